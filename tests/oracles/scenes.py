"""Whole scenes in the format of `reference/scenes.json`: rates, energy, momenta, time stepping.

A scene is a dict: `gravity`, `law`, `bodies` (mass, inertia about the centre of mass in body axes,
position and velocity of the centre of mass in the world, angular_velocity in body axes) and
`connectors` (body0, body1 with -1 for the ground, position0, position1, stiffness, damping,
offset). Beyond the file's format: body `rotation`, connector `law`, `rotation0`, `rotation1`,
`rotation_marker0`, `rotation_marker1` (matrices) and `velocity_offset`.

A state is an array (n_bodies, 13) with rows p_WB (3), q_WB (4, scalar first), v_WB_W (3),
w_WB_B (3); B has its origin at the centre of mass. It may be complex, see `rotations`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from . import laws
from .laws import LawResult, Pose
from .rotations import Array, cross, from_quaternion, to_quaternion

Scene = dict[str, Any]
GROUND = -1
LAWS = {"standard": laws.standard, "intrinsic": laws.intrinsic, "consistent": laws.consistent}
_P, _Q, _V, _W = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)


def state_of(bodies: list[dict[str, Any]]) -> Array:
    """The state (n_bodies, 13) of a list of body dicts, identity rotation unless given."""
    return np.array([
        [
            *body["position"],
            *to_quaternion(np.array(body.get("rotation", np.eye(3)), dtype=float)),
            *body["velocity"],
            *body["angular_velocity"],
        ]
        for body in bodies
    ])


def start_state(scene: Scene) -> Array:
    """The state of the scene at t = 0."""
    return state_of(scene["bodies"])


def final_state(scene: Scene) -> Array:
    """The stored reference state at the scene's `t_end`."""
    final = scene["final"]
    columns = zip(*final.values(), strict=True)
    return state_of([dict(zip(final, row, strict=True)) for row in columns])


def _inertia(body: dict[str, Any]) -> Array:
    """I_BB_B (3, 3) from principal moments or a full matrix."""
    inertia = np.asarray(body["inertia"], dtype=float)
    return np.diag(inertia) if inertia.ndim == 1 else inertia


def marker_pose(state: Array, connector: dict[str, Any], end: int) -> Pose:
    """Frame A of a connector's marker 0, or C of marker 1, and its motion.

    p_WA = p_WB + R_WB p_BA, R_WA = R_WB R_BA rotation_marker, v_WA = v_WB + w_WB x (R_WB p_BA).
    """
    p_BA = np.asarray(connector[f"position{end}"], dtype=float)
    R_BA = np.eye(3)
    for key in (f"rotation{end}", f"rotation_marker{end}"):
        if key in connector:
            R_BA = R_BA @ np.asarray(connector[key], dtype=float)
    body = connector[f"body{end}"]
    if body == GROUND:
        return Pose(p_BA, R_BA)
    x = state[body]
    R_WB = from_quaternion(x[_Q])
    r_W, w_W = R_WB @ p_BA, R_WB @ x[_W]
    return Pose(x[_P] + r_W, R_WB @ R_BA, x[_V] + cross(w_W, r_W), w_W)


def connector_result(scene: Scene, state: Array, connector: dict[str, Any]) -> LawResult:
    """The law of one connector at a state: wrenches on its markers, strain, rate, local."""
    return _apply(scene, connector, [marker_pose(state, connector, end) for end in (0, 1)])


def _apply(scene: Scene, connector: dict[str, Any], poses: list[Pose]) -> LawResult:
    """The connector's law at given marker poses."""
    law = LAWS[connector.get("law", scene["law"])]
    return law(
        *poses, connector["stiffness"], connector["damping"], connector["offset"],
        connector.get("velocity_offset", 0.0),
    )


def wrenches(scene: Scene, state: Array) -> tuple[Array, Array]:
    """Force (world) and moment about the centre of mass (world) on each body, gravity included."""
    gravity = np.asarray(scene["gravity"], dtype=float)
    force = np.array([body["mass"] * gravity for body in scene["bodies"]], dtype=state.dtype)
    moment = np.zeros_like(force)
    for connector in scene["connectors"]:
        poses = [marker_pose(state, connector, end) for end in (0, 1)]
        result = _apply(scene, connector, poses)
        ends = ((result.force0, result.torque0), (result.force1, result.torque1))
        for end, (f, m) in enumerate(ends):
            body = connector[f"body{end}"]
            if body != GROUND:
                force[body] += f
                moment[body] += m + cross(poses[end].p - state[body, _P], f)
    return force, moment


