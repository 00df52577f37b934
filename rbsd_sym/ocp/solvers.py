"""The solvers of nonlinear programs, through CasADi: IPOPT and fatrop."""

from __future__ import annotations

import contextlib
import io
import math
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from .nlp import Nlp


class OptimisationOutcome(Enum):
    """How an optimisation ended, public as `rs.ocp.Outcome`; the value is the message.

    `solution.outcome.ok` is true for the first three: there is a plan that meets the conditions.
    Of an `unstable_across_reduction` the plan holds only while nothing disturbs what the minimal
    model left out.
    """

    optimal = "optimal"
    acceptable = "the solver stopped near an optimum, short of its tolerance"
    unstable_across_reduction = "a motion left out of the minimal model is unstable"
    infeasible = "no motion found that meets all conditions"
    iteration_limit = "the solver reached its limit of iterations"
    not_finite = "a function or derivative is not finite"
    stopped = "stopped by the progress function"
    failed = "the solver gave up"

    @property
    def ok(self) -> bool:
        """Whether there is a plan that meets the conditions."""
        kind = OptimisationOutcome
        return self in (kind.optimal, kind.acceptable, kind.unstable_across_reduction)


class Iteration(NamedTuple):
    """State of the solver at one iteration, which a progress function is called with.

    For example `optimise(problem, progress=lambda it: it.number > 100 and it.violation < 1e-6)`
    stops the solver after 100 iterations, once conditions hold.

    Fields:
        number: from 0.
        cost: of the current plan.
        violation: largest violation of an equation or bound, in the unit of each.
    """

    number: int
    cost: float
    violation: float


Progress = Callable[[Iteration], Any]
"""Called at every iteration; stops the solver if it returns True."""


class NlpAnswer(NamedTuple):
    """Result of a solver.

    Fields:
        x, lam_x, lam_g: variables (n,), multipliers of their bounds (n,) and of the rows (m,).
        seconds: time of the call alone.
    """

    x: np.ndarray
    cost: float
    lam_x: np.ndarray
    lam_g: np.ndarray
    outcome: OptimisationOutcome
    message: str
    iterations: int
    seconds: float = 0.0


_RELAXED = 1e-8  # fatrop widens bounds by this, relative to 1 or the bound
_IPOPT = {
    "Solve_Succeeded": OptimisationOutcome.optimal,
    "Solved_To_Acceptable_Level": OptimisationOutcome.acceptable,
    "Feasible_Point_Found": OptimisationOutcome.optimal,
    "Search_Direction_Becomes_Too_Small": OptimisationOutcome.acceptable,
    "Infeasible_Problem_Detected": OptimisationOutcome.infeasible,
    "Restoration_Failed": OptimisationOutcome.infeasible,
    "Maximum_Iterations_Exceeded": OptimisationOutcome.iteration_limit,
    "Maximum_CpuTime_Exceeded": OptimisationOutcome.iteration_limit,
    "Maximum_WallTime_Exceeded": OptimisationOutcome.iteration_limit,
    "Invalid_Number_Detected": OptimisationOutcome.not_finite,
    "User_Requested_Stop": OptimisationOutcome.stopped,
}


