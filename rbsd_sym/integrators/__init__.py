"""Integrators, which turn a `Model` and an `Experiment` into a `Trajectory`; one file per method.

`README.md` in this folder compares the methods, and says how to add one.
"""

from .collocation import Collocation
from .dop853 import Dop853
from .explicit_rk import ExplicitRK
from .generalized_alpha import GeneralizedAlpha
from .idas import Idas
from .post_newton import PostNewton
from .rk4 import RK4
from .rosenbrock import Rosenbrock

__all__ = [
    "RK4",
    "Collocation",
    "Dop853",
    "ExplicitRK",
    "GeneralizedAlpha",
    "Idas",
    "PostNewton",
    "Rosenbrock",
]
