"""Runs of CasADi's integrators: time-varying inputs, partial results, statistics, reports."""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..model.casadi_events import clean_data
from ..model.model import Model
from ..model.signals import Samples, Signal, evaluate, is_constant, raise_of_user, symbolic
from ..model.trajectory import Column, Outcome, Trajectory
from ..model.values import Experiment

# Redirection of standard output acts on the whole process, so only one thread may use it at a time.
_OUTPUT = threading.Lock()
# Newton iterations for z at saved points, whose values are already good to the tolerance.
_ROUNDS = 3
# Last Newton step relative to 1 + |z|, below which z is accepted.
_SETTLED = 1e-10


class Run(NamedTuple):
    """Raw result of CasADi's integrator.

    Fields:
        x, z: (n, n_x), (n, n_z) at the output times, the start included; NaN rows after a failure.
        failed: whether the integrator reported an error.
        messages: what CasADi and SUNDIALS printed.
        stats: statistics by CasADi's names.
    """

    x: np.ndarray
    z: np.ndarray
    failed: bool
    messages: str
    stats: Mapping[str, Any]


class Verdict(NamedTuple):
    """An integrator's reading of a failed run: the outcome, the time in s if known, advice."""

    outcome: Outcome
    t: float | None
    advice: str


def run(
    model: Model,
    experiment: Experiment,
    plugin: str,
    options: Mapping[str, Any],
    judge: Callable[[Run], Verdict],
    count: Mapping[str, str],
    with_rates: Callable[[list[float]], Mapping[str, Any]] | None = None,
) -> Trajectory:
    """Integrate a model without events by a CasADi plugin.

    Solves for a consistent start, integrates, solves the algebraic unknowns again at the output
    times, and turns a failure into an outcome with a report.

    Arguments:
        plugin: CasADi's name of the method: "idas", "rosenbrock", "erk", "rk", "collocation".
        options: of the plugin, by CasADi's names.
        judge: reads the outcome from a failed run.
        count: for each statistic in `trajectory.stats` its name in the plugin.
        with_rates: returns more options, given the rates (n_x) at the consistent start; it is
            called for models with algebraic unknowns.

    Returns:
        The trajectory, up to the failure if there was one.

    Raises:
        ValueError: CasADi refuses an option, or a user's input function raised an error.
    """
    started = time.perf_counter()
    # Nothing in the scene can move.
    if model.n_x + model.n_z == 0:
        still = np.zeros((len(experiment.t), 0))
        end = Outcome.reached_end
        return assemble(model, experiment, still, still, end, end.value, {"time": 0.0})
    found = consistent(model, experiment)
    if isinstance(found, Trajectory):
        return found
    experiment = found
    if model.n_x == 0:
        return _quasi_static(model, experiment, started)
    if model.n_z and with_rates:
        e, u = experiment, input_values(experiment.inputs, experiment.t[:1])
        rates = np.array(model.function("ode")(e.t[0], e.x, e.z, u, e.p)).reshape(-1)
        options = {**with_rates([float(rate) for rate in rates]), **options}
    integrator, kept = _integrator(model, experiment, plugin, options)
    built = time.perf_counter()
    result = call_integrator(integrator, experiment)
    if model.n_z:
        settle(model, experiment, result)
    if result.failed:
        raise_of_user(kept)
    stats: dict[str, float | str] = {}
    stats |= {ours: float(result.stats.get(theirs, np.nan)) for ours, theirs in count.items()}
    if "linear_solver" in options:
        stats["linear_solver"] = options["linear_solver"]
    stats["time"] = time.perf_counter() - built
    stats["time_build"] = built - started
    return _trajectory(model, experiment, result, judge, stats)


def _integrator(
    model: Model, experiment: Experiment, plugin: str, options: Mapping[str, Any]
) -> tuple[ca.Function, list[Any]]:
    """Return the integrator Function, and the callbacks in it, which must be kept as long.

    It is kept with the model for the next run of the same kind, unless an input is a function,
    which may return other values next time, or the start is part of the options.
    """
    inputs, grid = experiment.inputs, [float(t) for t in experiment.t]
    fixed = all(is_constant(s) for s in inputs) and "init_xdot" not in options
    key = ("integrator", plugin, repr(sorted(options.items())), experiment.t.tobytes())
    kept: list[Any] = []

    def build() -> ca.Function:
        dae = casadi_dae(model, inputs, kept)
        del dae["u"]
        try:
            return ca.integrator(model.name, plugin, dae, grid[0], grid[1:], dict(options))
        except RuntimeError as error:
            raise ValueError(
                f"model '{model.name}': CasADi refuses the options {dict(options)} of {plugin} "
                f"({str(error).strip().splitlines()[-1]}); check linear_solver and options"
            ) from error

    return (model.cached(key, build) if fixed else build()), kept


