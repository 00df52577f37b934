"""The three connector laws in matrix form, with a Jacobian of `consistent` derived by hand.

Marker 0 carries frame A, marker 1 frame C, the middle frame is M. All laws have one shape: a strain
s (6, translation first), a rate r (6), the local 6-vector Q = K (s - offset) + D (r - velocity
offset), and a wrench on each marker made from Q. Strains and rates are reported before the offset
is subtracted; forces and torques are in world components, torques about the marker they act on.

Arrays may be complex (complex-step derivatives), see `rotations`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from .rotations import (
    Array,
    cross,
    exp_so3,
    left_jacobian,
    left_jacobian_inverse,
    log_so3,
    skew,
    to_tait_bryan,
)


@dataclass(frozen=True)
class Pose:
    """A marker frame and its motion in the world, all in world components.

    p: p_WA (3), m; R: R_WA (3, 3), the marker's rotation included; v: v_WA_W (3), m/s;
    w: w_WA_W (3), rad/s.
    """

    p: Array
    R: Array
    v: Array = field(default_factory=lambda: np.zeros(3))
    w: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class LawResult:
    """Wrenches on the two markers (world components) and the law's own 6-vectors."""

    force0: Array
    torque0: Array
    force1: Array
    torque1: Array
    strain: Array
    rate: Array
    local: Array


Law = Callable[..., LawResult]


def _local(
    strain: Array, rate: Array, K: ArrayLike, D: ArrayLike, offset: ArrayLike,
    velocity_offset: ArrayLike,
) -> Array:
    """Q = K (s - offset) + D (r - velocity offset)."""
    return np.asarray(K) @ (strain - offset) + np.asarray(D) @ (rate - velocity_offset)


def standard(
    pose0: Pose, pose1: Pose, K: ArrayLike, D: ArrayLike, offset: ArrayLike,
    velocity_offset: ArrayLike = 0.0,
) -> LawResult:
    """Springs along the axes of marker 0, and Tait-Bryan xyz angles as torsion.

    s = [R_WA' (p_WC - p_WA); angles of R_AC], r = [R_WA' (v_WC - v_WA); R_WA' (w_WC - w_WA)],
    (f, m) = Q; marker 0 gets +R_WA f, +R_WA m and marker 1 the opposite. The angles' rates are
    not w_AC_A and no moment balances the arm between the markers: that is the element as
    defined (Exudyn's ObjectConnectorRigidBodySpringDamper).
    """
    R_AW = pose0.R.T
    strain = np.concatenate([R_AW @ (pose1.p - pose0.p), to_tait_bryan(R_AW @ pose1.R)])
    rate = np.concatenate([R_AW @ (pose1.v - pose0.v), R_AW @ (pose1.w - pose0.w)])
    local = _local(strain, rate, K, D, offset, velocity_offset)
    force, torque = pose0.R @ local[:3], pose0.R @ local[3:]
    return LawResult(force, torque, -force, -torque, strain, rate, local)


def intrinsic(
    pose0: Pose, pose1: Pose, K: ArrayLike, D: ArrayLike, offset: ArrayLike,
    velocity_offset: ArrayLike = 0.0,
) -> LawResult:
    """Springs along the SE(3) logarithm of the relative pose, in the middle frame.

    s = (v, th): th = log R_AC and v = V(th)^-1 p_AC_A, V = J_l [Solà et al. 2018, eqs. 173, 174].
    R_WM = R_WA exp(th/2); r = [R_WM' (v_WC - v_WA); R_WM' (w_WC - w_WA)]; (f, m) = Q in M. Marker 0
    gets +R_WM f and +R_WM m - T, marker 1 gets -R_WM f and -R_WM m - T with
    T = R_WM ((-v/2) x f) [after Masarati, Morandini 2010, and Exudyn's intrinsic formulation].
    """
    R_AW = pose0.R.T
    theta = log_so3(R_AW @ pose1.R)
    v = left_jacobian_inverse(theta) @ (R_AW @ (pose1.p - pose0.p))
    R_WM = pose0.R @ exp_so3(0.5 * theta)
    strain = np.concatenate([v, theta])
    rate = np.concatenate([R_WM.T @ (pose1.v - pose0.v), R_WM.T @ (pose1.w - pose0.w)])
    local = _local(strain, rate, K, D, offset, velocity_offset)
    force, torque = R_WM @ local[:3], R_WM @ local[3:]
    arm_torque = cross(R_WM @ (-0.5 * v), force)
    return LawResult(force, torque - arm_torque, -force, -torque - arm_torque, strain, rate, local)


