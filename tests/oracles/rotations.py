"""Rotations in matrix form: exponential, logarithm, quaternions, Tait-Bryan angles, Jacobians.

The library computes with quaternions; everything here goes through the rotation matrix, so that a
common mistake is unlikely. `R_AC` takes components in C to components in A.

Every function also takes complex arrays and is then analytic to first order in the imaginary part,
which is what the complex-step derivative [Squire, Trapp 1998] needs. So `x @ x` stands for the
square of a vector where a norm would conjugate, and branches look at the real part alone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.inexact]

_IDENTITY = np.eye(3)
# Below this squared angle (0.5 rad) the coefficients of the Jacobians come from their power
# series: the closed forms lose digits there, and their complex-step derivatives more of them.
_SERIES_BELOW = 0.25
# (t - sin t)/t^3 in powers of -t^2: 1/3!, 1/5!, ...
_SINE_DEFECT = (1 / 6, 1 / 120, 1 / 5040, 1 / 362880, 1 / 39916800, 1 / 6227020800)
# (1 - (t/2) cot(t/2))/t^2 in powers of t^2: |B_2|/2!, |B_4|/4!, ... (Bernoulli numbers)
_COTANGENT_DEFECT = (
    1 / 12, 1 / 720, 1 / 30240, 1 / 1209600, 1 / 47900160, 691 / 1307674368000, 1 / 74724249600,
)
# asin(x)/x in powers of x^2
_ARCSINE = (1, 1 / 6, 3 / 40, 5 / 112, 35 / 1152)


def cross(a: Array, b: Array) -> Array:
    """a x b by components (`np.cross` is ten times slower on single vectors)."""
    return np.array([
        a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
    ])


def skew(a: Array) -> Array:
    """[a]x, the matrix with [a]x b = a x b."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])


def unskew(S: Array) -> Array:
    """The vector a with [a]x = (S - S')/2, the skew part of S."""
    return 0.5 * np.array([S[2, 1] - S[1, 2], S[0, 2] - S[2, 0], S[1, 0] - S[0, 1]])


def atan2(y: complex, x: complex) -> complex:
    """The angle of (x, y), continued to first order in the imaginary parts.

    d atan2(y, x) = (x dy - y dx)/(x^2 + y^2); the exact log(x + i y) would add the tiny imaginary
    step to a number of order 1 and lose it.
    """
    angle = np.arctan2(np.real(y), np.real(x))
    if not (np.iscomplexobj(x) or np.iscomplexobj(y)):
        return angle
    slope = np.real(x) * np.imag(y) - np.real(y) * np.imag(x)
    return angle + 1j * slope / (np.real(x) ** 2 + np.real(y) ** 2)


def _series(coefficients: tuple[float, ...], s: complex) -> complex:
    """c0 + c1 s + c2 s^2 + ... by Horner's rule."""
    total = 0.0
    for c in reversed(coefficients):
        total = total * s + c
    return total


def _sinc(t: complex) -> complex:
    """sin(t)/t with value 1 at t = 0; exact to rounding everywhere, so no series is needed."""
    return np.sin(t) / t if t != 0 else 1.0


def exp_so3(theta: ArrayLike) -> Array:
    """Rotation matrix of a rotation vector th (rad), t = |th|.

    R = I + (sin t/t) [th]x + ((1 - cos t)/t^2) [th]x^2, with 1 - cos t = 2 sin^2(t/2).
    Rodrigues' formula [Murray, Li, Sastry 1994, eq. 2.14].
    """
    theta = np.asarray(theta)
    t = np.sqrt(theta @ theta)
    S = skew(theta)
    return _IDENTITY + _sinc(t) * S + 0.5 * _sinc(0.5 * t) ** 2 * (S @ S)


def log_so3(R: Array) -> Array:
    """Rotation vector (rad, length at most pi) of a rotation matrix; full accuracy near 0 and pi.

    The skew part of R is n sin t, the symmetric part S = cos t I + (1 - cos t) n n', and
    trace R = 1 + 2 cos t. Up to 120 degrees the skew part gives the axis. Beyond, where sin t
    fades, the axis is the longest column of n n' = (S - cos t I)/(1 - cos t), and the skew part
    only gives its sign. The angle is atan2(sin t, cos t) in both: Rodrigues' formula read
    backwards. At exactly pi both signs are right, and one of them is returned.
    """
    n_sin = unskew(R)
    cos = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    if cos.real > -0.5:
        sin_squared = n_sin @ n_sin
        if cos.real > 0 and abs(sin_squared) < 1e-3:
            return n_sin * _series(_ARCSINE, sin_squared)
        sin = np.sqrt(sin_squared)
        return n_sin * (atan2(sin, cos) / sin)
    outer = (0.5 * (R + R.T) - cos * _IDENTITY) / (1.0 - cos)
    axis = outer[:, np.argmax(np.diag(outer).real)]
    axis = axis / np.sqrt(axis @ axis)
    if (n_sin @ axis).real < 0:
        axis = -axis
    return axis * atan2(n_sin @ axis + 0.0, cos)


