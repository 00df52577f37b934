"""A block on a moving belt, held by a spring: it sticks, and slips back."""

import rbsd_sym as rs

T_END = 10.0
COLUMNS = ("block.p_x", "block.v_x", "spring.friction_x_force")


def scene(belt: object = 0.5, smoothing: float = 0) -> rs.Scene:
    """1 kg, weight 10 N, static friction 0.4, kinetic 0.3, on a belt with this velocity (m/s).

    With `smoothing` (m/s) friction is regularised over this width, and has no events.
    """
    block = rs.RigidBody("block", 1, (0.1, 0.1, 0.1), velocity=(0.5, 0, 0), size=(0.3, 0.2, 0.2))
    friction = rs.Friction(
        0, normal=10, kinetic=0.3, static=0.4, velocity=belt, smoothing=smoothing
    )
    spring = rs.RigidBodySpringDamper(
        "spring", rs.Marker(rs.GROUND), rs.Marker("block"), (4, 0, 0, 0, 0, 0), effects=[friction]
    )
    return rs.Scene("stick_slip", [block], [spring])
