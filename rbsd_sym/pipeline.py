"""The spine: from a scene to a model, from a model to a trajectory. Read this file first.

    Scene --write--> Dae --derive--> Model --solve--> Trajectory
                                       +----write--> files (exports)

A scene knows bodies, a Dae knows t x z u p and expressions of them, a Model knows functions. Each
stage takes a frozen value and gives a frozen value.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from .formulations import ModelWarning, Quaternion
from .formulations.in_plane import Formulation, smallest
from .integrators import Idas
from .minimal import balance
from .model.model import Model, derive
from .model.signals import Inputs
from .model.trajectory import Outcome, Trajectory
from .model.values import Experiment, Params, Start, Times, make_experiment
from .scene.scene import Scene

_GROWTH_WORTH_A_WARNING = 0.2  # exponent: a disturbance that grows by less than a fifth is none


class Integrator(Protocol):
    """A method: solves an experiment; failures are outcomes, not exceptions."""

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """The trajectory, up to a failure if there is one."""
        ...


class IntegrationError(RuntimeError):
    """An integration that failed; `trajectory` holds what was reached, with outcome and report."""

    def __init__(self, trajectory: Trajectory) -> None:
        super().__init__(f"{trajectory.name}: {trajectory.report}")
        self.trajectory = trajectory

    def __reduce__(self) -> tuple[type[IntegrationError], tuple[Trajectory]]:
        return IntegrationError, (self.trajectory,)


_LAYOUTS = {"auto": None, "flat": False, "kernels": True}


def compile_scene(
    scene: Scene, formulation: Formulation | None = None, minimal: bool = True, layout: str = "auto"
) -> Model:
    """The model of a scene.

    Arguments:
        formulation: coordinates, `Quaternion()` by default.
        minimal: leave out the states that provably never move, and give a body that turns about
            one axis one angle (`minimal`). Trajectories and outputs keep their full meaning.
        layout: "flat" writes every function out, "kernels" maps one kernel for each kind of part
            over its instances, "auto" takes the latter for large models. The numbers are the same.

    Raises:
        ValueError: the scene cannot be written in these coordinates; no such layout.
    """
    if layout not in _LAYOUTS:
        raise ValueError(f"compile_scene: layout {layout!r}; there are {', '.join(_LAYOUTS)}")
    chosen = formulation or Quaternion()
    if not minimal:
        model = derive(balance(chosen.write(scene)), None, _LAYOUTS[layout])
    else:
        model = derive(*smallest(scene, chosen), _LAYOUTS[layout])
    return replace(model, scene=scene)


def simulate(
    model: Model,
    times: Times,
    integrator: Integrator | None = None,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
    throw: bool = True,
    throw_unstable: bool = False,
) -> Trajectory:
    """Integrate a model.

    Arguments:
        times: the end in s (from 0, 200 intervals), or increasing output times, the first of which
            is the start.
        integrator: `Idas()` by default.
        inputs: by name: a number, a function of t, or samples (times, values), which are linear
            between and constant outside.
        params: values by name; the others keep their default.
        start: values of states by name (the others keep theirs), or an `Equilibrium`.
        throw: raise a failure; otherwise it is data in `trajectory.outcome`.
        throw_unstable: raise, too, if a motion that a minimal model left out is unstable.

    Raises:
        TypeError: a scene in place of a model, a name in place of an integrator.
        ValueError: unknown names, times that do not increase.
        IntegrationError: the integration failed; it carries the trajectory up to there.

    A motion that a minimal model left out and that is unstable is warned of, and is the outcome.
    """
    experiment = make_experiment(model, times, inputs, params, start)
    trajectory = across_reduction(model, as_integrator(integrator).solve(model, experiment))
    unstable = trajectory.outcome is Outcome.unstable_across_reduction
    if (throw and not trajectory.outcome.ok) or (throw_unstable and unstable):
        raise IntegrationError(trajectory)
    if unstable:
        warnings.warn(f"{model.name}: {trajectory.report}", ModelWarning, stacklevel=2)
    return trajectory


def as_integrator(given: Any, where: str = "simulate") -> Integrator:
    """Return the integrator, `Idas()` for None.

    Raises:
        TypeError: it is a class or a name.
    """
    if given is None:
        return Idas()
    if isinstance(given, type) or not hasattr(given, "solve"):
        shown = given.__name__ if isinstance(given, type) else repr(given)
        raise TypeError(f"{where}: integrator {shown}; give an object, such as Idas()")
    return given


def across_reduction(model: Model, trajectory: Trajectory) -> Trajectory:
    """The trajectory, and its outcome if the motion left out is unstable."""
    if trajectory.outcome is not Outcome.reached_end:
        return trajectory
    growth = model.transverse_growth(trajectory)
    if growth.exponent < _GROWTH_WORTH_A_WARNING:
        return trajectory
    outcome = Outcome.unstable_across_reduction
    report = (
        f"{outcome.value}: it grows with {growth.rate:.4g} 1/s at t = {growth.t:.4g} s, by a "
        f"factor of {np.exp(min(growth.exponent, 700.0)):.3g} over the run; "
        "compile with minimal=False and disturb the start"
    )
    return replace(trajectory, outcome=outcome, report=report)
