"""Suspects: states that random probing sees at rest, proven or not."""

from __future__ import annotations

import numpy as np

from ..dae import Dae

_PROBES = 6
_ROUNDING = 1e-11  # of a rate, relative to its size where everything moves


def suspects(full: Dae) -> tuple[int, ...]:
    """Rows of the states that seem never to move.

    The greatest fixed point of `freeze`, with random values in place of proofs.
    """
    n = full.x.numel()
    if n == 0:
        return ()
    rng = np.random.default_rng(0)
    rates = full.rates_function()
    p = np.array([label.start for label in full.p_labels])
    p = np.where(p == 0, 0.1, p)[:, None] * np.exp(0.3 * rng.standard_normal((p.size, _PROBES)))
    u = rng.standard_normal((full.u.numel(), _PROBES))
    z = rng.standard_normal((full.z.numel(), _PROBES))
    t = rng.uniform(0, 1, (1, _PROBES))
    start = np.column_stack([full.start_values(p[:, k])[0] for k in range(_PROBES)])
    moved = start + 0.3 * rng.standard_normal((n, _PROBES))

    def sizes(still: np.ndarray) -> np.ndarray:
        x = np.where(still[:, None], start, moved)
        return np.abs(np.array(rates(t, x, z, u, p))).max(axis=1)

    allowed = _ROUNDING * (1 + sizes(np.zeros(n, bool)))
    still = np.ones(n, bool)
    while (released := still & (sizes(still) > allowed)).any():
        still &= ~released
    return tuple(int(i) for i in np.flatnonzero(still))
