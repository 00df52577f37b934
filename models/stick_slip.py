"""A block on a moving belt, held by a spring: it sticks, and slips back."""

import rbsd_sym as rs

T_END = 10.0
COLUMNS = ("block.p_x", "block.v_x", "spring.friction_x_force")


def scene() -> rs.Scene:
    """1 kg on a belt of 0.5 m/s, weight 10 N, static friction 0.4, kinetic 0.3."""
    block = rs.RigidBody("block", 1, (0.1, 0.1, 0.1), velocity=(0.5, 0, 0), size=(0.3, 0.2, 0.2))
    belt = rs.Friction(0, normal=10, kinetic=0.3, static=0.4, velocity=0.5)
    spring = rs.RigidBodySpringDamper(
        "spring", rs.Marker(rs.GROUND), rs.Marker("block"), (4, 0, 0, 0, 0, 0), effects=[belt]
    )
    return rs.Scene("stick_slip", [block], [spring])
