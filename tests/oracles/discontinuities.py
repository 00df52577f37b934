"""Closed-form motions with events: friction, contact, stick-slip, fracture, impact.

A motion with events is a list of `Phase`s, each a smooth linear motion that is known exactly; its
events are the starts of all phases but the first. At the very time of an event the state is the one
after it. Where an event can go either way (a block that stops with its spring force equal to the
friction limit), rounding decides: choose other numbers for a test.

Plasticity, viscoelasticity, regularised friction and numerical damping are in `dissipation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .closed_forms import damped_oscillator
from .rotations import Array, cross

# A spring force this much above the static limit still counts as the limit (see `belt_phases`).
_LIMIT = 1.0 + 1e-12


class Phase(NamedTuple):
    """x'' = acceleration - rate x' - square x, from x and v at `start` (s) to the next phase.

    The mode is a name. A phase without a spring (square = 0) has no damper (rate = 0) either.
    """

    start: float
    mode: str
    x: float
    v: float
    acceleration: float = 0.0
    square: float = 0.0
    rate: float = 0.0


class Contact(NamedTuple):
    """One contact: duration (s), greatest depth (m) and velocity at its end (m/s, away)."""

    duration: float
    depth: float
    rebound: float


def motion(phase: Phase, t: ArrayLike) -> tuple[Array, Array]:
    """Position and velocity at times t, as if the phase lasted for ever.

    Overdamped phases overflow (cosh) where rate (t - start) is above 1400.
    """
    s = np.asarray(t, dtype=float) - phase.start
    if phase.square == 0.0:
        a = phase.acceleration
        return phase.x + phase.v * s + 0.5 * a * s * s, phase.v + a * s
    centre = phase.acceleration / phase.square
    y, v = damped_oscillator(s, 1.0, phase.square, phase.rate, phase.v, phase.x - centre)
    return centre + y, v


def state_at(phases: Sequence[Phase], t: ArrayLike) -> tuple[Array, Array]:
    """Position and velocity at times t (at least the first start) of a motion with events."""
    t = np.asarray(t, dtype=float)
    index = np.searchsorted([phase.start for phase in phases], t, side="right") - 1
    x, v = np.full(t.shape, np.nan), np.full(t.shape, np.nan)
    for i in np.unique(index[index >= 0]):
        x[index == i], v[index == i] = motion(phases[i], t[index == i])
    return x, v


def _after(phase: Phase, duration: float) -> tuple[float, float, float]:
    """Time, position and velocity at the end of a phase of given duration."""
    end = phase.start + duration
    # The duration itself, not `end` minus the start: it has more digits.
    x, v = motion(phase._replace(start=0.0), duration)
    return end, float(x), float(v)


def coulomb_turns(
    mass: float, stiffness: float, friction: float, x0: float, v0: float = 0.0,
    static: float | None = None,
) -> tuple[Array, Array]:
    """Times and positions of the standstills of m x'' + k x + F sign(x') = 0; it stays at the last.

    Moving towards smaller x, friction pushes with +F: half a harmonic oscillation about +F/k, the
    other way about -F/k. So from a standstill x_j at t_j

        x_(j+1) = 2 sign(x_j) F/k - x_j,   t_(j+1) = t_j + pi sqrt(m/k),

    |x| falls by 2 F/k each time, and the mass sticks at the first standstill with k |x| <= the
    static limit (F unless given) [Den Hartog 1956, free vibration with dry friction]. With
    v0 = 0 the start is the first standstill. `friction` > 0.
    """
    w, reach = np.sqrt(stiffness / mass), friction / stiffness
    limit = reach if static is None else static / stiffness
    times, turns = [0.0], [x0]
    if v0 != 0.0:
        y = x0 + np.copysign(reach, v0)
        times = [(np.arctan2(v0 / w, y) % np.pi) / w]
        turns = [np.copysign(np.hypot(y, v0 / w) - reach, v0)]
    while abs(turns[-1]) > limit:
        times.append(times[-1] + np.pi / w)
        turns.append(2.0 * np.copysign(reach, turns[-1]) - turns[-1])
    return np.array(times), np.array(turns)


def coulomb_phases(
    mass: float, stiffness: float, friction: float, x0: float, v0: float = 0.0,
    static: float | None = None,
) -> list[Phase]:
    """The Coulomb oscillator as phases "slip" and at last "stick", from t = 0."""
    times, turns = coulomb_turns(mass, stiffness, friction, x0, v0, static)
    square, push = stiffness / mass, friction / mass
    phases = [
        Phase(t, "slip", x, 0.0, np.copysign(push, x), square)
        for t, x in zip(times[:-1], turns[:-1], strict=True)
    ]
    if v0 != 0.0:
        phases.insert(0, Phase(0.0, "slip", x0, v0, -np.copysign(push, v0), square))
    return [*phases, Phase(times[-1], "stick", turns[-1], 0.0)]


def ball_impacts(
    count: int, height: float, gravity: float, restitution: float, v0: float = 0.0
) -> tuple[Array, Array]:
    """Times of the first impacts of a bouncing ball and its velocities after them (upwards, m/s).

    It hits the ground with u = sqrt(v0^2 + 2 g h) at t_1 = (v0 + u)/g, leaves with e u, and flies
    for 2 e u/g: u_n = e^n u, t_n = t_1 + (2 u/g) (e + ... + e^(n-1)).
    """
    u = np.sqrt(v0 * v0 + 2.0 * gravity * height)
    powers = restitution ** np.arange(1.0, count + 1.0)
    flights = np.concatenate([[0.0], np.cumsum(powers[:-1])])
    return (v0 + u) / gravity + 2.0 * u / gravity * flights, powers * u


def ball_zeno(height: float, gravity: float, restitution: float, v0: float = 0.0) -> float:
    """Time (s) at which infinitely many bounces are over: t_1 + (2 u/g) e/(1 - e), for e < 1."""
    u = np.sqrt(v0 * v0 + 2.0 * gravity * height)
    return (v0 + u + 2.0 * u * restitution / (1.0 - restitution)) / gravity


def ball_phases(
    height: float, gravity: float, restitution: float, v0: float = 0.0, count: int | None = None
) -> list[Phase]:
    """The bouncing ball as phases "flight" from t = 0, then "rest" from the Zeno time on.

    All bounces faster than 1e-17 of the first impact are there. With a `count` there are only that
    many, without a "rest", which restitution 1 needs.
    """
    rests = count is None
    if count is None:
        count = int(np.ceil(np.log(1e-17) / np.log(restitution))) if restitution > 0.0 else 1
    impacts = ball_impacts(count, height, gravity, restitution, v0)
    phases = [Phase(0.0, "flight", height, v0, -gravity)]
    phases += [Phase(t, "flight", 0.0, v, -gravity) for t, v in zip(*impacts, strict=True)]
    if rests:
        phases.append(Phase(ball_zeno(height, gravity, restitution, v0), "rest", 0.0, 0.0))
    return phases


def drop_contact(mass: float, stiffness: float, height: float, gravity: float) -> Contact:
    """A mass dropped from `height` (m) on a unilateral spring without damping.

    During contact y = -A (1 - cos s) - B sin s with s = w t, w^2 = k/m, A = g/w^2, B = u/w and
    u^2 = 2 g h. It is zero again at tan(s/2) = -B/A, and symmetric about half of that time:

        T = (2/w) (pi - atan(u w/g)),   depth = A + sqrt(A^2 + B^2),   rebound u.
    """
    w, u = np.sqrt(stiffness / mass), np.sqrt(2.0 * gravity * height)
    A, B = gravity / w**2, u / w
    return Contact(2.0 * (np.pi - np.arctan2(B, A)) / w, A + np.hypot(A, B), u)


def dashpot_contact(mass: float, stiffness: float, damping: float, speed: float) -> Contact:
    """Contact with a spring and dashpot that never pull, at impact velocity `speed`, no gravity.

    With z = d/(2 sqrt(k m)) and p = acos z, y = -(u/w) exp(-a t) sin(w t), a = z w0,
    w = w0 sqrt(1 - z^2). The force -k y - d y' is zero when tan(w t) = -2 a w/(w0^2 - 2 a^2), which
    is -tan(2 asin z), so w T = 2 p; the greatest depth is at half that time:

        T = 2 p/w,   depth = (u/w0) exp(-a T/2),   rebound = u exp(-a T)

    [Schwager, Poeschel 2007]. The spring is then still compressed. Critical and overdamped
    contacts are the continuation, p = arcosh z and w = w0 sqrt(z^2 - 1).
    """
    w0 = np.sqrt(stiffness / mass)
    z = damping / (2.0 * np.sqrt(stiffness * mass))
    root = np.sqrt(abs(1.0 - z * z))
    ratio = 1.0 if root == 0.0 else (np.arccos(z) if z < 1.0 else np.arccosh(z)) / root
    duration = 2.0 * ratio / w0
    return Contact(duration, speed / w0 * np.exp(-z * ratio), speed * np.exp(-2.0 * z * ratio))


def _first_rest(square: float, rate: float, y: float, v: float) -> float:
    """First t > 0 with y' = 0 of y'' + rate y' + square y = 0; infinite if it never rests.

    With a = rate/2 and w^2 = square - a^2, tan(w t) = v w/(a v + square y), tanh if w^2 < 0.
    """
    a = 0.5 * rate
    q, w2 = a * v + square * y, square - a * a
    w = np.sqrt(abs(w2))
    if w2 > 0.0:
        angle = np.arctan2(v * w, q) % np.pi
        return (angle if angle > 0.0 else np.pi) / w
    if v * q <= 0.0 or abs(v * w) >= abs(q):
        return np.inf
    return v / q if w == 0.0 else np.arctanh(v * w / q) / w


def _push_ends(phase: Phase) -> float:
    """Duration of a contact phase of unit mass: until its force per mass is zero, or for ever.

    The force N = -square x - rate v obeys the equation of motion about the weight g. It first
    meets zero, if at all, between the preceding maximum (or the start) and its first minimum.
    """
    g, square, rate = -phase.acceleration, phase.square, phase.rate
    force = -square * phase.x - rate * phase.v
    slope = -square * phase.v - rate * (force - g)
    low, high = 0.0, _first_rest(square, rate, force - g, slope)
    if slope > 0.0 or (slope == 0.0 and force < g):
        w2 = square - 0.25 * rate * rate
        low, high = high, high + np.pi / np.sqrt(w2) if w2 > 0.0 else np.inf
    weightless = Phase(0.0, "force", force - g, slope, 0.0, square, rate)
    if high == np.inf or g + motion(weightless, high)[0] > 0.0:
        return np.inf
    while low < (middle := 0.5 * (low + high)) < high:
        low, high = (middle, high) if g + motion(weightless, middle)[0] > 0.0 else (low, middle)
    return high


def spring_bounce_phases(
    t_end: float, mass: float, stiffness: float, damping: float, gravity: float,
    height: float, v0: float = 0.0,
) -> list[Phase]:
    """Bouncing on a unilateral spring and dashpot whose force is max(0, -k y - d y') below y = 0.

    Phases "flight" and "contact" up to t_end, from y = height >= 0. A contact ends when its force
    is zero (found by bisection of the exact force to the last digit), with a dashpot below y = 0.
    The next begins at y = 0 on the way down, or, if the mass does not come up to y = 0 any more,
    when k y + d y' is zero again, 2 (v/g - d/k) after the end. The last contact may go on for ever.
    """
    square, rate = stiffness / mass, damping / mass
    phases = [Phase(0.0, "flight", height, v0, -gravity)]
    while True:
        phase = phases[-1]
        if phase.mode == "contact":
            duration, mode, spring = _push_ends(phase), "flight", (0.0, 0.0)
        else:
            mode, spring = "contact", (square, rate)
            rise = phase.v**2 + 2.0 * gravity * phase.x
            duration = (phase.v + np.sqrt(rise)) / gravity if rise >= 0.0 else (
                2.0 * (phase.v / gravity - damping / stiffness)
            )
        if phase.start + duration > t_end:
            return phases
        t, x, v = _after(phase, duration)
        lands = mode == "contact" and rise >= 0.0
        phases.append(Phase(t, mode, 0.0 if lands else x, v, -gravity, *spring))


class BeltCycle(NamedTuple):
    """Limit cycle on a belt: durations (s), where slip and stick begin, greatest x (m)."""

    stick: float
    slip: float
    slip_start: float
    stick_start: float
    greatest: float


def belt_cycle(
    mass: float, stiffness: float, normal: float, static: float, kinetic: float, belt: float
) -> BeltCycle:
    """Stick-slip limit cycle of a block on a belt of velocity `belt` > 0, held by a spring.

    It sticks until k x = mu_s N, then slips backwards relative to the belt about x_k = mu_k N/k,
    starting D = (mu_s - mu_k) N/k beyond it with the belt's velocity V: x = x_k + D cos s
    + (V/w) sin s, s = w t. The velocity is V again at tan(s/2) = -D w/V, where x = x_k - D:

        slip (2/w) (pi - atan(D w/V)),   stick 2 D/V

    [Leine, Nijmeijer 2004, friction oscillators]. `static` > `kinetic` are the coefficients.
    """
    w, centre = np.sqrt(stiffness / mass), kinetic * normal / stiffness
    D = (static - kinetic) * normal / stiffness
    slip = 2.0 * (np.pi - np.arctan2(D * w, belt)) / w
    return BeltCycle(2.0 * D / belt, slip, centre + D, centre - D, centre + np.hypot(D, belt / w))


def _belt_speed_reached(phase: Phase, belt: float) -> float:
    """Time until a sliding block has the belt's velocity, infinite if never; grazing is never.

    With x - c = R cos(p), v = -R w sin(p), p = w t + const: from below p = pi + asin(V/(R w)), from
    above p = -asin(V/(R w)).
    """
    w = np.sqrt(phase.square)
    y = phase.x - phase.acceleration / phase.square
    fastest = np.hypot(y * w, phase.v)
    if fastest * (1.0 - 1e-12) <= belt:
        return np.inf
    arc = np.arcsin(belt / fastest)
    angle = np.pi + arc if phase.mode == "slip" else -arc
    return ((angle + np.arctan2(phase.v, y * w)) % (2.0 * np.pi)) / w


def belt_phases(
    t_end: float, mass: float, stiffness: float, normal: float, static: float, kinetic: float,
    belt: float, x0: float, v0: float,
) -> list[Phase]:
    """Block on a belt (velocity `belt` >= 0) and a spring to the wall (free at x = 0), up to t_end.

    Phases "stick" (with the belt), "slip" (slower than the belt, friction +mu_k N) and "overtake"
    (faster, -mu_k N). At the belt's velocity the block sticks if k |x| <= mu_s N; if not, the
    spring decides. Starts of small amplitude about x_k slip for ever, and so does every motion
    with mu_s = mu_k in the end. With a belt at rest this is the Coulomb oscillator.
    """
    square, push, limit = stiffness / mass, kinetic * normal / mass, static * normal / stiffness

    def enter(t: float, x: float, v: float) -> Phase:
        if v == belt and abs(x) <= limit * _LIMIT:
            return Phase(t, "stick", x, v)
        if v < belt or (v == belt and x > 0.0):
            return Phase(t, "slip", x, v, push, square)
        return Phase(t, "overtake", x, v, -push, square)

    phases = [enter(0.0, x0, v0)]
    while True:
        phase = phases[-1]
        if phase.mode == "stick":
            duration = max(limit - phase.x, 0.0) / belt if belt > 0.0 else np.inf
        else:
            duration = _belt_speed_reached(phase, belt)
        if phase.start + duration > t_end:
            return phases
        t, x, _ = _after(phase, duration)
        if phase.mode == "stick":
            phases.append(Phase(t, "slip", limit, belt, push, square))
        else:
            phases.append(enter(t, x, belt))


def force_at_energy(stiffness: float, energy: float) -> float:
    """Spring force (N) at which a linear spring stores `energy` (J): sqrt(2 k U)."""
    return np.sqrt(2.0 * stiffness * energy)


def fracture_phases(
    mass: float, stiffness: float, limit: float, x0: float, v0: float, load: float = 0.0
) -> list[Phase]:
    """Mass under a constant load on a spring that breaks for good at |k x| = limit (N).

    "whole" is x = c + R cos p about c = load/k, p = w t + const; it reaches +X = limit/k outwards
    at p = -acos((X - c)/R), -X at p = acos((-X - c)/R). Then "broken": x'' = load/m. The break
    turns limit^2/(2 k) of spring energy into heat. Without enough amplitude there is no second
    phase. `mass` may be a moment of inertia, the limit a torque.
    """
    w, X, c = np.sqrt(stiffness / mass), limit / stiffness, load / stiffness
    if abs(x0) >= X:
        return [Phase(0.0, "broken", x0, v0, load / mass)]
    whole = Phase(0.0, "whole", x0, v0, load / mass, w * w)
    R, at_start = np.hypot(x0 - c, v0 / w), -np.arctan2(v0 / w, x0 - c)
    times = [
        ((-side * np.arccos((side * X - c) / R) - at_start) % (2.0 * np.pi)) / w
        for side in (1.0, -1.0) if abs(side * X - c) < R
    ]
    if not times:
        return [whole]
    t, x, v = _after(whole, min(times))
    return [whole, Phase(t, "broken", np.copysign(X, x), v, load / mass)]


def impact(
    mass0: float, mass1: float, v0: float, v1: float, restitution: float
) -> tuple[float, float]:
    """Velocities of two particles on a line after an impact: v1' - v0' = -e (v1 - v0).

    Momentum is kept; with M = m0 m1/(m0 + m1) the energy M (1 - e^2) (v0 - v1)^2/2 is lost
    [Goldsmith 1960, Newton's restitution].
    """
    p = (1.0 + restitution) * (v0 - v1) * mass0 * mass1 / (mass0 + mass1)
    return v0 - p / mass0, v1 + p / mass1


def impacts_in_order(
    masses: Sequence[float], velocities: ArrayLike, restitution: float, limit: int = 1000
) -> tuple[Array, list[int]]:
    """Particles that touch in a row: pairwise impacts, always the leftmost approaching pair first.

    The result of simultaneous impacts depends on the order, except for equal masses with e = 1,
    which exchange velocities. Returns the velocities, and the left members of the pairs in the
    order of their impacts; ValueError beyond `limit` impacts.
    """
    v = np.array(velocities, dtype=float)
    order: list[int] = []
    while np.any(approaching := v[:-1] > v[1:] + 1e-15 * np.abs(v).max()):
        if len(order) == limit:
            raise ValueError(f"still approaching after {limit} impacts")
        i = int(np.argmax(approaching))
        v[i], v[i + 1] = impact(masses[i], masses[i + 1], v[i], v[i + 1], restitution)
        order.append(i)
    return v, order


class Body(NamedTuple):
    """A rigid body at an impact, in world axes: inertia (3, 3) about and v of the centre of mass.

    The arm goes from there to the contact point.
    """

    mass: float
    inertia: Array
    arm: Array
    v: Array
    w: Array


def impact_bodies(
    body0: Body, body1: Body, normal: ArrayLike, restitution: float
) -> tuple[Body, Body]:
    """Frictionless impact of two rigid bodies at a point; `normal` (unit) points from 0 to 1.

    The impulse p n on body 1 (-p n on body 0) has p = -(1 + e) n.(u1 - u0)/sum of
    (1/m + c.(I^-1 c)), c = arm x n, u the velocities of the contact point [Brogliato 1999].
    A body of infinite mass is a wall. Bodies that separate are left alone.
    """
    n = np.asarray(normal, dtype=float)
    approach, compliance = 0.0, 0.0
    for body, side in ((body0, -1.0), (body1, 1.0)):
        c = cross(body.arm, n)
        approach += side * (n @ body.v + c @ body.w)
        compliance += 1.0 / body.mass + c @ _turn(body, c)
    p = max(-(1.0 + restitution) * approach / compliance, 0.0)
    return tuple(
        body._replace(
            v=body.v + side * p / body.mass * n,
            w=body.w + side * p * _turn(body, cross(body.arm, n)),
        )
        for body, side in ((body0, -1.0), (body1, 1.0))
    )


def _turn(body: Body, moment: Array) -> Array:
    """I^-1 moment, zero for a body that does not turn."""
    if np.isinf(body.mass):
        return np.zeros(3)
    return np.linalg.solve(body.inertia, moment)
