"""Rotations against the matrix oracles: at rest, at tiny angles, at random, and up to pi."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import casadi as ca
import numpy as np
import pytest
from oracles import rotations as oracle

from rbsd_sym.base import rotation as rot

EPS = float(np.finfo(float).eps)
# The series of quat_exp ends at sqrt(0.1) = 0.316..., hence the two angles beside it.
ANGLES = [0.0, 1e-12, 1e-8, 1e-4, 0.1, 0.3162, 0.3163, 1.0, 2.0, 3.0]
NEAR_PI = [np.pi - 1e-4, np.pi - 1e-6, np.pi - 1e-8]


def numbers(value: Any) -> np.ndarray:
    """A DM as an array; columns become one-dimensional."""
    array = np.array(ca.DM(value))
    return array[:, 0] if array.shape[1] == 1 else array


def axes(count: int = 6, seed: int = 1) -> Iterator[np.ndarray]:
    """Coordinate axes, their diagonals, and random unit vectors."""
    yield from np.eye(3)
    yield from -np.eye(3)
    for axis in [np.ones(3), *np.random.default_rng(seed).normal(size=(count, 3))]:
        yield axis / np.linalg.norm(axis)


def quaternion(angle: float, axis: np.ndarray) -> ca.DM:
    """Unit quaternion by numpy's own trigonometry."""
    return ca.DM([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


def quaternions(seed: int) -> list[ca.DM]:
    """The identity, tiny, moderate and almost half turns, and random ones."""
    rng = np.random.default_rng(seed)
    turns = [quaternion(a, axis) for a in (0.0, 1e-8, 1.0, *NEAR_PI) for axis in axes(1, seed)]
    return turns + [ca.DM(q / np.linalg.norm(q)) for q in rng.normal(size=(10, 4))]


def test_group_properties() -> None:
    one = ca.DM([1, 0, 0, 0])
    for a, b, c in zip(quaternions(1), reversed(quaternions(2)), quaternions(3), strict=True):
        assert np.array_equal(numbers(rot.quat_product(one, a)), numbers(a))
        assert np.array_equal(numbers(rot.quat_product(a, one)), numbers(a))
        back = rot.quat_product(rot.quat_conjugate(a), a)
        assert np.abs(numbers(back - one)).max() < 4 * EPS
        left = rot.quat_product(rot.quat_product(a, b), c)
        right = rot.quat_product(a, rot.quat_product(b, c))
        assert np.abs(numbers(left - right)).max() < 4 * EPS


def test_quaternion_product_turns_like_the_matrices() -> None:
    for a, b in zip(quaternions(1), reversed(quaternions(2)), strict=True):
        R_a, R_b = (oracle.from_quaternion(numbers(q)) for q in (a, b))
        product = numbers(rot.quat_matrix(rot.quat_product(a, b)))
        assert np.abs(product - R_a @ R_b).max() < 8 * EPS
        opposite = numbers(rot.quat_matrix(rot.quat_conjugate(a)))
        assert np.abs(opposite - R_a.T).max() < 4 * EPS


def test_norm_and_sign_of_a_quaternion_do_not_count() -> None:
    p = ca.DM([0.3, -1.2, 0.7])
    for q in quaternions(4):
        for factor in (1e-3, -250.0):
            for f in (rot.quat_matrix, lambda r: ca.vertcat(*rot.se3_log(p, r))):
                assert np.abs(numbers(f(factor * q)) - numbers(f(q))).max() < 32 * EPS
            half = numbers(rot.quat_matrix(rot.quat_half(factor * q)))
            assert np.abs(half - numbers(rot.quat_matrix(rot.quat_half(q)))).max() < 8 * EPS


@pytest.mark.parametrize("angle", ANGLES + NEAR_PI)
def test_exp_and_log(angle: float) -> None:
    for axis in axes():
        th = angle * axis
        q = rot.quat_exp(ca.DM(th))
        assert np.abs(numbers(q) - numbers(quaternion(angle, axis))).max() < 4 * EPS
        # The matrix has entries of order 1; the logarithm holds tiny angles to relative accuracy.
        assert np.abs(numbers(rot.quat_matrix(q)) - oracle.exp_so3(th)).max() < 8 * EPS
        assert np.abs(numbers(rot.quat_log(q)) - th).max() <= 4 * EPS * angle
        assert np.abs(numbers(rot.quat_log(-q)) - th).max() <= 4 * EPS * angle


@pytest.mark.parametrize(("delta", "published"), [(1e-4, 6e-8), (1e-6, 1e-4), (1e-8, 2e8)])
def test_log_next_to_pi_where_the_naive_one_fails(delta: float, published: float) -> None:
    """Published worst errors of acos(c)/(2 sin) on the matrix; quaternion and atan2 have 2e-16."""
    ours = theirs = naive = 0.0
    for axis in axes(60):
        th = (np.pi - delta) * axis
        R = numbers(rot.quat_matrix(quaternion(np.pi - delta, axis)))
        ours = max(ours, np.abs(numbers(rot.quat_log(rot.matrix_quat(ca.DM(R)))) - th).max())
        theirs = max(theirs, np.abs(oracle.log_so3(R) - th).max())
        angle = np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            naive = max(naive, np.abs(angle / np.sin(angle) * oracle.unskew(R) - th).max())
    assert ours < 4 * np.pi * EPS
    assert theirs < 4 * np.pi * EPS
    assert published / 2 < naive < 20 * published


def test_log_at_pi_is_one_of_the_two() -> None:
    for axis in axes():
        th = numbers(rot.quat_log(ca.DM([0.0, *axis])))
        assert abs(np.linalg.norm(th) - np.pi) < 4 * EPS
        assert np.abs(oracle.exp_so3(th) - (2 * np.outer(axis, axis) - np.eye(3))).max() < 8 * EPS


@pytest.mark.parametrize("angle", [*ANGLES, *NEAR_PI, np.pi])
def test_half_rotation(angle: float) -> None:
    for axis in axes():
        half = rot.quat_half(quaternion(angle, axis))
        matrix = numbers(rot.quat_matrix(half))
        assert np.abs(matrix - oracle.exp_so3(angle * axis / 2)).max() < 8 * EPS
        # Twice the half is the whole, whatever the norm of either.
        twice = numbers(rot.quat_matrix(rot.quat_product(half, half)))
        assert np.abs(twice - oracle.exp_so3(angle * axis)).max() < 8 * EPS
        assert np.abs(2 * numbers(rot.quat_log(half)) - angle * axis).max() <= 4 * EPS * angle


def matrix_exponential(A: np.ndarray) -> np.ndarray:
    """exp(A) by Taylor's series of A/16, squared four times."""
    term = total = np.eye(len(A))
    for k in range(1, 25):
        term = term @ (A / 16) / k
        total = total + term
    for _ in range(4):
        total = total @ total
    return total


@pytest.mark.parametrize("angle", [*ANGLES, *NEAR_PI])
def test_se3_log(angle: float) -> None:
    rng = np.random.default_rng(5)
    for axis in axes():
        p, R = rng.normal(size=3), oracle.exp_so3(angle * axis)
        v, th = (numbers(part) for part in rot.se3_log(ca.DM(p), quaternion(angle, axis)))
        assert np.abs(th - angle * axis).max() <= 4 * EPS * angle
        assert np.abs(v - oracle.left_jacobian_inverse(angle * axis) @ p).max() < 16 * EPS
        twist, pose = np.zeros((4, 4)), np.eye(4)
        twist[:3, :3], twist[:3, 3], pose[:3, :3], pose[:3, 3] = oracle.skew(th), v, R, p
        assert np.abs(matrix_exponential(twist) - pose).max() < 64 * EPS


@pytest.mark.parametrize("angle", [*ANGLES, *NEAR_PI, np.pi])
def test_quaternion_of_a_matrix(angle: float) -> None:
    for axis in axes():
        R = oracle.exp_so3(angle * axis)
        q = numbers(rot.matrix_quat(ca.DM(R)))
        assert abs(q @ q - 1) < 4 * EPS
        assert np.abs(oracle.from_quaternion(q) - R).max() < 8 * EPS
        other = oracle.to_quaternion(R)
        assert min(np.abs(q - other).max(), np.abs(q + other).max()) < 4 * EPS


def test_half_turns_about_the_axes_are_exact() -> None:
    for i, R in enumerate((np.diag([1, -1, -1.0]), np.diag([-1, 1, -1.0]), np.diag([-1, -1, 1.0]))):
        assert np.array_equal(numbers(rot.matrix_quat(ca.DM(R))), np.eye(4)[i + 1])


def test_tait_bryan_angles() -> None:
    rng = np.random.default_rng(6)
    inside = rng.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], size=(50, 3))
    steep = [[0.4, s * (np.pi / 2 - d), -1.1] for s in (1, -1) for d in (1e-2, 1e-4)]
    tiny = [[0, 0, 0], [1e-8, -2e-8, 3e-8], [1e-300, 0, 0]]
    for a in np.array([*inside, *steep, *tiny], dtype=float):
        R = numbers(rot.xyz_matrix(ca.DM(a)))
        assert np.abs(R - oracle.from_tait_bryan(a)).max() < 4 * EPS
        # Roll and yaw are read off entries of size cos(pitch), the pitch off its sine and cosine.
        bound = 4 * EPS * max(1.0, np.abs(a).max()) / np.cos(a[1])
        assert np.abs(numbers(rot.matrix_xyz(ca.DM(R))) - a).max() < bound
        q = numbers(rot.xyz_quat(ca.DM(a)))
        assert abs(q @ q - 1) < 4 * EPS
        assert np.abs(oracle.from_quaternion(q) - R).max() < 8 * EPS


