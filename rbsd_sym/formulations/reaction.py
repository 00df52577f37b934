"""What connectors of one kind do to their bodies, as kernels shared by all of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..base.symbols import TIME
from ..dae.members import RotationKind
from ..laws import Effect, Law, Relative, Response, SpringDamper, respond, while_on
from ..laws.effect import Change
from ..mechanics.motion import (
    Body,
    MarkerOnBody,
    Motion,
    Wrench,
    displaced,
    ground_motion,
    marker_motion,
    power,
    seen_from_first,
    torque_on_body,
)
from ..mechanics.quantities import ConnectorView, Quantity
from ..scene.scene import Functions
from .layout import Layout, accelerations, kernel
from .pack import ConnectorConstants, marker_of


@dataclass(frozen=True)
class Kind:
    """What two connectors must have in common to share their kernels.

    `places` says for each marker which of the connector's bodies carries it, None for the ground;
    `effects` are the structures of the effects; `active` is None where a number decides, and
    `switches` says that events do, by the last of its own states.
    """

    law: Law
    places: tuple[int | None, int | None]
    functions: Functions
    effects: tuple[Any, ...]
    n_data: int
    active: bool | None
    switches: bool

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
    bodies: list[Body]


@dataclass(frozen=True, eq=False)
class Reaction:
    """Kernels of connectors of one kind, over the states x of their bodies and their own.

    Arguments:
        effects: of one of them, for their structure.
        example: constants of one of them, for their sizes.
    """

    kind: Kind
    layout: Layout
    effects: tuple[Effect, ...]
    example: ConnectorConstants

    @cached_property
    def x(self) -> ca.SX:
        """States of the bodies, then its own."""
        return ca.SX.sym("x", self.n_body_rows + self.n_own)

    @property
    def n_body_rows(self) -> int:
        """Rows of the bodies."""
        return self.kind.n_bodies * self.layout.size

    @property
    def n_own(self) -> int:
        """Its data and internal states."""
        of_effects = sum(len(effect.own) for effect in self.effects)
        return self.kind.n_data + of_effects + self.kind.switches

    @cached_property
    def z(self) -> ca.SX:
        """Its unknown forces."""
        return ca.SX.sym("z", sum(len(effect.unknowns) for effect in self.effects))

    @cached_property
    def c(self) -> ca.SX:
        """Column of its constants."""
        return ca.SX.sym("c", self.example.column.numel())

    @cached_property
    def constants(self) -> ConnectorConstants:
        """Its constants by name."""
        return self.example.over(self.c)

    @property
    def own(self) -> ca.SX:
        """Its data and internal states."""
        return self.x[self.n_body_rows :]

    @cached_property
    def bodies(self) -> list[Body]:
        """Its bodies."""
        return [self.layout.body(part) for part in self.layout.split(self.x[: self.n_body_rows])]

    @cached_property
    def _on(self) -> ca.SX | None:
        """Condition under which the connector acts; None if it never changes."""
        if self.kind.active is not None:
            return None
        return (self.own[-1] if self.kind.switches else self.constants.active) > 0.5

    def _leaves(self, name: str) -> ca.SX:
        """Values of the symbols that a user function uses."""
        return self.constants.functions[Functions._fields.index(name)]

    def _bound(self) -> tuple[Effect, ...]:
        """The effects with symbols for their numbers."""
        pairs = zip(self.effects, self.constants.effects, strict=True)
        return tuple(effect.bound(numbers) for effect, numbers in pairs)

    def see(self, bodies: list[Body]) -> _Sight:
        """The connector with its bodies in any axes."""
        kind, c = self.kind, self.constants
        markers = [marker_of(column) for column in c.markers]
        motions = [
            ground_motion(marker) if place is None else marker_motion(bodies[place], marker)
            for marker, place in zip(markers, kind.places, strict=True)
        ]
        user, force = None, kind.functions.force
        if force is not None:
            user = lambda *given: force.function(*given, self._leaves("force"))  # noqa: E731
        numbers = SpringDamper(
            ca.reshape(c.stiffness, 6, 6),
            ca.reshape(c.damping, 6, 6),
            c.offset,
            c.velocity_offset,
            user,
            self._bound(),
            self.own,
            self.z,
            kind.n_data,
            self._gives,
            self._on,
        )
        answer = partial(respond, kind.law, numbers, TIME.expr)
        return _Sight(answer(*motions), answer, markers, motions, bodies)

    @cached_property
    def _sight(self) -> _Sight:
        return self.see(self.bodies)

    def accelerate(self, sight: _Sight, wrenches: tuple[Wrench, Wrench], R_WE: ca.SX) -> ca.SX:
        """What wrenches on its markers give its bodies: (v', w') of each.

        Arguments:
            R_WE: from the axes of the wrenches to the world's.
        """
        rates = [ca.SX.zeros(6)] * len(sight.bodies)
        f0_W = R_WE @ wrenches[0].f
        opposite = ca.is_equal(wrenches[1].f, -wrenches[0].f, 2)
        forces = (f0_W, -f0_W if opposite else R_WE @ wrenches[1].f)
        for i, place in enumerate(self.kind.places):
            if place is not None:
                torque = torque_on_body(sight.bodies[place], sight.markers[i].p_BA, wrenches[i])
                compliance = self.constants.compliances[place]
                rates[place] += accelerations(forces[i], torque, compliance)
        return ca.vertcat(*rates)

    def _impulse(self, force: ca.SX, relative: Relative) -> ca.SX:
        """Change of the bodies' velocities by an impulse (6, 1) in the axes of the force."""
        markers = [marker_of(column) for column in self.constants.markers]
        sight = _Sight(None, None, markers, [], self.bodies)  # type: ignore[arg-type]
        return self.accelerate(sight, relative.transmit(force), ca.SX.eye(3))

    def _gives(self, relative: Relative, axis: int) -> ca.SX:
        """How much the rate along an axis falls for a unit impulse."""
        unit = ca.SX(6, 1)
        unit[axis] = 1
        return -ca.jtimes(
            relative.rate[axis], self.x, self._on_velocities(self._impulse(unit, relative))
        )

    def _on_velocities(self, change: ca.SX) -> ca.SX:
        """A change of velocities as one of all of x."""
        parts = [
            part
            for body in ca.vertsplit(change, 6)
            for part in (ca.SX.zeros(self.layout.size - 6), body)
        ]
        return ca.vertcat(*parts, ca.SX.zeros(self.n_own)) if change.numel() else 0 * self.x

    def rates(self) -> ca.Function:
        """(accelerations of its bodies, rates of its own states; equations of its unknowns)."""
        bodies, R_WE = self.bodies, ca.SX.eye(3)
        # A user may look at the world's axes, and an impulse is worked out there.
        if len(bodies) == 2 and self.kind.functions.force is None and not self.effects:
            R_WE = bodies[0].motion.frame.R_WA
            bodies = seen_from_first(
                bodies[0], bodies[1], self.layout.coordinates.kind is RotationKind.quaternion
            )
        sight = self.see(bodies)
        response = sight.response
        rates = self.accelerate(sight, (response.wrench0, response.wrench1), R_WE)
        equations = (answer.equation for answer in response.answers)
        return kernel(
            "connector",
            self.x,
            self.c,
            ca.vertcat(rates, self._own_rates(response)),
            ca.vertcat(ca.SX(0, 1), *equations),
            z=self.z,
        )

    def _own_rates(self, response: Response) -> ca.SX:
        still = ca.SX.zeros(self.kind.n_data), ca.SX.zeros(int(self.kind.switches))
        return ca.vertcat(still[0], *(a.rates for a in response.answers), still[1])

    def hold(self, index: int) -> ca.Function:
        """(rate that effect `index` holds, weight of its derivative in the equation)."""
        sight = self._sight
        axis = self.effects[index].axis  # type: ignore[attr-defined]
        rate = sight.response.relative.rate[axis]
        driven = getattr(self._bound()[index], "velocity", 0)
        held = sight.response.answers[index].held
        return kernel("hold", self.x, self.c, rate - driven, held, z=self.z)

    def change(self, index: int, change: Change) -> ca.Function:
        """(zero function, change of velocities and own states) of an event of effect `index`."""
        relative, effects = self._sight.response.relative, self.effects
        first = self.kind.n_data + sum(len(effect.own) for effect in effects[:index])
        own = ca.SX.zeros(self.n_own)
        last, zero = first + len(effects[index].own), change.zero
        own[first:last] = change.own - self.own[first:last]
        impulse = ca.SX.zeros(6)
        if not change.impulse.is_zero():
            left = self._left(index)  # what is broken throws nothing
            zero, own = ca.if_else(left > 0, zero, 1), left * own
            impulse[effects[index].axis] = left * change.impulse  # type: ignore[attr-defined]
        jump = ca.vertcat(self._impulse(impulse, relative), own)
        return self._event(zero, jump)

    def _event(self, zero: ca.SX, jump: ca.SX) -> ca.Function:
        """An event, which does not happen while the connector is off."""
        zero, jump = while_on(self._on, zero, 1), while_on(self._on, jump)
        return kernel("event", self.x, self.c, zero, jump, z=self.z)

    def _left(self, index: int) -> ca.SX:
        """What later effects leave of the wrench of effect `index`, 0 ... 1."""
        left = ca.SX(1)
        for effect, answer in list(zip(self.effects, self._sight.response.answers, strict=True))[
            index + 1 :
        ]:
            if effect.whole:
                left = left * answer.factor
        return left

    def changes(self) -> list[tuple[int, Change]]:
        """The events of its effects, each with the index of its effect."""
        answers = self._sight.response.answers
        return [(i, change) for i, answer in enumerate(answers) for change in answer.changes]

    def _user(self, name: str) -> ca.SX:
        """Result of a user function that is given the data."""
        relative = self._sight.response.relative
        frames = [motion.frame.R_WA for motion in self._sight.motions]
        function = getattr(self.kind.functions, name).function
        data = self.own[: self.kind.n_data]
        return function(
            TIME.expr, relative.strain, relative.rate, *frames, data, self._leaves(name)
        )

    def switch(self) -> ca.Function:
        """(zero function, change of velocities and own states) where it is switched on or off.

        It is one event, which must cross back before it can fire again: of two, for on and for off,
        each would see what the other has just left a rounding beyond zero.
        """
        on, active = self._on, self.constants.active
        zero = ca.if_else(on, active - np.nextafter(0.5, 1), 0.5 - active)  # 0.5 itself is off
        change = ca.SX.zeros(6 * self.kind.n_bodies + self.n_own)
        change[-1] = ca.if_else(on, 0, 1) - self.own[-1]
        return kernel("switch", self.x, self.c, zero, change, z=self.z)

    def user_event(self, first: int) -> ca.Function:
        """(zero function, change of velocities and own states) of a user's event."""
        n, relative = self.kind.n_data, self._sight.response.relative
        block = self._user("events")[first : first + 7 + n]
        own = ca.SX.zeros(self.n_own)
        if n:
            own[:n] = block[7:] - self.own[:n]
        jump = ca.vertcat(self._impulse(block[1:7], relative), own)
        return self._event(block[0], jump)

    def update(self) -> ca.Function:
        """(error, recommended step, new data) of the user's post_newton_step."""
        block = self._user("post_newton")
        still = ca.vertcat(0, -1, self.own[: self.kind.n_data])
        block = while_on(self._on, block, still)
        return kernel("post_newton", self.x, self.c, block[0], block[1], block[2:], z=self.z)

    def measure(self, quantity: Quantity) -> ca.Function:
        """A quantity, from the constants and their explicit time derivative."""
        sight, x = self._sight, self.x
        response, motions = sight.response, sight.motions
        split = self.layout.split(x[: self.n_body_rows])
        rates = [*(self.layout.kinematic_rates(part) for part in split), self._own_rates(response)]
        c_rate = ca.SX.sym("c_rate", self.c.numel())
        energy = response.potential_energy
        stored_rate = ca.jtimes(energy, self.c, c_rate)
        if x.numel():
            stored_rate += ca.jtimes(energy, x, ca.vertcat(*rates))
        given = power(response.wrench0, motions[0]) + power(response.wrench1, motions[1])
        active = ca.SX(self.kind.active) if self._on is None else self._on
        tangents = (partial(_tangent, sight, held) for held in (False, True))
        value = quantity.measure(ConnectorView(response, stored_rate, given, active, *tangents))
        return kernel(quantity.name, x, ca.vertcat(self.c, c_rate), value, z=self.z)


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
