"""Symbolic numbers of a scene: `Param`, `Input`, `TIME`, and what arithmetic makes of them."""

from __future__ import annotations

import operator
import re
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from typing import Any, TypeAlias, Union
from weakref import WeakValueDictionary

import casadi as ca
import numpy as np

from .elementwise import UFUNCS, interpolated
from .names import check_identifier

Expr: TypeAlias = ca.SX


_SHOWN = 60  # characters of an expression in a message


class SymbolError(TypeError):
    """Python or numpy asks a symbol for a value; the message says what to write instead."""


class Scalar:
    """One symbolic number that mixes with floats and numpy arrays from both sides.

    A scene number that is not a plain float is a `Scalar`; a user function of a connector is called
    with arrays of them. Functions of numpy (`np.sin`, `np.sign`, `np.maximum`, `np.where`,
    `np.interp`, ...) and of CasADi both work. A `Scalar` has no truth value: a branch is written
    with `where`.
    """

    __slots__ = ("expr", "leaves")

    def __init__(self, expr: Expr, leaves: frozenset[Leaf] = frozenset()) -> None:
        self.expr = expr
        self.leaves = leaves

    def __SX__(self) -> Expr:  # CasADi's own hook for foreign scalars
        return self.expr

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return _call_ufunc(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, types: Any, given: Any, options: Any) -> Any:
        return _call_function(function, given, options)

    def _apply(self, other: object, function: Any, swap: bool = False) -> Any:
        if not _mixes(other):
            return NotImplemented
        return apply(function, other, self) if swap else apply(function, self, other)

    def __add__(self, other: object) -> Scalar:
        return self._apply(other, operator.add)

    def __radd__(self, other: object) -> Scalar:
        return self._apply(other, operator.add, swap=True)

    def __sub__(self, other: object) -> Scalar:
        return self._apply(other, operator.sub)

    def __rsub__(self, other: object) -> Scalar:
        return self._apply(other, operator.sub, swap=True)

    def __mul__(self, other: object) -> Scalar:
        return self._apply(other, operator.mul)

    def __rmul__(self, other: object) -> Scalar:
        return self._apply(other, operator.mul, swap=True)

    def __truediv__(self, other: object) -> Scalar:
        return self._apply(other, operator.truediv)

    def __rtruediv__(self, other: object) -> Scalar:
        return self._apply(other, operator.truediv, swap=True)

    def __pow__(self, other: object) -> Scalar:
        return self._apply(other, ca.power)

    def __rpow__(self, other: object) -> Scalar:
        return self._apply(other, ca.power, swap=True)

    def __mod__(self, other: object) -> Scalar:
        return self._apply(other, UFUNCS["remainder"])

    def __rmod__(self, other: object) -> Scalar:
        return self._apply(other, UFUNCS["remainder"], swap=True)

    def __floordiv__(self, other: object) -> Scalar:
        return self._apply(other, UFUNCS["floor_divide"])

    def __rfloordiv__(self, other: object) -> Scalar:
        return self._apply(other, UFUNCS["floor_divide"], swap=True)

    def __lt__(self, other: object) -> Scalar:
        return self._apply(other, operator.lt)

    def __le__(self, other: object) -> Scalar:
        return self._apply(other, operator.le)

    def __gt__(self, other: object) -> Scalar:
        return self._apply(other, operator.gt)

    def __ge__(self, other: object) -> Scalar:
        return self._apply(other, operator.ge)

    def __eq__(self, other: object) -> Any:
        return self._apply(other, operator.eq)

    def __ne__(self, other: object) -> Any:
        return self._apply(other, operator.ne)

    __hash__ = object.__hash__  # a symbol is kept in sets by identity; == is a condition

    def __and__(self, other: object) -> Scalar:
        return self._apply(other, ca.logic_and)

    __rand__ = __and__

    def __or__(self, other: object) -> Scalar:
        return self._apply(other, ca.logic_or)

    __ror__ = __or__

    def __invert__(self) -> Scalar:
        return apply(ca.logic_not, self)

    def __neg__(self) -> Scalar:
        return apply(operator.neg, self)

    def __pos__(self) -> Scalar:
        return self

    def __abs__(self) -> Scalar:
        return apply(ca.fabs, self)

    # numpy rounds the entries of an object array by Python's functions.
    def __floor__(self) -> Scalar:
        return apply(ca.floor, self)

    def __ceil__(self) -> Scalar:
        return apply(ca.ceil, self)

    def __trunc__(self) -> Scalar:
        return apply(UFUNCS["trunc"], self)

    def __bool__(self) -> bool:
        raise SymbolError(
            f"{self._name} has no truth value, so Python's if, and, or, max, min cannot branch on "
            "it; write rbsd_sym.where(a > b, x, y) for x if a > b else y, np.maximum(a, b) for "
            "max(a, b), np.minimum(a, b) for min(a, b), np.logical_and(a, b) for a and b"
        )

    def __float__(self) -> float:
        if self.expr.is_constant():
            return float(self.expr)
        raise SymbolError(
            f"{self._name} is not a number; write np.sin(x) for math.sin(x), x for float(x), "
            "np.array(x) for np.array(x, float), and f = [0] * 6; f[2] = x, or f = np.zeros(6, "
            "dtype=object), for f = np.zeros(6)"
        )

    def __int__(self) -> int:
        raise SymbolError(f"{self._name} is not a number; write np.trunc(x) for int(x)")

    def __round__(self, digits: int | None = None) -> Scalar:
        raise SymbolError(f"{self._name} is not a number; write np.rint(x) for round(x)")

    def __index__(self) -> int:
        raise SymbolError(
            f"{self._name} is not a whole number to count or index by; write range(n) with a "
            "number n, and rbsd_sym.where(i < x, a, b) for what depends on x"
        )

    def __repr__(self) -> str:
        return str(self.expr)

    @property
    def _name(self) -> str:
        text = str(self.expr)
        return f"the symbol '{text}'" if len(text) <= _SHOWN else f"'{text[:_SHOWN]}...'"


