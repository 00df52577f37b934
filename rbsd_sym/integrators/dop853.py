"""DOP853: explicit Runge-Kutta of order 8, dense output of order 7, for ODEs that are not stiff."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ..base.tableau import E3, E5, A, C, D
from ..model.model import Model
from ..model.signals import is_constant
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import assemble, failure_report, input_values
from .events import Instant, SegmentEnd, Watch, guarded
from .options import check_options, refuse_unknowns, refuse_updates

# An ODE has no algebraic unknowns.
_NONE = np.zeros(0)
# Checks for events in a step.
_CHECKS = 4
_EPSILON = float(np.finfo(float).eps)
_ADVICE = {
    Outcome.too_many_steps: "raise max_steps, loosen the tolerances, or for stiff connectors use "
    "Idas() or Rosenbrock()",
    Outcome.step_too_small: "check for a singularity or a discontinuity there",
    Outcome.not_finite: "check parameters and start values",
}


@dataclass(frozen=True)
class Dop853:
    """Explicit Runge-Kutta of order 8(5, 3), DOP853 [Hairer, Norsett, Wanner 1993, sec. II.10].

    For models that are not stiff: the stiffest connector limits its steps. It locates events on its
    dense output of order 7; algebraic unknowns and post-Newton steps are not supported. Steps end
    on output times that are two or more steps apart; other output times are interpolated.

    This one runs in Python: a step of one body takes about 0.26 ms. `export_simulator` writes the
    same method to C (for models without events), where it is the fastest method here for scenes
    that are not stiff (generated/charts/compiler.md).

    Arguments:
        rtol, atol: relative and absolute local error of each state (SI units).
        max_steps: in the whole run, including rejected steps.

    Raises:
        ValueError: an option out of its range.

    >>> simulate(model, 2.0, Dop853(rtol=1e-10, atol=1e-12))  # doctest: +SKIP
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    max_steps: int = 1_000_000
    plugin: ClassVar[str] = ""
    solves_algebraic: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_options(self)

    @property
    def casadi_options(self) -> Mapping[str, Any]:
        """Empty, since CasADi does not integrate here."""
        return {}

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate an experiment.

        Returns:
            The trajectory, up to the failure if there was one, which is its `outcome`.

        Raises:
            ValueError: the model has algebraic unknowns or post-Newton steps.
        """
        refuse_unknowns(model)
        refuse_updates(model, type(self).__name__)
        started = time.perf_counter()
        rates, run = _Rates(model, experiment), _PairRun(experiment, Watch(model, experiment))
        with np.errstate(over="ignore", invalid="ignore"):
            end = guarded(lambda: self._integrate(rates, run) if model.n_x else Outcome.reached_end)
        outcome = (end.outcome or Outcome.solver_failed) if isinstance(end, SegmentEnd) else end
        stats = {
            "steps": float(run.steps),
            "evaluations": float(rates.count),
            "rejected_steps": float(run.rejected),
            "events": float(len(run.watch.fired)),
            "time": time.perf_counter() - started,
        }
        n, report = run.saved if model.n_x else len(experiment.t), outcome.value
        x, z = run.x[:n], np.zeros((n, 0))
        if isinstance(end, SegmentEnd):
            stats["t_failed"], report = end.t, end.report
        elif not outcome.ok:
            stats["t_failed"] = run.t
            report = failure_report(model, experiment, x, z, outcome, run.t, _ADVICE[outcome])
        return assemble(model, experiment, x, z, outcome, report, stats, run.watch.fired)

    def _integrate(self, rates: _Rates, run: _PairRun) -> Outcome:
        """Step from the start to the end; PI control of the steps, in terms of the error e."""
        k, x, end = run.k, run.begin(), run.end
        shortest = 16 * _EPSILON * max(abs(run.t), abs(end))
        k[0] = rates(run.t, x)
        if not np.isfinite(k[0]).all():
            return Outcome.not_finite
        h, before, rejected = self._first_step(rates, run, x), 1e-4, False
        while run.t < end:
            wanted = h
            h, reached = run.fitted(wanted)
            if wanted <= shortest and reached < end:
                return Outcome.step_too_small
            if run.steps + run.rejected >= self.max_steps:
                return Outcome.too_many_steps
            y = _step(rates, run.t, h, x, k)
            e = self._error(h, x, y, k)
            if not e <= 1:
                if h <= shortest:
                    return Outcome.step_too_small if np.isfinite(e) else Outcome.not_finite
                h *= max(0.333, 0.9 * e**-0.125) if np.isfinite(e) else 0.1
                run.rejected, rejected = run.rejected + 1, True
                continue
            run.steps += 1
            after = run.advance(rates, h, x, y, reached)
            # After an event nothing that was learnt about the step holds.
            if after is not None:
                x, k[0] = after, rates(run.t, after)
                h, before, rejected = self._first_step(rates, run, x), 1e-4, False
                continue
            factor = 0.9 * e**-0.1 * before**0.05 if e > 0 else 6.0
            factor = min(1.0 if rejected else 6.0, max(0.333, factor))
            # A step cut short to end on an output time has a small error, which says nothing about
            # the step that was wanted.
            if h < wanted:
                h = max(factor * h, wanted)
            else:
                h, before = factor * h, max(e, 1e-4)
            rejected, x = False, y
            # The slope at the end of a step is the first one of the next.
            k[0] = k[12]
        return Outcome.reached_end

    def _error(self, h: float, x: np.ndarray, y: np.ndarray, k: np.ndarray) -> float:
        """Return the largest error of a step, relative to the tolerance of that state."""
        # h e5^2 / sqrt(e5^2 + (e3 / 10)^2), from the embedded solutions of orders 5 and 3 [Hairer,
        # Norsett, Wanner 1993, sec. II.10], but for each state rather than in the mean, so that
        # states at rest do not loosen the tolerance of a moving one. Ratios to the larger of both
        # keep the squares from underflow.
        e5, e3 = np.abs(E5 @ k), 0.1 * np.abs(E3 @ k)
        larger = np.maximum(e5, e3)
        larger[larger == 0] = 1.0
        r5, r3 = e5 / larger, e3 / larger
        scale = self.atol + self.rtol * np.maximum(np.abs(x), np.abs(y))
        root = np.sqrt(r5 * r5 + r3 * r3)
        root[root == 0] = 1.0
        worst = float((h * e5 * r5 / (root * scale)).max())
        return worst if np.isfinite(y).all() else float("nan")

    def _first_step(self, rates: _Rates, run: _PairRun, x: np.ndarray) -> float:
        """Return a first step from the sizes of x, x', x'' [Hairer, Norsett, Wanner 1993, II.4]."""
        span, scale = run.end - run.t, self.atol + self.rtol * np.abs(x)
        d0, d1 = (float((np.abs(v) / scale).max()) for v in (x, run.k[0]))
        h0 = min(span, 1e-6 * span if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1)
        run.k[1] = rates(run.t + h0, x + h0 * run.k[0])
        d = max(d1, float((np.abs(run.k[1] - run.k[0]) / (h0 * scale)).max()))
        h1 = max(1e-6 * span, 1e-3 * h0) if d <= 1e-15 else (0.01 / d) ** 0.125
        return min(100 * h0, h1, span)


