"""Impact: a stop that throws back at once, by Newton's coefficient of restitution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from .effect import Answer, Change, Effect, Own, Rule, Sight, value_at_default


@dataclass(frozen=True, eq=False)
class Impact(Effect):
    """Where the clearance is used up, the velocity along the axis turns round: v+ = -e v-.

    Picture: a hard floor. The impulse goes to both bodies through the law, as a force would, so
    that turns and other directions follow from the inertias. Its energy loss, (1 - e^2) v^2 / 2
    times the effective mass, is added to the state `lost` (J). A start beyond the stop that
    approaches is thrown back at once. A body that comes to rest bounces without end in finite time;
    the run then ends with its outcome. For what rests use `Contact`.

    Arguments:
        axis: 0, 1, 2 for translation along the joint's x, y, z, 3, 4, 5 for rotation.
        restitution: e, 0 ... 1.
        gap: clearance at zero strain (m or rad).
        side: +1 if the stop is at negative strain (a floor), -1 if at positive.
    """

    axis: int
    restitution: Any
    gap: Any = 0.0
    side: int = 1
    name: str = ""
    rules: ClassVar[Mapping[str, Rule]] = {"restitution": Rule(""), "gap": Rule("m", signed=True)}

    def _check(self, where: str) -> None:
        if self.side not in (1, -1):
            raise ValueError(f"{where}: side {self.side!r}; it is +1 (a floor) or -1 (a ceiling)")
        restitution = value_at_default(self.restitution)
        if restitution > 1:
            raise ValueError(
                f"{where}, restitution: {restitution:g}; at most 1, which loses no energy"
            )

    @property
    def own(self) -> tuple[Own, ...]:
        """The energy lost."""
        return (Own("lost", "J", data=True),)

    @property
    def impulsive(self) -> bool:
        """It throws."""
        return True

    def answer(self, sight: Sight) -> Answer:
        """No force; the impulse."""
        e, gives = self.restitution, sight.gives()
        approach = self.side * ca.fmin(self.side * sight.rate, 0)
        lost = sight.own[0] + (1 - e * e) * approach**2 / (2 * gives)
        clearance = self.gap + self.side * sight.strain
        hits = Change("hits", clearance, lost, (1 + e) * approach / gives, at_once=True)
        return Answer(rates=ca.SX(0), changes=(hits,))
