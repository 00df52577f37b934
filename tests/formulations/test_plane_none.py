"""Scenes that are not planar, and what a trajectory of a tilted model speaks of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from helpers.comparing import by_name, compare
from scenes.plane import FORMULATIONS, carried, matrix, shuffled, sizes, some_rotation, unit
from scenes.small import EYE, LAWS, Array, chain

import rbsd_sym as rs
from rbsd_sym.formulations.plane import planes


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


@pytest.mark.parametrize("law", LAWS.values(), ids=by_name)
@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
def test_all_outputs_and_states_are_those_of_the_full_model(law: Any, formulation: Any) -> None:
    plain = chain(2, law)
    offset = [1e-4, 2e-4, 0, 0, 0, 0.1]
    moved = [replace(c, offset=offset) for c in plain.connectors]
    scene = shuffled(replace(plain, connectors=moved), 3, far=2.0)
    assert rs.compile_scene(scene, formulation).n_x == 12
    assert compare(scene, 0.3) < 1e-9


@pytest.mark.parametrize("law", [rs.Intrinsic(), rs.Consistent()], ids=by_name)
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
