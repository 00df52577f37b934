"""Effects with events against closed forms: friction, contact, impact, plasticity, fracture, ...

Tolerances: integration at rtol 1e-10 leaves 1e-10 to 1e-9 of the motion over some ten events; 1e-8
has room for it, and stays far below what a wrong law would show. Expectations come from
tests/oracles; the numbers written out are published.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from effect_scenes import (
    LAWS,
    along,
    balance,
    block,
    driven,
    evaluate,
    force,
    largest,
    names,
    thrown,
    times_of,
    unit,
)
from oracles import discontinuities as events
from oracles import dissipation

import rbsd_sym as rs

TIGHT = {
    "idas": rs.Idas(1e-10, 1e-12), "rosenbrock": rs.Rosenbrock(1e-10, 1e-12),
    "explicit": rs.ExplicitRK(1e-10, 1e-12), "dop853": rs.Dop853(1e-10, 1e-12),
}  # fmt: skip
HOLDING = ("idas", "rosenbrock")  # those that solve for the force of friction that sticks
EVERYWHERE = [(law, axis) for law in LAWS for axis in range(6)]
SOME = [("standard", 0), ("standard", 5), ("intrinsic", 3), ("consistent", 2), ("consistent", 4)]
everywhere = pytest.mark.parametrize(("law", "axis"), EVERYWHERE)
somewhere = pytest.mark.parametrize(("law", "axis"), SOME)
by_integrator = pytest.mark.parametrize("method", TIGHT)
by_holding = pytest.mark.parametrize("method", HOLDING)


# A motion along one axis is what counts here, not whether a spring without the others is stable.
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


def compare(found: rs.Trajectory, phases: list[events.Phase], axis: int, error: float) -> None:
    """Positions and velocities against phases."""
    x, v = events.state_at(phases, found.t)
    ours = along(found, axis)
    assert largest(ours[0] - x) < error
    assert largest(ours[1] - v) < error


# Coulomb friction. N = 0.2, mu_k = 0.5 make the published F = 0.1.


@everywhere
def test_coulomb_oscillator_as_published(law: str, axis: int) -> None:
    """Turning points 1, -0.8, 0.6, -0.4, 0.2, then 0 at 5 pi, where it sticks."""
    model = rs.compile_scene(block(rs.Friction(axis, 0.2, 0.5), axis, 1.0, x=1.0, law=law))
    t = np.arange(49) * np.pi / 8
    found = rs.simulate(model, t, TIGHT["rosenbrock"])
    assert largest(along(found, axis)[0][::8] - [1, -0.8, 0.6, -0.4, 0.2, 0, 0]) < 1e-8
    assert largest(times_of(found, "sticks") - np.pi * np.arange(1, 6)) < 1e-8
    assert largest(times_of(found, "slips") - np.pi * np.arange(5)) < 1e-8
    compare(found, events.coulomb_phases(1.0, 1.0, 0.1, 1.0), axis, 1e-8)


@by_holding
@pytest.mark.parametrize(
    ("x", "v", "static"),
    [
        (1.05, 0.0, None), (1.05, 0.0, 1.2), (0.0, 0.05, None),
        (0.3, -1.2, None), (-0.2, 1.5, 1.7),
    ],
    ids=["released", "static", "slow", "thrown", "thrown static"],
)  # fmt: skip
def test_coulomb_oscillator_from_any_start(
    x: float, v: float, static: float | None, method: str
) -> None:
    """With mass 2, k = 8, kinetic friction 0.5 N and a static limit of more."""
    effect = rs.Friction(1, 1.0, 0.5, static and 0.5 * static)
    model = rs.compile_scene(block(effect, 1, 8.0, 2.0, x, v))
    phases = events.coulomb_phases(2.0, 8.0, 0.5, x, v, static and 0.5 * static)
    found = rs.simulate(model, np.linspace(0, phases[-1].start + 2, 60), TIGHT[method])
    compare(found, phases, 1, 1e-8)
    assert abs(times_of(found, "sticks")[-1] - phases[-1].start) < 1e-8
    assert abs(found["j.friction_y_mode"][-1]) < 1e-9


@by_holding
@pytest.mark.parametrize("pull", [0.4, -0.4])
def test_friction_that_sticks_holds_exactly(pull: float, method: str) -> None:
    """k x = 0.05 and a pull beside it stay below mu_s N = 0.5: nothing happens, for 100 s."""
    model = rs.compile_scene(block(rs.Friction(0, 1.0, 0.3, 0.5), 0, 1.0, x=0.05, pull=pull))
    found = rs.simulate(model, [0, 50, 100], TIGHT[method])
    assert found.events == ()
    assert largest(along(found, 0)[0] - 0.05) < 1e-15
    assert largest(found["j.friction_x_force"] - (pull - 0.05)) < 1e-14


@pytest.mark.parametrize("minimal", [True, False])
@pytest.mark.parametrize("formulation", [rs.Quaternion(), rs.TaitBryan()], ids=["q", "angles"])
@pytest.mark.parametrize(("law", "axis"), [("standard", 2), ("intrinsic", 5)])
def test_friction_in_all_coordinates(
    law: str, axis: int, formulation: Any, minimal: bool
) -> None:
    scene = block(rs.Friction(axis, 0.2, 0.5, 0.6), axis, 1.0, x=0.9, law=law)
    model = rs.compile_scene(scene, formulation, minimal)
    assert (model.n_x == 3) == minimal
    assert model.n_z == 1
    found = rs.simulate(model, np.linspace(0, 16, 50), TIGHT["rosenbrock"])
    compare(found, events.coulomb_phases(1.0, 1.0, 0.1, 0.9, static=0.12), axis, 1e-8)


def test_friction_that_holds_needs_an_integrator_for_it() -> None:
    model = rs.compile_scene(block(rs.Friction(0, 0.2, 0.5), 0, 1.0, x=1.0))
    with pytest.raises(ValueError, match="1 algebraic"):
        rs.simulate(model, 1.0, rs.ExplicitRK())


# Stick-slip on a belt: m = 2, k = 50, N = 20, mu_s = 0.5, mu_k = 0.3, V = 0.2.

BELT = {"mass": 2.0, "stiffness": 50.0, "normal": 20.0, "static": 0.5, "kinetic": 0.3, "belt": 0.2}


def on_belt(axis: int, x: float, v: float, law: str = "standard", **options: Any) -> rs.Scene:
    """The block on the belt."""
    friction = rs.Friction(axis, 20.0, 0.3, 0.5, velocity=0.2, **options)
    return block(friction, axis, 50.0, 2.0, x, v, law)


@by_holding
@pytest.mark.parametrize(("x", "v"), [(0.0, 0.2), (0.0, 0.0), (0.05, 0.5)])
def test_stick_slip_on_a_belt(x: float, v: float, method: str) -> None:
    """It sticks from the start, after a slip, after it was faster than the belt."""
    model = rs.compile_scene(on_belt(0, x, v))
    phases = events.belt_phases(6.0, **BELT, x0=x, v0=v)
    found = rs.simulate(model, np.linspace(0, 6, 61), TIGHT[method])
    compare(found, phases, 0, 1e-8)
    slips = [p.start for p in phases if p.mode == "slip" and p.start > 0]
    sticks = [p.start for p in phases if p.mode == "stick" and p.start > 0]
    assert largest(times_of(found, "slips") - slips) < 1e-8
    assert largest(times_of(found, "sticks") - sticks) < 1e-8


@pytest.mark.parametrize(
    ("law", "axis"), [*SOME[:4], ("consistent", 4)]
)
def test_limit_cycle_on_a_belt(law: str, axis: int) -> None:
    cycle = events.belt_cycle(**BELT)
    model = rs.compile_scene(on_belt(axis, 0.0, 0.2, law))
    found = rs.simulate(model, np.linspace(0, 6, 61), TIGHT["rosenbrock"])
    slips, sticks = (times_of(found, name) for name in ("slips", "sticks"))
    assert largest(sticks - slips[: len(sticks)] - cycle.slip) < 1e-8
    assert largest(slips[1:] - sticks[: len(slips) - 1] - cycle.stick) < 1e-8
    x = along(rs.simulate(model, [0, slips[1]], TIGHT["rosenbrock"]), axis)[0][-1]
    assert abs(x - cycle.slip_start) < 1e-8


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


# Plasticity: k = 100, F_y = 80, cycles u = 2.5 sin t, so that u_y = 0.8.

_U, _K, _F = 2.5, 100.0, 80.0
HARDENING = {"perfect": (0.0, 0.0), "kinematic": (25.0, 0.0), "isotropic": (0.0, 12.0),
             "both": (25.0, 12.0)}  # fmt: skip


def cycled(kind: str, law: str = "standard", axis: int = 0) -> rs.Model:
    """The model of a driven plastic connector."""
    plastic = rs.Plastic(axis, _K, _F, *HARDENING[kind])
    return rs.compile_scene(driven(plastic, _U * np.sin(rs.TIME), axis, law))


@pytest.mark.parametrize(
    ("kind", "method", "law", "axis"),
    [*((kind, "dop853", "standard", 0) for kind in HARDENING),
     *(("both", "rosenbrock", *place) for place in SOME),
     ("isotropic", "idas", "standard", 1), ("kinematic", "explicit", "intrinsic", 4)],
)  # fmt: skip
def test_plastic_cycles(kind: str, law: str, axis: int, method: str) -> None:
    """At 64 points a cycle, reversals included, between which the return mapping is exact."""
    t = np.arange(161) * np.pi / 32
    found = rs.simulate(cycled(kind, law, axis), t, TIGHT[method])
    expected = dissipation.elastoplastic(_U * np.sin(t), _K, _F, *HARDENING[kind])
    assert largest(force(found, axis) - expected.force) < 1e-11 * _F
    turns = np.pi * (np.arange(5) + 0.5)
    assert largest(times_of(found, "reverses") - turns) < 1e-12
    if kind == "isotropic":
        peaks = dissipation.isotropic_peaks(5, _U, _K, _F, 12.0)
        assert largest(np.abs(force(found, axis)[16::32]) - peaks) < 1e-9


@pytest.mark.parametrize("kind", ["perfect", "kinematic"])
def test_loss_of_a_plastic_cycle(kind: str) -> None:
    """4 F_y (u_m - u_y) without hardening, from one peak to the next of its kind."""
    start, end = np.pi / 2, 5 * np.pi / 2
    found = balance(cycled(kind), end, TIGHT["explicit"], 0.5)
    first = balance(cycled(kind), start, TIGHT["explicit"], 0.5)
    area = dissipation.kinematic_loop_area(_U, _K, _F, HARDENING[kind][0])
    assert kind != "perfect" or area == pytest.approx(4 * _F * (_U - _F / _K), rel=1e-15)
    assert found.heat - first.heat == pytest.approx(area, rel=1e-9)


@pytest.mark.parametrize("kind", HARDENING)
def test_energy_of_plastic_cycles(kind: str) -> None:
    """Work of the drive, heat and what spring and hardening store, against the oracle's."""
    end, model = 7.0, cycled(kind)
    u = _U * np.sin([np.pi / 2, 3 * np.pi / 2, end])
    expected = dissipation.elastoplastic(u, _K, _F, *HARDENING[kind])
    found = balance(model, end, TIGHT["explicit"], 0.5, drive=0)
    assert found.heat == pytest.approx(expected.dissipated[-1], rel=1e-9)
    assert found.given == pytest.approx(expected.work[-1], rel=1e-9)
    assert abs(found.error) < 1e-9 * found.heat


