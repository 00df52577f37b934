"""Rigid-body mechanics as small functions: frames, relative motion, wrenches, Newton-Euler, energy.

Monogram notation: p_WA is the position of A from W, R_WA turns components in A into components in
W, w_WA_W is the angular velocity of A in W with components in W, f_A_W a force on A.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import casadi as ca

from ..base.rotation import cross, dot3, quat_conjugate, quat_matrix, quat_product

Expr: TypeAlias = ca.SX


class Frame(NamedTuple):
    """Pose of a frame A in the world; q_WA is the quaternion of the same rotation as R_WA."""

    p_WA: Expr
    R_WA: Expr
    q_WA: Expr


class Motion(NamedTuple):
    """A frame and its velocities, in world components (m/s, rad/s)."""

    frame: Frame
    v_WA: Expr
    w_WA: Expr


class Wrench(NamedTuple):
    """Force (N) at a point and torque (N m), in world components."""

    f: Expr
    tau: Expr


class Body(NamedTuple):
    """Motion of a body: the frame at its centre of mass with body axes; w_WB_B in body axes."""

    motion: Motion
    w_WB_B: Expr


class MarkerOnBody(NamedTuple):
    """A marker relative to the centre of mass, in body axes; the rates are of driven markers."""

    p_BA: Expr
    R_BA: Expr
    q_BA: Expr
    v_BA: Expr
    w_BA_B: Expr


def body_motion(p_WB: Expr, R_WB: Expr, q_WB: Expr, v_WB: Expr, w_WB_B: Expr) -> Body:
    """Body from its position, rotation, velocity (world) and angular velocity (body axes)."""
    return Body(Motion(Frame(p_WB, R_WB, q_WB), v_WB, R_WB @ w_WB_B), w_WB_B)


def marker_motion(body: Body, marker: MarkerOnBody) -> Motion:
    """Motion of a marker carried by a body."""
    frame = body.motion.frame
    R_WB = frame.R_WA
    p_WA = frame.p_WA + R_WB @ marker.p_BA
    v_WA = body.motion.v_WA + R_WB @ (cross(body.w_WB_B, marker.p_BA) + marker.v_BA)
    w_WA = R_WB @ (body.w_WB_B + marker.w_BA_B)
    return Motion(
        Frame(p_WA, R_WB @ marker.R_BA, quat_product(frame.q_WA, marker.q_BA)), v_WA, w_WA
    )


def ground_motion(marker: MarkerOnBody) -> Motion:
    """Motion of a marker on the ground, whose frame is the world."""
    return Motion(Frame(marker.p_BA, marker.R_BA, marker.q_BA), marker.v_BA, marker.w_BA_B)


def displaced(motion: Motion, small: Expr, faster: Expr) -> Motion:
    """A motion changed to first order: translation and turn, velocities; (6, 1), world axes."""
    p, R, q = motion.frame
    half = ca.vertcat(1, small[3:] / 2)
    turn = ca.SX.eye(3) + ca.skew(small[3:])
    frame = Frame(p + small[:3], turn @ R, quat_product(half, q))
    return Motion(frame, motion.v_WA + faster[:3], motion.w_WA + faster[3:])


def seen_from_first(first: Body, second: Body, by_quaternion: bool) -> list[Body]:
    """Both bodies in the axes of the first, from its centre of mass; its velocity is taken off.

    What connects them depends on nothing else, and of the first body's frame nothing is left to
    compute. Angular velocities stay those in the world.
    """
    here, there = first.motion, second.motion
    R_EW = here.frame.R_WA.T
    q = quat_product(quat_conjugate(here.frame.q_WA), there.frame.q_WA)
    R = quat_matrix(q) if by_quaternion else R_EW @ there.frame.R_WA
    still = ca.SX.zeros(3)
    own = Frame(still, ca.SX.eye(3), ca.SX([1, 0, 0, 0]))
    frame = Frame(R_EW @ (there.frame.p_WA - here.frame.p_WA), R, q)
    motion = Motion(frame, R_EW @ (there.v_WA - here.v_WA), R @ second.w_WB_B)
    return [Body(Motion(own, still, first.w_WB_B), first.w_WB_B), Body(motion, second.w_WB_B)]


def torque_on_body(body: Body, p_BA: Expr, wrench: Wrench) -> Expr:
    """Torque about the centre of mass, body axes, of a wrench at A."""
    R_BW = body.motion.frame.R_WA.T
    return R_BW @ wrench.tau + cross(p_BA, R_BW @ wrench.f)


def gyroscopic(inertia: Expr, w_WB_B: Expr) -> Expr:
    """Torque w x (I w), body axes (N m), by differences of inertias, which fold if equal."""
    rows = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        wi, wj, wk = w_WB_B[i], w_WB_B[j], w_WB_B[k]
        rows.append(
            (inertia[k, k] - inertia[j, j]) * wj * wk
            + inertia[j, k] * (wj * wj - wk * wk)
            + (inertia[i, k] * wj - inertia[i, j] * wk) * wi
        )
    return ca.vertcat(*rows)


def inverse3(A: Expr) -> Expr:
    """Inverse of a symmetric 3x3 matrix by cofactors; exact zeros of a diagonal one stay zeros."""
    c = [
        [
            A[(i + 1) % 3, (j + 1) % 3] * A[(i + 2) % 3, (j + 2) % 3]
            - A[(i + 1) % 3, (j + 2) % 3] * A[(i + 2) % 3, (j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    det = A[0, 0] * c[0][0] + A[0, 1] * c[0][1] + A[0, 2] * c[0][2]
    return ca.vertcat(*(ca.horzcat(*(c[j][i] / det for j in range(3))) for i in range(3)))


def kinetic_energy(mass: Expr, inertia: Expr, body: Body) -> Expr:
    """M v.v / 2 + w.I w / 2 (J)."""
    v, w = body.motion.v_WA, body.w_WB_B
    return (mass * dot3(v, v) + dot3(w, inertia @ w)) / 2


def momentum(mass: Expr, body: Body) -> Expr:
    """M v, world axes (kg m/s)."""
    return mass * body.motion.v_WA


def angular_momentum(mass: Expr, inertia: Expr, body: Body) -> Expr:
    """About the world origin: p x m v + R I w, world axes (kg m2/s)."""
    frame = body.motion.frame
    return cross(frame.p_WA, mass * body.motion.v_WA) + frame.R_WA @ (inertia @ body.w_WB_B)


def power(wrench: Wrench, motion: Motion) -> Expr:
    """Power of a wrench on a frame in motion (W)."""
    return dot3(wrench.f, motion.v_WA) + dot3(wrench.tau, motion.w_WA)
