"""Data states and events in models: labels, start values, what minimal models keep, rates."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes.data import TIGHT, compiled, names
from scenes.events import body, by_method, joint, names_of, run, swing

import rbsd_sym as rs

FORMULATIONS = pytest.mark.parametrize(
    "formulation", [rs.Quaternion(), rs.TaitBryan()], ids=["quaternion", "tait_bryan"]
)
# Free bodies and frictionless hits: what is left out may well be unstable.
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


def switched(mbs: Any, t: Any, item: Any, data: Any, *rest: Any) -> list[Any]:
    """A force along x that is the first entry of data."""
    return [-data[0], 0, 0, 0, 0, 0]


# Labels, rates, start values, columns.


def test_labels_and_rates() -> None:
    impact = joint("hit", "b", effects=rs.Impact(2, 0.5, gap=9), data=[0.25, -3.0])
    model = compiled([body(velocity=(1, 2, 3))], [impact], gravity=(0, 0, -9.81))
    data = {v.name: (v.start, v.unit) for v in model.x_labels if v.data}
    assert data == {"hit.data_0": (0.25, ""), "hit.data_1": (-3.0, ""),
                    "hit.impact_z_lost": (0.0, "J")}  # fmt: skip
    rng = np.random.default_rng(0)
    rows = [i for i, v in enumerate(model.x_labels) if v.data]
    assert rows == list(model.dae.data)
    for _ in range(3):
        rates = model.function("ode")(rng.random(), rng.standard_normal(model.n_x), [], [], [])
        assert not np.array(rates)[rows].any()
    idle = replace(impact, active=False)
    assert not any(v.data for v in compiled([body()], [idle], None, False).x_labels)


@by_method()
def test_a_start_of_data(method: str) -> None:
    """x = 2 t^2 / 2; the state is a column of the trajectory and goes on from there."""
    model = compiled([body()], [joint(force=switched, data=[0.0])])
    assert names(model) == ["b.p_x", "b.v_x", "c.data_0"]
    found = run(model, [0, 0.5, 1], method, start={"c.data_0": 2.0})
    np.testing.assert_allclose(found["b.p_x"], found.t**2, atol=1e-12)
    np.testing.assert_allclose(found["c.data_0"], 2, atol=1e-15)
    assert found.state_at_end["c.data_0"] == pytest.approx(2.0)
    assert run(model, 1.0, method)["b.p_x"][-1] == 0


# What a minimal model keeps.


@FORMULATIONS
@by_method(among=tuple(TIGHT))
def test_a_force_that_data_switch_on_is_not_frozen(formulation: Any, method: str) -> None:
    link = joint(force=switched, data=[0.0], function=lambda s: [rs.Event(1 - s.t, data=[1.0])])
    model = compiled([body()], [link], formulation)
    assert names(model) == ["b.p_x", "b.v_x", "c.data_0"]
    found = run(model, [0, 0.5, 1.5, 2], method)
    np.testing.assert_allclose(found["b.p_x"], [0, 0, 0.125, 0.5], atol=1e-10)


@FORMULATIONS
@by_method(among=tuple(TIGHT))
def test_a_body_at_rest_that_another_hits(formulation: Any, method: str) -> None:
    """It moves; one that nobody hits, on a spring at rest, does not."""
    bodies = [body("a", velocity=(1, 0, 0)), body("b", position=(1, 0, 0)),
              body("idle", position=(5, 0, 0))]  # fmt: skip
    hit = joint("c", "b", marker0=rs.Marker("a"), effects=rs.Impact(0, 0.5, gap=-0.5))
    hold = joint("h", "idle", marker0=rs.Marker(rs.GROUND, (5, 0, 0)), stiffness=[1] * 6)
    model = compiled(bodies, [hit, hold], formulation)
    assert names(model) == ["a.p_x", "a.v_x", "b.p_x", "b.v_x", "c.impact_x_lost"]
    found = run(model, [0, 0.4, 1], method)
    assert [found[f"{b}.v_x"][-1] for b in "ab"] == pytest.approx([0.25, 0.75], abs=1e-12)
    assert found["c.impact_x_lost"][-1] == pytest.approx(0.5 * 0.75 / 2, abs=1e-12)
    np.testing.assert_array_equal(found["idle.p_x"], 5)


@FORMULATIONS
@by_method(among=tuple(TIGHT))
def test_a_body_at_rest_that_a_users_impulse_moves(formulation: Any, method: str) -> None:
    kick = joint(function=lambda s: [rs.Event(1 - s.t, impulse=[0, -2, 0, 0, 0, -1.4])])
    model = compiled([body()], [kick], formulation)
    angle = "b.angle_z" if isinstance(formulation, rs.Quaternion) else "b.a_z"
    assert names(model) == ["b.p_y", angle, "b.v_y", "b.w_z"]
    found = run(model, [0, 0.9, 2], method)
    np.testing.assert_allclose(found["b.velocity"], [[0] * 3] * 2 + [[0, 2, 0]], atol=1e-14)
    assert found["b.rotation_matrix"][-1][1, 0] == pytest.approx(np.sin(1.0), abs=1e-9)


def test_an_impulse_that_is_zero_by_default() -> None:
    """What a Param may set moving is kept."""
    push = rs.Param("push", 0.0, "N s")
    kick = joint(function=lambda s: [rs.Event(1 - s.t, impulse=[-push, 0, 0, 0, 0, 0])])
    model = compiled([body()], [kick])
    assert names(model) == ["b.p_x", "b.v_x"]
    assert rs.simulate(model, 2.0, params={"push": 3.0})["b.v_x"][-1] == pytest.approx(3.0)


def watched(*outputs: str) -> rs.Model:
    """One body that passes a mark, and one whose event changes data that nobody feels."""
    bodies = [body("b", velocity=(1, 0, 0)), body("far", position=(0, 0, 1), velocity=(0, 0, 1))]
    mark = joint("c", "b", lambda s: [rs.Event(s.u[0] - 0.5, 1, name="mark")])
    note = joint("d", "far", lambda s: [rs.Event(s.u[2] - 1.5, 1, [1.0], name="note")], data=[0.0])
    return compiled(bodies, [mark, note], outputs=list(outputs) or None)


def test_states_and_events_that_nobody_feels_are_dropped() -> None:
    """A monitor changes nothing and is kept, with the states it looks at."""
    assert watched().events == ("c.mark", "d.note")
    for output, kept, events in (
        ("b.position", ["b.p_x"], ("c.mark",)),
        ("far.position", ["b.p_x", "far.p_z"], ("c.mark",)),
    ):
        model = watched(output)
        assert (names(model), model.events) == (kept, events)
        assert names_of(rs.simulate(model, 2.0)) == ["mark"]


def test_an_event_that_stops_is_kept() -> None:
    bodies = [body("b", velocity=(1, 0, 0)), body("far", velocity=(0, 0, 1))]
    stop = joint("d", "far", lambda s: [rs.Event(s.u[2] - 1.5, 1, [1.0], stop=True)], data=[0.0])
    model = compiled(bodies, [stop], outputs=["b.position"])
    assert model.events == ("d.event_0",)
    found = rs.simulate(model, 2.0)
    assert found.outcome is rs.Outcome.event
    assert found.events[0][0] == pytest.approx(1.5, abs=1e-10)


# Rates of the zero functions.


def slopes(model: rs.Model, found: rs.Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Zero functions' rates at the inner times, and by central differences (n_events, n)."""

    def column(labels: Any) -> np.ndarray:
        return np.array([found[v.name] for v in labels]).reshape(len(labels), len(found.t))

    dae = model.dae
    given = (found.t[None, :], column(model.x_labels), column(dae.z_labels),
             column(dae.u_labels), column(dae.p_labels))  # fmt: skip
    zero, rate = (np.array(model.function(name)(*given)) for name in ("zero", "zero_rate"))
    return rate[:, 1:-1], (zero[:, 2:] - zero[:, :-2]) / (found.t[2:] - found.t[:-2])


