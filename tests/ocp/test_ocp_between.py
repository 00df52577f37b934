"""Conditions along the path between the points at which a method keeps them."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scenes.ocp import FORCE, cart, hinged

import rbsd_sym as rs
from rbsd_sym.ocp import Bound, Collocation, Free, Phase, Problem, Shooting, Solution, optimise
from rbsd_sym.ocp.nlp import RowKind

HIGH = 1 / 9


def bounce(as_row: bool) -> Problem:
    """Back to the start at the opposite speed in 1 s, least effort, not beyond a wall.

    The optimum is 4 / (9 wall), with the wall touched from 3 wall to 1 - 3 wall
    [Bryson, Ho 1975, sec. 3.11, example 2].
    """
    model = rs.compile_scene(cart(velocity=(1, 0, 0)))
    wall = {"wall": Bound("cart.p_x", high=HIGH, unit="m")} if as_row else (
        {"cart.p_x": (None, HIGH)})  # fmt: skip
    phase = Phase(1.0, end={"cart.p_x": 0, "cart.v_x": -1}, path=wall, integral=FORCE**2 / 2)
    return Problem(model, phase, inputs={"force": Free()})


def by_hand(found: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Position over time from x'' = u, by trapezoidal sums on each interval."""
    times, places, x, v = [0.0], [0.0], 0.0, 1.0
    for k, (a, b) in enumerate(itertools.pairwise(found.mesh)):
        tau = np.linspace(0, 1, 1001)
        u, h = found.inputs["force"].at(k, tau), (b - a) / 1000
        for n in range(1000):
            x += h * (v + h * (2 * u[n] + u[n + 1]) / 6)
            v += h * (u[n] + u[n + 1]) / 2
            times.append(a + (b - a) * tau[n + 1])
            places.append(x)
    return np.array(times), np.array(places)


@pytest.mark.parametrize("as_row", [False, True])
def test_a_wall_is_passed_between_points_and_the_report_says_by_how_much(as_row: bool) -> None:
    found = optimise(bounce(as_row), Collocation(4, 3, input_degree=1))
    (miss,) = found.between
    t, x = by_hand(found)
    beyond = x.max() - HIGH
    assert beyond > 2e-3 * HIGH
    assert miss.what == ("path 'wall'" if as_row else "path 'cart.p_x'")
    assert miss.value - HIGH == pytest.approx(beyond, rel=0.1)
    assert miss.t == pytest.approx(t[x.argmax()], abs=0.03) or (
        1 - miss.t == pytest.approx(t[x.argmax()], abs=0.03))  # it is symmetric
    assert miss.relative == pytest.approx((miss.value - HIGH) / HIGH)
    assert f"{miss.value:.6g} m, wanted 0.111111 m" in found.notes[0]
    assert "path_points" in found.notes[0]


@pytest.mark.parametrize("as_row", [False, True])
def test_more_points_keep_to_the_wall(as_row: bool) -> None:
    given = [(0, 1e-2), (1, 8e-3), (7, 5e-4), (31, 3e-5)]
    found = [optimise(bounce(as_row), Collocation(4, 3, input_degree=1, path_points=n))
             for n, _ in given]  # fmt: skip
    beyond = [one.between[0].relative if one.between else 0.0 for one in found]
    assert all(a < most for a, (_, most) in zip(beyond, given, strict=True)), beyond
    assert beyond[2] < beyond[0] / 10
    assert not found[3].notes
    # Cubic polynomials on a mesh without the ends of the arc are a restriction: not below the best.
    assert found[3].cost > 4 * (1 - 1e-4)


def test_the_optimum_on_a_mesh_with_the_ends_of_the_arc() -> None:
    fitted = optimise(bounce(False), Collocation([0, 1 / 3, 2 / 3, 1], 3, input_degree=1))
    assert fitted.cost == pytest.approx(4, rel=1e-7)
    assert not fitted.notes


