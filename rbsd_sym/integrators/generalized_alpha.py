"""Generalized-alpha on R3 x SO(3): second order, with numerical damping of high frequencies."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from numbers import Real
from typing import ClassVar, NamedTuple

import casadi as ca
import numpy as np

from ..model.model import Model
from ..model.signals import is_constant
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .alpha_step import Groups, first_order, rates_function, second_order, step_function
from .alpha_switch import Switch
from .driver import assemble, failure_report, input_values, not_consistent
from .events import SegmentEnd, guarded
from .post_newton import PostNewton

_EPSILON = float(np.finfo(float).eps)
_SLACK = 1e-6  # by how much of itself a step may be longer than asked for, to fit an interval
_FINEST = 1024  # parts of a fixed step, where Newton's method needs shorter ones
_GROWTH = 2.0  # of a step, at most
_ADVICE = {
    Outcome.too_many_steps: "raise max_steps, or take longer steps",
    Outcome.step_too_small: "look for a singularity or a discontinuity there, or loosen the "
    "tolerances",
    Outcome.solver_failed: "Newton's method finds no end of the step, however short; look for a "
    "discontinuity there, or raise newton_tolerance",
    Outcome.not_finite: "check parameters and start values",
}


class State(NamedTuple):
    """Where the integration is.

    Fields:
        t, lag: time, and what rounding has kept from it in a long sum of steps, s.
        x, z: states and algebraic unknowns.
        rate, a: for each state its rate, of a velocity the acceleration, and the method's own a;
            zero where none is kept (`alpha_step`).
        h: the step that led here, s; 0 at a start.
        bend: change of the rate over that step, by h.
    """

    t: float
    lag: float
    x: np.ndarray
    z: np.ndarray
    rate: np.ndarray
    a: np.ndarray
    h: float
    bend: np.ndarray


class Stepper:
    """Single steps: `start` gives a `State`, `try_step` the next one.

    To accept a step is to go on from it: trying changes nothing but counters, so that a step may be
    cut, repeated with other data states, or left. After a jump of x or its rates, start again.
    """

    def __init__(
        self, model: Model, experiment: Experiment, spectral_radius: float, tolerance: float
    ) -> None:
        self.model, self.experiment, self.tolerance = model, experiment, tolerance
        self.function = step_function(model, spectral_radius, tolerance)
        self.data = list(model.dae.data)
        self.tried, self.iterations = 0, 0
        self._constant = all(is_constant(signal) for signal in experiment.inputs)
        n, m = model.n_x, model.n_z
        self._in = [np.zeros(size) for size in (1, 1, n, n, n, m)]
        self._in += [self.inputs(float(experiment.t[0])), experiment.p.astype(float)]
        self._out = [np.zeros(size) for size in (n, n, n, m, 1, 1)]
        self._buffer, self._evaluate = self.function.buffer()
        for i, value in enumerate(self._in):
            if value.size:
                self._buffer.set_arg(i, memoryview(value))  # type: ignore[arg-type]
        for i, value in enumerate(self._out):
            if value.size:
                self._buffer.set_res(i, memoryview(value))  # type: ignore[arg-type]

    def inputs(self, t: float) -> np.ndarray:
        """Values of the inputs."""
        return input_values(self.experiment.inputs, np.array([t]))[:, 0]

    def start(self, t: float, x: np.ndarray, z: np.ndarray) -> State | Outcome:
        """The state to start from; z need only be near a solution."""
        model, u, p = self.model, self.inputs(t), self.experiment.p
        z, found = model.consistent(t, x, z, u, p)
        if not found:
            return Outcome.not_consistent
        rate = np.array(rates_function(model)(t, x, z, u, p)).reshape(-1)
        if not np.isfinite(rate).all():
            return Outcome.not_finite
        return State(t, 0.0, x, z, rate, rate, 0.0, np.zeros_like(rate))

    def try_step(self, s: State, h: float, data: np.ndarray | None = None) -> State | Outcome:
        """The state a step of h further on, or why there is none.

        Steps may vary. The a of a state is the rate at a time shifted by a share of the step that
        led to it; where the next one is longer by d, velocities take ((1 - rho)/(1 + rho))^2/2 h d
        v'' of it, which is of first order only where steps keep jumping. Scaling a - rate by the
        ratio of the steps would undo that, but lets stiff oscillations grow (by 1.26 a round with
        steps as 8 4 2 1 2 4 and rho = 0.9).

        Arguments:
            data: values of the data states during this step, if they are to change.
        """
        self._in[0][0], self._in[1][0] = s.t, h
        for given, value in zip(self._in[2:], (s.x, s.rate, s.a, s.z), strict=False):
            given[:] = value
        if data is not None:
            self._in[2][self.data] = data
        if not self._constant:
            self._in[6][:] = self.inputs(s.t + h)
        self._evaluate()
        x, rate, a, z, size, iterations = self._out
        self.tried += 1
        self.iterations += int(iterations[0])
        if not size[0] <= self.tolerance:
            return Outcome.solver_failed if np.isfinite(size[0]) else Outcome.not_finite
        if not (np.isfinite(x).all() and np.isfinite(z).all() and np.isfinite(rate).all()):
            return Outcome.not_finite
        passed, bend = h + s.lag, (rate - s.rate) / h
        t = s.t + passed
        lag = passed - (t - s.t)
        return State(t, lag, x.copy(), z.copy(), rate.copy(), a.copy(), h, bend)


@dataclass(frozen=True)
class GeneralizedAlpha:
    """Order 2, unconditionally stable, with the damping of high frequencies to be chosen.

    [Chung, Hulbert 1993] with the recursion of [Arnold, Bruels 2007], on the Lie group of positions
    and rotations [Bruels, Cardona 2010]: a step turns a body by a rotation vector, so that
    quaternions stay units and angles keep their digits. States of first order follow
    [Jansen, Whiting, Hulbert 2000]; algebraic unknowns solve their equations at the end of a step.

    Without tolerances steps are fixed: the interval between two output times is cut into the fewest
    equal steps that are not longer than `step`. Where Newton's method does not find the end of a
    step, shorter ones are taken; `rejected_steps` counts them.

    With tolerances `step` is the first one, and the local error of each is estimated: that of
    coordinates from the change of the acceleration [Zienkiewicz, Xie 1991], that of states of first
    order from divided differences of their rates, as in circuit simulators [Nagel 1975], both with
    the constants of this method. Velocities are not looked at: that would resolve every stiff
    vibration, which this method is there to step over.

    Arguments:
        step: s.
        spectral_radius: what a step leaves of an oscillation much faster than the step, 0 ... 1.
            1 is the trapezoidal rule, which damps nothing; 0 damps most.
        rtol, atol: relative and absolute local error of coordinates and of states of first order;
            both or none.
        post_newton: how far post-Newton steps are resolved (`integrators.post_newton`).
        newton_tolerance: last correction of Newton's method, relative to 1 + |value| in SI units.
            Convergence is quadratic: the error left is about its square.
        max_steps: in all, those rejected too.
    """

    step: float
    spectral_radius: float = 0.9
    rtol: float | None = None
    atol: float | None = None
    newton_tolerance: float = 1e-8
    post_newton: PostNewton = field(default_factory=PostNewton)
    max_steps: int = 1_000_000
    solves_algebraic: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check("step", self.step, 0.0, math.inf, " s")
        if not (_is_real(self.spectral_radius) and 0 <= self.spectral_radius <= 1):
            raise ValueError(
                f"GeneralizedAlpha: spectral_radius {self.spectral_radius!r}; it is a number in "
                "0 ... 1"
            )
        if (self.rtol is None) != (self.atol is None):
            raise ValueError(
                f"GeneralizedAlpha: rtol {self.rtol!r} and atol {self.atol!r}; give both for steps "
                "that adapt, none for fixed ones"
            )
        if self.rtol is not None:
            _check("rtol", self.rtol, 0.0, 1.0)
            _check("atol", self.atol, 0.0, math.inf)
        _check("newton_tolerance", self.newton_tolerance, 1e-15, 1e-3)
        if not isinstance(self.max_steps, int) or not self.max_steps > 0:
            raise ValueError(
                f"GeneralizedAlpha: max_steps {self.max_steps!r}; it is a whole number above 0"
            )

    def step_function(self, model: Model) -> ca.Function:
        """One step as a CasADi Function, which generates to C; see `alpha_step.step_function`."""
        return step_function(model, self.spectral_radius, self.newton_tolerance)

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate; a failure is a `Trajectory` up to it with its `Outcome`."""
        started = time.perf_counter()
        run = _AlphaRun(experiment, self.step)
        if model.n_x + model.n_z == 0:  # nothing in the scene can move
            end = Outcome.reached_end
            return assemble(model, experiment, run.x, run.z, end, end.value, {"time": 0.0})
        stepper = Stepper(model, experiment, self.spectral_radius, self.newton_tolerance)
        built = time.perf_counter()
        switch = Switch(model, experiment, stepper.try_step, self.post_newton, self.step)
        with np.errstate(over="ignore", invalid="ignore"):
            end = guarded(lambda: self._integrate(stepper, run, switch))
        outcome = (end.outcome or Outcome.solver_failed) if isinstance(end, SegmentEnd) else end
        if outcome is Outcome.not_consistent:
            return not_consistent(model, experiment)
        stats = {
            "steps": float(run.steps),
            "rejected_steps": float(run.rejected),
            "newton_iterations": float(stepper.iterations),
            "events": float(len(switch.watch.happened)),
            "time": time.perf_counter() - built,
            "time_build": built - started,
        }
        n, report = max(run.saved, 1), outcome.value  # the start is kept, whatever it is
        x, z = run.x[:n], run.z[:n]
        if isinstance(end, SegmentEnd):
            stats["t_failed"], report = end.t, end.report
        elif not outcome.ok:
            stats["t_failed"] = run.t
            report = _report(model, experiment, x, z, outcome, run.t)
        happened = switch.watch.happened
        return assemble(model, experiment, x, z, outcome, report, stats, happened)

    def _integrate(self, stepper: Stepper, run: _AlphaRun, switch: Switch) -> Outcome:
        start = stepper.start(run.t, run.x[0], run.z[0])
        if isinstance(start, State) and stepper.model.events:
            start = stepper.start(run.t, *switch.begin(run.t, start.x, start.z))
        if isinstance(start, Outcome):
            return start
        state, errors = start, self._errors(stepper.model)
        run.save(state)
        for target in run.times[1:]:
            while state.t < target:
                if run.steps + run.rejected >= self.max_steps:
                    return Outcome.too_many_steps
                new = self._step(stepper, run, state, float(target), errors, switch)
                went = isinstance(new, State) and new is not state  # else the step was rejected
                point = switch.after(state, new) if went else None
                if point is not None:
                    new = stepper.start(point.t, point.x, point.z)
                if isinstance(new, Outcome):
                    return new
                state = new
                run.t = state.t
            run.save(state)
        return Outcome.reached_end

    def _errors(self, model: Model) -> _Errors | None:
        if self.rtol is None or self.atol is None:
            return None
        return _Errors(model, self.spectral_radius, self.rtol, self.atol)

    def _step(
        self,
        stepper: Stepper,
        run: _AlphaRun,
        s: State,
        target: float,
        errors: _Errors | None,
        switch: Switch,
    ) -> State | Outcome:
        """The next state on the way to an output time, or the old one after a step rejected."""
        left = target - s.t - s.lag
        parts = max(1, math.ceil(left / run.wish - _SLACK))
        h = left / parts
        shortest = 16 * _EPSILON * run.reach if errors else self.step / _FINEST
        new, shorter = switch.solved(s, h)
        if shorter is not None:
            run.reject(shorter)
            return s
        if isinstance(new, Outcome):
            run.reject(0.25 * h if errors else 0.5 * h)
            return new if h <= shortest else s
        if errors is None:
            run.accept(min(self.step, 2 * run.wish, switch.wish))
        else:
            error = errors.of(s, new)
            best = h * 0.9 * max(error, 1e-9) ** (-1 / 3)
            if not error <= 1:
                run.reject(max(0.2 * h, best) if np.isfinite(error) else 0.2 * h)
                return Outcome.step_too_small if h <= shortest else s
            growth = 1.0 if run.shrunk else _GROWTH
            run.accept(min(best, growth * run.wish, switch.wish))
        return new._replace(t=target, lag=0.0) if parts == 1 else new


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _check(name: str, value: object, low: float, high: float, unit: str = "") -> None:
    if not (_is_real(value) and low < value < high):  # type: ignore[operator]
        rule = "positive and finite" if high == math.inf else f"a number in {low:g} ... {high:g}"
        raise ValueError(f"GeneralizedAlpha: {name} {value!r}{unit}; it is {rule}")


