"""Figures: a trajectory, a table. They return matplotlib figures, or write a file."""

from .animation import animate, snapshot
from .curves import trajectory
from .precision_chart import work_precision
from .stability_chart import stability_map

__all__ = ["animate", "snapshot", "stability_map", "trajectory", "work_precision"]
