"""The chain of blocks of a problem: nodes at the ends of phases, intervals between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ..dae.members import Label
from .conditions import End, at_end, at_start, groups, opened, path_box
from .mesh import Interval
from .nlp import BlockFunctions, Kind, Nlp, Row, Segment, Variable, Where
from .stage import Stage


@dataclass(frozen=True, eq=False)
class Guess:
    """Where a search starts.

    Fields:
        s: constants (n_s,).
        x, z, v: functions of (phase, fractions (n,) of it) that give states, algebraic unknowns,
            and the Inputs to be found there, a column each.
    """

    s: np.ndarray
    x: Callable[[int, np.ndarray], np.ndarray]
    z: Callable[[int, np.ndarray], np.ndarray]
    v: Callable[[int, np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Chain:
    """A transcribed problem.

    Fields:
        intervals, mesh: of each phase.
    """

    stage: Stage
    intervals: tuple[Interval, ...]
    mesh: tuple[np.ndarray, ...]
    nlp: Nlp

    def segments(self, where: Where) -> dict[int, int]:
        """Number of the segment there, by phase."""
        return {part.phase: k for k, part in enumerate(self.nlp.segments) if part.where is where}


def chained(
    stage: Stage,
    intervals: Sequence[Interval],
    mesh: tuple[np.ndarray, ...],
    guess: Guess,
    elastic: bool = False,
) -> Chain:
    """Put the blocks of all phases in a chain.

    Arguments:
        elastic: let conditions along the path and at the ends of phases be missed, and minimise
            what they are missed by.
    """
    parts: list[Segment] = []
    for i in range(stage.n_phases):
        begin = at_start(stage, i)
        if begin.rows:
            parts.append(_node(stage, i, begin, guess, Where.start))
        body = _body(stage, i, intervals[i], mesh[i], guess, None if begin.rows else begin.box)
        end = at_end(stage, i)
        node = _node(stage, i, opened(stage, i, end) if elastic else end, guess, Where.end)
        if elastic:
            body, node = _loosened(body, _state_box(stage, i, intervals[i])), _loosened(node)
        parts += [body, node]
    return Chain(stage, tuple(intervals), mesh, Nlp(tuple(parts)))


def _body(
    stage: Stage,
    i: int,
    interval: Interval,
    mesh: np.ndarray,
    guess: Guess,
    begin: np.ndarray | None,
) -> Segment:
    """The intervals of a phase.

    Arguments:
        begin: bounds of the states at its start, unless a node before it has them.
    """
    starts, lengths = mesh[:-1], np.diff(mesh)
    y = _handed_on(stage, i, guess, starts)
    low, high, values = [y[0]], [y[1]], [y[2]]
    variables = [Variable(label) for label in _y_labels(stage)]
    boxes = {group: path_box(stage, i, group) for group in "xzu"}
    for group, tau in interval.variables:
        at, box = starts + tau * lengths, boxes[group]
        low.append(np.repeat(box[0][:, None], len(at), axis=1))
        high.append(np.repeat(box[1][:, None], len(at), axis=1))
        values.append({"x": guess.x, "z": guess.z, "u": guess.v}[group](i, at))
        variables += [Variable(label, tau) for label in groups(stage)[group][0]]
    lower, upper = np.vstack(low), np.vstack(high)
    if begin is not None:
        lower[: stage.model.n_x, 0], upper[: stage.model.n_x, 0] = begin
        _fix_unused(stage, i, lower, upper)
    row_low, row_high, rows = _interval_rows(stage, i, interval)
    return Segment(
        Where.path,
        i,
        interval.functions,
        np.vstack([lengths, starts]),
        stage.n_y,
        stage.n_y,
        lower,
        upper,
        np.clip(np.vstack(values), lower, upper),
        row_low,
        row_high,
        tuple(variables),
        rows,
        np.vstack([starts, mesh[1:]]).T,
    )


def _y_labels(stage: Stage) -> tuple[Label, ...]:
    constants = (c.label for c in stage.constants)
    return (*stage.model.x_labels, *constants, *stage.v_labels[: stage.n_m])


def _fix_unused(stage: Stage, i: int, low: np.ndarray, high: np.ndarray) -> None:
    """Fix the Inputs that the very first block would be handed, since no block is before it."""
    if i == 0 and stage.n_m:
        rows = slice(stage.n_y - stage.n_m, stage.n_y)
        low[rows, 0] = high[rows, 0] = 0.0


def _handed_on(
    stage: Stage, i: int, guess: Guess, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bounds and guess of y at fractions of a phase, (n_y, n) each."""
    n, box = len(at), path_box(stage, i, "x")
    free = np.full(stage.n_m, np.inf)
    low = np.concatenate([box[0], [c.low for c in stage.constants], -free])
    high = np.concatenate([box[1], [c.high for c in stage.constants], free])
    values = np.vstack(
        [guess.x(i, at), np.repeat(guess.s[:, None], n, axis=1), guess.v(i, at)[: stage.n_m]]
    )
    return np.repeat(low[:, None], n, axis=1), np.repeat(high[:, None], n, axis=1), values


