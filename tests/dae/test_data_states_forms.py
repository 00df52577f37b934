"""Models with data states and events in all forms: minimal, full, kernels, C, files, digests.

Minimal and full models are integrated by the same method at rtol 1e-10; their steps differ, so that
1e-8 of the size of each quantity is what they may differ by.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scenes.data import TIGHT, compiled, names
from scenes.events import Seen, ball, body, joint, names_of, watch
from scenes.plane import carried, shuffled, some_rotation

import rbsd_sym as rs

CLOSE = 1e-8
# Free bodies and frictionless hits: what is left out may well be unstable.
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


# Minimal and full models agree.


def pendulum() -> rs.Scene:
    """It swings in the xy plane into a stop, which throws it back and counts."""
    link = body(mass=1.0, inertia=(0.01, 0.1, 0.1), position=(0.5, 0, 0))
    hinge = joint(
        marker1=rs.Marker("b", (-0.5, 0, 0)), stiffness=[1e3] * 3 + [0] * 3,
        damping=[10] * 3 + [0] * 3, law=rs.Consistent(), data=[0.0],
        function=lambda s: [rs.Event(s.th[2] + 1, -1, [s.data[0] + 1],
                                     [0, 0, 0, 0, 0, 0.18 * s.w[2]], name="stop")],
    )  # fmt: skip
    return rs.Scene("pendulum", [link], [hinge], gravity=(0, -9.81, 0))


def tumbling() -> rs.Scene:
    """A box that falls on two of its corners, one after the other."""
    box = body(mass=2.0, inertia=(0.1, 0.2, 0.25), position=(0, 0, 1), velocity=(0.3, 0.1, 0),
               angular_velocity=(0.5, 0.2, 0.1))  # fmt: skip
    corners = [
        joint(f"f{i}", marker1=rs.Marker("b", p), effects=rs.Impact(2, 0.6))
        for i, p in enumerate([(0.2, 0.1, -0.3), (-0.2, 0.1, -0.3)])
    ]
    return rs.Scene("tumbling", [box], corners, gravity=(0, 0, -9.81))


def relay() -> rs.Scene:
    """Two bodies on a spring; a thermostat with hysteresis pushes the first."""
    bodies = [body("a"), body("b", mass=2.0, position=(1, 0, 0))]
    spring = joint("k", "b", marker0=rs.Marker("a"), stiffness=[50] * 6, offset=[1, 0, 0, 0, 0, 0])
    push = joint(
        "c", "a", lambda s: [rs.Event(s.u[0] - 0.05, 1, [-1]), rs.Event(s.u[0] + 0.05, -1, [1])],
        force=lambda m, t, i, data, *rest: [-data[0], 0, 0, 0, 0, 0], data=[1.0],
    )  # fmt: skip
    return rs.Scene("relay", bodies, [spring, push])


COMPARED = ("position", "rotation_matrix", "velocity", "angular_velocity", "force_local", "torque1",
            "rotation", "energy", "momentum", "angular_momentum")  # fmt: skip
SCENES = {"pendulum": (pendulum, 0.7, 2), "tumbling": (tumbling, 0.6, 1), "relay": (relay, 4.0, 3)}
TILT = some_rotation(np.random.default_rng(3))


def compare(small: rs.Model, full: rs.Model, times: Any, method: str, events: int) -> None:
    """Events, data and outputs of two models of the same scene."""
    a, b = (rs.simulate(model, times, TIGHT[method]) for model in (small, full))
    assert names_of(a) == names_of(b)
    assert len(a.events) >= events
    # 1e-8 of a second, over stiff joints: events are known as well as the states are.
    np.testing.assert_allclose([t for t, _ in a.events], [t for t, _ in b.events], atol=CLOSE)
    compared = [o for o in small.dae.outputs if o.split(".")[-1] in COMPARED]
    for name in (*compared, *names(full)):
        x, y = a[name], b[name]
        if name.split(".")[-1].startswith("q_"):  # of either sign
            x, y = np.abs(x), np.abs(y)
        size = max(1.0, float(np.abs(y).max()))
        assert np.abs(x - y).max() < 10 * CLOSE * size, name


@pytest.mark.parametrize(("name", "method"), [
    ("pendulum", "idas"), ("pendulum", "rosenbrock"), ("pendulum", "explicit"),
    ("tumbling", "explicit"), ("relay", "rosenbrock"),
])  # fmt: skip
def test_minimal_equals_full(name: str, method: str) -> None:
    make, end, events = SCENES[name]
    small, full = rs.compile_scene(make()), rs.compile_scene(make(), minimal=False)
    assert small.n_x < full.n_x
    compare(small, full, np.linspace(0, end, 12), method, events)


@pytest.mark.parametrize("name", ["pendulum", "tumbling"])
def test_minimal_equals_full_in_angles(name: str) -> None:
    make, end, events = SCENES[name]
    small, full = (rs.compile_scene(make(), rs.TaitBryan(), minimal=m) for m in (True, False))
    assert small.n_x < full.n_x
    compare(small, full, np.linspace(0, end, 12), "explicit", events)


def test_a_quaternion_becomes_an_angle_beside_events() -> None:
    kept = ["b.p_x", "b.p_y", "b.angle_z", "b.v_x", "b.v_y", "b.w_z", "c.data_0"]
    assert names(rs.compile_scene(pendulum())) == kept


def test_events_in_a_tilted_plane() -> None:
    """With any body axes: the same small model, events and data as in the world's plane."""
    scene = shuffled(pendulum(), 0)
    tilted, plain = rs.compile_scene(scene), rs.compile_scene(pendulum())
    assert tilted.n_x == plain.n_x == 7
    times = np.linspace(0, 0.7, 8)
    compare(tilted, rs.compile_scene(scene, minimal=False), times, "explicit", 2)
    a, b = (rs.simulate(model, times, TIGHT["explicit"]) for model in (tilted, plain))
    np.testing.assert_allclose([t for t, _ in a.events], [t for t, _ in b.events], atol=CLOSE)
    np.testing.assert_array_equal(a["c.data_0"], b["c.data_0"])
    np.testing.assert_allclose(a["energy"], b["energy"], atol=CLOSE)


