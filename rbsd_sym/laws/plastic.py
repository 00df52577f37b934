"""Elastoplasticity with kinematic and isotropic hardening along one axis."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from .effect import Answer, Change, Effect, Own, Rule, Sight
from .smooth import ramp

_NOISE = 1e-12  # of the yield force: rounding of what yielding has just left
_WIDTH = 1e-2  # of the yield force, in which smooth yielding sets in


@dataclass(frozen=True, eq=False)
class Plastic(Effect):
    """Spring in series with a slider that hardens.

        f = k (u - p),   |f - H p| <= F_y + I s,   s' = |p'|

    The form with events keeps p and s as data states, `plastic` and `length`, which hold the
    history up to the last reversal: the force is that of the return mapping [Simo, Hughes 1998, ch.
    1] from there, exact for any way that does not turn back, and only the event at which yielding
    ends writes the history. Yielding sets in at another event, without a change.

    Arguments:
        axis: 0, 1, 2 for translation along the joint's x, y, z, 3, 4, 5 for rotation.
        stiffness, yield_force: k (N/m) and F_y (N), or N m/rad and N m.
        kinematic, isotropic: H and I, in the unit of the stiffness.
        smoothing: 0 for the form with events. Else the viscosity c (N s/m) of viscoplastic flow
            [Perzyna 1966], C2: p' = ramp(|f - H p| - F_y - I s) / c with p and s as internal
            states. Its force exceeds the yield force by c |p'|, and yielding sets in over 1 % of
            F_y.
    """

    axis: int
    stiffness: Any
    yield_force: Any
    kinematic: Any = 0.0
    isotropic: Any = 0.0
    smoothing: float = 0.0
    name: str = ""
    rules: ClassVar[Mapping[str, Rule]] = {
        "stiffness": Rule("N/m", positive=True),
        "yield_force": Rule("N", positive=True),
        "kinematic": Rule("N/m"),
        "isotropic": Rule("N/m"),
    }

    @property
    def own(self) -> tuple[Own, ...]:
        """Plastic strain and its length."""
        unit, data = "rad" if self.axis > 2 else "m", not self.smoothing
        return Own("plastic", unit, data=data), Own("length", unit, data=data)

    def answer(self, sight: Sight) -> Answer:
        """The force, by return mapping or viscoplastic."""
        k, hardening, u = self.stiffness, self.kinematic, sight.strain
        p, s = sight.own[0], sight.own[1]
        reduced = k * (u - p) - hardening * p
        side, excess = ca.sign(reduced), ca.fabs(reduced) - self.yield_force - self.isotropic * s
        if self.smoothing:
            flow = ramp(excess, _WIDTH * self.yield_force) / self.smoothing
            lost = (ca.fabs(reduced) - self.isotropic * s) * flow
            return self._answer(u, p, s, lost, ca.vertcat(side * flow, flow))
        total = k + hardening + self.isotropic
        slip = ca.fmax(excess, 0) / total
        flows = excess > _NOISE * self.yield_force
        lost = ca.if_else(excess > 0, self.yield_force * side * k * sight.rate / total, 0)
        p, s = p + side * slip, s + slip
        changes = (
            Change(
                "reverses", ca.if_else(flows, side * sight.rate, 1), ca.vertcat(p, s), at_once=True
            ),
            Change("yields", -excess, sight.own),
        )
        return self._answer(u, p, s, lost, ca.SX.zeros(2), changes)

    def _answer(
        self,
        u: ca.SX,
        p: ca.SX,
        s: ca.SX,
        lost: ca.SX,
        rates: ca.SX,
        changes: tuple[Change, ...] = (),
    ) -> Answer:
        energy = self.stiffness * (u - p) ** 2 + self.kinematic * p**2 + self.isotropic * s**2
        return Answer(self.stiffness * (u - p), energy / 2, lost, rates, changes)
