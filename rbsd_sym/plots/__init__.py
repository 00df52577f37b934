"""Figures: a trajectory, a table. They return matplotlib figures, or write a file."""

from .columns import trajectory

__all__ = ["trajectory"]