@dataclass(frozen=True)
class Ipopt:
    """Interior-point solver IPOPT [Waechter, Biegler 2006], with MUMPS and exact derivatives.

    It prints nothing. It is the solver for warm starts and progress functions, and the second one
    that `optimise` tries by default. For example `optimise(problem, method,
    solver=Ipopt(tol=1e-10, options={"mu_strategy": "adaptive"}))`.

    Arguments:
        tol: on the scaled optimality error.
        max_iterations: at most.
        options: more of IPOPT's options, by their names.

    Raises:
        ValueError: IPOPT refuses the options (when it is called).
    """

    tol: float = 1e-9
    max_iterations: int = 500
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def solve(
        self, nlp: Nlp, start: Mapping[str, np.ndarray], progress: Progress | None
    ) -> NlpAnswer:
        """Solve from the start of the program, or from `start`.

        Arguments:
            start: x0, and lam_x0, lam_g0 for a warm start; empty for the program's own start.
            progress: called with an `Iteration` at each; returns True to stop.
        """
        warm = "lam_g0" in start
        # IPOPT relaxes bounds by 1e-8 by default, and then returns values outside of them.
        own = {
            "print_level": 0,
            "sb": "yes",
            "tol": self.tol,
            "max_iter": self.max_iterations,
            "bound_relax_factor": 0.0,
        }
        if warm:
            # By default the start is pushed away from its bounds, and the barrier starts at 0.1:
            # both would throw away what the earlier solution knew.
            own |= {
                "warm_start_init_point": "yes",
                "mu_init": 1e-6,
                "warm_start_bound_push": 1e-9,
                "warm_start_mult_bound_push": 1e-9,
                "warm_start_slack_bound_push": 1e-9,
                "warm_start_slack_bound_frac": 1e-9,
                "warm_start_bound_frac": 1e-9,
            }
        functions = dict(nlp.functions)
        hess = functions["nlp_hess_l"]
        symbols = hess.mx_in()
        upper = ca.triu(hess(*symbols))
        functions["nlp_hess_l"] = ca.Function(
            "nlp_hess_l", symbols, [upper], hess.name_in(), ["triu_hess_gamma_x_x"]
        )
        options = {"ipopt": own | dict(self.options)}
        return _called(nlp, "ipopt", functions, options, start, progress, _ipopt_outcome)


@dataclass(frozen=True)
class Fatrop:
    """Interior-point solver fatrop [Vanroye, Sathya, De Schutter, Decre 2023].

    It makes use of the chain of blocks, so that its linear algebra takes a time proportional to
    the number of intervals, and is the first one that `optimise` tries by default. It has neither
    warm starts nor progress functions. For example `optimise(problem, method, solver=Fatrop(tol=
    1e-8))`.

    Arguments:
        tol: on the optimality error.
        max_iterations: at most.
        options: more of fatrop's options, by their names.

    Raises:
        ValueError: fatrop refuses the options (when it is called).
    """

    tol: float = 1e-10
    max_iterations: int = 500
    options: Mapping[str, Any] = field(default_factory=dict, hash=False)

    def solve(
        self, nlp: Nlp, start: Mapping[str, np.ndarray], progress: Progress | None
    ) -> NlpAnswer:
        """Solve from the start of the program, or from x0 in `start`.

        Raises:
            ValueError: a progress function, which fatrop does not call.
        """
        if progress is not None:
            raise ValueError("Fatrop: reports no progress; use Ipopt() with a progress function")
        own = {"print_level": 0, "tol": self.tol, "max_iter": self.max_iterations}
        functions = dict(nlp.functions)
        hess = functions["nlp_hess_l"]
        symbols = hess.mx_in()
        gradient = functions["nlp_grad"](*symbols)[2]
        functions["nlp_hess_l"] = ca.Function(
            "nlp_hess_l",
            symbols,
            [gradient, hess(*symbols)],
            hess.name_in(),
            ["grad_gamma_x", "hess_gamma_x_x"],
        )
        functions["nlp_grad_f"] = ca.Function(
            "nlp_grad_f",
            symbols[:2],
            [functions["nlp_grad_f"](*symbols[:2])[1]],
            ["x", "p"],
            ["grad_f_x"],
        )
        options = {
            "fatrop": own | dict(self.options),
            "structure_detection": "manual",
            **nlp.structure,
        }
        return _called(
            nlp, "fatrop", functions, options, {**_inside(nlp), **start}, None, _fatrop_outcome
        )


def _inside(nlp: Nlp) -> dict[str, np.ndarray]:
    """Return bounds moved inwards by as much as fatrop moves them outwards."""
    bounds, found = nlp.bounds, {}
    # So a plan is within the bounds that the user gave. Where there is no room inside, they stay.
    for key in ("x", "g"):
        low, high = bounds[f"lb{key}"], bounds[f"ub{key}"]
        room = [
            _RELAXED * np.maximum(1.0, np.abs(np.nan_to_num(side, posinf=0, neginf=0)))
            for side in (low, high)
        ]
        open_ = high - low > 4 * (room[0] + room[1])
        found[f"lb{key}"] = np.where(open_, low + room[0], low)
        found[f"ub{key}"] = np.where(open_, high - room[1], high)
    return found