def test_rates_are_derivatives() -> None:
    """R' = R [w]x in body axes, along a path with given rate; complex step of the oracles."""
    rng, h = np.random.default_rng(7), 1e-30
    for a, w in zip(rng.uniform(-1.4, 1.4, (20, 3)), rng.normal(size=(20, 3)), strict=True):
        R = oracle.from_tait_bryan(a)
        rate = numbers(rot.xyz_rate(ca.DM(a), ca.DM(w)))
        spin = R.T @ oracle.from_tait_bryan(a + 1j * h * rate).imag / h
        assert np.abs(spin - oracle.skew(w)).max() < 64 * EPS * np.abs(w).max() / np.cos(a[1])
        q = numbers(rot.xyz_quat(ca.DM(a)))
        rate = numbers(rot.quat_rate(ca.DM(q), ca.DM(w)))
        spin = R.T @ oracle.from_quaternion(q + 1j * h * rate).imag / h
        assert np.abs(spin - oracle.skew(w)).max() < 16 * EPS * np.abs(w).max()


def evaluate(f: Callable[..., Any], kind: Any, values: list[np.ndarray]) -> np.ndarray:
    """f of SX or MX symbols as a function, at the values."""
    symbols = [kind.sym("a", *np.shape(value)) for value in values]
    result = f(*symbols)
    result = ca.vertcat(*result) if isinstance(result, tuple) else result
    assert isinstance(result, kind)
    return numbers(ca.Function("f", symbols, [result])(*values))


