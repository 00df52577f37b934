"""Scenes in other axes: the same motion, and planar motion found in any plane and any body axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.comparing import by_name
from scenes.plane import FORMULATIONS, carried, reframed, shuffled, sizes, some_rotation, unit
from scenes.small import EYE, LAWS, Array, chain

import rbsd_sym as rs
from rbsd_sym.base.checks import at_default
from rbsd_sym.dae.members import RotationKind
from rbsd_sym.formulations.layout import Layout
from rbsd_sym.formulations.plane import Plane, planes, written_in

CYCLIC = EYE[[2, 0, 1]]  # R x = y, R y = z, R z = x


# The same motion.


def user_force(mbs: Any, t: Any, i: Any, u: Any, th: Any, v: Any, w: Any, K: Any, D: Any,
               A0: Any, A1: Any, offset: Any) -> list[Any]:  # fmt: skip
    """A spring whose force leans on the world's x axis and on both joint frames."""
    return [
        50 * u[0] + 3 * A0[0][1],
        40 * u[1],
        30 * u[2] * A1[2][2],
        2 * th[0],
        3 * A0[1][0],
        w[2],
    ]


def busy_scene(seed: int) -> rs.Scene:
    """Two bodies, every law, a user force, loads in both frames, Params, an Input and the time."""
    rng = np.random.default_rng(seed)
    g, a, push = rs.Param("g", 9.81), rs.Param("a", 0.3, "m"), rs.Input("push", "N", 2.0)
    shapes = [some_rotation(rng) for _ in range(2)]
    bodies = [
        rs.RigidBody(
            name, 1.5 + i, shapes[i] @ np.diag([1.0, 1.5, 2.0]) @ shapes[i].T,
            com=0.3 * rng.standard_normal(3) + [a if i else 0.1, 0, 0],
            position=rng.standard_normal(3),
            rotation=-unit(rng) if i else some_rotation(rng), velocity=rng.standard_normal(3),
            angular_velocity=rng.standard_normal(3),
        )
        for i, name in enumerate("AB")
    ]  # fmt: skip

    def marker(body: str, position: Any = None) -> rs.Marker:
        place = rng.standard_normal(3) if position is None else position
        return rs.Marker(body, place, unit(rng) if rng.random() < 0.5 else some_rotation(rng))

    driven = rs.Marker(
        rs.GROUND, [np.sin(rs.TIME), a / 4 - 2 * a, 1.0],
        [np.cos(rs.TIME), 0.6 * np.sin(rs.TIME), 0, 0.8 * np.sin(rs.TIME)],
    )  # fmt: skip
    swung = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
    ends = [
        (marker(rs.GROUND), marker("A")),
        (marker("A"), marker("B")),
        (marker("B", [a, 0.2, 2 * a + 1]), driven),
        (rs.Marker("A", (0, a, 1), swung), marker("B")),
    ]
    connectors = [
        rs.RigidBodySpringDamper(
            f"c{i}", *pair, 20 * rng.random(6) + 5, rng.random(6), 0.1 * rng.standard_normal(6),
            [0.1, 0, 0.2, 0, 0.1, 0], some_rotation(rng), unit(rng), law=law, force=force,
        )
        for i, (pair, law, force) in enumerate(
            zip(ends, [*LAWS.values(), rs.Consistent()], [None] * 3 + [user_force], strict=True))
    ]  # fmt: skip
    loads = [
        rs.Load("wind", marker("A"), (1, push, -2 * push), (0, 1, push)),
        rs.Load("jet", marker("B"), (push, 1, 0), (1, 0, 2), frame="body"),
        rs.Load("nothing", marker(rs.GROUND), (1, 0, 0)),
    ]
    return rs.Scene("busy", bodies, connectors, loads, gravity=[g * v for v in unit(rng, 3)])


def returned(plane: Plane, formulation: Any) -> ca.Function:
    """Function (x of the new scene, its rate) -> (x of the original scene, its rate)."""
    layout = Layout(plane.scene, formulation)
    n = layout.size * len(plane.scene.bodies)
    x, rate = ca.SX.sym("x", n), ca.SX.sym("rate", n)
    back = plane.way_back(layout, x)
    return ca.Function("back", [x, rate], [back, ca.jtimes(back, x, rate)])


