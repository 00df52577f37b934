"""What a reduction left out, and the Jacobian that tells whether it stays there."""

from __future__ import annotations

import casadi as ca

from ..dae import Dae, Label
from ..reduction import Dropped, Replaced

_NEVER_MOVES = "its rate is zero while all dropped states keep their start values"
_NOT_FELT = "no requested output feels it"


def dropped(full: Dae, reduced: Dae) -> tuple[Dropped, ...]:
    """The states that never move, then those that no requested output feels."""
    labels = [full.x_labels[i] for i in _gone(reduced)]
    still = tuple(Dropped(label.name, label.start, _NEVER_MOVES) for label in labels)
    way = reduced.expansion
    lost = [way.labels[i] for i in sorted(way.unknown)] if way else []
    return still + tuple(Dropped(label.name, label.start, _NOT_FELT) for label in lost)


def replaced(full: Dae, reduced: Dae) -> tuple[Replaced, ...]:
    """The states that follow from others."""
    way = reduced.expansion
    if way is None:
        return ()
    here = {label.name for label in (*reduced.x_labels, *reduced.z_labels)}
    left = {d.name for d in dropped(full, reduced)}
    hows = {row: _rate_of(way.labels, motion.coordinates) for motion in way.followers
            for row in motion.velocities}  # fmt: skip
    states = ca.vertsplit(way.states) if way.rows else []
    pairs = [(i, label) for i, label in enumerate(way.labels)
             if label.name not in here and label.name not in left]  # fmt: skip
    return tuple(
        Replaced(label.name, hows.get(i, f"{states[i]}".replace("@", ""))) for i, label in pairs
    )


def _rate_of(labels: tuple[Label, ...], coordinates: tuple[int, ...]) -> str:
    return "rate of " + ", ".join(labels[row].name for row in coordinates)


def inertial(full: Dae, reduced: Dae) -> tuple[bool, ...]:
    """For each dropped state whether its row is a rate, or a force that must vanish."""
    idle = {row for motion in full.balances for row in motion.idle}
    return tuple(row not in idle for row in _gone(reduced))


def transverse(full: Dae, reduced: Dae) -> ca.Function:
    """Jacobian of the rates that vanish by the states that never move, on the kept manifold.

    Parameters that only the dropped motion feels come after p.
    """
    rows, block = _gone(reduced), ca.SX(0, 0)
    if rows:
        block = ca.jacobian(full.ode[rows], full.x[rows])
        block = ca.substitute(block, full.x, reduced.measured[: full.x.numel()])
    t, x, z, u, p = reduced.symbols
    arguments = [t, x, z, u, ca.vertcat(p, reduced.idle_p)]
    return ca.Function("transverse", arguments, [block], list("txzup"), ["transverse"])


def _gone(reduced: Dae) -> list[int]:
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
        if row is None
        and i not in follows
        and i not in way.unknown
        and not ca.depends_on(states[i], moving)
    ]
