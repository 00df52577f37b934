"""The law whose wrench is the derivative of an energy: right for every scene."""

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
    """Spring-damper with a potential; momentum, energy and frame-indifference hold exactly.

    Picture: the displacement is measured in the frame half way between the two markers, the
    rotation as a rotation vector; the wrench is what the energy stored in them demands.

        u = [Am' (p1 - p0); th] - offset,  Am = A0 exp(th / 2),  th = rotation vector of A0' A1
        U = u' K u / 2
        s = K u + D (u' - velocity_offset),  u' the time derivative of u
        wrench on marker i = -J_i' s,  J_i = derivative of u with respect to marker i's motion

    The derivative is taken by CasADi with respect to the relative motion in A0 (a translation and a
    turn of A1), and carried to the two markers as any internal wrench is: equal and opposite forces
    on one line of action. So the net moment vanishes for any K and D.

    All six physical tests hold: moment balance, marker order, closed-loop work, passivity of a
    positive semidefinite D, frame-indifference, isotropy. K must be symmetric.

    As a joint: a zero row frees its direction, about any axis. Limits: the rotation vector jumps at
    the relative angle pi.
    """

    needs_symmetric_stiffness: ClassVar[bool] = True
    turns_with_frames: ClassVar[bool] = True
    soft_axes_with_trouble: ClassVar[tuple[int, ...]] = ()

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Strain, its time derivative, and the wrenches -J' force on the markers."""
        R_WA = motion0.frame.R_WA
        lever = motion1.frame.p_WA - motion0.frame.p_WA
        p_AC = R_WA.T @ lever
        q_AC = quat_upper(quat_product(quat_conjugate(motion0.frame.q_WA), motion1.frame.q_WA))
        v_AC = R_WA.T @ (motion1.v_WA - motion0.v_WA - cross(motion0.w_WA, lever))
        w_AC_A = R_WA.T @ (motion1.w_WA - motion0.w_WA)

        step = ca.SX.sym("step", 6)  # a small motion of C in A: translation, then turn
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
