"""Rigid-body mechanics as small functions: frames, relative motion, wrenches, Newton-Euler, energy.

Monogram notation: p_WA is the position of A relative to W, R_WA maps components in A to components
in W, w_WA_W is the angular velocity of A in W with components in W, and f_A_W is a force on A. W is
the world, B a body frame at the centre of mass, A and C are marker frames, E is any other frame.
Adjacent letters cancel: R_WA = R_WB R_BA. All values are expressions (3, 1), (3, 3) or, for
quaternions, (4, 1).
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import casadi as ca

from ..base.rotation import cross, dot3, quat_conjugate, quat_matrix, quat_product

Expr: TypeAlias = ca.SX


class Frame(NamedTuple):
    """Pose of a frame A in the world.

    Fields:
        p_WA: position, m.
        R_WA: rotation matrix.
        q_WA: quaternion of the same rotation, scalar first. Laws use whichever of the two is
            cheaper.
    """

    p_WA: Expr
    R_WA: Expr
    q_WA: Expr


class Motion(NamedTuple):
    """A frame A and its velocity (m/s) and angular velocity (rad/s), in world components."""

    frame: Frame
    v_WA: Expr
    w_WA: Expr


class Wrench(NamedTuple):
    """Force (N) at a point, and torque (N m), in world components."""

    f: Expr
    tau: Expr


class Body(NamedTuple):
    """Motion of a body.

    Fields:
        motion: of the frame at the centre of mass with body axes.
        w_WB_B: the angular velocity once more, in body axes, rad/s.
    """

    motion: Motion
    w_WB_B: Expr


class MarkerOnBody(NamedTuple):
    """A marker relative to the centre of mass of its body, in body axes.

    Fields:
        p_BA, R_BA, q_BA: pose (m); quaternion and matrix are the same rotation.
        v_BA, w_BA_B: velocities relative to the body (m/s, rad/s), not zero for a driven marker.
    """

    p_BA: Expr
    R_BA: Expr
    q_BA: Expr
    v_BA: Expr
    w_BA_B: Expr


def body_motion(p_WB: Expr, R_WB: Expr, q_WB: Expr, v_WB: Expr, w_WB_B: Expr) -> Body:
    """Return a body from its states.

    Arguments:
        p_WB, v_WB: position (m) and velocity (m/s) of the centre of mass, world components.
        R_WB, q_WB: rotation as matrix and as quaternion.
        w_WB_B: angular velocity in body axes, rad/s.
    """
    return Body(Motion(Frame(p_WB, R_WB, q_WB), v_WB, R_WB @ w_WB_B), w_WB_B)


def marker_motion(body: Body, marker: MarkerOnBody) -> Motion:
    """Return the motion of a marker A carried by a body.

    p_WA = p_WB + R_WB p_BA,   v_WA = v_WB + R_WB (w_WB_B x p_BA + v_BA),
    w_WA = R_WB (w_WB_B + w_BA_B)
    """
    frame = body.motion.frame
    R_WB = frame.R_WA
    p_WA = frame.p_WA + R_WB @ marker.p_BA
    v_WA = body.motion.v_WA + R_WB @ (cross(body.w_WB_B, marker.p_BA) + marker.v_BA)
    w_WA = R_WB @ (body.w_WB_B + marker.w_BA_B)
    return Motion(
        Frame(p_WA, R_WB @ marker.R_BA, quat_product(frame.q_WA, marker.q_BA)), v_WA, w_WA
    )


def ground_motion(marker: MarkerOnBody) -> Motion:
    """Return the motion of a marker on the ground, whose body frame is the world."""
    return Motion(Frame(marker.p_BA, marker.R_BA, marker.q_BA), marker.v_BA, marker.w_BA_B)


def displaced(motion: Motion, small: Expr, faster: Expr) -> Motion:
    """Return a motion changed by a small displacement, exact to first order.

    Arguments:
        small: (6, 1) translation (m) and rotation (rad), world axes.
        faster: (6, 1) additional velocity (m/s) and angular velocity (rad/s), world axes.
    """
    p, R, q = motion.frame
    half = ca.vertcat(1, small[3:] / 2)
    # First order is all that is needed: the result is differentiated once at small = 0.
    turn = ca.SX.eye(3) + ca.skew(small[3:])
    frame = Frame(p + small[:3], turn @ R, quat_product(half, q))
    return Motion(frame, motion.v_WA + faster[:3], motion.w_WA + faster[3:])


def seen_from_first(first: Body, second: Body, by_quaternion: bool) -> list[Body]:
    """Return both bodies in the axes E of the first, relative to its centre of mass and velocity.

    What connects two bodies depends on their relative motion only (frame-indifference), and in
    these axes the first frame is the identity, which removes its terms from the expressions.
    Angular velocities remain those in the world, with components in E.

    Arguments:
        first, second: the bodies in the world.
        by_quaternion: whether the relative rotation matrix is made from the relative quaternion
            (fewer operations if the coordinates are quaternions) or from the two matrices.
    """
    here, there = first.motion, second.motion
    R_EW = here.frame.R_WA.T
    q = quat_product(quat_conjugate(here.frame.q_WA), there.frame.q_WA)
    # From angles, the product of the two matrices is cheaper than the quaternions.
    R = quat_matrix(q) if by_quaternion else R_EW @ there.frame.R_WA
    still = ca.SX.zeros(3)
    own = Frame(still, ca.SX.eye(3), ca.SX([1, 0, 0, 0]))
    frame = Frame(R_EW @ (there.frame.p_WA - here.frame.p_WA), R, q)
    motion = Motion(frame, R_EW @ (there.v_WA - here.v_WA), R @ second.w_WB_B)
    return [Body(Motion(own, still, first.w_WB_B), first.w_WB_B), Body(motion, second.w_WB_B)]


def torque_on_body(body: Body, p_BA: Expr, wrench: Wrench) -> Expr:
    """Return the torque about the centre of mass, body axes (N m), of a wrench at p_BA."""
    R_BW = body.motion.frame.R_WA.T
    return R_BW @ wrench.tau + cross(p_BA, R_BW @ wrench.f)


def gyroscopic(inertia: Expr, w_WB_B: Expr) -> Expr:
    """Return the gyroscopic torque w x (I w), body axes, N m.

    It is written with differences of the moments of inertia, which vanish if these are equal.

    Arguments:
        inertia: about the centre of mass, body axes, kg m2 (3, 3).
        w_WB_B: angular velocity in body axes, rad/s.
    """
    rows = []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        # Row i of w x (I w), with i, j, k in cyclic order, sorted by products of velocities.
        wi, wj, wk = w_WB_B[i], w_WB_B[j], w_WB_B[k]
        rows.append(
            (inertia[k, k] - inertia[j, j]) * wj * wk
            + inertia[j, k] * (wj * wj - wk * wk)
            + (inertia[i, k] * wj - inertia[i, j] * wk) * wi
        )
    return ca.vertcat(*rows)


def inverse3(A: Expr) -> Expr:
    """Return the inverse (3, 3) of a symmetric matrix; zeros of a diagonal one stay exact."""
    c = [
        [
            A[(i + 1) % 3, (j + 1) % 3] * A[(i + 2) % 3, (j + 2) % 3]
            - A[(i + 1) % 3, (j + 2) % 3] * A[(i + 2) % 3, (j + 1) % 3]
            for j in range(3)
        ]
        for i in range(3)
    ]
    # Cofactors instead of ca.inv: structural zeros stay zeros, and CasADi folds them.
    det = A[0, 0] * c[0][0] + A[0, 1] * c[0][1] + A[0, 2] * c[0][2]
    return ca.vertcat(*(ca.horzcat(*(c[j][i] / det for j in range(3))) for i in range(3)))


def kinetic_energy(mass: Expr, inertia: Expr, body: Body) -> Expr:
    """Return m v.v / 2 + w.I w / 2, J; inertia about the centre of mass, body axes."""
    v, w = body.motion.v_WA, body.w_WB_B
    return (mass * dot3(v, v) + dot3(w, inertia @ w)) / 2


def momentum(mass: Expr, body: Body) -> Expr:
    """Return the linear momentum m v, world axes, kg m/s."""
    return mass * body.motion.v_WA


def angular_momentum(mass: Expr, inertia: Expr, body: Body) -> Expr:
    """Return p x m v + R I w: about the world origin, world axes, kg m2/s."""
    frame = body.motion.frame
    return cross(frame.p_WA, mass * body.motion.v_WA) + frame.R_WA @ (inertia @ body.w_WB_B)


def power(wrench: Wrench, motion: Motion) -> Expr:
    """Return the power f.v + tau.w of a wrench on a moving frame, W."""
    return dot3(wrench.f, motion.v_WA) + dot3(wrench.tau, motion.w_WA)