@pytest.mark.parametrize("x", [2.0, 3.0])
@by_integrator
def test_plastic_spring_let_go_beyond_yield(x: float, method: str) -> None:
    """From rest it unloads elastically about p = (x - 1) / 1.5, until f - H p is -F_y."""
    model = rs.compile_scene(block(rs.Plastic(0, 1.0, 1.0, 0.5), 0, x=x))
    p = (x - 1) / 1.5
    amplitude = x - p
    yields = np.arccos((0.5 * p - 1) / amplitude)
    t = np.linspace(0, yields, 12)
    found = rs.simulate(model, t, TIGHT[method])
    assert largest(along(found, 0)[0] - p - amplitude * np.cos(t)) < 1e-8


# Fracture: m = 2, k = 50 under a load of 3, limit 10 N (at 0.2 m) or 1 J.

LIMITS = {"force": 10.0, "torque": 10.0, "energy": 1.0}


@pytest.mark.parametrize(
    ("law", "axis", "limit", "method"),
    [("standard", 0, "force", "idas"), ("consistent", 1, "energy", "rosenbrock"),
     ("consistent", 4, "torque", "explicit"), ("intrinsic", 3, "energy", "dop853"),
     ("standard", 5, "torque", "rosenbrock")],
)  # fmt: skip
@pytest.mark.parametrize(("x", "v"), [(0.1, 1.1), (-0.15, -0.9)])
def test_fracture(x: float, v: float, law: str, axis: int, limit: str, method: str) -> None:
    """In tension and in compression; it stays broken, and loses limit^2 / (2 k)."""
    broken = rs.Fracture(**{limit: LIMITS[limit]})
    model = rs.compile_scene(block(broken, axis, 50.0, 2.0, x, v, law, pull=3.0))
    phases = events.fracture_phases(2.0, 50.0, 10.0, x, v, 3.0)
    assert len(phases) == 2
    found = rs.simulate(model, np.linspace(0, 1, 41), TIGHT[method])
    compare(found, phases, axis, 1e-9)
    assert [name for _, name in found.events] == ["j.fracture_breaks"]
    assert abs(found.events[0][0] - phases[1].start) < 1e-10
    after = found.t > phases[1].start
    assert largest(force(found, axis)[after]) < 1e-12
    assert largest(found["j.potential_energy"][after]) < 1e-12
    assert largest(found["j.fracture_broken"] - after) < 1e-12
    assert found["j.fracture_lost"][-1] == pytest.approx(1.0, rel=1e-9)


