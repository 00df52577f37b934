"""User forces: the documented signature, plain-number code, symbols, errors; resting connectors."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from oracles import closed_forms, rotations
from oracles import laws as oracle

import rbsd_sym as rs

# All states are kept: functions are evaluated where a scene that starts at rest never goes.
compiled_full = functools.partial(rs.compile_scene, minimal=False)
EPS = float(np.finfo(float).eps)
TURN = rotations.exp_so3([0.3, -0.5, 0.9])
K = [4000.0, 5000.0, 7000.0, 250.0, 500.0, 325.0]
NAMES = [
    "mbs", "t", "item", "displacement", "rotation", "velocity", "angular_velocity", "stiffness",
    "damping", "rotJ0", "rotJ1", "offset",
]  # fmt: skip
Force = Callable[..., Any]


def compiled(force: Force | None, law: Any = None, **numbers: Any) -> rs.Model:
    """Two free bodies and the connector "joint" of index 1, behind a plain one of index 0."""
    bodies = [rs.RigidBody(f"b{i}", 2.0, (0.3, 0.4, 0.5), position=(i, 0.1, 0.0)) for i in (0, 1)]
    markers = [rs.Marker("b0", (0.1, 0.2, 0.3), TURN), rs.Marker("b1", (-0.3, 0.1, 0.2))]
    given = {"stiffness": K, "rotation_marker1": TURN.T} | numbers
    connectors = [
        rs.RigidBodySpringDamper("plain", *markers, [1.0] * 6),
        rs.RigidBodySpringDamper("joint", *markers, force=force, law=law or rs.Standard(), **given),
    ]
    return compiled_full(rs.Scene("pair", bodies, connectors, outputs=["joint.force_local"]))


STATE = np.random.default_rng(31).normal(size=26)


def local(model: rs.Model, t: float = 0.0, u: Any = (), p: Any = ()) -> np.ndarray:
    """What the user function gave: force and torque in the joint's own frame."""
    names = ("joint.force_local", "joint.torque_local")
    return np.concatenate([np.array(model.function(n)(t, STATE, [], u, p))[:, 0] for n in names])


def revealing(*components: Callable[[dict[str, Any]], Any]) -> Force:
    """A force with the documented positional signature that returns parts of its arguments."""

    def force(*arguments: Any) -> list[Any]:
        assert len(arguments) == len(NAMES)
        given = dict(zip(NAMES, arguments, strict=True))
        return [component(given) for component in components]

    return force


def entries(name: str, *indices: Any) -> list[Callable[[dict[str, Any]], Any]]:
    return [lambda given, i=i: given[name][i] for i in indices]


@pytest.mark.parametrize("law", ["Standard", "Intrinsic", "Consistent"])
def test_motion_arguments_are_those_of_the_law(law: str) -> None:
    for pair in (("displacement", "rotation"), ("velocity", "angular_velocity")):
        model = compiled(revealing(*entries(pair[0], 0, 1, 2), *entries(pair[1], 0, 1, 2)),
                         getattr(rs, law)())  # fmt: skip
        outputs = {"displacement": "displacement_local", "rotation": "rotation",
                   "velocity": "velocity_local", "angular_velocity": "angular_velocity_local"}
        expected = np.concatenate([
            np.array(model.function(f"joint.{outputs[name]}")(0, STATE, [], [], []))[:, 0]
            for name in pair
        ])  # fmt: skip
        assert np.linalg.norm(expected) > 1
        assert np.array_equal(local(model), expected)


def test_rotations_are_those_of_the_joint() -> None:
    """rotJ_i is rotation_marker_i, given as matrix or quaternion, indexed in one or two steps."""
    half = rotations.exp_so3([0.2, 0.1, -0.4])
    for given in (half, rotations.to_quaternion(half)):
        turned = {"rotation_marker0": given, "rotation_marker1": TURN.T}
        for name, R in (("rotJ0", half), ("rotJ1", TURN.T)):
            for rows in ((0, 1), (1, 2)):
                places = [(i, j) for i in rows for j in range(3)]
                once = compiled(revealing(*entries(name, *places)), **turned)
                twice = compiled(revealing(
                    *(lambda g, name=name, i=i, j=j: g[name][i][j] for i, j in places)
                ), **turned)  # fmt: skip
                expected = [R[place] for place in places]
                assert np.abs(local(once) - expected).max() < 4 * EPS
                assert np.array_equal(local(twice), local(once))


