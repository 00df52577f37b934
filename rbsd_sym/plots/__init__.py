"""Figures: a trajectory, a table. They return matplotlib figures, or write a file."""

from .columns import trajectory
from .motion import animate, snapshot
from .precision import work_precision
from .stability import stability_map

__all__ = ["animate", "snapshot", "stability_map", "trajectory", "work_precision"]
