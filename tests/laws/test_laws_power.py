"""Power balance of a connector, driven or not, with an oracle that differentiates along the flow.

Two bodies with eccentric centres of mass, turned markers and turned joint frames; what may depend
on time is written once and evaluated with TIME by the package, with complex time by the oracle.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from oracles import laws as oracle
from oracles import rotations
from scenes.small import LAWS

import rbsd_sym as rs

# All states are kept: functions are evaluated where a scene that starts at rest never goes.
compiled_full = functools.partial(rs.compile_scene, minimal=False)
EPS = float(np.finfo(float).eps)
RNG = np.random.default_rng(21)
COM = RNG.normal(size=(2, 3)) * 0.3
SHIFT = RNG.normal(size=6)
TURNS = rotations.exp_so3([0.3, -0.5, 0.9]), rotations.exp_so3([-0.2, 0.4, 0.1])
WRENCH = ("force0", "torque0", "force1", "torque1")
SCALARS = ("potential_energy", "dissipated_power", "injected_power")


def coupled(typical: list[float]) -> np.ndarray:
    """A positive definite matrix, symmetric to the last bit."""
    A = np.sqrt(typical)[:, None] * (np.eye(6) + 0.2 * RNG.normal(size=(6, 6)))
    return (A @ A.T + (A @ A.T).T) / 2


K = coupled([4000.0, 5000.0, 7000.0, 250.0, 500.0, 325.0])
D = coupled([40.0, 50.0, 70.0, 5.0, 8.0, 6.0])
BASE: dict[str, Any] = {
    "stiffness": K, "damping": D,
    "offset": 0.1 * RNG.normal(size=6), "velocity_offset": np.zeros(6),
    "position0": RNG.normal(size=3), "position1": RNG.normal(size=3),
    "rotation0": TURNS[0], "rotation1": TURNS[1].T,
    "rotation_marker0": TURNS[1], "rotation_marker1": TURNS[0].T,
}  # fmt: skip


def about_z(angle: Any) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


# What depends on the time, as a function of it.
SCENARIOS: dict[str, Callable[[Any], dict[str, Any]]] = {
    "constant": lambda t: {},
    "offset": lambda t: {"offset": BASE["offset"] * (1 + np.sin(3 * t))},
    "velocity_offset": lambda t: {"velocity_offset": SHIFT * np.cos(t)},
    "stiffness": lambda t: {"stiffness": K * (2 + np.sin(2 * t))},
    "marker": lambda t: {
        "position0": BASE["position0"] + SHIFT[:3] * np.sin(2 * t),
        "rotation1": BASE["rotation1"] @ about_z(0.7 * np.sin(2 * t)),
    },
    "joint": lambda t: {"rotation_marker0": about_z(t * t) @ BASE["rotation_marker0"]},
}


@functools.cache
def compiled(law: str, scenario: str) -> rs.Model:
    """The connector between two free bodies."""
    n = BASE | SCENARIOS[scenario](rs.TIME)
    bodies = [rs.RigidBody(f"b{i}", 1.0, (1.0, 1.0, 1.0), com=COM[i]) for i in (0, 1)]
    markers = [rs.Marker(f"b{i}", n[f"position{i}"], n[f"rotation{i}"]) for i in (0, 1)]
    connector = rs.RigidBodySpringDamper(
        "joint", *markers, n["stiffness"], n["damping"], n["offset"], n["velocity_offset"],
        n["rotation_marker0"], n["rotation_marker1"], LAWS[law],
    )  # fmt: skip
    outputs = [f"joint.{name}" for name in (*WRENCH, *SCALARS)]
    return compiled_full(rs.Scene("pair", bodies, [connector], outputs=outputs))


def wrench_of(result: oracle.LawResult) -> np.ndarray:
    return np.concatenate([getattr(result, name) for name in WRENCH])


class Truth(NamedTuple):
    """What the oracle says at a state and a time: U' is along the motion, the drives included."""

    wrench: np.ndarray
    power: float
    stored: float
    stored_rate: float
    dissipated: float
    strain: np.ndarray
    rate: np.ndarray
    traffic: float


