"""CasADi's explicit Runge-Kutta pair of order 5(4) for ODEs that are not stiff."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from ..model.model import Model
from ..model.trajectory import Trajectory
from ..model.values import Experiment
from .casadi_run import run_with_events
from .driver import run
from .options import (
    check_options,
    judge_runge_kutta,
    refuse_unknowns,
    refuse_updates,
    runge_kutta_options,
)


@dataclass(frozen=True)
class ExplicitRK:
    """Explicit, adaptive, dense output of order 4; the step is bound by the stiffest connector.

    Arguments:
        rtol, atol: relative and absolute local error of each state.
        max_steps: within one output interval.
        max_step: s; None leaves it free.
        options: more of CasADi's options for the plugin, by their names.
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    max_steps: int = 1_000_000
    max_step: float | None = None
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    plugin: ClassVar[str] = "erk"
    solves_algebraic: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def casadi_options(self) -> Mapping[str, Any]:
        """Options of the plugin, without the tolerances."""
        return runge_kutta_options(self)

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate; a failure is a `Trajectory` up to it with its `Outcome`.

        Raises:
            ValueError: the model has algebraic unknowns or post-Newton steps.
        """
        refuse_unknowns(model)
        refuse_updates(model, type(self).__name__)
        options = {"reltol": self.rtol, "abstol": self.atol, **self.casadi_options}
        count = {"steps": "n_steps", "evaluations": "n_rhs", "rejected_steps": "n_reject"}
        judge = lambda result: judge_runge_kutta(result, self.max_steps)  # noqa: E731
        solve = run_with_events if model.dae.events else run
        return solve(model, experiment, self.plugin, options, judge, count)
