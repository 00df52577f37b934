"""What connectors of one kind exert on their bodies, as kernels that all of them share."""

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

    Fields:
        law: the law.
        places: for each marker the index, among the connector's bodies, of the one that carries it;
            None for the ground.
        functions: the traced user functions.
        effects: structures of the effects (`Effect.structure`).
        n_data: number of data states of the connector itself.
        active: whether the connector acts, if that never changes; None if an expression decides.
        switches: whether events follow that expression, by the last of the own states.
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
        """Number of moving bodies that the connector touches: 0, 1 or 2."""
        return len({place for place in self.places if place is not None})


class _Evaluation(NamedTuple):
    """A connector evaluated for given motions of its bodies.

    Fields:
        response: force, wrenches and energies.
        respond: function that returns the response to other motions of the markers.
        markers, motions: the two markers on their bodies, and their motions.
        bodies: the moving bodies, one or two.
    """

    response: Response
    respond: Callable[..., Response]
    markers: list[MarkerOnBody]
    motions: list[Motion]
    bodies: list[Body]


@dataclass(frozen=True, eq=False)
class Reaction:
    """Kernels of the connectors of one kind, over x: the states of their bodies, then their own.

    Arguments:
        kind: what the connectors have in common.
        layout: rows and coordinates of the scene.
        effects: the effects of one of the connectors, for their structure.
        example: constants of one of the connectors, for their sizes.
    """

    kind: Kind
    layout: Layout
    effects: tuple[Effect, ...]
    example: ConnectorConstants

    @cached_property
    def x(self) -> ca.SX:
        """Symbols of the states of the bodies, then of the connector's own."""
        return ca.SX.sym("x", self.n_body_rows + self.n_own)

    @property
    def n_body_rows(self) -> int:
        """Number of states of the bodies."""
        return self.kind.n_bodies * self.layout.size

    @property
    def n_own(self) -> int:
        """Number of data and internal states of the connector."""
        of_effects = sum(len(effect.own) for effect in self.effects)
        return self.kind.n_data + of_effects + self.kind.switches

    @cached_property
    def z(self) -> ca.SX:
        """Symbols of its unknown forces."""
        return ca.SX.sym("z", sum(len(effect.unknowns) for effect in self.effects))

    @cached_property
    def c(self) -> ca.SX:
        """Symbols of its constants, a column."""
        return ca.SX.sym("c", self.example.column.numel())

    @cached_property
    def constants(self) -> ConnectorConstants:
        """The same symbols by name."""
        return self.example.over(self.c)

    @property
    def own(self) -> ca.SX:
        """Its data and internal states, the end of x."""
        return self.x[self.n_body_rows :]

    @cached_property
    def bodies(self) -> list[Body]:
        """Its moving bodies in the world."""
        return [self.layout.body(part) for part in self.layout.split(self.x[: self.n_body_rows])]

    @cached_property
    def _on(self) -> ca.SX | None:
        """Condition under which the connector acts; None if it never changes."""
        if self.kind.active is not None:
            return None
        return (self.own[-1] if self.kind.switches else self.constants.active) > 0.5

    def _leaves(self, name: str) -> ca.SX:
        """Return the constants that are the symbols used by a user function."""
        return self.constants.functions[Functions._fields.index(name)]

    def _bound(self) -> tuple[Effect, ...]:
        """Return the effects with symbols for their numbers."""
        pairs = zip(self.effects, self.constants.effects, strict=True)
        return tuple(effect.bound(numbers) for effect, numbers in pairs)

    def evaluate(self, bodies: list[Body]) -> _Evaluation:
        """Evaluate the connector for its bodies, given in any one system of axes.

        Arguments:
            bodies: the moving bodies, as in `bodies` or relative to the first of them.
        """
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
        return _Evaluation(answer(*motions), answer, markers, motions, bodies)

    @cached_property
    def _evaluated(self) -> _Evaluation:
        return self.evaluate(self.bodies)

    def accelerate(
        self, evaluated: _Evaluation, wrenches: tuple[Wrench, Wrench], R_WE: ca.SX
    ) -> ca.SX:
        """Return what wrenches on the markers cause in the bodies: (v', w') of each, stacked.

        Arguments:
            evaluated: the connector, evaluated.
            wrenches: on marker 0 and marker 1, in the axes E of the evaluation.
            R_WE: from these axes to the world's.
        """
        rates = [ca.SX.zeros(6)] * len(evaluated.bodies)
        f0_W = R_WE @ wrenches[0].f
        # Laws exert opposite forces; recognising that saves one rotation into the world. CasADi
        # compares expressions only to a given depth, here 2.
        opposite = ca.is_equal(wrenches[1].f, -wrenches[0].f, 2)
        forces = (f0_W, -f0_W if opposite else R_WE @ wrenches[1].f)
        for i, place in enumerate(self.kind.places):
            if place is not None:
                compliance = self.constants.compliances[place]
                torque = torque_on_body(
                    evaluated.bodies[place], evaluated.markers[i].p_BA, wrenches[i]
                )
                rates[place] += accelerations(forces[i], torque, compliance)
        return ca.vertcat(*rates)

    def _impulse(self, force: ca.SX, relative: Relative) -> ca.SX:
        """Return the change of the bodies' velocities by an impulse (6, 1) along the strain."""
        markers = [marker_of(column) for column in self.constants.markers]
        # Not `_evaluated`: effects call this while the response is being computed.
        evaluated = _Evaluation(None, None, markers, [], self.bodies)  # type: ignore[arg-type]
        return self.accelerate(evaluated, relative.transmit(force), ca.SX.eye(3))

    def _gives(self, relative: Relative, axis: int) -> ca.SX:
        """Return by how much the rate along an axis decreases for a unit impulse along it."""
        unit = ca.SX(6, 1)
        unit[axis] = 1
        # A positive impulse resists a positive rate, so the rate decreases along the change of x
        # that the impulse causes.
        return -ca.jtimes(
            relative.rate[axis], self.x, self._on_velocities(self._impulse(unit, relative))
        )

    def _on_velocities(self, change: ca.SX) -> ca.SX:
        """Return a change of velocities as a change of all of x."""
        parts = [
            part
            for body in ca.vertsplit(change, 6)
            for part in (ca.SX.zeros(self.layout.size - 6), body)
        ]
        return ca.vertcat(*parts, ca.SX.zeros(self.n_own)) if change.numel() else 0 * self.x

    def rates(self) -> ca.Function:
        """Return the kernel of a part.

        Its results are the accelerations of the bodies followed by the rates of the own states, and
        the equations of the unknown forces.
        """
        bodies, R_WE = self.bodies, ca.SX.eye(3)
        # In the axes of the first body its own rotation drops out of the expressions. User
        # functions receive frames relative to the world, and effects may apply impulses there.
        if len(bodies) == 2 and self.kind.functions.force is None and not self.effects:
            R_WE = bodies[0].motion.frame.R_WA
            bodies = seen_from_first(
                bodies[0], bodies[1], self.layout.coordinates.kind is RotationKind.quaternion
            )
        evaluated = self.evaluate(bodies)
        response = evaluated.response
        rates = self.accelerate(evaluated, (response.wrench0, response.wrench1), R_WE)
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
        """Return the kernel of a hold: the rate that effect `index` keeps, and its weight."""
        evaluated = self._evaluated
        axis = self.effects[index].axis  # type: ignore[attr-defined]
        rate = evaluated.response.relative.rate[axis]
        driven = getattr(self._bound()[index], "velocity", 0)
        held = evaluated.response.answers[index].held
        return kernel("hold", self.x, self.c, rate - driven, held, z=self.z)

    def change(self, index: int, change: Change) -> ca.Function:
        """Return the kernel of an effect's event: zero function, change of velocities and states.

        Arguments:
            index: which effect.
            change: one of the events of its answer.
        """
        relative, effects = self._evaluated.response.relative, self.effects
        first = self.kind.n_data + sum(len(effect.own) for effect in effects[:index])
        own = ca.SX.zeros(self.n_own)
        last, zero = first + len(effects[index].own), change.zero
        # Effects give new values; events add changes.
        own[first:last] = change.own - self.own[first:last]
        impulse = ca.SX.zeros(6)
        if not change.impulse.is_zero():
            # A connector that is broken applies no impulse either.
            remaining = self._remaining(index)
            zero, own = ca.if_else(remaining > 0, zero, 1), remaining * own
            impulse[effects[index].axis] = remaining * change.impulse  # type: ignore[attr-defined]
        jump = ca.vertcat(self._impulse(impulse, relative), own)
        return self._event(zero, jump)

    def _event(self, zero: ca.SX, jump: ca.SX) -> ca.Function:
        """Return the kernel of an event, which cannot happen while the connector is off."""
        zero, jump = while_on(self._on, zero, 1), while_on(self._on, jump)
        return kernel("event", self.x, self.c, zero, jump, z=self.z)

    def _remaining(self, index: int) -> ca.SX:
        """Return which fraction (0 ... 1) of the wrench of effect `index` later effects leave."""
        remaining = ca.SX(1)
        for effect, answer in list(
            zip(self.effects, self._evaluated.response.answers, strict=True)
        )[index + 1 :]:
            if effect.whole:
                remaining = remaining * answer.factor
        return remaining

    def changes(self) -> list[tuple[int, Change]]:
        """Return the events of all effects, each with the index of its effect."""
        answers = self._evaluated.response.answers
        return [(i, change) for i, answer in enumerate(answers) for change in answer.changes]

    def _user(self, name: str) -> ca.SX:
        """Return the result of a user function that receives the data."""
        relative = self._evaluated.response.relative
        frames = [motion.frame.R_WA for motion in self._evaluated.motions]
        function = getattr(self.kind.functions, name).function
        data = self.own[: self.kind.n_data]
        return function(
            TIME.expr, relative.strain, relative.rate, *frames, data, self._leaves(name)
        )

    def switch(self) -> ca.Function:
        """Return the kernel of the event that switches the connector on or off.

        It is a single event, which must cross back before it can fire again. With two events, one
        for on and one for off, each would find the function that the other has just left beyond
        zero by rounding.
        """
        on, active = self._on, self.constants.active
        # The connector acts if `active` > 0.5; 0.5 itself is off.
        zero = ca.if_else(on, active - np.nextafter(0.5, 1), 0.5 - active)
        change = ca.SX.zeros(6 * self.kind.n_bodies + self.n_own)
        change[-1] = ca.if_else(on, 0, 1) - self.own[-1]
        return kernel("switch", self.x, self.c, zero, change, z=self.z)

    def user_event(self, first: int) -> ca.Function:
        """Return the kernel of a user's event: zero function, change of velocities and own states.

        Arguments:
            first: where its rows (zero function, 6 impulses, data) begin in the traced result.
        """
        n, relative = self.kind.n_data, self._evaluated.response.relative
        # Rows of one event: zero function, impulse (6), new data (n).
        block = self._user("events")[first : first + 7 + n]
        own = ca.SX.zeros(self.n_own)
        if n:
            own[:n] = block[7:] - self.own[:n]
        jump = ca.vertcat(self._impulse(block[1:7], relative), own)
        return self._event(block[0], jump)

    def update(self) -> ca.Function:
        """Return the kernel of post_newton_step: error, recommended step, new data."""
        block = self._user("post_newton")
        still = ca.vertcat(0, -1, self.own[: self.kind.n_data])
        block = while_on(self._on, block, still)
        return kernel("post_newton", self.x, self.c, block[0], block[1], block[2:], z=self.z)

    def measure(self, quantity: Quantity) -> ca.Function:
        """Return the kernel of a quantity, over the constants and their rates by TIME."""
        evaluated, x = self._evaluated, self.x
        response, motions = evaluated.response, evaluated.motions
        split = self.layout.split(x[: self.n_body_rows])
        rates = [*(self.layout.kinematic_rates(part) for part in split), self._own_rates(response)]
        c_rate = ca.SX.sym("c_rate", self.c.numel())
        energy = response.potential_energy
        # dU/dt = dU/dc c' + dU/dx x'; offsets or markers driven by TIME are in c. Velocities have
        # rate zero here, since the energy does not depend on them.
        stored_rate = ca.jtimes(energy, self.c, c_rate)
        if x.numel():
            stored_rate += ca.jtimes(energy, x, ca.vertcat(*rates))
        given = power(response.wrench0, motions[0]) + power(response.wrench1, motions[1])
        active = ca.SX(self.kind.active) if self._on is None else self._on
        tangents = (partial(_tangent, evaluated, held) for held in (False, True))
        value = quantity.measure(ConnectorView(response, stored_rate, given, active, *tangents))
        return kernel(quantity.name, x, ca.vertcat(self.c, c_rate), value, z=self.z)


def _tangent(evaluated: _Evaluation, velocities: bool) -> ca.SX:
    """Return the derivative (12, 12) of the wrenches by small motions of the markers.

    Arguments:
        velocities: differentiate by the velocities of the markers instead.
    """
    # Both markers are displaced to first order, and the wrenches differentiated at zero
    # displacement.
    step, still = ca.SX.sym("step", 12), ca.SX.zeros(6)
    moved = [
        displaced(motion, *((still, part) if velocities else (part, still)))
        for motion, part in zip(evaluated.motions, (step[:6], step[6:]), strict=True)
    ]
    response = evaluated.respond(*moved)
    wrenches = ca.vertcat(*response.wrench0, *response.wrench1)
    return ca.densify(ca.substitute(ca.jacobian(wrenches, step), step, ca.SX.zeros(12)))
