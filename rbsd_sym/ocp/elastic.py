"""Conditions that may be missed: what a problem without a plan is told by."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from ..dae.members import Label
from .nlp import Segment, StageFunctions

MISSED = "missed by"


def loosened(part: Segment, kind: str, box: np.ndarray | None = None) -> Segment:
    """The segment with two slacks for each row of a kind; what they add up to is the cost.

    Slacks count relative to 1 + |bound|.

    Arguments:
        box: bounds (n_w, 2) of variables that become rows of this kind, infinite for the others;
            where a stage has bounds of its own, as at a start that is given, they stay.
    """
    whole = part if box is None else _as_rows(part, kind, box)
    chosen = [k for k, own in enumerate(whole.kinds) if own == kind]
    n, count = len(chosen), part.count
    w, c = ca.MX.sym("w", part.n_w + 2 * n), ca.MX.sym("c", part.constants.shape[0])
    both, _ = part.functions.value(w[: part.n_w], c)
    moved = [] if box is None else [w[int(j)] for j in _bounded(box)]
    both = ca.vertcat(both, *moved)
    up, down = w[part.n_w : part.n_w + n], w[part.n_w + n :]
    spread = ca.DM(whole.n_g, n)
    for j, k in enumerate(chosen):
        spread[k, j] = 1.0
    both = both + spread @ (up - down)
    places = [k - part.n_next for k in chosen]
    bounds = np.where(np.isfinite(whole.row_low), whole.row_low, whole.row_high)[places]
    weights = 1 / (1 + np.abs(np.where(np.isfinite(bounds), bounds, 0.0)))
    cost = ca.dot(ca.DM(weights), up + down) if n else ca.MX(0)
    none = np.zeros((2 * n, count))
    following = both[: part.n_next] if part.n_next else ca.MX(0, 1)
    rows = both[part.n_next :] if whole.n_g > part.n_next else ca.MX(0, 1)
    return replace(
        whole,
        functions=StageFunctions.derived("elastic", w, c, following, rows, cost),
        low=np.vstack([whole.low, none]),
        high=np.vstack([whole.high, none + np.inf]),
        guess=np.vstack([part.guess, none]),
        variables=(*part.variables, *(Label("", MISSED, "", "") for _ in range(2 * n))),
        when=(np.append(part.when[0], np.zeros(2 * n)), whole.when[1]),
    )


def _bounded(box: np.ndarray) -> np.ndarray:
    """Variables that have bounds."""
    return np.flatnonzero(np.isfinite(box).any(axis=1))


def _as_rows(part: Segment, kind: str, box: np.ndarray) -> Segment:
    """The segment with bounds of variables as rows; its functions are still those of before."""
    chosen = _bounded(box)
    low, high = part.low.copy(), part.high.copy()
    for j in chosen:
        own = (low[j] == box[j, 0]) & (high[j] == box[j, 1])
        low[j, own], high[j, own] = -np.inf, np.inf
    return replace(
        part,
        low=low,
        high=high,
        row_low=np.append(part.row_low, box[chosen, 0]),
        row_high=np.append(part.row_high, box[chosen, 1]),
        rows=(*part.rows, *(part.variables[j] for j in chosen)),
        when=(part.when[0], np.append(part.when[1], part.when[0][chosen])),
        kinds=(*part.kinds, *(kind for _ in chosen)),
    )
