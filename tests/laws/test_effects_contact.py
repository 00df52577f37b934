"""Contact and impact against closed forms.

Tolerances: integration at rtol 1e-10 leaves 1e-10 to 1e-9 of the motion over some ten events; 1e-8
has room for it, and stays far below what a wrong law would show. Expectations come from
tests/oracles; the numbers written out are published.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.comparing import largest
from oracles import discontinuities as events
from scenes.effects import TIGHT, along, block, compare, force, thrown, times_of

import rbsd_sym as rs

by_integrator = pytest.mark.parametrize("method", TIGHT)
# A motion along one axis is what counts here, not whether a spring without the others is stable.
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


# Contact.


@pytest.mark.parametrize(
    ("method", "law", "axis"),
    [*((method, "standard", 2) for method in TIGHT), ("dop853", "consistent", 4)],
)
@pytest.mark.parametrize(
    ("stiffness", "duration", "depth"),
    [
        (1e4, 0.03281435718836892, 0.01502245152753091),
        (1e6, 0.003155599565615692, 0.001410558455683603),
        (1e8, 3.142993367464368e-4, 1.401695447116542e-4),
    ],
)
def test_drop_on_a_spring_as_published(
    stiffness: float, duration: float, depth: float, law: str, axis: int, method: str
) -> None:
    """Mass 1 from 0.1 m; the deepest point is half way through the contact."""
    scene = block(rs.Contact(axis, stiffness), axis, x=0.1, law=law, pull=-9.81)
    lands = np.sqrt(2 * 0.1 / 9.81)
    found = rs.simulate(
        rs.compile_scene(scene), [0, lands + duration / 2, lands + 2 * duration], TIGHT[method]
    )
    start, end = times_of(found, "closes")[0], times_of(found, "opens")[0]
    assert abs(start - lands) < 1e-12
    assert abs((end - start) / duration - 1) < 1e-9
    assert abs(-along(found, axis)[0][1] / depth - 1) < 1e-9
    assert abs(found[f"j.contact_{rs.laws.effect.AXES[axis]}_lost"][-1]) < 1e-12


@pytest.mark.parametrize(
    ("damping", "method"),
    [*((damping, method) for damping in (0.0, 20.0) for method in TIGHT), (250.0, "explicit")],
)
def test_bounces_on_spring_and_damper_never_pull(damping: float, method: str) -> None:
    """Down to overdamped: it lets go before it comes up, and sets in again on the way down."""
    model = rs.compile_scene(block(rs.Contact(2, 1e4, damping), 2, x=0.1, pull=-9.81))
    phases = events.spring_bounce_phases(2.0, 1.0, 1e4, damping, 9.81, 0.1)
    found = rs.simulate(model, np.linspace(0, 2, 401), TIGHT[method])
    compare(found, phases, 2, 1e-6)  # of 1.4 m/s, times w = 100 1/s over w = 1 above
    assert [name.endswith("closes") for _, name in found.events] == [
        p.mode == "contact" for p in phases[1:]
    ]
    assert largest(np.array([t for t, _ in found.events]) - [p.start for p in phases[1:]]) < 1e-8
    push = -force(found, 2)
    assert push.min() >= 0
    assert push.max() > 9.81


@pytest.mark.parametrize(
    ("method", "law", "axis"),
    [("idas", "standard", 0), ("rosenbrock", "intrinsic", 4), ("explicit", "consistent", 5),
     ("dop853", "standard", 5)],
)  # fmt: skip
def test_contact_on_the_other_side_with_a_gap(law: str, axis: int, method: str) -> None:
    """A ceiling at +0.3 is the mirror of a floor at -0.3, which is a floor at 0 raised by 0.3."""
    t, paths = np.linspace(0, 1.5, 31), []
    for side in (1, -1):
        contact = rs.Contact(axis, 1e3, 5.0, 0.3, side)
        scene = block(contact, axis, x=-0.2 * side, law=law, pull=-9.81 * side)
        found = rs.simulate(rs.compile_scene(scene), t, TIGHT[method])
        paths.append((side * along(found, axis)[0], side * force(found, axis)))
    phases = events.spring_bounce_phases(1.5, 1.0, 1e3, 5.0, 9.81, 0.1)
    assert largest(paths[0][0] + 0.3 - events.state_at(phases, t)[0]) < 1e-8
    assert largest(np.subtract(*paths)) < 1e-8


@pytest.mark.parametrize("method", ["rosenbrock", "explicit", "dop853"])
def test_stops_at_both_ends(method: str) -> None:
    """Period: twice the free way over v, and half an oscillation in each of the stops."""
    lower, upper, v, w = -0.4, 0.7, 2.0, 50.0
    model = rs.compile_scene(block(rs.stops(3, lower, upper, w**2), 3, v=v, law="consistent"))
    period = 2 * (upper - lower) / v + 2 * np.pi / w
    found = rs.simulate(model, period * np.arange(4), TIGHT[method])
    assert largest(along(found, 3)[0]) < 1e-7
    hits = [times_of(found, f"stop_{end}_closes") for end in ("upper", "lower")]
    assert largest(hits[0] - upper / v - period * np.arange(3)) < 1e-8
    assert largest(hits[1] - hits[0] - (upper - lower) / v - np.pi / w) < 1e-8


def test_contact_that_starts_pressed_counts_what_its_spring_held() -> None:
    """From a depth of 0.1 m the spring of 1 kN/m throws up by 5 J, which no state remembers."""
    model = rs.compile_scene(block(rs.Contact(2, 1e3), 2, x=-0.1, pull=-9.81))
    found = rs.simulate(model, [0, 0.5], TIGHT["rosenbrock"])
    lands = found["j.contact_z_lost"]
    x, v = (a[-1] for a in along(found, 2))
    assert lands[0] == pytest.approx(-5.0, rel=1e-12)
    assert v**2 / 2 + 9.81 * (x + 0.1) == pytest.approx(5.0, rel=1e-9)


# Impact.


def floor_under_a_flight(effect: Any) -> rs.Model:
    """From 0.1 m with -1 m/s under 4 m/s2 upwards: below 0 between 0.138 and 0.362 s."""
    return rs.compile_scene(block(effect, 2, x=0.1, v=-1.0, pull=4.0))


@pytest.mark.parametrize(
    "method", [rs.Idas(), rs.Dop853(), rs.Rosenbrock(),
               rs.ExplicitRK()], ids=lambda m: type(m).__name__
)  # fmt: skip
@pytest.mark.parametrize("effect", [rs.Contact(2, 1e4), rs.Impact(2, 1.0)], ids=["spring", "hard"])
def test_a_dip_below_the_floor_is_seen(effect: Any, method: Any) -> None:
    """It comes at sqrt(0.2) m/s and leaves so, with and without a spring."""
    found = rs.simulate(floor_under_a_flight(effect), np.linspace(0, 1, 11), method)
    assert found.events[0][0] == pytest.approx((1 - np.sqrt(0.2)) / 4, rel=1e-9)
    assert along(found, 2)[0].min() > -1e-2


@pytest.mark.parametrize(
    "method", ["dop853", "rosenbrock", "idas"]
)
def test_output_times_do_not_decide_on_events(method: str) -> None:
    """The contact lasts 2/w atan(u w / a) = 0.03 s, in a run of 2 s between two output times."""
    u, w, a = np.sqrt(0.2), 100.0, 4.0
    leaves = (1 - u) / a + 2 / w * np.arctan(u * w / a)
    found = rs.simulate(floor_under_a_flight(rs.Contact(2, 1e4)), [0, 2], TIGHT[method])
    assert times_of(found, "opens") == pytest.approx([leaves], rel=1e-8)
    flight = 2 - leaves
    assert along(found, 2)[0][-1] == pytest.approx(u * flight + a * flight**2 / 2, rel=1e-7)


@pytest.mark.parametrize(
    ("method", "law", "axis"),
    [*((method, "standard", 2) for method in TIGHT), ("idas", "consistent", 3),
     ("dop853", "intrinsic", 4)],
)  # fmt: skip
def test_ten_bounces_of_a_ball(law: str, axis: int, method: str) -> None:
    scene = block(rs.Impact(axis, 0.8), axis, x=1.0, v=0.3, law=law, pull=-9.81)
    t, v = events.ball_impacts(10, 1.0, 9.81, 0.8, 0.3)
    end = t[-1] + 0.9 * v[-1] / 9.81
    found = rs.simulate(rs.compile_scene(scene), np.linspace(0, end, 41), TIGHT[method])
    assert largest(times_of(found, "hits") - t) < 1e-10
    compare(found, events.ball_phases(1.0, 9.81, 0.8, 0.3, 10), axis, 1e-9)
    lost = found[f"j.impact_{rs.laws.effect.AXES[axis]}_lost"][-1]
    assert lost == pytest.approx((v[0] / 0.8) ** 2 / 2 * (1 - 0.8**20), rel=1e-10)


@pytest.mark.parametrize(
    ("method", "restitution"),
    [("idas", 0.3), ("rosenbrock", 0.8), ("explicit", 0.3), ("dop853", 0.5)],
)
def test_a_ball_that_comes_to_rest_ends_the_run(restitution: float, method: str) -> None:
    """Zeno: without end in finite time; what is left then is 1e-10 of the run and one bounce."""
    model = rs.compile_scene(block(rs.Impact(2, restitution), 2, x=1.0, pull=-9.81))
    end = events.ball_zeno(1.0, 9.81, restitution)
    found = rs.simulate(model, np.linspace(0, 6, 21), TIGHT[method], throw=False)
    assert found.outcome is rs.Outcome.endless_events
    assert found.t[-1] < end < found.t[-1] + 0.3 + 1e-9
    assert abs(found.stats["t_failed"] - end) < 6e-9
    with pytest.raises(rs.IntegrationError, match="without end"):
        rs.simulate(model, 6.0, TIGHT[method])


@pytest.mark.parametrize(
    ("method", "restitution"),
    [("idas", 0.3), ("dop853", 0.1),
     ("rosenbrock", 0.3), ("explicit", 0.3)],
)  # fmt: skip
def test_every_bounce_is_one_event(method: str, restitution: float) -> None:
    """Flights soon shorter than an eighth of the output interval of 0.1 s."""
    model = rs.compile_scene(block(rs.Impact(2, restitution), 2, x=1.0, v=0.3, pull=-9.81))
    found = rs.simulate(model, np.linspace(0, 6, 61), TIGHT[method], throw=False)
    expected = events.ball_impacts(10, 1.0, 9.81, restitution, 0.3)[0]
    assert largest(times_of(found, "hits")[:10] - expected) < 1e-10


def test_all_events_are_told() -> None:
    """More than a hundred bounces before the end."""
    model = rs.compile_scene(block(rs.Impact(2, 0.8), 2, x=1.0, v=0.3, pull=-9.81))
    found = rs.simulate(model, 6.0, TIGHT["explicit"], throw=False)
    assert found.stats["events"] > 100
    assert times_of(found, "hits")[0] == pytest.approx(0.48313910051831, rel=1e-10)


@by_integrator
def test_nothing_falls_through_the_floor(method: str) -> None:
    """A ball that cannot rest may end the run; it is never below."""
    model = rs.compile_scene(block(rs.Impact(2, 0.0), 2, x=1.0, pull=-9.81))
    found = rs.simulate(model, np.linspace(0, 2, 21), TIGHT[method], throw=False)
    assert along(found, 2)[0].min() > -1e-6


@by_integrator
def test_impact_without_loss_and_on_a_ceiling(method: str) -> None:
    """Between floor and ceiling at +-0.5 m, 3 m/s, no gravity: every 1/3 s."""
    model = rs.compile_scene(block(
        [rs.Impact(0, 1.0, 0.5, name="floor"), rs.Impact(0, 1.0, 0.5, -1, "ceiling")], v=3.0
    ))  # fmt: skip
    found = rs.simulate(model, [0, 1.0, 1.9], TIGHT[method])
    assert [name for _, name in found.events][:3] == [
        "j.ceiling_hits", "j.floor_hits", "j.ceiling_hits"
    ]
    assert largest([t for t, _ in found.events] - (np.arange(6) + 0.5) / 3) < 1e-12
    assert largest(np.abs(along(found, 0)[1]) - 3) < 1e-12


@pytest.mark.parametrize(
    ("method", "law", "apart"),
    [("rosenbrock", "standard", -0.2), ("idas", "intrinsic", 0.0), ("explicit", "consistent", -0.2),
     ("dop853", "consistent", 0.1)],
)  # fmt: skip
def test_impact_of_two_turning_bodies(law: str, apart: float, method: str) -> None:
    """Centres of mass off the origins, markers off both; in 1e-8 s spins change by 1e-8 rad/s."""
    pair = thrown(rs.Impact(1, 0.6, -apart), law, 3, apart)
    found = rs.simulate(rs.compile_scene(pair.scene), [0, 1e-8], TIGHT[method])
    assert [name for _, name in found.events] == ["j.impact_y_hits"]
    # Strains of the intrinsic law are those of a screw, a few percent from distances.
    assert found.events[0][0] == pytest.approx(1e-9, rel=1e-6 if law != "intrinsic" else 0.1)
    expected = events.impact_bodies(*pair.bodies, pair.normal, 0.6)
    for i, body in enumerate(pair.scene.bodies):
        R, w = found[f"b{i}.rotation_matrix"][-1], found[f"b{i}.angular_velocity"][-1]
        v = found[f"b{i}.velocity"][-1] + R @ np.cross(w, body.com)
        assert largest(v - expected[i].v) < 1e-6
        assert largest(R @ w - expected[i].w) < 1e-6
        assert largest(expected[i].w - pair.bodies[i].w) > 0.1
    before, after = found["energy"]
    assert found["j.impact_y_lost"][-1] == pytest.approx(before - after, rel=1e-7)


@pytest.mark.parametrize("law", ["standard", "consistent"])
def test_impact_beside_a_lever(law: str) -> None:
    """Consistent is the one law that keeps what nature keeps; all turn the velocity round."""
    pair = thrown(rs.Impact(1, 0.6, 0.2), law, 5, -0.2, aside=0.4)
    found = rs.simulate(rs.compile_scene(pair.scene), [0, 1e-8], TIGHT["rosenbrock"])
    change = {name: np.diff(found[name], axis=0)[0]
              for name in ("momentum", "angular_momentum", "energy")}  # fmt: skip
    rate = found["j.velocity_local"][:, 1]
    assert len(found.events) == 1
    assert rate[1] == pytest.approx(-0.6 * rate[0], rel=1e-6)
    assert largest(change["momentum"]) < 1e-10
    assert largest(np.diff(found["b0.angular_velocity"], axis=0)) > 1
    if law == "consistent":
        assert largest(change["angular_momentum"]) < 1e-10
        assert found["j.impact_y_lost"][-1] == pytest.approx(-change["energy"], rel=1e-7)
    else:
        assert largest(change["angular_momentum"]) > 0.1
