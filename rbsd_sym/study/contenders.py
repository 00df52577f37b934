"""The integrators that can take a model, each over a range of settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..integrators import RK4, Collocation, Dop853, ExplicitRK, GeneralizedAlpha, Idas, Rosenbrock
from ..model.model import Model

_TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
_ABSOLUTE = 1e-2  # absolute tolerance, relative to the relative one
_STEPS = (100, 400, 1600, 6400)  # in the run, of methods with fixed steps
_FEW = 60  # states, above which methods that take long in Python are left out


def contenders(
    model: Model, t_end: float, tolerances: Sequence[float] = _TOLERANCES
) -> dict[str, list[Any]]:
    """Integrators by name, for `work_precision`: those that can take the model.

    Fixed steps cut the run into 100 to 6400; explicit methods are left out where the model has
    algebraic unknowns, methods with steps fixed beforehand where it has events.
    """
    pairs = [(rtol, rtol * _ABSOLUTE) for rtol in tolerances]
    steps = [t_end / n for n in _STEPS]
    explicit, plain = not model.n_z, not (model.events or model.dae.updates)
    found: dict[str, list[Any]] = {"Idas": [Idas(*pair) for pair in pairs]}
    if not model.dae.updates:
        found["Rosenbrock"] = [Rosenbrock(*pair) for pair in pairs]
        if explicit:
            found["ExplicitRK"] = [ExplicitRK(*pair) for pair in pairs]
            found["Dop853"] = [Dop853(*pair, max_steps=20_000) for pair in pairs]
    found["GeneralizedAlpha"] = [GeneralizedAlpha(h) for h in steps]
    if plain and explicit:
        found["RK4"] = [RK4(h) for h in steps]
    if plain and model.n_x + model.n_z <= _FEW:
        found["Radau, order 5"] = [Collocation(h, 3, "radau") for h in steps[:3]]
        found["Legendre, order 6"] = [Collocation(h, 3, "legendre") for h in steps[:3]]
    return found
