"""Optimal control on the same model.

    problem = rs.ocp.Problem(
        model,
        rs.ocp.Phase(
            rs.ocp.Free(4.0, low=1.0, high=10.0),           # horizon in s
            end={"hub.position": (1, 0, 0), "hub.v_x": 0},
            path={"rod.force_local": (-0.4, 0.4)},
            integral=lambda v: v["rod.rotation"][2] ** 2 + 0.1 * push**2,
            end_cost=rs.TIME,
        ),
        inputs={"push": rs.ocp.Free(low=-1, high=1)},
        params={"k": rs.ocp.Free(2e4, low=1e4, high=1e5)},  # found together with the motion
    )
    solution = rs.ocp.optimise(problem, rs.ocp.Collocation(30, degree=4, refine=1e-6))

A `Problem` knows no method, `Collocation` and `Shooting` know no solver, `Ipopt` and `Fatrop` know
no model: any goes with any. README.md in this folder says how one becomes the other.
"""

from .direct_collocation import DirectCollocation as Collocation
from .direct_shooting import Shooting
from .export import Code, export_problem
from .loaded import ProblemLibrary, load_problem
from .nlp import Nlp
from .optimise import optimise, transcribe
from .plan import Flight, Miss, OptimisationError, Pieces, Solution
from .problem import Bound, Free, Phase, Problem
from .solvers import Fatrop, Ipopt, Iteration
from .solvers import OptimisationOutcome as Outcome

__all__ = [
    "Bound",
    "Code",
    "Collocation",
    "Fatrop",
    "Flight",
    "Free",
    "Ipopt",
    "Iteration",
    "Miss",
    "Nlp",
    "OptimisationError",
    "Outcome",
    "Phase",
    "Pieces",
    "Problem",
    "ProblemLibrary",
    "Shooting",
    "Solution",
    "export_problem",
    "load_problem",
    "optimise",
    "transcribe",
]
