"""A finer mesh where a simulation contradicts the plan, and where bounded Inputs jump."""

from __future__ import annotations

import math

import numpy as np

from .chain import Chain
from .conditions import path_box
from .mesh import Refinement
from .plan import Plan, pieces

_MOST_PIECES = 4  # of an interval in one round
_JUMP = 0.1  # of an Input's range: less is not a switch
_BETWEEN = 1e-3  # of the range from a bound: beyond it the Input is between its bounds
_NARROW = 0.2  # of an interval: what is left around a switch inside it


def refined(
    chain: Chain, plan: Plan, errors: np.ndarray, wanted: Refinement
) -> tuple[np.ndarray, ...] | None:
    """Return the next mesh, None if this one is good.

    Arguments:
        errors: of each interval of all phases, relative (n,).
    """
    found, place, changed = [], 0, False
    for i, mesh in enumerate(chain.mesh):
        n = len(mesh) - 1
        own = errors[place : place + n]
        cuts: list[np.ndarray] = []
        around = _around_switches(plan, place, i, mesh, wanted.tolerance)
        for k in range(n):
            inside = around.get(k)
            if inside is None:
                inside = np.linspace(0, 1, _pieces(own[k], wanted) + 1)[1:-1]
            changed |= len(inside) > 0
            cuts.append(mesh[k] + (mesh[k + 1] - mesh[k]) * np.concatenate([[0.0], inside]))
        found.append(np.append(np.concatenate(cuts), 1.0))
        place += n
    return tuple(found) if changed else None


def _pieces(error: float, wanted: Refinement) -> int:
    """Number of parts that an interval is divided into, so that each is as good as wanted."""
    if not error > wanted.tolerance:
        return 1
    # The error of an interval falls with its length to the power of the order.
    need = (error / wanted.tolerance) ** (1 / wanted.order)
    return int(np.clip(math.ceil(need), 2, _MOST_PIECES))


def _around_switches(
    plan: Plan, place: int, i: int, mesh: np.ndarray, tolerance: float
) -> dict[int, np.ndarray]:
    """Places at which to divide the intervals where a bounded Input jumps, as fractions of them."""
    found, widths = dict[int, set[float]](), np.diff(mesh)
    for piece, (low, high) in zip(
        pieces(plan).values(), path_box(plan.traced, i, "u").T, strict=True
    ):
        if not np.isfinite(high - low) or high <= low:
            continue
        n = len(widths)
        mean = np.array([piece.at(place + j, np.linspace(0, 1, 5)).mean() for j in range(n)])
        for j, tau in _switches((mean - low) / (high - low)):
            # A jump misplaced by h costs in proportion to h squared, since an Input constant on an
            # interval can have the right mean there.
            if widths[j] ** 2 > tolerance:
                found.setdefault(j, set()).update(tau)
    return {j: _apart(taus) for j, taus in found.items()}


def _switches(level: np.ndarray) -> list[tuple[int, tuple[float, ...]]]:
    """Intervals to divide, and where: on both sides of an estimated switch.

    Arguments:
        level: means of an Input on the intervals, 0 at its lower bound, 1 at its upper (n,).
    """
    found: list[tuple[int, tuple[float, ...]]] = []
    n = len(level)
    for j in range(n):
        before, after = level[max(j - 1, 0)], level[min(j + 1, n - 1)]
        between = _BETWEEN < level[j] < 1 - _BETWEEN
        step = abs(after - before) > _JUMP and min(before, after) < level[j] < max(before, after)
        if between and step:
            # An interval with a jump inside has a mean between the values before and after, which
            # says where it is.
            tau = float(np.clip((level[j] - after) / (before - after), 0.0, 1.0))
            cuts = (tau - _NARROW / 2, tau + _NARROW / 2)
            found.append((j, tuple(v for v in cuts if 0.02 < v < 0.98)))
        elif j + 1 < n and abs(after - level[j]) > 1 - 2 * _JUMP:  # between two intervals
            found.append((j, (1 - _NARROW / 2,)))
            found.append((j + 1, (_NARROW / 2,)))
    return found


def _apart(taus: set[float]) -> np.ndarray:
    """Return them in order, without those that almost coincide."""
    kept: list[float] = []
    for tau in sorted(taus):
        if not kept or tau - kept[-1] > 0.02:
            kept.append(tau)
    return np.array(kept)
