"""Stick-slip, and infinitely many events.

A block on a belt sticks and slips; a ball with restitution comes to rest after infinitely many
bounces in finite time. Regularised friction never sticks but creeps: its error falls only with the
width of the regularisation, and explicit methods need steps in inverse proportion to it. The form
with events matches the closed form to the tolerance. The bouncing ball ends every run with the
outcome `endless_events`, with the number of events and a time that falls short of the exact one by
less than 1e-6 of it; no run hangs. Remedy: events for stick and slip, with `Idas` or `Rosenbrock`;
and for what comes to rest a `Contact` with damping, which closes for good.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    GROUND,
    Contact,
    Dop853,
    ExplicitRK,
    GeneralizedAlpha,
    Idas,
    Impact,
    Marker,
    RigidBody,
    RigidBodySpringDamper,
    Rosenbrock,
    Scene,
    compile_scene,
    simulate,
)
from rbsd_sym.study import Table

from .oscillators import legend_below, style_of
from .pages import model_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 12
_stick_slip = model_file("stick_slip").scene
# m/s, N, -, -, N/m; the block has 1 kg.
BELT, NORMAL, STATIC, KINETIC, SPRING = 0.5, 10.0, 0.4, 0.3, 4.0
# m/s2, m.
GRAVITY, HEIGHT = 9.81, 1.0
# Length of a run, s.
_END = 10.0
_RTOL, _ATOL = 1e-8, 1e-10
# Width of the regularisation whose path is shown, m/s.
_WIDE = 1e-2
# N/m, N s/m.
_FLOOR: dict[str, Any] = {"stiffness": 1e6, "damping": 400.0}
_STYLES = {
    name: style_of(name)
    for name in ("Idas", "Rosenbrock", "ExplicitRK", "Dop853", "GeneralizedAlpha")
}


def belt_path(t: np.ndarray) -> np.ndarray:
    """Return the position (m) of the block [Leine, Nijmeijer 2004].

    It starts with the belt at 0, sticks up to mu_s N / k, then slips about c = mu_k N / k:
    x = c + D cos s + (V/w) sin s, D = (mu_s - mu_k) N / k, s = w t, until its velocity is V again
    at x = c - D.

    Arguments:
        t: times (n,), s.
    """
    w, centre = math.sqrt(SPRING), KINETIC * NORMAL / SPRING
    D = (STATIC - KINETIC) * NORMAL / SPRING
    slip = 2 * (math.pi - math.atan2(D * w, BELT)) / w
    first = (centre + D) / BELT
    since = (t - first) % (slip + 2 * D / BELT)
    slips = centre + D * np.cos(w * since) + BELT / w * np.sin(w * since)
    later = np.where(since < slip, slips, centre - D + BELT * (since - slip))
    return np.where(t < first, BELT * t, later)


def zeno_time(restitution: float) -> float:
    """Return the time (s) at which infinitely many bounces are over."""
    impact = math.sqrt(2 * GRAVITY * HEIGHT)
    return (impact + 2 * impact * restitution / (1 - restitution)) / GRAVITY


def _ball(floor: Any) -> Any:
    ball = RigidBody("ball", 1, (1, 1, 1), position=(0, 0, HEIGHT))
    floor = RigidBodySpringDamper("floor", Marker(GROUND), Marker("ball"), 0, effects=[floor])
    return compile_scene(Scene("ball", [ball], [floor], gravity=(0, 0, -GRAVITY)))


def study(full: bool) -> dict[str, Table]:
    """Measure stick-slip in both forms over the width, bouncing balls, and a ball that rests."""
    decades = np.linspace(0.5, -3, 8) if full else np.array([0.0, -2.0])
    friction, path = _friction(_WIDE * 10**decades)
    ends, bounces = _bounces((0.5, 0.8, 0.95) if full else (0.5,))
    return {
        "friction": friction,
        "path": path,
        "endless": ends,
        "bounces": bounces,
        "rest": _rest(full),
    }


def _friction(widths: np.ndarray) -> tuple[Table, Table]:
    times = np.linspace(0.0, _END, 201)
    exact = belt_path(times)
    methods: dict[str, Any] = {
        "Idas": Idas(_RTOL, _ATOL),
        "Rosenbrock": Rosenbrock(_RTOL, _ATOL),
        "ExplicitRK": ExplicitRK(_RTOL, _ATOL),
        "GeneralizedAlpha": GeneralizedAlpha(1e-2),
    }
    rows, paths = [], {}
    for width in (0.0, *map(float, widths)):
        model = compile_scene(_stick_slip(smoothing=width))
        for name, method in methods.items():
            # Sticking needs an algebraic unknown, which explicit methods do not support.
            if not width and name == "ExplicitRK":
                continue
            run = simulate(model, times, method, throw=False)
            x, n = run["block.p_x"], len(run.t)
            if name == "Idas":
                paths[width] = x
            error = float(np.abs(x - exact[:n]).max())
            rows.append((name, width, error, run.stats["steps"], len(run.events), run.outcome.name))
    columns = (times, exact, paths[0.0], paths[_WIDE])
    return (
        Table(
            ("method", "width", "error", "steps", "events", "outcome"),
            ("", "m/s", "m", "", "", ""),
            tuple(rows),
        ),
        Table(
            ("t", "exact", "with_events", "regularised"),
            ("s", "m", "m", "m"),
            tuple(zip(*(c.tolist() for c in columns), strict=True)),
        ),
    )


def _bounces(restitutions: tuple[float, ...]) -> tuple[Table, Table]:
    ends, rows = [], []
    for restitution in restitutions:
        model, zeno = _ball(Impact(2, restitution=restitution)), zeno_time(restitution)
        for name, method in (
            ("Idas", Idas()),
            ("Dop853", Dop853()),
            ("Rosenbrock", Rosenbrock()),
            ("ExplicitRK", ExplicitRK()),
            ("GeneralizedAlpha", GeneralizedAlpha(1e-2)),
        ):
            run = simulate(model, np.linspace(0, 1.2 * zeno, 101), method, throw=False)
            count = int(run.stats.get("events", len(run.events)))
            end = float(run.stats["t_failed"])
            ends.append((name, restitution, run.outcome.name, count, end, zeno))
            if restitution == restitutions[0]:
                rows += [(name, i + 1, t, zeno - t) for i, (t, _) in enumerate(run.events)][::2]
    return (
        Table(
            ("method", "restitution", "outcome", "events", "end", "exact_end"),
            ("", "", "", "", "s", "s"),
            tuple(ends),
        ),
        Table(("method", "bounce", "time", "time_left"), ("", "", "s", "s"), tuple(rows)),
    )


def _rest(full: bool) -> Table:
    """Return how a ball on an elastic, damped floor ends: pressed in by m g / k."""
    model, rows = _ball(Contact(2, **_FLOOR)), []
    methods: dict[str, Any] = {"Idas": Idas(1e-6, 1e-8), "Dop853": Dop853(1e-6, 1e-8)}
    if full:
        methods["GeneralizedAlpha"] = GeneralizedAlpha(1e-3)
    for name, method in methods.items():
        run = simulate(model, np.linspace(0, 3, 31), method, throw=False)
        rows.append(
            (
                name,
                run.outcome.name,
                len(run.events),
                float(run["ball.p_z"][-1]),
                -GRAVITY / _FLOOR["stiffness"],
            )
        )
    return Table(
        ("method", "outcome", "events", "height", "exact_height"),
        ("", "", "", "m", "m"),
        tuple(rows),
    )


def draw(tables: Tables) -> Figure:
    """Draw the path, error and steps over the width, and the time left at each bounce."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 8.2), layout="constrained")
    panels: Any = figure.subplots(2, 2)
    (path, error), (bounces, steps) = panels
    table = tables["path"]
    t = table.column("t")
    path.plot(t, table.column("exact"), color="0.7", lw=5, label="exact")
    path.plot(t, table.column("with_events"), color="black", lw=1.2, label="with events")
    path.plot(
        t,
        table.column("regularised"),
        "--",
        color="#D55E00",
        lw=1.4,
        label=f"regularised, {_WIDE:g} m/s wide",
    )
    path.set(xlabel="time [s]", ylabel="position of the block [m]")
    _draw_widths(error, steps, tables["friction"])
    table = tables["bounces"]
    # The methods coincide, so the markers differ in size.
    for i, (name, style) in enumerate(_STYLES.items()):
        mine = table.column("method") == name
        own = style | {"ls": "", "ms": 13 - 2.5 * i, "mfc": "none", "mew": 1.5}
        bounces.plot(
            table.column("bounce")[mine], table.column("time_left")[mine], **own, label=name
        )
    bounces.set(
        yscale="log",
        xlabel="bounce",
        ylabel="time left to the end of all bounces [s]",
        title="restitution 0.5: every run ends as endless_events",
    )
    n = np.arange(1, 46)
    bounces.plot(
        n, zeno_time(0.5) * 2 / 3 * 0.5 ** (n - 1.0), color="0.6", lw=1, zorder=0, label="exact"
    )
    for panel in panels.ravel():
        panel.grid(alpha=0.3)
        legend_below(panel, 3)
    return figure


def _draw_widths(error: Any, steps: Any, table: Table) -> None:
    width = table.column("width")
    for name, style in _STYLES.items():
        mine = table.column("method") == name
        if not mine.any():
            continue
        smooth, sharp = mine & (width > 0), mine & (width == 0)
        for panel, column in ((error, "error"), (steps, "steps")):
            values = table.column(column)
            panel.plot(width[smooth], values[smooth], **style, label=name)
            for value in values[sharp]:
                panel.axhline(value, color=style["color"], ls="--", lw=1.2)
    for panel, label in ((error, "largest error of the position [m]"), (steps, "steps")):
        panel.plot([], [], "--", color="0.4", label="with events")
        panel.set(
            xscale="log", yscale="log", xlabel="width of regularised friction [m/s]", ylabel=label
        )
        panel.invert_xaxis()
