"""What holds at the ends of phases: bounds of the states there, and rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..base.rotation import matrix_xyz, quat_matrix
from ..dae.members import Label, pick
from .stage import Frame, quaternions
from .terms import Rows, error_vector

_ROOM = 1e-9  # of a start value beside its bounds


@dataclass(frozen=True, eq=False)
class End:
    """Conditions at one end of a phase.

    Fields:
        box: bounds of the states (2, n_x).
        labels, low, high: of the rows; `rows` (t, x, z, v, s) -> [rows; alg] gives them, and
            `feels_z` tells whether they need z.
    """

    box: np.ndarray
    labels: tuple[Label, ...]
    low: np.ndarray
    high: np.ndarray
    rows: ca.Function
    feels_z: bool


class _Extra:
    """Rows over x and s, gathered."""

    def __init__(self) -> None:
        self.labels: list[Label] = []
        self.exprs: list[ca.SX] = []
        self.values: list[float] = []

    def add(self, label: Label, expr: ca.SX, value: float = 0.0) -> None:
        self.labels.append(label)
        self.exprs.append(expr)
        self.values.append(value)


def at_start(frame: Frame, i: int) -> End:
    """What holds at the start of a phase."""
    box, rows, extra = start_box(frame, i), _open_rows(frame, i), _Extra()
    x, s = ca.SX.sym("x", frame.model.n_x), ca.SX.sym("s", frame.n_s)
    if i == 0:
        _add_by_params(frame, extra, x, s)
        for turn in quaternions(frame.model):
            if not all(box[0, r] == box[1, r] for r in turn):
                q = x[list(turn)]
                name = frame.model.x_labels[turn[0]].name.rpartition(".")[0]
                extra.add(Label("", f"norm of {name}'s quaternion", "", ""), ca.dot(q, q), 1.0)
        if frame.problem.periodic:
            for label, k in zip(frame.model.x_labels, range(frame.model.n_x), strict=True):
                extra.add(label, x[k] - frame.start_copy(s)[k])
    return _end(frame, box, rows, extra, x, s)


def at_end(frame: Frame, i: int) -> End:
    """What holds at the end of a phase."""
    box, rows = frame.terms[i].end.limits(frame.model.x_labels), frame.terms[i].end.rows
    x, s, extra = ca.SX.sym("x", frame.model.n_x), ca.SX.sym("s", frame.n_s), _Extra()
    if frame.problem.periodic and i == frame.n_phases - 1:
        before, labels = frame.start_copy(s), frame.model.x_labels
        for k in frame.cyclic:
            extra.add(
                Label("", f"return of {labels[k].name}", "", labels[k].unit), x[k] - before[k]
            )
        for turn in frame.cyclic_turns:
            rows_ = list(turn)
            name = labels[turn[0]].name.rpartition(".")[0]
            for axis, expr in zip(
                "xyz", ca.vertsplit(error_vector(before[rows_], x[rows_])), strict=True
            ):
                extra.add(Label("", f"return of {name}'s rotation_{axis}", "", "rad"), expr)
    return _end(frame, box, rows, extra, x, s)


def opened(frame: Frame, end: End) -> End:
    """The same end, with bounds of states as rows."""
    boxed = [k for k in range(frame.model.n_x) if np.isfinite(end.box[:, k]).any()]
    symbols = [
        ca.SX.sym(k, size)
        for k, size in (
            ("t", 1),
            ("x", frame.model.n_x),
            ("z", frame.model.n_z),
            ("v", frame.n_v),
            ("s", frame.n_s),
        )
    ]
    rows, alg = end.rows(*symbols)
    box = end.box.copy()
    box[0, boxed], box[1, boxed] = -np.inf, np.inf
    return End(
        box,
        (*end.labels, *(frame.model.x_labels[k] for k in boxed)),
        np.concatenate([end.low, end.box[0, boxed]]),
        np.concatenate([end.high, end.box[1, boxed]]),
        ca.Function("rows", symbols, [ca.vertcat(rows, pick(symbols[1], boxed)), alg]),
        end.feels_z,
    )


def _end(frame: Frame, box: np.ndarray, rows: Rows, extra: _Extra, x: ca.SX, s: ca.SX) -> End:
    own = frame.node(rows.expr)
    t, z, v = ca.SX.sym("t"), ca.SX.sym("z", frame.model.n_z), ca.SX.sym("v", frame.n_v)
    value, alg = own(t, x, z, v, s)
    both = ca.vertcat(ca.SX(0, 1), value, *extra.exprs)
    values = np.array(extra.values, float)
    return End(
        box,
        (*rows.labels, *extra.labels),
        np.concatenate([rows.low, values]),
        np.concatenate([rows.high, values]),
        ca.Function("rows", [t, x, z, v, s], [both, alg]),
        frame.feels(rows.expr)[0],
    )


def _open_rows(frame: Frame, i: int) -> Rows:
    """Rows at the start, but for orientations that are given to the states themselves."""
    rows = frame.terms[i].start.rows
    given = {f"{body}.rotation error" for body in _given_turns(frame, i)}
    keep = [k for k, v in enumerate(rows.labels) if v.name.rpartition("_")[0] not in given]
    return Rows(
        tuple(rows.labels[k] for k in keep),
        pick(rows.expr, keep),
        rows.low[keep],
        rows.high[keep],
        rows.targets,
    )


def _given_turns(frame: Frame, i: int) -> dict[str, dict[str, float]]:
    """By body, the values of the rotation coordinates that a start orientation fixes."""
    names, found = {label.name for label in frame.model.x_labels}, {}
    for body, target in frame.terms[i].start.rows.targets.items():
        if f"{body}.q_w" in names:
            parts = {f"{body}.q_{axis}": q for axis, q in zip("wxyz", target, strict=True)}
        else:
            angles = np.array(matrix_xyz(quat_matrix(ca.DM(target)))).reshape(-1)
            parts = {f"{body}.a_{axis}": a for axis, a in zip("xyz", angles, strict=True)}
        if set(parts) <= names:
            found[body] = {name: float(value) for name, value in parts.items()}
    return found


def start_box(frame: Frame, i: int) -> np.ndarray:
    """Bounds (2, n_x) of the states at the start of a phase.

    In the first phase states that no condition names stand at the model's values, unless a row
    there depends on them.

    Raises:
        ValueError: such a value is outside the bounds along the path.
    """
    labels, conditions = frame.model.x_labels, frame.terms[i].start
    box = conditions.limits(labels)
    turned = {k: v for part in _given_turns(frame, i).values() for k, v in part.items()}
    for k, label in enumerate(labels):
        if label.name in turned:
            box[:, k] = turned[label.name]
    if i or not frame.problem.starts_fixed:
        return box
    rows = _open_rows(frame, i).expr
    values = start_values(frame)
    named = set(frame.problem.stretches[0].start) | set(turned) | set(_by_params(frame))
    for k, label in enumerate(labels):
        if label.name in named or ca.depends_on(rows, frame.model.dae.x[k]):
            continue
        if not box[0, k] - _ROOM <= values[k] <= box[1, k] + _ROOM:
            raise ValueError(
                f"problem, start: the model begins at '{label.name}' = {values[k]:.6g} "
                f"{label.unit}, outside the path bounds {box[0, k]:.6g} ... {box[1, k]:.6g}; give "
                "another start, or wider bounds"
            )
        box[:, k] = values[k]
    return box


def start_values(frame: Frame) -> np.ndarray:
    """The states at the model's start, Params at their guesses."""
    s = np.array([label.start for label in frame.s_labels], float)
    p = np.array([float(v) for v in frame.parameters(s)])[: frame.model.n_p]
    return frame.model.dae.start_values(p)[0]


def _by_params(frame: Frame) -> dict[str, int]:
    """Rows of the states whose start follows from Params that are to be found."""
    dae = frame.model.dae
    free = {label.name for label in frame.s_labels}
    p = [dae.p[i] for i, label in enumerate(dae.p_labels) if label.name in free]
    if not p or not frame.problem.starts_fixed:
        return {}
    named = set(frame.problem.stretches[0].start)
    return {
        label.name: i
        for i, label in enumerate(dae.x_labels)
        if label.name not in named and ca.depends_on(dae.x_start[i], ca.vertcat(*p))
    }


def _add_by_params(frame: Frame, extra: _Extra, x: ca.SX, s: ca.SX) -> None:
    rows = _by_params(frame)
    if not rows:
        return
    dae = frame.model.dae
    parameters: list[Any] = frame.parameters(s)
    start = ca.Function("start", [dae.p], [dae.x_start])(
        ca.vertcat(ca.SX(0, 1), *parameters[: frame.model.n_p])
    )
    for name, k in rows.items():
        extra.add(Label("", f"start of {name}", "", dae.x_labels[k].unit), x[k] - start[k])
