"""The element as it is documented: its user function, its defaults, the names of its outputs."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import rotations

import rbsd_sym as rs
from rbsd_sym.ocp.terms import Names
from rbsd_sym.plots.shapes import drawing_of

TURN0, TURN1 = rotations.exp_so3([0, 0, 0.35]), rotations.exp_so3([0.6, 0.2, -0.1])
NAMES = {
    "DisplacementLocal": "displacement_local",
    "VelocityLocal": "velocity_local",
    "Rotation": "rotation",
    "AngularVelocityLocal": "angular_velocity_local",
    "ForceLocal": "force_local",
    "TorqueLocal": "torque_local",
    "activeConnector": "active",
}


def simple(mbs, t, itemNumber, displacement, rotation, velocity, angularVelocity,
           stiffness, damping, rotJ0, rotJ1, offset):  # fmt: skip
    """The documented example: three springs, from the diagonal of the stiffness."""
    k, u = stiffness, displacement
    return [u[0] * k[0][0], u[1] * k[1][1], u[2] * k[2][2], 0, 0, 0]


def everything(mbs, t, itemNumber, displacement, rotation, velocity, angularVelocity,
               stiffness, damping, rotJ0, rotJ1, offset):  # fmt: skip
    """Uses every argument, in the ways of code for lists of numbers."""
    own = np.array(mbs.GetObjectParameter(itemNumber, "stiffness"))
    x = np.array([*displacement, *rotation]) - np.array(offset)
    v = np.array([*velocity, *angularVelocity])
    force = own @ x + np.array(damping) @ v + 0.1 * np.array(stiffness) @ np.sign(x)
    force[:3] += np.array(rotJ0) @ np.clip(v[:3], -0.5, 0.5)
    force[3:] += np.array(rotJ1).T @ np.maximum(x[3:], 0.0) + t
    return [*force[:3], np.interp(x[0], [-1, 0, 1], [5, -2, 3]), *force[4:]]


K, D = np.diag([500.0, 600.0, 700.0, 20.0, 30.0, 40.0]), np.diag([5.0, 6.0, 7.0, 0.2, 0.3, 0.4])
K[0, 4] = 12.0
OFFSET = [0.01, -0.02, 0.03, 0.1, -0.2, 0.05]
POSITION, ANGLES = np.array([0.3, -0.2, 0.4]), np.array([0.3, -0.4, 0.2])
VELOCITY, RATES = np.array([0.7, -0.9, 0.2]), np.array([0.5, 0.4, -0.3])


def scene(force: Any, rotation: Any, spin: Any) -> rs.Scene:
    body = rs.RigidBody("b", 1.5, (0.2, 0.3, 0.4), position=POSITION, rotation=rotation,
                        velocity=VELOCITY, angular_velocity=spin)  # fmt: skip
    joint = rs.RigidBodySpringDamper(
        "c", rs.Marker("b", (0.1, 0, 0)), rs.Marker(rs.GROUND), K, D, OFFSET,
        rotation_marker0=TURN0, rotation_marker1=TURN1, force=force,
    )  # fmt: skip
    return rs.Scene("s", [body], [joint])


@pytest.mark.parametrize("force", [simple, everything])
def test_user_functions_give_what_they_give_numbers(force: Any) -> None:
    """Arguments by hand from the documented definitions; rotJ0, rotJ1 are the joint's rotations."""
    R, spin = rotations.from_tait_bryan(ANGLES), np.array([0.4, -0.6, 0.8])
    model = rs.compile_scene(scene(force, R, spin), minimal=False)
    run = rs.simulate(model, [0, 1e-6])
    A0 = R @ TURN0
    arm = R @ [0.1, 0, 0]
    strain = A0.T @ -(POSITION + arm), rotations.to_tait_bryan(A0.T @ TURN1)
    rate = A0.T @ -(VELOCITY + np.cross(R @ spin, arm)), A0.T @ -(R @ spin)

    class Numbers:
        def GetObjectParameter(self, item: int, name: str) -> Any:
            return {"stiffness": K}[name]

    given = (*strain, *rate, K, D, TURN0, TURN1, np.array(OFFSET))
    expected = np.array(force(Numbers(), 0.0, 0, *given), float)
    found = np.concatenate([run["c.ForceLocal"][0], run["c.TorqueLocal"][0]])
    assert np.abs(found - expected).max() < 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("force", [simple, everything])
def test_exudyn_gives_the_same(force: Any) -> None:
    sys.__dict__.setdefault("exudynFast", True)  # before the first import, as elsewhere
    exu = pytest.importorskip("exudyn")
    exu.config.printToConsole = False
    items, kind = exu.itemInterface, exu.OutputVariableType
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    ground = mbs.CreateGround()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # it is to give up rotationMarker0
        node = mbs.AddNode(items.NodeRigidBodyRxyz(
            referenceCoordinates=[*POSITION, *ANGLES], initialVelocities=[*VELOCITY, *RATES]
        ))  # fmt: skip
        body = mbs.AddObject(items.ObjectRigidBody(
            nodeNumber=node, mass=1.5, inertia=[0.2, 0.3, 0.4, 0, 0, 0]
        ))  # fmt: skip
        markers = [
            mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=body, localPosition=[0.1, 0, 0])),
            mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=ground)),
        ]
        connector = mbs.AddObject(items.ObjectConnectorRigidBodySpringDamper(
            markerNumbers=markers, stiffness=K, damping=D, offset=OFFSET, rotationMarker0=TURN0,
            rotationMarker1=TURN1, springForceTorqueUserFunction=force,
        ))  # fmt: skip
    mbs.Assemble()
    rotation = mbs.GetNodeOutput(node, kind.RotationMatrix).reshape(3, 3)
    spin = mbs.GetNodeOutput(node, kind.AngularVelocityLocal)
    model = rs.compile_scene(scene(force, rotation, spin), minimal=False)
    run = rs.simulate(model, [0, 1e-6])
    for name in list(NAMES)[:6]:
        theirs = mbs.GetObjectOutput(connector, getattr(kind, name))
        assert run[f"c.{name}"][0] == pytest.approx(theirs, rel=1e-12, abs=1e-12), name


