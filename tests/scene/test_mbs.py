"""`mbs` and the joint's rotations in user functions: documented names, copies, refusals, planes."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from oracles import rotations

import rbsd_sym as rs

EPS = float(np.finfo(float).eps)
TURN0, TURN1 = rotations.exp_so3([0.4, -0.1, 0.8]), rotations.exp_so3([-0.6, 0.3, 0.2])
K = np.diag([3.0, 4.0, 5.0, 6.0, 7.0, 8.0]) + 0.5 * np.eye(6, k=1) + 0.5 * np.eye(6, k=-1)
D = np.diag([0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
OFFSET, SPEEDS = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [0.6, 0.5, 0.4, 0.3, 0.2, 0.1]


def scene_of(user: Callable[..., Any], variables: Any = (), **more: Any) -> rs.Scene:
    """A body on two connectors, the second of which, "joint", has the user's force."""
    body = rs.RigidBody("b", 2.0, (0.3, 0.4, 0.5))
    markers = rs.Marker(rs.GROUND), rs.Marker("b")
    given = {
        "stiffness": K, "damping": D, "offset": OFFSET, "velocity_offset": SPEEDS,
        "rotation_marker0": TURN0, "rotation_marker1": TURN1, "draw_size": 0.2, "color": "#112233",
        "law": rs.Intrinsic(),
    } | more  # fmt: skip
    first = rs.RigidBodySpringDamper("first", *markers, [9.0] * 6, offset=[0.01] * 6, active=False)
    joint = rs.RigidBodySpringDamper("joint", *markers, force=user, **given)
    return rs.Scene("two", [body], [first, joint], variables=dict(variables))


def seen(look: Callable[..., Any], variables: Any = (), **more: Any) -> Any:
    """What a user function sees: look(mbs, item)."""
    found = []

    def user(mbs, t, item, *rest) -> list[float]:
        found.append(look(mbs, item))
        return [0.0] * 6

    rs.compile_scene(scene_of(user, variables, **more), minimal=False)
    return found[0]


@pytest.mark.parametrize(("name", "expected"), [
    ("name", "joint"), ("stiffness", K), ("damping", D), ("offset", OFFSET),
    ("velocityOffset", SPEEDS), ("velocity_offset", SPEEDS), ("rotationMarker0", TURN0),
    ("rotationMarker1", TURN1), ("rotation_marker1", TURN1), ("activeConnector", True),
    ("intrinsicFormulation", True), ("useIntrinsicFormulation", True), ("markerNumbers", [2, 3]),
    ("nodeNumber", -1), ("postNewtonStepUserFunction", 0), ("Vshow", True), ("VdrawSize", 0.2),
    ("Vcolor", "#112233"), ("draw_size", 0.2), ("active", True), ("data", []),
])  # fmt: skip
def test_parameters_by_their_names(name: str, expected: Any) -> None:
    value = seen(lambda mbs, item: mbs.GetObjectParameter(item, name))
    assert type(value) is type(expected) or isinstance(value, np.ndarray)
    assert np.array_equal(value, expected)


def test_the_functions_themselves_and_other_connectors() -> None:
    value = seen(lambda mbs, item: mbs.GetObjectParameter(
        objectNumber=item, parameterName="springForceTorqueUserFunction"))  # fmt: skip
    assert value.__name__ == "user"
    assert seen(lambda mbs, item: mbs.GetObjectParameter(0, "springForceTorqueUserFunction")) == 0
    assert seen(lambda mbs, item: mbs.GetObjectParameter(item - 1, "name")) == "first"
    assert np.array_equal(
        seen(lambda mbs, item: mbs.GetObjectParameter(0, "stiffness")), 9 * np.eye(6)
    )
    assert seen(lambda mbs, item: mbs.GetObjectParameter(0, "activeConnector")) is False
    assert seen(lambda mbs, item: mbs.GetObjectParameter(0, "VdrawSize")) == -1.0
    assert seen(lambda mbs, item: mbs.GetObjectParameter(0, "Vcolor")) == (-1.0,) * 4


