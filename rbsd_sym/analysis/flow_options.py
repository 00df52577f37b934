"""CasADi options of each integrator, and which integrators support derivatives."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..integrators import RK4, Collocation, ExplicitRK, Idas, Rosenbrock
from ..integrators.options import elements_of
from ..model.model import Model
from ..model.values import Experiment


def _of_idas(method: Any, model: Model, e: Experiment) -> tuple[str, dict[str, Any]]:
    # The same share of the tolerances as in `Idas.solve`.
    scale = method.safety / np.sqrt(max(1, model.n_x + model.n_z))
    options = {
        "reltol": max(method.rtol * scale, 1e-15),
        "abstol": method.atol * scale,
        "max_multistep_order": method.max_order,
        "max_num_steps": method.max_steps,
        "linear_solver": method.linear_solver or "qr",
    }
    for name, value in (("max_step_size", method.max_step), ("step0", method.first_step)):
        if value:
            options[name] = value
    return "idas", options | dict(method.options)


def _of_pair(method: Any, model: Model, e: Experiment) -> tuple[str, dict[str, Any]]:
    # The pair's error estimate is that of the states alone. With steps bounded by the user the
    # derivatives are those of the discrete solution; without, they were off by up to 0.15.
    if not method.max_step:
        kind = type(method).__name__
        raise ValueError(
            f"sensitivity of '{model.name}': {kind} chooses its steps by the states alone, and "
            "where these are at rest their derivatives may still vary; "
            f"give {kind}(max_step=...) in s, or use Idas()"
        )
    return method.plugin, {"reltol": method.rtol, "abstol": method.atol, **method.casadi_options}


def _of_rk4(method: Any, model: Model, e: Experiment) -> tuple[str, dict[str, Any]]:
    return "rk", {"number_of_finite_elements": elements_of(e, method.step)}


def _of_collocation(method: Any, model: Model, e: Experiment) -> tuple[str, dict[str, Any]]:
    return "collocation", {
        "number_of_finite_elements": elements_of(e, method.step),
        "interpolation_order": method.degree,
        "collocation_scheme": method.scheme,
        "simplify": False,
        "rootfinder": "fast_newton",
        # The exact derivative of the discrete solution presumes that Newton's method has solved
        # its equations, so it is stopped later than in `Collocation.solve`.
        "rootfinder_options": {"abstol": 0, "abstolStep": 1e-13, "max_iter": 50},
    }


PLUGINS = {
    Idas: _of_idas,
    Rosenbrock: _of_pair,
    ExplicitRK: _of_pair,
    Collocation: _of_collocation,
    RK4: _of_rk4,
}
"""For each class of integrator: (integrator, model, experiment) -> (CasADi plugin, options)."""
