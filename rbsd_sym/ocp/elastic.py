"""Conditions that may be missed: what a problem without a plan is told by."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from ..parts import Label
from .nlp import Segment, StageFunctions

MISSED = "missed by"


def loosened(part: Segment, kind: str) -> Segment:
    """The segment with two slacks for each row of a kind; what they add up to is the cost.

    Slacks count relative to 1 + |bound|.
    """
    chosen = [k for k, own in enumerate(part.kinds) if own == kind]
    n, count = len(chosen), part.count
    w, c = ca.MX.sym("w", part.n_w + 2 * n), ca.MX.sym("c", part.constants.shape[0])
    both, _ = part.functions.value(w[: part.n_w], c)
    up, down = w[part.n_w : part.n_w + n], w[part.n_w + n :]
    spread = ca.DM(part.n_g, n)
    for j, k in enumerate(chosen):
        spread[k, j] = 1.0
    both = both + spread @ (up - down)
    places = [k - part.n_next for k in chosen]
    bounds = np.where(np.isfinite(part.row_low), part.row_low, part.row_high)[places]
    weights = 1 / (1 + np.abs(np.where(np.isfinite(bounds), bounds, 0.0)))
    cost = ca.dot(ca.DM(weights), up + down) if n else ca.MX(0)
    none = np.zeros((2 * n, count))
    following = both[: part.n_next] if part.n_next else ca.MX(0, 1)
    rows = both[part.n_next :] if part.n_g > part.n_next else ca.MX(0, 1)
    return replace(
        part,
        functions=StageFunctions.derived("elastic", w, c, following, rows, cost),
        low=np.vstack([part.low, none]),
        high=np.vstack([part.high, none + np.inf]),
        guess=np.vstack([part.guess, none]),
        variables=(*part.variables, *(Label(MISSED, "") for _ in range(2 * n))),
        when=(np.append(part.when[0], np.zeros(2 * n)), part.when[1]),
    )
