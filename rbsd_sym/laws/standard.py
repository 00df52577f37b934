"""The law that defines the element: strain measured in the joint frame of marker 0."""

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

        rs.RigidBodySpringDamper("mount", rs.Marker(rs.GROUND), rs.Marker("engine"), stiffness)

    Picture: a 6x6 spring is fixed to marker 0 and aligned with its axes; its other end pulls at
    marker 1.

    Free bodies: marker 1 receives the force -A0 f and the torque -A0 m, marker 0 receives +A0 f and
    +A0 m, each at its own marker. No torque balances the moment of f over the distance between the
    markers.

        displacement = A0' (p1 - p0)          velocity = A0' (v1 - v0)
        rotation = Tait-Bryan xyz of A0' A1   angular velocity = A0' (w1 - w0)
        (f, m) = K ([displacement; rotation] - offset) + D ([velocity; angular velocity]
                 - velocity_offset)

    p, v, w are positions, velocities and angular velocities of the markers in world components.
    This is the element as defined [Exudyn, ObjectConnectorRigidBodySpringDamper], including its
    defects: the net moment is not zero, the wrench depends on the order of the markers, and the
    work around a closed loop of poses is not zero. A positive semidefinite D only dissipates.

    As a joint: a zero row and column of K frees its direction, and the others, if stiff, hold. All
    three rotations free: a ball joint. Rotation about z free: a hinge about the local z. A
    translation free: a slider along an axis of marker 0, accurate if marker 0 is on the ground. A
    hinge about the local x is unstable (flutter), one about the local y ends at 90 degrees: turn
    the joint frame with `rotation_marker0` and `rotation_marker1`, or use `Consistent`.

    Choosing numbers: k is the load over the deflection that is acceptable, or m w^2 for a natural
    frequency w (rad/s) of the mass m that the mount carries; d = 2 zeta sqrt(k m) for a damping
    ratio zeta. For rotation take the moment of inertia about the joint for m. A stiffness far above
    what the deflection requires only costs steps.

    Limits: relative rotations must be small, unless about a single axis; the pitch (second angle)
    is singular at +-90 degrees.
    """

    needs_symmetric_stiffness: ClassVar[bool] = False
    turns_with_frames: ClassVar[bool] = False
    soft_axes_with_trouble: ClassVar[tuple[int, ...]] = (0, 1)

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Return strain and rate in A0, and the map from a force (6, 1) in A0 to marker wrenches.

        See `Law.relative`.
        """
        R_AW = motion0.frame.R_WA.T
        displacement = R_AW @ (motion1.frame.p_WA - motion0.frame.p_WA)
        rotation = matrix_xyz(R_AW @ motion1.frame.R_WA)
        # Not the derivative of the displacement, which would contain the rotation of A0: the
        # element is defined so, and the damper stays passive.
        velocity = R_AW @ (motion1.v_WA - motion0.v_WA)
        angular_velocity = R_AW @ (motion1.w_WA - motion0.w_WA)

        def transmit(force: ca.SX) -> tuple[Wrench, Wrench]:
            f, tau = R_AW.T @ force[:3], R_AW.T @ force[3:]
            return Wrench(f, tau), Wrench(-f, -tau)

        return Relative(
            ca.vertcat(displacement, rotation), ca.vertcat(velocity, angular_velocity), transmit
        )
