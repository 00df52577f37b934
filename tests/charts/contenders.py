"""Who competes in the speed charts: every integrator of ours in each form, Exudyn, scipy.

A contender runs a setting and gives a trajectory and the CPU seconds it took. What is timed: of
ours the whole call of `simulate`, in Python; of an exported simulator its C function, called from
Python; of Exudyn the solve call alone, without building, assembling and reading results; of scipy
the call of `solve_ivp`.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import math
import os
import signal
import time
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from oracles import scenes
from oracles.rotations import from_quaternion, to_quaternion
from scenes.speed import Case, rates

import rbsd_sym as rs
from rbsd_sym.model.trajectory import Column, Outcome, Trajectory

POINTS = 8  # output intervals
_FEW = 60  # states, above which collocation takes seconds to build
_MANY = 1000  # states, above which methods that factor matrices themselves take long to build
_DENSE = 4  # bodies up to which dense matrices may be the faster ones
_LOOSE = 1e-6  # by which Newton's residual falls in Exudyn: enough for the errors charted
_INTERPRETED = ("Idas", "Rosenbrock", "ExplicitRK", "RK4")  # where the form can matter
_LONGEST = 5.0  # CPU seconds after which a run of a peer is given up
_QUICK = 1e-3  # s: shorter runs are repeated and divided
Setting = Any


class Contender(NamedTuple):
    """One method in one form.

    Fields:
        family: which curve it belongs to; the best form of each family is drawn.
        efforts: settings in increasing effort; steps (multiples of POINTS) if `fixed`, else
            relative tolerances.
        run: (effort) -> trajectory at the output times, or at start and end alone.
        clock: (effort) -> CPU seconds of one run.
        word: (effort) -> the setting in words.
    """

    family: str
    method: str
    efforts: tuple[float, ...]
    fixed: bool
    run: Callable[[float], Trajectory]
    clock: Callable[[float], float]
    word: Callable[[float], str]


def cpu(call: Callable[[], Any]) -> float:
    """CPU seconds of a call; short ones are repeated."""
    began = time.thread_time()
    call()
    took = time.thread_time() - began
    if took > _QUICK:
        return took
    n = math.ceil(_QUICK / max(took, 1e-6))
    began = time.thread_time()
    for _ in range(n):
        call()
    return (time.thread_time() - began) / n


def tolerances(step: float) -> tuple[float, ...]:
    """From 1e-2 to 1e-12, `step` decades apart."""
    return tuple(float(10.0**-e) for e in np.arange(2, 12.01, step))


def steps(first: int, last: int) -> tuple[float, ...]:
    """From `first` doubled to `last`."""
    return tuple(float(first * 2**k) for k in range(int(math.log2(last / first)) + 1))


def ours(model: rs.Model, t_end: float, apart: float) -> Iterator[Contender]:
    """Every integrator that can take the model, with compiled functions, and some interpreted."""
    grid = np.linspace(0, t_end, POINTS + 1)
    for form, candidate in (("compiled", rs.compiled(model)), ("interpreted", model)):

        def contender(
            family: str, efforts: tuple[float, ...], make: Callable[[float], Any],
            name: str = "", form: str = form, candidate: rs.Model = candidate,
        ) -> Contender:  # fmt: skip
            fixed = efforts[0] > 1

            def run(effort: float) -> Trajectory:
                try:
                    return rs.simulate(candidate, grid, make(effort), throw=False)
                except RuntimeError as error:  # CasADi cannot build it
                    return failed(model.name, str(error))

            return Contender(
                family, f"{name or family}, {form}", efforts, fixed, run,
                lambda effort: cpu(lambda: run(effort)),
                lambda effort: f"{effort:.0f} steps" if fixed else f"rtol {effort:.1e}",
            )  # fmt: skip

        for family, name, efforts, make in _integrators(model, t_end, apart):
            if form == "compiled" or (name or family) in _INTERPRETED:
                yield contender(family, efforts, make, name)


def _integrators(model: rs.Model, t_end: float, apart: float) -> Iterator[tuple[Any, ...]]:
    """Family, name, efforts, and what makes an integrator of an effort."""
    explicit, plain = not model.n_z, not (model.events or model.dae.updates)
    adaptive, fixed = tolerances(apart), steps(POINTS, 2**16)
    yield "Idas", "", adaptive, lambda r: rs.Idas(r, r / 100)
    yield "Idas", "Idas(max_order=2)", adaptive, lambda r: rs.Idas(r, r / 100, max_order=2)
    if model.n_x <= _MANY:
        yield "Rosenbrock", "", adaptive, lambda r: rs.Rosenbrock(r, r / 100)
        yield "GeneralizedAlpha", "", fixed, lambda n: rs.GeneralizedAlpha(t_end / n)
    if explicit:
        yield "ExplicitRK", "", adaptive, lambda r: rs.ExplicitRK(r, r / 100, max_steps=100_000)
        yield "Dop853", "", adaptive, lambda r: rs.Dop853(r, r / 100, max_steps=3_000)
    if explicit and plain:
        yield "RK4", "", fixed, lambda n: rs.RK4(t_end / n)
    if plain and model.n_x + model.n_z <= _FEW:
        for scheme in ("radau", "legendre"):
            yield ("Collocation", f"Collocation {scheme}, 3 points", fixed,
                   lambda n, s=scheme: rs.Collocation(t_end / n, 3, s))  # fmt: skip


def exported(model: rs.Model, t_end: float, apart: float, folder: Path) -> Iterator[Contender]:
    """Whole simulations in C, of the methods that can be exported for the model."""
    methods: list[Any] = []
    most = 1_000_000 if model.n_x <= _MANY else 10_000
    if not model.n_z and not model.events:
        methods.append(rs.Dop853(max_steps=most))
    if model.n_x <= _MANY:
        methods.append(rs.Rosenbrock())
    if not model.n_z:
        methods.append(rs.ExplicitRK(max_steps=most))
    for method in methods:
        family = type(method).__name__
        artefact = rs.export_simulator(model, folder / family, method)
        simulator = rs.load_simulator(artefact, model)

        def run(rtol: float, simulator: rs.Simulator = simulator) -> Trajectory:
            return simulator(t_end, rtol=rtol, atol=rtol / 100, points=POINTS)

        def clock(rtol: float, simulator: rs.Simulator = simulator) -> float:
            out = np.zeros((POINTS, model.n_x + model.n_z))
            pointer, no = out.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), None
            return cpu(lambda: simulator.function(0.0, t_end, no, 1, no, no, no, rtol, rtol / 100,
                                                  POINTS, pointer, no))  # fmt: skip

        yield Contender(family, f"{family}, exported C", tolerances(apart), False, run, clock,
                        lambda effort: f"rtol {effort:.1e}")  # fmt: skip


def trajectory_of(case: Case, t: np.ndarray, states: Any) -> Trajectory:
    """The bodies' columns from states (n, bodies, 13) about the centres of mass."""
    x, columns = np.array(states).reshape(len(t), -1, 13), {}
    if case.peer is None:
        raise ValueError(f"{case.scene.name}: no scene for peers")
    for i, (body, data) in enumerate(zip(case.scene.bodies, case.peer["bodies"], strict=True)):
        p, q, v, w = x[:, i, :3], x[:, i, 3:7], x[:, i, 7:10], x[:, i, 10:]
        q = q / np.linalg.norm(q, axis=1)[:, None]
        R = np.array([from_quaternion(one) for one in q])
        columns |= {
            f"{body.name}.position": Column(p - R @ data["com"], "m"),
            f"{body.name}.quaternion": Column(q, ""),
            f"{body.name}.velocity": Column(
                v - (R @ np.cross(w, data["com"])[:, :, None])[:, :, 0], "m/s"),
            f"{body.name}.angular_velocity": Column(w, "rad/s"),
        }  # fmt: skip
    outcome = Outcome.reached_end
    return Trajectory(case.scene.name, t, columns, outcome, outcome.value, {}, {}, (), "")


