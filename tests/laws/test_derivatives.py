"""Derivatives at rest: the energy of `Consistent` to third order, and tangent stiffness."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from oracles import laws as oracle
from oracles import rotations
from paths import stored

from rbsd_sym.base import rotation as rot
from rbsd_sym.laws import Consistent, Intrinsic, SpringDamper, Standard, respond
from rbsd_sym.mechanics.motion import Frame, Motion

EPS = float(np.finfo(float).eps)
STORED = stored("derivatives")
CASES = STORED["cases"]
K, OFFSET = ca.DM(STORED["stiffness"]), ca.DM(STORED["offset"])
# Worst relative errors found, over all cases: 7e-16, 5e-15, 2e-15 and 2.4e-14 for orders 0 to 3.
TOLERANCE = np.array([8e-15, 4e-14, 2e-14, 3e-13])
Log = Callable[[Any], Any]


def moved(p: Any, q: Any, step: Any) -> Motion:
    """A frame translated by step[:3] and turned by step[3:], world axes."""
    q = rot.quat_product(rot.quat_exp(step[3:]), q)
    still = ca.SX.zeros(3)
    return Motion(Frame(p + step[:3], rot.quat_matrix(q), q), still, still)


def energy(s: Any, p0: Any, q0: Any, p1: Any, q1: Any, direction: Any) -> Any:
    """U of the moved markers, by the package's own law."""
    motions = moved(p0, q0, s * direction[:6]), moved(p1, q1, s * direction[6:])
    numbers = SpringDamper(ca.SX(K), ca.SX.zeros(6, 6), ca.SX(OFFSET), ca.SX.zeros(6))
    return respond(Consistent(), numbers, ca.SX(0), *motions).potential_energy


def orders(U: Any, s: Any) -> Any:
    """U and its first three derivatives by s."""
    column = [U]
    for _ in range(3):
        column.append(ca.jacobian(column[-1], s))
    return ca.vertcat(*column)


def data(case: dict[str, Any]) -> list[ca.DM]:
    """p0, q0, p1, q1, direction; a tiny angle is held by a quaternion, not by a matrix."""
    q0, q1 = (rot.matrix_quat(ca.DM(case[f"R{i}"])) for i in (0, 1))
    if case["angle"] < 1e-8:
        q1 = rot.quat_product(q0, rot.quat_exp(case["angle"] * ca.DM(case["axis"])))
    return [ca.DM(case["p0"]), q0, ca.DM(case["p1"]), q1, ca.DM(case["direction"])]


@functools.cache
def in_sx() -> ca.Function:
    """Orders 0 to 3 by (s, data), differentiated as SX expressions."""
    symbols = [ca.SX.sym("s"), *(ca.SX.sym("d", n) for n in (3, 4, 3, 4, 12))]
    return ca.Function("in_sx", symbols, [orders(energy(*symbols), symbols[0])])


@functools.cache
def in_mx() -> ca.Function:
    """The same, differentiated through a call of the function of U."""
    symbols = [ca.SX.sym("s"), *(ca.SX.sym("d", n) for n in (3, 4, 3, 4, 12))]
    U = ca.Function("U", symbols, [energy(*symbols)])
    called = [ca.MX.sym("a", symbol.numel()) for symbol in symbols]
    return ca.Function("in_mx", called, [orders(U(*called), called[0])])


def with_numbers(case: dict[str, Any]) -> np.ndarray:
    """Poses as numbers in the expression; s stays a symbol until the end."""
    s = ca.SX.sym("s")
    column = orders(energy(s, *(ca.SX(value) for value in data(case))), s)
    return np.array(ca.Function("f", [s], [column])(0))[:, 0]


def folded(case: dict[str, Any]) -> np.ndarray:
    """Everything a number: s = 0 is folded into the differentiated expression too."""
    s = ca.SX.sym("s")
    column = orders(energy(s, *(ca.SX(value) for value in data(case))), s)
    column = ca.substitute(column, s, 0)
    assert column.is_constant()
    return np.array(ca.DM(column))[:, 0]


EVALUATIONS: dict[str, Callable[[dict[str, Any]], np.ndarray]] = {
    "sx": lambda case: np.array(in_sx()(0, *data(case)))[:, 0],
    "mx": lambda case: np.array(in_mx()(0, *data(case)))[:, 0],
    "with_numbers": with_numbers,
    "folded": folded,
}


@pytest.mark.parametrize("evaluation", EVALUATIONS)
@pytest.mark.parametrize("index", range(len(CASES)))
def test_energy_to_third_order(index: int, evaluation: str) -> None:
    case = CASES[index]
    reference = np.array(case["derivatives"])
    error = np.abs(EVALUATIONS[evaluation](case) - reference) / np.abs(reference)
    assert (error < TOLERANCE).all(), error


def textbook_energy(log: Log, case: dict[str, Any]) -> Callable[[Any], Any]:
    """U(s) with a logarithm of your choice, everything else as in the law."""
    p0, q0, p1, q1, d = data(case)

    def U(s: Any) -> Any:
        q0_moved = rot.quat_product(rot.quat_exp(s * d[3:6]), q0)
        q1_moved = rot.quat_product(rot.quat_exp(s * d[9:]), q1)
        q = rot.quat_product(rot.quat_conjugate(q0_moved), q1_moved)
        R_WM = rot.quat_matrix(rot.quat_product(q0_moved, rot.quat_half(q)))
        u = ca.vertcat(R_WM.T @ (p1 - p0 + s * (d[6:9] - d[:3])), log(q)) - OFFSET
        return ca.dot(u, K @ u) / 2

    return U


