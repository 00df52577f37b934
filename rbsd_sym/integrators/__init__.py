"""Integrators: a `Model` and an `Experiment` to a `Trajectory`; one file per method."""

from .dop853 import Dop853
from .explicit_rk import ExplicitRK
from .idas import Idas
from .rosenbrock import Rosenbrock

__all__ = ["Dop853", "ExplicitRK", "Idas", "Rosenbrock"]
