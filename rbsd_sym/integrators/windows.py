"""IDAS over segments of a run, checked for events between, and restarted after every event.

CasADi's own events cannot be used with IDAS (it stops with IDA_ILL_INPUT on a bouncing ball), and
a CasADi integrator has its output grid built in. So time is scaled: one integrator over s = 0 ... 1
serves all segments with the same number of checks. Segments grow as long as nothing happens.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from ..model.casadi_events import MIN_CHECKS
from ..model.model import Model
from ..model.signals import is_constant, raise_of_user
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import Run, Verdict, assemble, call_integrator, casadi_dae, failure_report, settle
from .events import SEARCHED, Instant, SegmentEnd, Watch, guarded
from .post_newton import Advice, PostNewton, advice

# Checks in an output interval, at least.
CHECKS = 8
# Checks in a segment, at most; and in the segment after an event, which is likely to be followed by
# another one soon.
_MOST = 20_000
_FEW = 16
# Between two checks IDAS may take _STEPS steps on average, and _BEGIN more after a restart.
# More steps mean fast motion, which needs more checks.
_STEPS, _BEGIN = 4, 100
# Output intervals in one segment, at most.
_LONGEST = 64
# A remainder shorter than this fraction of the time between checks does not get a check of its own.
_SLIVER = 1e-3
# Relative differences of output intervals that count as equal.
_UNIFORM = 1e-9
# Statistics of SUNDIALS that are not counts: the last order and the last step.
_LAST = ("qlast", "hlast")
# Tolerances in search of an event, relative to those of the run.
_TIGHTER = 1e-2

Options = Callable[[Instant, float], Mapping[str, Any]]
"""(start, length in s) -> CasADi's options for a segment in scaled time."""


@dataclass(eq=False)
class SegmentIntegrators:
    """CasADi integrators in scaled time, one for each plugin and number of checks.

    Fields:
        kept: callbacks of input functions, which must live as long as the integrators.
        counts: statistics of SUNDIALS, summed over all segments.
        own: integrators that must not be kept with the model.
    """

    model: Model
    experiment: Experiment
    kept: list[Any] = field(default_factory=list)
    counts: dict[str, float] = field(default_factory=dict)
    own: dict[Any, Any] = field(default_factory=dict)

    def run(
        self, plugin: str, start: Instant, length: float, checks: int, options: Mapping[str, Any]
    ) -> Run:
        """Integrate a segment, with states at `checks` equally spaced times after its start.

        Arguments:
            plugin: "idas" or "rosenbrock".
            length: of the segment, s.
            options: CasADi's, in scaled time.
        """
        function = self._integrator(plugin, checks, options)
        e = self.experiment
        inputs = [s for s in e.inputs if is_constant(s)]
        p = np.concatenate([e.p, np.array(inputs, float), [start.t, length]])
        part = replace(e, t=np.linspace(0, 1, checks + 1), x=start.x, z=start.z, p=p, inputs=())
        result = call_integrator(function, part)
        for key, value in result.stats.items():
            if isinstance(value, (int, float)):
                before = 0.0 if key in _LAST else self.counts.get(key, 0.0)
                self.counts[key] = before + value
        raise_of_user(self.kept)
        return result

    def advance(self, point: Instant, t: float, rtol: float, atol: float) -> Any:
        """Integrate from a point to a later time t (s), in search of an event.

        Returns:
            x and z at t, or None if the integration failed.
        """
        # A one-step method, since the multistep IDAS would begin each of these short integrations
        # at order 1. Its result is smooth in t, as the search for a root requires.
        options = {"reltol": rtol * _TIGHTER, "abstol": atol * _TIGHTER, "max_num_steps": 10_000}
        result = self.run("rosenbrock", point, t - point.t, 1, options)
        data = list(self.model.dae.data)
        result.x[-1, data] = point.x[data]
        good = not result.failed and np.isfinite(result.x[-1]).all()
        return (result.x[-1], result.z[-1]) if good else None

    def _integrator(self, plugin: str, checks: int, options: Mapping[str, Any]) -> ca.Function:
        constant = all(is_constant(s) for s in self.experiment.inputs)
        key = ("segment", plugin, checks, repr(sorted(options.items())))

        def build() -> ca.Function:
            grid = [k / checks for k in range(1, checks + 1)]
            return ca.integrator(self.model.name, plugin, self._scaled(), 0.0, grid, dict(options))

        # Rates at the start among the options make the integrator good for this segment only.
        if "init_xdot" in options:
            return build()
        if constant:
            return self.model.cached(key, build)
        # An input function may return other values in the next run, so the integrator that contains
        # it is kept for this run only.
        if key not in self.own:
            self.own[key] = build()
        return self.own[key]

    def _scaled(self) -> dict[str, Any]:
        """Return CasADi's DAE over s = (t - t0) / T, with the parameters p, t0 and T."""
        dae = casadi_dae(self.model, self.experiment.inputs, self.kept)
        symbol = type(dae["x"])
        s, t0, length = (symbol.sym(name) for name in ("s", "t0", "T"))
        ode, alg = ca.substitute([dae["ode"], dae["alg"]], [dae["t"]], [t0 + s * length])
        p = ca.vertcat(dae["p"], t0, length)
        return {"t": s, "x": dae["x"], "z": dae["z"], "p": p, "ode": length * ode, "alg": alg}


