"""Dry friction along one axis: Coulomb's law with stick and slip, and the bristle model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from .effect import Answer, Change, Effect, Own, Rule, Sight, value_at_default

_STILL = 1e-8  # m/s or rad/s: what moves faster does not stick
_CREEP = 1e-6  # of the Stribeck velocity: below it bristles do not yield
_PEAK = 4.0  # widths, where regularised friction reaches the static limit


def _limits(effect: Any, sight: Sight) -> tuple[ca.SX, ca.SX]:
    """Kinetic and static limit of the friction force."""
    normal = effect.normal
    if isinstance(normal, str):
        normal = ca.fabs(sight.forces[normal])
    static = effect.kinetic if effect.static is None else effect.static
    return effect.kinetic * normal, static * normal


def _check_coefficients(effect: Any, where: str) -> None:
    if effect.static is None:
        return
    kinetic, static = value_at_default(effect.kinetic), value_at_default(effect.static)
    if static < kinetic:
        raise ValueError(
            f"{where}: static coefficient {static:g} < kinetic {kinetic:g}; it takes at least as "
            "much to start sliding as to keep it up"
        )


@dataclass(frozen=True, eq=False)
class Friction(Effect):
    """Coulomb friction: |f| <= mu_s N at rest, f = mu_k N sign(v) in motion.

    Picture: a block on a belt of velocity V; v = rate - V.

    The form with events has the state `mode`, the sign of the sliding velocity, 0 where it sticks.
    Sticking is exact: the friction force is an unknown, which holds v where it is, until it exceeds
    mu_s N. Sliding ends as v falls to zero; what happens then, sticking decides. So a model with it
    has an algebraic unknown, and both bodies need inertia.

    Arguments:
        axis: 0, 1, 2 for translation along the joint's x, y, z, 3, 4, 5 for rotation.
        normal: N (or N m with a lever), or the name of a contact earlier in the same connector.
        kinetic, static: coefficients; static is kinetic by default.
        velocity: V, m/s or rad/s.
        smoothing: 0 for the form with events. Else the velocity w (m/s or rad/s) of the regularised
            one: f = N (mu_k tanh(v/w) + (mu_s - mu_k) b(v / 4w)), b(x) = x exp((1 - x^2)/2), smooth
            to any order. It never sticks: below the limit it creeps, under a force f at
            w atanh(f / (mu_k N)), an error of order 1 in w; coming to rest without a load it slides
            too far by pi^2 m w^2 / (12 mu_k N); its peak is below mu_s N by 0.07 % of mu_k N.
    """

    axis: int
    normal: Any
    kinetic: Any
    static: Any = None
    velocity: Any = 0.0
    smoothing: float = 0.0
    name: str = ""

    @property
    def rules(self) -> Mapping[str, Rule]:  # type: ignore[override]
        """Its numbers."""
        rules = {"kinetic": Rule(""), "static": Rule(""), "velocity": Rule("m/s", signed=True)}
        return rules if isinstance(self.normal, str) else {"normal": Rule("N"), **rules}

    def _check(self, where: str) -> None:
        _check_coefficients(self, where)

    @property
    def own(self) -> tuple[Own, ...]:
        """The sign of the sliding velocity."""
        return () if self.smoothing else (Own("mode", data=True),)

    @property
    def unknowns(self) -> tuple[Own, ...]:
        """The friction force."""
        return () if self.smoothing else (Own("force", "N m" if self.axis > 2 else "N"),)

    @property
    def impulsive(self) -> bool:
        """It holds."""
        return not self.smoothing

    def answer(self, sight: Sight) -> Answer:
        """The friction force, and stick and slip."""
        kinetic, static = _limits(self, sight)
        v = sight.rate - self.velocity
        if self.smoothing:
            x = v / (_PEAK * self.smoothing)
            force = kinetic * ca.tanh(v / self.smoothing)
            force += (static - kinetic) * x * ca.exp((1 - x * x) / 2)
            return Answer(force, dissipated=force * v)
        mode, force = sight.own[0], sight.unknown[0]
        slides = mode * mode > 0.5  # linear solvers leave rounding in data
        halt = v / sight.gives()  # the drift of the velocity held, and of finding the event
        changes = (
            Change("sticks", ca.if_else(slides, mode * v, 1), ca.SX(0), halt),
            Change("moves", ca.if_else(slides, 1, _STILL - ca.fabs(v)), ca.sign(v), at_once=True),
            Change(
                "slips",
                ca.if_else(slides, 1, static - ca.fabs(force)),
                ca.sign(force),
                halt,
                at_once=True,
            ),
        )
        return Answer(
            force,
            dissipated=force * v,
            rates=ca.SX(0),
            changes=changes,
            equation=slides * (force - mode * kinetic),
            held=1 - slides,
        )


@dataclass(frozen=True, eq=False)
class LuGre(Effect):
    """Friction of bristles that bend before they slide [Canudas de Wit et al. 1995].

        f = s0 b + s1 b' + s2 v,   b' = v - s0 |v| b / g(v),
        g = N (mu_k + (mu_s - mu_k) exp(-(v / v_s)^2))

    The state `bristle` b is the mean deflection. |v| is v^2 / sqrt(v^2 + e^2), e = v_s / 10^6, so
    that derivatives are continuous; loads that move the block more slowly than e creep past the
    static limit. The heat is not negative where s1 |v| <= 4 g(v). Choose atol well below the
    deflection mu_s N / s0.

    Arguments:
        axis, normal, kinetic, static, velocity: as in `Friction`.
        stribeck: velocity v_s, m/s or rad/s, at which friction has fallen to the kinetic one.
        stiffness, damping: s0 (N/m) and s1 (N s/m) of the bristles.
        viscous: s2, N s/m.
    """

    axis: int
    normal: Any
    kinetic: Any
    static: Any
    stribeck: Any
    stiffness: Any
    damping: Any = 0.0
    viscous: Any = 0.0
    velocity: Any = 0.0
    name: str = ""

    @property
    def rules(self) -> Mapping[str, Rule]:  # type: ignore[override]
        """Its numbers."""
        rules = {
            "kinetic": Rule("", positive=True),
            "static": Rule("", positive=True),
            "stribeck": Rule("m/s", positive=True),
            "stiffness": Rule("N/m", positive=True),
            "damping": Rule("N s/m"),
            "viscous": Rule("N s/m"),
            "velocity": Rule("m/s", signed=True),
        }
        if isinstance(self.normal, str):
            return rules
        return {"normal": Rule("N", positive=True), **rules}

    def _check(self, where: str) -> None:
        _check_coefficients(self, where)

    @property
    def own(self) -> tuple[Own, ...]:
        """The deflection of the bristles."""
        return (Own("bristle", "rad" if self.axis > 2 else "m"),)

    def answer(self, sight: Sight) -> Answer:
        """The friction force and the rate of the bristles."""
        b, v = sight.own[0], sight.rate - self.velocity
        kinetic, static = _limits(self, sight)
        e = _CREEP * self.stribeck
        speed = v * v / ca.sqrt(v * v + e * e)
        limit = kinetic + (static - kinetic) * ca.exp(-((v / self.stribeck) ** 2))
        rate = v - self.stiffness * speed * b / limit
        force = self.stiffness * b + self.damping * rate + self.viscous * v
        energy = self.stiffness * b * b / 2
        return Answer(force, energy, force * v - self.stiffness * b * rate, rate)