def textbook_orders(log: Log, case: dict[str, Any]) -> np.ndarray:
    """Orders 0 to 3, relative to the reference, minus one."""
    s = ca.SX.sym("s")
    column = ca.Function("f", [s], [orders(textbook_energy(log, case)(s), s)])(0)
    return np.array(column)[:, 0] / np.array(case["derivatives"]) - 1


def naive_log(q: Any) -> Any:
    """th = 2 atan2(|v|, w) v / |v|."""
    n = ca.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    return 2 * ca.atan2(n, q[0]) / n * q[1:]


def guarded_log(q: Any) -> Any:
    """The naive form with a guard that takes its limit 2 v below 1e-8 rad."""
    n2 = q[1] ** 2 + q[2] ** 2 + q[3] ** 2
    near = n2 < 0.25e-16
    n = ca.sqrt(ca.if_else(near, 1, n2))
    return ca.if_else(near, 2, 2 * ca.atan2(n, q[0]) / n) * q[1:]


def test_the_harness_passes_the_right_log() -> None:
    for case in CASES[::4]:
        assert (np.abs(textbook_orders(rot.quat_log, case)) < TOLERANCE).all()


def test_naive_log_is_nan_at_rest() -> None:
    at_rest = [case for case in CASES if case["angle"] == 0]
    assert len(at_rest) == 4
    for case in at_rest:
        assert np.isnan(textbook_orders(naive_log, case)).all()


def test_naive_log_is_noise_next_to_rest() -> None:
    """At 1e-12 rad there is no NaN, and the third derivative is off by factors up to millions."""
    errors = np.array([
        np.abs(textbook_orders(naive_log, case)) for case in CASES if case["angle"] == 1e-12
    ])  # fmt: skip
    assert (errors[:, :2] < TOLERANCE[:2]).all()
    assert errors[:, 3].min() > 0.01
    assert errors[:, 3].max() > 1e6


def test_guarded_log_has_a_wrong_third_derivative_at_rest() -> None:
    """Value, slope and curvature pass; the third derivative is silently off by up to 17 %."""
    errors = []
    for case in CASES:
        if case["angle"] == 0:
            error = textbook_orders(guarded_log, case)
            assert (np.abs(error[:3]) < TOLERANCE[:3]).all()
            errors.append(error[3])
    assert errors[0] == pytest.approx(-0.173730, abs=1e-6)
    assert np.abs(errors).min() > 1e-3


def tangent(law: Any, p1: Any, q1: Any, stiffness: Any) -> np.ndarray:
    """Minus the Jacobian (12, 12) of the wrenches by the markers' world motions, A0 = I.

    The offset is the strain of the pose itself, so that the connector carries no load.
    """
    steps = ca.SX.sym("steps", 12)
    pose0 = ca.DM.zeros(3), ca.DM([1, 0, 0, 0])

    def answer(step: Any, offset: Any) -> Any:
        numbers = SpringDamper(ca.SX(stiffness), ca.SX.zeros(6, 6), offset, ca.SX.zeros(6))
        motions = moved(*pose0, step[:6]), moved(p1, q1, step[6:])
        return respond(law, numbers, ca.SX(0), *motions)

    strain = answer(ca.SX.zeros(12), ca.SX.zeros(6)).relative.strain
    response = answer(steps, strain)
    wrench = ca.vertcat(*response.wrench0, *response.wrench1)
    f = ca.Function("tangent", [steps], [wrench, -ca.jacobian(wrench, steps)])
    load, matrix = (np.array(part) for part in f(0))
    assert np.abs(load).max() < 1e-9  # N, beside stiffnesses of 1e4 N/m
    return matrix


POSES = [(np.array([0.1, 0.2, 0.3]), angle * np.array([0.5, -0.4, 0.8])) for angle in (0, 1, 2.5)]


@pytest.mark.parametrize(("p1", "th"), POSES)
def test_tangent_stiffness_of_consistent(p1: np.ndarray, th: np.ndarray) -> None:
    """J' K J at an unloaded equilibrium: symmetric, with the oracle's hand-made J."""
    matrix = tangent(Consistent(), ca.DM(p1), rot.quat_exp(ca.DM(th)), K)
    size = np.abs(matrix).max()
    assert np.abs(matrix - matrix.T).max() < 1e-12 * size
    poses = oracle.Pose(np.zeros(3), np.eye(3)), oracle.Pose(p1, rotations.exp_so3(th))
    J = oracle.middle_jacobian(*poses)
    assert np.abs(matrix - J.T @ np.array(K) @ J).max() < 64 * EPS * size


@pytest.mark.parametrize("law", [Standard(), Intrinsic()])
def test_tangent_stiffness_of_the_others_is_unsymmetric(law: Any) -> None:
    """A coupled, symmetric K at a finite rotation: 16 % and 12 % of the largest entry."""
    p1, th = POSES[2]
    matrix = tangent(law, ca.DM(p1), rot.quat_exp(ca.DM(th)), K)
    assert np.abs(matrix - matrix.T).max() > 0.1 * np.abs(matrix).max()
