"""Energy and momentum that the law creates.

Two free bricks rotate against each other on one spring without damping (scene `pair`): energy is
constant and angular momentum remains zero. `Standard` and `Intrinsic` create both out of nothing,
since their wrenches have no potential and their moments do not balance; no integrator can repair
that. The resulting motion is chaotic as well: runs at two tolerances separate, and once they differ
by more than 1 % (the dotted line) the value is no longer a property of the scene, only its order of
magnitude is. Remedy: `law=Consistent()`, which keeps both to the tolerance.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    ExplicitRK,
    Marker,
    RigidBody,
    RigidBodySpringDamper,
    Scene,
    compile_scene,
    simulate,
)
from rbsd_sym.study import Table

from .law_scenes import LAW_COLOURS, LAWS, legend_below, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 1
TOLERANCES = (1e-8, 1e-10)
_PER_DECADE = 30
# Relative difference of energy from which on two runs count as different motions.
_APART = 0.01
# Of a solid brick of 20 kg and 1 x 0.1 x 0.2 m.
_INERTIA = (1 / 12, 20 * 1.04 / 12, 20 * 1.01 / 12)
_SPIN = np.array([8.5, 10.5, 16.0])


def pair(law: Any) -> Scene:
    """Return two bricks side by side on one undamped spring.

    They differ from those of `models/pair.py` by rounding in one moment of inertia, on which the
    numbers of this page depend where the motion is chaotic.
    """
    left = RigidBody("left", 20, _INERTIA, position=(0, 1, 0), angular_velocity=_SPIN)
    right = RigidBody("right", 20, _INERTIA, position=(1, 1, 0), angular_velocity=-_SPIN)
    spring = RigidBodySpringDamper(
        "spring",
        Marker("left", (0.5, 0, 0)),
        Marker("right", (-0.5, 0, 0)),
        (4000, 5000, 7000, 250, 500, 325),
        law=law,
    )
    return Scene("pair", [left, right], [spring])


def study(full: bool) -> Tables:
    """Measure energy and momentum over 10 s (100 s if full), at two tolerances."""
    decades = 3 if full else 2
    times = np.concatenate(
        [[0.0], np.geomspace(0.1, 10.0 ** (decades - 1), decades * _PER_DECADE + 1)]
    )
    curves: list[tuple[Any, ...]] = []
    numbers: list[tuple[Any, ...]] = []
    for name, law in LAWS.items():
        model = compile_scene(pair(law), minimal=False)
        runs = [simulate(model, times, ExplicitRK(r, r * 1e-2)) for r in TOLERANCES]
        energy = [run["energy"] / run["energy"][0] for run in runs]
        moment = [np.linalg.norm(run["angular_momentum"], axis=1) for run in runs]
        rows = list(zip(times, *energy, *moment, strict=True))
        curves += [(name, *row) for row in rows[1:]]
        parted = np.flatnonzero(np.abs(energy[0] / energy[1] - 1) > _APART)
        since = float(times[parted[0]]) if len(parted) else None
        numbers += [(name, *rows[1 + d * _PER_DECADE], since) for d in range(1, decades + 1)]
    columns = ("law", "t", "energy_loose", "energy_tight", "momentum_loose", "momentum_tight")
    units = ("", "s", "of the start", "of the start", "kg m2/s", "kg m2/s")
    return {
        "numbers": Table((*columns, "apart_from"), (*units, "s"), tuple(numbers)),
        "curves": Table(columns, units, tuple(curves)),
    }


def draw(tables: Tables) -> Figure:
    """Draw energy and momentum created over time; thin lines are the looser tolerance."""
    figure, axes = panels()
    curves, numbers = tables["curves"], tables["numbers"]
    for panel, quantity in zip(axes, ("energy", "momentum"), strict=True):
        for law, colour in LAW_COLOURS.items():
            mine = curves.column("law") == law
            t = curves.column("t")[mine]
            for run, style, rtol in (
                ("tight", {"lw": 2.0, "ls": "-"}, TOLERANCES[1]),
                ("loose", {"lw": 0.9, "ls": "--"}, TOLERANCES[0]),
            ):
                value = curves.column(f"{quantity}_{run}")[mine]
                made = np.abs(value - 1) if quantity == "energy" else value
                label = f"{law}, rtol {rtol:g}"
                panel.plot(t, made, color=colour, label=label, **style)
            since = numbers.column("apart_from")[numbers.column("law") == law][0]
            if np.isfinite(since):
                panel.axvline(since, color=colour, ls=":", lw=1.2)
        panel.plot([], [], "k:", lw=1.2, label="both runs part")
        panel.set(xscale="log", yscale="log", xlabel="time [s]")
    axes[0].set_ylabel("|energy made|, of that at the start")
    axes[1].set_ylabel("angular momentum made [kg m²/s]")
    legend_below(figure, axes[0], 4)
    return figure
