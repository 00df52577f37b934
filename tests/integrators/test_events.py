"""Events along a run: when they fire, what they change, and on what they depend.

Bodies fall, fly and vibrate, so that times are known in closed form.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracles import discontinuities as exact
from scenes.events import (
    CASADI,
    EXACT,
    METHODS,
    TIGHT,
    G,
    ball,
    body,
    bouncing,
    by_method,
    joint,
    names_of,
    run,
    swing,
    times_of,
    within_seconds,  # noqa: F401  (a fixture of every test here)
)

import rbsd_sym as rs

# Single events.


def all_ways(zero: Any, at_once: bool) -> list[rs.Event]:
    """Events of one function, with each direction, by name."""
    ways = {"falls": -1, "rises": 1} if at_once else {"falls": -1, "rises": 1, "b": 0}
    return [rs.Event(zero, way, at_once=at_once, name=name) for name, way in ways.items()]


def check_times(found: rs.Trajectory, expected: dict[str, list[float]], error: float) -> None:
    """Events by name, and that the run went on."""
    told: dict[str, list[float]] = {}
    for t, name in zip(times_of(found), names_of(found), strict=True):
        told.setdefault(name, []).append(t)
    assert set(told) == set(expected)
    for name, times in expected.items():
        np.testing.assert_allclose(told[name], times, rtol=0, atol=error, err_msg=name)
    assert found.outcome is rs.Outcome.reached_end


MARKS = [(6 + sign * np.sqrt(36 - 2 * G)) / G for sign in (-1, 1)]


@by_method()
def test_a_ball_thrown_past_a_mark(method: str) -> None:
    found = run(ball(lambda s: all_ways(s.u[2] - 2, False), speed=6.0), [0, 0.7, 1.3], method)
    rise, fall = MARKS
    expected = {"falls": [fall], "rises": [rise], "b_rises": [rise], "b_falls": [fall]}
    check_times(found, expected, EXACT)


@by_method()
def test_a_ball_thrown_past_a_mark_from_beyond(method: str) -> None:
    """At once is at the start, below the mark."""
    found = run(ball(lambda s: all_ways(s.u[2] - 2, True), speed=6.0), [0, 0.7, 1.3], method)
    check_times(found, {"falls": [0, MARKS[1]], "rises": [MARKS[0]]}, EXACT)


@by_method()
def test_an_oscillator(method: str) -> None:
    model = swing(lambda s: [rs.Event(s.u[0] - 0.5, 0, name="half"), rs.Event(s.v[0], name="top")])
    found = run(model, np.linspace(0, 3, 4), method, TIGHT)
    expected = np.pi * np.array([1 / 6, 1 / 2, 5 / 6])
    np.testing.assert_allclose(times_of(found), expected, rtol=0, atol=EXACT)
    assert names_of(found) == ["half_rises", "top", "half_falls"]


@cache
def passing(at_once: bool) -> rs.Model:
    """Of u = v sin t."""
    return swing(lambda s: all_ways(s.u[0], at_once))


@by_method()
@pytest.mark.parametrize(("v", "expected"), [
    (1, {"falls": [1], "rises": [2], "b_falls": [1], "b_rises": [2]}),
    (-1, {"falls": [2], "rises": [1], "b_falls": [2], "b_rises": [1]}), (0, {}),
])  # fmt: skip
def test_a_start_on_zero(v: float, expected: dict[str, list[float]], method: str) -> None:
    """It counts on the side to which it moves, and what rests never fires."""
    found = run(passing(False), np.linspace(0, 7, 8), method, start={"b.v_x": v})
    # rtol 1e-8 over one period
    check_times(found, {k: [np.pi * t for t in times] for k, times in expected.items()}, 1e-6)


@by_method()
@pytest.mark.parametrize("v", [1, -1])
def test_a_start_on_zero_that_moves_beyond(v: float, method: str) -> None:
    """At once is at the start for the direction in which it moves."""
    found = run(passing(True), np.linspace(0, 7, 8), method, start={"b.v_x": v})
    first, second = ("rises", "falls") if v > 0 else ("falls", "rises")
    check_times(found, {first: [0, 2 * np.pi], second: [np.pi]}, 1e-6)


@by_method(*CASADI, why="CasADi looks for + to -: what starts on zero never fires")
@pytest.mark.parametrize("power", [2, 3])
def test_a_start_on_zero_without_rate_counts_as_above(power: int, method: str) -> None:
    found = run(ball(lambda s: [rs.Event(-(s.t**power))]), np.linspace(0, 1, 5), method)
    np.testing.assert_allclose(times_of(found), [0], atol=1e-9)


@by_method(among=CASADI)
def test_casadi_tells_of_what_it_missed(method: str) -> None:
    """The run ends before the first output time at which an armed event is found below zero."""
    found = run(ball(lambda s: [rs.Event(-(s.t**2))]), np.linspace(0, 1, 5), method)
    assert found.outcome is rs.Outcome.solver_failed
    assert "event 'c.event_0' was missed before t = 0.25 s" in found.report
    assert "use Idas() or Dop853()" in found.report
    assert found.stats["t_failed"] == 0.25
    np.testing.assert_array_equal(found.t, [0])
    assert found.events == ()


@by_method()
def test_at_once_beyond_zero_at_the_start(method: str) -> None:
    """In the order of the list; without at_once it must come from the other side."""
    model = swing(
        lambda s: [
            rs.Event(s.u[0], name="crosses"),
            rs.Event(s.u[0], data=[s.data[0] + 1], at_once=True, name="adds"),
            rs.Event(s.u[0], data=[2 * s.data[0]], at_once=True, name="doubles"),
        ],
        x=-1.0, v=0.0, data=[1.0],
    )  # fmt: skip
    found = run(model, np.linspace(0, 6, 7), method)
    np.testing.assert_allclose(times_of(found) / np.pi, [0, 0, 1.5, 1.5, 1.5], atol=1e-6)
    assert names_of(found) == ["adds", "doubles", "crosses", "adds", "doubles"]
    np.testing.assert_array_equal(found["c.data_0"], [4, 4, 4, 4, 4, 10, 10])


@by_method()
def test_an_event_that_stops(method: str) -> None:
    model = ball(lambda s: [rs.Event(s.u[2], stop=True, name="ground")])
    found = run(model, np.linspace(0, 1, 11), method)
    assert found.outcome is rs.Outcome.event
    assert found.outcome.ok
    assert found.events == ((pytest.approx(np.sqrt(2 / G), abs=EXACT), "c.ground"),)
    np.testing.assert_allclose(found.t, np.linspace(0, 0.4, 5), atol=1e-15)
    np.testing.assert_allclose(found["b.p_z"], 1 - G * found.t**2 / 2, atol=EXACT)
    assert found.report == "stopped at an event 'c.ground' at t = 0.451523641 s"
    assert run(model, [0, 0.4], method).events == ()


@by_method()
def test_a_stop_at_the_start(method: str) -> None:
    model = ball(lambda s: [rs.Event(s.u[2] - 2, at_once=True, stop=True)])
    found = run(model, 1.0, method)
    assert (found.outcome, list(found.t), times_of(found)) == (rs.Outcome.event, [0.0], [0.0])


# What events change.


@by_method()
def test_bang_bang(method: str) -> None:
    """Pushed by 1 N up to x = 1/2, pulled back by 1 N, let go as it rests: x = 1 at t = 2."""
    model = rs.compile_scene(rs.Scene("crane", [body()], [joint(
        data=[1.0], force=lambda m, t, i, data, *rest: [-data[0], 0, 0, 0, 0, 0],
        function=lambda s: [rs.Event(s.u[0] - 0.5, 1, [-1]), rs.Event(s.v[0], -1, [0])],
    )]))  # fmt: skip
    found = run(model, [0, 0.5, 0.9, 1.1, 1.5, 2.3, 3], method)  # not uniform
    np.testing.assert_allclose(times_of(found), [1, 2], atol=EXACT)
    np.testing.assert_allclose(found["c.data_0"], [1, 1, 1, -1, -1, 0, 0], atol=1e-15)
    np.testing.assert_array_equal(found["c.force_local"][:, 0], -found["c.data_0"])
    t = found.t
    x = np.where(t < 1, t**2 / 2, np.where(t < 2, 1 - (2 - t) ** 2 / 2, 1))
    np.testing.assert_allclose(found["b.p_x"], x, atol=EXACT)


@by_method()
@pytest.mark.parametrize("formulation", [rs.Quaternion(), rs.TaitBryan()], ids=["quat", "xyz"])
def test_an_impulse_between_two_bodies_keeps_momenta(formulation: Any, method: str) -> None:
    """Linear to rounding; angular, with the law that balances moments, to the run's error."""
    bodies = [
        body("a", mass=2.0, velocity=(1, 0.5, 0), angular_velocity=(0.2, 0, 1)),
        body("b", position=(1, 0.2, 0.1), velocity=(-1, 0, 0.3), angular_velocity=(0.1, 0.4, 0)),
    ]
    kick = [1.0, 2.0, 3.0, 0.1, 0.2, 0.3]
    link = joint(
        function=lambda s: [rs.Event(0.3 - s.t, impulse=kick)], law=rs.Consistent(),
        marker0=rs.Marker("a", (0.1, 0.2, 0.3)), marker1=rs.Marker("b", (0, -0.1, 0.2)),
    )  # fmt: skip
    scene = rs.Scene("pair", bodies, [link], outputs=["momentum", "angular_momentum", "a.velocity"])
    found = run(rs.compile_scene(scene, formulation), [0, 0.2, 0.4, 0.6], method)
    assert np.ptp(found["momentum"], axis=0).max() < 1e-14
    assert np.ptp(found["angular_momentum"], axis=0).max() < 1e-8
    jump = found["a.velocity"][2] - found["a.velocity"][1]
    assert np.linalg.norm(jump) == pytest.approx(np.linalg.norm(kick[:3]) / 2, rel=1e-8)


