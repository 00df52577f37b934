"""Maxwell branch: a spring and a damper in series, beside the connector's own spring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from .effect import Answer, Effect, Own, Rule, Sight


@dataclass(frozen=True, eq=False)
class Maxwell(Effect):
    """One branch of a viscoelastic material [Christensen 1982, ch. 1]; several make a spectrum.

        f' = k u' - f k / c

    The internal state `force` f starts at 0: the branch is relaxed. In steady vibration at w it
    adds the stiffness k i w T / (1 + i w T), T = c / k.

    Arguments:
        axis: 0, 1, 2 for translation along the joint's x, y, z, 3, 4, 5 for rotation.
        stiffness, damping: k (N/m) and c (N s/m), or N m/rad and N m s/rad.
    """

    axis: int
    stiffness: Any
    damping: Any
    name: str = ""
    rules: ClassVar[Mapping[str, Rule]] = {
        "stiffness": Rule("N/m", positive=True),
        "damping": Rule("N s/m", positive=True),
    }

    @property
    def own(self) -> tuple[Own, ...]:
        """The force of the branch."""
        return (Own("force", "N m" if self.axis > 2 else "N"),)

    def answer(self, sight: Sight) -> Answer:
        """Force, energy in the spring, loss in the damper."""
        f = sight.own[0]
        rate = self.stiffness * (sight.rate - f / self.damping)
        return Answer(f, f * f / (2 * self.stiffness), f * f / self.damping, rate)
