"""Where a search starts: from the conditions, a simulation, values by name, or a solution."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..base.rotation import matrix_xyz, quat_matrix
from ..integrators.driver import input_values
from ..model.signals import signal_of
from ..model.trajectory import Trajectory
from .ends import at_start, start_values
from .problem import Free
from .stage import Frame, quaternions

_NEWTON = 30  # steps towards states that meet the conditions at an end
_DAMPING = 1e-8  # of these steps
_TURN = 0.5  # rad, of an angle in one of them
_STUCK, _NUDGE = 1e-6, 0.1  # a step that leads nowhere, and one that leads away


@dataclass(frozen=True, eq=False)
class Guess:
    """Values of a phase at fractions of it, by functions of (phase, fractions)."""

    s: np.ndarray
    x: Callable[[int, np.ndarray], np.ndarray]
    z: Callable[[int, np.ndarray], np.ndarray]
    v: Callable[[int, np.ndarray], np.ndarray]


def from_conditions(frame: Frame) -> Guess:
    """States straight from the start to the end of each phase, rotations the short way.

    Inputs are at their guess, else the model's value within the bounds; algebraic unknowns balance
    at the start.
    """
    s = np.array([label.start for label in frame.s_labels], float)
    ends = [_start_states(frame)]
    for i in range(frame.n_phases):
        ends.append(_end_states(frame, i, ends[-1], s))
    if frame.problem.periodic:
        s[frame.n_s - frame.model.n_x :] = ends[0]
    turns = quaternions(frame.model)

    def x(i: int, at: np.ndarray) -> np.ndarray:
        before, after = ends[i], ends[i + 1]
        found = before[:, None] + (after - before)[:, None] * at
        for turn in turns:
            rows = list(turn)
            found[rows] = _between(before[rows], after[rows], at)
        return found

    def v(i: int, at: np.ndarray) -> np.ndarray:
        t0, length = frame.span(i, s)
        rows = [_input(frame, k, float(t0) + float(length) * at) for k in frame.controls]
        return np.array(rows).reshape(frame.n_v, len(at))

    z0 = _balanced(frame, ends[0], v(0, np.zeros(1)), s)
    return Guess(s, x, lambda i, at: np.repeat(z0[:, None], len(at), axis=1), v)


def _input(frame: Frame, k: int, t: np.ndarray) -> np.ndarray:
    label = frame.model.dae.u_labels[k]
    free: Free = frame.problem.inputs[label.name]
    if callable(free.guess):
        return np.clip([float(free.guess(float(time))) for time in t], free.low, free.high)
    return np.full(len(t), free.start(label.start))


def _start_states(frame: Frame) -> np.ndarray:
    box = at_start(frame, 0).box
    return np.clip(start_values(frame), box[0], box[1])


def _end_states(frame: Frame, i: int, before: np.ndarray, s: np.ndarray) -> np.ndarray:
    """States near those at the start of a phase that meet the conditions at its end, if found."""
    terms, names = frame.terms[i], {v.name: k for k, v in enumerate(frame.model.x_labels)}
    box = terms.end.limits(frame.model.x_labels)
    x = np.clip(before, box[0], box[1])
    for body, target in terms.end.rows.targets.items():
        if f"{body}.q_w" in names:
            x[[names[f"{body}.q_{axis}"] for axis in "wxyz"]] = target
        elif f"{body}.a_x" in names:
            angles = np.array(matrix_xyz(quat_matrix(ca.DM(target)))).reshape(-1)
            x[[names[f"{body}.a_{axis}"] for axis in "xyz"]] = angles
    return np.clip(_towards(frame, i, x, s), box[0], box[1])


def _towards(frame: Frame, i: int, x: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Newton's method on the rows of an end, in the least change of the states."""
    rows = frame.terms[i].end.rows
    if not rows.labels:
        return x
    symbols = [
        ca.SX.sym(k, n)
        for k, n in (
            ("t", 1),
            ("x", frame.model.n_x),
            ("z", frame.model.n_z),
            ("v", frame.n_v),
            ("s", frame.n_s),
        )
    ]
    value = frame.node(rows.expr)(*symbols)[0]
    both = ca.Function("towards", symbols, [value, ca.jacobian(value, symbols[1])])
    t0, length = frame.span(i, s)
    fixed = (float(t0) + float(length), np.zeros(frame.model.n_z), np.zeros(frame.n_v), s)
    turns = np.array([label.unit == "rad" for label in frame.model.x_labels])
    found, widest = x.copy(), np.where(turns, _TURN, np.inf)
    for _ in range(_NEWTON):
        r, J = (np.array(ca.DM(part)) for part in both(fixed[0], found, *fixed[1:]))
        gap = np.clip(r[:, 0], rows.low, rows.high) - r[:, 0]
        if not (np.isfinite(gap).all() and np.isfinite(J).all()):
            return x
        if np.abs(gap).max() < 1e-12:
            break
        step = J.T @ np.linalg.lstsq(J @ J.T + _DAMPING * np.eye(len(gap)), gap, rcond=None)[0]
        if np.abs(step).max() < _STUCK:  # half a turn away an orientation has no derivative
            step = _NUDGE * np.cos(np.arange(len(found)))
        found = found + np.clip(step, -widest, widest)
    return found if np.isfinite(found).all() else x


