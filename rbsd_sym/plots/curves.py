"""Curves of a trajectory's columns over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..base.names import titled
from ..model.trajectory import Trajectory
from .style import COLOURS, STYLES

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def trajectory(trajectory: Trajectory, columns: Sequence[str]) -> Figure:
    """Return a figure with a panel for each column, its components over time.

    Axes carry quantity and unit. Colours and line styles distinguish up to 32 components.

    >>> rs.plots.trajectory(trajectory, ["arm.position", "joint.force_local"]).savefig("arm.png")

    Arguments:
        trajectory: from `simulate`, or loaded from a file.
        columns: names of states, inputs or outputs, such as "arm.position".

    Raises:
        ValueError: no columns, or an unknown one.
    """
    # Matplotlib is imported where it is used: it is slow to import, and simulations do not need it.
    from matplotlib.figure import Figure

    names = [columns] if isinstance(columns, str) else list(columns)
    if not names:
        raise ValueError("plots.trajectory: no columns; name at least one")
    figure = Figure(figsize=(7.0, 0.6 + 1.9 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for panel, name in zip(panels, names, strict=True):
        column = trajectory.column(name)
        values = column.values.reshape(len(trajectory.t), -1)
        for i in range(values.shape[1]):
            label = column.components[i] if len(column.components) == values.shape[1] else str(i)
            style = STYLES[(i // len(COLOURS) + i) % len(STYLES)]
            colour = COLOURS[i % len(COLOURS)]
            panel.plot(trajectory.t, values[:, i], style, color=colour, label=label, lw=1.5)
        quantity = titled(name)
        panel.set_ylabel(f"{quantity} [{column.unit}]" if column.unit else quantity)
        panel.set_title(name, loc="left", fontsize="medium")
        panel.grid(alpha=0.3)
        panel.margins(x=0)
        # The limits of a constant column would otherwise enlarge its rounding errors to full size.
        if np.ptp(values) < 1e-12 * max(1.0, float(np.abs(values).max())):
            middle = float(values.mean())
            panel.set_ylim(middle - 1, middle + 1)
        if values.shape[1] > 1:
            panel.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    panels[-1].set_xlabel("time [s]")
    return figure
