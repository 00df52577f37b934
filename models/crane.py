"""A crane carries a load over a wall, from rest to rest, with minimum effort.

No swing is left at the end. A force drives the trolley along x, and a servo lifts it: a spring and
damper whose offset is an Input. The load hangs from the trolley on an elastic rope. For small
swings, and without the wall, both are two masses on a spring of stiffness load weight / rope length
[Wie, Sinha, Liu 1993].
"""

from __future__ import annotations

from typing import Any

import numpy as np

import rbsd_sym as rs

T_END = 3.0
COLUMNS = ("drive", "lift", "trolley.p_x", "load.p_x", "load.p_z", "rope.potential_energy")
INPUTS = {"drive": lambda t: 150.0 * np.cos(2.0 * t)}
METHOD = rs.ocp.Collocation(60, degree=5, input_degree=2, refine=1e-5)
SOLVER = rs.ocp.Ipopt()
# m/s2; mass of trolley and of load, kg; length of the loaded rope, m.
GRAVITY, MASS, LENGTH = 9.81, 200.0, 4.0
WEIGHT = MASS * GRAVITY
# Stiffness of rope and lifting servo, N/m.
ROPE, SERVO = 4e4, 2e4
DRIVE = rs.Input("drive", "N")
LIFT = rs.Input("lift", "m")
# Position, half width and height of an ellipse that the load's centre must avoid, m.
WALL = (2.5, 1.0, 1.2)


def _rope(
    mbs,
    t,
    item,
    displacement,
    rotation,
    velocity,
    angular_velocity,
    stiffness,
    damping,
    rotJ0,
    rotJ1,
    offset,
):
    """Spring (4e4 N/m) and damper (400 N s/m) along the line between the two points."""
    d = displacement
    length = np.sqrt(d @ d)
    # LENGTH is that of the loaded rope, so the weight is added to the elastic force.
    pull = ROPE * (length - LENGTH) + WEIGHT + 400.0 * (d @ velocity) / length
    return [*(pull / length * d), 0.0, 0.0, 0.0]


def scene() -> rs.Scene:
    """Return the crane: trolley and load of 200 kg each, at rest, the load at height 0."""
    edge = (0.8, 0.6, 0.3)
    trolley = rs.RigidBody("trolley", MASS, (10, 10, 10), position=(0, 0, LENGTH), size=edge)
    load = rs.RigidBody("load", MASS, (10, 10, 10), size=(0.5, 0.5, 0.5))
    hoist = rs.RigidBodySpringDamper(
        "hoist",
        rs.Marker(rs.GROUND, (0, 0, LENGTH)),
        rs.Marker("trolley"),
        stiffness=(0, 0, SERVO, 0, 0, 0),
        damping=(0, 0, 4e3, 0, 0, 0),
        # The second term carries both weights: with LIFT = 0 the trolley rests at its start.
        offset=(0, 0, LIFT + 2 * WEIGHT / SERVO, 0, 0, 0),
        show=False,
    )
    rope = rs.RigidBodySpringDamper(
        "rope", rs.Marker("trolley"), rs.Marker("load"), 0, force=_rope, draw_size=0.05
    )
    motor = rs.Load("motor", rs.Marker("trolley"), force=(DRIVE, 0, 0))
    return rs.Scene("crane", [trolley, load], [hoist, rope], [motor], gravity=(0, 0, -GRAVITY))


def _rest(distance: float, axes: str = "xz") -> dict[str, float]:
    """Return the end: trolley and load at rest at a distance, m."""
    places = {"trolley": (distance, 0, LENGTH), "load": (distance, 0, 0)}
    ends = {f"{body}.p_{axis}": places[body]["xyz".index(axis)] for body in places for axis in axes}
    return ends | {f"{body}.v_{axis}": 0 for body in places for axis in axes}


def _over(t: float) -> float:
    """Return a height (m) that passes over the wall, for the guess."""
    return 2 * np.sin(np.pi * t / 6) ** 2


GUESS = {"load.p_z": _over, "trolley.p_z": lambda t: LENGTH + _over(t), "lift": _over}


def clearance(v: Any) -> Any:
    """Return a function of the load's position that is at least 1 outside the wall."""
    place, half, height = WALL
    x, _, z = v["load.position"]
    return ((x - place) / half) ** 2 + (z / height) ** 2


def problem(distance: float = 5.0, duration: float = 6.0) -> rs.ocp.Problem:
    """Return the problem of carrying the load over the wall with minimum forces of the motors.

    Arguments:
        distance: m.
        duration: s.
    """
    weight = 2 * WEIGHT
    phase = rs.ocp.Phase(
        duration,
        end=_rest(distance),
        path={"wall": rs.ocp.Bound(clearance, low=1.0)},
        integral=lambda v: (v["drive"] ** 2 + (v["hoist.force_local"][2] + weight) ** 2) / 2e6,
    )
    lift = rs.ocp.Free(0.0, low=-1.0, high=3.0)
    inputs = {"drive": rs.ocp.Free(low=-800, high=800), "lift": lift}
    return rs.ocp.Problem(rs.compile_scene(scene()), phase, inputs=inputs)


def level(distance: float, duration: float | None = None) -> rs.ocp.Problem:
    """Return the problem without wall and lifting: minimum effort in a given time, or minimum time.

    In minimum time the force is limited to load weight times distance / rope length.

    Arguments:
        distance: m.
        duration: s; None for minimum time.
    """
    end, time = _rest(distance, "x"), np.sqrt(LENGTH / GRAVITY)
    if duration:
        phase, drive = rs.ocp.Phase(duration, end=end, integral=DRIVE**2 / 2), rs.ocp.Free()
    else:
        horizon = rs.ocp.Free(4 * time, time, 10 * time)
        phase = rs.ocp.Phase(horizon, end=end, end_cost=rs.TIME)
        force = WEIGHT * distance / LENGTH
        drive = rs.ocp.Free(low=-force, high=force)
    inputs = {"drive": drive, "lift": 0.0}
    return rs.ocp.Problem(rs.compile_scene(scene()), phase, inputs=inputs)


def picture(solution: rs.ocp.Solution) -> Any:
    """Plot the paths of trolley and load with the wall, and both Inputs over time."""
    from matplotlib.figure import Figure

    plan, figure = solution.trajectory, Figure(figsize=(7.5, 7.0), layout="constrained")
    path, drive, lift = figure.subplots(3, 1, height_ratios=(2.5, 1, 1))
    angle, (place, half, height) = np.linspace(0, np.pi, 100), WALL
    path.fill(place + half * np.cos(angle), height * np.sin(angle), color="0.85")
    ends = [(plan[f"{body}.p_x"], plan[f"{body}.p_z"]) for body in ("trolley", "load")]
    path.plot(*np.array(ends)[:, :, ::15].transpose(1, 0, 2), color="0.7", linewidth=0.8)
    path.plot(*ends[0], label="trolley")
    path.plot(*ends[1], label="load")
    path.set(xlabel="x [m]", ylabel="z [m]", aspect="equal")
    path.legend(loc="center left", bbox_to_anchor=(1, 0.5))
    drive.plot(plan.t, plan["drive"])
    drive.set(ylabel="drive [N]")
    lift.plot(plan.t, plan["lift"])
    lift.set(xlabel="time [s]", ylabel="lift [m]")
    return figure


if __name__ == "__main__":
    found = rs.ocp.optimise(problem(), METHOD, GUESS, SOLVER)
    print(found)
    picture(found).savefig("generated/charts/crane.png", dpi=80)
