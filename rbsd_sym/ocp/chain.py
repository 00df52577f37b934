"""The chain of blocks of a problem: nodes at the ends of phases, intervals between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from ..dae.members import Label
from .conditions import End, at_end, at_start, groups, opened, path_box
from .mesh import Interval
from .nlp import BlockFunctions, Nlp, Row, RowKind, Segment, Variable, Where
from .traced import TracedProblem


@dataclass(frozen=True, eq=False)
class Guess:
    """Start of a search.

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

    traced: TracedProblem
    intervals: tuple[Interval, ...]
    mesh: tuple[np.ndarray, ...]
    nlp: Nlp

    def segments(self, where: Where) -> dict[int, int]:
        """Return the number of the segment at that place, by phase."""
        return {part.phase: k for k, part in enumerate(self.nlp.segments) if part.where is where}


def chained(
    traced: TracedProblem,
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
    for i in range(traced.n_phases):
        begin = at_start(traced, i)
        # Conditions at a start that are bounds of states need no node of their own: they are bounds
        # of the first block's variables.
        if begin.rows:
            parts.append(_node(traced, i, begin, guess, Where.start))
        body = _body(traced, i, intervals[i], mesh[i], guess, None if begin.rows else begin.box)
        end = at_end(traced, i)
        node = _node(traced, i, opened(traced, i, end) if elastic else end, guess, Where.end)
        if elastic:
            body, node = _loosened(body, _state_box(traced, i, intervals[i])), _loosened(node)
        parts += [body, node]
    return Chain(traced, tuple(intervals), mesh, Nlp(tuple(parts)))


def _body(
    traced: TracedProblem,
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
    y = _handed_on(traced, i, guess, starts)
    low, high, values = [y[0]], [y[1]], [y[2]]
    variables = [Variable(label) for label in _y_labels(traced)]
    boxes = {group: path_box(traced, i, group) for group in "xzu"}
    for group, tau in interval.variables:
        at, box = starts + tau * lengths, boxes[group]
        low.append(np.repeat(box[0][:, None], len(at), axis=1))
        high.append(np.repeat(box[1][:, None], len(at), axis=1))
        values.append({"x": guess.x, "z": guess.z, "u": guess.v}[group](i, at))
        variables += [Variable(label, tau) for label in groups(traced)[group][0]]
    lower, upper = np.vstack(low), np.vstack(high)
    if begin is not None:
        lower[: traced.model.n_x, 0], upper[: traced.model.n_x, 0] = begin
        _fix_unused(traced, i, lower, upper)
    row_low, row_high, rows = _interval_rows(traced, i, interval)
    return Segment(
        Where.path,
        i,
        interval.functions,
        np.vstack([lengths, starts]),
        traced.n_y,
        traced.n_y,
        lower,
        upper,
        np.clip(np.vstack(values), lower, upper),
        row_low,
        row_high,
        tuple(variables),
        rows,
        np.vstack([starts, mesh[1:]]).T,
    )


def _y_labels(traced: TracedProblem) -> tuple[Label, ...]:
    constants = (c.label for c in traced.constants)
    return (*traced.model.x_labels, *constants, *traced.v_labels[: traced.n_m])


def _fix_unused(traced: TracedProblem, i: int, low: np.ndarray, high: np.ndarray) -> None:
    """Fix the Inputs that the very first block would be handed, since no block is before it."""
    if i == 0 and traced.n_m:
        rows = slice(traced.n_y - traced.n_m, traced.n_y)
        low[rows, 0] = high[rows, 0] = 0.0


def _handed_on(
    traced: TracedProblem, i: int, guess: Guess, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bounds and guess of y at fractions of a phase, (n_y, n) each."""
    n, box = len(at), path_box(traced, i, "x")
    free = np.full(traced.n_m, np.inf)
    low = np.concatenate([box[0], [c.low for c in traced.constants], -free])
    high = np.concatenate([box[1], [c.high for c in traced.constants], free])
    values = np.vstack(
        [guess.x(i, at), np.repeat(guess.s[:, None], n, axis=1), guess.v(i, at)[: traced.n_m]]
    )
    return np.repeat(low[:, None], n, axis=1), np.repeat(high[:, None], n, axis=1), values


def _interval_rows(
    traced: TracedProblem, i: int, interval: Interval
) -> tuple[np.ndarray, np.ndarray, tuple[Row, ...]]:
    """Bounds of the rows of an interval after what it hands on, and what all its rows are."""
    path, limits, dae = traced.terms[i].path.rows, interval.limits, traced.model.dae
    sides = {
        RowKind.rate: (dae.x_labels, np.zeros(traced.model.n_x), np.zeros(traced.model.n_x)),
        RowKind.balance: (dae.z_labels, np.zeros(traced.model.n_z), np.zeros(traced.model.n_z)),
        RowKind.path: (path.labels, path.low, path.high),
        RowKind.limit: (limits.labels, limits.low, limits.high),
    }
    low, high = [np.zeros(0)], [np.zeros(0)]
    rows = [Row(label, RowKind.motion, i) for label in _y_labels(traced)]
    for kind, tau in interval.rows:
        labels, lower, upper = sides[kind]
        low.append(lower)
        high.append(upper)
        rows += [Row(label, kind, i, tau) for label in labels]
    return np.concatenate(low), np.concatenate(high), tuple(rows)


def _node(traced: TracedProblem, i: int, end: End, guess: Guess, where: Where) -> Segment:
    """The node at an end of a phase: w = [y; z if needed]."""
    last = where is Where.end
    at = np.array([1.0 if last else 0.0])
    n_next = 0 if last and i == traced.n_phases - 1 else traced.n_y
    # A node has the algebraic unknowns as variables, and their equations as rows, only where a
    # condition, cost or jump depends on them.
    z_cost = last and traced.depends(traced.terms[i].end_cost, *_link(traced, i))[0]
    n_z = traced.model.n_z if end.needs_z or z_cost else 0
    low, high, values = _handed_on(traced, i, guess, at)
    low[: traced.model.n_x, 0], high[: traced.model.n_x, 0] = end.box
    if not last:
        _fix_unused(traced, i, low, high)
    unknowns, far = traced.model.dae.z_labels[:n_z], np.full((n_z, 1), np.inf)
    lower, upper = np.vstack([low, -far]), np.vstack([high, far])
    links = [Row(label, RowKind.link, i) for label in _y_labels(traced)]
    balance = np.zeros(n_z)
    return Segment(
        where,
        i,
        _node_functions(traced, i, end, n_z, last, n_next),
        np.zeros((0, 1)),
        traced.n_y,
        n_next,
        lower,
        upper,
        np.clip(np.vstack([values, guess.z(i, at)[:n_z]]), lower, upper),
        np.concatenate([balance, end.low]),
        np.concatenate([balance, end.high]),
        tuple(Variable(label) for label in (*_y_labels(traced), *unknowns)),
        (*links[:n_next], *(Row(label, RowKind.balance, i) for label in unknowns), *end.rows),
        np.array([[at[0], at[0]]]),
    )


def _link(traced: TracedProblem, i: int) -> list[ca.SX]:
    """States after the end of a phase by those before, if they jump."""
    link = traced.terms[i + 1].link if i + 1 < traced.n_phases else None
    return [] if link is None else [link]


def _node_functions(
    traced: TracedProblem, i: int, end: End, n_z: int, last: bool, n_next: int
) -> BlockFunctions:
    w, c = ca.SX.sym("w", traced.n_y + n_z), ca.SX.sym("c", 0)
    x, s, m = traced.split(w[: traced.n_y])
    z = w[traced.n_y :] if n_z else ca.SX.zeros(traced.model.n_z)
    v = m if traced.n_m else ca.SX.zeros(traced.n_v)
    t0, length = traced.span(i, s)
    t = t0 + length if last else t0
    rows, alg = end.value(t, x, z, v, s)
    cost, following = ca.SX(0), w[: traced.n_y]
    if last:
        # The states after a jump go to the first block of the next phase in place of those before.
        own = traced.over("own", traced.terms[i].end_cost, *_link(traced, i))
        cost, *link = own.call([ca.SX(a) for a in (t, x, z, v, s)])
        following = ca.vertcat(link[0], s, m) if link else following
    if not n_next:
        following = ca.SX(0, 1)
    both = ca.vertcat(alg if n_z else ca.SX(0, 1), rows)
    return BlockFunctions.derived("node", w, c, following, both, cost)


def _state_box(traced: TracedProblem, i: int, interval: Interval) -> np.ndarray:
    """Bounds (n_w, 2) along a phase of the states and unknowns among an interval's variables."""
    free = np.array([[-np.inf], [np.inf]])
    bounds = {group: path_box(traced, i, group) for group in "xz"}
    bounds["u"] = np.repeat(free, traced.n_v, axis=1)
    constants = np.repeat(free, traced.n_y - traced.model.n_x, axis=1)
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
    # The rows are those of before, evaluated by their Function: only the derivatives are made anew.
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
    """Return the variables that have bounds."""
    return np.flatnonzero(np.isfinite(box).any(axis=1))


def _as_rows(part: Segment, box: np.ndarray) -> Segment:
    """Return the segment with bounds of variables as rows, with the functions of before."""
    chosen = _bounded(box)
    low, high = part.low.copy(), part.high.copy()
    for j in chosen:
        # A block whose bounds differ from those along the path, as at a given start, keeps them.
        own = (low[j] == box[j, 0]) & (high[j] == box[j, 1])
        low[j, own], high[j, own] = -np.inf, np.inf
    moved = (part.variables[j] for j in chosen)
    return replace(
        part,
        low=low,
        high=high,
        row_low=np.append(part.row_low, box[chosen, 0]),
        row_high=np.append(part.row_high, box[chosen, 1]),
        rows=(*part.rows, *(Row(v.label, RowKind.path, part.phase, v.node) for v in moved)),
    )
