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
from .windows import Walk, follow

_FIRST_STEP = 1e-7  # of the run, with algebraic unknowns
_LARGE = 60  # states and unknowns, above which csparse is faster than qr
_FLOOR = 1e-15  # of rtol; below it IDAS refuses, for want of digits

_REASONS = {
    "IDA_TOO_MUCH_WORK": (
        Outcome.too_many_steps,
        "raise max_steps, loosen the tolerances, or for undamped stiff "
        "connectors lower max_order to 2",
    ),
    "IDA_ERR_FAIL": (
        Outcome.step_too_small,
        "look for a singularity there (Tait-Bryan pitch at 90 degrees, "
        "rotation by pi), or loosen the tolerances; below 1e-10 rounding alone may stop IDAS",
    ),
    "IDA_CONV_FAIL": (
        Outcome.step_too_small,
        "look for a discontinuity there, or try Rosenbrock()",
    ),
    "IDA_LINESEARCH_FAIL": (
        Outcome.not_consistent,
        "give start values of the algebraic unknowns near a solution",
    ),
}


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
    """IDAS [Hindmarsh et al. 2005], through CasADi, with exact sparse Jacobians.

    Arguments:
        rtol, atol: relative and absolute error wanted in each state. Algebraic unknowns take no
            part in the choice of the step; they solve their equations at every point.
        safety: IDAS itself bounds the root mean square over all states of the error of one step. It
            is given rtol and atol times safety / sqrt(number of states), so that idle states beside
            it loosen nothing for a moving one, and the sum over many steps stays near what was
            asked for. sqrt(number of states) would hand the tolerances on as they are.
        max_order: of the BDF formula, 1 ... 5. Orders above 2 are unstable on the imaginary axis:
            for undamped stiff connectors 2 needs far fewer steps.
        linear_solver: CasADi name such as "qr", "csparse", "lapacklu". By default csparse above 60
            states and unknowns, where it takes 0.6 to 0.95 times as long as qr on chains, qr below,
            where they tie; `trajectory.stats` tells which.
        max_steps: within one output interval.
        max_step, first_step: s; None lets IDAS choose.
        post_newton: how far post-Newton steps are resolved.
        options: more of CasADi's options for the plugin, by their names.

    A model with events is watched eight times an output interval, 400 times a run, and at every
    fourth step, whichever is most often; IDAS starts again after each event (see
    `integrators.events`).
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
            raise ValueError(f"Idas: max_order {self.max_order}; BDF orders are 1 ... 5")

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate; a failure is a `Trajectory` up to it with its `Outcome`."""
        scale = self.safety / math.sqrt(max(1, model.n_x + model.n_z))
        options: dict[str, Any] = {
            "reltol": max(self.rtol * scale, _FLOOR),
            "abstol": self.atol * scale,
            "max_multistep_order": self.max_order,
            "max_num_steps": self.max_steps,
        }
        if model.n_z:
            # Their rounding, large where they follow from stiff forces, must not set the step.
            options["suppress_algebraic"] = True
            # Its own first guess, 1e-14 s at tight tolerances, leaves their equations no digits.
            options["step0"] = _FIRST_STEP * float(experiment.t[-1] - experiment.t[0])
        large = model.n_x + model.n_z > _LARGE
        options["linear_solver"] = self.linear_solver or ("csparse" if large else "qr")
        if self.max_step:
            options["max_step_size"] = self.max_step
        if self.first_step:
            options["step0"] = self.first_step
        if model.dae.events or model.dae.updates:
            return self._walk(model, experiment, options)
        return run(
            model, experiment, "idas", options | dict(self.options), _judge, _COUNT, _given_start
        )

    def _walk(self, model: Model, experiment: Experiment, options: dict[str, Any]) -> Trajectory:
        """In stretches, from event to event; in each, time is scaled to 0 ... 1."""
        rates, found = model.function("ode"), consistent(model, experiment)
        if isinstance(found, Trajectory):
            return found

        def scaled(start: Instant, length: float) -> dict[str, Any]:
            own = dict(options)
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
        walk = Walk(model, found, scaled, tolerances, self.post_newton)
        return follow(walk, _judge, _COUNT)


def _given_start(rates: list[float]) -> dict[str, Any]:
    """The start is consistent: IDAS need not look for it, and stop at the rounding of zeros."""
    return {"calc_ic": False, "init_xdot": rates}


def _judge(result: Run) -> Verdict:
    flag = re.search(r"IDA_\w+", result.messages)
    times = re.findall(r"[Aa]t t = ([-+0-9.e]+)", result.messages)
    t = float(times[-1]) if times else None
    outcome, advice = _REASONS.get(
        flag[0] if flag else "", (Outcome.solver_failed, "try Rosenbrock(), or looser tolerances")
    )
    said = f" (IDAS says {flag[0]})" if flag else f" ({result.messages.strip()[-200:]})"
    return Verdict(outcome, t, advice + said)
