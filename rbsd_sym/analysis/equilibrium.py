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

_SETTLED = 1e-12  # last step, relative to 1 + |value|
_GOOD = 1e-8  # last step, or scaled residual, where rounding ends the search
_LARGEST_TURN = 0.5  # rad in one step
_HALVINGS = 8
_FIRST, _SHORTEST, _LONGEST = 1e-3, 1e-12, 1e6  # s, of a step of relaxation
_PATIENCE = 4  # steps of relaxation for each allowed of Newton's method


class Rest(Enum):
    """How a search for rest ended; the value is the message."""

    found = "found"
    unbalanced = "nothing balances what acts, near the start"
    no_progress = "the search made no progress"
    too_many_iterations = "too many iterations"
    not_finite = "a value is not finite"

    @property
    def ok(self) -> bool:
        """Whether the state is a rest."""
        return self is Rest.found


class EquilibriumError(RuntimeError):
    """A search for rest that failed; `equilibrium` holds how far it came."""

    def __init__(self, equilibrium: Equilibrium) -> None:
        super().__init__(equilibrium.report)
        self.equilibrium = equilibrium

    def __reduce__(self) -> tuple[type[EquilibriumError], tuple[Equilibrium]]:
        return EquilibriumError, (self.equilibrium,)


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """A rest of a model, or how far the search for it came.

    Fields:
        point: t, x, z, u, p; `linearize(model, equilibrium)` tells whether it is stable.
        x, z: values of states and unknowns by name, as `simulate(start=...)` takes them.
        outcome, report: how the search ended, and the full sentence.
        residual: largest rate, or algebraic residual, that is left, in SI units of its row.
        iterations: of Newton's method.
        free: directions that nothing decides, by the names that move; the state stays along them
            as close to the start as it can.
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
        """States and unknowns by name."""
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
    """The state at rest near a start: velocities are zero, and nothing accelerates.

    Newton's method with exact Jacobians, by steps in tangent coordinates, so that quaternions keep
    their norm. Steps are shortened where they would lead away [Deuflhard 2011, sec. 3.3], and none
    turns a body by more than 0.5 rad. Where this gets stuck, the motion from the start is followed
    by implicit Euler steps, whose length grows until it has come to rest [Kelley, Keyes 1998].
    Among the steps that free directions leave open it takes the smallest. Which of several
    equilibria it finds depends on the start, and it may be unstable: `linearize` tells.

    Arguments:
        inputs, params: by name; the others keep their default.
        start: states near which to look, as for `simulate`; velocities count as zero. Data states
            keep their values.
        t: s, for scenes that depend on time.
        iterations: at most.
        throw: raise a failure; otherwise it is data in `equilibrium.outcome`.

    Raises:
        ValueError: unknown names, values that are no finite numbers.
        EquilibriumError: no rest was found.
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
    """The point with all velocities zero, those of massless bodies among the unknowns, too."""
    dae, x, z = model.dae, point.x.copy(), point.z.copy()
    way = dae.expansion
    names = {
        (way.labels if way else dae.x_labels)[row].name
        for motion in dae.motions
        for row in motion.velocities
    }
    for values, labels in ((x, dae.x_labels), (z, dae.z_labels)):
        values[[i for i, label in enumerate(labels) if label.name in names]] = 0.0
    return replace(point, x=x, z=z)


class _Linear(NamedTuple):
    """Residual (tangent rates, algebraic) at a point, and its slope by (tangent step, z)."""

    point: Point
    residual: np.ndarray
    slope: Slope


class _Problem:
    """Rates in tangent coordinates and algebraic residuals, which must vanish."""

    def __init__(self, model: Model, point: Point) -> None:
        self.model, self.point, self.chart = model, point, chart_of(model)
        self.free: tuple[str, ...] = ()
        names = [label.name for label in (*self.chart.labels, *model.dae.z_labels)]
        self._names, self._turns = names, _turns(self.chart)

    def search(self, most: int) -> tuple[Rest, int]:
        """Newton's method from the point; where it fails, relaxation and again Newton's method."""
        start = self.point
        outcome, count = self._newton(most)
        if outcome in (Rest.found, Rest.unbalanced):
            return outcome, count
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
                left = np.abs(here.slope.scaled(self._residual(self.point))).max(initial=0.0)
                return (Rest.found if left <= _GOOD else Rest.unbalanced), count
            if after is None:
                return Rest.no_progress, count
            self.point = after
        return Rest.too_many_iterations, most

    def _nearer(self, here: _Linear, step: np.ndarray) -> Point | None:
        """Where a part of Newton's step leads that gets nearer to rest.

        Nearer by the next step of the same slope [Deuflhard 2011, sec. 3.3], in which stiff and
        soft directions count alike.
        """
        size = float(np.linalg.norm(step))
        for factor in self._factors(step):
            trial = self._moved(factor * step)
            again = np.linalg.norm(here.slope.solve(self._residual(trial)))
            if again <= (1 - factor / 4) * size:
                return trial
        return None

    def _relax(self, most: int) -> int:
        """Motion that is damped as far as it can be: implicit Euler steps, longer and longer."""
        rates = np.arange(self.chart.size + self.model.n_z) < self.chart.size
        h = _FIRST
        for count in range(most):
            here = self._at(self.point)
            if not (np.isfinite(here.residual).all() and here.slope.finite):
                return count
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
        """Parts of a step to try; the longest turns nothing by more than is allowed."""
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
        """What came of it."""
        point, dae = self.point, self.model.dae
        ode, alg = self._rates(point)
        rows = np.concatenate([ode, alg])
        labels = [f"{label.name} changes by" for label in dae.x_labels]
        labels += [f"the balance of {label.name} is off by" for label in dae.z_labels]
        size = np.where(np.isfinite(rows), np.abs(rows), np.inf)
        residual = float(size.max(initial=0.0))
        report = f"rest {outcome.value} in {count} iterations, largest residual {residual:.3g}"
        if self.free:
            report += f"; nothing decides {', '.join(self.free)}"
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
            return f"nothing holds {', '.join(self.free)}: hold it by stiffness, or remove the load"
        if outcome is Rest.not_finite:
            return "check parameters and start values"
        return "give a start nearer to rest, or simulate with more damping until it comes to rest"


def _turns(chart: Chart) -> list[int]:
    """Tangent coordinates that are angles."""
    return [i for i, label in enumerate(chart.labels) if label.unit == "rad"]


def _dense(value: Any) -> np.ndarray:
    return np.array(ca.DM(value).full())
