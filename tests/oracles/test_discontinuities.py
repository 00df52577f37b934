"""The oracles of discontinuities and dissipation against published numbers and second opinions."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from . import closed_forms, dissipation, rotations, scenes
from . import discontinuities as events
from .discontinuities import Phase

EPS = np.finfo(float).eps
# Mass 1 kg dropped from 0.1 m: stiffness, contact time and depth from published.md.
PUBLISHED_CONTACTS = [
    (1e4, 0.03281435718836892, 0.01502245152753091),
    (1e6, 0.003155599565615692, 0.001410558455683603),
    (1e8, 3.142993367464368e-4, 1.401695447116542e-4),
]
# rho, h omega, |R|^1000 and one unit of its last digit, from published.md.
PUBLISHED_RADII = [
    (0.9, 0.3, 0.9994, 1e-4), (0.9, 1.0, 0.9439, 1e-4), (0.9, 10.0, 7.8e-8, 1e-9),
    (0.5, 0.1, 0.998, 1e-3), (0.5, 0.3, 0.868, 1e-3), (0.5, 1.0, 2.2e-5, 1e-6),
    (1.0, 1.0, 1.0, EPS), (1.0, 10.0, 1.0, EPS),
]
BLOCK = {"mass": 2.0, "stiffness": 50.0, "normal": 20.0, "static": 0.5, "kinetic": 0.3}


def check_motion(
    phases: Sequence[Phase], acceleration: Callable[[str, float, float], float], t_end: float,
    restitution: float = -1.0,
) -> None:
    """Every phase obeys its law, integrated numerically, and ends where the next one starts.

    The velocity there is -restitution times that before.
    """
    ends = [phase.start for phase in phases[1:]]
    assert ends == sorted(ends)
    for phase, end in zip(phases, [*ends, t_end], strict=True):
        def rates(y: np.ndarray, mode: str = phase.mode) -> np.ndarray:
            return np.array([y[1], acceleration(mode, y[0], y[1])])

        start, duration = np.array([phase.x, phase.v]), end - phase.start
        numbers = scenes.integrate(rates, start, duration, 12 + int(50 * duration))
        assert np.abs(np.array(events.motion(phase, end)) - numbers).max() < 1e-11
    for before, after in itertools.pairwise(phases):
        x, v = events.motion(before, after.start)
        assert abs(x - after.x) < 1e-11
        assert abs(restitution * v + after.v) < 1e-11


def insides(
    phases: Sequence[Phase], t_end: float
) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Mode, positions and velocities strictly inside each phase."""
    ends = [*(phase.start for phase in phases[1:]), t_end]
    inside = np.linspace(0.001, 0.999, 60)
    return [
        (phase.mode, *events.state_at(phases, phase.start + inside * (end - phase.start)))
        for phase, end in zip(phases, ends, strict=True)
    ]


def test_coulomb_oscillator_as_published() -> None:
    times, turns = events.coulomb_turns(1.0, 1.0, 0.1, 1.0)
    assert np.abs(turns - [1.0, -0.8, 0.6, -0.4, 0.2, 0.0]).max() < 8 * EPS
    assert np.abs(times - np.pi * np.arange(6)).max() < 64 * EPS
    phases = events.coulomb_phases(1.0, 1.0, 0.1, 1.0)
    x, v = events.state_at(phases, [5.0 * np.pi + 1e-9, 100.0])
    assert np.abs(x).max() < 8 * EPS
    assert np.array_equal(v, [0.0, 0.0])
    # Half way down from 1: on the centre 0.1, at speed 0.9.
    assert np.abs(np.array(events.state_at(phases, np.pi / 2)) - [0.1, -0.9]).max() < 8 * EPS


@pytest.mark.parametrize("v0", [0.0, 2.7, -2.7, 0.01])
@pytest.mark.parametrize("x0", [1.7, -1.7, 0.05])
def test_coulomb_oscillator_by_energy_and_as_belt_at_rest(x0: float, v0: float) -> None:
    m, k, F, t_end = 2.0, 30.0, 3.1, 12.0
    times, turns = events.coulomb_turns(m, k, F, x0, v0)
    way = np.cumsum(np.abs(np.diff([x0, *turns])))
    lost = 0.5 * m * v0**2 + 0.5 * k * x0**2 - 0.5 * k * turns**2
    assert np.abs(lost - F * way).max() < 100 * EPS * 50.0
    assert np.all(k * np.abs(turns[:-1]) > F)
    assert k * abs(turns[-1]) <= F
    # The belt at rest finds its events by other formulas.
    phases = events.coulomb_phases(m, k, F, x0, v0)
    belt = events.belt_phases(t_end, m, k, F, 1.0, 1.0, 0.0, x0, v0)
    assert phases[-1].start == times[-1] < t_end
    t = np.linspace(0.0, t_end, 500)
    for a, b in zip(events.state_at(phases, t), events.state_at(belt, t), strict=True):
        assert np.abs(a - b).max() < 1e-12


