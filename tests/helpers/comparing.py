"""Numbers of models and trajectories beside each other."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

import rbsd_sym as rs


def by_name(value: Any) -> str:
    """Test id of an integrator, a law, a formulation: the name of its class."""
    return type(value).__name__


def points(model: rs.Model, count: int = 3) -> list[list[Any]]:
    """Random arguments (t, x, z, u, p) near the start."""
    rng = np.random.default_rng(0)
    p = np.array([label.start for label in model.dae.p_labels])
    x, z = model.dae.start_values(p)
    return [
        [rng.standard_normal(), *(v + 0.1 * rng.standard_normal(v.size) for v in
                                  (x, z, np.zeros(model.n_u), p))]
        for _ in range(count)
    ]  # fmt: skip


def largest(values: Any) -> float:
    """Largest absolute value."""
    return float(np.abs(np.asarray(values, float)).max())


def close(a: Any, b: Any, tolerance: float = 1e-12) -> None:
    """Assert that matrices agree, relative to the largest entry, or absolutely if that is small."""
    a, b = (np.array(ca.densify(ca.DM(v))) for v in (a, b))
    assert a.shape == b.shape
    assert np.abs(a - b).max(initial=0.0) <= tolerance * (1 + np.abs(a).max(initial=0.0))


def states(model: rs.Model, trajectory: rs.Trajectory) -> np.ndarray:
    """States (n, n_x) along a trajectory."""
    return np.array([trajectory[label.name] for label in model.x_labels]).T


def traffic(trajectory: rs.Trajectory, connector: str) -> float:
    """Largest power through a connector: force times velocity, component by component."""
    pairs = (("force_local", "velocity_local"), ("torque_local", "angular_velocity_local"))
    return max(
        float(np.abs(trajectory[f"{connector}.{f}"] * trajectory[f"{connector}.{v}"]).max())
        for f, v in pairs
    )


def compare(scene: rs.Scene, t_end: float = 0.5) -> float:
    """Largest difference of minimal and full, relative to the size of a quantity, at least 1."""
    times = np.linspace(0, t_end, 6)
    integrator = rs.ExplicitRK(1e-11, 1e-13)
    models = [rs.compile_scene(scene, minimal=minimal) for minimal in (True, False)]
    small, full = (rs.simulate(model, times, integrator) for model in models)
    assert small.outcome.ok
    worst = 0.0
    for name in models[0].dae.outputs:
        scale = max(np.abs(full[name]).max(), 1.0)
        if name.endswith("_power"):  # a small difference of large powers
            scale = max(scale, traffic(full, name.split(".")[0]))
        worst = max(worst, float(np.abs(small[name] - full[name]).max()) / scale)
    for label in models[1].x_labels:
        difference = np.abs(small[label.name] - full[label.name]).max()
        if label.name.split(".")[1].startswith("q_"):  # of either sign: the angle may start in -pi
            difference = np.abs(np.abs(small[label.name]) - np.abs(full[label.name])).max()
        worst = max(worst, float(difference) / max(1.0, float(np.abs(full[label.name]).max())))
    return worst