def test_fracture_below_its_limits_does_not_happen() -> None:
    phases = events.fracture_phases(2.0, 50.0, 10.0, 0.19, 0.0)
    assert len(phases) == 1
    model = rs.compile_scene(block(rs.Fracture(10.0, 1.0, 1.0), 0, 50.0, 2.0, 0.19))
    found = rs.simulate(model, np.linspace(0, 3, 31), TIGHT["rosenbrock"])
    compare(found, phases, 0, 1e-9)
    assert found.events == ()


def test_first_of_three_limits_breaks() -> None:
    """The torque limit of 1 N m at an angle of 0.02 rad, long before force and energy."""
    model = rs.compile_scene(block(rs.Fracture(10.0, 1.0, 1.0), 3, 50.0, 2.0, 0.0, 1.0))
    found = rs.simulate(model, np.linspace(0, 0.1, 31), TIGHT["rosenbrock"])
    assert found.events[0][0] == pytest.approx(np.arcsin(0.02 * 5) / 5, rel=1e-9)


# Maxwell branches.

BRANCHES = [(40.0, 8.0), (15.0, 0.5), (5.0, 30.0)]


def maxwell(axis: int) -> list[rs.Maxwell]:
    """The branches as effects."""
    return [rs.Maxwell(axis, k, c, f"m{i}") for i, (k, c) in enumerate(BRANCHES)]


