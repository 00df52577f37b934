"""What a reduction left out, and the Jacobian that tells whether it stays there."""

from __future__ import annotations

import casadi as ca

from ..dae.dae import Dae
from ..dae.members import Label
from ..dae.reduction import Dropped, Replaced

_NEVER_MOVES = "its rate is zero while all dropped states keep their start values"
_NOT_FELT = "no requested output feels it"
_LONG = 50  # characters of a formula


def dropped(still: list[int], reduced: Dae) -> tuple[Dropped, ...]:
    """The states that never move, then those that no requested output feels.

    Arguments:
        still: full states that never move.
    """
    way = reduced.expansion
    if way is None:
        return ()
    pairs = [(i, _NEVER_MOVES) for i in still] + [(i, _NOT_FELT) for i in sorted(way.unknown)]
    labels = [(way.labels[i], reason) for i, reason in pairs]
    return tuple(Dropped(label.name, label.start, reason) for label, reason in labels)


def replaced(left: tuple[Dropped, ...], reduced: Dae) -> tuple[Replaced, ...]:
    """The states that follow from others, beside those that are left out."""
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
    """A short formula as it stands, of a long one what it depends on."""
    text = str(expr)
    if len(text) <= _LONG and "@" not in text:
        return text
    return "a function of " + ", ".join(sorted(symbol.name() for symbol in ca.symvar(expr)))


def _rate_of(labels: tuple[Label, ...], coordinates: tuple[int, ...]) -> str:
    return "rate of " + ", ".join(labels[row].name for row in coordinates)


def inertial(full: Dae, still: list[int]) -> tuple[bool, ...]:
    """For each state that never moves whether its row is a rate, or a force that must vanish."""
    idle = {row for motion in full.balances for row in motion.idle}
    return tuple(row not in idle for row in still)


def transverse(full: Dae, core: Dae, written: Dae, reduced: Dae) -> ca.Function:
    """Jacobian of the rates that vanish by the states that never move, on the kept manifold.

    Parameters that only the dropped motion feels come after p.

    Arguments:
        core: what is left of the full model without what never moves.
        written: the same, perhaps with other names and among the states of another scene.
        reduced: what is left of that without what no output feels.
    """
    rows, block = never_moving(core), ca.SX(0, 0)
    if rows:
        block = ca.jacobian(full.ode[rows], full.x[rows])
        block = ca.substitute(block, full.x, core.measured[: full.x.numel()])
        block = ca.substitute(block, ca.vertcat(core.x, core.z), _over(reduced, written))
    t, x, z, u, p = reduced.symbols
    arguments = [t, x, z, u, ca.vertcat(p, reduced.idle_p)]
    return ca.Function("transverse", arguments, [block], list("txzup"), ["transverse"])


def _over(reduced: Dae, written: Dae) -> ca.SX:
    """States and unknowns of `written`; those that `reduced` lacks stand at their start."""
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
    """Full rows that never move: they have no row, and a start value instead of a state."""
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
