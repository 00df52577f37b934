"""Circulatory forces and negative damping.

A mass on a plane spring whose stiffness is not symmetric, K = [[k, g], [-g, k]]: the part g turns a
displacement into a force across it, as the oil film of a bearing does, and feeds whirling. Without
a damper every g makes the motion grow, at about g / (2 sqrt(k m)); a damper c prevents this as long
as g < c sqrt(k/m). Negative damping makes it grow at -c / (2 m). Eigenvalues of the linearised
model predict both before any simulation. Remedy: `model.notes` points out such terms, and
`Consistent` refuses a stiffness that is not symmetric; where they are intended, check the
eigenvalues.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    GROUND,
    ExplicitRK,
    Marker,
    Model,
    Param,
    RigidBody,
    RigidBodySpringDamper,
    Scene,
    compile_scene,
    simulate,
)
from rbsd_sym.plots.style import COLOURS
from rbsd_sym.study import Table

from .law_scenes import growth_rate, legend_below, panels, spectrum_with

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 9
# kg, N/m, N s/m.
MASS, STIFFNESS, DAMPING = 1.0, 100.0, 2.0
# Circulatory stiffness that the damper just stabilises, N/m.
CRITICAL = DAMPING * np.sqrt(STIFFNESS / MASS)
# Initial displacement, m.
_DISTURBANCE = 1e-6
_BISECTIONS = 50


def whirling(g: Any, c: Any) -> Scene:
    """Return the mass on its plane spring; g (N/m) and c (N s/m) are numbers or Params."""
    stiffness = np.array(np.diag([STIFFNESS] * 3 + [0.0] * 3), object)
    stiffness[0, 1], stiffness[1, 0] = g, -g
    damping = np.array(np.zeros((6, 6)), object)
    damping[0, 0] = damping[1, 1] = c
    damping[2, 2] = DAMPING
    mass = RigidBody("mass", MASS, (1, 1, 1), position=(_DISTURBANCE, 0, 0))
    spring = RigidBodySpringDamper("spring", Marker(GROUND), Marker("mass"), stiffness, damping)
    return Scene("whirling", [mass], [spring])


def closed_form(g: float, c: float) -> float:
    """Return the growth (1/s): the largest real part of the roots of m s^2 + c s + k + i g."""
    # x + i y turns the two equations with K = [[k, g], [-g, k]] into one with a complex stiffness.
    return float(np.roots([MASS, c, STIFFNESS + 1j * g]).real.max())


def eigenvalue(model: Model, g: float, c: float) -> float:
    """Return the growth (1/s) of the linearised model."""
    return float(spectrum_with(model, {"g": g, "c": c}).real.max())


def measured(model: Model, g: float, c: float) -> float:
    """Return the growth (1/s) of x + i y in a simulation of 4 s, with whirls of both senses."""
    times = np.linspace(0.0, 4.0, 101)
    run = simulate(model, times, ExplicitRK(1e-10, 1e-16), params={"g": g, "c": c})
    return growth_rate(times, run["mass.p_x"] + 1j * run["mass.p_y"])


def study(full: bool) -> Tables:
    """Measure growth over g with and without damper, over c, and the boundary between."""
    model = compile_scene(whirling(Param("g", CRITICAL, "N/m"), Param("c", DAMPING, "N s/m")))
    n = 41 if full else 9
    cases = [("no damper", g, 0.0) for g in np.linspace(0, 40, n)]
    cases += [("with damper", g, DAMPING) for g in np.linspace(0, 40, n)]
    cases += [("negative damping", 0.0, c) for c in np.linspace(-2, 2, n)]
    rows = []
    for i, (name, g, c) in enumerate(cases):
        seen = measured(model, g, c) if i % n % max(1, n // 10) == 0 else None
        rows.append((name, g, c, closed_form(g, c), eigenvalue(model, g, c), seen))
    dampers = np.linspace(0.25, 4.0, 16 if full else 4)
    edges = [(c, c * np.sqrt(STIFFNESS / MASS), _boundary(model, c)) for c in dampers]
    units = ("", "N/m", "N s/m", "1/s", "1/s", "1/s")
    return {
        "growth": Table(
            ("case", "g", "c", "closed_form", "eigenvalue", "simulation"), units, tuple(rows)
        ),
        "boundary": Table(
            ("c", "closed_form", "eigenvalue"), ("N s/m", "N/m", "N/m"), tuple(edges)
        ),
    }


def _boundary(model: Model, c: float) -> float:
    """Return the g (N/m) at which the linearised model begins to grow, by bisection."""
    low, high = 0.0, 10 * c * np.sqrt(STIFFNESS / MASS)
    # Fifty halvings leave 1e-15 of the bracket.
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        low, high = (low, middle) if eigenvalue(model, middle, c) > 0 else (middle, high)
    return (low + high) / 2


def draw(tables: Tables) -> Figure:
    """Draw growth over g, growth over c, and the boundary in the plane of both."""
    figure, axes = panels((1.0, 1.0, 1.0))
    growth, boundary = tables["growth"], tables["boundary"]
    styles = {
        "no damper": (0, "g", COLOURS[1], "-"),
        "with damper": (0, "g", COLOURS[0], "-"),
        "negative damping": (1, "c", COLOURS[2], "-"),
    }
    for case, (at, axis, colour, style) in styles.items():
        mine = growth.column("case") == case
        x = growth.column(axis)[mine]
        values = {
            name: growth.column(name)[mine] for name in ("closed_form", "eigenvalue", "simulation")
        }
        axes[at].plot(x, values["closed_form"], color=colour, ls=style, lw=1.6)
        axes[at].plot(x, values["eigenvalue"], ".", color=colour, ms=6)
        axes[at].plot(x, values["simulation"], "o", color=colour, ms=9, mfc="none")
        axes[0].plot([], [], color=colour, lw=1.6, label=case)
    for style, label in (("k-", "closed form"), ("k.", "eigenvalue"), ("ko", "simulation")):
        axes[0].plot([], [], style, mfc="none" if style == "ko" else "k", label=label)
    for panel in axes[:2]:
        panel.axhline(0, color="0.4", lw=0.8)
    axes[0].set(xlabel="circulatory stiffness g [N/m]", ylabel="growth [1/s]")
    axes[1].set(xlabel="damping c [N s/m]", ylabel="growth [1/s]")
    c, edge = boundary.column("c"), boundary.column("closed_form")
    axes[2].plot(c, edge, "k-")
    axes[2].plot(c, boundary.column("eigenvalue"), "k.", ms=6)
    axes[2].fill_between(c, edge, edge.max(), color=COLOURS[1], alpha=0.25, lw=0)
    axes[2].text(0.3, 0.8, "whirls", transform=axes[2].transAxes, ha="center")
    axes[2].text(0.75, 0.2, "dies out", transform=axes[2].transAxes, ha="center")
    axes[2].set(xlabel="damping c [N s/m]", ylabel="circulatory stiffness g [N/m]")
    legend_below(figure, axes[0], 6)
    return figure
