"""A block on a moving belt, held by a spring, that alternately sticks and slips."""

import rbsd_sym as rs

T_END = 10.0
COLUMNS = ("block.p_x", "block.v_x", "spring.friction_x_force")


def scene(belt: object = 0.5, smoothing: float = 0) -> rs.Scene:
    """Return the block: 1 kg, weight 10 N, static friction 0.4, kinetic friction 0.3.

    Arguments:
        belt: velocity of the belt, m/s; a number, Param or Input.
        smoothing: width (m/s) of regularised friction without events; 0 for the form with events.
    """
    block = rs.RigidBody("block", 1, (0.1, 0.1, 0.1), velocity=(0.5, 0, 0), size=(0.3, 0.2, 0.2))
    friction = rs.Friction(
        0, normal=10, kinetic=0.3, static=0.4, velocity=belt, smoothing=smoothing
    )
    spring = rs.RigidBodySpringDamper(
        "spring", rs.Marker(rs.GROUND), rs.Marker("block"), (4, 0, 0, 0, 0, 0), effects=[friction]
    )
    return rs.Scene("stick_slip", [block], [spring])
