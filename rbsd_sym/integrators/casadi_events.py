"""Events for CasADi's one-step methods, which locate crossings on their dense output.

CasADi fires one event where its function falls through zero, from + to - only. The transition does
the rest: it solves the algebraic unknowns again, and fires what else is due at that instant (see
`events` for the rules; here each event fires at most once at one instant). Since CasADi tells
nothing about events, extra states without rate keep a record of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..model import Model
from .events import BAND, CLOSE, CROWD, INSTANT, Happened

RECORD = 64  # events remembered, the last ones
_NEWTON = 4  # steps for the unknowns after an event
_PASSES = 2  # over all events, for those that others set off
_NEVER = 1e300


# The extra states: count of events, first time at which one stops the run, first time at which they
# follow each other without end, then times and indices of the last ones.
N_EXTRA = 3 + 2 * RECORD
_TIMES, _WHICH = slice(3, 3 + RECORD), slice(3 + RECORD, N_EXTRA)


class Recorded(NamedTuple):
    """What happened in a run: how many events, the last `RECORD`, and when it was to end."""

    total: int
    events: tuple[Happened, ...]
    t_stop: float
    t_endless: float


def extra_start() -> np.ndarray:
    """Start values of the extra states."""
    return np.array([0.0, _NEVER, _NEVER] + [0.0] * (2 * RECORD))


def recorded(model: Model, extra: np.ndarray, before: Sequence[Happened]) -> Recorded:
    """The record in the extra states, after what happened before the run."""
    count = int(extra[0])
    times, which = extra[_TIMES], extra[_WHICH]
    slots = [k % RECORD for k in range(max(0, count - RECORD), count)]
    found = [Happened(float(times[k]), model.events[int(which[k])]) for k in slots]
    return Recorded(count + len(before), (*before, *found), float(extra[1]), float(extra[2]))


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
    zero = model.function("zero")(*given(t, x, z, p))
    ode = ca.vertcat(dae["ode"], ca.MX.zeros(N_EXTRA))
    return {**dae, "x": w, "ode": ode, "zero": zero}, transition


def _cascade(model: Model) -> ca.Function:
    """(index, t, x, z, u, p, extra, instant) -> x, z, extra after all that is due."""
    n = len(model.events)
    index, instant = ca.MX.sym("index"), ca.MX.sym("instant")
    t, u, p = ca.MX.sym("t"), ca.MX.sym("u", model.n_u), ca.MX.sym("p", model.n_p)
    x0, z0 = ca.MX.sym("x", model.n_x), ca.MX.sym("z", model.n_z)
    extra0 = ca.MX.sym("extra", N_EXTRA)
    fire, due = _fire(model), _due(model)
    x, z, extra = fire(index, t, x0, z0, u, p, extra0, instant)
    fired = [index == j for j in range(n)]
    for _ in range(_PASSES if n > 1 else 0):
        for j in range(n):
            now = ca.logic_and(due(t, x, z, u, p, instant)[j], ca.logic_not(fired[j]))
            after = fire(j, t, x, z, u, p, extra, instant)
            x, z, extra = (
                ca.if_else(now, new, old) for new, old in zip(after, (x, z, extra), strict=True)
            )
            fired[j] = ca.logic_or(fired[j], now)
    return ca.Function("cascade", [index, t, x0, z0, u, p, extra0, instant], [x, z, extra])


def _fire(model: Model) -> ca.Function:
    """(index, t, x, z, u, p, extra, instant) -> x, consistent z and record after one event."""
    index, t, instant = ca.MX.sym("index"), ca.MX.sym("t"), ca.MX.sym("instant")
    x, z = ca.MX.sym("x", model.n_x), ca.MX.sym("z", model.n_z)
    u, p = ca.MX.sym("u", model.n_u), ca.MX.sym("p", model.n_p)
    extra = ca.MX.sym("extra", N_EXTRA)
    chosen = ca.vertcat(*(index == j for j in range(len(model.events))))
    after = x + ca.densify(model.function("jump")(t, x, z, u, p) @ chosen)
    unknown = z
    for _ in range(_NEWTON if model.n_z else 0):
        residual = model.function("alg")(t, after, unknown, u, p)
        jacobian = model.function("dalg_dz")(t, after, unknown, u, p)
        unknown = unknown - ca.solve(jacobian, ca.densify(residual))
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
    record = ca.if_else(extra[2] < _NEVER, extra, record)  # what comes after the end is no matter
    return ca.Function("fire", [index, t, x, z, u, p, extra, instant], [after, unknown, record])


def _due(model: Model) -> ca.Function:
    """(t, x, z, u, p, instant) -> which events fire now."""
    t, x, z = ca.MX.sym("t"), ca.MX.sym("x", model.n_x), ca.MX.sym("z", model.n_z)
    u, p = ca.MX.sym("u", model.n_u), ca.MX.sym("p", model.n_p)
    instant = ca.MX.sym("instant")
    zero, rate = (model.function(f)(t, x, z, u, p) for f in ("zero", "zero_rate"))
    width = BAND * instant * ca.fabs(rate)
    falls = ca.logic_and(ca.fabs(zero) <= width, rate < 0)
    at_once = ca.DM([float(event.at_once) for event in model.dae.events])
    beyond = ca.logic_and(zero < -width, at_once > 0)
    return ca.Function("due", [t, x, z, u, p, instant], [ca.logic_or(falls, beyond)])