UNARY = {
    "quat_conjugate": 4, "quat_matrix": 4, "quat_log": 4, "quat_half": 4, "quat_exp": 3,
    "xyz_matrix": 3, "xyz_quat": 3, "matrix_quat": (3, 3), "matrix_xyz": (3, 3),
}  # fmt: skip
BINARY = {
    "quat_product": (4, 4), "quat_rate": (4, 3), "se3_log": (3, 4), "xyz_rate": (3, 3),
    "cross": (3, 3), "dot3": (3, 3),
}  # fmt: skip


@pytest.mark.parametrize("name", [*UNARY, *BINARY])
def test_same_numbers_in_sx_mx_and_dm(name: str) -> None:
    f, rng = getattr(rot, name), np.random.default_rng(8)
    for scale in (1.0, 1e-9):
        if isinstance(UNARY.get(name), tuple):
            values = [oracle.exp_so3(scale * rng.normal(size=3))]
        else:
            sizes = BINARY.get(name, (UNARY.get(name),))
            values = [scale * rng.normal(size=n) for n in sizes]
        plain = f(*(ca.DM(value) for value in values))
        plain = numbers(ca.vertcat(*plain) if isinstance(plain, tuple) else plain)
        size = max(np.abs(plain).max(), np.finfo(float).tiny)
        for kind in (ca.SX, ca.MX):
            assert np.abs(evaluate(f, kind, values) - plain).max() <= 2 * EPS * size


@pytest.mark.parametrize("kind", [ca.SX, ca.MX])
@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-4, 0.1, 0.3162, 0.3163, 1.0, 3.0])
def test_derivatives_of_exp_and_log_cancel(kind: Any, angle: float) -> None:
    """log exp is the identity, so along a line its derivatives are (direction, 0, 0)."""
    s = kind.sym("s")
    rng = np.random.default_rng(9)
    for axis in axes(2):
        direction = rng.normal(size=3)
        orders = [rot.quat_log(rot.quat_exp(ca.DM(angle * axis) + s * ca.DM(direction)))]
        for _ in range(3):
            orders.append(ca.jacobian(orders[-1], s))
        results = [numbers(v) for v in ca.Function("orders", [s], orders)(0.0)]
        assert np.abs(results[0] - angle * axis).max() <= 8 * EPS * angle
        # Where its series ends, the closed form of exp loses angle^-4 in the third derivative.
        for order, expected, bound in ((1, direction, 8), (2, 0, 64), (3, 0, 1024)):
            assert np.abs(results[order] - expected).max() < bound * EPS, order
