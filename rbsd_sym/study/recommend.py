"""Recommend an integrator for a model, from pilot runs and measured costs of its functions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..base.symbols import is_number
from ..integrators import Idas, Rosenbrock
from ..model.model import Model
from ..model.signals import Inputs
from ..model.values import Experiment, Given, Params, Start, as_model, make_experiment
from .contenders import contenders
from .pilot import Costs, Modes, Pilot, Trial, costs, modes
from .table import ResultTable
from .work_precision import setting_text

_INTERVALS = 8  # output intervals of a pilot run
_SETTINGS = 4  # tried for one method, at most
_SHRINK, _SHORTEST = 8.0, 1e-6  # factor by which a pilot that takes too long is cut; least share
_RUNS = 4.0  # CPU time of all pilot runs of one method over that of the first run, roughly
_FEWEST = 2000  # steps that a pilot run may take in an output interval, at least
_LOOSER = 30.0  # looser settings are tried if the error is so many times smaller than wanted
_GIVE_UP = 5.0  # a method is given up if it is so many times slower than the fastest so far
_TIGHTEST = 1e-13  # relative tolerance
_FIRST_STEPS = 64  # equal steps of the first run of a method with fixed steps
_MANY = 1000  # states above which methods that factor large matrices in Python take minutes
_ORDERS = {"GeneralizedAlpha": 2, "RK4": 4, "Radau, order 5": 5, "Legendre, order 6": 6}
# Of explicit methods: the largest stable product of step and |eigenvalue| on the negative real
# axis, roughly, and the number of calls of the rates in a step.
_EXPLICIT = {"ExplicitRK": (3.3, 6), "Dop853": (6.0, 12), "RK4": (2.8, 4)}
_COLUMNS = ("method", "setting", "error", "time", "steps", "evaluations", "jacobians", "outcome")
_UNITS = ("", "", "", "s", "", "", "", "")
_UNDAMPED = 1e-3  # damping ratio
_FAST_PHASE = 1000.0  # rad in the run: a mode that turns further is fast beside the motion
_BDF_LIMIT = 3  # steps of BDF over those at order 2, from which the text mentions it


@dataclass(frozen=True)
class Recommendation:
    """The integrator that `recommend` chose, the reasons, and the runs it was chosen from.

    >>> pick = rs.study.recommend(model, 1e-6, 2.0)
    >>> print(pick)
    >>> trajectory = rs.simulate(model, 2.0, pick.integrator)

    Fields:
        integrator: for `simulate` or `export_simulator`.
        why: the reasons, in sentences with numbers; `print` shows them.
        table: a row for each pilot run: method, setting, error, time (s, scaled to the whole run),
            steps, evaluations, jacobians, outcome.
    """

    integrator: Any
    why: str
    table: ResultTable

    def __str__(self) -> str:
        return self.why


class _Run(NamedTuple):
    """A pilot run; `seconds` is CPU time for the whole run, in Python or of the calls in C."""

    method: str
    integrator: Any
    trial: Trial
    seconds: float


def recommend(
    model: Model,
    rtol: float = 1e-6,
    t_end: float = 1.0,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
    exported: bool = False,
    seconds: float = 10.0,
) -> Recommendation:
    """Return the integrator that reaches an error in the least CPU time, and the reasons.

    Every applicable integrator (see `contenders`) simulates the beginning of the run, or all of it
    if time permits, at several settings. Errors are those of `work_precision`, against a more
    accurate run that a second method checks. Times are scaled to the whole run, so a motion that
    changes its character later is judged by its beginning. Timing is noisy: two methods within a
    factor of two may change places.

    >>> print(rs.study.recommend(model, 1e-6, 2.0))

    Arguments:
        model: what `compile_scene` returns.
        rtol: the largest error wanted, relative to the excursions of the motion.
        t_end: end of the run, s.
        exported: choose for `export_simulator`: only methods that it takes, by the measured cost of
            their calls of rates, Jacobians and linear solves instead of their times in Python.
        seconds: CPU time that the pilot runs may take, roughly; building integrators comes on top.
        inputs, params, start: as in `simulate`.

    Raises:
        TypeError: not a model.
        ValueError: rtol, t_end or seconds out of range; no states; no method that reaches the end
            of even a short pilot run, or none that can be exported.
    """
    _check(model, rtol, t_end, seconds, exported)
    given: Given = {"inputs": inputs, "params": params, "start": start}
    whole = make_experiment(model, t_end, inputs, params, start)
    # Costs are those of the model as given; those of a `compiled` model are those of machine code.
    # The pilot runs for an export use the model that is exported.
    price = costs(model, whole)
    model = model.plain if exported else model
    pilot, share = _pilot(model, whole, rtol, seconds, given)
    assert pilot.path is not None
    around = modes(model, pilot.path, whole)
    seen = len(pilot.path.events)
    facts = _Facts(price, around, share, t_end, pilot.floor, exported, seen)
    runs = list(_runs(pilot, rtol, share, facts))
    best = _best(model, runs, rtol)
    table = ResultTable(_COLUMNS, _UNITS, tuple(_row(run) for run in runs))
    return Recommendation(best.integrator, _why(model, best, runs, rtol, facts), table)


def _check(model: Model, rtol: float, t_end: float, seconds: float, exported: bool) -> None:
    as_model(model, "recommend")
    for name, value, top, unit in (
        ("rtol", rtol, 0.1, ""),
        ("t_end", t_end, math.inf, " s"),
        ("seconds", seconds, math.inf, " s"),
    ):
        if not (is_number(value) and 0 < float(value) < top):
            raise ValueError(
                f"recommend: {name} {value!r}{unit}; it is a number above 0"
                + (f" and below {top:g}" if math.isfinite(top) else "")
            )
    if rtol < _TIGHTEST * 1e3:
        raise ValueError(
            f"recommend: rtol {rtol:g}; below {_TIGHTEST * 1e3:g} no pilot run can resolve errors; "
            "ask for a larger one"
        )
    if not model.n_x:
        raise ValueError(
            f"model '{model.name}': no states, so there is nothing to integrate; compile with "
            "minimal=False to keep states that never move"
        )
    if exported and not any(_methods(model, t_end, exported)):
        raise ValueError(
            f"model '{model.name}': no integrator for it can be exported; call recommend with "
            "exported=False"
        )


def _pilot(
    model: Model, whole: Experiment, rtol: float, seconds: float, given: Given
) -> tuple[Pilot, float]:
    """Return a pilot with its reference, and the share of the run that it covers.

    Arguments:
        seconds: CPU time for all pilot runs together.
    """
    # A first run by IDAS at the error wanted measures what a share of the run costs. The share
    # begins at 1/32; it grows fourfold while that is affordable, and is cut if it is not.
    t, share, before = (float(whole.t[0]), float(whole.t[-1])), 1.0 / 32, math.inf
    seconds /= _RUNS * len(list(_methods(model, 1.0, False)))
    found: tuple[Pilot, float] | None = None
    while share > _SHORTEST:
        grid = np.linspace(t[0], t[0] + share * (t[1] - t[0]), _INTERVALS + 1)
        pilot = Pilot(model, grid, given, _FEWEST)
        ready = pilot.refer_to(_reference(model, rtol))
        trial = pilot.attempt(Idas(rtol, rtol / 100)) if ready else None
        if found and (trial is None or trial.seconds > seconds):
            return found
        if trial is None:
            share /= _SHRINK
            continue
        steps = trial.steps if trial.error is not None else _FEWEST
        per_step = max(trial.seconds / max(steps, 1.0), 2e-6)
        pilot.most = int(max(_FEWEST, seconds / per_step))
        if trial.seconds <= seconds:
            found = pilot, share
            if share == 1.0 or before < math.inf:
                return found
            share = min(1.0, 4 * share)
        elif trial.seconds > before / 2:
            # The run was cut and is hardly faster: its cost does not depend on its length.
            return pilot, share
        else:
            share, before = share / _SHRINK, trial.seconds
    raise ValueError(
        f"model '{model.name}': no integrator reaches the end of the first "
        f"{share * (t[1] - t[0]):.3g} s of the run; read the report of simulate(model, ..., "
        "throw=False)"
    )


def _reference(model: Model, rtol: float) -> list[Any]:
    """Return methods for the reference and its check, in the order in which they are tried."""
    # A thousandth of the error wanted leaves room for the error of the reference itself, and for
    # methods whose global error is many times their tolerance.
    tight = max(1e-3 * rtol, _TIGHTEST)
    idas, rosenbrock = Idas(tight, tight / 100), Rosenbrock(tight, tight / 100)
    if model.dae.updates or model.n_x > _MANY:
        return [idas, Idas(tight / 3, tight / 300)]
    return [rosenbrock, idas]


def _runs(pilot: Pilot, rtol: float, share: float, facts: _Facts) -> Iterator[_Run]:
    """Yield pilot runs of every method, at settings that approach the error wanted."""
    # Two records are kept. `quickest` is a time in Python, which limits what a method may still
    # spend on trials; `fastest` is by the measure that decides, which for C is that of the calls.
    span, price = float(pilot.grid[-1] - pilot.grid[0]), facts.price
    quickest = fastest = math.inf
    for method, first in _methods(pilot.model, span, facts.exported):
        if _bound(method, span, facts) > _GIVE_UP * fastest:
            continue
        search = _by_steps if hasattr(first, "step") else _by_tolerance
        for integrator, trial in search(pilot, method, first, rtol, quickest):
            seconds = _in_c(trial, price) if facts.exported else trial.seconds
            yield _Run(method, integrator, trial, seconds / share)
            if trial.error is not None and trial.error <= rtol:
                quickest, fastest = min(quickest, trial.seconds), min(fastest, seconds)


def _bound(method: str, span: float, facts: _Facts) -> float:
    """Return the least CPU time (s) at which an explicit method is stable; 0 for the others."""
    limit, calls = _EXPLICIT.get(method, (math.inf, 0))
    return span * facts.modes.fastest / limit * calls * facts.price.rates


def _methods(model: Model, span: float, exported: bool) -> Iterator[tuple[str, Any]]:
    """Yield the names of the methods to try, and one integrator of each."""
    for method, several in contenders(model, span, (1e-6,)).items():
        first = several[0]
        if exported and not _exports(model, first):
            continue
        if model.n_x > _MANY and method in ("Rosenbrock", "GeneralizedAlpha"):
            continue
        yield method, first
        if isinstance(first, Idas):
            yield "Idas, order 2", replace(first, max_order=2)


def _exports(model: Model, integrator: Any) -> bool:
    plugin = getattr(integrator, "plugin", None)
    return plugin is not None and not model.dae.updates and bool(plugin or not model.events)


def _by_tolerance(
    pilot: Pilot, method: str, first: Any, rtol: float, fastest: float
) -> Iterator[tuple[Any, Trial]]:
    """Yield runs at several tolerances: tighter until the error is reached, or else looser."""
    tolerance, reached = rtol, False
    for _ in range(_SETTINGS):
        integrator = replace(first, rtol=tolerance, atol=tolerance / 100)
        # The pilot has a limit of its own on steps; what is recommended has the usual one.
        if hasattr(first, "max_steps"):
            integrator = replace(integrator, max_steps=type(first).max_steps)
        trial = pilot.attempt(integrator)
        yield integrator, trial
        if trial.error is None:
            return
        if trial.error > rtol:
            if reached or tolerance <= _TIGHTEST or trial.seconds > _GIVE_UP * fastest:
                return
            # The error is taken as proportional to the tolerance, with a margin. One digit is
            # enough, and is what a user would type.
            tolerance *= max(1e-4, 0.3 * rtol / trial.error)
            tolerance = max(float(f"{tolerance:.0e}"), _TIGHTEST)
        elif trial.error < rtol / _LOOSER and tolerance >= rtol:
            reached, tolerance = True, min(10 * tolerance, 0.01)
        else:
            return


def _by_steps(
    pilot: Pilot, method: str, first: Any, rtol: float, fastest: float
) -> Iterator[tuple[Any, Trial]]:
    """Yield runs with more and more equal steps, until the error is reached."""
    span, n = float(pilot.grid[-1] - pilot.grid[0]), float(_FIRST_STEPS)
    for _ in range(_SETTINGS):
        integrator = replace(first, step=span / n)
        trial = pilot.attempt(integrator)
        yield integrator, trial
        if trial.error is not None and trial.error <= rtol:
            return
        # For a method of order k the error is proportional to n^-k; a fifth more steps are taken.
        more = 4.0
        if trial.error is not None:
            more = min(64.0, max(1.3, 1.2 * (trial.error / rtol) ** (1 / _ORDERS[method])))
        n *= more
        if n > 10 * pilot.most or trial.seconds * more > _GIVE_UP * min(fastest, 1.0):
            return


def _in_c(trial: Trial, price: Costs) -> float:
    """Return the CPU time (s) of a run's calls of the model, which is all that a run in C takes."""
    # Each new Jacobian is charged with two linear solves, for its factors and their use.
    jacobians = trial.jacobians if math.isfinite(trial.jacobians) else 0.0
    return trial.evaluations * price.rates + jacobians * (price.jacobian + 2 * price.solve)


