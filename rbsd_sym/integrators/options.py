"""Checks shared by the integrators, and the verdict on CasADi's own methods."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..model.model import Model
from ..model.trajectory import Outcome
from ..model.values import Experiment
from .driver import Run, Verdict


def check_options(integrator: Any) -> None:
    """Tolerances and steps of an integrator are positive numbers, where they are given.

    Raises:
        ValueError: they are not.
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
            raise ValueError(f"{where}: {name} {value!r}; it is a {kind}")


def refuse_unknowns(model: Model) -> None:
    """Explicit methods integrate ODEs.

    Raises:
        ValueError: the model has algebraic unknowns.
    """
    if model.n_z:
        raise ValueError(
            f"model '{model.name}': {model.n_z} algebraic unknowns; an explicit method "
            "integrates ODEs only; use Idas() or Rosenbrock()"
        )


def refuse_updates(model: Model, method: str) -> None:
    """Methods whose accepted steps are not shown have no post-Newton step.

    Raises:
        ValueError: the model has one.
    """
    if model.dae.updates:
        raise ValueError(
            f"model '{model.name}': post_newton_step, which {method} does not have; use "
            "GeneralizedAlpha() or Idas()"
        )


def refuse_events(model: Model, method: str) -> None:
    """Methods with steps fixed beforehand have no events.

    Raises:
        ValueError: the model has events or post-Newton steps.
    """
    if model.events or model.dae.updates:
        what = "events" if model.events else "post_newton_step"
        raise ValueError(
            f"model '{model.name}': {what}, which {method} does not have; use Idas(), "
            "GeneralizedAlpha(step), or effects with smoothing"
        )


def check_fixed_step(integrator: Any) -> None:
    """The step is a positive number.

    Raises:
        ValueError: it is not.
    """
    step = integrator.step
    if not (isinstance(step, (int, float)) and 0 < step < math.inf):
        raise ValueError(f"{type(integrator).__name__}: step {step!r} s; it is positive and finite")


def elements_of(experiment: Experiment, step: float) -> int:
    """What CasADi is to be told, so that no step is longer than asked for.

    It cuts each interval into ceil(interval / span * number) steps. With equal intervals one less
    than the true number keeps rounding from adding a step to some of them.
    """
    intervals, span = np.diff(experiment.t), float(experiment.t[-1] - experiment.t[0])
    most = max(1, math.ceil(float(intervals.max()) / step * (1 - 1e-9)))
    if len(intervals) > 1 and np.ptp(intervals) <= 1e-9 * intervals[0]:
        return most * len(intervals) - 1
    return max(1, math.ceil(span / step * (1 - 1e-9)))


def runge_kutta_options(integrator: Any) -> dict[str, Any]:
    """CasADi's options for its own one-step methods, without the tolerances."""
    options: dict[str, Any] = {"max_num_steps": integrator.max_steps}
    if integrator.max_step:
        options["max_step_size"] = integrator.max_step
    return options | dict(integrator.options)


def judge_runge_kutta(result: Run, max_steps: int) -> Verdict:
    """Outcome of a failed Rosenbrock or explicit run, from its step count."""
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
        "look for a singularity or a discontinuity there, or loosen the tolerances",
    )
