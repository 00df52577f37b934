"""Maxwell branch: a spring and a damper in series, parallel to the connector's own spring."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from .effect import Answer, Effect, Own, Rule, Sight


@dataclass(frozen=True, eq=False)
class Maxwell(Effect):
    """One Maxwell branch of a viscoelastic material [Christensen 1982, ch. 1].

        effects=[rs.Maxwell(2, 2e4, 50), rs.Maxwell(2, 1e4, 500, name="slow")]

    Picture: a spring and a damper in series, parallel to the spring-damper of the connector.
    Several branches make a relaxation spectrum.

    Free bodies: f acts along the axis on both markers, with the sign of the spring force.

        f' = k u' - f k / c

    The internal state `force` f starts at 0: the branch is relaxed.

    Choosing numbers: the branch relaxes with the time constant T = c / k. In steady vibration at
    the circular frequency w it adds the complex stiffness k i w T / (1 + i w T): for w far above
    1 / T the stiffness k, far below it the damper c. Fit k and T of the branches to a measured
    relaxation curve.

    Limits: linear; T much shorter than the times of interest makes the equations stiff, and a plain
    damper does the same.

    Arguments:
        axis: 0, 1, 2 for translation along x, y, z of the joint frame; 3, 4, 5 for rotation.
        stiffness, damping: k (N/m) and c (N s/m), or N m/rad and N m s/rad.
        name: label within the connector; by default maxwell_<axis>.
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
        """The force of the branch, N or N m."""
        return (Own("force", "N m" if self.axis > 2 else "N"),)

    def answer(self, sight: Sight) -> Answer:
        """Return the force, the energy in the spring and the loss in the damper."""
        f = sight.own[0]
        rate = self.stiffness * (sight.rate - f / self.damping)
        return Answer(f, f * f / (2 * self.stiffness), f * f / self.damping, rate)
