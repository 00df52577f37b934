"""What a reduction left out and why, and the Jacobian that shows whether it would stay there."""

from __future__ import annotations

import casadi as ca

from ..dae.dae import Dae
from ..dae.members import Label
from ..dae.reduction import Dropped, Replaced

_NEVER_MOVES = "its rate is zero while all dropped states keep their start values"
_UNUSED = "no requested output depends on it"
_LONG = 50  # characters of a formula


def dropped(still: list[int], reduced: Dae) -> tuple[Dropped, ...]:
    """Return the states that never move, then those that no requested output depends on.

    Arguments:
        still: rows of the full states that never move.
    """
    way = reduced.expansion
    if way is None:
        return ()
    pairs = [(i, _NEVER_MOVES) for i in still] + [(i, _UNUSED) for i in sorted(way.unknown)]
    labels = [(way.labels[i], reason) for i, reason in pairs]
    return tuple(Dropped(label.name, label.start, reason) for label, reason in labels)


def replaced(left: tuple[Dropped, ...], reduced: Dae) -> tuple[Replaced, ...]:
    """Return the states that follow from others by a formula, except those in `left`."""
    way = reduced.expansion
    if way is None:
        return ()
    here = {label.name for label in (*reduced.x_labels, *reduced.z_labels)}
    here |= {d.name for d in left}
    hows = {
        row: _rate_of(way.labels, motion.coordinates)
        for motion in way.followers
        for row in motion.velocities
    }
    states = ca.vertsplit(way.states) if way.rows else []
    pairs = [(i, label) for i, label in enumerate(way.labels) if label.name not in here]
    return tuple(
        Replaced(label.name, hows[i], True)
        if i in hows
        else Replaced(label.name, _formula(states[i]))
        for i, label in pairs
    )


def _formula(expr: ca.SX) -> str:
    """Return a short formula as text; of a long one, the symbols that it depends on."""
    text = str(expr)
    if len(text) <= _LONG and "@" not in text:
        return text
    return "a function of " + ", ".join(sorted(symbol.name() for symbol in ca.symvar(expr)))


def _rate_of(labels: tuple[Label, ...], coordinates: tuple[int, ...]) -> str:
    return "rate of " + ", ".join(labels[row].name for row in coordinates)


def inertial(full: Dae, still: list[int]) -> tuple[bool, ...]:
    """Return whether the row of each still state is a rate, not a force that must vanish."""
    idle = {row for motion in full.balances for row in motion.idle}
    return tuple(row not in idle for row in still)


def transverse(full: Dae, core: Dae, written: Dae, reduced: Dae) -> ca.Function:
    """Return the Jacobian of the vanishing rates by the still states, along motions of the model.

    It is a Function of (t, x, z, u, p) of the reduced model; parameters that only the dropped
    motion depends on follow in p.

    Arguments:
        full: the model before all passes.
        core: after the passes on the motion.
        written: the same motion as `core`, perhaps as part of the states of another scene.
        reduced: `written` after the passes on the outputs.
    """
    # Along such motions the full Jacobian is block triangular: still rates do not depend on moving
    # states. So this block alone decides whether a small disturbance of the still states grows.
    rows, block = never_moving(core), ca.SX(0, 0)
    if rows:
        block = ca.jacobian(full.ode[rows], full.x[rows])
        block = ca.substitute(block, full.x, core.measured[: full.x.numel()])
        block = ca.substitute(block, ca.vertcat(core.x, core.z), _over(reduced, written))
    t, x, z, u, p = reduced.symbols
    arguments = [t, x, z, u, ca.vertcat(p, reduced.idle_p)]
    return ca.Function("transverse", arguments, [block], list("txzup"), ["transverse"])


def _over(reduced: Dae, written: Dae) -> ca.SX:
    """Return x and z of `written` over those of `reduced`; what it lacks is at its start."""
    here = {label.name for label in (*reduced.x_labels, *reduced.z_labels)}
    values = [ca.SX(0, 1)]
    for kind in "xz":
        column, start = getattr(written, kind), getattr(written, f"{kind}_start")
        values += [
            column[i] if label.name in here else start[i]
            for i, label in enumerate(getattr(written, f"{kind}_labels"))
        ]
    return ca.vertcat(*values)


def never_moving(reduced: Dae) -> list[int]:
    """Return the full rows that never move: without a row, and with a start value as formula."""
    way = reduced.expansion
    if way is None:
        return []
    moving = ca.vertcat(reduced.x, reduced.z)
    follows = {row for motion in way.followers for row in motion.velocities}
    states = ca.vertsplit(way.states) if way.rows else []
    return [
        i
        for i, row in enumerate(way.rows)
        if row is None and i not in follows and not ca.depends_on(states[i], moving)
    ]
