"""The classical Runge-Kutta method of order 4 with fixed steps."""

from __future__ import annotations

from dataclasses import dataclass

from ..model.model import Model
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import Run, Verdict, run
from .options import check_fixed_step, elements_of, refuse_events, refuse_unknowns


@dataclass(frozen=True)
class RK4:
    """Fixed steps; unstable where step times frequency exceeds 2.83 without damping.

    Arguments:
        step: s; intervals between output times are cut into equal steps not longer than this.
    """

    step: float

    def __post_init__(self) -> None:
        check_fixed_step(self)

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate; values that are not finite end the `Trajectory` there.

        Raises:
            ValueError: the model has algebraic unknowns, or events.
        """
        refuse_unknowns(model)
        refuse_events(model, type(self).__name__)
        options = {"number_of_finite_elements": elements_of(experiment, self.step)}
        return run(model, experiment, "rk", options, _judge, {})


def _judge(result: Run) -> Verdict:
    return Verdict(Outcome.not_finite, None, "take shorter steps")