def test_outputs_answer_to_their_documented_names(tmp_path: Path) -> None:
    """In scenes, functions, trajectories, files, sensitivities and optimal control."""
    push = rs.Input("push", "N", 1.0)
    stiff = rs.Param("stiff", 50.0)
    body = rs.RigidBody("b", 1.5, (0.2, 0.3, 0.4))
    joint = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), [stiff] * 6)
    load = rs.Load("load", rs.Marker("b"), force=(push, 0, 0))

    def model(outputs: list[str]) -> rs.Model:
        return rs.compile_scene(rs.Scene("s", [body], [joint], [load], outputs=outputs))

    asked = model([f"c.{name}" for name in NAMES])
    ours = model([f"c.{name}" for name in NAMES.values()])
    assert asked.dae.requested == ours.dae.requested
    assert [v.name for v in asked.dae.out_labels] == [v.name for v in ours.dae.out_labels]
    run = rs.simulate(ours, 0.5)
    for documented, name in NAMES.items():
        assert asked.function(f"c.{documented}") is asked.function(f"c.{name}")
        assert np.array_equal(run[f"c.{documented}"], run[f"c.{name}"])
        assert f"c.{documented}" in run
        assert f"c.{documented}" not in run.columns
    assert "c.Force" not in run
    assert "b.ForceLocal" not in run
    loaded = rs.Trajectory.load(run.save(tmp_path / "run"))
    assert np.array_equal(loaded["c.ForceLocal"], run["c.force_local"])
    slopes = [
        rs.sensitivity(ours, 0.5, wrt=["stiff"], outputs=[f"c.{name}"])
        for name in ("ForceLocal", "force_local")
    ]
    first, second = (np.asarray(s[name]) for s, name in zip(
        slopes, ("c.ForceLocal", "c.force_local"), strict=True))  # fmt: skip
    assert np.array_equal(first, second)
    with pytest.raises(ValueError, match=r"no output 'c.Velocity'; there are: c\."):
        model(["c.Velocity"])


def test_problems_answer_to_documented_names() -> None:
    push = rs.Input("push", "N", 0.0)
    body = rs.RigidBody("b", 1.0, (1, 1, 1))
    joint = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), [1] * 6)
    load = rs.Load("load", rs.Marker("b"), force=(push, 0, 0))
    model = rs.compile_scene(rs.Scene("s", [body], [joint], [load]))
    known = Names(model)
    for documented, name in NAMES.items():
        assert repr(known[f"c.{documented}"]) == repr(known[f"c.{name}"])
        assert np.shape(np.maximum(known[f"c.{name}"], 0)) == np.shape(known[f"c.{name}"])
        assert known.find(f"c.{documented}").labels == known.find(f"c.{name}").labels
        assert f"c.{documented}" not in list(model.dae.outputs)


def test_active_is_asked_for_by_name() -> None:
    """It is in no default output, so that models are what they were."""
    markers = rs.Marker(rs.GROUND), rs.Marker("b")
    connectors = [
        rs.RigidBodySpringDamper("yes", *markers, [1] * 6),
        rs.RigidBodySpringDamper("no", *markers, [1] * 6, active=False),
    ]
    model = rs.compile_scene(rs.Scene("s", [rs.RigidBody("b", 1, (1, 1, 1))], connectors))
    assert not any(name.endswith(".active") for name in model.dae.requested)
    run = rs.simulate(model, 0.1)
    assert (run["yes.activeConnector"] == 1).all()
    assert (run["no.activeConnector"] == 0).all()


def test_defaults_are_the_documented_ones() -> None:
    markers = rs.Marker(rs.GROUND), rs.Marker("b")
    bare = rs.RigidBodySpringDamper("c", *markers)
    zeros = rs.RigidBodySpringDamper("c", *markers, np.zeros((6, 6)))
    body = rs.RigidBody("b", 1, (1, 1, 1), velocity=(1, 0, 0))
    texts = [rs.Scene("s", [body], [c]).text for c in (bare, zeros)]
    assert texts[0] == texts[1]
    run = rs.simulate(rs.compile_scene(rs.Scene("s", [body], [bare])), 1.0)
    assert run["b.position"][-1] == pytest.approx([1, 0, 0], abs=1e-9)
    assert np.array_equal(run["c.ForceLocal"], np.zeros((201, 3)))


@pytest.mark.parametrize("given", [
    {"draw_size": -1}, {"draw_size": -1.0, "color": (-1, -1, -1, -1)},
    {"color": [-1.0, -1.0, -1.0, -1.0]}, {"draw_size": None, "color": None},
])  # fmt: skip
def test_documented_drawing_defaults_draw_the_same(given: dict[str, Any]) -> None:
    markers = rs.Marker(rs.GROUND), rs.Marker("b")
    body = rs.RigidBody("b", 1, (1, 1, 1))
    springs = [rs.RigidBodySpringDamper("c", *markers, [1] * 6, **more) for more in (given, {})]
    (drawn,), (plain,) = (drawing_of(rs.Scene("s", [body], [s])).connectors for s in springs)
    assert (drawn.diameter, drawn.color) == (plain.diameter, plain.color)
