"""A model at one point: its rest, and its linear motion about a state."""

from .equilibrium import Equilibrium, EquilibriumError, static_equilibrium
from .linearize import Linear, linearize
from .point import Point, Where, locate

__all__ = [
    "Equilibrium",
    "EquilibriumError",
    "Linear",
    "Point",
    "Where",
    "linearize",
    "locate",
    "static_equilibrium",
]
