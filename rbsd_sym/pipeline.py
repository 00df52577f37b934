"""The spine: from a scene to a model, from a model to a trajectory. Read this file first.

    Scene --write--> Dae --derive--> Model --solve--> Trajectory
                                       +----write--> files (exports)

A scene knows bodies, a Dae knows t x z u p and expressions of them, a Model knows functions. Each
stage takes a frozen value and gives a frozen value.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from .base.symbols import is_number
from .formulations import ModelWarning, Quaternion
from .formulations.in_plane import Formulation, smallest
from .integrators import Idas
from .minimal import balance
from .model.model import Model, derive
from .model.trajectory import Experiment, Outcome, Samples, Signal, Trajectory
from .model.values import check_kept, check_known, filled
from .scene.scene import Scene

_DEFAULT_INTERVALS = 200
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
    times: float | Sequence[float] | np.ndarray,
    integrator: Integrator | None = None,
    inputs: Mapping[str, Any] | None = None,
    params: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
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
        start: values of states by name; the others keep theirs.
        throw: raise a failure; otherwise it is data in `trajectory.outcome`.
        throw_unstable: raise, too, if a motion that a minimal model left out is unstable.

    Raises:
        ValueError: unknown names, times that do not increase.
        IntegrationError: the integration failed; it carries the trajectory up to there.

    A motion that a minimal model left out and that is unstable is warned of, and is the outcome.
    """
    if isinstance(integrator, type):
        raise TypeError(
            f"simulate: integrator {integrator.__name__}; give an object, such as Idas()"
        )
    experiment = make_experiment(model, times, inputs or {}, params or {}, start or {})
    trajectory = across_reduction(model, (integrator or Idas()).solve(model, experiment))
    unstable = trajectory.outcome is Outcome.unstable_across_reduction
    if (throw and not trajectory.outcome.ok) or (throw_unstable and unstable):
        raise IntegrationError(trajectory)
    if unstable:
        warnings.warn(f"{model.name}: {trajectory.report}", ModelWarning, stacklevel=2)
    return trajectory


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


def make_experiment(
    model: Model,
    times: float | Sequence[float] | np.ndarray,
    inputs: Mapping[str, Any],
    params: Mapping[str, float],
    start: Mapping[str, float],
) -> Experiment:
    """Everything by name turned into vectors, and checked."""
    dae = model.dae
    every = dae.parameters.labels
    values = filled(model, "parameter", every, [v.start for v in every], params)
    p, idle = values[: model.n_p], values[model.n_p :]
    x, z = dae.start_values(p)
    labels = (*dae.x_labels, *dae.z_labels)
    check_kept(model, start, "start")
    xz = filled(model, "state", labels, np.concatenate([x, z]), start)
    check_known(model, "input", dae.u_labels, inputs)
    where = f"model '{model.name}', input"
    signals = tuple(
        signal_of(inputs.get(v.name, v.start), f"{where} '{v.name}'", v.unit) for v in dae.u_labels
    )
    return Experiment(_times(times), xz[: model.n_x], xz[model.n_x :], p, signals, idle)


def signal_of(value: Any, where: str, unit: str) -> Signal:
    """A number, a function of t, or samples (times, values), checked.

    Raises:
        ValueError: it is none of them, or not finite.
    """
    if callable(value):
        return value
    if is_number(value):
        if not np.isfinite(float(value)):
            raise ValueError(f"{where}: {value} {unit}; give a finite number")
        return float(value)
    try:
        t, samples = (np.array(part, float) for part in value)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"{where}: {value!r}; give a number, a function of t, or samples (times, values)"
        ) from error
    good = t.ndim == 1 and t.shape == samples.shape and len(t) > 1 and bool((np.diff(t) > 0).all())
    if not good or not (np.isfinite(t).all() and np.isfinite(samples).all()):
        raise ValueError(
            f"{where}: samples of shape {t.shape} and {samples.shape}; times increase, values are "
            "finite, both have one length of at least 2"
        )
    return Samples(t, samples)


def _times(times: float | Sequence[float] | np.ndarray) -> np.ndarray:
    if is_number(times):
        if not (np.isfinite(float(times)) and float(times) > 0):  # type: ignore[arg-type]
            raise ValueError(f"simulate: t_end {times} s; the end is positive and finite")
        return np.linspace(0.0, float(times), _DEFAULT_INTERVALS + 1)  # type: ignore[arg-type]
    grid = np.array(times, float)
    if grid.ndim != 1 or len(grid) < 2 or not np.isfinite(grid).all() or (np.diff(grid) <= 0).any():
        raise ValueError(
            f"simulate: output times of shape {grid.shape}; they are at least two finite numbers "
            "that increase, the first is the start"
        )
    return grid
