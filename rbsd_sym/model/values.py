"""Values that a model is called with, from names and vectors: points, starts, experiments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeAlias, TypedDict, Union

import casadi as ca
import numpy as np

from ..base.symbols import Scalar, is_number
from ..dae.members import Label
from .model import Model
from .signals import Inputs, Signal, signal_of, value_at
from .trajectory import Trajectory

# Names listed in an error message, at most.
_LISTED = 30
# Times that differ by less, relative to 1 + |t|, are one.
_SAME = 1e-9
# Output intervals of a run of which only the end is given.
_DEFAULT_INTERVALS = 200


@dataclass(frozen=True, eq=False)
class Point:
    """Values of all arguments of a model's functions at one point, as numpy vectors in SI units.

    `locate` makes one from names and values; `linearize` and `simulate(start=...)` take it.

    Fields:
        t: time, s.
        x, z: states (n_x,) and algebraic unknowns (n_z,), in the order of their labels.
        u, p: inputs (n_u,) and parameters (n_p,).
        idle: parameters that affect only outputs which were not requested.
        states: names of states and unknowns, by which a model recognises a point of its own.

    >>> point = locate(model, start={"arm.p_x": 0.1})         # doctest: +SKIP
    >>> model.function("ode")(*point.arguments)               # doctest: +SKIP
    """

    t: float
    x: np.ndarray
    z: np.ndarray
    u: np.ndarray
    p: np.ndarray
    idle: np.ndarray
    states: tuple[str, ...] = ()

    @property
    def arguments(self) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """(t, x, z, u, p), the arguments of every function of the model."""
        return self.t, self.x, self.z, self.u, self.p


class HasPoint(Protocol):
    """A value that holds a point of a model, such as an `Equilibrium`."""

    @property
    def point(self) -> Point:
        """The point."""
        ...


Params: TypeAlias = Mapping[str, float]
"""Values of parameters by name."""

Start: TypeAlias = Union[Mapping[str, float], Point, HasPoint]
"""States to start from: values by name, or the states of a `Point` or an `Equilibrium`."""

Where: TypeAlias = Union[Start, Trajectory, Sequence[float], np.ndarray, None]
"""A point of the state space: a `Start`, a vector of states, a `Trajectory`; None is the start."""

Times: TypeAlias = Union[float, Sequence[float], np.ndarray]
"""The end of a run in s, or its increasing output times, of which the first is the start."""


class Given(TypedDict):
    """Keyword arguments of a run, for functions that pass them on to `simulate`."""

    inputs: Inputs | None
    params: Params | None
    start: Start | None


@dataclass(frozen=True, eq=False)
class Experiment:
    """An integration to be done, as checked vectors: what `Integrator.solve` takes with a model.

    Fields:
        t: output times (n,), s, increasing; the first one is the start.
        x, z: start values of states (n_x,) and algebraic unknowns (n_z,); z need only be near a
            solution of alg = 0.
        p: values of the parameters (n_p,).
        inputs: one signal for each input, in the order of u.
        idle: values of parameters that affect only outputs which were not requested.
    """

    t: np.ndarray
    x: np.ndarray
    z: np.ndarray
    p: np.ndarray
    inputs: tuple[Signal, ...]
    idle: np.ndarray = field(default_factory=lambda: np.zeros(0))


def as_model(value: Any, where: str) -> Model:
    """Return the value if it is a `Model`.

    Arguments:
        value: what a caller passed as a model; a scene is the usual mistake.
        where: name of the function that was called, for the message.

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

    Values that are not given keep their default; start values that depend on parameters follow the
    values in `params`.

    Arguments:
        times: the end in s (from 0, in 200 intervals), or increasing output times.
        inputs, params, start: as in `simulate`.

    Raises:
        TypeError: `model` is not a model, or `start` is of an unknown kind.
        ValueError: unknown names, numbers that are not finite, times that do not increase.

    >>> Idas().solve(model, make_experiment(model, 2.0))  # doctest: +SKIP
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
            raise ValueError(f"simulate: t_end {times} s; give a positive, finite end time")
        return np.linspace(0.0, float(times), _DEFAULT_INTERVALS + 1)  # type: ignore[arg-type]
    grid = np.array(times, float)
    if grid.ndim != 1 or len(grid) < 2 or not np.isfinite(grid).all() or (np.diff(grid) <= 0).any():
        raise ValueError(
            f"simulate: output times of shape {grid.shape} s; give at least two finite numbers "
            "that increase, of which the first is the start"
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
    """Build a `Point` of a model from vectors, or from names and values.

    Data states that inputs, parameters and time alone determine are updated by their events, so
    that a connector which an Input switches is on or off as that Input says.

    Arguments:
        at: where to begin: a `Point`, or a value that holds one such as an `Equilibrium`, with its
            time, inputs and parameters; a `Trajectory`, of which the saved point at t is taken (by
            default the last one) with its inputs and parameters; a vector of states (n_x,); or
            states by name. By default the model's start.
        inputs: by name: numbers, functions of t or samples, which are evaluated at t.
        params: values by name; the others are those of `at`, or keep their default.
        start: values of states and algebraic unknowns that differ from those of `at`. The unknowns
            are taken as given, and need not solve their equations.
        t: time in s; by default that of `at`, or 0.

    Raises:
        TypeError: `model` is not a model, or `start` is of an unknown kind.
        ValueError: unknown names, values that are not finite numbers, a trajectory or point of
            another model.

    >>> locate(model, trajectory, t=0.5, params={"k": 3e4})  # doctest: +SKIP
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
    p, idle = values[: model.n_p], values[model.n_p :]
    return _switched(model, Point(base.t, x, z, u, p, idle, _state_names(model)))


def _switched(model: Model, point: Point) -> Point:
    """Return the point with the data states that inputs, parameters and time alone determine."""
    # A single point has no run in which the event of a switch could fire, so it fires here.
    for i in _switches(model):
        if float(model.function("zero")(*point.arguments)[i]) < 0:
            change = np.array(model.function("jump")(*point.arguments)[:, i]).reshape(-1)
            point = replace(point, x=point.x + change)
    return point


def _switches(model: Model) -> tuple[int, ...]:
    """Return the indices of the events that are due at once by inputs, parameters, time and data.

    Their functions depend on no other state and on no algebraic unknown.
    """
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
            f"{model.n_z} and {model.n_p}; make it with locate(model, ...)"
        )
    own = _state_names(model)
    if point.states and point.states != own:
        raise ValueError(
            f"model '{model.name}': a point with the states {', '.join(point.states[:_LISTED])} is "
            f"of another model; this one has {', '.join(own[:_LISTED])}; make it with "
            "locate(model, ...)"
        )
    return point


def _state_names(model: Model) -> tuple[str, ...]:
    return tuple(label.name for label in (*model.x_labels, *model.dae.z_labels))


def _started(
    model: Model, x: np.ndarray, z: np.ndarray, start: Start | None, what: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return states and unknowns, with the values given in `start` in their places.

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
    """Return a saved point of a trajectory, by default the last one."""
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
                f"'{trajectory.name}', the nearest is {trajectory.t[k]:.9g} s; use that one, or "
                "simulate with this time among the output times"
            )
    dae = model.dae
    groups = (dae.x_labels, dae.z_labels, dae.u_labels, *dae.parameters[:2])
    columns = [
        np.array([float(trajectory[label.name][k]) for label in labels]) for labels in groups
    ]
    x, z, u, p, idle = columns
    return Point(float(trajectory.t[k]), x, z, u, p, idle, _state_names(model))


def check_kept(model: Model, given: Mapping[str, float], what: str) -> None:
    """Check that no value is given for a state that the minimal model left out or replaced.

    Arguments:
        given: values by name of state.
        what: "point" or "start", for the message.

    Raises:
        ValueError: one is; the message gives the value or formula of that state, and the remedy.
    """
    still = {d.name: f"left out at {d.value:.6g}: {d.reason}" for d in model.dropped}
    how = still | {r.name: f"replaced: it is {r.how}" for r in model.replaced}
    rates = {r.name for r in model.replaced if r.is_rate}
    for name in given:
        if name in how:
            remedy = f"for a {what} elsewhere use compile_scene(minimal=False)"
            if name in rates:
                remedy = f"without inertia it has no {what} value of its own; leave it out"
            raise ValueError(f"model '{model.name}': state '{name}' was {how[name]}; {remedy}")


def check_known(model: Model, kind: str, labels: Sequence[Label], given: Mapping[str, Any]) -> None:
    """Check that all names given are names of labels.

    Arguments:
        kind: "state", "input" or "parameter", for the message.
        given: values by name.

    Raises:
        TypeError: `given` is not a mapping from names to values.
        ValueError: a name is not among the labels; the message lists those that are.
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
    """Return a vector of values, one for each label, with those given by name in their places.

    Arguments:
        kind: "state", "input" or "parameter", for the message.
        values: default values (n,), in the order of the labels.
        given: values by name, or None.

    Raises:
        ValueError: unknown names, values that are not finite numbers.
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
    """Check a vector of states, and return it as an array (n_x,)."""
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
            f"model '{model.name}': a vector of {len(vector)} states; it has {len(labels)}; give "
            f"finite values of {', '.join(label.name for label in labels[:_LISTED])}"
        )
    return vector


def _number(value: Any, where: str, unit: str) -> float:
    plain = is_number(value) and not isinstance(value, Scalar)
    if not plain or not np.isfinite(value):
        raise ValueError(f"{where}: {value!r} {unit}; give a finite number")
    return float(value)
