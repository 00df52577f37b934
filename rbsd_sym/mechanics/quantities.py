"""Named quantities with units that can be asked of bodies, connectors and the whole scene."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import casadi as ca

from ..base.rotation import cross, dot3
from .motion import Body, angular_momentum, kinetic_energy, momentum

_XYZ = ("x", "y", "z")


@dataclass(frozen=True)
class Quantity:
    """A quantity: name, unit, components, and the function that measures it.

    Arguments:
        name, unit: such as "velocity" and "m/s".
        measure: function of a `BodyView`, a `ConnectorView` or, for the scene, of (body views,
            gravity, sum over connectors), that returns a column.
        components: name of each entry of the column; ("",) for a scalar.
        shape: shape of the value at one time.
        of_connectors: for a quantity of the scene, the connector quantity whose sum it receives.
    """

    name: str
    unit: str
    measure: Callable[[Any], ca.SX]
    components: tuple[str, ...] = ("",)
    shape: tuple[int, ...] = ()
    of_connectors: Quantity | None = None


class BodyView(NamedTuple):
    """What a body quantity is computed from.

    Fields:
        body: motion of the body.
        mass, inertia: kg, and kg m2 about the centre of mass, body axes (3, 3).
        com: centre of mass in body axes, from the origin of the body frame, m.
        start: start position of the origin of the body frame, world axes, m.
    """

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
        "rotation_matrix",
        "",
        lambda view: ca.vec(view.body.motion.frame.R_WA.T),
        tuple(a + b for a in _XYZ for b in _XYZ),
        (3, 3),
    ),
    Quantity("quaternion", "", _quaternion, ("w", *_XYZ), (4,)),
    _vector("velocity", "m/s", _velocity),
    _vector("angular_velocity", "rad/s", lambda view: view.body.w_WB_B),
    _vector("displacement", "m", lambda view: _position(view) - view.start),
    Quantity(
        "kinetic_energy", "J", lambda view: kinetic_energy(view.mass, view.inertia, view.body)
    ),
)
"""Positions and velocities are those of the body frame's origin, in world axes; angular_velocity is
in body axes, rotation_matrix is R_WB row by row."""


class ConnectorView(NamedTuple):
    """What a connector quantity is computed from.

    Fields:
        response: strain, force, wrenches, energies (`laws.Response`).
        stored_rate: time derivative of the stored energy, W.
        given: power of the wrenches on the bodies, W.
        active: 1 where the connector acts, else 0.
        by_position, by_velocity: functions that return the derivatives (12, 12) of the wrenches
            [f0; tau0; f1; tau1] by small motions of the markers [p0; turn 0; p1; turn 1], and by
            their velocities.
    """

    response: Any  # laws.Response
    stored_rate: ca.SX
    given: ca.SX
    active: ca.SX
    by_position: Callable[[], ca.SX]
    by_velocity: Callable[[], ca.SX]


def _connector_vector(name: str, unit: str, measure: Callable[[Any], ca.SX]) -> Quantity:
    return _vector(name, unit, lambda view: measure(view.response))


_ROWS = [f"{kind}{end}{axis}" for end in "01" for kind in ("f", "tau") for axis in _XYZ]
_COLUMNS = [f"{kind}{end}{axis}" for end in "01" for kind in ("p", "turn") for axis in _XYZ]
_SQUARE = tuple(f"{row}_{column}" for row in _ROWS for column in _COLUMNS)

POTENTIAL_ENERGY = Quantity("potential_energy", "J", lambda view: view.response.potential_energy)

CONNECTOR_QUANTITIES = (
    _connector_vector("displacement_local", "m", lambda r: r.relative.strain[:3]),
    _connector_vector("velocity_local", "m/s", lambda r: r.relative.rate[:3]),
    _connector_vector("rotation", "rad", lambda r: r.relative.strain[3:]),
    _connector_vector("angular_velocity_local", "rad/s", lambda r: r.relative.rate[3:]),
    _connector_vector("force_local", "N", lambda r: r.force[:3]),
    _connector_vector("torque_local", "N m", lambda r: r.force[3:]),
    _connector_vector("force0", "N", lambda r: r.wrench0.f),
    _connector_vector("torque0", "N m", lambda r: r.wrench0.tau),
    _connector_vector("force1", "N", lambda r: r.wrench1.f),
    _connector_vector("torque1", "N m", lambda r: r.wrench1.tau),
    POTENTIAL_ENERGY,
    Quantity("dissipated_power", "W", lambda view: view.response.dissipated_power),
    # Power on the bodies beyond what is released from storage and dissipated: motors, offsets
    # driven by TIME (Inputs count as constant), and the defects of a law without a potential.
    Quantity(
        "injected_power",
        "W",
        lambda view: view.given + view.stored_rate + view.response.dissipated_power,
    ),
)

CONNECTOR_TANGENTS = (
    Quantity(
        "tangent_stiffness", "SI", lambda view: -ca.vec(view.by_position().T), _SQUARE, (12, 12)
    ),
    Quantity(
        "tangent_damping", "SI", lambda view: -ca.vec(view.by_velocity().T), _SQUARE, (12, 12)
    ),
)
"""Minus the derivatives of the wrenches on both markers, world axes (see `ConnectorView`), row by
row, so that a resisting spring is positive. Turns are small rotations about world axes."""

CONNECTOR_ACTIVE = Quantity("active", "", lambda view: view.active)

DOCUMENTED = {
    "DisplacementLocal": "displacement_local",
    "VelocityLocal": "velocity_local",
    "Rotation": "rotation",
    "AngularVelocityLocal": "angular_velocity_local",
    "ForceLocal": "force_local",
    "TorqueLocal": "torque_local",
    "activeConnector": CONNECTOR_ACTIVE.name,
}
"""Quantities of a connector by the names that the element's documentation gives them."""


@cache
def effect_force(index: int, name: str, unit: str) -> Quantity:
    """Return the quantity that is the force of effect number `index` along its axis."""
    return Quantity(name, unit, lambda view: view.response.answers[index].force)


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
