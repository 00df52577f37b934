"""What CasADi is to be told for each integrator, and which ones give derivatives to be trusted."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..integrators import RK4, Collocation, ExplicitRK, Idas, Rosenbrock
from ..integrators.options import elements_of
from ..model.model import Model
from ..model.values import Experiment


def _of_idas(method: Any, model: Model, e: Experiment) -> tuple[str, dict[str, Any]]:
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
    if not method.max_step:
        kind = type(method).__name__
        raise ValueError(
            f"sensitivity of '{model.name}': {kind} chooses its steps by the states alone; where "
            f"they rest, their derivatives do not; give {kind}(max_step=...) in s, or use Idas()"
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
        "rootfinder_options": {"abstol": 0, "abstolStep": 1e-13, "max_iter": 50},
    }


PLUGINS = {
    Idas: _of_idas,
    Rosenbrock: _of_pair,
    ExplicitRK: _of_pair,
    Collocation: _of_collocation,
    RK4: _of_rk4,
}
"""How each class of integrator is called: (integrator, model, experiment) -> (plugin, options)."""
