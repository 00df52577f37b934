"""Checks of options and models shared by the integrators, and verdicts on CasADi's own methods."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.model import Model
from ..model.trajectory import Outcome
from ..model.values import Experiment
from .driver import Run, Verdict


def check_options(integrator: Any) -> None:
    """Check that tolerances and steps of an integrator are positive numbers.

    Attributes that the integrator does not have are skipped; `max_step` and `first_step` may be
    None.

    Arguments:
        integrator: with some of rtol, atol, max_steps, max_step, first_step and safety.

    Raises:
        ValueError: one is out of range; the message names it with its value and range.
    """
    where = type(integrator).__name__
    tops = {
        "rtol": 1.0,
        "atol": math.inf,
        "max_steps": math.inf,
        "max_step": math.inf,
        "first_step": math.inf,
        "safety": math.inf,
    }
    for name, top in tops.items():
        optional = name in ("max_step", "first_step")
        if not hasattr(integrator, name) or (optional and getattr(integrator, name) is None):
            continue
        value = getattr(integrator, name)
        whole = name != "max_steps" or isinstance(value, int)
        if not (isinstance(value, (int, float)) and 0 < value < top and whole):
            kind = "whole number above 0" if name == "max_steps" else f"number in 0 ... {top}"
            raise ValueError(f"{where}: {name} {value!r}; give a {kind}")


def refuse_unknowns(model: Model) -> None:
    """Check that a model has no algebraic unknowns, for explicit methods, which integrate ODEs.

    Raises:
        ValueError: it has.
    """
    if model.n_z:
        raise ValueError(
            f"model '{model.name}': {model.n_z} algebraic unknowns; an explicit method "
            "integrates ODEs only; use Idas() or Rosenbrock()"
        )


def refuse_updates(model: Model, method: str) -> None:
    """Check that a model has no post-Newton steps, for methods that cannot interrupt for them.

    Arguments:
        method: name of the class, for the message.

    Raises:
        ValueError: it has one.
    """
    if model.dae.updates:
        raise ValueError(
            f"model '{model.name}': post_newton_step, which {method} does not support; use "
            "GeneralizedAlpha(step) or Idas()"
        )


def refuse_events(model: Model, method: str) -> None:
    """Check that a model has neither events nor post-Newton steps, for methods with fixed steps.

    Arguments:
        method: name of the class, for the message.

    Raises:
        ValueError: it has.
    """
    if model.events or model.dae.updates:
        what = "events" if model.events else "post_newton_step"
        raise ValueError(
            f"model '{model.name}': {what}, which {method} does not support; use Idas(), "
            "GeneralizedAlpha(step), or effects with smoothing"
        )


def check_fixed_step(integrator: Any) -> None:
    """Check that the step of an integrator is a positive number.

    Raises:
        ValueError: it is not.
    """
    step = integrator.step
    if not (isinstance(step, (int, float)) and 0 < step < math.inf):
        raise ValueError(
            f"{type(integrator).__name__}: step {step!r} s; give a positive, finite step"
        )


def elements_of(experiment: Experiment, step: float) -> int:
    """Return CasADi's `number_of_finite_elements` such that no step is longer than asked for.

    Arguments:
        experiment: with its output times, between which the steps are equal.
        step: longest step, s.
    """
    intervals, span = np.diff(experiment.t), float(experiment.t[-1] - experiment.t[0])
    most = max(1, math.ceil(float(intervals.max()) / step * (1 - 1e-9)))
    # CasADi divides each interval into ceil(interval / span * number) steps. With equal intervals,
    # a number one less than the true one keeps rounding from adding a step to some of them.
    if len(intervals) > 1 and np.ptp(intervals) <= 1e-9 * intervals[0]:
        return most * len(intervals) - 1
    return max(1, math.ceil(span / step * (1 - 1e-9)))


def runge_kutta_options(integrator: Any) -> dict[str, Any]:
    """Return CasADi's options of an adaptive one-step method, without the tolerances.

    Arguments:
        integrator: with max_steps, max_step (s) and options, which take precedence.
    """
    options: dict[str, Any] = {"max_num_steps": integrator.max_steps}
    if integrator.max_step:
        options["max_step_size"] = integrator.max_step
    return options | dict(integrator.options)


def judge_runge_kutta(result: Run, max_steps: int) -> Verdict:
    """Return the verdict on a failed run of CasADi's adaptive one-step methods.

    Arguments:
        max_steps: the limit of steps that the run was given.
    """
    if result.stats.get("n_steps", 0) >= max_steps:
        return Verdict(
            Outcome.too_many_steps,
            None,
            "raise max_steps, loosen the tolerances, or for stiff "
            "connectors use Idas() or Rosenbrock()",
        )
    return Verdict(
        Outcome.step_too_small,
        None,
        "check for a singularity or a discontinuity there, or loosen the tolerances",
    )