@pytest.mark.parametrize(("law", "axis"), [("standard", 0), ("intrinsic", 3), ("consistent", 4)])
def test_maxwell_relaxation_and_sine(law: str, axis: int) -> None:
    """A step of 0.3 loads the branches by k_i 0.3 at once; a sine, the storage and loss modulus."""
    t = np.linspace(0, 2, 21)
    step = rs.compile_scene(driven(maxwell(axis), 0.3 + 0 * rs.TIME, axis, law, 20.0))
    start = {f"j.m{i}_force": 0.3 * k for i, (k, _) in enumerate(BRANCHES)}
    found = rs.simulate(step, t, TIGHT["rosenbrock"], start=start)
    relaxed = dissipation.maxwell_relaxation(t, 20.0, BRANCHES, 0.3)
    assert largest(force(found, axis) - relaxed) < 1e-8
    model = rs.compile_scene(driven(maxwell(axis), 0.3 * np.sin(4 * rs.TIME), axis, law, 20.0))
    found = rs.simulate(model, t, TIGHT["rosenbrock"])
    assert largest(force(found, axis) - dissipation.maxwell_sine(t, 20.0, BRANCHES, 4, 0.3)) < 1e-8


@pytest.mark.parametrize(
    ("method", "law", "axis"), [*((method, "standard", 1) for method in TIGHT),
                                ("idas", "consistent", 3)],
)  # fmt: skip
def test_maxwell_oscillator(law: str, axis: int, method: str) -> None:
    t = np.linspace(0, 3, 31)
    model = rs.compile_scene(block(maxwell(axis), axis, 20.0, 1.5, 0.4, -1.0, law))
    found = rs.simulate(model, t, TIGHT[method])
    x, v, *f = dissipation.maxwell_oscillator(t, 1.5, 20.0, BRANCHES, 0.4, -1.0).T
    assert largest(along(found, axis)[0] - x) < 1e-8
    assert largest(along(found, axis)[1] - v) < 1e-8
    for i in range(3):
        assert largest(found[f"j.m{i}_force"] - f[i]) < 1e-7


