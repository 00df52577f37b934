"""Exudyn 1.13.6 on scenes in the format of `oracles.scenes`, at its best settings, for benchmarks.

Imported before Exudyn itself, this selects Exudyn's `fast` library (no range checks, AVX2), the one
to compare with. Found by running it: initial velocities of `ep` and `rxyz` nodes are rates of the
parameters, those of `rotvec` (Lie group) nodes hold the angular velocity in BODY axes; explicit
solvers refuse `ep`, whose quaternions are held by a constraint; errors of `rotvec` stop falling
near 1e-8 and then grow with the number of steps, where `rxyz` goes on to rounding.
"""

from __future__ import annotations

import itertools
import sys
import time
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from oracles import rotations
from oracles.rotations import Array
from oracles.scenes import GROUND, Scene, start_state

sys.__dict__.setdefault("exudynFast", True)
import exudyn as exu

exu.config.printToConsole = False
items = exu.itemInterface
IMPLICIT = ("GeneralizedAlpha", "TrapezoidalIndex2")
ADAPTIVE_ORDER = {"ODE23": 3, "DOPRI5": 5}  # those with an error estimate


@dataclass(frozen=True)
class Setting:
    """How to run Exudyn: with a `tolerance` the solver chooses its steps, else they are equal."""

    node: str = "rotvec"  # or "ep", "rxyz"
    solver: str = "RK44"  # a name in exu.DynamicSolverType
    steps: int = 1000  # with a tolerance the fewest
    tolerance: float | None = None  # of an ADAPTIVE_ORDER solver, relative and absolute
    linear: str = "EigenSparse"  # or "EXUdense"
    per_body: bool = True  # explicit: invert the mass matrix body by body
    spectral_radius: float = 1.0  # of GeneralizedAlpha at infinite frequency; 1 damps nothing
    modified_newton: bool = True  # implicit: keep the Jacobian while the iteration contracts
    newton: float = 1e-8  # implicit: the residual falls by this factor


@dataclass(frozen=True)
class Result:
    """The state (n, 13) as in `oracles.scenes`, and the times of the solve call alone, s."""

    state: Array
    cpu_seconds: float
    wall_seconds: float


class Try(NamedTuple):
    """One run in the search of `best`; the error is infinite where Exudyn failed."""

    setting: Setting
    result: Result
    error: float


class Failure(RuntimeError):
    """Exudyn gave up, or its numbers are not finite."""


class System:
    """A scene built and assembled in Exudyn; every `run` begins at the scene's start."""

    def __init__(self, scene: Scene, node: str) -> None:
        if scene["law"] not in ("standard", "intrinsic"):
            raise ValueError(f"Exudyn has no law {scene['law']!r}")
        self._container = exu.SystemContainer()
        self._mbs = mbs = self._container.AddSystem()
        ground = mbs.AddObject(items.ObjectGround())
        self._nodes = [mbs.AddNode(_node(node, x)) for x in start_state(scene)]
        bodies = []
        for body, number in zip(scene["bodies"], self._nodes, strict=True):
            J = np.array(body["inertia"], dtype=float)
            J = np.diag(J) if J.ndim == 1 else J
            six = J[[0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]]  # xx yy zz yz xz xy
            rigid = items.ObjectRigidBody(mass=body["mass"], inertia=six, nodeNumber=number)
            bodies.append(mbs.AddObject(rigid))
            if np.any(g := scene["gravity"]):
                at = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=bodies[-1]))
                mbs.AddLoad(items.LoadMassProportional(markerNumber=at, loadVector=g))
        for c in scene["connectors"]:
            c = dict(c)
            mbs.AddObject(items.ObjectConnectorRigidBodySpringDamper(
                markerNumbers=_markers(mbs, c, bodies, ground),
                stiffness=np.array(c.pop("stiffness")),
                damping=np.array(c.pop("damping")), offset=c.pop("offset"),
                useIntrinsicFormulation=scene["law"] == "intrinsic",
            ))  # fmt: skip
            if c:
                raise ValueError(f"entries of a connector not known here: {sorted(c)}")
        for s in scene.get("point_springs", ()):
            mbs.AddObject(items.ObjectConnectorSpringDamper(
                markerNumbers=_markers(mbs, dict(s), bodies, ground), stiffness=s["stiffness"],
                damping=s["damping"], referenceLength=s["length"],
            ))  # fmt: skip
        mbs.Assemble()

    def state(self) -> Array:
        """The current state (n, 13), rows p_W, q_WB, v_W, w_B."""
        kinds = exu.OutputVariableType
        wanted = (kinds.Position, kinds.RotationMatrix, kinds.Velocity, kinds.AngularVelocityLocal)
        read = [[self._mbs.GetNodeOutput(node, kind) for kind in wanted] for node in self._nodes]
        q = [rotations.to_quaternion(R.reshape(3, 3)) for _, R, _, _ in read]
        return np.array([[*p, *q, *v, *w] for (p, _, v, w), q in zip(read, q, strict=True)])

    def run(
        self, setting: Setting, t_end: float, watch: Any = None, every: int = 1,
        limit: float = np.inf,
    ) -> Result:  # fmt: skip
        """Solve to t_end.

        Arguments:
            watch: gets the state before `every` so many steps, which costs time.
            limit: CPU seconds after which the run is given up; to look at the clock costs time.
        """
        kinds = exu.MainSolverExplicit, exu.MainSolverImplicitSecondOrder
        solver, settings = kinds[setting.solver in IMPLICIT](), _simulation_settings(setting, t_end)
        count, deadline, late = itertools.count(), time.process_time() + limit, []

        def before_step(mbs: Any, t: float) -> bool:
            if watch and next(count) % every == 0:
                watch(self.state())
            if time.process_time() >= deadline:
                late.append(t)
            return not late

        self._mbs.SetPreStepUserFunction(before_step if watch or limit < np.inf else 0)
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            success = solver.SolveSystem(self._mbs, settings)
        except (RuntimeError, ValueError) as e:
            raise Failure(str(e).strip().split("\n")[0]) from None
        cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
        if late:
            raise Failure(f"given up after {cpu:.3g} s")
        if not success or not np.isfinite(state := self.state()).all():
            raise Failure(solver.GetErrorString().strip() or "not finite")
        return Result(state, cpu, wall)


