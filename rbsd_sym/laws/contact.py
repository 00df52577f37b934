"""Unilateral contact along one axis, and stops at both ends of a way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from ..base.symbols import is_number
from .effect import Answer, Change, Effect, Own, Rule, Sight, value_at_default
from .smooth import ramp, ramp_integral, step_over_ramp

_RELEASE = 0.1  # relative width in which damping stops short of pulling


@dataclass(frozen=True, eq=False)
class Contact(Effect):
    """Spring and damper that push and never pull.

    Picture: a stop stands `gap` away on one side. The depth is d = -gap - side strain, the push
    N = k d + c d' while d > 0 and N > 0, else 0; the force along the axis is -side N.

    Arguments:
        axis: 0, 1, 2 for translation along the joint's x, y, z, 3, 4, 5 for rotation.
        stiffness, damping: N/m and N s/m (or N m/rad, N m s/rad).
        gap: clearance at zero strain (m or rad).
        side: +1 if the stop is at negative strain (a floor), -1 if at positive.
        smoothing: 0 for the form with events, which has the states `closed` and `lost`, the energy
            (J) that the spring still held when it let go. Else the depth (m or rad) in which the
            push sets in, C2, with an error of at most 3/16 k smoothing, and the damper with one of
            at most c |d'|; damping reduces the push to no less than 0, with an error of at most 2 %
            of k d, near zero push only, which does not vanish with the smoothing.

    Source: closed forms of drop and release [Schwager, Poeschel 2007].
    """

    axis: int
    stiffness: Any
    damping: Any = 0.0
    gap: Any = 0.0
    side: int = 1
    smoothing: float = 0.0
    name: str = ""
    rules: ClassVar[Mapping[str, Rule]] = {
        "stiffness": Rule("N/m", positive=True),
        "damping": Rule("N s/m"),
        "gap": Rule("m", signed=True),
    }

    def _check(self, where: str) -> None:
        if self.side not in (1, -1):
            raise ValueError(f"{where}: side {self.side!r}; it is +1 (a floor) or -1 (a ceiling)")

    @property
    def own(self) -> tuple[Own, ...]:
        """Whether it touches, and the energy it let go."""
        return () if self.smoothing else (Own("closed", data=True), Own("lost", "J", data=True))

    def answer(self, sight: Sight) -> Answer:
        """The push, and its opening and closing."""
        depth, speed = -self.gap - self.side * sight.strain, -self.side * sight.rate
        if self.smoothing:
            return self._smooth(depth, speed)
        closed, lost = sight.own[0] > 0.5, sight.own[1]
        spread = depth + self.damping / self.stiffness * speed  # N / k, in the unit of the depth
        push, stored = self.stiffness * spread, self.stiffness * depth**2 / 2
        touch = ca.if_else(closed, 1, -ca.fmin(depth, spread))
        leave = ca.if_else(closed, spread, 1)
        changes = (
            Change(
                "closes",
                touch,
                ca.vertcat(1, lost - ca.fmax(depth, 0) * depth * self.stiffness / 2),
                at_once=True,
            ),
            Change("opens", leave, ca.vertcat(0, lost + stored), at_once=True),
        )
        return Answer(
            -self.side * closed * push,
            closed * stored,
            closed * self.damping * speed**2,
            ca.SX.zeros(2),
            changes,
        )

    def _smooth(self, depth: ca.SX, speed: ca.SX) -> Answer:
        w = self.smoothing
        spring = self.stiffness * ramp(depth, w)
        ratio = self.damping / self.stiffness * speed * step_over_ramp(depth, w)
        damper = spring * (ramp(1 + ratio, _RELEASE) - 1)
        return Answer(
            -self.side * (spring + damper), self.stiffness * ramp_integral(depth, w), damper * speed
        )


def stops(
    axis: int,
    lower: Any,
    upper: Any,
    stiffness: Any,
    damping: Any = 0.0,
    smoothing: float = 0.0,
    name: str = "stop",
) -> tuple[Contact, Contact]:
    """Limit stops: contacts at the strains `lower` and `upper` (m or rad), as two effects.

    Raises:
        ValueError: the lower end is not below the upper one.
    """
    for title, value in (("lower", lower), ("upper", upper)):
        if not is_number(value):
            raise TypeError(f"stops: {title} {value!r}; give a number, a Param or an expression")
    if value_at_default(lower) >= value_at_default(upper):
        raise ValueError(
            f"stops: lower {lower} is not below upper {upper}; exchange them, or set them apart"
        )
    return (
        Contact(axis, stiffness, damping, -lower, 1, smoothing, f"{name}_lower"),
        Contact(axis, stiffness, damping, upper, -1, smoothing, f"{name}_upper"),
    )