def test_coulomb_oscillator_sticks_earlier_with_a_static_limit() -> None:
    turns = events.coulomb_turns(1.0, 1.0, 0.1, 1.0, static=0.5)[1]
    assert np.abs(turns - [1.0, -0.8, 0.6, -0.4]).max() < 8 * EPS


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9, 1.0])
def test_bouncing_ball(restitution: float) -> None:
    g, height, v0 = 9.81, 0.3, 0.8
    times, speeds = events.ball_impacts(10, height, g, restitution, v0)
    # Flight by flight, each from the energy and the velocity at its start.
    t, y, v = 0.0, height, v0
    for time, speed in zip(times, speeds, strict=True):
        u = np.sqrt(v * v + 2.0 * g * y)
        t, y, v = t + (v + u) / g, 0.0, restitution * u
        assert time == pytest.approx(t, rel=16 * EPS)
        assert speed == pytest.approx(v, rel=16 * EPS)
    count = 10 if restitution == 1.0 else None
    phases = events.ball_phases(height, g, restitution, v0, count)
    starts = [phase.start for phase in phases]
    assert starts == sorted(starts)
    t_end = times[0] + 0.1 if restitution == 0.0 else starts[5]
    check_motion(phases[:5], lambda mode, x, v: -g if mode == "flight" else 0.0, t_end, restitution)
    for mode, x, _ in insides(phases, starts[-1])[:9]:
        assert mode == "flight" or restitution == 0.0
        assert np.all(x > 0.0) or restitution == 0.0
    if restitution < 1.0:
        zeno = events.ball_zeno(height, g, restitution, v0)
        # What is left after ten bounces is a geometric sum with the last flight as first term.
        rest = 2.0 * speeds[-1] / g / (1.0 - restitution)
        assert zeno == pytest.approx(times[-1] + rest, rel=16 * EPS)
        assert np.array_equal(events.state_at(phases, [zeno + 1e-12, 1e3]), np.zeros((2, 2)))


def test_zeno_time_without_restitution_is_the_first_impact() -> None:
    assert events.ball_zeno(0.1, 9.81, 0.0) == events.ball_impacts(1, 0.1, 9.81, 0.0)[0][0]


@pytest.mark.parametrize(("stiffness", "duration", "depth"), PUBLISHED_CONTACTS)
def test_contact_as_published(stiffness: float, duration: float, depth: float) -> None:
    contact = events.drop_contact(1.0, stiffness, 0.1, 9.81)
    assert contact.duration == pytest.approx(duration, rel=1e-14)
    assert contact.depth == pytest.approx(depth, rel=1e-14)
    fall = np.sqrt(2.0 * 0.1 / 9.81)
    # Ten bounces: every contact as long as the first, every flight twice the fall.
    phases = events.spring_bounce_phases(10 * (2 * fall + duration), 1.0, stiffness, 0.0, 9.81, 0.1)
    starts = np.array([phase.start for phase in phases])
    assert starts[1] == pytest.approx(fall, rel=4 * EPS)
    # A contact's end comes from the zero of a force: the rounding of w t over its slope.
    assert np.abs(np.diff(starts)[1::2] - duration).max() < 1e-13
    assert np.abs(np.diff(starts)[2::2] - 2.0 * fall).max() < 1e-12
    bottom = starts[1::2] + 0.5 * duration
    x, v = events.state_at(phases, bottom[bottom < starts[-1]])
    assert np.abs(x + depth).max() < 1e-12
    assert np.abs(v).max() < 1e-9


@pytest.mark.parametrize("ratio", [0.0, 1e-3, 0.3, 0.8, 0.999999, 1.0, 1.000001, 3.0])
def test_contact_with_a_dashpot(ratio: float) -> None:
    m, k, u = 2.0, 800.0, 3.0
    d = 2.0 * ratio * np.sqrt(k * m)
    contact = events.dashpot_contact(m, k, d, u)
    y, v = closed_forms.damped_oscillator(contact.duration, m, k, d, -u)
    assert v == pytest.approx(contact.rebound, rel=1e-10)
    assert k * y + d * v == pytest.approx(0.0, abs=1e-10 * u * np.sqrt(k * m))
    inside = np.linspace(0.0, contact.duration, 202)
    y, v = closed_forms.damped_oscillator(inside, m, k, d, -u)
    assert np.all((k * y + d * v)[1:-1] < 0.0)
    y, v = closed_forms.damped_oscillator(0.5 * contact.duration, m, k, d, -u)
    assert -y == pytest.approx(contact.depth, rel=1e-10)
    assert abs(v) < 1e-9 * u
    # Energy: kinetic at the start, what the dashpot took (trapezoidal rule), and what is left.
    t = np.linspace(0.0, contact.duration, 20001)
    y, v = closed_forms.damped_oscillator(t, m, k, d, -u)
    left = 0.5 * m * contact.rebound**2 + 0.5 * k * y[-1] ** 2
    assert 0.5 * m * u**2 - np.trapezoid(d * v * v, t) == pytest.approx(left, abs=1e-6)
    # The events of the bouncing mass without weight tend to it.
    g = 1e-4
    phases = events.spring_bounce_phases(2.0 * u / g, m, k, d, g, 0.5 * u * u / g)
    assert phases[2].start - phases[1].start == pytest.approx(contact.duration, rel=1e-4)


@pytest.mark.parametrize("damping", [0.0, 0.4, 5.0, 17.0, 40.0, 70.0])
def test_bouncing_on_spring_and_dashpot(damping: float) -> None:
    m, k, g, t_end = 1.5, 700.0, 9.81, 3.0
    phases = events.spring_bounce_phases(t_end, m, k, damping, g, 0.2, 0.5)

    def push(y: float, v: float) -> float:
        return -k * y - damping * v

    assert phases[1].mode == "contact"
    check_motion(
        phases, lambda mode, y, v: (push(y, v) if mode == "contact" else 0.0) / m - g, t_end
    )
    for mode, y, v in insides(phases, t_end):
        if mode == "contact":
            assert np.all(y < 0.0)
            assert np.all(push(y, v) > 0.0)
        else:
            assert np.all((y > 0.0) | (push(y, v) < 1e-9))
    if damping > 1.0:
        y, v = events.state_at(phases, 2.999)
        assert phases[-1].mode == "contact"
        assert y == pytest.approx(-m * g / k, abs=0.01)


