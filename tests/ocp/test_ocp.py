"""Optimal control: derivatives of the program, phases, Params, periods, use."""

from __future__ import annotations

import shutil
from typing import Any

import numpy as np
import pytest
from helpers import complex_step
from scenes.ocp import FORCE, SLEW, cart, hinged, massless_slew, oscillator, pressed_column

import rbsd_sym as rs
from rbsd_sym.ocp import (
    Collocation,
    Fatrop,
    Free,
    Ipopt,
    Phase,
    Problem,
    Shooting,
    optimise,
    transcribe,
)

EPS = np.finfo(float).eps
EFFORT = Collocation(5, 4, input_degree=3)
POSITION = "cart.p_x"


def rest_at(x: float) -> dict[str, Any]:
    return {"cart.p_x": x, "cart.v_x": 0.0}


def rich(layout: str = "auto") -> Problem:
    """Two phases with a link, free horizons, a free Param, costs and conditions of every kind."""
    model = rs.compile_scene(hinged(rs.Standard()), layout=layout)
    first = Phase(
        Free(1.0, 0.5, 2), start={"body.w_x": (-1, 1)},
        path={"joint.torque_local": (-9, 9)},
        end={"force": 0.1, "body.quaternion": (0.6, 0.8, 0, 0)},
        integral=lambda v: v["force"] ** 2 + np.sin(v["t"]) * v["joint.torque_local"][0] ** 2,
        end_cost=lambda v: v["soft"] * v["energy"],
    )  # fmt: skip
    second = Phase(
        Free(0.7, 0.5, 2), link={"body.w_y": lambda v: -0.5 * v["body.w_y"] + 0.1 * v["t"]},
        integral=lambda v: v["body.position"][0] ** 2, end_cost=rs.TIME,
    )  # fmt: skip
    return Problem(model, [first, second], inputs={"force": Free()},
                   params={"soft": Free(3.0, 1, 5)})  # fmt: skip


METHODS = {
    "legendre": (Collocation(2, 2, "legendre", 1), "auto"),
    "radau": (Collocation((1, [0, 0.3, 1]), 3, "radau"), "auto"),
    "kernels": (Collocation(2, 2), "kernels"),
    "order 4": (Shooting(2, 1, input_degree=1), "auto"),
    "order 8": (Shooting(1, 1, order=8), "auto"),
}


NONE = np.zeros((0, 1))


@pytest.mark.parametrize("name", METHODS)
def test_derivatives_of_the_program(name: str) -> None:
    """Against complex steps, which have no error but rounding."""
    method, layout = METHODS[name]
    room = (2000 if name == "order 8" else 200) * EPS  # its coefficients are in the tens
    nlp = transcribe(rich(layout), method)
    functions = nlp.functions
    rng = np.random.default_rng(1)
    x = nlp.bounds["x0"] + 0.05 * rng.standard_normal(nlp.n)
    lam, weight = rng.standard_normal(nlp.m), 1.3

    slope, rows = complex_step.jacobian(functions["nlp"], [x, NONE])
    gradient, jacobian = functions["nlp_grad_f"](x, [])[1], functions["nlp_jac_g"](x, [])[1]
    assert gradient.is_dense()  # IPOPT takes it to be
    gradient, jacobian = np.array(gradient)[:, 0], np.array(jacobian)
    assert np.abs(jacobian - rows).max() < room * np.abs(rows).max()
    assert np.abs(gradient - slope[0]).max() < room * np.abs(slope).max()

    by_parts = weight * gradient + jacobian.T @ lam
    given = [x, NONE, [weight], lam]
    lagrangian = np.array(functions["nlp_grad"](*given)[2])[:, 0]
    assert np.abs(lagrangian - by_parts).max() < room * np.abs(by_parts).max()
    curvature = complex_step.jacobian(functions["nlp_grad"], given)[2]
    hessian = np.array(functions["nlp_hess_l"](*given))
    assert np.abs(hessian - curvature).max() < room * np.abs(curvature).max()


def test_hessian_is_exact_at_rest() -> None:
    """All relative rotations are zero there, where a naive logarithm has no derivative."""
    model = rs.compile_scene(hinged())
    phase = Phase(1.0, integral=lambda v: v["joint.potential_energy"] + v["force"] ** 2)
    nlp = transcribe(Problem(model, phase, inputs={"force": Free()}), Collocation(2, 2))
    x, functions = nlp.bounds["x0"], nlp.functions
    lam = np.random.default_rng(0).standard_normal(nlp.m)
    given = [x, NONE, [1.0], lam]
    hessian = np.array(functions["nlp_hess_l"](*given))
    curvature = complex_step.jacobian(functions["nlp_grad"], given)[2]
    assert np.isfinite(hessian).all()
    assert np.abs(hessian - curvature).max() < 200 * EPS * np.abs(curvature).max()