def test_values_are_copies() -> None:
    def spoil(mbs: Any, item: int) -> Any:
        for name in ("stiffness", "offset", "rotationMarker0"):
            mbs.GetObjectParameter(item, name)[...] = 77.0
        mbs.variables["table"][:] = 0.0
        return [mbs.GetObjectParameter(item, "stiffness"), mbs.variables["table"]]

    stiffness, table = seen(spoil, {"table": np.array([1.0, 2.0])})
    assert np.array_equal(stiffness, K)
    assert np.array_equal(table, [1.0, 2.0])


def test_the_joint_frame_may_be_a_quaternion() -> None:
    value = seen(
        lambda mbs, item: mbs.GetObjectParameter(item, "rotationMarker0"),
        rotation_marker0=rotations.to_quaternion(TURN0),
    )
    assert np.abs(value - TURN0).max() < 4 * EPS


def test_symbols_stay_symbols() -> None:
    """A Param reached through mbs, its variables or rotJ1 is one of the model."""
    stiff, gap, angle = rs.Param("stiff", 30.0), rs.Param("gap", 0.5), rs.Param("angle", 0.2)
    turn = [[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]]

    def user(mbs, t, item, u, r, v, w, k, d, J0, J1, off) -> list[Any]:
        own = mbs.GetObjectParameter(item, "stiffness")
        return [own[0][0] * u[0], mbs.variables["gap"] * u[1], J1[1][0], J1[0, 0], 0, 0]

    scene = scene_of(user, {"gap": gap}, stiffness=[stiff, *[1.0] * 5], rotation_marker0=np.eye(3),
                     rotation_marker1=turn)  # fmt: skip
    model = rs.compile_scene(scene, minimal=False)
    assert [label.name for label in model.dae.p_labels] == ["angle", "gap", "stiff"]
    x = np.array([0.3, -0.4, 0.1, 1, *[0.0] * 9])
    u = np.array(model.function("joint.displacement_local")(0, x, [], [], [0.7, 2, 40]))[:, 0]
    force, torque = (np.array(model.function(f"joint.{n}_local")(0, x, [], [], [0.7, 2, 40]))[:, 0]
                     for n in ("force", "torque"))  # fmt: skip
    assert force == pytest.approx([40 * u[0], 2 * u[1], np.sin(0.7)])
    assert torque == pytest.approx([np.cos(0.7), 0, 0])


def test_variables_are_a_mapping() -> None:
    given = {"node": 3, "table": (0.0, 1.0)}
    assert seen(lambda mbs, item: mbs.variables["node"], given) == 3
    assert seen(lambda mbs, item: dict(mbs.variables), given) == given
    assert seen(lambda mbs, item: mbs.variables.get("other", 5), given) == 5
    assert seen(lambda mbs, item: "node" in mbs.variables, given) is True
    assert seen(lambda mbs, item: "other" in mbs.variables) is False


REFUSED = [
    (lambda m, i: m.GetNodeOutput(3, 1), TypeError, ["mbs.GetNodeOutput", "displacement"]),
    (lambda m, i: m.GetSensorValues(0), TypeError, ["mbs.GetSensorValues", "by displacement"]),
    (lambda m, i: m.GetObjectOutput(i, 1), TypeError, ["mbs.GetObjectOutput"]),
    (lambda m, i: m.SetObjectParameter(i, "stiffness", K), TypeError,
     ["mbs.SetObjectParameter", "a Param, an Input or data"]),
    (lambda m, i: m.systemData.GetTime(), TypeError, ["mbs.systemData"]),
    (lambda m, i: setattr(m, "memory", 3), TypeError, ["mbs.memory", "cannot be written", "data"]),
    (lambda m, i: m.variables.__setitem__("n", 1), TypeError, ["variables['n']", "data"]),
    (lambda m, i: m.variables["node"], ValueError,
     ["mbs.variables has no 'node'", "Scene(variables={'node': ...})"]),
    (lambda m, i: m.GetObjectParameter(i, "stifness"), ValueError,
     ["'stifness'", "there are: name, ", "rotationMarker1"]),
    (lambda m, i: m.GetObjectParameter(7, "stiffness"), ValueError,
     ["no connector 7", "0 ... 1", "itemNumber"]),
    (lambda m, i: m.GetObjectParameter("joint", "stiffness"), ValueError, ["no connector 'joint'"]),
    (lambda m, i: m.GetObjectParameter(-1, "stiffness"), ValueError, ["no connector -1"]),
    (lambda m, i: m.frame_to_world(0, 1), ValueError, ["another connector", "give itemNumber, 1"]),
    (lambda m, i: m.frame_to_world(i, 2), ValueError, ["markers 0 and 1"]),
]  # fmt: skip


