"""One body on one connector along one axis, free or driven, for the tests of effects and events."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from helpers.comparing import largest
from oracles import discontinuities as events
from oracles.rotations import exp_so3, log_so3

import rbsd_sym as rs

from .small import LAWS

HEAVY = 1e20  # kg or kg m2: a body that forces of 1 N do not move
TIGHT = {
    "idas": rs.Idas(1e-10, 1e-12), "rosenbrock": rs.Rosenbrock(1e-10, 1e-12),
    "explicit": rs.ExplicitRK(1e-10, 1e-12), "dop853": rs.Dop853(1e-10, 1e-12),
}  # fmt: skip
HOLDING = ("idas", "rosenbrock")  # those that solve for the force of friction that sticks
SOME = [("standard", 0), ("standard", 5), ("intrinsic", 3), ("consistent", 2), ("consistent", 4)]


def unit(axis: int) -> np.ndarray:
    """The axis 0 ... 5 as a column of six."""
    return np.eye(6)[axis]


def block(
    effects: Any, axis: int = 0, stiffness: Any = 0.0, mass: Any = 1.0, x: float = 0.0,
    v: float = 0.0, law: str = "standard", damping: Any = 0.0, pull: Any = 0.0, **options: Any,
) -> rs.Scene:  # fmt: skip
    """Body "b" on a connector "j" from the ground: m x'' = pull - k x - d x' - effects.

    For axes 3, 4, 5 x is an angle and the mass a moment of inertia.
    """
    e, turns = unit(axis), axis > 2
    start = {"position": x * e[:3], "velocity": v * e[:3]}
    if turns:
        start = {"rotation": exp_so3(x * e[3:]), "angular_velocity": v * e[3:]}
    body = rs.RigidBody("b", 1.0 if turns else mass, [mass if turns else 1.0] * 3, **start)
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND), rs.Marker("b"), stiffness * e, damping * e, law=LAWS[law],
        effects=effects, **options,
    )  # fmt: skip
    kind = "torque" if turns else "force"
    load = rs.Load("pull", rs.Marker("b"), **{kind: pull * (e[3:] if turns else e[:3])})
    return rs.Scene("block", [body], [joint], [load])


def driven(
    effects: Any, path: Any, axis: int = 0, law: str = "standard", stiffness: float = 0.0
) -> rs.Scene:
    """A connector whose strain follows `path`, a function of TIME, between ground and HEAVY."""
    e = unit(axis)
    body = rs.RigidBody("b", HEAVY, [HEAVY] * 3)
    half = path / 2
    turn = [np.cos(half), *(-np.sin(half) * e[3:])]  # of marker 0: back
    moved = rs.Marker(rs.GROUND, -path * e[:3], turn if axis > 2 else np.eye(3))
    joint = rs.RigidBodySpringDamper(
        "j", moved, rs.Marker("b"), stiffness * e, law=LAWS[law], effects=effects
    )
    return rs.Scene("driven", [body], [joint])


def along(trajectory: rs.Trajectory, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """Strain and rate of the connector."""
    names = ("displacement_local", "velocity_local") if axis < 3 else (
        "rotation", "angular_velocity_local")  # fmt: skip
    x, v = (trajectory[f"j.{name}"][:, axis % 3] for name in names)
    return x, v


def force(trajectory: rs.Trajectory, axis: int) -> np.ndarray:
    """Force of the connector along the axis."""
    return trajectory["j.force_local" if axis < 3 else "j.torque_local"][:, axis % 3]


def times_of(trajectory: rs.Trajectory, ending: str) -> np.ndarray:
    """Times of the events whose names end so."""
    return np.array([t for t, name in trajectory.events if name.endswith(ending)])


def evaluate(model: rs.Model, name: str, t: float = 0.0, **values: Any) -> np.ndarray:
    """An output at states given by name ("__" for "."), arrays of one length, the others at start.

    Returns one row per state.
    """
    labels = (*model.x_labels, *model.dae.z_labels)
    given = {key.replace("__", "."): np.atleast_1d(value) for key, value in values.items()}
    unknown = set(given) - {label.name for label in labels}
    if unknown:
        raise KeyError(f"{unknown}; there are {[label.name for label in labels]}")
    n = max((len(value) for value in given.values()), default=1)
    rows = np.array([
        np.broadcast_to(given.get(label.name, label.start), n) for label in labels
    ]).reshape(len(labels), n)  # fmt: skip
    p = np.array([label.start for label in model.dae.p_labels])[:, None].repeat(n, 1)
    u = np.array([label.start for label in model.dae.u_labels])[:, None].repeat(n, 1)
    times = np.full((1, n), t)
    found = model.function(name)(times, rows[: model.n_x], rows[model.n_x :], u, p)
    return np.array(found).T


class Thrown(NamedTuple):
    """Two free bodies about to hit, the oracle's bodies, and the normal from 0 to 1."""

    scene: rs.Scene
    bodies: tuple[events.Body, events.Body]
    normal: np.ndarray


