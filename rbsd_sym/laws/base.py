"""What every law offers, and what a connector makes of it: force, wrenches, energies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca

from ..mechanics import Motion, Wrench


class Relative(NamedTuple):
    """Relative motion as a law sees it.

    Fields:
        strain: (6, 1) displacement (m) and rotation (rad), before any offset.
        rate: (6, 1) velocity (m/s) and angular velocity (rad/s) that the damper feels.
        transmit: force (6, 1) -> (wrench on marker 0, wrench on marker 1), at the markers.
    """

    strain: ca.SX
    rate: ca.SX
    transmit: Callable[[ca.SX], tuple[Wrench, Wrench]]


class Law(Protocol):
    """From the motion of two markers to strain, rate and wrenches. One file per law.

    A law is a frozen dataclass: equal laws share one kernel. `turns_with_frames` says that both
    joint frames may be turned by one rotation, with K, D and offsets turned along;
    `soft_axes_with_trouble` names the local rotation axes about which the law is no valid hinge.
    """

    needs_symmetric_stiffness: ClassVar[bool]
    turns_with_frames: ClassVar[bool]
    soft_axes_with_trouble: ClassVar[tuple[int, ...]]

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Strain and rate of the motion, and the way back from force to wrenches."""
        ...


class SpringDamper(NamedTuple):
    """K and D (6, 6), offset and velocity_offset (6, 1), user force or None."""

    stiffness: ca.SX
    damping: ca.SX
    offset: ca.SX
    velocity_offset: ca.SX
    user_force: Any = None


class Response(NamedTuple):
    """Everything a connector answers to the motion of its markers."""

    relative: Relative
    force: ca.SX
    wrench0: Wrench
    wrench1: Wrench
    potential_energy: ca.SX
    dissipated_power: ca.SX


def respond(
    law: Law, numbers: SpringDamper, t: ca.SX, motion0: Motion, motion1: Motion
) -> Response:
    """Force K (strain - offset) + D (rate - velocity_offset), or the user's, and its energies.

    With a user force no potential is known: stored energy and dissipation count as zero, and all
    of its power is injected power.
    """
    relative = law.relative(motion0, motion1)
    stretch = relative.strain - numbers.offset
    slip = relative.rate - numbers.velocity_offset
    energy, dissipated = ca.SX(0), ca.SX(0)
    if numbers.user_force is None:
        elastic, viscous = numbers.stiffness @ stretch, numbers.damping @ slip
        force = elastic + viscous
        energy, dissipated = ca.dot(stretch, elastic) / 2, ca.dot(slip, viscous)
    else:
        R_WA, R_WC = motion0.frame.R_WA, motion1.frame.R_WA
        force = numbers.user_force(t, relative.strain, relative.rate, R_WA, R_WC)
    wrench0, wrench1 = relative.transmit(force)
    return Response(relative, force, wrench0, wrench1, energy, dissipated)
