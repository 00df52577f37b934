"""Optimal control against published values, closed forms, and itself: order, mesh, flight."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes.ocp import EIGENAXIS, SLEW, SLEW_EFFORT, SLEW_TIME, SWITCHES, TURN, TURN_TIME, flies

import rbsd_sym as rs
from rbsd_sym.ocp import Collocation, Ipopt, Shooting, optimise


@pytest.mark.parametrize("method", [Collocation(10, 5, "legendre", 4),
                                    Collocation(10, 5, "radau", 4),
                                    Shooting(10, 2, order=8, input_degree=3)])  # fmt: skip
def test_least_effort_of_the_slew(method: Any) -> None:
    found = optimise(SLEW.least_effort(), method)
    assert found.cost == pytest.approx(SLEW_EFFORT, abs=1e-8)
    assert found.mesh_error < 1e-5
    assert flies(found)


def test_least_time_of_the_slew_with_a_phase_for_each_arc() -> None:
    found = optimise(SLEW.arcs(), Collocation(5, 5))
    assert found.cost == pytest.approx(SLEW_TIME, abs=1e-9)
    assert np.cumsum(found.durations)[:3] == pytest.approx(SWITCHES, abs=1e-9)
    assert found.inputs["push"].switches(0.0) == pytest.approx(SWITCHES, abs=1e-9)
    assert flies(found)


def test_least_time_of_the_slew_on_a_refined_mesh() -> None:
    coarse = optimise(SLEW.problem(), Collocation(20, 4))
    assert 1e-3 < coarse.cost - SLEW_TIME < 2e-2  # jumps wait for the next interval
    found = optimise(SLEW.problem(), SLEW.METHOD)
    assert found.cost == pytest.approx(SLEW_TIME, abs=1e-6)
    assert found.inputs["push"].switches(0.0) == pytest.approx(SWITCHES, abs=1e-4)
    assert found.mesh_error < SLEW.METHOD.refine
    assert flies(found)
    # At rest for good: no vibration is left.
    last = found.trajectory.state_at_end
    after = rs.simulate(found.model, 10.0, rs.Idas(1e-10, 1e-12), start=last)
    assert np.abs(after["tip.p_x"] - 2).max() < 1e-6


def test_a_stiff_rod_takes_the_time_of_a_rigid_one() -> None:
    """2 sqrt(m d / F) for the mass of both is a bound: only the force moves the centre of mass."""
    rigid = 2 * np.sqrt(2.0)
    found = optimise(SLEW.problem(stiffness=100.0), Collocation(40, 4))
    assert 0 < found.cost - rigid < 0.02  # 0.0048, with the force constant on 40 intervals
    assert found.cost < SLEW_TIME


@pytest.mark.slow
def test_a_very_stiff_rod() -> None:
    found = optimise(SLEW.problem(stiffness=1000.0), Collocation(40, 4, refine=1e-6))
    assert 0 < found.cost - 2 * np.sqrt(2.0) < 1e-3


def test_a_limit_of_the_force_in_the_rod_costs_time() -> None:
    """It is 0.55 N in the fastest motion."""
    free = optimise(SLEW.problem(), Collocation(30, 4))
    assert np.abs(free.trajectory["rod.force_local"]).max() > 0.5
    found = optimise(SLEW.problem(force_in_rod=0.4), Collocation(30, 4))
    assert found.cost > free.cost + 0.1
    assert np.abs(found.trajectory["rod.force_local"]).max() < 0.4 + 2e-3
    assert flies(found)


@pytest.mark.parametrize("problem", [SLEW.problem(), SLEW.arcs()], ids=["mesh", "arcs"])
def test_collocation_and_shooting_agree(problem: Any) -> None:
    one = optimise(problem, Collocation(12, 5))
    two = optimise(problem, Shooting(12, 2, order=8))
    assert one.cost == pytest.approx(two.cost, abs=1e-6)
    times = one.trajectory.t[::4]
    a, b = (found.inputs["push"] for found in (one, two))
    assert np.abs([a(t + 1e-3) - b(t + 1e-3) for t in times[:-1]]).max() < 1e-4


def test_shooting_refines_too() -> None:
    found = optimise(SLEW.problem(), Shooting(12, 1, order=8, refine=1e-6))
    assert found.cost == pytest.approx(SLEW_TIME, abs=5e-6)
    assert flies(found)


@pytest.mark.parametrize(
    ("scheme", "degree"), [("legendre", 2), ("legendre", 3), ("radau", 2), ("radau", 3)]
)
def test_order_of_collocation(scheme: str, degree: int) -> None:
    """The cost has the order 2 degree, states between the ends of intervals degree + 1."""
    costs, errors = [], []
    for n in (8, 16):
        found = optimise(SLEW.least_effort(), Collocation(n, degree, scheme, degree - 1))
        costs.append(found.cost - SLEW_EFFORT)
        errors.append(found.mesh_error)
    assert np.log2(abs(costs[0] / costs[1])) == pytest.approx(2 * degree, abs=0.3)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(degree + 1, abs=0.4)


def test_order_of_inputs_constant_on_intervals() -> None:
    costs = [optimise(SLEW.least_effort(), Collocation(n, 4), fly=False).cost for n in (16, 32)]
    assert (costs[0] - SLEW_EFFORT) / (costs[1] - SLEW_EFFORT) == pytest.approx(4.0, rel=0.05)


def test_half_a_turn_by_collocation() -> None:
    found = optimise(TURN.problem(), Collocation(30, 3, refine=1e-5), guess=TURN.GUESS)
    assert found.cost == pytest.approx(TURN_TIME, abs=1e-4)
    assert flies(found)


def test_half_a_turn_on_a_refined_mesh() -> None:
    found = optimise(TURN.problem(), TURN.METHOD, guess=TURN.GUESS)
    assert found.cost == pytest.approx(TURN_TIME, abs=1e-6)
    assert flies(found)
    q = found.flown.trajectory["body.quaternion"][-1]  # type: ignore[union-attr]
    assert np.abs(q[:3]).max() < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("solver", [None, Ipopt()])
def test_half_a_turn_in_tait_bryan_angles(solver: Any) -> None:
    found = optimise(TURN.problem(rs.TaitBryan()), TURN.METHOD, guess=TURN.GUESS, solver=solver)
    assert found.cost == pytest.approx(TURN_TIME, abs=1e-6)
    assert flies(found)


def test_half_a_turn_in_tait_bryan_angles_on_a_coarse_mesh() -> None:
    method = Collocation(30, 3, refine=1e-5)
    found = optimise(TURN.problem(rs.TaitBryan()), method, guess=TURN.GUESS)
    assert found.cost == pytest.approx(TURN_TIME, abs=1e-4)


def test_the_turn_about_the_fixed_axis_is_a_worse_optimum() -> None:
    """A guess without the other torques does not leave it: 2 sqrt(pi)."""
    found = optimise(TURN.problem(), Collocation(30, 3))
    assert found.cost == pytest.approx(EIGENAXIS, abs=1e-4)
