"""Values of Inputs over time: numbers, samples and functions of t, checked once, then evaluated.

Inside an integrator a user's function becomes an expression where it accepts a symbol for t;
otherwise CasADi calls it back with numbers.
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
        t: increasing times (n,), s, at least two.
        values: finite values (n,), in the unit of the Input.
    """

    t: np.ndarray
    values: np.ndarray


Signal: TypeAlias = Union[float, Samples, Callable[[Any], Any]]
"""The value of an Input after `signal_of` has checked it."""

InputValue: TypeAlias = Union[
    float, Samples, Callable[[Any], Any], tuple[Sequence[float] | np.ndarray, ...]
]
"""What a user may give for an Input: a number, a function of t in s, samples (times, values)."""

Inputs: TypeAlias = Mapping[str, InputValue]
"""Values of Inputs by name."""


def signal_of(value: Any, where: str, unit: str) -> Signal:
    """Check what a user gave as the value of an Input, and return it as a `Signal`.

    Arguments:
        value: a number, a function of t in s, `Samples`, or a pair (times, values) of samples,
            times in s and increasing.
        where: text that begins the message, such as "model 'arm', input 'pull'".
        unit: of the Input, for the message.

    Raises:
        ValueError: the value is none of these, or not finite.

    >>> signal_of(2, "input 'pull'", "N")
    2.0
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
            f"{where}: samples of shape {t.shape} and {samples.shape}; give increasing times and "
            "finite values, both of one length of at least 2"
        )
    return Samples(t, samples)


def value_at(signal: Any, t: float) -> Any:
    """Return the value of a signal at time t in s."""
    if isinstance(signal, Samples):
        return float(np.interp(t, signal.t, signal.values))
    return signal(t) if callable(signal) else signal


def is_constant(signal: Signal) -> bool:
    """Return whether the input is one number for the whole run."""
    return is_number(signal)


def symbolic(signal: Signal, t: ca.SX) -> ca.SX | None:
    """Return the input as an expression of t if it is a function that accepts a symbol, else None.

    The user's function is called once with a symbol in place of the time. A traced function has
    exact derivatives and runs as fast as the model itself. A function that branches on t with `if`,
    or calls code for floats only, cannot be traced.

    Arguments:
        signal: the checked value of an Input.
        t: the SX symbol of the time in s.

    Raises:
        ValueError: the function uses a Param or Input, which has no value outside the model.
    """
    if not callable(signal):
        return None
    # Any exception may come from a user's function that cannot handle a symbol. It says nothing
    # about the function's behaviour with floats, so it only means "not traceable".
    try:
        value = signal(Scalar(t))
    except Exception:
        return None
    if leaves_of(value):
        names = ", ".join(sorted(leaf.name for leaf in leaves_of(value)))
        raise ValueError(
            f"input function {getattr(signal, '__name__', signal)!r}: uses the symbol {names}; it "
            "must return a number; use the symbol's value, or write the expression into the scene"
        )
    return to_expr(value) if is_number(value) else None


def evaluate(signal: Signal, t: ca.MX, kept: list[Any]) -> ca.MX:
    """Return the input at time t in an MX graph: interpolated samples, or a call back into Python.

    Arguments:
        signal: `Samples`, or a function that `symbolic` could not trace.
        t: MX symbol of the time, s.
        kept: list to which the callback is appended. The caller must keep it as long as the graph,
            since CasADi holds no reference to it.
    """
    if isinstance(signal, Samples):
        times, values = [float(v) for v in signal.t], [float(v) for v in signal.values]
        table = ca.interpolant("samples", "linear", [times], values)
        # CasADi extrapolates linearly; clipping t keeps the value constant outside the samples.
        return table(ca.fmin(ca.fmax(t, times[0]), times[-1]))
    call = _PythonCall(signal)  # type: ignore[arg-type]
    kept.append(call)
    return call(t)


def raise_of_user(kept: list[Any]) -> None:
    """Raise the error, if any, that a user's input function raised during the integration.

    CasADi only reports that an evaluation failed.

    Arguments:
        kept: callbacks, as filled by `evaluate`.

    Raises:
        ValueError: with the user's exception as its cause.
    """
    for call in kept:
        error = getattr(call, "error", None)
        if error is not None:
            call.error = None
            raise ValueError(
                f"input function {getattr(call.signal, '__name__', call.signal)!r}: "
                f"{type(error).__name__}: {error}; give a function that takes a time in s and "
                "returns one number for all times of the run"
            ) from error


class _PythonCall(ca.Callback):
    """A Python function of time as a CasADi Function."""

    def __init__(self, signal: Callable[[float], float]) -> None:
        ca.Callback.__init__(self)
        self.signal = signal
        self.error: Exception | None = None
        # Rosenbrock methods need the derivative by t, for which finite differences must do.
        self.construct("signal", {"enable_fd": True})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 1

    def eval(self, arg: list[ca.DM]) -> list[float]:
        try:
            return [float(self.signal(float(arg[0])))]
        except Exception as error:
            # CasADi turns the exception into a failed evaluation; `raise_of_user` raises it again.
            self.error = error
            raise
