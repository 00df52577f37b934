"""Where a search starts: from the conditions, a simulation, values by name, or a solution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ..integrators.driver import input_values
from ..model.signals import signal_of
from ..model.trajectory import Trajectory
from .chain import Chain, Guess
from .conditions import oriented, start_box, start_values
from .plan import Plan, Solution, pieces
from .problem import Free
from .traced import TracedProblem

_NEWTON = 30  # steps towards states that meet the conditions at an end
_DAMPING = 1e-8  # of these steps
_TURN = 0.5  # rad, of an angle in one of them
_STUCK, _NUDGE = 1e-6, 0.1  # a step that leads nowhere, and one that leads away


def first_guess(
    traced: TracedProblem, given: Any, mesh: tuple[np.ndarray, ...], degree: int
) -> tuple[Guess, dict[str, np.ndarray]]:
    """Return a guess, and variables and multipliers where an earlier solution has the same mesh.

    Arguments:
        given: None, a `Trajectory` over all phases, an earlier `Solution`, or values by name: a
            number, samples (times, values), or a function of t.
        degree: of the Inputs.

    Raises:
        ValueError: unknown names, samples of wrong size, a solution of another model.
        TypeError: anything else.
    """
    if isinstance(given, Solution):
        return _warm(traced, given, mesh, degree)
    base = from_conditions(traced)
    if given is None:
        return base, {}
    if isinstance(given, Trajectory):
        return _from_trajectory(traced, base, given), {}
    if isinstance(given, Mapping):
        return _from_values(traced, base, given), {}
    raise TypeError(
        f"guess: {type(given).__name__}; give a Trajectory, a Solution, or a mapping of values by "
        "name"
    )


def from_conditions(traced: TracedProblem) -> Guess:
    """Lead the states straight from the start to the end of each phase, rotations the short way.

    Inputs are at their guess, else the model's value within the bounds; algebraic unknowns balance
    at the start.
    """
    s = traced.s_start.copy()
    ends = [_start_states(traced)]
    for i in range(traced.n_phases):
        ends.append(_end_states(traced, i, ends[-1], s))
    if traced.problem.periodic:
        traced.start_copy(s)[:] = ends[0]

    def x(i: int, at: np.ndarray) -> np.ndarray:
        before, after = ends[i], ends[i + 1]
        # A straight line between two quaternions would leave the unit sphere.
        found = before[:, None] + (after - before)[:, None] * at
        for turn in traced.turns:
            rows = list(turn.rows)
            found[rows] = _arc(before[rows], after[rows], at)
        return found

    def v(i: int, at: np.ndarray) -> np.ndarray:
        t0, length = traced.span(i, s)
        rows = [_input(traced, k, float(t0) + float(length) * at) for k in traced.controls]
        return np.array(rows).reshape(traced.n_v, len(at))

    z0 = _balanced(traced, ends[0], v(0, np.zeros(1)), s)
    return Guess(s, x, lambda i, at: np.repeat(z0[:, None], len(at), axis=1), v)


def _input(traced: TracedProblem, k: int, t: np.ndarray) -> np.ndarray:
    label = traced.model.dae.u_labels[k]
    free: Free = traced.problem.inputs[label.name]
    if callable(free.guess):
        return np.clip([float(free.guess(float(time))) for time in t], free.low, free.high)
    return np.full(len(t), free.start(label.start))


def _start_states(traced: TracedProblem) -> np.ndarray:
    box = start_box(traced, 0)
    return np.clip(start_values(traced), box[0], box[1])


def _end_states(traced: TracedProblem, i: int, before: np.ndarray, s: np.ndarray) -> np.ndarray:
    """States near those at the start of a phase that meet the conditions at its end, if found."""
    end = traced.terms[i].end
    box = end.limits("x", range(traced.model.n_x))
    x = np.clip(before, box[0], box[1])
    for target in end.rows.targets:
        for row, value in oriented(traced, target).items():
            x[row] = value
    return np.clip(_towards(traced, i, x, s), box[0], box[1])


def _towards(traced: TracedProblem, i: int, x: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Move states by Newton's method, in least squares, until they meet the rows of an end.

    They are returned as given if a value or derivative is not finite.
    """
    rows = traced.terms[i].end.rows
    if not rows.labels:
        return x
    symbols = traced.arguments(ca.SX)
    value = traced.node(rows.expr)(*symbols)[0]
    both = ca.Function("towards", symbols, [value, ca.jacobian(value, symbols[1])])
    t0, length = traced.span(i, s)
    fixed = (float(t0) + float(length), np.zeros(traced.model.n_z), np.zeros(traced.n_v), s)
    turns = np.array([label.unit == "rad" for label in traced.model.x_labels])
    found, widest = x.copy(), np.where(turns, _TURN, np.inf)
    for _ in range(_NEWTON):
        r, J = (np.array(ca.DM(part)) for part in both(fixed[0], found, *fixed[1:]))
        gap = np.clip(r[:, 0], rows.low, rows.high) - r[:, 0]
        if not (np.isfinite(gap).all() and np.isfinite(J).all()):
            return x
        if np.abs(gap).max() < 1e-12:
            break
        step = J.T @ np.linalg.lstsq(J @ J.T + _DAMPING * np.eye(len(gap)), gap, rcond=None)[0]
        if np.abs(step).max() < _STUCK:
            # Half a turn from its target an orientation has no derivative. Any step that is not
            # along one of the axes leads away from there.
            step = _NUDGE * np.cos(np.arange(len(found)))
        found = found + np.clip(step, -widest, widest)
    return found if np.isfinite(found).all() else x


