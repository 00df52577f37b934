"""Time at equal error: interpolation along the convex lower front of work-precision points."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence

Point = tuple[float, float]


def front(runs: Iterable[tuple[float | None, float]]) -> list[Point]:
    """Corners (log error, log time), errors rising and times falling, of the convex lower front.

    Runs without an error, with one that is no number or with none left (0) take no part.
    """
    cheapest: dict[float, float] = {}
    for e, t in runs:
        if e is not None and math.isfinite(e) and e > 0 and t > 0:
            cheapest[math.log(e)] = min(cheapest.get(math.log(e), math.inf), math.log(t))
    hull: list[Point] = []
    for point in sorted(cheapest.items()):
        while len(hull) > 1 and _turns_up(hull[-2], hull[-1], point):
            hull.pop()
        hull.append(point)
    lowest = min(range(len(hull)), key=lambda i: hull[i][1], default=-1)
    return hull[: lowest + 1]


def _turns_up(a: Point, b: Point, c: Point) -> bool:
    """Whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])


def sober(runs: Sequence[tuple[float | None, float]]) -> list[tuple[float | None, float]]:
    """Runs of rising effort, each with the larger of its own error and that of the next.

    So that a run which is better by luck than one of more effort does not make a front.
    """
    after = [error for error, _ in runs[1:]] + [None]
    return [(error if error is None or later is None else max(error, later), t)
            for (error, t), later in zip(runs, after, strict=True)]  # fmt: skip


def time_at(runs: Iterable[tuple[float | None, float]], error: float) -> float | None:
    """Seconds to an error: linear between corners in logarithms, None if it is never reached.

    Beyond the cheapest run, which is better than asked for, it is the time of that run.
    """
    corners, x = front(runs), math.log(error)
    if not corners or x < corners[0][0]:
        return None
    for (x0, y0), (x1, y1) in itertools.pairwise(corners):
        if x <= x1:
            return math.exp(y0 + (y1 - y0) * (x - x0) / (x1 - x0))
    return math.exp(corners[-1][1])
