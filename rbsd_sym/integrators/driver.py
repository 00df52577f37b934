"""CasADi's integrators behind one call: time-varying inputs, partial results, statistics."""

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

from ..model.casadi_events import tidy
from ..model.model import Model
from ..model.signals import Samples, Signal, evaluate, is_constant, raise_of_user, symbolic
from ..model.trajectory import Column, Outcome, Trajectory
from ..model.values import Experiment

_OUTPUT = threading.Lock()  # redirection is for the whole process
_ROUNDS = 3  # of Newton's method at saved points, from values good to the tolerance
_SETTLED = 1e-10  # last step, relative to the unknowns


class Run(NamedTuple):
    """Raw result: x (n, n_x), z (n, n_z) with NaN rows after a failure, messages, statistics."""

    x: np.ndarray
    z: np.ndarray
    failed: bool
    messages: str
    stats: Mapping[str, Any]


class Verdict(NamedTuple):
    """What an integrator makes of a failed run: the outcome, the time if known, advice."""

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
    """Integrate with a CasADi plugin.

    Arguments:
        with_rates: more options, from the rates at the consistent start of a model with unknowns.
        judge: reads the outcome from a failed run.
        count: names of the statistics we report and of the plugin's own.
    """
    started = time.perf_counter()
    if model.n_x + model.n_z == 0:  # nothing in the scene can move
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
    """The integrator Function, and what it calls back, which must live as long.

    It is kept with the model for the next run of the same kind, unless an input is a function,
    which may answer differently next time, or the start is part of the options.
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
    """CasADi's DAE, and `u`: constant inputs are parameters after p, the others functions of time.

    Arguments:
        kept: is given what must live as long as the result.
    """
    dae = model.dae
    traced = [symbolic(signal, dae.t) for signal in inputs]
    constant = [dae.u[i] for i, s in enumerate(inputs) if is_constant(s)]
    p = ca.vertcat(dae.p, *constant)
    all_traced = all(e is not None or is_constant(s) for s, e in zip(inputs, traced, strict=True))
    if all_traced and not model.calls:
        u = ca.vertcat(
            ca.SX(0, 1), *(dae.u[i] if expr is None else expr for i, expr in enumerate(traced))
        )
        given = [dae.u, dae.x], [u, tidy(model, dae.x)]
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
    arguments = (t, tidy(model, x), z, u, q[: model.n_p])
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
    """Call through buffers, which CasADi fills row by row: a failure keeps what came before."""
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
    """The full sentence about a run that failed: where, what state, what to do."""
    t_last = float(e.t[max(len(x), 1) - 1])
    at = f"after t = {t_last:.9g} s" if t_fail is None else f"at t = {t_fail:.9g} s"
    where = _fastest(model, e, x[-1], z[-1], t_last)
    return f"{outcome.value} {at}; last saved state at t = {t_last:.9g} s, {where}; {advice}"


def _fastest(model: Model, e: Experiment, x: np.ndarray, z: np.ndarray, t: float) -> str:
    """The state with the largest rate, which usually names the culprit."""
    u = input_values(e.inputs, np.array([t]))
    rates = np.array(model.function("ode")(t, x, z, u, e.p)).reshape(-1)
    i = int(np.argmax(np.where(np.isfinite(rates), np.abs(rates), np.inf)))
    label = model.x_labels[i]
    return f"fastest there: {label.name} = {x[i]:.6g} {label.unit} with rate {rates[i]:.6g}"


def input_values(inputs: tuple[Signal, ...], t: np.ndarray) -> np.ndarray:
    """Inputs over time (n_u, n)."""
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
    """A `Trajectory` from its states (n, n_x) and (n, n_z), and what happened at which time."""
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
    """Z that solves alg = 0 at the start, by Newton's method from the given z."""
    u = input_values(e.inputs, e.t[:1])[:, 0]
    return model.consistent(float(e.t[0]), e.x, e.z, u, e.p)


def consistent(model: Model, e: Experiment) -> Experiment | Trajectory:
    """The experiment with unknowns that solve alg = 0, or the end of a run without any."""
    if not model.n_z:
        return e
    z, found = consistent_start(model, e)
    return replace(e, z=z) if found else not_consistent(model, e)


def settle(model: Model, e: Experiment, result: Run) -> None:
    """Solve alg = 0 again at the saved points: between its steps an integrator interpolates z.

    All points at once by Newton's method, those where it does not settle one by one.
    """
    n = int(np.isfinite(result.x).all(axis=1).argmin()) or len(e.t)
    u, p = input_values(e.inputs, e.t[:n]), np.repeat(e.p[:, None], n, axis=1)
    t, x, z = e.t[None, :n], result.x[:n].T, result.z[:n].T.copy()
    size = np.full(n, np.inf)
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
    """A model without states: alg = 0 at each time, each from the one before."""
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
            f"no balance found at t = {e.t[len(z)]:.9g} s, near the one before; give closer times, "
            "or inertia, if it jumps there"
        )
    )
    stats = {"time": time.perf_counter() - started}
    return assemble(model, e, np.zeros((len(z), 0)), np.array(z), end, report, stats)


def not_consistent(model: Model, e: Experiment) -> Trajectory:
    """A `Trajectory` of the start alone, whose algebraic unknowns could not be solved."""
    advice = "; give start values of the algebraic unknowns near a solution (start={name: value})"
    outcome = Outcome.not_consistent
    return assemble(model, e, e.x[None, :], e.z[None, :], outcome, outcome.value + advice, {})
