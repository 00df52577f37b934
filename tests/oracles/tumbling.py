"""A free rigid body by Jacobi's elliptic functions."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .rotations import Array


def complete_k(complement: float) -> float:
    """K(k) from k' = sqrt(1 - k^2): pi / (2 M(1, k')), M the arithmetic-geometric mean."""
    a, b = 1.0, complement
    while abs(a - b) > 1e-15 * a:
        a, b = 0.5 * (a + b), np.sqrt(a * b)
    return float(np.pi / (2.0 * a))


def jacobi(u: ArrayLike, complement: float) -> tuple[Array, Array, Array]:
    """Functions sn, cn, dn of u for the modulus with k' = sqrt(1 - k^2), 0 < k' <= 1.

    Descending Landen transformations [Abramowitz, Stegun 1964, sec. 16.4]: with a_0 = 1, b_0 = k'
    and c_n = (a_(n-1) - b_(n-1))/2 down to c_N = 0, phi_N = 2^N a_N u, and back

        sin(2 phi_(n-1) - phi_n) = (c_n / a_n) sin(phi_n);  sn = sin(phi_0), cn = cos(phi_0)

    dn^2 = k'^2 + k^2 cn^2 has no difference. u is first brought to within one period 4 K.
    """
    quarter = complete_k(complement)
    u = np.asarray(u, float)
    u = u - 4.0 * quarter * np.round(u / (4.0 * quarter))
    a, c = [1.0], [np.sqrt((1.0 - complement) * (1.0 + complement))]
    b = complement
    while c[-1] > 1e-16 * a[-1]:
        a_next, c_next = 0.5 * (a[-1] + b), 0.5 * (a[-1] - b)
        b = np.sqrt(a[-1] * b)
        a.append(a_next)
        c.append(c_next)
    phi = 2.0 ** (len(a) - 1) * a[-1] * u
    for a_n, c_n in zip(a[:0:-1], c[:0:-1], strict=True):
        phi = 0.5 * (phi + np.arcsin(c_n / a_n * np.sin(phi)))
    sn, cn = np.sin(phi), np.cos(phi)
    return sn, cn, np.sqrt(complement**2 + (1.0 - complement**2) * cn * cn)


def _invariants(inertia: ArrayLike, w: Array) -> tuple[float, float, float]:
    """2 T I_z - H^2, H^2 - 2 T I_x and H^2 - 2 T I_y, without differences of large numbers.

    H^2 - 2 T I = sum over the axes of I_i (I_i - I) w_i^2.
    """
    I = np.asarray(inertia, float)
    A, B, C = (float(np.sum(I * (I - one) * w * w)) for one in I)
    return -C, A, B


def tumbling(t: ArrayLike, inertia: ArrayLike, w: ArrayLike) -> Array:
    """Angular velocity (n, 3) at times t of a free body, principal axes, I_x < I_y < I_z.

    With H^2 > 2 T I_y, so that w_z keeps its sign [Landau, Lifshitz, Mechanics, sec. 37]:

        w_x = p cn(tau), w_y = s q sn(tau), w_z = r dn(tau),  tau = rate (t + t_0),
        p^2 = (2 T I_z - H^2)/(I_x (I_z - I_x)), q^2 = (2 T I_z - H^2)/(I_y (I_z - I_y)),
        r^2 = (H^2 - 2 T I_x)/(I_z (I_z - I_x)),
        rate^2 = (I_z - I_y)(H^2 - 2 T I_x)/(I_x I_y I_z),
        k'^2 = (I_z - I_x)(H^2 - 2 T I_y)/((I_z - I_y)(H^2 - 2 T I_x))

    r has the sign of w_z, and I_y w_y' = (I_z - I_x) w_z w_x gives w_y the sign s of r. t_0 follows
    from the start by the amplitude atan2(w_y / q, w_x / p): the incomplete integral
    F(phi) by Gauss-Legendre quadrature.
    """
    A, B, C = np.asarray(inertia, float)
    w = np.asarray(w, float)
    high, low, slack = _invariants(inertia, w)
    p, q = np.sqrt(high / (A * (C - A))), np.sqrt(high / (B * (C - B)))
    sign = np.copysign(1.0, w[2])
    r, rate = sign * np.sqrt(low / (C * (C - A))), np.sqrt((C - B) * low / (A * B * C))
    complement = np.sqrt((C - A) * slack / ((C - B) * low))
    phi = np.arctan2(sign * w[1] / q, w[0] / p)
    start = incomplete_f(float(phi), complement)
    sn, cn, dn = jacobi(rate * np.asarray(t, float) + start, complement)
    return np.stack([p * cn, sign * q * sn, r * dn], axis=-1)


def incomplete_f(phi: float, complement: float) -> float:
    """F(phi, k) for |phi| <= pi: the integral of 1/sqrt(1 - k^2 sin^2).

    In y with sin = tanh y near pi/2, where dn is small, the integrand stays smooth:
    F(phi) = integral of 1/sqrt(1 + k'^2 sinh^2 y) dy over 0 ... atanh(sin phi) for |phi| < pi/2.
    """
    if abs(phi) > np.pi / 2:
        rest = np.copysign(np.pi, phi) - phi
        half = np.copysign(2.0 * complete_k(complement), phi)
        return float(half - incomplete_f(rest, complement))
    end = np.arcsinh(np.tan(phi))
    x, weights = np.polynomial.legendre.leggauss(40)
    edges = np.linspace(0.0, end, 21)
    middle, half = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    y = middle[:, None] + half[:, None] * x
    return float(np.sum(half[:, None] * weights / np.hypot(1.0, complement * np.sinh(y))))


def half_period(inertia: ArrayLike, w: ArrayLike) -> float:
    """2 K / rate: w_x and w_y have then the other sign, s."""
    A, B, C = np.asarray(inertia, float)
    _, low, slack = _invariants(inertia, np.asarray(w, float))
    complement = np.sqrt((C - A) * slack / ((C - B) * low))
    return float(2.0 * complete_k(complement) / np.sqrt((C - B) * low / (A * B * C)))
