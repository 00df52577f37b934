"""What holds along a phase and at its ends: bounds of variables, and rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ..base.rotation import matrix_xyz, quat_matrix
from ..dae.members import Label, RotationKind, pick
from .nlp import Row, RowKind
from .terms import Rows, Target, error_vector
from .traced import Role, TracedProblem, state_rows

_ROOM = 1e-9  # of a start value beside its bounds


@dataclass(frozen=True, eq=False)
class End:
    """Conditions at one end of a phase.

    Fields:
        box: bounds of the states (2, n_x).
        rows, low, high: what the rows are, and their bounds.
        value: (t, x, z, v, s) -> [rows; alg]; `needs_z` says whether the rows depend on z.
    """

    box: np.ndarray
    rows: tuple[Row, ...]
    low: np.ndarray
    high: np.ndarray
    value: ca.Function
    needs_z: bool


@dataclass(frozen=True, eq=False)
class Limits:
    """All conditions along a phase: rows, then states, unknowns and Inputs that have bounds.

    Fields:
        low, high: (n,).
        value: (t, x, z, v, s) -> (n, 1).
    """

    labels: tuple[Label, ...]
    low: np.ndarray
    high: np.ndarray
    value: ca.Function


_Equation = tuple[Row, ca.SX, float]  # expression over x and s, equal to a number


def groups(traced: TracedProblem) -> dict[str, tuple[tuple[Label, ...], tuple[int, ...]]]:
    """Labels and indices in the model of the states, unknowns, and Inputs to be found."""
    dae = traced.model.dae
    return {
        "x": (dae.x_labels, tuple(range(traced.model.n_x))),
        "z": (dae.z_labels, tuple(range(traced.model.n_z))),
        "u": (traced.v_labels, traced.controls),
    }


def path_box(traced: TracedProblem, i: int, group: str) -> np.ndarray:
    """Bounds (2, n) of variables along a phase; of Inputs also those of the problem.

    Raises:
        ValueError: they contradict each other.
    """
    labels, indices = groups(traced)[group]
    box = traced.terms[i].path.limits(group, indices)
    for k, label in enumerate(labels if group == "u" else ()):
        own = traced.problem.inputs[label.name]
        pair = max(box[0, k], own.low), min(box[1, k], own.high)
        if pair[0] > pair[1]:
            raise ValueError(
                f"phase {i}, path '{label.name}': bounds {box[0, k]:.6g} ... {box[1, k]:.6g} "
                f"{label.unit} and those of the Input {own.low:.6g} ... {own.high:.6g} "
                "contradict each other"
            )
        box[:, k] = pair
    return box


def limits(traced: TracedProblem, i: int, input_degree: int) -> Limits:
    """Gather what is limited along phase i."""
    dae, rows = traced.model.dae, traced.terms[i].path.rows
    labels, exprs, low, high = [*rows.labels], [rows.expr], [rows.low], [rows.high]
    # An Input of degree 0 or 1 is within its bounds if its nodes are, which are variables.
    for group in "xzu" if input_degree > 1 else "xz":
        own, indices = groups(traced)[group]
        box = path_box(traced, i, group)
        for k in np.flatnonzero(np.isfinite(box).any(axis=0)):
            labels.append(own[k])
            exprs.append(getattr(dae, group)[indices[k]])
            low.append(box[:1, k])
            high.append(box[1:, k])
    value = traced.over("limits", ca.vertcat(*exprs))
    return Limits(tuple(labels), np.concatenate(low), np.concatenate(high), value)


def at_start(traced: TracedProblem, i: int) -> End:
    """Gather what holds at the start of a phase."""
    box, rows = start_box(traced, i), _open_rows(traced, i)
    _, x, _, _, s = symbols = traced.arguments(ca.SX)
    extra: list[_Equation] = []
    if i == 0:
        extra += _by_params(traced, x, s)
        for turn in traced.turns:
            # The equations of motion keep the norm that a quaternion starts with, so one row at
            # the start is enough, and more would be redundant.
            if any(box[0, r] < box[1, r] for r in turn.rows):
                q = x[list(turn.rows)]
                label = Label("", f"{turn.rotation.owner}'s quaternion")
                extra.append((Row(label, RowKind.norm, i), ca.dot(q, q), 1.0))
        if traced.problem.periodic:
            gap = x - traced.start_copy(s)
            extra += [
                (Row(label, RowKind.copy, i), gap[k], 0.0)
                for k, label in enumerate(traced.model.x_labels)
            ]
    return _end(traced, i, box, rows, extra, symbols)


def at_end(traced: TracedProblem, i: int) -> End:
    """Gather what holds at the end of a phase."""
    end, labels = traced.terms[i].end, traced.model.x_labels
    _, x, _, _, s = symbols = traced.arguments(ca.SX)
    extra: list[_Equation] = []
    if traced.problem.periodic and i == traced.n_phases - 1:
        before = traced.start_copy(s)
        extra += [(Row(labels[k], RowKind.cycle, i), x[k] - before[k], 0.0) for k in traced.cyclic]
        for turn in traced.cyclic_turns:
            rows, owner = list(turn.rows), turn.rotation.owner
            error = ca.vertsplit(error_vector(before[rows], x[rows]))
            for axis, expr in zip("xyz", error, strict=True):
                label = Label("", f"{owner}'s rotation", axis, "rad")
                extra.append((Row(label, RowKind.cycle, i), expr, 0.0))
    box = end.limits("x", range(traced.model.n_x))
    return _end(traced, i, box, end.rows, extra, symbols)


def opened(traced: TracedProblem, i: int, end: End) -> End:
    """Return the same end with bounds of states as rows."""
    boxed = [k for k in range(traced.model.n_x) if np.isfinite(end.box[:, k]).any()]
    symbols = traced.arguments(ca.SX)
    rows, alg = end.value(*symbols)
    box = end.box.copy()
    box[0, boxed], box[1, boxed] = -np.inf, np.inf
    return replace(
        end,
        box=box,
        rows=(*end.rows, *(Row(traced.model.x_labels[k], RowKind.end, i) for k in boxed)),
        low=np.concatenate([end.low, end.box[0, boxed]]),
        high=np.concatenate([end.high, end.box[1, boxed]]),
        value=ca.Function("rows", symbols, [ca.vertcat(rows, pick(symbols[1], boxed)), alg]),
    )


def _end(
    traced: TracedProblem,
    i: int,
    box: np.ndarray,
    rows: Rows,
    extra: list[_Equation],
    symbols: list[ca.SX],
) -> End:
    value, alg = traced.node(rows.expr)(*symbols)
    both = ca.vertcat(ca.SX(0, 1), value, *(expr for _, expr, _ in extra))
    values = np.array([number for _, _, number in extra], float)
    return End(
        box,
        (*(Row(label, RowKind.end, i) for label in rows.labels), *(row for row, _, _ in extra)),
        np.concatenate([rows.low, values]),
        np.concatenate([rows.high, values]),
        ca.Function("rows", symbols, [both, alg]),
        traced.depends(rows.expr)[0],
    )


def oriented(traced: TracedProblem, target: Target) -> dict[int, float]:
    """Values of the states that are the coordinates of an orientation, by row.

    Empty if one of the coordinates is not a state, as for a body with an angle about one axis.
    """
    rows = state_rows(traced.model, target.rotation.coordinates)
    if rows is None:
        return {}
    values = target.quaternion
    if target.rotation.kind is RotationKind.tait_bryan:
        values = np.array(matrix_xyz(quat_matrix(ca.DM(values)))).reshape(-1)
    return {row: float(value) for row, value in zip(rows, values, strict=True)}


def _given_states(traced: TracedProblem, i: int) -> dict[int, float]:
    """Values of the states that the orientations at the start of a phase fix, by row."""
    targets = traced.terms[i].start.rows.targets
    return {row: v for target in targets for row, v in oriented(traced, target).items()}


def _open_rows(traced: TracedProblem, i: int) -> Rows:
    """Rows at the start, but for orientations that are given to the states themselves."""
    rows = traced.terms[i].start.rows
    given = {k for target in rows.targets if oriented(traced, target) for k in target.rows}
    keep = [k for k in range(len(rows.labels)) if k not in given]
    labels = tuple(rows.labels[k] for k in keep)
    return Rows(labels, pick(rows.expr, keep), rows.low[keep], rows.high[keep], rows.targets)


def start_box(traced: TracedProblem, i: int) -> np.ndarray:
    """Bounds (2, n_x) of the states at the start of a phase.

    In the first phase states that no condition names are fixed at the model's values, unless a row
    there depends on them.

    Raises:
        ValueError: such a value is outside the bounds along the path.
    """
    start, model = traced.terms[i].start, traced.model
    box, given = start.limits("x", range(model.n_x)), _given_states(traced, i)
    for k, value in given.items():
        box[:, k] = value
    if i or not traced.problem.starts_fixed:
        return box
    rows, values = _open_rows(traced, i).expr, start_values(traced)
    free = {*given, *_moved_by_params(traced), *(k for group, k in start.named if group == "x")}
    for k, label in enumerate(model.x_labels):
        if k in free or ca.depends_on(rows, model.dae.x[k]):
            continue
        if not box[0, k] - _ROOM <= values[k] <= box[1, k] + _ROOM:
            raise ValueError(
                f"problem, start: the model begins at '{label.name}' = {values[k]:.6g} "
                f"{label.unit}, outside the path bounds {box[0, k]:.6g} ... {box[1, k]:.6g}; give "
                "another start, or wider bounds"
            )
        box[:, k] = values[k]
    return box


def start_values(traced: TracedProblem) -> np.ndarray:
    """The states at the model's start, Params at their guesses."""
    p = [float(v) for v in traced.parameters(traced.s_start)[: traced.model.n_p]]
    return traced.model.dae.start_values(np.array(p))[0]


def _moved_by_params(traced: TracedProblem) -> list[int]:
    """Rows of the states whose start follows from Params that are to be found."""
    dae, named = traced.model.dae, traced.terms[0].start.named
    found = [c.index for c in traced.constants if c.role is Role.parameter]
    p = [dae.p[k] for k in found if k < traced.model.n_p]
    if not p or not traced.problem.starts_fixed:
        return []
    return [
        k
        for k in range(traced.model.n_x)
        if ("x", k) not in named and ca.depends_on(dae.x_start[k], ca.vertcat(*p))
    ]


def _by_params(traced: TracedProblem, x: ca.SX, s: ca.SX) -> list[_Equation]:
    """Equations for the states whose start follows from Params that are to be found."""
    dae, rows = traced.model.dae, _moved_by_params(traced)
    if not rows:
        return []
    parameters = ca.vertcat(ca.SX(0, 1), *traced.parameters(s)[: traced.model.n_p])
    start = ca.Function("start", [dae.p], [dae.x_start])(parameters)
    return [(Row(dae.x_labels[k], RowKind.start, 0), x[k] - start[k], 0.0) for k in rows]
