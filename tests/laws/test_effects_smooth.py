"""Smooth forms of effects: how near to the forms with events, heat, and the energy of all forms.

Orders are slopes of log error over log width, between widths a factor of 4 to 16 apart.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.comparing import largest
from oracles import discontinuities as events
from oracles import dissipation
from scenes.effects import along, balance, block, driven, evaluate, force, gauss

import rbsd_sym as rs
from rbsd_sym.laws import smooth

EXPLICIT, ROSENBROCK = rs.ExplicitRK(1e-10, 1e-12), rs.Rosenbrock(1e-10, 1e-12)
EPS = float(np.finfo(float).eps)
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


def order(widths: Any, errors: Any) -> float:
    """Exponent between the first and the last."""
    return float(np.log(errors[-1] / errors[0]) / np.log(widths[-1] / widths[0]))


# The pieces.

WIDTH = 0.3


def derivatives(function: Callable[[Any, Any], Any], x: Any) -> np.ndarray:
    """Value, first and second derivative, one row per x."""
    s = ca.SX.sym("s")
    value = function(s, WIDTH)
    slope = ca.jacobian(value, s)
    f = ca.Function("f", [s], [ca.vertcat(value, slope, ca.jacobian(slope, s))])
    return np.array(f(np.atleast_2d(x))).T


EXACT = {  # above and below the width
    "ramp": (lambda x: x, lambda x: 0 * x),
    "ramp_integral": (lambda x: x**2 / 2 + WIDTH**2 / 10, lambda x: 0 * x),
    "step": (lambda x: 1 + 0 * x, lambda x: 0 * x),
    "step_over_ramp": (lambda x: 1 / x, lambda x: 5 / WIDTH + 0 * x),
}


@pytest.mark.parametrize("name", EXACT)
def test_smooth_pieces_are_exact_beyond_the_width(name: str) -> None:
    x = WIDTH * np.array([1.0, 1.1, 2.0, 50.0])
    for side, expected in zip((1, -1), EXACT[name], strict=True):
        found = derivatives(getattr(smooth, name), side * x)[:, 0]
        assert largest(found - expected(side * x)) <= 4 * EPS * largest(expected(side * x))


@pytest.mark.parametrize("name", ["ramp", "ramp_integral", "step"])
def test_smooth_pieces_are_c2(name: str) -> None:
    """Values and two derivatives on both sides of +-w differ by no more than the third allows."""
    step = 1e-9
    for end in (WIDTH, -WIDTH):
        below, above = derivatives(getattr(smooth, name), [end - step, end + step])
        third = 1000.0  # of a quintic of width 0.3
        assert largest(below - above) < 2 * step * third
    x = np.linspace(-1.2, 1.2, 241) * WIDTH
    value, slope, _ = derivatives(getattr(smooth, name), x).T
    assert value.min() >= 0
    assert slope.min() >= -EPS  # rising


def test_ramp_and_its_relatives_fit_each_other() -> None:
    """The error is largest at 0; the integral's slope is the ramp; the quotient is the quotient."""
    x = np.linspace(-1.5, 1.5, 301) * WIDTH
    ramp = derivatives(smooth.ramp, x)
    error = ramp[:, 0] - np.maximum(x, 0)
    assert error.min() >= -EPS
    assert error.max() == pytest.approx(3 * WIDTH / 16, rel=1e-15)
    assert abs(x[np.argmax(error)]) < 1e-15
    assert largest(derivatives(smooth.ramp_integral, x)[:, 1] - ramp[:, 0]) < 4 * EPS
    assert largest(ramp[:, 2]) <= 3 / (4 * WIDTH) * (1 + EPS)
    inside = x > -0.99 * WIDTH
    step, quotient = (derivatives(f, x)[:, 0] for f in (smooth.step, smooth.step_over_ramp))
    # Two triple zeros divide with an error of rounding over the cube of the distance 0.005.
    assert largest((quotient * ramp[:, 0] - step)[inside]) < 1e-12