def _arc(before: np.ndarray, after: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Unit quaternions (4, n) on the shorter arc from one to another, at fractions (n,) of it."""
    a, b = (q / max(float(np.linalg.norm(q)), 1e-300) for q in (before, after))
    b = b if a @ b >= 0 else -b
    angle = float(np.arccos(np.clip(a @ b, -1.0, 1.0)))
    if angle < 1e-9:
        return np.repeat(a[:, None], len(at), axis=1)
    return (np.outer(a, np.sin((1 - at) * angle)) + np.outer(b, np.sin(at * angle))) / np.sin(angle)


def _balanced(traced: TracedProblem, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> np.ndarray:
    model = traced.model
    p = np.array([float(value) for value in traced.parameters(s)])[: model.n_p]
    z = model.dae.start_values(p)[1]
    if not model.n_z:
        return z
    u = np.array([float(value) for value in traced.inputs(0.0, v[:, 0])])
    found, good = model.plain.consistent(0.0, x, z, u, p)
    return found if good else z


def _from_trajectory(traced: TracedProblem, base: Guess, given: Trajectory) -> Guess:
    """Stretch a trajectory over the phases, whose lengths are as guessed."""
    dae = traced.model.dae
    known = [v.name for v in dae.x_labels]
    missing = [name for name in known if name not in given]
    if missing:
        raise ValueError(
            f"guess: trajectory '{given.name}' has no '{missing[0]}'; it is of another model"
        )
    lengths = np.array([float(v) for v in traced.durations(base.s)])
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

    s = _scaled_horizons(traced, base.s, span)
    x = pick(dae.x_labels, base.x)
    if traced.problem.periodic:
        traced.start_copy(s)[:] = x(0, np.zeros(1))[:, 0]
    return Guess(s, x, pick(dae.z_labels, base.z), pick(traced.v_labels, base.v))


def _scaled_horizons(traced: TracedProblem, s: np.ndarray, span: float) -> np.ndarray:
    """Constants with one free horizon as long as the trajectory, if there is just one phase."""
    found = s.copy()
    horizon = traced.problem.sequence[0].horizon
    if traced.n_phases == 1 and isinstance(horizon, Free) and horizon.guess is None:
        found[0] = np.clip(span, horizon.low, horizon.high)
    return found


def _from_values(traced: TracedProblem, base: Guess, given: Mapping[str, Any]) -> Guess:
    dae = traced.model.dae
    groups = {"x": dae.x_labels, "z": dae.z_labels, "v": traced.v_labels}
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
            t0, length = traced.span(i, base.s)
            t = float(t0) + float(length) * at
            found = default(i, at).copy()
            for k, label in enumerate(groups[kind]):
                if label.name in signals:
                    found[k] = input_values((signals[label.name],), t)[0]
            return found

        return values

    return replace(base, **{kind: pick(kind, getattr(base, kind)) for kind in groups})


def from_solution(traced: TracedProblem, plan: Plan, chain: Chain) -> Guess:
    """Make a guess that is the plan, interpolated between its saved points."""
    own = list(pieces(plan).values())

    def along(i: int) -> np.ndarray:
        k, mesh = chain.intervals[i].saved, chain.mesh[i]
        inner = (mesh[:-1, None] + np.diff(mesh)[:, None] * k).reshape(-1)
        return np.append(inner, 1.0)

    grids = [along(i) for i in range(traced.n_phases)]

    def x(i: int, at: np.ndarray) -> np.ndarray:
        phase = plan.phases[i]
        return _interpolated(grids[i], np.hstack([phase.saved_x, phase.x[:, -1:]]), at)

    def z(i: int, at: np.ndarray) -> np.ndarray:
        saved = plan.phases[i].saved_z
        return _interpolated(grids[i], np.hstack([saved, saved[:, -1:]]), at)

    def v(i: int, at: np.ndarray) -> np.ndarray:
        before = sum(len(phase.nodes) for phase in plan.phases[:i])
        mesh = chain.mesh[i]
        k = np.clip(np.searchsorted(mesh, at, side="right") - 1, 0, len(mesh) - 2)
        tau = (at - mesh[k]) / (mesh[k + 1] - mesh[k])
        places = [(before + int(a), [float(b)]) for a, b in zip(k, tau, strict=True)]
        values = [[float(piece.at(*place)[0]) for place in places] for piece in own]
        return np.array(values).reshape(len(own), len(at))

    return Guess(plan.s, x, z, v)


def _interpolated(grid: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    return np.array([np.interp(at, grid, row) for row in values]).reshape(len(values), len(at))


def _warm(
    traced: TracedProblem, earlier: Solution, mesh: tuple[np.ndarray, ...], degree: int
) -> tuple[Guess, dict[str, np.ndarray]]:
    raw = earlier.raw
    ours, before = (
        ([v.name for v in own.model.x_labels], own.n_phases, own.n_s, own.controls)
        for own in (traced, raw.plan.traced)
    )
    if ours != before:
        raise ValueError(
            f"guess: the solution of '{earlier.trajectory.name}' has other states, Inputs, free "
            "constants or phases than this problem; give its trajectory instead"
        )
    guess = from_solution(traced, raw.plan, raw.chain)
    same = raw.degree == degree and all(
        a.shape == b.shape and np.allclose(a, b, rtol=0, atol=1e-12)
        for a, b in zip(raw.chain.mesh, mesh, strict=True)
    )
    if not same:
        return guess, {}
    answer = raw.answer
    return guess, {"x0": answer.x, "lam_x0": answer.lam_x, "lam_g0": answer.lam_g}
