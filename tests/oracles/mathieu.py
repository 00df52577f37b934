"""The damped Mathieu equation: its monodromy by Gauss' method, its boundaries by bisection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .rotations import Array


def monodromy(A: Callable[[float], Array], period: float, steps: int = 400) -> Array:
    """Solution of q' = A(t) q over a period from unit starts, by the two-stage Gauss method.

    It has order 4; the result of `steps` and of half as many are extrapolated to order 6
    [Hairer, Norsett, Wanner 1993, secs. II.7 and II.9].
    """
    coarse, fine = _gauss(A, period, steps // 2), _gauss(A, period, steps)
    return fine + (fine - coarse) / 15


def _gauss(A: Callable[[float], Array], period: float, steps: int) -> Array:
    h, root = period / steps, np.sqrt(3) / 6
    a = h * np.array([[1 / 4, 1 / 4 - root], [1 / 4 + root, 1 / 4]])
    n = len(A(0.0))
    M, one = np.eye(n), np.eye(n)
    for k in range(steps):
        first, second = (A((k + 0.5 + side * root) * h) for side in (-1, 1))
        left = np.block(
            [
                [one - a[0, 0] * first, -a[0, 1] * first],
                [-a[1, 0] * second, one - a[1, 1] * second],
            ]
        )
        rates = np.linalg.solve(left, np.vstack([first, second]))
        M = M + h / 2 * (rates[:n] + rates[n:]) @ M
    return M


def pendulum(
    amplitude: float, frequency: float, reduced: float, damping: float, gravity: float = 9.81
) -> Callable[[float], Array]:
    """A(t) of an upright pendulum on a hinge that moves by amplitude sin(w t) along the vertical.

        f'' + damping f' + (-gravity + amplitude w^2 sin(w t)) f / reduced = 0

    [Landau, Lifshitz, Mechanics, sec. 30]. `reduced` is J/(m l), `damping` c/J (1/s).
    """
    w = 2 * np.pi * frequency

    def A(t: float) -> Array:
        lift = -gravity + amplitude * w * w * np.sin(w * t)
        return np.array([[0.0, 1.0], [-lift / reduced, -damping]])

    return A


def exponent(A: Callable[[float], Array], period: float, steps: int = 400) -> float:
    """Largest growth rate of a disturbance, 1/s."""
    return float(np.log(np.abs(np.linalg.eigvals(monodromy(A, period, steps))).max()) / period)


def boundary(grows: Callable[[float], bool], low: float, high: float) -> float:
    """Where `grows` changes between two values, to 1e-6 of them."""
    first = grows(low)
    if grows(high) == first:
        raise ValueError(f"no change between {low} and {high}")
    while high - low > 1e-6 * high:
        middle = (low + high) / 2
        low, high = (middle, high) if grows(middle) == first else (low, middle)
    return (low + high) / 2