def _rank(run: _Run, rtol: float) -> tuple[int, float]:
    """Return a key that sorts runs: by time if they reach the error, else by error, then failures.

    Arguments:
        rtol: the error wanted.
    """
    if run.trial.error is None:
        return 2, run.seconds
    return (0, run.seconds) if run.trial.error <= rtol else (1, run.trial.error)


def _best(model: Model, runs: list[_Run], rtol: float) -> _Run:
    best = min(runs, key=lambda run: _rank(run, rtol))
    if best.trial.error is None:
        raise ValueError(
            f"model '{model.name}': no integrator finishes a pilot run in the CPU time allowed; "
            "give more seconds, or see the table of study.work_precision"
        )
    return best


def _row(run: _Run) -> tuple[Any, ...]:
    t = run.trial
    counts = (None if math.isnan(v) else v for v in (t.steps, t.evaluations, t.jacobians))
    return (run.method, setting_text(run.integrator), t.error, run.seconds, *counts, t.outcome.name)


class _Facts(NamedTuple):
    """What the reasons are written from; `floor` is the reference's error, `events` its events."""

    price: Costs
    modes: Modes
    share: float
    t_end: float
    floor: float
    exported: bool
    events: int


def _why(model: Model, best: _Run, runs: list[_Run], rtol: float, facts: _Facts) -> str:
    name = f"{type(best.integrator).__name__}({setting_text(best.integrator)})"
    reached = best.trial.error is not None and best.trial.error <= rtol
    checked = f"reference good to {facts.floor:.1g}"
    # The floor is NaN if no second method reached the end.
    checked = checked if facts.floor >= 0 else "reference not checked by a second method"
    clock = "calls of the model" if facts.exported else "CPU time"
    lines = [
        f"{name}: error {best.trial.error:.2g}"
        + ("" if reached else f", which misses {rtol:g}: no method reaches it")
        + f", {1e3 * best.seconds:.3g} ms of {clock} for {facts.t_end:g} s, from pilot runs over "
        f"{100 * facts.share:.3g} % of the run ({checked})."
    ]
    others: dict[str, _Run] = {}
    for run in sorted(runs, key=lambda run: _rank(run, rtol)):
        others.setdefault(run.method, run)
    rest = [run for run in others.values() if run.method != best.method]
    comparisons = [_compared(run, best, rtol) for run in rest]
    lines += [f"Others: {'; '.join(comparisons)}."] if comparisons else []
    return " ".join([*lines, *_of_modes(model, runs, facts), *_excluded(model, facts)])


