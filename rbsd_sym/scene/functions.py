"""User functions of a connector: called once with symbols, turned into CasADi functions."""

from __future__ import annotations

import inspect
import math
import re
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ..base.names import check_identifier
from ..base.program import content, without_derivative
from ..base.symbols import (
    TIME,
    Array,
    Leaf,
    Param,
    Scalar,
    SymbolError,
    arrays_of_symbols,
    is_number,
    leaves_of,
    to_array,
    to_expr,
)
from .elements import RigidBodySpringDamper
from .mbs import Mbs, joint_rotation

_FORCE = (
    "(mbs, t, item, displacement, rotation, velocity, angular_velocity, stiffness, damping, "
    "rotJ0, rotJ1, offset)"
)
_WITH_DATA = _FORCE.replace("item, ", "item, data, ")
_DIRECTIONS = (-1, 0, 1)
_LIBRARIES = (Path(__file__).parents[1], Path(ca.__file__).parent, Path(np.__file__).parent)
_OF_MATH = re.compile(r"\bmath\.(\w+)")
_IN_NUMPY = {
    "asin": "arcsin",
    "acos": "arccos",
    "atan": "arctan",
    "atan2": "arctan2",
    "asinh": "arcsinh",
    "acosh": "arccosh",
    "atanh": "arctanh",
    "pow": "power",
    "dist": "linalg.norm",
}


@dataclass(frozen=True, eq=False)
class Event:
    """What happens where a function of the motion crosses zero.

    Arguments:
        zero: the function, of the arguments that the user's function was given.
        direction: -1 fires as it falls through zero, +1 as it rises, 0 at both.
        data: new values of all data states of the connector; None leaves them.
        impulse: 6 numbers, in the axes and with the signs of the connector's force (N s, N m s);
            None applies none.
        at_once: fire also where the start, or another event, leaves the function on the far side.
            Otherwise it must cross, and a start on zero counts on the side to which it moves.
        stop: end the integration there.
        name: for the record; by default event_0, event_1, ...

    Raises:
        ValueError: direction is not -1, 0 or 1, `at_once` without direction.
    """

    zero: Any
    direction: int = -1
    data: Sequence[Any] | None = None
    impulse: Sequence[Any] | None = None
    at_once: bool = False
    stop: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.direction, (int, np.integer)) or self.direction not in _DIRECTIONS:
            raise ValueError(
                f"Event: direction {self.direction!r}; -1 falls, +1 rises, 0 is both ways"
            )
        if self.at_once and self.direction == 0:
            raise ValueError(
                "Event: at_once needs a direction, which tells the far side; give two events, with "
                "directions -1 and +1"
            )
        for title in ("at_once", "stop"):
            if not isinstance(getattr(self, title), (bool, np.bool_)):
                raise TypeError(f"Event: {title} {getattr(self, title)!r}; it is True or False")
        if self.name:
            check_identifier(self.name, "Event")


@dataclass(frozen=True, eq=False)
class TracedEvent:
    """A falling zero function: rows (zero, 6 impulse, data) of the traced function from `first`."""

    name: str
    first: int
    at_once: bool
    stops: bool
    throws: bool


@dataclass(frozen=True, eq=False)
class Traced:
    """A user function as a Function (t, strain, rate, A0, A1, data, leaves) -> column.

    `leaves` are the Params and Inputs it uses, its own and those of K, D and offset.
    """

    function: ca.Function
    leaves: tuple[Leaf, ...]
    events: tuple[TracedEvent, ...] = ()

    @property
    def text(self) -> str:
        """All that determines it: what it computes, and its events."""
        said = [f"{e.name} {e.at_once} {e.stops}" for e in self.events]
        return "\n".join([content(self.function), *said])

    @property
    def values(self) -> ca.SX:
        """Column of the leaves' symbols, the last argument of the function."""
        return ca.vertcat(ca.SX(0, 1), *(leaf.expr for leaf in self.leaves))


