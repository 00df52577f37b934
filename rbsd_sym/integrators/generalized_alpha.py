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
# A step may be longer than asked for by this fraction, to fit an output interval.
_SLACK = 1e-6
# A fixed step is divided into this many at most, where Newton's method needs shorter ones.
_FINEST = 1024
# Growth from one step to the next, at most.
_GROWTH = 2.0
_ADVICE = {
    Outcome.too_many_steps: "raise max_steps, or take longer steps",
    Outcome.step_too_small: "check for a singularity or a discontinuity there, or loosen the "
    "tolerances",
    Outcome.solver_failed: "Newton's method does not converge, however short the step; check for a "
    "discontinuity there, or raise newton_tolerance",
    Outcome.not_finite: "check parameters and start values",
}


class State(NamedTuple):
    """The state of the method after a step.

    Fields:
        t: time, s.
        lag: rounding error of t after a long sum of steps, s (compensated summation).
        x, z: states (n_x,) and algebraic unknowns (n_z,).
        rate: (n_x,) rate of each state (of a velocity the acceleration); zero where none is stored.
        a: (n_x,) the method's own approximation of the rates (see `alpha_step`).
        h: the step that led here, s; 0 at a start.
        bend: (n_x,) change of the rate over that step, divided by h.
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
    """Single steps of generalized-alpha: `start` returns a `State`, `try_step` the next one.

    Trying a step changes nothing but counters: a step may be shortened, repeated with other data
    states, or rejected, and is accepted by going on from its result. After a jump of x or of its
    rates call `start` again.

    Arguments:
        spectral_radius: at infinite frequency, 0 ... 1.
        tolerance: of Newton's method, as `newton_tolerance` of `GeneralizedAlpha`.

    Fields:
        tried, iterations: number of steps tried, and of all their Newton iterations.
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
        """Return the values (n_u,) of the inputs at time t (s)."""
        return input_values(self.experiment.inputs, np.array([t]))[:, 0]

    def start(self, t: float, x: np.ndarray, z: np.ndarray) -> State | Outcome:
        """Return the state to start from, with consistent z and rates.

        Arguments:
            t: s.
            x: states (n_x,).
            z: algebraic unknowns (n_z,), near a solution.

        Returns:
            The state, or the outcome `not_consistent` or `not_finite`.
        """
        model, u, p = self.model, self.inputs(t), self.experiment.p
        z, found = model.consistent(t, x, z, u, p)
        if not found:
            return Outcome.not_consistent
        rate = np.array(rates_function(model)(t, x, z, u, p)).reshape(-1)
        if not np.isfinite(rate).all():
            return Outcome.not_finite
        return State(t, 0.0, x, z, rate, rate, 0.0, np.zeros_like(rate))

    def try_step(self, s: State, h: float, data: np.ndarray | None = None) -> State | Outcome:
        """Return the state after a step, or the outcome that says why there is none.

        Steps may vary in length.

        Arguments:
            s: state before the step.
            h: length of the step, s.
            data: values of the data states during this step; by default those of s.
        """
        # The a of a state is the rate at a time shifted by a fraction of the step that led to it.
        # If the next step is longer by d, velocities get an error of
        # ((1 - rho)/(1 + rho))^2/2 h d v'', which is of first order only where steps keep changing.
        # Scaling a - rate by the ratio of the steps would remove it, but lets stiff oscillations
        # grow (by 1.26 in each cycle of steps 8 4 2 1 2 4 with rho = 0.9).
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
        # Compensated summation: what t + h loses by rounding is added to the next step.
        passed, bend = h + s.lag, (rate - s.rate) / h
        t = s.t + passed
        lag = passed - (t - s.t)
        return State(t, lag, x.copy(), z.copy(), rate.copy(), a.copy(), h, bend)