def test_next_contact_below_the_surface() -> None:
    """A strong dashpot leaves the spring compressed, and the mass falls back onto it."""
    m, k, g = 1.5, 700.0, 9.81
    found = 0
    for damping in np.linspace(5.0, 70.0, 40):
        phases = events.spring_bounce_phases(4.0, m, k, damping, g, 0.2)
        for before, after in itertools.pairwise(phases[1:]):
            if after.mode == "contact" and after.x < 0.0:
                found += 1
                assert before.x < 0.0
                assert k * after.x + damping * after.v == pytest.approx(0.0, abs=1e-10)
    assert found > 0


def test_belt_limit_cycle() -> None:
    belt = 0.1
    cycle = events.belt_cycle(**BLOCK, belt=belt)
    k, normal, kinetic = (BLOCK[name] for name in ("stiffness", "normal", "kinetic"))
    phases = events.belt_phases(100.0, **BLOCK, belt=belt, x0=0.05, v0=-0.3)
    starts = np.array([phase.start for phase in phases])
    modes = [phase.mode for phase in phases]
    first = modes.index("stick") + 1  # the first stick may begin anywhere
    assert modes[first:] == ["slip", "stick"] * ((len(modes) - first) // 2) + ["slip"] * (
        (len(modes) - first) % 2
    )
    assert len(modes) > 30
    lengths = np.diff(starts)[first:]
    assert np.abs(lengths[::2] - cycle.slip).max() < 1e-12
    assert np.abs(lengths[1::2] - cycle.stick).max() < 1e-12
    for phase in phases[first:]:
        x = cycle.slip_start if phase.mode == "slip" else cycle.stick_start
        assert phase.x == pytest.approx(x, abs=1e-14)
        assert phase.v == belt
    x, _ = events.state_at(phases, np.linspace(50.0, 60.0, 20001))
    assert x.max() == pytest.approx(cycle.greatest, abs=1e-7)
    # Per cycle: what the belt puts in, its friction turns into heat.
    gained = belt * (0.5 * k * (cycle.slip_start**2 - cycle.stick_start**2) / belt
                     + kinetic * normal * cycle.slip)
    heat = kinetic * normal * (belt * cycle.slip - (cycle.stick_start - cycle.slip_start))
    assert gained == pytest.approx(heat, rel=1e-13)


@pytest.mark.parametrize(("belt", "x0", "v0"), [
    (0.1, 0.05, -0.3), (0.1, 0.0, 0.1), (0.1, 0.0, 1.5), (0.3, -0.6, 0.3), (0.1, 0.5, 0.1),
    (0.0, 0.9, 0.0), (0.0, -0.9, -0.4), (1.0, 0.13, 0.05),
])
def test_block_on_a_belt(belt: float, x0: float, v0: float) -> None:
    m, k, normal, static, kinetic = BLOCK.values()
    push = {"stick": None, "slip": kinetic * normal, "overtake": -kinetic * normal}
    t_end = 7.0
    phases = events.belt_phases(t_end, **BLOCK, belt=belt, x0=x0, v0=v0)
    check_motion(
        phases, lambda mode, x, v: 0.0 if mode == "stick" else (push[mode] - k * x) / m, t_end
    )
    for mode, x, v in insides(phases, t_end):
        if mode == "stick":
            assert np.all(v == belt)
            assert np.all(np.abs(k * x) <= static * normal)
        else:
            assert np.all(v < belt) if mode == "slip" else np.all(v > belt)
    if belt == 1.0:
        assert len(phases) == 1  # too small an amplitude ever to reach the belt's velocity


def test_belt_with_equal_coefficients_stops_sticking() -> None:
    phases = events.belt_phases(50.0, 2.0, 50.0, 20.0, 0.3, 0.3, 0.1, -0.05, 0.1)
    assert [phase.mode for phase in phases] == ["stick", "slip"]
    _, v = events.state_at(phases, np.linspace(phases[1].start, 50.0, 10001))
    assert v.max() < 0.1 * (1.0 + 1e-12)


@pytest.mark.parametrize(("x0", "v0", "load"), [
    (0.0, 3.0, 0.0), (0.0, -3.0, 0.0), (0.09, -2.5, 0.0), (-0.05, 0.1, 9.0), (0.0, 0.0, -7.0),
])
def test_fracture(x0: float, v0: float, load: float) -> None:
    m, k, limit = 0.5, 100.0, 12.0
    phases = events.fracture_phases(m, k, limit, x0, v0, load)
    assert [phase.mode for phase in phases] == ["whole", "broken"]
    t_end = phases[1].start + 0.7
    check_motion(
        phases, lambda mode, x, v: (load - (k * x if mode == "whole" else 0.0)) / m, t_end
    )
    (_, x, _), _ = insides(phases, t_end)
    assert np.all(k * np.abs(x) < limit)
    assert k * abs(phases[1].x) == pytest.approx(limit, rel=4 * EPS)
    assert phases[1].x * phases[1].v > 0.0
    # Energy: what the spring held at the break is gone.
    x, v = events.state_at(phases, t_end)
    start = 0.5 * m * v0**2 + 0.5 * k * x0**2 - load * x0
    assert 0.5 * m * v**2 - load * x == pytest.approx(start - 0.5 * limit**2 / k, rel=1e-13)
    assert events.force_at_energy(k, 0.5 * limit**2 / k) == pytest.approx(limit, rel=4 * EPS)


