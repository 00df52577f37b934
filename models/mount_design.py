"""Engine mounts designed for the least force on the vehicle while the engine runs up.

The problem has no Input to be found, only two Params, stiffness and damping. Soft mounts transmit
less force; the drive torque and the resonances during run-up limit how soft and how lightly damped
they may be, through the travel of the mounts.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

import rbsd_sym as rs

T_END = 2.0
COLUMNS = (
    "engine.displacement",
    "left.displacement_local",
    "right.displacement_local",
    "left.force0",
)
METHOD = rs.ocp.Collocation(tuple(np.linspace(0, 1, 101) ** 0.7), degree=7, path_points=4)
MASS, GRAVITY = 120.0, 9.81
# Inclination of the mounts towards the engine.
TILT = math.radians(35)
# Largest travel of a mount in each direction, m.
TRAVEL = 3e-3
# Mass times eccentricity, kg m.
UNBALANCE = 0.04
# Drive torque at full speed, N m.
TORQUE = 150.0
# Shaft speed at start and end, rad/s.
SLOW, FAST = 2 * math.pi * 2, 2 * math.pi * 20
STIFFNESS = rs.Param("stiffness", 3e5, "N/m")
DAMPING = rs.Param("damping", 1500.0, "N s/m")


def _mount(name: str, side: int) -> rs.RigidBodySpringDamper:
    """Return a front and a rear mount as one connector; its z axis points towards the engine.

    The two are 0.6 m apart, which gives the rotational stiffness. The offset cancels the weight at
    rest.
    """
    c, s = math.cos(TILT), side * math.sin(TILT)
    turned = [[1, 0, 0], [0, c, -s], [0, s, c]]
    # Shear is softer than compression. Rotations about y and z strain the two mounts at 0.3 m from
    # the middle; about x a pair hardly resists.
    share = np.array([0.4, 0.4, 1, 0.001, 0.3**2, 0.4 * 0.3**2])
    place, half = (0, side * 0.3, -0.25), MASS * GRAVITY / 2
    return rs.RigidBodySpringDamper(
        name,
        rs.Marker(rs.GROUND, place),
        rs.Marker("engine", place),
        stiffness=share * STIFFNESS,
        damping=share * DAMPING,
        offset=[0, half * s / (0.4 * STIFFNESS), half * c / STIFFNESS, 0, 0, 0],
        rotation_marker0=turned,
        rotation_marker1=turned,
        law=rs.Consistent(),
        draw_size=0.06,
    )


def scene() -> rs.Scene:
    """Return a block on a left and a right pair of mounts; its shaft accelerates uniformly."""
    engine = rs.RigidBody("engine", MASS, (4.5, 9.0, 8.0), size=(0.7, 0.5, 0.45))
    rise = (FAST - SLOW) / T_END
    speed = SLOW + rise * rs.TIME
    # The unbalance turns by the integral of the speed.
    angle = SLOW * rs.TIME + rise * rs.TIME**2 / 2
    pull = UNBALANCE * speed**2
    loads = [
        rs.Load(
            "unbalance",
            rs.Marker("engine", (0, 0, 0.1)),
            force=(0, pull * np.cos(angle), pull * np.sin(angle)),
        ),
        rs.Load("drive", rs.Marker("engine"), torque=(TORQUE * (speed / FAST) ** 2, 0, 0)),
    ]
    mounts = [_mount("left", 1), _mount("right", -1)]
    return rs.Scene("mount_design", [engine], mounts, loads, gravity=(0, 0, -GRAVITY))


def transmitted(v: Any) -> Any:
    """Return the squared force on the vehicle beyond the weight, kN2."""
    force = v["left.force0"] + v["right.force0"] + np.array([0, 0, MASS * GRAVITY])
    return force @ force / 1e6


def problem() -> rs.ocp.Problem:
    """Return the problem: Params within what rubber can provide, travel within its limits."""
    travel = (-TRAVEL, TRAVEL)
    phase = rs.ocp.Phase(
        T_END,
        path={f"{name}.displacement_local": travel for name in ("left", "right")},
        integral=transmitted,
    )
    params = {
        "stiffness": rs.ocp.Free(low=5e4, high=1e6),
        "damping": rs.ocp.Free(low=100.0, high=1e4),
    }
    return rs.ocp.Problem(rs.compile_scene(scene()), phase, params=params)


def picture(solution: rs.ocp.Solution) -> Any:
    """Plot motion of the engine, travel and force of the mounts over time."""
    return rs.plots.trajectory(solution.trajectory, COLUMNS)


if __name__ == "__main__":
    found = rs.ocp.optimise(problem(), METHOD)
    print(found, found.params, sep="\n")
    picture(found).savefig("generated/charts/mount_design.png", dpi=80)
