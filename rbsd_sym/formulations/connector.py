"""The kernels of connectors: one for each kind, shared by all connectors of that kind."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import casadi as ca

from ..dae import Part
from ..elements import GROUND, RigidBodySpringDamper
from ..laws import Law, Response, SpringDamper, respond
from ..mechanics import (
    Body,
    MarkerOnBody,
    Motion,
    displaced,
    ground_motion,
    marker_motion,
    power,
    seen_from_first,
    torque_on_body,
)
from ..sensors import ConnectorView, Quantity
from ..symbols import TIME, to_expr
from ..user_force import TracedForce
from .columns import COMPLIANCE, MARKER, compliance_column, marker_column, marker_of
from .layout import Layout, accelerations, kernel

_NUMBERS = 84  # K (36), D (36), offset (6), velocity_offset (6)


@dataclass(frozen=True)
class Kind:
    """What two connectors must have in common to share a kernel.

    `places` says for each marker which of the connector's bodies carries it, None for the ground.
    """

    law: Law
    places: tuple[int | None, int | None]
    force: TracedForce | None

    @property
    def n_bodies(self) -> int:
        """Number of moving bodies the connector touches: 0, 1 or 2."""
        return len({place for place in self.places if place is not None})


class _Sight(NamedTuple):
    """What a kernel sees of its connector; `respond` answers to other motions of its markers."""

    response: Response
    respond: Callable[..., Response]
    markers: list[MarkerOnBody]
    motions: list[Motion]


@dataclass(frozen=True, eq=False)
class ConnectorWriter:
    """One connector of a scene as part and as outputs; kernels are kept in the shared cache."""

    layout: Layout
    index: int
    cache: dict[Hashable, ca.Function]

    @property
    def connector(self) -> RigidBodySpringDamper:
        """The element."""
        return self.layout.scene.connectors[self.index]

    @cached_property
    def carriers(self) -> list[int]:
        """Indices of the bodies it touches."""
        return self.layout.carriers(self.connector.marker0, self.connector.marker1)

    @cached_property
    def reads(self) -> tuple[int, ...]:
        """Rows of the states it reads."""
        return tuple(row for i in self.carriers for row in self.layout.rows(i))

    @cached_property
    def kind(self) -> Kind:
        """Law, places and user force."""
        places = tuple(
            None if m.body == GROUND else self.carriers.index(self.layout.index(m.body))
            for m in (self.connector.marker0, self.connector.marker1)
        )
        force = self.layout.scene.traced[self.index]
        return Kind(self.connector.law, (places[0], places[1]), force)

    @cached_property
    def constants(self) -> ca.SX:
        """Markers, numbers, compliance of the bodies, symbols of the user force."""
        connector, bodies = self.connector, [self.layout.scene.bodies[i] for i in self.carriers]
        columns = []
        for m, place, joint in zip(
            (connector.marker0, connector.marker1), self.kind.places,
            (connector.rotation_marker0, connector.rotation_marker1), strict=True,
        ):  # fmt: skip
            columns.append(marker_column(m, None if place is None else bodies[place], joint))
        acting = 1.0 if connector.active else 0.0
        columns += [
            ca.vec(acting * to_expr(connector.stiffness)),
            ca.vec(acting * to_expr(connector.damping)),
            to_expr(connector.offset),
            to_expr(connector.velocity_offset),
        ]
        columns += [compliance_column(body) for body in bodies]
        columns += [self.kind.force.values] if self.kind.force else []
        return ca.vertcat(*columns)

    def part(self) -> Part:
        """Its contribution to the accelerations of its bodies."""
        rows = tuple(row for i in self.carriers for row in self.layout.velocity_rows(i))
        return Part(self.connector.name, self._shared(None), self.reads, (), self.constants, rows)

    def measure(self, quantity: Quantity) -> tuple[ca.Function, ca.SX]:
        """Kernel and constants of a quantity: the constants and their explicit time derivative."""
        rates = ca.jacobian(self.constants, TIME.expr)
        return self._shared(quantity), ca.densify(ca.vertcat(self.constants, rates))

    def _shared(self, quantity: Quantity | None) -> ca.Function:
        key = (self.kind, quantity)
        if key not in self.cache:
            x = ca.SX.sym("x", self.kind.n_bodies * self.layout.size)
            c = ca.SX.sym("c", self.constants.numel())
            self.cache[key] = (
                self._build_measure(x, c, quantity) if quantity else self._build_rates(x, c)
            )
        return self.cache[key]

    def _see(self, c: ca.SX, bodies: list[Body]) -> _Sight:
        kind, k = self.kind, 2 * MARKER
        markers = [marker_of(c[:MARKER]), marker_of(c[MARKER:k])]
        motions = [
            ground_motion(marker) if place is None else marker_motion(bodies[place], marker)
            for marker, place in zip(markers, kind.places, strict=True)
        ]
        user = None
        if kind.force is not None:
            function, leaves = kind.force.function, c[k + _NUMBERS + COMPLIANCE * kind.n_bodies :]
            user = lambda *arguments: function(*arguments, leaves)  # noqa: E731
        numbers = SpringDamper(
            ca.reshape(c[k : k + 36], 6, 6), ca.reshape(c[k + 36 : k + 72], 6, 6),
            c[k + 72 : k + 78], c[k + 78 : k + 84], user,
        )  # fmt: skip
        answer = partial(respond, kind.law, numbers, TIME.expr)
        return _Sight(answer(*motions), answer, markers, motions)

    def _build_rates(self, x: ca.SX, c: ca.SX) -> ca.Function:
        bodies, R_WE = [self.layout.body(part) for part in self.layout.split(x)], ca.SX.eye(3)
        if len(bodies) == 2 and self.kind.force is None:  # a user may look at the world's axes
            R_WE = bodies[0].motion.frame.R_WA
            bodies = seen_from_first(bodies[0], bodies[1], self.layout.coordinates.quaternion)
        sight, first = self._see(c, bodies), 2 * MARKER + _NUMBERS
        wrenches = (sight.response.wrench0, sight.response.wrench1)
        f0_W = R_WE @ wrenches[0].f
        opposite = ca.is_equal(wrenches[1].f, -wrenches[0].f, 2)
        forces = (f0_W, -f0_W if opposite else R_WE @ wrenches[1].f)
        rates = [ca.SX.zeros(6)] * len(bodies)
        for i, place in enumerate(self.kind.places):
            if place is not None:
                compliance = c[first + COMPLIANCE * place : first + COMPLIANCE * (place + 1)]
                torque = torque_on_body(bodies[place], sight.markers[i].p_BA, wrenches[i])
                rates[place] += accelerations(forces[i], torque, compliance)
        return kernel("connector", x, c, ca.vertcat(*rates), ca.SX(0, 1))

    def _build_measure(self, x: ca.SX, c: ca.SX, quantity: Quantity) -> ca.Function:
        sight = self._see(c, [self.layout.body(part) for part in self.layout.split(x)])
        response, motions = sight.response, sight.motions
        parts = [self.layout.kinematic_rates(part) for part in self.layout.split(x)]
        c_rate = ca.SX.sym("c_rate", c.numel())
        energy = response.potential_energy
        stored_rate = ca.jtimes(energy, c, c_rate)
        if parts:
            stored_rate += ca.jtimes(energy, x, ca.vertcat(*parts))
        given = power(response.wrench0, motions[0]) + power(response.wrench1, motions[1])
        tangents = (partial(_tangent, sight, held) for held in (False, True))
        value = quantity.measure(ConnectorView(response, stored_rate, given, *tangents))
        return kernel(quantity.name, x, ca.vertcat(c, c_rate), value)


def _tangent(sight: _Sight, velocities: bool) -> ca.SX:
    """Derivative (12, 12) of the wrenches by the markers' small motions, or by their velocities."""
    step, still = ca.SX.sym("step", 12), ca.SX.zeros(6)
    moved = [
        displaced(motion, *((still, part) if velocities else (part, still)))
        for motion, part in zip(sight.motions, (step[:6], step[6:]), strict=True)
    ]
    response = sight.respond(*moved)
    wrenches = ca.vertcat(*response.wrench0, *response.wrench1)
    return ca.densify(ca.substitute(ca.jacobian(wrenches, step), step, ca.SX.zeros(12)))
