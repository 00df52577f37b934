"""The flyball governor of `models/governor.py`: the scene, and its published motion."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import numpy as np

from rbsd_sym import (
    GROUND,
    Marker,
    Model,
    ModelWarning,
    RigidBody,
    RigidBodySpringDamper,
    Scene,
    compile_scene,
)

SPEED = -0.903124289663356422  # m/s: rod_0.v_y at 1 s
HEIGHT = 0.485000928413884402  # m: of the slider
_SPIN = np.array([0.0, 0.0, 0.16 * 2 * np.pi])  # rad/s
_TILT = np.deg2rad(30.0)


@cache
def governor() -> Model:
    """26 modes up to 2.8e4 rad/s without damping, and a slow motion."""
    with warnings.catch_warnings():  # hinges about local y are sound below 90 degrees
        warnings.simplefilter("ignore", ModelWarning)
        return compile_scene(scene())


def scene() -> Scene:
    """Shaft, slider, two rods with balls; four joints and two struts."""
    k, turn = 2e4, 1e3
    base = np.diag([k, k, k, turn, turn, 0])
    connectors = [
        RigidBodySpringDamper(
            "base", Marker(GROUND), Marker("shaft", (0, 0, -0.5)), base, 0.05 * base
        ),
        RigidBodySpringDamper(
            "guide", Marker("shaft"), Marker("slider"), [k, k, 0, turn, turn, turn]
        ),
    ]
    for i, side in enumerate((1, -1)):
        connectors += [
            RigidBodySpringDamper(
                f"hinge_{i}",
                Marker("shaft", (0.05 * side, 0, 0.5)),
                Marker(f"rod_{i}", (-0.5 * side, 0, 0)),
                [k, k, k, turn, 0, turn],
            ),
            RigidBodySpringDamper(
                f"strut_{i}",
                Marker("slider", (0.05 * side, 0, 0)),
                Marker(f"rod_{i}"),
                0,
                force=_strut,
            ),
        ]
    return Scene("governor", _bodies(), connectors, gravity=(0, 0, -9.81))


def _strut(
    mbs: Any, t: Any, item: Any, displacement: Any, rotation: Any, velocity: Any, *rest: Any
) -> list[Any]:
    """Spring (4000 N/m, 0.5 m long) and damper (200 N s/m) along the line between the points."""
    d = displacement
    length = np.sqrt(d @ d)
    pull = (4000.0 * (length - 0.5) + 200.0 * (d @ velocity) / length) / length
    return [pull * d[0], pull * d[1], pull * d[2], 0.0, 0.0, 0.0]


def _box(mass: float, x: float, y: float, z: float) -> np.ndarray:
    """Principal inertias of a solid cuboid with these edges."""
    return mass / 12 * np.array([y * y + z * z, x * x + z * z, x * x + y * y])


def _turning(
    name: str, mass: float, inertia: Any, position: Any, angle: float = 0.0, com: Any = (0, 0, 0)
) -> RigidBody:
    """A body tilted about y, that turns with the shaft."""
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return RigidBody(
        name,
        mass,
        inertia,
        com=com,
        position=position,
        rotation=R,
        velocity=np.cross(_SPIN, position),
        angular_velocity=R.T @ _SPIN,
    )


def _bodies() -> list[RigidBody]:
    """Shaft and slider, and two rods of 0.3 kg with a ball of 5 kg at the tip."""
    rod, ball = 0.3, 5.0
    com = 0.5 * ball / (rod + ball)
    across = rod * com**2 + ball * (0.5 - com) ** 2
    inertia = _box(rod, 1.0, 0.01, 0.01) + np.array([0, across, across])
    reach = 0.05 + 0.5 * np.cos(_TILT)
    return [
        _turning("shaft", rod, _box(rod, 0.01, 0.01, 1.0), (0, 0, 0.5)),
        _turning("slider", 3.0, _box(3.0, 0.1, 0.1, 0.1), (0, 0, 0.5)),
        *(
            _turning(
                f"rod_{i}",
                rod + ball,
                inertia,
                (side * reach, 0, 0.75),
                side * _TILT,
                (side * com, 0, 0),
            )
            for i, side in enumerate((1, -1))
        ),
    ]