def _report(
    model: Model, e: Experiment, x: np.ndarray, z: np.ndarray, outcome: Outcome, t: float
) -> str:
    if not model.n_x:
        return f"{outcome.value} at t = {t:.9g} s; {_ADVICE[outcome]}"
    return failure_report(model, e, x, z, outcome, t, _ADVICE[outcome])


class _AlphaRun:
    """Where the integration is, the points saved so far, and the step it would like to take."""

    def __init__(self, experiment: Experiment, step: float) -> None:
        self.times, n = experiment.t, len(experiment.t)
        self.t, self.wish, self.shrunk = float(experiment.t[0]), step, False
        self.reach = float(np.abs(experiment.t[[0, -1]]).max())
        self.saved, self.steps, self.rejected = 0, 0, 0
        self.x, self.z = np.zeros((n, experiment.x.size)), np.zeros((n, experiment.z.size))
        self.x[0], self.z[0] = experiment.x, experiment.z

    def save(self, s: State) -> None:
        """Keep the state at the next output time."""
        self.x[self.saved], self.z[self.saved] = s.x, s.z
        self.saved += 1

    def accept(self, wish: float) -> None:
        """Count a step, and wish for the next."""
        self.steps, self.wish, self.shrunk = self.steps + 1, wish, False

    def reject(self, wish: float) -> None:
        """Count a rejected step, and wish for a shorter one."""
        self.rejected, self.wish, self.shrunk = self.rejected + 1, wish, True


