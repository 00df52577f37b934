"""Impact: a rigid stop that reverses the velocity, by Newton's coefficient of restitution."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from .effect import Answer, Change, Effect, Own, Rule, Sight, value_at_default


@dataclass(frozen=True, eq=False)
class Impact(Effect):
    """Rigid stop along one axis that reverses the velocity, with a coefficient of restitution.

        rs.RigidBodySpringDamper("floor", rs.Marker(rs.GROUND), rs.Marker("ball"), 0,
                                 effects=[rs.Impact(2, restitution=0.8)])

    Picture: a hard floor. Once the clearance gap + side strain is used up and the bodies approach,
    the velocity along the axis is reversed in an instant.

    Free bodies: an impulse of (1 + e) |v-| times the effective mass acts on both markers as a force
    would, through the law of the connector; rotations and the other directions change according to
    the inertias. Both bodies need inertia, unless one is the ground.

        v+ = -e v-,   loss = (1 - e^2) v-^2 / 2 times the effective mass

    The loss (J) is added to the data state `lost`.

    Choosing numbers: e is the square root of the rebound height over the drop height.

    Limits: a body that comes to rest would bounce infinitely often in finite time; the run then
    ends with its outcome. Use `Contact` for bodies that come to rest. A start beyond the stop with
    approaching bodies is an impact at once.

    Arguments:
        axis: 0, 1, 2 for translation along x, y, z of the joint frame; 3, 4, 5 for rotation.
        restitution: e, 0 ... 1.
        gap: clearance at zero strain, m or rad.
        side: +1 if the stop is at negative strain (a floor), -1 if at positive strain (a ceiling).
        name: label within the connector; by default impact_<axis>.
    """

    axis: int
    restitution: Any
    gap: Any = 0.0
    side: int = 1
    name: str = ""
    rules: ClassVar[Mapping[str, Rule]] = {"restitution": Rule(""), "gap": Rule("m", signed=True)}

    def _check(self, where: str) -> None:
        if self.side not in (1, -1):
            raise ValueError(f"{where}: side {self.side!r}; give +1 (a floor) or -1 (a ceiling)")
        restitution = value_at_default(self.restitution)
        if restitution > 1:
            raise ValueError(
                f"{where}, restitution: {restitution:g}; at most 1, which loses no energy; lower it"
            )

    @property
    def own(self) -> tuple[Own, ...]:
        """The energy lost in impacts, J."""
        return (Own("lost", "J", data=True),)

    @property
    def impulsive(self) -> bool:
        """True: it applies impulses."""
        return True

    def answer(self, sight: Sight) -> Answer:
        """Return no force, and the event that applies the impulse."""
        e, gives = self.restitution, sight.gives()
        # Only approaching bodies collide; if the rate already points away, as it may after another
        # event at the same instant, the impulse is zero.
        approach = self.side * ca.fmin(self.side * sight.rate, 0)
        lost = sight.own[0] + (1 - e * e) * approach**2 / (2 * gives)
        clearance = self.gap + self.side * sight.strain
        hits = Change("hits", clearance, lost, (1 + e) * approach / gives, at_once=True)
        return Answer(rates=ca.SX(0), changes=(hits,))
