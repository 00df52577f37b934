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
    """The classical explicit Runge-Kutta method of order 4, with fixed steps.

    For models that are not stiff: without damping it is unstable where the step times the angular
    frequency exceeds 2.83. Algebraic unknowns and events are not supported, and the error is not
    controlled: repeat the run with half the step to see it.

    Arguments:
        step: s; intervals between output times are divided into equal steps, not longer than this.

    Raises:
        ValueError: a step that is not positive and finite.

    >>> simulate(model, 2.0, RK4(1e-3))  # doctest: +SKIP
    """

    step: float

    def __post_init__(self) -> None:
        check_fixed_step(self)

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate an experiment.

        Returns:
            The trajectory, up to the first value that is not finite.

        Raises:
            ValueError: the model has algebraic unknowns, events or post-Newton steps.
        """
        refuse_unknowns(model)
        refuse_events(model, type(self).__name__)
        options = {"number_of_finite_elements": elements_of(experiment, self.step)}
        return run(model, experiment, "rk", options, _judge, {})


def _judge(result: Run) -> Verdict:
    return Verdict(Outcome.not_finite, None, "give a shorter step")
