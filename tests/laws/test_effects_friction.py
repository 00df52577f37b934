"""Coulomb friction, stick-slip on a belt and bristles against closed forms.

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
from scenes.effects import HOLDING, SOME, TIGHT, along, block, compare, driven, force, times_of
from scenes.small import LAWS

import rbsd_sym as rs

EVERYWHERE = [(law, axis) for law in LAWS for axis in range(6)]
everywhere = pytest.mark.parametrize(("law", "axis"), EVERYWHERE)
by_holding = pytest.mark.parametrize("method", HOLDING)
# A motion along one axis is what counts here, not whether a spring without the others is stable.
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


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
