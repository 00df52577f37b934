"""Static equilibrium: a state without velocities in which nothing accelerates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..base.linalg import Slope, named_directions
from ..model.model import Model
from ..model.signals import Inputs
from ..model.values import Params, Point, Start, as_model, locate
from .tangent import Chart, chart_of, left_inverse

# Newton's method has converged when its last step, relative to 1 + |value|, is below _SETTLED; or
# below _GOOD if rounding allows no better.
_SETTLED = 1e-12
_GOOD = 1e-8
# Largest rotation of a body in one step, rad.
_LARGEST_TURN = 0.5
_HALVINGS = 8
# First, shortest and longest step of relaxation, s.
_FIRST, _SHORTEST, _LONGEST = 1e-3, 1e-12, 1e6
# Steps of relaxation allowed for each allowed Newton step.
_PATIENCE = 4


class Rest(Enum):
    """How a search for an equilibrium ended; the value of a member is its message."""

    found = "found"
    unbalanced = "the loads cannot be balanced near the start"
    no_progress = "the search made no progress"
    too_many_iterations = "too many iterations"
    not_finite = "a value is not finite"

    @property
    def ok(self) -> bool:
        """Whether an equilibrium was found."""
        return self is Rest.found


class EquilibriumError(RuntimeError):
    """Raised by `static_equilibrium` when it finds no equilibrium.

    The message is the report of the search: the outcome, the largest residual with its unit, and
    what to change. `error.equilibrium` holds the last state that was reached, with the same report;
    `static_equilibrium(..., throw=False)` returns it instead of raising.
    """

    def __init__(self, equilibrium: Equilibrium) -> None:
        super().__init__(equilibrium.report)
        self.equilibrium = equilibrium

    def __reduce__(self) -> tuple[type[EquilibriumError], tuple[Equilibrium]]:
        return EquilibriumError, (self.equilibrium,)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A static equilibrium of a model, or the last state that the search for it reached.

    Fields:
        name: of the model.
        point: t, x, z, u, p; `linearize(model, equilibrium)` shows whether it is stable.
        x, z: values of states and algebraic unknowns by name, as `simulate(start=...)` takes them.
        outcome, report: how the search ended, and a sentence with the residual and advice.
        residual: largest rate, or algebraic residual, that is left, in the SI unit of its row.
        iterations: number of steps, of Newton's method and of relaxation.
        free: directions that the equations do not determine, each by the names of the coordinates
            that move along it; the state stays as close to the start as possible along them.

    >>> run = simulate(model, 2.0, start=static_equilibrium(model))  # doctest: +SKIP
    """

    name: str
    point: Point
    x: dict[str, float]
    z: dict[str, float]
    outcome: Rest
    report: str
    residual: float
    iterations: int
    free: tuple[str, ...]

    @property
    def state(self) -> dict[str, float]:
        """States and algebraic unknowns by name, for `simulate(start=...)`."""
        return self.x | self.z

    def __str__(self) -> str:
        return f"{self.name}: {self.report}"

    def __repr__(self) -> str:
        return f"<Equilibrium of '{self.name}': {self.outcome.value}>"


def static_equilibrium(
    model: Model,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
    t: float = 0.0,
    iterations: int = 100,
    throw: bool = True,
) -> Equilibrium:
    """Find a state near a start in which velocities are zero and nothing accelerates.

    Solves 0 = ode(t, x, z, u, p), 0 = alg by Newton's method with exact Jacobians. Steps are taken
    in tangent coordinates, so that quaternions keep their norm. A step that does not come nearer to
    the solution is shortened [Deuflhard 2011, sec. 3.3], and none rotates a body by more than 0.5
    rad. Where Newton's method fails, implicit Euler steps of growing length follow the motion from
    the start until it has come to rest [Kelley, Keyes 1998]. Along directions that the equations
    do not determine, each step is the smallest possible.

    Which of several equilibria is found depends on the start, and it may be unstable: check it with
    `linearize`.

    Arguments:
        inputs, params: values by name; the others keep their default. An input that varies in time
            is taken at t.
        start: states near which to search, as for `simulate`; velocities count as zero. Data states
            keep their values.
        t: time in s, for scenes that depend on time.
        iterations: Newton steps, at most.
        throw: raise an error on failure; otherwise the failure is data in `equilibrium.outcome`.

    Raises:
        TypeError: `model` is not a model.
        ValueError: unknown names, values that are not finite numbers.
        EquilibriumError: no equilibrium was found.

    >>> rest = static_equilibrium(model, params={"k": 3e4})    # doctest: +SKIP
    >>> rest.x["arm.p_z"], linearize(model, rest).stable       # doctest: +SKIP
    """
    as_model(model, "static_equilibrium")
    point = locate(model, inputs=inputs, params=params, start=start, t=t)
    problem = _Problem(model, _stopped(model, point))
    outcome, count = problem.search(iterations)
    result = problem.result(outcome, count)
    if throw and not outcome.ok:
        raise EquilibriumError(result)
    return result


