"""From names and vectors to the values a model is called with: points, starts, experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeAlias, TypedDict, Union

import casadi as ca
import numpy as np

from ..base.symbols import is_number
from ..dae.members import Label
from .model import Model
from .signals import Inputs, Signal, signal_of, value_at
from .trajectory import Trajectory

_LISTED = 30  # names in an error message
_SAME = 1e-9  # of a run: two times that close are one
_DEFAULT_INTERVALS = 200  # of a run of which only the end is given


@dataclass(frozen=True, eq=False)
class Point:
    """Values of t (s), x, z, u and p of a model; `idle` are parameters that affect outputs only."""

    t: float
    x: np.ndarray
    z: np.ndarray
    u: np.ndarray
    p: np.ndarray
    idle: np.ndarray

    @property
    def arguments(self) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """What every function of the model takes."""
        return self.t, self.x, self.z, self.u, self.p


class HasPoint(Protocol):
    """What holds a point of a model, such as an `Equilibrium`."""

    @property
    def point(self) -> Point:
        """The point."""
        ...


Params: TypeAlias = Mapping[str, float]
"""Values of parameters by name."""

Start: TypeAlias = Union[Mapping[str, float], Point, HasPoint]
"""States to start from: values by name, or the states of a `Point` or an `Equilibrium`."""

Where: TypeAlias = Union[Start, Trajectory, Sequence[float], np.ndarray, None]
"""A place in the state space: a `Start`, a vector of states, a `Trajectory`; None is the start."""

Times: TypeAlias = Union[float, Sequence[float], np.ndarray]
"""The end of a run in s, or its increasing output times, of which the first is the start."""


class Given(TypedDict):
    """What a run is given by name, to be handed on as keyword arguments."""

    inputs: Inputs | None
    params: Params | None
    start: Start | None


@dataclass(frozen=True, eq=False)
class Experiment:
    """What to integrate: output times (n,), start x, z, values p, and one signal for each input.

    `idle` are values of parameters that affect outputs only.
    """

    t: np.ndarray
    x: np.ndarray
    z: np.ndarray
    p: np.ndarray
    inputs: tuple[Signal, ...]
    idle: np.ndarray = field(default_factory=lambda: np.zeros(0))


def as_model(value: Any, where: str) -> Model:
    """Return the value if it is a model.

    Raises:
        TypeError: it is something else; the message says how to get a model.
    """
    if isinstance(value, Model):
        return value
    kind = type(value).__name__
    raise TypeError(f"{where}: model is a {kind}; give a model, such as compile_scene(scene)")


def make_experiment(
    model: Model,
    times: Times,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
) -> Experiment:
    """Turn times, and values by name, into the checked vectors of an `Experiment`.

    Arguments:
        times: the end in s (from 0, in 200 intervals), or increasing output times.
        inputs, params, start: as in `simulate`.

    Raises:
        TypeError: no model, or a start of another kind.
        ValueError: unknown names, numbers that are not finite, times that do not increase.
    """
    dae = as_model(model, "simulate").dae
    parameters = dae.parameters.labels
    values = filled(model, "parameter", parameters, [v.start for v in parameters], params)
    p, idle = values[: model.n_p], values[model.n_p :]
    xz = np.concatenate(_started(model, *dae.start_values(p), start, "start"))
    given = inputs or {}
    check_known(model, "input", dae.u_labels, given)
    where = f"model '{model.name}', input"
    signals = tuple(
        signal_of(given.get(v.name, v.start), f"{where} '{v.name}'", v.unit) for v in dae.u_labels
    )
    return Experiment(_grid(times), xz[: model.n_x], xz[model.n_x :], p, signals, idle)


def _grid(times: Times) -> np.ndarray:
    if is_number(times):
        if not (np.isfinite(float(times)) and float(times) > 0):  # type: ignore[arg-type]
            raise ValueError(f"simulate: t_end {times} s; the end is positive and finite")
        return np.linspace(0.0, float(times), _DEFAULT_INTERVALS + 1)  # type: ignore[arg-type]
    grid = np.array(times, float)
    if grid.ndim != 1 or len(grid) < 2 or not np.isfinite(grid).all() or (np.diff(grid) <= 0).any():
        raise ValueError(
            f"simulate: output times of shape {grid.shape}; they are at least two finite numbers "
            "that increase, the first is the start"
        )
    return grid


def locate(
    model: Model,
    at: Where = None,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
    t: float | None = None,
) -> Point:
    """Build a `Point` from vectors, or from names and values.

    Data states are as events leave them that look at inputs, parameters and time alone: a connector
    that an Input switches is on or off as the Input is.

    Arguments:
        at: a `Point` or what holds one, with its time, inputs and parameters; a `Trajectory`, of
            which the saved point at t is taken, the last one by default, likewise; a vector of
            states; or a start. By default the model's start.
        inputs: by name, a value at t each.
        params: by name.
        start: states and algebraic unknowns that differ from those of `at`; unknowns are not
            solved for.
        t: s, 0 by default.

    Raises:
        TypeError: no model, or a start of another kind.
        ValueError: unknown names, values that are not finite numbers, a trajectory of another
            model.
    """
    where = f"model '{as_model(model, 'linearize').name}'"
    held = at if isinstance(at, Point) else getattr(at, "point", None)
    dae, every = model.dae, model.dae.parameters.labels
    if isinstance(at, Trajectory):
        base = _saved(model, at, t)
    elif isinstance(held, Point):
        base = _of_this_model(model, held)
        base = base if t is None else replace(base, t=_number(t, f"{where}, time", "s"))
    else:
        time = _number(0.0 if t is None else t, f"{where}, time", "s")
        usual = [label.start for label in every]
        values = filled(model, "parameter", every, usual, params)
        p, idle = values[: model.n_p], values[model.n_p :]
        u = np.array([label.start for label in dae.u_labels])
        base = Point(time, *dae.start_values(p), u, p, idle)
        if isinstance(at, Mapping):
            x, z = _started(model, base.x, base.z, at, "point")
            base = replace(base, x=x, z=z)
        elif at is not None:
            base = replace(base, x=_vector(model, at))
    values = filled(model, "parameter", every, [*base.p, *base.idle], params)
    now = {name: value_at(value, base.t) for name, value in (inputs or {}).items()}
    u = filled(model, "input", dae.u_labels, base.u, now)
    x, z = _started(model, base.x, base.z, start, "point")
    return _switched(model, Point(base.t, x, z, u, values[: model.n_p], values[model.n_p :]))


def _switched(model: Model, point: Point) -> Point:
    """The point with the data states that inputs, parameters and the time alone decide."""
    for i in _switches(model):
        if float(model.function("zero")(*point.arguments)[i]) < 0:
            change = np.array(model.function("jump")(*point.arguments)[:, i]).reshape(-1)
            point = replace(point, x=point.x + change)
    return point


def _switches(model: Model) -> tuple[int, ...]:
    """Events that happen at once wherever inputs, parameters, time and data have them happen."""
    dae = model.dae
    if not dae.events:
        return ()

    def build() -> tuple[int, ...]:
        moving = [dae.x[i] for i in range(model.n_x) if i not in dae.data]
        depends = set(ca.jacobian_sparsity(dae.zero, ca.vertcat(dae.z, *moving)).row())
        events = enumerate(dae.events)
        return tuple(i for i, event in events if event.at_once and i not in depends)

    return model.cached("switches", build)


def _of_this_model(model: Model, point: Point) -> Point:
    if len(point.x) != model.n_x or len(point.z) != model.n_z or len(point.p) != model.n_p:
        raise ValueError(
            f"model '{model.name}': a point with {len(point.x)} states, {len(point.z)} unknowns "
            f"and {len(point.p)} parameters is of another model; this one has {model.n_x}, "
            f"{model.n_z} and {model.n_p}"
        )
    return point


def _started(
    model: Model, x: np.ndarray, z: np.ndarray, start: Start | None, what: str
) -> tuple[np.ndarray, np.ndarray]:
    """States and unknowns, those of `start` in their places.

    Arguments:
        what: "point" or "start", for the message.
    """
    if start is None:
        return x, z
    held = start if isinstance(start, Point) else getattr(start, "point", None)
    if isinstance(held, Point):
        held = _of_this_model(model, held)
        return held.x, held.z
    if not isinstance(start, Mapping):
        raise TypeError(
            f"model '{model.name}', start: {type(start).__name__}; give values of states by name, "
            "such as {'arm.p_x': 0.1}, or an Equilibrium"
        )
    check_kept(model, start, what)
    labels = (*model.x_labels, *model.dae.z_labels)
    both = filled(model, "state", labels, [*x, *z], start)
    return both[: model.n_x], both[model.n_x :]


def _saved(model: Model, trajectory: Trajectory, t: float | None) -> Point:
    """A saved point of a trajectory."""
    labels = (*model.x_labels, *model.dae.z_labels)
    if tuple(trajectory.states) != tuple(label.name for label in labels):
        raise ValueError(
            f"model '{model.name}': trajectory '{trajectory.name}' has other states; give one of "
            "this model"
        )
    k = len(trajectory.t) - 1
    if t is not None:
        t = _number(t, f"model '{model.name}', time", "s")
        k = int(np.abs(trajectory.t - t).argmin())
        if abs(trajectory.t[k] - t) > _SAME * (1 + abs(t)):
            raise ValueError(
                f"model '{model.name}': t = {t} s is not a saved time of trajectory "
                f"'{trajectory.name}', the nearest is {trajectory.t[k]:.9g} s; save it, or take it"
            )
    dae = model.dae
    groups = (dae.x_labels, dae.z_labels, dae.u_labels, *dae.parameters[:2])
    columns = [
        np.array([float(trajectory[label.name][k]) for label in labels]) for labels in groups
    ]
    return Point(float(trajectory.t[k]), *columns)


def check_kept(model: Model, given: Mapping[str, float], what: str) -> None:
    """Check that no name is that of a state that the minimal model left out or replaced.

    Arguments:
        what: "point" or "start", for the message.

    Raises:
        ValueError: one is.
    """
    still = {d.name: f"left out at {d.value:.6g}: {d.reason}" for d in model.dropped}
    how = still | {r.name: f"replaced: it is {r.how}" for r in model.replaced}
    rates = {r.name for r in model.replaced if r.is_rate}
    for name in given:
        if name in how:
            remedy = f"a {what} elsewhere needs compile_scene(minimal=False)"
            if name in rates:
                remedy = f"without inertia it has no {what} of its own"
            raise ValueError(f"model '{model.name}': state '{name}' was {how[name]}; {remedy}")


def check_known(model: Model, kind: str, labels: Sequence[Label], given: Mapping[str, Any]) -> None:
    """Check that all names are those of labels.

    Raises:
        TypeError: `given` does not hold values by name.
        ValueError: a name is not among the labels.
    """
    if not isinstance(given, Mapping):
        raise TypeError(
            f"model '{model.name}', {kind}s: {type(given).__name__}; give values by name, such as "
            "{'name': 1.0}"
        )
    names = [label.name for label in labels]
    for name in given:
        if name not in names:
            there = ", ".join(names[:_LISTED]) or "none"
            raise ValueError(f"model '{model.name}': no {kind} '{name}'; there are: {there}")


def filled(
    model: Model, kind: str, labels: Sequence[Label], values: Any, given: Mapping[str, Any] | None
) -> np.ndarray:
    """Return values, with those given by name in their places.

    Raises:
        ValueError: unknown names, values that are no finite numbers.
    """
    given = given or {}
    check_known(model, kind, labels, given)
    out = np.array(values, float)
    for i, label in enumerate(labels):
        if label.name in given:
            where = f"model '{model.name}', {kind} '{label.name}'"
            out[i] = _number(given[label.name], where, label.unit)
    return out


def _vector(model: Model, given: Any) -> np.ndarray:
    """A vector of states, checked."""
    labels = model.x_labels
    try:
        vector = np.array(given, float).reshape(-1)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"model '{model.name}': states {given!r}; give a vector of {len(labels)} numbers, "
            "names and values, an Equilibrium or a Trajectory"
        ) from error
    if len(vector) != len(labels) or not np.isfinite(vector).all():
        raise ValueError(
            f"model '{model.name}': a vector of {len(vector)} states; it has {len(labels)} finite "
            f"ones: {', '.join(label.name for label in labels[:_LISTED])}"
        )
    return vector


def _number(value: Any, where: str, unit: str) -> float:
    if not is_number(value) or not np.isfinite(float(value)):
        raise ValueError(f"{where}: {value!r} {unit}; give a finite number")
    return float(value)
