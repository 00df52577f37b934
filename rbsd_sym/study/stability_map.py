"""Stability maps: the largest growth rate of a disturbance, over two parameters or settings."""

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
    """Return growth rates over two axes, in a table with a row for each pair of values.

    Without a period, the growth rate is the spectral abscissa: the largest real part of an
    eigenvalue of the motion linearised at the static equilibrium or at a given state. With a
    period, it is the largest log|multiplier| / period of the periodic motion [Floquet 1883].
    Motions that a minimal model left out are included.

    >>> axes = {"k": [1e3, 1e4, 1e5]}, {"push": [0.0, 5.0]}
    >>> rs.plots.stability_map(rs.study.stability_map(model, *axes))

    Arguments:
        model: a model, or a function make(point) -> model, where a point is a dict of both values.
            It is called once for each combination of values that are not Params or Inputs.
        x_axis, y_axis: {name: values} of a Param, a constant Input, or a setting for `make`.
        integrator, accuracy: of periodic motion, as in `floquet`.
        inputs, params: as in `linearize`, beside those on the axes.
        at: a state as in `linearize`, or a function of the point that returns one; by default the
            static equilibrium. With a period: where the motion starts.
        period: s, or a function of the point.
        t: time at which the motion is linearised or starts, s.
        units: of settings, by name; Params and Inputs have their own.

    Returns:
        Columns: both names; `abscissa`, and that of the motions `kept` and `left_out` (None if
        there are none), 1/s; `mode_frequency` of the fastest growing mode, Hz; with a period
        `multiplier`, the largest modulus; `stable`; `error`: None, or why the point failed.

    Raises:
        TypeError: neither a model nor a function that returns one.
        ValueError: an axis without exactly one name and finite values; a name that is not a Param
            or Input of a given model.
    """
    request = _Request(at, period, inputs or {}, params or {}, t, integrator, accuracy)
    return _table(model, request, _points(x_axis, y_axis), units or {})


class _Request(NamedTuple):
    """The arguments of `stability_map` that are the same at every point."""

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
    """Return all pairs of values as points, x changing fastest."""
    x_name, y_name = _axis("x_axis", x_axis), _axis("y_axis", y_axis)
    if x_name == y_name:
        raise ValueError(f"stability_map: both axes are '{x_name}'; give two different names")
    pairs = itertools.product(y_axis[y_name], x_axis[x_name])
    return [{x_name: float(x), y_name: float(y)} for y, x in pairs]


def _table(
    model: Model | Make, request: _Request, points: list[Point], units: Mapping[str, str]
) -> ResultTable:
    models, axes = _Models(model, tuple(points[0])), list(points[0])
    names = ["stable", "error"] if request.period is None else ["multiplier", "stable", "error"]
    columns = (*axes, *_COLUMNS, *names)
    rows = [_row(models, request, point, columns) for point in points]
    given = models.units | dict(units)
    both = [given.get(name, "") for name in axes]
    return ResultTable(columns, (*both, *_COLUMNS.values(), *("" for _ in names)), tuple(rows))


def _axis(where: str, axis: Mapping[str, Sequence[float]]) -> str:
    """Return the name of an axis, after checking its values."""
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
    """The model of each point; `make` is called as rarely as possible.

    Which of the two names are Params or Inputs is known once `make` has returned a model. Only the
    others, the settings, need another model when they change.
    """

    def __init__(self, model: Model | Make, names: tuple[str, ...]) -> None:
        self.given, self.names = model, names
        self.units: dict[str, str] = {}
        self._made: dict[tuple[Cell, ...], Model] = {}
        self._settings: list[str] | None = None
        if isinstance(model, Model):
            self._sort_names(model)
            if self._settings:
                there = ", ".join(_adjustable(model)) or "none"
                raise ValueError(
                    f"stability_map: '{self._settings[0]}' is not a Param or Input of model "
                    f"'{model.name}'; there are: {there}; for settings of another kind give a "
                    "function make(point) -> model"
                )
        elif not callable(model):
            raise TypeError(f"stability_map: {model!r}; give a model, or make(point) -> model")

    def _sort_names(self, model: Model) -> None:
        known = _adjustable(model)
        self.units |= {name: known[name] for name in self.names if name in known}
        self._settings = [name for name in self.names if name not in known]

    def at(self, point: Point) -> Model:
        """Return the model of a point, made if no earlier one fits.

        Raises:
            TypeError: `make` returned something else.
        """
        if isinstance(self.given, Model):
            return self.given
        if self._settings is None or self._key(point) not in self._made:
            model = self.given(dict(point))
            if not isinstance(model, Model):
                raise TypeError(
                    f"stability_map: make({point}) gave a {type(model).__name__}; return a model, "
                    "such as compile_scene(scene(**point))"
                )
            self._sort_names(model)
            self._made[self._key(point)] = model
        return self._made[self._key(point)]

    def _key(self, point: Point) -> tuple[Cell, ...]:
        """Return the values of the settings, which need a model of their own."""
        return tuple(point[name] for name in self._settings or ())


def _adjustable(model: Model) -> dict[str, str]:
    """Return the unit of each Param and Input, which can be set without another model, by name."""
    dae = model.dae
    return {v.name: v.unit for v in (*dae.parameters.labels, *dae.u_labels)}


def _row(
    models: _Models, request: _Request, point: Point, columns: Sequence[str]
) -> tuple[Cell, ...]:
    """Return one row; if the point fails, with the reason and without numbers."""
    # A TypeError is a mistake in the call that would fail at every point, so it is raised. Any
    # other exception, also of the user's functions, belongs to the point.
    try:
        found: dict[str, Cell] = {**_growth(models.at(point), request, point), "error": None}
    except TypeError:
        raise
    except Exception as error:
        found = {"error": reason(error)}
    return tuple({**point, **found}.get(name) for name in columns)


def _growth(model: Model, request: _Request, point: Point) -> dict[str, Cell]:
    inputs = {label.name for label in model.dae.u_labels}
    given = {k: v for k, v in point.items() if k in _adjustable(model)}
    u = {**request.inputs, **{k: v for k, v in given.items() if k in inputs}}
    p = {**request.params, **{k: v for k, v in given.items() if k not in inputs}}
    at = request.at(dict(point)) if callable(request.at) else request.at
    if request.period is not None:
        period = request.period(dict(point)) if callable(request.period) else request.period
        return _periodic(model, float(period), at, u, p, request)
    if at is None:
        at = static_equilibrium(model, inputs=u, params=p, t=request.t)
    linear = linearize(model, at, inputs=u, params=p, t=request.t)
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
    request: _Request,
) -> dict[str, Cell]:
    start = None if at is None else locate(model, at, params=p, t=request.t)
    motion = floquet(
        model,
        period,
        request.integrator,
        inputs=u,
        params=p,
        start=start,
        t=request.t,
        accuracy=request.accuracy,
    )
    # A multiplier exp(lambda period) has the angle Im(lambda) period, up to multiples of 2 pi: the
    # frequency is the lowest of those that fit.
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
