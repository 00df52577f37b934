"""Jacobians by differences instead of exact ones: a stiff pendulum's slow frequency, and Newton."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np

from rbsd_sym import (
    GROUND,
    Idas,
    Marker,
    Model,
    Param,
    RigidBody,
    RigidBodySpringDamper,
    Scene,
    compile_scene,
    simulate,
)
from rbsd_sym.study import Table

GRAVITY, INERTIA = 9.81, 0.1  # m/s2, kg m2
TILT = 0.5  # rad: of gravity against z, so that no symmetry hides the error of differences
WAYS = ("exact", "forward", "central")
_EPSILON = float(np.finfo(float).eps)
_MANY = 10_000_000  # steps
_RATIO = 0.1  # of damping, so that Newton's method is what costs


@cache
def hanging() -> Model:
    """1 kg on a joint 1 m away, swinging in a plane; `stiffness`, `damping` of the joint.

    Without what was left out: its eigenvalues are zero, which rounding in stiff joints hides.
    """
    k, d = Param("stiffness", 1e6, "N/m"), Param("damping", 0.0, "N s/m")
    bob = RigidBody("bob", 1, [INERTIA] * 3, position=(0, 0, -1))
    joint = RigidBodySpringDamper(
        "joint", Marker(GROUND), Marker("bob", (0, 0, 1)), [k, k, k, 0, 0, 0], [d, d, d, 0, 0, 0]
    )
    down = (GRAVITY * math.sin(TILT), 0, -GRAVITY * math.cos(TILT))
    scene = Scene("hanging", [bob], [joint], gravity=down)
    return replace(compile_scene(scene), reduction=None)


def slow_frequency(k: float) -> float:
    """Lower frequency about the rest position (rad/s), of a joint with stiffness k (N/m).

    With the sideways coordinate x of the body and its angle a, the marker is at x - L a:
    x'' = -k (x - L a), J a'' = k L (x - L a) - G L a; G = m g is the tension, m = 1 kg. The square
    of the frequency is a root of J s^2 - (k (J + L^2) + G L) s + k G L = 0, here without the
    difference of numbers of nearly one size.
    """
    b = k * (INERTIA + 1) + GRAVITY
    return math.sqrt(2 * k * GRAVITY / (b + math.sqrt(b * b - 4 * INERTIA * k * GRAVITY)))


def _rest(model: Model, k: float) -> np.ndarray:
    r = 1 + GRAVITY / k
    at = {"bob.p_x": r * math.sin(TILT), "bob.p_z": -r * math.cos(TILT), "bob.angle_y": -TILT}
    return np.array([at.get(label.name, 0.0) for label in model.x_labels])


def _jacobian(way: str, rates: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """By differences with the steps of the textbooks: eps^(1/2) or eps^(1/3), times max(1, |x|)."""
    steps = _EPSILON ** (1 / 2 if way == "forward" else 1 / 3) * np.maximum(1, np.abs(x))
    columns = []
    for e in np.diag(steps):
        back = x if way == "forward" else x - e
        columns.append((rates(x + e) - rates(back)) / (x + e - back).sum())
    return np.array(columns).T


def digits(stiffnesses: np.ndarray) -> Table:
    """Error of the slow frequency from eigenvalues of each Jacobian, and of its entries."""
    model, rows = hanging(), []
    ode, exact = model.function("ode"), model.function("dode_dx")
    for k in stiffnesses:
        p = [{"stiffness": float(k), "damping": 0.0}[label.name] for label in model.dae.p_labels]
        x = _rest(model, float(k))

        def rates(at: np.ndarray, p: list[float] = p) -> np.ndarray:
            return np.array(ode(0, at, [], [], p)).reshape(-1)

        true, w = np.array(ca.DM(exact(0, x, [], [], p))), slow_frequency(float(k))
        for way in WAYS:
            J = true if way == "exact" else _jacobian(way, rates, x)
            found = np.linalg.eigvals(J)
            away = float(np.abs(found - 1j * w).min()) / w
            rows.append((way, float(k), float(np.abs(J - true).max()), away))
    return Table(
        ("jacobian", "stiffness", "largest_error", "slow_frequency_error"),
        ("", "N/m", "", ""),
        tuple(rows),
    )


def _with_differences(model: Model, way: str) -> Model:
    """The model with rates that CasADi differentiates by its own differences."""
    if way == "exact":
        return model
    ode = model.function("ode")
    arguments = ode.mx_in()
    options = {
        "enable_forward": False,
        "enable_reverse": False,
        "enable_jacobian": False,
        "enable_fd": True,
        "fd_method": way,
    }
    rates = ca.Function("ode", arguments, [ode(*arguments)], list("txzup"), ["ode"], options)
    return replace(model, library={"ode": rates})


def newton(stiffnesses: np.ndarray) -> Table:
    """Work of IDAS with each Jacobian on two seconds of swinging, the joint damped."""
    rows = []
    for way in WAYS:
        model = _with_differences(hanging(), way)
        for k in stiffnesses:
            given = {"stiffness": float(k), "damping": 2 * _RATIO * math.sqrt(float(k))}
            method = Idas(1e-6, 1e-8, max_order=2, max_steps=_MANY)
            run = simulate(model, [0, 2.0], method, params=given, throw=False)
            counts = [run.stats[name] for name in ("steps", "newton_iterations", "jacobians")]
            rows.append((way, float(k), *counts, run.outcome.name))
    return Table(
        ("jacobian", "stiffness", "steps", "newton_iterations", "jacobians", "outcome"),
        ("", "N/m", "", "", "", ""),
        tuple(rows),
    )
