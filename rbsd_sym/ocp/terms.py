"""Phases traced on the symbols of a model: costs, bounds of variables, rows of conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..base import checks
from ..base.rotation import matrix_quat, quat_conjugate, quat_product
from ..dae.members import Label, pick
from ..model.model import Model
from .names import Names, trace
from .problem import Bound, Free, Phase, Problem

_MET = 1e-9  # a condition on what never moves is met within rounding of its value
_AXES = ("w", "x", "y", "z")


@dataclass(frozen=True, eq=False)
class Rows:
    """Conditions low <= expr <= high, over [t, x, z, u, all parameters].

    Fields:
        labels: name and unit of each row.
        targets: unit quaternions that bodies are to reach, by body, for the guess.
    """

    labels: tuple[Label, ...]
    expr: ca.SX
    low: np.ndarray
    high: np.ndarray
    targets: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Conditions:
    """Bounds of variables by name, and rows."""

    box: Mapping[str, tuple[float, float]]
    rows: Rows

    def limits(self, labels: tuple[Label, ...]) -> np.ndarray:
        """Bounds (2, n) of variables, infinite where there are none."""
        pairs = [self.box.get(label.name, (-math.inf, math.inf)) for label in labels]
        return np.array(pairs, float).reshape(len(labels), 2).T


@dataclass(frozen=True, eq=False)
class Terms:
    """A phase traced: costs and conditions over [t, x, z, u, all parameters].

    `link` holds the states just after its start by the values just before, None if continuous.
    """

    integrand: ca.SX
    end_cost: ca.SX
    start: Conditions
    end: Conditions
    path: Conditions
    link: ca.SX | None


def traced(problem: Problem, model: Model, still: Mapping[str, float]) -> tuple[Terms, ...]:
    """The phases of a problem, traced on a model.

    Arguments:
        still: states that provably never move in this problem, and their values. A condition that
            they meet for ever is redundant, and is left away.

    Raises:
        LeftOut: the minimal model does not know what they need.
        ValueError, TypeError: unknown names, values of the wrong shape, contradictions.
    """
    names = Names(model)
    at_rest = _Still(model, still)
    found = []
    for i, phase in enumerate(problem.stretches):
        where = f"phase {i}" if len(problem.stretches) > 1 else "problem"
        terms = Terms(
            trace(names, phase.integral, f"{where}, integral"),
            trace(names, phase.end_cost, f"{where}, end_cost"),
            _conditions(at_rest, names, phase.start, f"{where}, start"),
            _conditions(at_rest, names, phase.end, f"{where}, end"),
            _conditions(at_rest, names, phase.path, f"{where}, path"),
            _link(model, names, phase, where),
        )
        _check_given(problem, terms.path, f"{where}, path")
        found.append(_within(terms, where))
    return tuple(found)


def _link(model: Model, names: Names, phase: Phase, where: str) -> ca.SX | None:
    if not phase.link:
        return None
    known = {label.name: i for i, label in enumerate(model.x_labels)}
    states = ca.vertsplit(model.dae.x)
    for name, expression in phase.link.items():
        if name not in known:
            names.column(name)  # tells what is left out, and what does not exist
            raise ValueError(f"{where}, link: '{name}' is no state; only states jump")
        states[known[name]] = trace(names, expression, f"{where}, link '{name}'")
    return ca.vertcat(*states)


class _Still:
    """States that never move, and conditions with them put in."""

    def __init__(self, model: Model, values: Mapping[str, float]) -> None:
        self.model, self.values = model, values
        rows = [i for i, label in enumerate(model.x_labels) if label.name in values]
        self._symbols = pick(model.dae.x, rows)
        self._numbers = ca.DM([values[model.x_labels[i].name] for i in rows])

    def put_in(self, expr: ca.SX) -> ca.SX:
        """The expression with these states at their values."""
        return ca.substitute(expr, self._symbols, self._numbers)


def _conditions(at_rest: _Still, names: Names, given: Mapping[str, Any], where: str) -> Conditions:
    model = at_rest.model
    states = {label.name for label in model.x_labels}
    boxed = set(states)
    if where.endswith("path"):
        boxed |= {label.name for label in (*model.dae.z_labels, *model.dae.u_labels)}
    box: dict[str, tuple[float, float]] = {}
    rows: list[tuple[Label, ca.SX, float, float]] = []
    targets: dict[str, np.ndarray] = {}
    for name, value in _turned(given).items():
        place = f"{where} '{name}'"
        if isinstance(value, Bound):
            expr = trace(names, value.expression, place)
            row = (Label("", name, "", value.unit), expr, value.low, value.high)
            rows += _moving(at_rest, name, [row])
            continue
        if name in at_rest.values:
            _check_still(at_rest, name, place, value, names.known_unit(name))
            continue
        column, shape = names.column(name)
        unit = names.unit(name)
        low, high = _limits(place, value, shape, unit)
        if name in boxed:
            box[name] = (float(low[0]), float(high[0]))
            continue
        target = _target(name, low, high, place)
        if target is not None:
            body = name.rsplit(".", 1)[0]
            targets[body] = target
            rows += _moving(at_rest, name, _error_rows(names, body, target))
            continue
        parts = [f"{name}_{part}" if part else name for part in names.components(name)]
        labels = [Label("", part, "", unit) for part in parts]
        rows += _moving(
            at_rest, name, list(zip(labels, ca.vertsplit(column), low, high, strict=True))
        )
    return Conditions(box, _stacked(rows, targets))


def _turned(given: Mapping[str, Any]) -> dict[str, Any]:
    """Conditions, with four values for the quaternion of a body as one orientation.

    Four equations for three degrees of freedom would be redundant.
    """
    found = dict(given)
    for name in given:
        body, dot, state = str(name).rpartition(".")
        parts = [f"{body}.q_{axis}" for axis in _AXES]
        if dot and state == "q_w" and all(_is_number(found.get(part)) for part in parts):
            found[f"{body}.quaternion"] = [found.pop(part) for part in parts]
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating))


def _limits(
    where: str, value: Any, shape: tuple[int, ...], unit: str
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of all components, row by row: a value, or a pair (low, high)."""
    pair = isinstance(value, (tuple, list)) and len(value) == 2
    if pair:
        low = -math.inf if value[0] is None else value[0]
        high = math.inf if value[1] is None else value[1]
    else:
        low = high = value
    count = math.prod(shape)
    found = []
    for side in (low, high):
        try:
            array = np.array(side, float)
        except (TypeError, ValueError) as error:
            raise TypeError(
                f"{where}: {value!r}; give a number, an array of shape {shape}, a pair (low, high) "
                "with None for no bound, or a Bound"
            ) from error
        if array.shape not in ((), shape) or (not pair and array.shape != shape):
            raise ValueError(
                f"{where}: shape {array.shape}; the quantity has shape {shape}; a pair (low, high) "
                "bounds every component"
            )
        found.append(np.broadcast_to(array, shape).reshape(count))
    for lower, upper in zip(*found, strict=True):
        if np.isnan(lower) or np.isnan(upper) or lower > upper or lower == np.inf == upper:
            raise ValueError(
                f"{where}: bounds {lower:.6g} and {upper:.6g} {unit}; the lower is a number not "
                "above the upper"
            )
    return found[0], found[1]


