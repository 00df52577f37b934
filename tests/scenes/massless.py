"""Scenes with massless bodies, for the tests of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from helpers.comparing import largest
from oracles import scenes as oracle
from oracles.rotations import exp_so3

import rbsd_sym as rs

from .small import GROUND, LAWS

UNDAMPED, DAMPED = 0.0, 0.02  # s: damping matrix over stiffness matrix
TIGHTER = rs.Idas(1e-11, 1e-13)
Data = dict[str, Any]


def ground(*place: Any) -> rs.Marker:
    """A marker on the ground."""
    return rs.Marker(rs.GROUND, place)


def spring(
    name: str, one: rs.Marker, other: rs.Marker, K: Any, D: Any = 0, law: str = "standard",
    **options: Any,
) -> rs.RigidBodySpringDamper:  # fmt: skip
    """A connector; a law by its name."""
    return rs.RigidBodySpringDamper(name, one, other, K, D, law=LAWS[law], **options)


def massless(name: str, *place: float) -> rs.RigidBody:
    """A body without mass and inertia."""
    return rs.RigidBody(name, 0, 0, position=place)


def residual(model: rs.Model, trajectory: rs.Trajectory, rows: Any = slice(None)) -> float:
    """Largest |alg| over the saved points, N or N m."""
    t = trajectory.t[rows]
    x, z, u, p = (
        np.array([trajectory[label.name][rows] for label in labels]).reshape(len(labels), len(t))
        for labels in (
            model.x_labels, model.dae.z_labels, model.dae.u_labels, model.dae.p_labels)
    )  # fmt: skip
    values = model.function("alg")(t[None, :], x, z, u, p)
    return float(np.abs(np.array(values)).max(initial=0.0))


def values_of_z(model: rs.Model) -> np.ndarray:
    """Start values in the labels of z."""
    return np.array([label.start for label in model.dae.z_labels])


def linked(mass: float, damping: float, start: Mapping[str, Any] | None = None) -> rs.Scene:
    """Ground - spring - link - spring - body (1 kg); the link has `mass` and that inertia."""
    K = np.array([1000, 1200, 1500, 200, 300, 400], float)
    inertia = (mass, mass, mass) if mass else 0
    link = rs.RigidBody("link", mass, inertia, **(start or {"position": (1, 0, 0)}))
    body = rs.RigidBody(
        "body", 1.0, (0.1, 0.2, 0.3), position=(2, 0.1, 0), velocity=(0, 0.5, 0.3)
    )
    markers = (
        ("inner", rs.Marker(rs.GROUND), rs.Marker("link", (-1, 0, 0))),
        ("outer", rs.Marker("link"), rs.Marker("body", (-1, 0, 0))),
    )
    springs = [
        rs.RigidBodySpringDamper(name, one, other, K, damping * K, law=rs.Consistent())
        for name, one, other in markers
    ]
    return rs.Scene("link", [link, body], springs, gravity=(0.3, -1, 0.5))


def start_of(trajectory: rs.Trajectory, body: str) -> dict[str, Any]:
    """Pose and velocities of a body at the first point, as RigidBody takes them."""
    q = trajectory[f"{body}.quaternion"][0]
    start = {
        name: trajectory[f"{body}.{name}"][0]
        for name in ("position", "velocity", "angular_velocity")
    }
    return start | {"rotation": q / np.linalg.norm(q)}


# An independent oracle: numpy, with the laws as written a second time in tests/oracles.


def scene_data(law: str, damping: float, seed: int = 3) -> Data:
    """A massless body b0 between two springs with coupled stiffness, turned markers and offsets."""
    rng = np.random.default_rng(seed)
    turned = lambda size: exp_so3(size * rng.uniform(-1, 1, 3))  # noqa: E731
    bodies = [
        {"mass": 0.0, "inertia": np.zeros(3), "position": [1, 0.1, 0], "velocity": np.zeros(3),
         "angular_velocity": np.zeros(3), "rotation": turned(0.2)},
        {"mass": 2.0, "inertia": [0.1, 0.2, 0.25], "position": [2, 0, 0.2], "rotation": turned(0.3),
         "velocity": [0.3, -0.2, 1], "angular_velocity": [1, -2, 0.5]},
    ]  # fmt: skip
    connectors = []
    for ends, place0, place1 in (
        ((-1, 0), [0, 0, 0], [-1, 0.1, 0.05]), ((0, 1), [0.2, 0.1, -0.1], [-0.8, 0, 0.1])
    ):  # fmt: skip
        A = rng.uniform(-1, 1, (6, 6))
        scale = np.sqrt([1500.0] * 3 + [60.0] * 3)
        K = scale[:, None] * (np.eye(6) + 0.05 * (A + A.T)) * scale  # positive by Gershgorin
        connectors.append({
            "body0": ends[0], "body1": ends[1], "position0": place0, "position1": place1,
            "stiffness": K, "damping": damping * K, "offset": rng.uniform(-0.05, 0.05, 6),
            "rotation0": turned(0.3), "rotation_marker0": turned(0.2),
            "rotation_marker1": turned(0.2),
        })  # fmt: skip
    return {"gravity": [0.3, -1, 0.5], "law": law, "bodies": bodies, "connectors": connectors}


def scene_of(data: Data, **options: Any) -> rs.Scene:
    """The scene of the oracle's data; bodies b<i>, connectors c<i>."""

    def marker(c: Data, side: int) -> rs.Marker:
        body = c[f"body{side}"]
        name = rs.GROUND if body == oracle.GROUND else f"b{body}"
        return rs.Marker(name, c[f"position{side}"], c.get(f"rotation{side}", np.eye(3)))

    turn = lambda c, side: c.get(f"rotation_marker{side}", np.eye(3))  # noqa: E731
    bodies = [
        rs.RigidBody(
            f"b{i}", b["mass"], b["inertia"] if b["mass"] else 0, position=b["position"],
            rotation=b.get("rotation", np.eye(3)), velocity=b["velocity"],
            angular_velocity=b["angular_velocity"],
        )
        for i, b in enumerate(data["bodies"])
    ]  # fmt: skip
    springs = [
        spring(
            f"c{i}", marker(c, 0), marker(c, 1), c["stiffness"], c["damping"], data["law"],
            offset=c["offset"], rotation_marker0=turn(c, 0), rotation_marker1=turn(c, 1),
        )
        for i, c in enumerate(data["connectors"])
    ]  # fmt: skip
    return rs.Scene("scene", bodies, springs, gravity=data["gravity"], **options)


