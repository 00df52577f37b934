"""Why there is no plan, or where it exceeds its limits: which condition, when, by how much."""

from __future__ import annotations

import numpy as np

from .chain import Chain
from .conditions import Limits
from .mesh import basis, control_nodes
from .nlp import Row, Variable, Where
from .plan import Miss, Plan, read

_MISSED = 1e-6  # of the size of a bound: less is the solver's tolerance


def misses(chain: Chain, x: np.ndarray) -> list[Miss]:
    """Return the conditions that variables (n,) do not meet, the worst first."""
    if not np.isfinite(x).all():
        return []
    bounds, nlp = chain.nlp.bounds, chain.nlp
    g = np.array(nlp.functions["nlp"](x, [])[1]).reshape(-1)
    s = read(chain, x).s
    found = []
    sides = ((x, bounds["lbx"], bounds["ubx"], 0), (g, bounds["lbg"], bounds["ubg"], 1))
    for values, low, high, side in sides:
        gap = np.maximum(low - values, values - high)
        scale = 1 + np.abs(np.where(values < low, low, np.where(np.isfinite(high), high, 0.0)))
        for k in np.flatnonzero(gap / scale > _MISSED):
            bound = low[k] if values[k] < low[k] else high[k]
            # From the number of a variable or row to its segment, its block and its place there.
            j = max(i for i, first in enumerate(nlp.offsets[:-1]) if first[side] <= k)
            part = nlp.segments[j]
            size = part.n_g if side else part.n_w
            block, row = divmod(int(k) - nlp.offsets[j][side], size)
            what = part.rows[row] if side else part.variables[row]
            found.append(_at(chain, s, j, block, what, float(values[k]), float(bound)))
    return sorted(found, key=lambda miss: -miss.relative)


def _at(
    chain: Chain,
    s: np.ndarray,
    j: int,
    block: int,
    what: Row | Variable,
    value: float,
    bound: float,
) -> Miss:
    """Make a miss of a variable or row of a block of segment j."""
    part = chain.nlp.segments[j]
    a, b = part.fractions[block]
    t0, length = (float(v) for v in chain.traced.span(part.phase, s))
    relative = abs(value - bound) / (1 + abs(bound))
    t = t0 + length * (a + what.node * (b - a))
    name = f"{_phase(chain, part.phase)}{part.where.value} '{what.name}'"
    return Miss(name, t, value, bound, what.label.unit, relative)


def _phase(chain: Chain, i: int) -> str:
    return f"phase {i}, " if chain.traced.n_phases > 1 else ""


def elastic_report(chain: Chain, x: np.ndarray) -> list[str]:
    """Say what conditions are missed by in an elastic chain that was solved; the worst of each."""
    found: dict[tuple[int, str], Miss] = {}
    s = read(chain, x).s
    for j, (part, columns) in enumerate(zip(chain.nlp.segments, chain.nlp.split(x), strict=True)):
        slacks = [(k, v.loosens) for k, v in enumerate(part.variables) if v.loosens is not None]
        half = len(slacks) // 2  # those upwards come first
        for block in range(part.count):
            for (k, row), (other, _) in zip(slacks[:half], slacks[half:], strict=True):
                up, down = columns[k, block], columns[other, block]
                low, high = part.row_low[row - part.n_next], part.row_high[row - part.n_next]
                # At the optimum one of them is zero: they are what the row lacks to its bound.
                bound, value = (low, low - up) if up > down else (high, high + down)
                miss = _at(chain, s, j, block, part.rows[row], float(value), float(bound))
                known = found.get((part.phase, miss.what))
                if miss.relative > max(_MISSED, known.relative if known else 0.0):
                    found[part.phase, miss.what] = miss
    return [str(miss) for miss in sorted(found.values(), key=lambda miss: -miss.relative)]


def between_points(chain: Chain, x: np.ndarray, plan: Plan, degree: int) -> tuple[Miss, ...]:
    """Return the conditions along the path that a plan exceeds between the points of its method.

    The worst place of each, the largest first.

    Arguments:
        x: the program's variables (n,).
        degree: of the Inputs.
    """
    found = []
    for i, interval in enumerate(chain.intervals):
        limit = interval.limits
        if not limit.labels or not len(interval.checked):
            continue
        t, values = _limited(chain, x, plan, i, degree)
        gap = _excess(limit, values)
        for k in np.flatnonzero(gap.max(axis=1) > _MISSED):
            j = int(np.argmax(gap[k]))
            value, label = float(values[k, j]), limit.labels[k]
            bound = float(limit.low[k] if value < limit.low[k] else limit.high[k])
            what = f"{_phase(chain, i)}{Where.path.value} '{label.name}'"
            found.append(Miss(what, float(t[j]), value, bound, label.unit, float(gap[k, j])))
    return tuple(sorted(found, key=lambda miss: -miss.relative))


def _excess(limit: Limits, values: np.ndarray) -> np.ndarray:
    """Excess of values (n, points), relative to the distance of the bounds, or to the only one."""
    low, high = limit.low[:, None], limit.high[:, None]
    gap = np.maximum(np.maximum(low - values, values - high), 0.0)
    both = np.isfinite(high - low) & (high > low)
    largest = np.maximum(
        np.abs(np.where(np.isfinite(low), low, 0.0)), np.abs(np.where(np.isfinite(high), high, 0.0))
    )
    scale = np.where(both, np.where(both, high, 1.0) - np.where(both, low, 0.0), largest)
    return gap / np.where(scale > 0, scale, 1.0)


def _limited(
    chain: Chain, x: np.ndarray, plan: Plan, i: int, degree: int
) -> tuple[np.ndarray, np.ndarray]:
    """Times (n,) at which phase i is checked, and what is limited there (rows, n)."""
    number, interval, phase = chain.segments(Where.path)[i], chain.intervals[i], plan.phases[i]
    part, n_v = chain.nlp.segments[number], chain.traced.n_v
    columns = chain.nlp.split(x)[number]
    states, unknowns = interval.check.map(part.count)(columns, part.constants)
    nodes = phase.nodes.reshape(part.count, degree + 1, n_v)
    weights = basis(control_nodes(degree), interval.checked)
    inputs = np.einsum("tk,ckv->vct", weights, nodes)
    t = (phase.t[:-1, None] + np.diff(phase.t)[:, None] * interval.checked).reshape(-1)
    constants = np.repeat(plan.s[:, None], len(t), axis=1)
    given = (t[None, :], states, unknowns, inputs.reshape(n_v, len(t)), constants)
    return t, np.array(interval.limits.value.map(len(t))(*given))
