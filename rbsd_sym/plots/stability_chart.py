"""Stability maps: growth rate in colours over two axes, and the boundary."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..study import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NEUTRAL = 1e-6  # of the largest rate, below which nothing grows


def stability_map(table: Table, title: str = "") -> Figure:
    """Growth rate over the first two columns of a `study.stability_map`, with its boundary.

    Red grows, blue decays, white is neutral; the black line is the boundary, crosses are points
    that failed. Where no disturbance decays, the boundary is drawn where growth begins.

    Raises:
        ValueError: a table of something else, or one value on an axis.
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
    """Colours with white at 0; each side has its own scale, where both are there."""
    from matplotlib.colors import TwoSlopeNorm

    return TwoSlopeNorm(0.0, low if low < 0 else -bound, high if high > 0 else bound)


def _ticks(low: float, high: float) -> list[float]:
    """Round values of both sides, each with its own scale."""
    from matplotlib.ticker import MaxNLocator

    chosen = MaxNLocator(4)
    below = chosen.tick_values(low, 0) if low < 0 else []
    above = chosen.tick_values(0, high) if high > 0 else []
    return sorted({0.0, *(v for v in below if low <= v), *(v for v in above if v <= high)})


def _signs(rates: np.ndarray, high: float) -> np.ndarray:
    """The rates, each side in units of its own median, so that neither draws the boundary near."""
    edge = np.where(rates > _NEUTRAL * high, rates, -np.abs(rates))
    edge[edge == 0] = -_NEUTRAL * high
    for side in (edge > 0, edge < 0):
        if side.any():
            edge[side] = np.sqrt(np.abs(edge[side]) / np.median(np.abs(edge[side]))) * np.sign(
                edge[side]
            )
    return edge


def _grid(table: Table) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values of both axes, and the rates (n_y, n_x), NaN where a point is missing or failed."""
    if "abscissa" not in table.columns[2:]:
        raise ValueError(
            f"plots.stability_map: columns {', '.join(table.columns)}; give the table of "
            "study.stability_map"
        )
    columns = [table.column(name) for name in table.columns[:2]]
    axes = [np.unique(column.astype(float)) for column in columns]
    if min(map(len, axes)) < 2:
        raise ValueError(
            "plots.stability_map: one value on an axis; a map needs at least two on each"
        )
    rates = np.full((len(axes[1]), len(axes[0])), np.nan)
    values = [np.nan if row is None else float(row) for row in table.column("abscissa")]
    places = [np.searchsorted(a, c.astype(float)) for a, c in zip(axes, columns, strict=True)]
    rates[places[1], places[0]] = values
    return axes[0], axes[1], rates


def _geometric(values: np.ndarray) -> bool:
    """Whether steps are equal on a logarithmic scale, and not on a linear one."""
    if len(values) < 3:
        return False
    ratios, steps = np.diff(np.log(values)), np.diff(values)
    return bool(np.ptp(ratios) < 1e-6 * ratios[0] and np.ptp(steps) > 1e-6 * steps[0])
