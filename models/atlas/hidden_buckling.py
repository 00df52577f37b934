"""Buckling that the minimal model hides.

An upright bar stands on a hinge that resists tilting by a spring k. Nothing disturbs it, so its
motion contains no tilt: the minimal model keeps only the height, two states, and stays upright for
any k. Below k = m g l the bar buckles. The full model stays upright as well if it starts at rest;
only a disturbance makes it fall, at the rate sqrt((m g l - k) / (I + m l^2)). `simulate` checks the
motion that was left out along the run, warns, and returns `Outcome.unstable_across_reduction` with
the same rate. Remedy: `compile_scene(minimal=False)` and a disturbed start, or a stiffer hinge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    GROUND,
    Consistent,
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
from rbsd_sym.plots.style import COLOURS
from rbsd_sym.study import Table

from .law_scenes import growth_rate, known_trouble, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 10
# kg, m from the hinge to the centre, kg m2, m/s2, N/m.
MASS, LENGTH, INERTIA, GRAVITY, SUPPORT = 1.0, 0.5, 0.08, 9.81, 1e6
# N s/m; it makes the support's own vibration decay.
_SUPPORT_DAMPING = 1e3
# Stiffness at which the bar buckles, N m/rad.
CRITICAL = MASS * GRAVITY * LENGTH
# Height of the centre, with the support compressed by the weight.
_AT_REST = LENGTH - MASS * GRAVITY / SUPPORT
# A small rotation about the hinge, rad/s and m/s.
_PUSH = {"bar.w_y": 1e-6, "bar.v_x": 1e-6 * LENGTH}
_METHOD = Rosenbrock(1e-8, 1e-13)


def column(k: Any) -> Scene:
    """Return the bar on its hinge of tilting stiffness k (N m/rad, a number or a Param)."""
    bar = RigidBody("bar", MASS, (INERTIA, INERTIA, 0.01), position=(0, 0, LENGTH))
    hinge = RigidBodySpringDamper(
        "hinge",
        Marker(GROUND),
        Marker("bar", (0, 0, -LENGTH)),
        [SUPPORT] * 3 + [k, k, 1.0],
        [_SUPPORT_DAMPING] * 3 + [0.0] * 3,
        law=Consistent(),
    )
    return Scene("column", [bar], [hinge], gravity=(0, 0, -GRAVITY))


def closed_form(k: np.ndarray) -> np.ndarray:
    """Return the growth of the tilt (1/s) on a rigid support, 0 where the bar stays upright."""
    return np.sqrt(np.maximum(CRITICAL - k, 0) / (INERTIA + MASS * LENGTH**2))


def study(full: bool) -> Tables:
    """Measure growth over k by the check, the full model and the closed form; and one fall."""
    k = Param("k", 1.0, "N m/rad")
    small, whole = compile_scene(column(k)), compile_scene(column(k), minimal=False)
    rows = [_row(small, whole, float(value)) for value in np.linspace(0.5, 8.0, 31 if full else 7)]
    columns = ("k", "closed_form", "outcome", "check", "simulation", "undisturbed")
    units = ("N m/rad", "1/s", "", "1/s", "1/s", "rad")
    return {"growth": Table(columns, units, tuple(rows)), "fall": _fall(small, whole)}


def _row(small: Model, whole: Model, k: float) -> tuple[Any, ...]:
    """Return what the minimal model's check finds, growth in the full model, tilt without push."""
    start = {"bar.p_z": _AT_REST}
    with known_trouble():
        run = simulate(small, np.linspace(0.0, 4.0, 101), _METHOD, params={"k": k}, start=start)
    times = np.linspace(0.0, 3.0, 101)
    still = simulate(whole, times, _METHOD, params={"k": k}, start=start)
    pushed = simulate(whole, times, _METHOD, params={"k": k}, start=start | _PUSH)
    grown = growth_rate(times, pushed["bar.w_y"])
    tilt = float(np.abs(still["hinge.rotation"]).max())
    rate = small.transverse_growth(run).rate
    return k, float(closed_form(np.array(k))), run.outcome.name, rate, grown, tilt


def _fall(small: Model, whole: Model) -> Table:
    """Return tilts at k = 1 N m/rad: minimal model, full model at rest, and pushed."""
    times, start = np.linspace(0.0, 8.0, 201), {"bar.p_z": _AT_REST}
    pushed = start | _PUSH
    with known_trouble():
        runs = [
            simulate(model, times, _METHOD, start=given)
            for model, given in ((small, start), (whole, start), (whole, pushed))
        ]
    tilts = [np.abs(run["hinge.rotation"][:, 1]) for run in runs]
    columns = ("t", "minimal", "full", "full_pushed")
    return Table(columns, ("s", "rad", "rad", "rad"), tuple(zip(times, *tilts, strict=True)))


def draw(tables: Tables) -> Figure:
    """Draw growth over the spring, and the tilt over time."""
    figure, axes = panels()
    growth, fall = tables["growth"], tables["fall"]
    k = np.linspace(0.0, float(growth.column("k").max()), 400)
    axes[0].plot(k, closed_form(k), "k-", lw=1.2, label="closed form")
    axes[0].plot(
        *(growth.column(c) for c in ("k", "check")),
        "o",
        color=COLOURS[0],
        ms=8,
        mfc="none",
        label="check of the minimal model",
    )
    axes[0].plot(
        *(growth.column(c) for c in ("k", "simulation")),
        "+",
        color=COLOURS[1],
        ms=9,
        mew=1.8,
        label="full model, pushed",
    )
    axes[0].axvline(CRITICAL, color="0.4", ls=":")
    axes[0].set(xlabel="tilting stiffness k [N m/rad]", ylabel="growth of the tilt [1/s]")
    t = fall.column("t")
    axes[1].plot(
        t,
        fall.column("full_pushed"),
        color=COLOURS[1],
        lw=1.8,
        label="full model, pushed by 1e-6 rad/s",
    )
    axes[1].plot(t, fall.column("full"), color=COLOURS[2], lw=4, label="full model, at rest")
    axes[1].plot(t, fall.column("minimal"), "k--", label="minimal model")
    axes[1].set_yscale("symlog", linthresh=1e-7)
    axes[1].set(xlabel="time [s], at k = 1 N m/rad", ylabel="tilt [rad]")
    axes[1].set_yticks([0, 1e-6, 1e-4, 1e-2, 1], ["0", "1e-6", "1e-4", "0.01", "1"])
    axes[1].minorticks_off()
    for panel in axes:
        panel.legend(
            loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=8
        )
    return figure