def random_states(rng: np.random.Generator, formulation: Any, bodies: int = 2) -> Array:
    """Tait-Bryan angles within 0.7 rad, which keeps clear of the singularity."""
    parts = []
    for _ in range(bodies):
        quaternion = formulation.kind is RotationKind.quaternion
        rotation = unit(rng) if quaternion else 0.7 * rng.uniform(-1, 1, 3)
        parts += [rng.standard_normal(3), rotation, rng.standard_normal(6)]
    return np.concatenate(parts)


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
@pytest.mark.parametrize("seed", range(2))
def test_a_scene_in_other_axes_moves_alike(seed: int, formulation: Any) -> None:
    """Rates of all states, wrenches, and the start, at random states and values."""
    rng = np.random.default_rng(100 + seed)
    scene = busy_scene(seed)
    plane = written_in(scene, some_rotation(rng), rng.standard_normal(3))
    old, new = (rs.compile_scene(s, formulation, minimal=False) for s in (scene, plane.scene))
    assert [v.name for v in old.dae.p_labels] == [v.name for v in new.dae.p_labels] == ["a", "g"]
    back = returned(plane, formulation)
    for _ in range(5):
        y, u, p = random_states(rng, formulation), rng.standard_normal(1), rng.standard_normal(2)
        t = rng.standard_normal()
        x, expected = (np.array(v).ravel() for v in back(y, new.function("ode")(t, y, [], u, p)))
        rate = np.array(old.function("ode")(t, x, [], u, p)).ravel()
        assert np.abs(rate - expected).max() < 1e-11 * np.abs(rate).max()
        for name in [f"c{i}.{what}1" for i in range(4) for what in ("force", "torque")]:
            a = np.array(old.function(name)(t, x, [], u, p))
            b = plane.Q @ np.array(new.function(name)(t, y, [], u, p))
            assert np.abs(a - b).max() < 1e-11 * max(1.0, np.abs(a).max()), name
    p = rng.standard_normal(2)
    ours = np.array(back(new.dae.start_values(p)[0], 0)[0]).ravel()
    np.testing.assert_allclose(ours, old.dae.start_values(p)[0], atol=1e-13)


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
def test_a_planar_model_gives_the_motion_of_the_full_one(formulation: Any) -> None:
    scene = shuffled(chain(2, rs.Consistent()), 4, far=2.0)
    plane = next(planes(scene))
    integrator, times = rs.ExplicitRK(1e-11, 1e-13), [0.0, 0.2, 0.4]
    small = rs.compile_scene(plane.scene, formulation)
    assert small.n_x == 12
    full = rs.compile_scene(scene, formulation, minimal=False)
    names = [label.name for label in full.x_labels]
    ours = rs.simulate(small, times, integrator)
    theirs = rs.simulate(full, times, integrator)
    back = returned(plane, formulation)
    for k in range(len(times)):
        x = np.array(back([ours[name][k] for name in names], 0)[0]).ravel()
        truth = np.array([theirs[name][k] for name in names])
        assert np.abs(x - truth).max() < 1e-8
    assert np.abs(truth - [label.start for label in full.x_labels]).max() > 0.4  # it did move


# Planar motion is found.


@pytest.mark.parametrize("law", LAWS.values(), ids=by_name)
@pytest.mark.parametrize(("links", "seed"), [(1, 0), (1, 1), (1, 2), (3, 3), (3, 4)])
def test_a_chain_in_any_plane_with_any_body_axes(links: int, seed: int, law: Any) -> None:
    scene = shuffled(chain(links, law), seed, far=3.0)
    (plane,) = planes(scene)
    assert rs.compile_scene(plane.scene).n_x == 6 * links
    np.testing.assert_allclose(plane.scene.gravity, (9.81, 0, 0), rtol=1e-14)  # x is down
    assert all(body.position[2] == 0 for body in plane.scene.bodies)
    assert rs.compile_scene(scene).n_x == 6 * links


@pytest.mark.parametrize("law", LAWS.values(), ids=by_name)
def test_far_from_all_origins(law: Any) -> None:
    """Rounding is that of the numbers given: here of 1e3 m and of 200 m, for links of 1 m."""
    for seed in range(3):
        assert sizes(shuffled(chain(1, law), seed, far=1e3)) == [6]
    link = rs.RigidBody(
        "b0", 1, (0.01, 0.1, 0.1), com=(100.5, 200, 0), position=(-100, -200, 0),
        velocity=(400, -200, 0), angular_velocity=(0, 0, 2),
    )  # fmt: skip
    joint = replace(chain(1, law).connectors[0], marker1=rs.Marker("b0", (100, 200, 0)))
    for seed in range(3):
        assert sizes(shuffled(rs.Scene("s", [link], [joint]), seed)) == [6]


def test_a_centre_of_mass_away_from_the_origin_and_a_start_in_motion() -> None:
    """The pendulum turns about its pivot at 2 rad/s; its frame sits at the pivot."""
    link = rs.RigidBody("b0", 1, (0.01, 0.1, 0.1), com=(0.5, 0, 0), angular_velocity=(0, 0, 2))
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND), rs.Marker("b0"), [1e4] * 6, law=rs.Consistent()
    )
    pushes = [rs.Load("f", rs.Marker("b0"), (1, 2, 0), (0, 0, 3)),
              rs.Load("g", rs.Marker("b0"), (0, 1, 0), (0, 0, 3), frame="body")]  # fmt: skip
    for seed, turn in enumerate([None, None, EYE, CYCLIC]):
        still = rs.Scene("s", [link], [joint], pushes[:1], gravity=(0, -9.81, 0))
        assert sizes(shuffled(still, seed, turn, far=1.0)) == [6]
    turned = rs.Scene("s", [link], [joint], pushes, gravity=(0, -9.81, 0))
    S = some_rotation(np.random.default_rng(0))
    pushes[1] = replace(pushes[1], force=S.T @ (0, 1, 0), torque=S.T @ (0, 0, 3))
    turned = reframed(replace(turned, loads=pushes), {"b0": S})
    assert sizes(carried(turned, some_rotation(np.random.default_rng(1)))) == [6]


