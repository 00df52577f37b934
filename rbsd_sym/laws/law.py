"""The interface of laws, and what a connector computes from one: force, wrenches, energies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca

from ..mechanics.motion import Motion, Wrench
from .effect import Answer, Effect, Sight


class Relative(NamedTuple):
    """Relative motion of two markers as a law measures it.

    Fields:
        strain: (6, 1) displacement (m) and rotation (rad), before the offset is subtracted.
        rate: (6, 1) velocity (m/s) and angular velocity (rad/s) on which the damper acts.
        transmit: function of a force (6, 1), N and N m along the components of the strain, that
            returns the wrenches on marker 0 and marker 1, at the markers in world components.
    """

    strain: ca.SX
    rate: ca.SX
    transmit: Callable[[ca.SX], tuple[Wrench, Wrench]]


class Law(Protocol):
    """A connector law: from the motion of two markers to strain, rate and wrenches.

    A law is a frozen dataclass without numbers of a connector, so that equal laws share one kernel.
    To add one, write a file with a class that has these members.

    Fields:
        needs_symmetric_stiffness: whether K must be symmetric, because the force derives from an
            energy.
        turns_with_frames: whether both joint frames may be rotated by the same rotation if K, D and
            the offsets are rotated along.
        soft_axes_with_trouble: local rotation axes (0, 1, 2) about which the law is not a valid
            hinge.
    """

    needs_symmetric_stiffness: ClassVar[bool]
    turns_with_frames: ClassVar[bool]
    soft_axes_with_trouble: ClassVar[tuple[int, ...]]

    def relative(self, motion0: Motion, motion1: Motion) -> Relative:
        """Return strain, rate, and the map from force to wrenches.

        Arguments:
            motion0, motion1: motions of the joint frames at marker 0 and marker 1, world
                components.

        Two moving bodies are usually given relative to the first one's frame; a law must not depend
        on the choice of the inertial frame.
        """
        ...


def _no_bodies(relative: Relative, axis: int) -> ca.SX:
    raise ValueError("respond: an effect with impulses needs bodies; give SpringDamper(gives=...)")


class SpringDamper(NamedTuple):
    """The numbers of a connector that `respond` combines with its law.

    Fields:
        stiffness, damping: K and D (6, 6).
        offset, velocity_offset: (6, 1), m and rad, m/s and rad/s.
        user_force: function (t, strain, rate, A0, A1, data) that returns the force (6, 1) in place
            of the linear one; or None.
        effects: the effects, with symbols for their numbers.
        own: column of the connector's data, then of the states of the effects in order.
        unknown: column of the unknown forces of the effects in order.
        n_data: how many entries of `own` are the connector's data.
        gives: function (relative, axis) that returns by how much the rate along the axis decreases
            for a unit impulse along it, 1/kg or 1/(kg m2).
        on: condition under which the connector acts; None if it always does.
    """

    stiffness: ca.SX
    damping: ca.SX
    offset: ca.SX
    velocity_offset: ca.SX
    user_force: Any = None
    effects: tuple[Effect, ...] = ()
    own: ca.SX = ca.SX(0, 1)
    unknown: ca.SX = ca.SX(0, 1)
    n_data: int = 0
    gives: Callable[[Relative, int], ca.SX] = _no_bodies
    on: ca.SX | None = None


class Response(NamedTuple):
    """What a connector exerts for a given motion of its markers.

    Fields:
        relative: strain, rate and the map to wrenches.
        force: (6, 1), N and N m, along the components of the strain; positive resists positive
            strain.
        wrench0, wrench1: wrenches on marker 0 and marker 1, world components.
        potential_energy: J.
        dissipated_power: W.
        answers: what each effect contributed, in order.
    """

    relative: Relative
    force: ca.SX
    wrench0: Wrench
    wrench1: Wrench
    potential_energy: ca.SX
    dissipated_power: ca.SX
    answers: tuple[Answer, ...]


def respond(
    law: Law, numbers: SpringDamper, t: ca.SX, motion0: Motion, motion1: Motion
) -> Response:
    """Return force, wrenches, energy and dissipation of a connector.

    The force is K (strain - offset) + D (rate - velocity_offset), or that of the user's function,
    plus the forces of the effects. No potential of a user force is known: its stored energy and
    dissipation count as zero, and all of its power as injected power. While the connector is off,
    force and energies are zero and the states of its effects are constant.

    Arguments:
        law: how strain and rate are measured.
        numbers: stiffness, damping, offsets, effects.
        t: time, s.
        motion0, motion1: motions of the joint frames, world components.
    """
    relative = law.relative(motion0, motion1)
    stretch = relative.strain - numbers.offset
    slip = relative.rate - numbers.velocity_offset
    energy, dissipated = ca.SX(0), ca.SX(0)
    if numbers.user_force is None:
        elastic, viscous = numbers.stiffness @ stretch, numbers.damping @ slip
        force = elastic + viscous
        # An unsymmetric K stores the energy of its symmetric part; the power of the rest counts as
        # injected.
        energy, dissipated = ca.dot(stretch, elastic) / 2, ca.dot(slip, viscous)
    else:
        R_WA, R_WC = motion0.frame.R_WA, motion1.frame.R_WA
        data = numbers.own[: numbers.n_data]
        force = numbers.user_force(t, relative.strain, relative.rate, R_WA, R_WC, data)
    total = _Total(*(while_on(numbers.on, value) for value in (force, energy, dissipated)))
    answers = _answers(numbers, t, relative, total)
    wrench0, wrench1 = relative.transmit(total.force)
    return Response(
        relative, total.force, wrench0, wrench1, total.energy, total.dissipated, answers
    )


def while_on(on: ca.SX | None, value: ca.SX, off: ca.SX | float = 0) -> ca.SX:
    """Return `value` while the connector acts, and `off` otherwise.

    The value is selected, not multiplied by 0 or 1, so that one that is infinite or NaN while the
    connector is off has no effect, nor have its derivatives.

    Arguments:
        on: condition under which the connector acts; None if it always does.
        value, off: expressions of one shape; `off` may be a number.
    """
    return value if on is None or not value.numel() else ca.if_else(on, value, off)


def _answer_while_on(on: ca.SX | None, answer: Answer, unknown: ca.SX) -> Answer:
    """Return an answer that contributes nothing while off; an unknown force is then zero."""
    return answer._replace(
        force=while_on(on, answer.force),
        energy=while_on(on, answer.energy),
        dissipated=while_on(on, answer.dissipated),
        rates=while_on(on, answer.rates),
        equation=while_on(on, answer.equation, unknown),
        held=while_on(on, answer.held),
    )


@dataclass
class _Total:
    """Sums of force, energy and dissipation over the spring-damper and the effects so far."""

    force: ca.SX
    energy: ca.SX
    dissipated: ca.SX

    def add(self, effect: Effect, answer: Answer) -> None:
        """Add the answer of an effect; an effect on the whole wrench scales the sums so far."""
        if effect.whole:
            self.force = answer.factor * self.force
            self.energy = answer.factor * self.energy
            self.dissipated = answer.factor * self.dissipated + answer.dissipated
            return
        unit = ca.SX(6, 1)
        unit[effect.axis] = 1  # type: ignore[attr-defined]
        self.force = self.force + answer.force * unit
        self.energy = self.energy + answer.energy
        self.dissipated = self.dissipated + answer.dissipated


def _answers(
    numbers: SpringDamper, t: ca.SX, relative: Relative, total: _Total
) -> tuple[Answer, ...]:
    """Evaluate the effects in order, adding each to the total, and return their answers."""
    answers: list[Answer] = []
    forces: dict[str, ca.SX] = {}
    i, j = numbers.n_data, 0
    for effect in numbers.effects:
        i_end, j_end = i + len(effect.own), j + len(effect.unknowns)
        # Order matters: an effect receives the force and energy of everything before it, so that
        # friction finds the contact's push and fracture the load that it limits.
        axis: Any = slice(6) if effect.whole else effect.axis  # type: ignore[attr-defined]
        sight = Sight(
            t,
            relative.strain[axis],
            relative.rate[axis],
            numbers.own[i:i_end],
            numbers.unknown[j:j_end],
            partial(numbers.gives, relative, axis),
            total.force,
            total.energy,
            forces,
        )
        answer = _answer_while_on(numbers.on, effect.answer(sight), sight.unknown)
        forces[effect.label] = answer.force
        total.add(effect, answer)
        answers.append(answer)
        i, j = i_end, j_end
    return tuple(answers)
