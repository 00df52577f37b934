"""The chain of stages of a problem: nodes at the ends of phases, intervals between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from ..dae.members import Label
from .between import groups, path_box
from .elastic import loosened
from .ends import End, at_end, at_start, opened
from .interval import Interval
from .nlp import Nlp, Segment, StageFunctions
from .stage import Frame


class Start(Protocol):
    """Where a search starts: values at fractions (n,) of a phase, (n_.., n)."""

    @property
    def s(self) -> np.ndarray:
        """Constants."""
        ...

    def x(self, phase: int, at: np.ndarray) -> np.ndarray:
        """States."""
        ...

    def z(self, phase: int, at: np.ndarray) -> np.ndarray:
        """Algebraic unknowns."""
        ...

    def v(self, phase: int, at: np.ndarray) -> np.ndarray:
        """Inputs that are to be found."""
        ...


@dataclass(frozen=True, eq=False)
class Chain:
    """A transcribed problem.

    Fields:
        intervals, mesh: of each phase.
        kinds: of each segment of the program, whether it is a "start", "interval" or "end".
    """

    frame: Frame
    intervals: tuple[Interval, ...]
    mesh: tuple[np.ndarray, ...]
    nlp: Nlp
    kinds: tuple[str, ...]

    def segments(self, kind: str) -> dict[int, int]:
        """Number of the segment of a kind, by phase."""
        parts = zip(self.kinds, self.nlp.segments, strict=True)
        return {part.phase: k for k, (own, part) in enumerate(parts) if own == kind}


def chained(
    frame: Frame,
    intervals: Sequence[Interval],
    mesh: tuple[np.ndarray, ...],
    guess: Start,
    elastic: bool = False,
) -> Chain:
    """The stages of all phases.

    Arguments:
        elastic: conditions along the path and at the ends of phases may be missed, and what they
            are missed by is the cost.
    """
    parts: list[tuple[str, Segment]] = []
    for i in range(frame.n_phases):
        begin = at_start(frame, i)
        if begin.labels:
            parts.append(("start", _node(frame, i, begin, guess, first=i == 0, last=False)))
        body = _body(frame, i, intervals[i], mesh[i], guess, None if begin.labels else begin.box)
        end = at_end(frame, i)
        node = _node(frame, i, opened(frame, end) if elastic else end, guess, False, True)
        if elastic:
            box = _state_box(frame, i, intervals[i])
            body, node = loosened(body, "path", box), loosened(node, "end")
        parts += [("interval", body), ("end", node)]
    nlp = Nlp(tuple(part for _, part in parts))
    return Chain(frame, tuple(intervals), mesh, nlp, tuple(kind for kind, _ in parts))


def _body(
    frame: Frame,
    i: int,
    interval: Interval,
    mesh: np.ndarray,
    guess: Start,
    begin: np.ndarray | None,
) -> Segment:
    """The intervals of a phase; `begin` are bounds of the states at the first, if it is theirs."""
    starts, lengths = mesh[:-1], np.diff(mesh)
    names_of = groups(frame)
    y = _handed_on(frame, i, guess, starts)
    low, high, values, names, when = [y[0]], [y[1]], [y[2]], list(_y_labels(frame)), []
    when += [0.0] * frame.n_y
    limits = {kind: path_box(frame, i, kind) for kind in "xzu"}
    for kind, tau in interval.variables:
        at = starts + tau * lengths
        found = {"x": guess.x, "z": guess.z, "u": guess.v}[kind](i, at)
        box = limits[kind]
        low.append(np.repeat(box[0][:, None], len(at), axis=1))
        high.append(np.repeat(box[1][:, None], len(at), axis=1))
        values.append(found)
        names += names_of[kind]
        when += [tau] * len(names_of[kind])
    lower, upper = np.vstack(low), np.vstack(high)
    if begin is not None:
        lower[: frame.model.n_x, 0], upper[: frame.model.n_x, 0] = begin
        _fix_unused(frame, i, lower, upper)
    row_low, row_high, rows, row_when, kinds = _interval_rows(frame, i, interval)
    return Segment(
        interval.functions,
        np.vstack([lengths, starts]),
        frame.n_y,
        frame.n_y,
        lower,
        upper,
        np.clip(np.vstack(values), lower, upper),
        row_low,
        row_high,
        tuple(names),
        rows,
        (np.array(when), row_when),
        i,
        np.vstack([starts, mesh[1:]]).T,
        kinds,
    )


def _state_box(frame: Frame, i: int, interval: Interval) -> np.ndarray:
    """Bounds (n_w, 2) along a phase of the states and unknowns among an interval's variables."""
    free = np.array([[-np.inf], [np.inf]])
    bounds = {kind: path_box(frame, i, kind) for kind in "xz"}
    bounds["u"] = np.repeat(free, frame.n_v, axis=1)
    constants = np.repeat(free, frame.n_y - frame.model.n_x, axis=1)
    blocks = [bounds[kind] for kind, _ in interval.variables]
    return np.hstack([bounds["x"], constants, *blocks]).T


def _y_labels(frame: Frame) -> tuple[Label, ...]:
    return (*frame.model.x_labels, *frame.s_labels, *groups(frame)["u"][: frame.n_m])


def _fix_unused(frame: Frame, i: int, low: np.ndarray, high: np.ndarray) -> None:
    """Nothing comes before the first stage, whose Inputs could be handed on."""
    if i == 0 and frame.n_m:
        rows = slice(frame.n_y - frame.n_m, frame.n_y)
        low[rows, 0] = high[rows, 0] = 0.0


