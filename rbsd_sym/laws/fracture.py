"""Fracture: a connector that breaks at a load limit and stays broken."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, ClassVar

import casadi as ca

from .effect import Answer, Change, Effect, Own, Rule, Sight
from .smooth import ramp

# Keeps derivatives of a norm finite at zero.
_TINY = 1e-300
# Relative excess over which smooth damage sets in.
_WIDTH = 1e-2


@dataclass(frozen=True, eq=False)
class Fracture(Effect):
    """Fracture: the whole wrench of the connector vanishes for good once a limit is reached.

        effects=[rs.Fracture(force=2e3)]

    Picture: a bolt. The spring-damper (or user force) and the effects listed before this one break
    together.

    Free bodies: afterwards neither marker receives a wrench from them.

    The limits apply to the magnitude of the force, the magnitude of the torque and the stored
    energy, whichever is reached first; limits that are not given do not count. The form with events
    has the data states `broken` (0 or 1) and `lost`, the energy (J) stored at that moment.

    Choosing numbers: a force limit is the strength of the material times the cross-section.

    Limits: forces of dampers count towards the load. An energy limit needs a potential, so it does
    not go with a user force.

    Arguments:
        force, torque, energy: limits in N, N m and J; at least one.
        smoothing: 0 for the form with events. Otherwise the time T (s) of damage that grows beyond
            the limit, C2: D' = (1 - D) ramp(load / limit - 1) / T, and 1 - D of the wrench remains.
            It breaks late, by about T over the relative excess.
        name: label within the connector; by default fracture.
    """

    force: Any = None
    torque: Any = None
    energy: Any = None
    smoothing: float = 0.0
    name: str = ""
    whole: ClassVar[bool] = True
    rules: ClassVar[Mapping[str, Rule]] = {
        "force": Rule("N", positive=True),
        "torque": Rule("N m", positive=True),
        "energy": Rule("J", positive=True),
    }

    def _check(self, where: str) -> None:
        if self.force is None and self.torque is None and self.energy is None:
            raise ValueError(f"{where}: no limit; give a force, a torque or an energy")

    @property
    def own(self) -> tuple[Own, ...]:
        """With events `broken` and `lost`; with smoothing `damage`."""
        if self.smoothing:
            return (Own("damage"),)
        return Own("broken", data=True), Own("lost", "J", data=True)

    @property
    def needs_potential(self) -> bool:
        """Whether there is an energy limit."""
        return self.energy is not None

    def answer(self, sight: Sight) -> Answer:
        """Return which fraction of the wrench remains, and the event that breaks it."""
        load = self._load(sight)
        if self.smoothing:
            rate = (1 - sight.own[0]) * ramp(load - 1, _WIDTH) / self.smoothing
            return Answer(dissipated=rate * sight.energy, rates=rate, factor=1 - sight.own[0])
        broken, lost = sight.own[0] > 0.5, sight.own[1]
        breaks = Change(
            "breaks",
            ca.if_else(broken, 1, 1 - load),
            ca.vertcat(1, lost + sight.energy),
            at_once=True,
        )
        return Answer(rates=ca.SX.zeros(2), changes=(breaks,), factor=1 - broken)

    def _load(self, sight: Sight) -> ca.SX:
        """Return the load over its limit, the largest of those given."""
        loads = []
        for part, limit in ((sight.force[:3], self.force), (sight.force[3:], self.torque)):
            if limit is not None:
                loads.append(ca.sqrt(ca.dot(part, part) + _TINY) / limit)
        if self.energy is not None:
            loads.append(sight.energy / self.energy)
        return reduce(ca.fmax, loads)
