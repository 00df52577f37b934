"""Connectors of a scene as parts, events and outputs; those of one kind share their kernels."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca

from ..base.names import joined
from ..base.symbols import TIME, to_expr
from ..dae.members import Hold, Label, Part, Transition, Update
from ..mechanics.quantities import (
    CONNECTOR_ACTIVE,
    CONNECTOR_QUANTITIES,
    CONNECTOR_TANGENTS,
    Quantity,
    effect_force,
)
from ..scene.elements import GROUND, RigidBodySpringDamper
from .layout import Layout
from .pack import (
    ConnectorConstants,
    axes_without_inertia,
    compliance_column,
    has_mass,
    marker_column,
)
from .reaction import Kind, Reaction


@dataclass(frozen=True, eq=False)
class ConnectorWriter:
    """Writes one connector of a scene as members of a `Dae`.

    Arguments:
        layout: rows and coordinates of the scene.
        index: which connector of the scene.
        cache: kernels by kind and purpose, shared by all connectors of the scene.
    """

    layout: Layout
    index: int
    cache: dict[Hashable, Any]

    @property
    def connector(self) -> RigidBodySpringDamper:
        """The element in the scene."""
        return self.layout.scene.connectors[self.index]

    @cached_property
    def carriers(self) -> list[int]:
        """Indices of the moving bodies it touches."""
        return self.layout.carriers(self.connector.marker0, self.connector.marker1)

    @cached_property
    def reads(self) -> tuple[int, ...]:
        """Rows of the states it reads: those of its bodies, then its own."""
        return (*(row for i in self.carriers for row in self.layout.rows(i)), *self.own_rows)

    @property
    def own_rows(self) -> tuple[int, ...]:
        """Rows of its data and internal states."""
        return self.layout.own_rows(self.index)

    @property
    def reads_z(self) -> tuple[int, ...]:
        """Rows of its unknown forces in z."""
        return self.layout.unknown_rows(self.index)

    @property
    def labels(self) -> list[Label]:
        """Labels of its own states."""
        name = self.connector.name
        return [Label(name, o.name, "", o.unit, o.start, o.data) for o in self.connector.own]

    @property
    def unknowns(self) -> list[Label]:
        """Labels of its unknown forces."""
        return [Label(self.connector.name, o.name, "", o.unit) for o in self.connector.unknowns]

    @property
    def quantities(self) -> list[Quantity]:
        """Quantities that can be asked of it; those of every connector, and each effect's force."""
        forces = [
            effect_force(i, effect.label, "N m" if effect.axis > 2 else "N")
            for i, effect in enumerate(self._effects)
            if not effect.whole
        ]
        return [*CONNECTOR_QUANTITIES, *CONNECTOR_TANGENTS, CONNECTOR_ACTIVE, *forces]

    @cached_property
    def kind(self) -> Kind:
        """What it must have in common with another connector to share kernels."""
        # Bodies are numbered within the connector, so that connectors between different bodies can
        # be of one kind.
        places = tuple(
            None if m.body == GROUND else self.carriers.index(self.layout.index(m.body))
            for m in (self.connector.marker0, self.connector.marker1)
        )
        structures = tuple(effect.structure for effect in self._effects)
        return Kind(
            self.connector.law,
            (places[0], places[1]),
            self.layout.scene.traced[self.index],
            structures,
            len(self.connector.data) if self.connector.acts else 0,
            None if self.connector.switched else self.connector.active,
            self.connector.acts and self.connector.switches,
        )

    @property
    def _effects(self) -> tuple[Any, ...]:
        return tuple(self.connector.effects) if self.connector.acts else ()

    @cached_property
    def _named(self) -> ConnectorConstants:
        connector, bodies = self.connector, [self.layout.scene.bodies[i] for i in self.carriers]
        markers = zip(
            (connector.marker0, connector.marker1),
            self.kind.places,
            (connector.rotation_marker0, connector.rotation_marker1),
            strict=True,
        )
        # A connector that never acts has outputs, but no stiffness and no part.
        acting = 0.0 if connector.idle else 1.0
        return ConnectorConstants(
            tuple(
                marker_column(marker, None if place is None else bodies[place], joint)
                for marker, place, joint in markers
            ),
            ca.vec(acting * to_expr(connector.stiffness)),
            ca.vec(acting * to_expr(connector.damping)),
            to_expr(connector.offset),
            to_expr(connector.velocity_offset),
            tuple(compliance_column(body) for body in bodies),
            to_expr(connector.active) if connector.switched else ca.SX(0, 1),
            tuple(traced.values if traced else ca.SX(0, 1) for traced in self.kind.functions),
            tuple(effect.column for effect in self._effects),
        )

    @cached_property
    def constants(self) -> ca.SX:
        """Column of its constants (n, 1), in the order of `ConnectorConstants`."""
        return self._named.column

    @property
    def reaction(self) -> Reaction:
        """The kernels of its kind."""
        key = ("reaction", self.kind)
        if key not in self.cache:
            self.cache[key] = Reaction(self.kind, self.layout, self._effects, self._named)
        return self.cache[key]

    @property
    def _changes(self) -> tuple[int, ...]:
        """Rows that its events may change: velocities of its bodies, and its own states."""
        velocities = (row for i in self.carriers for row in self.layout.velocity_rows(i))
        return (*velocities, *self.own_rows)

    @property
    def _place(self) -> tuple[tuple[int, ...], tuple[int, ...], ca.SX]:
        return self.reads, self.reads_z, self.constants

    def part(self) -> Part:
        """Return its contribution to its bodies' accelerations and its own states' rates."""
        kernel = self._kept("rates", lambda: self.reaction.rates())
        return Part(self.connector.name, kernel, *self._place, self._changes, self.reads_z)

    def holds(self) -> list[Hold]:
        """Return the quantities that its effects keep constant, such as a sticking velocity.

        Raises:
            ValueError: an effect holds or hits a body without inertia.
        """
        self._check_inertia()
        found: list[Hold] = []
        for i, effect in enumerate(self._effects):
            if effect.unknowns:
                kernel = self._kept(("hold", i), partial(self.reaction.hold, i))
                row = self.reads_z[len(found)]
                name = joined(self.connector.name, effect.label)
                found.append(Hold(name, kernel, *self._place, row))
        return found

    def _check_inertia(self) -> None:
        traced = self.kind.functions.events
        acting = [f"{e.label} stops or throws" for e in self._effects if e.impulsive]
        acting += [f"{e.name} throws" for e in (traced.events if traced else ()) if e.throws]
        for body in (self.layout.scene.bodies[i] for i in self.carriers):
            if acting and (not has_mass(body) or axes_without_inertia(body)):
                raise ValueError(
                    f"connector '{self.connector.name}': {acting[0]} body "
                    f"'{body.name}', which lacks mass or inertia; give it some, or use a form with "
                    "smoothing"
                )

    def events(self) -> list[Transition]:
        """Return its switching on and off, its effects' events in order, then those of the user.

        Raises:
            ValueError: two events have the same name.
        """
        name, found, names = self.connector.name, list[Transition](), list[str]()
        if self.kind.switches:
            kernel = self._kept("switch", lambda: self.reaction.switch())
            names.append("switches")
            label = joined(name, names[-1])
            found.append(Transition(label, kernel, *self._place, self._changes, at_once=True))
        for k, (i, change) in enumerate(self.reaction.changes()):
            kernel = self._kept(("event", k), partial(self.reaction.change, i, change))
            names.append(f"{self._effects[i].label}_{change.name}")
            label = joined(name, names[-1])
            found.append(Transition(label, kernel, *self._place, self._changes, change.at_once))
        traced = self.kind.functions.events
        for event in traced.events if traced else ():
            first = event.first
            kernel = self._kept(("user event", first), partial(self.reaction.user_event, first))
            names.append(event.name)
            label = joined(name, event.name)
            found.append(
                Transition(label, kernel, *self._place, self._changes, event.at_once, event.stops)
            )
        if len(set(names)) < len(names):
            raise ValueError(
                f"connector '{name}', events: {', '.join(names)}; give them different names"
            )
        return found

    def updates(self) -> list[Update]:
        """Return the user's post_newton_step as an update; nothing if there is none."""
        if self.kind.functions.post_newton is None:
            return []
        kernel = self._kept("update", lambda: self.reaction.update())
        rows = self.own_rows[: self.kind.n_data]
        return [Update(self.connector.name, kernel, *self._place, rows)]

    def measure(self, quantity: Quantity) -> tuple[ca.Function, ca.SX]:
        """Return kernel and constants of a quantity.

        The constants are those of the connector, followed by their explicit time derivatives.
        """
        rates = ca.jacobian(self.constants, TIME.expr)
        kernel = self._kept(quantity, lambda: self.reaction.measure(quantity))
        return kernel, ca.densify(ca.vertcat(self.constants, rates))

    def _kept(self, key: Hashable, build: Callable[[], ca.Function]) -> ca.Function:
        key = (self.kind, key)
        if key not in self.cache:
            self.cache[key] = build()
        return self.cache[key]
