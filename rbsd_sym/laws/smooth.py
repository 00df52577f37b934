"""Smooth stand-ins for max(0, x) and the unit step: C2, and exact beyond w.

The second derivative of the ramp is the parabola 3 (w^2 - x^2) / (4 w^3) within |x| < w, so that
the first rises from 0 to 1 and the ramp is 3 w / 16 at 0, its largest error.
"""

from __future__ import annotations

from typing import Any

import casadi as ca


def ramp(x: Any, w: Any) -> Any:
    """max(0, x) with an error of at most 3 w / 16, within |x| < w only."""
    inside = 3 * (w * w * x * x / 2 - x**4 / 12) / (4 * w**3) + x / 2 + 3 * w / 16
    return _pieces(x, w, inside, x)


def ramp_integral(x: Any, w: Any) -> Any:
    """Integral of the ramp from -w; x^2 / 2 + w^2 / 10 beyond w."""
    inside = 3 * (w * w * x**3 / 6 - x**5 / 60) / (4 * w**3) + x * x / 4 + 3 * w * x / 16
    return _pieces(x, w, inside + w * w / 20, x * x / 2 + w * w / 10)


def step(x: Any, w: Any) -> Any:
    """0 below -w, 1 above w, a quintic between."""
    t = (x / w + 1) / 2
    return _pieces(x, w, t**3 * (10 - 15 * t + 6 * t * t), 1)


def step_over_ramp(x: Any, w: Any) -> Any:
    """step(x, w) / ramp(x, w) for x > -w, where both have a triple zero; 5 / w below."""
    t = (x / w + 1) / 2
    ratio = 2 * (10 - 15 * t + 6 * t * t) / (w * (3 - x / w))
    return ca.if_else(x >= w, 1 / ca.if_else(x >= w, x, 1), ca.if_else(x > -w, ratio, 5 / w))


def _pieces(x: Any, w: Any, inside: Any, above: Any) -> Any:
    return ca.if_else(x >= w, above, ca.if_else(x > -w, inside, 0))
