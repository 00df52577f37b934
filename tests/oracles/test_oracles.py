"""The oracles against multiprecision reference values, published results and each other."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from paths import stored

from . import closed_forms, laws, rotations, scenes
from .laws import LawResult, Pose

LAW_CASES = stored("laws")["cases"]
DERIVATIVES = stored("derivatives")
SCENES = stored("scenes")["scenes"]
EPS = np.finfo(float).eps
# The slender brick of the published intrinsic test, its stiffness, and no damping.
BRICK = SCENES["pair"]["bodies"][0]
STIFFNESS = SCENES["pair"]["connectors"][0]["stiffness"]
UNDAMPED = np.zeros((6, 6))
# Equal steps that bring a scene within the errors asked below.
STEPS = {
    "mini": 30, "single": 64, "coupled": 64, "single_consistent": 64, "pair_consistent": 110,
    "pair_intrinsic": 120,
}


def relative(value: np.ndarray, reference: Any) -> float:
    """Length of the difference over the length of the reference."""
    return np.linalg.norm(value - np.asarray(reference)) / np.linalg.norm(reference)


def marker_of(case: dict[str, Any], i: int) -> Pose:
    """Marker i of a case of laws.json, its own rotation included."""
    R = np.array(case[f"R{i}"]) @ np.array(case[f"rotation_marker{i}"])
    return Pose(np.array(case[f"p{i}"]), R, np.array(case[f"v{i}"]), np.array(case[f"w{i}"]))


def wrench_of(result: LawResult) -> np.ndarray:
    """(force0, torque0, force1, torque1), 12."""
    return np.concatenate([result.force0, result.torque0, result.force1, result.torque1])


def moved(pose0: Pose, pose1: Pose, direction: np.ndarray, s: complex) -> tuple[Pose, Pose]:
    """Both markers displaced by s direction (12): world translations and world rotations."""
    dp0, dr0, dp1, dr1 = np.split(s * np.asarray(direction), 4)
    return (
        Pose(pose0.p + dp0, rotations.exp_so3(dr0) @ pose0.R),
        Pose(pose1.p + dp1, rotations.exp_so3(dr1) @ pose1.R),
    )


@functools.cache
def end_of(name: str) -> np.ndarray:
    """The oracle's state at the end of a reference scene; cached, two tests look at the pairs."""
    return scenes.simulate(SCENES[name], SCENES[name]["t_end"], STEPS[name])


def free_body(**changes: Any) -> dict[str, Any]:
    """A scene with one brick and nothing else, with other body entries as given."""
    return {"gravity": [0.0, 0.0, 0.0], "bodies": [{**BRICK, **changes}], "connectors": []}


@pytest.mark.parametrize("angle", [0, 1e-12, 1e-8, 1e-4, 0.1, 1, 2, 3, np.pi - 1e-8, np.pi])
def test_rotations_there_and_back(angle: float) -> None:
    rng = np.random.default_rng(1)
    for axis in [*np.eye(3), *rng.normal(size=(20, 3))]:
        theta = angle * axis / np.linalg.norm(axis)
        R = rotations.exp_so3(theta)
        assert np.abs(R @ R.T - np.eye(3)).max() < 8 * EPS
        back = rotations.log_so3(R)
        # At pi itself both signs of the axis are logarithms.
        sign = np.sign(back @ theta) if angle > 3.1 else 1.0
        assert np.abs(sign * back - theta).max() < 16 * EPS
        assert np.abs(rotations.from_quaternion(rotations.to_quaternion(R)) - R).max() < 8 * EPS
        bryan = rotations.from_tait_bryan(rotations.to_tait_bryan(R))
        assert np.abs(bryan - R).max() < 8 * EPS


def test_elementary_rotations() -> None:
    x, y, z = np.eye(3)
    for axis, (start, end) in enumerate([(y, z), (z, x), (x, y)]):
        quarter = rotations.rotation_about(axis, np.pi / 2)
        assert np.abs(quarter @ start - end).max() < EPS
        assert np.abs(quarter - rotations.exp_so3(np.pi / 2 * np.eye(3)[axis])).max() < 2 * EPS
    half = np.sqrt(0.5)
    turn = rotations.from_quaternion(3.0 * np.array([half, 0.0, 0.0, half]))
    assert np.abs(turn - rotations.rotation_about(2, np.pi / 2)).max() < 4 * EPS
    angles = np.array([0.3, -1.2, 2.5])
    back = rotations.to_tait_bryan(rotations.from_tait_bryan(angles))
    assert np.abs(back - angles).max() < 16 * EPS