def _stopped(model: Model, point: Point) -> Point:
    """Return the point with all velocities zero, also those among the algebraic unknowns."""
    dae, x, z = model.dae, point.x.copy(), point.z.copy()
    expansion = dae.expansion
    names = {
        (expansion.labels if expansion else dae.x_labels)[row].name
        for motion in dae.motions
        for row in motion.velocities
    }
    for values, labels in ((x, dae.x_labels), (z, dae.z_labels)):
        values[[i for i, label in enumerate(labels) if label.name in names]] = 0.0
    return replace(point, x=x, z=z)


class _Linear(NamedTuple):
    """Residual [tangent rates; alg] at a point, and its derivative by [tangent step; z]."""

    point: Point
    residual: np.ndarray
    slope: Slope


class _Problem:
    """The equations of an equilibrium, [tangent rates; alg] = 0, and the search for a solution."""

    def __init__(self, model: Model, point: Point) -> None:
        self.model, self.point, self.chart = model, point, chart_of(model)
        self.free: tuple[str, ...] = ()
        names = [label.name for label in (*self.chart.labels, *model.dae.z_labels)]
        self._names, self._turns = names, _turns(self.chart)

    def search(self, most: int) -> tuple[Rest, int]:
        """Search by Newton's method; where it fails, relax from the start and try again.

        Returns:
            The outcome, and the number of all steps.
        """
        start = self.point
        outcome, count = self._newton(most)
        if outcome in (Rest.found, Rest.unbalanced):
            return outcome, count
        # Newton's method may have moved far from the start; relaxation begins there again.
        stuck, self.point = (outcome, self.point), start
        relaxed = self._relax(_PATIENCE * most)
        outcome, again = self._newton(most)
        if not outcome.ok and outcome is not Rest.unbalanced:
            outcome, self.point = stuck
        return outcome, count + relaxed + again

    def _newton(self, most: int) -> tuple[Rest, int]:
        for count in range(most + 1):
            here = self._at(self.point)
            if not (np.isfinite(here.residual).all() and here.slope.finite):
                return Rest.not_finite, count
            step = -here.slope.solve(here.residual)
            size, after = self._size(step), self._nearer(here, step)
            self.free = named_directions(here.slope.null, self._names)
            if size <= _GOOD and (after is None or size <= _SETTLED):
                self.point = after or self.point
                # The least-squares step of a singular system is also small where loads act along a
                # free direction, which nothing can balance: only the residual shows that.
                left = np.abs(here.slope.scaled(self._residual(self.point))).max(initial=0.0)
                return (Rest.found if left <= _GOOD else Rest.unbalanced), count
            if after is None:
                return Rest.no_progress, count
            self.point = after
        return Rest.too_many_iterations, most

    def _nearer(self, here: _Linear, step: np.ndarray) -> Point | None:
        """Return the point after the longest part of Newton's step that comes nearer to rest."""
        # The natural monotonicity test [Deuflhard 2011, sec. 3.3]: the next step with the same
        # Jacobian must be shorter. In its length stiff and soft directions count alike, whereas the
        # norm of the residual would be that of the stiff ones alone.
        size = float(np.linalg.norm(step))
        for factor in self._factors(step):
            trial = self._moved(factor * step)
            again = np.linalg.norm(here.slope.solve(self._residual(trial)))
            if again <= (1 - factor / 4) * size:
                return trial
        return None

    def _relax(self, most: int) -> int:
        """Follow the motion by implicit Euler steps of growing length; return their number.

        Implicit Euler damps every oscillation that is fast against the step, so that long steps
        come to rest at a stable equilibrium (pseudo-transient continuation).
        """
        rates = np.arange(self.chart.size + self.model.n_z) < self.chart.size
        h = _FIRST
        for count in range(most):
            here = self._at(self.point)
            if not (np.isfinite(here.residual).all() and here.slope.finite):
                return count
            # One Newton step of (q1 - q0) / h = rates(q1), 0 = alg, and the remainder `missed` of a
            # second one as a measure of its error.
            M = np.diag(rates / h) - here.slope.J
            try:
                step = np.linalg.solve(M, here.residual)
                trial = self._moved(step)
                missed = np.linalg.solve(M, rates * step / h - self._residual(trial))
            except np.linalg.LinAlgError:
                h /= 4
                continue
            turn = float(np.abs(step[self._turns]).max(initial=0.0))
            size = float(np.linalg.norm(step))
            if not np.linalg.norm(missed) <= size / 2 + _SETTLED or turn > _LARGEST_TURN:
                h /= 4
                if h < _SHORTEST:
                    return count
                continue
            self.point, h = trial, 3 * h
            if h > _LONGEST and self._size(step) <= _GOOD:
                return count
        return most

    def _factors(self, step: np.ndarray) -> list[float]:
        """Return fractions of a step to try; the largest keeps rotations within the limit."""
        turn = float(np.abs(step[self._turns]).max(initial=0.0))
        longest = min(1.0, _LARGEST_TURN / turn) if turn else 1.0
        return [longest / 2.0**k for k in range(_HALVINGS)] if np.isfinite(turn) else []

    def _size(self, step: np.ndarray) -> float:
        plain, turns = self.chart.plain, self.chart.size - len(self.chart.plain)
        values = np.concatenate([self.point.x[plain], np.zeros(turns), self.point.z])
        return float((np.abs(step) / (1 + np.abs(values))).max(initial=0.0))

    def _moved(self, step: np.ndarray) -> Point:
        here, n = self.point, self.chart.size
        x = np.array(self.chart.retract(here.x, here.z, here.p, step[:n])).reshape(-1)
        return replace(here, x=x, z=here.z + step[n:])

    def _rates(self, point: Point) -> tuple[np.ndarray, np.ndarray]:
        return tuple(  # type: ignore[return-value]
            np.array(self.model.function(name)(*point.arguments)).reshape(-1)
            for name in ("ode", "alg")
        )

    def _residual(self, point: Point) -> np.ndarray:
        ode, alg = self._rates(point)
        back = left_inverse(_dense(self.chart.basis(point.x, point.z, point.p)))
        return np.concatenate([back @ ode, alg])

    def _at(self, point: Point) -> _Linear:
        T = _dense(self.chart.basis(point.x, point.z, point.p))
        back = left_inverse(T)
        f_x, f_z, g_x, g_z = (
            _dense(self.model.function(f"d{f}_d{v}")(*point.arguments))
            for f in ("ode", "alg")
            for v in "xz"
        )
        J = np.block([[back @ f_x @ T, back @ f_z], [g_x @ T, g_z]])
        return _Linear(point, self._residual(point), Slope(J))

    def result(self, outcome: Rest, count: int) -> Equilibrium:
        """Build the `Equilibrium` at the last point, with its report."""
        point, dae = self.point, self.model.dae
        ode, alg = self._rates(point)
        rows = np.concatenate([ode, alg])
        labels = [f"{label.name} changes by" for label in dae.x_labels]
        labels += [f"the balance of {label.name} is off by" for label in dae.z_labels]
        size = np.where(np.isfinite(rows), np.abs(rows), np.inf)
        residual = float(size.max(initial=0.0))
        report = (
            f"equilibrium {outcome.value} in {count} iterations, largest residual {residual:.3g}"
        )
        if self.free:
            report += f"; the equations do not determine {', '.join(self.free)}"
        if not outcome.ok:
            worst = int(size.argmax()) if len(rows) else 0
            units = [f"{label.unit} per s" for label in dae.x_labels] + [""] * len(dae.z_labels)
            report = (
                f"static_equilibrium, model '{self.model.name}': {outcome.value}, after {count} "
                f"iterations; {labels[worst]} {rows[worst]:.6g} {units[worst]}".rstrip()
                + f"; {self._advice(outcome)}"
            )
        x = {label.name: float(v) for label, v in zip(dae.x_labels, point.x, strict=True)}
        z = {label.name: float(v) for label, v in zip(dae.z_labels, point.z, strict=True)}
        return Equilibrium(
            self.model.name, point, x, z, outcome, report, residual, count, self.free
        )

    def _advice(self, outcome: Rest) -> str:
        if outcome is Rest.unbalanced and self.free:
            return f"nothing holds {', '.join(self.free)}: add stiffness there, or remove the load"
        if outcome is Rest.not_finite:
            return "check parameters and start values"
        return "give a start nearer to rest, or simulate with more damping until it comes to rest"


def _turns(chart: Chart) -> list[int]:
    """Return the indices of the tangent coordinates that are angles."""
    return [i for i, label in enumerate(chart.labels) if label.unit == "rad"]


def _dense(value: Any) -> np.ndarray:
    return np.array(ca.DM(value).full())
