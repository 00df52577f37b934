"""Freeze: leave out the states that provably never move.

If the rate of a state is zero at its start value whatever the other states do, the start value is a
solution, and the only one, since the rates are Lipschitz continuous (Picard-Lindelöf).
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

import casadi as ca
import numpy as np

from ..dae.dae import Dae, Expansion
from ..dae.members import Part, Transition, numbers_of, pick
from ..dae.zeros import fold
from .probing import at_rest


def freeze(dae: Dae) -> Dae:
    """Drop the states whose rates vanish identically while they keep their start values.

    If the rates of a set Z of states are zero with Z at its start values, for all values of the
    other states, the inputs and the parameters, then Z never moves. The greatest such set that can
    be proven is a fixed point: start with all states, and remove those whose rate is not provably
    zero until nothing changes. Data states are never in Z, nor is a state that an event may change.

    The pass is sound, but not complete: a state may be kept that never moves. The motion that is
    left out may be unstable (see `Reduction.transverse`).
    """
    gone = _Frozen(dae).solve()
    kept = [i for i in range(dae.x.numel()) if i not in gone]
    place = {row: i for i, row in enumerate(kept)}
    start, x = dae.x_start, dae.x
    states = ca.vertcat(ca.SX(0, 1), *(start[i] if i in gone else x[i] for i in range(x.numel())))
    return replace(
        dae,
        x=pick(x, kept),
        x_labels=tuple(dae.x_labels[i] for i in kept),
        x_start=pick(start, kept),
        parts=tuple(part for part in dae.parts if _is_live(part, gone)),
        expansion=Expansion(
            states,
            dae.x_labels,
            tuple(place.get(row) for row in range(x.numel())),
            (None,) * x.numel(),
        ),
        source=f"minimal\n{dae.source}",
    )


def _is_live(part: Part, gone: frozenset[int]) -> bool:
    return bool(part.alg_rows) or any(row not in gone for row in part.ode_rows)


class _Frozen:
    """The greatest fixed point that can be proven.

    A part is evaluated again when a state that it reads has left the set. Parts with the same
    kernel, constants and frozen values share one proof.
    """

    def __init__(self, dae: Dae) -> None:
        self.dae = dae
        n = dae.x.numel()
        self.parts = (*dae.parts, *(_as_part(event) for event in dae.events))
        # A proof can only succeed for states that do not move at random values either.
        self.frozen = at_rest(dae)
        self.x, self.start = ca.vertsplit(dae.x), ca.vertsplit(dae.x_start)
        self.values = numbers_of(dae.x_start)
        self.rates: list[dict[int, ca.SX | None]] = [{} for _ in range(n)]
        self.readers: list[set[int]] = [set() for _ in range(n)]
        self.local: list[ca.SX] = []
        self.known: dict[Hashable, list[ca.SX | None]] = {}
        for k, part in enumerate(self.parts):
            for row in part.reads:
                self.readers[row].add(k)

    def solve(self) -> frozenset[int]:
        """Return the indices of the states that never move."""
        dirty = set(range(len(self.parts)))
        while dirty:
            dirty = {k for k in dirty if self.frozen[list(self.parts[k].ode_rows)].any()}
            touched = {row for k in dirty for row in self._evaluate(k)}
            released = [row for row in touched if self.frozen[row] and not self._is_zero(row)]
            self.frozen[released] = False
            dirty = {k for row in released for k in self.readers[row]}
        return frozenset(int(i) for i in np.flatnonzero(self.frozen))

    def _evaluate(self, k: int) -> tuple[int, ...]:
        """Store what part k adds to the rates with the frozen states at their start; its rows."""
        part = self.parts[k]
        reads = list(part.reads)
        still, values = self.frozen[reads], self.values[reads]
        formulas = tuple(
            self.start[i].element_hash()
            for i, v, f in zip(reads, values, still, strict=True)
            if f and np.isnan(v)
        )
        given = np.where(still, values, np.nan)
        key = (part.kernel.__hash__(), still.tobytes(), given.tobytes(), formulas, part.signature)
        if key not in self.known:
            self.known[key] = self._prove(part, still)
        for row, rate in zip(part.ode_rows, self.known[key], strict=True):
            self.rates[row][k] = rate
        return part.ode_rows

    def _prove(self, part: Part, still: np.ndarray) -> list[ca.SX | None]:
        """Return what a part adds to each row, over t, u, p; None if it depends on a moving state.

        Which states move, and their symbols, do not matter, so that parts alike share the result.
        """
        dae, count = self.dae, len(part.reads) + len(part.reads_z)
        while len(self.local) < count:
            self.local.append(ca.SX.sym(f"w{len(self.local)}"))
        local = self.local[:count]
        x = [
            self.start[row] if frozen else symbol
            for row, frozen, symbol in zip(part.reads, still, local, strict=False)
        ]
        z = local[len(part.reads) :]
        none = ca.SX(0, 1)
        rows, _ = part.kernel(dae.t, ca.vertcat(none, *x), ca.vertcat(none, *z), part.constants)
        moving = ca.vertcat(none, *local)
        open_rows = [i for i in range(rows.numel()) if not rows[i].is_constant()]
        # CasADi has already simplified products with the frozen zeros; what is left takes a proof.
        if open_rows and still.any():
            rows[open_rows] = fold(rows[open_rows], ca.vertcat(dae.t, moving, dae.u, dae.p))
        return [None if ca.depends_on(row, moving) else row for row in ca.vertsplit(rows)]

    def _is_zero(self, row: int) -> bool:
        """Whether the rates that all parts add to a row cancel, and no event changes it."""
        total = ca.SX(0)
        for k, rate in self.rates[row].items():
            if rate is None:
                return False
            # A jump by an event cannot be made up for by a rate, so that it must be zero by itself.
            if k >= len(self.dae.parts):
                if not rate.is_zero():
                    return False
                continue
            total = total + rate
        return bool(total.is_zero())


def _as_part(event: Transition) -> Part:
    """Return an event as a part whose rates are the changes that the event makes."""
    t, x, z, c = event.kernel.sx_in()
    change = event.kernel(t, x, z, c)[1]
    kernel = ca.Function("change", [t, x, z, c], [change, ca.SX(0, 1)])
    return Part(event.name, kernel, event.reads, event.reads_z, event.constants, event.rows)
