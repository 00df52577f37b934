"""Reference scenes at tight tolerances, and random scenes against the numpy oracle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracles import closed_forms, rotations, scenes
from scenes import reference
from scenes.small import LAWS

import rbsd_sym as rs

Array = NDArray[np.float64]
EPS = float(np.finfo(float).eps)
FORMULATIONS = [rs.Quaternion(), rs.TaitBryan()]
# Relative rotations (rad) drawn for each law: away from the pitch of 90 degrees, and from pi.
REACH = {"standard": 1.2, "intrinsic": 2.5, "consistent": 2.5}
# `pair` crosses the singularity of Standard's Tait-Bryan angles, where the law jumps;
# `pair_intrinsic` amplifies a start perturbation by up to 4e7, so 1e-10 leaves about 1e-5.
LIMITS = {"pair": 2e-2, "pair_intrinsic": 1e-3}
# Bodies of the pairs turn through a pitch of 90 degrees; all others stay away from it.
SMALL_PITCH = [name for name in reference.SCENES if not name.startswith("pair")]
# Random, but the same in every run, and without a database file in the working folder.
few = settings(max_examples=15, deadline=None, derandomize=True, database=None)


def by_name(value: Any) -> str:
    """Test id of a formulation or integrator."""
    return type(value).__name__


@pytest.mark.parametrize("name", reference.SCENES)
def test_reference_scene(name: str) -> None:
    model = rs.compile_scene(reference.build(name))
    trajectory = rs.simulate(
        model, reference.SCENES[name]["t_end"], rs.Idas(rtol=1e-10, atol=1e-12)
    )
    assert reference.error(name, trajectory) < LIMITS.get(name, 1e-7)


@pytest.mark.parametrize(
    "integrator", [rs.Idas(1e-14, 1e-14), rs.ExplicitRK(1e-13, 1e-14)], ids=by_name
)
def test_sensitive_reference_scene_at_the_tightest_tolerances(integrator: Any) -> None:
    model = rs.compile_scene(reference.build("pair_intrinsic"))
    trajectory = rs.simulate(model, 1.0, integrator)
    assert reference.error("pair_intrinsic", trajectory) < 1e-7


@pytest.mark.parametrize("name", SMALL_PITCH)
def test_formulations_agree(name: str) -> None:
    """Along the whole motion, through outputs: the states differ."""
    t_end = reference.SCENES[name]["t_end"]
    scene = reference.build(name)
    one, other = (
        rs.simulate(rs.compile_scene(scene, formulation=f), t_end, rs.Idas(1e-10, 1e-12))
        for f in FORMULATIONS
    )
    for body in scene.bodies:
        for quantity in ("position", "rotation_matrix", "velocity", "angular_velocity"):
            a, b = one[f"{body.name}.{quantity}"], other[f"{body.name}.{quantity}"]
            excursion = max(np.abs(a - a[0]).max(), 1e-3)
            assert np.abs(a - b).max() < 1e-7 * excursion, (body.name, quantity)
    scale = max(1.0, np.abs(one["energy"]).max())
    assert np.abs(one["energy"] - other["energy"]).max() < 1e-7 * scale


@dataclass(frozen=True)
class Case:
    """One random scene twice: for the package, and as the oracle's dict with loads beside it.

    The oracle describes bodies at their centre of mass. Each load is (body, point from the centre
    of mass in body axes, force, torque, frame).
    """

    scene: rs.Scene
    oracle: dict[str, Any]
    loads: list[tuple[int, Array, Array, Array, str]]

    @property
    def state(self) -> Array:
        """The start (n, 13): p of the centre of mass, q, v of it, w in body axes."""
        return scenes.start_state(self.oracle)


def random_rotation(rng: np.random.Generator) -> Array:
    """Any rotation with a pitch of less than 1.2 rad, so that both formulations can hold it."""
    return rotations.from_tait_bryan(rng.uniform([-3, -1.2, -3], [3, 1.2, 3]))


def written(rng: np.random.Generator, R: Array) -> Array:
    """The rotation as matrix or as quaternion of either sign."""
    kind = rng.integers(3)
    return R if kind == 0 else (-1) ** kind * rotations.to_quaternion(R)


def psd(rng: np.random.Generator, scale: float) -> Array:
    """A random positive semidefinite 6x6 matrix of rank 5."""
    B = rng.normal(size=(6, 5))
    K = scale * B @ B.T
    return (K + K.T) / 2


def random_body(rng: np.random.Generator, i: int) -> tuple[rs.RigidBody, dict[str, Any], Array]:
    """A body, the oracle's dict of it, and its centre of mass."""
    mass, com = rng.uniform(0.5, 3), rng.normal(size=3) * 0.4
    axes, second_moments = random_rotation(rng), rng.uniform(0.05, 1, 3)
    inertia = axes @ np.diag(second_moments.sum() - second_moments) @ axes.T
    inertia = (inertia + inertia.T) / 2
    R, p, v, w = random_rotation(rng), *rng.normal(size=(3, 3))
    body = rs.RigidBody(f"b{i}", mass, inertia, com, p, written(rng, R), v, w)
    oracle = {
        "mass": mass, "inertia": inertia, "rotation": R, "position": p + R @ com,
        "velocity": v + R @ np.cross(w, com), "angular_velocity": w,
    }  # fmt: skip
    return body, oracle, com


