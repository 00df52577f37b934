"""Effects: laws along one axis of a connector, or over all of it, added to its wrench.

A law says what strain and rate are; an effect answers to one component of them with a force. It may
have internal states, data states that only events change, and one unknown force. Signs are those of
the spring K u: a positive force resists a positive strain.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from ..base.checks import at_default
from ..base.names import check_identifier
from ..base.program import identity
from ..base.symbols import Leaf, Scalar, is_number, leaves_of, to_expr

AXES = ("x", "y", "z", "rx", "ry", "rz")
_TURNED = {
    "N/m": "N m/rad",
    "N": "N m",
    "m": "rad",
    "m/s": "rad/s",
    "N s/m": "N m s/rad",
    "N/m3": "N m/rad3",
}
_NONE = ca.SX(0, 1)
_ZERO = ca.SX(0)


class Own(NamedTuple):
    """An internal state of an effect, or (`data`) one that only events change."""

    name: str
    unit: str = ""
    start: float = 0.0
    data: bool = False


class Sight(NamedTuple):
    """What an effect sees.

    Fields:
        strain, rate: along its axis (m, m/s or rad, rad/s); (6, 1) for an effect on the whole.
        own: its own states; `unknown`: its unknown force, an empty column if it has none.
        gives: how much the rate falls for a unit impulse along the axis (1/kg or 1/(kg m2)).
        force, energy: of all that is there before it, (6, 1) N and N m, and J.
        forces: of the effects before it, by name.
    """

    t: ca.SX
    strain: ca.SX
    rate: ca.SX
    own: ca.SX
    unknown: ca.SX
    gives: Callable[[], ca.SX]
    force: ca.SX
    energy: ca.SX
    forces: Mapping[str, ca.SX]


class Change(NamedTuple):
    """An event of an effect: what happens when `zero` falls through zero.

    Fields:
        own: new values of its own states.
        impulse: along the axis (N s or N m s), with the sign of a force.
        at_once: see `parts.Event`.
    """

    name: str
    zero: ca.SX
    own: ca.SX
    impulse: ca.SX = _ZERO
    at_once: bool = False


class Answer(NamedTuple):
    """What an effect answers.

    Fields:
        force: along the axis (N or N m).
        energy, dissipated: stored (J) and lost as heat (W).
        rates: of its own states; zero for data.
        equation, held: the unknown solves 0 = equation + held d(rate)/dt.
        factor: of the whole wrench, from an effect on the whole.
    """

    force: ca.SX = _ZERO
    energy: ca.SX = _ZERO
    dissipated: ca.SX = _ZERO
    rates: ca.SX = _NONE
    changes: tuple[Change, ...] = ()
    equation: ca.SX = _NONE
    held: ca.SX = _ZERO
    factor: ca.SX = ca.SX(1)


class Rule(NamedTuple):
    """What a number of an effect must be."""

    unit: str
    positive: bool = False
    signed: bool = False


@dataclass(frozen=True, eq=False)
class Effect:
    """What all effects share. Subclasses are frozen dataclasses, one file per law.

    `rules` names the numbers, which may be floats, Params, Inputs or expressions; all other fields
    are part of the structure, so that effects which agree in them share their code.
    """

    rules: ClassVar[Mapping[str, Rule]] = {}
    whole: ClassVar[bool] = False
    """Whether it acts on the whole wrench instead of along an axis."""

    @property
    def label(self) -> str:
        """Its name within the connector."""
        given = getattr(self, "name", "")
        axis = getattr(self, "axis", None)
        kind = type(self).__name__.lower()
        return given or (kind if axis is None else f"{kind}_{AXES[axis]}")

    @property
    def own(self) -> tuple[Own, ...]:
        """Its states."""
        return ()

    @property
    def unknowns(self) -> tuple[Own, ...]:
        """Its unknown force, or none."""
        return ()

    @property
    def impulsive(self) -> bool:
        """Whether it gives impulses or holds, and so needs inertia on both sides."""
        return False

    @property
    def needs_potential(self) -> bool:
        """Whether it depends on the energy stored before it."""
        return False

    def answer(self, sight: Sight) -> Answer:
        """Force, energies, rates of its states and events."""
        raise NotImplementedError

    def check(self, where: str) -> None:
        """Check axis, name and numbers.

        Raises:
            ValueError, TypeError: what breaks the rules, and where.
        """
        where, turns = f"{where}, {type(self).__name__}", False
        if not self.whole:
            axis: Any = self.axis  # type: ignore[attr-defined]
            _check_axis(axis, where)
            turns = axis >= 3
        if getattr(self, "name", ""):
            check_identifier(self.name, where)  # type: ignore[attr-defined]
        optional = {f.name for f in fields(self) if f.default is None}
        for name, rule in self.rules.items():
            value = getattr(self, name)
            if value is not None or name not in optional:
                unit = _TURNED.get(rule.unit, rule.unit) if turns else rule.unit
                _check_number(f"{where}, {name}", value, rule._replace(unit=unit))
        _check_smoothing(getattr(self, "smoothing", 0.0), f"{where}, smoothing")
        self._check(where)

    def _check(self, where: str) -> None:
        """More rules of one effect."""

    @property
    def structure(self) -> tuple[Any, ...]:
        """What two effects must have in common to share their code."""
        own = [
            getattr(self, f.name) is None if f.name in self.rules else getattr(self, f.name)
            for f in fields(self)
        ]
        return (type(self), *own)

    @property
    def column(self) -> ca.SX:
        """Its numbers."""
        values = (getattr(self, name) for name in self.rules)
        return ca.vertcat(_NONE, *(to_expr(v) for v in values if v is not None))

    @property
    def leaves(self) -> frozenset[Leaf]:
        """Every Param, Input and TIME in its numbers."""
        return frozenset().union(*(leaves_of(getattr(self, name)) for name in self.rules))

    def bound(self, column: ca.SX) -> Any:
        """The effect with symbols for its numbers, in the order of `column`."""
        twin, i = copy.copy(self), 0
        for name in self.rules:
            if getattr(self, name) is not None:
                object.__setattr__(twin, name, column[i])
                i += 1
        return twin

    @property
    def text(self) -> str:
        """All that determines it."""
        values = (f"{f.name}={_plain(getattr(self, f.name))}" for f in fields(self))
        return f"{type(self).__name__}({', '.join(values)})"


def _plain(value: Any) -> str:
    if isinstance(value, Scalar):
        return identity(value.expr)
    return repr(float(value)) if is_number(value) else repr(value)


def _check_number(where: str, value: Any, rule: Rule) -> None:
    if not is_number(value):
        raise TypeError(
            f"{where}: {value!r} is {type(value).__name__}; give a float, a Param, an Input, TIME "
            "or an expression of them"
        )
    number = value_at_default(value)
    if not np.isfinite(number):
        raise ValueError(f"{where}: {number} {rule.unit}; it is finite; check where it came from")
    if not rule.signed and (number < 0 or (rule.positive and number == 0)):
        kind, unit = "positive" if rule.positive else "not negative", f" {rule.unit}".rstrip()
        raise ValueError(f"{where}: {number:g}{unit}; it is {kind}; check sign and unit")


def value_at_default(value: Any) -> float:
    """A number, or what an expression is at the values its symbols start with."""
    symbolic = isinstance(value, Scalar)
    return float(at_default(np.array(value, dtype=object)) if symbolic else value)


def _check_axis(axis: Any, where: str) -> None:
    whole = isinstance(axis, (int, np.integer)) and not isinstance(axis, bool)
    if not (whole and 0 <= axis < 6):
        raise ValueError(
            f"{where}: axis {axis!r}; it is 0, 1, 2 for translation along the joint's x, y, z, or "
            "3, 4, 5 for rotation"
        )


def _check_smoothing(value: Any, where: str) -> None:
    if not is_number(value) or isinstance(value, Scalar):
        raise TypeError(f"{where}: {value!r} is {type(value).__name__}; it is a plain number")
    if not 0 <= value < np.inf:
        raise ValueError(f"{where}: {value!r}; it is 0, for the form with events, or above")
