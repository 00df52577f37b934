"""Smooth replacements of max(0, x) and of the unit step: C2, and exact for |x| > w.

The second derivative of the ramp is the parabola 3 (w^2 - x^2) / (4 w^3) within |x| < w. Its
integral is 1, so that the slope rises from 0 to 1; the ramp itself is 3 w / 16 at x = 0, which is
its largest error.
"""

from __future__ import annotations

from typing import Any

import casadi as ca


def ramp(x: Any, w: Any) -> Any:
    """Return a smooth max(0, x); its error is at most 3 w / 16, and zero for |x| > w."""
    inside = 3 * (w * w * x * x / 2 - x**4 / 12) / (4 * w**3) + x / 2 + 3 * w / 16
    return _pieces(x, w, inside, x)


def ramp_integral(x: Any, w: Any) -> Any:
    """Return the integral of the ramp from -w to x; it is x^2 / 2 + w^2 / 10 for x > w."""
    inside = 3 * (w * w * x**3 / 6 - x**5 / 60) / (4 * w**3) + x * x / 4 + 3 * w * x / 16
    return _pieces(x, w, inside + w * w / 20, x * x / 2 + w * w / 10)


def step(x: Any, w: Any) -> Any:
    """Return a smooth unit step: 0 for x < -w, 1 for x > w, a quintic in between."""
    t = (x / w + 1) / 2
    return _pieces(x, w, t**3 * (10 - 15 * t + 6 * t * t), 1)


def step_over_ramp(x: Any, w: Any) -> Any:
    """Return step(x, w) / ramp(x, w) for x > -w, and its limit 5 / w below.

    Both have a triple zero at -w, which is cancelled analytically instead of dividing 0 by 0.
    """
    t = (x / w + 1) / 2
    ratio = 2 * (10 - 15 * t + 6 * t * t) / (w * (3 - x / w))
    return ca.if_else(x >= w, 1 / ca.if_else(x >= w, x, 1), ca.if_else(x > -w, ratio, 5 / w))


def _pieces(x: Any, w: Any, inside: Any, above: Any) -> Any:
    """Return 0 for x <= -w, `inside` up to w, `above` from there on."""
    return ca.if_else(x >= w, above, ca.if_else(x > -w, inside, 0))
