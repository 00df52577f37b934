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
    """Spring-damper in the frame half way between the markers; independent of their order.

        rs.RigidBodySpringDamper("mount", marker0, marker1, stiffness, law=rs.Intrinsic())

    Picture: the screw motion that takes marker 0 to marker 1 is halved, and the spring sits in the
    middle.

    Free bodies: marker 1 receives the force -Am f and the torque -(Am m) - T, marker 0 receives +Am
    f and +(Am m) - T, with T = (Am (-v/2)) x (Am f) [Exudyn, intrinsicFormulation].

        (v, th) = log of the SE(3) transformation from (A0, p0) to (A1, p1)
        Am = A0 exp(th / 2)
        displacement = v, rotation = th, velocity = Am' (v1 - v0), angular velocity = Am' (w1 - w0)
        (f, m) = K ([v; th] - offset) + D (velocities - velocity_offset), components in Am

    As a joint: zero rows give a ball, hinge, slider, cylindrical or universal joint, about any
    axis.

    Choosing numbers: as for `Standard`.

    Limits: the net moment is zero only for small rotations (the error grows with angle^2 / 24). The
    law is neither conservative nor passive: a translational damper between two bodies that turn
    together increases their energy; use `Consistent` where energy counts. The rotation vector jumps
    at a relative angle of pi.
    """

    needs_symmetric_stiffness: ClassVar[bool] = False
    turns_with_frames: ClassVar[bool] = True
    soft_axes_with_trouble: ClassVar[tuple[int, ...]] = ()

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Return strain and rate in the middle frame, and the map from force to marker wrenches.

        See `Law.relative`.
        """
        R_AW = motion0.frame.R_WA.T
        q_AC = quat_product(quat_conjugate(motion0.frame.q_WA), motion1.frame.q_WA)
        p_AC = R_AW @ (motion1.frame.p_WA - motion0.frame.p_WA)
        displacement, rotation = se3_log(p_AC, q_AC)
        R_WM = motion0.frame.R_WA @ quat_matrix(quat_half(q_AC))
        # These rates are not conjugate to the wrench below with its balancing torques, so the
        # damper can feed energy.
        velocity = R_WM.T @ (motion1.v_WA - motion0.v_WA)
        angular_velocity = R_WM.T @ (motion1.w_WA - motion0.w_WA)

        def transmit(force: ca.SX) -> tuple[Wrench, Wrench]:
            f, tau = R_WM @ force[:3], R_WM @ force[3:]
            # Balancing torque of the force about each marker, with half of the lever; it uses v,
            # not the distance p1 - p0, which is why the moment balances for small rotations only.
            arm = R_WM @ cross(-displacement / 2, force[:3])
            return Wrench(f, tau - arm), Wrench(-f, -tau - arm)

        return Relative(
            ca.vertcat(displacement, rotation), ca.vertcat(velocity, angular_velocity), transmit
        )