def thrown(effect: Any, law: str, seed: int, apart: float, aside: float = 0.0) -> Thrown:
    """Bodies b0 and b1 whose markers in 1e-9 s are `apart` (m) along axis 1 of the law, all random.

    The markers lie `aside` (m) across. The law looks along the axes of marker 0, or those half way.
    """
    draw = np.random.default_rng(seed).uniform
    R = [exp_so3(draw(-1, 1, 3)) for _ in range(2)]
    turn, arms, coms = exp_so3(draw(-0.3, 0.3, 3)), draw(-0.5, 0.5, (2, 3)), draw(-0.2, 0.2, (2, 3))
    A = R[0] @ turn
    if law != "standard":
        A = A @ exp_so3(log_so3(A.T @ R[1]) / 2)
    n, spins, masses = A[:, 1], draw(-2, 2, (2, 3)), (2.0, 0.7)
    inertias = [np.diag(draw(0.1, 0.2, 3)) for _ in range(2)]
    at_marker = [draw(-1, 1, 3) + 3 * n, draw(-1, 1, 3) - 3 * n]
    v = [at_marker[i] - R[i] @ np.cross(spins[i], arms[i]) for i in range(2)]
    way = 1e-9 * n @ (at_marker[0] - at_marker[1])
    p = [np.zeros(3), R[0] @ arms[0] - R[1] @ arms[1] + aside * A[:, 0] + (apart + way) * n]
    bodies = [
        rs.RigidBody(f"b{i}", masses[i], inertias[i], coms[i], p[i], R[i], v[i], spins[i])
        for i in range(2)
    ]
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker("b0", arms[0], turn), rs.Marker("b1", arms[1]), 0.0, law=LAWS[law],
        effects=effect,
    )  # fmt: skip
    twins = [
        events.Body(masses[i], R[i] @ inertias[i] @ R[i].T, R[i] @ (arms[i] - coms[i]),
                    v[i] + R[i] @ np.cross(spins[i], coms[i]), R[i] @ spins[i])
        for i in range(2)
    ]  # fmt: skip
    return Thrown(rs.Scene("thrown", bodies, [joint]), (twins[0], twins[1]), n)


def names(axis: int) -> tuple[str, str]:
    """Position and velocity of a body that moves along one axis only, as states of its model."""
    letter = "xyz"[axis % 3]
    return ("b.p_" + letter, "b.v_" + letter) if axis < 3 else (
        "b.angle_" + letter, "b.w_" + letter)  # fmt: skip


def gauss(breaks: Sequence[float], longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Times inside the pieces between breaks (s), no longer than `longest`, and their weights.

    Eight Gauss points in each piece; pieces below 1e-7 of the whole are left out.
    """
    y, w = np.polynomial.legendre.leggauss(8)
    times, weights = [], []
    breaks = np.unique(breaks)
    for start, end in pairwise(breaks):
        if end - start > 1e-7 * (breaks[-1] - breaks[0]):
            edges = np.linspace(start, end, 1 + int(np.ceil((end - start) / longest)))
            for a, b in pairwise(edges):
                times.append((a + b) / 2 + (b - a) / 2 * y)
                weights.append((b - a) / 2 * w)
    return np.concatenate(times), np.concatenate(weights)


class Balance(NamedTuple):
    """What became of the energy (J): change of the stored, heat, given, let go at events."""

    stored: float
    heat: float
    given: float
    lost: float

    @property
    def error(self) -> float:
        """What is missing."""
        return self.stored + self.heat + self.lost - self.given


def balance(
    model: rs.Model, end: float, integrator: Any, longest: float = 0.1,
    drive: int | None = None, pull: Any = None,
) -> Balance:  # fmt: skip
    """The energy over a run, powers integrated between events.

    Arguments:
        drive: axis of a connector whose marker on the ground is moved by TIME: the package counts
            what the ground gives as power of the ground, not of the connector.
        pull: (force of the load "pull", axis), whose power the package does not count.
    """
    first = rs.simulate(model, [0.0, end], integrator)
    t, weights = gauss([0.0, *(t for t, _ in first.events), end], longest)
    found = rs.simulate(model, np.concatenate([[0.0], t, [end]]), integrator)
    power = {name: weights @ found[f"j.{name}"][1:-1]
             for name in ("dissipated_power", "injected_power")}  # fmt: skip
    states = [label.name for label in model.x_labels if label.name.endswith("lost")]
    lost = sum(found[name][-1] - found[name][0] for name in states)
    change = float(found["energy"][-1] - found["energy"][0])
    given = power["injected_power"]
    if drive is not None:
        given += weights @ (force(found, drive) * along(found, drive)[1])[1:-1]
    if pull is not None:
        given += float(pull[0] * np.diff(along(found, pull[1])[0][[0, -1]])[0])
    return Balance(change, power["dissipated_power"], given, float(lost))


def compare(found: rs.Trajectory, phases: list[events.Phase], axis: int, error: float) -> None:
    """Positions and velocities against phases."""
    x, v = events.state_at(phases, found.t)
    ours = along(found, axis)
    assert largest(ours[0] - x) < error
    assert largest(ours[1] - v) < error
