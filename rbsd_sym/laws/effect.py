"""Effects: laws along one axis of a connector, or on its whole wrench, added to the spring-damper.

The law of the connector defines strain and rate; an effect responds to one component of them with a
force. It may have internal states, data states that only events change, and one unknown force.
Signs are those of the spring K u: a positive force resists a positive strain.
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
# Units of a rule along a translation axis, and what they are along a rotation axis.
_FOR_ROTATION = {
    "N/m": "N m/rad",
    "N": "N m",
    "m": "rad",
    "m/s": "rad/s",
    "N s/m": "N m s/rad",
    "N/m3": "N m/rad3",
}
_EMPTY = ca.SX(0, 1)
_ZERO = ca.SX(0)


class Own(NamedTuple):
    """A state (or unknown force) of an effect.

    Fields:
        name: identifier within the effect, such as "closed".
        unit: SI unit; "" without one.
        start: value at the start.
        data: True if the state is constant between events and only they change it.
    """

    name: str
    unit: str = ""
    start: float = 0.0
    data: bool = False


class Sight(NamedTuple):
    """What an effect is given to compute its answer, all as expressions.

    Fields:
        t: time, s.
        strain, rate: along the axis of the effect (m, m/s or rad, rad/s); (6, 1) for an effect on
            the whole wrench.
        own: its states, in the order of `Effect.own`.
        unknown: its unknown force; an empty column if it has none.
        gives: function that returns by how much the rate decreases for a unit impulse along the
            axis, 1/kg or 1/(kg m2): the inverse effective mass.
        force, energy: sums over the spring-damper and the effects before it, (6, 1) in N and N m,
            and J.
        forces: force of each effect before it, by label.
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
    """An event of an effect: what changes when its zero function falls through zero.

    Fields:
        name: identifier within the effect, such as "opens".
        zero: the zero function.
        own: new values of all states of the effect.
        impulse: along the axis (N s or N m s), with the sign of a force.
        at_once: whether it also fires where the start, or another event, leaves the function below
            zero; see `dae.members.Transition`.
    """

    name: str
    zero: ca.SX
    own: ca.SX
    impulse: ca.SX = _ZERO
    at_once: bool = False


class Answer(NamedTuple):
    """What an effect contributes.

    Fields:
        force: along the axis, N or N m.
        energy, dissipated: energy stored, J, and power lost as heat, W.
        rates: rates of its states; zero for data.
        changes: its events.
        equation, held: its unknown force solves 0 = equation + held d(rate)/dt.
        factor: for an effect on the whole wrench, what remains of the sums before it (0 ... 1).
    """

    force: ca.SX = _ZERO
    energy: ca.SX = _ZERO
    dissipated: ca.SX = _ZERO
    rates: ca.SX = _EMPTY
    changes: tuple[Change, ...] = ()
    equation: ca.SX = _EMPTY
    held: ca.SX = _ZERO
    factor: ca.SX = ca.SX(1)


class Rule(NamedTuple):
    """What is required of a number of an effect.

    Fields:
        unit: for translation; for a rotation axis the message converts it.
        positive: zero is not allowed.
        signed: negative values are allowed.
    """

    unit: str
    positive: bool = False
    signed: bool = False


