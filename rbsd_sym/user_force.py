"""User force functions: called once with symbols, turned into one CasADi function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from .symbols import TIME, Leaf, Scalar, is_number, leaves_of, to_array, to_expr

_SIGNATURE = (
    "(mbs, t, item, displacement, rotation, velocity, angular_velocity, stiffness, damping, "
    "rotJ0, rotJ1, offset)"
)


@dataclass(frozen=True, eq=False)
class TracedForce:
    """A user force as a Function (t, strain, rate, A0, A1, leaves) -> force (6, 1).

    `leaves` are the Params and Inputs it uses, its own and those of K, D and offset.
    """

    function: ca.Function
    leaves: tuple[Leaf, ...]

    @property
    def text(self) -> str:
        """The algorithm, line by line."""
        return self.function.str(True)

    @property
    def values(self) -> ca.SX:
        """Column of the leaves' symbols, the last argument of the function."""
        return ca.vertcat(ca.SX(0, 1), *(leaf.expr for leaf in self.leaves))


def trace_force(
    force: Callable[..., Any],
    name: str,
    item: int,
    stiffness: np.ndarray,
    damping: np.ndarray,
    offset: np.ndarray,
) -> TracedForce:
    """Call the user's function once: motions are symbols, numbers of the connector stay numbers.

    Raises:
        TypeError: it branches on a symbol or returns something that is no number.
        ValueError: it does not return 6 numbers, or uses CasADi symbols that are no Param or Input.
    """
    where = f"connector '{name}', force"
    strain, rate = ca.SX.sym("strain", 6), ca.SX.sym("rate", 6)
    A0, A1 = ca.SX.sym("A0", 3, 3), ca.SX.sym("A1", 3, 3)
    try:
        result = force(
            None, TIME, item, to_array(strain[:3]), to_array(strain[3:]), to_array(rate[:3]),
            to_array(rate[3:]), stiffness.copy(), damping.copy(), to_array(A0), to_array(A1),
            offset.copy(),
        )  # fmt: skip
    except (TypeError, AttributeError) as error:
        raise TypeError(
            f"{where}: {error}; it is called as {_SIGNATURE}; symbols know +, -, *, /, **, "
            "comparisons, numpy's functions of one argument and rbsd_sym.where; other functions "
            "come from CasADi, such as casadi.atan2"
        ) from error
    values = _six_numbers(result, where)
    known = [TIME.expr, strain, rate, A0, A1]
    expr = ca.vertcat(*(to_expr(value) for value in values))
    seen = leaves_of(values) | leaves_of([stiffness, damping, offset])
    leaves = tuple(sorted(seen - {TIME}, key=lambda leaf: leaf.name))
    column = ca.vertcat(ca.SX(0, 1), *(leaf.expr for leaf in leaves))
    free = ca.Function("free", [*known, column], [expr], {"allow_free": True}).free_sx()
    if free:
        raise ValueError(
            f"{where}: uses the CasADi symbols {free}; only Params, Inputs and the arguments may "
            "appear; apply numpy functions (np.sin) to them, so that they are recognised"
        )
    return TracedForce(ca.Function("force", [*known, column], [expr]), leaves)


def _six_numbers(result: Any, where: str) -> list[Any]:
    if result is None:
        raise ValueError(f"{where}: returned None; it returns 6 numbers: force x y z, torque x y z")
    if isinstance(result, ca.SX):
        result = list(to_array(ca.vec(result)))
    try:
        values = list(np.asarray(result, dtype=object).reshape(-1))
    except (TypeError, ValueError) as error:
        raise TypeError(f"{where}: returned {result!r}; return a list of 6 numbers") from error
    if len(values) != 6:
        raise ValueError(
            f"{where}: returned {len(values)} numbers; it returns 6: force x y z, torque x y z"
        )
    for i, value in enumerate(values):
        if isinstance(value, ca.SX):
            values[i] = Scalar(value)
        elif not is_number(value):
            raise TypeError(f"{where}: entry {i} is {value!r}; return numbers or expressions")
        elif not isinstance(value, Scalar) and not np.isfinite(value):
            raise ValueError(f"{where}: entry {i} is {value}; numbers are finite")
    return values