def _interval_rows(
    stage: Stage, i: int, interval: Interval
) -> tuple[np.ndarray, np.ndarray, tuple[Row, ...]]:
    """Bounds of the rows of an interval after what it hands on, and what all its rows are."""
    path, limits, dae = stage.terms[i].path.rows, interval.limits, stage.model.dae
    sides = {
        Kind.rate: (dae.x_labels, np.zeros(stage.model.n_x), np.zeros(stage.model.n_x)),
        Kind.balance: (dae.z_labels, np.zeros(stage.model.n_z), np.zeros(stage.model.n_z)),
        Kind.path: (path.labels, path.low, path.high),
        Kind.limit: (limits.labels, limits.low, limits.high),
    }
    low, high = [np.zeros(0)], [np.zeros(0)]
    rows = [Row(label, Kind.motion, i) for label in _y_labels(stage)]
    for kind, tau in interval.rows:
        labels, lower, upper = sides[kind]
        low.append(lower)
        high.append(upper)
        rows += [Row(label, kind, i, tau) for label in labels]
    return np.concatenate(low), np.concatenate(high), tuple(rows)


def _node(stage: Stage, i: int, end: End, guess: Guess, where: Where) -> Segment:
    """The node at an end of a phase: w = [y; z if needed]."""
    last = where is Where.end
    at = np.array([1.0 if last else 0.0])
    n_next = 0 if last and i == stage.n_phases - 1 else stage.n_y
    z_cost = last and stage.depends(stage.terms[i].end_cost, *_link(stage, i))[0]
    n_z = stage.model.n_z if end.needs_z or z_cost else 0
    low, high, values = _handed_on(stage, i, guess, at)
    low[: stage.model.n_x, 0], high[: stage.model.n_x, 0] = end.box
    if not last:
        _fix_unused(stage, i, low, high)
    unknowns, far = stage.model.dae.z_labels[:n_z], np.full((n_z, 1), np.inf)
    lower, upper = np.vstack([low, -far]), np.vstack([high, far])
    links = [Row(label, Kind.link, i) for label in _y_labels(stage)]
    balance = np.zeros(n_z)
    return Segment(
        where,
        i,
        _node_functions(stage, i, end, n_z, last, n_next),
        np.zeros((0, 1)),
        stage.n_y,
        n_next,
        lower,
        upper,
        np.clip(np.vstack([values, guess.z(i, at)[:n_z]]), lower, upper),
        np.concatenate([balance, end.low]),
        np.concatenate([balance, end.high]),
        tuple(Variable(label) for label in (*_y_labels(stage), *unknowns)),
        (*links[:n_next], *(Row(label, Kind.balance, i) for label in unknowns), *end.rows),
        np.array([[at[0], at[0]]]),
    )


