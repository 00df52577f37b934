"""The law the element is named for: components in the joint frame of marker 0."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from ..base.rotation import matrix_xyz
from ..mechanics.motion import Motion, Wrench
from .law import Relative


@dataclass(frozen=True)
class Standard:
    """Spring-damper between two markers, measured in the joint frame A0 of marker 0.

    Picture: a 6x6 spring sits on marker 0, with its axes; it pulls on marker 1.

        displacement = A0' (p1 - p0)          velocity = A0' (v1 - v0)
        rotation = Tait-Bryan xyz of A0' A1   angular velocity = A0' (w1 - w0)
        (f, m) = K ([displacement; rotation] - offset) + D ([velocity; angular velocity]
                 - velocity_offset)

    Free bodies: marker 1 feels the force -A0 f and the torque -A0 m, marker 0 feels +A0 f and
    +A0 m, each at its own marker. No balancing moment for the distance between the markers. That is
    the element as defined [Exudyn, ObjectConnectorRigidBodySpringDamper], faults included: the net
    moment is not zero, the wrench depends on the order of the markers, and work round a closed loop
    of poses is not zero. Dampers alone dissipate.

    As a joint: a zero (or soft) row frees its direction. A hinge is valid only about the local z
    axis; about x it flutters, about y it ends at 90 degrees. Turn the joint frame with
    `rotation_marker0` and `rotation_marker1`, or use `Consistent`.

    Limits: small relative rotations unless about one axis; the pitch (second angle) is singular at
    +-90 degrees.
    """

    needs_symmetric_stiffness: ClassVar[bool] = False
    turns_with_frames: ClassVar[bool] = False
    soft_axes_with_trouble: ClassVar[tuple[int, ...]] = (0, 1)

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Strain and rate in A0, and how a force (6, 1) on them loads the markers."""
        R_AW = motion0.frame.R_WA.T
        displacement = R_AW @ (motion1.frame.p_WA - motion0.frame.p_WA)
        rotation = matrix_xyz(R_AW @ motion1.frame.R_WA)
        velocity = R_AW @ (motion1.v_WA - motion0.v_WA)
        angular_velocity = R_AW @ (motion1.w_WA - motion0.w_WA)

        def transmit(force: ca.SX) -> tuple[Wrench, Wrench]:
            f, tau = R_AW.T @ force[:3], R_AW.T @ force[3:]
            return Wrench(f, tau), Wrench(-f, -tau)

        return Relative(
            ca.vertcat(displacement, rotation), ca.vertcat(velocity, angular_velocity), transmit
        )
