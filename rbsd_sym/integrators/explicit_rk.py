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
    """CasADi's explicit Runge-Kutta pair of order 5(4), with adaptive steps.

    For models that are not stiff: the stiffest connector limits its steps. It has dense output of
    order 4 and locates events; `export_simulator` writes it to C.

    Limits: algebraic unknowns and post-Newton steps are not supported, and events are noticed only
    where their function changes from + to - over a step.

    Arguments:
        rtol, atol: relative and absolute local error of each state (SI units).
        max_steps: within one output interval.
        max_step: s; None sets no limit.
        options: more of CasADi's options for the plugin, by their names; they take precedence.

    Raises:
        ValueError: an option out of its range.

    >>> simulate(model, 2.0, ExplicitRK(rtol=1e-6, atol=1e-8))  # doctest: +SKIP
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
        """CasADi's options for the plugin, without the tolerances."""
        return runge_kutta_options(self)

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate an experiment.

        Returns:
            The trajectory, up to the failure if there was one, which is its `outcome`.

        Raises:
            ValueError: the model has algebraic unknowns or post-Newton steps, or a user's input
                function raised an error.
        """
        refuse_unknowns(model)
        refuse_updates(model, type(self).__name__)
        options = {"reltol": self.rtol, "abstol": self.atol, **self.casadi_options}
        count = {"steps": "n_steps", "evaluations": "n_rhs", "rejected_steps": "n_reject"}
        judge = lambda result: judge_runge_kutta(result, self.max_steps)  # noqa: E731
        solve = run_with_events if model.dae.events else run
        return solve(model, experiment, self.plugin, options, judge, count)
