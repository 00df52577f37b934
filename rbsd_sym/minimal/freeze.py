"""Freeze: leave out the states that provably never move."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from ..dae import Dae, Expansion, Part
from ..zeros import fold


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