def test_a_carried_scene_hits_alike() -> None:
    """A floor that is tilted with all the rest."""
    times = np.linspace(0, 0.6, 4)
    a, b = (rs.simulate(rs.compile_scene(scene), times, TIGHT["explicit"])
            for scene in (tumbling(), carried(tumbling(), TILT, (1, 2, 3))))  # fmt: skip
    assert names_of(a) == names_of(b)
    np.testing.assert_allclose([t for t, _ in a.events], [t for t, _ in b.events], atol=CLOSE)
    np.testing.assert_allclose(a["f0.impact_z_lost"], b["f0.impact_z_lost"], atol=CLOSE)


@pytest.mark.parametrize(("name", "method"), [
    ("pendulum", "explicit"), ("relay", "idas"), ("tumbling", "rosenbrock"),
])  # fmt: skip
def test_kernels_equal_flat(name: str, method: str) -> None:
    """The same numbers, but for the order of sums."""
    make, end, _ = SCENES[name]
    flat, mapped = (rs.compile_scene(make(), layout=layout) for layout in ("flat", "kernels"))
    assert (flat.kernels, mapped.kernels) == (False, True)
    a, b = (rs.simulate(model, [0, end / 2, end], TIGHT[method]) for model in (flat, mapped))
    assert names_of(a) == names_of(b)
    np.testing.assert_allclose([t for t, _ in a.events], [t for t, _ in b.events], atol=CLOSE)
    for state in names(flat):
        np.testing.assert_allclose(a[state], b[state], atol=10 * CLOSE, err_msg=state)


# Files, C, digests.


def everything() -> rs.Scene:
    """Data, events both ways, impacts, contacts, post-Newton steps, a Param and friction."""
    limit = rs.Param("limit", 0.3, "m")
    busy = joint(
        data=[0.1, 0.2], force=lambda m, t, i, d, u, *rest: [5 * (u[0] - d[1]), 0, 0, 0, 0, d[0]],
        post_newton_step=lambda m, t, i, d, u, *rest: [0.0, -1.0, d[0], u[1] * d[1]],
        function=lambda s: [rs.Event(s.u[0] - limit, 0, [s.data[0], s.u[1]],
                                     [s.v[0], 0, 0, 0, 0, 1])],
    )  # fmt: skip
    hard = joint("f", "d", effects=[rs.Impact(2, 0.7, gap=-0.2), rs.Contact(0, 100.0, 3.0)])
    rough = joint("g", "d", effects=rs.Friction(1, 3.0, 0.3, 0.4), stiffness=[0, 9, 0, 0, 0, 0])
    bodies = [body(velocity=(1, 0.2, 0)), body("d", position=(0, 0.5, 1), velocity=(0.1, 0, 0))]
    return rs.Scene("everything", bodies, [busy, hard, rough], gravity=(0, 0, -9.81))


FUNCTIONS = ["ode", "zero", "jump", "post_newton", "zero_rate"]


