"""Figures of results: curves, pictures and films of motions, charts of studies.

All functions return a matplotlib figure, but `animate`, which writes a file. None of them uses
pyplot, so no backend is chosen and nothing is shown.
"""

from .animation import animate, snapshot
from .curves import trajectory
from .precision_chart import work_precision
from .stability_chart import stability_map

__all__ = ["animate", "snapshot", "stability_map", "trajectory", "work_precision"]
