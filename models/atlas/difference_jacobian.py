"""Jacobians by differences: their effect on a slow frequency and on Newton's method."""

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

# m/s2, kg m2.
GRAVITY, INERTIA = 9.81, 0.1
# Angle of gravity to z, rad, so that no symmetry hides the error of differences.
TILT = 0.5
KINDS = ("exact", "forward", "central")
_EPSILON = float(np.finfo(float).eps)
# Steps: practically no limit.
_MANY = 10_000_000
# Damping ratio; with the vibration damped, Newton's method dominates the cost.
_RATIO = 0.1


@cache
def hanging() -> Model:
    """Return a stiff pendulum: 1 kg, 1 m from its joint, in a plane; Params `stiffness`, `damping`.

    The account of the reduction is removed: its eigenvalues are zero, which rounding in stiff
    joints hides.
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
    """Return the lower frequency (rad/s) about the rest position, for a joint of stiffness k (N/m).

    With the lateral coordinate x of the body and its angle a, the marker is at x - L a: x'' = -k
    (x - L a), J a'' = k L (x - L a) - G L a; G = m g is the tension, m = 1 kg. The square of the
    frequency is a root of J s^2 - (k (J + L^2) + G L) s + k G L = 0, here in the form that avoids
    the difference of numbers of nearly equal size.
    """
    b = k * (INERTIA + 1) + GRAVITY
    return math.sqrt(2 * k * GRAVITY / (b + math.sqrt(b * b - 4 * INERTIA * k * GRAVITY)))


def _rest(model: Model, k: float) -> np.ndarray:
    r = 1 + GRAVITY / k
    at = {"bob.p_x": r * math.sin(TILT), "bob.p_z": -r * math.cos(TILT), "bob.angle_y": -TILT}
    return np.array([at.get(label.name, 0.0) for label in model.x_labels])


def _jacobian(kind: str, rates: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    """Return the Jacobian by differences with textbook steps.

    They are eps^(1/2) forward, or eps^(1/3) central, times max(1, |x|).
    """
    steps = _EPSILON ** (1 / 2 if kind == "forward" else 1 / 3) * np.maximum(1, np.abs(x))
    columns = []
    for e in np.diag(steps):
        back = x if kind == "forward" else x - e
        columns.append((rates(x + e) - rates(back)) / (x + e - back).sum())
    return np.array(columns).T


def digits(stiffnesses: np.ndarray) -> Table:
    """Return errors of the slow frequency from eigenvalues of each Jacobian, and of its entries."""
    model, rows = hanging(), []
    ode, exact = model.function("ode"), model.function("dode_dx")
    for k in stiffnesses:
        p = [{"stiffness": float(k), "damping": 0.0}[label.name] for label in model.dae.p_labels]
        x = _rest(model, float(k))

        def rates(at: np.ndarray, p: list[float] = p) -> np.ndarray:
            return np.array(ode(0, at, [], [], p)).reshape(-1)

        true, w = np.array(ca.DM(exact(0, x, [], [], p))), slow_frequency(float(k))
        for kind in KINDS:
            J = true if kind == "exact" else _jacobian(kind, rates, x)
            found = np.linalg.eigvals(J)
            away = float(np.abs(found - 1j * w).min()) / w
            rows.append((kind, float(k), float(np.abs(J - true).max()), away))
    return Table(
        ("jacobian", "stiffness", "largest_error", "slow_frequency_error"),
        ("", "N/m", "", ""),
        tuple(rows),
    )


def _with_differences(model: Model, kind: str) -> Model:
    """Return the model with rates that CasADi differentiates numerically."""
    if kind == "exact":
        return model
    ode = model.function("ode")
    arguments = ode.mx_in()
    options = {
        "enable_forward": False,
        "enable_reverse": False,
        "enable_jacobian": False,
        "enable_fd": True,
        "fd_method": kind,
    }
    rates = ca.Function("ode", arguments, [ode(*arguments)], list("txzup"), ["ode"], options)
    return replace(model, library={"ode": rates})


def newton(stiffnesses: np.ndarray) -> Table:
    """Return the work of IDAS with each Jacobian on two seconds of swinging, joint damped."""
    rows = []
    for kind in KINDS:
        model = _with_differences(hanging(), kind)
        for k in stiffnesses:
            given = {"stiffness": float(k), "damping": 2 * _RATIO * math.sqrt(float(k))}
            method = Idas(1e-6, 1e-8, max_order=2, max_steps=_MANY)
            run = simulate(model, [0, 2.0], method, params=given, throw=False)
            counts = [run.stats[name] for name in ("steps", "newton_iterations", "jacobians")]
            rows.append((kind, float(k), *counts, run.outcome.name))
    return Table(
        ("jacobian", "stiffness", "steps", "newton_iterations", "jacobians", "outcome"),
        ("", "N/m", "", "", "", ""),
        tuple(rows),
    )
