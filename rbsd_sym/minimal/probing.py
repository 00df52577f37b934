"""Probing: which states do not move at random values of the others.

It decides nothing by itself: `freeze` tries to prove what probing finds, and a model notes states
that probing finds at rest but that could not be proven to be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..dae.dae import Dae
from ..model.kernels import Group, groups

_PROBES = 4  # random values of each state
_ROUNDING = 1e-11  # of a rate, relative to its size where everything moves


def at_rest(dae: Dae) -> np.ndarray:
    """Return for each state whether it stays at its start at random values of the others (n,).

    This is the fixed point of `freeze` with numbers instead of proofs: a state outside of it does
    move. Data states count as moving.
    """
    n = dae.x.numel()
    if n == 0:
        return np.zeros(0, bool)
    rates = _RandomRates(dae)
    rates.set(np.arange(n), rates.moved)
    allowed = _ROUNDING * (1 + rates.sizes()[:n])
    rates.set(np.arange(n), rates.start)
    still = np.ones(n, bool)
    still[list(dae.data)] = False
    rates.set(np.array(dae.data, int), rates.moved)
    while (released := np.flatnonzero(still & (rates.sizes()[:n] > allowed))).size:
        still[released] = False
        rates.set(released, rates.moved)
    return still


@dataclass(eq=False)
class _Values:
    """What one group adds to its rows (r, N, probes)."""

    group: Group
    values: np.ndarray


class _RandomRates:
    """Rates at random values; when states change, only the groups that read them are evaluated."""

    def __init__(self, dae: Dae) -> None:
        rng = np.random.default_rng(0)
        n = dae.x.numel()
        # Parameters vary around their defaults and keep their signs, as masses must.
        p = np.array([label.start for label in dae.p_labels])
        p = np.where(p == 0, 0.1, p)[:, None] * np.exp(0.3 * rng.standard_normal((p.size, _PROBES)))
        self.start = np.column_stack([dae.start_values(p[:, k])[0] for k in range(_PROBES)])
        self.moved = self.start + 0.3 * rng.standard_normal((n, _PROBES))
        others = rng.standard_normal((dae.z.numel() + dae.u.numel(), _PROBES))
        self.t = rng.uniform(0, 1, _PROBES)
        self.w = np.vstack([self.start, others, p])
        self.totals = np.zeros((n + dae.z.numel(), _PROBES))
        self.known = [_Values(g, np.zeros((*g.writes.shape, _PROBES))) for g in groups(dae)]

    def set(self, rows: np.ndarray, values: np.ndarray) -> None:
        """Set the states `rows` to theirs of `values` (n, probes), and update the rates."""
        self.w[rows] = values[rows]
        changed = np.zeros(len(self.w), bool)
        changed[rows] = True
        for known in self.known:
            group = known.group
            if len(rows) == len(values) > 0:
                dirty = np.arange(group.writes.shape[1])
            else:
                dirty = np.flatnonzero(changed[group.reads].any(axis=0))
            if dirty.size:
                fresh = self._evaluate(group, dirty)
                # A rate that is not finite, such as v / v at rest, is for the proof to judge.
                with np.errstate(invalid="ignore"):
                    change = fresh - known.values[:, dirty]
                    np.add.at(self.totals, group.writes[:, dirty], change)
                known.values[:, dirty] = fresh

    def sizes(self) -> np.ndarray:
        """Return the largest absolute rate of each row over the probes."""
        return np.abs(self.totals).max(axis=1)

    def _evaluate(self, group: Group, which: np.ndarray) -> np.ndarray:
        count = which.size
        w = self.w[group.reads[:, which]].reshape(-1, count * _PROBES)
        c = np.repeat(group.constants[:, which], _PROBES, axis=1)
        t = np.tile(self.t, count)[None, :]
        return np.array(group.kernel(t, w, c)).reshape(-1, count, _PROBES)