def left_jacobian(theta: ArrayLike) -> Array:
    """J_l(th) with w_AC_A = J_l(th) th' for R_AC = exp(th) (spatial components).

    J_l = I + ((1 - cos t)/t^2) [th]x + ((t - sin t)/t^3) [th]x^2 [Solà et al. 2018, eq. 145]. The
    right Jacobian (w_AC_C, components in C) is J_r(th) = J_l(-th) = J_l(th)' [eq. 143].
    """
    theta = np.asarray(theta)
    s = theta @ theta
    t = np.sqrt(s)
    b = _series(_SINE_DEFECT, -s) if abs(s) < _SERIES_BELOW else (t - np.sin(t)) / (t * s)
    S = skew(theta)
    return _IDENTITY + 0.5 * _sinc(0.5 * t) ** 2 * S + b * (S @ S)


def left_jacobian_inverse(theta: ArrayLike) -> Array:
    """J_l(th)^-1 = I - [th]x/2 + ((1 - (t/2) cot(t/2))/t^2) [th]x^2; singular at t = 2 pi only.

    [Solà et al. 2018, eq. 146], its (1 + cos t)/sin t written as cot(t/2), which stays finite at
    t = pi.
    """
    theta = np.asarray(theta)
    s = theta @ theta
    if abs(s) < _SERIES_BELOW:
        c = _series(_COTANGENT_DEFECT, s)
    else:
        half = 0.5 * np.sqrt(s)
        c = (1.0 - half / np.tan(half)) / s
    S = skew(theta)
    return _IDENTITY - 0.5 * S + c * (S @ S)


def from_quaternion(q: ArrayLike) -> Array:
    """Rotation matrix of a quaternion, scalar first, of any length.

    R = I + 2 (w [v]x + [v]x^2)/(q.q) for q = (w, v): Rodrigues' formula in Euler parameters
    [Shabana 2020, ch. 2].
    """
    q = np.asarray(q)
    S = skew(q[1:])
    return _IDENTITY + (2.0 / (q @ q)) * (q[0] * S + S @ S)


def to_quaternion(R: Array) -> Array:
    """Unit quaternion of a rotation matrix, scalar first and not negative.

    The matrix 4 q q' is linear in R; its column of largest diagonal element, divided by its length,
    is q. That choice of column keeps every digit at all angles [Shepperd 1978].
    """
    a = 2.0 * unskew(R)
    outer = np.empty((4, 4), dtype=R.dtype)
    outer[0, 0] = 1.0 + np.trace(R)
    outer[0, 1:] = outer[1:, 0] = a
    outer[1:, 1:] = R + R.T + (1.0 - np.trace(R)) * _IDENTITY
    q = outer[:, np.argmax(np.diag(outer).real)]
    q = q / np.sqrt(q @ q)
    return -q if q[0].real < 0 else q


def rotation_about(axis: int, angle: complex) -> Array:
    """Elementary rotation by an angle (rad) about coordinate axis 0, 1 or 2 (x, y or z)."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R = np.eye(3, dtype=np.result_type(angle, float))
    R[i, i] = R[j, j] = np.cos(angle)
    R[j, i] = np.sin(angle)
    R[i, j] = -R[j, i]
    return R


def from_tait_bryan(angles: ArrayLike) -> Array:
    """R = Rx(a) Ry(b) Rz(c) for the Tait-Bryan xyz angles (a, b, c) in rad (rotating axes)."""
    a, b, c = np.asarray(angles)
    return rotation_about(0, a) @ rotation_about(1, b) @ rotation_about(2, c)


def to_tait_bryan(R: Array) -> Array:
    """Tait-Bryan xyz angles (a, b, c) in rad with R = Rx(a) Ry(b) Rz(c), b in [-pi/2, pi/2].

    Read off the product: R_02 = sin b, (R_12, R_22) = cos b (-sin a, cos a) and
    (R_01, R_00) = cos b (-sin c, cos c). Singular at b = +-pi/2: a and c turn about one axis.
    """
    cos_b = np.sqrt(R[0, 0] ** 2 + R[0, 1] ** 2)
    return np.array([
        atan2(-R[1, 2], R[2, 2]), atan2(R[0, 2], cos_b), atan2(-R[0, 1], R[0, 0]),
    ])