def _called(
    nlp: Nlp,
    plugin: str,
    functions: dict[str, ca.Function],
    options: dict[str, Any],
    start: Mapping[str, np.ndarray],
    progress: Progress | None,
    judge: Callable[[Any], OptimisationOutcome],
) -> NlpAnswer:
    whole = functions.pop("nlp")
    follower = _Follower(nlp, progress) if progress else None
    own = options | {
        "print_time": False,
        "error_on_fail": False,
        "cache": functions,
        "calc_lam_p": False,
    }
    if follower:
        own["iteration_callback"] = follower
    arguments = {**nlp.bounds, **start}
    try:
        solver = ca.nlpsol("solver", plugin, whole, own)
    except RuntimeError as error:
        raise ValueError(
            f"{plugin} refuses its options {options[plugin]} "
            f"({str(error).strip().splitlines()[-1]}); check their names"
        ) from error
    begun, messages = time.perf_counter(), io.StringIO()
    with contextlib.redirect_stdout(messages), contextlib.redirect_stderr(messages):
        try:
            result, stats = solver(**arguments), solver.stats()
        except RuntimeError as error:
            empty = {"f": math.nan, "lam_x": np.zeros(nlp.n), "lam_g": np.zeros(nlp.m)}
            result = {"x": arguments["x0"], **empty}
            stats = {"return_status": str(error).strip().splitlines()[-1]}
    seconds = time.perf_counter() - begun
    if follower and follower.error:
        raise follower.error
    found = {key: np.array(value).reshape(-1) for key, value in result.items()}
    status = stats["return_status"]
    outcome = judge(status)
    if outcome.ok and not np.isfinite(found["x"]).all():
        outcome = OptimisationOutcome.not_finite
    return NlpAnswer(
        found["x"],
        float(found["f"][0]),
        found["lam_x"],
        found["lam_g"],
        outcome,
        f"{plugin}: {status}",
        int(stats.get("iter_count", 0)),
        seconds,
    )


def _ipopt_outcome(status: Any) -> OptimisationOutcome:
    return _IPOPT.get(str(status), OptimisationOutcome.failed)


def _fatrop_outcome(status: Any) -> OptimisationOutcome:
    return OptimisationOutcome.optimal if str(status) == "0" else OptimisationOutcome.failed


class _Follower(ca.Callback):
    """Hands every iteration to the user's function."""

    def __init__(self, nlp: Nlp, progress: Progress) -> None:
        ca.Callback.__init__(self)
        self.nlp, self.progress, self.count = nlp, progress, 0
        self.bounds = nlp.bounds
        self.error: Exception | None = None
        self.streams = sys.stdout, sys.stderr  # the solver's own words are caught
        self.construct("progress", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return str(ca.nlpsol_out(i))

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        sizes = {"f": 1, "x": self.nlp.n, "lam_x": self.nlp.n, "g": self.nlp.m, "lam_g": self.nlp.m}
        return ca.Sparsity.dense(sizes.get(ca.nlpsol_out(i), 0), 1)

    def eval(self, arg: list[ca.DM]) -> list[int]:
        found = dict(zip(ca.nlpsol_out(), (np.array(a).reshape(-1) for a in arg), strict=True))
        bounds = self.bounds
        gaps = [
            bounds["lbg"] - found["g"],
            found["g"] - bounds["ubg"],
            bounds["lbx"] - found["x"],
            found["x"] - bounds["ubx"],
        ]
        violation = max((float(gap.max(initial=0.0)) for gap in gaps), default=0.0)
        cost = float(found["f"][0])
        try:
            with (
                contextlib.redirect_stdout(self.streams[0]),
                contextlib.redirect_stderr(self.streams[1]),
            ):
                stop = self.progress(Iteration(self.count, cost, violation))
        except Exception as error:
            self.error, stop = error, True  # raised again once the solver has returned
        self.count += 1
        return [int(bool(stop))]