def middle_strain(pose0: Pose, pose1: Pose) -> tuple[Array, Array]:
    """The strain [R_WM' (p_WC - p_WA); th] of `consistent` and its middle frame R_WM.

    th = log R_AC, R_WM = R_WA exp(th/2): the frame half way between the markers, which does not
    care which of them comes first.
    """
    theta = log_so3(pose0.R.T @ pose1.R)
    R_WM = pose0.R @ exp_so3(0.5 * theta)
    return np.concatenate([R_WM.T @ (pose1.p - pose0.p), theta]), R_WM


def middle_jacobian(pose0: Pose, pose1: Pose) -> Array:
    """J (6, 12) with strain' = J (v0, w0, v1, w1), markers' motions in world components.

    With w_AC_A = R_WA' (w1 - w0) and half rotation H = exp(th/2) = R_AM:

        th'    = J_l(th)^-1 w_AC_A                             (definition of the left Jacobian)
        w_AM_A = J_l(th/2) th'/2                               (the same for the half rotation)
        w_WM_W = w0 + N (w1 - w0),  N = R_WA J_l(th/2) J_l(th)^-1 R_WA'/2
        d      = R_WM' (p1 - p0)
        d'     = R_WM' (v1 - v0) - R_WM' (w_WM x (p1 - p0))    (transport theorem)
               = R_WM' (v1 - v0) + [d]x R_WM' w_WM

    J_l as in [Solà et al. 2018, eqs. 145, 146].
    """
    return _jacobian_at(pose0, *middle_strain(pose0, pose1))


def _jacobian_at(pose0: Pose, strain: Array, R_WM: Array) -> Array:
    """`middle_jacobian` where strain and middle frame are known."""
    d, theta = strain[:3], strain[3:]
    theta_rate = left_jacobian_inverse(theta) @ pose0.R.T
    N = 0.5 * pose0.R @ left_jacobian(0.5 * theta) @ theta_rate
    turning = skew(d) @ R_WM.T
    J = np.zeros((6, 12), dtype=np.result_type(strain, R_WM))
    J[:3, 0:3] = -R_WM.T
    J[:3, 3:6] = turning @ (np.eye(3) - N)
    J[:3, 6:9] = R_WM.T
    J[:3, 9:12] = turning @ N
    J[3:, 3:6] = -theta_rate
    J[3:, 9:12] = theta_rate
    return J


def consistent(
    pose0: Pose, pose1: Pose, K: ArrayLike, D: ArrayLike, offset: ArrayLike,
    velocity_offset: ArrayLike = 0.0,
) -> LawResult:
    """Springs that derive from the energy U = (s - offset)' K (s - offset)/2, K symmetric.

    s = [R_WM' (p_WC - p_WA); log R_AC], r = s' = J motion, Q the force conjugate to s. The power
    of the wrenches on the markers is -Q's', hence (force0, torque0, force1, torque1) = -J' Q
    (principle of virtual power), J from `middle_jacobian`.
    """
    strain, R_WM = middle_strain(pose0, pose1)
    J = _jacobian_at(pose0, strain, R_WM)
    rate = J @ np.concatenate([pose0.v, pose0.w, pose1.v, pose1.w])
    local = _local(strain, rate, K, D, offset, velocity_offset)
    wrench = -J.T @ local
    return LawResult(wrench[:3], wrench[3:6], wrench[6:9], wrench[9:], strain, rate, local)


def energy(law: Law, pose0: Pose, pose1: Pose, K: ArrayLike, offset: ArrayLike) -> float:
    """U = (s - offset)' K (s - offset)/2 with the law's own strain s, J.

    For `consistent` this is a potential of the wrench. For the other two it is only bookkeeping:
    their wrenches have no potential.
    """
    e = law(pose0, pose1, K, np.zeros((6, 6)), offset).strain - offset
    return 0.5 * (e @ np.asarray(K) @ e)


def power(result: LawResult, pose0: Pose, pose1: Pose) -> float:
    """Power of both wrenches on the moving markers, sum of f.v + m.w, W."""
    return (
        result.force0 @ pose0.v + result.torque0 @ pose0.w
        + result.force1 @ pose1.v + result.torque1 @ pose1.w
    )


def net_moment(result: LawResult, pose0: Pose, pose1: Pose) -> Array:
    """Moment of both wrenches about the world origin, N m; zero if the law balances moments."""
    return (
        result.torque0 + cross(pose0.p, result.force0)
        + result.torque1 + cross(pose1.p, result.force1)
    )