@dataclass(frozen=True, eq=False)
class Effect:
    """Base class of all effects. Subclasses are frozen dataclasses, one file per law.

    `rules` names the numbers, which may be floats, Params, Inputs or expressions. All other fields
    belong to the structure; effects with the same structure share their code. A new effect defines
    `rules`, `own` if it has states, and `answer`.
    """

    rules: ClassVar[Mapping[str, Rule]] = {}
    whole: ClassVar[bool] = False
    """Whether the effect acts on the whole wrench instead of along an axis."""

    @property
    def label(self) -> str:
        """Name within the connector: the one given, else the kind and axis, such as contact_z."""
        given = getattr(self, "name", "")
        axis = getattr(self, "axis", None)
        kind = type(self).__name__.lower()
        return given or (kind if axis is None else f"{kind}_{AXES[axis]}")

    @property
    def own(self) -> tuple[Own, ...]:
        """Its states, in the order of `Sight.own`."""
        return ()

    @property
    def unknowns(self) -> tuple[Own, ...]:
        """Its unknown force, as a tuple of at most one entry."""
        return ()

    @property
    def impulsive(self) -> bool:
        """Whether it applies impulses or holds a velocity, which needs inertia on both sides."""
        return False

    @property
    def needs_potential(self) -> bool:
        """Whether it depends on the energy stored by what comes before it."""
        return False

    def answer(self, sight: Sight) -> Answer:
        """Return force, energies, rates of its states and events as expressions."""
        raise NotImplementedError

    def check(self, where: str) -> None:
        """Check axis, name and numbers, every symbol at its default value.

        Arguments:
            where: the connector, as the beginning of the error message.

        Raises:
            ValueError, TypeError: which number breaks which rule, and where.
        """
        where, turns = f"{where}, {type(self).__name__}", False
        if not self.whole:
            axis: Any = self.axis  # type: ignore[attr-defined]
            _check_axis(axis, where)
            turns = axis >= 3
        if getattr(self, "name", ""):
            check_identifier(self.name, where)  # type: ignore[attr-defined]
        # None is accepted only where it is the default, such as a limit that does not count.
        optional = {f.name for f in fields(self) if f.default is None}
        for name, rule in self.rules.items():
            value = getattr(self, name)
            if value is not None or name not in optional:
                unit = _FOR_ROTATION.get(rule.unit, rule.unit) if turns else rule.unit
                _check_number(f"{where}, {name}", value, rule._replace(unit=unit))
        _check_smoothing(getattr(self, "smoothing", 0.0), f"{where}, smoothing")
        self._check(where)

    def _check(self, where: str) -> None:
        """Check the rules that are particular to one effect."""

    @property
    def structure(self) -> tuple[Any, ...]:
        """Everything but the numbers: effects for which it is equal share their code."""
        own = [
            # Of a number only its absence matters: whether a static coefficient or a limit is given
            # decides which expressions there are.
            getattr(self, f.name) is None if f.name in self.rules else getattr(self, f.name)
            for f in fields(self)
        ]
        return (type(self), *own)

    @property
    def column(self) -> ca.SX:
        """Column of its numbers, in the order of `rules`, without those that are None."""
        values = (getattr(self, name) for name in self.rules)
        return ca.vertcat(_EMPTY, *(to_expr(v) for v in values if v is not None))

    @property
    def leaves(self) -> frozenset[Leaf]:
        """Every Param, Input and TIME in its numbers."""
        return frozenset().union(*(leaves_of(getattr(self, name)) for name in self.rules))

    def bound(self, column: ca.SX) -> Any:
        """Return a copy whose numbers are the entries of `column`, in the order of `rules`."""
        twin, i = copy.copy(self), 0
        for name in self.rules:
            if getattr(self, name) is not None:
                # Subclasses are frozen dataclasses; the copy is not shared yet, so changing it is
                # safe.
                object.__setattr__(twin, name, column[i])
                i += 1
        return twin

    @property
    def text(self) -> str:
        """Text that determines the effect completely, for the digest of a model."""
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
    """Return a number, or the value of an expression with every symbol at its default."""
    symbolic = isinstance(value, Scalar)
    return float(at_default(np.array(value, dtype=object)) if symbolic else value)


def _check_axis(axis: Any, where: str) -> None:
    whole = isinstance(axis, (int, np.integer)) and not isinstance(axis, bool)
    if not (whole and 0 <= axis < 6):
        raise ValueError(
            f"{where}: axis {axis!r}; give 0, 1, 2 for translation along the joint's x, y, z, or "
            "3, 4, 5 for rotation"
        )


def _check_smoothing(value: Any, where: str) -> None:
    if not is_number(value) or isinstance(value, Scalar):
        raise TypeError(f"{where}: {value!r} is {type(value).__name__}; give a plain number")
    if not 0 <= value < np.inf:
        raise ValueError(
            f"{where}: {value!r}; give 0, for the form with events, or a positive width"
        )
