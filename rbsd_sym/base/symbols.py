"""Symbolic numbers of a scene: `Param`, `Input`, `TIME`, and what arithmetic makes of them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any, TypeAlias, Union

import casadi as ca
import numpy as np

from .names import check_identifier

Expr: TypeAlias = ca.SX


class Scalar:
    """One symbolic number that mixes with floats and numpy arrays from both sides.

    A scene number that is no plain float is a `Scalar`; a user function of a connector is called
    with arrays of them. numpy functions (`np.sin`, `np.sqrt`, `np.tanh`, ...) and CasADi functions
    both work. A `Scalar` has no truth value: a branch is written with `where`.
    """

    __slots__ = ("expr", "leaves")

    def __init__(self, expr: Expr, leaves: frozenset[Leaf] = frozenset()) -> None:
        self.expr = expr
        self.leaves = leaves

    def __SX__(self) -> Expr:  # CasADi's own hook for foreign scalars
        return self.expr

    def _apply(self, other: object, function: Any, swap: bool = False) -> Any:
        if not is_number(other):
            return NotImplemented
        a, b = (other, self) if swap else (self, other)
        return Scalar(function(to_expr(a), to_expr(b)), self.leaves | leaves_of(other))

    def __add__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a + b)

    def __radd__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a + b, swap=True)

    def __sub__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a - b)

    def __rsub__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a - b, swap=True)

    def __mul__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a * b)

    def __rmul__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a * b, swap=True)

    def __truediv__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a / b)

    def __rtruediv__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a / b, swap=True)

    def __pow__(self, other: object) -> Scalar:
        return self._apply(other, ca.power)

    def __rpow__(self, other: object) -> Scalar:
        return self._apply(other, ca.power, swap=True)

    def __mod__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a - b * ca.floor(a / b))

    def __lt__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a < b)

    def __le__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a <= b)

    def __gt__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a > b)

    def __ge__(self, other: object) -> Scalar:
        return self._apply(other, lambda a, b: a >= b)

    def __eq__(self, other: object) -> Any:
        return self._apply(other, lambda a, b: a == b)

    def __ne__(self, other: object) -> Any:
        return self._apply(other, lambda a, b: a != b)

    __hash__ = object.__hash__  # a symbol is kept in sets by identity; == is a condition

    def __neg__(self) -> Scalar:
        return Scalar(-self.expr, self.leaves)

    def __pos__(self) -> Scalar:
        return self

    def __abs__(self) -> Scalar:
        return Scalar(ca.fabs(self.expr), self.leaves)

    def arctan2(self, other: object) -> Scalar:
        """atan2(self, other), the name numpy looks up for `np.arctan2`."""
        return self._apply(other, ca.atan2)

    def __bool__(self) -> bool:
        raise TypeError(
            f"'{self.expr}' is a symbol and has no truth value, so Python's if, and, or, min, max "
            "cannot branch on it; write rbsd_sym.where(condition, value_if_true, value_if_false)"
        )

    def __float__(self) -> float:
        if self.expr.is_constant():
            return float(self.expr)
        raise TypeError(
            f"'{self.expr}' is a symbol, not a number; use numpy functions (np.sin) instead of "
            "those of math, and do not convert with float()"
        )

    def __repr__(self) -> str:
        return str(self.expr)


def _unary(function: Any) -> Any:
    return lambda self: Scalar(function(self.expr), self.leaves)


# numpy calls the method of the ufunc's name on each object of an object array.
for _name, _function in {
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": ca.tan,
    "arcsin": ca.asin,
    "arccos": ca.acos,
    "arctan": ca.atan,
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "exp": ca.exp,
    "log": ca.log,
    "log10": ca.log10,
    "sqrt": ca.sqrt,
    "fabs": ca.fabs,
    "sign": ca.sign,
    "floor": ca.floor,
    "ceil": ca.ceil,
    "square": lambda a: a * a,
    "log1p": ca.log1p,
    "expm1": ca.expm1,
}.items():
    setattr(Scalar, _name, _unary(_function))


_UNIT = re.compile(r"[\w .^*/()%-]{0,32}")


class Leaf(Scalar):
    """A named symbol of the scene; equal only to itself."""

    __slots__ = ("name", "unit", "value")

    def __init__(self, name: str, value: float, unit: str) -> None:
        check_identifier(name, type(self).__name__.lower())
        if not isinstance(value, (int, float, np.integer, np.floating)) or not np.isfinite(value):
            raise ValueError(
                f"{type(self).__name__.lower()} '{name}': value {value!r}; it must be one finite "
                "number; give a float"
            )
        if not isinstance(unit, str):
            raise TypeError(
                f"{type(self).__name__.lower()} '{name}': unit {unit!r}; it is a string such as "
                "'N/m' (the order is Param(name, value, unit), Input(name, unit, value))"
            )
        if not _UNIT.fullmatch(unit) or "*/" in unit or "/*" in unit:
            raise ValueError(
                f"{type(self).__name__.lower()} '{name}': unit {unit!r}; units are printed into C "
                "comments and tables: at most 32 letters, digits, spaces and .^*/()%-, without "
                "/* or */; write it as 'N m/rad'"
            )
        super().__init__(ca.SX.sym(name))
        self.name, self.unit, self.value = name, unit, float(value)
        self.leaves = frozenset([self])

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError(
            f"{type(self).__name__.lower()} '{self.name}' cannot be copied or sent to another "
            "process, since a symbol is equal only to itself; build the scene there"
        )


class Param(Leaf):
    """A number that stays a symbol in the generated code; `value` is its default."""

    __slots__ = ()

    def __init__(self, name: str, value: float, unit: str = "") -> None:
        super().__init__(name, value, unit)


class Input(Leaf):
    """A number that may vary in time (a force, the offset of a servo); `value` is its default."""

    __slots__ = ()

    def __init__(self, name: str, unit: str = "", value: float = 0.0) -> None:
        super().__init__(name, value, unit)


class _Time(Leaf):
    __slots__ = ()


TIME = _Time("t", 0.0, "s")
"""The time, in s, for numbers that are a known function of it."""

Number = Union[float, int, Scalar]


def where(condition: object, if_true: object, if_false: object) -> Scalar:
    """`if_true` where the condition holds, else `if_false`; both are evaluated (a branch)."""
    parts = (condition, if_true, if_false)
    for part in parts:
        if not is_number(part) and not isinstance(part, (bool, np.bool_)):
            raise TypeError(f"where: {part!r} is not a number; give floats or symbols")
    leaves = frozenset().union(*(leaves_of(part) for part in parts))
    return Scalar(ca.if_else(*(to_expr(part) for part in parts)), leaves)


def is_number(value: object) -> bool:
    """Whether the value is a real number or a `Scalar`."""
    if isinstance(value, Scalar):
        return True
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def leaves_of(value: object) -> frozenset[Leaf]:
    """Every `Param`, `Input` and `TIME` inside a number or a (nested) array of numbers."""
    if isinstance(value, Scalar):
        return value.leaves
    if isinstance(value, np.ndarray):
        if value.dtype != object:
            return frozenset()
        return frozenset().union(*(leaves_of(item) for item in value.flat))
    if isinstance(value, (list, tuple)):
        return frozenset().union(*(leaves_of(item) for item in value))
    return frozenset()


def to_expr(value: Any) -> Expr:
    """A number or an array of numbers (vector or matrix) as an SX of the same shape."""
    if isinstance(value, Scalar):
        return value.expr
    array = np.asarray(value)
    if array.ndim == 0 and array.dtype == object:
        return to_expr(array.item())
    if array.dtype != object:
        return ca.SX(ca.DM(array.astype(float)))
    rows = np.atleast_2d(array.T).T if array.ndim == 1 else array
    return ca.vertcat(*(ca.horzcat(*(to_expr(item) for item in row)) for row in rows))


def to_array(expr: Expr) -> np.ndarray:
    """An SX as an object array of `Scalar`; a column becomes one-dimensional."""
    out: np.ndarray = np.empty(expr.shape, dtype=object)
    for i in range(expr.shape[0]):
        for j in range(expr.shape[1]):
            out[i, j] = Scalar(ca.SX(expr[i, j]))
    return out[:, 0] if expr.shape[1] == 1 else out


def default_values(expr: Expr, leaves: Iterable[Leaf]) -> np.ndarray:
    """The expression with each leaf at its default value, as floats of the same shape."""
    chosen = list(leaves)
    symbols = [leaf.expr for leaf in chosen]
    values = [leaf.value for leaf in chosen]
    return (
        np.array(ca.Function("defaults", symbols, [expr])(*values))
        if chosen
        else np.array(ca.DM(expr))
    )
