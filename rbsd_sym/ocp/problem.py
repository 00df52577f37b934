"""What is to be optimised: phases of motion of a model, conditions, costs, and what is free."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Union

import numpy as np

from ..base.symbols import Scalar, is_number
from ..model.model import Model

Expression = Union[float, Scalar, str, Callable[[Any], Any]]
"""A number, an expression of Inputs, Params and TIME, the name of a scalar quantity, or a function
of a namespace `v` that returns one: `lambda v: v["arm.position"][0] ** 2 + 0.1 * push ** 2`."""


@dataclass(frozen=True)
class Free:
    """A number that the optimisation finds: a horizon, a Param, or an Input over time.

    For example `Free(4.0, low=1.0, high=10.0)` as the horizon of a phase in s, or
    `Free(low=-1, high=1)` as a bounded Input.

    Arguments:
        guess: where the search starts, in the unit of what is found; by default the model's value
            (Param, Input), else the middle of the bounds. For an Input also a function of time.
        low, high: bounds, in the same unit; infinite by default.

    Raises:
        ValueError: bounds that contradict each other or the guess.
    """

    guess: Any = None
    low: float = -math.inf
    high: float = math.inf

    def __post_init__(self) -> None:
        check_bounds("Free", self.low, self.high, "")
        guess = self.guess
        if guess is None or callable(guess):
            return
        if not _finite(guess):
            raise ValueError(f"Free: guess {guess!r}; give a finite number")
        if not self.low <= guess <= self.high:
            raise ValueError(
                f"Free: guess {guess} outside its bounds {self.low} ... {self.high}; move it inside"
            )

    def start(self, default: float | None = None) -> float:
        """Return the guess, else the default moved within the bounds, else their middle."""
        if self.guess is not None and not callable(self.guess):
            return float(self.guess)
        if default is None:
            both = math.isfinite(self.low) and math.isfinite(self.high)
            default = (self.low + self.high) / 2 if both else 1.0
        return float(min(max(default, self.low), self.high))


@dataclass(frozen=True, eq=False)
class Bound:
    """A condition low <= expression <= high, under a name of its own.

    Use it where a condition is on more than one named quantity. The name is the key under which it
    is given: `path={"wall": Bound(lambda v: v["load.p_x"] ** 2 + v["load.p_z"] ** 2, low=1.0)}`.
    It appears in reports and in `Solution.multipliers`, here as "path wall".

    Arguments:
        expression: a scalar, see `Expression`.
        low, high: bounds; equal for an equation, infinite by default.
        unit: of the expression, for messages.

    Raises:
        ValueError: bounds that are not numbers, or contradict each other.
    """

    expression: Expression
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    def __post_init__(self) -> None:
        check_bounds("Bound", self.low, self.high, self.unit)


@dataclass(frozen=True, eq=False)
class Phase:
    """A part of the motion with its own horizon, conditions and cost.

    Conditions are given by name: of a state, an algebraic unknown, an Input or an output (with all
    its components), or any name for a `Bound`. The value is what the quantity equals, or a pair
    (low, high), None for no bound. A vector is an array of its shape. `<body>.quaternion` and
    `<body>.rotation_matrix` equal to a target are three equations for the rotation error, which q
    and -q meet alike. For example

        Phase(Free(4.0, low=1.0), end={"tip.position": (2, 0, 0)}, path={"push": (-1, 1)},
              end_cost=rs.TIME)

    Arguments:
        horizon: length in s, or `Free(guess, low, high)`.
        start, end: conditions at the ends. In the first phase the states that `start` does not name
            begin where the model does (see `Problem.fixed_start`).
        path: conditions throughout the phase, kept at the points of the transcription.
        integral: cost per second, integrated over the phase.
        end_cost: cost at the end of the phase; `TIME` there is the time of the end.
        link: states just after the start of this phase by the values `v` just before; the others
            are continuous. For the second phase and later.

    Raises:
        ValueError: a horizon that is not positive and finite.
        TypeError: conditions that are not a mapping.
    """

    horizon: float | Free = 1.0
    start: Mapping[str, Any] = field(default_factory=dict)
    end: Mapping[str, Any] = field(default_factory=dict)
    path: Mapping[str, Any] = field(default_factory=dict)
    integral: Expression = 0.0
    end_cost: Expression = 0.0
    link: Mapping[str, Expression] = field(default_factory=dict)

    def __post_init__(self) -> None:
        free = isinstance(self.horizon, Free)
        low = self.horizon.low if isinstance(self.horizon, Free) else self.horizon
        if not free and not (_finite(low) and low > 0):
            raise ValueError(f"Phase: horizon {low!r} s; it is positive and finite, or Free(...)")
        if free and not low > 0:
            raise ValueError(
                f"Phase: free horizon with lower bound {low} s; time runs forward; give a positive "
                "bound, such as Free(2.0, low=0.1, high=10.0)"
            )
        for title in ("start", "end", "path", "link"):
            if not isinstance(getattr(self, title), Mapping):
                raise TypeError(f"Phase, {title}: give a mapping {{name: condition}}")


@dataclass(frozen=True, eq=False)
class Problem:
    """An optimal control problem: the phases of a motion of a model, at the least cost.

    It is independent of the method that transcribes it and of the solver:

        problem = Problem(model, Phase(2.0, end={"cart.p_x": 3.0}, integral=force**2),
                          inputs={"force": Free(low=-9, high=9)})
        solution = optimise(problem, Collocation(20))

    Arguments:
        model: minimal or full. Where a cost or condition names a state that was left out, the model
            is compiled again with all states, and `Solution.notes` says so.
        phases: one `Phase`, or several in order.
        inputs: for every Input of the model: `Free(guess, low, high)` for one to be found, else a
            number or a function of t.
        params: by name: a value, or `Free(guess, low, high)` for one to be found. The others keep
            their default.
        periodic: whether the motion ends where it starts: True for all states, or the names of
            those that return. A rotation returns to itself, whatever the sign of its quaternion.
        fixed_start: whether states without a start condition begin at the model's values; by
            default unless the problem is periodic.

    Raises:
        ValueError: unknown names, Inputs that are missing, a model with events.
        TypeError: a model or phases of another kind.
    """

    model: Model
    phases: Phase | Sequence[Phase]
    inputs: Mapping[str, Any] = field(default_factory=dict)
    params: Mapping[str, Any] = field(default_factory=dict)
    periodic: bool | Sequence[str] = False
    fixed_start: bool | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.model, Model):
            raise TypeError(
                f"Problem: model {type(self.model).__name__}; give what compile_scene returns"
            )
        phases = (self.phases,) if isinstance(self.phases, Phase) else tuple(self.phases)
        if not phases or not all(isinstance(phase, Phase) for phase in phases):
            raise TypeError("Problem: phases; give a Phase, or a list of them")
        object.__setattr__(self, "phases", phases)
        if phases[0].link:
            raise ValueError("Problem: the first phase has a link; none comes before it; use start")
        _check_model(self.model)
        _check_inputs(self.model, self.inputs)
        _check_params(self.model, self.params)

    @property
    def sequence(self) -> tuple[Phase, ...]:
        """The phases in order."""
        return self.phases  # type: ignore[return-value]

    @property
    def starts_fixed(self) -> bool:
        """Whether states without a start condition begin at the model's values."""
        return not self.periodic if self.fixed_start is None else self.fixed_start


