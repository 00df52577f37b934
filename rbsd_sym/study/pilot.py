"""Pilot runs: short runs that measure what integrators cost on a model and how accurate they are.

Beside them are measured the cost of one call of the model's functions, and the fastest modes of its
linearised motion. `recommend` decides with these numbers.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..model.model import Model
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment, Given
from ..pipeline import simulate
from .work_precision import ErrorOf

_ALL_EIGENVALUES = 300  # states, up to which all eigenvalues are computed
_POWER_ITERATIONS = 60  # for larger models
_TIMING = 2e-3  # s, for which one function is called again and again
_REPEAT_BELOW = 0.1  # s: only shorter runs are timed a second time


class Costs(NamedTuple):
    """CPU time (s) of one call of the rates, of their Jacobian, and of a linear solve with it."""

    rates: float
    jacobian: float
    solve: float


class Modes(NamedTuple):
    """The fastest modes of the motion, linearised at several points.

    Fields:
        fastest: largest |eigenvalue|, 1/s.
        damping: damping ratio of that mode, -Re / |eigenvalue|; NaN if only its size is known.
        ringing: largest |eigenvalue| among oscillations with a damping ratio below 0.02 that are at
            least ten times as fast as the slowest oscillation, 1/s; 0 if there is none.
    """

    fastest: float
    damping: float
    ringing: float


class Trial(NamedTuple):
    """Result of one pilot run.

    Fields:
        error: as in `work_precision`; None if the run failed.
        seconds: CPU time of the run.
        steps, evaluations, jacobians: counts; NaN where the integrator does not report them.
        outcome: how the run ended.
    """

    error: float | None
    seconds: float
    steps: float
    evaluations: float
    jacobians: float
    outcome: Outcome


class Pilot:
    """Runs over the beginning of a simulation, compared with a more accurate run.

    Arguments:
        model: to simulate.
        grid: output times (n,), s.
        given: inputs, params and start, as in `simulate`.
        most: largest number of steps between two output times.
    """

    def __init__(self, model: Model, grid: np.ndarray, given: Given, most: int) -> None:
        self.model, self.grid, self.given, self.most = model, grid, given, most
        self._judge: ErrorOf | None = None
        self.path: Trajectory | None = None
        self.floor = math.nan

    def run(self, integrator: Any, most: int | None = None) -> Trajectory | None:
        """Simulate; return None if the integrator cannot even be built for this model.

        Arguments:
            integrator: its own limit on the number of steps is replaced.
            most: largest number of steps, that of the pilot by default.
        """
        if hasattr(integrator, "max_steps"):
            integrator = replace(integrator, max_steps=most or self.most)
        try:
            return simulate(self.model, self.grid, integrator, throw=False, **self.given)
        except RuntimeError:  # CasADi raises it for functions that it cannot differentiate
            return None

    def refer_to(self, methods: list[Any]) -> bool:
        """Choose the first method that reaches the end as the reference, the next to check it.

        The difference of the two is kept as `floor`, below which errors mean nothing.

        Returns:
            Whether there is a reference.
        """
        good: list[Trajectory] = []
        for method in methods:
            found = self.run(method, 10 * self.most)
            if found is not None and found.outcome.ok:
                good.append(found)
            if len(good) == 2:
                break
        if not good:
            return False
        self._judge, self.path = ErrorOf(self.model, good[0]), good[0]
        if len(good) == 2:
            self.floor = self._error(good[1])
        return True

    def _error(self, trajectory: Trajectory) -> float:
        assert self._judge is not None
        with np.errstate(all="ignore"):
            errors = self._judge(trajectory).values()
        return max((e for e in errors if e is not None), default=0.0)

    def attempt(self, integrator: Any) -> Trial:
        """Return error and CPU time of a run.

        The integrator is built by a first run, which is not timed. Of two timed runs the shorter
        counts; long ones are timed once.
        """
        seconds, found = math.inf, self.run(integrator)
        if found is None:
            return Trial(None, seconds, math.nan, math.nan, math.nan, Outcome.solver_failed)
        for _ in range(2):
            began = time.thread_time()
            found = self.run(integrator) or found
            took = time.thread_time() - began
            seconds = min(seconds, took)
            if took > _REPEAT_BELOW or not found.outcome.ok:
                break
        error = self._error(found) if found.outcome.ok else math.nan
        steps, calls, jacobians = (
            float(found.stats.get(key, math.nan)) for key in ("steps", "evaluations", "jacobians")
        )
        known = error if math.isfinite(error) else None
        return Trial(known, seconds, steps, calls, jacobians, found.outcome)


def costs(model: Model, experiment: Experiment) -> Costs:
    """Measure the CPU time of one call of the model's functions, at the start."""
    e, names = experiment, ["ode", "dode_dx"]
    given = [e.t[:1], e.x, e.z, np.zeros(model.n_u), e.p]
    rates, jacobian = (_seconds(model.function(name), given) for name in names)
    pattern = model.function("dode_dx").sparsity_out(0) + ca.Sparsity.diag(model.n_x)
    A, b = ca.MX.sym("A", pattern), ca.MX.sym("b", model.n_x)
    solver = ca.Function("solve", [A, b], [ca.solve(A, b, "qr" if model.n_x <= 60 else "csparse")])
    # The time of a solve depends mostly on the pattern. A dominant diagonal makes the matrix
    # regular, whatever the Jacobian is at the start.
    matrix = ca.DM(pattern, 1.0) + model.n_x * ca.DM.eye(model.n_x)
    return Costs(rates, jacobian, _seconds(solver, [np.array(matrix.nonzeros()), e.x]))


