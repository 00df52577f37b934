"""Balance: motions without inertia become algebraic, or of first order if they are damped.

A formulation writes the sum F of forces (or torques) into the `ode` row of a velocity without
inertia, and lists the motion in `Dae.balances`. F must vanish:

- F depends on the velocity: that becomes an algebraic unknown; the coordinate stays a state.
- F depends on coordinates only: these become algebraic; their velocity follows from d alg/dt = 0.
- F is zero for all states: the velocity is undetermined, and keeps its start value.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np

from ..dae.dae import Dae, Expansion
from ..dae.members import Balance, Label, Part, pick
from .undecided import Block, mixed, settle

_SHOWN = 12  # start values in one note


def balance(dae: Dae) -> Dae:
    """Return the `Dae` with its motions without inertia made algebraic, at consistent starts.

    Directions of motion that the balance does not determine are settled in `undecided.py`.

    Raises:
        ValueError: nothing acts on such a motion that could determine it.
    """
    if not dae.balances:
        return dae
    sorting = _Sorting(dae)
    for motion in dae.balances:
        sorting.sort(motion)
    for block in mixed(sorting.result(), sorting.blocks):
        sorting.by_velocity(block)
    return _with_start(settle(sorting.result(), sorting.blocks))


class _Sorting:
    """Sorts rows of the full scene into states, algebraic unknowns and equations."""

    def __init__(self, dae: Dae) -> None:
        n = dae.x.numel()
        self.dae = dae
        self.way = dae.expansion or Expansion(dae.x, dae.x_labels, tuple(range(n)), (None,) * n)
        self.rates = ca.vertsplit(dae.ode)
        reads = ca.jacobian_sparsity(ca.vertcat(dae.ode, dae.alg), dae.x)
        self.readers = [set(reads.row()[a:b]) for a, b in pairwise(reads.colind())]
        self.blocks: list[Block] = []
        self.notes: list[str] = []

    def sort(self, motion: Balance) -> None:
        """Choose unknowns for one motion: its velocities if damped, else its coordinates."""
        place = self.way.rows
        live = [row for row in motion.velocities if place[row] is not None]
        idle = [row for row in live if row in motion.idle]
        acting = tuple(row for row in idle if not self.rates[place[row]].is_zero())  # type: ignore[index]
        if idle and not acting:
            self.notes.append(
                f"{motion.name} has no inertia and nothing acts on it: {self._names(idle)} keeps "
                "its start value"
            )
        if acting:
            own = {place[row] for row in motion.coordinates}
            damped = any(self.readers[place[row]] - own for row in acting)  # type: ignore[index]
            # A rod has inertia about two axes only. All its coordinates stay states, then.
            mixed = not set(live) <= set(motion.idle)
            unknowns = acting if damped or mixed else motion.coordinates
            kept = tuple(row for row in unknowns if place[row] is not None)
            self.blocks.append(Block(motion, acting, kept, damped or mixed))

    def by_velocity(self, block: Block) -> None:
        """Take the velocities of a block as its unknowns, although nothing damps it."""
        k = self.blocks.index(block)
        self.blocks[k] = Block(block.motion, block.acting, block.acting, True)

    def _names(self, rows: list[int] | tuple[int, ...]) -> str:
        return ", ".join(self.way.labels[row].name for row in rows)

    def result(self) -> Dae:
        """Return the `Dae` whose z are the unknowns and whose alg are the balances."""
        dae, way, first = self.dae, self.way, self.dae.z.numel()
        followers = tuple(b.motion for b in self.blocks if not b.damped)
        derived = {row for motion in followers for row in motion.velocities}
        places = (way.rows[row] for b in self.blocks for row in b.unknowns)
        unknown = [place for place in places if place is not None]
        leaving = {*unknown, *(way.rows[row] for row in derived)}
        kept = [i for i in range(dae.x.numel()) if i not in leaving]
        place: dict[int | None, int] = {old: new for new, old in enumerate(kept)}
        acting = [row for b in self.blocks for row in b.acting]
        equation = {row: first + i for i, row in enumerate(acting)}
        gauges = [part for b in self.blocks if not b.damped for part in self._gauges(b)]
        numbered = [
            replace(part, alg_rows=(first + len(acting) + i,)) for i, part in enumerate(gauges)
        ]
        states = list(ca.vertsplit(way.states))
        for row in derived:
            states[row] = ca.SX(0)
        return replace(
            dae,
            x=pick(dae.x, kept),
            x_labels=tuple(dae.x_labels[i] for i in kept),
            x_start=pick(dae.x_start, kept),
            z=ca.vertcat(dae.z, pick(dae.x, unknown)),
            z_labels=(*dae.z_labels, *(dae.x_labels[i] for i in unknown)),
            z_start=ca.vertcat(dae.z_start, pick(dae.x_start, unknown)),
            parts=(*dae.parts, *numbered),
            balances=(),
            notes=(*dae.notes, *self.notes),
            expansion=Expansion(
                ca.vertcat(*states),
                way.labels,
                tuple(place.get(row) for row in way.rows),
                tuple(equation.get(row) for row in range(len(way.rows))),
                followers,
            ),
        )

    def _gauges(self, block: Block) -> list[Part]:
        """Return equations for what no force determines, so that coordinates can be solved for.

        The norm of a quaternion stays 1. Along an undetermined direction, such as the spin of a
        point mass on a string, the displacement from the start stays zero.
        """
        motion = block.motion
        guess = ca.vertcat(*(self.way.labels[row].start for row in motion.coordinates))
        c, start, turned = motion.away()
        free = [i for i, row in enumerate(motion.velocities) if row not in block.acting]
        rows = [turned[i] for i in free]
        rows += [ca.dot(c, c) - 1] if c.numel() > turned.numel() else []
        return [
            Part(motion.name, _equation(self.dae, c, start, row), motion.coordinates, (), guess, ())
            for row in rows
        ]


def _equation(dae: Dae, x: ca.SX, c: ca.SX, row: ca.SX) -> ca.Function:
    """Return a kernel that adds to alg only."""
    return ca.Function("balance", [dae.t, x, ca.SX.sym("z", 0), c], [ca.SX(0, 1), row])


def _with_start(dae: Dae) -> Dae:
    """Return the `Dae` with consistent start values of z, and a note on those that changed."""
    if not dae.z.numel():
        return dae
    u = np.array([label.start for label in dae.u_labels])
    p = np.array([label.start for label in dae.p_labels])
    x, guess = dae.start_values(p)
    z, found = dae.consistent(0.0, x, guess, u, p)
    if not found:
        note = "no consistent start values found at default values; give others near a solution"
        return replace(dae, notes=(*dae.notes, note))
    labels = tuple(
        replace(label, start=float(value)) for label, value in zip(dae.z_labels, z, strict=True)
    )
    note = _what_moved(dae.z_labels, labels)
    return replace(dae, z_labels=labels, notes=(*dae.notes, *([note] if note else [])))


def _what_moved(given: tuple[Label, ...], found: tuple[Label, ...]) -> str:
    moved = [
        f"{new.name} = {new.start:.6g} {new.unit}".rstrip() + f" (given {old.start:.6g})"
        for old, new in zip(given, found, strict=True)
        if abs(new.start - old.start) > 1e-9 * (1 + abs(new.start))
    ]
    more = f" and {len(moved) - _SHOWN} more" if len(moved) > _SHOWN else ""
    return f"consistent start values found: {', '.join(moved[:_SHOWN])}{more}" if moved else ""
