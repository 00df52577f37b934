"""`optimise`: from a problem and a method to a plan that was checked by simulation."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ..model.trajectory import Outcome, Trajectory
from ..pipeline import across_reduction
from .chain import Chain, Guess, chained
from .direct_collocation import DirectCollocation
from .flight import FlightFailed, flown
from .guess import first_guess, from_solution
from .mesh import Interval, Method, meshes
from .nlp import Nlp
from .plan import (
    Flight,
    Miss,
    OptimisationError,
    Plan,
    Raw,
    Solution,
    multipliers,
    pieces,
    read,
    trajectory,
)
from .problem import Problem
from .reasons import between_points, elastic_report, misses
from .refine import refined
from .solvers import Fatrop, Ipopt, NlpAnswer, OptimisationOutcome, Progress
from .traced import TracedProblem, check_freedom, trace_problem

_STRAYS = 1e-3  # of the size of states, or of a limit: a plan that is further off gets a note
_PATIENCE = 300  # iterations of fatrop, before IPOPT is tried


class Solver(Protocol):
    """Solves a program: `Ipopt(...)`, `Fatrop(...)`, or a class of one's own with this method."""

    def solve(self, nlp: Nlp, start: dict[str, np.ndarray], progress: Progress | None) -> NlpAnswer:
        """Solve from a start: x0, and multipliers lam_x0, lam_g0; empty for the program's own."""
        ...


@dataclass(frozen=True, eq=False)
class _Found:
    """One round: what was solved, and what is known of it."""

    chain: Chain
    answer: NlpAnswer
    plan: Plan
    flight: Flight | None
    errors: np.ndarray
    report: str
    flying: float


def optimise(
    problem: Problem,
    method: Method | None = None,
    guess: Any = None,
    solver: Solver | None = None,
    progress: Progress | None = None,
    throw: bool = True,
    fly: bool = True,
    compiled: bool = False,
) -> Solution:
    """Find the motion of least cost.

    For example

        solution = rs.ocp.optimise(problem, rs.ocp.Collocation(30, degree=4, refine=1e-6))
        print(solution, solution.cost, solution.trajectory["tip.position"][-1])

    Arguments:
        problem: what to find, and at what cost.
        method: `Collocation()` by default, or `Shooting()`.
        guess: a `Trajectory` of `simulate`, values by name, or an earlier `Solution` (with its
            multipliers, if the mesh is the same); by default straight from start to end.
        solver: `Fatrop(...)` or `Ipopt(...)`. By default fatrop, and IPOPT where it fails, where
            progress is wanted, and for a warm start.
        progress: called with an `Iteration` at each; returns True to stop.
        throw: raise where there is no plan; otherwise it is data in `solution.outcome`.
        fly: check the plan by simulation with IDAS at rtol 1e-10, and report the difference. A
            method that refines needs it, and does so in any case.
        compiled: build machine code of the functions of one interval; it needs a C compiler, and
            pays where a problem is solved often (the library stays in the cache).

    Returns:
        The solution; it need not be the global optimum, which the search cannot recognise.

    Raises:
        ValueError, TypeError: what is wrong with the problem, before the solver starts.
        OptimisationError: no plan was found; `error.solution` holds what was reached.
    """
    for given, example in ((method, "Collocation()"), (solver, "Ipopt()")):
        if isinstance(given, type):
            raise TypeError(f"optimise: {given.__name__}; give an object, such as {example}")
    if method is not None and not hasattr(method, "interval"):
        raise TypeError(
            f"optimise: method is a {type(method).__name__}, which does not transcribe problems; "
            "give rbsd_sym.ocp.Collocation(...) or rbsd_sym.ocp.Shooting(...)"
        )
    chosen = method or DirectCollocation()
    search = _Search(chosen, solver, progress, fly, compiled)
    solution = _solution(problem, chosen, *search.run(trace_problem(problem), guess))
    if throw and not solution.outcome.ok:
        raise OptimisationError(solution)
    return solution


