"""Plasticity, fracture, Maxwell branches and nonlinear springs against closed forms.

Tolerances: integration at rtol 1e-10 leaves 1e-10 to 1e-9 of the motion over some ten events; 1e-8
has room for it, and stays far below what a wrong law would show. Expectations come from
tests/oracles; the numbers written out are published.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from helpers.comparing import largest
from oracles import discontinuities as events
from oracles import dissipation
from scenes.effects import (
    SOME,
    TIGHT,
    along,
    balance,
    block,
    compare,
    driven,
    evaluate,
    force,
    names,
    times_of,
)

import rbsd_sym as rs

somewhere = pytest.mark.parametrize(("law", "axis"), SOME)
by_integrator = pytest.mark.parametrize("method", TIGHT)
# A motion along one axis is what counts here, not whether a spring without the others is stable.
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


# Plasticity: k = 100, F_y = 80, cycles u = 2.5 sin t, so that u_y = 0.8.

_U, _K, _F = 2.5, 100.0, 80.0
HARDENING = {"perfect": (0.0, 0.0), "kinematic": (25.0, 0.0), "isotropic": (0.0, 12.0),
             "both": (25.0, 12.0)}  # fmt: skip


def cycled(kind: str, law: str = "standard", axis: int = 0) -> rs.Model:
    """The model of a driven plastic connector."""
    plastic = rs.Plastic(axis, _K, _F, *HARDENING[kind])
    return rs.compile_scene(driven(plastic, _U * np.sin(rs.TIME), axis, law))


@pytest.mark.parametrize(
    ("kind", "method", "law", "axis"),
    [*((kind, "dop853", "standard", 0) for kind in HARDENING),
     *(("both", "rosenbrock", *place) for place in SOME),
     ("isotropic", "idas", "standard", 1), ("kinematic", "explicit", "intrinsic", 4)],
)  # fmt: skip
def test_plastic_cycles(kind: str, law: str, axis: int, method: str) -> None:
    """At 64 points a cycle, reversals included, between which the return mapping is exact."""
    t = np.arange(161) * np.pi / 32
    found = rs.simulate(cycled(kind, law, axis), t, TIGHT[method])
    expected = dissipation.elastoplastic(_U * np.sin(t), _K, _F, *HARDENING[kind])
    assert largest(force(found, axis) - expected.force) < 1e-11 * _F
    turns = np.pi * (np.arange(5) + 0.5)
    assert largest(times_of(found, "reverses") - turns) < 1e-12
    if kind == "isotropic":
        peaks = dissipation.isotropic_peaks(5, _U, _K, _F, 12.0)
        assert largest(np.abs(force(found, axis)[16::32]) - peaks) < 1e-9


@pytest.mark.parametrize("kind", ["perfect", "kinematic"])
def test_loss_of_a_plastic_cycle(kind: str) -> None:
    """4 F_y (u_m - u_y) without hardening, from one peak to the next of its kind."""
    start, end = np.pi / 2, 5 * np.pi / 2
    found = balance(cycled(kind), end, TIGHT["explicit"], 0.5)
    first = balance(cycled(kind), start, TIGHT["explicit"], 0.5)
    area = dissipation.kinematic_loop_area(_U, _K, _F, HARDENING[kind][0])
    assert kind != "perfect" or area == pytest.approx(4 * _F * (_U - _F / _K), rel=1e-15)
    assert found.heat - first.heat == pytest.approx(area, rel=1e-9)


@pytest.mark.parametrize("kind", HARDENING)
def test_energy_of_plastic_cycles(kind: str) -> None:
    """Work of the drive, heat and what spring and hardening store, against the oracle's."""
    end, model = 7.0, cycled(kind)
    u = _U * np.sin([np.pi / 2, 3 * np.pi / 2, end])
    expected = dissipation.elastoplastic(u, _K, _F, *HARDENING[kind])
    found = balance(model, end, TIGHT["explicit"], 0.5, drive=0)
    assert found.heat == pytest.approx(expected.dissipated[-1], rel=1e-9)
    assert found.given == pytest.approx(expected.work[-1], rel=1e-9)
    assert abs(found.error) < 1e-9 * found.heat


@pytest.mark.parametrize("x", [2.0, 3.0])
@by_integrator
def test_plastic_spring_let_go_beyond_yield(x: float, method: str) -> None:
    """From rest it unloads elastically about p = (x - 1) / 1.5, until f - H p is -F_y."""
    model = rs.compile_scene(block(rs.Plastic(0, 1.0, 1.0, 0.5), 0, x=x))
    p = (x - 1) / 1.5
    amplitude = x - p
    yields = np.arccos((0.5 * p - 1) / amplitude)
    t = np.linspace(0, yields, 12)
    found = rs.simulate(model, t, TIGHT[method])
    assert largest(along(found, 0)[0] - p - amplitude * np.cos(t)) < 1e-8


# Fracture: m = 2, k = 50 under a load of 3, limit 10 N (at 0.2 m) or 1 J.

