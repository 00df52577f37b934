"""Jacobians and second derivatives of models against complex step of the oracles, and sparsity."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from oracles import laws as oracle
from oracles import rotations, scenes
from scenes import reference
from scenes.small import LAWS

import rbsd_sym as rs

# All states are kept: functions are evaluated where a scene that starts at rest never goes.
compiled_full = functools.partial(rs.compile_scene, minimal=False)
EPS = float(np.finfo(float).eps)
Array = np.ndarray
# Eighth-order central difference: its error is the eighth power of the step.
STENCIL = (4 / 5, -1 / 5, 4 / 105, -1 / 280)
# Name and unit-sized default of every Param and Input of `one_body`, in alphabetical order.
PARAMS = {"arm": 0.3, "com": 0.2, "coupling": 90.0, "d": 30.0, "inertia": 0.4, "k": 900.0, "m": 2.0}
INPUTS = {"push": 3.0, "servo": 0.2, "slip": 0.5}
GRAVITY = np.array([0.5, -9.81, 1.0])
GROUND = np.array([0.1, 0.2, 0.3])
LOAD_ARM = np.array([0.2, 0.1, 0.0])


def complex_step(f: Callable[[Array], Array], w: Array) -> Array:
    """Jacobian, exact to rounding [Squire, Trapp 1998]."""
    h = 1e-30
    return np.array([f(w + 1j * h * unit).imag / h for unit in np.eye(len(w))]).T


def assert_close(value: Any, exact: Array, tolerance: float) -> None:
    """Every entry, relative to the largest of its row."""
    size = np.abs(exact).max(axis=1, keepdims=True)
    assert (np.abs(np.array(value) - exact) <= tolerance * size).all()


@functools.cache
def reference_model(name: str) -> rs.Model:
    """A scene of reference/scenes.json; its states are in the oracle's order."""
    return compiled_full(reference.build(name))


def points(name: str) -> list[Array]:
    """The start (often at rest), and a state with everything in motion and quaternions not unit."""
    start = scenes.start_state(reference.SCENES[name])
    noise = np.random.default_rng(41).normal(size=start.shape)
    return [start.reshape(-1), (start + 0.3 * noise).reshape(-1)]


@pytest.mark.parametrize("name", ["single", "coupled", "chain4", "pair", "pair_intrinsic",
                                  "single_consistent", "chain4_consistent", "pair_consistent"])
def test_dode_dx_of_reference_scenes(name: str) -> None:
    scene, jacobian = reference.SCENES[name], reference_model(name).function("dode_dx")

    def rates(x: Array) -> Array:
        return scenes.rates(scene, x.reshape(-1, 13)).reshape(-1)

    for x in points(name):
        assert_close(jacobian(0, x, [], [], []), complex_step(rates, x), 1e-13)


def test_dode_dx_in_tait_bryan_angles() -> None:
    """Accelerations by all states; the rates of the angles are tested with the rotations."""
    scene = reference.SCENES["pair_consistent"]
    model = compiled_full(reference.build("pair_consistent"), rs.TaitBryan())
    x = np.random.default_rng(42).normal(size=24) * 0.5

    def accelerations(x: Array) -> Array:
        states = [
            np.concatenate([p, rotations.to_quaternion(rotations.from_tait_bryan(a)), v, w])
            for p, a, v, w in (np.split(body, 4) for body in x.reshape(2, 12))
        ]
        return scenes.rates(scene, np.array(states))[:, 7:].reshape(-1)

    rows = [i for i, label in enumerate(model.x_labels) if label.name[3] in "vw"]
    found = np.array(model.function("dode_dx")(0, x, [], [], []))[rows]
    assert_close(found, complex_step(accelerations, x), 1e-13)


def one_body(law: str) -> rs.Model:
    """A body on a bushing and under a load, with Params and Inputs in every role."""
    p = {name: rs.Param(name, value) for name, value in PARAMS.items()}
    u = {name: rs.Input(name, value=value) for name, value in INPUTS.items()}
    body = rs.RigidBody("b", p["m"], [p["inertia"], 0.5, 0.6], com=[0.0, 0.0, p["com"]])
    K = np.diag([800.0, 900.0, 700.0, 50.0, 60.0, 70.0]).astype(object)
    K[0, 0], K[1, 4], K[4, 1] = p["k"], p["coupling"], p["coupling"]
    connector = rs.RigidBodySpringDamper(
        "joint", rs.Marker(rs.GROUND, GROUND), rs.Marker("b", [0.1, p["arm"], -0.2]), K,
        [20.0, 20.0, p["d"], 2.0, 2.0, 2.0], [0.0, u["servo"], 0.0, 0.1, 0.0, 0.0],
        [0.0, 0.0, 0.0, u["slip"], 0.0, 0.0], law=LAWS[law],
    )  # fmt: skip
    load = rs.Load("load", rs.Marker("b", LOAD_ARM), [u["push"], 0.0, 0.0], frame="body")
    outputs = ["joint.force_local", "joint.torque1", "energy"]
    return compiled_full(rs.Scene("one", [body], [connector], [load], GRAVITY, outputs))


