"""Collocation with fixed steps: the implicit Runge-Kutta methods Gauss-Legendre and Radau IIA."""

from __future__ import annotations

from dataclasses import dataclass

from ..model.model import Model
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import Run, Verdict, run
from .options import check_fixed_step, elements_of, refuse_events

# CasADi has tables of collocation points up to this number.
_MOST_STAGES = 9
# Last Newton correction, SI units. A smaller bound is never met in stiff joints (1e6 N/m on
# coordinates of 1 m), for rounding; since convergence is quadratic, the error left is far smaller.
_NEWTON = 1e-11


@dataclass(frozen=True)
class Collocation:
    """Collocation with fixed steps: the implicit Runge-Kutta methods Radau IIA and Gauss-Legendre.

    Each step is solved by Newton's method with exact Jacobians. "radau" has order 2 degree - 1 and
    damps motion that is much faster than the step (L-stable); "legendre" has order 2 degree, is
    symmetric and preserves quadratic invariants [Hairer, Wanner 1996, sec. IV.5; Hairer, Lubich,
    Wanner 2006, sec. IV.2]. Algebraic unknowns are solved for, events are not supported, and the
    error is not controlled: repeat the run with half the step to see it.

    Arguments:
        step: s; intervals between output times are divided into equal steps, not longer than this.
        degree: number of stages, 1 ... 9.
        scheme: "radau" or "legendre".

    Raises:
        ValueError: an argument out of its range.

    >>> simulate(model, 2.0, Collocation(0.01, degree=3))  # doctest: +SKIP
    """

    step: float
    degree: int = 3
    scheme: str = "radau"

    def __post_init__(self) -> None:
        check_fixed_step(self)
        if self.degree not in range(1, _MOST_STAGES + 1):
            raise ValueError(f"Collocation: degree {self.degree!r}; give 1 ... {_MOST_STAGES}")
        if self.scheme not in ("radau", "legendre"):
            raise ValueError(f"Collocation: scheme {self.scheme!r}; give 'radau' or 'legendre'")

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate an experiment.

        Returns:
            The trajectory, up to the failure if there was one, which is its `outcome`.

        Raises:
            ValueError: the model has events or post-Newton steps.
        """
        refuse_events(model, type(self).__name__)
        options = {
            "number_of_finite_elements": elements_of(experiment, self.step),
            "interpolation_order": self.degree,
            "collocation_scheme": self.scheme,
            "simplify": False,
            "rootfinder": "fast_newton",
            "rootfinder_options": {"abstol": 0, "abstolStep": _NEWTON, "max_iter": 50},
        }
        return run(model, experiment, "collocation", options, _judge, {})


def _judge(result: Run) -> Verdict:
    advice = "Newton's method did not converge in a step; give a shorter step"
    return Verdict(Outcome.solver_failed, None, advice)
