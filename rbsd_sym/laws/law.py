"""What every law offers, and what a connector makes of it: force, wrenches, energies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple, Protocol

import casadi as ca

from ..mechanics.motion import Motion, Wrench
from .effect import Answer, Effect, Sight


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


def _weightless(relative: Relative, axis: int) -> ca.SX:
    raise ValueError("an impulse needs bodies; give SpringDamper(gives=...)")


class SpringDamper(NamedTuple):
    """What a connector is made of, beside its law.

    Fields:
        stiffness, damping (6, 6), offset, velocity_offset (6, 1).
        user_force: (t, strain, rate, A0, A1, data) -> force, or None.
        effects: with symbols for their numbers, and `own` and `unknown`, their states and unknown
            forces; the first `n_data` of own are the connector's own data.
        gives: (relative, axis) -> how much the rate along the axis falls for a unit impulse.
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
    gives: Callable[[Relative, int], ca.SX] = _weightless
    on: ca.SX | None = None


class Response(NamedTuple):
    """Everything a connector answers to the motion of its markers.

    `answers` are those of its effects, in order.
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
    """Force K (strain - offset) + D (rate - velocity_offset), or the user's, and its energies.

    Effects add theirs. With a user force no potential is known: stored energy and dissipation count
    as zero, and all of its power is injected power. While the connector is off, force and energies
    are zero and the states of its effects rest.
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
        data = numbers.own[: numbers.n_data]
        force = numbers.user_force(t, relative.strain, relative.rate, R_WA, R_WC, data)
    total = _Total(*(while_on(numbers.on, value) for value in (force, energy, dissipated)))
    answers = _answers(numbers, t, relative, total)
    wrench0, wrench1 = relative.transmit(total.force)
    return Response(
        relative, total.force, wrench0, wrench1, total.energy, total.dissipated, answers
    )


def while_on(on: ca.SX | None, value: ca.SX, off: ca.SX | float = 0) -> ca.SX:
    """The value where the connector acts, else what it is off.

    It is chosen, not multiplied: what is infinite or NaN while off leaves no trace, also in
    derivatives.
    """
    return value if on is None or not value.numel() else ca.if_else(on, value, off)


def _answer_while_on(on: ca.SX | None, answer: Answer, unknown: ca.SX) -> Answer:
    """An answer that is none while the connector is off; an unknown force is then zero."""
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
    """Sums over what was there before."""

    force: ca.SX
    energy: ca.SX
    dissipated: ca.SX

    def add(self, effect: Effect, answer: Answer) -> None:
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
    """What the effects answer; their sums are added to the total."""
    answers: list[Answer] = []
    forces: dict[str, ca.SX] = {}
    i, j = numbers.n_data, 0
    for effect in numbers.effects:
        i_end, j_end = i + len(effect.own), j + len(effect.unknowns)
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
