"""Scenes in other axes: the same motion, and planar motion found in any plane and any body axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from test_minimal import compare

import rbsd_sym as rs
from rbsd_sym.checks import at_default
from rbsd_sym.formulations.layout import Layout
from rbsd_sym.formulations.plane import Plane, planes, written_in

Array = NDArray[np.float64]
LAWS = [rs.Standard(), rs.Intrinsic(), rs.Consistent()]
FORMULATIONS = [rs.Quaternion(), rs.TaitBryan()]
EYE = np.eye(3)
CYCLIC = EYE[[2, 0, 1]]  # R x = y, R y = z, R z = x


def by_name(value: Any) -> str:
    """Test id of a law or formulation."""
    return type(value).__name__


def matrix(q: Any) -> Array:
    """Rotation matrix of a unit quaternion, scalar first."""
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def unit(rng: np.random.Generator, n: int = 4) -> Array:
    """A random unit vector, or quaternion."""
    v = rng.standard_normal(n)
    return v / np.linalg.norm(v)


def some_rotation(rng: np.random.Generator) -> Array:
    return matrix(unit(rng))


# The same scene elsewhere, and with other body axes: what `planes` has to undo.


def carried(scene: rs.Scene, R: Array, o: Any = (0, 0, 0)) -> rs.Scene:
    """Everything moved by p -> o + R p, the ground markers and gravity too."""

    def marker(m: rs.Marker) -> rs.Marker:
        if m.body != rs.GROUND:
            return m
        return rs.Marker(m.body, np.add(o, R @ m.position), R @ m.rotation)

    bodies = [
        replace(b, position=np.add(o, R @ b.position), rotation=R @ b.rotation,
                velocity=R @ b.velocity)
        for b in scene.bodies
    ]  # fmt: skip
    connectors = [
        replace(c, marker0=marker(c.marker0), marker1=marker(c.marker1)) for c in scene.connectors
    ]
    loads = [
        replace(v, force=R @ v.force, torque=R @ v.torque) if v.frame == "world" else v
        for v in scene.loads
    ]
    return replace(
        scene, bodies=bodies, connectors=connectors, loads=loads, gravity=R @ scene.gravity
    )


def reframed(scene: rs.Scene, S: dict[str, Array], by_joint: bool = False) -> rs.Scene:
    """Body axes turned by S: R_WB -> R_WB S; joint frames stay where they are.

    They are turned back in the markers, or in the joint rotations.
    """
    S = {**S, rs.GROUND: EYE}

    def marker(m: rs.Marker) -> rs.Marker:
        R = m.rotation if by_joint else S[m.body].T @ m.rotation
        return rs.Marker(m.body, S[m.body].T @ m.position, R)

    def joint(m: rs.Marker, R: Array) -> Array:
        return m.rotation.T @ S[m.body].T @ m.rotation @ R if by_joint else R

    bodies = [
        replace(b, rotation=b.rotation @ S[b.name], inertia=S[b.name].T @ b.inertia @ S[b.name],
                com=S[b.name].T @ b.com, angular_velocity=S[b.name].T @ b.angular_velocity)
        for b in scene.bodies
    ]  # fmt: skip
    connectors = [
        replace(c, marker0=marker(c.marker0), marker1=marker(c.marker1),
                rotation_marker0=joint(c.marker0, c.rotation_marker0),
                rotation_marker1=joint(c.marker1, c.rotation_marker1))
        for c in scene.connectors
    ]  # fmt: skip
    return replace(scene, bodies=bodies, connectors=connectors)


def chain(n: int, law: Any, off: float = 0.0, hinge: Array = EYE, **body: Any) -> rs.Scene:
    """Links along x that fall in the xy plane; `off` moves one marker out, `hinge` turns joints."""
    bodies, joints = [], []
    for i in range(n):
        out = off if i == n // 2 else 0.0
        numbers = {"mass": 1, "inertia": (0.01, 0.1, 0.1), **(body if i == 0 else {})}
        bodies.append(rs.RigidBody(f"b{i}", position=(i + 0.5, 0, 0), **numbers))
        joints.append(rs.RigidBodySpringDamper(
            f"j{i}", rs.Marker(f"b{i - 1}", (0.5, 0, 0), hinge) if i
            else rs.Marker(rs.GROUND, (0, 0, 0), hinge), rs.Marker(f"b{i}", (-0.5, 0, out), hinge),
            [1e5] * 3 + [1e3] * 3, [10] * 3 + [1] * 3, law=law,
        ))  # fmt: skip
    return rs.Scene("chain", bodies, joints, gravity=(0, -9.81, 0))


def shuffled(scene: rs.Scene, seed: int, R: Array | None = None, far: float = 0.0) -> rs.Scene:
    """The scene carried by a random rotation (or R) and a shift, with random body axes."""
    rng = np.random.default_rng(seed)
    S = {body.name: some_rotation(rng) for body in scene.bodies}
    R = some_rotation(rng) if R is None else R
    return carried(reframed(scene, S, by_joint=bool(seed % 2)), R, far * rng.standard_normal(3))


def sizes(scene: rs.Scene) -> list[int]:
    """Number of states of the minimal model of each candidate."""
    return [rs.compile_scene(plane.scene).n_x for plane in planes(scene)]


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
            zip(ends, [*LAWS, rs.Consistent()], [None, None, None, user_force], strict=True))
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
        rotation = unit(rng) if formulation.quaternion else 0.7 * rng.uniform(-1, 1, 3)
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


@pytest.mark.parametrize("law", LAWS, ids=by_name)
@pytest.mark.parametrize(("links", "seed"), [(1, 0), (1, 1), (1, 2), (3, 3), (3, 4)])
def test_a_chain_in_any_plane_with_any_body_axes(links: int, seed: int, law: Any) -> None:
    scene = shuffled(chain(links, law), seed, far=3.0)
    (plane,) = planes(scene)
    assert rs.compile_scene(plane.scene).n_x == 6 * links
    np.testing.assert_allclose(plane.scene.gravity, (9.81, 0, 0), rtol=1e-14)  # x is down
    assert all(body.position[2] == 0 for body in plane.scene.bodies)
    assert rs.compile_scene(scene).n_x == 6 * links


@pytest.mark.parametrize("law", LAWS, ids=by_name)
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
@pytest.mark.parametrize("law", LAWS[1:], ids=by_name)
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


# Scenes that are not planar.


def spun(w0: Any, w1: Any) -> rs.Scene:
    """Two free links at rest, but for their turning."""
    bodies = [rs.RigidBody(n, 1, (1, 1, 1), angular_velocity=w) for n, w in (("a", w0), ("b", w1))]
    return rs.Scene("spun", bodies, [])


SPATIAL: dict[str, Callable[[float], rs.Scene]] = {
    "a marker off the plane": lambda fault: chain(3, rs.Consistent(), off=0.1 * fault),
    "a marker barely off": lambda fault: chain(3, rs.Consistent(), off=1e-9 * fault),
    "two axes of rotation": lambda fault: spun((0, 0, 1), (0, 1 * fault, 1)),
    "an oblique inertia": lambda fault: chain(
        3, rs.Consistent(), inertia=(0.1, 0.1, 0.1, 0.01 * fault, 0, 0)
    ),
    "a start out of the plane": lambda fault: chain(2, rs.Consistent(), velocity=(0, 1, fault)),
    "a force out of the plane": lambda fault: replace(
        chain(2, rs.Consistent()), loads=[rs.Load("f", rs.Marker("b1"), (0, 1, fault))]
    ),
    "a torque in the plane": lambda fault: replace(
        chain(2, rs.Consistent()), loads=[rs.Load("f", rs.Marker("b1"), torque=(0, fault, 1))]
    ),
}


@pytest.mark.parametrize("name", SPATIAL)
def test_a_spatial_scene_has_no_plane(name: str) -> None:
    for seed in (0, 1):
        assert len(list(planes(shuffled(SPATIAL[name](0.0), seed)))) == 1
        assert not list(planes(shuffled(SPATIAL[name](1.0), seed)))


def test_a_spatial_scene_whose_candidate_keeps_the_world_is_not_reduced() -> None:
    """Heights are not looked at where the world axes are kept; the passes find out."""
    flat, bent = (shuffled(chain(3, rs.Consistent(), off), 0, EYE) for off in (0.0, 0.1))
    assert sizes(flat) == [18]
    assert all(n == 39 for n in sizes(bent))


def test_symbols_that_leave_the_plane_keep_the_states() -> None:
    """At its default the Param is in the plane: a candidate, which the passes refuse."""
    off = rs.Param("off", 0.0, "m")
    scene = chain(1, rs.Consistent())
    (joint,) = scene.connectors
    for value, states in ((off, 13), (0.0, 6)):
        moved = replace(joint, marker0=rs.Marker(rs.GROUND, (0, 0, value)))
        # Turned by hand: `carried` would blur the Param's direction.
        assert sizes(shuffled(replace(scene, connectors=[moved]), 0)) == [states]


def test_scenes_that_need_no_other_axes_have_no_candidate() -> None:
    assert not list(planes(chain(2, rs.Consistent())))
    assert list(planes(shuffled(chain(2, rs.Consistent()), 0, EYE)))


def test_bodies_whose_axes_cannot_be_turned_have_no_candidate() -> None:
    """A symbolic start rotation, and a rod: its missing inertia is found by its row of zeros."""
    R = some_rotation(np.random.default_rng(0))
    scene = carried(chain(1, rs.Consistent()), R)
    (link,) = scene.bodies
    angle = rs.Param("angle", 0.0)
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]]
    )
    assert sizes(scene) == [6]
    for changes in ({"rotation": R @ turn}, {"inertia": (0, 0.1, 0.1)}):
        assert not list(planes(replace(scene, bodies=[replace(link, **changes)])))


def test_points_without_a_force_may_be_anywhere() -> None:
    """Of a torque, and of connectors that are not active."""
    plain = chain(1, rs.Consistent())
    off = replace(plain.connectors[0], name="off", marker1=rs.Marker("b0", (0, 0, 1)), active=False)
    torque = rs.Load("m", rs.Marker("b0", (0, 0, 1)), torque=(0, 0, 2))
    scene = replace(plain, connectors=[*plain.connectors, off], loads=[torque])
    assert sizes(shuffled(scene, 0)) == [6]


# Through compile_scene: a trajectory speaks of the scene, whatever axes the model is written in.


def with_joints(scene: rs.Scene, R: Array) -> rs.Scene:
    """The scene with all joint frames turned by R."""
    connectors = [replace(c, rotation_marker0=R, rotation_marker1=R) for c in scene.connectors]
    return replace(scene, connectors=connectors)


@pytest.mark.parametrize("law", LAWS, ids=by_name)
@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
def test_all_outputs_and_states_are_those_of_the_full_model(law: Any, formulation: Any) -> None:
    plain = chain(2, law)
    offset = [1e-4, 2e-4, 0, 0, 0, 0.1]
    moved = [replace(c, offset=offset) for c in plain.connectors]
    scene = shuffled(replace(plain, connectors=moved), 3, far=2.0)
    assert rs.compile_scene(scene, formulation).n_x == 12
    assert compare(scene, 0.3) < 1e-9


@pytest.mark.parametrize("law", LAWS[1:], ids=by_name)
def test_joint_frames_oblique_to_the_plane(law: Any) -> None:
    """In a tilted plane, and in a world plane with oblique joints; Standard cannot turn them."""
    oblique = some_rotation(np.random.default_rng(5))
    tilted = carried(chain(2, law), matrix(unit(np.random.default_rng(6))))
    flat = chain(2, law)
    for scene in (with_joints(tilted, oblique), with_joints(flat, oblique)):
        assert rs.compile_scene(scene).n_x == 12
        assert compare(scene, 0.2) < 1e-9
    assert rs.compile_scene(with_joints(chain(2, rs.Standard()), oblique)).n_x == 26


def test_names_and_account_of_a_tilted_model(tmp_path: Any) -> None:
    scene = shuffled(chain(1, rs.Consistent()), 2, far=1.0)
    model = rs.compile_scene(scene)
    assert {v.name for v in model.x_labels} == {
        "b0.plane_p_x", "b0.plane_p_y", "b0.angle_z", "b0.plane_v_x", "b0.plane_v_y",
        "b0.plane_w_z",
    }  # fmt: skip
    text = str(model)
    assert "b0.plane_p_z = " in text
    assert "b0.p_x = " in text
    assert "the motion is planar, with normal (" in text
    assert len(model.dropped) == 6  # p, q, q, v, w, w out of the plane
    header = (rs.export_c(model, tmp_path / "chain").folder / "chain.h").read_text()
    assert "CHAIN_X_B0_PLANE_P_X" in header
    with pytest.raises(ValueError, match=r"b0\.p_x.*a function of b0\.plane_p_x.*minimal=False"):
        rs.simulate(model, 0.1, start={"b0.p_x": 1.0})


def test_a_tilted_column_buckles_like_an_upright_one() -> None:
    """Transverse growth in the plane's axes: that of a column that stands along the world's z."""
    bar = rs.RigidBody("bar", 1.0, (0.08, 0.08, 0.01), position=(0, 0, 0.5))
    hinge = rs.RigidBodySpringDamper(
        "hinge", rs.Marker(rs.GROUND), rs.Marker("bar", (0, 0, -0.5)), [1e6] * 3 + [1.0] * 3,
        law=rs.Consistent(),
    )  # fmt: skip
    push = rs.Load("push", rs.Marker("bar"), force=(rs.Input("push", "N"), 0, 0))
    upright = rs.Scene("s", [bar], [hinge], [push], gravity=(0, 0, -9.81))
    tilted = carried(upright, some_rotation(np.random.default_rng(8)))
    rates = []
    for scene, states in ((upright, 6), (tilted, 6)):
        model = rs.compile_scene(scene)
        assert model.n_x == states
        with pytest.warns(rs.ModelWarning, match="grows with"):
            trajectory = rs.simulate(model, 0.1)
        rates.append(model.transverse_growth(trajectory).rate)
    assert rates[0] == pytest.approx(rates[1], rel=1e-6)


def test_a_scene_without_plane_is_written_once(monkeypatch: Any) -> None:
    """Of a spatial scene no second model is made."""
    written = []
    plain = rs.Quaternion.write

    def counted(self: Any, scene: rs.Scene) -> Any:
        written.append(scene.name)
        return plain(self, scene)

    monkeypatch.setattr(rs.Quaternion, "write", counted)
    rs.compile_scene(SPATIAL["a marker off the plane"](1.0))
    assert len(written) == 1
    rs.compile_scene(shuffled(chain(1, rs.Consistent()), 0))
    assert len(written) == 3
