"""Stiffness sweep: the same slow motion on ever stiffer joints.

An arm whirls at one turn per second about a joint of stiffness k, without damping; its path is
known for every k. Explicit methods take steps in proportion to sqrt(k) and run out of them; fixed
steps of `RK4` blow up. `Idas` follows the stiff vibration, which only rounding keeps alive, with
ever more steps, and stops where double precision leaves it no digits: the force of the joint is a
difference of positions, with an error of about k times 1e-16 m (grey). `Rosenbrock` gets further,
with more steps and less accuracy. Legendre collocation damps nothing, so that rounding stays in the
motion. `GeneralizedAlpha` and Radau take the same steps with the same error from 1e3 to 1e14 N/m.
Remedy: these two, or a joint no stiffer than its deflection requires.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    GROUND,
    RK4,
    Collocation,
    Dop853,
    ExplicitRK,
    GeneralizedAlpha,
    Idas,
    Marker,
    Model,
    Param,
    RigidBody,
    RigidBodySpringDamper,
    Rosenbrock,
    Scene,
    compile_scene,
    simulate,
)
from rbsd_sym.study import Table

from .oscillators import style_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 8
# Angular velocity of the arm, rad/s.
SPIN = 2 * math.pi
# Length of a run, s: two turns.
_END = 2.0
_RTOL, _ATOL = 1e-6, 1e-8
# Fixed steps of methods with one and with three stages, s.
_SHORT, _LONG = 1e-3, 1e-2
_EPSILON = float(np.finfo(float).eps)
# CPU time, s: shorter runs are timed again, without what is built only once.
_AGAIN = 0.5
_STYLES: dict[str, dict[str, Any]] = {
    "Idas": style_of("Idas"),
    "Idas, max_order 2": style_of("Idas", ls="--"),
    "Rosenbrock": style_of("Rosenbrock"),
    "ExplicitRK": style_of("ExplicitRK"),
    "Dop853": style_of("Dop853"),
    "GeneralizedAlpha, radius 0.9": style_of("GeneralizedAlpha"),
    "Radau, order 5": style_of("Collocation"),
    "Legendre, order 6": style_of("Collocation", ls="--"),
    "RK4": style_of("RK4"),
}


@cache
def whirl() -> Model:
    """Return 1 kg on an arm of 1 m about a joint, in a plane; Param `stiffness` (N/m).

    The account of the reduction is removed: at 1e9 N/m rounding makes its zero eigenvalues resemble
    growth.
    """
    k = Param("stiffness", 1e6, "N/m")
    arm = RigidBody(
        "arm",
        1,
        (0.1, 0.1, 0.1),
        position=(1, 0, 0),
        velocity=(0, SPIN, 0),
        angular_velocity=(0, 0, SPIN),
    )
    joint = RigidBodySpringDamper(
        "joint", Marker(GROUND), Marker("arm", (-1, 0, 0)), [k, k, k, 0, 0, 0]
    )
    return replace(compile_scene(Scene("whirl", [arm], [joint])), reduction=None)


def radius(k: float) -> float:
    """Return the radius (m) at which the force k (r - 1 m) of the joint is the centripetal one."""
    # k (r - 1) = w^2 r for 1 kg.
    return 1 + SPIN**2 / (k - SPIN**2)


def _methods(full: bool) -> Mapping[str, Any]:
    budget = 10 if full else 1
    # In each of the 20 output intervals.
    limit: dict[str, Any] = {"max_steps": 1_000 * budget}
    return {
        "Idas": Idas(_RTOL, _ATOL, **limit),
        "Idas, max_order 2": Idas(_RTOL, _ATOL, max_order=2, **limit),
        "Rosenbrock": Rosenbrock(_RTOL, _ATOL, **limit),
        "ExplicitRK": ExplicitRK(_RTOL, _ATOL, **limit),
        "Dop853": Dop853(_RTOL, _ATOL, max_steps=2_000 * budget),
        "GeneralizedAlpha, radius 0.9": GeneralizedAlpha(_SHORT, 0.9),
        "Radau, order 5": Collocation(_LONG, 3, "radau"),
        "Legendre, order 6": Collocation(_LONG, 3, "legendre"),
        "RK4": RK4(_SHORT),
    }


def study(full: bool) -> dict[str, Table]:
    """Measure error, steps and CPU time of each method over stiffness."""
    stiffnesses = np.logspace(3, 14, 12) if full else np.array([1e3, 1e6, 1e9, 1e14])
    rows = [
        (name, float(k), *_run(method, float(k), 2 if full else 1))
        for k in stiffnesses
        for name, method in _methods(full).items()
    ]
    return {
        "sweep": Table(
            ("method", "stiffness", "error", "steps", "time", "outcome"),
            ("", "N/m", "m", "", "s", ""),
            tuple(rows),
        )
    }


def _run(method: Any, k: float, repeats: int) -> tuple[float | None, float, float, str]:
    """Return the largest error of the position (m), steps, CPU time (s) and outcome."""
    r, times = radius(k), np.linspace(0.0, _END, 21)
    given: dict[str, Any] = {
        "params": {"stiffness": k},
        "start": {"arm.p_x": r, "arm.v_y": SPIN * r},
        "throw": False,
    }
    seconds = math.inf
    for _ in range(repeats):
        started = time.thread_time()
        run = simulate(whirl(), times, method, **given)
        took = time.thread_time() - started
        seconds = min(seconds, took)
        if took > _AGAIN:
            break
    error = None
    if run.outcome.ok:
        exact = r * np.array([np.cos(SPIN * times), np.sin(SPIN * times)]).T
        error = float(np.abs(run["arm.position"][:, :2] - exact).max())
    fixed = _END / method.step if hasattr(method, "step") else 0.0
    return error, float(run.stats.get("steps", fixed)), seconds, run.outcome.name


def draw(tables: Tables) -> Figure:
    """Draw error, steps and time over stiffness; failed runs are crosses."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 5.2), layout="constrained")
    panels: Any = figure.subplots(1, 3)
    table = tables["sweep"]
    for name, style in _STYLES.items():
        mine = table.column("method") == name
        k, error = table.column("stiffness")[mine], table.column("error")[mine]
        good = np.isfinite(error)
        panels[0].plot(k[good], error[good], **style, label=name)
        for panel, column in ((panels[1], "steps"), (panels[2], "time")):
            values = table.column(column)[mine]
            panel.plot(k[good], values[good], **style)
        for panel in panels:
            panel.plot(
                k[~good],
                np.full((~good).sum(), 0.97 - 0.03 * list(_STYLES).index(name)),
                "x",
                color=style["color"],
                transform=panel.get_xaxis_transform(),
                ms=5,
            )
    k = np.logspace(3, 14.3, 20)
    panels[0].plot(
        k,
        k * _EPSILON / SPIN**2,
        color="0.6",
        lw=3,
        zorder=0,
        label="rounding of the joint's force / force",
    )
    panels[0].plot([], [], "x", color="0.3", label="failed (top of each panel)")
    for panel, label, low, high in zip(
        panels,
        ("largest error of the position [m]", "steps", "CPU time [s]"),
        (1e-13, 1e1, 1e-3),
        (1e5, 1e7, 1e3),
        strict=True,
    ):
        panel.set(
            xscale="log",
            yscale="log",
            xlabel="stiffness of the joint [N/m]",
            ylabel=label,
            ylim=(low, high),
            xlim=(5e2, 3e14),
        )
        panel.grid(alpha=0.3)
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=4,
        frameon=False,
        fontsize=9,
    )
    return figure
