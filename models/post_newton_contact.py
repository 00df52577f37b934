"""A ball on a floor, with contact switched by a post-Newton step instead of an event."""

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
    """Return the force of a spring and damper along z while data[0] is 1."""
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
    """Return [error, recommended step, data] after a step.

    Contact closes where the ball is below the floor and pushed up, and opens with the push. The
    error is the force that was present, or missing, by mistake during the step just solved.
    """
    push = -(STIFFNESS * displacement[2] + DAMPING * velocity[2])
    touches = rs.where(displacement[2] < 0, rs.where(push > 0, 1, 0), 0)
    error = rs.where(touches == data[0], 0, abs(push))
    # A wrong state asks for the step to be redone with 1 us, -1 leaves the step as it is.
    return [error, rs.where(error > 0, 1e-6, -1), touches]


def scene() -> rs.Scene:
    """Return a ball of 1 kg dropped from 0.1 m."""
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