class _Call:
    """The symbols a user function is called with, and what its result is made of."""

    def __init__(
        self,
        title: str,
        item: int,
        connectors: Sequence[RigidBodySpringDamper],
        variables: Mapping[str, Any],
    ) -> None:
        own = connectors[item]
        self.where, self.item, self.connector = f"connector '{own.name}', {title}", item, own
        self.numbers = (own.stiffness, own.damping, own.offset)
        self.n_data = len(own.data)
        self.strain, self.rate = ca.SX.sym("strain", 6), ca.SX.sym("rate", 6)
        self.frames = ca.SX.sym("A0", 3, 3), ca.SX.sym("A1", 3, 3)
        self.data = ca.SX.sym("data", self.n_data)
        frames = (to_array(self.frames[0]), to_array(self.frames[1]))
        self.mbs = Mbs(self.where, item, connectors, frames, variables)

    def __call__(self, function: Callable[..., Any], with_data: bool) -> Any:
        strain, rate = self.strain, self.rate
        data = [list(to_array(self.data)) if self.n_data else []] if with_data else []
        stiffness, damping, offset = (_copy(value) for value in self.numbers)
        given = (
            self.mbs,
            TIME,
            self.item,
            *data,
            to_array(strain[:3]),
            to_array(strain[3:]),
            to_array(rate[:3]),
            to_array(rate[3:]),
            stiffness,
            damping,
            joint_rotation(self.connector, 0),
            joint_rotation(self.connector, 1),
            offset,
        )
        try:
            with arrays_of_symbols():
                return function(*given)
        except SymbolError as error:
            line = _line(error)
            raise TypeError(f"{self.where}: {line}{error}{_instead(line)}") from error
        except (TypeError, AttributeError, IndexError) as error:
            signature = _WITH_DATA if with_data else _FORCE
            raise TypeError(
                f"{self.where}: {_line(error)}{error}; it is called as {signature}, with arrays of "
                "symbols; numpy's elementwise functions, @, slices, sums, norms, np.where and "
                "np.interp work on them; other functions come from CasADi, such as casadi.erf"
            ) from error

    def traced(self, values: list[Any], events: tuple[TracedEvent, ...] = ()) -> Traced:
        known = [TIME.expr, self.strain, self.rate, *self.frames, self.data]
        expr = ca.vertcat(ca.SX(0, 1), *(to_expr(value) for value in values))
        seen = leaves_of(values) | leaves_of(list(self.numbers))
        leaves = tuple(sorted(seen - {TIME}, key=lambda leaf: leaf.name))
        column = ca.vertcat(ca.SX(0, 1), *(leaf.expr for leaf in leaves))
        free = ca.Function("free", [*known, column], [expr], {"allow_free": True}).free_sx()
        if free:
            raise ValueError(
                f"{self.where}: uses the CasADi symbols {free}; only Params, Inputs and the "
                "arguments may appear; make a Param or an Input of each"
            )
        function = ca.Function("user", [*known, column], [expr])
        if names := without_derivative(function):
            raise ValueError(
                f"{self.where}: CasADi has no derivatives of {', '.join(names)}; make it with the "
                "option {'enable_fd': True}, or use a formula or casadi.interpolant"
            )
        return Traced(function, leaves, events)


def _copy(value: np.ndarray) -> np.ndarray:
    return value.copy().view(Array) if value.dtype == object else value.copy()