@dataclass(frozen=True)
class GeneralizedAlpha:
    """Generalized-alpha: order 2, unconditionally stable, with selectable numerical damping.

    [Chung, Hulbert 1993] with the recursion of [Arnold, Bruels 2007], on the Lie group of positions
    and rotations [Bruels, Cardona 2010]: a step rotates a body by a rotation vector, so that
    quaternions keep their norm and angles their digits. States of first order follow [Jansen,
    Whiting, Hulbert 2000]; algebraic unknowns solve their equations at the end of each step.

    Without tolerances steps are fixed: the interval between two output times is divided into the
    fewest equal steps that are not longer than `step`. Where Newton's method does not converge,
    shorter steps are taken, and counted in `stats["rejected_steps"]`.

    With tolerances `step` is the first step, and the local error of each one is estimated: that of
    coordinates from the change of the acceleration [Zienkiewicz, Xie 1991], that of states of first
    order from divided differences of their rates, as in circuit simulators [Nagel 1975], both with
    the constants of this method. Errors of velocities are not controlled: that would resolve every
    stiff vibration, which this method is meant to step over.

    Arguments:
        step: s.
        spectral_radius: factor by which a step reduces an oscillation much faster than the step,
            0 ... 1. 1 is the trapezoidal rule, which damps nothing; 0 damps most.
        rtol, atol: relative and absolute local error of coordinates and of states of first order
            (SI units); give both or neither.
        newton_tolerance: largest last correction of Newton's method, relative to 1 + |value| in SI
            units. Convergence is quadratic: the error left is about its square.
        post_newton: how far post-Newton steps are resolved.
        max_steps: in the whole run, including rejected steps.

    Raises:
        ValueError: an argument out of its range, or only one of rtol and atol.

    >>> simulate(model, 2.0, GeneralizedAlpha(1e-3, spectral_radius=0.8))  # doctest: +SKIP
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
                f"GeneralizedAlpha: spectral_radius {self.spectral_radius!r}; give a number in "
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
                f"GeneralizedAlpha: max_steps {self.max_steps!r}; give a whole number above 0"
            )

    def step_function(self, model: Model) -> ca.Function:
        """Return one step as a CasADi Function, which can be generated to C.

        Its arguments and results are described at `integrators.alpha_step.step_function`.
        """
        return step_function(model, self.spectral_radius, self.newton_tolerance)

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate an experiment.

        Returns:
            The trajectory, up to the failure if there was one, which is its `outcome`.
        """
        started = time.perf_counter()
        run = _AlphaRun(experiment, self.step)
        # Nothing in the scene can move.
        if model.n_x + model.n_z == 0:
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
            "events": float(len(switch.watch.fired)),
            "time": time.perf_counter() - built,
            "time_build": built - started,
        }
        # The start is always part of the trajectory.
        n, report = max(run.saved, 1), outcome.value
        x, z = run.x[:n], run.z[:n]
        if isinstance(end, SegmentEnd):
            stats["t_failed"], report = end.t, end.report
        elif not outcome.ok:
            stats["t_failed"] = run.t
            report = _report(model, experiment, x, z, outcome, run.t)
        fired = switch.watch.fired
        return assemble(model, experiment, x, z, outcome, report, stats, fired)

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
                # A rejected step returns the old state.
                accepted = isinstance(new, State) and new is not state
                point = switch.after(state, new) if accepted else None
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
        """Take one step towards an output time.

        Arguments:
            s: state before the step.
            target: next output time, s.
            errors: estimates for steps that adapt; None for fixed steps.

        Returns:
            The next state, s itself if the step was rejected, or the outcome of a failure.
        """
        left = target - s.t - s.lag
        parts = max(1, math.ceil(left / run.proposed - _SLACK))
        h = left / parts
        shortest = 16 * _EPSILON * run.latest if errors else self.step / _FINEST
        new, shorter = switch.solved(s, h)
        if shorter is not None:
            run.reject(shorter)
            return s
        if isinstance(new, Outcome):
            run.reject(0.25 * h if errors else 0.5 * h)
            return new if h <= shortest else s
        if errors is None:
            run.accept(min(self.step, 2 * run.proposed, switch.proposed))
        else:
            error = errors.of(s, new)
            # The local error is of order h^3; 0.9 is a margin.
            best = h * 0.9 * max(error, 1e-9) ** (-1 / 3)
            if not error <= 1:
                run.reject(max(0.2 * h, best) if np.isfinite(error) else 0.2 * h)
                return Outcome.step_too_small if h <= shortest else s
            growth = 1.0 if run.shrunk else _GROWTH
            run.accept(min(best, growth * run.proposed, switch.proposed))
        # The last step of an interval ends on the output time exactly.
        return new._replace(t=target, lag=0.0) if parts == 1 else new


