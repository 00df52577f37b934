"""The spine: from a scene to a model, from a model to a trajectory. Read this file first.

    Scene --write--> Dae --derive--> Model --solve--> Trajectory
                                       +----write--> files (exports)

A `Scene` describes bodies and connectors; a `Dae` is a set of expressions of t, x, z, u, p; a
`Model` holds their functions and derivatives; a `Trajectory` holds numbers. Each stage takes a
frozen value and returns another one.
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

# Exponent of growth over a run; a disturbance that grows by less (to 1.22 times) is not reported.
_GROWTH_WORTH_A_WARNING = 0.2


class Integrator(Protocol):
    """A method of integration with its options, such as `Idas(rtol=1e-8)`.

    Failures of the integration are data (`trajectory.outcome`), not exceptions; only a model that
    the method cannot integrate raises a ValueError.
    """

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate an experiment; return the trajectory, up to the failure if there was one."""
        ...


class IntegrationError(RuntimeError):
    """Raised by `simulate` when an integration fails.

    The message is the report of the run: what happened, when, the state with the largest rate, and
    what to change. `error.trajectory` holds the states that were reached, with outcome and report;
    `simulate(..., throw=False)` returns it instead of raising.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        super().__init__(f"{trajectory.name}: {trajectory.report}")
        self.trajectory = trajectory

    def __reduce__(self) -> tuple[type[IntegrationError], tuple[Trajectory]]:
        return IntegrationError, (self.trajectory,)


# Names of `layout` -> the argument `kernels` of `derive`.
_LAYOUTS = {"auto": None, "flat": False, "kernels": True}


def compile_scene(
    scene: Scene, formulation: Formulation | None = None, minimal: bool = True, layout: str = "auto"
) -> Model:
    """Compile a scene into a model: its equations of motion with exact derivatives.

    Arguments:
        scene: bodies, connectors, loads, gravity and requested outputs.
        formulation: the coordinates, `Quaternion()` by default.
        minimal: leave out the states that provably never move, and describe a body that rotates
            about one axis by one angle. Trajectories and outputs keep their full meaning, and
            `print(model)` lists what was left out and why. The motion that was left out may be
            unstable; `simulate` reports that.
        layout: "flat" writes every function as one expression, "kernels" maps one kernel for each
            kind of part over its instances, "auto" chooses the latter for large models. The numbers
            are the same.

    Raises:
        ValueError: the scene cannot be written in these coordinates, or the layout is unknown.

    >>> model = compile_scene(scene)                     # doctest: +SKIP
    >>> model.function("dode_dx")(0.0, x, z, u, p)       # doctest: +SKIP
    """
    if not isinstance(scene, Scene):
        raise TypeError(f"compile_scene: scene is a {type(scene).__name__}; give a Scene")
    if layout not in _LAYOUTS:
        raise ValueError(f"compile_scene: layout {layout!r}; give one of {', '.join(_LAYOUTS)}")
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
    """Integrate a model over time.

    Arguments:
        times: the end time in s (from 0, with 200 output intervals), or increasing output times, of
            which the first is the start.
        integrator: the method with its options, `Idas()` by default.
        inputs: by name: a number, a function of t in s, or samples (times, values), which are
            interpolated linearly and constant outside.
        params: values by name; the others keep their default.
        start: values of states by name (the others keep theirs), or an `Equilibrium` or `Point`.
        throw: raise an error on failure; otherwise the failure is data in `trajectory.outcome`.
        throw_unstable: also raise an error if a motion that a minimal model left out is unstable.

    Returns:
        States, inputs and outputs by name; outputs are evaluated on first use. If a motion that
        the minimal model left out is unstable along the trajectory, that is its outcome, and a
        `ModelWarning` is issued.

    Raises:
        TypeError: a scene in place of a model, a class or name in place of an integrator.
        ValueError: unknown names, times that do not increase, a model that the method cannot
            integrate (algebraic unknowns, events).
        IntegrationError: the integration failed; it carries the trajectory up to there.

    >>> trajectory = simulate(model, 2.0, Idas(rtol=1e-10), inputs={"pull": lambda t: 3 * t},
    ...                       params={"k": 3e4}, start={"arm.p_x": 0.1})  # doctest: +SKIP
    >>> trajectory["arm.position"][-1]                                    # doctest: +SKIP
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
    """Return the integrator that a caller gave, or `Idas()` for None.

    Arguments:
        given: an object with a method `solve`.
        where: name of the function that was called, for the message.

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
    """Check the stability of the states that a minimal model left out, along a trajectory.

    Returns:
        The trajectory; if a small disturbance of these states grows by more than a factor of
        exp(0.2) over the run, with the outcome `unstable_across_reduction` and its report. A
        trajectory that did not reach its end is returned as it is.
    """
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
