"""The hinge that flutters.

A body of 2 kg on a stiff, damped hinge, whose free axis is the local x, swings under gravity. With
`Standard` the stiff torques about y and z couple once the hinge has turned, since they act along
the axes of one side; two modes merge and one of them grows, at hundreds of 1/s: beyond 0.6 rad,
energy rises from a few joules to more than 1e4 J. The eigenvalues of the linearised model predict
it for every angle (for a body hinged at its centre, without damping: no growth at 10 degrees, 217/s
at 30, 612/s at 60). `compile_scene` warns of such a hinge. Remedy: rotate the joint frame so that
its z is the hinge axis, or `law=Consistent()`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    GROUND,
    ExplicitRK,
    Marker,
    Model,
    RigidBody,
    RigidBodySpringDamper,
    Scene,
    compile_scene,
    simulate,
)
from rbsd_sym.plots.style import COLOURS
from rbsd_sym.study import Table

from .law_scenes import (
    LAW_COLOURS,
    LAW_STYLES,
    LAWS,
    growth_rate,
    known_trouble,
    legend_below,
    panels,
    spectrum,
    state,
    turn_x,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 2
STIFFNESS = 1e3 * np.array([4000.0, 5000.0, 7000.0, 0.0, 500.0, 325.0])
# Principal inertias, kg m2.
INERTIA = np.array([0.1, 0.2, 0.3])
# Hinge relative to the centre of mass, m.
ARM = np.array([0.1, -0.2, 0.05])
# Initial angular velocity, rad/s.
SPIN = np.array([1.0, -2.0, 1.5])
# Damping over stiffness, s.
DAMPING = 1e-4
# Number of e-foldings over which growth is measured.
_GROWTHS = 14.0
# Initial spin that is to grow, rad/s.
_DISTURBANCE = 1e-9


def hinged(law: Any, damping: float = DAMPING, arm: Any = ARM, spin: Any = SPIN) -> Scene:
    """Return the body with its hinge at rest in the origin; gravity acts only if the body spins.

    Arguments:
        law: law of the hinge.
        damping: damping over stiffness, s.
        arm: hinge in body axes, m.
        spin: initial angular velocity, rad/s.
    """
    swinging = np.any(spin)
    body = RigidBody(
        "body",
        2.0,
        INERTIA,
        position=-np.array(arm),
        angular_velocity=spin,
        velocity=-np.cross(spin, arm),
    )
    hinge = RigidBodySpringDamper(
        "hinge", Marker(GROUND), Marker("body", arm), STIFFNESS, damping * STIFFNESS, law=law
    )
    gravity = (0, 0, -9.81) if swinging else (0, 0, 0)
    return Scene("hinged", [body], [hinge], gravity=gravity)


def closed_form(degrees: np.ndarray) -> np.ndarray:
    """Return the growth (1/s) of the undamped `Standard` hinge through the body's centre.

    Small rotations b, c about y and z beside the angle a about x obey Iy b'' = -ky cos(a) b - kz
    sin(a) c, Iz c'' = ky sin(a) b - kz cos(a) c.
    """
    (ky, kz), (Iy, Iz) = STIFFNESS[4:], INERTIA[1:]
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    A = np.array([[ky * c / Iy, kz * s / Iy], [-ky * s / Iz, kz * c / Iz]]).transpose(2, 0, 1)
    # Growth is the real part of the root of s^2, an eigenvalue of -A.
    squared = -np.linalg.eigvals(A).astype(complex)
    return np.abs(np.sqrt(squared).real).max(axis=1)


def posed(model: Model, degrees: float, arm: Any) -> np.ndarray:
    """Return the state in which the hinge has turned by `degrees`, at rest and unloaded."""
    half = np.deg2rad(degrees) / 2
    p = -turn_x(2 * half) @ arm
    return state(
        model,
        body__p_x=p[0],
        body__p_y=p[1],
        body__p_z=p[2],
        body__q_w=np.cos(half),
        body__q_x=np.sin(half),
    )


# Law, damping, arm.
_CASES: dict[str, tuple[str, float, Any]] = {
    "centre": ("Standard", 0.0, np.zeros(3)),
    "undamped": ("Standard", 0.0, ARM),
    "damped": ("Standard", DAMPING, ARM),
    "consistent": ("Consistent", DAMPING, ARM),
}


def study(full: bool) -> Tables:
    """Measure growth over the angle of the hinge, growth in simulations, and the swing itself."""
    angles = np.linspace(-90.0, 90.0, 73 if full else 25)
    rates: dict[str, list[float]] = {}
    measured: list[tuple[Any, ...]] = []
    for name, (law, damping, arm) in _CASES.items():
        with known_trouble():
            model = compile_scene(hinged(LAWS[law], damping, arm, (0, 0, 0)), minimal=False)
        spectra = [spectrum(model, posed(model, angle, arm)) for angle in angles]
        rates[name] = [float(values.real.max()) for values in spectra]
        if law == "Standard":
            measured += [(name, angle, *_measured(model, angle, arm)) for angle in (-60, 60)]
        if name == "centre":
            measured.append((name, 30.0, *_measured(model, 30.0, arm)))
    rows = zip(angles, closed_form(angles), *rates.values(), strict=True)
    return {
        "eigenvalues": Table(("angle", "closed_form", *rates), ("deg", *["1/s"] * 5), tuple(rows)),
        "growth": Table(
            ("hinge", "angle", "eigenvalue", "simulation"),
            ("", "deg", "1/s", "1/s"),
            tuple(measured),
        ),
        "swing": _swing(1.0 if full else 0.5),
    }


def _measured(model: Model, angle: float, arm: Any) -> tuple[float, float]:
    """Return the largest real part, and the growth (1/s) of a tiny spin about y in a simulation."""
    x = posed(model, angle, arm)
    rate = float(spectrum(model, x).real.max())
    start = dict(zip((label.name for label in model.x_labels), x, strict=True))
    start["body.w_y"] = _DISTURBANCE
    times = np.linspace(0.0, _GROWTHS / rate, 1201)
    run = simulate(model, times, ExplicitRK(1e-9, 1e-16), start=start)
    # Measured once the growing mode dominates the others.
    late = slice(300, None)
    return rate, growth_rate(times[late], run["body.w_y"][late])


def _swing(t_end: float) -> Table:
    times = np.linspace(0.0, t_end, 251)
    columns = [times]
    for law in ("Standard", "Consistent"):
        with known_trouble():
            model = compile_scene(hinged(LAWS[law]), minimal=False)
        run = simulate(model, times, ExplicitRK(1e-8, 1e-10))
        stored = run["body.kinetic_energy"] + run["hinge.potential_energy"]
        columns += [run["hinge.rotation"][:, 0], stored.reshape(-1)]
    names = ("angle_Standard", "energy_Standard", "angle_Consistent", "energy_Consistent")
    return Table(("t", *names), ("s", "rad", "J", "rad", "J"), tuple(zip(*columns, strict=True)))


def draw(tables: Tables) -> Figure:
    """Draw growth over the angle, then angle and energy of the swing."""
    figure, axes = panels((1.2, 1.0, 1.0))
    rates, growth, swing = (tables[name] for name in ("eigenvalues", "growth", "swing"))
    angle = rates.column("angle")
    lines = {
        "centre": ("k", "-", "Standard, hinged at the centre, undamped"),
        "undamped": (COLOURS[4], "--", "Standard, on an arm, undamped"),
        "damped": (LAW_COLOURS["Standard"], "-", "Standard, on an arm, damped"),
        "consistent": (LAW_COLOURS["Consistent"], "-.", "Consistent, on an arm, damped"),
    }
    for name, (colour, style, label) in lines.items():
        axes[0].plot(angle, rates.column(name), color=colour, ls=style, lw=1.8, label=label)
        mine = growth.column("hinge") == name
        axes[0].plot(
            growth.column("angle")[mine],
            growth.column("simulation")[mine],
            "o",
            color=colour,
            ms=7,
            mfc="none",
        )
    axes[0].plot([], [], "ko", ms=7, mfc="none", label="growth in a simulation")
    axes[0].set(xlabel="angle of the hinge [deg]", ylabel="growth [1/s]", xticks=range(-90, 91, 30))
    for law in ("Standard", "Consistent"):
        colour, style = LAW_COLOURS[law], LAW_STYLES[law]
        for panel, name in zip(axes[1:], ("angle", "energy"), strict=True):
            panel.plot(
                swing.column("t"), swing.column(f"{name}_{law}"), color=colour, ls=style, lw=1.6
            )
            panel.set(xlabel="time [s]")
    axes[1].set(ylabel="angle of the hinge [rad]")
    axes[2].set(ylabel="kinetic and strain energy [J]", yscale="log")
    legend_below(figure, axes[0], 3)
    return figure
