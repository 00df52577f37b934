"""SUNDIALS IDAS: variable-order, variable-step BDF for semi-explicit index-1 DAEs."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..model.model import Model
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import Run, Verdict, consistent, input_values, run
from .events import Instant
from .options import check_options
from .post_newton import PostNewton
from .windows import SegmentedRun, run_in_segments

# First step of a model with algebraic unknowns, as a fraction of the run.
_FIRST_STEP = 1e-7
# Number of states and unknowns above which csparse is faster than qr.
_LARGE = 60
# Least rtol; below it IDAS refuses to start, since double precision has not enough digits.
_FLOOR = 1e-15

# The flag that SUNDIALS prints on failure -> outcome and advice.
_REASONS = {
    "IDA_TOO_MUCH_WORK": (
        Outcome.too_many_steps,
        "raise max_steps, loosen the tolerances, or for undamped stiff "
        "connectors lower max_order to 2",
    ),
    "IDA_ERR_FAIL": (
        Outcome.step_too_small,
        "check for a singularity there (Tait-Bryan pitch at 90 degrees, "
        "rotation by pi), or loosen the tolerances; below 1e-10 rounding alone may stop IDAS",
    ),
    "IDA_CONV_FAIL": (
        Outcome.step_too_small,
        "check for a discontinuity there, or try Rosenbrock()",
    ),
    "IDA_LINESEARCH_FAIL": (
        Outcome.not_consistent,
        "give start values of the algebraic unknowns near a solution",
    ),
}


# Statistics in `trajectory.stats` -> their names in SUNDIALS.
_COUNT = {
    "steps": "nsteps",
    "evaluations": "nfevals",
    "jacobians": "nlinsetups",
    "newton_iterations": "nniters",
    "rejected_steps": "netfails",
    "failed_newton": "nncfails",
    "last_order": "qlast",
    "last_step": "hlast",
}


@dataclass(frozen=True)
class Idas:
    """IDAS of SUNDIALS [Hindmarsh et al. 2005]: variable-step BDF of order 1 to 5, the default.

    An implicit multistep method for stiff and non-stiff models, with algebraic unknowns, events and
    post-Newton steps, run through CasADi with exact sparse Jacobians. It is not exported to C.

    Arguments:
        rtol, atol: relative and absolute error wanted in each state (SI units). Algebraic unknowns
            do not influence the choice of steps; they solve their equations at every output time.
        safety: IDAS itself bounds the root mean square, over all states, of the error of one step.
            It is given rtol and atol times safety / sqrt(number of states and unknowns), so that
            states at rest do not loosen the tolerance of a moving one, and the sum of errors over
            many steps stays near what was asked for. With safety = sqrt(number) the tolerances are
            passed on unchanged.
        max_order: of the BDF formula, 1 ... 5. Orders above 2 are unstable on the imaginary axis:
            for undamped stiff connectors order 2 needs far fewer steps.
        linear_solver: CasADi's name, such as "qr", "csparse", "lapacklu". By default csparse above
            60 states and unknowns, where it takes 0.6 to 0.95 times as long as qr on chains, and qr
            below, where they are equally fast; `trajectory.stats` says which was used.
        max_steps: within one output interval.
        max_step, first_step: s; None lets IDAS choose.
        post_newton: how far post-Newton steps are resolved.
        options: more of CasADi's options for the plugin, by their names; they take precedence.

    A model with events is checked at least eight times in each output interval, 400 times in the
    run, and about once for every four steps; IDAS starts again after each event (see
    `integrators.events`).

    Raises:
        ValueError: an option out of its range.

    >>> simulate(model, 2.0, Idas(rtol=1e-10, atol=1e-12, max_order=2))  # doctest: +SKIP
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    max_order: int = 5
    linear_solver: str | None = None
    max_steps: int = 100_000
    max_step: float | None = None
    first_step: float | None = None
    safety: float = 0.1
    post_newton: PostNewton = field(default_factory=PostNewton)
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        check_options(self)
        if self.max_order not in range(1, 6):
            raise ValueError(f"Idas: max_order {self.max_order}; give a BDF order in 1 ... 5")

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate an experiment.

        Returns:
            The trajectory, up to the failure if there was one, which is its `outcome`.

        Raises:
            ValueError: CasADi refuses an option, or a user's input function raised an error.
        """
        scale = self.safety / math.sqrt(max(1, model.n_x + model.n_z))
        options: dict[str, Any] = {
            "reltol": max(self.rtol * scale, _FLOOR),
            "abstol": self.atol * scale,
            "max_multistep_order": self.max_order,
            "max_num_steps": self.max_steps,
        }
        if model.n_z:
            # Rounding of z is large where it follows from stiff forces; it must not limit the step.
            options["suppress_algebraic"] = True
            # IDAS's own first step, 1e-14 s at tight tolerances, is so short that rounding
            # dominates the algebraic equations.
            options["step0"] = _FIRST_STEP * float(experiment.t[-1] - experiment.t[0])
        large = model.n_x + model.n_z > _LARGE
        options["linear_solver"] = self.linear_solver or ("csparse" if large else "qr")
        if self.max_step:
            options["max_step_size"] = self.max_step
        if self.first_step:
            options["step0"] = self.first_step
        if model.dae.events or model.dae.updates:
            return self._in_segments(model, experiment, options)
        return run(
            model, experiment, "idas", options | dict(self.options), _judge, _COUNT, _given_start
        )

    def _in_segments(
        self, model: Model, experiment: Experiment, options: dict[str, Any]
    ) -> Trajectory:
        """Integrate in segments, in each of which time is scaled to 0 ... 1."""
        rates, found = model.function("ode"), consistent(model, experiment)
        if isinstance(found, Trajectory):
            return found

        def scaled(start: Instant, length: float) -> dict[str, Any]:
            own = dict(options)
            # Steps in s become fractions of the segment, and rates become changes over it.
            for name, value in (("max_step_size", self.max_step), ("step0", self.first_step)):
                if value:
                    own[name] = value / length
            if model.n_z:
                u = input_values(experiment.inputs, np.array([start.t]))[:, 0]
                given = rates(start.t, start.x, start.z, u, experiment.p)
                own |= {"step0": _FIRST_STEP}
                own |= _given_start([float(length * rate) for rate in np.array(given).reshape(-1)])
            return own | dict(self.options)

        tolerances = options["reltol"], options["abstol"]
        whole = SegmentedRun(model, found, scaled, tolerances, self.post_newton)
        return run_in_segments(whole, _judge, _COUNT)


def _given_start(rates: list[float]) -> dict[str, Any]:
    """Return the options that give IDAS the rates at a consistent start."""
    # Without init_xdot IDAS starts from wrong rates, and stops at t = 0 for stiff dampers. Its own
    # search for a consistent start (calc_ic) is not needed, and may fail on the rounding of zeros.
    return {"calc_ic": False, "init_xdot": rates}


def _judge(result: Run) -> Verdict:
    """Read outcome, time and advice from what SUNDIALS printed."""
    flag = re.search(r"IDA_\w+", result.messages)
    times = re.findall(r"[Aa]t t = ([-+0-9.e]+)", result.messages)
    t = float(times[-1]) if times else None
    outcome, advice = _REASONS.get(
        flag[0] if flag else "", (Outcome.solver_failed, "try Rosenbrock(), or looser tolerances")
    )
    shown = f" (IDAS says {flag[0]})" if flag else f" ({result.messages.strip()[-200:]})"
    return Verdict(outcome, t, advice + shown)
