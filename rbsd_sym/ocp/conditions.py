"""What holds along a phase and at its ends: bounds of variables, and rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ..base.rotation import matrix_xyz, quat_matrix
from ..dae.members import Label, RotationKind, pick
from .nlp import Kind, Row
from .stage import Role, Stage, state_rows
from .terms import Rows, Target, error_vector

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


def groups(stage: Stage) -> dict[str, tuple[tuple[Label, ...], tuple[int, ...]]]:
    """Labels and indices in the model of the states, unknowns, and Inputs to be found."""
    dae = stage.model.dae
    return {
        "x": (dae.x_labels, tuple(range(stage.model.n_x))),
        "z": (dae.z_labels, tuple(range(stage.model.n_z))),
        "u": (stage.v_labels, stage.controls),
    }


def path_box(stage: Stage, i: int, group: str) -> np.ndarray:
    """Bounds (2, n) of variables along a phase; of Inputs also those of the problem.

    Raises:
        ValueError: they contradict each other.
    """
    labels, indices = groups(stage)[group]
    box = stage.terms[i].path.limits(group, indices)
    for k, label in enumerate(labels if group == "u" else ()):
        own = stage.problem.inputs[label.name]
        pair = max(box[0, k], own.low), min(box[1, k], own.high)
        if pair[0] > pair[1]:
            raise ValueError(
                f"phase {i}, path '{label.name}': bounds {box[0, k]:.6g} ... {box[1, k]:.6g} "
                f"{label.unit} and those of the Input {own.low:.6g} ... {own.high:.6g} "
                "contradict each other"
            )
        box[:, k] = pair
    return box


def limits(stage: Stage, i: int, input_degree: int) -> Limits:
    """Gather what is limited along phase i."""
    dae, rows = stage.model.dae, stage.terms[i].path.rows
    labels, exprs, low, high = [*rows.labels], [rows.expr], [rows.low], [rows.high]
    # An Input of degree 0 or 1 is within its bounds if its nodes are, which are variables.
    for group in "xzu" if input_degree > 1 else "xz":
        own, indices = groups(stage)[group]
        box = path_box(stage, i, group)
        for k in np.flatnonzero(np.isfinite(box).any(axis=0)):
            labels.append(own[k])
            exprs.append(getattr(dae, group)[indices[k]])
            low.append(box[:1, k])
            high.append(box[1:, k])
    value = stage.over("limits", ca.vertcat(*exprs))
    return Limits(tuple(labels), np.concatenate(low), np.concatenate(high), value)


def at_start(stage: Stage, i: int) -> End:
    """Gather what holds at the start of a phase."""
    box, rows = start_box(stage, i), _open_rows(stage, i)
    _, x, _, _, s = symbols = stage.arguments(ca.SX)
    extra: list[_Equation] = []
    if i == 0:
        extra += _by_params(stage, x, s)
        for turn in stage.turns:
            # The equations of motion keep the norm that a quaternion starts with, so one row at
            # the start is enough, and more would be redundant.
            if any(box[0, r] < box[1, r] for r in turn.rows):
                q = x[list(turn.rows)]
                label = Label("", f"{turn.rotation.owner}'s quaternion")
                extra.append((Row(label, Kind.norm, i), ca.dot(q, q), 1.0))
        if stage.problem.periodic:
            gap = x - stage.start_copy(s)
            extra += [
                (Row(label, Kind.copy, i), gap[k], 0.0)
                for k, label in enumerate(stage.model.x_labels)
            ]
    return _end(stage, i, box, rows, extra, symbols)


def at_end(stage: Stage, i: int) -> End:
    """Gather what holds at the end of a phase."""
    end, labels = stage.terms[i].end, stage.model.x_labels
    _, x, _, _, s = symbols = stage.arguments(ca.SX)
    extra: list[_Equation] = []
    if stage.problem.periodic and i == stage.n_phases - 1:
        before = stage.start_copy(s)
        extra += [(Row(labels[k], Kind.cycle, i), x[k] - before[k], 0.0) for k in stage.cyclic]
        for turn in stage.cyclic_turns:
            rows, owner = list(turn.rows), turn.rotation.owner
            error = ca.vertsplit(error_vector(before[rows], x[rows]))
            for axis, expr in zip("xyz", error, strict=True):
                label = Label("", f"{owner}'s rotation", axis, "rad")
                extra.append((Row(label, Kind.cycle, i), expr, 0.0))
    box = end.limits("x", range(stage.model.n_x))
    return _end(stage, i, box, end.rows, extra, symbols)


def opened(stage: Stage, i: int, end: End) -> End:
    """Return the same end with bounds of states as rows."""
    boxed = [k for k in range(stage.model.n_x) if np.isfinite(end.box[:, k]).any()]
    symbols = stage.arguments(ca.SX)
    rows, alg = end.value(*symbols)
    box = end.box.copy()
    box[0, boxed], box[1, boxed] = -np.inf, np.inf
    return replace(
        end,
        box=box,
        rows=(*end.rows, *(Row(stage.model.x_labels[k], Kind.end, i) for k in boxed)),
        low=np.concatenate([end.low, end.box[0, boxed]]),
        high=np.concatenate([end.high, end.box[1, boxed]]),
        value=ca.Function("rows", symbols, [ca.vertcat(rows, pick(symbols[1], boxed)), alg]),
    )


def _end(
    stage: Stage, i: int, box: np.ndarray, rows: Rows, extra: list[_Equation], symbols: list[ca.SX]
) -> End:
    value, alg = stage.node(rows.expr)(*symbols)
    both = ca.vertcat(ca.SX(0, 1), value, *(expr for _, expr, _ in extra))
    values = np.array([number for _, _, number in extra], float)
    return End(
        box,
        (*(Row(label, Kind.end, i) for label in rows.labels), *(row for row, _, _ in extra)),
        np.concatenate([rows.low, values]),
        np.concatenate([rows.high, values]),
        ca.Function("rows", symbols, [both, alg]),
        stage.depends(rows.expr)[0],
    )


def oriented(stage: Stage, target: Target) -> dict[int, float]:
    """Values of the states that are the coordinates of an orientation, by row.

    Empty if one of the coordinates is not a state, as for a body with an angle about one axis.
    """
    rows = state_rows(stage.model, target.rotation.coordinates)
    if rows is None:
        return {}
    values = target.quaternion
    if target.rotation.kind is RotationKind.tait_bryan:
        values = np.array(matrix_xyz(quat_matrix(ca.DM(values)))).reshape(-1)
    return {row: float(value) for row, value in zip(rows, values, strict=True)}


def _given_states(stage: Stage, i: int) -> dict[int, float]:
    """Values of the states that the orientations at the start of a phase fix, by row."""
    targets = stage.terms[i].start.rows.targets
    return {row: v for target in targets for row, v in oriented(stage, target).items()}


def _open_rows(stage: Stage, i: int) -> Rows:
    """Rows at the start, but for orientations that are given to the states themselves."""
    rows = stage.terms[i].start.rows
    given = {k for target in rows.targets if oriented(stage, target) for k in target.rows}
    keep = [k for k in range(len(rows.labels)) if k not in given]
    labels = tuple(rows.labels[k] for k in keep)
    return Rows(labels, pick(rows.expr, keep), rows.low[keep], rows.high[keep], rows.targets)


def start_box(stage: Stage, i: int) -> np.ndarray:
    """Bounds (2, n_x) of the states at the start of a phase.

    In the first phase states that no condition names are fixed at the model's values, unless a row
    there depends on them.

    Raises:
        ValueError: such a value is outside the bounds along the path.
    """
    start, model = stage.terms[i].start, stage.model
    box, given = start.limits("x", range(model.n_x)), _given_states(stage, i)
    for k, value in given.items():
        box[:, k] = value
    if i or not stage.problem.starts_fixed:
        return box
    rows, values = _open_rows(stage, i).expr, start_values(stage)
    free = {*given, *_moved_by_params(stage), *(k for group, k in start.named if group == "x")}
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


def start_values(stage: Stage) -> np.ndarray:
    """The states at the model's start, Params at their guesses."""
    p = [float(v) for v in stage.parameters(stage.s_start)[: stage.model.n_p]]
    return stage.model.dae.start_values(np.array(p))[0]


def _moved_by_params(stage: Stage) -> list[int]:
    """Rows of the states whose start follows from Params that are to be found."""
    dae, named = stage.model.dae, stage.terms[0].start.named
    found = [c.index for c in stage.constants if c.role is Role.parameter]
    p = [dae.p[k] for k in found if k < stage.model.n_p]
    if not p or not stage.problem.starts_fixed:
        return []
    return [
        k
        for k in range(stage.model.n_x)
        if ("x", k) not in named and ca.depends_on(dae.x_start[k], ca.vertcat(*p))
    ]


def _by_params(stage: Stage, x: ca.SX, s: ca.SX) -> list[_Equation]:
    """Equations for the states whose start follows from Params that are to be found."""
    dae, rows = stage.model.dae, _moved_by_params(stage)
    if not rows:
        return []
    parameters = ca.vertcat(ca.SX(0, 1), *stage.parameters(s)[: stage.model.n_p])
    start = ca.Function("start", [dae.p], [dae.x_start])(parameters)
    return [(Row(dae.x_labels[k], Kind.start, 0), x[k] - start[k], 0.0) for k in rows]
