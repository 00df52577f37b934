"""Costs and conditions of a problem's phases, traced on the symbols of its model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..base import checks
from ..base.names import joined, near
from ..base.rotation import matrix_quat, quat_conjugate, quat_product
from ..base.symbols import TIME, Array, Scalar, is_number, to_expr
from ..dae.members import Label, Rotation, RotationKind, pick
from ..model.model import Model
from .problem import Bound, Expression, Free, Phase, Problem

_MET = 1e-9  # a condition on what never moves is met within rounding of its value
_NONE = (-math.inf, math.inf)
_ORIENTATION = ("quaternion", "rotation_matrix")  # outputs of what rotates

Place = tuple[str, int]
"""A variable of a model: the group "x", "z", "u", "p" or "idle_p" of its `Dae`, and the index."""

_Condition = tuple[Label, ca.SX, float, float]  # low <= expression <= high


class LeftOut(Exception):
    """A quantity that the minimal model does not know."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


@dataclass(frozen=True, eq=False)
class Named:
    """A quantity of the model that was looked up by its name.

    Fields:
        column: its components, row by row, over the symbols of the model (n, 1).
        labels: name and unit of each component (n,).
        shape: of the quantity, () for a scalar.
        place: which variable of the model it is; None for an output, the time, and a state that was
            left out or replaced.
    """

    column: ca.SX
    labels: tuple[Label, ...]
    shape: tuple[int, ...] = ()
    place: Place | None = None


class Names:
    """Argument `v` of the functions of costs and conditions: `v[name]` is a quantity of the model.

    States, algebraic unknowns, Inputs and Params are `Scalar`s, outputs are `Scalar`s or arrays of
    them in their shape; `v["t"]` is the time in s. Arithmetic, numpy functions and `where` work on
    them.
    """

    def __init__(self, model: Model) -> None:
        self._model, dae = model, model.dae
        self._variables = {"t": Named(dae.t, (Label("", "t", unit="s"),))}
        for group in ("x", "z", "u", "p", "idle_p"):
            column = getattr(dae, group)
            for i, label in enumerate(getattr(dae, f"{group}_labels")):
                self._variables[label.name] = Named(column[i], (label,), (), (group, i))
        # Labels of the scene's own states come first, then those in axes of a plane, if there are.
        self._full = dae.expansion.labels if dae.expansion else dae.x_labels
        turns = {turn.owner: turn for turn in reversed(dae.rotations)}  # the scene's own come first
        self.orientations = {
            output.name: turns[output.owner]
            for output in dae.outputs.values()
            if output.owner in turns and output.quantity in _ORIENTATION
        }
        self.quaternions = [
            (turn, tuple(self._full[row].name for row in turn.coordinates))
            for turn in turns.values()
            if turn.kind is RotationKind.quaternion
        ]

    def __getitem__(self, name: str) -> Any:
        found = self.find(name)
        cells = np.empty(found.column.numel(), dtype=object)
        cells[:] = [Scalar(cell) for cell in ca.vertsplit(found.column)]
        return cells[0] if found.shape == () else cells.reshape(found.shape).view(Array)

    def find(self, name: str) -> Named:
        """Look up a quantity.

        Raises:
            LeftOut: the minimal model does not know it.
            ValueError: there is no such quantity.
        """
        model = self._model
        if name in self._variables:
            return self._variables[name]
        if name in {d.name for d in model.dropped}:
            raise LeftOut(name)
        # States that a minimal model computes from others can be used in expressions all the same.
        if name in model.left_out:
            row = [label.name for label in self._full].index(name)
            return Named(model.expression("states")[row], (self._full[row],))
        output = model.dae.outputs.get(name)
        if output is None:
            every = [*self._variables, *model.left_out, *model.dae.outputs]
            raise ValueError(f"model '{model.name}': no '{name}'; there are: {near(name, every)}")
        try:
            return Named(model.dae.output(name), output.labels, output.shape)
        except ValueError as error:
            raise LeftOut(name) from error

    def label(self, place: Place) -> Label:
        """Return the label of a variable."""
        return getattr(self._model.dae, f"{place[0]}_labels")[place[1]]

    def unit(self, state: str) -> str:
        """Return the unit of a state of the full scene, also of one that was left out."""
        return next((label.unit for label in self._full if label.name == state), "")

    def trace(self, expression: Expression, where: str) -> ca.SX:
        """Return an expression, a scalar, over the symbols of the model.

        Raises:
            LeftOut: it needs what the minimal model does not know.
            ValueError, TypeError: unknown names, a value that is not a number, foreign symbols.
        """
        value: Any = expression
        if isinstance(expression, str):
            value = self[expression]
        elif callable(expression):
            value = expression(self)
        array = np.asarray(value, dtype=object)
        if array.shape in ((), (1,)):
            value = array.reshape(-1)[0]
        if not is_number(value):
            shape = f" of shape {array.shape}" if array.shape else ""
            raise TypeError(
                f"{where}: {type(value).__name__}{shape}; it is one number; pick a component, or "
                "sum over them"
            )
        for leaf in value.leaves if isinstance(value, Scalar) else ():
            own = self._variables.get(leaf.name)
            if leaf is not TIME and not (own and ca.is_equal(own.column, leaf.expr)):
                raise ValueError(
                    f"{where}: {type(leaf).__name__} '{leaf.name}' is not of this model; use the "
                    "ones its scene was made with"
                )
        return ca.SX(to_expr(value))


