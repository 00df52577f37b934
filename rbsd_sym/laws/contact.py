"""Unilateral contact along one axis, and limit stops at both ends of a range."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from ..base.symbols import is_number
from .effect import Answer, Change, Effect, Own, Rule, Sight, value_at_default
from .smooth import ramp, ramp_integral, step_over_ramp

# Relative width over which the smooth push approaches zero when damping would make it pull.
_RELEASE = 0.1


@dataclass(frozen=True, eq=False)
class Contact(Effect):
    """Unilateral spring and damper along one axis: it pushes and never pulls.

        rs.RigidBodySpringDamper("floor", rs.Marker(rs.GROUND), rs.Marker("ball"), 0,
                                 effects=[rs.Contact(2, stiffness=1e5, damping=200)])

    Picture: a stop at a distance `gap` on one side. The depth is d = -gap - side strain, the push
    N = k d + c d' while d > 0 and N > 0, else 0.

    Free bodies: the force along the axis is -side N. With side +1 it drives marker 1 in the
    positive direction of the axis; marker 0 receives the opposite through the law of the connector.

    As a joint: with a large stiffness it is the limit stop of a slider or hinge (`stops`).

    Choosing numbers: a weight m g rests at the depth m g / k; an impact at speed v reaches v
    sqrt(m / k) without damping. The coefficient of restitution of an impact without gravity is
    exp(-2 z acos(z) / sqrt(1 - z^2)), z = c / (2 sqrt(k m)) < 1 [Schwager, Poeschel 2007], m the
    effective mass along the axis.

    Limits: contact along one axis of the connector, not between the surfaces of bodies. The form
    with events restarts the integrator at every closing and opening, so many short contacts are
    slow.

    Arguments:
        axis: 0, 1, 2 for translation along x, y, z of the joint frame; 3, 4, 5 for rotation.
        stiffness, damping: k and c, N/m and N s/m (or N m/rad and N m s/rad).
        gap: clearance at zero strain, m or rad.
        side: +1 if the stop is at negative strain (a floor), -1 if at positive strain (a ceiling).
        smoothing: 0 for the form with events. It has the data states `closed` (0 or 1) and `lost`,
            the energy (J) that the spring still held when contact ended. Otherwise the depth (m or
            rad) over which the push sets in, C2. The spring force is then off by at most 3/16 k
            smoothing, the damper by at most c |d'|. Damping can reduce the push to 0 but not below;
            near zero push this adds an error of at most 2 % of k d, which does not vanish with the
            smoothing.
        name: label within the connector; by default contact_<axis>.
    """

    axis: int
    stiffness: Any
    damping: Any = 0.0
    gap: Any = 0.0
    side: int = 1
    smoothing: float = 0.0
    name: str = ""
    rules: ClassVar[Mapping[str, Rule]] = {
        "stiffness": Rule("N/m", positive=True),
        "damping": Rule("N s/m"),
        "gap": Rule("m", signed=True),
    }

    def _check(self, where: str) -> None:
        if self.side not in (1, -1):
            raise ValueError(f"{where}: side {self.side!r}; give +1 (a floor) or -1 (a ceiling)")

    @property
    def own(self) -> tuple[Own, ...]:
        """With events `closed` and `lost`; none with smoothing."""
        return () if self.smoothing else (Own("closed", data=True), Own("lost", "J", data=True))

    def answer(self, sight: Sight) -> Answer:
        """Return the push, its energies, and the events that close and open the contact."""
        depth, speed = -self.gap - self.side * sight.strain, -self.side * sight.rate
        if self.smoothing:
            return self._smooth(depth, speed)
        closed, lost = sight.own[0] > 0.5, sight.own[1]
        # The push divided by k, so that both conditions for closing have the unit of the depth.
        push_depth = depth + self.damping / self.stiffness * speed
        push, stored = self.stiffness * push_depth, self.stiffness * depth**2 / 2
        # Contact begins once the depth and the push are both positive, and ends as the push
        # vanishes, which with damping is at a positive depth.
        touch = ca.if_else(closed, 1, -ca.fmin(depth, push_depth))
        leave = ca.if_else(closed, push_depth, 1)
        changes = (
            Change(
                "closes",
                touch,
                # A contact that closes at a depth, such as at the start, stores energy that was not
                # there before; `lost` pays for it, so that the energy account stays exact.
                ca.vertcat(1, lost - ca.fmax(depth, 0) * depth * self.stiffness / 2),
                at_once=True,
            ),
            Change("opens", leave, ca.vertcat(0, lost + stored), at_once=True),
        )
        return Answer(
            -self.side * closed * push,
            closed * stored,
            closed * self.damping * speed**2,
            ca.SX.zeros(2),
            changes,
        )

    def _smooth(self, depth: ca.SX, speed: ca.SX) -> Answer:
        """Return the push of the form without events."""
        w = self.smoothing
        spring = self.stiffness * ramp(depth, w)
        # spring * ratio = c d' step(d), the damper switched on over the same depth. The ramp of
        # 1 + ratio keeps spring + damper from becoming negative.
        ratio = self.damping / self.stiffness * speed * step_over_ramp(depth, w)
        damper = spring * (ramp(1 + ratio, _RELEASE) - 1)
        return Answer(
            -self.side * (spring + damper), self.stiffness * ramp_integral(depth, w), damper * speed
        )


def stops(
    axis: int,
    lower: Any,
    upper: Any,
    stiffness: Any,
    damping: Any = 0.0,
    smoothing: float = 0.0,
    name: str = "stop",
) -> tuple[Contact, Contact]:
    """Return the two limit stops of a range of strain, as two contacts.

        effects=rs.stops(5, lower=-0.5, upper=0.5, stiffness=1e4, damping=20)

    Arguments:
        axis, stiffness, damping, smoothing: as in `Contact`.
        lower, upper: strains at which the stops begin to push, m or rad.
        name: the contacts are called <name>_lower and <name>_upper.

    Raises:
        ValueError: the lower end is not below the upper one.
        TypeError: an end that is neither a number nor an expression.
    """
    for title, value in (("lower", lower), ("upper", upper)):
        if not is_number(value):
            raise TypeError(f"stops: {title} {value!r}; give a number, a Param or an expression")
    if value_at_default(lower) >= value_at_default(upper):
        raise ValueError(
            f"stops: lower {lower} is not below upper {upper}; exchange them, or move them apart"
        )
    return (
        Contact(axis, stiffness, damping, -lower, 1, smoothing, f"{name}_lower"),
        Contact(axis, stiffness, damping, upper, -1, smoothing, f"{name}_upper"),
    )
