"""Transcriptions of optimal control: error against the mesh, and against the time to solve.

`python tests/charts/ocp.py` writes generated/charts/ocp_order.png and .md.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from paths import CHARTS
from scenes.ocp import SLEW, SLEW_EFFORT

from rbsd_sym.ocp import Collocation, Ipopt, Shooting, optimise
from rbsd_sym.plots.style import COLOURS, MARKERS
from rbsd_sym.study import Table

INTERVALS = (4, 8, 16, 32, 64)
REPEATS = 5
METHODS = {
    "Legendre, degree 2": lambda n: Collocation(n, 2, "legendre", 1),
    "Legendre, degree 3": lambda n: Collocation(n, 3, "legendre", 2),
    "Radau, degree 2": lambda n: Collocation(n, 2, "radau", 1),
    "Radau, degree 3": lambda n: Collocation(n, 3, "radau", 2),
    "shooting, order 4": lambda n: Shooting(n, 1, 4, input_degree=2),
    "shooting, order 8": lambda n: Shooting(n, 1, 8, input_degree=2),
    "Inputs constant, degree 3": lambda n: Collocation(n, 3, "legendre", 0),
}


def table() -> Table:
    """Error of the least effort, error of an interval, and seconds of IPOPT, for each mesh."""
    problem, rows = SLEW.least_effort(), []
    for name, method in METHODS.items():
        for n in INTERVALS:
            found = optimise(problem, method(n), solver=Ipopt())
            times = [optimise(problem, method(n), solver=Ipopt(), fly=False).stats["time"]
                     for _ in range(REPEATS)]  # fmt: skip
            rows.append((name, n, abs(found.cost - SLEW_EFFORT) / SLEW_EFFORT, found.mesh_error,
                         float(np.median(times)), found.stats["variables"]))  # fmt: skip
    columns = ("method", "intervals", "error", "mesh_error", "time", "variables")
    return Table(columns, ("", "", "", "", "s", ""), tuple(rows))


def figure(found: Table) -> Any:
    """Error of the cost against the number of intervals, and against the time to solve."""
    from matplotlib.figure import Figure

    picture = Figure(figsize=(9.5, 4.2), layout="constrained")
    left, right = picture.subplots(1, 2, sharey=True)
    names = np.array([str(name) for name in found.column("method")])
    for i, name in enumerate(METHODS):
        mine = names == name
        error = np.maximum(found.column("error")[mine].astype(float), 1e-13)
        style = {"color": COLOURS[i % len(COLOURS)], "marker": MARKERS[i % len(MARKERS)], "ms": 5}
        left.loglog(found.column("intervals")[mine].astype(float), error, label=name, **style)
        right.loglog(1e3 * found.column("time")[mine].astype(float), error, ls="", **style)
    left.set(xlabel="intervals", ylabel="relative error of the cost")
    left.set_xticks(INTERVALS, [str(n) for n in INTERVALS], minor=False)
    left.minorticks_off()
    right.set(xlabel="time of IPOPT [ms]")
    ticks = [n for n in (1, 2, 5, 10, 20, 50, 100) if right.get_xlim()[0] < n < right.get_xlim()[1]]
    right.set_xticks(ticks, [str(n) for n in ticks], minor=False)
    right.minorticks_off()
    for panel in (left, right):
        panel.grid(alpha=0.3)
    picture.suptitle("Least effort of two masses and a spring, 5 s", fontsize="medium")
    picture.legend(*left.get_legend_handles_labels(), loc="outside right upper", frameon=False)
    return picture


def main() -> None:
    """Write the chart and its table."""
    folder = CHARTS
    folder.mkdir(parents=True, exist_ok=True)
    found = table()
    figure(found).savefig(folder / "ocp_order.png", dpi=110)
    text = f"# Order of transcriptions\n\n`python tests/charts/ocp.py`\n\n{found.to_markdown()}"
    (folder / "ocp_order.md").write_text(text)
    print(found)


if __name__ == "__main__":
    main()