def _markers(mbs: Any, c: dict[str, Any], bodies: list[Any], ground: Any) -> list[Any]:
    """The two markers of a connector, whose entries for them are taken out."""
    made = []
    for end in "01":
        i, frame = c.pop(f"body{end}"), np.eye(4)
        frame[:3, :3] = c.pop(f"rotation_marker{end}", np.eye(3))
        frame[:3, 3] = c.pop(f"position{end}")
        body = ground if i == GROUND else bodies[i]
        made.append(mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localHT=frame)))
    return made


def _node(kind: str, x: Array) -> Any:
    """The node of one body at the state x (13), its reference being the start."""
    p, q, v, w_B, R = x[:3], x[3:7], x[7:10], x[10:13], rotations.from_quaternion(x[3:7])
    if kind == "rotvec":
        make, angles, rate = items.NodeRigidBodyRotVecLG, rotations.log_so3(R), w_B
    elif kind == "ep":
        make, angles = items.NodeRigidBodyEP, q
        rate = 0.5 * np.array([-q[1:] @ w_B, *(q[0] * w_B + rotations.cross(q[1:], w_B))])
    elif kind == "rxyz":
        make, angles = items.NodeRigidBodyRxyz, rotations.to_tait_bryan(R)
        (_, sb, sc), (_, cb, cc) = np.sin(angles), np.cos(angles)
        to_w_B = np.array([[cb * cc, sc, 0.0], [-cb * sc, cc, 0.0], [sb, 0.0, 1.0]])
        rate = np.linalg.solve(to_w_B, w_B)
    else:
        raise ValueError(f"no node {kind!r}")
    return make(referenceCoordinates=[*p, *angles], initialVelocities=[*v, *rate])


def _simulation_settings(setting: Setting, t_end: float) -> Any:
    """Nothing written, nothing shown, one thread, and the faster of every choice."""
    settings = exu.SimulationSettings()
    stepping, linear = settings.timeIntegration, settings.linearSolver
    alpha, newton, solution = stepping.generalizedAlpha, stepping.newton, settings.solution
    stepping.solverType = getattr(exu.DynamicSolverType, setting.solver)
    stepping.endTime, stepping.numberOfSteps, h_max = t_end, setting.steps, t_end / setting.steps
    stepping.verboseMode = stepping.verboseModeFile = stepping.stepInformation = 0
    stepping.automaticStepSize = stepping.adaptiveStep = setting.tolerance is not None
    # DOPRI5 and ODE23 fail a fixed step, too, whose error estimate is above the tolerance.
    stepping.relativeTolerance = stepping.absoluteTolerance = setting.tolerance or 1e30
    stepping.minimumStepSize, stepping.initialStepSize = h_max * 1e-7, h_max * 1e-2
    stepping.explicit.computeEndOfStepAccelerations = False
    stepping.explicit.computeMassMatrixInversePerBody = setting.per_body
    alpha.spectralRadius = setting.spectral_radius
    alpha.useNewmark = alpha.useIndex2Constraints = setting.solver == "TrapezoidalIndex2"
    newton.useModifiedNewton, newton.relativeTolerance = setting.modified_newton, setting.newton
    linear.solverType = getattr(exu.LinearSolverType, setting.linear)
    linear.reuseAnalyzedPattern, settings.parallel.numberOfThreads = True, 1
    solution.file.write = solution.sensors.active = False
    solution.solverInformationFileName = ""
    return settings


