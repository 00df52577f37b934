"""A point of a model: time, states, unknowns, inputs, parameters, given by name or as vectors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias, Union

import casadi as ca
import numpy as np

from ..base.symbols import is_number
from ..dae.members import Label
from .model import Model
from .trajectory import Samples, Trajectory

Where: TypeAlias = Union[
    "Point", Trajectory, Mapping[str, float], Sequence[float], np.ndarray, None
]
"""Where in the state space: nothing for the start, a state vector, values by name, a trajectory."""

_LISTED = 30  # names in an error message
_SAME = 1e-9  # of a run: two times that close are one


@dataclass(frozen=True, eq=False)
class Point:
    """Values of t (s), x, z, u and p of a model; `idle` are parameters that only outputs feel."""

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


def locate(
    model: Model,
    x: Where = None,
    z: Mapping[str, float] | Sequence[float] | np.ndarray | None = None,
    inputs: Mapping[str, Any] | None = None,
    params: Mapping[str, float] | None = None,
    t: float | None = None,
) -> Point:
    """The point that vectors, names and values tell of.

    Data states are as events leave them that look at inputs, parameters and time alone: a connector
    that an Input switches is on or off as the Input is.

    Arguments:
        x: a state vector, values by name (of unknowns, too; the others keep their start), or a
            `Trajectory`, of which the saved point at t is taken, the last one by default, with its
            inputs and parameters.
        z: algebraic unknowns, likewise; as they are, not solved for.
        inputs: by name, a number or a function of t each.
        params: by name.
        t: s, 0 by default.

    Raises:
        ValueError: unknown names, values that are no finite numbers, a trajectory of another model.
    """
    return _switched(model, _located(model, x, z, inputs, params, t))


def _located(model: Model, x: Any, z: Any, inputs: Any, params: Any, t: float | None) -> Point:
    where = f"model '{model.name}'"
    if isinstance(x, Point):
        return _changed(model, x, z, inputs, params, t)
    if isinstance(x, Trajectory):
        return _changed(model, _saved(model, x, t), z, inputs, params, None)
    time = _number(0.0 if t is None else t, f"{where}, time", "s")
    every = (*model.dae.p_labels, *model.dae.idle_p_labels)
    values = filled(model, "parameter", every, [v.start for v in every], params)
    p, idle = values[: model.n_p], values[model.n_p :]
    x0, z0 = model.dae.start_values(p)
    point = Point(time, x0, z0, _inputs(model, inputs, time), p, idle)
    return _moved(model, point, x, z)


def _switched(model: Model, point: Point) -> Point:
    for i in _switches(model):
        if float(model.function("zero")(*point.arguments)[i]) < 0:
            change = np.array(model.function("jump")(*point.arguments)[:, i]).reshape(-1)
            point = replace(point, x=point.x + change)
    return point


def _switches(model: Model) -> tuple[int, ...]:
    """Events that happen at once wherever inputs, parameters, time and data have them happen."""
    dae = model.dae
    if "switches" not in model.memo and dae.events:
        moving = [dae.x[i] for i in range(model.n_x) if i not in dae.data]
        reads = ca.jacobian_sparsity(dae.zero, ca.vertcat(dae.z, *moving))
        looks = set(reads.row())
        model.memo["switches"] = tuple(
            i for i, event in enumerate(dae.events) if event.at_once and i not in looks
        )
    return model.memo.get("switches", ())


def _changed(
    model: Model, point: Point, z: Any, inputs: Any, params: Any, t: float | None
) -> Point:
    if len(point.x) != model.n_x or len(point.z) != model.n_z or len(point.p) != model.n_p:
        raise ValueError(
            f"model '{model.name}': a point with {len(point.x)} states, {len(point.z)} unknowns "
            f"and {len(point.p)} parameters is of another model; this one has {model.n_x}, "
            f"{model.n_z} and {model.n_p}"
        )
    if t is not None:
        point = replace(point, t=_number(t, f"model '{model.name}', time", "s"))
    every = (*model.dae.p_labels, *model.dae.idle_p_labels)
    values = filled(model, "parameter", every, [*point.p, *point.idle], params)
    point = replace(point, p=values[: model.n_p], idle=values[model.n_p :])
    if inputs:
        point = replace(point, u=_inputs(model, inputs, point.t, point.u))
    return _moved(model, point, None, z)


def _moved(model: Model, point: Point, x: Any, z: Any) -> Point:
    """The point with other states and unknowns."""
    labels = (*model.x_labels, *model.dae.z_labels)
    if isinstance(x, Mapping):
        check_kept(model, x, "point")
        both = filled(model, "state", labels, [*point.x, *point.z], x)
        point = replace(point, x=both[: model.n_x], z=both[model.n_x :])
    elif x is not None:
        point = replace(point, x=_vector(model, "states", model.x_labels, x))
    if isinstance(z, Mapping):
        point = replace(point, z=filled(model, "unknown", model.dae.z_labels, point.z, z))
    elif z is not None:
        point = replace(point, z=_vector(model, "unknowns", model.dae.z_labels, z))
    return point


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
        k = int(np.abs(trajectory.t - t).argmin())
        if abs(trajectory.t[k] - t) > _SAME * (1 + abs(t)):
            raise ValueError(
                f"model '{model.name}': t = {t} s is no saved time of trajectory "
                f"'{trajectory.name}', the nearest is {trajectory.t[k]:.9g} s; save it, or take it"
            )

    def values(labels: Sequence[Label]) -> np.ndarray:
        return np.array([float(trajectory[label.name][k]) for label in labels])

    dae = model.dae
    return Point(
        float(trajectory.t[k]),
        values(dae.x_labels),
        values(dae.z_labels),
        values(dae.u_labels),
        values(dae.p_labels),
        values(dae.idle_p_labels),
    )


def _inputs(model: Model, given: Mapping[str, Any] | None, t: float, old: Any = None) -> np.ndarray:
    """Values of the inputs at time t."""
    labels = model.dae.u_labels
    before = [label.start for label in labels] if old is None else old
    return filled(model, "input", labels, before, {k: _at(v, t) for k, v in (given or {}).items()})


def _at(signal: Any, t: float) -> Any:
    if isinstance(signal, Samples):
        return float(np.interp(t, signal.t, signal.values))
    return signal(t) if isinstance(signal, Callable) else signal  # type: ignore[arg-type]


def check_kept(model: Model, given: Mapping[str, float], what: str) -> None:
    """No name is that of a state that the minimal model left out or replaced.

    Arguments:
        what: "point" or "start", for the message.

    Raises:
        ValueError: one is.
    """
    still = {d.name: f"left out at {d.value:.6g}: {d.reason}" for d in model.dropped}
    how = still | {r.name: f"replaced: it is {r.how}" for r in model.replaced}
    for name in given:
        if name in how:
            remedy = f"a {what} elsewhere needs compile_scene(minimal=False)"
            if "rate of" in how[name]:
                remedy = f"without inertia it has no {what} of its own"
            raise ValueError(f"model '{model.name}': state '{name}' was {how[name]}; {remedy}")


def check_known(model: Model, kind: str, labels: Sequence[Label], given: Mapping[str, Any]) -> None:
    """All names are those of labels.

    Raises:
        ValueError: one is not.
    """
    names = [label.name for label in labels]
    for name in given:
        if name not in names:
            there = ", ".join(names[:_LISTED]) or "none"
            raise ValueError(f"model '{model.name}': no {kind} '{name}'; there are: {there}")


def filled(
    model: Model, kind: str, labels: Sequence[Label], values: Any, given: Mapping[str, Any] | None
) -> np.ndarray:
    """Values with those given by name in their places.

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


def _vector(model: Model, kind: str, labels: Sequence[Label], given: Any) -> np.ndarray:
    try:
        vector = np.array(given, float).reshape(-1)
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"model '{model.name}': {kind} {given!r}; give a vector of {len(labels)} numbers, or "
            "names and values"
        ) from error
    if len(vector) != len(labels) or not np.isfinite(vector).all():
        raise ValueError(
            f"model '{model.name}': a vector of {len(vector)} {kind}; it has {len(labels)} finite "
            f"ones: {', '.join(label.name for label in labels[:_LISTED])}"
        )
    return vector


def _number(value: Any, where: str, unit: str) -> float:
    if not is_number(value) or not np.isfinite(float(value)):
        raise ValueError(f"{where}: {value!r} {unit}; give a finite number")
    return float(value)
