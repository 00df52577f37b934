"""Work and precision: the error of integrators against the time they take."""

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
"""An integrator, or a function without arguments that returns a `Trajectory` at the same times."""


class Reference(NamedTuple):
    """A trajectory to measure errors against, what made it, and how far a second one is from it."""

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
    """Error and CPU time of each integrator at each setting.

    The error is the largest over the output times of position, rotation angle, velocity and angular
    velocity of all bodies, each relative to its excursion: its largest distance from the start over
    the run and all bodies. A run that fails is a row with its outcome and no error; one that claims
    success and is wrong is a row with its error.

    Arguments:
        integrators: in order; under names, or under those of their types.
        times: as in `simulate`, but a number gives 20 intervals.
        reference: by default two methods at tight tolerances (`converged`).
        repeats: of each run, after one that builds; the median time counts, the shortest and the
            longest are beside it. Times are CPU times of this thread, of the whole call.
        inputs, params, start: as in `simulate`.

    Returns:
        Table: method, setting, error, its four parts, time, time_min, time_max (s), steps,
            outcome, floor (of the reference).

    Raises:
        ValueError: no integrators, no body in the model's outputs, a reference at other times.
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
    """A run at the tightest useful tolerances, and its difference from one of another method.

    Of `Dop853` (without algebraic unknowns), `Rosenbrock` and `Idas` the two that agree best.

    Raises:
        IntegrationError: fewer than two of them reach the end.
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
    """The error of a trajectory against a reference: its largest parts over time and bodies."""

    def __init__(self, model: Model, reference: Trajectory) -> None:
        owners = (o.owner for o in model.dae.outputs.values() if o.quantity == "angular_velocity")
        self.bodies = list(owners)
        if not self.bodies:
            raise ValueError(f"model '{model.name}': no bodies to compare")
        self.t, self._exact = reference.t, _motions(reference, self.bodies)
        ways = {q: [_way(q, m[q], m[q][:1]) for m in self._exact.values()] for q in _QUANTITIES}
        self.excursions = {q: float(np.max(way)) for q, way in ways.items()}

    def __call__(self, trajectory: Trajectory) -> dict[str, float | None]:
        """Error of each quantity, None for one that does not move.

        Raises:
            ValueError: it has other output times than the reference.
        """
        if len(trajectory.t) != len(self.t) or np.abs(trajectory.t - self.t).max() > 1e-9:
            raise ValueError(
                f"{trajectory.name}: {len(trajectory.t)} output times, the reference has "
                f"{len(self.t)}; both need the same"
            )
        errors: dict[str, float | None] = {}
        found = _motions(trajectory, self.bodies)
        for q in _QUANTITIES:
            size = self.excursions[q]
            ways = (_way(q, found[b][q], self._exact[b][q]) for b in self.bodies)
            errors[q] = max(float(np.max(way)) for way in ways) / size if size > 0 else None
        return errors


def _motions(trajectory: Trajectory, bodies: Sequence[str]) -> dict[str, dict[str, np.ndarray]]:
    """Columns of each body, by quantity."""
    names = dict(
        zip(_QUANTITIES, ("position", "quaternion", "velocity", "angular_velocity"), strict=True)
    )
    trajectory.evaluate([f"{body}.{name}" for body in bodies for name in names.values()])
    return {b: {q: trajectory[f"{b}.{name}"] for q, name in names.items()} for b in bodies}


def _way(quantity: str, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of two columns over time (n,); of quaternions the angle between them, rad."""
    if quantity != "angle":
        return np.linalg.norm(a - b, axis=1)
    # 2 asin of half the chord, between q and the nearer of q and -q.
    chord = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return 4 * np.arcsin(np.minimum(chord / 2, 1.0))


def _grid(times: Times) -> np.ndarray:
    return np.linspace(0.0, float(times), _POINTS + 1) if is_number(times) else np.array(times)  # type: ignore[arg-type]


def _named(integrators: Any) -> list[tuple[str, Contender]]:
    if isinstance(integrators, Mapping):
        return [(name, one) for name, several in integrators.items() for one in several]
    return [(type(one).__name__, one) for one in integrators]


def setting_text(contender: Contender) -> str:
    """What sets a contender apart: its `label`, or the fields that are not their defaults."""
    if hasattr(contender, "label"):
        return str(contender.label)
    if not is_dataclass(contender):
        return getattr(contender, "__name__", "")
    own = [(f, getattr(contender, f.name)) for f in fields(contender)]
    told = (
        f"{f.name} {value:g}" if isinstance(value, float) else f"{f.name} {value}"
        for f, value in own
        if f.default_factory is MISSING and value != f.default
    )
    return ", ".join(told)


def _runner(
    model: Model, contender: Contender, grid: np.ndarray, given: Given
) -> Callable[[], Trajectory]:
    if hasattr(contender, "solve"):
        return lambda: simulate(model, grid, contender, throw=False, **given)
    if not callable(contender):
        raise TypeError(f"work_precision: {contender!r}; give integrators, or functions")
    return contender


def _timed(run: Callable[[], Trajectory], repeats: int) -> tuple[Trajectory, list[float]]:
    trajectory, seconds = run(), []
    for _ in range(max(1, repeats)):
        started = time.thread_time()
        trajectory = run()
        seconds.append(time.thread_time() - started)
    return trajectory, seconds