def _method(function: Callable[..., Expr]) -> Any:
    return lambda self, *others: apply(function, self, *others)


# numpy calls the method of the ufunc's name on each entry of a plain object array.
for _name, _function in UFUNCS.items():
    setattr(Scalar, _name, _method(_function))


class Array(np.ndarray):
    """An object array of numbers and `Scalar`s that numpy's functions treat as an array of numbers.

    Of a plain object array numpy asks the truth of comparisons, which symbols do not have.
    """

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return _call_ufunc(ufunc, method, inputs, options)

    def __array_function__(self, function: Any, types: Any, given: Any, options: Any) -> Any:
        return _call_function(function, given, options)


def apply(function: Callable[..., Expr], *values: Any) -> Scalar:
    """A CasADi function of numbers, of which some are symbols."""
    leaves = frozenset().union(*(leaves_of(value) for value in values))
    return Scalar(function(*(to_expr(value) for value in values)), leaves)


def _mixes(value: object) -> bool:
    """Whether arithmetic takes it: numbers, and the truth values of comparisons of numbers."""
    return is_number(value) or isinstance(value, (bool, np.bool_))


def _call_ufunc(ufunc: Any, method: str, inputs: Any, options: Any) -> Any:
    """An elementwise function of numpy, or its sum, product, maximum, ... over an axis."""
    plain = [_plain(value) for value in inputs]
    out = options.get("out")
    if out is not None:
        options = {**options, "out": tuple(_plain(value) for value in out)}
    function = UFUNCS.get(ufunc.__name__)
    if function is not None:
        ufunc = np.frompyfunc(partial(_on_entries, function, ufunc), ufunc.nin, 1)
    result = getattr(ufunc, method)(*plain, **options)
    return _marked(result) if out is None else out[0]


def _on_entries(function: Callable[..., Expr], ufunc: Any, *values: Any) -> Any:
    symbolic = any(isinstance(value, Scalar) for value in values)
    return apply(function, *values) if symbolic else ufunc(*values)


def _call_function(function: Any, given: Any, options: Any) -> Any:
    """A function of numpy that is not elementwise: ours if it looks at values, else numpy's."""
    own = _FUNCTIONS.get(function)
    if own is not None:
        return own(*given, **options)
    arrays = tuple(_array(value) for value in given)
    options = {key: _array(value) for key, value in options.items()}
    nothing = np.empty(0, dtype=object).view(Array)
    result = _marked(np.ndarray.__array_function__(nothing, function, (Array,), arrays, options))
    single = isinstance(result, Array) and not result.ndim
    return result.item() if single and any(isinstance(v, Scalar) for v in given) else result