def _between(before: np.ndarray, after: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Unit quaternions along the shorter arc from one to another (4, n)."""
    a, b = (q / max(float(np.linalg.norm(q)), 1e-300) for q in (before, after))
    b = b if a @ b >= 0 else -b
    angle = float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
    if angle < 1e-9:
        return np.repeat(a[:, None], len(at), axis=1)
    return (np.outer(a, np.sin((1 - at) * angle)) + np.outer(b, np.sin(at * angle))) / np.sin(angle)


def _balanced(frame: Frame, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:
    model = frame.model
    p = np.array([float(value) for value in frame.parameters(s)])[: model.n_p]
    z = model.dae.start_values(p)[1]
    if not model.n_z:
        return z
    u = np.array([float(value) for value in frame.inputs(0.0, v[:, 0])])
    found, good = model.plain.consistent(0.0, x, z, u, p)
    return found if good else z


def from_user(frame: Frame, given: Any) -> Guess:
    """A guess from what the user gave.

    Arguments:
        given: None, a `Trajectory` over all phases, or values by name: a number, samples
            (times, values), or a function of t, with horizons by `Free`.

    Raises:
        ValueError: unknown names, samples of wrong size.
        TypeError: anything else.
    """
    base = from_conditions(frame)
    if given is None:
        return base
    if isinstance(given, Trajectory):
        return _from_trajectory(frame, base, given)
    if isinstance(given, Mapping):
        return _from_values(frame, base, given)
    raise TypeError(
        f"guess: {type(given).__name__}; give a Trajectory, a Solution, or a mapping of values by "
        "name"
    )


def _from_trajectory(frame: Frame, base: Guess, given: Trajectory) -> Guess:
    """Stretched over the phases: their lengths are as guessed, the trajectory's total apart."""
    dae = frame.model.dae
    known = [v.name for v in dae.x_labels]
    missing = [name for name in known if name not in given]
    if missing:
        raise ValueError(
            f"guess: trajectory '{given.name}' has no '{missing[0]}'; it is of another model"
        )
    lengths = np.array([float(v) for v in frame.durations(base.s)])
    bounds = np.concatenate([[0.0], np.cumsum(lengths)]) / lengths.sum()
    t0, span = float(given.t[0]), float(given.t[-1] - given.t[0])

    def pick(labels: Any, default: Any) -> Any:
        def values(i: int, at: np.ndarray) -> np.ndarray:
            t = t0 + span * (bounds[i] + (bounds[i + 1] - bounds[i]) * at)
            found = default(i, at).copy()
            for k, label in enumerate(labels):
                if label.name in given:
                    found[k] = np.interp(t, given.t, given[label.name])
            return found

        return values

    controls = [dae.u_labels[k] for k in frame.controls]
    s = _scaled_horizons(frame, base.s, span)
    x = pick(dae.x_labels, base.x)
    if frame.problem.periodic:
        s[frame.n_s - frame.model.n_x :] = x(0, np.zeros(1))[:, 0]
    return Guess(s, x, pick(dae.z_labels, base.z), pick(controls, base.v))


def _scaled_horizons(frame: Frame, s: np.ndarray, span: float) -> np.ndarray:
    """Constants with one free horizon as long as the trajectory, if there is just one phase."""
    found = s.copy()
    horizon = frame.problem.stretches[0].horizon
    if frame.n_phases == 1 and isinstance(horizon, Free) and horizon.guess is None:
        found[0] = np.clip(span, horizon.low, horizon.high)
    return found


def _from_values(frame: Frame, base: Guess, given: Mapping[str, Any]) -> Guess:
    dae = frame.model.dae
    groups = {
        "x": dae.x_labels,
        "z": dae.z_labels,
        "v": tuple(dae.u_labels[k] for k in frame.controls),
    }
    known = {label.name: label.unit for labels in groups.values() for label in labels}
    for name in given:
        if name not in known:
            raise ValueError(
                f"guess: no state, algebraic unknown or free Input '{name}'; there are: "
                f"{', '.join(sorted(known))}"
            )
    signals = {k: signal_of(value, f"guess '{k}'", known[k]) for k, value in given.items()}

    def pick(kind: str, default: Any) -> Any:
        def values(i: int, at: np.ndarray) -> np.ndarray:
            t0, length = frame.span(i, base.s)
            t = float(t0) + float(length) * at
            found = default(i, at).copy()
            for k, label in enumerate(groups[kind]):
                if label.name in signals:
                    found[k] = input_values((signals[label.name],), t)[0]
            return found

        return values

    return replace(base, **{kind: pick(kind, getattr(base, kind)) for kind in groups})