def test_zero_rate_of_a_swinging_mass() -> None:
    """An error of h^2/6 times the third derivative, which is at most 40, and rounding / h."""
    push, k = rs.Input("push", "N"), rs.Param("k", 9.0)
    spring = joint(stiffness=[k, 0, 0, 0, 0, 0], function=lambda s: [
        rs.Event(s.u[0] - 5), rs.Event(9 + s.u[0] * s.v[0]), rs.Event(5 + np.sin(s.t) * s.u[0]),
    ])  # fmt: skip
    load = rs.Load("load", rs.Marker("b"), force=(push, 0, 0))
    model = compiled([body(velocity=(1, 0, 0))], [spring], loads=[load])
    h = 1e-3
    times = np.arange(0, 1, h)
    found = rs.simulate(model, times, TIGHT["explicit"], inputs={"push": 0.3})
    rate, difference = slopes(model, found)
    assert np.abs(rate).max(axis=1).min() > 0.5
    np.testing.assert_allclose(rate, difference, atol=h**2 / 6 * 40 + 1e-9)


@by_method(among=("idas", "rosenbrock"))
def test_zero_rate_beside_algebraic_unknowns(method: str) -> None:
    """A block sticks to a belt of 0.1 m/s: the reserve of friction falls at k V = 5 N/s.

    The unknown friction force is all that the function of `slips` looks at.
    """
    block = joint(
        stiffness=[50.0, 0, 0, 0, 0, 0], effects=rs.Friction(0, 10.0, 0.3, 0.4, velocity=0.1)
    )
    model = compiled([body(velocity=(0.1, 0, 0))], [block])
    found = run(model, np.linspace(0, 0.7, 71), method)
    assert found.events == ()
    rate, difference = slopes(model, found)
    slips = model.events.index("c.friction_x_slips")
    np.testing.assert_allclose(rate[slips], -5, rtol=1e-9)
    # Linear in t, so that nothing but the run's error over h = 0.01 is left.
    np.testing.assert_allclose(difference[slips], -5, rtol=1e-6)
    later = run(model, np.linspace(0, 1, 11), method)
    assert later.events[0] == (pytest.approx(0.8, abs=1e-8), "c.friction_x_slips")


def test_user_events_beside_effects_with_states() -> None:
    model = swing(lambda s: [rs.Event(s.u[0] - 0.5, 1)], effects=rs.Impact(0, 0.5, gap=1.0))
    assert model.events == ("c.impact_x_hits", "c.event_0")
