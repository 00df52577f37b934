"""The post-Newton step: data states that follow from the step that was just solved.

A connector's `post_newton_step` returns [error, recommended step, data...]. With `GeneralizedAlpha`
it is called after each converged Newton solve, at the end of the step:

1. The data become what it returned.
2. While its error exceeds `tolerance`, the step is solved again from its start with the new data,
   at most `iterations` times; if it still does, the step is halved, down to the smallest.
3. A recommended step shorter than the one taken redoes the step with it while the error exceeds the
   tolerance, and otherwise bounds the next one: > 0 is a length in s, 0 asks for the smallest step,
   < 0 is no wish. Afterwards steps double up to the one asked for.

With IDAS it is called at the points where the driver looks, eight an output interval. The data
become what it returned if the error is within the tolerance, and IDAS starts again if they changed.
If not, the step to that point is halved until the error is within the tolerance, or the time of the
change is known to an instant; then the data become what it returned. Recommended steps play no
part.

The largest error of all connectors counts, and the smallest step that is not negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..model.model import Model


@dataclass(frozen=True)
class PostNewton:
    """How far the post-Newton step is resolved.

    Arguments:
        tolerance: of the error that the user's functions return, in their unit.
        iterations: solves of one step before it is cut (`GeneralizedAlpha`).
    """

    tolerance: float = 1e-6
    iterations: int = 5

    def __post_init__(self) -> None:
        if not (self.tolerance >= 0 and np.isfinite(self.tolerance)):
            raise ValueError(f"PostNewton: tolerance {self.tolerance!r}; it is 0 or above")
        if not isinstance(self.iterations, int) or self.iterations < 1:
            raise ValueError(f"PostNewton: iterations {self.iterations!r}; at least 1")


class Advice(NamedTuple):
    """What the user's functions say: error, recommended step (s, or -1), states with new data."""

    error: float
    step: float
    x: np.ndarray


def advice(
    model: Model, t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, p: np.ndarray
) -> Advice:
    """The advice at a point."""
    column = np.array(model.function("post_newton")(t, x, z, u, p)).reshape(-1)
    return Advice(float(column[0]), float(column[1]), column[2:])
