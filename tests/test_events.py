"""Events along a run: when they fire, in which order, what they change, and runs without end.

Bodies fall, fly and vibrate, so that times are known in closed form. Free flight is a polynomial,
which every method integrates exactly: its times are good to rounding, and 1e-10 has room for the
search. Where a spring or an input sets the error, methods run at rtol 1e-12.
"""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from oracles import discontinuities as exact

import rbsd_sym as rs

EXACT = 1e-10
G = 9.81
METHODS = {
    "idas": rs.Idas(), "rosenbrock": rs.Rosenbrock(), "explicit": rs.ExplicitRK(),
    "dop853": rs.Dop853(),
}  # fmt: skip
TIGHT = {
    "idas": rs.Idas(1e-12, 1e-14), "rosenbrock": rs.Rosenbrock(1e-12, 1e-14),
    "explicit": rs.ExplicitRK(1e-12, 1e-14), "dop853": rs.Dop853(1e-12, 1e-14),
}  # fmt: skip
CASADI = ("rosenbrock", "explicit")
WATCHED = ("idas", "dop853")
# What the search of events does not do yet.
LOOKS = "CasADi's methods look at the ends of steps only: a dip between them is not seen"
ROUNDED = "a function that rounding lifts above zero again fires again and again"


@pytest.fixture(autouse=True)
def within_seconds() -> Iterator[None]:
    """A run that hangs is a failure."""

    def stop(*_: Any) -> None:
        raise TimeoutError("still running after 20 s")

    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, stop)
        signal.alarm(20)
    yield
    if hasattr(signal, "SIGALRM"):
        signal.alarm(0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)


class Seen(NamedTuple):
    """What a user function of events looks at."""

    t: Any
    data: Any
    u: Any
    th: Any
    v: Any
    w: Any


def watch(function: Callable[[Seen], Any]) -> Callable[..., Any]:
    """A function of `Seen` as a connector's `events`."""
    return lambda mbs, t, item, data, u, th, v, w, *rest: function(Seen(t, data, u, th, v, w))


def body(name: str = "b", **given: Any) -> rs.RigidBody:
    return rs.RigidBody(name, **({"mass": 1.0, "inertia": (1.0, 1.2, 1.4)} | given))


def joint(name: str = "c", marker: Any = "b", function: Any = None, **given: Any) -> Any:
    """A connector from the ground, without spring, with events of `Seen`."""
    given |= {"events": watch(function)} if function else {}
    ends = {"marker0": rs.Marker(rs.GROUND), "marker1": rs.Marker(marker), "stiffness": 0}
    return rs.RigidBodySpringDamper(name, **(ends | given))


def ball(function: Any = None, height: float = 1.0, speed: float = 0.0, gravity: Any = G,
         **connector: Any) -> rs.Model:  # fmt: skip
    """A body in free flight along z."""
    bodies = [body(position=(0, 0, height), velocity=(0, 0, speed))]
    joints = [joint(function=function, **connector)]
    return rs.compile_scene(rs.Scene("ball", bodies, joints, gravity=(0, 0, -gravity)))


def swing(function: Any, x: float = 0.0, v: float = 1.0, k: float = 1.0, **rest: Any) -> rs.Model:
    """A mass on a spring along x."""
    spring = joint(function=function, stiffness=[k, 0, 0, 0, 0, 0], **rest)
    scene = rs.Scene("swing", [body(position=(x, 0, 0), velocity=(v, 0, 0))], [spring])
    return rs.compile_scene(scene, minimal=False)


@cache
def bouncing() -> rs.Model:
    """A ball with a user's impulse where it meets the floor, with Params g and e."""
    e = rs.Param("e", 0.8)
    return ball(
        lambda s: [rs.Event(s.u[2], impulse=[0, 0, (1 + e) * s.v[2], 0, 0, 0])],
        gravity=rs.Param("g", G, "m/s2"),
    )  # fmt: skip


def run(model: rs.Model, times: Any, method: str, among: Any = METHODS, **rest: Any) -> Any:
    return rs.simulate(model, times, among[method], throw=False, **rest)


def times_of(trajectory: rs.Trajectory) -> np.ndarray:
    return np.array([t for t, _ in trajectory.events])


def names_of(trajectory: rs.Trajectory) -> list[str]:
    return [name.split(".")[1] for _, name in trajectory.events]


def by_method(*fails: str, why: str = "", among: Any = tuple(METHODS)) -> Any:
    """Parametrize over methods, of which some are known to fail, and why."""
    mark = [pytest.mark.xfail(strict=True, reason=why)]
    return pytest.mark.parametrize(
        "method", [pytest.param(m, marks=mark if m in fails else []) for m in among]
    )


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


# Several at one instant.