@dataclass(frozen=True, eq=False)
class _Search:
    """Solving, and solving again on finer meshes; fields as the arguments of `optimise`."""

    method: Method
    solver: Solver | None
    progress: Progress | None
    fly: bool
    compiled: bool

    def run(self, traced: TracedProblem, guess: Any) -> tuple[_Found, dict[str, float | str]]:
        """Return the last round, and statistics of all."""
        begun, solving, flying, iterations, rounds = time.perf_counter(), 0.0, 0.0, 0, 0
        intervals = _intervals(traced, self.method, self.compiled)
        mesh = meshes(self.method.intervals, traced.n_phases)
        start, lam = first_guess(traced, guess, mesh, self.method.input_degree)
        check_freedom(traced)
        while True:
            chain = chained(traced, intervals, mesh, start)
            lam = lam if _fits(chain, lam) else {}
            found = self._solved(chain, lam, start)
            solving, flying = solving + found.answer.seconds, flying + found.flying
            rounds, iterations = rounds + 1, iterations + found.answer.iterations
            finer = _finer(found, self.method, rounds)
            if finer is None:
                break
            mesh, lam = finer, {}
            start = from_solution(traced, found.plan, found.chain)
        build = time.perf_counter() - begun - solving - flying
        return found, {
            "rounds": float(rounds),
            "iterations": float(iterations),
            "time": solving,
            "time_flight": flying,
            "time_build": build,
        }

    def _solved(self, chain: Chain, lam: dict[str, np.ndarray], start: Guess) -> _Found:
        report, spent = "", 0.0
        for solver in [self.solver] if self.solver else _team(self.progress, lam):
            answer = solver.solve(chain.nlp, lam, self.progress)
            spent += answer.seconds
            if answer.outcome.ok or answer.outcome is OptimisationOutcome.stopped:
                break
        answer = answer._replace(seconds=spent)
        if not answer.outcome.ok and answer.outcome is not OptimisationOutcome.stopped:
            answer, report = _explained(chain, solver, answer, start)
        plan = read(chain, answer.x)
        flight, errors, before = None, np.zeros(0), time.perf_counter()
        if answer.outcome.ok and (self.fly or self.method.refinement):
            try:
                flight, errors = flown(chain, plan, self.method.input_degree)
            except FlightFailed as failed:
                report = f"the plan cannot be simulated by IDAS: {failed}"
        flying = time.perf_counter() - before
        return _Found(chain, answer, plan, flight, errors, report, flying)


def transcribe(problem: Problem, method: Method | None = None, guess: Any = None) -> Nlp:
    """Write a problem as a nonlinear program, for other solvers and for tests.

    `functions` of the result holds its CasADi Functions with exact derivatives, `bounds` the start
    and the bounds of variables and rows. `transcribe(problem, method).n` is the number of
    variables, without a call of a solver. To write a program to C, use `export_problem`.

    Arguments:
        problem, method, guess: as in `optimise`.

    Raises:
        ValueError, TypeError: what is wrong with the problem.
    """
    traced, chosen = trace_problem(problem), method or DirectCollocation()
    mesh = meshes(chosen.intervals, traced.n_phases)
    start, _ = first_guess(traced, guess, mesh, chosen.input_degree)
    return chained(traced, _intervals(traced, chosen, False), mesh, start).nlp


def _intervals(traced: TracedProblem, method: Method, compiled: bool) -> list[Interval]:
    intervals = [method.interval(traced, i) for i in range(traced.n_phases)]
    if not compiled:
        return intervals
    name = f"{traced.model.name}_ocp"
    return [replace(part, functions=part.functions.compiled(name)) for part in intervals]


def _team(progress: Progress | None, lam: dict[str, np.ndarray]) -> list[Solver]:
    """Return the solvers to be tried in turn."""
    # Fatrop is the faster one, but has neither progress nor warm starts, and gives up where IPOPT
    # restores feasibility.
    return [Ipopt()] if progress or lam else [Fatrop(max_iterations=_PATIENCE), Ipopt()]


def _fits(chain: Chain, lam: dict[str, np.ndarray]) -> bool:
    """Whether values of an earlier program are those of one like this."""
    return bool(lam) and (len(lam["x0"]), len(lam["lam_g0"])) == (chain.nlp.n, chain.nlp.m)