@pytest.mark.parametrize("layout", ["flat", "kernels"])
def test_both_solvers_find_the_same(layout: str) -> None:
    model = rs.compile_scene(hinged(), layout=layout)
    phase = Phase(1.0, end={"body.w_x": 0.1}, path={"force": (-2, 2)}, integral=FORCE**2)
    problem = Problem(model, phase, inputs={"force": Free()})
    one = optimise(problem, Collocation(3, 2), solver=Ipopt())
    two = optimise(problem, Collocation(3, 2), solver=Fatrop())
    assert one.cost == pytest.approx(two.cost, rel=1e-7)
    assert one.inputs["force"].values == pytest.approx(two.inputs["force"].values, abs=1e-6)


def test_least_effort_of_a_mass() -> None:
    """x'' = u over d in T: u = 6 d / T^2 (1 - 2 t/T), cost 6 d^2 / T^3."""
    model = rs.compile_scene(cart())
    problem = Problem(model, Phase(2.0, end=rest_at(3.0), integral=FORCE**2 / 2),
                      inputs={"force": Free()})  # fmt: skip
    for method in (Collocation(3, 3, input_degree=1), Collocation(3, 3, "radau", 2),
                   Shooting(3, 1, input_degree=1)):  # fmt: skip
        found = optimise(problem, method)
        assert found.cost == pytest.approx(6 * 9 / 8, rel=1e-12)
        for t in (0.0, 0.7, 1.0, 1.9):
            assert found.inputs["force"](t) == pytest.approx(4.5 * (1 - t), abs=1e-9)
        assert found.flown is not None
        assert found.flown.difference < 1e-9
        # The cost grows with d as 2 cost / d, and its derivative by the end state is the costate.
        assert found.multipliers["end cart.p_x"] == pytest.approx(2 * found.cost / 3, rel=1e-8)
        costates = found.multipliers["costate of cart.p_x"]
        assert np.abs(costates) == pytest.approx([2 * found.cost / 3] * 3, rel=1e-8)


def test_what_was_found_can_be_simulated() -> None:
    found = optimise(SLEW.problem(), Collocation(20, 4))
    again = rs.simulate(found.model, found.trajectory.t, rs.Idas(1e-10, 1e-12),
                        inputs=found.inputs)  # fmt: skip
    gap = np.abs(again["tip.position"] - found.trajectory["tip.position"]).max()
    assert gap < 1e-6  # IDAS steps over the jumps here
    assert found.trajectory["rod.force_local"].shape == (len(found.trajectory.t), 3)
    assert found.trajectory["push"].max() <= 1.0 + 1e-9


def test_a_phase_may_begin_with_a_jump() -> None:
    """Least norm with controllability Gramians: cost = d' inv(G) d."""
    model = rs.compile_scene(cart())
    phases = [Phase(1.0, integral=FORCE**2),
              Phase(2.0, link={"cart.v_x": lambda v: -0.5 * v["cart.v_x"]}, end=rest_at(1.0),
                    integral=FORCE**2)]  # fmt: skip
    found = optimise(Problem(model, phases, inputs={"force": Free()}), EFFORT)

    def gramian(T: float) -> np.ndarray:
        return np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])

    over = np.array([[1, 2.0], [0, 1]]) @ np.diag([1, -0.5])
    G = over @ gramian(1.0) @ over.T + gramian(2.0)
    d = np.array([1.0, 0.0])
    assert found.cost == pytest.approx(d @ np.linalg.solve(G, d), rel=1e-10)
    assert found.durations == (1.0, 2.0)
    before = found.raw.plan.phases[0].x[:, -1]
    after = found.raw.plan.phases[1].x[:, 0]
    assert after == pytest.approx(before * [1, -0.5], abs=1e-9)
    assert found.flown is not None
    assert found.flown.difference < 1e-8


@pytest.mark.parametrize("method", [Collocation(8, 5, input_degree=4),
                                    Shooting(8, 2, order=8, input_degree=4)])  # fmt: skip