def test_fracture_that_does_not_happen_or_already_has() -> None:
    assert len(events.fracture_phases(0.5, 100.0, 12.0, 0.05, 0.5)) == 1
    assert events.fracture_phases(0.5, 100.0, 12.0, 0.12, 0.5)[0].mode == "broken"


@pytest.mark.parametrize("e", [0.0, 0.6, 1.0])
def test_impact_of_two_particles(e: float) -> None:
    m0, m1, v0, v1 = 2.0, 3.0, 1.5, -0.7
    a, b = events.impact(m0, m1, v0, v1, e)
    assert b - a == pytest.approx(e * (v0 - v1), abs=1e-15)
    assert m0 * a + m1 * b == pytest.approx(m0 * v0 + m1 * v1, rel=1e-14)
    lost = 0.5 * (m0 * (v0**2 - a**2) + m1 * (v1**2 - b**2))
    assert lost == pytest.approx(0.5 * (m0 * m1 / (m0 + m1)) * (1 - e * e) * (v0 - v1) ** 2)


def test_impacts_in_a_row() -> None:
    v, order = events.impacts_in_order([1.0] * 4, [3.0, 0.0, 0.0, 0.0], 1.0)
    assert np.array_equal(v, [0.0, 0.0, 0.0, 3.0])
    assert order == [0, 1, 2]
    v, _ = events.impacts_in_order([1.0] * 4, [3.0, 2.0, 0.0, -1.0], 1.0)
    assert np.allclose(v, [-1.0, 0.0, 2.0, 3.0], atol=8 * EPS)
    masses = np.array([2.0, 0.1, 0.3, 1.0])
    v, order = events.impacts_in_order(masses, [1.0, 0.0, 0.0, -1.0], 0.9)
    assert masses @ v == pytest.approx(1.0, rel=1e-14)
    assert np.all(np.diff(v) > -1e-14)
    assert len(order) > 3
    # The order matters: the mirror image, mirrored back, ends otherwise.
    mirrored, _ = events.impacts_in_order(masses[::-1], [1.0, 0.0, 0.0, -1.0], 0.9)
    assert np.abs(v + mirrored[::-1]).max() > 0.01
    with pytest.raises(ValueError, match="after 2 impacts"):
        events.impacts_in_order(masses, [1.0, 0.0, 0.0, -1.0], 0.9, limit=2)


@pytest.mark.parametrize("e", [0.0, 0.6, 1.0])
def test_impact_of_two_bodies(e: float) -> None:
    rng = np.random.default_rng(3)
    n = rng.normal(size=3)
    n /= np.linalg.norm(n)
    R = rotations.exp_so3([0.3, 1.0, -0.4])
    arms = rng.normal(size=(2, 3))
    start = (
        events.Body(2.0, R @ np.diag([0.2, 0.3, 0.4]) @ R.T, arms[0], 3.0 * n, rng.normal(size=3)),
        events.Body(3.0, np.diag([0.5, 0.4, 0.3]), arms[1], -3.0 * n, rng.normal(size=3)),
    )
    end = events.impact_bodies(*start, n, e)

    def separation(bodies: Sequence[events.Body]) -> float:
        velocities = [body.v + np.cross(body.w, body.arm) for body in bodies]
        return n @ (velocities[1] - velocities[0])

    def momentum(bodies: Sequence[events.Body]) -> np.ndarray:
        # About the contact point: the centre of mass lies at -arm.
        return sum(np.concatenate([
            body.mass * body.v, body.inertia @ body.w - np.cross(body.arm, body.mass * body.v),
        ]) for body in bodies)

    def energy(bodies: Sequence[events.Body]) -> float:
        return sum(0.5 * b.mass * b.v @ b.v + 0.5 * b.w @ b.inertia @ b.w for b in bodies)

    assert separation(start) < 0.0
    assert separation(end) == pytest.approx(-e * separation(start), abs=1e-13)
    assert np.abs(momentum(end) - momentum(start)).max() < 1e-13 * 20
    assert energy(end) <= energy(start) * (1.0 + 8 * EPS)
    assert (energy(end) == pytest.approx(energy(start), rel=1e-13)) == (e == 1.0)
    assert np.array_equal(events.impact_bodies(*end, n, e)[0].v, end[0].v) or e == 0.0


def test_impact_of_bodies_reduces_to_particles_and_walls() -> None:
    n, still = np.array([1.0, 0.0, 0.0]), np.zeros(3)
    bodies = [
        events.Body(m, np.eye(3), 0.3 * side * n, v * n, still)
        for m, v, side in ((2.0, 1.5, 1.0), (3.0, -0.7, -1.0))
    ]
    end = events.impact_bodies(*bodies, n, 0.4)
    expected = events.impact(2.0, 3.0, 1.5, -0.7, 0.4)
    assert [body.v[0] for body in end] == pytest.approx(expected, rel=1e-14)
    wall = events.Body(np.inf, np.eye(3), still, still, still)
    assert events.impact_bodies(bodies[0], wall, n, 0.4)[0].v[0] == pytest.approx(-0.6)
    # A rod (m, length 2 l) falling flat with one tip on a step, plastic impact: the tip stops. Its
    # angular momentum about the tip is kept, m l v = (m l^2/3 + m l^2) w, so w = 3 v/(4 l).
    m, l, v, up = 1.2, 0.5, 2.0, np.array([0.0, 0.0, 1.0])
    rod = events.Body(
        m, np.diag([1e-9, m * l * l / 3.0, m * l * l / 3.0]), l * n, -v * up, still
    )
    _, rod = events.impact_bodies(wall, rod, up, 0.0)
    assert np.abs(rod.w) == pytest.approx([0.0, 0.75 * v / l, 0.0], rel=1e-13)
    assert np.abs(rod.v + np.cross(rod.w, rod.arm)).max() < 1e-14


