"""Scenes of Exudyn's examples and of the literature, and values of their motions (SI).

The values are closed forms, or come from an extrapolation of order 16 in extended precision; those
that test suites print are of coarse steps, and are not used. Three of the scenes are in models/.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from paths import MODELS

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file

Array = NDArray[np.float64]


def turn(axis: str, degrees: float) -> Array:
    """Elementary rotation about 'x', 'y' or 'z'."""
    a = np.deg2rad(degrees)
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    R = np.eye(3)
    R[j, j] = R[k, k] = np.cos(a)
    R[k, j] = np.sin(a)
    R[j, k] = -R[k, j]
    return R


def cuboid(mass: float, x: float, y: float, z: float) -> Array:
    """Principal inertias of a solid cuboid with these edges."""
    return mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])


mini, brick_pair, governor = (
    load_model_file(MODELS / f"{name}.py").scene for name in ("mini", "pair", "governor")
)
MINI_Y = -0.83979165737914566746


def linear_force(
    mbs: Any, t: Any, item: Any, displacement: Any, rotation: Any, velocity: Any,
    angular_velocity: Any, stiffness: Any, damping: Any, rotJ0: Any, rotJ1: Any, offset: Any,
) -> list[Any]:
    """The documented user function, written as for plain numbers; it ignores the offset."""
    k, d = stiffness, damping
    force = [displacement[i] * k[i][i] + velocity[i] * d[i][i] for i in range(3)]
    torque = [rotation[i] * k[3 + i][3 + i] + angular_velocity[i] * d[3 + i][3 + i]
              for i in range(3)]
    return force + torque


def user_force() -> rs.Scene:
    """Unit mass and inertia on a user force; the offset must not matter."""
    body = rs.RigidBody(
        "body", 1.0, [1.0, 1.0, 1.0], velocity=[0, 10, 0], angular_velocity=[8 * np.pi, 0, 0]
    )
    spring = rs.RigidBodySpringDamper(
        "spring", rs.Marker(rs.GROUND), rs.Marker("body"), np.full(6, 5000.0),
        [50, 50, 50, 5, 5, 5], offset=[0.1, 0.2, 0.3, 0.1, 0.2, 0.3], force=linear_force,
    )
    return rs.Scene("user_force", [body], [spring])


USER_FORCE_R = {0.1: 0.18270749424034783999, 1.0: 0.19703898945856870887}

SPIN = [8.5, 10.5, 16.0]  # rad/s, of the bricks


def brick_on_ground(law: Any, body_first: bool = False) -> rs.Scene:
    """Body 1 of the intrinsic test; with `body_first` body 2, whose markers are swapped."""
    markers = [rs.Marker(rs.GROUND, [0.5, 0, 0]), rs.Marker("body", [-0.5, 0, 0])]
    if body_first:
        markers.reverse()
    body = rs.RigidBody(
        "body", 20.0, cuboid(20.0, 1.0, 0.1, 0.2), position=[1, 0, 0], velocity=[0, 1, 2],
        angular_velocity=SPIN,
    )  # fmt: skip
    K = [4000.0, 5000.0, 7000.0, 250.0, 500.0, 325.0]
    spring = rs.RigidBodySpringDamper("spring", *markers, K, law=law)
    return rs.Scene("brick", [body], [spring])


INTRINSIC_DISPLACEMENT = {
    1.0: [0.16842872947209188, -0.062373656590390931, 0.10666627222215249],
    5.0: [-0.095363301680375017, -0.12467905461758595, -0.086626924508350091],
}
INTRINSIC_PAIR_SPIN = [-44.430154748, 27.823298362, -2.7553305840]
STANDARD_CENTRE = {
    False: [1.1721991762561, -0.0914798585380, 0.1095815937500],
    True: [1.1452088375999, -0.1096747104114, 0.1005483038187],
}

_BRICARD_POINTS = np.array([[0, 0, 0], [1, 0, 0], [1, -1, 0], [1, -1, 1], [0, -1, 1], [0, 0, 1]],
                           float)
_BRICARD_TURNS = (("z", 0), ("z", -90), ("y", -90), ("z", 180), ("z", 90))


def bricard(k: float = 1e6, kr: float = 1e4, free: str = "z") -> rs.Scene:
    """Bricard's linkage of five rods and six penalty hinges, free about their local z (or x)."""
    rods, rotations = [], [np.eye(3)]
    for i, (axis, degrees) in enumerate(_BRICARD_TURNS):
        rotations.append(np.round(turn(axis, degrees)))
        rods.append(rs.RigidBody(
            f"rod{i}", 1.0, cuboid(1.0, 1.0, 0.1, 0.1), rotation=rotations[-1],
            position=(_BRICARD_POINTS[i] + _BRICARD_POINTS[i + 1]) / 2,
        ))  # fmt: skip
    rotations.append(np.eye(3))
    stiffness = [k, k, k, kr, kr, 0] if free == "z" else [k, k, k, 0, kr, kr]
    hinges = []
    for i, axis in enumerate("yzxyzx"):
        a = "xyz".index(axis)
        columns = (a + 1, a + 2, a) if free == "z" else (a, a + 1, a + 2)
        frame = np.eye(3)[:, [column % 3 for column in columns]]
        markers = [
            rs.Marker(name, position, rotation.T @ frame) for name, position, rotation in (
                (f"rod{i - 1}" if i else rs.GROUND, [0.5, 0, 0] if i else [0, 0, 0], rotations[i]),
                (f"rod{i}" if i < 5 else rs.GROUND,
                 [-0.5, 0, 0] if i < 5 else _BRICARD_POINTS[5], rotations[i + 1]),
            )
        ]  # fmt: skip
        hinges.append(rs.RigidBodySpringDamper(f"hinge{i}", *markers, stiffness))
    return rs.Scene("bricard", rods, hinges, gravity=[0, -9.81, 0])


