"""Closed-form motions: damped oscillator, the user_force scene, ballistic flight, symmetric top."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from .rotations import Array, exp_so3


def damped_oscillator(
    t: ArrayLike, mass: float, stiffness: float, damping: float, v0: float, y0: float = 0.0
) -> tuple[Array, Array]:
    """Position and velocity of m y'' + d y' + k y = 0 at times t, for every damping ratio.

    With a = d/(2 m) and w^2 = k/m - a^2, C = cos(w t) and S = sin(w t)/w:

        y  = exp(-a t) (y0 C + (v0 + a y0) S)
        y' = exp(-a t) (v0 C - (a v0 + y0 k/m) S)

    [Landau, Lifshitz, Mechanics, sec. 25]. Complex w covers overdamping; S = t at w = 0. The scene
    `mini` is m = 1, k = 500, d = 5, v0 = 1000; `mass` may be a moment of inertia.
    """
    t = np.asarray(t, dtype=float)
    a = damping / (2.0 * mass)
    w = np.sqrt(complex(stiffness / mass - a * a))
    C = np.cos(w * t).real
    S = (np.sin(w * t) / w).real if w != 0 else t
    decay = np.exp(-a * t)
    y = decay * (y0 * C + (v0 + a * y0) * S)
    return y, decay * (v0 * C - (a * v0 + y0 * stiffness / mass) * S)


def user_force(t: ArrayLike) -> Array:
    """r(t) = p_x + p_y of the body point (0.1, 0.1, 0.1) m in the scene `user_force`.

    Unit mass and inertia, a translation y (k = 5000, d = 50, v0 = 10 m/s) and a rotation phi about
    x (k = 5000, d = 5, 8 pi rad/s) that do not feel each other, so p = (0, y, 0) + Rx(phi) point.
    """
    y, _ = damped_oscillator(t, 1.0, 5000.0, 50.0, 10.0)
    phi, _ = damped_oscillator(t, 1.0, 5000.0, 5.0, 8.0 * np.pi)
    return 0.1 + y + 0.1 * np.cos(phi) - 0.1 * np.sin(phi)


def ballistic(
    t: float, position: ArrayLike, velocity: ArrayLike, gravity: ArrayLike
) -> tuple[Array, Array]:
    """Position and velocity of a free centre of mass: p + v t + g t^2/2, v + g t."""
    p, v, g = (np.asarray(a, dtype=float) for a in (position, velocity, gravity))
    return p + v * t + 0.5 * g * t * t, v + g * t


def free_symmetric_top(
    t: float, transverse: float, axial: float, R_WB: ArrayLike, w_WB_B: ArrayLike
) -> tuple[Array, Array]:
    """Attitude R_WB and angular velocity w_WB_B of a free body with inertia diag(A, A, C).

    The angular momentum h_W = R_WB I w is constant. Regular precession about it, spin about z:

        R_WB(t) = exp(t h_W/A) R_WB(0) Rz(t (1 - C/A) w_z),
        w_WB_B(t) = Rz(t (1 - C/A) w_z)' w_WB_B(0)

    [Landau, Lifshitz, Mechanics, secs. 33, 35]; A = C is the spherical top, which turns uniformly.
    """
    R, w = np.asarray(R_WB, dtype=float), np.asarray(w_WB_B, dtype=float)
    h_W = R @ (np.array([transverse, transverse, axial]) * w)
    spin = exp_so3(np.array([0.0, 0.0, t * (1.0 - axial / transverse) * w[2]]))
    return exp_so3(t * h_W / transverse) @ R @ spin, spin.T @ w