@pytest.mark.parametrize(("look", "kind", "words"), REFUSED, ids=range(len(REFUSED)))
def test_the_rest_is_refused_by_name(look: Any, kind: type[Exception], words: list[str]) -> None:
    with pytest.raises(kind) as caught:
        seen(look)
    message = str(caught.value)
    assert caught.type is kind
    assert message.startswith("connector 'joint', force: "), message
    assert "; " in message
    for word in words:
        assert word in message, message


def test_variables_of_a_scene_are_checked() -> None:
    with pytest.raises(TypeError, match=r"scene 'two', variables: list; give names and values"):
        rs.Scene("two", [rs.RigidBody("b", 1, (1, 1, 1))], [], variables=["node"])


def test_a_plane_that_is_oblique_changes_nothing() -> None:
    """The scene is written in axes of its plane; users see the joint, the world and mbs as before.

    Joint frames become part of the markers there, and stiffnesses may be turned.
    """
    tilt = rotations.exp_so3([0.5, -0.7, 0.2])
    normal, along = tilt[:, 2], tilt[:, 0]
    about = rotations.exp_so3([0, 0, 0.3])

    def user(mbs, t, item, u, r, v, w, k, d, J0, J1, off) -> list[Any]:
        spin = along @ mbs.frame_to_world(item, 1) @ np.array([1.0, 0.0, 0.0])
        other = mbs.GetObjectParameter(0, "stiffness")[0, 1]
        turned = mbs.GetObjectParameter(item, "rotationMarker1")[1, 0]
        return [-(5 + 20 * J0[0, 1]) * u[0], -(5 + spin) * u[1], 0, 0, 0, -(other + turned) * r[2]]

    other = np.zeros((6, 6))
    other[:3, :3] = tilt @ np.diag([3.0, 1.0, 2.0]) @ tilt.T
    other[0, 1] = other[1, 0] = 4.0
    bodies = [
        rs.RigidBody("a", 1.5, tilt @ np.diag([0.2, 0.3, 0.4]) @ tilt.T, velocity=0.3 * along,
                     position=0.2 * tilt[:, 1], angular_velocity=0.7 * normal),
    ]  # fmt: skip
    markers = [rs.Marker(b, p, tilt) for b, p in ((rs.GROUND, (0, 0, 0)), ("a", 0.4 * along))]
    connectors = [
        rs.RigidBodySpringDamper("soft", rs.Marker(rs.GROUND), rs.Marker("a"), other, active=False),
        rs.RigidBodySpringDamper("joint", *markers, force=user, rotation_marker0=about,
                                 rotation_marker1=about.T),
    ]  # fmt: skip
    scene = rs.Scene("slope", bodies, connectors)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.ModelWarning)
        small, full = rs.compile_scene(scene), rs.compile_scene(scene, minimal=False)
    assert small.n_x < full.n_x
    assert any("planar, with normal" in note for note in small.notes)
    runs = [rs.simulate(m, 1.5, rs.Idas(1e-10, 1e-12)) for m in (small, full)]
    for name in ("a.position", "a.rotation_matrix", "joint.force_local", "joint.rotation"):
        first, second = (run[name] for run in runs)
        assert np.abs(first - second).max() < 1e-7, name