LIMITS = {"force": 10.0, "torque": 10.0, "energy": 1.0}


@pytest.mark.parametrize(
    ("law", "axis", "limit", "method"),
    [("standard", 0, "force", "idas"), ("consistent", 1, "energy", "rosenbrock"),
     ("consistent", 4, "torque", "explicit"), ("intrinsic", 3, "energy", "dop853"),
     ("standard", 5, "torque", "rosenbrock")],
)  # fmt: skip
@pytest.mark.parametrize(("x", "v"), [(0.1, 1.1), (-0.15, -0.9)])
def test_fracture(x: float, v: float, law: str, axis: int, limit: str, method: str) -> None:
    """In tension and in compression; it stays broken, and loses limit^2 / (2 k)."""
    broken = rs.Fracture(**{limit: LIMITS[limit]})
    model = rs.compile_scene(block(broken, axis, 50.0, 2.0, x, v, law, pull=3.0))
    phases = events.fracture_phases(2.0, 50.0, 10.0, x, v, 3.0)
    assert len(phases) == 2
    found = rs.simulate(model, np.linspace(0, 1, 41), TIGHT[method])
    compare(found, phases, axis, 1e-9)
    assert [name for _, name in found.events] == ["j.fracture_breaks"]
    assert abs(found.events[0][0] - phases[1].start) < 1e-10
    after = found.t > phases[1].start
    assert largest(force(found, axis)[after]) < 1e-12
    assert largest(found["j.potential_energy"][after]) < 1e-12
    assert largest(found["j.fracture_broken"] - after) < 1e-12
    assert found["j.fracture_lost"][-1] == pytest.approx(1.0, rel=1e-9)


def test_fracture_below_its_limits_does_not_happen() -> None:
    phases = events.fracture_phases(2.0, 50.0, 10.0, 0.19, 0.0)
    assert len(phases) == 1
    model = rs.compile_scene(block(rs.Fracture(10.0, 1.0, 1.0), 0, 50.0, 2.0, 0.19))
    found = rs.simulate(model, np.linspace(0, 3, 31), TIGHT["rosenbrock"])
    compare(found, phases, 0, 1e-9)
    assert found.events == ()


def test_first_of_three_limits_breaks() -> None:
    """The torque limit of 1 N m at an angle of 0.02 rad, long before force and energy."""
    model = rs.compile_scene(block(rs.Fracture(10.0, 1.0, 1.0), 3, 50.0, 2.0, 0.0, 1.0))
    found = rs.simulate(model, np.linspace(0, 0.1, 31), TIGHT["rosenbrock"])
    assert found.events[0][0] == pytest.approx(np.arcsin(0.02 * 5) / 5, rel=1e-9)


# Maxwell branches.

BRANCHES = [(40.0, 8.0), (15.0, 0.5), (5.0, 30.0)]


def maxwell(axis: int) -> list[rs.Maxwell]:
    """The branches as effects."""
    return [rs.Maxwell(axis, k, c, f"m{i}") for i, (k, c) in enumerate(BRANCHES)]


@pytest.mark.parametrize(("law", "axis"), [("standard", 0), ("intrinsic", 3), ("consistent", 4)])
def test_maxwell_relaxation_and_sine(law: str, axis: int) -> None:
    """A step of 0.3 loads the branches by k_i 0.3 at once; a sine, the storage and loss modulus."""
    t = np.linspace(0, 2, 21)
    step = rs.compile_scene(driven(maxwell(axis), 0.3 + 0 * rs.TIME, axis, law, 20.0))
    start = {f"j.m{i}_force": 0.3 * k for i, (k, _) in enumerate(BRANCHES)}
    found = rs.simulate(step, t, TIGHT["rosenbrock"], start=start)
    relaxed = dissipation.maxwell_relaxation(t, 20.0, BRANCHES, 0.3)
    assert largest(force(found, axis) - relaxed) < 1e-8
    model = rs.compile_scene(driven(maxwell(axis), 0.3 * np.sin(4 * rs.TIME), axis, law, 20.0))
    found = rs.simulate(model, t, TIGHT["rosenbrock"])
    assert largest(force(found, axis) - dissipation.maxwell_sine(t, 20.0, BRANCHES, 4, 0.3)) < 1e-8


@pytest.mark.parametrize(
    ("method", "law", "axis"), [*((method, "standard", 1) for method in TIGHT),
                                ("idas", "consistent", 3)],
)  # fmt: skip
def test_maxwell_oscillator(law: str, axis: int, method: str) -> None:
    t = np.linspace(0, 3, 31)
    model = rs.compile_scene(block(maxwell(axis), axis, 20.0, 1.5, 0.4, -1.0, law))
    found = rs.simulate(model, t, TIGHT[method])
    x, v, *f = dissipation.maxwell_oscillator(t, 1.5, 20.0, BRANCHES, 0.4, -1.0).T
    assert largest(along(found, axis)[0] - x) < 1e-8
    assert largest(along(found, axis)[1] - v) < 1e-8
    for i in range(3):
        assert largest(found[f"j.m{i}_force"] - f[i]) < 1e-7


