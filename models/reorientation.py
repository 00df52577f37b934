"""A satellite turns by 180 degrees in minimum time with three bounded torques.

The fastest motion is not a rotation about the fixed axis, which takes 2 sqrt(pi) = 3.545 s: the
other torques tilt the axis so that it helps [Bilimoria, Wie 1993]. Mirror images of the motion take
the same time; the guess selects one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import rbsd_sym as rs

T_END = 3.3
COLUMNS = ("tau_x", "tau_y", "tau_z", "body.quaternion", "body.angular_velocity")
METHOD = rs.ocp.Collocation(30, degree=4, refine=1e-7)
# Switching sequence that leads to one of the mirror images.
GUESS = {
    "tau_x": lambda t: np.where(0.4 < t < 1.0, -1.0, 1.0),
    "tau_y": lambda t: np.where(t < 1.6, -1.0, 1.0),
    "tau_z": lambda t: np.where(t < 1.7, 1.0, -1.0),
}


def scene() -> rs.Scene:
    """Return a body with moments of inertia of 1 kg m2, and a torque about each of its axes."""
    torques = [rs.Input(f"tau_{axis}", "N m") for axis in "xyz"]
    body = rs.RigidBody("body", 1, (1, 1, 1), size=(1.0, 0.7, 0.5))
    wheels = rs.Load("wheels", rs.Marker("body"), torque=torques, frame="body")
    return rs.Scene("reorientation", [body], [], [wheels])


def problem(formulation: Any = None) -> rs.ocp.Problem:
    """Return the problem: from rest to rest, half a turn about z, at most 1 N m about each axis.

    Arguments:
        formulation: coordinates of the model; `Quaternion` by default.
    """
    phase = rs.ocp.Phase(
        rs.ocp.Free(3.3, low=1.0, high=10.0),
        end={"body.quaternion": (0, 0, 0, 1), "body.angular_velocity": (0, 0, 0)},
        end_cost=rs.TIME,
    )
    torque = rs.ocp.Free(low=-1, high=1)
    model = rs.compile_scene(scene(), formulation)
    return rs.ocp.Problem(model, phase, inputs={f"tau_{axis}": torque for axis in "xyz"})


def picture(solution: rs.ocp.Solution) -> Any:
    """Plot torques, orientation and angular velocity over time."""
    return rs.plots.trajectory(solution.trajectory, COLUMNS)


if __name__ == "__main__":
    found = rs.ocp.optimise(problem(), METHOD, guess=GUESS)
    print(found)
    picture(found).savefig("generated/charts/reorientation.png", dpi=110)