def _seconds(function: ca.Function, given: list[np.ndarray]) -> float:
    """Return the CPU time (s) of one call, without what Python adds.

    CasADi's buffers call a Function on fixed memory; the usual call converts each argument.
    """
    buffer, evaluate = function.buffer()
    kept = [np.ascontiguousarray(value, float) for value in given]
    results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, value in enumerate(kept):
        if value.size:
            buffer.set_arg(i, memoryview(value))  # type: ignore[arg-type]
    for i, value in enumerate(results):
        if value.size:
            buffer.set_res(i, memoryview(value))  # type: ignore[arg-type]
    evaluate()
    began, calls = time.thread_time(), 0
    while time.thread_time() - began < _TIMING or not calls:
        evaluate()
        calls += 1
    return (time.thread_time() - began) / calls


def modes(model: Model, trajectory: Trajectory, experiment: Experiment, points: int = 5) -> Modes:
    """Return the fastest modes at the start and at some of the saved points.

    Arguments:
        trajectory: of this model, with this experiment.
        points: how many saved points are used at most, the first and the last included.
    """
    rows = np.unique(np.linspace(0, len(trajectory.t) - 1, points).astype(int))
    found = [_modes_at(model, trajectory, experiment, int(row)) for row in rows]
    fastest = max(found, key=lambda m: m.fastest)
    return fastest._replace(ringing=max(m.ringing for m in found))


def _modes_at(model: Model, trajectory: Trajectory, e: Experiment, row: int) -> Modes:
    def column(labels: Any) -> np.ndarray:
        return np.array([trajectory[label.name][row] for label in labels], float)

    dae = model.dae
    point = (
        float(trajectory.t[row]),
        column(dae.x_labels),
        column(dae.z_labels),
        column(dae.u_labels),
        e.p,
    )
    A: ca.DM = model.function("dode_dx")(*point)
    # With algebraic unknowns, 0 = g(x, z) makes dz = -g_z^-1 g_x dx, so the motion of the states
    # has the Jacobian f_x - f_z g_z^-1 g_x. Least squares also copes with a singular g_z.
    if model.n_z:
        names = ("dode_dz", "dalg_dz", "dalg_dx")
        f_z, g_z, g_x = (np.array(ca.DM(model.function(name)(*point))) for name in names)
        A = ca.DM(np.array(ca.DM(A)) - f_z @ np.linalg.lstsq(g_z, g_x, rcond=None)[0])
    if model.n_x > _ALL_EIGENVALUES:
        return Modes(_power(A), math.nan, 0.0)
    values = np.linalg.eigvals(np.array(ca.DM(A)))
    size = np.abs(values)
    worst = int(np.argmax(size))
    if size[worst] == 0:
        return Modes(0.0, math.nan, 0.0)
    # Imaginary parts that are rounding of the largest eigenvalue do not make an oscillation.
    oscillates = np.abs(values.imag) > 1e-6 * size[worst]
    slow = float(size[oscillates].min()) if oscillates.any() else 0.0
    rings = oscillates & (-values.real < 0.02 * size) & (size > 10 * slow)
    return Modes(
        float(size[worst]),
        float(-values[worst].real / size[worst]),
        float(size[rings].max(initial=0.0)),
    )


def _power(A: ca.DM) -> float:
    """Return the modulus of the largest eigenvalue, by power iteration."""
    # The largest eigenvalues may be a complex pair, under which the growth from one product to the
    # next oscillates. So its logarithm is averaged over the second half of the iterations.
    v, growth = ca.DM(np.random.default_rng(1).normal(size=A.shape[0])), 0.0
    for k in range(_POWER_ITERATIONS):
        v = A @ v
        size = float(ca.norm_2(v))
        if not 0 < size < math.inf:
            return 0.0
        v /= size
        growth += math.log(size) if k >= _POWER_ITERATIONS // 2 else 0.0
    return math.exp(growth / (_POWER_ITERATIONS - _POWER_ITERATIONS // 2))
