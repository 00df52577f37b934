"""Events for CasADi's one-step methods, which locate crossings on their dense output.

CasADi fires one event where its function falls through zero, from + to - only. The transition does
the rest: it solves the algebraic unknowns again, and fires what else is due at that instant, by the
rules of `integrators.events`, but 64 events at one instant count as endless. Since CasADi tells
nothing about events, extra states without rate keep a record of them.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from .model import Model

# What all methods agree on (see `integrators.events`).
INSTANT = 1e-15  # of the run: times closer than this are one
BAND = 10.0  # instants: a function this close to zero is zero
LEAST = 400  # looks for crossings in a run
CROWD = 10  # instants that follow each other
CLOSE = 1e-10  # of the run: closer than this they never end

RECORD = 64  # events remembered between two output times, the last ones
_SEARCH = 500  # looks for one event
_MOST = 10_000  # events in a run
_NEWTON = 4  # steps for the unknowns after an event
_NEST, _DEPTH = 8, 2  # at most _NEST ** _DEPTH events at one instant
NEVER = 1e300
_NOISE = 1e-25
_FOUND = 1e-9  # a function that does not jump is nearer to zero where it was found to cross it


# The extra states: count of events, first time at which one stops the run, first time at which they
# follow each other without end; times and indices of the last ones; and of each event, the time
# at which it was last seen spent: fired, and not above zero since; 0 where it is not.
_TIMES, _WHICH = slice(3, 3 + RECORD), slice(3 + RECORD, 3 + 2 * RECORD)
_SPENT = slice(3 + 2 * RECORD, None)
_TINY = 1e-300  # stands for the time 0


class Happened(NamedTuple):
    """An event that has fired."""

    t: float
    name: str


class Recorded(NamedTuple):
    """What happened in a run: how many events, which, and when it was to end."""

    total: int
    events: tuple[Happened, ...]
    t_stop: float
    t_endless: float


def n_extra(model: Model) -> int:
    """Number of extra states."""
    return 3 + 2 * RECORD + len(model.events)


def extra_start(model: Model, armed: np.ndarray, t: float) -> np.ndarray:
    """Start values of the extra states, after what happened at the start.

    Arguments:
        armed: whether each event would fire as it falls.
    """
    spent = np.where(armed, 0.0, t or _TINY)
    return np.concatenate([[0.0, NEVER, NEVER], np.zeros(2 * RECORD), spent])


def recorded(model: Model, extra: np.ndarray, before: Sequence[Happened]) -> Recorded:
    """The record in the extra states (n, n_extra) at the output times, after what was before.

    Of more than `RECORD` events between two output times the first ones are lost.
    """
    found, told = list(before), 0
    for row in extra:
        count, times, which = int(row[0]), row[_TIMES], row[_WHICH]
        slots = (k % RECORD for k in range(max(told, count - RECORD), count))
        found += [Happened(float(times[k]), model.events[int(which[k])]) for k in slots]
        told = count
    return Recorded(told + len(before), tuple(found), float(extra[-1, 1]), float(extra[-1, 2]))


def ready(extra: np.ndarray) -> np.ndarray:
    """Whether each event would fire as it falls (n, events), from the extra states (n, n_extra)."""
    return extra[:, _SPENT] == 0


def tidy(model: Model, x: Any) -> Any:
    """The states with zeros where linear solvers have left rounding in data states.

    So that a comparison with 0 is one.
    """
    rows = list(ca.vertsplit(x)) if model.n_x else []
    for i in model.dae.data:
        rows[i] = ca.if_else(ca.fabs(rows[i]) < _NOISE, 0, rows[i])
    return ca.vertcat(*rows) if model.dae.data else x


def add_events(
    model: Model, dae: dict[str, Any], arguments: Sequence[ca.MX], instant: Any
) -> tuple[dict[str, Any], ca.Function]:
    """A DAE in MX with the extra states, functions of the events, and the transition.

    Arguments:
        dae: CasADi's, over t, x, z, p.
        arguments: t, x, z, u, p of the model over the symbols of `dae`.
        instant: times closer than this (s) are one.
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
    over = ca.fmin(extra[1], extra[2]) < NEVER  # then events are off: what follows is no matter
    zero = ca.if_else(over, 1, model.function("zero")(*given(t, x, z, p)))
    ode = ca.vertcat(dae["ode"], ca.MX.zeros(n_extra(model)))
    return {**dae, "x": w, "ode": ode, "zero": zero}, transition