def test_loss_of_a_steady_maxwell_cycle() -> None:
    """The slowest branch, 6 s, has forgotten the start after 150 s, to e^-25 = 1e-11."""
    model = rs.compile_scene(driven(maxwell(0), 0.3 * np.sin(4 * rs.TIME), 0, "standard", 20.0))
    first = rs.simulate(model, [0, 48 * np.pi], TIGHT["rosenbrock"])
    start = {f"j.m{i}_force": first[f"j.m{i}_force"][-1] for i in range(3)}
    t = np.linspace(0, np.pi / 2, 65)
    found = rs.simulate(model, t, TIGHT["rosenbrock"], start=start)
    loss = found["j.dissipated_power"][:-1].mean() * np.pi / 2  # exact for few harmonics
    assert loss == pytest.approx(dissipation.maxwell_cycle_loss(4.0, 0.3, BRANCHES), rel=1e-8)


# Springs that are not linear.


def spring(effect: Any, law: str, axis: int) -> Any:
    """A function of strains: force and energy of an effect alone."""
    model = rs.compile_scene(block(effect, axis, x=0.3, v=0.1, law=law))
    name, place = "force_local" if axis < 3 else "torque_local", names(axis)[0].replace(".", "__")

    def values(x: Any) -> tuple[np.ndarray, np.ndarray]:
        f = evaluate(model, f"j.{name}", **{place: x})[:, axis % 3]
        return f, evaluate(model, "j.potential_energy", **{place: x})[:, 0]

    return values


@somewhere
def test_cubic_spring(law: str, axis: int) -> None:
    x = np.linspace(-1.4, 1.4, 15)
    f, energy = spring(rs.Cubic(axis, 7.0, -2.0), law, axis)(x)
    assert largest(f - (7 * x**3 - 2 * x)) < 1e-13 * 30
    assert largest(energy - (7 * x**4 / 4 - x**2)) < 1e-13 * 30


KNOTS = np.array([-1.0, -0.6, -0.5, 0.1, 0.4, 1.1])
VALUES = np.array([-3.0, -2.5, 0.3, 0.2, 1.0, 4.0])


def test_table_is_the_natural_cubic_spline() -> None:
    """Through its points, C2 there, cubic between, straight beyond: that is only one curve."""
    at = spring(rs.Table(0, KNOTS, VALUES), "standard", 0)
    assert largest(at(KNOTS)[0] - VALUES) < 1e-13
    for a, b in pairwise(KNOTS):
        f = at(np.linspace(a, b, 5))[0]
        assert abs(f @ [1, -4, 6, -4, 1]) < 1e-12  # fourth difference of a cubic
    h = 1e-3
    for knot in KNOTS:
        left, right = (at(knot + side * h * np.arange(4))[0] for side in (-1, 1))
        slopes = [side * f @ [-11, 18, -9, 2] / (6 * h) for side, f in ((-1, left), (1, right))]
        bends = [f @ [2, -5, 4, -1] / h**2 for f in (left, right)]  # both exact for cubics
        assert slopes[0] == pytest.approx(slopes[1], abs=1e-9)
        assert bends[0] == pytest.approx(bends[1], abs=1e-6)
    for end, side in ((KNOTS[0], -1), (KNOTS[-1], 1)):
        f = at(end + side * np.array([0.0, 0.5, 1.0, 2.0, 4.0]))[0]
        assert largest(np.diff(f) / [0.5, 0.5, 1, 2] - (f[1] - f[0]) / 0.5) < 1e-12