@by_method()
@pytest.mark.parametrize("grid", [np.linspace(0, 2.4, 25), [0, 0.1, 0.4, 1.3, 2.3, 2.4]], ids=len)
def test_bounces(grid: Any, method: str) -> None:
    found = run(bouncing(), grid, method)
    np.testing.assert_allclose(times_of(found), exact.ball_impacts(4, 1, G, 0.8)[0], atol=EXACT)
    x, v = exact.state_at(exact.ball_phases(1.0, G, 0.8, count=4), found.t)
    np.testing.assert_allclose(found["b.p_z"], x, atol=EXACT)
    np.testing.assert_allclose(found["b.v_z"], v, atol=EXACT)


heights, restitutions, weights = st.floats(0.01, 100), st.floats(0.3, 1), st.floats(0.1, 100)


@by_method()
@settings(max_examples=3, deadline=None, derandomize=True,
          suppress_health_check=list(HealthCheck))  # fmt: skip
@given(height=heights, restitution=restitutions, gravity=weights)
def test_random_bounces(method: str, height: float, restitution: float, gravity: float) -> None:
    """Three bounces, well apart of each other and of the output times."""
    impacts, _ = exact.ball_impacts(4, height, gravity, restitution)
    assume(np.diff(impacts).min() > 1e-3)
    grid = np.linspace(0, (impacts[2] + impacts[3]) / 2, 40)
    found = run(bouncing(), grid, method, TIGHT, start={"b.p_z": height},
                params={"e": restitution, "g": gravity})  # fmt: skip
    # Of the run: tolerances are relative to the state, not to the time.
    np.testing.assert_allclose(times_of(found), impacts[:3], rtol=1e-9)
    x, _ = exact.state_at(exact.ball_phases(height, gravity, restitution, count=3), found.t)
    np.testing.assert_allclose(found["b.p_z"], x, atol=1e-8 * height)