def random_connector(
    rng: np.random.Generator, i: int, ends: tuple[int, int], law: str, oracles: list[Any],
    coms: list[Array],
) -> tuple[rs.RigidBodySpringDamper, dict[str, Any]]:
    """A connector between two bodies (-1: ground) with markers and joint frames turned at random.

    Marker 1 is turned so that the relative rotation is a drawn one within the law's reach.
    """
    axis = rng.normal(size=3)
    R_AC = rotations.exp_so3(axis / np.linalg.norm(axis) * rng.uniform(0, REACH[law]))
    R_WB = [oracles[b]["rotation"] if b >= 0 else np.eye(3) for b in ends]
    joints, turned = [random_rotation(rng) for _ in ends], [random_rotation(rng)]
    turned.append(R_WB[1].T @ (R_WB[0] @ turned[0] @ joints[0]) @ R_AC @ joints[1].T)
    points = rng.normal(size=(2, 3)) * 0.5
    markers = [
        rs.Marker(f"b{b}" if b >= 0 else rs.GROUND, p, written(rng, R))
        for b, p, R in zip(ends, points, turned, strict=True)
    ]
    K, D = psd(rng, 100.0), psd(rng, 5.0)
    offset, rate = rng.normal(size=(2, 6)) * 0.1
    connector = rs.RigidBodySpringDamper(
        f"c{i}", *markers, K, D, offset, rate, written(rng, joints[0]), written(rng, joints[1]),
        law=LAWS[law],
    )
    oracle = {"law": law, "stiffness": K, "damping": D, "offset": offset, "velocity_offset": rate}
    for end, b in enumerate(ends):
        oracle |= {
            f"body{end}": b, f"rotation{end}": turned[end], f"rotation_marker{end}": joints[end],
            f"position{end}": points[end] - (coms[b] if b >= 0 else 0),
        }  # fmt: skip
    return connector, oracle


def random_case(
    seed: int, n: int, laws: list[str], grounded: bool = True, loaded: bool = True
) -> Case:
    """A chain of n bodies, with `grounded` also tied to the ground at both ends."""
    rng = np.random.default_rng(seed)
    bodies, oracles, coms = map(list, zip(*(random_body(rng, i) for i in range(n)), strict=True))
    ends = [(i, i + 1) for i in range(n - 1)]
    ends += [(-1, 0), (n - 1, -1)] if grounded else []
    pairs = [random_connector(rng, i, e[:: rng.choice([-1, 1])], laws[i % len(laws)], oracles, coms)
             for i, e in enumerate(ends)]
    items, loads = [], []
    for i in range(n if loaded else 0):
        point, f, m = rng.normal(size=(3, 3))
        frame = ("world", "body")[rng.integers(2)]
        items.append(rs.Load(f"l{i}", rs.Marker(f"b{i}", point, random_rotation(rng)), f, m, frame))
        loads.append((i, point - coms[i], f, m, frame))
    gravity = rng.normal(size=3) if loaded else np.zeros(3)
    # Outputs are built on demand: all of them for every drawn scene would take most of the time.
    scene = rs.Scene("random", bodies, [pair[0] for pair in pairs], items, gravity, outputs=())
    oracle = {"gravity": gravity, "law": "standard", "bodies": oracles,
              "connectors": [pair[1] for pair in pairs]}
    return Case(scene, oracle, loads)