def test_inputs_of_degree_two_are_kept_within_bounds_between_their_nodes() -> None:
    model = rs.compile_scene(cart())
    phase = Phase(Free(2.0, 0.5, 5), end={"cart.p_x": 1, "cart.v_x": 0}, end_cost=rs.TIME)
    problem = Problem(model, phase, inputs={"force": Free(low=-1, high=0.5)})
    loose = optimise(problem, Collocation(3, 4, input_degree=2))
    (miss,) = loose.between
    assert miss.what == "path 'force'"
    inside = np.linspace(0, 1, 1001)
    every = np.concatenate([loose.inputs["force"].at(k, inside) for k in range(3)])
    most = max(every.max() - 0.5, -1 - every.min()) / 1.5
    assert miss.relative == pytest.approx(most, rel=0.05)
    assert most > 1e-3
    tight = optimise(problem, Collocation(3, 4, input_degree=2, path_points=15))
    every = np.concatenate([tight.inputs["force"].at(k, inside) for k in range(3)])
    assert max(every.max() - 0.5, -1 - every.min()) / 1.5 < most / 10
    assert tight.t_end > loose.t_end


@pytest.mark.parametrize("layout", ["flat", "kernels"])
def test_both_layouts_and_phases(layout: str) -> None:
    """A limited rate in two phases, a limited torque in the second; the phase is named."""
    model = rs.compile_scene(hinged(), layout=layout)
    rate: dict[str, Any] = {"body.w_x": (-0.3, 0.3)}
    tight = {**rate, "joint.torque_local": (-0.05, 0.05)}
    phases = [Phase(0.5, path=rate, integral=FORCE**2),
              Phase(0.5, end={"body.w_x": 0.05}, path=tight, integral=FORCE**2)]  # fmt: skip
    problem = Problem(model, phases, inputs={"force": Free()})
    loose, kept = (optimise(problem, Collocation(3, 2, path_points=n)) for n in (0, 7))
    assert loose.between[0].what.startswith("phase 1, path 'joint.torque_local")
    assert sum(m.relative for m in kept.between) < loose.between[0].relative / 10
    counts = [sum(row.kind in (RowKind.path, RowKind.limit) for row in part.rows)
              for part in kept.raw.chain.nlp.segments if part.count > 1]  # fmt: skip
    assert counts == [7, 2 * 3 + 7 * 4]  # the rate at 7 points; torques at 2 more


def test_shooting_keeps_states_within_bounds_at_the_ends_of_steps() -> None:
    found = optimise(bounce(False), Shooting(4, 8, input_degree=1))
    t, x = by_hand(found)
    ends = np.abs(t * 32 - np.round(t * 32)) < 1e-9
    assert ends.sum() == 33
    assert x[ends].max() < HIGH * (1 + 1e-6)
    assert x.max() < HIGH * (1 + 2e-3)
    kept = optimise(bounce(False), Collocation(4, 3, input_degree=1, path_points=7))
    assert found.cost == pytest.approx(kept.cost, rel=1e-3)


def test_earlier_solutions_of_another_degree_are_a_start() -> None:
    first = optimise(bounce(False), Collocation(4, 3, input_degree=1))
    for method in (Collocation(4, 4, input_degree=1),
                   Collocation(4, 3, input_degree=1, path_points=2)):  # fmt: skip
        again = optimise(bounce(False), method, guess=first)
        assert again.outcome.ok


def test_path_points_are_whole_numbers() -> None:
    for wrong in (-1, 1.5):
        with pytest.raises(ValueError, match="path_points"):
            Collocation(4, 3, path_points=wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(("as_row", "points"), [(False, 0), (True, 0), (False, 3)])
def test_a_wall_that_cannot_be_kept_to_is_named(as_row: bool, points: int) -> None:
    """At 1 m/s and 1 N the cart of 1 kg stops after 0.5 m and 1 s."""
    model = rs.compile_scene(cart(velocity=(1, 0, 0)))
    wall = {"wall": Bound("cart.p_x", high=HIGH, unit="m")} if as_row else (
        {"cart.p_x": (None, HIGH)})  # fmt: skip
    phase = Phase(4.0, end={"cart.p_x": 0}, path=wall, integral=FORCE**2 / 2)
    problem = Problem(model, phase, inputs={"force": Free(low=-1, high=1)})
    method = Collocation(6, 3, input_degree=1, path_points=points)
    found = optimise(problem, method, throw=False)
    name = "wall" if as_row else "cart.p_x"
    assert f"path '{name}' at t = 1 s is 0.5 m, wanted 0.111111 m (missed by" in found.report