@functools.cache
def one_body_model(law: str) -> rs.Model:
    return one_body(law)


def by_hand(law: str, w: Array) -> tuple[Array, Array]:
    """(ode, out) of `one_body` at w = [x; u; p], Newton-Euler about the centre of mass."""
    position, q, v, w_B, u, p = np.split(w, [3, 7, 10, 13, 16])
    arm, com, coupling, d, inertia, k, m = p
    push, servo, slip = u
    K, D, offset, shift = (np.zeros(shape, w.dtype) for shape in ((6, 6), (6, 6), 6, 6))
    K[range(6), range(6)] = [k, 900.0, 700.0, 50.0, 60.0, 70.0]
    K[1, 4] = K[4, 1] = coupling
    D[range(6), range(6)] = [20.0, 20.0, d, 2.0, 2.0, 2.0]
    offset[1], offset[3], shift[3] = servo, 0.1, slip
    R, centre = rotations.from_quaternion(q), np.array([0.0, 0.0, com])
    lever, load_lever = np.array([0.1, arm, -0.2]) - centre, LOAD_ARM - centre
    pose0 = oracle.Pose(GROUND, np.eye(3))
    pose1 = oracle.Pose(
        position + R @ lever, R, v + R @ rotations.cross(w_B, lever), R @ w_B
    )
    result = getattr(oracle, law)(pose0, pose1, K, D, offset, shift)
    force_B, load = R.T @ result.force1, np.array([push, 0.0, 0.0])
    moment = R.T @ result.torque1 + rotations.cross(lever, force_B)
    moment = moment + rotations.cross(load_lever, load)
    I = np.diag(np.array([inertia, 0.5, 0.6]))
    spin = (moment - rotations.cross(w_B, I @ w_B)) / np.diag(I)
    q_rate = 0.5 * np.array([-(q[1:] @ w_B), *(q[0] * w_B + rotations.cross(q[1:], w_B))])
    ode = np.concatenate([v, q_rate, (result.force1 + R @ load) / m + GRAVITY, spin])
    e = result.strain - offset
    energy = (m * (v @ v) + w_B @ I @ w_B + e @ K @ e) / 2 - m * (GRAVITY @ position)
    return ode, np.array([*result.local[:3], *result.torque1, energy])


def states() -> dict[str, Array]:
    """x of `one_body`: at rest without relative rotation, and in motion."""
    rest = np.zeros(13)
    rest[3] = 1.0
    return {"rest": rest, "motion": 0.5 * np.random.default_rng(43).normal(size=13) + rest}


def test_order_of_params_and_inputs() -> None:
    dae = one_body_model("consistent").dae
    assert [v.name for v in dae.p_labels] == list(PARAMS)
    assert [v.name for v in dae.u_labels] == list(INPUTS)


@pytest.mark.parametrize("state", ["rest", "motion"])
@pytest.mark.parametrize("law", LAWS)
def test_every_jacobian_of_one_body(law: str, state: str) -> None:
    model, x = one_body_model(law), states()[state]
    u, p = np.array([*INPUTS.values()]), np.array([*PARAMS.values()])
    w, ends = np.concatenate([x, u, p]), {"x": (0, 13), "u": (13, 16), "p": (16, 23)}
    for i, f in enumerate(("ode", "out")):
        value = np.array(model.function(f)(0, x, [], u, p))[:, 0]
        true = by_hand(law, w)[i]
        assert np.abs(value - true).max() < 1e-13 * np.abs(true).max()
        exact = complex_step(lambda w, i=i: by_hand(law, w)[i], w)
        # Rows are scaled by the whole gradient: a zero block must be zero to that.
        found = np.hstack([
            np.array(model.function(f"d{f}_d{v}")(0, x, [], u, p)) for v in ends
        ])  # fmt: skip
        assert_close(found, exact, 1e-13)
        for v, (start, end) in ends.items():
            block = exact[:, start:end]
            assert np.abs(found[:, start:end] - block).max() <= 1e-13 * np.abs(block).max(), (f, v)


