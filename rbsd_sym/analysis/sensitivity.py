"""Derivatives of a simulation by parameters, constant inputs and start values.

CasADi's integrators give the derivatives of the states; those of algebraic unknowns and outputs
follow by the chain rule from exact Jacobians. Start values that depend on a parameter count.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..dae.members import Label
from ..model.model import Model
from ..model.signals import Inputs, symbolic
from ..model.trajectory import Trajectory
from ..model.values import Experiment, Params, Start, Times, as_model, make_experiment
from ..pipeline import Integrator, as_integrator, simulate
from .flow import Flow
from .flow_options import PLUGINS
from .wrt import Measure, Way

__all__ = ["Sensitivity", "sensitivity"]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of outputs by parameters, inputs and start values.

    `sensitivity["body.position"]` is an array (n, 3, n_wrt) over the output times in forward mode,
    (3, n_wrt) at the end in adjoint mode; of a state (n, n_wrt), or (n_wrt,).

    Fields:
        trajectory: what was differentiated.
        wrt: names, units and values of what it was differentiated by.
        derivatives: by the name of the output.
        units: of each output.
    """

    trajectory: Trajectory
    wrt: tuple[Label, ...]
    derivatives: Mapping[str, np.ndarray]
    units: Mapping[str, str]

    @property
    def t(self) -> np.ndarray:
        """Output times (n,), s."""
        return self.trajectory.t

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.derivatives:
            raise ValueError(
                f"sensitivity of '{self.trajectory.name}': no output '{name}'; there are: "
                + ", ".join(self.derivatives)
            )
        return self.derivatives[name]

    def __repr__(self) -> str:
        wrt = ", ".join(label.name for label in self.wrt)
        return f"<Sensitivity of {', '.join(self.derivatives)} by {wrt}>"

    def by(self, output: str, wrt: str) -> np.ndarray:
        """Derivative of one output by one name.

        Raises:
            ValueError: it was not asked for.
        """
        names = [label.name for label in self.wrt]
        if wrt not in names:
            raise ValueError(
                f"sensitivity of '{self.trajectory.name}': not by '{wrt}', but by "
                + ", ".join(names)
            )
        return self[output][..., names.index(wrt)]


def sensitivity(
    model: Model,
    times: Times,
    wrt: Sequence[str],
    outputs: Sequence[str],
    mode: str = "forward",
    integrator: Integrator | None = None,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
) -> Sensitivity:
    """Derivatives of outputs along a simulation.

    Arguments:
        times, inputs, params, start: as for `simulate`.
        wrt: names of parameters, of inputs that are constant, and of states, meaning their start
            values. The derivative by a parameter includes what it does to start values, but for
            those in `start` and in `wrt`. A component of a quaternion moves alone.
        outputs: names of outputs and states.
        mode: "forward" gives each derivative at every output time, at a cost that grows with the
            number of names in wrt; "adjoint" gives those at the end alone, at a cost that grows
            with the number of entries of the outputs.
        integrator: `Idas()` by default, which controls the error of the derivatives, too;
            `Collocation`, `RK4`: the exact derivative of the discrete solution; `Rosenbrock` and
            `ExplicitRK` likewise, with a `max_step`, since the states alone choose their steps.

    Raises:
        ValueError: unknown names, a model with events or post-Newton steps, an input that is a
            function CasADi cannot trace, an integrator or a mode that is not served.
        IntegrationError: the integration failed, or its derivatives did.
    """
    as_model(model, "sensitivity")
    if mode not in ("forward", "adjoint"):
        raise ValueError(f"sensitivity: mode {mode!r}; it is 'forward' or 'adjoint'")
    method = as_integrator(integrator, "sensitivity")
    experiment = make_experiment(model, times, inputs, params, start)
    _check(model, experiment, method)
    names = _names("wrt", wrt), _names("outputs", outputs)
    way = Way(model, experiment, names[0], start)
    measures = [Measure.of(model, name) for name in names[1]]
    trajectory = simulate(model, times, method, inputs=inputs, params=params, start=start)
    # Compiled functions have no derivatives of their own.
    run = Flow(model.plain, experiment, method, way, trajectory)
    found = run.forward(measures) if mode == "forward" else run.adjoint(measures)
    units = {m.name: m.unit for m in measures}
    return Sensitivity(trajectory, way.labels, found, units)


def _names(what: str, given: Sequence[str]) -> list[str]:
    names = [given] if isinstance(given, str) else list(given)
    if not names or len(set(names)) < len(names):
        raise ValueError(f"sensitivity: {what} {names}; give at least one name, each once")
    return names


def _check(model: Model, experiment: Experiment, method: Any) -> None:
    where = f"sensitivity of '{model.name}'"
    if model.events or model.dae.updates:
        what = f"events ({', '.join(model.events[:5])})" if model.events else "post_newton_step"
        raise ValueError(
            f"{where}: {what}; derivatives across jumps are not served here; give its effects "
            "smoothing, or differentiate an exported simulator"
        )
    if model.n_x == 0:
        raise ValueError(f"{where}: the model has no states; take the Jacobians of its functions")
    for label, signal in zip(model.dae.u_labels, experiment.inputs, strict=True):
        if callable(signal) and symbolic(signal, model.dae.t) is None:
            raise ValueError(
                f"{where}, input '{label.name}': a function that takes floats only has no exact "
                "derivative by t; use numpy functions and `where` in place of `if`, or samples"
            )
    if type(method) not in PLUGINS:
        served = ", ".join(kind.__name__ for kind in PLUGINS)
        raise ValueError(
            f"{where}: {type(method).__name__} gives no derivatives here; use one of {served}"
        )