@pytest.mark.parametrize("angle", [0.0, 1e-8, 1e-3, 0.499, 0.501, 1.0, 3.0, np.pi])
def test_jacobians_are_derivatives_of_exp(angle: float) -> None:
    axis, rate, h = np.array([2.0, -1.0, 2.0]) / 3.0, np.array([0.3, 0.5, -0.7]), 1e-30
    theta = angle * axis
    R = rotations.exp_so3(theta)
    spin = rotations.unskew(rotations.exp_so3(theta + 1j * h * rate).imag / h @ R.T)
    J = rotations.left_jacobian(theta)
    assert np.abs(J @ rate - spin).max() < 16 * EPS
    assert np.abs(rotations.left_jacobian_inverse(theta) @ J - np.eye(3)).max() < 16 * EPS
    if angle < np.pi:
        perturbed = rotations.log_so3(rotations.exp_so3(theta + 1j * h * rate))
        assert np.abs(perturbed.imag / h - rate).max() < 1e3 * EPS


@pytest.mark.parametrize("name", scenes.LAWS)
@pytest.mark.parametrize("index", range(len(LAW_CASES)))
def test_laws_agree_with_multiprecision(name: str, index: int) -> None:
    case = LAW_CASES[index]
    K, D, offset = (np.array(case[key]) for key in ("stiffness", "damping", "offset"))
    result = scenes.LAWS[name](marker_of(case, 0), marker_of(case, 1), K, D, offset)
    for quantity, reference in case["laws"][name].items():
        assert relative(getattr(result, quantity), reference) < 1e-11, quantity
    # A double matrix holds an angle to an absolute rounding error, whatever the angle.
    rotation = result.strain[3:] - case["laws"][name]["strain"][3:]
    assert np.abs(rotation).max() < 8 * EPS


@pytest.mark.parametrize("index", range(len(DERIVATIVES["cases"])))
def test_energy_and_wrench_agree_with_multiprecision(index: int) -> None:
    case = DERIVATIVES["cases"][index]
    K, offset = np.array(DERIVATIVES["stiffness"]), np.array(DERIVATIVES["offset"])
    R0, R1 = np.array(case["R0"]), np.array(case["R1"])
    if case["angle"] < 1e-8:
        R1 = R0 @ rotations.exp_so3(case["angle"] * np.array(case["axis"]))
    poses = Pose(np.array(case["p0"]), R0), Pose(np.array(case["p1"]), R1)
    direction = np.array(case["direction"])
    value, slope, curvature, _ = case["derivatives"]
    assert laws.energy(laws.consistent, *poses, K, offset) == pytest.approx(value, rel=1e-11)
    wrench = wrench_of(laws.consistent(*poses, K, UNDAMPED, offset))
    assert -wrench @ direction == pytest.approx(slope, rel=1e-11)

    h = 1e-30
    stepped = moved(*poses, direction, 1j * h)
    complex_energy = laws.energy(laws.consistent, *stepped, K, offset)
    assert complex_energy.imag / h == pytest.approx(slope, rel=1e-11)
    complex_wrench = wrench_of(laws.consistent(*stepped, K, UNDAMPED, offset))
    assert -complex_wrench.imag @ direction / h == pytest.approx(curvature, rel=1e-10)


def test_middle_jacobian_agrees_with_complex_step() -> None:
    h = 1e-30
    for case in LAW_CASES:
        poses = marker_of(case, 0), marker_of(case, 1)
        columns = [
            laws.middle_strain(*moved(*poses, unit, 1j * h))[0].imag / h for unit in np.eye(12)
        ]
        assert relative(laws.middle_jacobian(*poses), np.array(columns).T) < 1e-13


@pytest.mark.parametrize("name", scenes.LAWS)
def test_velocity_offset_shifts_the_damper(name: str) -> None:
    shift = np.array([0.1, -0.2, 0.3, 0.4, 0.5, -0.6])
    case = LAW_CASES[6]
    poses = marker_of(case, 0), marker_of(case, 1)
    K, D, offset = (np.array(case[key]) for key in ("stiffness", "damping", "offset"))
    law = scenes.LAWS[name]
    plain, shifted = law(*poses, K, D, offset), law(*poses, K, D, offset, shift)
    assert relative(plain.local - shifted.local, D @ shift) < 1e-13
    # The wrench is linear in the local 6-vector, so a spring of strain -shift does the same.
    spring = law(*poses, D, UNDAMPED, plain.strain + shift)
    assert relative(wrench_of(shifted) - wrench_of(plain), wrench_of(spring)) < 1e-12


