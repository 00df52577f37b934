"""Several events at one instant, in which order, and runs in which they follow without end."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from oracles import discontinuities as exact
from scenes.events import (
    EXACT,
    METHODS,
    G,
    Seen,
    ball,
    body,
    by_method,
    joint,
    names_of,
    run,
    times_of,
    within_seconds,  # noqa: F401  (a fixture of every test here)
)

import rbsd_sym as rs

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
