"""Stability maps: the largest growth rate of a disturbance over two parameters or settings."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias, Union

import numpy as np

from ..analysis.equilibrium import static_equilibrium
from ..analysis.floquet import floquet
from ..analysis.linearize import linearize
from ..model.model import Model
from ..model.signals import Inputs
from ..model.values import Params, Where, locate
from ..pipeline import Integrator
from .table import Cell, ResultTable
from .workers import reason

Point: TypeAlias = dict[str, float]
Make: TypeAlias = Callable[[Point], Model]
At: TypeAlias = Union[Where, Callable[[Point], Where]]

_COLUMNS = {"abscissa": "1/s", "kept": "1/s", "left_out": "1/s", "mode_frequency": "Hz"}


def stability_map(
    model: Model | Make,
    x_axis: Mapping[str, Sequence[float]],
    y_axis: Mapping[str, Sequence[float]],
    integrator: Integrator | None = None,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    at: At = None,
    period: float | Callable[[Point], float] | None = None,
    t: float = 0.0,
    units: Mapping[str, str] | None = None,
    accuracy: float = 1e-4,
) -> ResultTable:
    """Growth rates over two axes, a row for each pair of values.

    Without a period it is the spectral abscissa, the largest real part of an eigenvalue, at the
    static equilibrium or a given state; with one it is the largest log|multiplier| / period of the
    periodic motion [Floquet 1883]. Motions that a minimal model left out count.

    Arguments:
        model: or a function make(point) -> model, where a point is a dict of both values; called
            once for each combination of those that are no Params or Inputs of the model it makes.
        x_axis, y_axis: {name: values} of a Param, a constant Input, or a setting for `make`.
        at: a state as for `linearize`, or a function of the point that gives one; by default the
            static equilibrium, from the model's start. With a period: where the motion starts.
        period: s, or a function of the point.
        inputs, params: as for `linearize`, beside those on the axes.
        t: s.
        units: of settings, by name; Params and Inputs have theirs.
        integrator, accuracy: of periodic motion, see `floquet`.

    Returns:
        Columns: the two names; `abscissa`, that of what is `kept` and of what was `left_out` (None
        if nothing was), 1/s; `mode_frequency` of the fastest growing mode, Hz; `multiplier`, the
        largest modulus, if there is a period; `stable`; and `error`: None, or why the point failed.

    Raises:
        ValueError: axes without one name and values, names that are no Params.
    """
    asked = _Asked(at, period, inputs or {}, params or {}, t, integrator, accuracy)
    return _table(model, asked, _points(x_axis, y_axis), units or {})


class _Asked(NamedTuple):
    """What is asked at every point."""

    at: At
    period: float | Callable[[Point], float] | None
    inputs: Inputs
    params: Params
    t: float
    integrator: Integrator | None
    accuracy: float


def _points(
    x_axis: Mapping[str, Sequence[float]], y_axis: Mapping[str, Sequence[float]]
) -> list[Point]:
    """All pairs of values."""
    x_name, y_name = _axis("x_axis", x_axis), _axis("y_axis", y_axis)
    if x_name == y_name:
        raise ValueError(f"stability_map: both axes are '{x_name}'; name two")
    pairs = itertools.product(y_axis[y_name], x_axis[x_name])
    return [{x_name: float(x), y_name: float(y)} for y, x in pairs]


def _table(
    model: Model | Make, asked: _Asked, points: list[Point], units: Mapping[str, str]
) -> ResultTable:
    models, axes = _Models(model, tuple(points[0])), list(points[0])
    names = ["stable", "error"] if asked.period is None else ["multiplier", "stable", "error"]
    columns = (*axes, *_COLUMNS, *names)
    rows = [_row(models, asked, point, columns) for point in points]
    given = models.units | dict(units)
    both = [given.get(name, "") for name in axes]
    return ResultTable(columns, (*both, *_COLUMNS.values(), *("" for _ in names)), tuple(rows))


def _axis(where: str, axis: Mapping[str, Sequence[float]]) -> str:
    """The name of an axis; its values are checked."""
    good = isinstance(axis, Mapping) and len(axis) == 1
    try:
        values = np.array(next(iter(axis.values())), float) if good else np.zeros(0)
    except (TypeError, ValueError):
        values = np.zeros(0)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise ValueError(
            f"stability_map: {where} {axis!r}; give one name with finite values, such as "
            "{'stiffness': [1e3, 2e3]}"
        )
    return str(next(iter(axis)))


class _Models:
    """The model of each point."""

    def __init__(self, model: Model | Make, names: tuple[str, ...]) -> None:
        self.given, self.names = model, names
        self.units: dict[str, str] = {}
        self._made: dict[tuple[Cell, ...], Model] = {}
        self._settings: list[str] | None = None
        if isinstance(model, Model):
            self._look(model)
            if self._settings:
                there = ", ".join(_knobs(model)) or "none"
                raise ValueError(
                    f"stability_map: '{self._settings[0]}' is no Param or Input of model "
                    f"'{model.name}'; there are: {there}; for settings of another kind give a "
                    "function make(point) -> model"
                )
        elif not callable(model):
            raise TypeError(f"stability_map: {model!r}; give a model, or make(point) -> model")

    def _look(self, model: Model) -> None:
        knobs = _knobs(model)
        self.units |= {name: knobs[name] for name in self.names if name in knobs}
        self._settings = [name for name in self.names if name not in knobs]

    def at(self, point: Point) -> Model:
        """The model of a point, made if it needs to be."""
        if isinstance(self.given, Model):
            return self.given
        if self._settings is None or self._key(point) not in self._made:
            model = self.given(dict(point))
            if not isinstance(model, Model):
                raise TypeError(
                    f"stability_map: make({point}) gave a {type(model).__name__}; it returns a "
                    "model, such as compile_scene(scene(**point))"
                )
            self._look(model)
            self._made[self._key(point)] = model
        return self._made[self._key(point)]

    def _key(self, point: Point) -> tuple[Cell, ...]:
        """Values of the settings that need another model."""
        return tuple(point[name] for name in self._settings or ())


def _knobs(model: Model) -> dict[str, str]:
    """Names of what can be set without another model, and units."""
    dae = model.dae
    return {v.name: v.unit for v in (*dae.parameters.labels, *dae.u_labels)}


def _row(models: _Models, asked: _Asked, point: Point, columns: Sequence[str]) -> tuple[Cell, ...]:
    """One row; whatever fails is its reason."""
    try:
        found: dict[str, Cell] = {**_judged(models.at(point), asked, point), "error": None}
    except TypeError:
        raise
    except Exception as error:  # a point that fails is a row, whatever fails there
        found = {"error": reason(error)}
    return tuple({**point, **found}.get(name) for name in columns)


def _judged(model: Model, asked: _Asked, point: Point) -> dict[str, Cell]:
    inputs = {label.name for label in model.dae.u_labels}
    knobs = {k: v for k, v in point.items() if k in _knobs(model)}
    u = {**asked.inputs, **{k: v for k, v in knobs.items() if k in inputs}}
    p = {**asked.params, **{k: v for k, v in knobs.items() if k not in inputs}}
    at = asked.at(dict(point)) if callable(asked.at) else asked.at
    if asked.period is not None:
        period = asked.period(dict(point)) if callable(asked.period) else asked.period
        return _periodic(model, float(period), at, u, p, asked)
    if at is None:
        at = static_equilibrium(model, inputs=u, params=p, t=asked.t)
    linear = linearize(model, at, inputs=u, params=p, t=asked.t)
    spectrum = linear.spectrum
    fastest = int(spectrum.values.real.argmax()) if len(spectrum.values) else 0
    return {
        "abscissa": linear.abscissa,
        "kept": _largest(linear.kept.growth),
        "left_out": _largest(linear.left_out.growth),
        "stable": linear.stable,
        "mode_frequency": abs(float(spectrum.values[fastest].imag)) / (2 * np.pi),
    }


def _periodic(
    model: Model,
    period: float,
    at: Where,
    u: Mapping[str, Any],
    p: Mapping[str, float],
    asked: _Asked,
) -> dict[str, Cell]:
    start = None if at is None else locate(model, at, params=p, t=asked.t)
    motion = floquet(
        model,
        period,
        asked.integrator,
        inputs=u,
        params=p,
        start=start,
        t=asked.t,
        accuracy=asked.accuracy,
    )
    every = np.concatenate([motion.kept.values, motion.left_out.values])
    fastest = every[int(np.abs(every).argmax())] if len(every) else 1.0
    return {
        "abscissa": motion.abscissa,
        "kept": _largest(motion.kept.exponents(period)),
        "left_out": _largest(motion.left_out.exponents(period)),
        "stable": motion.stable,
        "mode_frequency": abs(float(np.angle(fastest))) / (2 * np.pi * period),
        "multiplier": motion.multiplier,
    }


def _largest(rates: np.ndarray) -> float | None:
    return float(rates.max()) if len(rates) else None