@dataclass(frozen=True, eq=False)
class Target:
    """An orientation that a rotation is to reach, and the rows of the conditions that say so."""

    rotation: Rotation
    quaternion: np.ndarray
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Rows:
    """Conditions low <= expr <= high, over [t, x, z, u, all parameters].

    Fields:
        labels: name and unit of each row.
        targets: orientations among the conditions; guess and start use them directly.
    """

    labels: tuple[Label, ...]
    expr: ca.SX
    low: np.ndarray
    high: np.ndarray
    targets: tuple[Target, ...]


@dataclass(frozen=True, eq=False)
class Conditions:
    """Bounds of variables, and rows.

    Fields:
        box: (low, high) of each variable that has bounds.
        named: variables that the user's mapping itself names; at the ends of phases `box` also
            holds the bounds along the path.
    """

    box: Mapping[Place, tuple[float, float]]
    rows: Rows
    named: frozenset[Place]

    def limits(self, group: str, indices: Any) -> np.ndarray:
        """Return the bounds (2, n) of variables of a group, infinite where there are none."""
        pairs = [self.box.get((group, i), _NONE) for i in indices]
        return np.array(pairs, float).reshape(len(pairs), 2).T


@dataclass(frozen=True, eq=False)
class Terms:
    """Costs and conditions of a phase over [t, x, z, u, all parameters].

    `link` holds the states just after its start by the values just before, None if continuous.
    """

    integrand: ca.SX
    end_cost: ca.SX
    start: Conditions
    end: Conditions
    path: Conditions
    link: ca.SX | None


def trace_phases(problem: Problem, model: Model, still: Mapping[str, float]) -> tuple[Terms, ...]:
    """Trace the phases of a problem on a model.

    Arguments:
        still: states that provably never move in this problem, and their values. A condition that
            they always meet is redundant, and is left out.

    Raises:
        LeftOut: the minimal model does not know what they need.
        ValueError, TypeError: unknown names, values of the wrong shape, contradictions.
    """
    names = Names(model)
    tracer = _Tracer(model, names, still)
    found = []
    for i, phase in enumerate(problem.sequence):
        where = f"phase {i}" if len(problem.sequence) > 1 else "problem"
        terms = Terms(
            names.trace(phase.integral, f"{where}, integral"),
            names.trace(phase.end_cost, f"{where}, end_cost"),
            tracer.conditions(phase.start, f"{where}, start", "x"),
            tracer.conditions(phase.end, f"{where}, end", "x"),
            tracer.conditions(phase.path, f"{where}, path", "xzu"),
            _link(model, names, phase, where),
        )
        _check_given(problem, names, terms.path, f"{where}, path")
        found.append(_within(terms, names, where))
    return tuple(found)


def _link(model: Model, names: Names, phase: Phase, where: str) -> ca.SX | None:
    if not phase.link:
        return None
    states = ca.vertsplit(model.dae.x)
    for name, expression in phase.link.items():
        group, i = names.find(name).place or ("", 0)
        if group != "x":
            raise ValueError(f"{where}, link: '{name}' is not a state; only states jump; name one")
        states[i] = names.trace(expression, f"{where}, link '{name}'")
    return ca.vertcat(*states)


class _Tracer:
    """Traces conditions on a model, with states that never move put in at their values."""

    def __init__(self, model: Model, names: Names, still: Mapping[str, float]) -> None:
        self._names, self._still = names, still
        rows = [i for i, label in enumerate(model.x_labels) if label.name in still]
        self._symbols = pick(model.dae.x, rows)
        self._numbers = ca.DM([still[model.x_labels[i].name] for i in rows])

    def conditions(self, given: Mapping[str, Any], where: str, groups: str) -> Conditions:
        """Trace the conditions of one end, or of the path.

        Arguments:
            groups: of the variables whose conditions are bounds, not rows.
        """
        names, box = self._names, dict[Place, tuple[float, float]]()
        rows: list[_Condition] = []
        targets: list[Target] = []
        for name, value in _oriented(names, given).items():
            place = f"{where} '{name}'"
            if isinstance(value, Bound):
                expr = names.trace(value.expression, place)
                rows += self._moving(
                    [(Label("", name, unit=value.unit), expr, value.low, value.high)]
                )
                continue
            if name in self._still:
                _check_still(self._still[name], place, value, names.unit(name))
                continue
            found = names.find(name)
            low, high = _limits(place, value, found.shape, found.labels[0].unit)
            if found.place and found.place[0] in groups:
                box[found.place] = (float(low[0]), float(high[0]))
                continue
            # An orientation that is given has three degrees of freedom, not four or nine.
            turn = names.orientations.get(name)
            if turn and (low == high).all():
                target = _quaternion(low, place)
                own = self._moving(_rotation_error(names, turn, target))
                at = range(len(rows), len(rows) + len(own))
                targets.append(Target(turn, target, tuple(at)))
            else:
                cells = ca.vertsplit(found.column)
                own = self._moving(list(zip(found.labels, cells, low, high, strict=True)))
            rows += own
        return Conditions(box, _stacked(rows, targets), frozenset(box))

    def _moving(self, rows: list[_Condition]) -> list[_Condition]:
        """Return the rows that depend on anything.

        Raises:
            ValueError: one does not, and is not met.
        """
        kept = []
        for label, expr, low, high in rows:
            # A row that depends on nothing would be a zero row of the Jacobian; where constraints
            # are dependent, solvers need not converge.
            settled = ca.substitute(expr, self._symbols, self._numbers)
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


