"""Charts of stability: growth rate in colours over two axes, and the boundary of stability."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..study import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NEUTRAL = 1e-6  # growth rates below this part of the largest one count as rounding


def stability_map(table: Table, title: str = "") -> Figure:
    """Return a map of growth rates, in colours, with the boundary of stability.

    Disturbances grow where the map is red and decay where it is blue; white is neutral. The black
    line is the boundary, crosses are points that failed. In an undamped scene, where nothing
    decays, the boundary is drawn where growth begins. An axis with geometric steps is logarithmic.

    >>> table = rs.study.stability_map(model, {"k": [1e3, 1e4, 1e5]}, {"push": [0.0, 5.0]})
    >>> rs.plots.stability_map(table, "swing").savefig("map.png")

    Arguments:
        table: of `study.stability_map`; its first two columns are the axes.
        title: of the figure.

    Raises:
        ValueError: another table, or an axis with only one value.
    """
    from matplotlib.figure import Figure

    x, y, rates = _grid(table)
    figure = Figure(figsize=(7.0, 4.8), layout="constrained")
    panel: Any = figure.subplots()
    found = np.isfinite(rates)
    bound = float(np.abs(rates[found]).max(initial=0.0)) or 1.0
    low, high = float(rates[found].min(initial=0.0)), float(rates[found].max(initial=0.0))
    mesh = panel.pcolormesh(
        x,
        y,
        np.ma.masked_invalid(rates),
        cmap="RdBu_r",
        norm=_norm(low, high, bound),
        shading="nearest",
    )
    bar = figure.colorbar(mesh, ax=panel, label="largest growth rate [1/s]")
    ticks = _ticks(low, high)
    bar.set_ticks(ticks, labels=[f"{tick:.3g}" for tick in ticks])
    if low <= 0 < high:
        edge = np.ma.masked_invalid(_signs(rates, high))
        panel.contour(x, y, edge, levels=[0.0], colors="black", linewidths=1.8)
        panel.plot([], [], color="black", lw=1.8, label="stability boundary")
    if not found.all():
        failed = np.argwhere(~found)
        panel.plot(x[failed[:, 1]], y[failed[:, 0]], "x", color="black", ms=5, label="failed")
    for axis, i, values in ((panel.xaxis, 0, x), (panel.yaxis, 1, y)):
        unit = table.units[i]
        axis.set_label_text(f"{table.columns[i].replace('_', ' ')}{f' [{unit}]' if unit else ''}")
        if (values > 0).all() and _geometric(values):
            axis.axes.set(**{f"{'xy'[i]}scale": "log"})
    panel.set_title(title)
    if panel.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", frameon=False, ncols=3)
    return figure


def _norm(low: float, high: float, bound: float) -> Any:
    """Return the scale of colours, white at 0; growth and decay each have their own range."""
    from matplotlib.colors import TwoSlopeNorm

    # Both sides need a bound other than 0, also one on which there are no values.
    return TwoSlopeNorm(0.0, low if low < 0 else -bound, high if high > 0 else bound)


def _ticks(low: float, high: float) -> list[float]:
    """Return round values for the bar of colours, on both sides of 0."""
    from matplotlib.ticker import MaxNLocator

    chosen = MaxNLocator(4)
    below = chosen.tick_values(low, 0) if low < 0 else []
    above = chosen.tick_values(0, high) if high > 0 else []
    return sorted({0.0, *(v for v in below if low <= v), *(v for v in above if v <= high)})


def _signs(rates: np.ndarray, high: float) -> np.ndarray:
    """Return numbers with the signs of the rates, whose zero contour is the boundary."""
    # Contours are interpolated linearly. If decay is, say, a hundred times as fast as growth, the
    # boundary would be drawn far too near to the growing side. So both sides are measured in their
    # own median, and the root compresses large values. Rates that count as rounding are made
    # negative, so that an undamped scene has a boundary where growth begins.
    edge = np.where(rates > _NEUTRAL * high, rates, -np.abs(rates))
    edge[edge == 0] = -_NEUTRAL * high
    for side in (edge > 0, edge < 0):
        if side.any():
            edge[side] = np.sqrt(np.abs(edge[side]) / np.median(np.abs(edge[side]))) * np.sign(
                edge[side]
            )
    return edge


def _grid(table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the values of both axes, and the rates (n_y, n_x), NaN for missing or failed points.

    Raises:
        ValueError: another table, or an axis with only one value.
    """
    if "abscissa" not in table.columns[2:]:
        raise ValueError(
            f"plots.stability_map: a table with columns {', '.join(table.columns)}; give the table "
            "of study.stability_map"
        )
    columns = [table.column(name) for name in table.columns[:2]]
    axes = [np.unique(column.astype(float)) for column in columns]
    if min(map(len, axes)) < 2:
        raise ValueError(
            "plots.stability_map: one value on an axis; a map needs at least two on each; give "
            "more values to study.stability_map"
        )
    rates = np.full((len(axes[1]), len(axes[0])), np.nan)
    values = [np.nan if row is None else float(row) for row in table.column("abscissa")]
    places = [np.searchsorted(a, c.astype(float)) for a, c in zip(axes, columns, strict=True)]
    rates[places[1], places[0]] = values
    return axes[0], axes[1], rates


def _geometric(values: np.ndarray) -> bool:
    """Return whether steps are equal on a logarithmic scale, and not on a linear one."""
    if len(values) < 3:
        return False
    ratios, steps = np.diff(np.log(values)), np.diff(values)
    return bool(np.ptp(ratios) < 1e-6 * ratios[0] and np.ptp(steps) > 1e-6 * steps[0])
