"""Named quantities with units: what can be asked of bodies, connectors and the scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from .mechanics import Body, angular_momentum, kinetic_energy, momentum
from .rotation import cross, dot3

_XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class Quantity:
    """A name, a unit, the names of its components, and how it is measured.

    `of_connectors` is the connector quantity whose sum over the scene the measure also gets.
    """

    name: str
    unit: str
    measure: Callable[[Any], ca.SX]
    components: tuple[str, ...] = ("",)
    shape: tuple[int, ...] = ()
    of_connectors: Quantity | None = None


class BodyView(NamedTuple):
    """What a body quantity is measured from."""

    body: Body
    mass: ca.SX
    inertia: ca.SX
    com: ca.SX
    start: ca.SX


def _vector(name: str, unit: str, measure: Callable[[Any], ca.SX]) -> Quantity:
    return Quantity(name, unit, measure, _XYZ, (3,))


def _position(view: BodyView) -> ca.SX:
    frame = view.body.motion.frame
    return frame.p_WA - frame.R_WA @ view.com


def _velocity(view: BodyView) -> ca.SX:
    return view.body.motion.v_WA - view.body.motion.frame.R_WA @ cross(view.body.w_WB_B, view.com)


def _quaternion(view: BodyView) -> ca.SX:
    q = view.body.motion.frame.q_WA
    return q / ca.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)


BODY_QUANTITIES = (
    _vector("position", "m", _position),
    Quantity(
        "rotation_matrix", "", lambda view: ca.vec(view.body.motion.frame.R_WA.T),
        tuple(a + b for a in _XYZ for b in _XYZ), (3, 3),
    ),
    Quantity("quaternion", "", _quaternion, ("w", *_XYZ), (4,)),
    _vector("velocity", "m/s", _velocity),
    _vector("angular_velocity", "rad/s", lambda view: view.body.w_WB_B),
    _vector("displacement", "m", lambda view: _position(view) - view.start),
    Quantity(
        "kinetic_energy", "J", lambda view: kinetic_energy(view.mass, view.inertia, view.body)
    ),
)  # fmt: skip
"""Of the body frame's origin, world axes; angular_velocity in body axes."""

# A connector quantity is measured from (response, rate of stored energy, power on the bodies).
POTENTIAL_ENERGY = Quantity("potential_energy", "J", lambda m: m[0].potential_energy)

CONNECTOR_QUANTITIES = (
    _vector("displacement_local", "m", lambda m: m[0].relative.strain[:3]),
    _vector("velocity_local", "m/s", lambda m: m[0].relative.rate[:3]),
    _vector("rotation", "rad", lambda m: m[0].relative.strain[3:]),
    _vector("angular_velocity_local", "rad/s", lambda m: m[0].relative.rate[3:]),
    _vector("force_local", "N", lambda m: m[0].force[:3]),
    _vector("torque_local", "N m", lambda m: m[0].force[3:]),
    _vector("force0", "N", lambda m: m[0].wrench0.f),
    _vector("torque0", "N m", lambda m: m[0].wrench0.tau),
    _vector("force1", "N", lambda m: m[0].wrench1.f),
    _vector("torque1", "N m", lambda m: m[0].wrench1.tau),
    POTENTIAL_ENERGY,
    Quantity("dissipated_power", "W", lambda m: m[0].dissipated_power),
    # What the connector gives beyond what it stores and dissipates: motors, driven offsets (by
    # TIME; Inputs count as held), and the faults of a law that has no potential.
    Quantity("injected_power", "W", lambda m: m[2] + m[1] + m[0].dissipated_power),
)


# A scene quantity is measured from (body views, gravity, sum of the connectors' stored energy).
def _energy(m: Any) -> ca.SX:
    views, gravity, stored = m
    total = stored
    for view in views:
        total = total + kinetic_energy(view.mass, view.inertia, view.body)
        total = total - view.mass * dot3(gravity, view.body.motion.frame.p_WA)
    return total


def _momentum(m: Any) -> ca.SX:
    return sum((momentum(view.mass, view.body) for view in m[0]), ca.SX.zeros(3))


def _angular_momentum(m: Any) -> ca.SX:
    return sum(
        (angular_momentum(view.mass, view.inertia, view.body) for view in m[0]), ca.SX.zeros(3)
    )


SCENE_QUANTITIES = (
    Quantity("energy", "J", _energy, of_connectors=POTENTIAL_ENERGY),
    _vector("momentum", "kg m/s", _momentum),
    _vector("angular_momentum", "kg m2/s", _angular_momentum),
)
"""energy: kinetic, stored in connectors, and potential in gravity (zero at the world origin);
angular_momentum: about the world origin."""