def load_wrench(case: Case, load: tuple[int, Array, Array, Array, str]) -> tuple[Array, Array]:
    """Force and moment about the centre of mass, world axes, of a load at the start."""
    i, point, f, m, frame = load
    R = case.oracle["bodies"][i]["rotation"]
    f, m = (f, m) if frame == "world" else (R @ f, R @ m)
    return f, m + np.cross(R @ point, f)


def oracle_rates(case: Case) -> Array:
    """The oracle's rates (n, 13) with the loads added by Newton and Euler."""
    out = scenes.rates(case.oracle, case.state)
    for load in case.loads:
        body, (f, m) = case.oracle["bodies"][load[0]], load_wrench(case, load)
        out[load[0], 7:10] += f / body["mass"]
        out[load[0], 10:] += np.linalg.solve(body["inertia"], body["rotation"].T @ m)
    return out


def angle_rates(x: Array) -> tuple[Array, Array]:
    """Tait-Bryan angles of a body's state and their rates, by a complex step along R' = R [w]x."""
    R, h = rotations.from_quaternion(x[3:7]), 1e-30
    angles = rotations.to_tait_bryan(R + 1j * h * R @ rotations.skew(x[10:]))
    return angles.real, angles.imag / h


def columns(case: Case, formulation: Any) -> tuple[dict[str, float], dict[str, float]]:
    """States and rates by the names of the formulation."""
    values, slopes = {}, {}
    for i, (x, dx) in enumerate(zip(case.state, oracle_rates(case), strict=True)):
        middle = (x[3:7], dx[3:7])
        if isinstance(formulation, rs.TaitBryan):
            middle = angle_rates(x)
        names = [f"b{i}.{name}" for name in (
            *("p_x", "p_y", "p_z"),
            *(("q_w", "q_x", "q_y", "q_z") if len(middle[0]) == 4 else ("a_x", "a_y", "a_z")),
            *("v_x", "v_y", "v_z", "w_x", "w_y", "w_z"),
        )]  # fmt: skip
        values |= dict(zip(names, [*x[:3], *middle[0], *x[7:]], strict=True))
        slopes |= dict(zip(names, [*dx[:3], *middle[1], *dx[7:]], strict=True))
    return values, slopes


def state_vector(model: rs.Model, values: dict[str, float]) -> Array:
    """The model's x in its own order."""
    return np.array([values[label.name] for label in model.x_labels])


laws_of_a_chain = st.lists(st.sampled_from(sorted(LAWS)), min_size=1, max_size=4)
seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 3)


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
@few
@given(seed=seeds, n=sizes, laws=laws_of_a_chain)
def test_rates_equal_the_oracle(formulation: Any, seed: int, n: int, laws: list[str]) -> None:
    """Largest error of each block (positions, rotations, velocities, spins) by its largest rate."""
    case = random_case(seed, n, laws)
    model = rs.compile_scene(case.scene, formulation=formulation)
    values, slopes = columns(case, formulation)
    rates = np.array(model.function("ode")(0, state_vector(model, values), [], [], [])).ravel()
    for kind in "pqavw":
        rows = [i for i, v in enumerate(model.x_labels) if v.name.split(".")[1][0] == kind]
        expected = np.array([slopes[model.x_labels[i].name] for i in rows])
        if len(rows):
            assert np.abs(rates[rows] - expected).max() <= 1e-11 * np.abs(expected).max(), kind