def test_joint_frames_to_world_come_from_mbs() -> None:
    """mbs.frame_to_world(item, i) = R_body R_marker R_joint."""
    R0, R1 = (rotations.from_quaternion(STATE[i : i + 4]) for i in (3, 16))
    for marker, R in enumerate((R0 @ TURN, R1 @ TURN.T)):
        for rows in ((0, 1), (1, 2)):
            places = [(i, j) for i in rows for j in range(3)]
            model = compiled(revealing(*(
                lambda g, i=marker, place=place: g["mbs"].frame_to_world(g["item"], i)[place]
                for place in places
            )))  # fmt: skip
            assert np.abs(local(model) - [R[place] for place in places]).max() < 8 * EPS


def test_the_other_arguments() -> None:
    damping, offset = np.arange(36.0).reshape(6, 6), [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    model = compiled(revealing(
        lambda g: g["mbs"].GetObjectParameter(0, "stiffness")[2, 2], lambda g: 3 * g["t"],
        lambda g: g["item"],
        lambda g: g["stiffness"][1][1], lambda g: g["damping"][2, 5], lambda g: g["offset"][4],
    ), damping=damping, offset=offset)  # fmt: skip
    assert np.array_equal(local(model, t=0.5), [1.0, 1.5, 1.0, 5000.0, 17.0, 0.5])


def test_called_once_with_copies() -> None:
    """The function may write into the matrices it gets, and it is traced, not called again."""
    calls = []

    def force(mbs, t, item, d, r, v, w, k, c, J0, J1, offset) -> list[Any]:
        calls.append(t)
        k[0][0], c[0, 0], offset[0] = 1.0, 2.0, 3.0
        return [k[0][0] + c[0][0] + offset[0], *d, *r[:2]]

    connector = rs.RigidBodySpringDamper(
        "joint", rs.Marker(rs.GROUND), rs.Marker("b"), K, K, [0.1] * 6, force=force
    )
    model = compiled_full(rs.Scene("one", [rs.RigidBody("b", 1.0, (1, 1, 1))], [connector]))
    for name in ("ode", "dode_dx", "out"):
        model.function(name)
    assert len(calls) == 1
    assert np.array_equal(np.diag(connector.stiffness), K)
    assert np.array_equal(connector.damping, connector.stiffness)
    assert np.array_equal(connector.offset, [0.1] * 6)


def written_for_numbers(mbs, t, item, d, r, v, w, k, c, J0, J1, offset) -> list[Any]:
    """Code that also runs on floats."""
    length = np.sqrt(d[0] ** 2 + d[1] * d[1] + d[2] * d[2])
    pull = k[1][1] * np.tanh((length - 0.2) / 0.1)
    brake = np.sin(3 * t) - 2.0 / (1 + abs(v[0])) + np.exp(-np.abs(w[1])) * np.arctan2(d[1], d[0])
    force = pull * np.array(d) / length
    torque = np.dot(k[3:, 3:], r) + np.cross(d, v) + J0 @ np.array([0.0, 0.0, brake])
    return [*force, *torque]


def test_code_for_plain_numbers() -> None:
    """The same function called with floats is the reference."""
    model = compiled(written_for_numbers, rotation_marker0=TURN.T, rotation_marker1=TURN)
    outputs = ("displacement_local", "rotation", "velocity_local", "angular_velocity_local")
    motion = [np.array(model.function(f"joint.{n}")(0.7, STATE, [], [], []))[:, 0] for n in outputs]
    expected = np.array(written_for_numbers(
        None, 0.7, 1, *motion, np.diag(K), np.zeros((6, 6)), TURN.T, TURN, np.zeros(6)
    ))  # fmt: skip
    assert np.abs(local(model, t=0.7) - expected).max() < 64 * EPS * np.abs(expected).max()


def test_wrench_of_a_user_force_and_its_power() -> None:
    """The law carries it to the markers; no potential is known, so all power is injected."""
    force = revealing(*(lambda g, i=i: 10.0 * i - 20 for i in range(6)))
    R0 = rotations.from_quaternion(STATE[3:7]) @ TURN
    model = compiled(force)
    f0, tau0, f1, tau1 = (
        np.array(model.function(f"joint.{n}")(0, STATE, [], [], []))[:, 0]
        for n in ("force0", "torque0", "force1", "torque1")
    )
    assert np.abs(f0 - R0 @ [-20.0, -10.0, 0.0]).max() < 64 * EPS * 20
    assert np.abs(tau0 - R0 @ [10.0, 20.0, 30.0]).max() < 64 * EPS * 30
    assert np.array_equal(np.array([f0, tau0]), -np.array([f1, tau1]))
    stored, dissipated, injected = (
        float(model.function(f"joint.{n}")(0, STATE, [], [], []))
        for n in ("potential_energy", "dissipated_power", "injected_power")
    )
    given = 0.0
    for x, arm, f, tau in ((STATE[:13], (0.1, 0.2, 0.3), f0, tau0),
                           (STATE[13:], (-0.3, 0.1, 0.2), f1, tau1)):
        R = rotations.from_quaternion(x[3:7])
        given += f @ (x[7:10] + R @ np.cross(x[10:], arm)) + tau @ (R @ x[10:])
    assert (stored, dissipated) == (0.0, 0.0)
    assert injected == pytest.approx(given, rel=1e-12)


def test_derivatives_are_exact() -> None:
    """Newton's third law of calculus: a force k d^3 has the slope 3 k d^2 on the diagonal."""
    cubic = revealing(*(lambda g, i=i: 5.0 * g["displacement"][i] ** 3 for i in range(3)),
                      *(lambda g: 0.0 for _ in range(3)))  # fmt: skip
    ground, body = rs.Marker(rs.GROUND), rs.RigidBody("b", 2.0, (1.0, 1.0, 1.0))
    connector = rs.RigidBodySpringDamper("joint", ground, rs.Marker("b"), 0.0, force=cubic)
    model = compiled_full(rs.Scene("one", [body], [connector]))
    x = np.array([0.3, -0.2, 0.5, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    slope = np.array(model.function("dode_dx")(0, x, [], [], []))[7:10, :3]
    assert np.abs(slope + np.diag(15 * x[:3] ** 2 / 2)).max() < 8 * EPS


def test_published_user_force() -> None:
    """y = 10/sqrt(4375) exp(-25 t) sin(...): rates of a force that ignores the offset."""

    def force(mbs, t, item, d, r, v, w, k, c, J0, J1, offset) -> list[Any]:
        return [k[i][i] * d[i] + c[i][i] * v[i] for i in range(3)] + [
            k[i + 3][i + 3] * r[i] + c[i + 3][i + 3] * w[i] for i in range(3)
        ]

    body = rs.RigidBody("b", 1.0, (1.0, 1.0, 1.0), velocity=(0.0, 10.0, 0.0))
    connector = rs.RigidBodySpringDamper(
        "joint", rs.Marker(rs.GROUND), rs.Marker("b"), [5000.0] * 6, [50.0] * 6, [0.2] * 6,
        force=force,
    )  # fmt: skip
    model = rs.compile_scene(rs.Scene("one", [body], [connector]))
    end = rs.simulate(model, 0.1, rs.Idas(rtol=1e-10, atol=1e-12))["b.position"][-1]
    y, _ = closed_forms.damped_oscillator(0.1, 1.0, 5000.0, 50.0, 10.0)
    assert end == pytest.approx([0.0, y, 0.0], abs=1e-7)


def test_branch_with_where() -> None:
    """Symbols in the condition or in a branch are recognised as Params."""
    gap, k = rs.Param("gap", 0.0), rs.Param("k", 100.0)
    one_sided = revealing(
        lambda g: rs.where(g["displacement"][0] > gap, k * g["displacement"][0], 0.0),
        lambda g: rs.where(g["displacement"][0] <= 0, 7.0, 8.0), *(lambda g: 0.0 for _ in range(4)),
    )  # fmt: skip
    body = rs.RigidBody("b", 1.0, (1.0, 1.0, 1.0))
    connector = rs.RigidBodySpringDamper(
        "joint", rs.Marker(rs.GROUND), rs.Marker("b"), 0.0, force=one_sided
    )
    model = compiled_full(rs.Scene("one", [body], [connector]))
    for x, expected in ((0.5, (50.0, 8.0)), (-0.5, (0.0, 7.0)), (0.0, (0.0, 7.0))):
        force = model.function("joint.force_local")(0, [x, 0, 0, 1, *[0] * 9], [], [], [0, 100])
        assert tuple(np.array(force)[:2, 0]) == expected


def test_closure_over_params_and_inputs() -> None:
    soft, push = rs.Param("soft", 2.0, "N/m"), rs.Input("push", "N", 5.0)
    model = compiled(revealing(
        lambda g: soft * g["displacement"][0], lambda g: push + g["stiffness"][0][0],
        lambda g: np.sqrt(soft), *(lambda g: 0.0 for _ in range(3)),
    ), stiffness=[rs.Param("k", 3.0), *K[1:]])  # fmt: skip
    assert [(v.name, v.start, v.unit) for v in model.dae.p_labels] == [
        ("k", 3.0, ""), ("soft", 2.0, "N/m")
    ]  # fmt: skip
    assert [(v.name, v.start) for v in model.dae.u_labels] == [("push", 5.0)]
    strain = np.array(model.function("joint.displacement_local")(0, STATE, [], [5], [3, 2]))[0, 0]
    found = local(model, u=[4.0], p=[10.0, 9.0])
    assert found == pytest.approx([9 * strain, 14, 3, 0, 0, 0], rel=4 * EPS)


@pytest.mark.parametrize(("force", "error", "words"), [
    (lambda *a: [1.0] * 3 if a[3][0] > 0 else [0.0] * 3, TypeError, "connector 'joint'.*where"),
    (lambda *a: [max(a[3][0], 0.0)] + [0.0] * 5, TypeError, "connector 'joint'.*where"),
    (lambda *a: [math.sin(a[3][0])] + [0.0] * 5, TypeError, "connector 'joint'.*numpy"),
    (lambda *a: [0.0] * 5, ValueError, "connector 'joint'.*5 numbers.*returns 6"),
    (lambda *a: None, ValueError, "connector 'joint'.*returns 6"),
    (lambda *a: ["stiff"] * 6, TypeError, "connector 'joint'.*'stiff'"),
    (lambda *a: [float("nan")] * 6, ValueError, "connector 'joint'.*finite"),
    (lambda *a: [ca.SX.sym("alien")] * 6, ValueError, "connector 'joint'.*alien"),
    (lambda only: [0.0] * 6, TypeError, "connector 'joint'.*argument"),
])  # fmt: skip
def test_errors_name_connector_and_remedy(
    force: Force, error: type[Exception], words: str
) -> None:
    with pytest.raises(error, match=words):
        compiled(force)


def test_inactive_connector_costs_nothing() -> None:
    """Zero wrench and energy, the very instructions of the scene without it, and a note."""
    def scene(connectors: list[rs.RigidBodySpringDamper]) -> rs.Model:
        bodies = [rs.RigidBody(f"b{i}", 2.0, (0.3, 0.4, 0.5)) for i in (0, 1)]
        return compiled_full(rs.Scene("pair", bodies, connectors, outputs=[]))

    force = revealing(*(lambda g: 1.0 for _ in range(6)))
    for law in (rs.Standard(), rs.Intrinsic(), rs.Consistent()):
        for user in (None, force):
            resting = rs.RigidBodySpringDamper(
                "joint", rs.Marker("b0", (0.1, 0, 0)), rs.Marker("b1"), K, K, [0.1] * 6, law=law,
                force=user, active=False,
            )  # fmt: skip
            with_it, without = scene([resting]), scene([])
            assert len(with_it.dae.parts) == len(without.dae.parts)
            for name in ("ode", "dode_dx"):
                assert with_it.operations(name) == without.operations(name)
                assert with_it.function(name).str(True) == without.function(name).str(True)
            for name in ("force0", "torque0", "force1", "torque1", "force_local", "torque_local",
                         "potential_energy", "dissipated_power", "injected_power"):
                value = np.array(with_it.function(f"joint.{name}")(0, STATE, [], [], []))
                assert np.array_equal(value, np.zeros_like(value)), name
            assert any("joint" in note and "not active" in note for note in with_it.dae.notes)


def test_inactive_connector_still_measures() -> None:
    """Strain and rate stay those of the law, so that a released joint can be watched."""
    R0, R1 = (rotations.from_quaternion(STATE[i : i + 4]) for i in (3, 16))
    model = compiled(None, rs.Consistent(), active=False)
    poses = []
    for x, R, arm, turn in ((STATE[:13], R0, (0.1, 0.2, 0.3), TURN),
                            (STATE[13:], R1, (-0.3, 0.1, 0.2), TURN.T)):
        poses.append(oracle.Pose(x[:3] + R @ arm, R @ turn))
    strain, _ = oracle.middle_strain(*poses)
    for name, expected in (("displacement_local", strain[:3]), ("rotation", strain[3:])):
        value = np.array(model.function(f"joint.{name}")(0, STATE, [], [], []))[:, 0]
        assert np.abs(value - expected).max() < 64 * EPS