def _compared(run: _Run, best: _Run, rtol: float) -> str:
    if run.trial.error is None:
        return f"{run.method} fails ({run.trial.outcome.name})"
    if run.trial.error > rtol:
        return f"{run.method} reaches only error {run.trial.error:.2g}"
    return f"{run.method} takes {run.seconds / best.seconds:.3g} times as long"


def _of_modes(model: Model, runs: list[_Run], facts: _Facts) -> Iterator[str]:
    m, price = facts.modes, facts.price
    damping = f", damping ratio {m.damping:.2g}" if math.isfinite(m.damping) else ""
    damping = ", undamped" if abs(m.damping) < _UNDAMPED else damping
    # 2.8 is the stability limit of the classical method of order 4 on the negative real axis.
    yield (
        f"Fastest mode {m.fastest:.3g} 1/s{damping}: stability alone makes an explicit method of "
        f"order 4 take {facts.t_end * m.fastest / 2.8:.2g} steps. One call of the rates takes "
        f"{1e6 * price.rates:.2g} us, of the Jacobian {1e6 * price.jacobian:.2g} us."
    )
    span = facts.t_end * facts.share
    tried = {run.method for run in runs}
    skipped = [name for name, _ in _methods(model, span, facts.exported) if name not in tried]
    if skipped:
        yield f"That leaves out {', '.join(skipped)}, which were not tried."
    steps = {
        name: min(
            (r.trial.steps for r in runs if r.method == name and r.trial.steps > 0),
            default=math.nan,
        )
        for name in ("Idas", "Idas, order 2")
    }
    # BDF of order above 2 is not A-stable: it amplifies modes near the imaginary axis, so that its
    # step control keeps the steps as short as the mode, however small that mode's amplitude is.
    if m.ringing * facts.t_end > _FAST_PHASE:
        yield (
            f"A mode of {m.ringing:.3g} rad/s is hardly damped: BDF of order above 2 is unstable "
            "for it if steps are longer than its period."
        )
        if steps["Idas"] > _BDF_LIMIT * steps["Idas, order 2"]:
            yield (
                f"The pilot runs confirm it: Idas takes {steps['Idas']:.0f} steps, with "
                f"max_order=2 {steps['Idas, order 2']:.0f}."
            )


def _excluded(model: Model, facts: _Facts) -> Iterator[str]:
    if model.n_z:
        yield f"{model.n_z} algebraic unknowns leave out explicit methods."
    if model.events and not facts.events:
        yield "No event occurred in the pilot runs; give more seconds, so that they cover some."
    if model.events:
        yield f"{len(model.events)} kinds of events leave out methods with steps fixed beforehand."
    if model.dae.updates:
        yield "Post-Newton steps leave out all methods but Idas and GeneralizedAlpha."
    if not facts.exported and not model.dae.updates:
        yield "For a simulation in C set exported=True: other methods may be faster there."
