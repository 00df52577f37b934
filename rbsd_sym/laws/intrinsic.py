"""The law in the middle frame, from the logarithm of the relative rigid transformation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from ..base.rotation import cross, quat_conjugate, quat_half, quat_matrix, quat_product, se3_log
from ..mechanics.motion import Motion, Wrench
from .law import Relative


@dataclass(frozen=True)
class Intrinsic:
    """Spring-damper in the frame half way between the markers; indifferent to their order.

    Picture: the screw motion from marker 0 to marker 1 is halved; the spring sits in the middle.

        (v, th) = log of the SE(3) transformation from (A0, p0) to (A1, p1)
        Am = A0 exp(th / 2)
        displacement = v, rotation = th, velocity = Am' (v1 - v0), angular velocity = Am' (w1 - w0)
        (f, m) = K ([v; th] - offset) + D (velocities - velocity_offset), in Am

    Free bodies: marker 1 feels the force -Am f and the torque -(Am m) - T, marker 0 feels +Am f and
    +(Am m) - T, with T = (Am (-v/2)) x (Am f) [Exudyn, intrinsicFormulation].

    The net moment is zero only for small rotations (its error grows with angle^2/24); the law is
    neither conservative nor passive: a translational damper between two bodies that turn together
    feeds energy. Use `Consistent` where that counts.

    Limits: the rotation vector jumps at the relative angle pi.
    """

    needs_symmetric_stiffness: ClassVar[bool] = False
    turns_with_frames: ClassVar[bool] = True
    soft_axes_with_trouble: ClassVar[tuple[int, ...]] = ()

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Strain and rate in the middle frame, and how a force (6, 1) loads the markers."""
        R_AW = motion0.frame.R_WA.T
        q_AC = quat_product(quat_conjugate(motion0.frame.q_WA), motion1.frame.q_WA)
        p_AC = R_AW @ (motion1.frame.p_WA - motion0.frame.p_WA)
        displacement, rotation = se3_log(p_AC, q_AC)
        R_WM = motion0.frame.R_WA @ quat_matrix(quat_half(q_AC))
        velocity = R_WM.T @ (motion1.v_WA - motion0.v_WA)
        angular_velocity = R_WM.T @ (motion1.w_WA - motion0.w_WA)

        def transmit(force: ca.SX) -> tuple[Wrench, Wrench]:
            f, tau = R_WM @ force[:3], R_WM @ force[3:]
            arm = R_WM @ cross(-displacement / 2, force[:3])
            return Wrench(f, tau - arm), Wrench(-f, -tau - arm)

        return Relative(
            ca.vertcat(displacement, rotation), ca.vertcat(velocity, angular_velocity), transmit
        )
