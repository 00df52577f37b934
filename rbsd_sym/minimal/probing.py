"""Probing: which states seem never to move, by random values in place of proofs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..dae.dae import Dae
from ..model.kernels import Group, groups

_PROBES = 4
_ROUNDING = 1e-11  # of a rate, relative to its size where everything moves


def at_rest(dae: Dae) -> np.ndarray:
    """Whether each state stays at its start, as far as random values tell (n,).

    The greatest fixed point of `freeze`, decided by numbers. A state that is not in it does move; a
    proof can only be found for one that is. Data states count as moving.
    """
    n = dae.x.numel()
    if n == 0:
        return np.zeros(0, bool)
    probe = _Probe(dae)
    probe.set(np.arange(n), probe.moved)
    allowed = _ROUNDING * (1 + probe.sizes()[:n])
    probe.set(np.arange(n), probe.start)
    still = np.ones(n, bool)
    still[list(dae.data)] = False
    probe.set(np.array(dae.data, int), probe.moved)
    while (released := np.flatnonzero(still & (probe.sizes()[:n] > allowed))).size:
        still[released] = False
        probe.set(released, probe.moved)
    return still


@dataclass(eq=False)
class _Values:
    """The results (r, N, probes) of one group."""

    group: Group
    values: np.ndarray


class _Probe:
    """Rates at random values; a change is worked out for those that read it only."""

    def __init__(self, dae: Dae) -> None:
        rng = np.random.default_rng(0)
        n = dae.x.numel()
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
        """Give states their value among `values` (n, probes)."""
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
        """Largest rate of each row over the probes."""
        return np.abs(self.totals).max(axis=1)

    def _evaluate(self, group: Group, which: np.ndarray) -> np.ndarray:
        count = which.size
        w = self.w[group.reads[:, which]].reshape(-1, count * _PROBES)
        c = np.repeat(group.constants[:, which], _PROBES, axis=1)
        t = np.tile(self.t, count)[None, :]
        return np.array(group.kernel(t, w, c)).reshape(-1, count, _PROBES)