def casadi_dae(model: Model, inputs: tuple[Signal, ...], kept: list[Any]) -> dict[str, Any]:
    """Build a DAE in CasADi's form: a dict of "t", "x", "z", "p", "ode", "alg", and "u".

    Constant inputs become parameters after p, so that an integrator serves all their values; the
    others become expressions of t, or calls back into Python. "u" are the inputs as expressions,
    which `ca.integrator` must not be given.

    Arguments:
        inputs: one signal for each input of the model.
        kept: list to which callbacks are appended; the caller must keep it as long as the result.

    Returns:
        SX expressions where all inputs are traced and the model is flat, MX otherwise.
    """
    dae = model.dae
    traced = [symbolic(signal, dae.t) for signal in inputs]
    constant = [dae.u[i] for i, s in enumerate(inputs) if is_constant(s)]
    p = ca.vertcat(dae.p, *constant)
    all_traced = all(e is not None or is_constant(s) for s, e in zip(inputs, traced, strict=True))
    # One flat SX expression is the fastest to evaluate. A kernel or a call back into Python needs
    # an MX graph around it.
    if all_traced and not model.calls:
        u = ca.vertcat(
            ca.SX(0, 1), *(dae.u[i] if expr is None else expr for i, expr in enumerate(traced))
        )
        given = [dae.u, dae.x], [u, clean_data(model, dae.x)]
        ode, alg = ca.substitute([dae.ode, dae.alg], *given)
        return {"t": dae.t, "x": dae.x, "z": dae.z, "p": p, "ode": ode, "alg": alg, "u": u}
    t, x, z = ca.MX.sym("t"), ca.MX.sym("x", model.n_x), ca.MX.sym("z", model.n_z)
    q = ca.MX.sym("p", p.numel())
    entries, place = [], model.n_p
    for signal, expr in zip(inputs, traced, strict=True):
        if is_constant(signal):
            entries.append(q[place])
            place += 1
        elif expr is not None:
            entries.append(ca.Function("input", [dae.t], [expr])(t))
        else:
            entries.append(evaluate(signal, t, kept))
    u = ca.vertcat(*entries)
    arguments = (t, clean_data(model, x), z, u, q[: model.n_p])
    return {
        "t": t,
        "x": x,
        "z": z,
        "p": q,
        "ode": model.function("ode")(*arguments),
        "alg": model.function("alg")(*arguments),
        "u": u,
    }


def call_integrator(integrator: ca.Function, experiment: Experiment) -> Run:
    """Evaluate an integrator Function for an experiment, and keep what it reached on failure.

    Arguments:
        integrator: from `ca.integrator`, over the output times of the experiment.
        experiment: its parameters and constant inputs become the integrator's parameters.
    """
    # CasADi fills the memory of a buffer output time by output time, so that after a failure the
    # rows before it are there. An ordinary call raises an exception and returns nothing.
    n = len(experiment.t) - 1
    constant = [float(s) for s in experiment.inputs if is_constant(s)]  # type: ignore[arg-type]
    arguments = {
        "x0": experiment.x,
        "z0": experiment.z,
        "p": np.concatenate([experiment.p, np.array(constant)]),
    }
    results = {
        "xf": np.full((n, experiment.x.size), np.nan),
        "zf": np.full((n, experiment.z.size), np.nan),
    }
    buffer, evaluate_buffer = integrator.buffer()
    kept = {key: np.ascontiguousarray(value, float) for key, value in arguments.items()}
    for key, value in kept.items():
        if value.size:
            buffer.set_arg(integrator.index_in(key), value.data)
    for key, value in results.items():
        if value.size:
            buffer.set_res(integrator.index_out(key), value.data)
    messages, failed = io.StringIO(), False
    # SUNDIALS prints the reason of a failure, which is in no return value.
    with _OUTPUT, contextlib.redirect_stderr(messages), contextlib.redirect_stdout(messages):
        try:
            evaluate_buffer()
            failed = buffer.ret() != 0
        except RuntimeError as error:
            failed = True
            messages.write(str(error))
    x = np.vstack([experiment.x, results["xf"]])
    z = np.vstack([experiment.z, results["zf"]])
    return Run(x, z, failed, messages.getvalue(), dict(buffer.stats()))


