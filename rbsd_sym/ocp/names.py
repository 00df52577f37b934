"""Quantities of a model by name, as the expressions of a problem see them."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from ..base.symbols import TIME, Scalar, is_number, to_expr
from ..model.model import Model
from .problem import Expression


class LeftOut(Exception):
    """A quantity that the minimal model does not know."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class Names:
    """What a function of a cost or condition is called with: `v[name]` is a quantity of the model.

    States, algebraic unknowns, Inputs and Params are `Scalar`s, outputs are `Scalar`s or arrays of
    them in their shape; `v["t"]` is the time. Arithmetic, numpy functions and `where` work on them.
    """

    def __init__(self, model: Model) -> None:
        self._model = model
        dae = model.dae
        groups = (
            (dae.x_labels, dae.x),
            (dae.z_labels, dae.z),
            (dae.u_labels, dae.u),
            (dae.p_labels, dae.p),
            (dae.idle_p_labels, dae.idle_p),
        )
        self._scalars = {"t": dae.t}
        for labels, column in groups:
            self._scalars |= {label.name: column[i] for i, label in enumerate(labels)}
        self._units = {"t": "s"} | {v.name: v.unit for labels, _ in groups for v in labels}

    def __getitem__(self, name: str) -> Any:
        column, shape = self.column(name)
        cells = np.empty(column.numel(), dtype=object)
        cells[:] = [Scalar(cell) for cell in ca.vertsplit(column)]
        return cells[0] if shape == () else cells.reshape(shape)

    def column(self, name: str) -> tuple[ca.SX, tuple[int, ...]]:
        """A quantity as a column, row by row, and its shape.

        Raises:
            LeftOut: the minimal model does not know it.
            ValueError: there is no such quantity.
        """
        model = self._model
        if name in self._scalars:
            return self._scalars[name], ()
        if name in {d.name for d in model.dropped}:
            raise LeftOut(name)
        if name in model.left_out:
            labels = model.dae.expansion.labels if model.dae.expansion else ()
            row = [label.name for label in labels].index(name)
            return model.expression("states")[row], ()
        if name not in model.dae.outputs:
            raise ValueError(f"model '{model.name}': no '{name}'; {self._near(str(name))}")
        try:
            return model.dae.output(name), model.dae.outputs[name].shape
        except ValueError as error:
            raise LeftOut(name) from error

    def known_unit(self, name: str) -> str:
        """Unit of a state of the full scene, also of one that was left out."""
        way = self._model.dae.expansion
        labels = way.labels if way else self._model.x_labels
        return next((label.unit for label in labels if label.name == name), "")

    def unit(self, name: str) -> str:
        """Unit of a quantity."""
        output = self._model.dae.outputs.get(name)
        return output.unit if output else self._units.get(name, "")

    def components(self, name: str) -> tuple[str, ...]:
        """Names of the components of a quantity, ("",) for a scalar."""
        output = self._model.dae.outputs.get(name)
        return output.components if output else ("",)

    def _near(self, name: str) -> str:
        every = [*self._scalars, *self._model.left_out, *self._model.dae.outputs]
        owner = name.split(".")[0]
        near = [key for key in every if key.split(".")[0] == owner and "." in key]
        if near:
            return f"of '{owner}' there are: {', '.join(near)}"
        owners = dict.fromkeys(key.split(".")[0] for key in every)
        return f"there are: {', '.join(owners)}"


def trace(names: Names, expression: Expression, where: str) -> ca.SX:
    """An expression over the symbols of the model, a scalar.

    Raises:
        LeftOut: it needs what the minimal model does not know.
        ValueError, TypeError: unknown names, a value that is no number, or foreign symbols.
    """
    value: Any = expression
    if isinstance(expression, str):
        value = names[expression]
    elif callable(expression):
        value = expression(names)
    array = np.asarray(value, dtype=object)
    if array.shape in ((), (1,)):
        value = array.reshape(-1)[0]
    if not is_number(value):
        shape = f" of shape {array.shape}" if array.shape else ""
        raise TypeError(
            f"{where}: {type(value).__name__}{shape}; it is one number; pick a component, or sum "
            "over them"
        )
    return _checked(names, value, where)


def _checked(names: Names, value: Any, where: str) -> ca.SX:
    own = {str(key): column for key, column in names._scalars.items()}
    for leaf in value.leaves if isinstance(value, Scalar) else ():
        mine = leaf is TIME or (leaf.name in own and ca.is_equal(own[leaf.name], leaf.expr))
        if not mine:
            raise ValueError(
                f"{where}: {type(leaf).__name__} '{leaf.name}' is not of this model; use the ones "
                "its scene was made with"
            )
    return ca.SX(to_expr(value))