def test_moment_balance_and_power() -> None:
    A = Pose(np.zeros(3), np.eye(3))
    C = Pose(np.array([0.1, 0.2, 0.3]), rotations.exp_so3([0.5, -0.4, 0.8]))
    moments = {
        name: np.linalg.norm(laws.net_moment(law(A, C, STIFFNESS, UNDAMPED, np.zeros(6)), A, C))
        for name, law in scenes.LAWS.items()
    }
    # The torques of `standard` cancel, which leaves the couple d x K d = (120, -90, 20) N m.
    assert moments["standard"] == pytest.approx(np.sqrt(22900.0), rel=1e-14)
    # |d x f - v_M x f| of the two arms, computed once more with matrix functions (expm, logm).
    assert moments["intrinsic"] == pytest.approx(18.700850529642, rel=1e-12)
    assert moments["consistent"] < 1e-12
    case = LAW_CASES[7]
    poses = marker_of(case, 0), marker_of(case, 1)
    D = np.array(case["damping"])
    damper = laws.consistent(*poses, 0.0 * D, D, np.zeros(6))
    drained = damper.rate @ D @ damper.rate
    assert laws.power(damper, *poses) == pytest.approx(-drained, rel=1e-13)


@pytest.mark.parametrize("name", STEPS)
def test_scenes_reach_the_reference_state(name: str) -> None:
    scene, end = SCENES[name], end_of(name)
    start, reference = scenes.start_state(scene), scenes.final_state(scene)
    # A change e of the start of `pair_intrinsic` changes its final velocities by up to 4e7 e
    # (measured), so rounding alone shows there as some 1e-7 rad/s, whatever the step.
    error = 2e-7 if name == "pair_intrinsic" else 1e-9
    speed = max(1.0, np.abs(start[:, 7:]).max())
    assert np.abs(end[:, :3] - reference[:, :3]).max() < 1e-9
    assert np.abs(end[:, 7:] - reference[:, 7:]).max() < error * speed
    for x, R_WB in zip(end, scene["final"]["rotation"], strict=True):
        assert np.abs(rotations.from_quaternion(x[3:7]) - R_WB).max() < error


@pytest.mark.parametrize(("name", "final_energy", "turned"), [
    ("pair_consistent", 628.054, 0.0), ("pair_intrinsic", 622.024, 0.1963),
])
def test_energy_and_momenta_of_the_pair(name: str, final_energy: float, turned: float) -> None:
    """Published: what the law makes of energy (J) and angular momentum (kg m2/s) in 1 s."""
    scene, end = SCENES[name], end_of(name)
    assert scenes.energy(scene, scenes.start_state(scene)) == pytest.approx(628.054, abs=5e-4)
    assert scenes.energy(scene, end) == pytest.approx(final_energy, abs=5e-4)
    assert np.abs(scenes.momentum(scene, end)).max() < 1e-11
    assert np.linalg.norm(scenes.angular_momentum(scene, end)) == pytest.approx(turned, abs=5e-5)


@pytest.mark.parametrize(("law", "body_first", "centre"), [
    ("intrinsic", True, (1.16842872947209188, -0.062373656590390931, 0.10666627222215249)),
    ("standard", False, (1.1721991762561, -0.0914798585380, 0.1095815937500)),
    ("standard", True, (1.1452088375999, -0.1096747104114, 0.1005483038187)),
])
def test_published_brick_on_a_connector(
    law: str, body_first: bool, centre: tuple[float, ...]
) -> None:
    """The intrinsic test: marker 0 on the ground, then the same with the markers swapped."""
    scene = free_body(position=[1.0, 0.0, 0.0], velocity=[0.0, 1.0, 2.0])
    brick, ground = (0, [-0.5, 0.0, 0.0]), (scenes.GROUND, [0.5, 0.0, 0.0])
    (body0, p0), (body1, p1) = (brick, ground) if body_first else (ground, brick)
    scene["law"] = law
    scene["connectors"] = [{
        "body0": body0, "position0": p0, "body1": body1, "position1": p1,
        "stiffness": STIFFNESS, "damping": UNDAMPED, "offset": np.zeros(6),
    }]
    end = scenes.simulate(scene, 1.0, 80)
    assert np.abs(end[0, :3] - centre).max() < 1e-9


