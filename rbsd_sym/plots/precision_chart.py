"""Work-precision charts: error against CPU time, both logarithmic."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..study import Table
from .style import COLOURS, MARKERS, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_WRONG = 0.1  # error from which a run that reports success is marked as wrong
# The colour of a method is that of its place here, in every chart.
_METHODS = ("Idas", "Rosenbrock", "ExplicitRK", "Dop853", "GeneralizedAlpha", "Collocation", "RK4")


def work_precision(table: Table, title: str = "") -> Figure:
    """Return a chart of error against CPU time, with a line for each method.

    Both axes are logarithmic. Bars span the shortest and the longest time. Runs that failed are
    crosses at the top; runs that report success with an error above 0.1 are circled. Errors in the
    shaded band at the bottom are not resolved by the reference.

    >>> table = rs.study.work_precision(model, rs.study.contenders(model, 2.0), 2.0)
    >>> rs.plots.work_precision(table).savefig("chart.png")

    Arguments:
        table: of `study.work_precision`.
        title: of the figure.

    Raises:
        ValueError: a table without the columns of `study.work_precision`.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    panel: Any = figure.subplots()
    methods = list(dict.fromkeys(str(m) for m in table.column("method")))
    failed = False
    for i, method in enumerate(methods):
        failed |= _line(panel, table, method, _place(method, methods, i))
    panel.set(xscale="log", yscale="log", xlabel="CPU time [ms]", title=title)
    _plain_numbers(panel.xaxis)
    panel.set_ylabel("largest error, relative to excursion")
    floor = float(table.column("floor")[0])
    low, high = panel.get_ylim()
    if floor > 0:
        low = min(low, floor / 3)
        panel.axhspan(low, floor, color="0.9", lw=0, label="not resolved by the reference")
    panel.set_ylim(low, high)
    if failed:
        panel.plot([], [], "x", color="black", label="failed")
    panel.grid(alpha=0.3)
    panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return figure


def _plain_numbers(axis: Any) -> None:
    """Label an axis with 1, 2, 5, 10, ... instead of powers of ten."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _place(method: str, methods: list[str], i: int) -> int:
    """Return the index of a method's colour; others than ours come after them."""
    # A label such as "hand-written C" is not in the list, and must not move the others' colours.
    if method in _METHODS:
        return _METHODS.index(method)
    others = [m for m in methods if m not in _METHODS]
    return len(_METHODS) + others.index(method) if method in others else i


def _line(panel: Any, table: Table, method: str, place: int) -> bool:
    """Draw the runs of one method; return whether one of them failed."""
    mine = np.array([str(m) == method for m in table.column("method")])
    time, low, high = (1e3 * table.column(name)[mine] for name in ("time", "time_min", "time_max"))
    error = np.array([np.nan if e is None else float(e) for e in table.column("error")[mine]])
    good = np.isfinite(error) & (error > 0)
    colour, marker = COLOURS[place % len(COLOURS)], MARKERS[place % len(MARKERS)]
    style = STYLES[place // len(COLOURS) % len(STYLES)]
    spread = np.array([time - low, high - time])
    if good.any():
        panel.errorbar(
            time[good],
            error[good],
            xerr=spread[:, good],
            color=colour,
            marker=marker,
            ls=style,
            ms=5,
            lw=1.4,
            elinewidth=0.8,
            label=method,
        )
    # Failed runs have a time but no error: this transform takes data for x, and for y the height of
    # the panel from 0 to 1.
    top = panel.get_xaxis_transform()
    panel.plot(time[~good], np.full((~good).sum(), 0.97), "x", color=colour, transform=top)
    wrong = good & (error > _WRONG)
    panel.plot(time[wrong], error[wrong], "o", ms=11, mfc="none", color=colour)
    return bool((~good).any())
