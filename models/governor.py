"""A flyball governor: its balls rise as the shaft turns, and lift the slider."""

import numpy as np

import rbsd_sym as rs

T_END = 1.0
COLUMNS = ("slider.position", "rod_0.velocity", "hinge_0.force_local")
SPIN = np.array([0.0, 0.0, 0.16 * 2 * np.pi])
TILT = np.deg2rad(30.0)
K_JOINT = 2e4
K_TURN = 0.05 * K_JOINT


def _box(mass, x, y, z):
    """Return the principal inertias (3,) of a solid cuboid with these edges, kg m2."""
    return mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])


def _turning(name, mass, inertia, position, size, angle=0.0, com=(0, 0, 0)):
    """Return a body tilted about y by `angle` (rad) that rotates with the shaft."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return rs.RigidBody(
        name,
        mass,
        inertia,
        com=com,
        position=position,
        rotation=R,
        size=size,
        velocity=np.cross(SPIN, position),
        # The angular velocity is given in body axes, the velocity in world axes.
        angular_velocity=R.T @ SPIN,
    )


def _strut(
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
    """Spring (4000 N/m, 0.5 m long) and damper (200 N s/m) along the line between the points."""
    d = displacement
    length = np.sqrt(d @ d)
    pull = (4000.0 * (length - 0.5) + 200.0 * (d @ velocity) / length) / length
    return [pull * d[0], pull * d[1], pull * d[2], 0.0, 0.0, 0.0]


def _bodies():
    """Return shaft and slider, and two rods of 0.3 kg with a ball of 5 kg at each tip."""
    rod, ball = 0.3, 5.0
    # Rod and ball as one body: the ball is 0.5 m from the rod's middle.
    com = 0.5 * ball / (rod + ball)
    across = rod * com**2 + ball * (0.5 - com) ** 2
    inertia = _box(rod, 1.0, 0.01, 0.01) + np.array([0, across, across])
    reach = 0.05 + 0.5 * np.cos(TILT)
    return [
        _turning("shaft", rod, _box(rod, 0.01, 0.01, 1.0), (0, 0, 0.5), (0.01, 0.01, 1.0)),
        _turning("slider", 3.0, _box(3.0, 0.1, 0.1, 0.1), (0, 0, 0.5), (0.1, 0.1, 0.1)),
        *(
            _turning(
                f"rod_{i}",
                rod + ball,
                inertia,
                (side * reach, 0, 0.75),
                (1.0, 0.01, 0.01),
                side * TILT,
                (side * com, 0, 0),
            )
            for i, side in enumerate((1, -1))
        ),
    ]


def scene() -> rs.Scene:
    """Return Exudyn's `stiffFlyballGovernor`: stiff joints without damping.

    Its modes reach 2.8e4 rad/s, beside a slow motion, which makes it hard for most methods.
    """
    k, turn = K_JOINT, K_TURN
    base = np.diag([k, k, k, turn, turn, 0])
    connectors = [
        rs.RigidBodySpringDamper(
            "base", rs.Marker(rs.GROUND), rs.Marker("shaft", (0, 0, -0.5)), base, 0.05 * base
        ),
        rs.RigidBodySpringDamper(
            "guide", rs.Marker("shaft"), rs.Marker("slider"), [k, k, 0, turn, turn, turn]
        ),
    ]
    for i, side in enumerate((1, -1)):
        connectors += [
            rs.RigidBodySpringDamper(
                f"hinge_{i}",
                rs.Marker("shaft", (0.05 * side, 0, 0.5)),
                rs.Marker(f"rod_{i}", (-0.5 * side, 0, 0)),
                [k, k, k, turn, 0, turn],
            ),
            rs.RigidBodySpringDamper(
                f"strut_{i}",
                rs.Marker("slider", (0.05 * side, 0, 0)),
                rs.Marker(f"rod_{i}"),
                0,
                force=_strut,
            ),
        ]
    return rs.Scene("governor", _bodies(), connectors, gravity=(0, 0, -9.81))
