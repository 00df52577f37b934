"""Formulations: write a scene as a `Dae`; one file per choice of coordinates."""

from .audit import ModelWarning
from .quaternion import Quaternion
from .tait_bryan import TaitBryan

__all__ = ["ModelWarning", "Quaternion", "TaitBryan"]
