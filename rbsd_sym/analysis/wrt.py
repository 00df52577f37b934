"""Numerators and denominators of derivatives: outputs, and the names in `wrt`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ..dae.members import Label
from ..model.model import Model
from ..model.signals import is_constant
from ..model.values import Experiment, Start

# Names listed in an error message, at most.
_LISTED = 30


class Directions:
    """Derivatives of start states, parameters and inputs by the names in `wrt`.

    Fields:
        labels: names, units and values of what derivatives are by, (n_wrt).
        x, p, u, idle: derivatives of start states (n_x, n_wrt), parameters (n_p, n_wrt), inputs
            (n_u, n_wrt) and parameters without effect on the states; one column for each name.

    Raises:
        ValueError: a name is unknown, or an input that varies in time.
    """

    def __init__(self, model: Model, e: Experiment, names: list[str], start: Start | None) -> None:
        dae, n = model.dae, len(names)
        groups = (dae.x_labels, dae.p_labels, dae.u_labels, dae.idle_p_labels)
        self.x, self.p, self.u, self.idle = (np.zeros((len(g), n)) for g in groups)
        u = [float(s) if is_constant(s) else np.nan for s in e.inputs]  # type: ignore[arg-type]
        values, labels = (e.x, e.p, np.array(u), e.idle), []
        for k, name in enumerate(names):
            group, row = _find(model, name, groups)
            if group == 2 and np.isnan(u[row]):
                raise ValueError(
                    f"sensitivity of '{model.name}': input '{name}' varies in time, and so has no "
                    "single value to differentiate by; write it with a Param, and use that"
                )
            (self.x, self.p, self.u, self.idle)[group][row, k] = 1.0
            labels.append(replace(groups[group][row], start=float(values[group][row])))
        self.labels = tuple(labels)
        # A start value may be an expression of parameters. It follows them unless it was given, or
        # is itself what derivatives are by.
        moved = np.array(ca.DM(_start_slope(model)(e.p))) @ self.p
        every = [label.name for label in dae.x_labels]
        given = () if start is None else start if isinstance(start, Mapping) else every
        fixed = {*given, *names}
        kept = [i for i, name in enumerate(every) if name not in fixed]
        self.x[kept] += moved[kept]

    @property
    def scale(self) -> np.ndarray:
        """Typical size (n_wrt,) of a change of each: its absolute value, or 1 where that is 0."""
        values = np.abs([label.start for label in self.labels])
        return np.where(values > 0, values, 1.0)


def _find(model: Model, name: str, groups: Sequence[Sequence[Label]]) -> tuple[int, int]:
    for group, labels in enumerate(groups):
        for row, label in enumerate(labels):
            if label.name == name:
                return group, row
    left = {d.name for d in model.dropped} | {r.name for r in model.replaced}
    left |= {label.name for label in model.dae.z_labels}
    if name in left:
        raise ValueError(
            f"sensitivity of '{model.name}': '{name}' has no start value of its own in this model; "
            "compile_scene(minimal=False) keeps states that never move"
        )
    there = ", ".join([label.name for labels in groups for label in labels][:_LISTED])
    raise ValueError(
        f"sensitivity of '{model.name}': no parameter, input or state '{name}'; there are: {there}"
    )


def _start_slope(model: Model) -> ca.Function:
    """Build the Function p -> derivative (n_x, n_p) of the start states by p."""
    dae = model.dae
    return ca.Function("start_slope", [dae.p], [ca.jacobian(dae.x_start, dae.p)])


class Measure(NamedTuple):
    """An output or a state with its derivatives.

    Fields:
        name, unit, shape: of the quantity; the shape of a state is ().
        slopes: Function (t, x, z, u, all parameters) -> dense derivatives by x, z, u and all
            parameters, one row for each entry.
    """

    name: str
    unit: str
    shape: tuple[int, ...]
    slopes: ca.Function

    @staticmethod
    def of(model: Model, name: str) -> Measure:
        """Build the `Measure` of an output or state.

        Raises:
            ValueError: there is none of that name.
        """
        dae = model.dae
        labels = (*dae.x_labels, *dae.z_labels)
        every = ca.vertcat(dae.x, dae.z)
        place = {label.name: i for i, label in enumerate(labels)}
        shape: tuple[int, ...] = ()
        if name in place:
            expr, unit = every[place[name]], labels[place[name]].unit
        elif name in model.left_out and dae.expansion:
            row = [label.name for label in dae.expansion.labels].index(name)
            expr, unit = dae.measured[row], dae.expansion.labels[row].unit
        else:
            expr = dae.output(name)
            unit, shape = dae.outputs[name].unit, dae.outputs[name].shape
        p = dae.parameters.symbols
        jacobians = [ca.densify(ca.jacobian(expr, v)) for v in (dae.x, dae.z, dae.u, p)]
        slopes = ca.Function("slopes", [dae.t, dae.x, dae.z, dae.u, p], jacobians, {"cse": True})
        return Measure(name, unit, shape, slopes)