# Forces at random states.

DRAWN = np.random.default_rng(5).uniform(-1, 1, (1000, 3))


def at_states(
    effect: Any, names: tuple[str, ...] = ("b__p_x", "b__v_x"), scales: tuple[float, ...] = (1, 1),
    output: str = "force_local", stiffness: float = 0.0, damping: float = 0.0, **given: Any,
) -> np.ndarray:  # fmt: skip
    """An output of a block with an effect along axis 0 at random states of given names and size."""
    model = rs.compile_scene(block(effect, 0, stiffness, x=0.1, v=0.1, damping=damping))
    values = {name: DRAWN[:, i] * scales[i] for i, name in enumerate(names)}
    return evaluate(model, f"j.{output}", **{**values, **given})[:, 0]


@pytest.mark.parametrize("damping", [0.0, 3.0, 300.0])
def test_smooth_contact_against_its_law(damping: float) -> None:
    """max(0, k d + c d') for d > 0: within 3/16 k w, 2 % of k d, and what sets in within w.

    It never pulls, whatever the velocity.
    """
    k, w = 1e3, 0.1
    push = -at_states(rs.Contact(0, k, damping, smoothing=w), scales=(0.5, 2.0))
    d, speed = -0.5 * DRAWN[:, 0], -2.0 * DRAWN[:, 1]
    sharp = np.where(d > 0, np.maximum(0, k * d + damping * speed), 0)
    error = np.abs(push - sharp)
    assert push.min() >= 0
    assert largest(push[d <= -w]) == 0
    beyond = d >= w
    assert (error[beyond] <= (0.02 * k * d)[beyond] * (damping > 0) + 1e-12).all()
    within = np.abs(d) < w
    bound = 3 / 16 * k * w + (0.02 * k * w * (damping > 0) + damping * np.abs(speed))
    assert (error[within] <= bound[within]).all()
    assert error.max() > 0.5 * 3 / 16 * k * w


@pytest.mark.parametrize("static", [None, 0.5])
def test_regularised_friction_against_its_law(static: float | None) -> None:
    """mu N sign(v) but for the tail of the peak, which ends 0.07 % of mu_k N below mu_s N."""
    w, N, kinetic = 0.01, 20.0, 0.3
    f = at_states(rs.Friction(0, N, kinetic, static, smoothing=w))
    v = DRAWN[:, 1]
    x = np.abs(v) / (4 * w)
    peak = ((static or kinetic) - kinetic) * x * np.exp((1 - x * x) / 2)
    bound = N * (2 * kinetic * np.exp(-2 * np.abs(v) / w) + peak)
    assert (np.abs(f - kinetic * N * np.sign(v)) <= bound + 1e-13).all()
    fine = {"b__v_x": np.linspace(-12, 12, 9601) * w, "b__p_x": np.zeros(9601)}
    model = rs.compile_scene(block(rs.Friction(0, N, kinetic, static, smoothing=w), x=0.1, v=0.1))
    largest_force = evaluate(model, "j.force_local", **fine)[:, 0].max()
    short = (static or kinetic) * N - largest_force
    assert 0 <= short <= 7e-4 * kinetic * N


def test_viscoplastic_force_exceeds_the_limit_by_its_viscosity() -> None:
    """Pulled at v it settles at F_y + c v, hardening at H v more each second."""
    c, v = 4.0, 0.5
    for hardening in (0.0, 20.0):
        plastic = rs.Plastic(0, 100.0, 80.0, hardening, smoothing=c)
        model = rs.compile_scene(driven(plastic, v * rs.TIME))
        found = rs.simulate(model, [0, 3.0, 4.0], EXPLICIT)
        p, s = found["j.plastic_x_plastic"], found["j.plastic_x_length"]
        rate = v * 100 / (100 + hardening)
        expected = 80 + hardening * p + c * rate
        assert force(found, 0)[1:] == pytest.approx(expected[1:], rel=1e-9)
        assert largest(p - s) == 0


