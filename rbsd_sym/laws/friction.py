"""Dry friction along one axis: Coulomb's law with stick and slip, and the LuGre bristle model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from .effect import Answer, Change, Effect, Own, Rule, Sight, value_at_default

# Sliding velocity, m/s or rad/s, above which a sticking contact is taken to move.
_STILL = 1e-8
# Fraction of the Stribeck velocity below which bristles hardly yield.
_CREEP = 1e-6
# Widths at which regularised friction reaches the static limit.
_PEAK = 4.0


def _limits(effect: Any, sight: Sight) -> tuple[ca.SX, ca.SX]:
    """Return the kinetic and the static limit of the friction force, N or N m."""
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
            "much to start sliding as to keep sliding; exchange them"
        )


@dataclass(frozen=True, eq=False)
class Friction(Effect):
    """Coulomb friction along one axis: |f| <= mu_s N at rest, f = mu_k N sign(v) in motion.

        effects=[rs.Contact(2, 1e5, 200), rs.Friction(0, normal="contact_z", kinetic=0.3)]

    Picture: a block on a belt of velocity V; v = rate - V is the sliding velocity.

    Free bodies: a positive f opposes a positive v; it acts on both markers, in opposite directions,
    through the law of the connector.

    The form with events has the data state `mode`: the sign of the sliding velocity, 0 while
    sticking. Sticking is exact: the friction force is an algebraic unknown that keeps v constant
    until it would exceed mu_s N. Sliding ends when v reaches zero; whether the block then sticks or
    slides on, the static limit decides.

    Choosing numbers: coefficients from tables for the pair of materials. With smoothing, choose w
    well below the sliding velocities of interest; explicit methods need shorter steps in proportion
    to w.

    Limits: the form with events makes an algebraic unknown (no explicit methods) and needs inertia
    in both bodies. If two friction effects hold the same motion, how they share the load is not
    determined.

    Arguments:
        axis: 0, 1, 2 for translation along x, y, z of the joint frame; 3, 4, 5 for rotation.
        normal: N, or N m with the lever included; or the label of a contact earlier in this
            connector.
        kinetic, static: coefficients mu_k and mu_s; static is kinetic by default.
        velocity: V, m/s or rad/s.
        smoothing: 0 for the form with events. Otherwise the velocity w (m/s or rad/s) of the
            regularised force f = N (mu_k tanh(v/w) + (mu_s - mu_k) b(v / 4w)), b(x) = x
            exp((1 - x^2)/2), which is smooth to any order. It never sticks: under a load f below
            the limit it creeps at w atanh(f / (mu_k N)), an error of order 1 in w; coming to rest
            without a load it slides too far by pi^2 m w^2 / (12 mu_k N); its peak is below mu_s N
            by 0.07 % of mu_k N.
        name: label within the connector; by default friction_<axis>.
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
        """Its numbers; `normal` is not one if it names a contact."""
        rules = {"kinetic": Rule(""), "static": Rule(""), "velocity": Rule("m/s", signed=True)}
        return rules if isinstance(self.normal, str) else {"normal": Rule("N"), **rules}

    def _check(self, where: str) -> None:
        _check_coefficients(self, where)

    @property
    def own(self) -> tuple[Own, ...]:
        """With events the sign of the sliding velocity; none with smoothing."""
        return () if self.smoothing else (Own("mode", data=True),)

    @property
    def unknowns(self) -> tuple[Own, ...]:
        """With events the friction force; none with smoothing."""
        return () if self.smoothing else (Own("force", "N m" if self.axis > 2 else "N"),)

    @property
    def impulsive(self) -> bool:
        """True with events: it holds the velocity while sticking."""
        return not self.smoothing

    def answer(self, sight: Sight) -> Answer:
        """Return the friction force, and the events between sticking and sliding."""
        kinetic, static = _limits(self, sight)
        v = sight.rate - self.velocity
        if self.smoothing:
            x = v / (_PEAK * self.smoothing)
            force = kinetic * ca.tanh(v / self.smoothing)
            force += (static - kinetic) * x * ca.exp((1 - x * x) / 2)
            return Answer(force, dissipated=force * v)
        mode, force = sight.own[0], sight.unknown[0]
        # Not mode != 0: the linear solver of an implicit method leaves rounding in data states.
        slides = mode * mode > 0.5
        # Impulse that removes what is left of v: drift while it was held, and the error of locating
        # the event.
        halt = v / sight.gives()
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
            # 0 = slides (f - mode mu_k N) + (1 - slides) dv/dt: one row of alg in both modes.
            equation=slides * (force - mode * kinetic),
            held=1 - slides,
        )


@dataclass(frozen=True, eq=False)
class LuGre(Effect):
    """LuGre friction: bristles that bend before they slide [Canudas de Wit et al. 1995].

        effects=[rs.LuGre(0, normal=10, kinetic=0.3, static=0.4, stribeck=0.01, stiffness=1e5)]

    Picture: two surfaces with elastic bristles; the state `bristle` b is their mean deflection.

    Free bodies: as for `Friction`.

        f = s0 b + s1 b' + s2 v,   b' = v - s0 |v| b / g(v),
        g = N (mu_k + (mu_s - mu_k) exp(-(v / v_s)^2))

    |v| is v^2 / sqrt(v^2 + e^2) with e = v_s / 10^6, so that derivatives are continuous.

    Choosing numbers: s0 is the static limit mu_s N over the presliding deflection; s1 = sqrt(s0 m)
    gives a block of mass m on its bristles half the critical damping. Choose atol well below the
    deflection mu_s N / s0.

    Limits: a load that moves the block more slowly than e creeps past the static limit. The
    dissipation is not negative where s1 |v| <= 4 g(v).

    Arguments:
        axis, normal, kinetic, static, velocity: as in `Friction`; static must be given.
        stribeck: velocity v_s, m/s or rad/s, at which friction falls towards the kinetic limit.
        stiffness, damping: s0 (N/m) and s1 (N s/m) of the bristles, or N m/rad and N m s/rad.
        viscous: s2, N s/m or N m s/rad.
        name: label within the connector; by default lugre_<axis>.
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
        """Its numbers; `normal` is not one if it names a contact."""
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
        """The deflection of the bristles, m or rad."""
        return (Own("bristle", "rad" if self.axis > 2 else "m"),)

    def answer(self, sight: Sight) -> Answer:
        """Return the friction force, the energy in the bristles, and their rate."""
        b, v = sight.own[0], sight.rate - self.velocity
        kinetic, static = _limits(self, sight)
        e = _CREEP * self.stribeck
        # A smooth |v|: close to it for |v| >> e, with a double zero at rest.
        speed = v * v / ca.sqrt(v * v + e * e)
        limit = kinetic + (static - kinetic) * ca.exp(-((v / self.stribeck) ** 2))
        rate = v - self.stiffness * speed * b / limit
        force = self.stiffness * b + self.damping * rate + self.viscous * v
        energy = self.stiffness * b * b / 2
        return Answer(force, energy, force * v - self.stiffness * b * rate, rate)