def oracle_states(trajectory: rs.Trajectory, n: int) -> np.ndarray:
    """States (points, bodies, 13) in the oracle's order."""
    names = ("position", "quaternion", "velocity", "angular_velocity")
    return np.stack([np.hstack([trajectory[f"b{i}.{q}"] for q in names]) for i in range(n)], axis=1)


def unbalance(data: Data, states: np.ndarray) -> float:
    """Force and torque left on body 0 by the oracle's laws, relative to what the springs pull."""
    worst = 0.0
    for state in states:
        force, moment = oracle.wrenches(data, state)
        pulls = [oracle.connector_result(data, state, c) for c in data["connectors"]]
        sizes = [max(largest(getattr(r, of)) for r in pulls) for of in ("force0", "torque0")]
        worst = max(worst, largest(force[0]) / sizes[0], largest(moment[0]) / sizes[1])
    return worst


# Consistent start.


def strung(place: Any = (1, 0, 0), turn: Any = (1, 0, 0, 0), k: Any = 1000.0) -> rs.Scene:
    """A massless body between two springs, off the balance unless started there."""
    a = rs.RigidBody("a", 0, 0, position=place, rotation=np.array(turn) / np.linalg.norm(turn))
    b = rs.RigidBody("b", 1, (0.1, 0.2, 0.3), position=(2.1, 0.1, 0))
    links = [rs.Marker("a", (-1, 0, 0)), rs.Marker("a"), rs.Marker("b", (-1, 0, 0))]
    springs = [
        spring("c1", GROUND, links[0], [k, 1200, 1500, 200, 300, 400], law="intrinsic"),
        spring("c2", *links[1:], [1500, 1200, 1000, 400, 300, 100], law="intrinsic"),
    ]
    return rs.Scene("strung", [a, b], springs, gravity=(0.3, -1, 0.5))
