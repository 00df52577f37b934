"""Rotations: quaternions, rotation vectors, Tait-Bryan xyz angles, the half rotation.

Every function takes CasADi SX, MX or DM (numpy arrays are read as DM) and returns the same kind.
Quaternions are (4, 1), scalar first; q and -q are one rotation, and every function of a quaternion
except `quat_rate` is indifferent to its norm, so that norm drift cannot change the dynamics.
R_AB turns components in B into components in A.

No function divides by an angle. The logarithms halve the angle until one power series serves from
zero to pi, without a branch, so that derivatives of any order are right at rest; the exponential
selects a series near zero and clamps the argument of the regular branch away from it.
"""

from __future__ import annotations

from typing import Any, TypeVar

import casadi as ca

M = TypeVar("M", ca.SX, ca.MX, ca.DM)

_TERMS = 13


def dot3(a: M, b: M) -> M:
    """Scalar product of two 3-vectors, written out so that structural zeros fold."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Any, b: Any) -> Any:
    """Vector product of two 3-vectors (3, 1)."""
    return ca.vertcat(
        a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    )


def quat_product(a: Any, b: Any) -> Any:
    """Hamilton product: the rotation b, then a; q_AC = q_AB q_BC."""
    return ca.vertcat(
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def quat_conjugate(q: Any) -> Any:
    """The opposite rotation (of any norm)."""
    return ca.vertcat(q[0], -q[1], -q[2], -q[3])


def quat_matrix(q: Any) -> Any:
    """Rotation matrix (3, 3) of a quaternion of any norm: R = 1 + 2 (w [v] + [v][v]) / q.q."""
    w, x, y, z = (q[i] for i in range(4))
    s = 2 / (w * w + x * x + y * y + z * z)
    xx, yy, zz = s * x * x, s * y * y, s * z * z
    xy, xz, yz = s * x * y, s * x * z, s * y * z
    wx, wy, wz = s * w * x, s * w * y, s * w * z
    return ca.vertcat(
        ca.horzcat(1 - (yy + zz), xy - wz, xz + wy),
        ca.horzcat(xy + wz, 1 - (xx + zz), yz - wx),
        ca.horzcat(xz - wy, yz + wx, 1 - (xx + yy)),
    )


def matrix_quat(R: Any) -> Any:
    """Unit quaternion of a rotation matrix, from the largest of its four components.

    The columns of the symmetric matrix 4 q q' are linear in R; the one with the largest diagonal
    entry is normalised [Shepperd 1978]. Accurate at every angle.
    """
    columns = (
        (1 + R[0, 0] + R[1, 1] + R[2, 2], R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]),
        (R[2, 1] - R[1, 2], 1 + R[0, 0] - R[1, 1] - R[2, 2], R[0, 1] + R[1, 0], R[0, 2] + R[2, 0]),
        (R[0, 2] - R[2, 0], R[0, 1] + R[1, 0], 1 - R[0, 0] + R[1, 1] - R[2, 2], R[1, 2] + R[2, 1]),
        (R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], 1 - R[0, 0] - R[1, 1] + R[2, 2]),
    )
    best, size = ca.vertcat(*columns[0]), columns[0][0]
    for i in (1, 2, 3):
        larger = columns[i][i] > size
        best = ca.if_else(larger, ca.vertcat(*columns[i]), best)
        size = ca.if_else(larger, columns[i][i], size)
    return best / ca.sqrt(best[0] ** 2 + best[1] ** 2 + best[2] ** 2 + best[3] ** 2)


def quat_rate(q_WB: Any, w_WB_B: Any) -> Any:
    """Time derivative of a quaternion: q' = q (0, w) / 2, w in body axes (rad/s)."""
    return quat_product(q_WB, ca.vertcat(0, w_WB_B)) / 2


def quat_upper(q: Any) -> Any:
    """The unit quaternion with w >= 0 of the same rotation."""
    scale = (2 * (q[0] >= 0) - 1) / ca.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    return ca.vertcat(*(scale * q[i] for i in range(4)))


def quarter(q: Any) -> Any:
    """Vector u = tan(angle/4) axis of an upper unit quaternion, at most 1 long: v / (1 + w).

    (1, u) is a quaternion of the half rotation; the logarithms are regular functions of u.
    """
    return q[1:4] / (1 + q[0])


def _atan_remainder(y: Any) -> Any:
    """(1 - atan(t)/t) / t^2 for y = t^2 in 0 ... 1, without branch or cancellation.

    With s = 1 + sqrt(1 + y), atan(t) = 2 atan(t/s), so C(y) = (1 + 2 C(y/s^2) / s) / s^2. Two such
    halvings bring t below tan(pi/16), where 13 terms of 1/3 - y/5 + y^2/7 - ... leave less than
    epsilon of the value and of its first three derivatives.
    """
    # 2 / (2 x), because CasADi turns a product with 1 / x back into a division, and each derivative
    # of a division divides again.
    r1 = 2 / (2 + 2 * ca.sqrt(1 + y))
    y1 = y * (r1 * r1)
    r2 = 2 / (2 + 2 * ca.sqrt(1 + y1))
    y2 = y1 * (r2 * r2)
    total = 1.0 / (2 * _TERMS + 1)
    for k in range(_TERMS - 2, -1, -1):
        total = 1.0 / (2 * k + 3) - y2 * total
    for r in (r2, r1):
        total = (1 + 2 * total * r) * (r * r)
    return total


