"""IDAS over stretches of a run, watched on the way, and started again after every event.

CasADi's own events of IDAS are not to be trusted (IDA_ILL_INPUT on a bouncing ball), and its
integrators have a grid for good. So time is scaled: one integrator over s = 0 ... 1 serves every
stretch of as many output intervals. Stretches grow as long as nothing happens.
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

from ..model.casadi_events import LEAST
from ..model.model import Model
from ..model.signals import is_constant, raise_of_user
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import Run, Verdict, assemble, call_integrator, casadi_dae, failure_report, settle
from .events import SEARCHED, Instant, SegmentEnd, Watch, guarded
from .post_newton import Advice, PostNewton, advice

LOOKS = 8  # in an output interval, at least
_MOST = 20_000  # looks in a stretch
_FEW = 16  # looks in one after an event, which is likely to be followed by another
_STEPS, _BEGIN = 4, 100  # of IDAS from look to look, at most, beside those after a start
_LONGEST = 64  # output intervals in one stretch
_SLIVER = 1e-3  # of a look, which is not looked at
_UNIFORM = 1e-9  # relative differences of output intervals that count as equal
_LAST = ("qlast", "hlast")  # statistics of SUNDIALS that are not counts
_TIGHTER = 1e-2  # tolerances for the way to an event, relative to those of the run

Options = Callable[[Instant, float], Mapping[str, Any]]
"""(start, length in s) -> CasADi's options for a stretch in scaled time."""


@dataclass(eq=False)
class Stretches:
    """Integrators in scaled time, one for each number of looks and plugin."""

    model: Model
    experiment: Experiment
    kept: list[Any] = field(default_factory=list)
    counts: dict[str, float] = field(default_factory=dict)
    own: dict[Any, Any] = field(default_factory=dict)

    def run(
        self, plugin: str, start: Instant, length: float, looks: int, options: Mapping[str, Any]
    ) -> Run:
        """States at `looks` equal distances from the start on."""
        function = self._integrator(plugin, looks, options)
        e = self.experiment
        inputs = [s for s in e.inputs if is_constant(s)]
        p = np.concatenate([e.p, np.array(inputs, float), [start.t, length]])
        part = replace(e, t=np.linspace(0, 1, looks + 1), x=start.x, z=start.z, p=p, inputs=())
        result = call_integrator(function, part)
        for key, value in result.stats.items():
            if isinstance(value, (int, float)):  # the last order and step are no sums
                before = 0.0 if key in _LAST else self.counts.get(key, 0.0)
                self.counts[key] = before + value
        raise_of_user(self.kept)
        return result

    def advance(self, point: Instant, t: float, rtol: float, atol: float) -> Any:
        """State at a later time, smooth in it, for the search of an event."""
        options = {"reltol": rtol * _TIGHTER, "abstol": atol * _TIGHTER, "max_num_steps": 10_000}
        result = self.run("rosenbrock", point, t - point.t, 1, options)
        data = list(self.model.dae.data)
        result.x[-1, data] = point.x[data]
        good = not result.failed and np.isfinite(result.x[-1]).all()
        return (result.x[-1], result.z[-1]) if good else None

    def _integrator(self, plugin: str, looks: int, options: Mapping[str, Any]) -> ca.Function:
        constant = all(is_constant(s) for s in self.experiment.inputs)
        key = ("stretch", plugin, looks, repr(sorted(options.items())))

        def build() -> ca.Function:
            grid = [k / looks for k in range(1, looks + 1)]
            return ca.integrator(self.model.name, plugin, self._scaled(), 0.0, grid, dict(options))

        if "init_xdot" in options:  # the start is part of the options
            return build()
        if constant:
            return self.model.cached(key, build)
        if key not in self.own:  # an input is a function, which may answer differently next time
            self.own[key] = build()
        return self.own[key]

    def _scaled(self) -> dict[str, Any]:
        """The DAE over s, with the start t0 and the length T of the stretch after p."""
        dae = casadi_dae(self.model, self.experiment.inputs, self.kept)
        symbol = type(dae["x"])
        s, t0, length = (symbol.sym(name) for name in ("s", "t0", "T"))
        ode, alg = ca.substitute([dae["ode"], dae["alg"]], [dae["t"]], [t0 + s * length])
        p = ca.vertcat(dae["p"], t0, length)
        return {"t": s, "x": dae["x"], "z": dae["z"], "p": p, "ode": length * ode, "alg": alg}