def failed(name: str, why: str) -> Trajectory:
    """What is left of a run that gave nothing."""
    start = Trajectory(name, np.zeros(1), {}, Outcome.solver_failed, why, {}, {}, (), "")
    return start


def scipy_methods(case: Case, apart: float) -> Iterator[Contender]:
    """`solve_ivp` with the oracle's right-hand side, for scenes of one body."""
    if case.peer is None or len(case.peer["bodies"]) > 1:
        return
    try:
        from scipy.integrate import solve_ivp
    except ImportError:
        return
    start, grid = scenes.start_state(case.peer), np.linspace(0, case.t_end, POINTS + 1)

    deadline = [math.inf]

    def f(t: float, y: np.ndarray) -> np.ndarray:
        if time.thread_time() > deadline[0]:
            raise TimeoutError(f"given up after {_LONGEST:g} s")
        return rates(case, t, y.reshape(start.shape)).reshape(-1)

    for method in ("DOP853", "Radau", "LSODA"):

        def solve(rtol: float, method: str = method) -> Any:
            deadline[0] = time.thread_time() + _LONGEST
            return solve_ivp(f, (0, case.t_end), start.reshape(-1), method, grid, rtol=rtol,
                             atol=rtol / 100)  # fmt: skip

        def run(rtol: float, solve: Any = solve) -> Trajectory:
            try:
                found = solve(rtol)
            except TimeoutError as error:
                return failed(case.scene.name, str(error))
            if not found.success:
                return failed(case.scene.name, found.message)
            made = trajectory_of(case, grid, found.y.T)
            return replace(made, stats={"evaluations": float(found.nfev)})

        yield Contender("scipy", f"scipy {method}", tolerances(apart)[:-2], False, run,
                        lambda rtol, solve=solve: cpu(lambda: solve(rtol)),
                        lambda effort: f"rtol {effort:.1e}")  # fmt: skip