def _link(stage: Stage, i: int) -> list[ca.SX]:
    """States after the end of a phase by those before, if they jump."""
    link = stage.terms[i + 1].link if i + 1 < stage.n_phases else None
    return [] if link is None else [link]


def _node_functions(
    stage: Stage, i: int, end: End, n_z: int, last: bool, n_next: int
) -> BlockFunctions:
    w, c = ca.SX.sym("w", stage.n_y + n_z), ca.SX.sym("c", 0)
    x, s, m = stage.split(w[: stage.n_y])
    z = w[stage.n_y :] if n_z else ca.SX.zeros(stage.model.n_z)
    v = m if stage.n_m else ca.SX.zeros(stage.n_v)
    t0, length = stage.span(i, s)
    t = t0 + length if last else t0
    rows, alg = end.value(t, x, z, v, s)
    cost, following = ca.SX(0), w[: stage.n_y]
    if last:
        own = stage.over("own", stage.terms[i].end_cost, *_link(stage, i))
        cost, *link = own.call([ca.SX(a) for a in (t, x, z, v, s)])
        following = ca.vertcat(link[0], s, m) if link else following
    if not n_next:
        following = ca.SX(0, 1)
    both = ca.vertcat(alg if n_z else ca.SX(0, 1), rows)
    return BlockFunctions.derived("node", w, c, following, both, cost)


def _state_box(stage: Stage, i: int, interval: Interval) -> np.ndarray:
    """Bounds (n_w, 2) along a phase of the states and unknowns among an interval's variables."""
    free = np.array([[-np.inf], [np.inf]])
    bounds = {group: path_box(stage, i, group) for group in "xz"}
    bounds["u"] = np.repeat(free, stage.n_v, axis=1)
    constants = np.repeat(free, stage.n_y - stage.model.n_x, axis=1)
    blocks = [bounds[group] for group, _ in interval.variables]
    return np.hstack([bounds["x"], constants, *blocks]).T


def _loosened(part: Segment, box: np.ndarray | None = None) -> Segment:
    """Return the segment with two slacks for each condition; what they add up to is the cost.

    A condition low <= r <= high becomes low <= r + up - down <= high with slacks up, down >= 0,
    which are as small as they can be. They count relative to 1 + |bound|.

    Arguments:
        box: bounds (n_w, 2) of variables that become conditions, infinite for the others; where a
            block has bounds of its own, as at a start that is given, they stay.
    """
    whole = part if box is None else _as_rows(part, box)
    chosen = [k for k, row in enumerate(whole.rows) if not row.kind.is_equation]
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
    slacks = [Variable(Label("", "slack"), loosens=k) for k in (*chosen, *chosen)]
    return replace(
        whole,
        functions=BlockFunctions.derived("elastic", w, c, following, rows, cost),
        low=np.vstack([whole.low, none]),
        high=np.vstack([whole.high, none + np.inf]),
        guess=np.vstack([part.guess, none]),
        variables=(*part.variables, *slacks),
    )


def _bounded(box: np.ndarray) -> np.ndarray:
    """Variables that have bounds."""
    return np.flatnonzero(np.isfinite(box).any(axis=1))


def _as_rows(part: Segment, box: np.ndarray) -> Segment:
    """Return the segment with bounds of variables as rows, with the functions of before."""
    chosen = _bounded(box)
    low, high = part.low.copy(), part.high.copy()
    for j in chosen:
        own = (low[j] == box[j, 0]) & (high[j] == box[j, 1])
        low[j, own], high[j, own] = -np.inf, np.inf
    moved = (part.variables[j] for j in chosen)
    return replace(
        part,
        low=low,
        high=high,
        row_low=np.append(part.row_low, box[chosen, 0]),
        row_high=np.append(part.row_high, box[chosen, 1]),
        rows=(*part.rows, *(Row(v.label, Kind.path, part.phase, v.node) for v in moved)),
    )