def test_elastoplastic_cycle_by_hand() -> None:
    """k = 100, F_y = 1 (u_y = 0.01), H = 25, cycle +-0.03: p = +-(3 - 1)/125 = +-0.016.

    Peak force 100 (0.03 - 0.016) = 1.4 = H p + F_y; it yields again after a fall of 2 F_y, at
    u = 0.03 - 0.02 = 0.01. Lost per cycle F_y times the plastic way 4 x 0.016 = 0.064 J.
    """
    u = np.array([0.0, 0.01, 0.03, 0.01, -0.03, -0.01, 0.03])
    h = dissipation.elastoplastic(u, 100.0, 1.0, kinematic=25.0)
    assert np.abs(h.force - [0.0, 1.0, 1.4, -0.6, -1.4, 0.6, 1.4]).max() < 16 * EPS
    assert np.abs(h.plastic - [0.0, 0.0, 0.016, 0.016, -0.016, -0.016, 0.016]).max() < EPS
    assert h.dissipated[-1] - h.dissipated[2] == pytest.approx(0.064, rel=1e-14)
    # Corners of the loop (a parallelogram) by the shoelace formula.
    corners = np.array([u[2:6], h.force[2:6]])
    x, y = corners
    area = 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    assert area == pytest.approx(0.064, rel=1e-14)
    assert dissipation.kinematic_loop_area(0.03, 100.0, 1.0, 25.0) == pytest.approx(0.064)
    assert h.work[-1] - h.work[2] == pytest.approx(0.064, rel=1e-13)


def test_perfect_plasticity_as_published() -> None:
    k, Fy, um = 4e3, 7.0, 0.01
    u = np.concatenate([[0.0], um * np.tile([1.0, -1.0], 3), [um]])
    h = dissipation.elastoplastic(u, k, Fy)
    loss = 4.0 * Fy * (um - Fy / k)
    assert np.abs(np.diff(h.work[1::2]) - loss).max() < 1e-14
    assert np.abs(np.diff(h.dissipated[1::2]) - loss).max() < 1e-14
    assert dissipation.kinematic_loop_area(um, k, Fy) == pytest.approx(loss, rel=1e-14)
    assert dissipation.kinematic_loop_area(0.99 * Fy / k, k, Fy) == 0.0


@pytest.mark.parametrize(("H", "I"), [(0.0, 0.0), (20.0, 0.0), (0.0, 9.0), (20.0, 9.0)])
def test_elastoplastic_does_not_depend_on_the_pieces(H: float, I: float) -> None:
    k, Fy = 100.0, 1.0
    corners = np.array([0.0, 0.03, -0.02, 0.011, -0.05, 0.07, 0.05, 0.02])
    coarse = dissipation.elastoplastic(corners, k, Fy, H, I)
    pieces = 4000
    fine_u = np.interp(np.arange(7 * pieces + 1) / pieces, np.arange(8), corners)
    fine = dissipation.elastoplastic(fine_u, k, Fy, H, I)
    for a, b in zip(coarse, fine, strict=True):
        assert np.abs(a - b[::pieces]).max() < 1e-13
    # Karush-Kuhn-Tucker conditions, and the energies.
    y = np.abs(fine.force - H * fine.plastic) - Fy - I * fine.length
    assert y.max() < 1e-13
    moved = np.diff(fine.length) > 0.0
    assert np.abs(y[1:][moved]).max() < 1e-13
    assert np.all(np.diff(fine.plastic)[moved] * (fine.force - H * fine.plastic)[1:][moved] > 0.0)
    stored = 0.5 * H * fine.plastic**2 + 0.5 * I * fine.length**2
    assert np.abs(fine.plastic_work - fine.dissipated - stored).max() < 1e-13
    area = np.concatenate([[0.0], np.cumsum(
        0.5 * (fine.force[1:] + fine.force[:-1]) * np.diff(fine_u)
    )])
    # The trapezoidal rule errs in the few pieces that hold a corner of the force only.
    assert np.abs(fine.work - area).max() < 14 * k * (np.diff(fine_u).max()) ** 2


def test_isotropic_hardening_shakes_down() -> None:
    k, Fy, I, um = 100.0, 1.0, 30.0, 0.03
    u = np.concatenate([[0.0], um * np.tile([1.0, -1.0], 30)])
    h = dissipation.elastoplastic(u, k, Fy, isotropic=I)
    peaks = dissipation.isotropic_peaks(60, um, k, Fy, I)
    assert np.abs(np.abs(h.force[1:]) - peaks).max() < 1e-13
    assert h.length[-1] == pytest.approx((k * um - Fy) / I, rel=1e-12)


