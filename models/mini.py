"""The mini example of the element: one body on springs along its axes, moving along y."""

import rbsd_sym as rs

T_END = 1.0
COLUMNS = ("body.position", "spring.force_local")


def scene() -> rs.Scene:
    """Return 1 kg on springs of 500 N/m, with 5 N s/m along y, started at 1000 m/s."""
    body = rs.RigidBody("body", mass=1, inertia=(1, 1, 1), velocity=(0, 1000, 0))
    spring = rs.RigidBodySpringDamper(
        "spring",
        rs.Marker(rs.GROUND),
        rs.Marker("body"),
        stiffness=(500, 500, 500, 0, 0, 0),
        damping=(0, 5, 0, 0, 0, 0),
    )
    return rs.Scene("mini", [body], [spring])
