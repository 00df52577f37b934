"""Error and CPU time of regularised friction against its width, beside events and bristles.

`python tests/charts/friction.py` writes generated/charts/friction.md, friction.csv, friction.png.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from oracles import discontinuities as events
from paths import CHARTS
from scenes.effects import along, block

import rbsd_sym as rs

WIDTHS = np.logspace(-1.5, -5, 8)
RTOL, ATOL = 1e-8, 1e-10
REPEATS = 5
_ACCELERATION = 1.0  # m/s2: bristles bend by the square of the width over this

# Okabe and Ito's colours: told apart by readers with any colour vision, and by their markers.
_STYLE = {
    "regularised": ("#0072B2", "o-", "regularised"),
    "bristles": ("#009E73", "^-", "LuGre"),
    "events": ("#D55E00", "-", "stick and slip as events"),
}
_HEAD = ("scene", "method", "width", "largest error", "CPU time", "steps", "events")
_UNITS = ("", "", "m/s", "m", "ms", "", "")


class Case(NamedTuple):
    """A block with friction whose motion is known: the scene of an effect, and the path.

    Fields:
        slope: exponent, its text, and how far below the errors its line is.
    """

    title: str
    scene: Callable[[Any], rs.Scene]
    friction: dict[str, float]
    phases: Sequence[events.Phase]
    end: float
    slope: tuple[float, str, float]


CASES = {
    "Coulomb oscillator": Case(
        "oscillator with dry friction: five half\nswings from 1.05 m down, then rest",
        lambda effect: block(effect, 0, 1.0, x=1.05),
        {"normal": 0.2, "kinetic": 0.5, "static": 0.5, "velocity": 0.0},
        events.coulomb_phases(1.0, 1.0, 0.1, 1.05), 18.0, (1.0, "slope 1", 30),
    ),
    "belt": Case(
        "block on a belt of 0.2 m/s with a spring:\none and a half cycles of stick and slip",
        lambda effect: block(effect, 0, 50.0, 2.0, v=0.2),
        {"normal": 20.0, "kinetic": 0.3, "static": 0.5, "velocity": 0.2},
        events.belt_phases(2.6, 2.0, 50.0, 20.0, 0.5, 0.3, 0.2, 0.0, 0.2), 2.6,
        (2 / 3, "slope 2/3", 3000),
    ),
}  # fmt: skip


def effect(method: str, case: Case, width: float) -> Any:
    """Friction along x; bristles as narrow as the width, with critical damping."""
    f = case.friction
    if method == "bristles":
        stiffness = f["static"] * f["normal"] * _ACCELERATION / width**2
        return rs.LuGre(0, **f, stribeck=width, stiffness=stiffness,
                        damping=2 * np.sqrt(stiffness))  # fmt: skip
    return rs.Friction(0, **f, smoothing=0.0 if method == "events" else width)


def measure(name: str, method: str, width: float) -> tuple[Any, ...]:
    """A row: largest error of the path at 401 times, and what the run cost."""
    case = CASES[name]
    t = np.linspace(0, case.end, 401)
    model = rs.compile_scene(case.scene(effect(method, case, width)))
    bend = width**2 / _ACCELERATION  # of bristles: a state that small needs a tolerance to match
    integrator = rs.Rosenbrock(RTOL, min(ATOL, 1e-3 * bend) if method == "bristles" else ATOL)
    costs = []
    for _ in range(1 + REPEATS):  # the first one builds the integrator
        start = time.process_time()
        found = rs.simulate(model, t, integrator)
        costs.append(time.process_time() - start)
    error = np.abs(along(found, 0)[0] - events.state_at(case.phases, t)[0]).max()
    return (name, method, width, float(error), 1e3 * min(costs[1:]), found.stats["steps"],
            len(found.events))  # fmt: skip


def rows() -> tuple[tuple[Any, ...], ...]:
    """All that is measured."""
    return tuple(
        measure(name, method, float(width))
        for name in CASES for method in _STYLE
        for width in ([0.0] if method == "events" else WIDTHS)
    )  # fmt: skip


def draw(table: rs.study.Table) -> Any:
    """Above the error, below the CPU time; left and right the two scenes."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7.6), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, (name, case) in enumerate(CASES.items()):
        for row, value in enumerate((3, 4)):
            panel = panels[row, column]
            for method, (colour, style, label) in _STYLE.items():
                chosen = [r for r in table.rows if r[:2] == (name, method)]
                if method == "events":
                    panel.axhline(chosen[0][value], color=colour, lw=1.8, label=label)
                else:
                    panel.loglog([r[2] for r in chosen], [r[value] for r in chosen], style,
                                 color=colour, ms=6, lw=1.5, label=label)  # fmt: skip
            panel.grid(alpha=0.3)
            panel.tick_params(labelsize=11)
        first = next(r for r in table.rows if r[:2] == (name, "regularised"))
        exponent, label, below = case.slope
        line = first[3] / below * (WIDTHS / WIDTHS[0]) ** exponent
        panels[0, column].loglog(WIDTHS, line, ":", color="0.3", lw=1.5)
        panels[0, column].annotate(label, (WIDTHS[3], line[3]), (4, -14), fontsize=11,
                                   textcoords="offset points", color="0.3")  # fmt: skip
        panels[0, column].set_title(case.title, fontsize=11.5, loc="left")
        panels[1, column].set_xlabel("width of the regularisation [m/s]", fontsize=12)
    panels[0, 0].set_ylabel("largest error of the path [m]", fontsize=12)
    panels[1, 0].set_ylabel("CPU time of a run [ms]", fontsize=12)
    ticks = [1, 2, 5, 10, 20, 50, 100, 200]
    panels[1, 0].set_ylim(0.5, 300)
    panels[1, 0].set_yticks(ticks, [str(tick) for tick in ticks])
    panels[1, 0].minorticks_off()
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=12, frameon=False)
    title = "Dry friction as events, regularised, and with bristles (LuGre)"
    figure.suptitle(title, x=0.02, ha="left", fontsize=15)
    return figure


def main() -> None:
    """Measure, and write table and picture."""
    table = rs.study.Table(_HEAD, _UNITS, rows())
    target = CHARTS
    target.mkdir(parents=True, exist_ok=True)
    text = "\n\n".join([
        "# Friction: error and cost against the width of the regularisation",
        f"Made by `python tests/charts/friction.py` with Rosenbrock({RTOL:g}, {ATOL:g}). CPU time "
        f"is the smallest of {REPEATS} runs, errors are the largest of 401 points against closed "
        "forms.\nBristles (LuGre) take the width for their Stribeck velocity, and bend by its "
        f"square over {_ACCELERATION:g} m/s2 before they slide; their absolute tolerance is a "
        "thousandth of that.",
        table.to_markdown(),
    ])  # fmt: skip
    (target / "friction.md").write_text(text + "\n")
    table.to_csv(target / "friction.csv")
    draw(table).savefig(target / "friction.png", dpi=120)
    print(text)


if __name__ == "__main__":
    main()
