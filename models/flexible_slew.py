"""A hub pushes a load through a spring, from rest to rest, in minimum time or with minimum effort.

Two masses and a spring [Wie, Sinha, Liu 1993]. In minimum time the force switches between its
bounds at three instants; with a rigid rod one switch and a time of
2 sqrt(mass distance / force) = 2.828 s would do.
"""

from __future__ import annotations

from typing import Any

import rbsd_sym as rs

T_END = 5.0
COLUMNS = ("push", "hub.p_x", "tip.p_x", "hub.v_x", "tip.v_x", "rod.force_local")
METHOD = rs.ocp.Collocation(20, degree=4, refine=1e-8)
REST = {"hub.p_x": 1, "tip.p_x": 2, "hub.v_x": 0, "tip.v_x": 0}
PUSH = rs.Input("push", "N")


def scene(stiffness: float = 1.0) -> rs.Scene:
    """Return two masses of 1 kg, 1 m apart on a rod of given stiffness, and a force on the hub."""
    hub = rs.RigidBody("hub", 1, (0.1, 0.1, 0.1), size=(0.3, 0.3, 0.3))
    tip = rs.RigidBody("tip", 1, (0.1, 0.1, 0.1), position=(1, 0, 0), size=(0.2, 0.2, 0.2))
    rod = rs.RigidBodySpringDamper(
        "rod",
        rs.Marker("hub"),
        rs.Marker("tip"),
        stiffness=(stiffness, 0, 0, 0, 0, 0),
        # The rod is unstrained at its length of 1 m.
        offset=(1, 0, 0, 0, 0, 0),
    )
    motor = rs.Load("motor", rs.Marker("hub"), force=(PUSH, 0, 0))
    return rs.Scene("flexible_slew", [hub, tip], [rod], [motor])


def problem(stiffness: float = 1.0, force_in_rod: float | None = None) -> rs.ocp.Problem:
    """Return the minimum-time problem over 1 m with a push of at most 1 N.

    Arguments:
        stiffness: of the rod, N/m.
        force_in_rod: largest force in the rod, N; None for no limit.
    """
    limit = (
        rs.ocp.Bound(lambda v: v["rod.force_local"][0], -force_in_rod, force_in_rod, "N")
        if force_in_rod
        else None
    )
    phase = rs.ocp.Phase(
        rs.ocp.Free(4.0, low=1.0, high=10.0),
        end=REST,
        path={"force in the rod": limit} if limit else {},
        end_cost=rs.TIME,
    )
    model = rs.compile_scene(scene(stiffness))
    return rs.ocp.Problem(model, phase, inputs={"push": rs.ocp.Free(low=-1, high=1)})


def arcs() -> rs.ocp.Problem:
    """Return the minimum-time problem with a phase for each arc at a bound: switches are exact."""
    lengths = rs.ocp.Free(1.0, low=0.1, high=5.0)
    # In each of four phases the push is constant at a bound, and the length is free.
    phases = [rs.ocp.Phase(lengths, path={"push": push}) for push in (1, -1, 1)]
    last = rs.ocp.Phase(lengths, path={"push": -1}, end=REST, end_cost=rs.TIME)
    model = rs.compile_scene(scene())
    return rs.ocp.Problem(model, [*phases, last], inputs={"push": rs.ocp.Free(low=-1, high=1)})


def least_effort(duration: float = 5.0) -> rs.ocp.Problem:
    """Return the problem of least integral of half the force squared in a given time (s)."""
    phase = rs.ocp.Phase(duration, end=REST, integral=PUSH**2 / 2)
    model = rs.compile_scene(scene())
    return rs.ocp.Problem(model, phase, inputs={"push": rs.ocp.Free()})


def picture(solution: rs.ocp.Solution) -> Any:
    """Plot force, motion and force in the rod over time."""
    return rs.plots.trajectory(solution.trajectory, COLUMNS)


if __name__ == "__main__":
    found = rs.ocp.optimise(problem(), METHOD)
    print(found)
    picture(found).savefig("generated/charts/flexible_slew.png", dpi=110)