@dataclass(eq=False)
class Walk:
    """A run in stretches, from event to event.

    Fields:
        options: CasADi's options for a stretch that starts at a point and has a length (s).
        x, z: at the output times reached, `saved` of them.
    """

    model: Model
    experiment: Experiment
    options: Options
    tolerances: tuple[float, float]
    post: PostNewton

    def __post_init__(self) -> None:
        e = self.experiment
        self.watch, self.stretches = Watch(self.model, e), Stretches(self.model, e)
        self.x = np.full((len(e.t), self.model.n_x), np.nan)
        self.z = np.full((len(e.t), self.model.n_z), np.nan)
        self.saved, self.looks = 0, 0
        steps = np.diff(e.t)
        self._data, self._finer = list(self.model.dae.data), 1
        # Few output times tell nothing about how fast things move.
        while LOOKS * self._finer * len(steps) < LEAST:
            self._finer *= 2
        self._uniform = bool(np.ptp(steps) <= _UNIFORM * steps[0])

    def go(self) -> SegmentEnd:
        """From the start to the end, or to what ends it."""
        e = self.experiment
        found = guarded(lambda: self._go(self.watch.begin(float(e.t[0]), e.x, e.z)))
        if found.point is not None:
            self._save(found.point)
        return found

    def _go(self, point: Instant) -> SegmentEnd:
        times, size, few = self.experiment.t, 1, _MOST
        self._save(point)
        while self.saved < len(times):
            aligned = abs(times[self.saved - 1] - point.t) <= self.watch.instant
            count = min(size, len(times) - self.saved) if aligned and self._uniform else 1
            end = float(times[self.saved + count - 1])
            looks = LOOKS * count * self._finer
            if count == 1:
                end, looks = self._part(point.t, end, few)
            points, failed = self._stretch(point, end, looks)
            reached = self._along(points)
            if reached is None and failed is not None:
                return SegmentEnd(None, points[-1].t, failed=failed)
            few = min(4 * few, _MOST) if reached is None else _FEW
            size = min(2 * size, _LONGEST) if reached is None else 1
            point = points[-1] if reached is None else reached
        return SegmentEnd(Outcome.reached_end, point.t)

    def _part(self, t: float, end: float, few: int) -> tuple[float, int]:
        """The end of the next stretch on the way to an output time, and its looks, `few` at most.

        Numbers of looks are powers of two, so that few integrators serve all stretches.
        """
        interval = end - float(self.experiment.t[self.saved - 1])
        looks = LOOKS * self._finer * (end - t) / interval
        if looks > 1.5 * few:
            return t + (end - t) * few / looks, few
        return end, 2 ** max(0, math.ceil(math.log2(max(1.0, looks - _SLIVER))))

    def _along(self, points: list[Instant]) -> Instant | None:
        """The point after the first event, or change of data, on the way; None if there is none."""
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

    def _stretch(self, start: Instant, end: float, looks: int) -> tuple[list[Instant], Run | None]:
        """Points on the way, with what the events look at, and the run if it failed."""
        length = end - start.t
        options = self.options(start, length)
        run = self.stretches.run("idas", start, length, looks, options)
        while not run.failed and looks < _MOST and run.stats["nsteps"] > _STEPS * looks + _BEGIN:
            looks *= 2
            run = self.stretches.run("idas", start, length, looks, options)
        t = start.t + length * np.arange(looks + 1) / looks
        t[-1] = end
        good = np.isfinite(run.x).all(axis=1) & np.isfinite(run.z).all(axis=1)
        n = int(good.argmin()) if not good.all() else len(good)
        x, z = run.x[:n].copy(), run.z[:n].copy()
        x[:, self._data] = start.x[self._data]  # linear solvers leave rounding in them
        if self.model.n_z and n > 1:
            settle(self.model, replace(self.experiment, t=t[:n]), run._replace(x=x, z=z))
        self.looks += n
        return [start, *self.watch.look_at(t[1:n], x[1:], z[1:])], run if n < len(good) else None

    def _advance(self, point: Instant, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        state = self.stretches.advance(point, t, *self.tolerances)
        if state is None or not self.model.n_z:
            return state
        u, p = self.watch.inputs(t), self.experiment.p
        z, found = self.model.consistent(t, state[0], state[1], u, p)
        return (state[0], z) if found else None

    def _resolve(self, a: Instant, b: Instant) -> Instant | None:
        """The point at which data change (see `post_newton`), if they do on the way to b."""
        last, target = a, b
        while True:
            said = self._advice(target)
            close = target.t - last.t <= self.watch.instant
            if said.error <= self.post.tolerance or close:
                changed = bool((said.x != target.x).any())
                if changed:
                    if target is not b:
                        self.watch.count(target.t, SEARCHED)
                    return self.watch.look(target.t, said.x, target.z)
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
        """Keep the state if its time is an output time."""
        times, instant = self.experiment.t, self.watch.instant
        k = self.saved
        if k < len(times) and abs(times[k] - point.t) <= instant:
            self.saved += 1
        elif not (k and abs(times[k - 1] - point.t) <= instant):
            return
        self.x[self.saved - 1], self.z[self.saved - 1] = point.x, point.z


def follow(walk: Walk, judge: Callable[[Run], Verdict], count: Mapping[str, str]) -> Trajectory:
    """Walk, and make a `Trajectory` of it.

    Arguments:
        judge: reads the outcome from a failed run.
        count: names of the statistics we report and of the plugin's own.
    """
    started, model, e = time.perf_counter(), walk.model, walk.experiment
    end = walk.go()
    x, z, n = walk.x[: walk.saved], walk.z[: walk.saved], walk.saved
    outcome, report = end.outcome, end.report
    if end.failed is not None:
        verdict = judge(end.failed)
        outcome = verdict.outcome
        report = failure_report(model, e, x, z, outcome, end.t, verdict.advice)
    outcome = outcome or Outcome.solver_failed
    happened = walk.watch.happened
    counts = walk.stretches.counts
    stats: dict[str, float | str] = {k: counts[v] for k, v in count.items() if v in counts}
    stats |= {"events": float(len(happened)), "looks": float(walk.looks)}
    stats["time"] = time.perf_counter() - started
    if n < len(e.t):
        stats["t_failed"] = end.t
    return assemble(model, e, x, z, outcome, report or outcome.value, stats, happened)
