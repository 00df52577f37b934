"""Runs of models with events by CasADi's own one-step methods, which fire the events themselves."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ..model import casadi_events
from ..model.casadi_events import (
    CLOSE,
    CROWD,
    MIN_CHECKS,
    Recorded,
    add_events,
    clean_data,
    extra_start,
    ready,
    recorded,
)
from ..model.model import Model
from ..model.signals import is_constant, raise_of_user
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .driver import (
    Run,
    Verdict,
    assemble,
    call_integrator,
    casadi_dae,
    consistent,
    failure_report,
    settle,
)
from .events import SegmentEnd, Watch, guarded

# A function is this far below zero, relative to the run times 1 + |rate|, only if its event was
# missed, not merely late by a rounding error.
_BEYOND = 1e-6


def run_with_events(
    model: Model,
    experiment: Experiment,
    plugin: str,
    options: Mapping[str, Any],
    judge: Callable[[Run], Verdict],
    count: Mapping[str, str],
) -> Trajectory:
    """Integrate a model with events by a CasADi plugin.

    Events at the start fire before the integration, those during it inside CasADi (see
    `model.casadi_events`). Afterwards the saved points are checked for events that CasADi missed.

    Arguments:
        plugin: "rosenbrock" or "erk".
        options, judge, count: as of `driver.run`.

    Raises:
        ValueError: a user's input function raised an error, or the model has no states.
    """
    # CasADi's search for events needs derivatives, which compiled functions do not have.
    model = model.plain
    found = consistent(model, experiment)
    if isinstance(found, Trajectory):
        return found
    experiment = found
    started, watch = time.perf_counter(), Watch(model, experiment)
    begun = guarded(lambda: watch.begin(float(experiment.t[0]), experiment.x, experiment.z))
    if isinstance(begun, SegmentEnd):
        x, z = experiment.x[None, :], experiment.z[None, :]
        return assemble(
            model,
            experiment,
            x,
            z,
            begun.outcome or Outcome.solver_failed,
            begun.report,
            {},
            watch.fired,
        )
    experiment = replace(experiment, x=begun.x, z=begun.z)
    kept: list[Any] = []
    integrator = _integrator(model, experiment, plugin, options, watch.instant, kept)
    built = time.perf_counter()
    extra = extra_start(model, watch.armed, float(experiment.t[0]))
    whole = np.concatenate([experiment.x, extra])
    result = call_integrator(integrator, replace(experiment, x=whole))
    extra = result.x[: _reached(result), model.n_x :]
    record = recorded(model, extra, watch.fired)
    result = result._replace(x=result.x[:, : model.n_x].copy())
    if model.n_z:
        settle(model, experiment, result)
    if result.failed:
        raise_of_user(kept)
    stats: dict[str, float | str] = {"events": float(record.total)}
    stats |= {ours: float(result.stats.get(theirs, np.nan)) for ours, theirs in count.items()}
    stats |= {"time": time.perf_counter() - built, "time_build": built - started}
    return _trajectory(watch, result, judge, stats, record, ready(extra))


def _reached(result: Run) -> int:
    """Return the number of saved points before the first that is not finite, at least 1."""
    finite = np.isfinite(result.x).all(axis=1)
    return max(1, int(finite.argmin()) if not finite.all() else len(finite))


def _integrator(
    model: Model,
    e: Experiment,
    plugin: str,
    options: Mapping[str, Any],
    instant: float,
    kept: list[Any],
) -> ca.Function:
    """Return the integrator Function, kept with the model if all inputs are constant."""
    fixed = all(is_constant(s) for s in e.inputs)
    key = ("events", plugin, repr(sorted(options.items())), e.t.tobytes())

    def build() -> ca.Function:
        return _with_events(model, e, plugin, options, instant, kept)

    return model.cached(key, build) if fixed else build()


def _with_events(
    model: Model,
    e: Experiment,
    plugin: str,
    options: Mapping[str, Any],
    instant: float,
    kept: list[Any],
) -> ca.Function:
    dae = casadi_dae(model, e.inputs, kept)
    t, x, z, p, u = (dae[key] for key in ("t", "x", "z", "p", "u"))
    # The transition calls Functions, which only an MX graph can.
    if not isinstance(x, ca.MX):
        over = ca.Function("dae", [t, x, z, p], [dae["ode"], dae["alg"], u])
        t, x, z, p = (ca.MX.sym(key, dae[key].shape) for key in "txzp")
        ode, alg, u = over(t, x, z, p)
        dae = {"t": t, "x": x, "z": z, "p": p, "ode": ode, "alg": alg}
    dae.pop("u", None)
    arguments = (t, clean_data(model, x), z, u, p[: model.n_p])
    dae, transition = add_events(model, dae, arguments, instant)
    options = {"max_step_size": _longest(e), **options}
    grid = [float(time) for time in e.t]
    return casadi_events.integrator(model.name, plugin, dae, grid, transition, instant, options)


def _missed(
    watch: Watch, x: np.ndarray, z: np.ndarray, ready: np.ndarray
) -> tuple[int, str] | None:
    """Return the first saved point before which an event was missed, and its name, or None.

    An event was missed if it is armed while its function is clearly below zero.

    Arguments:
        x, z: saved points (n, n_x), (n, n_z).
        ready: (n, events) whether each event is armed at each point.
    """
    t = watch.experiment.t
    for k, point in enumerate(watch.check_all(t[: len(x)], x, z)):
        width = _BEYOND * (1 + np.abs(point.rate)) * (t[-1] - t[0])
        late = np.flatnonzero(ready[k] & (point.zero < -width))
        if late.size:
            return k, watch.model.events[int(late[0])]
    return None


def _longest(e: Experiment) -> float:
    """Return the longest step that is allowed, s."""
    # CasADi compares signs at the ends of steps only, so a short excursion below zero within a step
    # goes unnoticed. Shorter steps make that less likely; `_missed` reports some that remain.
    span, interval = float(e.t[-1] - e.t[0]), float(np.diff(e.t).max())
    return min(span / MIN_CHECKS, interval / 2)


def _trajectory(
    watch: Watch,
    result: Run,
    judge: Callable[[Run], Verdict],
    stats: dict[str, float | str],
    record: Recorded,
    armed: np.ndarray,
) -> Trajectory:
    """Build the trajectory, cut off where an event, or a missed event, ended the run."""
    model, e = watch.model, watch.experiment
    n, last = _reached(result), min(record.t_stop, record.t_endless)
    if last <= e.t[n - 1]:
        n = int(np.searchsorted(e.t, last, side="right" if record.t_stop == last else "left"))
        events = [event for event in record.events if event.t <= last]
        outcome = Outcome.event if record.t_stop == last else Outcome.endless_events
        report = f"{outcome.value} '{events[-1].name}' at t = {last:.9g} s"
        if outcome is Outcome.endless_events:
            report = (
                f"{outcome.value}: {record.total} events up to t = {last:.9g} s, the last "
                f"{CROWD} within {CLOSE:g} of the run, the last '{events[-1].name}'; give the "
                "effects smoothing, or let an event stop the run"
            )
        stats["t_failed"] = last
        return assemble(model, e, result.x[:n], result.z[:n], outcome, report, stats, events)
    x, z = result.x[:n], result.z[:n]
    missed = _missed(watch, x, z, armed)
    if missed is not None:
        n, outcome = missed[0], Outcome.solver_failed
        stats["t_failed"] = float(e.t[n])
        report = (
            f"{outcome.value}: event '{missed[1]}' was missed before t = {e.t[n]:.9g} s; CasADi's "
            "methods notice only a change from + to - over a step; use Idas() or Dop853()"
        )
        return assemble(model, e, x[:n], z[:n], outcome, report, stats, record.events)
    if not result.failed and n == len(e.t):
        outcome = Outcome.reached_end
        return assemble(model, e, x, z, outcome, outcome.value, stats, record.events)
    endless = re.search(
        r"more than max_events = (\d+) events, the last at t = (\S+)", result.messages
    )
    if endless:
        outcome, stats["t_failed"] = Outcome.endless_events, float(endless[2])
        report = (
            f"{outcome.value}: {endless[1]} events up to t = {endless[2]} s; give the effects "
            "smoothing, or let an event stop the run"
        )
    else:
        verdict = judge(result)
        outcome, stats["t_failed"] = verdict.outcome, float(e.t[n - 1])
        report = failure_report(model, e, x, z, outcome, verdict.t, verdict.advice)
    return assemble(model, e, x, z, outcome, report, stats, record.events)
