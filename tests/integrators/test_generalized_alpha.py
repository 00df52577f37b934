"""Generalized-alpha: order, amplification, oracles, published numbers."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from oracles import laws
from oracles.dissipation import (
    alpha_body,
    alpha_roots,
    alpha_steps,
    amplification_matrix,
    spectral_radius,
)
from oracles.rotations import cross, exp_so3
from scenes import published, reference
from scenes.alpha import (
    FORMULATIONS,
    GROUND,
    K_TUMBLING,
    TIGHT,
    TIP,
    TUMBLING,
    WEIGHT,
    model_of,
    path,
    start_of,
    tumbling,
)

import rbsd_sym as rs
from rbsd_sym.integrators.alpha_step import Groups, first_order, second_order, step_function
from rbsd_sym.integrators.generalized_alpha import GeneralizedAlpha

NOTHING = np.zeros(0)
by_formulation = pytest.mark.parametrize("formulation", FORMULATIONS)
by_minimal = pytest.mark.parametrize("minimal", [True, False], ids=["minimal", "full"])


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
    times = np.linspace(0, reference.SCENES[name]["t_end"], 6)
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
    moved = Groups(model.dae).moved
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
    method = GeneralizedAlpha(h, rho)
    found = rs.simulate(model_of("driven"), oracle.t, method, inputs={"f": pull})
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
        found = rs.simulate(model, [0, 1.0], GeneralizedAlpha(h))["rod_0.v_y"][-1]
        assert abs(found - published.GOVERNOR_SPEED[1.0]) == pytest.approx(error, rel=0.025)