def test_maxwell_branches_against_integration() -> None:
    k, branches = 50.0, [(30.0, 6.0), (80.0, 1.0)]
    omega, U = 7.0, 0.2

    def forces(y: np.ndarray) -> np.ndarray:
        """Time, then the branches, under u = U sin(w t)."""
        rate = U * omega * np.cos(omega * y[0])
        return np.array([1.0, *(ki * rate - ki / c * f for (ki, c), f in zip(
            branches, y[1:], strict=True))])

    end = scenes.integrate(forces, np.zeros(3), 1.3, 100)
    exact = dissipation.maxwell_sine(1.3, k, branches, omega, U)
    # The integrated time is rounded to 1e-13 s, at a force rate of 40 N/s.
    assert exact == pytest.approx(k * U * np.sin(omega * 1.3) + end[1:].sum(), abs=2e-11)
    assert dissipation.maxwell_sine(0.0, k, branches, omega, U) == 0.0
    # A steady cycle, long after the start: loss by the trapezoidal rule (exact for a period).
    t = 20.0 + 2.0 * np.pi / omega * np.arange(64) / 64
    f = dissipation.maxwell_sine(t, k, branches, omega, U)
    loss = np.mean(f * U * omega * np.cos(omega * t)) * 2.0 * np.pi / omega
    assert dissipation.maxwell_cycle_loss(omega, U, branches) == pytest.approx(loss, rel=1e-12)
    assert loss > 0.0
    # Force amplitude and phase.
    K = dissipation.maxwell_stiffness(omega, k, branches)
    assert np.abs(f - U * (K * np.exp(1j * omega * t)).imag).max() < 1e-12

    # The free oscillator.
    m, x0, v0 = 0.4, 0.3, -1.0

    def rates(y: np.ndarray) -> np.ndarray:
        x, v, *f = y
        return np.array([v, -(k * x + sum(f)) / m, *(ki * v - ki / c * fi for (ki, c), fi in zip(
            branches, f, strict=True))])

    end = scenes.integrate(rates, np.array([x0, v0, 0.0, 0.0]), 2.0, 80)
    free = dissipation.maxwell_oscillator([0.0, 2.0], m, k, branches, x0, v0)
    assert np.abs(free - [[x0, v0, 0.0, 0.0], end]).max() < 1e-13


def test_maxwell_relaxation_creep_and_limits() -> None:
    k, k1, c1 = 50.0, 30.0, 6.0
    relaxed = dissipation.maxwell_relaxation([0.0, 1e3], k, [(k1, c1)], 0.1)
    assert relaxed == pytest.approx([8.0, 5.0], rel=1e-14)
    crept = dissipation.maxwell_creep([0.0, 1e3], k, (k1, c1), 4.0)
    assert crept == pytest.approx([0.05, 0.08], rel=1e-14)
    # Creep is what keeps the force constant: f = k u + f_1 with f_1 integrated for this u.
    decay = k * k1 / (c1 * (k + k1))
    rate0 = decay * (0.08 - 0.05)

    def branch(y: np.ndarray) -> np.ndarray:
        return np.array([1.0, k1 * rate0 * np.exp(-decay * y[0]) - k1 / c1 * y[1]])

    f1 = scenes.integrate(branch, np.array([0.0, k1 * 0.05]), 0.4, 10)[1]
    u = dissipation.maxwell_creep(0.4, k, (k1, c1), 4.0)
    assert k * u + f1 == pytest.approx(4.0, rel=1e-13)
    # Without the spring the branch flows; it is the limit of a soft spring.
    flow = dissipation.maxwell_creep(0.4, 0.0, (k1, c1), 4.0)
    assert dissipation.maxwell_creep(0.4, 1e-7, (k1, c1), 4.0) == pytest.approx(flow, rel=1e-7)
    slow, fast = dissipation.maxwell_stiffness([1e-9, 1e12], k, [(k1, c1)])
    assert slow == pytest.approx(k, rel=1e-8)
    assert fast == pytest.approx(k + k1, rel=1e-8)
    # The loss is greatest at w c/k = 1, where it is k_1/2.
    assert dissipation.maxwell_stiffness(k1 / c1, k, [(k1, c1)]).imag == pytest.approx(0.5 * k1)


@pytest.mark.parametrize("width", [0.02, 0.3, 2.0])
def test_sliding_with_tanh_friction(width: float) -> None:
    m, F, v0 = 1.5, 4.0, 1.2

    def rates(y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -F / m * np.tanh(y[1] / width)])

    y = np.array([0.0, v0])
    steps = 30 if width > 0.1 else 400
    for t in (0.2, 0.4, 0.6, 0.8):
        y = scenes.integrate(rates, y, 0.2, steps, 4)
        assert np.abs(np.array(dissipation.tanh_slide(t, m, F, width, v0)) - y).max() < 1e-9
    s, v = dissipation.tanh_slide(np.array([0.0, 1e3]), m, F, width, v0)
    assert v == pytest.approx([v0, 0.0], abs=1e-14)
    excess = s[1] - m * v0**2 / (2.0 * F)
    formula = dissipation.tanh_slide_excess(m, F, width)
    assert abs(excess / formula - 1.0) < 10 * (1.0 + v0 / width) * np.exp(-2.0 * v0 / width) + 1e-10
    # Energy: m v dv = -F tanh ds, and so the whole way takes longer than the ideal one.
    assert excess > 0.0
    creep = dissipation.tanh_creep(0.7 * F, F, width)
    assert F * np.tanh(creep / width) == pytest.approx(0.7 * F, rel=1e-14)


def test_tanh_friction_of_a_very_small_width() -> None:
    """sinh(v0/e) overflows there; ideal Coulomb friction is the limit."""
    t = np.array([0.0, 0.1, 0.3])
    s, v = dissipation.tanh_slide(t, 1.0, 2.0, 1e-6, 1.0)
    assert np.abs(v - (1.0 - 2.0 * t)).max() < 1e-14
    assert np.abs(s - (t - t * t)).max() < 1e-14


