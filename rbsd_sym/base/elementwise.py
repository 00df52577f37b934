"""Numpy's elementwise functions as CasADi expressions, under the names that numpy uses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import log, pi

import casadi as ca
import numpy as np

_DEGREE = pi / 180


def _rint(a: ca.SX) -> ca.SX:
    """Return the nearest whole number; halfway cases go to the even one, as in numpy."""
    above = ca.floor(a + 0.5)
    odd = above - 2 * ca.floor(above / 2)
    return above - ca.if_else(a + 0.5 == above, odd, 0)


UFUNCS: dict[str, Callable[..., ca.SX]] = {
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "arcsin": ca.asin,
    "arccos": ca.acos,
    "arctan": ca.atan,
    "arctan2": ca.atan2,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "arcsinh": ca.asinh,
    "arccosh": ca.acosh,
    "arctanh": ca.atanh,
    "exp": ca.exp,
    "exp2": lambda a: 2**a,
    "expm1": ca.expm1,
    "log": ca.log,
    "log2": lambda a: ca.log(a) / log(2),
    "log10": ca.log10,
    "log1p": ca.log1p,
    "sqrt": ca.sqrt,
    "cbrt": lambda a: ca.sign(a) * ca.fabs(a) ** (1 / 3),
    "square": lambda a: a * a,
    "conjugate": lambda a: a,
    "reciprocal": lambda a: 1 / a,
    "hypot": ca.hypot,
    "absolute": ca.fabs,
    "fabs": ca.fabs,
    "sign": ca.sign,
    "copysign": ca.copysign,
    "heaviside": lambda a, b: ca.if_else(a < 0, 0, ca.if_else(a > 0, 1, b)),
    "floor": ca.floor,
    "ceil": ca.ceil,
    "trunc": lambda a: ca.if_else(a < 0, ca.ceil(a), ca.floor(a)),
    "rint": _rint,
    "remainder": lambda a, b: a - b * ca.floor(a / b),
    "fmod": ca.fmod,
    "floor_divide": lambda a, b: ca.floor(a / b),
    "deg2rad": lambda a: a * _DEGREE,
    "radians": lambda a: a * _DEGREE,
    "rad2deg": lambda a: a / _DEGREE,
    "degrees": lambda a: a / _DEGREE,
    "maximum": ca.fmax,
    "minimum": ca.fmin,
    "fmax": ca.fmax,
    "fmin": ca.fmin,
    "clip": lambda a, low, high: ca.fmin(ca.fmax(a, low), high),
    "less": lambda a, b: a < b,
    "less_equal": lambda a, b: a <= b,
    "greater": lambda a, b: a > b,
    "greater_equal": lambda a, b: a >= b,
    "equal": lambda a, b: a == b,
    "not_equal": lambda a, b: a != b,
    "logical_and": ca.logic_and,
    "logical_or": ca.logic_or,
    "logical_xor": lambda a, b: (a != 0) != (b != 0),
    "logical_not": ca.logic_not,
    "bitwise_and": ca.logic_and,
    "bitwise_or": ca.logic_or,
    "invert": ca.logic_not,
}
"""Numpy functions by name; the operators +, -, *, /, ** and @ work on expressions without them."""


def interpolated(
    x: ca.SX, at: np.ndarray, values: Sequence[ca.SX], left: ca.SX, right: ca.SX
) -> ca.SX:
    """Return a piecewise linear function of x, with the formula that numpy uses within each piece.

    Arguments:
        x: where to evaluate it.
        at: numbers (n,) that do not decrease; where two are equal the function jumps.
        values: n values, one at each of them.
        left, right: values before the first and after the last.
    """
    out = ca.if_else(x > at[-1], right, values[-1])
    for a, b, low, high in reversed(
        list(zip(at[:-1], at[1:], values[:-1], values[1:], strict=True))
    ):
        if b > a:
            out = ca.if_else(x < b, (high - low) / (b - a) * (x - a) + low, out)
    return ca.if_else(x < at[0], left, out)