def frame(x: np.ndarray, numbers: dict[str, Any], i: int, dt: complex) -> oracle.Pose:
    """Marker i a short time dt after the state x of its body, numbers taken at that time."""
    p, q, v, w = np.split(x, [3, 7, 10])
    R_WB = rotations.from_quaternion(q)
    R_WB = rotations.exp_so3(dt * (R_WB @ w)) @ R_WB
    R = R_WB @ numbers[f"rotation{i}"] @ numbers[f"rotation_marker{i}"]
    return oracle.Pose(p + dt * v + R_WB @ (numbers[f"position{i}"] - COM[i]), R)


def truth(law: str, scenario: str, t: float, states: np.ndarray) -> Truth:
    """Everything by complex step in time; no velocity is derived by hand."""
    h, f = 1e-30, getattr(oracle, law)
    ahead = BASE | SCENARIOS[scenario](t + 1j * h)
    n = {key: np.real(value) for key, value in ahead.items()}
    moved = [frame(states[i], ahead, i, 1j * h) for i in (0, 1)]
    poses = [
        oracle.Pose(m.p.real, m.R.real, m.p.imag / h, rotations.unskew(m.R.imag / h @ m.R.real.T))
        for m in moved
    ]
    numbers = n["stiffness"], n["damping"], n["offset"], n["velocity_offset"]
    result = f(*poses, *numbers)
    U = oracle.energy(f, *moved, ahead["stiffness"], ahead["offset"])
    slip = result.rate - n["velocity_offset"]
    wrench = wrench_of(result)
    velocities = np.concatenate([v for pose in poses for v in (pose.v, pose.w)])
    return Truth(
        wrench, wrench @ velocities, U.real, U.imag / h, slip @ n["damping"] @ slip,
        result.strain, result.rate, np.abs(wrench * velocities).sum() + abs(U.imag / h),
    )  # fmt: skip


def points(count: int = 10) -> list[tuple[float, np.ndarray]]:
    """Times and states of two bodies, quaternions of any norm."""
    rng = np.random.default_rng(22)
    return [(rng.uniform(0, 3), rng.normal(size=(2, 13))) for _ in range(count)]


def measured(law: str, scenario: str, t: float, states: np.ndarray) -> tuple[np.ndarray, ...]:
    """Wrench (12), and (stored energy, dissipated, injected power), of the package."""
    values = compiled(law, scenario).function("out")(t, states.reshape(-1), [], [], [])
    column = np.array(values)[:, 0]
    return column[:12], column[12:]


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("law", LAWS)
def test_power_balance(law: str, scenario: str) -> None:
    """Marker powers = -dU/dt - dissipated + injected; driven markers have their velocity."""
    for t, states in points():
        wrench, (stored, dissipated, injected) = measured(law, scenario, t, states)
        true = truth(law, scenario, t, states)
        assert np.linalg.norm(wrench - true.wrench) < 1e-12 * np.linalg.norm(true.wrench)
        assert stored == pytest.approx(true.stored, rel=1e-12)
        assert dissipated == pytest.approx(true.dissipated, rel=1e-12)
        balance = true.power + true.stored_rate + true.dissipated
        assert abs(injected - balance) < 1e-12 * true.traffic


@pytest.mark.parametrize("scenario", ["constant", "marker", "joint"])
def test_consistent_injects_nothing(scenario: str) -> None:
    """With constant offset, K and no velocity offset; moving markers change nothing."""
    for t, states in points():
        _, (*_, injected) = measured("consistent", scenario, t, states)
        assert abs(injected) < 256 * EPS * truth("consistent", scenario, t, states).traffic


@pytest.mark.parametrize("law", ["standard", "intrinsic"])
def test_the_other_laws_inject(law: str) -> None:
    """The faults of a law without potential show as injected power."""
    shares = []
    for t, states in points():
        _, (*_, injected) = measured(law, "constant", t, states)
        shares.append(abs(injected) / truth(law, "constant", t, states).traffic)
    assert np.median(shares) > 0.02