def _cascade(model: Model) -> ca.Function:
    """(index, t, x, z, u, p, extra, instant) -> x, z, extra after an event and all that is due.

    A negative index is none.
    """
    symbols, index = _symbols(model), ca.MX.sym("index")
    t, x, z, u, p, extra, instant = symbols
    found, none = index == ca.DM(range(len(model.events))), ca.DM.zeros(len(model.events))
    at_event = ca.fabs(_seen(model)(t, x, z, u, p, instant, none)[0])
    # Rounding of a function where it was found to cross zero, if it does not jump.
    floor = ca.if_else(ca.logic_and(found, at_event <= _FOUND), 2 * at_event, 0)
    zero, width, falls, above = _seen(model)(t, x, z, u, p, instant, floor)
    spent = extra[_SPENT]
    fresh = ca.logic_or(spent == 0, t - spent > BAND * instant)
    fallen = ca.logic_and(falls, fresh)
    waits = ca.logic_and(_at_once(model), spent == 0)
    armed = ca.logic_or(ca.logic_or(above, fallen), ca.logic_or(waits, found))
    below = ca.logic_and(waits, zero < -width)
    due = _first(ca.logic_or(found, ca.logic_or(fallen, below)))
    armed, due, x, z, extra = _repeated(model)(armed, due, floor, *symbols)
    over = due >= 0  # more than may happen at one instant
    spent = ca.if_else(armed, 0, ca.if_else(t == 0, _TINY, t))
    extra = ca.vertcat(
        extra[:2], ca.if_else(over, ca.fmin(extra[2], t), extra[2]), extra[3 : _SPENT.start], spent
    )
    return ca.Function("cascade", [index, *symbols], [x, z, extra])


def begin(model: Model, name: str) -> ca.Function:
    """(t, x, z, u, p, extra, instant) -> x, consistent z, extra after what is due there."""
    symbols = _symbols(model)
    t, x, z, u, p, extra, instant = symbols
    z = _settled(model, t, x, z, u, p)
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
    """Index of the first that is not 0, -1 if none is."""
    index = ca.MX(-1)
    for j in reversed(range(due.numel())):
        index = ca.if_else(due[j], j, index)
    return index


def _repeated(model: Model) -> ca.Function:
    """(armed, due, floor, t, x, z, u, p, extra, instant) -> armed, due, x, z, extra at the end.

    Or after _NEST ** _DEPTH events; `due` is the index of the next one, -1 if there is none.
    """
    symbols, n = _symbols(model), len(model.events)
    t, x, z, u, p, extra, instant = symbols
    armed, due, floor = ca.MX.sym("armed", n), ca.MX.sym("due"), ca.MX.sym("floor", n)
    inputs = [armed, due, floor, *symbols]
    idle = ca.Function("idle", inputs, [armed, due, x, z, extra])
    step = ca.Function.if_else("step", _one(model), idle)
    step = ca.Function("next", inputs, step(due >= 0, *inputs))
    for _ in range(_DEPTH):
        state = [armed, due, x, z, extra]
        for _ in range(_NEST):
            state = step(*state[:2], floor, t, *state[2:4], u, p, state[4], instant)
        step = ca.Function("next", inputs, state)
    return step


def _one(model: Model) -> ca.Function:
    """As `_repeated`, after one event."""
    symbols, n = _symbols(model), len(model.events)
    t, x, z, u, p, extra, instant = symbols
    armed, due, floor = ca.MX.sym("armed", n), ca.MX.sym("due"), ca.MX.sym("floor", n)
    x, z, extra = _fire(model)(due, *symbols)
    zero, width, falls, above = _seen(model)(t, x, z, u, p, instant, floor)
    own, below = due == ca.DM(range(n)), zero < -width
    kept = ca.logic_and(armed, ca.logic_not(own))
    now = ca.logic_or(above, ca.logic_and(kept, ca.logic_or(_at_once(model), zero >= -width)))
    next_one = ca.logic_and(now, ca.logic_or(falls, ca.logic_and(_at_once(model), below)))
    goes_on = extra[1] >= NEVER
    following = ca.if_else(goes_on, _first(next_one), -1)
    return ca.Function("one", [armed, due, floor, *symbols], [now, following, x, z, extra])


def _settled(model: Model, t: Any, x: Any, z: Any, u: Any, p: Any) -> ca.MX:
    """The unknowns that solve alg = 0, by Newton's method."""
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
    unknown = _settled(model, t, after, z, u, p)
    stops = ca.DM([float(event.stops) for event in model.dae.events])
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
    """(t, x, z, u, p, instant, floor) -> zero, its width, whether it falls, whether it is above."""
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
    """CasADi's integrator with events, from the first time of the grid to the others.

    Arguments:
        tolerance: times closer than this are one.
    """
    own = {
        "transition": transition,
        "event_tol": tolerance,
        "max_event_iter": _SEARCH,
        "max_events": _MOST,
    }
    with contextlib.redirect_stderr(io.StringIO()):  # "Event support is experimental"
        return ca.integrator(name, plugin, dict(dae), grid[0], list(grid[1:]), own | dict(options))
