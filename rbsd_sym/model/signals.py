"""Values of Inputs over time: numbers, samples and functions, checked once, then evaluated.

Inside an integrator a function is traced with a symbol where that is possible, or called.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, Union

import casadi as ca
import numpy as np

from ..base.symbols import Scalar, is_number, leaves_of, to_expr


@dataclass(frozen=True, eq=False)
class Samples:
    """An input given by samples: linear between them, constant before the first and after the last.

    Arguments:
        t: increasing times (n,), s.
        values: (n,).
    """

    t: np.ndarray
    values: np.ndarray


Signal: TypeAlias = Union[float, Samples, Callable[[Any], Any]]
"""The checked value of an Input."""

InputValue: TypeAlias = Union[
    float, Samples, Callable[[Any], Any], tuple[Sequence[float] | np.ndarray, ...]
]
"""What a user may give for an Input: a number, a function of t (s), samples (times, values)."""

Inputs: TypeAlias = Mapping[str, InputValue]
"""Values of Inputs by name."""


def signal_of(value: Any, where: str, unit: str) -> Signal:
    """Check the value of an Input.

    Arguments:
        value: a number, a function of t (s), `Samples` or a pair (times, values) of samples.
        where, unit: of the Input, for messages.

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
        pair = (value.t, value.values) if isinstance(value, Samples) else value
        t, samples = (np.array(part, float) for part in pair)
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


def value_at(signal: Any, t: float) -> Any:
    """Value at time t (s) of a signal."""
    if isinstance(signal, Samples):
        return float(np.interp(t, signal.t, signal.values))
    return signal(t) if callable(signal) else signal


def is_constant(signal: Signal) -> bool:
    """Whether the input is one number."""
    return is_number(signal)


def symbolic(signal: Signal, t: ca.SX) -> ca.SX | None:
    """The input as an expression of t, if it is a function that takes a symbol; else None.

    A traced function is exact and as fast as the model itself. One that branches on t, or calls
    what knows only floats, cannot be traced.

    Raises:
        ValueError: it uses a Param or Input, which has no value outside the model.
    """
    if not callable(signal):
        return None
    try:
        value = signal(Scalar(t))
    except Exception:  # whatever a user's function raises on a symbol, floats may still do
        return None
    if leaves_of(value):
        names = ", ".join(sorted(leaf.name for leaf in leaves_of(value)))
        raise ValueError(
            f"input function {getattr(signal, '__name__', signal)!r}: uses the symbol {names}; it "
            "returns a number; give the value, or make the expression part of the scene"
        )
    return to_expr(value) if is_number(value) else None


def evaluate(signal: Signal, t: ca.MX, kept: list[Any]) -> ca.MX:
    """The input at time t in an MX graph: interpolated samples, or a call back into Python.

    Arguments:
        kept: is given what must live as long as the graph, since CasADi holds no reference to it.
    """
    if isinstance(signal, Samples):
        times, values = [float(v) for v in signal.t], [float(v) for v in signal.values]
        table = ca.interpolant("samples", "linear", [times], values)
        return table(ca.fmin(ca.fmax(t, times[0]), times[-1]))
    call = _PythonCall(signal)  # type: ignore[arg-type]
    kept.append(call)
    return call(t)


def raise_of_user(kept: list[Any]) -> None:
    """Raise what a user's input function raised during the integration, if anything.

    Raises:
        ValueError: from the user's exception.
    """
    for call in kept:
        error = getattr(call, "error", None)
        if error is not None:
            call.error = None
            raise ValueError(
                f"input function {getattr(call.signal, '__name__', call.signal)!r}: "
                f"{type(error).__name__}: {error}; it takes a time in s and returns one number"
            ) from error


class _PythonCall(ca.Callback):
    """A Python function of time; its derivative, which only Rosenbrock asks for, by differences."""

    def __init__(self, signal: Callable[[float], float]) -> None:
        ca.Callback.__init__(self)
        self.signal = signal
        self.error: Exception | None = None
        self.construct("signal", {"enable_fd": True})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 1

    def eval(self, arg: list[ca.DM]) -> list[float]:
        try:
            return [float(self.signal(float(arg[0])))]
        except Exception as error:
            self.error = error  # CasADi turns it into a failed evaluation; the driver raises it
            raise