def _explained(
    chain: Chain, solver: Solver, answer: NlpAnswer, start: Guess
) -> tuple[NlpAnswer, str]:
    """Find out why there is no answer; return a better one if there is, and the reason.

    The elastic program lets conditions be missed. If none needs to be, the problem is tried once
    more from there.
    """
    # Solvers only say that they gave up. With slacks any motion from the start is feasible, and
    # those that are not zero name the conditions that contradict each other.
    loose = chained(chain.traced, chain.intervals, chain.mesh, start, elastic=True)
    second = solver.solve(loose.nlp, {}, None)
    if not second.outcome.ok:
        worst = misses(chain, answer.x)
        return answer, "; ".join(str(miss) for miss in worst[:2])
    missed = elastic_report(loose, second.x)
    if missed:
        failed = answer._replace(outcome=OptimisationOutcome.infeasible)
        return failed, f"at best {'; '.join(missed[:3])}"
    near = from_solution(chain.traced, read(loose, second.x), loose)
    again = chained(chain.traced, chain.intervals, chain.mesh, near)
    third = solver.solve(again.nlp, {}, None)
    if third.outcome.ok:
        return third, ""
    return answer, "; ".join(str(miss) for miss in misses(chain, answer.x)[:2])


def _finer(found: _Found, method: Method, rounds: int) -> tuple[np.ndarray, ...] | None:
    wanted = method.refinement
    if wanted is None or rounds > wanted.rounds or found.flight is None:
        return None
    return refined(found.chain, found.plan, found.errors, wanted)


def _solution(
    problem: Problem, method: Method, found: _Found, stats: dict[str, float | str]
) -> Solution:
    chain, answer, plan = found.chain, found.answer, found.plan
    traced = chain.traced
    path: Trajectory = trajectory(plan)
    outcome, report = answer.outcome, _report(answer, found.report)
    if not outcome.ok:
        path = replace(path, outcome=Outcome.solver_failed, report=report)
    else:
        path = across_reduction(traced.model, path)
        if path.outcome is Outcome.unstable_across_reduction:
            outcome, report = OptimisationOutcome.unstable_across_reduction, path.report
    labels = traced.model.dae.parameters.labels
    values = [float(value) for value in traced.parameters(plan.s)]
    functions = chain.nlp.functions
    stats |= {
        "variables": float(chain.nlp.n),
        "equations": float(chain.nlp.m),
        "nonzeros": float(functions["nlp_jac_g"].nnz_out(1)),
        "solver": answer.message,
    }
    between = between_points(chain, answer.x, plan, method.input_degree) if outcome.ok else ()
    raw = Raw(answer, method.input_degree, plan, chain)
    return Solution(
        problem,
        traced.model,
        path,
        pieces(plan),
        tuple(float(v) for v in traced.durations(plan.s)),
        {label.name: v for label, v in zip(labels, values, strict=True)},
        plan.edges,
        answer.cost,
        outcome,
        report,
        found.errors,
        found.flight,
        between,
        multipliers(chain, answer),
        stats,
        (*traced.notes, *_strays(found.flight), *_beyond(between)),
        raw,
    )


def _strays(flight: Flight | None) -> list[str]:
    """A note where the simulation contradicts the plan."""
    if flight is None or flight.difference < _STRAYS:
        return []
    name, t = flight.worst
    return [
        f"flown by IDAS the plan strays by {flight.difference:.2g} in '{name}' at t = {t:.6g} s; "
        "take more intervals, a higher degree, or refine"
    ]


def _beyond(between: tuple[Miss, ...]) -> list[str]:
    """A note where limits are exceeded by much."""
    if not between or between[0].relative < _STRAYS:
        return []
    return [
        f"between the points at which conditions are kept, {between[0]}; take more intervals, or "
        "path_points of Collocation"
    ]


def _report(answer: NlpAnswer, reason: str) -> str:
    text = answer.outcome.value
    if answer.outcome is OptimisationOutcome.optimal and not reason:
        return text
    parts = [part for part in (reason, f"({answer.message})") if part]
    return f"{text}: {' '.join(parts)}" if not math.isnan(answer.cost) else f"{text}: {parts[-1]}"
