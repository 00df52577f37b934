"""Rotations: quaternions, rotation vectors, Tait-Bryan xyz angles, and the half rotation.

Every function takes CasADi SX, MX or DM (numpy arrays are read as DM) and returns the same type.
Quaternions are (4, 1), scalar first. q and -q are the same rotation. The functions of a quaternion,
except `quat_rate` and `quarter`, give the same rotation for any norm, so that drift of the norm
cannot change the dynamics. R_AB maps components in B to components in A.

No function divides by an angle. The logarithms halve the angle until one power series holds from 0
to pi, without a branch, so that derivatives of every order are exact at rest. The exponential uses
a series near zero and keeps the argument of its regular branch away from zero.
"""

from __future__ import annotations

from typing import Any, TypeVar

import casadi as ca

M = TypeVar("M", ca.SX, ca.MX, ca.DM)

# Terms of the arctangent series in `_atan_remainder`.
_TERMS = 13


def dot3(a: M, b: M) -> M:
    """Return the scalar product of two 3-vectors, written out so that structural zeros vanish."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Any, b: Any) -> Any:
    """Return the vector product a x b of two 3-vectors, (3, 1), written out like `dot3`."""
    return ca.vertcat(
        a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    )


def quat_product(a: Any, b: Any) -> Any:
    """Return the Hamilton product a b (4, 1): the rotation b followed by a.

    It composes as rotation matrices do, q_AC = q_AB q_BC, and its norm is the product of the norms.

    >>> quat_product(ca.DM([0, 1, 0, 0]), ca.DM([0, 0, 1, 0]))
    DM([0, 0, 0, 1])
    """
    return ca.vertcat(
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    )


def quat_conjugate(q: Any) -> Any:
    """Return the conjugate (4, 1): the inverse rotation, with the same norm."""
    return ca.vertcat(q[0], -q[1], -q[2], -q[3])


def quat_matrix(q: Any) -> Any:
    """Return the rotation matrix (3, 3) of a quaternion of any norm.

    R = 1 + 2 (w [v] + [v][v]) / q.q with q = (w, v) and [v] the cross-product matrix. The division
    by q.q replaces a normalisation.
    """
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
    """Return the unit quaternion (4, 1) of a rotation matrix (3, 3), accurate at every angle.

    The columns of the symmetric matrix 4 q q' are linear in R; the one with the largest diagonal
    entry is normalised [Shepperd 1978]. The sign of the result is the one that makes its largest
    component positive.
    """
    # 4 q q' written out in entries of R, column by column.
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
    """Return the time derivative (4, 1) of a quaternion: q' = q (0, w) / 2.

    The norm of q is constant under this equation, whatever it is.

    Arguments:
        q_WB: quaternion (4, 1) from B to W.
        w_WB_B: angular velocity of B in W, components in B, rad/s.
    """
    return quat_product(q_WB, ca.vertcat(0, w_WB_B)) / 2


def quat_upper(q: Any) -> Any:
    """Return the unit quaternion with w >= 0 (the upper half sphere) of the same rotation.

    It changes sign, and so jumps, where w crosses zero: at the angle pi.
    """
    # Not sign(w), which is 0 for w = 0.
    scale = (2 * (q[0] >= 0) - 1) / ca.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    return ca.vertcat(*(scale * q[i] for i in range(4)))


def quarter(q: Any) -> Any:
    """Return the vector tan(angle/4) axis (3, 1) of a unit quaternion with w >= 0.

    It is v / (1 + w), at most 1 long. (1, u) is a quaternion of the half rotation, and the
    logarithms are regular functions of u.
    """
    return q[1:4] / (1 + q[0])


def _atan_remainder(y: Any) -> Any:
    """Return C(y) = (1 - atan(t)/t) / t^2 of y = t^2 in 0 ... 1, without branch or cancellation.

    With s = 1 + sqrt(1 + y), atan(t) = 2 atan(t/s), hence C(y) = (1 + 2 C(y/s^2) / s) / s^2. Two
    such halvings bring t below tan(pi/16), where 13 terms of 1/3 - y/5 + y^2/7 - ... leave an error
    below epsilon in the value and in its first three derivatives.
    """
    # Written 2 / (2 x) instead of 1 / x: CasADi turns a product with 1 / x back into a division,
    # and every derivative of a division divides again.
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
    """Return the rotation vector (3, 1), rad, of u = tan(angle/4) axis: 4 atan(|u|) u / |u|."""
    y = dot3(u, u)
    return 4 * (1 - y * _atan_remainder(y)) * u


def quat_log(q: Any) -> Any:
    """Return the rotation vector (3, 1), rad, of a quaternion of any norm and either sign.

    Its length is the angle, 0 ... pi [Sola 2018, eq. 105, with half angles]. Derivatives of every
    order are exact down to angle zero. At the angle pi the vector jumps to its opposite.
    """
    return quarter_log(quarter(quat_upper(q)))


def quat_exp(th: Any) -> Any:
    """Return the unit quaternion (4, 1) of a rotation vector th (3, 1), rad, of any length.

    It is (cos(a/2), sin(a/2) th/a) with a = |th|; near a = 0 by power series, so that derivatives
    exist there as well.
    """
    a2 = dot3(th, th)
    near = a2 < 0.1
    # CasADi evaluates both branches of if_else, and derivatives multiply the unused one by zero, so
    # that its argument must never be 0: 0 times infinity is NaN.
    half = ca.sqrt(ca.if_else(near, 1, a2)) / 2
    x = ca.if_else(near, a2, 0) / 4
    # Series of sin(h)/h and cos(h) in x = h^2 < 0.025; ten terms leave a relative error of 1e-16 in
    # the third derivative.
    sinc, cosine = 1.0, 1.0
    for k in range(9, 0, -1):
        sinc = 1 - x * sinc / (2 * k * (2 * k + 1))
        cosine = 1 - x * cosine / (2 * k * (2 * k - 1))
    w = ca.if_else(near, cosine, ca.cos(half))
    return ca.vertcat(w, th * ca.if_else(near, sinc / 2, ca.sin(half) / (2 * half)))


def quat_half(q: Any) -> Any:
    """Return a quaternion (4, 1) of the half rotation, exp(log(q) / 2), without trigonometry.

    The norm of the result is not 1. Like the logarithm it jumps at the angle pi.
    """
    return ca.vertcat(1, quarter(quat_upper(q)))


def se3_log(p: Any, q: Any) -> tuple[Any, Any]:
    """Return the logarithm (v, th), m and rad, of the rigid transformation (p, q).

    It solves p = V(th) v, q = exp(th):

        v = p - th x p / 2 + B th x (th x p),  B = (1 - (a/2) cot(a/2)) / a^2,  a = |th|

    [Sola, Deray, Atchuthan 2018, eq. 174 and 176]. With t = tan(a/4), A = atan(t)/t and
    C = (1 - A)/t^2 this is B = (A + C) / (16 A^2), which is regular from 0 to pi. th jumps at
    a = pi.

    Arguments:
        p: position (3, 1) of the second frame in the first, m.
        q: quaternion (4, 1) of the second frame in the first, of any norm and sign.
    """
    u = quarter(quat_upper(q))
    y = dot3(u, u)
    c = _atan_remainder(y)
    a = 1 - y * c
    th = 4 * a * u
    th_p = cross(th, p)
    return p - th_p / 2 + (a + c) / (16 * a * a) * cross(th, th_p), th


def xyz_matrix(a: Any) -> Any:
    """Return the rotation matrix (3, 3) of Tait-Bryan xyz angles: R = Rx(a0) Ry(a1) Rz(a2)."""
    s0, s1, s2 = (ca.sin(a[i]) for i in range(3))
    c0, c1, c2 = (ca.cos(a[i]) for i in range(3))
    return ca.vertcat(
        ca.horzcat(c1 * c2, -c1 * s2, s1),
        ca.horzcat(c0 * s2 + s0 * s1 * c2, c0 * c2 - s0 * s1 * s2, -s0 * c1),
        ca.horzcat(s0 * s2 - c0 * s1 * c2, s0 * c2 + c0 * s1 * s2, c0 * c1),
    )


def matrix_xyz(R: Any) -> Any:
    """Return the Tait-Bryan xyz angles (3, 1), rad, of a rotation matrix R = Rx(a0) Ry(a1) Rz(a2).

    a0 and a2 lie in -pi ... pi, a1 in -pi/2 ... pi/2. At the ends of a1 (gimbal lock) only the sum
    or difference of a0 and a2 is determined, and derivatives do not exist.
    """
    return ca.vertcat(
        ca.atan2(-R[1, 2], R[2, 2]),
        ca.atan2(R[0, 2], ca.sqrt(R[0, 0] ** 2 + R[0, 1] ** 2)),
        ca.atan2(-R[0, 1], R[0, 0]),
    )


def xyz_quat(a: Any) -> Any:
    """Return the unit quaternion (4, 1) of Tait-Bryan xyz angles, continuous in the angles."""
    q = [
        ca.vertcat(ca.cos(a[i] / 2), *(ca.sin(a[i] / 2) * (i == j) for j in range(3)))
        for i in range(3)
    ]
    return quat_product(quat_product(q[0], q[1]), q[2])


def xyz_rate(a: Any, w_WB_B: Any) -> Any:
    """Return the rates (3, 1) of Tait-Bryan xyz angles, rad/s; singular at a1 = +-pi/2.

    Arguments:
        a: angles (3, 1), rad, of R_WB = Rx(a0) Ry(a1) Rz(a2).
        w_WB_B: angular velocity of B in W, components in B, rad/s.
    """
    s2, c2 = ca.sin(a[2]), ca.cos(a[2])
    rate0 = (c2 * w_WB_B[0] - s2 * w_WB_B[1]) / ca.cos(a[1])
    rate1 = s2 * w_WB_B[0] + c2 * w_WB_B[1]
    return ca.vertcat(rate0, rate1, w_WB_B[2] - ca.sin(a[1]) * rate0)