def test_a_periodic_problem(method: Any) -> None:
    """x'' = u follows a cos(w t): x = X cos(w t), X = a / (1 + r w^4)."""
    a, w, r = 0.3, 2 * np.pi / 3, 0.05
    model = rs.compile_scene(cart())
    cost = lambda v: (v["cart.p_x"] - a * np.cos(w * v["t"])) ** 2 + r * v["force"] ** 2  # noqa: E731
    problem = Problem(model, Phase(3.0, integral=cost), inputs={"force": Free()}, periodic=True)
    found = optimise(problem, method)
    assert found.cost == pytest.approx(1.5 * a**2 * r * w**4 / (1 + r * w**4), rel=1e-8)
    assert found.trajectory["cart.p_x"][0] == pytest.approx(a / (1 + r * w**4), rel=1e-5)
    ends = found.trajectory["cart.p_x"][[0, -1]]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


def test_stiffness_and_force_are_chosen_together() -> None:
    k = rs.Param("k", 2.0, "N/m")
    model = rs.compile_scene(oscillator(k))
    phase = Phase(2.0, end=rest_at(0.0), integral=FORCE**2)

    def cost(value: Any, method: Any = EFFORT) -> Any:
        given = {"force": Free()}
        return optimise(Problem(model, phase, inputs=given, params={"k": value}), method)

    found = cost(Free(2.0, 0.1, 50))
    best = found.params["k"]
    assert 0.2 < best < 40
    around = [cost(best * (1 + d)).cost for d in (-0.02, 0.0, 0.02)]
    assert around[1] == pytest.approx(found.cost, rel=1e-9)
    assert around[0] > around[1] < around[2]
    # The least is flat: its two sides are equal to third order.
    assert abs(around[0] - around[2]) < 0.1 * (around[0] + around[2] - 2 * around[1])
    shot = cost(Free(2.0, 0.1, 50), Shooting(5, 3, order=8, input_degree=3))
    assert shot.params["k"] == pytest.approx(best, rel=1e-5)
    assert shot.cost == pytest.approx(found.cost, abs=1e-7)


def test_a_start_that_follows_from_a_free_parameter() -> None:
    where = rs.Param("where", 0.5, "m")
    model = rs.compile_scene(cart(position=(where, 0, 0)))
    phase = Phase(1.0, end=rest_at(3.0), integral=FORCE**2 / 2)
    problem = Problem(model, phase, inputs={"force": Free()}, params={"where": Free(0.5, 0.0, 2.0)})
    found = optimise(problem, EFFORT)
    assert found.params["where"] == pytest.approx(2.0, abs=1e-7)
    assert found.cost == pytest.approx(6.0, rel=1e-6)


def test_algebraic_unknowns() -> None:
    """Two springs of 2 N/m with a massless joint between are one of 1 N/m."""
    model = rs.compile_scene(massless_slew())
    assert (model.n_x, model.n_z) == (4, 1)
    problem = Problem(model, Phase(5.0, end=SLEW.REST, integral=SLEW.PUSH**2 / 2),
                      inputs={"push": Free()})  # fmt: skip
    stiff = Shooting(8, 2, integrator=rs.Rosenbrock(1e-10, 1e-12), input_degree=2)
    one, two = optimise(problem, Collocation(8, 5, input_degree=2)), optimise(problem, stiff)
    plain = optimise(SLEW.least_effort(), Collocation(8, 5, input_degree=2))
    assert one.cost == pytest.approx(plain.cost, abs=1e-9)
    assert two.cost == pytest.approx(one.cost, abs=1e-6)
    for found in (one, two):
        middle = (found.trajectory["hub.p_x"] + found.trajectory["tip.p_x"]) / 2
        assert found.trajectory["mid.p_x"] == pytest.approx(middle, abs=1e-9)
        assert found.flown is not None
        assert found.flown.difference < 1e-5
    with pytest.raises(ValueError, match="1 algebraic unknowns, which explicit steps"):
        optimise(problem, Shooting(8))


def test_conditions_on_unknowns_and_inputs_at_the_end() -> None:
    model = rs.compile_scene(massless_slew())
    end = {"mid.p_x": 1.5, "hub.v_x": 0, "tip.v_x": 0, "push": 0.25}
    phase = Phase(5.0, end=end, path={"far.force_local": (-0.2, 0.2)}, integral=SLEW.PUSH**2 / 2)
    problem = Problem(model, phase, inputs={"push": Free()})
    found = optimise(problem, Collocation(8, 4, input_degree=3))
    assert found.trajectory["mid.p_x"][-1] == pytest.approx(1.5, abs=1e-8)
    assert found.inputs["push"](5.0) == pytest.approx(0.25, abs=1e-8)
    points = found.trajectory["far.force_local"][:, 0]
    assert 0.19 < np.abs(points).max() < 0.2 + 2e-3  # it holds at the collocation points


