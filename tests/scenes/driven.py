"""An oscillator driven by an input, and its motion in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from oracles.closed_forms import damped_oscillator

import rbsd_sym as rs

Array = NDArray[np.float64]
M, K, D = 2.0, 40.0, 0.8  # kg, N/m, N s/m
CLOSE = 1e-8  # m, for motions of 0.1 m at rtol 1e-10; each integrator is within 3e-9
GRID = np.linspace(0.0, 2.0, 41)
KNOTS, FORCES = np.array([0.1, 0.3, 0.5, 1.2, 1.7]), np.array([1.0, 3.0, -2.0, 5.0, 1.0])


def oscillator(force: Any, k: Any = K) -> rs.Model:
    """m x'' + d x' + k x = force along x, on the ground; the other directions rest."""
    body = rs.RigidBody("b", M, [0.1, 0.2, 0.25], velocity=[0.5, 0, 0])
    spring = rs.RigidBodySpringDamper(
        "c", rs.Marker(rs.GROUND), rs.Marker("b"), [k, K, K, 10, 10, 10], [D, D, D, 0.1, 0.1, 0.1]
    )
    load = rs.Load("push", rs.Marker("b"), [force, 0, 0])
    return rs.compile_scene(rs.Scene("oscillator", [body], [spring], [load]))


def piecewise_linear(t: Array, knots: Array, forces: Array, x: float, v: float) -> Array:
    """Closed form for a force linear between knots: on each piece a line plus free vibration."""
    out = np.empty_like(t)
    for t0, t1, f0, f1 in zip(knots, knots[1:], forces, forces[1:], strict=False):
        slope = (f1 - f0) / (t1 - t0)
        at0, rate = f0 / K - slope * D / K**2, slope / K  # a particular motion
        now = (t >= t0) & (t <= t1)
        free, _ = damped_oscillator(t[now] - t0, M, K, D, v - rate, x - at0)
        out[now] = at0 + rate * (t[now] - t0) + free
        ends = damped_oscillator(t1 - t0, M, K, D, v - rate, x - at0)
        x, v = at0 + rate * (t1 - t0) + float(ends[0]), rate + float(ends[1])
    return out


def sine_driven(t: Array, f: float, w: float, x: float, v: float) -> Array:
    """Closed form for the force f sin(w t): steady vibration plus free vibration."""
    a, b = K - M * w * w, D * w
    sine, cosine = f * a / (a * a + b * b), -f * b / (a * a + b * b)
    free, _ = damped_oscillator(t, M, K, D, v - sine * w, x - cosine)
    return sine * np.sin(w * t) + cosine * np.cos(w * t) + free
