"""Generalized-alpha: order, amplification, oracles, published numbers, C, steps, failures."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import massless_chart
import numpy as np
import published_scenes as published
import pytest
import reference_scenes as reference
from oracles import laws
from oracles.dissipation import (
    alpha_body,
    alpha_roots,
    alpha_steps,
    amplification_matrix,
    spectral_radius,
)
from oracles.rotations import cross, exp_so3

import rbsd_sym as rs
from rbsd_sym.integrators.alpha_step import (
    Layout,
    first_order,
    rates_function,
    second_order,
    step_function,
)
from rbsd_sym.integrators.generalized_alpha import GeneralizedAlpha, Stepper
from rbsd_sym.pipeline import make_experiment
from rbsd_sym.trajectory import Outcome

GROUND = rs.Marker(rs.GROUND)
FORMULATIONS = {"quaternion": rs.Quaternion(), "tait_bryan": rs.TaitBryan()}
TIGHT = rs.Idas(1e-11, 1e-13)
NOTHING = np.zeros(0)
COMPILER = shutil.which("gcc") or shutil.which("cc")
by_formulation = pytest.mark.parametrize("formulation", FORMULATIONS)
by_minimal = pytest.mark.parametrize("minimal", [True, False], ids=["minimal", "full"])


@cache
def model_of(name: str, formulation: str = "quaternion", minimal: bool = True) -> rs.Model:
    return rs.compile_scene(SCENES[name](), FORMULATIONS[formulation], minimal)


def oscillator() -> rs.Scene:
    """One state and its velocity, at 1 rad/s."""
    body = rs.RigidBody("b", 1.0, [1, 1, 1], velocity=[0.1, 0, 0])
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("b"), [1, 0, 0, 0, 0, 0])
    return rs.Scene("oscillator", [body], [spring])


def driven() -> rs.Scene:
    """A damped oscillator under an input, and a rotation that the input does not reach."""
    body = rs.RigidBody("b", 2.0, [1, 1, 1], velocity=[0.7, 0, 0])
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), [50, 0, 0, 0, 0, 0], [3, 0, 0, 0, 0, 0]
    )
    pull = rs.Load("pull", rs.Marker("b"), force=(rs.Input("f", "N"), 0, 0))
    return rs.Scene("driven", [body], [spring], [pull])


def kelvin() -> rs.Scene:
    """A massless body on a spring (1 N/m) and a damper (1 N s/m): x' = -x, and x' is algebraic."""
    body = rs.RigidBody("a", 0, 0, position=(0.4, 0, 0))
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("a"), [1] * 6, [1] * 6)
    return rs.Scene("kelvin", [body], [spring])


def maxwell() -> rs.Scene:
    """A tumbling body with two Maxwell branches, whose forces are states of first order."""
    body = rs.RigidBody(
        "b", 1.0, [1, 2, 3], velocity=[0.7, 0.5, 0.2], angular_velocity=[0.3, 0.2, 1.5]
    )
    branches = (rs.Maxwell(0, 100.0, 3.0), rs.Maxwell(4, 20.0, 1.0))
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), [50, 60, 70, 8, 9, 10], effects=branches
    )
    return rs.Scene("maxwell", [body], [spring], gravity=(0, 0, -9.81))


def rod() -> rs.Scene:
    """A thin rod: its spin about its own axis is algebraic, the other two have inertia."""
    body = rs.RigidBody(
        "r", 1.0, (0, 0.1, 0.1), position=(1, 0, 0), velocity=(0, 0.5, 0.2),
        angular_velocity=(0, 1, -2),
    )  # fmt: skip
    K = np.array([300, 400, 500, 20, 30, 40.0])
    ends = rs.Marker(rs.GROUND, (0.5, 0, 0)), rs.Marker("r", (-0.5, 0.05, 0))
    spring = rs.RigidBodySpringDamper("s", *ends, K, 0.02 * K, law=rs.Consistent())
    return rs.Scene("rod", [body], [spring], gravity=(0.1, 0, -9.81))


def pendulum() -> rs.Scene:
    """Planar in a tilted plane: three coordinates in axes of that plane."""
    R, k = exp_so3([0.3, 0.5, -0.2]), 500.0
    body = rs.RigidBody(
        "b", 1.0, [0.01, 0.02, 0.03], position=R @ [1, 0, 0], rotation=R,
        velocity=R @ [0, 0.5, 0], angular_velocity=[0, 0, 0.5],
    )  # fmt: skip
    hinge = rs.RigidBodySpringDamper(
        "c", rs.Marker(rs.GROUND, (0, 0, 0), R), rs.Marker("b", [-1, 0, 0]),
        [k, k, k, 50, 50, 0], [1, 1, 1, 0.1, 0.1, 0],
    )  # fmt: skip
    return rs.Scene("pendulum", [body], [hinge], gravity=R @ [0, -9.81, 0])


TUMBLING = {
    "mass": 2.0, "inertia": np.diag([0.1, 0.2, 0.25]), "position": np.array([0.1, 0.05, -0.2]),
    "rotation": exp_so3([0.3, -0.2, 0.5]), "velocity": np.array([0.3, -1, 0.5, 3, -2, 5]),
}  # fmt: skip
K_TUMBLING = np.array([400, 500, 700, 25, 50, 32.0])
TIP = np.array([0.1, 0.2, -0.1])
WEIGHT = np.array([0, 0, -9.81])


def tumbling(law: Any = None) -> rs.Scene:
    """A body that turns once a second, on a damped spring at a corner."""
    T = TUMBLING
    body = rs.RigidBody(
        "b", T["mass"], T["inertia"], position=T["position"], rotation=T["rotation"],
        velocity=T["velocity"][:3], angular_velocity=T["velocity"][3:],
    )  # fmt: skip
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b", TIP), K_TUMBLING, 0.01 * K_TUMBLING, law=law or rs.Standard()
    )
    return rs.Scene("tumbling", [body], [spring], gravity=WEIGHT)


SCENES = {
    "oscillator": oscillator, "driven": driven, "kelvin": kelvin, "maxwell": maxwell, "rod": rod,
    "pendulum": pendulum, "tumbling": tumbling, "heavy_top": published.heavy_top,
    "link": lambda: massless_chart.scene(0.0, massless_chart.UNDAMPED),
    "damped_link": lambda: massless_chart.scene(0.0, massless_chart.DAMPED),
} | {name: lambda name=name: reference.build(name) for name in reference.REFERENCE}  # fmt: skip


def start_of(model: rs.Model) -> list[np.ndarray]:
    """x, z, u, p at their start."""
    dae = model.dae
    groups = (model.x_labels, dae.z_labels, dae.u_labels, dae.p_labels)
    return [np.array([label.start for label in labels]) for labels in groups]


def path(model: rs.Model, t_end: float, integrator: Any) -> np.ndarray:
    """States and unknowns at 21 times."""
    found = rs.simulate(model, np.linspace(0, t_end, 21), integrator)
    return np.array([found[name] for name in found.states])


def stepper(model: rs.Model, rho: float = 0.9) -> Stepper:
    return Stepper(model, make_experiment(model, [0, 1], {}, {}, {}), rho, 1e-10)


# Order


@by_minimal
@by_formulation
@pytest.mark.parametrize(
    ("name", "h"), [("mini", 2e-3), ("single", 4e-3), ("single_consistent", 4e-3)]
)
def test_order_two_on_reference_scenes(
    name: str, h: float, formulation: str, minimal: bool
) -> None:
    """The next term of the error is h w = 0.1 of the first in its square: 1 % of the order."""
    model = model_of(name, formulation, minimal)
    times = np.linspace(0, reference.REFERENCE[name]["t_end"], 6)
    errors = [
        reference.error(name, rs.simulate(model, times, GeneralizedAlpha(step)))
        for step in (h, h / 2)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.03)
    assert errors[1] < 1e-3


@by_formulation
def test_order_two_on_an_undamped_pair(formulation: str) -> None:
    """Its rotations are fast (h w = 0.2): their phase makes the observed order 2.1 still."""
    model = model_of("pair_consistent", formulation)
    errors = [
        reference.error("pair_consistent", rs.simulate(model, [0, 0.5, 1], GeneralizedAlpha(step)))
        for step in (1e-3, 5e-4)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.15)


@by_formulation
@pytest.mark.parametrize(
    ("name", "kinds"),
    [("link", (6, 0, 0)), ("damped_link", (6, 6, 0)), ("rod", (5, 1, 0)), ("maxwell", (6, 0, 2)),
     ("pendulum", (3, 0, 0)), ("kelvin", (0, 1, 0))],
)  # fmt: skip
def test_order_two_with_unknowns_and_states_of_first_order(
    name: str, kinds: tuple[int, ...], formulation: str
) -> None:
    """Also with rho = 0, where the start's a0 = v0' is felt most. `kinds` counts what is moved."""
    model = model_of(name, formulation)
    moved = Layout(model.dae).moved
    second, tangent = sum(m.second for m in moved), sum(m.velocity is not None for m in moved)
    assert (second, tangent, len(moved) - second - tangent) == kinds
    exact = path(model, 0.2, TIGHT)
    scale = np.abs(exact).max()
    for rho in (1.0, 0.8, 0.0):
        errors = [
            np.abs(path(model, 0.2, GeneralizedAlpha(h, rho)) - exact).max()
            for h in (1e-3, 5e-4)
        ]
        assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1), rho
        assert errors[0] < 0.02 * scale


@pytest.mark.parametrize("rho", [0.9, 0.5, 0.0])
def test_order_two_with_steps_that_vary(rho: float) -> None:
    """By a factor of three, smoothly: 2 s in output intervals of 1 + sin(20 t)/2, a step each."""
    errors = []
    for count in (800, 1600):
        s = np.linspace(0, 2, count + 1)
        times = s + (1 - np.cos(20 * s)) / 40
        times *= 2 / times[-1]
        found = rs.simulate(model_of("single_consistent"), times, GeneralizedAlpha(1.0, rho))
        assert found.stats["steps"] == count
        errors.append(reference.error("single_consistent", found))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.3, 0.0])
def test_a_jump_of_the_step_leaves_what_is_documented(rho: float) -> None:
    """Under f = t (v'' = 1): ((1 - rho)/(1 + rho))^2/2 h d for a step longer by d; exact before.

    The first step is such a jump, from 0. A jump's share dies out with 2^-n at least.
    """
    body, load = rs.RigidBody("b", 1.0, [1, 1, 1]), rs.Load("l", rs.Marker("b"), (rs.TIME, 0, 0))
    model = rs.compile_scene(rs.Scene("pushed", [body], [], [load]))
    times = np.concatenate([np.arange(0, 101.0), 100 + 2.5 * np.arange(1, 21)])
    found = rs.simulate(model, times, GeneralizedAlpha(5.0, rho))
    gap = found["b.v_x"] - times**2 / 2
    share = ((1 - rho) / (1 + rho)) ** 2 / 2
    assert gap[100] == pytest.approx(share, abs=1e-9)
    assert gap[-1] - gap[100] == pytest.approx(share * 2.5 * 1.5, abs=1e-5)


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.3, 0.0])
def test_local_errors_are_those_of_the_coefficients(rho: float) -> None:
    """Under f = t^2/2 (v''' = 1) and f = t (v'' = 1), after the start has died out.

    Steps of 1 s: each adds the same error, up to rounding of t^4 = 1e7, and of rho^60 < 2e-6.
    """
    body, coefficients = rs.RigidBody("b", 1.0, [1, 1, 1]), second_order(rho)
    for power, row, shares, error in (
        (1, 0, [1 / 6], coefficients.error_of_position), (2, 1, [1 / 6], coefficients.error)
    ):  # fmt: skip
        load = rs.Load("l", rs.Marker("b"), force=(rs.TIME**power / power, 0, 0))
        model = rs.compile_scene(rs.Scene("pushed", [body], [], [load]))
        t = np.arange(61.0)
        found = rs.simulate(model, t, GeneralizedAlpha(1.0, rho))
        v = t ** (power + 1) / (power * (power + 1))
        gap = found["b.v_x"] - v
        if row == 0:  # the coordinate's error beyond that of the velocity it starts with
            gap = found["b.p_x"] - t**3 * shares[0]
            added = gap[-1] - gap[-2] - (found["b.v_x"] - v)[-2]
        else:
            added = gap[-1] - gap[-2]
        assert added == pytest.approx(error, abs=1e-5)


@by_formulation
def test_minimal_and_full_models_take_the_same_steps(formulation: str) -> None:
    """What is left out is at rest; in the plane's axes the same tangent steps are taken.

    Outputs differ by the rounding of coordinates, which hinges of 100 rad/s turn into velocities.
    """
    t = np.linspace(0, 1, 11)
    small, full = (
        rs.simulate(model_of("pendulum", formulation, minimal), t, GeneralizedAlpha(5e-3, 0.7))
        for minimal in (True, False)
    )
    for name in ("b.position", "b.rotation_matrix", "b.velocity"):
        np.testing.assert_allclose(small[name], full[name], rtol=0, atol=1e-10)


def test_velocities_without_coordinates_take_the_same_steps() -> None:
    """Where only velocities are asked for, the minimal model has no coordinates."""
    body = rs.RigidBody("b", 1.0, [1, 2, 3], velocity=[0.7, 0.5, 0.2], angular_velocity=[1, 2, 3])
    air = rs.RigidBodySpringDamper("air", GROUND, rs.Marker("b"), [0] * 6, [0.5] * 3 + [0.2] * 3)
    scenes = [rs.Scene("falling", [body], [air], gravity=WEIGHT, outputs=outputs)
              for outputs in (["b.velocity"], [])]  # fmt: skip
    small, full = (rs.compile_scene(scene) for scene in scenes)
    assert not any(".p_" in label.name for label in small.x_labels)
    a, b = (rs.simulate(m, [0, 0.5, 1], GeneralizedAlpha(0.05, 0.3)) for m in (small, full))
    np.testing.assert_allclose(a["b.velocity"], b["b.velocity"], rtol=0, atol=1e-12)


# Amplification


def amplification(h: float, rho: float, powers: tuple[int, int] = (1, 2)) -> np.ndarray:
    """Matrix of one step on the columns (q, h v / s^i, h^2 a / s^j), s = h w or 1, w = 1 rad/s."""
    step, columns, s = step_function(model_of("oscillator"), rho, 1e-8), [], max(h, 1.0)
    units = np.array([1.0, s ** powers[0], s ** powers[1]])
    for q, hv, hha in np.diag(units):
        x1, _, a1, _, size, _ = step(
            0, h, [q, hv / h], [0, -q], [0, hha / h**2], NOTHING, NOTHING, NOTHING
        )
        assert float(size) <= 1e-8
        columns.append(np.array([float(x1[0]), float(x1[1]) * h, float(a1[1]) * h * h]) / units)
    return np.array(columns).T


@pytest.mark.parametrize("rho", [1.0, 0.9, 0.5, 0.0])
def test_amplification_on_an_undamped_oscillator(rho: float) -> None:
    """With entries of order 1 the nearly triple root at large h w keeps its digits.

    At rho < 1 the state of a stiff oscillation has h v = (h w)^2 q: the matrix in that scaling is
    right to rounding only if q is no difference of numbers that large (1e8 q at h w = 1e4).
    """
    for h in np.logspace(-2, 4, 13):
        matrix = amplification(h, rho)
        radius = float(np.abs(np.linalg.eigvals(matrix)).max())
        assert radius == pytest.approx(spectral_radius(h, rho), abs=1e-8)
        if rho < 1:
            units = np.array([1.0, max(h, 1.0) ** 2, max(h, 1.0) ** 2])
            oracle = amplification_matrix(h, rho) * units / units[:, None]
            np.testing.assert_allclose(amplification(h, rho, (2, 2)), oracle, rtol=0, atol=1e-12)


def test_accelerations_keep_their_digits_in_short_steps() -> None:
    """Steps of 1e-6 s at 1 m/s: dq - h v is 1e-6 of dq, and 1e-10 would be left of a."""
    step = step_function(model_of("oscillator"), 0.9, 1e-12)
    given = ([1.0, 1.0], [0, -1.0], [0, -1.0], NOTHING, NOTHING, NOTHING)
    x1, rate1, *_ = step(0, 1e-6, *given)
    assert float(rate1[1]) == pytest.approx(-float(x1[0]), abs=1e-14)


def test_rho_one_keeps_the_pair_of_the_trapezoidal_rule_and_no_third_root() -> None:
    for h in (0.1, 1.0, 100.0):
        found = np.linalg.eigvals(amplification(h, 1.0))
        pair = alpha_roots(h, 1.0)[:2]
        for root in (*pair, 0.0):
            assert np.abs(found - root).min() < 1e-12


def test_rho_one_is_the_trapezoidal_rule() -> None:
    """x1 = (1 - h A/2)^-1 (1 + h A/2) x0 for the damped scene `mini`; 1000 m/s of 1e-16 each."""
    model, h = model_of("mini"), 0.01
    A = np.array(ca.DM(model.function("dode_dx")(0, start_of(model)[0], [], [], [])))
    found = rs.simulate(model, h * np.arange(101), GeneralizedAlpha(h, 1.0))
    x = start_of(model)[0]
    for k in range(1, 101):
        x = np.linalg.solve(np.eye(2) - h / 2 * A, x + h / 2 * (A @ x))
        assert [found[name][k] for name in found.states] == pytest.approx(x, abs=1e-10)


@pytest.mark.parametrize(
    ("rho", "h", "left"),
    [(0.9, 0.3, 0.9994), (0.9, 1.0, 0.9439), (0.9, 10.0, 7.8e-8), (0.5, 0.1, 0.998),
     (0.5, 0.3, 0.868), (0.5, 1.0, 2.2e-5), (1.0, 1.0, 1.0)],
)  # fmt: skip
def test_published_amplitude_after_1000_steps(rho: float, h: float, left: float) -> None:
    """Within half a unit of the last digit printed, which is 1e-3 to 2 % of the value."""
    radius = np.abs(np.linalg.eigvals(amplification(h, rho))).max()
    assert radius**1000 == pytest.approx(left, rel=0.025 if left < 1e-3 else 6e-4)


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.5, 0.0])
def test_first_order_states_follow_jansen_whiting_hulbert(rho: float) -> None:
    """Their own form, with alphas from the start of the step, on x' = -x for the columns (x, h a).

    y_m = r_0 + m (r_1 - r_0) = -(x_0 + f (x_1 - x_0)), x_1 = x_0 + h r_0 + g h (r_1 - r_0),
    m = (3 - rho)/(1 + rho)/2, f = 1/(1 + rho), g = 1/2 + m - f.
    """
    m, f = 0.5 * (3 - rho) / (1 + rho), 1 / (1 + rho)
    g = 0.5 + m - f
    model, step = model_of("kelvin"), step_function(model_of("kelvin"), rho, 1e-12)
    names = [label.name for label in model.x_labels]
    row, n = names.index("a.p_x"), model.n_x
    x, z, u, p = start_of(model)
    for h in (0.01, 1.0, 1e3):
        left = np.array([[f * h, m], [1.0, -g]])
        right = np.array([[(f - 1) * h, m - 1], [1.0, 1 - g]])
        for q, ha in ((0.4, 0.0), (0.4, -0.3 * h)):
            rate, a = np.zeros(n), np.zeros(n)
            rate[row], a[row], x[row] = -q, ha / h, q
            x1, rate1, a1, *_ = step(0, h, x, rate, a, z, u, p)
            if rho == 1:  # a = x' is kept exactly, whatever a was
                assert float(a1[row]) == pytest.approx(-float(x1[row]), abs=1e-14)
                continue
            found = [float(x1[row]), h * float(a1[row])]
            assert found == pytest.approx(np.linalg.solve(left, right @ [q, ha]), abs=1e-12)
            assert float(rate1[row]) == pytest.approx(-found[0], abs=1e-12)
        assert first_order(rho).gamma == pytest.approx(g)


# Oracles


def wrench_of(law: str) -> Any:
    """Force (world) and moment (body axes) on the tumbling body by the oracle's law."""

    def wrench(t: float, p: Any, R: Any, v: Any, w: Any) -> tuple[Any, Any]:
        arm, w_W = R @ TIP, R @ w
        found = getattr(laws, law)(
            laws.Pose(np.zeros(3), np.eye(3)), laws.Pose(p + arm, R, v + cross(w_W, arm), w_W),
            np.diag(K_TUMBLING), np.diag(0.01 * K_TUMBLING), np.zeros(6), 0.0,
        )  # fmt: skip
        moment = found.torque1 + cross(arm, found.force1)
        return found.force1 + TUMBLING["mass"] * WEIGHT, R.T @ moment

    return wrench


@by_formulation
@pytest.mark.parametrize(
    ("law", "rho"), [("standard", 0.8), ("consistent", 1.0), ("consistent", 0.0)]
)
def test_every_step_is_that_of_the_oracle(law: str, rho: float, formulation: str) -> None:
    """Half a turn in 50 steps; values up to 13 with 1e-16 each, on 50 steps: 1e-13, and room."""
    h, steps = 0.01, 50
    oracle = alpha_body(wrench=wrench_of(law), h=h, steps=steps, rho=rho, **TUMBLING)
    scene = tumbling({"standard": rs.Standard(), "consistent": rs.Consistent()}[law])
    model = rs.compile_scene(scene, FORMULATIONS[formulation])
    found = rs.simulate(model, oracle.t, GeneralizedAlpha(h, rho, newton_tolerance=1e-10))
    for name, values in (("position", oracle.p), ("rotation_matrix", oracle.R),
                         ("velocity", oracle.v[:, :3]), ("angular_velocity", oracle.v[:, 3:])):
        np.testing.assert_allclose(found[f"b.{name}"], values, rtol=0, atol=1e-12)


@pytest.mark.parametrize("rho", [1.0, 0.8, 0.0])
def test_inputs_count_at_the_end_of_a_step(rho: float) -> None:
    """2 v' + 3 v + 50 q = f(t) by the oracle, which takes f at both ends of a step."""
    pull, h = (lambda t: 3 * np.sin(4 * t) + 1), 0.01
    oracle = alpha_steps(
        lambda t, q, v, rate: 2 * rate + 3 * v + 50 * q - pull(t),
        lambda t, q, v, rate: (np.array([[50.0]]), np.array([[3.0]]), np.array([[2.0]])),
        [0.0], [0.7], h, 100, rho,
    )  # fmt: skip
    found = rs.simulate(model_of("driven"), oracle.t, GeneralizedAlpha(h, rho), {"f": pull})
    np.testing.assert_allclose(found["b.p_x"], oracle.q[:, 0], rtol=0, atol=1e-13)
    np.testing.assert_allclose(found["b.v_x"], oracle.v[:, 0], rtol=0, atol=1e-13)


# Long runs


def test_free_rotation_loses_no_digits() -> None:
    """1e5 steps of 1e-3 rad, 100 rad in all.

    The tangent step is h w exactly, so w never changes. Each product of quaternions rounds by
    1e-16: at random 3e-14 after 1e5 steps, 1e-12 leaves room for some bias. The norm, which nothing
    feels, is multiplied by that of the same exponential every time: 1e5 times 2.2e-16.
    """
    w = np.array([1.0, 2.0, 2.0]) / 3
    body = rs.RigidBody("b", 1.0, [1, 1, 1], angular_velocity=w)
    model = rs.compile_scene(rs.Scene("free", [body], []), minimal=False)
    found = rs.simulate(model, np.linspace(0, 100, 11), GeneralizedAlpha(1e-3))
    assert found.stats["steps"] == 100_000
    assert (found["b.angular_velocity"] == w).all()
    for t, R in zip(found.t, found["b.rotation_matrix"], strict=True):
        assert np.abs(R - exp_so3(t * w)).max() < 1e-12
    q = np.array([found[f"b.q_{c}"] for c in "wxyz"])
    assert np.abs(np.linalg.norm(q, axis=0) - 1).max() < 1e5 * 2.2e-16


def test_heavy_top_extrapolates_to_the_published_place() -> None:
    """Order 2: (4 x(h/2) - x(h))/3 leaves order 4 of (h w)^4 with w = 150 rad/s: some 1e-5 m."""
    places = [
        rs.simulate(model_of("heavy_top"), [0, 1.0], GeneralizedAlpha(h))["top.position"][-1]
        for h in (1e-3, 5e-4)
    ]
    exact = np.array(published.HEAVY_TOP_CENTRE[1.0])
    assert np.abs(places[1] - exact).max() == pytest.approx(1.3e-3, rel=0.1)
    assert np.abs((4 * places[1] - places[0]) / 3 - exact).max() < 3e-5


@pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")
def test_governor_has_the_published_errors_of_generalized_alpha() -> None:
    """Exudyn's with rho = 0.9: 7.9e-5 m/s with steps of 1 ms, 2.0e-6 with 0.2 ms."""
    model = rs.compile_scene(published.governor())
    for h, error in ((1e-3, 7.9e-5), (2e-4, 2.0e-6)):
        found = rs.simulate(model, [0, 1.0], GeneralizedAlpha(h))["rod0.v_y"][-1]
        assert abs(found - published.GOVERNOR_SPEED[1.0]) == pytest.approx(error, rel=0.025)


# The step function


@pytest.mark.skipif(not COMPILER, reason="no C compiler")
@pytest.mark.parametrize(
    ("name", "layout"), [("tumbling", "flat"), ("rod", "flat"), ("chain4", "kernels")]
)
def test_step_function_generates_to_c(name: str, layout: str, tmp_path: Path) -> None:
    """Operations come in the same order: differences are those of fused ones and of exp and sin."""
    model = rs.compile_scene(SCENES[name](), layout=layout)
    step = step_function(model, 0.9, 1e-9)
    generator = ca.CodeGenerator("step.c")
    generator.add(step)
    (tmp_path / "step.c").write_text(generator.dump())
    library = tmp_path / "step.so"
    subprocess.run(
        [COMPILER, "-std=c99", "-O0", "-shared", "-fPIC", "step.c", "-o", library, "-lm"],
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    compiled = ca.external("alpha_step", str(library))
    x, z, u, p = start_of(model)
    rate = rates_function(model)(0, x, z, u, p)
    for ours, theirs in zip(*(f(0, 2e-3, x, rate, rate, z, u, p) for f in (step, compiled)),
                            strict=True):
        np.testing.assert_allclose(np.array(theirs), np.array(ours), rtol=1e-12, atol=1e-12)
    for f in (step, compiled):
        *_, size, count = f(0, 2e-3, x * np.nan, rate, rate, z, u, p)
        assert float(size) == np.inf
        assert not float(count) > 12


@pytest.mark.parametrize("name", ["pair_consistent", "damped_link"])
def test_kernels_and_compiled_models_take_the_same_steps(name: str) -> None:
    """Sums in another order: 1e-16 of 1e6 N/m, over 50 steps."""
    flat = model_of(name)
    others = [rs.compile_scene(SCENES[name](), layout="kernels")]
    others += [rs.compiled(flat, flags=["-O0"])] if COMPILER and name == "pair_consistent" else []
    exact = path(flat, 0.1, GeneralizedAlpha(2.5e-3))
    for model in others:
        assert model.calls
        found = path(model, 0.1, GeneralizedAlpha(2.5e-3))
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)


def test_single_steps_leave_the_state_as_it_was() -> None:
    """A step tried, cut and tried again is the step; data states hold during a step, then stay."""
    s = stepper(model_of("tumbling"))
    start = s.start(0.0, *start_of(s.model)[:2])
    whole = s.try_step(start, 0.01)
    s.try_step(start, 0.003)
    again = s.try_step(start, 0.01)
    assert not isinstance(whole, Outcome)
    assert not isinstance(again, Outcome)
    assert (whole.x == again.x).all()
    assert whole.t == 0.01
    assert s.tried == 3


def test_data_states_are_no_unknowns_and_may_be_changed_for_a_step() -> None:
    """A spring in series with a slider (Plastic): its plastic strain moves the spring's origin."""
    body = rs.RigidBody("b", 1.0, [1, 1, 1], velocity=[0.1, 0, 0])
    slider = rs.Plastic(0, 30.0, 1e3)
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), [1, 0, 0, 0, 0, 0], effects=(slider,)
    )
    model = rs.compile_scene(rs.Scene("slider", [body], [spring]))
    names = [label.name for label in model.x_labels]
    data = [names[i] for i in model.dae.data]
    assert len(data) == 2
    assert not set(Layout(model.dae).slots) & set(model.dae.data)
    s = stepper(model)
    start = s.start(0.0, *start_of(model)[:2])
    plain = s.try_step(start, 0.01)
    values = np.where([name.endswith("_plastic") for name in data], 0.02, 0.0)
    moved = s.try_step(start, 0.01, values)
    assert not isinstance(plain, Outcome)
    assert not isinstance(moved, Outcome)
    assert (plain.x[s.data] == start.x[s.data]).all()
    assert sorted(moved.x[s.data]) == [0.0, 0.02]
    row = names.index("b.v_x")
    assert moved.rate[row] - plain.rate[row] == pytest.approx(30 * 0.02, rel=0.01)


# Steps


def test_intervals_are_cut_into_the_fewest_equal_steps() -> None:
    """0.1 / 0.01 is 10 steps and no sliver, 0.025 / 0.01 is 3."""
    for times, steps in (([0, 0.1, 0.2, 0.3], 30), ([0, 0.025, 0.05], 6), ([0, 0.01, 0.02], 2),
                         ([0, 0.004, 0.02], 3), (np.linspace(0, 1, 8), 7 * 15)):
        found = rs.simulate(model_of("oscillator"), times, GeneralizedAlpha(0.01))
        assert found.stats["steps"] == steps
        assert (found.t == np.array(times)).all()


def test_shorter_steps_where_newton_fails() -> None:
    """Steps of 50 ms at 13 rad/s; one is too long to be solved."""
    found = rs.simulate(model_of("pair_consistent"), [0, 0.5, 1.0], GeneralizedAlpha(0.05, 0.5))
    assert found.stats["rejected_steps"] > 0
    assert found.outcome is Outcome.reached_end


@pytest.mark.parametrize(("name", "t_end"), [("single", 0.4), ("maxwell", 2.0), ("kelvin", 40.0)])
def test_error_falls_with_the_tolerance(name: str, t_end: float) -> None:
    """A local error of h^3 within the tolerance leaves tol^(2/3): 1e-2 over three decades."""
    model = model_of(name)
    exact = path(model, t_end, TIGHT)
    errors, steps, rejected = [], [], 0.0
    for tolerance in (1e-3, 1e-4, 1e-5, 1e-6):
        method = GeneralizedAlpha(t_end / 8, 0.8, tolerance, tolerance)
        found = rs.simulate(model, np.linspace(0, t_end, 21), method)
        values = np.array([found[state] for state in found.states])
        errors.append(np.abs(values - exact).max())
        steps.append(found.stats["steps"])
        rejected += found.stats["rejected_steps"]
    assert rejected > 0
    assert errors[-1] < errors[0] / 20
    assert steps[-1] / steps[-2] == pytest.approx(10 ** (1 / 3), rel=0.25)


def test_adaptive_steps_step_over_a_stiff_vibration() -> None:
    """The pivot's 2.6e3 rad/s (1e-6 m) do not bind the steps; the top's turning does."""
    found = rs.simulate(model_of("heavy_top"), [0, 0.2], GeneralizedAlpha(1e-3, 0.5, 1e-4, 1e-4))
    assert found.stats["steps"] < 0.2 * 2.6e3


# Failures


def growing(force: Any) -> rs.Scene:
    """A massless body on a spring whose force never exceeds 1 N, under a load."""

    def law(mbs: Any, t: Any, item: Any, displacement: Any, rotation: Any, *rest: Any) -> list[Any]:
        return [np.tanh(displacement[0]), displacement[1], displacement[2], *rotation]

    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("a"), np.zeros(6), force=law)
    load = rs.Load("l", rs.Marker("a"), force=(force, 0, 0))
    bodies = [rs.RigidBody("a", 0, 0), rs.RigidBody("b", 1.0, [1, 1, 1], velocity=[1, 0, 0])]
    other = rs.RigidBodySpringDamper("o", GROUND, rs.Marker("b"), [5] * 6)
    return rs.Scene("growing", bodies, [spring, other], [load])


@pytest.mark.parametrize(
    "tolerances", [{}, {"rtol": 1e-3, "atol": 1e-3}], ids=["fixed", "adaptive"]
)
def test_failures_keep_the_trajectory(tolerances: dict[str, float]) -> None:
    """No solution from t = 0.5 s on; no number from 0.5 s on; too many steps."""
    unsolvable = rs.compile_scene(growing(2 * rs.TIME))
    body = rs.RigidBody("b", 1.0, [1, 1, 1])
    load = rs.Load("l", rs.Marker("b"), force=(np.sqrt(0.5 - rs.TIME), 0, 0))
    imaginary = rs.compile_scene(rs.Scene("imaginary", [body], [], [load]))
    times = np.linspace(0, 1, 11)
    for model, outcomes in ((unsolvable, (Outcome.solver_failed, Outcome.not_finite)),
                            (imaginary, (Outcome.not_finite,))):
        found = rs.simulate(model, times, GeneralizedAlpha(0.01, **tolerances), throw=False)
        assert found.outcome in outcomes
        assert len(found.t) in (5, 6)
        assert found.stats["t_failed"] == pytest.approx(0.5, abs=0.011)
        assert all(np.isfinite(found[name]).all() for name in found.states)
        assert f"at t = {found.stats['t_failed']:.9g} s" in found.report
    found = rs.simulate(
        model_of("single"), times, GeneralizedAlpha(1e-3, max_steps=250, **tolerances), throw=False
    )
    if tolerances:
        assert found.outcome is Outcome.reached_end
    else:
        assert found.outcome is Outcome.too_many_steps
        assert (len(found.t), found.stats["steps"]) == (3, 250)


def test_a_start_without_solution_is_told() -> None:
    found = rs.simulate(
        rs.compile_scene(growing(2.0 + rs.TIME)), [0, 1], GeneralizedAlpha(0.1), throw=False
    )
    assert found.outcome is Outcome.not_consistent
    assert len(found.t) == 1


def test_models_without_states() -> None:
    """A massless body alone follows its load; a body that nothing moves stays."""
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("a"), [20] * 6)
    load = rs.Load("l", rs.Marker("a"), force=(3 * rs.TIME, 0, 0))
    scene = rs.Scene("hanging", [rs.RigidBody("a", 0, 0)], [spring], [load])
    found = rs.simulate(rs.compile_scene(scene), [0, 1, 2], GeneralizedAlpha(0.5))
    assert found["a.position"][:, 0] == pytest.approx([0, 0.15, 0.3], abs=1e-12)
    still = rs.compile_scene(rs.Scene("still", [rs.RigidBody("a", 1.0, [1, 1, 1])], []))
    assert rs.simulate(still, [0, 1], GeneralizedAlpha(1e-9))["a.position"].shape == (2, 3)
    alone = growing(2 * rs.TIME)
    alone = dataclasses.replace(alone, bodies=alone.bodies[:1], connectors=alone.connectors[:1])
    found = rs.simulate(rs.compile_scene(alone), [0, 0.4, 1], GeneralizedAlpha(0.1), throw=False)
    assert found.outcome in (Outcome.solver_failed, Outcome.not_finite)
    assert found["a.p_x"][1] == pytest.approx(np.arctanh(0.8), abs=1e-12)
    assert len(found.t) == 2
    assert "at t = 0.49" in found.report


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": -0.1}, "GeneralizedAlpha: step -0.1 s; it is positive and finite"),
        ({"step": 0}, "step 0 s; it is positive"),
        ({"step": np.inf}, "step inf s; it is positive and finite"),
        ({"step": np.nan}, "step nan s; it is positive and finite"),
        ({"step": "1e-3"}, "step '1e-3' s; it is positive"),
        ({"step": True}, "step True s; it is positive"),
        ({"spectral_radius": -0.1}, "spectral_radius -0.1; it is a number in 0 ... 1"),
        ({"spectral_radius": 1.1}, "spectral_radius 1.1; it is a number in 0 ... 1"),
        ({"spectral_radius": None}, "spectral_radius None; it is a number in 0 ... 1"),
        ({"rtol": 1e-6}, "rtol 1e-06 and atol None; give both"),
        ({"atol": 1e-6}, "rtol None and atol 1e-06; give both"),
        ({"rtol": 0.0, "atol": 1e-6}, "rtol 0.0; it is a number in 0 ... 1"),
        ({"rtol": 1e-6, "atol": -1.0}, "atol -1.0; it is positive and finite"),
        ({"newton_tolerance": 0.0}, "newton_tolerance 0.0; it is a number in 1e-15 ... 0.001"),
        ({"max_steps": 0}, "max_steps 0; it is a whole number above 0"),
        ({"max_steps": 1e6}, "max_steps 1000000.0; it is a whole number above 0"),
    ],
)
def test_bad_arguments_are_told(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match="GeneralizedAlpha") as caught:
        GeneralizedAlpha(**{"step": 0.1} | arguments)
    assert message in str(caught.value)