def test_damage_grows_in_its_own_time() -> None:
    """Held at 1.5 times the limit: 1 - D = exp(-0.5 t / T)."""
    model = rs.compile_scene(
        driven(rs.Fracture(10.0, smoothing=0.2), 0.3 + 0 * rs.TIME, stiffness=50.0)
    )
    t = np.linspace(0, 1, 11)
    found = rs.simulate(model, t, EXPLICIT)
    assert largest(found["j.fracture_damage"] - 1 + np.exp(-0.5 * t / 0.2)) < 1e-9
    assert largest(force(found, 0) - 15 * np.exp(-0.5 * t / 0.2)) < 1e-8
    below = rs.compile_scene(
        driven(rs.Fracture(10.0, smoothing=0.2), 0.198 + 0 * rs.TIME, stiffness=50.0)
    )
    assert largest(rs.simulate(below, t, EXPLICIT)["j.fracture_damage"]) == 0


@pytest.mark.parametrize(
    "effect",
    [rs.Contact(0, 1e3, smoothing=0.2), rs.Contact(0, 1e3, 0.0, -0.3, -1, 0.2), rs.Cubic(0, 7, -2),
     rs.Table(0, (-0.5, -0.1, 0.2, 0.6), (1, -1, 0, 4)), rs.Fracture(1.0),
     rs.Plastic(0, 50, 20, 9)],
    ids=lambda effect: type(effect).__name__,
)  # fmt: skip
def test_force_is_the_derivative_of_the_energy(effect: Any) -> None:
    """Of forces that conserve it, at 1,000 strains, by CasADi's derivative of the output."""
    model = rs.compile_scene(block(effect, 0, 3.0, x=0.1, v=0.1))
    place = [label.name for label in model.x_labels].index("b.p_x")
    slope = ca.jacobian(model.expression("j.potential_energy"), model.dae.x[place])
    f = model.expression("j.force_local")[0]
    over = ca.Function("over", model.symbols, [slope, f])
    x = np.array([[label.start] * 1000 for label in model.x_labels])
    x[place] = DRAWN[:, 0]
    slopes, forces = (np.array(v)[0] for v in over(0, x, [], [], []))
    elastic = np.abs(50 * x[place]) <= 20 if isinstance(effect, rs.Plastic) else slice(None)
    assert largest(slopes[elastic] - forces[elastic]) < 1e-13 * largest(forces)


# Heat is not negative.

HEAT = {
    "contact": (rs.Contact(0, 1e3, 20.0), {"j__contact_x_closed": 1.0}),
    "smooth contact": (rs.Contact(0, 1e3, 20.0, smoothing=0.2), {}),
    "friction": (rs.Friction(0, 5.0, 0.3, 0.5), {
        "j__friction_x_mode": np.sign(DRAWN[:, 1]),
        "j__friction_x_force": 1.5 * np.sign(DRAWN[:, 1])}),
    "smooth friction": (rs.Friction(0, 5.0, 0.3, 0.5, smoothing=0.1), {}),
    "bristles": (rs.LuGre(0, 5.0, 0.3, 0.5, 0.1, 1e3), {
        "j__lugre_x_bristle": 3e-3 * DRAWN[:, 2]}),
    "damped bristles": (rs.LuGre(0, 5.0, 0.3, 0.5, 0.1, 1e3, 6.0, 0.5), {
        "j__lugre_x_bristle": 3e-3 * DRAWN[:, 2]}),  # s1 |v| <= 4 g(v), as bristles need
    "plastic": (rs.Plastic(0, 50.0, 20.0, 5.0, 3.0), {"j__plastic_x_plastic": 0.2 * DRAWN[:, 2]}),
    "viscoplastic": (rs.Plastic(0, 50.0, 20.0, 5.0, 3.0, 2.0), {
        "j__plastic_x_plastic": 0.2 * DRAWN[:, 2], "j__plastic_x_length": 0.2}),
    "maxwell": (rs.Maxwell(0, 10.0, 2.0), {"j__maxwell_x_force": 7 * DRAWN[:, 2]}),
    "damage": (rs.Fracture(3.0, smoothing=0.1), {"j__fracture_damage": DRAWN[:, 2] ** 2}),
    "cubic": (rs.Cubic(0, 3.0), {}),
}  # fmt: skip