@somewhere
def test_energy_of_a_table_is_the_integral_of_its_force(law: str, axis: int) -> None:
    """Five-point Gauss is exact in each piece; zero at the first strain."""
    at = spring(rs.Table(axis, KNOTS, VALUES), law, axis)
    y, w = np.polynomial.legendre.leggauss(5)
    total = 0.0
    for a, b in pairwise([*KNOTS, 1.3]):
        total += (b - a) / 2 * w @ at((a + b) / 2 + (b - a) / 2 * y)[0]
        assert at(b)[1][0] == pytest.approx(total, rel=1e-12)
    f, energy = at([KNOTS[0], -1.4])
    assert energy[0] == 0
    assert energy[1] == pytest.approx(-0.4 * f.mean(), rel=1e-12)


def test_oscillation_on_a_table_keeps_its_energy() -> None:
    model = rs.compile_scene(block(rs.Table(2, KNOTS, 5 * KNOTS), 2, x=0.8))
    found = rs.simulate(model, np.linspace(0, 5, 21), TIGHT["explicit"])
    assert largest(along(found, 2)[0] - 0.8 * np.cos(np.sqrt(5) * found.t)) < 1e-8
    assert largest(np.diff(found["energy"])) < 1e-8


# Bristles: N = 10, mu_k = 0.3, mu_s = 0.5.


def bristles(axis: int, **options: Any) -> rs.LuGre:
    given = {"stribeck": 0.01, "stiffness": 1e4, "damping": 50.0, "viscous": 0.4} | options
    return rs.LuGre(axis, 10.0, 0.3, 0.5, **given)


@pytest.mark.parametrize(("law", "axis"), [("standard", 0), ("intrinsic", 3), ("consistent", 4)])
def test_steady_sliding_on_bristles(law: str, axis: int) -> None:
    """f = g(v) + s2 v, and b = g / s0; |v| is too small by (v_s / 1000 v)^2 / 2 = 5e-9 at most."""
    speed = rs.Param("speed", 0.01)
    model = rs.compile_scene(driven(bristles(axis), speed * rs.TIME, axis, law))
    state = next(label.name for label in model.x_labels if label.name.endswith("bristle"))
    for v in (0.01, -0.02, 0.3):
        found = rs.simulate(model, [0, 0.6], TIGHT["rosenbrock"], params={"speed": v})
        limit = 3 + 2 * np.exp(-((v / 0.01) ** 2))
        assert force(found, axis)[-1] == pytest.approx(np.sign(v) * limit + 0.4 * v, rel=1e-6)
        assert found[state][-1] == pytest.approx(np.sign(v) * limit / 1e4, rel=1e-6)


@pytest.mark.parametrize("pull", [2.9, 4.9, -4.9])
def test_bristles_hold_below_the_static_limit(pull: float) -> None:
    """Under a load that comes slowly they bend by f / s0 and stay; beyond the limit they let go."""
    slowly = np.tanh(rs.TIME)
    model = rs.compile_scene(block(bristles(0), 0, pull=pull * slowly))
    t = np.linspace(0, 20, 41)
    x, v = along(rs.simulate(model, t, TIGHT["idas"]), 0)
    bent = abs(pull) / 1e4
    assert abs(x[-1] - x[-2]) < 1e-9
    assert abs(v[-1]) < 1e-9
    # An elastic part f / s0, and what slips while it swings in.
    assert bent < abs(x[-1]) < 20 * bent
    loose = rs.compile_scene(block(bristles(0), 0, pull=5.1 * np.sign(pull) * slowly))
    assert abs(along(rs.simulate(loose, [0, 5], TIGHT["idas"]), 0)[0][-1]) > 1


def test_bristles_let_go_under_a_slow_load() -> None:
    """1 N/s on bristles of 1 MN/m bends them by 1e-6 m/s, v_s / 10,000; mu_s N is 5 N."""
    stiff = bristles(0, stiffness=1e6, damping=1e3)
    model = rs.compile_scene(block(stiff, 0, pull=1.0 * rs.TIME))
    found = rs.simulate(model, np.linspace(0, 7, 71), rs.Idas(1e-8, 1e-12))
    assert 4.9 < force(found, 0).max() < 5.001
    assert along(found, 0)[0][-1] > 1


