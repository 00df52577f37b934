"""Collocation with fixed steps: the implicit Runge-Kutta methods Gauss-Legendre and Radau IIA."""

from __future__ import annotations

from dataclasses import dataclass

from ..model.model import Model
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import Run, Verdict, run
from .options import check_fixed_step, elements_of, refuse_events

_MOST_STAGES = 9  # CasADi has tables of collocation points up to here
# Newton's last correction in SI units: below it, rounding in stiff joints (1e6 N/m on coordinates
# of 1 m) never ends; convergence is quadratic, so that it leaves no error of its own.
_NEWTON = 1e-11


@dataclass(frozen=True)
class Collocation:
    """Fixed steps of a collocation method, solved by Newton's method with exact Jacobians.

    `radau` has order 2 degree - 1 and damps what is much faster than the step (L-stable);
    `legendre` has order 2 degree, is symmetric and keeps quadratic invariants [Hairer, Wanner 1996,
    sec. IV.5; Hairer, Lubich, Wanner 2006, sec. IV.2].

    Arguments:
        step: s; intervals between output times are cut into equal steps not longer than this.
        degree: stages, 1 ... 9.
        scheme: "radau" or "legendre".
    """

    step: float
    degree: int = 3
    scheme: str = "radau"

    def __post_init__(self) -> None:
        check_fixed_step(self)
        if self.degree not in range(1, _MOST_STAGES + 1):
            raise ValueError(f"Collocation: degree {self.degree!r}; it is 1 ... {_MOST_STAGES}")
        if self.scheme not in ("radau", "legendre"):
            raise ValueError(f"Collocation: scheme {self.scheme!r}; it is 'radau' or 'legendre'")

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate; a failure is a `Trajectory` up to it with its `Outcome`.

        Raises:
            ValueError: the model has events.
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
    advice = "Newton's method found no end of a step; take shorter steps"
    return Verdict(Outcome.solver_failed, None, advice)
