"""Energy of `Consistent` and its derivatives in decimal arithmetic, as a reference for others."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal, localcontext
from typing import NamedTuple

_DIGITS = 90
# Step of the central differences; with 90 digits they keep 28 of the third derivative.
_STEP = Decimal(10) ** -14
# Halvings of an angle before the power series.
_HALVINGS = 6
_TERMS = 40
_Vector = list[Decimal]


class Pose(NamedTuple):
    """Two markers, a motion of both along a line, and the spring between them.

    Fields:
        p0, p1: positions (3,), m.
        q0, q1: quaternions (4,), scalar first.
        direction: (12,) translation and rotation of marker 0, then of marker 1, world axes.
        stiffness: (6, 6).
        offset: (6,).
    """

    p0: Sequence[float]
    q0: Sequence[float]
    p1: Sequence[float]
    q1: Sequence[float]
    direction: Sequence[float]
    stiffness: Sequence[Sequence[float]]
    offset: Sequence[float]


def exact_orders(pose: Pose) -> tuple[float, ...]:
    """Return U and its first three derivatives along the motion, correct to the last digit."""
    with localcontext() as context:
        context.prec = _DIGITS
        u = {k: _energy(pose, k * _STEP) for k in (-2, -1, 0, 1, 2)}
        # Central differences; the first one of order 4, so that all keep enough digits.
        first = (8 * (u[1] - u[-1]) - (u[2] - u[-2])) / (12 * _STEP)
        second = (u[1] - 2 * u[0] + u[-1]) / _STEP**2
        third = (u[2] - 2 * u[1] + 2 * u[-1] - u[-2]) / (2 * _STEP**3)
        return tuple(float(value) for value in (u[0], first, second, third))


def _energy(pose: Pose, s: Decimal) -> Decimal:
    d = [Decimal(float(v)) * s for v in pose.direction]
    q0, q1 = (_product(_exp(turn), _exact(q)) for turn, q in ((d[3:6], pose.q0), (d[9:], pose.q1)))
    lever = [
        Decimal(float(b)) + e - Decimal(float(a)) - c
        for a, b, c, e in zip(pose.p0, pose.p1, d[:3], d[6:9], strict=True)
    ]
    q = _unit(_product(_conjugate(q0), q1))
    q = q if q[0] >= 0 else [-v for v in q]
    middle = _unit(_product(q0, [1 + q[0], *q[1:]]))
    local = _product(_product(_conjugate(middle), [Decimal(0), *lever]), middle)[1:]
    u = [v - Decimal(float(o)) for v, o in zip((*local, *_log(q)), pose.offset, strict=True)]
    K = pose.stiffness
    return (
        sum((u[i] * Decimal(float(K[i][j])) * u[j] for i in range(6) for j in range(6)), Decimal(0))
        / 2
    )


def _exact(q: Sequence[float]) -> _Vector:
    return [Decimal(float(v)) for v in q]


def _unit(q: _Vector) -> _Vector:
    norm = sum((v * v for v in q), Decimal(0)).sqrt()
    return [v / norm for v in q]


def _conjugate(q: _Vector) -> _Vector:
    return [q[0], -q[1], -q[2], -q[3]]


def _product(a: _Vector, b: _Vector) -> _Vector:
    return [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]


def _exp(th: _Vector) -> _Vector:
    """Return the quaternion of a rotation vector, by the series of cos(h) and sin(h) / h in h^2."""
    x = sum((v * v for v in th), Decimal(0)) / 4
    cosine = sinc = term = Decimal(1)
    for k in range(1, _TERMS):
        term = -term * x / (2 * k * (2 * k - 1))
        cosine += term
        sinc += term / (2 * k + 1)
    return [cosine, *(v * sinc / 2 for v in th)]


def _log(q: _Vector) -> _Vector:
    """Return the rotation vector of a unit quaternion (w, v) with w >= 0, as in `quat_log`."""
    u = [v / (1 + q[0]) for v in q[1:]]
    y, factor = sum((v * v for v in u), Decimal(0)), Decimal(4)
    # atan(t) = 2 atan(t / (1 + sqrt(1 + t^2))).
    for _ in range(_HALVINGS):
        r = 1 + (1 + y).sqrt()
        y, factor = y / (r * r), 2 * factor / r
    ratio = sum(((-y) ** k / (2 * k + 1) for k in range(1, _TERMS)), Decimal(1))
    return [factor * ratio * v for v in u]
