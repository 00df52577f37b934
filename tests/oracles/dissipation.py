"""Dissipation, wanted and numerical: plasticity, Maxwell branches, tanh friction, time stepping.

Closed forms and exact updates, and generalized-alpha as published, on R^n and on R3 x SO(3).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .rotations import Array, cross, exp_so3

# Newton's method (at least two corrections) stops at a correction this small; its square is below
# rounding. It gives up after so many.
_CORRECTION, _ITERATIONS = 1e-9, 30


class PlasticHistory(NamedTuple):
    """One entry per displacement: force (N), plastic part (m), its length (m), energies (J).

    work, the integral of f du, is stored + plastic_work; plastic_work, the integral of f dp, is
    dissipated + what the hardening stores, H p^2/2 + I s^2/2.
    """

    force: Array
    plastic: Array
    length: Array
    work: Array
    plastic_work: Array
    dissipated: Array


def elastoplastic(
    displacement: ArrayLike, stiffness: float, yield_force: float, kinematic: float = 0.0,
    isotropic: float = 0.0,
) -> PlasticHistory:
    """Spring and slider with linear hardening under a piecewise linear displacement from zero.

    f = k (u - p), |f - H p| <= F_y + I s, s' = |p'|. For the trial force with p held, let
    y = |f - H p| - F_y - I s; if y > 0, p moves by g = y/(k + H + I) towards f - H p and s grows
    by g: the return mapping [Simo, Hughes 1998, ch. 1], with no error for whole straight pieces,
    because p moves one way in each. While it moves f is linear in p, so that f dp is a
    trapezium; elastic energy k (u - p)^2/2, dissipated F_y s.
    """
    p = s = plastic_work = 0.0
    rows = []
    for u in np.asarray(displacement, dtype=float):
        reduced = stiffness * (u - p) - kinematic * p
        excess = abs(reduced) - yield_force - isotropic * s
        if excess > 0.0:
            step = excess / (stiffness + kinematic + isotropic)
            yields_at = kinematic * p + np.copysign(yield_force + isotropic * s, reduced)
            s += step
            step = np.copysign(step, reduced)
            p += step
            plastic_work += 0.5 * (yields_at + stiffness * (u - p)) * step
        force = stiffness * (u - p)
        work = 0.5 * force * (u - p) + plastic_work
        rows.append((force, p, s, work, plastic_work, yield_force * s))
    return PlasticHistory(*np.array(rows).T)


def kinematic_loop_area(
    amplitude: float, stiffness: float, yield_force: float, kinematic: float = 0.0
) -> float:
    """Energy lost (J) per closed cycle between +-u_m with kinematic hardening H.

    At +-u_m the plastic part is +-(k u_m - F_y)/(k + H); on the way the force is H p +- F_y. The
    parts H p cancel over the cycle, F_y times the way remains: 4 F_y (k u_m - F_y)/(k + H). With
    H = 0 it is 4 F_y (u_m - u_y), u_y = F_y/k; zero below u_y.
    """
    excess = max(stiffness * amplitude - yield_force, 0.0)
    return 4.0 * yield_force * excess / (stiffness + kinematic)


def isotropic_peaks(
    count: int, amplitude: float, stiffness: float, yield_force: float, isotropic: float
) -> Array:
    """Force (N, absolute) at the first `count` reversals between +-u_m with isotropic hardening I.

    At a reversal the force is the yield force Y. The first quarter makes k u_m - Y equal to
    (k u_m - F_y) k/(k + I); a half cycle slides by 2 (k u_m - Y)/(k + I), so that k u_m - Y shrinks
    by (k - I)/(k + I) in each: the spring shakes down to elastic cycles (I < k).
    """
    gap = (stiffness * amplitude - yield_force) * stiffness / (stiffness + isotropic)
    ratio = (stiffness - isotropic) / (stiffness + isotropic)
    return stiffness * amplitude - gap * ratio ** np.arange(count)


Branches = Sequence[tuple[float, float]]


def maxwell_relaxation(t: ArrayLike, stiffness: float, branches: Branches, u0: float) -> Array:
    """Force after a step u0 at t = 0: u0 (k + sum of k_i exp(-t k_i/c_i)).

    A spring k beside branches (k_i, c_i), each a spring and a damper in series: f_i/k_i + the
    damper's part = u, so f_i' = k_i u' - f_i k_i/c_i [Christensen 1982, ch. 1].
    """
    t = np.asarray(t, dtype=float)
    return u0 * (stiffness + sum(k * np.exp(-t * k / c) for k, c in branches))


def maxwell_creep(
    t: ArrayLike, stiffness: float, branch: tuple[float, float], force: float
) -> Array:
    """Displacement under a force applied at t = 0, one branch (the standard linear solid).

    f = k u + f_1, f_1' = k_1 u' - f_1 k_1/c_1 gives (f/k) (1 - k_1/(k + k_1) exp(-t/T)) with
    T = (c_1/k_1) (k + k_1)/k; for k = 0 f/k_1 + f t/c_1.
    """
    t = np.asarray(t, dtype=float)
    k1, c1 = branch
    if stiffness == 0.0:
        return force / k1 + force * t / c1
    decay = np.exp(-t * k1 * stiffness / (c1 * (stiffness + k1)))
    return force / stiffness * (1.0 - k1 / (stiffness + k1) * decay)


def maxwell_stiffness(omega: ArrayLike, stiffness: float, branches: Branches) -> Array:
    """Complex stiffness k + sum of k_i i w T_i/(1 + i w T_i), T_i = c_i/k_i (storage + i loss)."""
    s = 1j * np.asarray(omega, dtype=float)
    return stiffness + sum(s * c / (1.0 + s * c / k) for k, c in branches)


def maxwell_cycle_loss(omega: float, amplitude: float, branches: Branches) -> float:
    """Energy (J) lost per steady cycle u = U sin(w t): pi U^2 times the loss stiffness."""
    return np.pi * amplitude**2 * float(maxwell_stiffness(omega, 0.0, branches).imag)


def maxwell_sine(
    t: ArrayLike, stiffness: float, branches: Branches, omega: float, amplitude: float
) -> Array:
    """Force for u = U sin(w t) from t = 0, branches unloaded before.

    f_i = U (Re K_i sin(w t) + Im K_i (cos(w t) - exp(-t/T_i))).
    """
    t = np.asarray(t, dtype=float)
    force = stiffness * np.sin(omega * t)
    for k, c in branches:
        K = maxwell_stiffness(omega, 0.0, [(k, c)])
        force = force + K.real * np.sin(omega * t)
        force = force + K.imag * (np.cos(omega * t) - np.exp(-t * k / c))
    return amplitude * force


def maxwell_oscillator(
    t: ArrayLike, mass: float, stiffness: float, branches: Branches, x0: float, v0: float
) -> Array:
    """Free motion m x'' = -k x - sum of f_i, rows (x, v, f_1, ...) at times t, f_i = 0 at t = 0.

    Linear, y' = A y: y = sum of eigenvectors times exp(eigenvalue t) (distinct eigenvalues).
    """
    n = 2 + len(branches)
    A = np.zeros((n, n))
    A[0, 1], A[1, 0] = 1.0, -stiffness / mass
    for i, (k, c) in enumerate(branches, start=2):
        A[1, i], A[i, 1], A[i, i] = -1.0 / mass, k, -k / c
    values, vectors = np.linalg.eig(A)
    weights = np.linalg.solve(vectors, np.array([x0, v0] + [0.0] * (n - 2), dtype=complex))
    powers = np.exp(values * np.asarray(t, dtype=float)[..., None])
    return (powers * weights @ vectors.T).real


def tanh_slide(
    t: ArrayLike, mass: float, friction: float, width: float, v0: float
) -> tuple[Array, Array]:
    """Distance and velocity of m v' = -F tanh(v/e), e = `width` (m/s), from v0 > 0: exact.

    sinh(v/e) = sinh(v0/e) exp(-F t/(m e)), and ds = -(m/F) v coth(v/e) dv, so
    s = (m e^2/F) (G(v0/e) - G(v/e)) with G(z) the integral of y coth y from 0 to z.
    """
    z0 = v0 / width
    # log of sinh(v/e), which itself may overflow
    L = z0 + np.log1p(-np.exp(-2.0 * z0)) - np.log(2.0)
    L = L - friction * np.asarray(t, dtype=float) / (mass * width)
    large = np.maximum(L, 0.0)
    z = np.where(
        L > 0.0,
        large + np.log1p(np.sqrt(1.0 + np.exp(-2.0 * large))),
        np.arcsinh(np.exp(np.minimum(L, 0.0))),
    )
    s = [_coth_integral(z0) - _coth_integral(value) for value in z.flat]
    return mass * width**2 / friction * np.reshape(s, z.shape), width * z


def _coth_integral(z: float) -> float:
    """G(z), the integral of y coth y from 0 to z.

    y coth y = y + 2 y/(exp(2 y) - 1), and the integral of the second part to infinity is pi^2/12:
    G = z^2/2 + pi^2/12 - sum of exp(-2 n z) (z/n + 1/(2 n^2)). Below 1 Gauss-Legendre, whose error
    with 20 points is far below rounding (the nearest pole is at i pi).
    """
    if z < 1.0:
        y, weight = np.polynomial.legendre.leggauss(20)
        y = 0.5 * z * (1.0 + y)
        return 0.5 * z * float(weight @ (y / np.tanh(y))) if z > 0.0 else 0.0
    n = np.arange(1.0, 21.0)
    return 0.5 * z * z + np.pi**2 / 12.0 - np.exp(-2.0 * n * z) @ (z / n + 0.5 / n**2)


def tanh_slide_excess(mass: float, friction: float, width: float) -> float:
    """How much farther (m) than m v0^2/(2 F) a mass slides with tanh(v/e): pi^2 m e^2/(12 F).

    The limit t -> infinity of `tanh_slide`, up to a relative exp(-2 v0/e). Second order in e.
    """
    return np.pi**2 * mass * width**2 / (12.0 * friction)


def tanh_creep(force: float, friction: float, width: float) -> float:
    """Velocity (m/s) at which tanh friction lets a mass creep that Coulomb friction would hold.

    |force| < F: v = e atanh(force/F), first order in e.
    """
    return width * np.arctanh(force / friction)

class AlphaParameters(NamedTuple):
    """Coefficients of generalized-alpha."""

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float


def alpha_parameters(rho: float) -> AlphaParameters:
    """Optimal coefficients for a spectral radius rho at infinity [Chung, Hulbert 1993].

    alpha_m = (2 rho - 1)/(rho + 1), alpha_f = rho/(rho + 1), gamma = 1/2 + alpha_f - alpha_m (for
    order 2), beta = (gamma + 1/2)^2/4 = 1/(1 + rho)^2. The step [Arnold, Bruels 2007] is

        q1 = q0 + h v0 + h^2 ((1/2 - beta) a0 + beta a1),  v1 = v0 + h ((1 - gamma) a0 + gamma a1),
        (1 - alpha_m) a1 + alpha_m a0 = (1 - alpha_f) v1' + alpha_f v0',

    with v' from the equation of motion at the ends of the step and a0 = v0' at the start.
    """
    alpha_m, alpha_f = (2.0 * rho - 1.0) / (rho + 1.0), rho / (rho + 1.0)
    gamma = 0.5 + alpha_f - alpha_m
    return AlphaParameters(alpha_m, alpha_f, 0.25 * (gamma + 0.5) ** 2, gamma)


def amplification_matrix(h_omega: float, rho: float, damping_ratio: float = 0.0) -> Array:
    """Matrix of one step on v' = -2 d w v - w^2 q for the columns (q, h v, h^2 a).

    With h^2 v' = -r.(q, h v, h^2 a), r = ((h w)^2, 2 d h w, 0), the three equations of the step are
    left X1 = right X0.
    """
    m, f, beta, gamma = alpha_parameters(rho)
    r = np.array([h_omega**2, 2.0 * damping_ratio * h_omega, 0.0])
    left = np.array([[1.0, 0.0, -beta], [0.0, 1.0, -gamma], [0.0, 0.0, 1.0 - m]])
    right = np.array([[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [0.0, 0.0, -m]])
    left[2] += (1.0 - f) * r
    right[2] -= f * r
    return np.linalg.solve(left, right)


def alpha_roots(h_omega: float, rho: float) -> Array:
    """Eigenvalues of the undamped `amplification_matrix` to rounding, h w > 0: the pair, the third.

    With the optimal coefficients the characteristic polynomial is, z = (h w)^2,

        (1 + rho)^2 (l - 1)^2 ((2 - rho) l + 2 rho - 1) + z (l + rho)^3,

    nearly a triple root -rho for large z, where a general solver loses digits. Put in
    l = (1 - rho p)/(1 + p): (1 - rho) p^3 - p^2 - Z^2 with Z = h w/(1 + rho), whose roots lie well
    apart. For rho = 1 p = +-i Z, the trapezoidal rule, and the third is at infinity, l = -1.
    """
    Z, k = h_omega / (1.0 + rho), 1.0 - rho
    if k == 0.0:
        pair = (1.0 - 1j * Z) / (1.0 + 1j * Z)
        return np.array([pair, np.conj(pair), -1.0])
    p = np.roots([k, -1.0, 0.0, -Z * Z]).astype(complex)
    p = p[np.argsort(p.real)]
    return (1.0 - rho * p) / (1.0 + p)


def spectral_radius(h_omega: float, rho: float) -> float:
    """Largest absolute eigenvalue of one step on an undamped oscillator (rho at infinity)."""
    return float(np.abs(alpha_roots(h_omega, rho)).max())


def numerical_damping(h_omega: float, rho: float) -> tuple[float, float]:
    """Damping ratio and relative lengthening of the period that the method adds.

    The principal pair is exp(-d +- i p): damping ratio d/sqrt(d^2 + p^2), lengthening h w/p - 1.
    To leading order, with r = (1 - rho)/(1 + rho) and y = h w (by series of `alpha_roots`):
    d = r^3 y^4/2, p = y - (1/12 + 3 r^2/8) y^3.
    """
    logarithm = np.log(alpha_roots(h_omega, rho)[0])
    phase = abs(logarithm.imag)
    return -logarithm.real / abs(logarithm), h_omega / phase - 1.0


Residual = Callable[[float, Array, Array, Array], Array]
Jacobian = Callable[[float, Array, Array, Array], tuple[Array, Array, Array]]


class Steps(NamedTuple):
    """Times (n + 1) and, one row per time, q, v, v' and the method's a."""

    t: Array
    q: Array
    v: Array
    rate: Array
    a: Array


def _newton(residual: Callable[[Array], Array], slope: Callable[[Array], Array], x: Array) -> Array:
    """The zero of a residual; ArithmeticError if the corrections do not get small."""
    for i in range(_ITERATIONS):
        correction = np.linalg.solve(slope(x), residual(x))
        x = x - correction
        if i > 0 and np.abs(correction).max() <= _CORRECTION * (1.0 + np.abs(x).max()):
            return x
    raise ArithmeticError(f"no convergence, last correction {np.abs(correction).max():.1e}")


def _advance(
    h: float, p: AlphaParameters, v: Array, rate: Array, a: Array, dq: Array
) -> tuple[Array, Array, Array]:
    """The new v, v' and a that belong to an increment dq of q.

    dq is the unknown of both integrators. With v' as unknown the increment would be a difference of
    numbers as large as (h w)^2 q: at h w = 1e4 that costs eight digits.
    """
    a1 = ((dq / h - v) / h - (0.5 - p.beta) * a) / p.beta
    new_rate = ((1.0 - p.alpha_m) * a1 + p.alpha_m * a - p.alpha_f * rate) / (1.0 - p.alpha_f)
    return v + h * ((1.0 - p.gamma) * a + p.gamma * a1), new_rate, a1


def alpha_steps(
    residual: Residual, jacobian: Jacobian, q0: ArrayLike, v0: ArrayLike, h: float, steps: int,
    rho: float, a0: ArrayLike | None = None,
) -> Steps:
    """Generalized-alpha with q' = v and residual(t, q, v, v') = 0 on R^n, equal steps from t = 0.

    `jacobian` gives the derivatives of the residual in q, v and v'. Newton's unknown is the
    increment dq, with dv/dq = gamma/(beta h), dv'/dq = (1 - alpha_m)/((1 - alpha_f) beta h^2).
    """
    p = alpha_parameters(rho)
    dv = p.gamma / (p.beta * h)
    drate = (1.0 - p.alpha_m) / ((1.0 - p.alpha_f) * p.beta * h * h)
    q, v = (np.atleast_1d(np.array(x, dtype=float)) for x in (q0, v0))
    rate = _newton(
        lambda x: residual(0.0, q, v, x), lambda x: jacobian(0.0, q, v, x)[2], np.zeros_like(q)
    )
    a = rate if a0 is None else np.atleast_1d(np.array(a0, dtype=float))
    rows = [(q, v, rate, a)]
    for n in range(1, steps + 1):
        q, v, rate, a = rows[-1]

        def end(dq: Array, q=q, v=v, rate=rate, a=a, t=n * h) -> tuple[float, Array, Array, Array]:
            return t, q + dq, *_advance(h, p, v, rate, a, dq)[:2]

        def slope(dq: Array, end=end) -> Array:
            K, C, M = jacobian(*end(dq))
            return K + dv * C + drate * M

        dq = _newton(lambda dq, end=end: residual(*end(dq)), slope, h * (v + 0.5 * h * a))
        rows.append((q + dq, *_advance(h, p, v, rate, a, dq)))
    columns = (np.array(column) for column in zip(*rows, strict=True))
    return Steps(h * np.arange(steps + 1), *columns)


class BodySteps(NamedTuple):
    """Times (n + 1) and, one row per time, p_WB, R_WB, (v_WB_W, w_WB_B), its rate and a (6)."""

    t: Array
    p: Array
    R: Array
    v: Array
    rate: Array
    a: Array


Wrench = Callable[[float, Array, Array, Array, Array], tuple[Array, Array]]


def alpha_body(
    mass: float, inertia: ArrayLike, wrench: Wrench, position: ArrayLike, rotation: ArrayLike,
    velocity: ArrayLike, h: float, steps: int, rho: float,
) -> BodySteps:
    """Generalized-alpha for one rigid body on R3 x SO(3) [Bruels, Cardona 2010].

    `velocity` is (v_WB_W, w_WB_B) (6), `inertia` (3, 3) about the centre of mass in body axes, and
    wrench(t, p_WB, R_WB, v_WB_W, w_WB_B) gives force (world) and moment (body axes). A step is that
    of R^n with increments p1 = p0 + D_p, R1 = R0 exp(D_R). The equations are m v' = f and
    I w' + w x I w = m_B; their derivative in D comes from complex steps through exp, so that no
    tangent operator is written down. `wrench` must take complex arrays.
    """
    alpha, I = alpha_parameters(rho), np.asarray(inertia, dtype=float)

    def residual(t: float, p: Array, R: Array, v: Array, rate: Array) -> Array:
        force, moment = wrench(t, p, R, v[:3], v[3:])
        turn = I @ rate[3:] + cross(v[3:], I @ v[3:]) - moment
        return np.concatenate([mass * rate[:3] - force, turn])

    p, R, v = (np.array(x, dtype=float) for x in (position, rotation, velocity))
    rest = residual(0.0, p, R, v, np.zeros(6))
    rate = -np.concatenate([rest[:3] / mass, np.linalg.solve(I, rest[3:])])
    rows = [(p, R, v, rate, rate)]
    for n in range(1, steps + 1):
        p, R, v, rate, a = rows[-1]

        def equations(D: Array, p=p, R=R, v=v, rate=rate, a=a, t=n * h) -> Array:
            v1, rate1, _ = _advance(h, alpha, v, rate, a, D)
            return residual(t, p + D[:3], R @ exp_so3(D[3:]), v1, rate1)

        def slope(D: Array, equations=equations) -> Array:
            return np.array([equations(D + 1e-30j * e).imag for e in np.eye(6)]).T / 1e-30

        D = _newton(equations, slope, h * (v + 0.5 * h * a))
        rows.append((p + D[:3], R @ exp_so3(D[3:]), *_advance(h, alpha, v, rate, a, D)))
    columns = (np.array(column) for column in zip(*rows, strict=True))
    return BodySteps(h * np.arange(steps + 1), *columns)