def run(scene: Scene, setting: Setting, t_end: float | None = None) -> Result:
    """Build the scene and solve it to t_end, the scene's own unless given."""
    return System(scene, setting.node).run(setting, scene["t_end"] if t_end is None else t_end)


def distance(a: Array, b: Array) -> Array:
    """Largest differences (n, 4) in position, rotation matrix, velocity, angular velocity."""
    def parts(x: Array) -> tuple[Array, ...]:
        return x[:3], rotations.from_quaternion(x[3:7]), x[7:10], x[10:13]

    rows = zip(map(parts, a), map(parts, b), strict=True)
    return np.array([[np.abs(p - q).max() for p, q in zip(x, y, strict=True)] for x, y in rows])


def excursion(scene: Scene) -> Array:
    """Largest `distance` (n, 4) from the start during the motion, at least 1e-3."""
    seen, start = [], start_state(scene)
    setting = Setting(solver="DOPRI5", steps=200, tolerance=1e-7)
    system = System(scene, setting.node)
    system.run(setting, scene["t_end"], lambda x: seen.append(distance(x, start)))
    return np.maximum(np.max(seen, axis=0), 1e-3)


def candidates(n: int) -> list[Setting]:
    """Settings to try for n bodies, likely the fastest first; dense matrices only if n is small."""
    free, alpha = ("rotvec", "rxyz"), Setting(solver="GeneralizedAlpha")
    all_ = [Setting(node, s) for s in ("DOPRI5", "RK44", "RK67", "RK33") for node in free]
    all_ += [Setting(node, s, 20, 1.0) for s in ADAPTIVE_ORDER for node in free]
    all_ += [replace(s, per_body=False) for s in all_ if s.node == "rotvec"]
    all_ += [Setting(node, s, newton=1e-6) for s in IMPLICIT for node in (*free, "ep")]
    all_ += [alpha, replace(alpha, spectral_radius=0.9), replace(alpha, modified_newton=False)]
    return all_ + [replace(s, linear="EXUdense") for s in all_ if n <= 4]


def with_effort(setting: Setting, effort: float) -> Setting:
    """16 steps times 2^effort, or the tolerance which should do that."""
    if setting.tolerance is None:
        return replace(setting, steps=round(16 * 2.0**effort))
    return replace(setting, tolerance=1e-2 * 2.0 ** (-effort * ADAPTIVE_ORDER[setting.solver]))


def best(
    scene: Scene, reference: Array, error: float = 1e-6, seconds: float = 20.0
) -> tuple[Setting, Result, float, list[Try]]:
    """The setting that gets below the error in the least CPU time, its run, error, and all tries.

    The error is the largest `distance` to the reference, each relative to its `excursion`. Every
    candidate has its steps doubled until it gets there, then reduced in finer ratios, to 2^(1/8);
    it is left when its next run would take more than `seconds` or four times the fastest so far.
    At last the six fastest run five times in turn: the smallest median wins.
    """
    scale, systems = excursion(scene), {k: System(scene, k) for k in ("rotvec", "ep", "rxyz")}
    tries: list[Try] = []

    def attempt(setting: Setting) -> Try:
        cpu = time.process_time()
        try:
            result = systems[setting.node].run(setting, scene["t_end"])
            off = float((distance(result.state, reference) / scale).max())
        except Failure:
            result, off = Result(np.array(np.nan), time.process_time() - cpu, np.nan), np.inf
        return Try(setting, result, off)

    for base in candidates(len(scene["bodies"])):
        for effort in range(7 if base.tolerance else 20):  # down to 9e-12
            tries.append(now := attempt(with_effort(base, effort)))
            if now.error < error:
                at = float(effort)
                for part in (0.5, 0.25, 0.125):
                    tries.append(attempt(with_effort(base, at - part)))
                    at -= part if tries[-1].error < error else 0.0
                break
            limit = min([seconds, *(4 * t.result.cpu_seconds for t in tries if t.error < error)])
            if 2 * now.result.cpu_seconds > limit:
                break
    good = sorted((t for t in tries if t.error < error), key=lambda t: t.result.cpu_seconds)[:6]
    if not good:
        raise Failure(f"no setting gets below {error:g}: {min(t.error for t in tries):.2g}")
    cpu = np.median([[attempt(t.setting)[1].cpu_seconds for t in good] for _ in range(5)], axis=0)
    setting, result, off = good[np.argmin(cpu)]
    return setting, replace(result, cpu_seconds=min(cpu)), off, tries
