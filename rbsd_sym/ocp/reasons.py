"""Why there is no plan: which condition, where, by how much."""

from __future__ import annotations

import numpy as np

from .between import Miss, passed
from .chain import Chain
from .elastic import MISSED
from .mesh import same_input
from .reading import Plan, read

_MISSED = 1e-6  # of the size of a bound: less is the solver's tolerance


def misses(chain: Chain, x: np.ndarray) -> list[Miss]:
    """Conditions that variables do not meet, the worst first."""
    if not np.isfinite(x).all():
        return []
    bounds = chain.nlp.bounds
    g = np.array(chain.nlp.functions["nlp"](x, [])[1]).reshape(-1)
    s = read(chain, x).s
    found = []
    sides = ((x, bounds["lbx"], bounds["ubx"], 0), (g, bounds["lbg"], bounds["ubg"], 1))
    for values, low, high, kind in sides:
        gap = np.maximum(low - values, values - high)
        scale = 1 + np.abs(np.where(values < low, low, np.where(np.isfinite(high), high, 0.0)))
        for k in np.flatnonzero(gap / scale > _MISSED):
            bound = low[k] if values[k] < low[k] else high[k]
            found.append(_miss(chain, s, int(k), kind, float(values[k]), float(bound)))
    return sorted(found, key=lambda miss: -miss.relative)


def _miss(chain: Chain, s: np.ndarray, k: int, kind: int, value: float, bound: float) -> Miss:
    offsets = chain.nlp.offsets
    j = max(i for i, start in enumerate(offsets[:-1]) if start[kind] <= k)
    part = chain.nlp.segments[j]
    size = part.n_g if kind else part.n_w
    stage, row = divmod(k - offsets[j][kind], size)
    return _at(chain, s, j, stage, row, kind, value, bound)


def _at(
    chain: Chain, s: np.ndarray, j: int, stage: int, row: int, kind: int, value: float, bound: float
) -> Miss:
    """A miss of a variable (kind 0) or row (1) of a stage of segment j."""
    part = chain.nlp.segments[j]
    label = (part.rows if kind else part.variables)[row]
    share = part.when[kind][row]
    a, b = part.fractions[stage]
    t0, length = (float(v) for v in chain.frame.span(part.phase, s))
    where = {"interval": "path"}.get(chain.kinds[j], chain.kinds[j])
    phase = f"phase {part.phase}, " if chain.frame.n_phases > 1 else ""
    relative = abs(value - bound) / (1 + abs(bound))
    t = t0 + length * (a + share * (b - a))
    return Miss(f"{phase}{where} '{label.name}'", t, value, bound, label.unit, relative)


def elastic_report(chain: Chain, x: np.ndarray) -> list[str]:
    """What conditions are missed by, in an elastic chain that was solved; the worst of each."""
    found: dict[tuple[int, str], Miss] = {}
    s = read(chain, x).s
    for j, (part, (a, _)) in enumerate(zip(chain.nlp.segments, chain.nlp.offsets, strict=False)):
        first = next((k for k, v in enumerate(part.variables) if v.name == MISSED), part.n_w)
        gaps = x[a : a + part.n_w * part.count].reshape(part.count, part.n_w)[:, first:]
        half = gaps.shape[1] // 2
        kind = "path" if chain.kinds[j] == "interval" else chain.kinds[j]
        rows = [k for k, own in enumerate(part.kinds) if own == kind][:half]
        for stage in range(part.count):
            for k, row in enumerate(rows):
                up, down = gaps[stage, k], gaps[stage, half + k]
                sides = part.row_low[row - part.n_next], part.row_high[row - part.n_next]
                gap, bound = (up, sides[0]) if up > down else (down, sides[1])
                value = bound - gap if up > down else bound + gap
                miss = _at(chain, s, j, stage, row, 1, float(value), float(bound))
                known = found.get((part.phase, miss.what))
                if miss.relative > max(_MISSED, known.relative if known else 0.0):
                    found[part.phase, miss.what] = miss
    return [str(miss) for miss in sorted(found.values(), key=lambda miss: -miss.relative)]


def between_points(chain: Chain, x: np.ndarray, plan: Plan, degree: int) -> tuple[Miss, ...]:
    """Conditions along the path that a plan passes between the points at which they are kept.

    The worst place of each, the largest first; `relative` is to the room between the bounds, or to
    the bound.

    Arguments:
        x: the program's variables.
        degree: of the Inputs.
    """
    found = []
    for i, interval in enumerate(chain.intervals):
        limit = interval.limits
        if not limit.labels or not len(interval.checked):
            continue
        t, values = _limited(chain, x, plan, i, degree)
        gap = passed(limit, values)
        for k in np.flatnonzero(gap.max(axis=1) > _MISSED):
            j = int(np.argmax(gap[k]))
            value, label = float(values[k, j]), limit.labels[k]
            bound = float(limit.low[k] if value < limit.low[k] else limit.high[k])
            phase = f"phase {i}, " if chain.frame.n_phases > 1 else ""
            found.append(
                Miss(
                    f"{phase}path '{label.name}'",
                    float(t[j]),
                    value,
                    bound,
                    label.unit,
                    float(gap[k, j]),
                )
            )
    return tuple(sorted(found, key=lambda miss: -miss.relative))


def _limited(
    chain: Chain, x: np.ndarray, plan: Plan, i: int, degree: int
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) at which phase i is looked at, and what is limited there (rows, n)."""
    number, interval, leg = chain.segments("interval")[i], chain.intervals[i], plan.legs[i]
    part, first, n_v = chain.nlp.segments[number], chain.nlp.offsets[number][0], chain.frame.n_v
    columns = x[first : first + part.n_w * part.count].reshape(part.count, part.n_w).T
    states, unknowns = interval.check.map(part.count)(columns, part.constants)
    nodes = leg.nodes.reshape(part.count, degree + 1, n_v)
    weights = same_input(degree, interval.checked)
    inputs = np.einsum("tk,ckv->vct", weights, nodes)
    t = (leg.t[:-1, None] + np.diff(leg.t)[:, None] * interval.checked).reshape(-1)
    constants = np.repeat(plan.s[:, None], len(t), axis=1)
    given = (t[None, :], states, unknowns, inputs.reshape(n_v, len(t)), constants)
    return t, np.array(interval.limits.value.map(len(t))(*given))
