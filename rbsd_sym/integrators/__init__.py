"""Integrators: a `Model` and an `Experiment` to a `Trajectory`; one file per method."""

from .explicit_rk import ExplicitRK
from .idas import Idas
from .rosenbrock import Rosenbrock

__all__ = ["ExplicitRK", "Idas", "Rosenbrock"]
