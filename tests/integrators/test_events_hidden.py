"""Crossings between two looks of a method, many in one output interval, and awkward times."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from oracles import discontinuities as exact
from scenes.events import (
    CASADI,
    EXACT,
    G,
    ball,
    bouncing,
    by_method,
    names_of,
    run,
    swing,
    times_of,
    within_seconds,  # noqa: F401  (a fixture of every test here)
)

import rbsd_sym as rs

# What the search of events does not do yet.
LOOKS = "CasADi's methods look at the ends of steps only: a dip between them is not seen"
ROUNDED = "a function that rounding lifts above zero again fires again and again"


# Hidden crossings, many of them, and awkward times.


@cache
def dipping() -> rs.Model:
    """A parabola that goes below zero by a Param at t = 0.537."""
    depth = rs.Param("depth", 0.0)
    return ball(lambda s: [rs.Event((s.t - 0.537) ** 2 - depth, 0, name="dip")])


@by_method()
@pytest.mark.parametrize("depth", [1e-2])
def test_a_dip(depth: float, method: str) -> None:
    check_dip(depth, method)


@by_method(*CASADI, why=LOOKS)
@pytest.mark.parametrize("depth", [1e-6, 1e-10])
def test_a_brief_dip(depth: float, method: str) -> None:
    check_dip(depth, method)


def check_dip(depth: float, method: str) -> None:
    """Between two looks; sqrt(depth) before and after the middle."""
    found = run(dipping(), [0, 0.5, 1], method, params={"depth": depth})
    assert names_of(found) == ["dip_falls", "dip_rises"]
    half = np.sqrt(depth)
    np.testing.assert_allclose(times_of(found), [0.537 - half, 0.537 + half], atol=1e-9 * half)


@pytest.mark.parametrize("integrator", [rs.Rosenbrock(max_step=0.1), rs.ExplicitRK(max_step=0.1)])
def test_a_dip_longer_than_the_steps(integrator: Any) -> None:
    found = rs.simulate(dipping(), [0, 0.5, 1], integrator, params={"depth": 1e-2})
    np.testing.assert_allclose(times_of(found), [0.437, 0.637], atol=EXACT)


@by_method()
@pytest.mark.parametrize("gap", [0.0, 1e-12, 1e-6])
def test_what_does_not_go_below_zero_does_not_fire(gap: float, method: str) -> None:
    assert run(dipping(), [0, 0.5, 1], method, params={"depth": -gap}).events == ()


@by_method()
def test_the_top_of_an_oscillation(method: str) -> None:
    """No polynomial; the mark is 1e-4 below the top, whose height is known to some 1e-9."""
    model = swing(lambda s: [rs.Event(1 - 1e-4 - s.u[0], 0, name="top")])
    found = run(model, [0, 1, 2, 3], method)
    assert names_of(found) == ["top_falls", "top_rises"]
    half = np.arccos(1 - 1e-4)
    np.testing.assert_allclose(times_of(found) - np.pi / 2, [-half, half], atol=1e-7)


@by_method(among=CASADI)
def test_casadi_remembers_the_last_64(method: str) -> None:
    found = run(ticking(), [0, 1.005, 1.05], method)
    assert found.stats["events"] == 104
    told = times_of(found)
    assert len(told) >= 64
    np.testing.assert_allclose(told, np.arange(105 - len(told), 105) / 100, atol=EXACT)


@by_method(among=("idas",))
def test_many_events_in_one_output_interval(method: str) -> None:
    found = run(ticking(), [0, 1.005, 1.05], method)
    np.testing.assert_allclose(times_of(found), np.arange(1, 105) / 100, atol=EXACT)
    np.testing.assert_allclose(found["c.data_0"], [0.01, 1.01, 1.05], atol=EXACT)


@cache
def ticking() -> rs.Model:
    """A clock that strikes every 0.01 s, but for the end of the run."""
    return ball(lambda s: [rs.Event(s.data[0] - s.t, data=[s.data[0] + 0.01])], data=[0.01])


@by_method(among=(*CASADI, "dop853"))
def test_many_bounces_in_one_output_interval(method: str) -> None:
    """Without loss, 70 times; CasADi's methods tell of the last 64."""
    impacts, _ = exact.ball_impacts(70, 0.01, G, 1.0)
    given = {"start": {"b.p_z": 0.01}, "params": {"e": 1.0}}
    found = run(bouncing(), [0, impacts[-1] + 1e-3, impacts[-1] + 2e-3], method, **given)
    told = times_of(found)
    assert len(told) == 70 or (method in CASADI and len(told) >= 64)
    np.testing.assert_allclose(told, impacts[-len(told) :], atol=1e-9)
    assert found["b.v_z"][-1] == pytest.approx(np.sqrt(2 * G * 0.01) - 2e-3 * G, abs=1e-9)


@by_method()
@pytest.mark.parametrize("grid", [[0, 0.5, 1, 1.5], [0, 1, 1 + 1e-9, 2], [0, 0.3, 1, 1.7, 5]],
                         ids=["uniform", "close", "uneven"])  # fmt: skip
def test_an_event_at_an_output_time(grid: list[float], method: str) -> None:
    """Once; which side of it the output shows is decided by rounding."""
    model = ball(lambda s: [rs.Event(1 - s.t, data=[s.data[0] + 1])], data=[0.0])
    found = run(model, grid, method)
    np.testing.assert_allclose(times_of(found), [1], atol=EXACT)
    at = grid.index(1)
    np.testing.assert_array_equal(found["c.data_0"][:at], 0)
    np.testing.assert_array_equal(found["c.data_0"][at + 1 :], 1)
    assert found["c.data_0"][at] in (0, 1)


@by_method()
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_short_and_long_runs(scale: float, method: str) -> None:
    """The same fall from 1 m in microseconds and in days; rtol 1e-8 at up to 1e6 m/s."""
    given = {"start": {"b.p_z": 1.0}, "params": {"e": 1.0, "g": 2 / scale**2}}
    found = run(bouncing(), np.linspace(0, 6, 7) * scale, method, **given)
    np.testing.assert_allclose(times_of(found) / scale, [1, 3, 5], atol=1e-8)


@by_method(*CASADI, why=ROUNDED)
def test_a_short_way_of_a_high_ball(method: str) -> None:
    """Marks up to 0.4 mm below 1 m: rounding of the height is 1e-13 of the run's way."""
    depths = np.linspace(1e-4, 4e-4, 8)
    model = ball(lambda s: [rs.Event(s.u[2] - 1 + d) for d in depths])
    found = run(model, [0, 0.004, 0.01], method)
    np.testing.assert_allclose(times_of(found), np.sqrt(2 * depths / G), atol=EXACT)


@by_method(among=("idas", *CASADI))
def test_a_fast_oscillator_in_a_slow_scene(method: str) -> None:
    """10^4 rad/s for 31 half periods; IDAS is watched eight times an output interval."""
    model = swing(lambda s: [rs.Event(s.u[0], 0)], k=1e8)
    found = run(model, np.linspace(0, 0.01, 11), method)
    # rtol 1e-8 over 100 rad is some 1e-6 rad
    np.testing.assert_allclose(times_of(found), np.arange(1, 32) * np.pi * 1e-4, atol=1e-9)