def _is_real(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _check(name: str, value: object, low: float, high: float, unit: str = "") -> None:
    if not (_is_real(value) and low < value < high):  # type: ignore[operator]
        rule = "positive, finite number" if high == math.inf else f"number in {low:g} ... {high:g}"
        raise ValueError(f"GeneralizedAlpha: {name} {value!r}{unit}; give a {rule}")


def _report(
    model: Model, e: Experiment, x: np.ndarray, z: np.ndarray, outcome: Outcome, t: float
) -> str:
    if not model.n_x:
        return f"{outcome.value} at t = {t:.9g} s; {_ADVICE[outcome]}"
    return failure_report(model, e, x, z, outcome, t, _ADVICE[outcome])


class _AlphaRun:
    """State of the integration: time, points saved so far, and the step proposed next."""

    def __init__(self, experiment: Experiment, step: float) -> None:
        self.times, n = experiment.t, len(experiment.t)
        self.t, self.proposed, self.shrunk = float(experiment.t[0]), step, False
        self.latest = float(np.abs(experiment.t[[0, -1]]).max())
        self.saved, self.steps, self.rejected = 0, 0, 0
        self.x, self.z = np.zeros((n, experiment.x.size)), np.zeros((n, experiment.z.size))
        self.x[0], self.z[0] = experiment.x, experiment.z

    def save(self, s: State) -> None:
        """Store the state at the next output time."""
        self.x[self.saved], self.z[self.saved] = s.x, s.z
        self.saved += 1

    def accept(self, proposed: float) -> None:
        """Count a step, and store the length proposed for the next one, s."""
        self.steps, self.proposed, self.shrunk = self.steps + 1, proposed, False

    def reject(self, proposed: float) -> None:
        """Count a rejected step, and store the shorter one proposed, s."""
        self.rejected, self.proposed, self.shrunk = self.rejected + 1, proposed, True


class _Errors:
    """Local errors of coordinates and of first-order states, relative to the tolerances."""

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
        self._scale_rows = _padded([part.scale_rows for part in moved])

    def of(self, s: State, new: State) -> float:
        """Return the largest error of a step; up to 1 the step is accepted."""
        if not self._slots:
            return 0.0
        h, bend = new.h, new.bend[self._slots]
        # The error of a coordinate is a multiple of h^3 v'', that of a first-order state of h^3
        # y'''. The third derivative is a divided difference over this step and the one before; at a
        # start, bend / h overestimates it, which makes the first step rather too short.
        third = 2 * (bend - s.bend[self._slots]) / (h + s.h) if s.h else bend / h
        errors = self._constants * h**3 * np.abs(np.where(self._second, bend, third))
        size = self._atol + self._rtol * np.maximum(np.abs(s.x), np.abs(new.x))
        return float((errors / size[self._scale_rows].max(axis=1)).max())


def _padded(rows: list[tuple[int, ...]]) -> np.ndarray:
    """Return rows of unequal length as a matrix, with the first entry of each row repeated."""
    n = max((len(row) for row in rows), default=1)
    return np.array([row + row[:1] * (n - len(row)) for row in rows], int).reshape(-1, n)
