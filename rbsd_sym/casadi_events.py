"""Events for CasADi's one-step methods, which locate crossings on their dense output.

CasADi fires one event where its function falls through zero, from + to - only. The transition does
the rest: it solves the algebraic unknowns again, and fires what else is due at that instant (see
`integrators.events` for the rules; here each event fires at most once at one instant). Since CasADi
tells nothing about events, extra states without rate keep a record of them.
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
_PASSES = 2  # over all events, for those that others set off
NEVER = 1e300
_NOISE = 1e-25


# The extra states: count of events, first time at which one stops the run, first time at which they
# follow each other without end, then times and indices of the last ones.
N_EXTRA = 3 + 2 * RECORD
_TIMES, _WHICH = slice(3, 3 + RECORD), slice(3 + RECORD, N_EXTRA)


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


def extra_start() -> np.ndarray:
    """Start values of the extra states."""
    return np.array([0.0, NEVER, NEVER] + [0.0] * (2 * RECORD))


def recorded(model: Model, extra: np.ndarray, before: Sequence[Happened]) -> Recorded:
    """The record in the extra states (n, N_EXTRA) at the output times, after what was before.

    Of more than `RECORD` events between two output times the first ones are lost.
    """
    found, told = list(before), 0
    for row in extra:
        count, times, which = int(row[0]), row[_TIMES], row[_WHICH]
        slots = (k % RECORD for k in range(max(told, count - RECORD), count))
        found += [Happened(float(times[k]), model.events[int(which[k])]) for k in slots]
        told = count
    return Recorded(told + len(before), tuple(found), float(extra[-1, 1]), float(extra[-1, 2]))


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
    extra = ca.MX.sym("record", N_EXTRA)
    given = ca.Function("given", [t, x, z, p], list(arguments))
    cascade = _cascade(model)
    index, w = ca.MX.sym("index"), ca.vertcat(x, extra)
    new = cascade(index, *arguments, extra, instant)
    transition = ca.Function(
        "transition", [index, t, w, z, p, ca.MX(0, 1)], [ca.vertcat(new[0], new[2]), new[1]],
        ["index", "t", "x", "z", "p", "u"], ["post_x", "post_z"],
    )  # fmt: skip
    over = ca.fmin(extra[1], extra[2]) < NEVER  # then events are off: what follows is no matter
    zero = ca.if_else(over, 1, model.function("zero")(*given(t, x, z, p)))
    ode = ca.vertcat(dae["ode"], ca.MX.zeros(N_EXTRA))
    return {**dae, "x": w, "ode": ode, "zero": zero}, transition


def _cascade(model: Model) -> ca.Function:
    """(index, t, x, z, u, p, extra, instant) -> x, z, extra after an event and all that is due."""
    symbols, index = _symbols(model), ca.MX.sym("index")
    state = _fire(model)(index, *symbols)
    fired = [index == j for j in range(len(model.events))]
    state = _passes(model, symbols, state, fired, _PASSES if len(fired) > 1 else 0)
    return ca.Function("cascade", [index, *symbols], state)


def begin(model: Model) -> ca.Function:
    """(t, x, z, u, p, extra, instant) -> x, consistent z, extra after what fires at the start."""
    symbols = _symbols(model)
    t, x, z, u, p, extra, _ = symbols
    state = [x, _settled(model, t, x, z, u, p), extra]
    state = _passes(model, symbols, state, [ca.MX(0)] * len(model.events), _PASSES)
    return ca.Function("begin", symbols, state)


def _symbols(model: Model) -> list[ca.MX]:
    sizes = {"t": 1, "x": model.n_x, "z": model.n_z, "u": model.n_u, "p": model.n_p,
             "extra": N_EXTRA, "instant": 1}  # fmt: skip
    return [ca.MX.sym(name, n) for name, n in sizes.items()]


def _passes(
    model: Model, symbols: list[ca.MX], state: Sequence[ca.MX], fired: list[Any], count: int
) -> list[ca.MX]:
    """The state (x, z, extra) after all events in order, each if it is due and has not fired."""
    t, u, p, instant = symbols[0], symbols[3], symbols[4], symbols[-1]
    fire, due = _fire(model), _due(model)
    x, z, extra = state
    for _ in range(count):
        for j in range(len(fired)):
            now = ca.logic_and(due(t, x, z, u, p, instant)[j], ca.logic_not(fired[j]))
            after = fire(j, t, x, z, u, p, extra, instant)
            x, z, extra = (
                ca.if_else(now, new, old) for new, old in zip(after, (x, z, extra), strict=True)
            )
            fired[j] = ca.logic_or(fired[j], now)
    return [x, z, extra]


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
    )
    return ca.Function("fire", [index, *symbols], [after, unknown, record])


def _due(model: Model) -> ca.Function:
    """(t, x, z, u, p, instant) -> which events fire now."""
    t, x, z, u, p, _, instant = _symbols(model)
    zero, rate = (model.function(f)(t, x, z, u, p) for f in ("zero", "zero_rate"))
    width = BAND * instant * ca.fabs(rate)
    falls = ca.logic_and(ca.fabs(zero) <= width, rate < 0)
    at_once = ca.DM([float(event.at_once) for event in model.dae.events])
    beyond = ca.logic_and(zero < -width, at_once > 0)
    return ca.Function("due", [t, x, z, u, p, instant], [ca.logic_or(falls, beyond)])


def integrator(
    name: str, plugin: str, dae: Mapping[str, Any], grid: Sequence[float], transition: ca.Function,
    tolerance: float, options: Mapping[str, Any],
) -> ca.Function:  # fmt: skip
    """CasADi's integrator with events, from the first time of the grid to the others.

    Arguments:
        tolerance: times closer than this are one.
    """
    own = {"transition": transition, "event_tol": tolerance, "max_event_iter": _SEARCH,
           "max_events": _MOST}  # fmt: skip
    with contextlib.redirect_stderr(io.StringIO()):  # "Event support is experimental"
        return ca.integrator(name, plugin, dict(dae), grid[0], list(grid[1:]), own | dict(options))