@pytest.mark.skipif(not shutil.which("gcc"), reason="needs a C compiler")
@pytest.mark.parametrize(
    "layout",
    [
        "flat",
        "kernels",
    ],
)
def test_c_gives_the_numbers_of_python(layout: str, tmp_path: Path) -> None:
    """To rounding: gcc may order sums otherwise."""
    model = rs.compile_scene(everything(), layout=layout)
    library = rs.load_c(rs.export_c(model, tmp_path, functions=FUNCTIONS), model)
    rng = np.random.default_rng(1)
    start = np.array([v.start for v in model.x_labels])
    for _ in range(5):
        x, z = start + rng.standard_normal(model.n_x), rng.standard_normal(model.n_z)
        for name in FUNCTIONS:
            given = (rng.random(), x, z, [], [0.3 + rng.random()])
            same(model.function(name)(*given), library.function(name)(*given), name)


def same(a: Any, b: Any, name: str) -> None:
    a, b = np.array(ca.DM(a)), np.array(ca.DM(b))
    assert a.shape == b.shape, name
    np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12, err_msg=name)


def test_functions_of_kernels_are_those_of_the_flat_layout() -> None:
    flat, mapped = (rs.compile_scene(everything(), layout=how) for how in ("flat", "kernels"))
    rng = np.random.default_rng(2)
    start = np.array([v.start for v in flat.x_labels])
    for _ in range(3):
        x, z = start + rng.standard_normal(flat.n_x), rng.standard_normal(flat.n_z)
        for name in FUNCTIONS:
            given = (rng.random(), x, z, [], [0.3 + rng.random()])
            same(flat.function(name)(*given), mapped.function(name)(*given), name)


def test_a_saved_trajectory_keeps_its_events(tmp_path: Path) -> None:
    found = rs.simulate(rs.compile_scene(relay()), 2.0, rs.ExplicitRK())
    loaded = rs.Trajectory.load(found.save(tmp_path / "run"))
    assert len(found.events) > 1
    assert loaded.events == found.events
    np.testing.assert_array_equal(loaded["c.data_0"], found["c.data_0"])
    assert loaded.state_at_end == found.state_at_end
    stopped = rs.simulate(ball(lambda s: [rs.Event(s.u[2], stop=True)]), 1.0)
    assert rs.Trajectory.load(stopped.save(tmp_path / "stop")).outcome is rs.Outcome.event


LEAN = rs.Contact(2, 100.0)
CHANGES: dict[str, tuple[Any, Any]] = {
    "effect's number": ({"effects": LEAN}, {"effects": replace(LEAN, stiffness=101.0)}),
    "effect's side": ({"effects": LEAN}, {"effects": replace(LEAN, side=-1)}),
    "effect's name": ({"effects": LEAN}, {"effects": replace(LEAN, name="stop")}),
    "order of effects": ({"effects": [LEAN, rs.Impact(0, 0.5)]},
                         {"effects": [rs.Impact(0, 0.5), LEAN]}),
    "start of data": ({"data": [1.0]}, {"data": [2.0]}),
    "post-Newton step": ({"post_newton_step": lambda *a: [0, -1, a[3][0]]},
                         {"post_newton_step": lambda *a: [0, -1, 2 * a[3][0]]}),
}  # fmt: skip
EVENTS: dict[str, Callable[[Seen], rs.Event]] = {
    "plain": lambda s: rs.Event(s.u[0], data=[1.0]),
    "zero": lambda s: rs.Event(s.u[0] - 1e-9, data=[1.0]),
    "direction": lambda s: rs.Event(s.u[0], 1, data=[1.0]),
    "data": lambda s: rs.Event(s.u[0], data=[2.0]),
    "impulse": lambda s: rs.Event(s.u[0], data=[1.0], impulse=[1, 0, 0, 0, 0, 0]),
    "at_once": lambda s: rs.Event(s.u[0], data=[1.0], at_once=True),
    "stop": lambda s: rs.Event(s.u[0], data=[1.0], stop=True),
    "name": lambda s: rs.Event(s.u[0], data=[1.0], name="mark"),
}


def digest(**connector: Any) -> str:
    return compiled([body(velocity=(1, 0, 0))], [joint(**({"data": [0.0]} | connector))]).digest


@pytest.mark.parametrize("what", CHANGES)
def test_the_digest_tells_connectors_apart(what: str) -> None:
    before, after = CHANGES[what]
    assert digest(**before) == digest(**before)
    assert digest(**before) != digest(**after)


def test_the_digest_tells_events_apart() -> None:
    digests = {what: digest(events=watch(lambda s, e=event: [e(s)]))
               for what, event in EVENTS.items()}  # fmt: skip
    assert len(set(digests.values())) == len(EVENTS)
    again = digest(events=watch(lambda s: [rs.Event(s.u[0], data=[1.0])]))
    assert again == digests["plain"]
