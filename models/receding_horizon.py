"""A hub pushes a load through a spring, following a plan that is renewed every quarter of a second.

A solver exported to C makes the plans, for a spring softer than the real one and without knowledge
of the gust that hits the load. Without a C compiler Python makes them.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

import rbsd_sym as rs

T_END = 20.0
# Time between plans, s; one interval of the mesh.
STEP = 0.25
METHOD = rs.ocp.Shooting(24, steps=1)
HORIZON = 6.0
GOAL = {"hub.p_x": 1.0, "tip.p_x": 2.0, "hub.v_x": 0.0, "tip.v_x": 0.0}
# Stiffness of the rod in the plans, and of the plant, N/m.
STIFFNESS = 1.0
TRUE_STIFFNESS = 1.6
PUSH, GUST = rs.Input("push", "N"), rs.Input("gust", "N")
COLUMNS = ("push", "gust", "hub.p_x", "tip.p_x", "rod.force_local")


def scene() -> rs.Scene:
    """Return two masses of 1 kg on a rod along x, a force on the hub, and a gust on the tip."""
    hub = rs.RigidBody("hub", 1, (0.1, 0.1, 0.1), size=(0.3, 0.3, 0.3))
    tip = rs.RigidBody("tip", 1, (0.1, 0.1, 0.1), position=(1, 0, 0), size=(0.2, 0.2, 0.2))
    rod = rs.RigidBodySpringDamper(
        "rod",
        rs.Marker("hub"),
        rs.Marker("tip"),
        stiffness=(rs.Param("stiffness", STIFFNESS, "N/m"), 0, 0, 0, 0, 0),
        offset=(1, 0, 0, 0, 0, 0),
    )
    loads = [
        rs.Load("motor", rs.Marker("hub"), force=(PUSH, 0, 0)),
        rs.Load("wind", rs.Marker("tip"), force=(GUST, 0, 0)),
    ]
    return rs.Scene("receding_horizon", [hub, tip], [rod], loads)


def problem(start: dict[str, float] | None = None) -> rs.ocp.Problem:
    """Return the planning problem: be near the goal soon, within 6 s, with at most 1 N.

    Arguments:
        start: states at which the plan begins; by default those of the scene.
    """

    def miss(v: Any) -> Any:
        return sum((v[name] - goal) ** 2 for name, goal in GOAL.items())

    phase = rs.ocp.Phase(
        HORIZON,
        start or {},
        integral=lambda v: miss(v) + 0.1 * PUSH**2,
        end_cost=lambda v: 10 * miss(v),
    )
    inputs = {"push": rs.ocp.Free(low=-1, high=1), "gust": 0.0}
    return rs.ocp.Problem(rs.compile_scene(scene()), phase, inputs=inputs)


def gust(t: float) -> float:
    """Return the gust (N) at time t (s): 0.6 N for one second from 10 s on."""
    return 0.6 if 10.0 <= t < 11.0 else 0.0


class Run(NamedTuple):
    """Record of a closed loop.

    Fields:
        t: times of the plans, and the end, s.
        push: force applied after each plan, N.
        seconds: time that each plan took, s.
        states: state values at `t`, by name.
        said: which controller made the plans.
    """

    t: np.ndarray
    push: np.ndarray
    seconds: np.ndarray
    states: dict[str, np.ndarray]
    said: str


Controller = Callable[[dict[str, float]], float]


def controller_in_c() -> Controller:
    """Return a controller that calls the exported solver.

    Each solution starts from the previous one, shifted by one interval.

    Raises:
        CompilerMissing: there is no C compiler.
    """
    with tempfile.TemporaryDirectory() as folder:
        artefact = rs.ocp.export_problem(problem(), METHOD, f"{folder}/ocp", solver=True)
        library = rs.ocp.load_problem(artefact)
    names = [name for name, _, _ in library.labels["x"]]
    kept = {"w": library.defaults()[2], "lam": None}

    def control(state: dict[str, float]) -> float:
        found = library.solve([state[name] for name in names], kept["w"], kept["lam"])
        if found.code is not rs.ocp.Code.optimal:
            raise RuntimeError(f"no plan: {found.code.name}, violation {found.violation:.3g}")
        kept["w"], kept["lam"] = library.shift(found.w, found.lam)
        return float(found.u[0])

    return control


def controller_in_python() -> Controller:
    """Return a controller that calls `optimise`, which transcribes the problem every time."""

    def control(state: dict[str, float]) -> float:
        found = rs.ocp.optimise(problem(state), METHOD, fly=False)
        return found.inputs["push"](0.0)

    return control


def controller() -> tuple[Controller, str]:
    """Return the controller in C, or in Python without a compiler, and which one it is."""
    try:
        return controller_in_c(), "plans by the exported solver in C"
    except rs.CompilerMissing:
        return controller_in_python(), "no C compiler found: plans by Python, which take longer"


def close_the_loop(t_end: float = T_END, using: tuple[Controller, str] | None = None) -> Run:
    """Simulate the true plant with the gust by IDAS, with the push from a new plan in every step.

    Arguments:
        t_end: s.
        using: controller and its description; by default `controller()`.
    """
    control, said = using or controller()
    plant = rs.compile_scene(scene())
    state = {label.name: float(label.start) for label in plant.x_labels}
    times = STEP * np.arange(round(t_end / STEP))
    states = {name: [value] for name, value in state.items()}
    pushes, seconds = [], []
    # Measure, plan, apply the first interval of the plan, and repeat.
    for t in times:
        begun = time.perf_counter()
        pushes.append(control(state))
        seconds.append(time.perf_counter() - begun)
        moved = rs.simulate(
            plant,
            [t, t + STEP / 2, t + STEP],
            rs.Idas(1e-9, 1e-11),
            inputs={"push": pushes[-1], "gust": gust(t)},
            params={"stiffness": TRUE_STIFFNESS},
            start=state,
        )
        state = {name: float(moved[name][-1]) for name in state}
        for name, value in state.items():
            states[name].append(value)
    return Run(
        np.append(times, times[-1] + STEP),
        np.array(pushes),
        np.array(seconds),
        {name: np.array(values) for name, values in states.items()},
        said,
    )


def picture(run: Run) -> Any:
    """Plot where hub and load are, the forces, and how long the plans took."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.5, 7), layout="constrained")
    place, force, cost = figure.subplots(3, 1, sharex=True, height_ratios=(2, 1.2, 1.2))
    for name in ("hub.p_x", "tip.p_x"):
        (line,) = place.plot(run.t, run.states[name], label=f"{name.split('.')[0]}")
        place.axhline(GOAL[name], color=line.get_color(), lw=0.8, ls=":")
    place.set(
        ylabel="position [m]",
        title=f"Spring of {TRUE_STIFFNESS} N/m, planned for {STIFFNESS} N/m; dotted: the goal",
    )
    place.legend(frameon=False, loc="lower right")
    force.stairs(run.push, run.t, baseline=None, label="push, at most 1 N")
    blown = [gust(t) for t in run.t[:-1]]
    force.stairs(blown, run.t, baseline=None, color="tab:red", label="gust, not foreseen")
    force.set(ylabel="force [N]", ylim=(-1.15, 1.15))
    force.legend(frameon=False, loc="upper right")
    cost.semilogy(run.t[:-1], 1e3 * run.seconds, ".", ms=4)
    decades = np.log10(1e3 * run.seconds)
    cost.set_ylim(10 ** np.floor(decades.min()), 10 ** np.ceil(decades.max()))
    cost.set(ylabel="time of a plan [ms]", xlabel="t [s]", title=run.said)
    for panel in (place, force, cost):
        panel.grid(alpha=0.3)
    return figure


if __name__ == "__main__":
    run = close_the_loop()
    print(run.said)
    print(f"median time of a plan: {1e3 * np.median(run.seconds):.3g} ms")
    print(f"miss at the end: {max(abs(run.states[n][-1] - g) for n, g in GOAL.items()):.2g}")
    picture(run).savefig("generated/charts/receding_horizon.png", dpi=110)
