"""Rows, constants and rotations of a program are told by structure: the names do not matter."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scenes.ocp import FORCE, SLEW, TURN, cart, hinged, massless_slew
from scenes.plane import some_rotation

import rbsd_sym as rs
from rbsd_sym.base.rotation import matrix_quat
from rbsd_sym.dae.members import Label
from rbsd_sym.ocp import Bound, Collocation, Free, Phase, Problem, Shooting, optimise, transcribe
from rbsd_sym.ocp.nlp import Nlp, RowKind, Where
from rbsd_sym.ocp.traced import Role, trace_problem

FORMULATIONS = [rs.Quaternion(), rs.TaitBryan()]
C, S = np.cos(0.3), np.sin(0.3)


def renamed(model: rs.Model) -> rs.Model:
    """The same model with names of states that mean nothing."""
    labels = tuple(
        Label("thing", f"s{i}", "", label.unit, label.start)
        for i, label in enumerate(model.x_labels)
    )
    return replace(model, dae=replace(model.dae, x_labels=labels), scene=None)


def orientations(model: rs.Model) -> Problem:
    """From one orientation to another, given as a quaternion and as a matrix."""
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    effort = lambda v: sum(v[f"tau_{axis}"] ** 2 for axis in "xyz")  # noqa: E731
    phase = Phase(2.0, start={"body.quaternion": (C, S, 0, 0)},
                  end={"body.rotation_matrix": turn, "body.angular_velocity": (0, 0, 0)},
                  integral=effort)  # fmt: skip
    return Problem(model, phase, inputs={f"tau_{axis}": Free() for axis in "xyz"})


def periodic(model: rs.Model) -> Problem:
    phase = Phase(Free(1.0, 0.5, 2), integral=lambda v: (v["energy"] - 1) ** 2 + v["force"] ** 2)
    return Problem(model, phase, inputs={"force": Free()}, periodic=True)


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=lambda f: type(f).__name__)
@pytest.mark.parametrize(("scene", "problem"), [(TURN.scene, orientations), (hinged, periodic)])
def test_names_of_states_do_not_matter(scene: Any, problem: Any, formulation: Any) -> None:
    """Start, goal and return of rotations, the norm row, and the guess on the short arc."""
    model = replace(rs.compile_scene(scene(), formulation, minimal=False), scene=None)
    method = Collocation(3, 2, input_degree=1)
    ours, theirs = (transcribe(problem(m), method) for m in (model, renamed(model)))
    for key, value in ours.bounds.items():
        assert np.array_equal(theirs.bounds[key], value), key
    w = ours.bounds["x0"] + 0.1 * np.random.default_rng(0).standard_normal(ours.n)
    for one, two in zip(*(nlp.functions["nlp"](w, []) for nlp in (ours, theirs)), strict=True):
        assert np.array_equal(np.array(one), np.array(two))
    kinds = Counter(row.kind for part in ours.segments for row in part.rows)
    turns = isinstance(formulation, rs.Quaternion)
    assert kinds[RowKind.norm] == (turns and problem is periodic)
    assert kinds == Counter(row.kind for part in theirs.segments for row in part.rows)


def counted(nlp: Nlp, where: Where) -> Counter[tuple[RowKind, int]]:
    return Counter((row.kind, row.phase) for part in nlp.segments if part.where is where
                   for row in part.rows)  # fmt: skip


def test_rows_of_collocation() -> None:
    """Two phases of a model with unknowns: what each row says, where, and of what."""
    model = rs.compile_scene(massless_slew())
    near = {"near.force_local": (-9, 9), "hub.v_x": (None, 5)}
    phases = [Phase(1.0, path=near), Phase(Free(1.0, 0.5), end={"mid.p_x": 1.5, "hub.v_x": 0})]
    nlp = transcribe(Problem(model, phases, inputs={"push": Free()}),
                     Collocation(3, 2, path_points=1))  # fmt: skip
    n_y = model.n_x + 1  # and the horizon
    assert counted(nlp, Where.path) == {
        (RowKind.motion, 0): n_y, (RowKind.motion, 1): n_y,
        (RowKind.rate, 0): 2 * 4, (RowKind.rate, 1): 2 * 4,
        (RowKind.balance, 0): 2, (RowKind.balance, 1): 2,
        (RowKind.path, 0): 2, (RowKind.limit, 0): 2,  # the force along x; beside it the speed
    }  # fmt: skip
    assert counted(nlp, Where.end) == {
        (RowKind.link, 0): n_y, (RowKind.balance, 1): 1, (RowKind.end, 1): 1}  # fmt: skip
    body = nlp.segments[0]
    root = np.sqrt(3) / 6  # Gauss points of degree 2
    nodes = {round(row.node, 12) for row in body.rows if row.kind is RowKind.rate}
    assert sorted(nodes) == pytest.approx([0.5 - root, 0.5 + root])
    assert {row.node for row in body.rows if row.kind is RowKind.limit} == {0.5}
    names = [row.name for row in body.rows]
    assert names[:5] == [f"motion of {name}" for name in (
        "hub.p_x", "hub.v_x", "tip.p_x", "tip.v_x", "horizon of phase 1")]  # fmt: skip
    assert {"rate of tip.v_x", "balance of mid.p_x", "near.force_local_x"} <= set(names)
    assert [v.name for v in body.variables][5:9] == ["push", "hub.p_x", "hub.v_x", "tip.p_x"]


def test_rows_of_shooting() -> None:
    wall = Bound("cart.p_x", high=2.0)
    phase = Phase(1.0, path={"wall": wall, "cart.v_x": (-3, 3)}, end={"cart.p_x": 1.0})
    problem = Problem(rs.compile_scene(cart()), phase, inputs={"force": Free()})
    nlp = transcribe(problem, Shooting(2, 4))
    assert counted(nlp, Where.path) == {
        (RowKind.motion, 0): 2, (RowKind.limit, 0): 3 * 2, (RowKind.path, 0): 1}  # fmt: skip
    rows = nlp.segments[0].rows
    assert [row.node for row in rows if row.label.name == "wall"] == [0.25, 0.5, 0.75, 1.0]


def test_constants_know_their_role() -> None:
    k = rs.Param("k", 2.0, "N")
    body = rs.RigidBody("cart", 1.0, (1, 1, 1))
    loads = [rs.Load("push", rs.Marker("cart"), force=(FORCE + k, 0, 0))]
    model = rs.compile_scene(rs.Scene("cart", [body], [], loads))
    phases = [Phase(1.0), Phase(Free(2.0, 1, 3))]
    params = {"k": Free(low=1, high=4)}
    found = trace_problem(Problem(model, phases, {"force": Free()}, params, periodic=True))
    said = [(c.role, c.index, c.label.name, c.low, c.label.start) for c in found.constants]
    assert said == [
        (Role.horizon, 1, "horizon of phase 1", 1, 2.0), (Role.parameter, 0, "k", 1, 2.0),
        (Role.start, 0, "start of cart.p_x", -np.inf, 0.0),
        (Role.start, 1, "start of cart.v_x", -np.inf, 0.0)]  # fmt: skip
    s = np.array([2.5, 3.0, 7.0, 8.0])
    assert found.durations(s) == [1.0, 2.5]
    assert found.parameters(s) == [3.0]
    assert list(found.start_copy(s)) == [7.0, 8.0]


def test_a_multiplier_of_a_condition_on_an_unknown_is_its_price() -> None:
    """It stands alone under its name, beside the equation that gives the unknown there."""

    def solved(goal: float) -> Any:
        end = {"mid.p_x": goal, "hub.v_x": 0, "tip.v_x": 0}
        phase = Phase(5.0, end=end, integral=SLEW.PUSH**2 / 2)
        model = rs.compile_scene(massless_slew())
        problem = Problem(model, phase, inputs={"push": Free()})
        return optimise(problem, Collocation(6, 4), fly=False)

    h = 1e-3
    slope = (solved(1.5 + h).cost - solved(1.5 - h).cost) / (2 * h)
    price = solved(1.5).multipliers["end mid.p_x"]
    assert price.shape == (1,)
    assert abs(price[0]) == pytest.approx(abs(slope), rel=1e-6)
    assert abs(slope) > 0.1


def spinner(R: np.ndarray) -> rs.Scene:
    """A body that a motor turns about an axis of its own, which R makes any axis of the world."""
    torque = rs.Input("torque", "N m")
    spring = rs.RigidBodySpringDamper("spring", rs.Marker(rs.GROUND, rotation=R), rs.Marker("body"),
                                      [9, 9, 9, 9, 9, 0.5], law=rs.Consistent())  # fmt: skip
    motor = rs.Load("motor", rs.Marker("body"), torque=(0, 0, torque), frame="body")
    return rs.Scene("spinner", [rs.RigidBody("body", 1, (1, 2, 3), rotation=R)], [spring], [motor])


@pytest.mark.parametrize("given", ["quaternion", "rotation_matrix", "states"])
def test_an_orientation_in_a_plane_of_any_normal(given: str) -> None:
    """The model has one angle, about no axis of the world; the goal is a rotation to the world."""
    R = some_rotation(np.random.default_rng(4))
    upright, tilted = (rs.compile_scene(spinner(M)) for M in (np.eye(3), R))
    assert upright.n_x == tilted.n_x == 2
    costs = []
    for model, M in ((upright, np.eye(3)), (tilted, R)):
        goal = M @ np.array([[C, -S, 0], [S, C, 0], [0, 0, 1]])
        q = np.array(matrix_quat(ca.DM(goal))).reshape(-1)
        end = {"states": {f"body.q_{axis}": float(v) for axis, v in zip("wxyz", q, strict=True)},
               "quaternion": {"body.quaternion": q},
               "rotation_matrix": {"body.rotation_matrix": goal}}[given]  # fmt: skip
        phase = Phase(1.0, end={**end, "body.angular_velocity": (0, 0, 0)},
                      integral=lambda v: v["torque"] ** 2)  # fmt: skip
        found = optimise(Problem(model, phase, inputs={"torque": Free()}), Collocation(4, 3))
        costs.append(found.cost)
        assert np.abs(found.trajectory["body.rotation_matrix"][-1] - goal).max() < 1e-8
        assert found.flown is not None
        assert found.flown.difference < 1e-4
    assert costs[0] == pytest.approx(costs[1], rel=1e-8)
    assert costs[0] > 1