@cache
def cradle(masses: Any, restitution: float) -> rs.Model:
    """Balls in a row that touch, hit from the left at t = 1 with 1 m/s."""
    bodies = [
        body(f"b{i}", mass=m, position=(i - (i == 0), 0, 0), velocity=(float(i == 0), 0, 0))
        for i, m in enumerate(masses)
    ]
    hit = rs.Impact(0, restitution, gap=-1.0)
    joints = [
        joint(f"c{i}", f"b{i + 1}", marker0=rs.Marker(f"b{i}"), effects=hit)
        for i in range(len(masses) - 1)
    ]
    return rs.compile_scene(rs.Scene("cradle", bodies, joints))


def speeds(found: rs.Trajectory, n: int) -> list[float]:
    return [float(found[f"b{i}.v_x"][-1]) for i in range(n)]


@by_method()
def test_two_balls_at_the_same_instant(method: str) -> None:
    bodies = [body(f"b{i}", position=(i, 0, 1.0)) for i in (0, 1)]
    joints = [joint(f"c{i}", f"b{i}", effects=rs.Impact(2, 0.8)) for i in (0, 1)]
    scene = rs.Scene("balls", bodies, joints, gravity=(0, 0, -G))
    found = run(rs.compile_scene(scene), np.linspace(0, 2, 9), method)
    impacts = np.repeat(exact.ball_impacts(3, 1, G, 0.8)[0], 2)
    np.testing.assert_allclose(times_of(found), impacts, atol=EXACT)
    assert [name[:2] for _, name in found.events] == ["c0", "c1"] * 3
    np.testing.assert_allclose(found["b0.p_z"], found["b1.p_z"], atol=EXACT)


@by_method()
@pytest.mark.parametrize(("masses", "restitution"), [
    ((1, 2, 1.5), 1.0), ((1, 2, 1.5), 0.5), ((1, 1, 1), 1.0), ((1, 1, 1, 1, 1), 1.0),
    ((3, 1, 1), 1.0), ((1, 1, 1), 0.5), ((5, 1, 2, 1), 0.9),
])  # fmt: skip
def test_cradle(masses: tuple[float, ...], restitution: float, method: str) -> None:
    """Impacts one after the other at one instant; of equal balls the last leaves with all speed."""
    v, order = exact.impacts_in_order(masses, [1] + [0] * (len(masses) - 1), restitution)
    found = run(cradle(masses, restitution), [0, 0.6, 1.5], method)
    assert found.outcome is rs.Outcome.reached_end
    np.testing.assert_allclose(speeds(found, len(masses)), v, atol=EXACT)
    # Balls left in touch may meet again, with the velocities that rounding has left.
    assert [name[1] for _, name in found.events][: len(order)] == [str(i) for i in order]
    np.testing.assert_allclose(times_of(found)[: len(order)], 1, atol=EXACT)


def chained(s: Seen, links: int) -> list[rs.Event]:
    """At t = 1 the first entry of data becomes 1; each of the others follows the one before."""

    def raised(i: int) -> list[Any]:
        return [1 if j == i else s.data[j] for j in range(links)]

    first = rs.Event(1 - s.t, data=raised(0), name="e0")
    return [first, *(
        rs.Event(0.5 - s.data[i - 1] + s.data[i], data=raised(i), at_once=True, name=f"e{i}")
        for i in range(1, links)
    )]  # fmt: skip


@pytest.mark.parametrize("backwards", [False, True])
@by_method()
def test_events_that_set_off_each_other(backwards: bool, method: str) -> None:
    step = -1 if backwards else 1
    found = run(ball(lambda s: chained(s, 3)[::step], data=[0.0] * 3), [0, 0.7, 2], method)
    assert names_of(found) == ["e0", "e1", "e2"]
    assert [found[f"c.data_{i}"][-1] for i in range(3)] == [1, 1, 1]
    np.testing.assert_allclose(times_of(found), 1, atol=EXACT)


@by_method()
def test_a_long_chain_against_the_order_of_the_list(method: str) -> None:
    found = run(ball(lambda s: chained(s, 8)[::-1], data=[0.0] * 8), [0, 0.7, 2], method)
    assert names_of(found) == [f"e{i}" for i in range(8)]


@by_method()
def test_a_jump_below_zero_is_no_crossing(method: str) -> None:
    model = ball(
        lambda s: [rs.Event(1 - s.t, data=[1.0], name="e0"), rs.Event(0.5 - s.data[0], name="e1")],
        data=[0.0],
    )
    assert names_of(run(model, [0, 0.7, 2], method)) == ["e0"]