def test_what_drives_inject_in_closed_form() -> None:
    """-K (strain - offset) . offset' of a servo, -velocity_offset . D slip of a motor, and
    (strain - offset)' K' (strain - offset) / 2 of a spring that stiffens."""
    for t, states in points():
        true = truth("consistent", "offset", t, states)
        stretch = true.strain - BASE["offset"] * (1 + np.sin(3 * t))
        servo = -(K @ stretch) @ (BASE["offset"] * 3 * np.cos(3 * t))
        _, (*_, injected) = measured("consistent", "offset", t, states)
        assert abs(injected - servo) < 1e-12 * true.traffic

        true = truth("consistent", "velocity_offset", t, states)
        shift = SHIFT * np.cos(t)
        _, (*_, injected) = measured("consistent", "velocity_offset", t, states)
        assert abs(injected + shift @ D @ (true.rate - shift)) < 1e-12 * true.traffic

        true = truth("consistent", "stiffness", t, states)
        stretch = true.strain - BASE["offset"]
        stiffening = stretch @ K @ stretch * np.cos(2 * t)
        _, (*_, injected) = measured("consistent", "stiffness", t, states)
        assert abs(injected - stiffening) < 1e-12 * true.traffic


@pytest.mark.parametrize("law", LAWS)
def test_servo(law: str) -> None:
    """An Input as offset: force K (strain - u); it counts as held, so `Consistent` injects none."""
    servo = [rs.Input(f"u{i}", value=float(i)) for i in range(6)]
    bodies = [rs.RigidBody("b0", 2.0, (1.0, 1.0, 1.0)), rs.RigidBody("b1", 1.0, (1.0, 1.0, 1.0))]
    connector = rs.RigidBodySpringDamper(
        "joint", rs.Marker("b0"), rs.Marker("b1"), K, D, offset=servo, law=LAWS[law]
    )
    model = compiled_full(rs.Scene("servo", bodies, [connector], outputs=["joint.force_local"]))
    assert [label.start for label in model.dae.u_labels] == [0, 1, 2, 3, 4, 5]
    u, rng = 0.1 * np.arange(6.0), np.random.default_rng(23)
    x = rng.normal(size=26)
    poses = []
    for p, q, v, w in (np.split(state, [3, 7, 10]) for state in x.reshape(2, 13)):
        R = rotations.from_quaternion(q)
        poses.append(oracle.Pose(p, R, v, R @ w))
    result = getattr(oracle, law)(*poses, K, D, u)
    force = np.array(model.function("joint.force_local")(0, x, [], u, []))[:, 0]
    assert np.linalg.norm(force - result.local[:3]) < 1e-12 * np.linalg.norm(result.local)
    if law == "consistent":
        injected = float(model.function("joint.injected_power")(0, x, [], u, []))
        velocities = np.concatenate([v for pose in poses for v in (pose.v, pose.w)])
        traffic = np.abs(wrench_of(result) * velocities).sum()
        assert abs(injected) < 256 * EPS * traffic
    # The rates are linear in u: on the first body dv'/du = -R_f K / m in the frame of the force.
    push = np.array(model.function("dode_du")(0, x, [], u, []))[7:10]
    unit = getattr(oracle, law)(*poses, K, D, u).force0 - np.array([
        getattr(oracle, law)(*poses, K, D, u + step).force0 for step in np.eye(6)
    ])  # fmt: skip
    assert np.abs(push + unit.T / 2.0).max() < 1e-12 * np.abs(K).max()


def test_driven_ground_marker_damps_relative_to_itself() -> None:
    """Ground marker at 0.1 sin(3 t) on x: the damper pulls a body at rest along with d 0.3 cos."""
    ground = rs.Marker(rs.GROUND, [0.1 * np.sin(3 * rs.TIME), 0.0, 0.0])
    body = rs.RigidBody("b", 2.0, (1.0, 1.0, 1.0))
    for law in LAWS.values():
        connector = rs.RigidBodySpringDamper(
            "joint", ground, rs.Marker("b"), 0.0, [40.0, 0, 0, 0, 0, 0], law=law
        )
        model = compiled_full(rs.Scene("shaker", [body], [connector]))
        x = [label.start for label in model.x_labels]
        for t in (0.0, 0.4, 1.3):
            rates = np.array(model.function("ode")(t, x, [], [], []))[:, 0]
            assert rates[7] == pytest.approx(40 * 0.3 * np.cos(3 * t) / 2, rel=1e-14)
            assert np.array_equal(np.delete(rates, 7), np.zeros(12))
