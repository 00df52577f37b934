"""Work and precision: the error of integrators against the CPU time they take."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np

from ..base.symbols import is_number
from ..integrators import Dop853, Idas, Rosenbrock
from ..model.model import Model
from ..model.signals import Inputs
from ..model.trajectory import Trajectory
from ..model.values import Given, Params, Start, Times, as_model
from ..pipeline import IntegrationError, simulate
from .table import ResultTable

_POINTS = 20  # output intervals, if only the end is given
_QUANTITIES = ("position", "angle", "velocity", "angular_velocity")
_UNITS = {
    "method": "",
    "setting": "",
    "error": "",
    **{f"error_{q}": "" for q in _QUANTITIES},
    "time": "s",
    "time_min": "s",
    "time_max": "s",
    "steps": "",
    "outcome": "",
    "floor": "",
}
Contender = Any
"""An integrator, or a function without arguments that returns a `Trajectory` at the same times.

Such a function may carry a `label`, which the table shows as its setting.
"""


class Reference(NamedTuple):
    """A trajectory that errors are measured against; `converged` returns one.

    Fields:
        trajectory: the reference, at the output times of the comparison.
        floor: difference of a second method from it, as an error; smaller errors are not resolved.
        names: of the method that made it, and of the second one.
    """

    trajectory: Trajectory
    floor: float
    names: tuple[str, str]


def work_precision(
    model: Model,
    integrators: Mapping[str, Sequence[Contender]] | Sequence[Contender],
    times: Times = 1.0,
    reference: Trajectory | Reference | None = None,
    repeats: int = 5,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
) -> ResultTable:
    """Return error and CPU time of each integrator at each setting.

    The error is the largest, over output times and bodies, of the errors in position, rotation
    angle, velocity and angular velocity, each over its excursion: the largest distance from the
    start over the run and all bodies. A run that fails is a row with its outcome and no error; one
    that reports success with wrong numbers is a row with its error.

    >>> table = rs.study.work_precision(model, [rs.Idas(1e-6, 1e-8), rs.Dop853(1e-6, 1e-8)], 2.0)
    >>> rs.plots.work_precision(table)

    Arguments:
        integrators: a list, or lists by the name of the method, such as those of `contenders`.
        times: as in `simulate`, but a number means 20 intervals.
        reference: by default the result of `converged`.
        repeats: timed runs, after one that builds the integrator. Times are CPU times of this
            thread for the whole call; the median is `time`.
        inputs, params, start: as in `simulate`.

    Returns:
        Columns method, setting, error, its four parts, time, time_min, time_max (s), steps,
        outcome, floor (of the reference).

    Raises:
        ValueError: no integrators; no bodies among the model's outputs; other output times.
    """
    as_model(model, "work_precision")
    given: Given = {"inputs": inputs, "params": params, "start": start}
    grid = _grid(times)
    named = _named(integrators)
    if not named:
        raise ValueError("work_precision: no integrators; give a list, such as [Idas(1e-6, 1e-8)]")
    if reference is None:
        reference = converged(model, grid, **given)
    if isinstance(reference, Trajectory):
        reference = Reference(reference, 0.0, ("given", ""))
    measure = ErrorOf(model, reference.trajectory)
    rows = [
        (
            name,
            setting_text(contender),
            *_row(_runner(model, contender, grid, given), repeats, measure),
        )
        for name, contender in named
    ]
    floor = reference.floor
    return ResultTable(tuple(_UNITS), tuple(_UNITS.values()), tuple((*row, floor) for row in rows))


def _row(run: Callable[[], Trajectory], repeats: int, measure: ErrorOf) -> tuple[Any, ...]:
    # A run that reports success may still be wrong, which only its measured error shows.
    trajectory, seconds = _timed(run, repeats)
    errors: dict[str, float | None] = dict.fromkeys(_QUANTITIES)
    if trajectory.outcome.ok:
        errors = measure(trajectory)
    known = [e for e in errors.values() if e is not None]
    return (
        max(known, default=None),
        *errors.values(),
        float(np.median(seconds)),
        min(seconds),
        max(seconds),
        trajectory.stats.get("steps"),
        trajectory.outcome.name,
    )


def converged(
    model: Model,
    times: Times = 1.0,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
) -> Reference:
    """Return a run at the tightest useful tolerances, checked by another method.

    `Idas`, `Rosenbrock` and, without algebraic unknowns, `Dop853` simulate the model. Of the two
    that agree best, one is the reference, and their difference its `floor`.

    >>> reference = rs.study.converged(model, 2.0)

    Arguments:
        model: what `compile_scene` returns.
        times: as in `simulate`, but a number means 20 intervals.
        inputs, params, start: as in `simulate`.

    Raises:
        IntegrationError: fewer than two of them reach the end.
        ValueError: no bodies among the model's outputs.
    """
    grid = _grid(times)
    methods: list[Any] = [] if model.n_z else [Dop853(1e-13, 1e-15, max_steps=200_000)]
    methods += [Rosenbrock(1e-12, 1e-14), Idas(1e-13, 1e-14)]
    runs = [
        (
            simulate(model, grid, method, inputs=inputs, params=params, start=start, throw=False),
            type(method).__name__,
        )
        for method in methods
    ]
    good = [(run, name) for run, name in runs if run.outcome.ok]
    if len(good) < 2:
        raise IntegrationError(next(run for run, _ in runs if not run.outcome.ok))
    pairs = []
    for i, (first, name) in enumerate(good):
        measure = ErrorOf(model, first)
        for second, other in good[i + 1 :]:
            floor = max((e for e in measure(second).values() if e is not None), default=0.0)
            pairs.append(Reference(first, floor, (name, other)))
    return min(pairs, key=lambda pair: pair.floor)


class ErrorOf:
    """The error of trajectories against a reference; a call returns that of one trajectory.

    Arguments:
        model: of all trajectories.
        reference: at the output times at which errors are measured.

    Raises:
        ValueError: no bodies among the model's outputs.
    """

    def __init__(self, model: Model, reference: Trajectory) -> None:
        owners = (o.owner for o in model.dae.outputs.values() if o.quantity == "angular_velocity")
        self.bodies = list(owners)
        if not self.bodies:
            raise ValueError(
                f"model '{model.name}': no bodies among its outputs to compare; compile the scene "
                "with the outputs of a body"
            )
        self.t, self._exact = reference.t, _motions(reference, self.bodies)
        moved = {
            q: [_distance(q, m[q], m[q][:1]) for m in self._exact.values()] for q in _QUANTITIES
        }
        # One excursion for all bodies: a body that hardly moves is not measured by its own motion,
        # of which rounding would be a large part.
        self.excursions = {q: float(np.max(distances)) for q, distances in moved.items()}

    def __call__(self, trajectory: Trajectory) -> dict[str, float | None]:
        """Return the error of each quantity, relative to its excursion; None if nothing moves.

        Raises:
            ValueError: the trajectory has other output times than the reference.
        """
        if len(trajectory.t) != len(self.t) or np.abs(trajectory.t - self.t).max() > 1e-9:
            raise ValueError(
                f"{trajectory.name}: {len(trajectory.t)} output times, the reference has "
                f"{len(self.t)}; simulate both at the same times"
            )
        errors: dict[str, float | None] = {}
        found = _motions(trajectory, self.bodies)
        for q in _QUANTITIES:
            size = self.excursions[q]
            distances = (_distance(q, found[b][q], self._exact[b][q]) for b in self.bodies)
            errors[q] = max(float(np.max(d)) for d in distances) / size if size > 0 else None
        return errors


def _motions(trajectory: Trajectory, bodies: Sequence[str]) -> dict[str, dict[str, np.ndarray]]:
    """Return the columns of each body, by quantity."""
    names = dict(
        zip(_QUANTITIES, ("position", "quaternion", "velocity", "angular_velocity"), strict=True)
    )
    trajectory.evaluate([f"{body}.{name}" for body in bodies for name in names.values()])
    return {b: {q: trajectory[f"{b}.{name}"] for q, name in names.items()} for b in bodies}


def _distance(quantity: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distance of two columns over time (n,); of quaternions the rotation angle, rad."""
    if quantity != "angle":
        return np.linalg.norm(a - b, axis=1)
    # q and -q are the same rotation, so the shorter chord counts. It spans half the rotation angle
    # on the unit sphere: angle = 4 asin(chord / 2), which unlike acos(q'q) keeps small angles.
    chord = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return 4 * np.arcsin(np.minimum(chord / 2, 1.0))


