"""`optimise`: from a problem and a method to a plan that was flown."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ..model.trajectory import Outcome as Reached
from ..model.trajectory import Trajectory
from ..pipeline import across_reduction
from .between import Miss
from .chain import Chain, chained
from .direct_collocation import Collocation
from .flight import Flight, FlightFailed
from .guess import Guess, from_user
from .interval import Interval, Method
from .machine_code import compiled_stage
from .mesh import meshes
from .nlp import Nlp
from .problem import Problem
from .reading import Plan, flown, multipliers, pieces, read, trajectory
from .reasons import between_points, elastic_report, misses
from .refine import refined
from .solution import OptimisationError, Raw, Solution
from .solvers import Answer, Fatrop, Ipopt, Outcome, Progress
from .stage import Frame, framed
from .warm import from_solution, warm_start

_STRAYS = 1e-3  # of the size of states, or of a limit: a plan further off is not to be trusted
_PATIENCE = 300  # iterations of fatrop, before IPOPT is tried


class Solver(Protocol):
    """Solves a program: `Ipopt(...)` or `Fatrop(...)`."""

    def solve(self, nlp: Any, start: Any, progress: Progress | None) -> Answer:
        """The answer, from a start."""
        ...


@dataclass(frozen=True, eq=False)
class _Found:
    """One round: what was solved, and what is known of it."""

    chain: Chain
    answer: Answer
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
    """Find the motion that costs least.

    Arguments:
        method: `Collocation()` by default, or `Shooting()`.
        guess: a `Trajectory` of `simulate`, values by name, or an earlier `Solution` (with its
            multipliers, if the mesh is the same); by default straight from start to end.
        solver: `Fatrop(...)` or `Ipopt(...)`. By default fatrop, and IPOPT where it fails, where
            progress is wanted, and for a warm start.
        progress: called with an `Iteration` at each; returns True to stop.
        throw: raise where there is no plan; otherwise it is data in `solution.outcome`.
        fly: integrate the plan with IDAS at rtol 1e-10, and report the difference. A method that
            refines needs it.
        compiled: build machine code of the functions of one stage; it needs a C compiler, and pays
            where a problem is solved often (the library stays in the cache).

    Raises:
        ValueError, TypeError: what is wrong with the problem, before the solver starts.
        OptimisationError: no plan; it carries the solution.
    """
    if isinstance(method, type) or isinstance(solver, type):
        given = method if isinstance(method, type) else solver
        raise TypeError(f"optimise: {given.__name__}; give an object, such as {given.__name__}()")  # type: ignore[union-attr]
    chosen = method or Collocation()
    search = _Search(chosen, solver, progress, fly, compiled)
    solution = _solution(problem, chosen, *search.run(framed(problem), guess))
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

    def run(self, frame: Frame, guess: Any) -> tuple[_Found, dict[str, float | str]]:
        """The last round, and statistics of all."""
        begun, solving, flying, iterations, rounds = time.perf_counter(), 0.0, 0.0, 0, 0
        intervals = _stages(frame, self.method, self.compiled)
        mesh = meshes(self.method.intervals, frame.n_phases)
        start, lam = _first_guess(frame, self.method, guess, mesh)
        while True:
            chain = chained(frame, intervals, mesh, start)
            _check_freedom(chain)
            lam = lam if _fits(chain, lam) else {}
            found = self._solved(chain, lam, start)
            solving, flying = solving + found.answer.seconds, flying + found.flying
            rounds, iterations = rounds + 1, iterations + found.answer.iterations
            finer = _finer(found, self.method, rounds)
            if finer is None:
                break
            mesh, lam = finer, {}
            start = from_solution(frame, found.plan, found.chain)
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
            if answer.outcome.ok or answer.outcome is Outcome.stopped:
                break
        answer = answer._replace(seconds=spent)
        if not answer.outcome.ok and answer.outcome is not Outcome.stopped:
            answer, report = _explained(chain, solver, answer, start)
        plan = read(chain, answer.x)
        flight, errors, before = None, np.zeros(0), time.perf_counter()
        if answer.outcome.ok and (self.fly or self.method.refinement):
            try:
                flight, errors = flown(chain, plan, self.method.input_degree)
            except FlightFailed as failed:
                report = f"IDAS cannot fly the plan: {failed}"
        flying = time.perf_counter() - before
        return _Found(chain, answer, plan, flight, errors, report, flying)


def transcribe(problem: Problem, method: Method | None = None, guess: Any = None) -> Nlp:
    """The nonlinear program of a problem, for other solvers, export, and tests.

    `functions` holds its CasADi Functions with exact derivatives, `bounds` the start and the bounds
    of variables and rows.

    Raises:
        ValueError, TypeError: what is wrong with the problem.
    """
    frame, chosen = framed(problem), method or Collocation()
    mesh = meshes(chosen.intervals, frame.n_phases)
    start, _ = _first_guess(frame, chosen, guess, mesh)
    return chained(frame, _stages(frame, chosen, False), mesh, start).nlp


def _stages(frame: Frame, method: Method, compiled: bool) -> list[Interval]:
    intervals = [method.interval(frame, i) for i in range(frame.n_phases)]
    if not compiled:
        return intervals
    name = f"{frame.model.name}_ocp"
    return [replace(part, functions=compiled_stage(name, part.functions)) for part in intervals]


def _team(progress: Progress | None, lam: dict[str, np.ndarray]) -> list[Solver]:
    """Solvers to be tried in turn."""
    return [Ipopt()] if progress or lam else [Fatrop(max_iterations=_PATIENCE), Ipopt()]


def _first_guess(
    frame: Frame, method: Method, guess: Any, mesh: tuple[np.ndarray, ...]
) -> tuple[Guess, dict[str, np.ndarray]]:
    if isinstance(guess, Solution):
        return warm_start(frame, guess, mesh, method.input_degree)
    return from_user(frame, guess), {}


def _fits(chain: Chain, lam: dict[str, np.ndarray]) -> bool:
    """Whether values of an earlier program are those of one like this."""
    return bool(lam) and (len(lam["x0"]), len(lam["lam_g0"])) == (chain.nlp.n, chain.nlp.m)


def _check_freedom(chain: Chain) -> None:
    if not chain.frame.controls and not chain.frame.n_s:
        raise ValueError(
            f"model '{chain.frame.model.name}': nothing is to be found; make an Input, a Param or "
            "a horizon Free"
        )


def _explained(chain: Chain, solver: Solver, answer: Answer, start: Guess) -> tuple[Answer, str]:
    """Why there is no answer: what is missed if the conditions at the ends may be.

    If none needs to be, the problem is tried once more from there.
    """
    loose = chained(chain.frame, chain.intervals, chain.mesh, start, elastic=True)
    second = solver.solve(loose.nlp, {}, None)
    if not second.outcome.ok:
        worst = misses(chain, answer.x)
        return answer, "; ".join(str(miss) for miss in worst[:2])
    told = elastic_report(loose, second.x)
    if told:
        failed = (
            answer
            if answer.outcome is Outcome.infeasible
            else answer._replace(outcome=Outcome.infeasible)
        )
        return failed, f"at best {'; '.join(told[:3])}"
    near = from_solution(chain.frame, read(loose, second.x), loose)
    again = chained(chain.frame, chain.intervals, chain.mesh, near)
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
    frame = chain.frame
    path: Trajectory = trajectory(plan)
    outcome, report = answer.outcome, _report(answer, found.report)
    if not outcome.ok:
        path = replace(path, outcome=Reached.solver_failed, report=report)
    else:
        path = across_reduction(frame.model, path)
        if path.outcome is Reached.unstable_across_reduction:
            outcome, report = Outcome.unstable_across_reduction, path.report
    labels = frame.model.dae.parameters.labels
    values = [float(value) for value in frame.parameters(plan.s)]
    functions = chain.nlp.functions
    stats |= {
        "variables": float(chain.nlp.n),
        "equations": float(chain.nlp.m),
        "nonzeros": float(functions["nlp_jac_g"].nnz_out(1)),
        "solver": answer.message,
    }
    edges = np.concatenate([plan.legs[0].t, *(leg.t[1:] for leg in plan.legs[1:])])
    between = between_points(chain, answer.x, plan, method.input_degree) if outcome.ok else ()
    raw = Raw(chain.mesh, answer, method.input_degree, plan, chain)
    return Solution(
        problem,
        frame.model,
        path,
        pieces(plan),
        tuple(float(v) for v in frame.durations(plan.s)),
        {label.name: v for label, v in zip(labels, values, strict=True)},
        edges,
        answer.cost,
        outcome,
        report,
        found.errors,
        found.flight,
        between,
        multipliers(chain, answer),
        stats,
        (*frame.notes, *_strays(found.flight), *_beyond(between)),
        raw,
    )


def _strays(flight: Flight | None) -> list[str]:
    """A note where the plan does not fly."""
    if flight is None or flight.difference < _STRAYS:
        return []
    name, t = flight.worst
    return [
        f"flown by IDAS the plan strays by {flight.difference:.2g} in '{name}' at t = {t:.6g} s; "
        "take more intervals, a higher degree, or refine"
    ]


def _beyond(between: tuple[Miss, ...]) -> list[str]:
    """A note where limits are passed by much."""
    if not between or between[0].relative < _STRAYS:
        return []
    return [
        f"between the points at which conditions are kept, {between[0]}; take more intervals, or "
        "path_points of Collocation"
    ]


def _report(answer: Answer, reason: str) -> str:
    text = answer.outcome.value
    if answer.outcome is Outcome.optimal and not reason:
        return text
    parts: Sequence[str] = [part for part in (reason, f"({answer.message})") if part]
    return f"{text}: {' '.join(parts)}" if not math.isnan(answer.cost) else f"{text}: {parts[-1]}"