@few
@given(seed=seeds, n=sizes, laws=laws_of_a_chain, stretch=st.floats(0.5, 2))
def test_quaternion_norm_does_not_act(seed: int, n: int, laws: list[str], stretch: float) -> None:
    case = random_case(seed, n, laws)
    model = rs.compile_scene(case.scene)
    start = np.array([label.start for label in model.x_labels]).reshape(n, 13)
    longer = start.copy()
    longer[:, 3:7] *= stretch
    ode = model.function("ode")
    a, b = (np.array(ode(0, x.ravel(), [], [], [])).reshape(n, 13) for x in (start, longer))
    assert np.abs(a[:, 7:] - b[:, 7:]).max() <= 1e-11 * np.abs(a[:, 7:]).max()


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
@few
@given(seed=seeds, n=sizes)
def test_start_is_the_described_one(formulation: Any, seed: int, n: int) -> None:
    """States at the centre of mass, outputs at the frame's origin."""
    case = random_case(seed, n, ["consistent"], grounded=False)
    model = rs.compile_scene(case.scene, formulation=formulation)
    start = {label.name: label.start for label in model.x_labels}
    x = state_vector(model, start)
    for i, body in enumerate(case.scene.bodies):
        for quantity in ("position", "velocity", "angular_velocity"):
            error = measure(model, f"b{i}.{quantity}", x) - getattr(body, quantity)
            assert np.abs(error).max() < 100 * EPS
        R = measure(model, f"b{i}.rotation_matrix", x).reshape(3, 3)
        assert np.abs(R - case.oracle["bodies"][i]["rotation"]).max() < 100 * EPS
        centre = [start[f"b{i}.p_{axis}"] for axis in "xyz"]
        assert np.abs(centre - case.oracle["bodies"][i]["position"]).max() < 100 * EPS


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
@few
@given(seed=seeds, law=st.sampled_from(sorted(LAWS)))
def test_connector_outputs_equal_the_oracle(formulation: Any, seed: int, law: str) -> None:
    case = random_case(seed, 2, [law], grounded=False)
    model = rs.compile_scene(case.scene, formulation=formulation)
    x = np.array([label.start for label in model.x_labels])
    result = scenes.connector_result(case.oracle, case.state, case.oracle["connectors"][0])
    six = {"displacement_local rotation": result.strain, "force_local torque_local": result.local,
           "velocity_local angular_velocity_local": result.rate,
           "force0 torque0": np.append(result.force0, result.torque0),
           "force1 torque1": np.append(result.force1, result.torque1)}  # fmt: skip
    for names, expected in six.items():
        value = np.concatenate([measure(model, f"c0.{name}", x) for name in names.split()])
        assert np.abs(value - expected).max() <= 1e-12 * np.abs(expected).max(), names
    expected = scenes.energy(case.oracle, case.state)
    assert measure(model, "energy", x)[0] == pytest.approx(expected, rel=1e-12)


def measure(model: rs.Model, name: str, x: Array) -> Array:
    """An output at t = 0."""
    return np.array(model.function(name)(0, x, [], [], [])).ravel()


def along_motion(model: rs.Model, name: str, x: Array) -> tuple[Array, Array]:
    """An output differentiated along the motion, and the size of the largest terms."""
    dae = model.dae
    value = dae.output(name)
    slope = ca.jacobian(value, dae.x)
    rate = slope @ dae.ode + ca.jacobian(value, dae.t)
    size = ca.fabs(slope) @ ca.fabs(dae.ode)
    both = ca.Function("along", model.symbols, [rate, size])(0, x, [], [], [])
    return np.array(both[0]).ravel(), np.array(both[1]).max()


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
@few
@given(seed=seeds, n=sizes, laws=laws_of_a_chain)
def test_energy_budget(formulation: Any, seed: int, n: int, laws: list[str]) -> None:
    """Energy changes by what connectors dissipate and inject, and by the power of the loads."""
    case = random_case(seed, n, laws)
    model = rs.compile_scene(case.scene, formulation=formulation)
    x = np.array([label.start for label in model.x_labels])
    rate, scale = along_motion(model, "energy", x)
    power = 0.0
    for load in case.loads:
        (f, m), state = load_wrench(case, load), case.state[load[0]]
        power += f @ state[7:10] + m @ case.oracle["bodies"][load[0]]["rotation"] @ state[10:]
    total, scale = power, scale + abs(power)
    for i, connector in enumerate(case.oracle["connectors"]):
        dissipated = measure(model, f"c{i}.dissipated_power", x)[0]
        injected = measure(model, f"c{i}.injected_power", x)[0]
        total += injected - dissipated
        scale += abs(injected) + abs(dissipated)
        result = scenes.connector_result(case.oracle, case.state, connector)
        D, pull = connector["damping"], connector["velocity_offset"]
        slip = result.rate - pull
        assert dissipated == pytest.approx(slip @ D @ slip, abs=1e-11 * scale)
        if connector["law"] == "consistent":  # nothing but the driven rate gives power
            assert injected == pytest.approx(-pull @ D @ slip, abs=1e-11 * scale)
    assert rate[0] == pytest.approx(total, abs=1e-11 * scale)


