"""Angles with limits: pitch at 90 degrees, rotation at 180.

`Standard` measures the relative rotation by Tait-Bryan xyz angles. When the pitch passes 90
degrees, roll and yaw jump by 180 degrees, and the torque jumps with them: a motion straight through
stops the integrator, one that passes close by takes thousands of steps, and energy is created.
Bodies in `TaitBryan` coordinates take several times as many steps there under any law, and cannot
start there at all if they spin; quaternions with `Consistent` pass without any effect. All laws
jump at 180 degrees: a spring wound up to there lets go and pulls from the other side. Energy is
conserved if the spring is relaxed at zero, but an offset near 180 degrees creates 2 pi k offset (J)
at each passage. Remedy: rotate the joint frames so that the spring is relaxed at zero, instead of
using an offset. `study.domain` reports which connector came to its limit, when, and how close.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    GROUND,
    Consistent,
    ExplicitRK,
    Marker,
    Model,
    Quaternion,
    RigidBody,
    RigidBodySpringDamper,
    Scene,
    Standard,
    TaitBryan,
    compile_scene,
    simulate,
)
from rbsd_sym.plots.style import COLOURS
from rbsd_sym.study import Table
from rbsd_sym.study.domain import domain

from .law_scenes import LAW_COLOURS, LAW_STYLES, LAWS, state, turn_x

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 4
# Most steps in one output interval.
MOST_STEPS = 10_000
# Offset close to half a turn, rad.
OFFSET = 3.1
# Angle between the axis of the turn and y, rad: a turn about y itself is a special case.
_TILT = 0.01
_EYE = np.eye(3)
# 90 degrees about y: at this relative rotation the xyz angles are singular.
_UP = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
# Law of the connector and coordinates of the body.
_VARIANTS: dict[str, tuple[Any, Any]] = {
    "Standard, quaternion": (Standard(), Quaternion()),
    "Consistent, Tait-Bryan": (Consistent(), TaitBryan()),
    "Consistent, quaternion": (Consistent(), Quaternion()),
}
_METHOD = ExplicitRK(1e-8, 1e-10, max_steps=MOST_STEPS)


def spun(
    law: Any, spin: Any = (0, 0, 0), offset: float = 0.0, frame: Any = _EYE, start: Any = _EYE
) -> Scene:
    """Return a body of inertia 1 kg m2 on a torsion spring of 1 N m/rad.

    Arguments:
        law: law of the spring.
        spin: initial angular velocity, rad/s.
        offset: offset of the spring about x, rad.
        frame, start: rotation of the joint frame, and of the body at the start (3, 3).
    """
    body = RigidBody("body", 1.0, (1, 1, 1), angular_velocity=spin, rotation=start)
    spring = RigidBodySpringDamper(
        "spring",
        Marker(GROUND),
        Marker("body"),
        (0, 0, 0, 1, 1, 1),
        offset=(0, 0, 0, offset, 0, 0),
        law=law,
        rotation_marker0=frame,
    )
    return Scene("spun", [body], [spring])


def study(full: bool) -> Tables:
    """Measure the torque over a turn, passages of the pitch, of pi, and of an offset near pi."""
    misses = [0.0, *np.logspace(-8, -1, 15 if full else 3)]
    passages = []
    for name, (law, formulation) in _VARIANTS.items():
        standing = spun(law, (0.1, 0.2, 0), frame=_UP, start=_UP)
        passages.append((name, None, *_passage(compile_scene(standing, formulation, False))))
        model = compile_scene(spun(law, (0, 2, 0)), formulation, minimal=False)
        passages += [(name, miss, *_passage(model, miss)) for miss in misses]
    wraps, wrapped = _wraps()
    motions, energies, near = _offsets(12.0 if full else 8.0)
    reports = zip(
        ("wrap at 180 deg", "near 180 deg", "through 180 deg"), (wrapped, *near), strict=True
    )
    return {
        "torque": _torque(),
        "passages": Table(
            ("way", "miss", "outcome", "t", "steps", "energy", "told"),
            ("", "rad/s", "", "s", "", "of the start", ""),
            tuple(passages),
        ),
        "wrap": wraps,
        "offset": motions,
        "energies": energies,
        "domain": Table(
            ("motion", *wrapped.columns),
            ("", *wrapped.units),
            tuple((motion, *row) for motion, table in reports for row in table.rows),
        ),
    }


def _torque() -> Table:
    """Return the size of the torque over a turn about an axis close to y, for two laws."""
    axis = np.array([np.sin(_TILT), np.cos(_TILT), 0.0])
    degrees = np.arange(0.0, 270.5, 2.5)
    columns = [degrees]
    for law in ("Standard", "Consistent"):
        model = compile_scene(spun(LAWS[law]), minimal=False)
        torque = model.function("spring.torque_local")
        half = np.deg2rad(degrees) / 2
        states = np.tile(state(model)[:, None], len(half))
        rows = [[v.name for v in model.x_labels].index(f"body.q_{k}") for k in "wxyz"]
        states[rows] = np.vstack([np.cos(half), axis[:, None] * np.sin(half)])
        columns.append(np.linalg.norm(np.array(torque(0, states, [], [], [])), axis=0))
    units = ("deg", "N m", "N m")
    return Table(("angle", "Standard", "Consistent"), units, tuple(zip(*columns, strict=True)))


def _passage(model: Model, miss: float = 0.0) -> tuple[Any, ...]:
    """Return how a run through a relative pitch of 90 degrees ends, and what `domain` reports."""
    times, start = np.linspace(0.0, 2.0, 41), {"body.w_z": miss}
    run = simulate(model, times, _METHOD, start=start, throw=False)
    energy = float(run["energy"][-1] / run["energy"][0])
    reports = [
        f"{row[0]}: {row[1]} {row[3]:.1f} deg at {row[4]:.2f} s"
        for row in domain(model, run, 10.0).rows
    ]
    steps = run.stats["steps"]
    return run.outcome.name, float(run.t[-1]), steps, energy, "; ".join(reports)


def _wraps() -> tuple[Table, Table]:
    """Return motions of a spring wound past pi by 4 rad/s, and of one that counts turns."""
    times = np.linspace(0.0, 3.5, 141)
    angles, spins = [], []
    for law in LAWS.values():
        model = compile_scene(spun(law, (4, 0, 0)), minimal=False)
        run = simulate(model, times, _METHOD)
        angles.append(run["spring.rotation"][:, 0])
        spins.append(run["body.w_x"])
    report = domain(model, run)
    rows = zip(times, *angles, *spins, 4 * np.sin(times), 4 * np.cos(times), strict=True)
    columns = (*(f"angle_{n}" for n in LAWS), *(f"spin_{n}" for n in LAWS))
    units = ("s", *["rad"] * 3, *["rad/s"] * 3, "rad", "rad/s")
    table = Table(("t", *columns, "angle_counted", "spin_counted"), units, tuple(rows))
    return table, report


def _offsets(t_end: float) -> tuple[Table, Table, list[Table]]:
    """Return motions of a spring with an offset of 3.1 rad after a small and a larger push."""
    times = np.linspace(0.0, t_end, 241)
    cases = {
        "small": (0.03, OFFSET, _EYE),
        "large": (0.05, OFFSET, _EYE),
        "turned_frame": (0.05, 0.0, turn_x(OFFSET)),
    }
    spins, energies, reports = [], [], []
    for name, (push, offset, frame) in cases.items():
        scene = spun(Consistent(), (push, 0, 0), offset, frame, turn_x(OFFSET))
        model = compile_scene(scene, minimal=False)
        run = simulate(model, times, _METHOD)
        spins.append(run["body.w_x"])
        energies.append((name, push, float(run["energy"][0]), float(run["energy"].max())))
        reports.append(domain(model, run))
    motions = Table(("t", *cases), ("s", *["rad/s"] * 3), tuple(zip(times, *spins, strict=True)))
    columns = ("case", "push", "energy_start", "energy_largest")
    return motions, Table(columns, ("", "rad/s", "J", "J"), tuple(energies)), reports[:2]


def draw(tables: Tables) -> Figure:
    """Draw torque over the turn, steps over the miss, the passage of pi, and the offset near pi."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 7.6), layout="constrained")
    (torque, steps), (wrap, offset) = figure.subplots(2, 2)
    for panel in (torque, steps, wrap, offset):
        panel.grid(alpha=0.3)
    for law in ("Standard", "Consistent"):
        torque.plot(
            *(tables["torque"].column(c) for c in ("angle", law)),
            label=law,
            lw=2,
            color=LAW_COLOURS[law],
            ls=LAW_STYLES[law],
        )
    torque.set(
        xlabel="turn about an axis close to y [deg]",
        ylabel="size of the torque [N m]",
        xticks=range(0, 271, 45),
    )
    _draw_passages(steps, tables["passages"])
    t = tables["wrap"].column("t")
    wrap.plot(
        t,
        tables["wrap"].column("spin_Consistent"),
        color=LAW_COLOURS["Consistent"],
        lw=2,
        label="all three laws",
    )
    wrap.plot(
        t, tables["wrap"].column("spin_counted"), "k--", lw=1.4, label="a spring that counts turns"
    )
    wrap.axvline(0.9033391107665128, color="0.4", ls=":", label="angle is 180 deg")
    wrap.set(xlabel="time [s]", ylabel="spin of a spring wound past 180 deg [rad/s]")
    t = tables["offset"].column("t")
    for case, colour, style, label in (
        ("large", COLOURS[4], "-", "0.05 rad/s, offset"),
        ("small", "k", "--", "0.03 rad/s, offset"),
        ("turned_frame", COLOURS[5], "-.", "0.05 rad/s, turned frame"),
    ):
        offset.plot(t, tables["offset"].column(case), color=colour, ls=style, lw=1.8, label=label)
    offset.set(xlabel="time [s]", ylabel="spin of a spring at rest at 3.1 rad [rad/s]")
    for panel in (torque, steps, wrap, offset):
        panel.legend(
            loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=8
        )
    return figure