@pytest.mark.parametrize("hinge", [EYE, CYCLIC, CYCLIC.T], ids="zyx")
@pytest.mark.parametrize("law", [rs.Intrinsic(), rs.Consistent()], ids=by_name)
def test_a_hinge_about_any_axis_of_its_frame(law: Any, hinge: Array) -> None:
    """In a tilted and in a world plane: V is such that joint frames turn about one of its axes."""
    for turn in (None, CYCLIC):
        assert sizes(shuffled(chain(1, law, hinge=hinge), 5, turn, far=1.0)) == [6]


def test_world_axes_are_kept_where_the_normal_is_one() -> None:
    """At a height of which 0.1 + 0.2 and 0.3 are two readings."""
    scene = carried(shuffled(chain(2, rs.Consistent()), 0, EYE), EYE, (0.3, 0.2, 0.1 + 0.2))
    grounded = scene.connectors[0]
    scene = replace(scene, connectors=[
        replace(grounded, marker0=rs.Marker(rs.GROUND, (0.3, 0.2, 0.3))), scene.connectors[1]
    ])  # fmt: skip
    (plane,) = planes(scene)
    assert plane.keeps_world
    assert (plane.Q == EYE).all()
    assert rs.compile_scene(plane.scene).n_x == 12
    np.testing.assert_allclose(plane.scene.bodies[0].position, (0.8, 0.2, 0.3), atol=1e-15)
    tilted = next(planes(shuffled(scene, 1)))
    assert not tilted.keeps_world


def test_symbols_in_the_plane_do_not_hide_it() -> None:
    """Gravity, lengths and a driven pivot as multiples of symbols, in a tilted plane."""
    g, length, push = rs.Param("g", 9.81), rs.Param("length", 2.0, "m"), rs.Input("push", "N")
    rng = np.random.default_rng(7)
    R, S = some_rotation(rng), some_rotation(rng)
    down, along, normal = R @ (0, -1, 0), R @ (1, 0, 0), R @ (0, 0, 1)
    arm = S.T @ (-0.5, 0, 0)
    pivot = [v * np.sin(rs.TIME) for v in along]
    link = rs.RigidBody(
        "b", 1, S.T @ np.diag([0.01, 0.1, 0.1]) @ S, position=[v * length / 2 for v in along],
        rotation=R @ S, velocity=[length * v for v in down],
    )  # fmt: skip
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND, pivot, R), rs.Marker("b", [v * length for v in arm], S.T),
        [100] * 6, law=rs.Consistent(),
    )  # fmt: skip
    loads = [
        rs.Load("f", rs.Marker("b"), [v * push for v in along], [v * push for v in normal]),
        rs.Load("m", rs.Marker("b"), torque=[v * push for v in S.T @ (0, 0, 1)], frame="body"),
    ]
    scene = rs.Scene("s", [link], [joint], loads, gravity=[2 * v * g - v for v in down])
    assert sizes(scene) == [6]
    # The symbols are alive.
    (plane,) = planes(scene)
    np.testing.assert_allclose(plane.Q @ at_default(plane.scene.gravity), (2 * 9.81 - 1) * down)
    assert [leaf.name for leaf in plane.scene.leaves] == ["g", "length", "push", "t"]


def test_a_hanging_pendulum_may_swing_about_each_joint_axis_across_it() -> None:
    """At rest nothing tells the plane; a motor that is off at the start turns about one axis."""
    link = rs.RigidBody("b", 1, (0.05, 0.1, 0.12), position=(0.5, 0, 0))
    motor = rs.Load("motor", rs.Marker("b"), (0, 0, 0), (0, 0, rs.Input("T", "N m")), "body")
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND), rs.Marker("b", (-0.5, 0, 0)), [1e4] * 6, law=rs.Consistent()
    )
    scene = rs.Scene("s", [link], [joint], [motor], gravity=(9.81, 0, 0))
    hanging = carried(scene, some_rotation(np.random.default_rng(3)))
    assert sizes(hanging) == [6, 6]
    for i, plane in enumerate(planes(hanging)):  # the joint's z, then its y; either stays its axis
        assert abs(plane.Q[:, 2 - i] @ hanging.bodies[0].rotation[:, 2 - i]) > 1 - 1e-14
