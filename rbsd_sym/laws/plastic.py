"""Elastoplasticity along one axis, with kinematic and isotropic hardening."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from .effect import Answer, Change, Effect, Own, Rule, Sight
from .smooth import ramp

# Excess, relative to the yield force, that counts as rounding just after a reversal.
_ROUNDING = 1e-12
# Relative excess over which smooth yielding sets in.
_WIDTH = 1e-2


@dataclass(frozen=True, eq=False)
class Plastic(Effect):
    """Elastic-plastic spring along one axis, with kinematic and isotropic hardening.

        effects=[rs.Plastic(0, stiffness=1e6, yield_force=500, kinematic=1e5)]

    Picture: a spring in series with a slider that hardens.

    Free bodies: f acts along the axis on both markers, with the sign of the spring force.

        f = k (u - p),   |f - H p| <= F_y + I s,   s' = |p'|

    p is the plastic strain, s its accumulated length. The form with events keeps both as data
    states, `plastic` and `length`, which hold the history up to the last reversal. The force comes
    from the return mapping [Simo, Hughes 1998, ch. 1] from there, which is exact as long as the
    motion does not reverse. Only the event at which yielding ends updates the history; the event at
    which it begins changes nothing.

    Choosing numbers: F_y is the force at the end of the linear range; beyond it the slope is k
    (H + I) / (k + H + I).

    Limits: one axis, without interaction of directions; no fracture (add `Fracture`), no rate
    dependence unless smoothed.

    Arguments:
        axis: 0, 1, 2 for translation along x, y, z of the joint frame; 3, 4, 5 for rotation.
        stiffness, yield_force: k (N/m) and F_y (N), or N m/rad and N m.
        kinematic, isotropic: hardening moduli H and I, in the unit of the stiffness.
        smoothing: 0 for the form with events. Otherwise the viscosity c (N s/m) of viscoplastic
            flow [Perzyna 1966], C2: p' = ramp(|f - H p| - F_y - I s) / c, with p and s as internal
            states. The force exceeds the yield force by c |p'|, and yielding sets in over 1 % of
            F_y.
        name: label within the connector; by default plastic_<axis>.
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
        """Plastic strain (m or rad) and its accumulated length."""
        unit, data = "rad" if self.axis > 2 else "m", not self.smoothing
        return Own("plastic", unit, data=data), Own("length", unit, data=data)

    def answer(self, sight: Sight) -> Answer:
        """Return the force, by return mapping or viscoplastic flow, and the events of yielding."""
        k, hardening, u = self.stiffness, self.kinematic, sight.strain
        p, s = sight.own[0], sight.own[1]
        reduced = k * (u - p) - hardening * p
        side, excess = ca.sign(reduced), ca.fabs(reduced) - self.yield_force - self.isotropic * s
        if self.smoothing:
            flow = ramp(excess, _WIDTH * self.yield_force) / self.smoothing
            lost = (ca.fabs(reduced) - self.isotropic * s) * flow
            return self._answer(u, p, s, lost, ca.vertcat(side * flow, flow))
        # Return mapping in one dimension: the trial force exceeds the yield limit by `excess`, and
        # a plastic strain of excess / (k + H + I) takes it back to the limit.
        total = k + hardening + self.isotropic
        slip = ca.fmax(excess, 0) / total
        flows = excess > _ROUNDING * self.yield_force
        # Of the plastic power f p' the hardening stores all but F_y |p'|, and p' = k
        # u' / (k + H + I).
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