@pytest.mark.parametrize("kind", HEAT)
def test_heat_is_never_negative(kind: str) -> None:
    """At 1,000 states; a plastic spring yields outwards, else it would have turned before."""
    effect, states = HEAT[kind]
    damping = 0.3 if kind == "damage" else 0.0
    heat = at_states(effect, output="dissipated_power", stiffness=4.0, damping=damping, **states)
    if kind == "plastic":
        reduced = 50 * (DRAWN[:, 0] - 0.2 * DRAWN[:, 2]) - 5 * 0.2 * DRAWN[:, 2]
        heat = heat[reduced * DRAWN[:, 1] > 0]
    assert heat.min() >= 0
    assert (heat.max() == 0) == (kind == "cubic")


@pytest.mark.parametrize("kind", HEAT)
def test_no_effect_gives_energy(kind: str) -> None:
    """Power on the body + rate of what is stored + heat = 0, at 1,000 states."""
    effect, states = HEAT[kind]
    damping = 0.3 if kind == "damage" else 0.0
    given = at_states(effect, output="injected_power", stiffness=4.0, damping=damping, **states)
    heat = at_states(effect, output="dissipated_power", stiffness=4.0, damping=damping, **states)
    assert largest(given) < 1e-13 * (largest(heat) + 1e2)


@pytest.mark.parametrize("smoothing", [0.0, 0.05])
def test_heat_of_friction_on_a_belt(smoothing: float) -> None:
    """N mu |v - V|, also where the belt drives the block."""
    v, V = DRAWN[:, 1], 0.4
    states = {"j__friction_x_mode": np.sign(v - V), "j__friction_x_force": 1.5 * np.sign(v - V)}
    effect = rs.Friction(0, 5.0, 0.3, velocity=V, smoothing=smoothing)
    heat = at_states(effect, output="dissipated_power", **({} if smoothing else states))
    size = np.tanh((v - V) / smoothing) if smoothing else np.sign(v - V)
    assert largest(heat - 1.5 * size * (v - V)) < 1e-14


# Nothing is lost of the energy.

START = {"stiffness": 40.0, "x": 0.5, "v": 1.0}
FAST = {**START, "x": 0.0, "v": 4.0}
KEPT = {  # with events, then smooth: effect, start, end
    "contact": (rs.Contact(0, 1e3, 10.0, 0.1), START, 2.0),
    "stops": (rs.stops(0, -0.2, 0.3, 1e3, 5.0), {"x": 0.1, "v": 2.0}, 2.0),
    "impact": (rs.Impact(0, 0.7, 0.1), START, 2.0),
    "friction": (rs.Friction(0, 5.0, 0.3, 0.5), START, 2.0),
    "friction on a belt": (rs.Friction(0, 20.0, 0.3, 0.5, velocity=0.3), START, 2.0),
    "plastic": (rs.Plastic(0, 50.0, 10.0, 5.0, 3.0), FAST, 2.0),
    "fracture": (rs.Fracture(15.0), {**FAST, "damping": 1.0}, 1.0),
    "cubic": (rs.Cubic(0, 60.0, -20.0), START, 2.0),
    "smooth contact": (rs.Contact(0, 1e3, 10.0, 0.1, smoothing=0.02), START, 1.0),
    "smooth friction": (rs.Friction(0, 5.0, 0.3, 0.5, smoothing=0.05), START, 1.0),
    "smooth belt": (rs.Friction(0, 20.0, 0.3, 0.5, 0.3, smoothing=0.05), START, 1.0),
    "bristles": (rs.LuGre(0, 5.0, 0.3, 0.5, 0.1, 1e3, 6.0, 0.5), START, 1.0),
    "viscoplastic": (rs.Plastic(0, 50.0, 10.0, 5.0, 3.0, 2.0), FAST, 1.0),
    "damage": (rs.Fracture(15.0, smoothing=0.05), {**FAST, "damping": 1.0}, 1.0),
    "maxwell": ([rs.Maxwell(0, 30.0, 4.0), rs.Maxwell(0, 9.0, 0.3, "m")], START, 1.0),
    "table": (rs.Table(0, (-0.5, -0.1, 0.2, 0.6), (-9, -3, 0, 30)), START, 1.0),
}


