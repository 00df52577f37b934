"""The integrators that are applicable to a model, each over a range of settings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..integrators import RK4, Collocation, Dop853, ExplicitRK, GeneralizedAlpha, Idas, Rosenbrock
from ..model.model import Model

_TOLERANCES = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
_ABSOLUTE = 1e-2  # absolute tolerance over relative tolerance
_STEPS = (100, 400, 1600, 6400)  # number of steps in the run, for methods with fixed steps
_FEW = 60  # states and unknowns, up to which collocation is worth its time in Python


def contenders(
    model: Model, t_end: float, tolerances: Sequence[float] = _TOLERANCES
) -> dict[str, list[Any]]:
    """Return the integrators that are applicable to a model, as `work_precision` takes them.

    Explicit methods are left out if the model has algebraic unknowns; RK4 and collocation, whose
    steps are fixed beforehand, if it has events; all but `Idas` and `GeneralizedAlpha` if it has
    post-Newton steps; collocation if the model is large. Fixed steps divide the run into 100, 400,
    1600 and 6400.

    >>> rs.study.work_precision(model, rs.study.contenders(model, 2.0), 2.0)

    Arguments:
        model: what `compile_scene` returns.
        t_end: length of the run, s, which the fixed steps divide.
        tolerances: relative tolerances; the absolute ones are a hundredth of them.

    Returns:
        Lists of integrators, by the name of the method.
    """
    # RK4 and collocation neither locate events nor run post-Newton steps.
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
