"""Runs of models with events by CasADi's one-step methods."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from .. import casadi_events
from ..casadi_events import CLOSE, CROWD, LEAST, Recorded, add_events, extra_start, recorded, tidy
from ..model import Model
from ..trajectory import Experiment, Outcome, Trajectory
from .checks import refuse_updates
from .driver import (
    Run,
    Verdict,
    assemble,
    call_integrator,
    casadi_dae,
    consistent_start,
    failure_report,
    not_consistent,
    settle,
)
from .events import End, Watch, guarded
from .signals import is_constant, raise_of_user

_BEYOND = 1e-6  # of the run and the rate: so far below zero no event is late, but missed


def run_with_events(
    model: Model, experiment: Experiment, plugin: str, options: Mapping[str, Any],
    judge: Callable[[Run], Verdict], count: Mapping[str, str],
) -> Trajectory:  # fmt: skip
    """Integrate with a CasADi plugin and its events; arguments as of `driver.run`.

    Raises:
        ValueError: the model has post-Newton steps.
    """
    refuse_updates(model, plugin)
    if model.n_z:
        z, consistent = consistent_start(model, experiment)
        if not consistent:
            return not_consistent(model, experiment)
        experiment = replace(experiment, z=z)
    started, watch = time.perf_counter(), Watch(model, experiment)
    begun = guarded(lambda: watch.begin(float(experiment.t[0]), experiment.x, experiment.z))
    if isinstance(begun, End):
        x, z = experiment.x[None, :], experiment.z[None, :]
        return assemble(model, experiment, x, z, begun.outcome or Outcome.solver_failed,
                        begun.report, {}, watch.happened)  # fmt: skip
    experiment = replace(experiment, x=begun.x, z=begun.z)
    kept: list[Any] = []
    integrator = _integrator(model, experiment, plugin, options, watch.instant, kept)
    built = time.perf_counter()
    whole = np.concatenate([experiment.x, extra_start()])
    result = call_integrator(integrator, replace(experiment, x=whole))
    record = recorded(model, result.x[: _reached(result), model.n_x :], watch.happened)
    result = result._replace(x=result.x[:, : model.n_x].copy())
    if model.n_z:
        settle(model, experiment, result)
    if result.failed:
        raise_of_user(kept)
    stats: dict[str, float | str] = {"events": float(record.total)}
    stats |= {ours: float(result.stats.get(theirs, np.nan)) for ours, theirs in count.items()}
    stats |= {"time": time.perf_counter() - built, "time_build": built - started}
    return _trajectory(model, experiment, result, judge, stats, record)


def _reached(result: Run) -> int:
    finite = np.isfinite(result.x).all(axis=1)
    return max(1, int(finite.argmin()) if not finite.all() else len(finite))


def _integrator(
    model: Model, e: Experiment, plugin: str, options: Mapping[str, Any], instant: float,
    kept: list[Any],
) -> ca.Function:  # fmt: skip
    """The integrator Function, kept with the model as in `driver`."""
    fixed = all(is_constant(s) for s in e.inputs)
    key = ("events", plugin, repr(sorted(options.items())), e.t.tobytes())
    if fixed and key in model.memo:
        return model.memo[key]
    dae = casadi_dae(model, e.inputs, kept)
    t, x, z, p, u = (dae[key] for key in ("t", "x", "z", "p", "u"))
    if not isinstance(x, ca.MX):
        over = ca.Function("dae", [t, x, z, p], [dae["ode"], dae["alg"], u])
        t, x, z, p = (ca.MX.sym(key, dae[key].shape) for key in "txzp")
        ode, alg, u = over(t, x, z, p)
        dae = {"t": t, "x": x, "z": z, "p": p, "ode": ode, "alg": alg}
    dae.pop("u", None)
    arguments = (t, tidy(model, x), z, u, p[: model.n_p])
    dae, transition = add_events(model, dae, arguments, instant)
    options = {"max_step_size": _longest(e), **options}
    grid = [float(time) for time in e.t]
    function = casadi_events.integrator(model.name, plugin, dae, grid, transition, instant, options)
    if fixed:
        model.memo[key] = function
    return function


def _missed(
    model: Model, e: Experiment, x: np.ndarray, z: np.ndarray
) -> tuple[int, str] | None:  # fmt: skip
    """The first saved point at which an event that fires at once should have, and its name.

    One that would change nothing there has done what it does, and so has one that has been below
    zero from the start.
    """
    watch, change = Watch(model, e), model.function("jump")
    waits = np.full(len(model.events), True)
    for k, point in enumerate(watch.look_at(e.t[: len(x)], x, z)):
        width = _BEYOND * (1 + np.abs(point.rate)) * (e.t[-1] - e.t[0])
        waits &= point.zero < -width
        below = np.flatnonzero(watch.at_once & (point.zero < -width) & ~waits)
        if below.size:
            jump = np.array(ca.DM(change(point.t, point.x, point.z, watch.inputs(point.t), e.p)))
            late = [i for i in below if np.abs(jump[:, i]).max() > _BEYOND]
            if late:
                return k, model.events[int(late[0])]
    return None


def _longest(e: Experiment) -> float:
    """The longest step: CasADi looks for crossings at the ends of steps only."""
    span, interval = float(e.t[-1] - e.t[0]), float(np.diff(e.t).max())
    return min(span / LEAST, interval / 2)


def _trajectory(
    model: Model, e: Experiment, result: Run, judge: Callable[[Run], Verdict],
    stats: dict[str, float | str], record: Recorded,
) -> Trajectory:  # fmt: skip
    n, last = _reached(result), min(record.t_stop, record.t_endless)
    if last <= e.t[n - 1]:
        n = int(np.searchsorted(e.t, last, side="right" if record.t_stop == last else "left"))
        events = [event for event in record.events if event.t <= last]
        outcome = Outcome.event if record.t_stop == last else Outcome.endless_events
        report = f"{outcome.value} '{events[-1].name}' at t = {last:.9g} s"
        if outcome is Outcome.endless_events:
            report = (
                f"{outcome.value}: {record.total} events up to t = {last:.9g} s, the last "
                f"{CROWD} within {CLOSE:g} of the run, the last '{events[-1].name}'"
            )
        stats["t_failed"] = last
        return assemble(model, e, result.x[:n], result.z[:n], outcome, report, stats, events)
    x, z = result.x[:n], result.z[:n]
    missed = _missed(model, e, x, z)
    if missed is not None:
        n, outcome = missed[0], Outcome.solver_failed
        stats["t_failed"] = float(e.t[n])
        report = (
            f"{outcome.value}: event '{missed[1]}' was missed before t = {e.t[n]:.9g} s; what "
            "comes fast near rest escapes CasADi's methods; use Idas() or Dop853()"
        )
        return assemble(model, e, x[:n], z[:n], outcome, report, stats, record.events)
    if not result.failed and n == len(e.t):
        outcome = Outcome.reached_end
        return assemble(model, e, x, z, outcome, outcome.value, stats, record.events)
    endless = re.search(r"more than max_events = (\d+) events, the last at t = (\S+)",
                        result.messages)  # fmt: skip
    if endless:
        outcome, stats["t_failed"] = Outcome.endless_events, float(endless[2])
        report = f"{outcome.value}: {endless[1]} events up to t = {endless[2]} s"
    else:
        verdict = judge(result)
        outcome, stats["t_failed"] = verdict.outcome, float(e.t[n - 1])
        report = failure_report(model, e, x, z, outcome, verdict.t, verdict.advice)
    return assemble(model, e, x, z, outcome, report, stats, record.events)