def _target(name: str, low: np.ndarray, high: np.ndarray, where: str) -> np.ndarray | None:
    """The unit quaternion that an orientation is to equal, if the condition is one."""
    quantity = name.rpartition(".")[2]
    if quantity not in ("quaternion", "rotation_matrix") or (low != high).any():
        return None
    if quantity == "quaternion":
        return np.array(checks.rotation(low, where), float)
    R = checks.rotation(low.reshape(3, 3), where)
    return np.array(matrix_quat(ca.DM(np.array(R, float)))).reshape(-1)


def _error_rows(
    names: Names, body: str, target: np.ndarray
) -> list[tuple[Label, ca.SX, float, float]]:
    """Three equations: the rotation error is zero. See `error_vector`."""
    error = error_vector(ca.SX(target), names.column(f"{body}.quaternion")[0])
    return [
        (Label("", f"{body}.rotation error_{axis}", "", "rad"), cell, 0.0, 0.0)
        for axis, cell in zip("xyz", ca.vertsplit(error), strict=True)
    ]


def error_vector(target: Any, q: Any) -> Any:
    """Rotation from target to q, both of norm 1: 2 sin(angle/2) axis (3, 1), rad near zero.

    It is zero for q and -q, has full rank there, and is smooth at every angle.
    """
    return 2 * quat_product(quat_conjugate(target), q)[1:4]


def _check_still(at_rest: _Still, name: str, where: str, value: Any, unit: str) -> None:
    low, high = (float(side[0]) for side in _limits(where, value, (), unit))
    own = at_rest.values[name]
    room = _MET * (1 + abs(own))
    if not low - room <= own <= high + room:
        raise ValueError(
            f"{where}: never moves from {own:.6g} {unit}, wanted {_text(low, high)}; nothing in "
            "this problem acts on it; give it another start, or a load"
        )


def _moving(
    at_rest: _Still, name: str, rows: list[tuple[Label, ca.SX, float, float]]
) -> list[tuple[Label, ca.SX, float, float]]:
    """The rows that depend on anything.

    Raises:
        ValueError: one does not, and is not met.
    """
    kept = []
    for label, expr, low, high in rows:
        settled = at_rest.put_in(expr)
        if ca.symvar(settled):
            kept.append((label, expr, float(low), float(high)))
            continue
        value = float(settled)
        room = _MET * (1 + abs(value))
        if low - room <= value <= high + room:
            continue
        raise ValueError(
            f"condition '{label.name}': always {value:.6g} {label.unit}, wanted {low:.6g} ... "
            f"{high:.6g}; nothing in the model changes it"
        )
    return kept


def _stacked(
    rows: list[tuple[Label, ca.SX, float, float]], targets: Mapping[str, np.ndarray]
) -> Rows:
    return Rows(
        tuple(row[0] for row in rows),
        ca.vertcat(ca.SX(0, 1), *(row[1] for row in rows)),
        np.array([row[2] for row in rows], float),
        np.array([row[3] for row in rows], float),
        targets,
    )


def _check_given(problem: Problem, path: Conditions, where: str) -> None:
    for name in path.box:
        if name in problem.inputs and not isinstance(problem.inputs[name], Free):
            raise ValueError(
                f"{where} '{name}': this input is given; only one that is Free takes conditions"
            )


def _within(terms: Terms, where: str) -> Terms:
    """The phase, bounds at its ends cut down to those along the path.

    Raises:
        ValueError: they have nothing in common.
    """
    changed = {}
    for title in ("start", "end"):
        own: Conditions = getattr(terms, title)
        box = dict(terms.path.box)
        for name, (low, high) in own.box.items():
            along = box.get(name, (-math.inf, math.inf))
            both = max(low, along[0]), min(high, along[1])
            if both[0] > both[1]:
                raise ValueError(
                    f"{where}, {title} '{name}': {_text(low, high)} outside the path bounds "
                    f"{_text(*along)}; they contradict each other"
                )
            box[name] = both
        changed[title] = Conditions(box, own.rows)
    return replace(terms, **changed)


def _text(low: float, high: float) -> str:
    return f"{low:.6g}" if low == high else f"{low:.6g} ... {high:.6g}"