def _grid(times: Times) -> np.ndarray:
    return np.linspace(0.0, float(times), _POINTS + 1) if is_number(times) else np.array(times)  # type: ignore[arg-type]


def _named(integrators: Any) -> list[tuple[str, Contender]]:
    if isinstance(integrators, Mapping):
        return [(name, one) for name, several in integrators.items() for one in several]
    return [(type(one).__name__, one) for one in integrators]


def setting_text(contender: Contender) -> str:
    """Return what distinguishes a contender: its `label`, or its fields other than the defaults."""
    if hasattr(contender, "label"):
        return str(contender.label)
    if not is_dataclass(contender):
        return getattr(contender, "__name__", "")
    own = [(f, getattr(contender, f.name)) for f in fields(contender)]
    texts = (
        f"{f.name} {value:g}" if isinstance(value, float) else f"{f.name} {value}"
        for f, value in own
        if f.default_factory is MISSING and value != f.default
    )
    return ", ".join(texts)


def _runner(
    model: Model, contender: Contender, grid: np.ndarray, given: Given
) -> Callable[[], Trajectory]:
    if hasattr(contender, "solve"):
        return lambda: simulate(model, grid, contender, throw=False, **given)
    if not callable(contender):
        raise TypeError(
            f"work_precision: {contender!r} is neither an integrator nor a function; give objects "
            "such as Idas(), or functions that return a Trajectory"
        )
    return contender


def _timed(run: Callable[[], Trajectory], repeats: int) -> tuple[Trajectory, list[float]]:
    # The first run builds the integrator, which the model keeps. CPU time of this thread leaves out
    # what other processes of the machine do meanwhile.
    trajectory, seconds = run(), []
    for _ in range(max(1, repeats)):
        started = time.thread_time()
        trajectory = run()
        seconds.append(time.thread_time() - started)
    return trajectory, seconds
