"""The law whose wrench is the derivative of a potential energy; suitable for every scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from ..base.rotation import (
    cross,
    quarter,
    quarter_log,
    quat_conjugate,
    quat_matrix,
    quat_product,
    quat_upper,
)
from ..mechanics.motion import Motion, Wrench
from .law import Relative


@dataclass(frozen=True)
class Consistent:
    """Spring-damper with a potential; exact in momentum, energy and frame-indifference.

        rs.RigidBodySpringDamper("mount", marker0, marker1, stiffness, law=rs.Consistent())

    Picture: the displacement is measured in the frame half way between the two markers, the
    rotation as a rotation vector, and the wrench follows from the energy stored in both.

    Free bodies: with [f; tau] = J' s in world components, marker 1 receives the force -f and the
    torque -tau, marker 0 the force +f and the torque tau + (p1 - p0) x f. Both forces act on one
    line, so that the net force and the net moment vanish for any K and D.

        u = [Am' (p1 - p0); th] - offset,  Am = A0 exp(th / 2),  th = rotation vector of A0' A1
        U = u' K u / 2
        s = K u + D (u' - velocity_offset),  u' the time derivative of u
        J = derivative of u by the translation and rotation of A1 relative to A0

    CasADi computes J. All six physical tests hold: moment balance, independence of the order of the
    markers, zero work around closed loops, passivity for a positive semidefinite D,
    frame-indifference and isotropy. K must be symmetric.

    As a joint: a zero row frees its direction, along or about any axis. With the other rows stiff
    the element tends to the ideal joint; two free rotations make a constant-velocity joint.

    Choosing numbers: as for `Standard`.

    Limits: the rotation vector jumps at a relative angle of pi, and the stored energy with it. With
    one free rotation axis the bending stiffness about the others grows with the angle of rotation,
    to 2.5 times at half a turn: right for mounts and bushings, not for bearings that turn far.
    """

    needs_symmetric_stiffness: ClassVar[bool] = True
    turns_with_frames: ClassVar[bool] = True
    soft_axes_with_trouble: ClassVar[tuple[int, ...]] = ()

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Return the strain, its time derivative, and the map from s to the marker wrenches.

        See `Law.relative`.
        """
        R_WA = motion0.frame.R_WA
        lever = motion1.frame.p_WA - motion0.frame.p_WA
        p_AC = R_WA.T @ lever
        # The sign of q is settled before the step is applied, so that no branch is differentiated.
        q_AC = quat_upper(quat_product(quat_conjugate(motion0.frame.q_WA), motion1.frame.q_WA))
        v_AC = R_WA.T @ (motion1.v_WA - motion0.v_WA - cross(motion0.w_WA, lever))
        w_AC_A = R_WA.T @ (motion1.w_WA - motion0.w_WA)

        # A small motion of C in A: translation, then rotation. The strain is differentiated by it
        # at zero: forward along the velocities for u', in reverse for J' s.
        step = ca.SX.sym("step", 6)
        u = quarter(quat_product(ca.vertcat(1, step[3:] / 2), q_AC))
        R_AM = quat_matrix(ca.vertcat(1, u))
        strain = ca.vertcat(R_AM.T @ (p_AC + step[:3]), quarter_log(u))
        still = ca.SX.zeros(6)
        rate = ca.substitute(ca.jtimes(strain, step, ca.vertcat(v_AC, w_AC_A)), step, still)

        def transmit(force: ca.SX) -> tuple[Wrench, Wrench]:
            load = ca.substitute(ca.jtimes(strain, step, force, True), step, still)
            f, tau = R_WA @ load[:3], R_WA @ load[3:]
            return Wrench(f, tau + cross(lever, f)), Wrench(-f, -tau)

        return Relative(ca.substitute(strain, step, still), rate, transmit)