def _handed_on(
    frame: Frame, i: int, guess: Start, at: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bounds and guess of y at fractions of a phase."""
    n = len(at)
    box = path_box(frame, i, "x")
    free = np.full(frame.n_m, np.inf)
    low = np.concatenate([box[0], frame.s_low, -free])
    high = np.concatenate([box[1], frame.s_high, free])
    values = np.vstack(
        [guess.x(i, at), np.repeat(guess.s[:, None], n, axis=1), guess.v(i, at)[: frame.n_m]]
    )
    return np.repeat(low[:, None], n, axis=1), np.repeat(high[:, None], n, axis=1), values


def _interval_rows(
    frame: Frame, i: int, interval: Interval
) -> tuple[np.ndarray, np.ndarray, tuple[Label, ...], np.ndarray, tuple[str, ...]]:
    """Bounds, labels, places and kinds of the rows of an interval, after what it hands on."""
    path, between, own = frame.terms[i].path.rows, interval.limits, groups(frame)
    blocks: dict[str, tuple[Sequence[Label], tuple[np.ndarray, np.ndarray] | None]] = {
        "rate": ([Label("", f"rate of {v.name}", "", v.unit) for v in own["x"]], None),
        "alg": ([Label("", f"balance of {v.name}", "", v.unit) for v in own["z"]], None),
        "path": (path.labels, (path.low, path.high)),
        "between": (between.labels, (between.low, between.high)),
    }
    labels: list[Label] = []
    low, high, when = [np.zeros(0)], [np.zeros(0)], [0.0] * frame.n_y
    kinds = ["motion"] * frame.n_y
    for kind, tau in interval.rows:
        rows, sides = blocks[kind]
        low.append(sides[0] if sides else np.zeros(len(rows)))
        high.append(sides[1] if sides else np.zeros(len(rows)))
        labels += rows
        when += [tau] * len(rows)
        kinds += ["path" if sides else kind] * len(rows)
    names = tuple(Label("", f"motion of {v.name}", "", v.unit) for v in _y_labels(frame))
    both = np.concatenate(low), np.concatenate(high)
    return *both, (*names, *labels), np.array(when), tuple(kinds)


def _node(frame: Frame, i: int, end: End, guess: Start, first: bool, last: bool) -> Segment:
    """The node at an end of a phase: w = [y; z if needed]."""
    at = np.array([1.0 if last else 0.0])
    final = last and i == frame.n_phases - 1
    z_cost = last and frame.feels(frame.terms[i].end_cost, *_link(frame, i))[0]
    n_z = frame.model.n_z if end.feels_z or z_cost else 0
    low, high, values = _handed_on(frame, i, guess, at)
    low[: frame.model.n_x, 0], high[: frame.model.n_x, 0] = end.box
    if first:
        _fix_unused(frame, i, low, high)
    unknowns, far = frame.model.dae.z_labels[:n_z], np.full((n_z, 1), np.inf)
    labels = (*_y_labels(frame), *unknowns)
    lower, upper = np.vstack([low, -far]), np.vstack([high, far])
    start = np.clip(np.vstack([values, guess.z(i, at)[:n_z]]), lower, upper)
    names = tuple(Label("", f"link of {v.name}", "", v.unit) for v in _y_labels(frame))
    rows = (*names[: 0 if final else frame.n_y], *unknowns, *end.labels)
    balance = np.zeros(n_z)
    return Segment(
        _node_functions(frame, i, end, n_z, last, final),
        np.zeros((0, 1)),
        frame.n_y,
        0 if final else frame.n_y,
        lower,
        upper,
        start,
        np.concatenate([balance, end.low]),
        np.concatenate([balance, end.high]),
        labels,
        rows,
        (np.zeros(len(labels)), np.zeros(len(rows))),
        i,
        np.array([[at[0], at[0]]]),
        ("link",) * (0 if final else frame.n_y) + ("alg",) * n_z + ("end",) * len(end.labels),
    )


def _link(frame: Frame, i: int) -> list[ca.SX]:
    """States after the end of a phase by those before, if they jump."""
    link = frame.terms[i + 1].link if i + 1 < frame.n_phases else None
    return [] if link is None else [link]


def _node_functions(
    frame: Frame, i: int, end: End, n_z: int, last: bool, final: bool
) -> StageFunctions:
    w, c = ca.SX.sym("w", frame.n_y + n_z), ca.SX.sym("c", 0)
    x, s, m = frame.split(w[: frame.n_y])
    z = w[frame.n_y :] if n_z else ca.SX.zeros(frame.model.n_z)
    v = m if frame.n_m else ca.SX.zeros(frame.n_v)
    t0, length = frame.span(i, s)
    t = t0 + length if last else t0
    rows, alg = end.rows(t, x, z, v, s)
    cost, following = ca.SX(0), w[: frame.n_y]
    if last:
        own = frame.over("own", frame.terms[i].end_cost, *_link(frame, i))
        cost, *link = own.call([ca.SX(a) for a in (t, x, z, v, s)])
        following = ca.vertcat(link[0], s, m) if link else following
    if final:
        following = ca.SX(0, 1)
    both = ca.vertcat(alg if n_z else ca.SX(0, 1), rows)
    return StageFunctions.derived("node", w, c, following, both, cost)