# Inputs, algebraic unknowns, no states.


SIGNALS: dict[str, tuple[Any, float]] = {  # the input, and when x = 1/2 under it
    "number": (2.0, np.sqrt(0.5)), "function": (lambda t: 2.0 + 0 * t, np.sqrt(0.5)),
    "branch": (lambda t: 0.0 if t < 1 else 2.0, 1 + np.sqrt(0.5)),
    "samples": (([0, 3], [0, 3.0]), 3 ** (1 / 3)),
}  # fmt: skip


@by_method()
@pytest.mark.parametrize("signal", SIGNALS)
def test_a_force_from_outside(signal: str, method: str) -> None:
    value, expected = SIGNALS[signal]
    # Nothing tells a method of the branch; its step control finds it, and to rtol 1e-8 only.
    among, error = (METHODS, 1e-7) if signal == "branch" else (TIGHT, EXACT)
    found = run(pushed(), np.linspace(0, 2, 5), method, among, inputs={"push": value})
    np.testing.assert_allclose(times_of(found), [expected], atol=error)
    if signal == "number":
        later = run(pushed(), [0, 2], method, inputs={"push": 2.0}, params={"far": 1.0})
        np.testing.assert_allclose(times_of(later), [1], atol=EXACT)


@cache
def pushed() -> rs.Model:
    push, far = rs.Input("push", "N"), rs.Param("far", 0.5, "m")
    mark = joint(function=lambda s: [rs.Event(s.u[0] - far, 1)])
    load = rs.Load("load", rs.Marker("b"), force=(push, 0, 0))
    return rs.compile_scene(rs.Scene("pushed", [body()], [mark], [load]))