def test_bristles_stay_within_bounds_and_heat() -> None:
    """|s0 b| <= mu_s N whatever the way; a cycle heats by the way times a force of 3 to 5 N."""
    path = 0.02 * np.sin(3 * rs.TIME) + 0.005 * np.sin(31 * rs.TIME)
    model = rs.compile_scene(driven(bristles(0, damping=0.0, viscous=0.0), path))
    t = np.linspace(0, 2 * np.pi, 2001)
    found = rs.simulate(model, t, TIGHT["rosenbrock"])
    assert 3.0 < largest(force(found, 0)) < 5.0
    way = np.abs(np.diff(along(found, 0)[0])).sum()
    power = found["j.dissipated_power"]
    assert power.min() >= 0
    heat = power.mean() * t[-1]
    assert 0.8 * 3 * way < heat < 5 * way


# Numbers that are symbols, and effects side by side.


def test_numbers_of_effects_are_params_and_inputs() -> None:
    """The sliding distance v^2 / (2 mu g) for any mu, and with a normal force that ramps up."""
    mu, normal = rs.Param("mu", 0.5), rs.Input("normal", "N", 9.81)
    model = rs.compile_scene(block(rs.Friction(0, normal, mu), v=2.0))
    assert [label.name for label in model.dae.p_labels] == ["mu"]
    assert [label.name for label in model.dae.u_labels] == ["normal"]
    for value in (0.5, 0.1):
        end = 1.5 * 2 / (value * 9.81)
        found = rs.simulate(model, [0, end], TIGHT["rosenbrock"], params={"mu": value})
        assert along(found, 0)[0][-1] == pytest.approx(4 / (2 * value * 9.81), rel=1e-9)
    # v = 2 - mu 10 t^2 / 2 is zero at t^2 = 0.8, x = 2 t - 2.5 t^3 / 3.
    ramp = {"normal": lambda t: 10 * t}
    found = rs.simulate(model, [0, 1.2], TIGHT["idas"], inputs=ramp)
    stop = np.sqrt(0.8)
    assert times_of(found, "sticks")[0] == pytest.approx(stop, rel=1e-7)
    assert along(found, 0)[0][-1] == pytest.approx(2 * stop - 2.5 * stop**3 / 3, rel=1e-7)


def test_stiffness_and_limits_are_params() -> None:
    """Depth of a contact and the instant of a fracture follow the values of a run."""
    k, limit = rs.Param("k", 1e4), rs.Param("limit", 10.0)
    model = rs.compile_scene(block(rs.Contact(2, k), 2, x=0.1, pull=-9.81))
    for value in (1e4, 1e6):
        contact = events.drop_contact(1.0, value, 0.1, 9.81)
        t = [0, np.sqrt(0.2 / 9.81) + contact.duration / 2]
        found = rs.simulate(model, t, TIGHT["explicit"], params={"k": value})
        assert along(found, 2)[0][-1] == pytest.approx(-contact.depth, rel=1e-9)
    model = rs.compile_scene(block(rs.Fracture(limit), 0, 50.0, 2.0, v=1.5))
    for value in (10.0, 12.0):
        found = rs.simulate(model, [0, 1], TIGHT["explicit"], params={"limit": value})
        when = events.fracture_phases(2.0, 50.0, value, 0.0, 1.5)[1].start
        assert found.events[0][0] == pytest.approx(when, rel=1e-9)


FLOOR = [rs.Contact(2, 1e5, 50.0), rs.Friction(0, "contact_z", 0.4, name="along_x"),
         rs.Friction(1, "contact_z", 0.4, name="along_y")]  # fmt: skip