@pytest.mark.parametrize("kind", KEPT)
def test_energy_is_accounted_for(kind: str) -> None:
    """Stored + heat + let go at events = given, of some 5 J, to what ten events leave of 1e-10.

    Between events heat is integrated by pieces, short ones where it sets in smoothly.
    """
    effect, start, end = KEPT[kind]
    integrator = ROSENBROCK if kind in ("friction", "friction on a belt") else EXPLICIT
    model = rs.compile_scene(block(effect, 0, **start))
    found = balance(model, end, integrator, 0.02 if model.events else 0.0025)
    assert abs(found.error) < 1e-6
    assert found.heat + found.lost > 0.1 or kind in ("cubic", "table")


@pytest.mark.parametrize(("law", "axis"), [("intrinsic", 3), ("consistent", 5), ("consistent", 1)])
def test_energy_is_accounted_for_along_other_axes(law: str, axis: int) -> None:
    effects = [rs.Contact(axis, 1e3, 10.0, 0.1), rs.Plastic(axis, 50.0, 10.0, 5.0),
               rs.Maxwell(axis, 30.0, 4.0)]  # fmt: skip
    model = rs.compile_scene(block(effects, axis, 40.0, v=4.0, law=law, damping=0.1, pull=-5.0))
    found = balance(model, 1.5, EXPLICIT, 0.025, pull=(-5.0, axis))
    assert abs(found.error) < 1e-6
    assert found.heat > 1


# Trajectories.


def test_regularised_slide_goes_too_far_by_the_square_of_its_width() -> None:
    t, errors, widths = np.linspace(0, 3, 13), [], (0.08, 0.02)
    for w in widths:
        model = rs.compile_scene(block(rs.Friction(0, 4.0, 0.5, smoothing=w), v=2.0))
        found = rs.simulate(model, t, ROSENBROCK)
        s, v = dissipation.tanh_slide(t, 1.0, 2.0, w, 2.0)
        assert largest(along(found, 0)[0] - s) < 1e-9
        assert largest(along(found, 0)[1] - v) < 1e-8
        errors.append(along(found, 0)[0][-1] - 1.0)
        assert errors[-1] == pytest.approx(dissipation.tanh_slide_excess(1.0, 2.0, w), rel=1e-3)
    assert order(widths, errors) == pytest.approx(2, abs=0.01)


def test_regularised_friction_creeps_under_a_load() -> None:
    for w in (0.02, 0.001):
        effect = rs.Friction(0, 4.0, 0.5, smoothing=w)
        found = rs.simulate(rs.compile_scene(block(effect, pull=1.5)), [0, 1.0], ROSENBROCK)
        assert along(found, 0)[1][-1] == pytest.approx(
            dissipation.tanh_creep(1.5, 2.0, w), rel=1e-6
        )