def _plain(value: Any) -> Any:
    if isinstance(value, Scalar):
        return _entry(value)
    return value.view(np.ndarray) if isinstance(value, Array) else value


def _array(value: Any) -> Any:
    return _entry(value).view(Array) if isinstance(value, Scalar) else value


def _entry(value: Scalar) -> np.ndarray:
    out: np.ndarray = np.empty((), dtype=object)
    out[()] = value
    return out


def _marked(result: Any) -> Any:
    """A result of numpy with its object arrays as `Array`s."""
    if isinstance(result, (list, tuple)):
        return type(result)(_marked(item) for item in result)
    marked = isinstance(result, np.ndarray) and result.dtype == object
    return result.view(Array) if marked else result


_NUMPY = threading.RLock()
_MAKERS = ("array", "asarray")


@contextmanager
def arrays_of_symbols() -> Iterator[None]:
    """Let `np.array` and `np.asarray` make an `Array` of what holds symbols, while it lasts.

    Numpy has no hook for it, and `np.array(displacement)` is how functions written for lists of
    numbers begin. Other arrays and other threads get what they always do.
    """
    with _NUMPY:
        here, makers = threading.get_ident(), {name: getattr(np, name) for name in _MAKERS}
        for name, make in makers.items():
            setattr(np, name, wraps(make)(partial(_made, here, make)))
        try:
            yield
        finally:
            for name, make in makers.items():
                setattr(np, name, make)


def _made(thread: int, make: Callable[..., np.ndarray], *given: Any, **options: Any) -> np.ndarray:
    array = make(*given, **options)
    symbolic = array.dtype == object and any(isinstance(item, Scalar) for item in array.flat)
    return array.view(Array) if symbolic and threading.get_ident() == thread else array


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """Return `if_true` where the condition holds, else `if_false`; both are evaluated.

    Numbers and symbols, or arrays of them, which are broadcast; the branch that is not taken leaves
    neither its value nor its derivatives, also where these are infinite.
    """
    parts = [np.asarray(part, dtype=object) for part in (condition, if_true, if_false)]
    for part in (item for array in parts for item in array.flat):
        if not _mixes(part):
            raise TypeError(f"where: {part!r} is not a number; give floats or symbols")
    result = np.frompyfunc(_branch, 3, 1)(*parts)
    return result.view(Array) if isinstance(result, np.ndarray) else result


def _branch(condition: Any, if_true: Any, if_false: Any) -> Any:
    if not isinstance(condition, Scalar):
        return if_true if condition else if_false
    return apply(ca.if_else, condition, if_true, if_false)


def _select(conditions: Any, choices: Any, default: Any = 0) -> Any:
    """`np.select`: the first choice whose condition holds."""
    out = default
    for condition, choice in reversed(list(zip(conditions, choices, strict=True))):
        out = where(condition, choice, out)
    return out


def _interp(
    x: Any, xp: Any, fp: Any, left: Any = None, right: Any = None, period: None = None
) -> Any:
    """`np.interp`, over points that are numbers."""
    at, values = np.asarray(xp, float), np.asarray(fp, dtype=object)
    if period is not None:
        raise SymbolError("np.interp: period of a symbol; write np.interp(x % period, xp, fp)")
    if at.ndim != 1 or at.shape != values.shape or not at.size or (np.diff(at) < 0).any():
        raise ValueError(
            f"np.interp: points of shape {at.shape} and {values.shape}; as many points as values, "
            "which do not decrease; sort them"
        )
    if at.size > _POINTS:
        raise SymbolError(
            f"np.interp: {at.size} points, each of which is a branch in the code of the model; "
            f"give at most {_POINTS}, or an Input with samples if it is a function of time"
        )
    ends = [values[0] if left is None else left, values[-1] if right is None else right]

    def of_entry(entry: Any) -> Scalar:
        return apply(lambda x, *v: interpolated(x, at, v[2:], *v[:2]), entry, *ends, *values)

    return _marked(np.frompyfunc(of_entry, 1, 1)(np.asarray(x, dtype=object)))