@few
@given(seed=seeds, n=st.integers(2, 3))
def test_free_flight_keeps_momentum(seed: int, n: int) -> None:
    """Bodies joined by Consistent only, nothing else acts: both momenta stand still."""
    case = random_case(seed, n, ["consistent"], grounded=False, loaded=False)
    for formulation in FORMULATIONS:
        model = rs.compile_scene(case.scene, formulation=formulation)
        x = np.array([label.start for label in model.x_labels])
        for name in ("momentum", "angular_momentum"):
            rate, scale = along_motion(model, name, x)
            assert np.abs(rate).max() <= 1e-12 * scale
        expected = scenes.angular_momentum(case.oracle, case.state)
        error = np.abs(measure(model, "angular_momentum", x) - expected).max()
        assert error <= 1e-12 * np.abs(expected).max()


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
def test_energy_budget_of_a_driven_offset(formulation: Any) -> None:
    """A servo by TIME: its work is injected power, in both formulations."""
    angle = 0.3 * np.sin(2 * rs.TIME + 0.5)
    body = rs.RigidBody("b", 2.0, [0.1, 0.2, 0.25], com=[0.1, 0, 0], velocity=[0.3, -0.1, 0.2],
                        angular_velocity=[0.5, 0.2, -0.4])  # fmt: skip
    servo = rs.RigidBodySpringDamper(
        "servo", rs.Marker(rs.GROUND), rs.Marker("b", [0.2, 0.1, 0]), np.diag([90.0] * 6),
        np.diag([2.0] * 6), offset=[0, 0.1 * angle, 0, 0, 0, angle], law=rs.Consistent(),
    )
    model = rs.compile_scene(rs.Scene("servo", [body], [servo]), formulation=formulation)
    x = np.array([label.start for label in model.x_labels])
    rate, scale = along_motion(model, "energy", x)
    injected = measure(model, "servo.injected_power", x)[0]
    dissipated = measure(model, "servo.dissipated_power", x)[0]
    assert rate[0] == pytest.approx(injected - dissipated, abs=1e-12 * scale)
    assert abs(injected) > 1e-3 * scale


@pytest.mark.parametrize("formulation", FORMULATIONS, ids=by_name)
def test_free_symmetric_top(formulation: Any) -> None:
    """Gravity pulls the centre of mass on a parabola; the spin about it precesses as in Euler."""
    R, w, com = rotations.exp_so3([0.3, -0.2, 0.4]), np.array([0.3, -0.4, 2.0]), [0.2, -0.1, 0.3]
    body = rs.RigidBody("top", 2.0, [0.3, 0.3, 0.2], com, [1, 2, 3], R, [0.5, 0, 4], w)
    scene = rs.Scene("top", [body], [], gravity=[0, 0, -9.81])
    model = rs.compile_scene(scene, formulation=formulation)
    trajectory = rs.simulate(model, 1.0, rs.ExplicitRK(1e-12, 1e-13))
    final_R, final_w = closed_forms.free_symmetric_top(1.0, 0.3, 0.2, R, w)
    assert np.abs(trajectory["top.rotation_matrix"][-1] - final_R).max() < 1e-10
    assert np.abs(trajectory["top.angular_velocity"][-1] - final_w).max() < 1e-10
    centre = closed_forms.ballistic(
        1.0, [1, 2, 3] + R @ com, [0.5, 0, 4] + R @ np.cross(w, com), [0, 0, -9.81]
    )[0]
    expected = centre - final_R @ com
    assert np.abs(trajectory["top.position"][-1] - expected).max() < 1e-10
    weight = trajectory["momentum"] - 2.0 * np.array([0, 0, -9.81]) * trajectory.t[:, None]
    assert np.abs(weight - weight[0]).max() < 1e-10
