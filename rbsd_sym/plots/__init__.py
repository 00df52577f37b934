"""Figures: a trajectory, a table. They return matplotlib figures, or write a file."""

from .columns import trajectory
from .precision import work_precision

__all__ = ["trajectory", "work_precision"]