def _norm(x: Any, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:
    """`np.linalg.norm` of one or of many vectors, whose derivative at zero is zero."""
    if ord not in (None, 2) or (axis is None and ord == 2 and np.ndim(x) > 1):
        raise SymbolError(
            f"np.linalg.norm: ord {ord!r} of symbols; write np.sqrt(np.sum(x**2)), "
            "np.sum(np.abs(x)) or np.max(np.abs(x))"
        )
    square = np.sum(np.asarray(x, dtype=object).view(Array) ** 2, axis=axis, keepdims=keepdims)
    return where(square > 0, np.sqrt(square), 0)


def _where(condition: Any, *branches: Any) -> Any:
    if len(branches) != 2:
        raise SymbolError(
            "np.where: the places where a symbol holds are not known; write np.where(a > b, x, y)"
        )
    return where(condition, *branches)


_POINTS = 1000  # of a table that becomes branches
_FUNCTIONS: dict[Any, Callable[..., Any]] = {
    np.where: _where,
    np.select: _select,
    np.interp: _interp,
    np.linalg.norm: _norm,
}


_UNIT = re.compile(r"[\w .^*/()%-]{0,32}")


# By symbol, since functions of CasADi, such as interpolants, return a plain SX without leaves.
_LEAVES: WeakValueDictionary[int, Leaf] = WeakValueDictionary()


class Leaf(Scalar):
    """A named symbol of the scene; equal only to itself."""

    __slots__ = ("__weakref__", "name", "unit", "value")

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
        _LEAVES[self.expr.element_hash()] = self

    def __reduce__(self) -> tuple[Any, ...]:
        raise TypeError(
            f"{type(self).__name__.lower()} '{self.name}' cannot be copied or sent to another "
            "process, since a symbol is equal only to itself; build the scene there"
        )


class Param(Leaf):
    """A number that stays a symbol in the model and in its C code.

    It stands for a float anywhere in a scene, also in arithmetic with floats and numpy arrays, and
    is constant during a run: `simulate(model, 1.0, params={"k": 3e4})`.

    Arguments:
        name: identifier, unique in the scene.
        value: default.
        unit: for tables, headers and messages.

    Use: k = rs.Param("k", 2e4, "N/m")
    """

    __slots__ = ()

    def __init__(self, name: str, value: float, unit: str = "") -> None:
        super().__init__(name, value, unit)


class Input(Leaf):
    """A number that may vary in time, such as a force or the offset of a servo.

    It stands for a float anywhere in a scene but in masses, inertias and starts; its course is
    given with the run: `simulate(model, 1.0, inputs={"push": lambda t: 5 * np.sin(t)})`.

    Arguments:
        name: identifier, unique in the scene.
        unit: for tables, headers and messages.
        value: default, constant in time.

    Use: push = rs.Input("push", "N")
    """

    __slots__ = ()

    def __init__(self, name: str, unit: str = "", value: float = 0.0) -> None:
        super().__init__(name, value, unit)


class _Time(Leaf):
    __slots__ = ()


TIME = _Time("t", 0.0, "s")
"""The time, in s, for numbers that are a known function of it."""

Number = Union[float, int, Scalar]


def is_number(value: object) -> bool:
    """Whether the value is a real number or a `Scalar`."""
    if isinstance(value, Scalar):
        return True
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def leaves_of(value: object) -> frozenset[Leaf]:
    """Every `Param`, `Input` and `TIME` inside a number or a (nested) array of numbers."""
    if isinstance(value, Scalar):
        return value.leaves
    if isinstance(value, ca.SX):
        found = (_LEAVES.get(symbol.element_hash()) for symbol in ca.symvar(value))
        return frozenset(leaf for leaf in found if leaf is not None)
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


def to_array(expr: Expr, leaves: frozenset[Leaf] = frozenset()) -> Array:
    """An SX as an `Array` of `Scalar`s that have these leaves; a column becomes one-dimensional."""
    out: np.ndarray = np.empty(expr.shape, dtype=object)
    for i in range(expr.shape[0]):
        for j in range(expr.shape[1]):
            out[i, j] = Scalar(ca.SX(expr[i, j]), leaves)
    return (out[:, 0] if expr.shape[1] == 1 else out).view(Array)


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