def _check_model(model: Model) -> None:
    if model.events or model.dae.updates:
        what = f"events ({', '.join(model.events[:3])})" if model.events else "post_newton_step"
        raise ValueError(
            f"model '{model.name}': {what}; optimal control needs smooth rates; use effects with "
            "smoothing, or split the motion into phases with links"
        )
    if not model.n_x:
        raise ValueError(f"model '{model.name}': no states; nothing in it can move")


def _check_inputs(model: Model, inputs: Mapping[str, Any]) -> None:
    names = [label.name for label in model.dae.u_labels]
    for name in inputs:
        if name not in names:
            raise ValueError(
                f"model '{model.name}': no input '{name}'; there are: {', '.join(names) or 'none'}"
            )
    missing = [name for name in names if name not in inputs]
    if missing:
        raise ValueError(
            f"Problem: input '{missing[0]}' is missing; give Problem(inputs={{'{missing[0]}': "
            "Free(low=..., high=...)}) to have it found, or a number or function of t"
        )
    for name, value in inputs.items():
        if not (isinstance(value, Free) or callable(value) or _finite(value)):
            raise ValueError(
                f"Problem, input '{name}': {value!r}; give Free(...), a finite number, or a "
                "function of t"
            )


def _check_params(model: Model, params: Mapping[str, Any]) -> None:
    labels = model.dae.parameters.labels
    names = [label.name for label in labels]
    for name, value in params.items():
        if name not in names:
            raise ValueError(
                f"model '{model.name}': no parameter '{name}'; there are: "
                f"{', '.join(names) or 'none'}"
            )
        if not (isinstance(value, Free) or _finite(value)):
            raise ValueError(f"Problem, parameter '{name}': {value!r}; give Free(...) or a number")


def check_bounds(where: str, low: Any, high: Any, unit: str) -> None:
    """Check that bounds are numbers in order.

    Raises:
        ValueError: they are not.
    """
    numbers = all(is_number(v) and not isinstance(v, Scalar) for v in (low, high))
    if not numbers or np.isnan(low) or np.isnan(high):
        raise ValueError(f"{where}: bounds {low!r} and {high!r}; give numbers")
    unit = f" {unit}" if unit else ""
    if low > high:
        raise ValueError(
            f"{where}: lower bound {low:.6g}{unit} above upper bound {high:.6g}{unit}; they "
            "contradict each other"
        )
    if low == math.inf or high == -math.inf:
        raise ValueError(f"{where}: bounds {low} ... {high}{unit} leave no number")


def _finite(value: Any) -> bool:
    return is_number(value) and not isinstance(value, Scalar) and bool(np.isfinite(float(value)))
