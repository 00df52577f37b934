"""What a reduction left out, and the Jacobian that tells whether it stays there."""

from __future__ import annotations

import casadi as ca

from ..dae import Dae, Dropped

_NEVER_MOVES = "its rate is zero while all dropped states keep their start values"


def dropped(full: Dae, reduced: Dae) -> tuple[Dropped, ...]:
    """The states that never move."""
    labels = [full.x_labels[i] for i in _gone(reduced)]
    return tuple(Dropped(label.name, label.start, _NEVER_MOVES) for label in labels)


def inertial(full: Dae, reduced: Dae) -> tuple[bool, ...]:
    """For each dropped state whether its row is a rate, or a force that must vanish."""
    idle = {row for motion in full.balances for row in motion.idle}
    return tuple(row not in idle for row in _gone(reduced))


def transverse(full: Dae, reduced: Dae) -> ca.Function:
    """Jacobian of the rates that vanish by the states that never move, on the kept manifold."""
    rows, block = _gone(reduced), ca.SX(0, 0)
    if rows:
        block = ca.jacobian(full.ode[rows], full.x[rows])
        block = ca.substitute(block, full.x, reduced.measured[: full.x.numel()])
    return ca.Function("transverse", reduced.symbols, [block], list("txzup"), ["transverse"])


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
        if row is None and i not in follows and not ca.depends_on(states[i], moving)
    ]