def rates(scene: Scene, state: Array) -> Array:
    """Time derivative of the state, Newton-Euler equations about the centres of mass.

    p' = v, q' = q (0, w_B)/2, m v' = f, I w_B' = R_WB' m_W - w_B x I w_B
    [Goldstein, Poole, Safko 2002, sec. 5.5; quaternion kinematics: Diebel 2006].
    """
    force, moment = wrenches(scene, state)
    out = np.empty_like(state)
    for i, body in enumerate(scene["bodies"]):
        I, x = _inertia(body), state[i]
        q, w = x[_Q], x[_W]
        out[i, _P] = x[_V]
        out[i, 3] = -0.5 * (q[1:] @ w)
        out[i, 4:7] = 0.5 * (q[0] * w + cross(q[1:], w))
        out[i, _V] = force[i] / body["mass"]
        m_B = from_quaternion(q).T @ moment[i]
        out[i, _W] = np.linalg.solve(I, m_B - cross(w, I @ w))
    return out


def kinetic_energy(scene: Scene, state: Array) -> float:
    """Sum of m v.v/2 + w_B.(I w_B)/2, J."""
    return sum(
        0.5 * body["mass"] * (x[_V] @ x[_V]) + 0.5 * (x[_W] @ _inertia(body) @ x[_W])
        for body, x in zip(scene["bodies"], state, strict=True)
    )


def energy(scene: Scene, state: Array) -> float:
    """Kinetic, gravitational (zero at the origin) and the connectors' own energies together, J."""
    total = kinetic_energy(scene, state)
    for body, x in zip(scene["bodies"], state, strict=True):
        total -= body["mass"] * (np.asarray(scene["gravity"]) @ x[_P])
    for connector in scene["connectors"]:
        e = connector_result(scene, state, connector).strain - connector["offset"]
        total += 0.5 * (e @ np.asarray(connector["stiffness"]) @ e)
    return total


def momentum(scene: Scene, state: Array) -> Array:
    """Linear momentum, sum of m v_W (3), N s."""
    return sum(body["mass"] * x[_V] for body, x in zip(scene["bodies"], state, strict=True))


def angular_momentum(scene: Scene, state: Array) -> Array:
    """Angular momentum about the world origin, sum of R_WB I w_B + p x m v (3), kg m2/s."""
    return sum(
        from_quaternion(x[_Q]) @ (_inertia(body) @ x[_W]) + body["mass"] * cross(x[_P], x[_V])
        for body, x in zip(scene["bodies"], state, strict=True)
    )


def extrapolated_step(f: Callable[[Array], Array], x: Array, h: float, columns: int) -> Array:
    """One step of Gragg's modified midpoint rule, extrapolated to order 2 `columns`.

    The rule with n = 2, 4, 6, ... substeps has an error in even powers of h/n; Aitken-Neville
    removes one power per column [Hairer, Norsett, Wanner 1993, sec. II.9].
    """
    slope = f(x)
    previous: list[Array] = []
    for j in range(1, columns + 1):
        n = 2 * j
        dt = h / n
        last, now = x, x + dt * slope
        for _ in range(n - 1):
            last, now = now, last + 2.0 * dt * f(now)
        row = [now]
        for k, older in enumerate(previous, start=1):
            row.append(row[-1] + (row[-1] - older) / ((j / (j - k)) ** 2 - 1.0))
        previous = row
    return previous[-1]


def integrate(
    f: Callable[[Array], Array], x: Array, t_end: float, steps: int, columns: int = 6
) -> Array:
    """x(t_end) of x' = f(x) by equal steps of order 2 `columns`, columns (columns + 1) calls each.

    Fixed steps and no tolerance: repeat with more steps to see the error.
    """
    for _ in range(steps):
        x = extrapolated_step(f, x, t_end / steps, columns)
    return x


def simulate(scene: Scene, t_end: float, steps: int, state: Array | None = None) -> Array:
    """The state at t_end, from the scene's start or from a given state."""
    start = start_state(scene) if state is None else state
    return integrate(lambda x: rates(scene, x), start, t_end, steps)