def _runner(case: Case) -> Any:
    """The module that runs Exudyn, or None where it is not to be had or cannot take the scene."""
    if case.peer is None or not case.exudyn:
        return None
    try:
        from peers import exudyn_runner
    except ImportError:
        return None
    return exudyn_runner


def exudyn_methods(case: Case) -> Iterator[Contender]:
    """Every solver of Exudyn with every node, with sparse matrices."""
    runner, systems = _runner(case), {}
    for base in _bases(runner) if runner else ():
        yield _exudyn(case, base, runner, systems)


def exudyn_variants(case: Case, chosen: Callable[[], Collection[str]]) -> Iterator[Contender]:
    """Other choices of the methods chosen so far, by their names."""
    runner, systems = _runner(case), {}
    names = chosen() if runner else ()
    for base in _bases(runner) if runner else ():
        if _title(base, runner) not in names:
            continue
        others: list[dict[str, Any]] = []
        if base.solver in runner.IMPLICIT:
            others = [{"modified_newton": False}, {"newton": 1e-8}]
            others += [{"spectral_radius": 0.9}] if base.solver == "GeneralizedAlpha" else []
        elif base.node == "rotvec":
            others = [{"per_body": False}]
        others += [{"linear": "EXUdense"}] if len(case.scene.bodies) <= _DENSE else []
        for other in others:
            yield _exudyn(case, replace(base, **other), runner, systems)


def _bases(runner: Any) -> list[Any]:
    free = ("rotvec", "rxyz")
    found = [runner.Setting(node, s) for s in ("DOPRI5", "RK44", "RK67", "RK33") for node in free]
    found += [runner.Setting(n, s, 20, 1.0) for s in runner.ADAPTIVE_ORDER for n in free]
    implicit = [runner.Setting(node, s, newton=_LOOSE) for s in runner.IMPLICIT
                for node in (*free, "ep")]  # fmt: skip
    turns = itertools.zip_longest(found, implicit)  # so that time is short for neither kind
    return [base for pair in turns for base in pair if base is not None]


def _title(base: Any, runner: Any) -> str:
    loose = _LOOSE if base.solver in runner.IMPLICIT else 1e-8
    usual = runner.Setting(base.node, base.solver, newton=loose)
    more = [
        f"{name} {getattr(base, name)}" for name in
        ("linear", "per_body", "spectral_radius", "modified_newton", "newton")
        if getattr(base, name) != getattr(usual, name)
    ]  # fmt: skip
    adaptive = ["adaptive"] if base.tolerance is not None else []
    return ", ".join([f"Exudyn {base.solver}", base.node, *adaptive, *more])


