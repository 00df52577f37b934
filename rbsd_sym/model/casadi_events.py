"""Events inside CasADi's own one-step integrators, in memory and in generated C.

These integrators locate a crossing on their dense output, fire an event where its function falls
from + to -, one event at a time, and report nothing about it afterwards. This module adds what the
rules of `integrators.events` require: a transition that solves the algebraic unknowns again and
fires every other event that is due at the same instant, and extra states without rate that record
which events fired, and when. One rule differs: 64 events at one instant count as endless.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from .model import Model

# Rules shared by all methods (see `integrators.events`).
# Times closer than this fraction of the run count as one instant.
INSTANT = 1e-15
# A function counts as zero where it moves through zero within this many instants.
BAND = 10.0
# Least number of checks for crossings in a run.
MIN_CHECKS = 400
# This many events within this fraction of the run count as endless.
CROWD = 10
CLOSE = 1e-10

# Only the last events before each output time are remembered, up to this number.
RECORD = 64
# Iterations of CasADi's search for one event.
_SEARCH = 500
# Events in a run, after which CasADi gives up.
_MOST = 10_000
# Newton steps for the algebraic unknowns after an event; a CasADi graph has no loop that ends on a
# condition, so their number is fixed.
_NEWTON = 4
# At most _NEST ** _DEPTH events at one instant (see `_repeated`).
_NEST, _DEPTH = 8, 2
NEVER = 1e300
# Data states smaller than this are rounding.
_NOISE = 1e-25
# A continuous function is smaller than this where its crossing was located; a larger value is a
# jump of the function.
_FOUND = 1e-9


# Layout of the extra states:
# [0] number of events so far;
# [1] first time at which an event stops the run, NEVER if none has;
# [2] first time at which events follow each other without end, NEVER if they do not;
# [_TIMES], [_WHICH] times and indices of the last events, as ring buffers;
# [_SPENT] for each event 0 while it is armed; otherwise the time of the last transition that found
# it spent (see the rules in `integrators.events`).
_TIMES, _WHICH = slice(3, 3 + RECORD), slice(3 + RECORD, 3 + 2 * RECORD)
_SPENT = slice(3 + 2 * RECORD, None)
# Written to [_SPENT] at t = 0, where the time itself would mean "armed".
_TINY = 1e-300


class Fired(NamedTuple):
    """An event that has fired: time in s, and name."""

    t: float
    name: str


class Recorded(NamedTuple):
    """Events of a run, as read from the extra states.

    Fields:
        total: number of events.
        events: the events still on record, in the order in which they fired.
        t_stop, t_endless: s; when an event stopped the run, and when events began to follow each
            other without end; `NEVER` where that did not happen.
    """

    total: int
    events: tuple[Fired, ...]
    t_stop: float
    t_endless: float


def n_extra(model: Model) -> int:
    """Return the number of extra states that record the events of a model."""
    return 3 + 2 * RECORD + len(model.events)


def extra_start(model: Model, armed: np.ndarray, t: float) -> np.ndarray:
    """Return start values (n_extra,) of the extra states, after the events at the start.

    Arguments:
        armed: (events,) bool; whether each event fires when its function next falls through zero.
        t: start time, s.
    """
    spent = np.where(armed, 0.0, t or _TINY)
    return np.concatenate([[0.0, NEVER, NEVER], np.zeros(2 * RECORD), spent])


def recorded(model: Model, extra: np.ndarray, before: Sequence[Fired]) -> Recorded:
    """Read the record of events from the extra states at the output times.

    Arguments:
        extra: (n, n_extra).
        before: events at the start, which the extra states do not hold.

    Of more than `RECORD` events between two output times only the last `RECORD` are found, but all
    are counted.
    """
    found, known = list(before), 0
    for row in extra:
        count, times, which = int(row[0]), row[_TIMES], row[_WHICH]
        slots = (k % RECORD for k in range(max(known, count - RECORD), count))
        found += [Fired(float(times[k]), model.events[int(which[k])]) for k in slots]
        known = count
    return Recorded(known + len(before), tuple(found), float(extra[-1, 1]), float(extra[-1, 2]))


def ready(extra: np.ndarray) -> np.ndarray:
    """Return whether each event is armed (n, events), from the extra states (n, n_extra)."""
    return extra[:, _SPENT] == 0


def clean_data(model: Model, x: Any) -> Any:
    """Return the states (n_x, 1) with data states below 1e-25 set to exactly 0.

    Data states have no rate, but the linear solver of an implicit method leaves rounding in them.
    Laws compare them with 0 (stuck or sliding, whole or broken), which rounding would decide.
    """
    rows = list(ca.vertsplit(x)) if model.n_x else []
    for i in model.dae.data:
        rows[i] = ca.if_else(ca.fabs(rows[i]) < _NOISE, 0, rows[i])
    return ca.vertcat(*rows) if model.dae.data else x


def add_events(
    model: Model, dae: dict[str, Any], arguments: Sequence[ca.MX], instant: Any
) -> tuple[dict[str, Any], ca.Function]:
    """Add the events of a model to a DAE in CasADi's form.

    Arguments:
        dae: MX symbols "t", "x", "z", "p" and expressions "ode", "alg", as `ca.integrator` takes
            them.
        arguments: t, x, z, u, p of the model, as expressions of the symbols of `dae`.
        instant: s; times closer than this are one instant.

    Returns:
        The DAE with the extra states after x and with "zero", the functions of the events, and the
        Function for the integrator's option "transition".
    """
    t, x, z, p = (dae[key] for key in "txzp")
    extra = ca.MX.sym("record", n_extra(model))
    given = ca.Function("given", [t, x, z, p], list(arguments))
    cascade = _cascade(model)
    index, w = ca.MX.sym("index"), ca.vertcat(x, extra)
    new = cascade(index, *arguments, extra, instant)
    transition = ca.Function(
        "transition",
        [index, t, w, z, p, ca.MX(0, 1)],
        [ca.vertcat(new[0], new[2]), new[1]],
        ["index", "t", "x", "z", "p", "u"],
        ["post_x", "post_z"],
    )
    # CasADi cannot end an integration at an event. Once the run has ended, all zero functions are
    # held at 1: nothing fires any more, and what is integrated from there on is cut off later.
    over = ca.fmin(extra[1], extra[2]) < NEVER
    zero = ca.if_else(over, 1, model.function("zero")(*given(t, x, z, p)))
    ode = ca.vertcat(dae["ode"], ca.MX.zeros(n_extra(model)))
    return {**dae, "x": w, "ode": ode, "zero": zero}, transition


def _cascade(model: Model) -> ca.Function:
    """(index, t, x, z, u, p, extra, instant) -> x, z, extra after an event and all others due.

    A negative index means that no event was found, such as at the start of a run.
    """
    symbols, index = _symbols(model), ca.MX.sym("index")
    t, x, z, u, p, extra, instant = symbols
    found, none = index == ca.DM(range(len(model.events))), ca.DM.zeros(len(model.events))
    at_event = ca.fabs(_seen(model)(t, x, z, u, p, instant, none)[0])
    # The search ends within an instant of the crossing, where rounding keeps a continuous function
    # off zero. Twice that remainder counts as zero in what follows; a function that jumps across
    # zero is farther off, and gets no such allowance.
    floor = ca.if_else(ca.logic_and(found, at_event <= _FOUND), 2 * at_event, 0)
    zero, width, falls, above = _seen(model)(t, x, z, u, p, instant, floor)
    spent = extra[_SPENT]
    fresh = ca.logic_or(spent == 0, t - spent > BAND * instant)
    fallen = ca.logic_and(falls, fresh)
    at_once = ca.logic_and(_at_once(model), spent == 0)
    armed = ca.logic_or(ca.logic_or(above, fallen), ca.logic_or(at_once, found))
    below = ca.logic_and(at_once, zero < -width)
    due = _first(ca.logic_or(found, ca.logic_or(fallen, below)))
    armed, due, x, z, extra = _repeated(model)(armed, due, floor, *symbols)
    # An event that is still due after all repetitions means too many at one instant.
    over = due >= 0
    spent = ca.if_else(armed, 0, ca.if_else(t == 0, _TINY, t))
    extra = ca.vertcat(
        extra[:2], ca.if_else(over, ca.fmin(extra[2], t), extra[2]), extra[3 : _SPENT.start], spent
    )
    return ca.Function("cascade", [index, *symbols], [x, z, extra])


def begin(model: Model, name: str) -> ca.Function:
    """Build the Function (t, x, z, u, p, extra, instant) -> x, z, extra for the start of a run.

    It solves the algebraic unknowns z for the start, and fires the events that are due there.

    Arguments:
        name: of the Function, which becomes a symbol of the generated C.
    """
    symbols = _symbols(model)
    t, x, z, u, p, extra, instant = symbols
    z = _solved(model, t, x, z, u, p)
    after = _cascade(model)(-1, t, x, z, u, p, extra, instant)
    return ca.Function(name, symbols, [ca.densify(value) for value in after])


def _symbols(model: Model) -> list[ca.MX]:
    sizes = {
        "t": 1,
        "x": model.n_x,
        "z": model.n_z,
        "u": model.n_u,
        "p": model.n_p,
        "extra": n_extra(model),
        "instant": 1,
    }
    return [ca.MX.sym(name, n) for name, n in sizes.items()]


def _at_once(model: Model) -> ca.DM:
    return ca.DM([float(event.at_once) for event in model.dae.events])


def _first(due: ca.MX) -> ca.MX:
    """Return the index of the first entry that is not 0, or -1."""
    index = ca.MX(-1)
    for j in reversed(range(due.numel())):
        index = ca.if_else(due[j], j, index)
    return index


def _repeated(model: Model) -> ca.Function:
    """(armed, due, floor, t, x, z, u, p, extra, instant) -> armed, due, x, z, extra at the end.

    It fires events until none is due, at most _NEST ** _DEPTH. `due` is the index of the event to
    fire next, -1 for none.
    """
    symbols, n = _symbols(model), len(model.events)
    t, x, z, u, p, extra, instant = symbols
    armed, due, floor = ca.MX.sym("armed", n), ca.MX.sym("due"), ca.MX.sym("floor", n)
    inputs = [armed, due, floor, *symbols]
    idle = ca.Function("idle", inputs, [armed, due, x, z, extra])
    step = ca.Function.if_else("step", _one(model), idle)
    step = ca.Function("next", inputs, step(due >= 0, *inputs))
    # A CasADi graph has no loop that ends on a condition. A Function that calls another one _NEST
    # times, nested _DEPTH deep, repeats the step often enough in little code; once nothing is due,
    # each further call takes the branch that returns its arguments.
    for _ in range(_DEPTH):
        state = [armed, due, x, z, extra]
        for _ in range(_NEST):
            state = step(*state[:2], floor, t, *state[2:4], u, p, state[4], instant)
        step = ca.Function("next", inputs, state)
    return step


def _one(model: Model) -> ca.Function:
    """Build the Function with the arguments and results of `_repeated` that fires one event."""
    symbols, n = _symbols(model), len(model.events)
    t, x, z, u, p, extra, instant = symbols
    armed, due, floor = ca.MX.sym("armed", n), ca.MX.sym("due"), ca.MX.sym("floor", n)
    x, z, extra = _fire(model)(due, *symbols)
    zero, width, falls, above = _seen(model)(t, x, z, u, p, instant, floor)
    # What another event puts below zero has not fallen through it: it stays armed only if it may
    # fire at once. The event itself is armed again only if it left its function above zero.
    own, below = due == ca.DM(range(n)), zero < -width
    kept = ca.logic_and(armed, ca.logic_not(own))
    now = ca.logic_or(above, ca.logic_and(kept, ca.logic_or(_at_once(model), zero >= -width)))
    next_one = ca.logic_and(now, ca.logic_or(falls, ca.logic_and(_at_once(model), below)))
    goes_on = extra[1] >= NEVER
    following = ca.if_else(goes_on, _first(next_one), -1)
    return ca.Function("one", [armed, due, floor, *symbols], [now, following, x, z, extra])


def _solved(model: Model, t: Any, x: Any, z: Any, u: Any, p: Any) -> ca.MX:
    """Return the unknowns that solve alg = 0, by a fixed number of Newton steps from z."""
    for _ in range(_NEWTON if model.n_z else 0):
        residual = ca.densify(model.function("alg")(t, x, z, u, p))
        z = z - ca.solve(model.function("dalg_dz")(t, x, z, u, p), residual)
    return z


def _fire(model: Model) -> ca.Function:
    """(index, t, x, z, u, p, extra, instant) -> x, consistent z and record after one event."""
    symbols = _symbols(model)
    t, x, z, u, p, extra, instant = symbols
    index = ca.MX.sym("index")
    chosen = ca.vertcat(*(index == j for j in range(len(model.events))))
    after = x + ca.densify(model.function("jump")(t, x, z, u, p) @ chosen)
    unknown = _solved(model, t, after, z, u, p)
    stops = ca.DM([float(event.stops) for event in model.dae.events])
    # The ring buffer also holds the time of the event CROWD - 1 before this one: if that is closer
    # than CLOSE of the run, events follow each other without end.
    slots, count = ca.DM(range(RECORD)), extra[0]
    slot, earlier = slots == ca.fmod(count, RECORD), slots == ca.fmod(count + 1 - CROWD, RECORD)
    crowded = t - ca.dot(earlier, extra[_TIMES]) <= instant * (CLOSE / INSTANT)
    endless = ca.logic_and(count + 1 >= CROWD, crowded)
    record = ca.vertcat(
        count + 1,
        ca.if_else(ca.dot(stops, chosen) > 0, ca.fmin(extra[1], t), extra[1]),
        ca.if_else(endless, ca.fmin(extra[2], t), extra[2]),
        ca.if_else(slot, t, extra[_TIMES]),
        ca.if_else(slot, index, extra[_WHICH]),
        extra[_SPENT],
    )
    return ca.Function("fire", [index, *symbols], [after, unknown, record])


def _seen(model: Model) -> ca.Function:
    """(t, x, z, u, p, instant, floor) -> zero, width, whether it falls, whether it is above.

    Within `width` of zero a function counts as zero, and its rate decides on which side it is.
    """
    t, x, z, u, p, _, instant = _symbols(model)
    floor = ca.MX.sym("floor", len(model.events))
    zero, rate = (ca.densify(model.function(f)(t, x, z, u, p)) for f in ("zero", "zero_rate"))
    width = ca.fmax(BAND * instant * ca.fabs(rate), floor)
    within = ca.fabs(zero) <= width
    falls = ca.logic_and(within, rate < 0)
    above = ca.logic_or(zero > width, ca.logic_and(within, rate >= 0))
    return ca.Function("seen", [t, x, z, u, p, instant, floor], [zero, width, falls, above])


def integrator(
    name: str,
    plugin: str,
    dae: Mapping[str, Any],
    grid: Sequence[float],
    transition: ca.Function,
    tolerance: float,
    options: Mapping[str, Any],
) -> ca.Function:
    """Build CasADi's integrator with events.

    Arguments:
        name: of the Function, which becomes a symbol of generated C.
        plugin: "rosenbrock" or "erk".
        dae, transition: from `add_events`.
        grid: start time and output times.
        tolerance: times closer than this are one instant, in the unit of the grid.
        options: more options of the plugin; they take precedence.
    """
    own = {
        "transition": transition,
        "event_tol": tolerance,
        "max_event_iter": _SEARCH,
        "max_events": _MOST,
    }
    # CasADi prints "Event support is experimental" whenever such an integrator is built.
    with contextlib.redirect_stderr(io.StringIO()):
        return ca.integrator(name, plugin, dict(dae), grid[0], list(grid[1:]), own | dict(options))