def _step(rates: _Rates, t: float, h: float, x: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return x after a step; k[0] is given, and k[1] ... k[12] are the slopes of its stages."""
    for s in range(1, 13):
        y = x + h * (A[s, :s] @ k[:s])
        k[s] = rates(t + C[s] * h, y)
    return y


class _Rates:
    """The rates of a model as a function of (t, x), with the inputs of an experiment."""

    def __init__(self, model: Model, experiment: Experiment) -> None:
        self._experiment, self.count = experiment, 0
        self._constant = all(is_constant(signal) for signal in experiment.inputs)
        self._u = input_values(experiment.inputs, experiment.t[:1])[:, 0]
        self._t, self._x = np.zeros(1), np.zeros(model.n_x)
        self._rates = np.zeros(model.n_x)
        # A CasADi buffer reads and writes these arrays in place, which costs far less than a call
        # that converts arguments and results. Unused arguments may stay unset.
        self._buffer, self._evaluate = model.function("ode").buffer()
        for i, value in ((0, self._t), (1, self._x), (3, self._u), (4, experiment.p)):
            if value.size:
                self._buffer.set_arg(i, memoryview(value))  # type: ignore[arg-type]
        if model.n_x:
            self._buffer.set_res(0, memoryview(self._rates))  # type: ignore[arg-type]

    def __call__(self, t: float, x: np.ndarray) -> np.ndarray:
        self.count += 1
        if not self._constant:
            self._u[:] = input_values(self._experiment.inputs, np.array([t]))[:, 0]
        self._t[0], self._x[:] = t, x
        self._evaluate()
        return self._rates


class _PairRun:
    """State of the integration: time, points saved so far, statistics, and events."""

    def __init__(self, experiment: Experiment, watch: Watch) -> None:
        self.times, self.end = experiment.t, float(experiment.t[-1])
        self.t, self.saved, self.steps, self.rejected = float(experiment.t[0]), 0, 0, 0
        self.x = np.zeros((len(experiment.t), experiment.x.size))
        self.k = np.zeros((16, experiment.x.size))
        self.watch, self._start = watch, experiment.x
        self._watched = bool(watch.model.events)

    def begin(self) -> np.ndarray:
        """Save the start, and return the state (n_x,) after the events that fire there."""
        x = self._start
        self.x[0], self.saved = x, 1
        if self._watched:
            self._point = self.watch.begin(self.t, x, _NONE)
            x = self._point.x
        self.x[0] = x
        return x.copy()

    def fitted(self, h: float) -> tuple[float, float]:
        """Return the length of the next step, which is at most h but for rounding, and its end.

        Arguments:
            h: wanted step, s.
        """
        # Where output times are two steps apart or more, a step ends on each of them: the end of a
        # step is more accurate than the middle of its interpolant, above all where stability limits
        # the step. The interval before is halved rather than leaving a sliver.
        at, following = float(self.times[self.saved]), self.times[self.saved + 1 :]
        rest = at - self.t
        far = not len(following) or following[0] - at >= 1.99 * h
        far = far and (rest > 0.1 * h or at >= self.end)
        if far and rest <= 1.01 * h:
            return rest, at
        if far and rest < 1.99 * h:
            return rest / 2, self.t + rest / 2
        if self.t + 1.01 * h >= self.end:
            return self.end - self.t, self.end
        return h, self.t + h

    def advance(
        self, rates: _Rates, h: float, x: np.ndarray, y: np.ndarray, t: float
    ) -> np.ndarray | None:
        """Save the output times within a step, up to the first event.

        Arguments:
            h, x, y: the step in s, and the states before and after it.
            t: end of the step, s.

        Returns:
            The state after the event, or None if there is none.
        """
        within = _Interpolant(rates, self.k, self.t, h, x, y, t)
        if self._watched:
            found = self._first_event(within, t)
            if found is not None:
                self._save(within, found.t)
                self._point = self.watch.fire(found)
                self.t = found.t
                # An event at an output time: the state after it is saved.
                if self.saved and abs(self.times[self.saved - 1] - found.t) <= self.watch.instant:
                    self.x[self.saved - 1] = self._point.x
                return self._point.x.copy()
        self._save(within, t)
        self.t = t
        return None

    def _first_event(self, within: _Interpolant, t: float) -> Instant | None:
        start = self.t
        for k in range(1, _CHECKS + 1):
            time = t if k == _CHECKS else start + (t - start) * k / _CHECKS
            point = self.watch.check(time, within(time), _NONE)
            found = self.watch.search(self._point, point, lambda _, at: (within(at), _NONE))
            self._point = point
            if found is not None:
                return found
        return None

    def _save(self, within: _Interpolant, t: float) -> None:
        n = int(np.searchsorted(self.times, t, side="right"))
        for i in range(self.saved, n):
            self.x[i] = within(float(self.times[i]))
        self.saved = max(n, self.saved)


class _Interpolant:
    """The solution within a step, of order 7; its first use evaluates three more stages."""

    def __init__(
        self,
        rates: _Rates,
        k: np.ndarray,
        t: float,
        h: float,
        x: np.ndarray,
        y: np.ndarray,
        end: float,
    ) -> None:
        self._rates, self._k, self._t, self._h, self._x, self._y = rates, k, t, h, x, y
        self._end = end
        self._parts: list[np.ndarray] = []

    def __call__(self, t: float) -> np.ndarray:
        if t >= self._end:
            return self._y
        theta, value = (t - self._t) / self._h, np.zeros_like(self._x)
        self._parts = self._parts or self._prepared()
        # x + theta (c0 + (1 - theta) (c1 + theta (c2 + (1 - theta) (c3 + ...)))).
        for j, part in enumerate(reversed(self._parts)):
            value = (value + part) * (theta if j % 2 == 0 else 1 - theta)
        return self._x + value

    def _prepared(self) -> list[np.ndarray]:
        k, h, x = self._k, self._h, self._x
        for s in (13, 14, 15):
            k[s] = self._rates(self._t + C[s] * h, x + h * (A[s, :s] @ k[:s]))
        change = self._y - x
        return [change, h * k[0] - change, 2 * change - h * (k[0] + k[12]), *(h * (D @ k))]
