"""A connector whose force is a Python function with the documented signature of the element."""

import rbsd_sym as rs

T_END = 0.1
COLUMNS = ("body.position", "spring.rotation", "spring.force_local")


def force(
    mbs,
    t,
    item,
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
    """Return 6 forces: springs with some damping along y and about x; called once, with symbols."""
    k, u, th = stiffness, displacement, rotation
    return [
        u[0] * k[0][0],
        u[1] * k[1][1] + 0.01 * velocity[1] * k[1][1],
        u[2] * k[2][2],
        th[0] * k[0][0] + 0.001 * angular_velocity[0] * k[0][0],
        th[1] * k[0][0],
        th[2] * k[0][0],
    ]


def scene() -> rs.Scene:
    """Return 1 kg started along y and rotating about x; the function ignores the offset."""
    body = rs.RigidBody(
        "body",
        mass=1,
        inertia=(1, 1, 1),
        velocity=(0, 10, 0),
        angular_velocity=(8 * 3.141592653589793, 0, 0),
    )
    spring = rs.RigidBodySpringDamper(
        "spring",
        rs.Marker(rs.GROUND),
        rs.Marker("body"),
        stiffness=(5000, 5000, 5000, 0, 0, 0),
        offset=(0, 1, 0, 0, 0, 0),
        force=force,
    )
    return rs.Scene("user_force", [body], [spring])