@pytest.mark.parametrize("name", ["pair", "pair_intrinsic", "pair_consistent"])
def test_rates_take_a_complex_step(name: str) -> None:
    scene = SCENES[name]
    x, direction = scenes.final_state(scene), np.random.default_rng(2).normal(size=(2, 13))
    ahead, behind = (scenes.rates(scene, x + s * direction) for s in (1e-6, -1e-6))
    stepped = scenes.rates(scene, x + 1e-30j * direction).imag / 1e-30
    assert relative((ahead - behind) / 2e-6, stepped) < 1e-7


def test_integrator_has_its_order() -> None:
    def error(steps: int) -> float:
        x = scenes.integrate(lambda x: np.array([x[1], -x[0]]), np.array([1.0, 0.0]), 8.0, steps, 3)
        return np.linalg.norm(x - [np.cos(8.0), -np.sin(8.0)])

    assert np.log2(error(16) / error(32)) == pytest.approx(6.0, abs=0.3)


def test_closed_forms_agree_with_published_values() -> None:
    y, v = closed_forms.damped_oscillator(1.0, 1.0, 500.0, 5.0, 1000.0)
    assert y == pytest.approx(-0.83979165737914566746, rel=1e-13)
    # The scene's stored state is converged to 1e-10, the closed form is exact.
    assert v == pytest.approx(SCENES["mini"]["final"]["velocity"][0][1], rel=1e-10)
    published = [0.18270749424034783999, 0.19703898945856870887]
    assert np.abs(closed_forms.user_force([0.1, 1.0]) - published).max() < 1e-15


@pytest.mark.parametrize("damping", [0.0, 1.0, 4.0, 4.000001, 9.0])
def test_damped_oscillator_at_every_damping_ratio(damping: float) -> None:
    mass, stiffness = 2.0, 2.0  # critical damping 4
    end = scenes.integrate(
        lambda x: np.array([x[1], -(stiffness * x[0] + damping * x[1]) / mass]),
        np.array([0.7, -0.4]), 3.0, 30,
    )
    exact = closed_forms.damped_oscillator(3.0, mass, stiffness, damping, -0.4, 0.7)
    # Next to the critical damping S = sin(w t)/w is a ratio of small numbers, w t = 2e-3.
    assert np.abs(end - exact).max() < 1e-12


def test_free_flight_agrees_with_closed_forms() -> None:
    start_R = rotations.exp_so3([0.4, -1.0, 0.3])
    start_w = np.array([1.5, -0.5, 4.0])
    scene = free_body(inertia=[0.5, 0.5, 0.2], rotation=start_R, angular_velocity=start_w)
    scene["gravity"] = [0.3, 0.0, -9.81]
    scene["bodies"][0]["velocity"] = [1.0, 2.0, 3.0]
    end = scenes.simulate(scene, 2.0, 40)[0]
    R, w = closed_forms.free_symmetric_top(2.0, 0.5, 0.2, start_R, start_w)
    p, v = closed_forms.ballistic(2.0, BRICK["position"], [1.0, 2.0, 3.0], scene["gravity"])
    assert np.abs(rotations.from_quaternion(end[3:7]) - R).max() < 1e-12
    assert np.abs(end[10:] - w).max() < 1e-12
    assert np.abs(end[[0, 1, 2, 7, 8, 9]] - [*p, *v]).max() < 1e-12 * 20


def test_intermediate_axis_tumbles_in_the_published_time() -> None:
    """I = (1, 2, 3), w = (e, 1, e): H^2 - 2 I_y T = 2 e^2 > 0, so w_z keeps its sign."""
    for e, half_period in ((0.1, 11.4981314720612743), (0.01, 19.5528670986343604)):
        scene = free_body(inertia=[1.0, 2.0, 3.0], angular_velocity=[e, 1.0, e])
        end = scenes.simulate(scene, half_period, 60)[0]
        assert np.abs(end[10:] - [-e, -1.0, e]).max() < 1e-11
        start = scenes.start_state(scene)
        assert scenes.energy(scene, end[None]) == pytest.approx(scenes.energy(scene, start))
        change = scenes.angular_momentum(scene, end[None]) - scenes.angular_momentum(scene, start)
        assert np.abs(change).max() < 1e-11