@dataclass(eq=False)
class SegmentedRun:
    """A run of a model with events, or with post-Newton steps, in segments.

    Fields:
        options: CasADi's options for a segment that starts at a point and has a length (s).
        tolerances: relative and absolute, of IDAS.
        post: how far post-Newton steps are resolved.
        x, z: states and unknowns at the output times, of which `saved` have been reached.
        checks: number of points at which events were checked.
    """

    model: Model
    experiment: Experiment
    options: Options
    tolerances: tuple[float, float]
    post: PostNewton

    def __post_init__(self) -> None:
        e = self.experiment
        self.watch, self.integrators = Watch(self.model, e), SegmentIntegrators(self.model, e)
        self.x = np.full((len(e.t), self.model.n_x), np.nan)
        self.z = np.full((len(e.t), self.model.n_z), np.nan)
        self.saved, self.checks = 0, 0
        steps = np.diff(e.t)
        self._data, self._finer = list(self.model.dae.data), 1
        # A coarse output grid does not mean slow motion: a run has a least number of checks.
        while CHECKS * self._finer * len(steps) < MIN_CHECKS:
            self._finer *= 2
        self._uniform = bool(np.ptp(steps) <= _UNIFORM * steps[0])

    def go(self) -> SegmentEnd:
        """Integrate to the last output time, or to what ends the run earlier."""
        e = self.experiment
        found = guarded(lambda: self._go(self.watch.begin(float(e.t[0]), e.x, e.z)))
        if found.point is not None:
            self._save(found.point)
        return found

    def _go(self, point: Instant) -> SegmentEnd:
        """Integrate segment by segment; after an event segments are short again."""
        times, size, few = self.experiment.t, 1, _MOST
        self._save(point)
        while self.saved < len(times):
            # A segment of several output intervals needs its checks to coincide with output times.
            aligned = abs(times[self.saved - 1] - point.t) <= self.watch.instant
            count = min(size, len(times) - self.saved) if aligned and self._uniform else 1
            end = float(times[self.saved + count - 1])
            checks = CHECKS * count * self._finer
            if count == 1:
                end, checks = self._segment_end(point.t, end, few)
            points, failed = self._segment(point, end, checks)
            reached = self._first_event(points)
            if reached is None and failed is not None:
                return SegmentEnd(None, points[-1].t, failed=failed)
            few = min(4 * few, _MOST) if reached is None else _FEW
            size = min(2 * size, _LONGEST) if reached is None else 1
            point = points[-1] if reached is None else reached
        return SegmentEnd(Outcome.reached_end, point.t)

    def _segment_end(self, t: float, end: float, few: int) -> tuple[float, int]:
        """Return the end time of the next segment, and its number of checks (at most `few`).

        Arguments:
            t, end: start of the segment, and the next output time, s.
        """
        interval = end - float(self.experiment.t[self.saved - 1])
        checks = CHECKS * self._finer * (end - t) / interval
        if checks > 1.5 * few:
            return t + (end - t) * few / checks, few
        # Powers of two, so that a few integrators serve all segments.
        return end, 2 ** max(0, math.ceil(math.log2(max(1.0, checks - _SLIVER))))

    def _first_event(self, points: list[Instant]) -> Instant | None:
        """Fire the first event, or make the first change of data, between the points of a segment.

        Returns:
            The point after it, or None if there is none.
        """
        for a, b in pairwise(points):
            found = self.watch.search(a, b, self._advance)
            if found is not None:
                found = self.watch.fire(found)
            elif self.model.dae.updates:
                found = self._resolve(a, b)
            if found is not None:
                self._save(found)
                return found
            self._save(b)
        return None

    def _segment(self, start: Instant, end: float, checks: int) -> tuple[list[Instant], Run | None]:
        """Integrate a segment; return its check points, and the raw run if it failed."""
        length = end - start.t
        options = self.options(start, length)
        run = self.integrators.run("idas", start, length, checks, options)
        # Many steps between two checks mean that functions may cross zero and come back unnoticed:
        # the segment is integrated again, with more checks.
        while not run.failed and checks < _MOST and run.stats["nsteps"] > _STEPS * checks + _BEGIN:
            checks *= 2
            run = self.integrators.run("idas", start, length, checks, options)
        t = start.t + length * np.arange(checks + 1) / checks
        t[-1] = end
        good = np.isfinite(run.x).all(axis=1) & np.isfinite(run.z).all(axis=1)
        n = int(good.argmin()) if not good.all() else len(good)
        x, z = run.x[:n].copy(), run.z[:n].copy()
        # Data states are constant between events; linear solvers leave rounding in them.
        x[:, self._data] = start.x[self._data]
        if self.model.n_z and n > 1:
            settle(self.model, replace(self.experiment, t=t[:n]), run._replace(x=x, z=z))
        self.checks += n
        return [start, *self.watch.check_all(t[1:n], x[1:], z[1:])], run if n < len(good) else None

    def _advance(self, point: Instant, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Return x, z at a later time t (s), or None if that fails."""
        state = self.integrators.advance(point, t, *self.tolerances)
        if state is None or not self.model.n_z:
            return state
        u, p = self.watch.inputs(t), self.experiment.p
        z, found = self.model.consistent(t, state[0], state[1], u, p)
        return (state[0], z) if found else None

    def _resolve(self, a: Instant, b: Instant) -> Instant | None:
        """Find the first change of data by a post-Newton step between two points.

        Returns:
            The point after the change (see `post_newton`), or None if data do not change up to b.
        """
        # [last, target] is halved until the user's error at target is within the tolerance, or
        # target is an instant behind last; then the data there hold, and the search goes on to b.
        last, target = a, b
        while True:
            response = self._advice(target)
            close = target.t - last.t <= self.watch.instant
            if response.error <= self.post.tolerance or close:
                changed = bool((response.x != target.x).any())
                if changed:
                    if target is not b:
                        self.watch.count(target.t, SEARCHED)
                    return self.watch.check(target.t, response.x, target.z)
                if target is b:
                    return None
                last, target = target, b
                continue
            middle = (last.t + target.t) / 2
            target = self.watch.reach(a, middle, self._advance)

    def _advice(self, point: Instant) -> Advice:
        u, p = self.watch.inputs(point.t), self.experiment.p
        return advice(self.model, point.t, point.x, point.z, u, p)

    def _save(self, point: Instant) -> None:
        """Store the state if its time is an output time, or that of the last point stored.

        The latter happens where an event fires at an output time: the state after it is kept.
        """
        times, instant = self.experiment.t, self.watch.instant
        k = self.saved
        if k < len(times) and abs(times[k] - point.t) <= instant:
            self.saved += 1
        elif not (k and abs(times[k - 1] - point.t) <= instant):
            return
        self.x[self.saved - 1], self.z[self.saved - 1] = point.x, point.z


def run_in_segments(
    run: SegmentedRun, judge: Callable[[Run], Verdict], count: Mapping[str, str]
) -> Trajectory:
    """Integrate in segments, and make a `Trajectory` of the result.

    Arguments:
        judge: reads the outcome from a raw run that failed.
        count: for each statistic in `trajectory.stats` its name in SUNDIALS.
    """
    started, model, e = time.perf_counter(), run.model, run.experiment
    end = run.go()
    x, z, n = run.x[: run.saved], run.z[: run.saved], run.saved
    outcome, report = end.outcome, end.report
    if end.failed is not None:
        verdict = judge(end.failed)
        outcome = verdict.outcome
        report = failure_report(model, e, x, z, outcome, end.t, verdict.advice)
    outcome = outcome or Outcome.solver_failed
    fired = run.watch.fired
    counts = run.integrators.counts
    stats: dict[str, float | str] = {k: counts[v] for k, v in count.items() if v in counts}
    stats |= {"events": float(len(fired)), "looks": float(run.checks)}
    stats["time"] = time.perf_counter() - started
    if n < len(e.t):
        stats["t_failed"] = end.t
    return assemble(model, e, x, z, outcome, report or outcome.value, stats, fired)