@pytest.mark.parametrize(("rho", "h_omega", "power", "digit"), PUBLISHED_RADII)
def test_spectral_radius_as_published(
    rho: float, h_omega: float, power: float, digit: float
) -> None:
    radius = dissipation.spectral_radius(h_omega, rho)
    assert radius**1000 == pytest.approx(power, abs=0.5 * digit + 1000 * 2 * EPS)


@pytest.mark.parametrize("rho", [1.0, 0.9, 0.5, 0.0])
def test_roots_belong_to_the_amplification_matrix(rho: float) -> None:
    for h_omega in 10.0 ** np.arange(-2.0, 4.5, 0.5):
        A = dissipation.amplification_matrix(h_omega, rho)
        roots = dissipation.alpha_roots(h_omega, rho)
        # Coefficients of the characteristic polynomial, which stay accurate near a triple root.
        minors = 0.5 * (np.trace(A) ** 2 - np.trace(A @ A))
        assert np.trace(A) == pytest.approx(roots.sum().real, abs=1e-13)
        assert minors == pytest.approx((roots.prod() * (1.0 / roots).sum()).real, abs=1e-12)
        assert np.linalg.det(A) == pytest.approx(roots.prod().real, abs=1e-13)
        for root in roots:
            z = h_omega**2
            parts = ((1 + rho) ** 2 * (root - 1) ** 2 * ((2 - rho) * root + 2 * rho - 1),
                     z * (root + rho) ** 3)
            assert abs(sum(parts)) < 1e-11 * (1.0 + sum(map(abs, parts)))
        assert dissipation.spectral_radius(h_omega, rho) <= 1.0 + 2 * EPS
        eigenvalues = np.abs(np.linalg.eigvals(A)).max()
        assert eigenvalues == pytest.approx(dissipation.spectral_radius(h_omega, rho), abs=1e-8)
    # The roots reach rho like (h w)^(-2/3).
    assert dissipation.spectral_radius(1e14, rho) == pytest.approx(rho, abs=1e-8)


@pytest.mark.parametrize("rho", [1.0, 0.9, 0.5, 0.0])
def test_numerical_damping_of_small_steps(rho: float) -> None:
    r = (1.0 - rho) / (1.0 + rho)
    for h in (0.02, 0.04):
        damping, lengthening = dissipation.numerical_damping(h, rho)
        assert damping == pytest.approx(0.5 * r**3 * h**3, rel=20 * h * h, abs=1e-13)
        assert lengthening == pytest.approx((1 / 12 + 0.375 * r * r) * h * h, rel=20 * h * h)
    if rho == 1.0:  # the trapezoidal rule: no damping, phase 2 atan(h/2)
        damping, lengthening = dissipation.numerical_damping(3.0, 1.0)
        assert abs(damping) < EPS
        assert lengthening == pytest.approx(3.0 / (2.0 * np.arctan(1.5)) - 1.0, rel=1e-14)


@pytest.mark.parametrize("rho", [1.0, 0.9, 0.5, 0.0])
@pytest.mark.parametrize(("omega", "ratio"), [(1e-1, 0.0), (20.0, 0.0), (20.0, 0.3), (1e5, 0.0)])
def test_integrator_has_the_amplification_matrix(rho: float, omega: float, ratio: float) -> None:
    h = 0.1
    A = dissipation.amplification_matrix(h * omega, rho, ratio)
    for start in np.eye(3):
        q, v, a = start / [1.0, h, h * h]
        steps = dissipation.alpha_steps(
            lambda t, q, v, rate: rate + 2.0 * ratio * omega * v + omega**2 * q,
            lambda t, q, v, rate: (
                omega**2 * np.eye(1), 2.0 * ratio * omega * np.eye(1), np.eye(1)
            ),
            q, v, h, 1, rho, a0=a,
        )
        got = np.array([steps.q[1, 0], h * steps.v[1, 0], h * h * steps.a[1, 0]])
        # v' is as large as (h w)^2 q, and known to Newton's relative tolerance.
        assert np.abs(got - A @ start).max() < 1e-12 * max(1.0, np.abs(A).max())