def test_block_slides_to_rest_on_a_floor() -> None:
    """Contact and friction along x and y in one connector: v^2 / (2 mu g) along each axis.

    Friction is that of each axis, not of a disc. The block lies m g / k deep from the start, so
    that the push is m g to integration's error.
    """
    g, (v_x, v_y) = 9.81, (1.5, -0.8)
    body = rs.RigidBody("b", 3.0, [1.0] * 3, position=(0, 0, -3 * g / 1e5), velocity=(v_x, v_y, 0))
    joint = rs.RigidBodySpringDamper("j", rs.Marker(rs.GROUND), rs.Marker("b"), 0, effects=FLOOR)
    model = rs.compile_scene(rs.Scene("floor", [body], [joint], gravity=(0, 0, -g)))
    assert model.n_z == 2
    found = rs.simulate(model, np.linspace(0, 0.6, 7), TIGHT["rosenbrock"])
    assert found["j.along_x"][1] == pytest.approx(0.4 * 3 * g, rel=1e-7)
    assert found["j.along_y"][1] == pytest.approx(-0.4 * 3 * g, rel=1e-7)
    assert found["j.contact_z"] == pytest.approx(-3 * g * np.ones(7), rel=1e-7)
    assert found["b.p_x"][-1] == pytest.approx(v_x**2 / (0.8 * g), rel=1e-8)
    assert found["b.p_y"][-1] == pytest.approx(-(v_y**2) / (0.8 * g), rel=1e-8)
    assert times_of(found, "along_y_sticks")[0] == pytest.approx(0.8 / (0.4 * g), rel=1e-8)
    assert abs(found["j.along_x_mode"][-1]) < 1e-9
    assert abs(found["j.along_y_mode"][-1]) < 1e-9


@by_holding
def test_friction_feels_the_push_of_bounces(method: str) -> None:
    """A bounce pushes by 2 m u + m g T, and takes mu times that of the speed along the floor."""
    g, c = 9.81, events.drop_contact(1.0, 1e4, 0.1, 9.81)
    body = rs.RigidBody("b", 1.0, [1.0] * 3, position=(0, 0, 0.1), velocity=(3.0, 0, 0))
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND), rs.Marker("b"), 0,
        effects=[rs.Contact(2, 1e4), rs.Friction(0, "contact_z", 0.2)],
    )  # fmt: skip
    model = rs.compile_scene(rs.Scene("bounces", [body], [joint], gravity=(0, 0, -g)))
    found = rs.simulate(model, [0, 0.1, 0.3, 0.6, 0.9], TIGHT[method])
    taken = 0.2 * (2 * c.rebound + g * c.duration)
    assert largest(found["b.v_x"] - 3.0 + taken * np.array([0, 0, 1, 2, 3])) < 1e-7


@pytest.mark.parametrize("method", ["rosenbrock", "explicit"])
def test_three_axes_do_not_feel_each_other(method: str) -> None:
    """Plastic, Maxwell and Contact beside each other move as each of them alone."""
    effects = [rs.Plastic(0, 3.0, 0.5, 1.0), rs.Maxwell(1, 4.0, 2.0), rs.Contact(2, 50.0, 1.0)]
    t = np.linspace(0, 4, 21)
    start, v = (0.0, 0.1, 0.2), (1.0, 0.5, -0.3)
    body = rs.RigidBody("b", 1.0, [1.0] * 3, position=start, velocity=v)
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND), rs.Marker("b"), [1, 1, 1, 0, 0, 0], effects=effects
    )
    together = rs.simulate(
        rs.compile_scene(rs.Scene("three", [body], [joint])), t, TIGHT[method]
    )["b.position"]
    for axis, effect in enumerate(effects):
        alone = rs.compile_scene(block(effect, axis, 1.0, 1.0, start[axis], v[axis]))
        found = along(rs.simulate(alone, t, TIGHT[method]), axis)[0]
        assert largest(found - together[:, axis]) < 1e-7


def test_effects_of_connectors_of_one_kind_keep_their_own_numbers() -> None:
    """Two blocks on frictions of one structure and other numbers, in one scene."""
    bodies, joints = [], []
    for i, (mu, v) in enumerate(((0.2, 1.0), (0.5, -2.0))):
        bodies.append(rs.RigidBody(f"b{i}", 1.0, [1.0] * 3, velocity=v * unit(0)[:3]))
        joints.append(rs.RigidBodySpringDamper(
            f"j{i}", rs.Marker(rs.GROUND), rs.Marker(f"b{i}"), 0, effects=rs.Friction(0, 10.0, mu)
        ))  # fmt: skip
    found = rs.simulate(
        rs.compile_scene(rs.Scene("two", bodies, joints)), [0, 1.0], TIGHT["rosenbrock"]
    )
    assert found["b0.p_x"][-1] == pytest.approx(1 / 4, rel=1e-8)
    assert found["b1.p_x"][-1] == pytest.approx(-4 / 10, rel=1e-8)
