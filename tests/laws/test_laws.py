"""The three laws against multiprecision references, folded or with Params, in SX, MX and C."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from oracles import laws as oracle
from oracles import rotations
from paths import stored
from scenes.small import LAWS

import rbsd_sym as rs

# All states are kept: functions are evaluated where a scene that starts at rest never goes.
compiled_full = functools.partial(rs.compile_scene, minimal=False)
EPS = float(np.finfo(float).eps)
CASES = stored("laws")["cases"]
WRENCH = ("force0", "torque0", "force1", "torque1")
# What the reference calls strain, rate and local are two outputs each.
GROUPS = {
    "wrench": WRENCH,
    "strain": ("displacement_local", "rotation"),
    "rate": ("velocity_local", "angular_velocity_local"),
    "local": ("force_local", "torque_local"),
}
QUANTITIES = tuple(q for group in GROUPS.values() for q in group)
Values = dict[str, np.ndarray]


def relative(value: np.ndarray, reference: np.ndarray) -> float:
    """Length of the difference over the length of the reference."""
    return float(np.linalg.norm(value - reference) / np.linalg.norm(reference))


def expected(case: dict[str, Any], law: str) -> Values:
    """The reference values of a case, grouped like GROUPS."""
    stored = case["laws"][law]
    wrench = np.concatenate([stored[q] for q in WRENCH])
    return {"wrench": wrench} | {g: np.array(stored[g]) for g in ("strain", "rate", "local")}


def grouped(column: np.ndarray) -> Values:
    """Outputs of one connector in the order of QUANTITIES, grouped like GROUPS."""
    ends = np.cumsum([3 * len(names) for names in GROUPS.values()])[:-1]
    return dict(zip(GROUPS, np.split(column, ends), strict=True))


def bodies_of(case: dict[str, Any], prefix: str) -> list[rs.RigidBody]:
    """The two marker carriers; the reference has world components, a body wants body axes."""
    return [
        rs.RigidBody(
            f"{prefix}{i}", 1.0, (1.0, 1.0, 1.0), position=case[f"p{i}"], rotation=case[f"R{i}"],
            velocity=case[f"v{i}"],
            angular_velocity=np.array(case[f"R{i}"]).T @ np.array(case[f"w{i}"]),
        )
        for i in (0, 1)
    ]  # fmt: skip


@functools.cache
def folded(law: str) -> tuple[rs.Model, np.ndarray]:
    """All cases side by side in one scene, every number folded into the code; and its start."""
    bodies, connectors = [], []
    for i, case in enumerate(CASES):
        bodies += bodies_of(case, f"b{i}_")
        connectors.append(rs.RigidBodySpringDamper(
            f"c{i}", rs.Marker(f"b{i}_0"), rs.Marker(f"b{i}_1"), case["stiffness"],
            case["damping"], case["offset"], law=LAWS[law],
            rotation_marker0=case["rotation_marker0"], rotation_marker1=case["rotation_marker1"],
        ))  # fmt: skip
    outputs = [f"c{i}.{q}" for i in range(len(CASES)) for q in QUANTITIES]
    model = compiled_full(rs.Scene("cases", bodies, connectors, outputs=outputs))
    return model, np.array([label.start for label in model.x_labels])


@functools.cache
def folded_values(law: str) -> list[Values]:
    """Every output of every case."""
    model, x = folded(law)
    columns = np.array(model.function("out")(0, x, [], [], [])).reshape(len(CASES), -1)
    return [grouped(column) for column in columns]


def param_matrix(name: str, rows: int, symmetric: bool) -> list[list[rs.Param]]:
    """A square matrix of Params called <name>_<i>_<j>; i <= j if it is symmetric."""
    made: dict[str, rs.Param] = {}

    def entry(i: int, j: int) -> rs.Param:
        i, j = (min(i, j), max(i, j)) if symmetric else (i, j)
        return made.setdefault(f"{i}_{j}", rs.Param(f"{name}_{i}_{j}", float(i == j)))

    return [[entry(i, j) for j in range(rows)] for i in range(rows)]


@functools.cache
def symbolic(law: str) -> rs.Model:
    """One connector whose numbers are all Params."""
    connector = rs.RigidBodySpringDamper(
        "joint", rs.Marker("b0"), rs.Marker("b1"),
        stiffness=param_matrix("stiffness", 6, True), damping=param_matrix("damping", 6, False),
        offset=[rs.Param(f"offset_{i}", 0.0) for i in range(6)], law=LAWS[law],
        rotation_marker0=param_matrix("rotation_marker0", 3, False),
        rotation_marker1=param_matrix("rotation_marker1", 3, False),
    )  # fmt: skip
    outputs = [f"joint.{q}" for q in (*QUANTITIES, "potential_energy", "dissipated_power")]
    scene = rs.Scene("one", bodies_of(CASES[0], "b"), [connector], outputs=outputs)
    return compiled_full(scene)


def arguments(model: rs.Model, index: int, **changed: np.ndarray) -> list[Any]:
    """(t, x, z, u, p) of the symbolic model for a case, with other numbers if given."""
    case = CASES[index] | changed
    p = []
    for label in model.dae.p_labels:
        name, *place = label.name.rsplit("_", 1 if label.name.startswith("offset") else 2)
        p.append(np.array(case[name])[tuple(int(i) for i in place)])
    states = folded("standard")[1].reshape(len(CASES), -1)
    return [0.0, states[index], [], [], p]


def poses(case: dict[str, Any]) -> list[oracle.Pose]:
    """The two marker frames of a case and their motions."""
    made = []
    for i in (0, 1):
        p, R, joint, v, w = (
            np.array(case[f"{name}{i}"]) for name in ("p", "R", "rotation_marker", "v", "w")
        )
        made.append(oracle.Pose(p, R @ joint, v, w))
    return made


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("index", range(len(CASES)))
def test_reference_case(law: str, index: int) -> None:
    values, stored = folded_values(law)[index], expected(CASES[index], law)
    for group in GROUPS:
        assert relative(values[group], stored[group]) < 1e-11, group
    # A double rotation matrix holds an angle to an absolute rounding error, whatever the angle.
    assert np.abs(values["strain"][3:] - stored["strain"][3:]).max() < 16 * EPS


@pytest.mark.parametrize("law", LAWS)
def test_output_functions_by_name(law: str) -> None:
    model, x = folded(law)
    for name, reference in zip(QUANTITIES, np.split(
        np.concatenate([folded_values(law)[7][g] for g in GROUPS]), len(QUANTITIES)
    ), strict=True):  # fmt: skip
        value = np.array(model.function(f"c7.{name}")(0, x, [], [], []))[:, 0]
        assert relative(value, reference) < 1e-13, name


@pytest.mark.parametrize("law", LAWS)
def test_folded_numbers_in_an_mx_call(law: str) -> None:
    model, x = folded(law)
    symbols = [ca.MX.sym(name, np.size(v)) for name, v in zip("tx", (0, x), strict=True)]
    called = ca.Function("called", symbols, [model.function("out")(*symbols, [], [], [])])
    columns = np.array(called(0, x)).reshape(len(CASES), -1)
    for values, column in zip(folded_values(law), columns, strict=True):
        for group, value in grouped(column).items():
            assert relative(value, values[group]) < 1e-13, group


@pytest.mark.parametrize("law", LAWS)
def test_params_in_sx_mx_and_c(law: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RBSD_SYM_CACHE", str(tmp_path / "cache"))
    model = symbolic(law)
    out = model.function("out")
    symbols = [ca.MX.sym(name, *out.size_in(name)) for name in "txzup"]
    in_mx = ca.Function("in_mx", symbols, [out(*symbols)])
    artefact = rs.export_c(model, tmp_path / "c", functions=["out"])
    try:
        in_c = rs.load_c(artefact, model).function("out")
    except rs.CompilerMissing as missing:
        pytest.skip(str(missing))
    for index, numbers in enumerate(folded_values(law)):
        point = arguments(model, index)
        for function in (out, in_mx, in_c):
            column = np.array(function(*point))[:, 0]
            for group, value in grouped(column[:-2]).items():
                assert relative(value, numbers[group]) < 1e-13, (function.name(), group)


@pytest.mark.parametrize("law", LAWS)
def test_stored_energy_and_dissipation(law: str) -> None:
    model = symbolic(law)
    for index, case in enumerate(CASES):
        *_, stored, dissipated = np.array(model.function("out")(*arguments(model, index)))[:, 0]
        K, D, offset = (np.array(case[k]) for k in ("stiffness", "damping", "offset"))
        e = expected(case, law)["strain"] - offset
        rate = expected(case, law)["rate"]
        assert stored == pytest.approx(e @ K @ e / 2, rel=1e-12)
        assert dissipated == pytest.approx(rate @ D @ rate, rel=1e-12)


def gradient(law: str, case: dict[str, Any]) -> np.ndarray:
    """dU by the markers' world translations and rotations, complex step of the oracle's energy."""
    h, slopes, (pose0, pose1) = 1e-30, [], poses(case)
    for step in 1j * h * np.eye(12):
        moved = [
            oracle.Pose(pose.p + d[:3], rotations.exp_so3(d[3:]) @ pose.R)
            for pose, d in ((pose0, step[:6]), (pose1, step[6:]))
        ]
        U = oracle.energy(getattr(oracle, law), *moved, case["stiffness"], case["offset"])
        slopes.append(U.imag / h)
    return np.array(slopes)


def undamped_wrench(law: str, index: int) -> np.ndarray:
    """Wrench (12) of the springs alone."""
    model = symbolic(law)
    point = arguments(model, index, damping=np.zeros((6, 6)))
    return grouped(np.array(model.function("out")(*point))[:-2, 0])["wrench"]


def test_wrench_of_consistent_is_minus_the_gradient_of_its_energy() -> None:
    for index, case in enumerate(CASES):
        slope = gradient("consistent", case)
        assert relative(undamped_wrench("consistent", index), -slope) < 32 * EPS


@pytest.mark.parametrize("law", ["standard", "intrinsic"])
def test_the_other_laws_have_another_wrench(law: str) -> None:
    """They have no potential: the wrench misses the gradient of the stored energy."""
    for index, case in enumerate(CASES):
        if case["relative_angle"] >= 1:
            assert relative(undamped_wrench(law, index), -gradient(law, case)) > 0.05
