"""Bodies without inertia: against closed forms, an independent oracle, and the limit of small ones.

Massless bodies, point masses and thin rods become algebraic, or first-order where they are damped.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from charts import massless as chart
from helpers.comparing import largest
from oracles import scenes as oracle
from scenes.massless import (
    DAMPED,
    TIGHTER,
    UNDAMPED,
    ground,
    massless,
    oracle_states,
    residual,
    scene_data,
    scene_of,
    spring,
    unbalance,
    values_of_z,
)
from scenes.small import GROUND, LAWS

import rbsd_sym as rs

TIGHT = rs.Idas(1e-10, 1e-12)


# Closed forms. IDAS at 1e-10 leaves 1e-10 to 1e-9 m over a period; 1e-8 has room for both.


@pytest.mark.parametrize(
    ("law", "minimal"), [*((law, True) for law in LAWS), ("standard", False), ("consistent", False)]
)
def test_two_springs_in_series(law: str, minimal: bool) -> None:
    """w^2 = k1 k2 / (k1 + k2) / m, and k1 a = k2 (b - a) for the massless body between."""
    k1, k2, m, v = 300.0, 200.0, 2.0, 1.0
    b = rs.RigidBody("b", m, (0.1, 0.2, 0.3), position=(2, 0, 0), velocity=(v, 0, 0))
    pairs = (("c1", GROUND, rs.Marker("a"), k1), ("c2", rs.Marker("a"), rs.Marker("b"), k2))
    springs = [
        spring(name, one, other, [k] + [500] * 5, law=law, offset=[1, 0, 0, 0, 0, 0])
        for name, one, other, k in pairs
    ]
    scene = rs.Scene("series", [massless("a", 1, 0, 0), b], springs)
    model = rs.compile_scene(scene, None, minimal)
    assert (model.n_x, model.n_z) == ((2, 1) if minimal else (13, 7))
    w = np.sqrt(k1 * k2 / (k1 + k2) / m)
    t = np.linspace(0, 2 * np.pi / w, 101)
    found = rs.simulate(model, t, TIGHT)
    moved, share = v / w * np.sin(w * t), k2 / (k1 + k2)
    assert largest(found["b.position"] - np.outer(moved, [1, 0, 0]) - [2, 0, 0]) < 1e-8
    assert largest(found["a.position"] - np.outer(share * moved, [1, 0, 0]) - [1, 0, 0]) < 1e-8
    assert largest(found["a.velocity"][:, 0] - share * v * np.cos(w * t)) < 1e-8


def exponential(A: np.ndarray, start: np.ndarray, t: np.ndarray) -> np.ndarray:
    """exp(A t) start, a column for each time, from eigenvalues and eigenvectors."""
    values, vectors = np.linalg.eig(A)
    weights = np.linalg.solve(vectors, start.astype(complex))
    return np.real(vectors @ (np.exp(np.outer(values, t)) * weights[:, None]))


@pytest.mark.parametrize("minimal", [True, False])
@pytest.mark.parametrize(("law", "parallel"), [("standard", 0.0), ("consistent", 40.0)])
def test_maxwell_element(law: str, parallel: float, minimal: bool) -> None:
    """Spring k, massless a, damper c, mass m; third order: a' = v - k a / c, b' = v, m v' = f.

    f = -k a - parallel b + weight, with a spring in parallel and weight, or without both.
    """
    k, c, m, weight = 100.0, 5.0, 1.5, 1.2 if parallel else 0.0
    b = rs.RigidBody("b", m, (0.1, 0.2, 0.3), position=(2, 0, 0), velocity=(1, 0, 0))
    stiff, rest = [500] * 5, weight / parallel if parallel else 0.0
    springs = [
        spring("s", ground(1, 0, 0), rs.Marker("a"), [k, *stiff], law=law),
        spring("d", rs.Marker("a"), rs.Marker("b"), [0, *stiff], [c] + [0] * 5, law),
        spring("p", ground(2, 0, 0), rs.Marker("b"), [parallel, *stiff], law=law),
    ]
    scene = rs.Scene("maxwell", [massless("a", 1.1, 0, 0), b], springs, gravity=(weight / m, 0, 0))
    A = np.array([[-k / c, 0, 1], [0, 0, 1], [-k / m, -parallel / m, 0]])
    t = np.linspace(0, 2, 101)
    a_x, b_x, v = exponential(A, np.array([0.1, -rest, 1.0]), t)
    model = rs.compile_scene(scene, None, minimal)
    assert not minimal or (model.n_x, model.n_z) == (3, 1)
    found = rs.simulate(model, t, TIGHT)
    assert largest(found["a.p_x"] - 1 - a_x) < 1e-8
    assert largest(found["b.p_x"] - 2 - rest - b_x) < 1e-8
    assert largest(found["b.v_x"] - v) < 1e-8
    assert largest(found["a.v_x"] - (v - k / c * a_x)) < 1e-8


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("minimal", [True, False])
def test_kelvin_element_is_first_order(law: str, minimal: bool) -> None:
    """Spring k and damper c side by side, no mass anywhere: c x' = F - k x, and z is x'."""
    k, c, F, x0 = 80.0, 6.0, 12.0, 0.4
    kelvin = spring("s", GROUND, rs.Marker("a"), [k] + [90] * 5, [c] * 6, law)
    pull = rs.Load("pull", rs.Marker("a"), force=(F, 0, 0))
    scene = rs.Scene("kelvin", [massless("a", x0, 0, 0)], [kelvin], [pull])
    model = rs.compile_scene(scene, None, minimal)
    assert "a.p_x" in [label.name for label in model.x_labels]
    z = {label.name: label for label in model.dae.z_labels}
    assert z["a.v_x"].start == pytest.approx((F - k * x0) / c, rel=1e-12)
    t = np.linspace(0, 0.5, 51)
    x = F / k + (x0 - F / k) * np.exp(-k * t / c)
    found = rs.simulate(model, t, TIGHT)
    assert largest(found["a.p_x"] - x) < 1e-8
    assert largest(found["a.v_x"] + k / c * (x - F / k)) < 1e-8


def hung(inertia: Any, law: str, K: Any, D: Any, spin: Any) -> rs.Scene:
    """A body on three torsion-free springs at its centre."""
    body = rs.RigidBody(
        "b", 1.5, inertia, position=(0.1, 0.2, -0.3), velocity=(0.5, 0, 0.2), angular_velocity=spin
    )
    places, none = ((1, 0, 0), (-1, 0.5, 0), (0, -1, 0.3)), [0, 0, 0]
    springs = [
        spring(f"c{i}", ground(*p), rs.Marker("b"), [*K[i], *none], [*D, *none], law)
        for i, p in enumerate(places)
    ]
    return rs.Scene("hung", [body], springs, gravity=(0, 1, -9.81))


def check_same_path(law: str, K: Any, D: Any, spin: Any) -> None:
    """A point mass and bodies of any inertia move alike, up to twice the integration error."""
    t = np.linspace(0, 2, 41)
    paths = [
        rs.simulate(rs.compile_scene(hung(J, law, K, D, spin)), t, TIGHT)["b.position"]
        for J in (0, (0.1, 0.2, 0.25), (7, 5, 4))
    ]
    assert np.ptp(paths[0], axis=0).min() > 0.1
    assert max(largest(path - paths[0]) for path in paths) < 1e-9


@pytest.mark.parametrize("D", [(0, 0, 0), (1, 2, 3)], ids=["undamped", "damped"])
def test_point_mass_moves_as_any_body_on_torsion_free_springs(D: Any) -> None:
    K = ((100, 150, 200), (50, 20, 90), (70, 0, 30))
    check_same_path("standard", K, D, (1, 2, 3))


@pytest.mark.parametrize("law", ["intrinsic", "consistent"])
def test_point_mass_on_isotropic_springs_whose_torque_cancels(law: str) -> None:
    """Equal stiffness along all axes: the other two laws give no torque either, in the end."""
    check_same_path(law, [(100,) * 3, (50,) * 3, (70,) * 3], (0, 0, 0), (0, 0, 0))


def pendulum_path(t: np.ndarray, weight: np.ndarray, k: float | None) -> np.ndarray:
    """A mass of 1 kg on a link of 1 m from (1, 0, 0), elastic (k, N/m) or rigid; numpy only."""

    def rates(x: np.ndarray) -> np.ndarray:
        p, v = x[:3], x[3:]
        r = np.linalg.norm(p)
        pull = k * (r - 1) / r if k else (v @ v + weight @ p) / r**2
        return np.concatenate([v, weight - pull * p])

    states = [np.array([1.0, 0, 0, 0, 0, 0])]
    for step in np.diff(t):  # order 12 with w h = 0.08: at rounding
        states.append(oracle.integrate(rates, states[-1], step, 8))
    return np.array(states)[:, :3]


@pytest.mark.parametrize(
    ("law", "weight"),
    [("consistent", (0, -9.81, 0)), ("consistent", (0, 1, -9.81)), ("standard", (0, 1, -9.81))],
)
def test_point_mass_on_a_massless_rod(law: str, weight: Any) -> None:
    """No torque on a body without inertia: the spring pulls along the rod, an elastic pendulum.

    The spin about the rod is felt by nothing; it stays where it is.
    """
    k, g = 1000.0, float(np.linalg.norm(weight))
    bob = rs.RigidBody("b", 1.0, 0, position=(1, 0, 0))
    hinge = spring("c", GROUND, rs.Marker("b", (-1, 0, 0)), [k] * 3 + [0] * 3, law=law)
    t = np.linspace(0, 1, 51)
    model = rs.compile_scene(rs.Scene("bob", [bob], [hinge], gravity=weight))
    found = rs.simulate(model, t, TIGHT)
    energy = found["energy"]
    assert largest(found["b.angular_velocity"][:, 0]) < 1e-5  # beside 4 rad/s
    assert largest(energy - energy[0]) < 1e-8 * g  # of the m g l that is exchanged
    path = found["b.position"]
    assert largest(path - pendulum_path(t, np.array(weight), k)) < 1e-8
    # A simple pendulum pulls with at most 3 m g, so the spring gives 3 m g / k, twice that if it
    # came at once. A length longer by this share slows the clock by half the share, at a speed of
    # at most sqrt(2 g l).
    give = 2 * 3 * g / k
    apart = largest(path - pendulum_path(t, np.array(weight), None))
    assert 1e-3 < apart < give + 0.5 * give * np.sqrt(2 * g) * t[-1]


def slopes(values: np.ndarray, h: float) -> np.ndarray:
    """Derivative at the middle of five points, of fourth order."""
    return np.tensordot(np.array([1, -8, 0, 8, -1]) / (12 * h), values, 1)


@pytest.mark.parametrize(
    ("law", "damping"),
    [("standard", 0.0), ("intrinsic", 0.01), ("consistent", 0.0), ("consistent", 0.01)],
)
def test_velocities_of_a_massless_body_are_the_rates_of_its_pose(law: str, damping: float) -> None:
    """Also under a marker driven by TIME, and with a centre of mass beside the body's origin.

    h = 3e-4 s leaves (w h)^4 / 30 = 3e-8 at w = 100 rad/s, and 1e-11 / h = 3e-8 of integration.
    """
    K = np.array([1000, 1200, 1500, 200, 300, 400.0])
    shaken = ground(0.1 * np.sin(9 * rs.TIME), 0.05 * rs.TIME, 0)
    a = rs.RigidBody("a", 0, 0, position=(1, 0, 0), com=(0.1, 0.2, 0))
    b = rs.RigidBody("b", 1, (0.1, 0.2, 0.3), position=(2, 0, 0))
    springs = [
        spring("c1", shaken, rs.Marker("a", (-1, 0.1, 0)), K, damping * K, law),
        spring("c2", rs.Marker("a"), rs.Marker("b", (-1, 0, 0.2)), K, damping * K, law),
    ]
    model = rs.compile_scene(rs.Scene("driven", [a, b], springs, gravity=(0, 1, -3)))
    h = 3e-4
    found = rs.simulate(model, [0, *(0.2 + h * np.arange(-2, 3))], TIGHTER)
    v, w = found["a.velocity"][3], found["a.angular_velocity"][3]
    R = found["a.rotation_matrix"]
    W = R[3].T @ slopes(R[1:], h)
    assert np.linalg.norm(v) > 0.3
    assert np.linalg.norm(w) > 0.3
    assert largest(slopes(found["a.position"][1:], h) - v) < 1e-6 * np.linalg.norm(v)
    assert largest([W[2, 1] - w[0], W[0, 2] - w[1], W[1, 0] - w[2]]) < 1e-6 * np.linalg.norm(w)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("damping", [0.0, 0.01])
def test_wrenches_on_a_massless_body_vanish_by_the_oracle(law: str, damping: float) -> None:
    """At points of the trajectory, to rounding in its first row; so does what moves the neighbour.

    Forces are 1000 N: 1e-10 N is a thousand roundings.
    """
    data = scene_data(law, damping)
    model = rs.compile_scene(scene_of(data))
    assert (model.n_x, model.n_z) == ((20, 6) if damping else (13, 7))
    t = np.linspace(0, 0.5, 11)
    found = rs.simulate(model, t, TIGHTER)
    assert residual(model, found, slice(1)) < 1e-10
    states = oracle_states(found, 2)
    assert unbalance(data, states[:1]) < 1e-12
    assert unbalance(data, states) < 1e-9  # z solves alg = 0 to about ten times rtol
    assert [found[v.name][0] for v in model.dae.z_labels] == pytest.approx(values_of_z(model))
    values = [np.array([found[v.name] for v in labels]) for labels in
              (model.x_labels, model.dae.z_labels)]  # fmt: skip
    rates = np.array(model.function("ode")(t[None, :], *values, [], []))
    rows = [i for i, label in enumerate(model.x_labels) if label.name.startswith("b1.v_")]
    forces = np.array([oracle.wrenches(data, state)[0][1] for state in states])
    np.testing.assert_allclose(rates[rows].T, forces / 2.0, atol=1e-11 * largest(forces))


# Against small masses.


@pytest.mark.parametrize("damping", [UNDAMPED, DAMPED])
def test_error_beside_a_small_mass_falls_in_proportion_to_it(damping: float) -> None:
    masses = np.array([1e-5, 1e-4, 1e-3, 1e-2])
    found = chart.errors(damping, masses)
    # The next order of the expansion in mass adds 1 % at 1e-2 kg: 0.003 to the slope.
    assert chart.slope(masses, found) == pytest.approx(1, abs=0.1)
    assert found[0] < 1e-5
    assert found[-1] > 1e-4, "the scene must feel the mass"


def test_chart_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chart, "errors", lambda damping, masses: (1 + damping) * masses)
    path = chart.draw(tmp_path / "new" / "massless.png")
    assert path.read_bytes().startswith(b"\x89PNG")
