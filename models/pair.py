"""Two free bricks on one undamped connector: shows what each law does to energy and momentum."""

import rbsd_sym as rs

T_END = 1.0
COLUMNS = ("energy", "angular_momentum", "joint.rotation")


def scene(law: object = None) -> rs.Scene:
    """Return two 20 kg bricks side by side that rotate against each other.

    Energy is constant and angular momentum zero, if the law conserves them.

    Arguments:
        law: law of the connector; `Consistent` by default.
    """
    inertia = (0.08333333333333336, 1.7333333333333334, 1.6833333333333333)
    spin = (8.5, 10.5, 16.0)
    left = rs.RigidBody(
        "left", 20, inertia, position=(0, 1, 0), angular_velocity=spin, size=(1, 0.1, 0.2)
    )
    right = rs.RigidBody(
        "right",
        20,
        inertia,
        position=(1, 1, 0),
        angular_velocity=[-w for w in spin],
        size=(1, 0.1, 0.2),
    )
    joint = rs.RigidBodySpringDamper(
        "joint",
        rs.Marker("left", (0.5, 0, 0)),
        rs.Marker("right", (-0.5, 0, 0)),
        stiffness=(4000, 5000, 7000, 250, 500, 325),
        law=law or rs.Consistent(),
    )
    return rs.Scene("pair", [left, right], [joint])
