"""The post-Newton step: data states that are updated from the step that was just solved.

A connector's `post_newton_step` returns [error, recommended step, data...]. With `GeneralizedAlpha`
it is called after each converged Newton solve, at the end of the step:

1. The data states take the values it returned.
2. While its error exceeds `tolerance`, the step is solved again from its start with the new data,
   at most `iterations` times; if the error is still too large, the step is halved, down to the
   smallest one.
3. The recommended step is a length in s if > 0, the smallest step if 0, and no recommendation if
   < 0. If it is shorter than the step taken, the step is repeated with it while the error exceeds
   the tolerance; otherwise it bounds the next step. Afterwards steps double, up to the one asked
   for.

With `Idas` it is called at the points at which events are checked, at least eight in each output
interval. If the error is within the tolerance, the data take the values it returned, and IDAS
starts again if they changed. If not, the time to that point is halved until the error is within the
tolerance, or the time of the change is known to an instant; then the data take the values it
returned. Recommended steps are not used.

If several connectors have a post-Newton step, the largest error counts, and the smallest step that
is not negative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..model.model import Model


@dataclass(frozen=True)
class PostNewton:
    """How accurately post-Newton steps are resolved by `GeneralizedAlpha` and `Idas`.

    The `post_newton_step` of a connector returns an error for each step that was solved. While it
    is above the tolerance, the step is solved again with the new data, or made shorter (see the
    rules in `integrators.post_newton`).

    Arguments:
        tolerance: largest acceptable error, in the unit in which the user's functions return it.
        iterations: solutions of one step before it is halved (`GeneralizedAlpha` only).

    Raises:
        ValueError: a negative tolerance, or less than one iteration.

    >>> GeneralizedAlpha(1e-3, post_newton=PostNewton(tolerance=1e-4))  # doctest: +SKIP
    """

    tolerance: float = 1e-6
    iterations: int = 5

    def __post_init__(self) -> None:
        if not (self.tolerance >= 0 and np.isfinite(self.tolerance)):
            raise ValueError(f"PostNewton: tolerance {self.tolerance!r}; give 0 or a larger number")
        if not isinstance(self.iterations, int) or self.iterations < 1:
            raise ValueError(
                f"PostNewton: iterations {self.iterations!r}; give a whole number >= 1"
            )


class Advice(NamedTuple):
    """Result of the post-Newton steps of all connectors at one point.

    Fields:
        error: the largest, in the unit of the user's functions.
        step: the smallest recommended step, s; -1 for no recommendation.
        x: states (n_x,) with the new data.
    """

    error: float
    step: float
    x: np.ndarray


def advice(
    model: Model, t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, p: np.ndarray
) -> Advice:
    """Evaluate the post-Newton steps of all connectors at a point (t in s, x, z, u, p)."""
    column = np.array(model.function("post_newton")(t, x, z, u, p)).reshape(-1)
    return Advice(float(column[0]), float(column[1]), column[2:])