def _draw_passages(panel: Any, passages: Table) -> None:
    """Draw steps over the miss of the axis (at least 10 are drawn); crosses are stopped runs."""
    colours = (LAW_COLOURS["Standard"], COLOURS[6], LAW_COLOURS["Consistent"])
    for (way, marker), colour in zip(zip(_VARIANTS, "os^", strict=True), colours, strict=True):
        mine = passages.column("way") == way
        # A logarithmic axis has no zero: a miss of 0 is drawn at 1e-9, a start at 90 deg at 1e-10.
        miss = np.maximum(passages.column("miss")[mine], 1e-9)
        miss[np.isnan(miss)] = 1e-10
        steps = np.maximum(passages.column("steps")[mine], 10)
        good = passages.column("outcome")[mine] == "reached_end"
        line = good & (miss > 1e-10)
        panel.plot(miss[line], steps[line], marker=marker, color=colour, ms=5, label=way)
        panel.plot(miss[good & ~line], steps[good & ~line], marker, color=colour, ms=5)
        panel.plot(miss[~good], steps[~good], "x", color=colour, ms=10, mew=2.5)
    panel.plot([], [], "kx", ms=10, mew=2.5, label="stopped")
    panel.set(xscale="log", yscale="log", ylabel="steps")
    panel.set_xticks(
        [1e-10, 1e-9, 1e-7, 1e-5, 1e-3, 1e-1],
        ["starts\nat 90°", "0", "1e-7", "1e-5", "1e-3", "0.1"],
    )
    panel.minorticks_off()
    panel.set_xlabel("spin about z, beside 2 rad/s about y [rad/s]")
