"""Optimal control: bad input, reasons of infeasibility, guesses, warm starts, progress, silence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenes.ocp import FORCE, SLEW, TURN, cart, oscillator

import rbsd_sym as rs
from rbsd_sym.ocp import (
    Bound,
    Collocation,
    Fatrop,
    Free,
    Ipopt,
    OptimisationError,
    Outcome,
    Phase,
    Problem,
    Shooting,
    optimise,
)

CART = rs.compile_scene(cart())
END = {"cart.p_x": 1.0, "cart.v_x": 0.0}
COARSE = Collocation(5, 3)


def solve(phase: Phase | None = None, force: Any = None, model: Any = CART, **given: Any) -> Any:
    """The cart, with something wrong about it."""
    guess = given.pop("guess", None)
    inputs = {"force": force or Free()}
    problem = Problem(model, phase or Phase(1.0, end=END), inputs=inputs, **given)
    return optimise(problem, COARSE, guess=guess)


def ball() -> rs.Model:
    body = rs.RigidBody("ball", 1, (1, 1, 1), position=(0, 0, 1))
    floor = rs.RigidBodySpringDamper(
        "floor", rs.Marker(rs.GROUND), rs.Marker("ball"), 0, effects=[rs.Contact(2, stiffness=1e4)]
    )
    return rs.compile_scene(rs.Scene("ball", [body], [floor], gravity=(0, 0, -9.81)))


BAD: dict[str, tuple[Callable[[], Any], str]] = {
    "unknown state": (lambda: solve(Phase(1.0, end={"cart.p_u": 1})),
                      "no 'cart.p_u'; there are: cart.p_x"),
    "unknown output": (lambda: solve(Phase(1.0, integral="cart.speed")), "no 'cart.speed'"),
    "unknown in a cost": (lambda: solve(Phase(1.0, integral=lambda v: v["x"])), "no 'x'; there"),
    "unknown input": (lambda: Problem(CART, Phase(), inputs={"pull": Free()}), "no input 'pull'"),
    "missing input": (lambda: Problem(CART, Phase()), "input 'force' is missing"),
    "unknown parameter": (lambda: solve(params={"k": 1.0}), "no parameter 'k'"),
    "unknown period": (lambda: solve(periodic=["cart.x"]), "periodic: no state 'cart.x'"),
    "foreign symbol": (lambda: solve(Phase(1.0, integral=rs.Param("k", 1.0) * FORCE)),
                       "Param 'k' is not of this model"),
    "vector cost": (lambda: solve(Phase(1.0, integral=lambda v: v["cart.position"])),
                    r"of shape \(3,\); it is one number"),
    "shape": (lambda: solve(Phase(1.0, end={"cart.position": 1.0})), r"shape \(\); the quantity"),
    "text": (lambda: solve(Phase(1.0, end={"cart.p_x": "far"})), "give a number"),
    "bounds": (lambda: solve(Phase(1.0, path={"cart.p_x": (2, 1)})), "bounds 2 and 1 m"),
    "input bounds": (lambda: Free(low=1, high=-1), "contradict each other"),
    "input and path": (lambda: solve(Phase(1.0, path={"force": (2, 3)}), Free(low=0, high=1)),
                       "contradict each other"),
    "end and path": (lambda: solve(Phase(1.0, end=END, path={"cart.p_x": (None, 0.5)})),
                     "end 'cart.p_x': 1 outside the path bounds -inf ... 0.5"),
    "start and path": (lambda: solve(Phase(1.0, end=END, path={"cart.p_x": (0.5, None)})),
                       "begins at 'cart.p_x' = 0 m, outside the path bounds"),
    "still": (lambda: solve(Phase(1.0, end={"cart.p_y": 1.0})), "'cart.p_y': never moves from 0 m"),
    "still output": (lambda: solve(Phase(1.0, end={"cart.position": (1, 1, 0)})),
                     "'cart.position_y': always 0 m, wanted 1"),
    "rotation": (lambda: solve(Phase(1.0, end={"cart.quaternion": (1, 1, 0, 0)})), "norm 1.41"),
    "guess outside": (lambda: Free(3.0, 0, 1), "guess 3.0 outside"),
    "guess of nothing": (lambda: solve(guess={"cart.x": 1}), "no state, algebraic unknown"),
    "guess not finite": (lambda: solve(guess={"force": float("nan")}), "nan N; give a finite"),
    "guess sizes": (lambda: solve(guess={"force": ([0, 1], [1, 2, 3])}), r"\(2,\) and \(3,\)"),
    "given input bounded": (lambda: solve(Phase(1.0, path={"force": (0, 1)}), 0.5), "is given"),
    "input that branches": (lambda: solve(force=lambda t: 1 if t < 1 else 2), "cannot be traced"),
    "nothing free": (lambda: solve(force=0.5), "nothing is to be found"),
    "horizon": (lambda: Phase(-1.0), "horizon -1.0 s; it is positive"),
    "free horizon": (lambda: Phase(Free(1.0, low=-1)), "lower bound -1 s"),
    "first link": (lambda: solve(Phase(1.0, link={"cart.v_x": 0.0})), "first phase has a link"),
    "link": (lambda: solve([Phase(), Phase(link={"cart.position": 0.0})]), "is not a state"),
    "start by input": (lambda: solve(Phase(1.0, start={"force": 1.0})), "which may jump"),
    "events": (lambda: Problem(ball(), Phase()), "optimal control needs smooth rates"),
    "intervals": (lambda: optimise(Problem(CART, Phase(), inputs={"force": Free()}),
                                   Collocation((3, 4))), "2 entries for 1 phases"),
    "fractions": (lambda: optimise(Problem(CART, Phase(), inputs={"force": Free()}),
                                   Collocation([0, 0.6, 0.5, 1])), "increase from 0 to 1"),
    "degree": (lambda: Collocation(3, 10), "degree 10"),
    "scheme": (lambda: Collocation(3, 2, "lobatto"), "scheme 'lobatto'"),
    "input degree": (lambda: Collocation(3, 2, input_degree=2), "input_degree 2; it is 0 ... 1"),
    "order": (lambda: Shooting(order=5), "order 5; it is 4 or 8"),
    "refine": (lambda: Collocation(refine=2.0), "refine 2.0"),
    "option": (lambda: optimise(Problem(CART, Phase(1.0, end=END, integral=FORCE**2),
                                        inputs={"force": Free()}), COARSE,
                                solver=Ipopt(options={"speed": 1})), "refuses its options"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_told_before_the_solver_starts(name: str) -> None:
    call, message = BAD[name]
    with pytest.raises((ValueError, TypeError), match=message):
        call()


def test_objects_are_given_and_not_their_types() -> None:
    problem = Problem(CART, Phase(1.0, end=END), inputs={"force": Free()})
    with pytest.raises(TypeError, match=r"Collocation; give an object, such as Collocation\(\)"):
        optimise(problem, Collocation)  # type: ignore[arg-type]


def test_an_unreachable_end_is_explained() -> None:
    """In 1 s with 1 N the cart moves by 0.25 m, rest to rest."""
    problem = Problem(CART, Phase(1.0, end=END, integral=FORCE**2),
                      inputs={"force": Free(low=-1, high=1)})  # fmt: skip
    with pytest.raises(OptimisationError, match="no motion found that meets all") as error:
        optimise(problem, Collocation(10, 3))
    solution = error.value.solution
    assert solution.outcome is Outcome.infeasible
    assert not solution.trajectory.outcome.ok
    assert "end 'cart.p_x' at t = 1 s is 0." in solution.report
    assert "wanted 1 m (missed by 0." in solution.report
    assert optimise(problem, Collocation(10, 3), throw=False).outcome is Outcome.infeasible


def test_a_path_that_cannot_be_kept_is_explained() -> None:
    gap = Bound(lambda v: v["cart.p_x"] - 0.5 * v["t"], 0.2, 0.3, "m")
    phase = Phase(1.0, path={"ahead": gap})
    found = optimise(Problem(CART, phase, inputs={"force": Free()}), Collocation(6, 3), throw=False)
    assert found.outcome is Outcome.infeasible
    assert "path 'ahead' at t = 0.0" in found.report
    assert "wanted 0.2 m (missed by 0.2" in found.report


def test_warm_start() -> None:
    cold = optimise(SLEW.problem(), Collocation(15, 3), solver=Ipopt())
    warm = optimise(SLEW.problem(), Collocation(15, 3), solver=Ipopt(), guess=cold)
    assert warm.cost == pytest.approx(cold.cost, abs=1e-7)
    assert warm.stats["iterations"] < cold.stats["iterations"] / 2
    other = optimise(SLEW.problem(), Collocation(24, 4), guess=cold)
    assert other.cost < cold.cost
    with pytest.raises(ValueError, match="has other states"):
        solve(guess=cold)


def test_guess_from_a_simulation_and_by_values() -> None:
    problem = SLEW.problem()
    run = rs.simulate(problem.model, 4.0, inputs={"push": lambda t: 0.5 * np.cos(t)})
    costs = [
        optimise(problem, Collocation(15, 3), guess=guess).cost
        for guess in (run, {"push": 0.5, "hub.p_x": ([0, 4], [0, 1])}, {"push": np.cos})
    ]
    assert costs == pytest.approx([costs[0]] * 3, rel=1e-8)
    with pytest.raises(ValueError, match=r"trajectory 'flexible_slew' has no 'cart\.p_x'"):
        solve(guess=run)


def test_progress_is_told_and_may_stop() -> None:
    seen: list[Any] = []
    found = optimise(SLEW.problem(), COARSE, progress=seen.append)
    assert [it.number for it in seen] == list(range(len(seen)))
    assert seen[-1].cost == pytest.approx(found.cost, abs=1e-6)
    assert seen[-1].violation < 1e-6 < seen[0].violation
    halted = optimise(SLEW.problem(), COARSE, progress=lambda it: it.number == 2, throw=False)
    assert halted.outcome is Outcome.stopped
    with pytest.raises(KeyError, match="mine"):
        optimise(SLEW.problem(), COARSE, progress=lambda it: {}["mine"])


def test_fatrop_tells_of_no_progress() -> None:
    with pytest.raises(ValueError, match=r"use Ipopt\(\) with a progress function"):
        optimise(SLEW.problem(), COARSE, solver=Fatrop(), progress=print)


@pytest.mark.parametrize("solver", [Ipopt(), Fatrop(), None])
def test_silence(solver: Any, capfd: pytest.CaptureFixture[str]) -> None:
    optimise(SLEW.problem(), COARSE, solver=solver)
    captured = capfd.readouterr()
    assert captured.out == captured.err == ""


def test_inputs_that_are_given() -> None:
    """A constant 0.5 N, and one that follows the time, do as in `simulate`."""
    model = rs.compile_scene(oscillator())
    phase = Phase(Free(0.5, 0.1, 1.0), end={"cart.v_x": 0.0}, end_cost=rs.TIME)
    found = optimise(Problem(model, phase, inputs={"force": 0.5}), Collocation(8, 5), throw=False)
    # x'' = -4 x + 0.5 turns after half a period, pi / 2, which is beyond the bound.
    assert found.outcome is Outcome.infeasible
    phase = Phase(Free(1.5, 0.1, 2.0), end={"cart.v_x": 0.0}, end_cost=rs.TIME)
    found = optimise(Problem(model, phase, inputs={"force": 0.5}), Collocation(8, 5))
    assert found.t_end == pytest.approx(np.pi / 2, abs=1e-8)
    wave = Problem(model, phase, inputs={"force": lambda t: np.sin(t)})
    driven = optimise(wave, Collocation(8, 5))
    again = rs.simulate(model, [0.0, driven.t_end], rs.Idas(1e-10, 1e-12), inputs={"force": np.sin})
    assert again["cart.v_x"][-1] == pytest.approx(0.0, abs=1e-7)


def test_a_plan_that_does_not_fly_is_told() -> None:
    found = optimise(SLEW.least_effort(), Collocation(5, 1, "radau"))
    assert found.flown is not None
    assert found.flown.difference > 0.01
    assert any("flown by IDAS the plan strays" in note for note in found.notes)
    assert optimise(SLEW.least_effort(), Collocation(8, 4, input_degree=2)).notes == ()


def test_a_solution_prints_and_its_plan_is_saved(tmp_path: Any) -> None:
    found = optimise(SLEW.problem(), COARSE)
    assert "flown by IDAS it differs by" in str(found)
    path = found.trajectory.save(tmp_path / "plan")
    assert rs.Trajectory.load(path)["tip.p_x"][-1] == pytest.approx(2.0, abs=1e-7)
    assert np.isnan(optimise(SLEW.problem(), COARSE, fly=False).mesh_error)


@pytest.mark.parametrize("formulation", [rs.Quaternion(), rs.TaitBryan()])
def test_orientations(formulation: Any) -> None:
    """q and -q are one goal; four states of a quaternion are three equations."""
    model = rs.compile_scene(TURN.scene(), formulation)
    c, s = np.cos(0.3), np.sin(0.3)
    torques = {f"tau_{axis}": Free() for axis in "xyz"}
    effort = lambda v: sum(v[name] ** 2 for name in torques)  # noqa: E731
    found = []
    R = np.array([[c * c - s * s, 0, 2 * c * s], [0, 1, 0], [-2 * c * s, 0, c * c - s * s]])
    goals = [{"body.quaternion": (c, 0, s, 0)}, {"body.quaternion": (-c, 0, -s, 0)},
             {"body.rotation_matrix": R}]  # fmt: skip
    if isinstance(formulation, rs.Quaternion):
        goals.append({"body.q_w": c, "body.q_x": 0.0, "body.q_y": s, "body.q_z": 0.0})
    for goal in goals:
        phase = Phase(2.0, start={"body.quaternion": (c, s, 0, 0)},
                      end={**goal, "body.angular_velocity": (0, 0, 0)},
                      integral=effort)  # fmt: skip
        plan = optimise(Problem(model, phase, inputs=torques), Collocation(6, 3, input_degree=2))
        found.append(plan.cost)
        q = plan.trajectory["body.quaternion"]
        assert q[0] == pytest.approx([c, s, 0, 0], abs=1e-12)
        assert abs(q[-1] @ [c, 0, s, 0]) == pytest.approx(1.0, abs=1e-12)
    assert found == pytest.approx([found[0]] * len(found), rel=1e-8)
    if isinstance(formulation, rs.Quaternion):  # Gauss points keep quadratic invariants
        states = np.array([plan.trajectory[f"body.q_{axis}"] for axis in "wxyz"])[:, ::4]
        assert np.abs(np.linalg.norm(states, axis=0) - 1).max() < 1e-12