def _line(error: BaseException) -> str:
    """Where in the user's code an error arose: "line 7, `f[2] = u[2]`: ", if that is known."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.line and not any(Path(frame.filename).is_relative_to(p) for p in _LIBRARIES):
            return f"line {frame.lineno}, `{frame.line}`: "
    return ""


def _instead(line: str) -> str:
    """What to write for the functions of math in a line; numbers, such as math.pi, are right."""
    names = [name for name in _OF_MATH.findall(line) if callable(getattr(math, name, None))]
    known = {name: _IN_NUMPY.get(name, name) for name in names}
    there = [(ours, name) for name, ours in known.items() if hasattr(np, ours)]
    return "".join(f"; here np.{ours} for math.{name}" for ours, name in there)


def trace_force(
    force: Callable[..., Any],
    item: int,
    connectors: Sequence[RigidBodySpringDamper],
    variables: Mapping[str, Any],
) -> Traced:
    """Call a connector's force once: motions are symbols, numbers of the connector stay numbers.

    One that takes 13 arguments gets the data states after `item`, as `post_newton_step` does.

    Raises:
        TypeError: it branches on a symbol or returns something that is not a number.
        ValueError: it does not return 6 numbers, or uses CasADi symbols that are no Param or Input.
    """
    call = _Call("force", item, connectors, variables)
    if not call.n_data and _takes(force, 13) and not _takes(force, 12):
        raise TypeError(
            f"{call.where}: takes 13 arguments, data after item, but the connector has no data; "
            "give data=[...], or leave the argument out"
        )
    result = call(force, call.n_data > 0 and _takes(force, 13))
    rule = "6 numbers: force x y z, torque x y z"
    return call.traced(_numbers(result, 6, rule, call.where))


def trace_post_newton(
    step: Callable[..., Any],
    item: int,
    connectors: Sequence[RigidBodySpringDamper],
    variables: Mapping[str, Any],
) -> Traced:
    """A connector's post_newton_step as a Function -> [error, recommended step, data].

    Raises:
        TypeError, ValueError: as `trace_force`.
    """
    call = _Call("post_newton_step", item, connectors, variables)
    n_data = call.n_data
    rule = f"2 + {n_data} numbers: error, recommended step, and each entry of data"
    return call.traced(_numbers(call(step, True), 2 + n_data, rule, call.where))


def trace_events(
    events: Callable[..., Any],
    item: int,
    connectors: Sequence[RigidBodySpringDamper],
    variables: Mapping[str, Any],
) -> Traced:
    """A connector's events as a Function -> (zero, impulse, data) of each, one after the other.

    Raises:
        TypeError, ValueError: as `trace_force`; a transition of wrong size.
    """
    call = _Call("events", item, connectors, variables)
    result = call(events, True)
    found = [result] if isinstance(result, Event) else result
    if not isinstance(found, (list, tuple)) or not all(isinstance(e, Event) for e in found):
        raise TypeError(f"{call.where}: returned {result!r}; return a list of rbsd_sym.Event")
    values: list[Any] = []
    traced: list[TracedEvent] = []
    for i, event in enumerate(found):
        label, signs = event.name or f"event_{i}", (-1, 1) if event.direction == 0 else (0,)
        block = _transition(event, call, label)
        for sign in signs:
            ending = {-1: "_falls", 0: "", 1: "_rises"}[sign]
            rising = (sign or event.direction) > 0
            throws = event.impulse is not None
            name = label + ending
            traced.append(TracedEvent(name, len(values), event.at_once, event.stop, throws))
            values += [-block[0] if rising else block[0], *block[1:]]
    names = [one.name for one in traced]
    if len(set(names)) < len(names):
        raise ValueError(f"{call.where}: names {names}; give events different names")
    return call.traced(values, tuple(traced))


def _transition(event: Event, call: _Call, label: str) -> list[Any]:
    """Zero function, impulse and new data of an event."""
    where = f"{call.where}, '{label}'"
    zero = _numbers([event.zero], 1, "1 number", f"{where}, zero")
    constant = not ca.symvar(to_expr(zero[0])) or (
        leaves_of(zero)
        and all(isinstance(leaf, Param) for leaf in leaves_of(zero))
        and not _moves(zero[0], call)
    )
    if constant:
        raise ValueError(
            f"{where}, zero: {zero[0]} is constant in time and never crosses zero; give an "
            "expression of the motion, data, TIME or an Input"
        )
    impulse = [0.0] * 6 if event.impulse is None else event.impulse
    data = list(to_array(call.data)) if call.n_data else []
    new = data if event.data is None else event.data
    rule = "6 numbers: impulse x y z, turning impulse x y z"
    count = f"{call.n_data} numbers, one for each entry of the connector's data"
    return [
        *zero,
        *_numbers(impulse, 6, rule, f"{where}, impulse"),
        *_numbers(new, call.n_data, count, f"{where}, data"),
    ]


def _moves(value: Any, call: _Call) -> bool:
    """Whether an expression depends on the motion or the data."""
    known = ca.vertcat(call.strain, call.rate, *map(ca.vec, call.frames), call.data)
    return bool(ca.depends_on(to_expr(value), known))


def _takes(function: Callable[..., Any], count: int) -> bool:
    """Whether a function can be called with that many arguments in order."""
    try:
        inspect.signature(function).bind(*range(count))
    except (TypeError, ValueError):
        return False
    return True


def _numbers(result: Any, count: int, rule: str, where: str) -> list[Any]:
    if result is None:
        raise ValueError(f"{where}: returned None; it returns {rule}")
    if isinstance(result, ca.SX):
        result = list(to_array(ca.vec(result)))
    try:
        values = list(np.asarray(result, dtype=object).reshape(-1))
    except (TypeError, ValueError) as error:
        raise TypeError(f"{where}: returned {result!r}; return a list of numbers") from error
    if len(values) != count:
        raise ValueError(f"{where}: returned {len(values)} numbers; it returns {rule}")
    for i, value in enumerate(values):
        if isinstance(value, ca.SX):
            values[i] = Scalar(value, leaves_of(value))
        elif not is_number(value):
            raise TypeError(f"{where}: entry {i} is {value!r}; return numbers or expressions")
        elif not isinstance(value, Scalar) and not np.isfinite(value):
            raise ValueError(f"{where}: entry {i} is {value}; numbers are finite")
    return values