def _oriented(names: Names, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the conditions, with numbers for all states of a quaternion as one orientation.

    Four equations for three degrees of freedom would be redundant.
    """
    found = dict(given)
    for turn, states in names.quaternions:
        if all(_is_number(found.get(state)) for state in states):
            found[joined(turn.owner, "quaternion")] = [found.pop(state) for state in states]
    return found


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating))


def _limits(
    where: str, value: Any, shape: tuple[int, ...], unit: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounds of all components, row by row, of a value or a pair (low, high)."""
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


def _quaternion(values: np.ndarray, where: str) -> np.ndarray:
    """Return the unit quaternion of an orientation, given as quaternion (4,) or matrix (9,)."""
    if len(values) == 4:
        return np.array(checks.rotation(values, where), float)
    R = checks.rotation(values.reshape(3, 3), where)
    return np.array(matrix_quat(ca.DM(np.array(R, float)))).reshape(-1)


def _rotation_error(names: Names, turn: Rotation, target: np.ndarray) -> list[_Condition]:
    """Return three equations: the rotation error is zero. See `error_vector`."""
    error = error_vector(ca.SX(target), names.find(joined(turn.owner, "quaternion")).column)
    return [
        (Label(turn.owner, "rotation error", axis, "rad"), cell, 0.0, 0.0)
        for axis, cell in zip("xyz", ca.vertsplit(error), strict=True)
    ]


def error_vector(target: Any, q: Any) -> Any:
    """Rotation from target to q, both of norm 1: 2 sin(angle/2) axis (3, 1), rad near zero.

    It is zero for q and -q, has full rank there, and is smooth at every angle.
    """
    return 2 * quat_product(quat_conjugate(target), q)[1:4]


def _check_still(own: float, where: str, value: Any, unit: str) -> None:
    low, high = (float(side[0]) for side in _limits(where, value, (), unit))
    room = _MET * (1 + abs(own))
    if not low - room <= own <= high + room:
        raise ValueError(
            f"{where}: never moves from {own:.6g} {unit}, wanted {_text(low, high)}; nothing in "
            "this problem acts on it; give it another start, or a load"
        )


def _stacked(rows: list[_Condition], targets: list[Target]) -> Rows:
    return Rows(
        tuple(row[0] for row in rows),
        ca.vertcat(ca.SX(0, 1), *(row[1] for row in rows)),
        np.array([row[2] for row in rows], float),
        np.array([row[3] for row in rows], float),
        tuple(targets),
    )


def _check_given(problem: Problem, names: Names, path: Conditions, where: str) -> None:
    for place in path.box:
        name = names.label(place).name
        if place[0] == "u" and not isinstance(problem.inputs[name], Free):
            raise ValueError(
                f"{where} '{name}': this input is given; only one that is Free takes conditions"
            )


def _within(terms: Terms, names: Names, where: str) -> Terms:
    """Return the phase with the bounds at its ends cut down to those along the path.

    Raises:
        ValueError: they have nothing in common.
    """
    changed = {}
    for title in ("start", "end"):
        own: Conditions = getattr(terms, title)
        # Bounds along the path hold at the ends, too, where they would otherwise be missing: the
        # states there are variables of their own.
        box = dict(terms.path.box)
        for place, (low, high) in own.box.items():
            along = box.get(place, _NONE)
            both = max(low, along[0]), min(high, along[1])
            if both[0] > both[1]:
                raise ValueError(
                    f"{where}, {title} '{names.label(place).name}': {_text(low, high)} outside the "
                    f"path bounds {_text(*along)}; they contradict each other"
                )
            box[place] = both
        changed[title] = replace(own, box=box)
    return replace(terms, **changed)


def _text(low: float, high: float) -> str:
    return f"{low:.6g}" if low == high else f"{low:.6g} ... {high:.6g}"