def upright(peer: dict[str, Any]) -> dict[str, Any]:
    """The same scene with body axes along those of the world at the start.

    `rxyz` nodes are singular where a body's second angle is 90 degrees, as of a rod of `bricard`.
    """
    turns = [np.array(body["rotation"], float) for body in peer["bodies"]]
    bodies = [
        {**body, "inertia": R @ body["inertia"] @ R.T, "rotation": np.eye(3),
         "angular_velocity": R @ body["angular_velocity"]}
        for body, R in zip(peer["bodies"], turns, strict=True)
    ]  # fmt: skip

    def turned(ends: dict[str, Any]) -> dict[str, Any]:
        own = dict(ends)
        for end in (0, 1):
            i = ends[f"body{end}"]
            for key in (f"position{end}", f"rotation_marker{end}"):
                if i != scenes.GROUND and key in own:
                    own[key] = turns[i] @ np.array(own[key], float)
        return own

    springs = {key: [turned(c) for c in peer[key]]
               for key in ("connectors", "point_springs") if key in peer}  # fmt: skip
    return {**peer, "bodies": bodies, **springs}


def turned_back(peer: dict[str, Any], state: np.ndarray) -> np.ndarray:
    """A state of the `upright` scene in the axes of the scene itself."""
    own = np.array(state, float)
    for x, body in zip(own, peer["bodies"], strict=True):
        R = np.array(body["rotation"], float)
        x[3:7], x[10:] = to_quaternion(from_quaternion(x[3:7]) @ R), R.T @ x[10:]
    return own


def _returns(call: Callable[[], Any]) -> bool:
    """Whether a call returns, tried in a child process that is killed after a while.

    Exudyn's adaptive solvers may try steps for ever, and ask nobody in between.
    """
    child = os.fork()
    if child == 0:
        signal.alarm(round(2 * _LONGEST))  # the default action ends the process, whatever it does
        with contextlib.suppress(Exception):
            call()
        os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def _exudyn(case: Case, base: Any, runner: Any, systems: dict[str, Any]) -> Contender:
    """Exudyn at one setting but for its effort: equal steps, or a tolerance."""
    if case.peer is None:
        raise ValueError(f"{case.scene.name}: no scene for peers")
    adaptive = base.tolerance is not None
    family = f"Exudyn, {'implicit' if base.solver in runner.IMPLICIT else 'explicit'}"

    def setting(effort: float) -> Any:
        own = {"tolerance": effort} if adaptive else {"steps": round(effort)}
        return replace(base, **own)

    def solve(effort: float, watch: Any = None, limit: float = math.inf) -> Any:
        if base.node not in systems:
            systems[base.node] = runner.System(upright(case.peer), base.node)
        every = max(1, round(effort) // POINTS)
        return systems[base.node].run(setting(effort), case.t_end, watch, every, limit)

    def run(effort: float) -> Trajectory:
        states: list[Any] = []
        if adaptive and not _returns(lambda: solve(effort, None, _LONGEST)):
            return failed(case.scene.name, f"did not return in {2 * _LONGEST:g} s")
        keep = lambda x: states.append(turned_back(case.peer, x))  # noqa: E731
        try:
            last = turned_back(case.peer, solve(effort, None if adaptive else keep, _LONGEST).state)
        except runner.Failure as error:
            return failed(case.scene.name, str(error))
        if adaptive:  # its steps do not meet the output times: judged at the end alone
            states = [scenes.start_state(case.peer)]  # type: ignore[arg-type]
        return trajectory_of(case, np.linspace(0, case.t_end, len(states) + 1), [*states, last])

    def clock(effort: float) -> float:
        try:
            return float(solve(effort).cpu_seconds)
        except runner.Failure:
            return math.nan

    efforts = tolerances(1)[:-2] if adaptive else steps(2 * POINTS, 2**21)
    word = lambda e: f"tolerance {e:.0e}" if adaptive else f"{e:.0f} steps"  # noqa: E731
    return Contender(family, _title(base, runner), efforts, not adaptive, run, clock, word)