def hessian_times(f: Callable[[Array], Array], w: Array, multiplier: Array, v: Array) -> Array:
    """H v of multiplier'f: complex step for the gradient, the stencil along v (|v| = 1)."""
    h, total = 0.005, np.zeros(len(w))
    for k, c in enumerate(STENCIL, start=1):
        ahead, behind = (multiplier @ complex_step(f, w + s * k * h * v) for s in (1, -1))
        total += c * (ahead - behind) / h
    return total


@pytest.mark.parametrize("state", ["rest", "motion"])
@pytest.mark.parametrize("law", LAWS)
def test_hessian_of_one_body(law: str, state: str) -> None:
    model, x, rng = one_body_model(law), states()[state], np.random.default_rng(44)
    u, p = np.array([*INPUTS.values()]), np.array([*PARAMS.values()])
    w = np.concatenate([x, u, p])
    direction = rng.normal(size=len(w))
    direction /= np.linalg.norm(direction)
    for i, (f, rows) in enumerate((("ode", 13), ("out", 7))):
        multiplier = rng.normal(size=rows)
        product = model.function(f"{f}_hessian")(0, x, [], u, p, multiplier) @ direction
        exact = hessian_times(
            lambda w, i=i: by_hand(law, w)[i], w, multiplier, direction
        )
        error = np.linalg.norm(np.array(product)[:, 0] - exact)
        assert error < 3e-12 * np.linalg.norm(exact)


@pytest.mark.parametrize("name", ["pair_consistent", "pair_intrinsic"])
def test_hessian_of_the_pair(name: str) -> None:
    """Two free bodies; at the start, where the relative rotation is zero, and in motion."""
    scene, rng = reference.SCENES[name], np.random.default_rng(45)
    hessian = reference_model(name).function("ode_hessian")
    multiplier, direction = rng.normal(size=26), rng.normal(size=26)
    direction /= np.linalg.norm(direction)

    def rates(x: Array) -> Array:
        return scenes.rates(scene, x.reshape(-1, 13)).reshape(-1)

    for x in points(name):
        found = np.array(hessian(0, x, [], [], [], multiplier) @ direction)[:, 0]
        exact = hessian_times(rates, x, multiplier, direction)
        assert np.linalg.norm(found - exact) < 3e-12 * np.linalg.norm(exact)


def chain(n: int) -> rs.Model:
    """n bodies one after the other, each tied to the one before by a coupled `Consistent`."""
    bodies = [rs.RigidBody(f"b{i}", 1.0, (1.0, 1.1, 1.2), position=(i, 0, 0)) for i in range(n)]
    K = 1000 * (np.eye(6) + 0.1)
    connectors = [
        rs.RigidBodySpringDamper(
            f"c{i}", rs.Marker(f"b{i - 1}", (0.5, 0, 0)) if i else rs.Marker(rs.GROUND),
            rs.Marker(f"b{i}", (-0.5, 0, 0)), K, K / 100, law=rs.Consistent(),
        )
        for i in range(n)
    ]  # fmt: skip
    return compiled_full(rs.Scene("chain", bodies, connectors, outputs=[]))


def test_jacobian_of_a_chain_is_sparse() -> None:
    """A body feels itself and its two neighbours: at most 3 x 13 entries a row, at any length."""
    found = {n: chain(n).function("dode_dx").sparsity_out(0) for n in (3, 4, 6)}
    for n, pattern in found.items():
        rows, columns = (np.array(index) for index in pattern.get_triplet())
        per_row = np.bincount(rows, minlength=13 * n)
        assert per_row.max() <= 39
        assert np.abs(rows // 13 - columns // 13).max() == 1
        kind = np.arange(13 * n) % 13
        assert (per_row[kind < 3] == 1).all()  # p' = v
        assert (per_row[(kind >= 3) & (kind < 7)] == 6).all()  # q' = q w / 2
    assert found[6].nnz() - found[4].nnz() == 2 * (found[4].nnz() - found[3].nnz())


def test_jacobian_of_what_does_not_act_is_empty() -> None:
    """Inputs that nothing but one body feels, and Params of the other."""
    push, k = rs.Input("push"), rs.Param("k", 5.0)
    bodies = [rs.RigidBody(f"b{i}", 1.0, (1.0, 1.0, 1.0)) for i in (0, 1)]
    connector = rs.RigidBodySpringDamper(
        "joint", rs.Marker(rs.GROUND), rs.Marker("b1"), [k, 0, 0, 0, 0, 0]
    )
    load = rs.Load("load", rs.Marker("b0"), [push, 0.0, 0.0])
    model = compiled_full(rs.Scene("two", bodies, [connector], [load], outputs=[]))
    assert set(model.function("dode_du").sparsity_out(0).row()) == {7}
    assert set(model.function("dode_dp").sparsity_out(0).row()) <= {13 + 7}
    assert model.function("dalg_dx").nnz_out(0) == 0
