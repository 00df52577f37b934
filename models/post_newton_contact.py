"""A ball on a floor, the contact switched by a post-Newton step instead of an event."""

import rbsd_sym as rs

T_END = 1.0
COLUMNS = ("ball.position", "floor.data_0")
STIFFNESS, DAMPING = 1e4, 10.0


def force(
    mbs,
    t,
    item,
    data,
    displacement,
    rotation,
    velocity,
    angular_velocity,
    stiffness,
    damping,
    rotJ0,
    rotJ1,
    offset,
):
    """Spring and damper while data[0] is 1."""
    return [0, 0, data[0] * (STIFFNESS * displacement[2] + DAMPING * velocity[2]), 0, 0, 0]


def post_newton_step(
    mbs,
    t,
    item,
    data,
    displacement,
    rotation,
    velocity,
    angular_velocity,
    stiffness,
    damping,
    rotJ0,
    rotJ1,
    offset,
):
    """Contact begins where the ball is below the floor and pushed up, and ends with the push.

    The error is the force that was there, or missing, by mistake.
    """
    push = -(STIFFNESS * displacement[2] + DAMPING * velocity[2])
    touches = rs.where(displacement[2] < 0, rs.where(push > 0, 1, 0), 0)
    error = rs.where(touches == data[0], 0, abs(push))
    return [error, rs.where(error > 0, 1e-6, -1), touches]


def scene() -> rs.Scene:
    """1 kg dropped from 0.1 m."""
    ball = rs.RigidBody(
        "ball", 1, (4e-4, 4e-4, 4e-4), position=(0, 0, 0.1), size=(0.05, 0.05, 0.05)
    )
    floor = rs.RigidBodySpringDamper(
        "floor",
        rs.Marker(rs.GROUND),
        rs.Marker("ball"),
        0,
        data=[0.0],
        force=force,
        post_newton_step=post_newton_step,
    )
    return rs.Scene("post_newton_contact", [ball], [floor], gravity=(0, 0, -9.81))
