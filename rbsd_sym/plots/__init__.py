"""Figures: a trajectory, a table. They return matplotlib figures, or write a file."""

from .columns import trajectory
from .motion import animate, snapshot
from .precision import work_precision

__all__ = ["animate", "snapshot", "trajectory", "work_precision"]
