"""Scenes of `tests/reference/scenes.json` as `Scene`s, and the error against their final states."""

from __future__ import annotations

from typing import Any

import numpy as np
from oracles.handwritten import chain
from paths import stored

import rbsd_sym as rs

from .small import LAWS

SCENES = stored("scenes")["scenes"]


def data(name: str) -> dict[str, Any]:
    """The named scene as the oracles read it; `chain<n>` of any length, stored or not."""
    return SCENES[name] if name in SCENES else chain(int(name.removeprefix("chain")))


def build(name: str) -> rs.Scene:
    """The named scene; body i is `b<i>`, connector i is `c<i>`."""
    given = data(name)
    bodies = [
        rs.RigidBody(
            f"b{i}", b["mass"], b["inertia"], position=b["position"],
            rotation=b.get("rotation", np.eye(3)), velocity=b["velocity"],
            angular_velocity=b["angular_velocity"],
        )
        for i, b in enumerate(given["bodies"])
    ]  # fmt: skip
    connectors = [_connector(i, c, LAWS[given["law"]]) for i, c in enumerate(given["connectors"])]
    return rs.Scene(name, bodies, connectors, gravity=given["gravity"])


def _connector(i: int, c: dict[str, Any], law: Any) -> rs.RigidBodySpringDamper:
    def marker(side: int) -> rs.Marker:
        body = c[f"body{side}"]
        return rs.Marker(rs.GROUND if body < 0 else f"b{body}", c[f"position{side}"])

    return rs.RigidBodySpringDamper(
        f"c{i}", marker(0), marker(1), c["stiffness"], c["damping"], c["offset"], law=law
    )


def error(name: str, trajectory: rs.Trajectory) -> float:
    """Largest error at the end over position, rotation, velocity, angular velocity.

    Each is relative to its excursion: the largest distance from the start over the trajectory (for
    a rotation matrix at least 1e-3, so that a body at rest does not divide by rounding).
    """
    final, worst = SCENES[name]["final"], 0.0
    for i in range(len(SCENES[name]["bodies"])):
        for ours, theirs in (("position", "position"), ("rotation_matrix", "rotation"),
                             ("velocity", "velocity"), ("angular_velocity", "angular_velocity")):
            values = trajectory[f"b{i}.{ours}"]
            excursion = max(np.abs(values - values[0]).max(), 1e-3)
            worst = max(worst, np.abs(values[-1] - np.array(final[theirs][i])).max() / excursion)
    return worst