def quarter_log(u: Any) -> Any:
    """Rotation vector (3, 1) of u = tan(angle/4) axis: 4 atan(|u|) u / |u|."""
    y = dot3(u, u)
    return 4 * (1 - y * _atan_remainder(y)) * u


def quat_log(q: Any) -> Any:
    """Rotation vector (3, 1), angle 0 ... pi, of a quaternion of any norm and either sign.

    [Sola 2018, eq. 105, with half angles]; it jumps at the angle pi.
    """
    return quarter_log(quarter(quat_upper(q)))


def quat_exp(th: Any) -> Any:
    """Unit quaternion of a rotation vector: (cos(a/2), sin(a/2) th/a), a = |th|."""
    a2 = dot3(th, th)
    near = a2 < 0.1
    half = ca.sqrt(ca.if_else(near, 1, a2)) / 2
    x = ca.if_else(near, a2, 0) / 4
    # sin(h)/h and cos(h) in x = h^2 < 0.025; ten terms leave 1e-16 of the third derivative.
    sinc, cosine = 1.0, 1.0
    for k in range(9, 0, -1):
        sinc = 1 - x * sinc / (2 * k * (2 * k + 1))
        cosine = 1 - x * cosine / (2 * k * (2 * k - 1))
    w = ca.if_else(near, cosine, ca.cos(half))
    return ca.vertcat(w, th * ca.if_else(near, sinc / 2, ca.sin(half) / (2 * half)))


def quat_half(q: Any) -> Any:
    """A quaternion of the half rotation, exp(log(q) / 2), for angles up to pi; no trigonometry."""
    return ca.vertcat(1, quarter(quat_upper(q)))


def se3_log(p: Any, q: Any) -> tuple[Any, Any]:
    """Logarithm (v, th) of the rigid transformation (p, q): p = V(th) v, q = exp(th).

    v = p - th x p / 2 + B th x (th x p), B = (1 - (a/2) cot(a/2)) / a^2, a = |th|
    [Sola, Deray, Atchuthan 2018, eq. 174 and 176]. With t = tan(a/4), A = atan(t)/t and
    C = (1 - A)/t^2 it is B = (A + C) / (16 A^2), regular from 0 to pi.
    """
    u = quarter(quat_upper(q))
    y = dot3(u, u)
    c = _atan_remainder(y)
    a = 1 - y * c
    th = 4 * a * u
    th_p = cross(th, p)
    return p - th_p / 2 + (a + c) / (16 * a * a) * cross(th, th_p), th


def xyz_matrix(a: Any) -> Any:
    """Rotation matrix of Tait-Bryan xyz angles: R = Rx(a0) Ry(a1) Rz(a2)."""
    s0, s1, s2 = (ca.sin(a[i]) for i in range(3))
    c0, c1, c2 = (ca.cos(a[i]) for i in range(3))
    return ca.vertcat(
        ca.horzcat(c1 * c2, -c1 * s2, s1),
        ca.horzcat(c0 * s2 + s0 * s1 * c2, c0 * c2 - s0 * s1 * s2, -s0 * c1),
        ca.horzcat(s0 * s2 - c0 * s1 * c2, s0 * c2 + c0 * s1 * s2, c0 * c1),
    )


def matrix_xyz(R: Any) -> Any:
    """Tait-Bryan xyz angles of a rotation matrix; a1 in -pi/2 ... pi/2, singular at its ends."""
    return ca.vertcat(
        ca.atan2(-R[1, 2], R[2, 2]),
        ca.atan2(R[0, 2], ca.sqrt(R[0, 0] ** 2 + R[0, 1] ** 2)),
        ca.atan2(-R[0, 1], R[0, 0]),
    )


def xyz_quat(a: Any) -> Any:
    """Unit quaternion of Tait-Bryan xyz angles."""
    q = [
        ca.vertcat(ca.cos(a[i] / 2), *(ca.sin(a[i] / 2) * (i == j) for j in range(3)))
        for i in range(3)
    ]
    return quat_product(quat_product(q[0], q[1]), q[2])


def xyz_rate(a: Any, w_WB_B: Any) -> Any:
    """Rates of Tait-Bryan xyz angles from the angular velocity in body axes; singular at pi/2."""
    s2, c2 = ca.sin(a[2]), ca.cos(a[2])
    rate0 = (c2 * w_WB_B[0] - s2 * w_WB_B[1]) / ca.cos(a[1])
    rate1 = s2 * w_WB_B[0] + c2 * w_WB_B[1]
    return ca.vertcat(rate0, rate1, w_WB_B[2] - ca.sin(a[1]) * rate0)
