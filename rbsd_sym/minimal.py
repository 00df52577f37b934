"""Passes that leave out what cannot move: `Dae -> (Dae, Reduction)`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from .dae import Dae, Dropped, Expansion, Label, Part, Reduction, Turn
from .zeros import fold

_NEVER_MOVES = "its rate is zero while all dropped states keep their start values"


def reduce(dae: Dae) -> tuple[Dae, Reduction]:
    """All passes: states that never move, then quaternions that turn about one axis.

    The small model is exact for every value of the states it keeps, the inputs and the parameters.
    """
    reduced = planar(freeze(dae))
    return reduced, Reduction(_dropped(dae, reduced), lambda: _transverse(dae, reduced))


def freeze(dae: Dae) -> Dae:
    """Drop states whose rates vanish identically while they sit at their start values.

    Let Z be a set of states; if their rates are zero with Z at its start, for all values of the
    other states, inputs and parameters, Z never moves. The greatest such set that can be proven is
    found by starting with all states and removing those whose rate is not provably zero. It is
    sound, not complete. The dropped motion may be unstable: see `Reduction.transverse`.
    """
    gone = _Frozen(dae).solve()
    kept = [i for i in range(dae.x.numel()) if i not in gone]
    place = {row: i for i, row in enumerate(kept)}
    start, x = dae.x_start, dae.x
    states = ca.vertcat(ca.SX(0, 1), *(
        start[i] if i in gone else x[i] for i in range(x.numel())))  # fmt: skip
    return replace(
        dae,
        x=x[kept] if kept else ca.SX(0, 1),
        x_labels=tuple(dae.x_labels[i] for i in kept),
        x_start=start[kept] if kept else ca.SX(0, 1),
        parts=tuple(part for part in dae.parts if _is_live(part, gone)),
        expansion=Expansion(
            states, dae.x_labels, tuple(place.get(row) for row in range(x.numel()))
        ),
        source=f"minimal\n{dae.source}",
    )


def _is_live(part: Part, gone: frozenset[int]) -> bool:
    return bool(part.alg_rows) or any(row not in gone for row in part.ode_rows)


def _gone(reduced: Dae) -> list[int]:
    """Full rows that never move: they have no row, and a start value instead of a state."""
    expansion = reduced.expansion
    if expansion is None:
        return []
    states = ca.vertsplit(expansion.states) if expansion.rows else []
    return [
        i
        for i, row in enumerate(expansion.rows)
        if row is None and not ca.depends_on(states[i], reduced.x)
    ]


def _dropped(full: Dae, reduced: Dae) -> tuple[Dropped, ...]:
    labels = [full.x_labels[i] for i in _gone(reduced)]
    return tuple(Dropped(label.name, label.start, _NEVER_MOVES) for label in labels)


def _transverse(full: Dae, reduced: Dae) -> ca.Function:
    """Jacobian of the rates that vanish by the states that never move, on the kept manifold."""
    rows, block = _gone(reduced), ca.SX(0, 0)
    if rows:
        block = ca.jacobian(full.ode[rows], full.x[rows])
        block = ca.substitute(block, full.x, reduced.states[: full.x.numel()])
    return ca.Function("transverse", reduced.symbols, [block], list("txzup"), ["transverse"])


class _Frozen:
    """The greatest provable fixed point; a part is seen again when what it reads is released."""

    def __init__(self, dae: Dae) -> None:
        self.dae = dae
        self.frozen = set(range(dae.x.numel()))
        self.rates: list[dict[int, ca.SX]] = [{} for _ in range(dae.x.numel())]
        self.readers: list[set[int]] = [set() for _ in range(dae.x.numel())]
        for k, part in enumerate(dae.parts):
            for row in part.reads:
                self.readers[row].add(k)

    def solve(self) -> frozenset[int]:
        """Indices of the states that never move."""
        dirty = set(range(len(self.dae.parts)))
        while dirty:
            touched = {row for k in dirty for row in self._evaluate(k)}
            released = {row for row in touched & self.frozen if not self._is_zero(row)}
            self.frozen -= released
            dirty = {k for row in released for k in self.readers[row]}
        return frozenset(self.frozen)

    def _evaluate(self, k: int) -> tuple[int, ...]:
        """Rates that part k adds with the frozen states at their start."""
        part, dae = self.dae.parts[k], self.dae
        states = ca.vertcat(*(dae.x_start[i] if i in self.frozen else dae.x[i] for i in part.reads))
        rows, _ = dae.contribution(part, states)
        # Proof costs time: only for rows that may still stay, and are not plainly zero.
        open_rows = [i for i, row in enumerate(part.ode_rows)
                     if row in self.frozen and not rows[i].is_constant()]  # fmt: skip
        if open_rows and not states.is_valid_input():
            rows[open_rows] = fold(rows[open_rows], ca.vertcat(*dae.symbols))
        for i, row in enumerate(part.ode_rows):
            self.rates[row][k] = rows[i]
        return part.ode_rows

    def _is_zero(self, row: int) -> bool:
        return bool(sum(self.rates[row].values(), ca.SX(0)).is_zero())


def planar(dae: Dae) -> Dae:
    """One angle instead of two quaternion states where a body turns about one fixed axis.

    A quaternion whose two other vector components are frozen at zero is (cos(a/2), sin(a/2)) of an
    angle a with a' = w; the angle counts turns. It takes the place of q_w; the other state goes.
    """
    expansion = dae.expansion
    if expansion is None:
        return dae
    states, rows = list(ca.vertsplit(expansion.states)), list(expansion.rows)
    x, start = list(ca.vertsplit(dae.x)), list(ca.vertsplit(dae.x_start))
    labels, full_labels = list(dae.x_labels), list(expansion.labels)
    parts, gone = list(dae.parts), set()
    for turn in dae.turns:
        axis = _axis(rows, states, turn)
        w_row, v_row = turn.quaternion[0], turn.quaternion[(axis or 0) + 1]
        w, v = rows[w_row], rows[v_row]
        if axis is None or w is None or v is None:
            continue
        name = f"{turn.name}.angle_{'xyz'[axis]}"
        x[w] = ca.SX.sym(name)
        start[w] = 2 * ca.atan2(start[v], start[w])
        labels[w] = Label(name, "rad", 2 * math.atan2(labels[v].start, labels[w].start))
        states[w_row], states[v_row] = ca.cos(x[w] / 2), ca.sin(x[w] / 2)
        rows[w_row] = rows[v_row] = None
        parts.append(
            Part(name, _pass_on(dae), (turn.velocity[axis],), (), ca.SX(0, 1), (len(states),))
        )
        states.append(x[w])
        rows.append(w)
        full_labels.append(labels[w])
        gone.add(v)
    changed = replace(
        dae,
        x=ca.vertcat(*x),
        x_labels=tuple(labels),
        x_start=ca.vertcat(*start),
        parts=tuple(parts),
        expansion=Expansion(ca.vertcat(*states), tuple(full_labels), tuple(rows)),
    )
    return _without(changed, gone) if gone else dae


def _without(dae: Dae, gone: set[int]) -> Dae:
    """The reduced `Dae` without some of its own states, which nothing reads any more."""
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


def _axis(rows: Sequence[int | None], states: Sequence[ca.SX], turn: Turn) -> int | None:
    """The axis 0, 1, 2 of a turn of which only that component moves; None for any other turn."""
    moving = [i for i in range(3) if rows[turn.quaternion[i + 1]] is not None]
    if len(moving) != 1:
        return None
    idle = [i for i in range(3) if i not in moving]
    still = [turn.quaternion[i + 1] for i in idle] + [turn.velocity[i] for i in idle]
    # A row without a state stands for a number here: it was frozen.
    if any(rows[row] is not None or not states[row].is_zero() for row in still):
        return None
    return moving[0]


def _pass_on(dae: Dae) -> ca.Function:
    """Kernel whose rate is the one state it reads."""
    w, none = ca.SX.sym("w"), ca.SX(0, 1)
    arguments = [dae.t, w, ca.SX.sym("z", 0), ca.SX.sym("c", 0)]
    return ca.Function("angle", arguments, [w, none])
