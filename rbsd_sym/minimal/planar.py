"""Planar: one angle for a body that turns about one fixed axis.

Of the four entries of its quaternion two remain after `freeze`; they lie on the unit circle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from ..dae.dae import Dae, Expansion
from ..dae.members import Balance, Kinematics, Label, Part, Rotation, RotationKind


def planar(dae: Dae) -> Dae:
    """Replace the two quaternion states of a body that turns about one fixed axis by one angle.

    With two vector components frozen at zero, the quaternion is (cos(a/2), sin(a/2)) for an angle a
    with a' = w, which counts turns. The angle takes the place of q_w, and the other state goes.

    Arguments:
        dae: after `freeze`; one that is not reduced is returned as it is.
    """
    expansion = dae.expansion
    if expansion is None:
        return dae
    states, rows = list(ca.vertsplit(expansion.states)), list(expansion.rows)
    x, start = list(ca.vertsplit(dae.x)), list(ca.vertsplit(dae.x_start))
    labels, full_labels = list(dae.x_labels), list(expansion.labels)
    parts, gone = list(dae.parts), set()
    balances, motions, pass_on = dae.balances, dae.motions, _pass_on(dae)
    for turn in dae.rotations:
        if turn.kind is not RotationKind.quaternion:
            continue
        axis = _axis(rows, states, turn)
        w_row, v_row = turn.coordinates[0], turn.coordinates[(axis or 0) + 1]
        w, v = rows[w_row], rows[v_row]
        if axis is None or w is None or v is None:
            continue
        value = 2 * math.atan2(labels[v].start, labels[w].start)
        labels[w] = Label(turn.owner, "angle", "xyz"[axis], "rad", value)
        name = labels[w].name
        x[w] = ca.SX.sym(name)
        start[w] = 2 * ca.atan2(start[v], start[w])
        # Parts go on reading the quaternion, now as a function of the angle. The angle is appended
        # to the full states, with a part of its own for its rate.
        states[w_row], states[v_row] = ca.cos(x[w] / 2), ca.sin(x[w] / 2)
        rows[w_row] = rows[v_row] = None
        parts.append(Part(name, pass_on, (turn.velocity[axis],), (), ca.SX(0, 1), (len(states),)))
        balances = tuple(_about_one_axis(b, turn, axis, len(states)) for b in balances)
        motions = tuple(_angle(m, turn, axis, len(states)) for m in motions)
        states.append(x[w])
        rows.append(w)
        full_labels.append(labels[w])
        gone.add(v)
    way = Expansion(ca.vertcat(*states), tuple(full_labels), tuple(rows), (None,) * len(rows))
    changed = replace(
        dae,
        x=ca.vertcat(*x),
        x_labels=tuple(labels),
        x_start=ca.vertcat(*start),
        parts=tuple(parts),
        balances=balances,
        motions=motions,
        expansion=way,
    )
    return _without(changed, gone) if gone else dae


def _without(dae: Dae, gone: set[int]) -> Dae:
    """Return a reduced `Dae` without some of its states, which nothing reads any more."""
    kept = [i for i in range(dae.x.numel()) if i not in gone]
    place = {old: new for new, old in enumerate(kept)}
    expansion = dae.expansion
    if expansion is None:
        raise ValueError(f"model '{dae.name}': states can only leave a reduced model")
    rows = tuple(None if row is None else place.get(row) for row in expansion.rows)
    return replace(
        dae,
        x=dae.x[kept],
        x_labels=tuple(dae.x_labels[i] for i in kept),
        x_start=dae.x_start[kept],
        expansion=replace(expansion, rows=rows),
    )


def _axis(rows: Sequence[int | None], states: Sequence[ca.SX], turn: Rotation) -> int | None:
    """Return the axis 0, 1, 2 of a rotation about one fixed axis; None for any other rotation."""
    moving = [i for i in range(3) if rows[turn.coordinates[i + 1]] is not None]
    if len(moving) != 1:
        return None
    idle = [i for i in range(3) if i not in moving]
    still = [turn.coordinates[i + 1] for i in idle] + [turn.velocity[i] for i in idle]
    # After `freeze`, a row without a state holds a start value, which must be zero.
    if any(rows[row] is not None or not states[row].is_zero() for row in still):
        return None
    return moving[0]


def _about_one_axis(balance: Balance, turn: Rotation, axis: int, angle: int) -> Balance:
    """Return the balance of this rotation for its angle, in row `angle`; any other unchanged."""
    if balance.coordinates != turn.coordinates:
        return balance
    w = turn.velocity[axis : axis + 1]
    idle = w if w[0] in balance.idle else ()
    velocity = ca.SX.sym("w")
    same = ca.Function("kinematics", [ca.SX.sym("a"), velocity], [velocity])
    return Balance(balance.name, (angle,), w, idle, same)


def _angle(motion: Kinematics, turn: Rotation, axis: int, angle: int) -> Kinematics:
    """Return the kinematics of this rotation for its angle, in row `angle`; others unchanged."""
    if motion.coordinates != turn.coordinates:
        return motion
    a, step = ca.SX.sym("a"), ca.SX.sym("step")
    added = ca.Function("retract", [a, step], [a + step])
    return Kinematics(
        motion.owner, motion.quantity, (angle,), turn.velocity[axis : axis + 1], added
    )


def _pass_on(dae: Dae) -> ca.Function:
    """Return a kernel whose rate is the only state that it reads."""
    w, none = ca.SX.sym("w"), ca.SX(0, 1)
    arguments = [dae.t, w, ca.SX.sym("z", 0), ca.SX.sym("c", 0)]
    return ca.Function("angle", arguments, [w, none])
