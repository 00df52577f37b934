"""A two-link arm with compliant joints moves from pose to pose in minimum time.

Motor torques are limited, and so are the deflections of the joint bushings. The arm moves in a
horizontal plane. A thousandth of the normalised effort is added to the time, because the fastest
motion is not unique.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import rbsd_sym as rs

T_END = 0.5
COLUMNS = (
    "shoulder_torque",
    "elbow_torque",
    "upper.angle_z",
    "fore.angle_z",
    "shoulder.displacement_local",
    "elbow.displacement_local",
)
INPUTS = {"shoulder_torque": 4.0, "elbow_torque": -1.0}
METHOD = rs.ocp.Collocation(120, degree=3, scheme="radau", input_degree=1, path_points=2)
SOLVER = rs.ocp.Ipopt()
# Length of each link, m.
LENGTH = 0.5
# Stiffness (N/m) and damping (N s/m) of the joints along each axis.
BUSHING = (1.5e4, 150.0)
# Largest deflection along each axis of a joint, m.
GIVES = 2e-3
# Largest motor torques, N m.
TOP = {"shoulder": 15.0, "elbow": 6.0}
# Rotation of the shoulder, and of the elbow relative to it, rad.
TURN = 1.2, -0.8
SHOULDER, ELBOW = (rs.Input(f"{name}_torque", "N m") for name in TOP)


def _link(name: str, mass: float, x: float) -> rs.RigidBody:
    """Return a slender link along x with its frame in the middle."""
    across = mass * LENGTH**2 / 12
    return rs.RigidBody(
        name, mass, (0.1 * across, across, across), position=(x, 0, 0), size=(LENGTH, 0.06, 0.06)
    )


def _joint(
    name: str, inner: rs.Marker, outer: str, bushing: tuple[float, float]
) -> rs.RigidBodySpringDamper:
    """Return a hinge about z, made of bushings of stiffness (N/m) and damping (N s/m)."""
    k, d = bushing
    return rs.RigidBodySpringDamper(
        name,
        inner,
        rs.Marker(outer, (-LENGTH / 2, 0, 0)),
        stiffness=(k, k, k, 1e3, 1e3, 0),
        damping=(d, d, d, 1, 1, 0.02),
        law=rs.Consistent(),
    )


def scene(bushing: tuple[float, float] = BUSHING) -> rs.Scene:
    """Return the arm: links of 3 and 2 kg, straight along x, and a motor in each joint.

    Arguments:
        bushing: stiffness (N/m) and damping (N s/m) of each joint along x, y and z.
    """
    bodies = [_link("upper", 3.0, LENGTH / 2), _link("fore", 2.0, 3 * LENGTH / 2)]
    joints = [
        _joint("shoulder", rs.Marker(rs.GROUND), "upper", bushing),
        _joint("elbow", rs.Marker("upper", (LENGTH / 2, 0, 0)), "fore", bushing),
    ]
    # The elbow motor sits on the upper arm, so its reaction acts there.
    motors = [
        rs.Load("upper_motors", rs.Marker("upper"), torque=(0, 0, SHOULDER - ELBOW)),
        rs.Load("fore_motor", rs.Marker("fore"), torque=(0, 0, ELBOW)),
    ]
    return rs.Scene("arm", bodies, joints, motors)


def _motion(share: float, rate: float) -> dict[str, float]:
    """Return the states of the unstrained arm, its joints at fraction `share` of their turn."""
    found, root, speed = {}, np.zeros(2), np.zeros(2)
    for name, angle in (("upper", TURN[0]), ("fore", TURN[0] + TURN[1])):
        a, w = angle * share, angle * rate
        half = LENGTH / 2 * np.array([np.cos(a), np.sin(a)])
        swing = w * np.array([-half[1], half[0]])
        found |= {f"{name}.angle_z": a, f"{name}.w_z": w}
        found |= {f"{name}.p_{axis}": v for axis, v in zip("xy", root + half, strict=True)}
        found |= {f"{name}.v_{axis}": v for axis, v in zip("xy", speed + swing, strict=True)}
        root, speed = root + 2 * half, speed + 2 * swing
    return found


TIMES = np.linspace(0, 0.6, 31)
# The guess: both joints move along a cubic in time from rest to rest, without strain.
_TAU = TIMES / TIMES[-1]
_SHARE, _RATE = 3 * _TAU**2 - 2 * _TAU**3, 6 * (_TAU - _TAU**2) / TIMES[-1]
_GUESSED = [_motion(*at) for at in zip(_SHARE, _RATE, strict=True)]
GUESS = {name: (TIMES, [at[name] for at in _GUESSED]) for name in _GUESSED[0]}


def _rest() -> dict[str, Any]:
    """Return the end: links at rest, with a residual vibration of up to 0.1 mm and 2 cm/s."""
    room = {"p": 1e-4, "v": 0.02, "a": 0.0, "w": 0.0}
    ends = {name: (v, room[name.split(".")[1][0]]) for name, v in _motion(1.0, 0.0).items()}
    return {name: (v - r, v + r) if r else v for name, (v, r) in ends.items()}


def problem(gives: float = GIVES, bushing: tuple[float, float] = BUSHING) -> rs.ocp.Problem:
    """Return the minimum-time problem.

    Arguments:
        gives: largest deflection along each axis of a joint, m.
        bushing: as in `scene`.
    """
    effort = (SHOULDER / TOP["shoulder"]) ** 2 + (ELBOW / TOP["elbow"]) ** 2
    phase = rs.ocp.Phase(
        rs.ocp.Free(0.7, 0.2, 3.0),
        end=_rest(),
        path={f"{name}.displacement_local": (-gives, gives) for name in TOP},
        integral=1e-3 * effort,
        # The horizon is free, so the time at the end is the duration.
        end_cost=rs.TIME,
    )
    inputs = {f"{name}_torque": rs.ocp.Free(low=-top, high=top) for name, top in TOP.items()}
    return rs.ocp.Problem(rs.compile_scene(scene(bushing)), phase, inputs=inputs)


def picture(solution: rs.ocp.Solution) -> Any:
    """Plot torques, angles and deflections of the joints over time."""
    return rs.plots.trajectory(solution.trajectory, COLUMNS)


if __name__ == "__main__":
    found = rs.ocp.optimise(problem(), METHOD, GUESS, SOLVER)
    print(found)
    picture(found).savefig("generated/charts/arm.png", dpi=80)
