"""Bodies on one connector whose motion is known exactly, and the style of each method in charts."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from rbsd_sym import (
    GROUND,
    Marker,
    Model,
    Param,
    RigidBody,
    RigidBodySpringDamper,
    Scene,
    Trajectory,
    compile_scene,
    simulate,
)
from rbsd_sym.plots.style import COLOURS, MARKERS

# In the order of the work-precision charts, so that a method has one colour everywhere.
METHODS = ("Idas", "Rosenbrock", "ExplicitRK", "Dop853", "GeneralizedAlpha", "Collocation", "RK4")


@cache
def oscillator() -> Model:
    """Return 1 kg on a spring along x with Params `stiffness` (N/m) and `damping` (N s/m)."""
    k, d = Param("stiffness", 1.0, "N/m"), Param("damping", 0.0, "N s/m")
    mass = RigidBody("mass", 1, (1, 1, 1), position=(1, 0, 0))
    spring = RigidBodySpringDamper(
        "spring", Marker(GROUND), Marker("mass"), [k, 0, 0, 0, 0, 0], [d, 0, 0, 0, 0, 0]
    )
    return compile_scene(Scene("oscillator", [mass], [spring]))


def swing(
    integrator: Any,
    times: Sequence[float] | np.ndarray,
    k: float = 1.0,
    d: float = 0.0,
    x: float = 1.0,
    v: float = 0.0,
) -> Trajectory:
    """Simulate the oscillator, whatever the outcome.

    Arguments:
        integrator: the method.
        times: output times, s.
        k, d: stiffness (N/m) and damping (N s/m).
        x, v: start, m and m/s.
    """
    return simulate(
        oscillator(),
        times,
        integrator,
        params={"stiffness": k, "damping": d},
        start={"mass.p_x": x, "mass.v_x": v},
        throw=False,
    )


def amplitude(trajectory: Trajectory, k: float = 1.0) -> np.ndarray:
    """Return sqrt(x^2 + v^2 / k) over time (n,), m; it is constant for the exact motion."""
    return np.hypot(trajectory["mass.p_x"], trajectory["mass.v_x"] / np.sqrt(k))


def factor(integrator: Any, h: float) -> complex:
    """Return the factor by which a fixed step of h multiplies v + i x, for x'' = -x.

    The exact factor is exp(i h). It is defined for one-step methods, which act on an oscillation as
    on a complex number.
    """
    end = swing(integrator, [0.0, h], x=0.0, v=1.0)
    return complex(end["mass.v_x"][-1], end["mass.p_x"][-1])


def timed(run: Any, *arguments: Any, **named: Any) -> tuple[Any, float]:
    """Return the result of a function, and the CPU time of this thread (s) of its second call.

    The first call builds functions that are kept.
    """
    run(*arguments, **named)
    started = time.thread_time()
    result = run(*arguments, **named)
    return result, time.thread_time() - started


def style_of(method: str, **more: Any) -> dict[str, Any]:
    """Return colour and marker of a method, the same in every chart, with changes in `more`."""
    place = METHODS.index(method)
    return {"color": COLOURS[place], "marker": MARKERS[place], "ms": 5, "lw": 1.4} | more


def legend_below(panel: Any, columns: int = 2, drop: float = -0.2) -> None:
    """Put the legend below the axis, where it hides no data."""
    panel.legend(
        loc="upper center", bbox_to_anchor=(0.5, drop), ncols=columns, frameon=False, fontsize=8
    )
