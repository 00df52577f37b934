"""Checks shared by the integrators, and the verdict on CasADi's own methods."""

from __future__ import annotations

import math

from ..trajectory import Outcome
from .driver import Run, Verdict


def check_tolerances(where: str, rtol: float, atol: float) -> None:
    """Both tolerances are positive finite numbers, rtol below 1.

    Raises:
        ValueError: they are not.
    """
    for name, value, top in (("rtol", rtol, 1.0), ("atol", atol, math.inf)):
        if not (isinstance(value, (int, float)) and 0 < value < top):
            raise ValueError(f"{where}: {name} {value!r}; it is a number in 0 ... {top}")


def judge_runge_kutta(result: Run, max_steps: int) -> Verdict:
    """Outcome of a failed Rosenbrock or explicit run, from its step count."""
    if result.stats.get("n_steps", 0) >= max_steps:
        return Verdict(
            Outcome.too_many_steps, None, "raise max_steps, loosen the tolerances, or for stiff "
            "connectors use Idas() or Rosenbrock()",
        )  # fmt: skip
    return Verdict(
        Outcome.step_too_small, None, "look for a singularity or a discontinuity there, or loosen "
        "the tolerances",
    )  # fmt: skip