def test_an_unstable_motion_that_was_left_out_is_told() -> None:
    model = rs.compile_scene(pressed_column())
    assert {label.name for label in model.x_labels} == {"bar.p_z", "bar.v_z"}
    phase = Phase(1.0, integral=FORCE**2, end={"bar.v_z": 0.0})
    found = optimise(Problem(model, phase, inputs={"force": Free()}), Collocation(40, 3))
    assert found.outcome is rs.ocp.Outcome.unstable_across_reduction
    assert found.outcome.ok
    assert "grows with" in found.report


def test_a_cost_that_needs_a_state_left_out_brings_it_back() -> None:
    model = rs.compile_scene(SLEW.scene())
    cost = lambda v: v["push"] ** 2 / 2 + v["tip.p_y"] ** 2  # noqa: E731
    phase = Phase(5.0, end=SLEW.REST, integral=cost)
    found = optimise(Problem(model, phase, inputs={"push": Free()}), EFFORT)
    assert found.model.n_x == 26
    assert any("'tip.p_y' was left out" in note for note in found.notes)
    assert found.cost == pytest.approx(optimise(SLEW.least_effort(), EFFORT).cost, rel=1e-8)


def test_a_start_elsewhere_brings_states_back() -> None:
    model = rs.compile_scene(cart())
    phase = Phase(1.0, start={"cart.p_y": 0.2}, end=rest_at(1.0), integral=FORCE**2)
    found = optimise(Problem(model, phase, inputs={"force": Free()}), EFFORT)
    assert found.model.n_x == 13
    assert found.trajectory["cart.position"][-1] == pytest.approx([1.0, 0.2, 0.0], abs=1e-9)


@pytest.mark.parametrize("minimal", [True, False])
def test_conditions_that_always_hold_are_left_away(minimal: bool) -> None:
    """They would be redundant equations."""
    model = rs.compile_scene(cart(), minimal=minimal)
    end = {"cart.position": (1.0, 0, 0), "cart.velocity": (0, 0, 0), "cart.p_z": 0.0}
    problem = Problem(model, Phase(1.0, end=end, integral=FORCE**2), inputs={"force": Free()})
    nlp = transcribe(problem, Collocation(3, 2, input_degree=1))
    x = nlp.bounds["x0"]
    free = nlp.bounds["lbx"] < nlp.bounds["ubx"]
    jacobian = np.array(nlp.functions["nlp_jac_g"](x, [])[1])[:, free]
    assert np.linalg.matrix_rank(jacobian) == nlp.m
    assert optimise(problem, EFFORT).cost == pytest.approx(12.0, rel=1e-9)


@pytest.mark.parametrize("goal", [(0, 0, 0, 1), (0, 0, 0, -1)])
def test_half_a_turn_in_a_plane(goal: tuple[float, ...]) -> None:
    """One angle stands for the quaternion; unit inertia and torque take 2 sqrt(pi)."""
    torque = rs.Input("torque", "N m")
    load = rs.Load("motor", rs.Marker("body"), torque=(0, 0, torque))
    body = rs.RigidBody("body", 1, (1, 1, 1))
    model = rs.compile_scene(rs.Scene("wheel", [body], [], [load]))
    assert model.n_x == 2
    names = ("body.q_w", "body.q_x", "body.q_y", "body.q_z")
    end = {**dict(zip(names, goal, strict=True)), "body.angular_velocity": (0, 0, 0)}
    phase = Phase(Free(3.0, 1, 9), end=end, end_cost=rs.TIME)
    problem = Problem(model, phase, inputs={"torque": Free(low=-1, high=1)})
    found = optimise(problem, Collocation(2, 3))
    assert found.cost == pytest.approx(2 * np.sqrt(np.pi), abs=1e-7)
    assert np.abs(found.trajectory["body.quaternion"][-1]) == pytest.approx([0, 0, 0, 1], abs=1e-7)


def test_compiled_stages() -> None:
    if not shutil.which("cc"):
        pytest.skip("no C compiler")
    for method in (Collocation(10, 3), Shooting(10, 2)):
        plain = optimise(SLEW.problem(), method)
        built = optimise(SLEW.problem(), method, compiled=True)
        assert built.cost == pytest.approx(plain.cost, rel=1e-9)