@by_method()
@pytest.mark.parametrize("apart", [1e-12, 0.0])
def test_two_events_close_to_each_other(apart: float, method: str) -> None:
    """In the order of time, whatever the list says; in that of the list if they are at once."""
    for first in (0, 1):
        pair = [
            lambda s: rs.Event(0.5 - s.t, data=[2 * s.data[0]], name="e0"),
            lambda s: rs.Event(0.5 + apart - s.t, data=[s.data[0] + 1], name="e1"),
        ]
        order = [pair[first], pair[1 - first]]
        model = ball(lambda s, order=order: [make(s) for make in order], data=[1.0])
        found = run(model, [0, 0.7, 1], method)
        assert names_of(found) == (["e0", "e1"] if apart or not first else ["e1", "e0"])
        np.testing.assert_allclose(np.diff(times_of(found)), apart, atol=1e-14)
        assert found["c.data_0"][-1] == pytest.approx(3 if apart or not first else 4, rel=1e-15)


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


# Runs without end.


@by_method()
def test_a_ball_that_comes_to_rest(method: str) -> None:
    """Infinitely many bounces before t = 1.3546 s; the run ends there and says so."""
    end, model = exact.ball_zeno(1.0, G, 0.5), ball(effects=rs.Impact(2, 0.5))
    found = run(model, [0, 0.4, 1.0, 2.0], method)
    assert found.outcome is rs.Outcome.endless_events
    assert not found.outcome.ok
    # It may end where thirty bounces are within 1e-6 of the run.
    assert found.stats["t_failed"] == pytest.approx(end, abs=2e-6)
    told = re.search(r": (\d+) events up to t = 1\.3545\d+ s, the last \d+ within", found.report)
    assert told is not None, found.report
    assert 20 < int(told[1]) < 1100
    np.testing.assert_array_equal(found.t, [0, 0.4, 1.0])
    with pytest.raises(rs.IntegrationError, match="follow each other without end"):
        rs.simulate(model, [0, 2.0], METHODS[method])


@by_method()
def test_bounces_before_the_end_are_told_once(method: str) -> None:
    found = run(ball(effects=rs.Impact(2, 0.5)), [0, 0.4, 1.0, 2.0], method)
    impacts, _ = exact.ball_impacts(30, 1.0, G, 0.5)
    np.testing.assert_allclose(times_of(found)[:30], impacts, atol=EXACT)


RELAYS: dict[str, Callable[[Any, Any], list[rs.Event]]] = {
    "two at once": lambda s, d: [rs.Event(s, -1, [-1], at_once=True, name="down"),
                                 rs.Event(s, 1, [1], at_once=True, name="up")],
    "both ways": lambda s, d: [rs.Event(s, 0, [-d])],
    "guarded": lambda s, d: [rs.Event(rs.where(d > 0, s, 1), -1, [-1], at_once=True, name="down"),
                             rs.Event(rs.where(d > 0, 1, -s), -1, [1], at_once=True, name="up")],
}  # fmt: skip


def relay(form: str) -> rs.Model:
    """Force -sign(x + v), switched without hysteresis, from x = 2, v = 1.

    It crosses at t = sqrt(6), and slides on x + v = 0 from 2 (sqrt(6) - 2) later on.
    """
    scene = rs.Scene("relay", [body(position=(2, 0, 0), velocity=(1, 0, 0))], [joint(
        function=lambda s: RELAYS[form](s.u[0] + s.v[0], s.data[0]), data=[1.0],
        force=lambda m, t, i, data, *rest: [data[0], 0, 0, 0, 0, 0],
    )])  # fmt: skip
    return rs.compile_scene(scene)


@by_method()
@pytest.mark.parametrize("form", RELAYS)
def test_a_relay_without_hysteresis(form: str, method: str) -> None:
    found = run(relay(form), [0, 1, 2, 3, 4, 10], method)
    slides = 3 * np.sqrt(6) - 4
    assert found.outcome is rs.Outcome.endless_events
    assert found.stats["t_failed"] == pytest.approx(slides, abs=1e-6)
    assert "events up to t = 3.348" in found.report


@by_method()
def test_a_ball_that_does_not_bounce(method: str) -> None:
    """Restitution 0 leaves it at rest on the floor."""
    check_floor(1.0, method)


@by_method()
def test_a_ball_that_starts_on_the_floor(method: str) -> None:
    check_floor(0.0, method)


def check_floor(height: float, method: str) -> None:
    """It never falls through the floor."""
    model = ball(effects=rs.Impact(2, 0.0), height=height)
    found = run(model, [0, 0.2, 0.6, 1], method)
    # CasADi's methods do not see what starts on zero, but that it was missed.
    assert found.outcome in (rs.Outcome.endless_events, rs.Outcome.solver_failed)
    assert found["b.p_z"].min() > -1e-9


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