def _trajectory(
    model: Model,
    experiment: Experiment,
    result: Run,
    judge: Callable[[Run], Verdict],
    stats: dict[str, float | str],
) -> Trajectory:
    finite = np.isfinite(result.x).all(axis=1) & np.isfinite(result.z).all(axis=1)
    n = int(np.argmin(finite)) if not finite.all() else len(finite)
    if not result.failed and n == len(finite):
        return assemble(
            model,
            experiment,
            result.x,
            result.z,
            Outcome.reached_end,
            Outcome.reached_end.value,
            stats,
        )
    if result.failed:
        verdict = judge(result)
    else:
        verdict = Verdict(Outcome.not_finite, None, "check parameters and start values")
    t_last = experiment.t[max(n, 1) - 1]
    known = verdict.t is not None and verdict.t >= t_last
    t_fail = verdict.t if known else t_last
    stats["t_failed"] = float(t_fail or t_last)
    x, z = result.x[:n], result.z[:n]
    report = failure_report(
        model, experiment, x, z, verdict.outcome, t_fail if known else None, verdict.advice
    )
    return assemble(model, experiment, x, z, verdict.outcome, report, stats)


def failure_report(
    model: Model,
    e: Experiment,
    x: np.ndarray,
    z: np.ndarray,
    outcome: Outcome,
    t_fail: float | None,
    advice: str,
) -> str:
    """Return a sentence about a run that failed: when, the fastest state there, what to do.

    Arguments:
        x, z: states and unknowns saved before the failure, (k, n_x) and (k, n_z), k at least 1.
        t_fail: time of the failure in s, or None if unknown.
        advice: what to change; it ends the sentence.
    """
    t_last = float(e.t[max(len(x), 1) - 1])
    at = f"after t = {t_last:.9g} s" if t_fail is None else f"at t = {t_fail:.9g} s"
    where = _fastest(model, e, x[-1], z[-1], t_last)
    return f"{outcome.value} {at}; last saved state at t = {t_last:.9g} s, {where}; {advice}"


def _fastest(model: Model, e: Experiment, x: np.ndarray, z: np.ndarray, t: float) -> str:
    """Describe the state with the largest rate, which is usually where the failure comes from."""
    u = input_values(e.inputs, np.array([t]))
    rates = np.array(model.function("ode")(t, x, z, u, e.p)).reshape(-1)
    i = int(np.argmax(np.where(np.isfinite(rates), np.abs(rates), np.inf)))
    label = model.x_labels[i]
    return f"fastest there: {label.name} = {x[i]:.6g} {label.unit} with rate {rates[i]:.6g}"


def input_values(inputs: tuple[Signal, ...], t: np.ndarray) -> np.ndarray:
    """Evaluate the inputs at times t (n,), s.

    Returns:
        Values (n_u, n).
    """
    rows = []
    for signal in inputs:
        if isinstance(signal, Samples):
            rows.append(np.interp(t, signal.t, signal.values))
        elif callable(signal):
            rows.append(np.array([float(signal(float(time))) for time in t]))
        else:
            rows.append(np.full(len(t), float(signal)))
    return np.array(rows).reshape(len(inputs), len(t))


def assemble(
    model: Model,
    experiment: Experiment,
    x: np.ndarray,
    z: np.ndarray,
    outcome: Outcome,
    report: str,
    stats: Mapping[str, float | str],
    events: Sequence[tuple[float, str]] = (),
) -> Trajectory:
    """Build a `Trajectory` from the states of a run.

    Arguments:
        experiment: its first n output times belong to the states.
        x, z: states (n, n_x) and algebraic unknowns (n, n_z).
        outcome, report: how the run ended, and the sentence about it.
        events: (time in s, name) of each event.
    """
    dae, t = model.dae, experiment.t[: len(x)]
    columns = {label.name: Column(x[:, i], label.unit) for i, label in enumerate(dae.x_labels)}
    columns |= {label.name: Column(z[:, i], label.unit) for i, label in enumerate(dae.z_labels)}
    u = input_values(experiment.inputs, t)
    columns |= {label.name: Column(u[i], label.unit) for i, label in enumerate(dae.u_labels)}
    states = tuple(label.name for label in (*dae.x_labels, *dae.z_labels))
    values = np.concatenate([experiment.p, experiment.idle])
    labels = dae.parameters.labels
    parameters = {label.name: float(v) for label, v in zip(labels, values, strict=True)}
    return Trajectory(
        model.name,
        t,
        columns,
        outcome,
        report,
        stats,
        parameters,
        states,
        model.digest,
        model.measure_all,
        model.left_out,
        tuple((float(t), name) for t, name in events),
        dae.aliases,
    )


