"""Derivatives of a simulation by parameters, constant inputs and start values.

CasADi's integrators give the derivatives of the states; those of algebraic unknowns and outputs
follow by the chain rule from exact Jacobians. Start values that depend on a parameter contribute.
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
from .wrt import Directions, Measure

__all__ = ["Sensitivity", "sensitivity"]


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Derivatives of outputs by parameters, inputs and start values, as `sensitivity` returns them.

    `found["body.position"]` is an array (n, 3, n_wrt) over the output times in forward mode, and
    (3, n_wrt) at the end in adjoint mode; for a state it is (n, n_wrt), or (n_wrt,). Units are
    those of the output, divided by those of the names in `wrt`.

    Fields:
        trajectory: the simulation that was differentiated.
        wrt: names, units and values of what it was differentiated by, in the order of the last
            axis.
        derivatives: arrays by name of output.
        units: of the outputs, by name.
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
        """Return the derivative of one output by one name.

        Arguments:
            output: name of an output that was asked for.
            wrt: name of a parameter, input or state in `wrt`.

        Returns:
            An array (n, ...) in forward mode, (...) in adjoint mode.

        Raises:
            ValueError: it was not asked for.

        >>> found.by("arm.position", "k")[-1]  # doctest: +SKIP
        """
        names = [label.name for label in self.wrt]
        if wrt not in names:
            raise ValueError(
                f"sensitivity of '{self.trajectory.name}': no derivative by '{wrt}', but by "
                f"{', '.join(names)}; add it to wrt"
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
    """Simulate, and differentiate outputs and states by parameters, inputs and start values.

    Arguments:
        times, inputs, params, start: as for `simulate`.
        wrt: names of parameters, of inputs that are constant, and of states, meaning their start
            values. The derivative by a parameter includes its effect on start values that depend on
            it, except on those given in `start` or named in `wrt`. The components of a quaternion
            are varied one by one, without normalisation.
        outputs: names of outputs and states.
        mode: "forward" returns each derivative at every output time, at a cost that grows with the
            number of names in wrt; "adjoint" only those at the end, at a cost that grows with the
            number of entries of the outputs.
        integrator: `Idas()` by default, which controls the error of the derivatives, too;
            `Collocation` or `RK4`, which give the exact derivative of the discrete solution;
            `Rosenbrock` or `ExplicitRK` likewise, but only with a `max_step`, since they choose
            their steps by the states alone.

    Raises:
        TypeError: `model` is not a model, or `integrator` is a class or a name.
        ValueError: unknown names, a model with events or post-Newton steps, an input that is a
            function CasADi cannot trace, an integrator or a mode that is not supported.
        IntegrationError: the integration failed, or that of the derivatives.

    >>> found = sensitivity(model, 2.0, ["k"], ["arm.position"])  # doctest: +SKIP
    >>> found["arm.position"].shape                               # doctest: +SKIP
    (201, 3, 1)
    """
    as_model(model, "sensitivity")
    if mode not in ("forward", "adjoint"):
        raise ValueError(f"sensitivity: mode {mode!r}; give 'forward' or 'adjoint'")
    method = as_integrator(integrator, "sensitivity")
    experiment = make_experiment(model, times, inputs, params, start)
    _check(model, experiment, method)
    names = _names("wrt", wrt), _names("outputs", outputs)
    directions = Directions(model, experiment, names[0], start)
    measures = [Measure.of(model, name) for name in names[1]]
    trajectory = simulate(model, times, method, inputs=inputs, params=params, start=start)
    # Compiled functions have no derivatives of their own.
    run = Flow(model.plain, experiment, method, directions, trajectory)
    found = run.forward(measures) if mode == "forward" else run.adjoint(measures)
    units = {m.name: m.unit for m in measures}
    return Sensitivity(trajectory, directions.labels, found, units)


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
            f"{where}: {what}; derivatives across jumps are not supported; give its effects "
            "smoothing, or take differences of simulations"
        )
    if model.n_x == 0:
        raise ValueError(f"{where}: the model has no states; use the Jacobians of its functions")
    for label, signal in zip(model.dae.u_labels, experiment.inputs, strict=True):
        if callable(signal) and symbolic(signal, model.dae.t) is None:
            raise ValueError(
                f"{where}, input '{label.name}': a function that takes floats only has no exact "
                "derivative by t; use numpy functions and `where` in place of `if`, or samples"
            )
    if type(method) not in PLUGINS:
        served = ", ".join(kind.__name__ for kind in PLUGINS)
        raise ValueError(
            f"{where}: {type(method).__name__} does not support derivatives; use one of {served}"
        )