BRICARD_P3 = {
    0.1: [1.000494745783000, -1.010645534294717, 0.990146912966229],
    0.5: [0.965822997177372, -1.228691534329196, 0.751602127092755],
}
BRICARD_ENERGY = 29.43


def heavy_top(k: float = 1e8) -> rs.Scene:
    """The heavy top on a stiff pivot at the origin."""
    spin = np.array([0, 150, -4.61538])
    centre = np.array([0.0, 1.0, 0.0])
    body = rs.RigidBody(
        "top", 15.0, [0.234375, 0.46875, 0.234375], position=centre,
        velocity=np.cross(spin, centre), angular_velocity=spin,
    )
    pivot = rs.RigidBodySpringDamper(
        "pivot", rs.Marker(rs.GROUND), rs.Marker("top", -centre), [k, k, k, 0, 0, 0]
    )
    return rs.Scene("heavy_top", [body], [pivot], gravity=[0, 0, -9.81])


HEAVY_TOP_CENTRE = {
    1.0: [0.1733326967159041, 0.6401387942069112, -0.7484551453954696],
    2.0: [-0.1503451462787639, -0.7241037095185683, -0.6731105507033185],
}


GOVERNOR_SPEED = {
    0.001: 0.896248877910944869, 0.1: 0.865486638927913772, 1.0: -0.903124289663356422,
}  # fmt: skip
GOVERNOR_STIFFEST = 2.789e4
GOVERNOR_HEIGHT = {0.1: 0.461062144488478686, 1.0: 0.485000928413884402}


def tumbling(e: float) -> rs.Scene:
    """A free body that spins nearly about its intermediate axis."""
    body = rs.RigidBody("body", 1.0, [1.0, 2.0, 3.0], angular_velocity=[e, 1, e])
    return rs.Scene("tumbling", [body], [])


TUMBLING_HALF_PERIOD = {0.1: 11.4981314720612743, 0.01: 19.5528670986343604,
                        0.001: 27.530840553733186}
