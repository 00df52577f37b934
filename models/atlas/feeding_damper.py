"""A damper that feeds energy.

Two bodies 1 m apart rotate together, like one rigid body, about their common centre at 2 rad/s; a
translational damper (100 N s/m, no spring) joins them. Their relative pose does not change, so a
damper should do nothing. `Intrinsic` opposes the difference of two velocities in the middle frame,
and adds torques for the moment of its force that do more work than the force dissipates: energy
rises from 1.2 J to 1.345 J in 1 ms. `Standard` does not feed energy; it brakes the rotation itself,
and loses angular momentum. Remedy: `law=Consistent()`, whose damper acts on the rate of the strain.
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

from .law_scenes import LAW_COLOURS, LAW_STYLES, LAWS, legend_below, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 3
# kg, kg m2, N s/m, rad/s, m.
MASS, INERTIA, DAMPING, SPIN, ARM = 1.0, 0.05, 100.0, 2.0, 0.05
_TIMES = np.linspace(0.0, 0.02, 101)


def turning_pair(law: Any) -> Scene:
    """Return the two bodies; the ends of the damper are 0.05 m from their centres."""
    bodies = [
        RigidBody(
            name,
            MASS,
            [INERTIA] * 3,
            position=(x, 0, 0),
            velocity=(0, SPIN * x, 0),
            angular_velocity=(0, 0, SPIN),
        )
        for name, x in (("left", -0.5), ("right", 0.5))
    ]
    damper = RigidBodySpringDamper(
        "damper",
        Marker("left", (ARM, 0, 0)),
        Marker("right", (-ARM, 0, 0)),
        0,
        [DAMPING] * 3 + [0.0] * 3,
        law=law,
    )
    return Scene("turning_pair", bodies, [damper])


def closed_form(t: np.ndarray) -> np.ndarray:
    """Return the energy with `Intrinsic` (J), while the damper rotates little against the frames.

    With the slip u between the ends and the spin w, m u'/2 and I w' follow from the force D u. So u
    decays at the rate a = D (2/m + b/I), b the arm, and E = E0 + (D S)^2 (1/m + 1/(4 I)), S the
    integral of u.
    """
    rate = DAMPING * (2 / MASS + ARM / INERTIA)
    slipped = SPIN * (1 - 2 * ARM) * -np.expm1(-rate * t) / rate
    start = SPIN**2 * (MASS / 4 + INERTIA)
    return start + (DAMPING * slipped) ** 2 * (1 / MASS + 1 / (4 * INERTIA))


def study(full: bool) -> Tables:
    """Measure energy and angular momentum over 20 ms."""
    # The study takes seconds in either case.
    del full
    energy, moment = {}, {}
    for name, law in LAWS.items():
        model = compile_scene(turning_pair(law), minimal=False)
        run = simulate(model, _TIMES, ExplicitRK(1e-11, 1e-13))
        energy[name], moment[name] = run["energy"], run["angular_momentum"][:, 2]
    columns = (*(f"energy_{n}" for n in LAWS), "closed_form", *(f"momentum_{n}" for n in LAWS))
    values = zip(_TIMES, *energy.values(), closed_form(_TIMES), *moment.values(), strict=True)
    units = ("s", "J", "J", "J", "J", *["kg m2/s"] * 3)
    return {"motion": Table(("t", *columns), units, tuple(values))}


def draw(tables: Tables) -> Figure:
    """Draw energy and angular momentum over time."""
    figure, axes = panels()
    motion = tables["motion"]
    t = 1e3 * motion.column("t")
    early = t <= 10
    for panel, quantity in zip(axes, ("energy", "momentum"), strict=True):
        for law, colour in LAW_COLOURS.items():
            panel.plot(
                t,
                motion.column(f"{quantity}_{law}"),
                color=colour,
                ls=LAW_STYLES[law],
                lw=2,
                label=law,
            )
        panel.set(xlabel="time [ms]")
    axes[0].plot(
        t[early][::5],
        motion.column("closed_form")[early][::5],
        "k+",
        ms=7,
        label="Intrinsic, closed form",
    )
    axes[0].set_ylabel("energy [J]")
    axes[1].set_ylabel("angular momentum [kg m²/s]")
    axes[1].set_ylim(bottom=0)
    legend_below(figure, axes[0], 4)
    return figure