@pytest.mark.parametrize(("value", "expected"), [
    (lambda t: 2 * np.sin(t), np.pi / 6), (([0, 3], [0, 3.0]), 1),
], ids=["sine", "samples"])  # fmt: skip
@by_method()
def test_an_event_of_an_input(value: Any, expected: float, method: str) -> None:
    model = signalled()
    found = run(model, np.linspace(0, 2, 5), method, inputs={"signal": value})
    np.testing.assert_allclose(times_of(found), [expected], atol=EXACT)


@by_method(*CASADI, why="CasADi fires twice where a function jumps, the second time earlier")
def test_an_event_of_an_input_that_jumps(method: str) -> None:
    step = {"signal": lambda t: 0.0 if t < 1 else 2.0}
    found = run(signalled(), np.linspace(0, 2, 21), method, inputs=step)
    np.testing.assert_allclose(times_of(found), [1], atol=1e-9)
    assert found["c.data_0"][-1] == 1


@cache
def signalled() -> rs.Model:
    """Events that count, and nothing that moves."""
    signal = rs.Input("signal")
    return ball(lambda s: [rs.Event(signal - 1, 1, data=[s.data[0] + 1])], gravity=0.0, data=[0.0])


@by_method(among=("idas", "rosenbrock"))
def test_events_beside_algebraic_unknowns(method: str) -> None:
    """A block that slides to a stop at mu g, past a mark and below half its speed."""
    block = joint(
        function=lambda s: [rs.Event(s.u[0] - 0.1, 1, name="mark"), rs.Event(s.v[0] - 0.5)],
        effects=rs.Friction(0, G, 0.3), data=[0.0],
    )  # fmt: skip
    model = rs.compile_scene(rs.Scene("block", [body(velocity=(1, 0, 0))], [block]))
    assert model.n_z == 1
    found = run(model, [0, 0.1, 0.3, 1], method)
    a = 0.3 * G
    np.testing.assert_allclose(
        times_of(found), [0, (1 - np.sqrt(1 - 0.2 * a)) / a, 0.5 / a, 1 / a], atol=EXACT
    )
    assert names_of(found) == ["friction_x_moves", "mark", "event_1", "friction_x_sticks"]
    assert found["b.p_x"][-1] == pytest.approx(1 / (2 * a), abs=EXACT)


@by_method()
def test_events_of_what_never_moves(method: str) -> None:
    scene = rs.Scene("rest", [body()], [joint(function=lambda s: [rs.Event(1 - s.t, name="tick")])])
    model = rs.compile_scene(scene)
    assert model.n_x == 0
    with pytest.raises(ValueError, match=r"model 'rest': events, but nothing moves.*minimal=False"):
        run(model, [0, 0.7, 2], method)
    full = rs.compile_scene(scene, minimal=False)
    np.testing.assert_allclose(times_of(run(full, [0, 0.7, 2], method)), [1], atol=EXACT)


@by_method()
def test_a_broken_connector_hits_nothing(method: str) -> None:
    """It breaks at 5 N / (100 N/m) below its rest, far above the floor it would have met."""
    model = swing(None, v=-1.0, k=100.0, effects=[rs.Impact(0, 1.0, gap=0.5), rs.Fracture(5.0)])
    found = run(model, [0, 0.2, 1.0], method)
    assert found["b.v_x"][-1] == pytest.approx(-np.sqrt(0.75), abs=1e-8)
    assert names_of(found) == ["fracture_breaks"]