def consistent_start(model: Model, e: Experiment) -> tuple[np.ndarray, bool]:
    """Solve alg = 0 at the start of an experiment, by Newton's method from its z.

    Returns:
        z (n_z,), and whether it is a solution.
    """
    u = input_values(e.inputs, e.t[:1])[:, 0]
    return model.consistent(float(e.t[0]), e.x, e.z, u, e.p)


def consistent(model: Model, e: Experiment) -> Experiment | Trajectory:
    """Return the experiment with a z that solves alg = 0 at the start.

    If there is none near the given z, return the trajectory of a run that ends at its start, with
    the outcome `not_consistent`.
    """
    if not model.n_z:
        return e
    z, found = consistent_start(model, e)
    return replace(e, z=z) if found else not_consistent(model, e)


def settle(model: Model, e: Experiment, result: Run) -> None:
    """Solve alg = 0 at the saved points of a run, in place.

    Between its steps an integrator interpolates z, which then does not solve its equations.

    Arguments:
        result: its z is overwritten, up to the first row that is not finite; where no solution is
            found, a point keeps its z.
    """
    n = int(np.isfinite(result.x).all(axis=1).argmin()) or len(e.t)
    u, p = input_values(e.inputs, e.t[:n]), np.repeat(e.p[:, None], n, axis=1)
    t, x, z = e.t[None, :n], result.x[:n].T, result.z[:n].T.copy()
    size = np.full(n, np.inf)
    # Newton's method at all points at once, by mapped functions; where it does not converge, the
    # safeguarded one of the model, point by point.
    for _ in range(_ROUNDS):
        r = np.array(model.function("alg")(t, x, z, u, p)).T
        J = np.array(ca.DM(model.function("dalg_dz")(t, x, z, u, p)))
        J = J.reshape(model.n_z, n, model.n_z).transpose(1, 0, 2)
        try:
            step = np.linalg.solve(J, r[:, :, None])[:, :, 0].T
        except np.linalg.LinAlgError:
            break
        z = z - step
        size = (np.abs(step) / (1 + np.abs(z))).max(axis=0)
    for k in np.flatnonzero(~(size <= _SETTLED)):
        given = (float(e.t[k]), result.x[k], result.z[k], u[:, k], e.p)
        value, found = model.consistent(*given)
        z[:, k] = value if found else result.z[k]
    result.z[:n] = z.T


def _quasi_static(model: Model, e: Experiment, started: float) -> Trajectory:
    """Solve alg = 0 at each output time, from the solution before, for a model without states."""
    u, z = input_values(e.inputs, e.t), [e.z]
    for k in range(1, len(e.t)):
        value, found = model.consistent(float(e.t[k]), e.x, z[-1], u[:, k], e.p)
        if not found:
            break
        z.append(value)
    end = Outcome.reached_end if len(z) == len(e.t) else Outcome.solver_failed
    report = (
        end.value
        if end.ok
        else (
            f"no balance found at t = {e.t[len(z)]:.9g} s near the one before; give closer output "
            "times, or give the bodies inertia if they jump there"
        )
    )
    stats = {"time": time.perf_counter() - started}
    return assemble(model, e, np.zeros((len(z), 0)), np.array(z), end, report, stats)


def not_consistent(model: Model, e: Experiment) -> Trajectory:
    """Return a `Trajectory` of the start alone, whose algebraic unknowns could not be solved."""
    advice = "; give start values of the algebraic unknowns near a solution (start={name: value})"
    outcome = Outcome.not_consistent
    return assemble(model, e, e.x[None, :], e.z[None, :], outcome, outcome.value + advice, {})