class _Errors:
    """Local errors relative to the tolerances: of coordinates and of states of first order."""

    def __init__(self, model: Model, rho: float, rtol: float, atol: float) -> None:
        moved = Groups(model.dae).moved
        second, first = second_order(rho), first_order(rho)
        constants = [
            second.error_of_position if p.second else (second if p.with_velocity else first).error
            for p in moved
        ]
        self._rtol, self._atol = rtol, atol
        self._constants = np.abs(constants)
        self._slots = [part.slot for part in moved]
        self._second = np.array([part.second for part in moved], bool)
        self._beside = _padded([part.beside for part in moved])

    def of(self, s: State, new: State) -> float:
        """The largest; 1 is as large as may be."""
        if not self._slots:
            return 0.0
        h, bend = new.h, new.bend[self._slots]
        # Without a step before, one order less: the first step is then rather too short.
        third = 2 * (bend - s.bend[self._slots]) / (h + s.h) if s.h else bend / h
        errors = self._constants * h**3 * np.abs(np.where(self._second, bend, third))
        size = self._atol + self._rtol * np.maximum(np.abs(s.x), np.abs(new.x))
        return float((errors / size[self._beside].max(axis=1)).max())


def _padded(rows: list[tuple[int, ...]]) -> np.ndarray:
    """Rows of unequal length as a matrix, the first entry of each repeated."""
    n = max((len(row) for row in rows), default=1)
    return np.array([row + row[:1] * (n - len(row)) for row in rows], int).reshape(-1, n)