def test_loss_of_a_steady_maxwell_cycle() -> None:
    """The slowest branch, 6 s, has forgotten the start after 150 s, to e^-25 = 1e-11."""
    model = rs.compile_scene(driven(maxwell(0), 0.3 * np.sin(4 * rs.TIME), 0, "standard", 20.0))
    first = rs.simulate(model, [0, 48 * np.pi], TIGHT["rosenbrock"])
    start = {f"j.m{i}_force": first[f"j.m{i}_force"][-1] for i in range(3)}
    t = np.linspace(0, np.pi / 2, 65)
    found = rs.simulate(model, t, TIGHT["rosenbrock"], start=start)
    loss = found["j.dissipated_power"][:-1].mean() * np.pi / 2  # exact for few harmonics
    assert loss == pytest.approx(dissipation.maxwell_cycle_loss(4.0, 0.3, BRANCHES), rel=1e-8)


# Springs that are not linear.


def spring(effect: Any, law: str, axis: int) -> Any:
    """A function of strains: force and energy of an effect alone."""
    model = rs.compile_scene(block(effect, axis, x=0.3, v=0.1, law=law))
    name, place = "force_local" if axis < 3 else "torque_local", names(axis)[0].replace(".", "__")

    def values(x: Any) -> tuple[np.ndarray, np.ndarray]:
        f = evaluate(model, f"j.{name}", **{place: x})[:, axis % 3]
        return f, evaluate(model, "j.potential_energy", **{place: x})[:, 0]

    return values


@somewhere
def test_cubic_spring(law: str, axis: int) -> None:
    x = np.linspace(-1.4, 1.4, 15)
    f, energy = spring(rs.Cubic(axis, 7.0, -2.0), law, axis)(x)
    assert largest(f - (7 * x**3 - 2 * x)) < 1e-13 * 30
    assert largest(energy - (7 * x**4 / 4 - x**2)) < 1e-13 * 30


KNOTS = np.array([-1.0, -0.6, -0.5, 0.1, 0.4, 1.1])
VALUES = np.array([-3.0, -2.5, 0.3, 0.2, 1.0, 4.0])


def test_table_is_the_natural_cubic_spline() -> None:
    """Through its points, C2 there, cubic between, straight beyond: that is only one curve."""
    at = spring(rs.Table(0, KNOTS, VALUES), "standard", 0)
    assert largest(at(KNOTS)[0] - VALUES) < 1e-13
    for a, b in pairwise(KNOTS):
        f = at(np.linspace(a, b, 5))[0]
        assert abs(f @ [1, -4, 6, -4, 1]) < 1e-12  # fourth difference of a cubic
    h = 1e-3
    for knot in KNOTS:
        left, right = (at(knot + side * h * np.arange(4))[0] for side in (-1, 1))
        slopes = [side * f @ [-11, 18, -9, 2] / (6 * h) for side, f in ((-1, left), (1, right))]
        bends = [f @ [2, -5, 4, -1] / h**2 for f in (left, right)]  # both exact for cubics
        assert slopes[0] == pytest.approx(slopes[1], abs=1e-9)
        assert bends[0] == pytest.approx(bends[1], abs=1e-6)
    for end, side in ((KNOTS[0], -1), (KNOTS[-1], 1)):
        f = at(end + side * np.array([0.0, 0.5, 1.0, 2.0, 4.0]))[0]
        assert largest(np.diff(f) / [0.5, 0.5, 1, 2] - (f[1] - f[0]) / 0.5) < 1e-12


@somewhere
def test_energy_of_a_table_is_the_integral_of_its_force(law: str, axis: int) -> None:
    """Five-point Gauss is exact in each piece; zero at the first strain."""
    at = spring(rs.Table(axis, KNOTS, VALUES), law, axis)
    y, w = np.polynomial.legendre.leggauss(5)
    total = 0.0
    for a, b in pairwise([*KNOTS, 1.3]):
        total += (b - a) / 2 * w @ at((a + b) / 2 + (b - a) / 2 * y)[0]
        assert at(b)[1][0] == pytest.approx(total, rel=1e-12)
    f, energy = at([KNOTS[0], -1.4])
    assert energy[0] == 0
    assert energy[1] == pytest.approx(-0.4 * f.mean(), rel=1e-12)


def test_oscillation_on_a_table_keeps_its_energy() -> None:
    model = rs.compile_scene(block(rs.Table(2, KNOTS, 5 * KNOTS), 2, x=0.8))
    found = rs.simulate(model, np.linspace(0, 5, 21), TIGHT["explicit"])
    assert largest(along(found, 2)[0] - 0.8 * np.cos(np.sqrt(5) * found.t)) < 1e-8
    assert largest(np.diff(found["energy"])) < 1e-8