def path_error(effect: Any, phases: list[events.Phase], end: float, **scene: Any) -> float:
    """Largest distance of a block from phases."""
    t = np.linspace(0, end, 41)
    found = rs.simulate(rs.compile_scene(block(effect, 0, **scene)), t, ROSENBROCK)
    return largest(along(found, 0)[0] - events.state_at(phases, t)[0])


def test_order_of_regularised_friction() -> None:
    """First order in the width: creep where it should stick, and asymmetry at each turn.

    On a belt 2/3: the load rises steadily past the peak of the force, which is left late.
    """
    widths = (2e-3, 1e-4)
    coulomb = events.coulomb_phases(1.0, 1.0, 0.1, 1.05)
    errors = [
        path_error(rs.Friction(0, 0.2, 0.5, smoothing=w), coulomb, 17.0, stiffness=1.0, x=1.05)
        for w in widths
    ]
    assert order(widths, errors) == pytest.approx(1, abs=0.05)
    belt = events.belt_phases(2.6, 2.0, 50.0, 20.0, 0.5, 0.3, 0.2, 0.0, 0.2)
    start = {"stiffness": 50.0, "mass": 2.0, "v": 0.2}
    errors = [
        path_error(rs.Friction(0, 20.0, 0.3, 0.5, 0.2, smoothing=w), belt, 2.6, **start)
        for w in widths
    ]
    assert order(widths, errors) == pytest.approx(2 / 3, abs=0.06)
    assert errors[-1] < 3e-3


def test_order_of_smooth_contact() -> None:
    """Second; with damping what remains is the rounding of its release, 2 % of the push."""
    for damping, widths in ((0.0, (1e-3, 1.25e-4)), (20.0, (4e-3, 1e-3, 6e-5))):
        phases = events.spring_bounce_phases(0.5, 1.0, 1e4, damping, 9.81, 0.1)
        errors = [
            path_error(rs.Contact(0, 1e4, damping, smoothing=w), phases, 0.5, x=0.1, pull=-9.81)
            for w in widths
        ]
        assert order(widths[:2], errors[:2]) == pytest.approx(2, abs=0.05 if not damping else 0.4)
        assert errors[-1] < 1e-5


def test_order_of_viscoplasticity() -> None:
    """First order in the viscosity, down to the 1 % of F_y in which yielding sets in."""
    t = np.arange(41) * np.pi / 16
    sharp = dissipation.elastoplastic(2.5 * np.sin(t), 100.0, 80.0, 25.0, 12.0).force
    errors, viscosities = [], (16.0, 4.0)
    for c in viscosities:
        plastic = rs.Plastic(0, 100.0, 80.0, 25.0, 12.0, c)
        found = rs.simulate(rs.compile_scene(driven(plastic, 2.5 * np.sin(rs.TIME))), t, ROSENBROCK)
        errors.append(largest(force(found, 0) - sharp))
        assert errors[-1] < 2.5 * c  # c times the largest rate
    assert order(viscosities, errors) == pytest.approx(1, abs=0.2)


def test_order_of_damage() -> None:
    """The load passes its limit at a steady rate, so damage comes late by the root of its time."""
    phases = events.fracture_phases(2.0, 50.0, 10.0, 0.1, 1.5, 0.0)
    times = (4e-4, 2.5e-5)
    errors = [
        path_error(rs.Fracture(10.0, smoothing=T), phases, 0.5, stiffness=50.0, mass=2.0, x=0.1,
                   v=1.5) for T in times
    ]  # fmt: skip
    assert order(times, errors) == pytest.approx(0.5, abs=0.1)


def test_gauss_points_are_those_of_the_integral() -> None:
    """The tests' own quadrature: pieces with breaks, exact for polynomials up to degree 15."""
    t, w = gauss([0.0, 0.3, 0.3 + 1e-12, 1.0], 0.25)
    assert w @ t**15 == pytest.approx(1 / 16, rel=1e-13)
    assert w @ (t > 0.3) == pytest.approx(0.7, rel=1e-11)