def pendulum_residual(t: float, q: np.ndarray, v: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Two pendulums, coupled through the mass matrix, driven and damped."""
    c = np.cos(q[0] - q[1])
    M = np.array([[2.0, c], [c, 1.0]])
    s = np.sin(q[0] - q[1])
    return M @ rate + np.array([
        s * v[1] ** 2 + 20.0 * np.sin(q[0]) + 0.3 * v[0],
        -s * v[0] ** 2 + 10.0 * np.sin(q[1]) - np.cos(3.0 * t),
    ])


def pendulum_jacobian(
    t: float, q: np.ndarray, v: np.ndarray, rate: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Complex steps."""
    steps = 1e-30j * np.eye(2)
    return tuple(
        np.array([pendulum_residual(t, *args(e)).imag for e in steps]).T / 1e-30
        for args in (
            lambda e: (q + e, v, rate), lambda e: (q, v + e, rate), lambda e: (q, v, rate + e)
        )
    )


@pytest.mark.parametrize("rho", [1.0, 0.9, 0.5, 0.0])
def test_order_two_on_a_double_pendulum(rho: float) -> None:
    def rates(y: np.ndarray) -> np.ndarray:
        t, q, v = y[0], y[1:3], y[3:]
        M = pendulum_jacobian(t, q, v, np.zeros(2))[2]
        return np.concatenate([
            [1.0], v, -np.linalg.solve(M, pendulum_residual(t, q, v, np.zeros(2)))
        ])

    exact = scenes.integrate(rates, np.array([0.0, 0.7, -0.4, 0.0, 0.5]), 1.0, 25)[1:]
    errors = []
    for n in (200, 400):
        steps = dissipation.alpha_steps(
            pendulum_residual, pendulum_jacobian, [0.7, -0.4], [0.0, 0.5], 1.0 / n, n, rho
        )
        errors.append(np.linalg.norm(np.concatenate([steps.q[-1], steps.v[-1]]) - exact))
        rest = [pendulum_residual(*x) for x in zip(*steps[:4], strict=True)]
        assert np.abs(rest).max() < 1e-10
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("rho", [1.0, 0.9, 0.5, 0.0])
def test_order_two_on_a_free_top(rho: float) -> None:
    inertia, w0 = np.diag([0.5, 0.5, 0.2]), [1.5, -0.5, 4.0]
    R0 = rotations.exp_so3([0.4, -1.0, 0.3])
    R_exact, w_exact = closed_forms.free_symmetric_top(1.0, 0.5, 0.2, R0, w0)
    g = np.array([0.3, 0.0, -9.81])
    errors = []
    for n in (40, 80):
        steps = dissipation.alpha_body(
            2.0, inertia, lambda t, p, R, v, w: (2.0 * g, np.zeros(3)), [1.0, 0.0, 2.0], R0,
            [1.0, 2.0, 3.0, *w0], 1.0 / n, n, rho,
        )
        errors.append([
            np.linalg.norm(rotations.log_so3(R_exact.T @ steps.R[-1])),
            np.linalg.norm(steps.v[-1, 3:] - w_exact),
        ])
        # The translation has a constant acceleration, which the method integrates exactly.
        p, v = closed_forms.ballistic(1.0, [1.0, 0.0, 2.0], [1.0, 2.0, 3.0], g)
        assert np.abs(steps.p[-1] - p).max() < 1e-12
        assert np.abs(steps.v[-1, :3] - v).max() < 1e-12
        assert np.abs(steps.R[-1].T @ steps.R[-1] - np.eye(3)).max() < 1e-13
    assert np.log2(np.divide(*errors)) == pytest.approx(2.0, abs=0.15)


@pytest.mark.parametrize("rho", [1.0, 0.6, 0.0])
def test_body_about_a_fixed_axis_is_the_method_on_the_line(rho: float) -> None:
    """A driven torsion pendulum about one axis, and a linear spring: increments simply add up."""
    axis, angle0 = np.array([2.0, -1.0, 2.0]) / 3.0, 0.4

    def wrench(
        t: float, p: np.ndarray, R: np.ndarray, v: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        # unskew(R) = axis sin(angle)
        return -30.0 * p - 0.2 * v, -8.0 * rotations.unskew(R) - 0.1 * w + np.cos(5.0 * t) * axis

    body = dissipation.alpha_body(
        2.0, 0.7 * np.eye(3), wrench, [0.1, 0.0, -0.2], rotations.exp_so3(angle0 * axis),
        [0.0, 0.5, 0.0, *(3.0 * axis)], 0.05, 40, rho,
    )

    def residual(t: float, q: np.ndarray, v: np.ndarray, rate: np.ndarray) -> np.ndarray:
        torque = -8.0 * np.sin(q[3]) - 0.1 * v[3] + np.cos(5.0 * t)
        return np.array([2.0, 2.0, 2.0, 0.7]) * rate - np.array(
            [*(-30.0 * q[:3] - 0.2 * v[:3]), torque]
        )

    def jacobian(
        t: float, q: np.ndarray, v: np.ndarray, rate: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return (
            np.diag([30.0, 30.0, 30.0, 8.0 * np.cos(q[3])]), np.diag([0.2, 0.2, 0.2, 0.1]),
            np.diag([2.0, 2.0, 2.0, 0.7]),
        )

    line = dissipation.alpha_steps(
        residual, jacobian, [0.1, 0.0, -0.2, angle0], [0.0, 0.5, 0.0, 3.0], 0.05, 40, rho
    )
    assert np.abs(body.p - line.q[:, :3]).max() < 1e-12
    assert np.abs(body.v - np.c_[line.v[:, :3], line.v[:, 3:] * axis]).max() < 1e-11
    for R, angle in zip(body.R, line.q[:, 3], strict=True):
        assert np.abs(R - rotations.exp_so3(angle * axis)).max() < 1e-11


def test_small_steps_of_a_free_rotation_lose_no_digits() -> None:
    w = np.array([0.0, 0.0, 1.0])
    steps = dissipation.alpha_body(
        1.0, np.diag([1.0, 2.0, 3.0]), lambda t, p, R, v, w: (np.zeros(3), np.zeros(3)),
        np.zeros(3), np.eye(3), [0.0, 0.0, 0.0, *w], 1e-3, 200, 0.9,
    )
    assert np.abs(steps.v[:, 3:] - w).max() < 4 * EPS
    assert np.abs(rotations.log_so3(steps.R[-1]) - 0.2 * w).max() < 200 * EPS


def test_newton_without_a_solution_says_so() -> None:
    with pytest.raises(ArithmeticError, match="no convergence"):
        dissipation.alpha_steps(
            lambda t, q, v, rate: rate * rate + 1.0,
            lambda t, q, v, rate: (np.zeros((1, 1)), np.zeros((1, 1)), np.diag(2.0 * rate + 0.1)),
            0.0, 0.0, 0.1, 1, 0.5,
        )
