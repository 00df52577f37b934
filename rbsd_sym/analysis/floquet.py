"""Stability of periodic motion: multipliers of disturbances over one period.

The motion is integrated once; disturbances follow the linear equations along it, q' = A(t) q in
tangent coordinates, by exponentials of Magnus' series, which are exact where A rests, however
stiff it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ..integrators import Idas
from ..model.model import Model
from ..model.signals import Inputs
from ..model.trajectory import Trajectory
from ..model.values import Params, Point, Start, as_model, locate, make_experiment
from ..pipeline import IntegrationError, Integrator, as_integrator
from .linearize import balanced, left_out_tangent
from .tangent import Chart, chart_of, left_inverse

NODES = 0.5 + np.array([-1, 0, 1]) * np.sqrt(15) / 10  # of Gauss, in an interval
_FEWEST, _MOST = 16, 8192  # intervals in a period
_TERMS = 18  # of the exponential's series, after scaling to less than 1
_ROUNDING = 1e-10  # of the monodromy matrix: rounding and the motion's own error
_RETURNED = 1e-7  # of 1 + |state|: a motion that comes back so close is periodic
_DRIVEN = 1e-6  # of 1 + the largest rate: rounding of a drive after a period
_SHOTS = 10  # of Newton's method, to find a periodic motion
_FREE = 1e-8  # of the largest singular value: directions in which every motion is periodic


class NotPeriodic(RuntimeError):
    """No periodic motion was found near the start."""


class Multipliers(NamedTuple):
    """Eigenvalues (k,) of a monodromy matrix, and how far errors may have moved each (k,)."""

    values: np.ndarray
    errors: np.ndarray

    def exponents(self, period: float) -> np.ndarray:
        """Growth rates log|m| / period, 1/s; a modulus within its error of 1 counts as 0."""
        size = np.abs(self.values)
        rates = np.log(np.maximum(size, 1e-300)) / period
        return np.where(np.abs(size - 1) <= self.errors, 0.0, rates)


@dataclass(frozen=True, eq=False)
class Floquet:
    """Stability of a periodic motion.

    Fields:
        period: s.
        kept, left_out: multipliers of the model's own motion, and of what a minimal model left out.
        start: the state at which the periodic motion starts, by name.
        miss: how far it is from its start after a period, relative to 1 + |state|.
        intervals: of the period.
    """

    period: float
    kept: Multipliers
    left_out: Multipliers
    start: Mapping[str, float]
    miss: float
    intervals: int

    @property
    def multiplier(self) -> float:
        """Largest modulus of all multipliers; more than 1 is unstable."""
        both = np.concatenate([self.kept.values, self.left_out.values])
        return float(np.abs(both).max(initial=0.0))

    def __repr__(self) -> str:
        return f"<Floquet: period {self.period:.6g} s, growth {self.abscissa:.6g} 1/s>"

    @property
    def abscissa(self) -> float:
        """Largest growth rate, 1/s."""
        rates = [part.exponents(self.period) for part in (self.kept, self.left_out)]
        return float(np.concatenate(rates).max(initial=-np.inf))

    @property
    def stable(self) -> bool:
        """Whether no disturbance grows from period to period."""
        return self.abscissa <= 0


def floquet(
    model: Model,
    period: float,
    integrator: Integrator | None = None,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
    t: float = 0.0,
    accuracy: float = 1e-6,
) -> Floquet:
    """Multipliers of the periodic motion near a start.

    Arguments:
        period: s.
        integrator: of the motion, `Idas(rtol=1e-10, atol=1e-12)` by default.
        inputs, params: as for `simulate`.
        start: states near which the motion passes; Newton's method finds the point from which it
            comes back. Turns by 2 pi count as coming back.
        t: time of the start, s.
        accuracy: of the monodromy matrix; the intervals are halved until two orders of Magnus'
            series differ by less, relative to its norm.

    Raises:
        ValueError: a period that is not positive, unknown names, a model with events.
        NotPeriodic: no periodic motion near the start, or a drive of another period.
        IntegrationError: the motion could not be integrated.
    """
    as_model(model, "floquet")
    where = f"floquet of '{model.name}'"
    if not (np.isfinite(period) and period > 0):
        raise ValueError(f"{where}: period {period} s; it is positive and finite")
    if model.events or model.dae.updates:
        raise ValueError(f"{where}: the model has events; give its effects smoothing")
    point = locate(model, params=params, start=start, t=t)
    method = as_integrator(integrator or Idas(rtol=1e-10, atol=1e-12), "floquet")
    return _Orbit(model, period, inputs or {}, params or {}, method, accuracy).find(point)


class _Orbit:
    """Motions over one period, and their linear equations."""

    def __init__(
        self,
        model: Model,
        period: float,
        inputs: Inputs,
        params: Params,
        integrator: Integrator,
        accuracy: float,
    ) -> None:
        self.model, self.period, self.inputs, self.params = model, period, inputs, params
        self.integrator, self.accuracy, self.chart = integrator, accuracy, chart_of(model)
        self.intervals = _FEWEST

    def find(self, point: Point) -> Floquet:
        """The periodic motion, and its multipliers."""
        self.point, labels = point, self.chart.labels
        self._check_drive()
        for _ in range(_SHOTS):
            motion = self._motion()
            missed = self._missed(motion)
            miss = np.abs(missed) / (1 + self._sizes())
            found = self._resolved(motion, self._kept)
            if miss.max(initial=0.0) <= _RETURNED:
                break
            step = np.linalg.lstsq(found[0] - np.eye(len(missed)), -missed, rcond=_FREE)[0]
            here = self.point
            x = np.array(self.chart.retract(here.x, here.z, here.p, step)).reshape(-1)
            self.point = replace(here, x=x)
        else:
            worst = labels[int(miss.argmax())]
            raise NotPeriodic(
                f"model '{self.model.name}': no motion of period {self.period:.6g} s found near "
                f"the start; after one, {worst.name} is off by {missed[int(miss.argmax())]:.3g} "
                f"{worst.unit}; give a start nearer to it, or the right period"
            )
        left_out = Multipliers(np.zeros(0, complex), np.zeros(0))
        if self.model.reduction is not None and self.model.reduction.inertial:
            left_out = _eigenvalues(*self._resolved(motion, self._left_out))
        names = [label.name for label in self.model.x_labels]
        start = dict(zip(names, map(float, self.point.x), strict=True))
        return Floquet(
            self.period,
            _eigenvalues(*found),
            left_out,
            start,
            float(miss.max(initial=0.0)),
            self.intervals,
        )

    def _check_drive(self) -> None:
        """What drives the motion must have the period: the rates of one state tell."""
        ends, point = [], self.point
        for t in (point.t, point.t + self.period):
            u = locate(self.model, point, inputs=self.inputs, t=t).u
            ends.append(np.array(self.model.function("ode")(t, point.x, point.z, u, point.p)))
        change = float(np.abs(ends[1] - ends[0]).max(initial=0.0))
        if change > _DRIVEN * (1 + float(np.abs(ends[0]).max(initial=0.0))):
            raise NotPeriodic(
                f"model '{self.model.name}': a period of {self.period:.6g} s later the same state "
                f"has other rates, by up to {change:.3g}; give the period of what drives it"
            )

    def _motion(self) -> Trajectory:
        """From the start over one period, saved at the nodes of all intervals."""
        model, point, h = self.model, self.point, self.period / self.intervals
        nodes = (np.arange(self.intervals)[:, None] + NODES).reshape(-1) * h
        times = point.t + np.concatenate([[0.0], nodes, [self.period]])
        experiment = make_experiment(model, times, self.inputs, self.params)
        experiment = replace(experiment, x=point.x, z=point.z)
        motion = self.integrator.solve(model, experiment)
        if not motion.outcome.ok:
            raise IntegrationError(motion)
        return motion

    def _sizes(self) -> np.ndarray:
        """Sizes of the states behind the tangent coordinates, 0 for turns."""
        plain = np.abs(self.point.x[self.chart.plain])
        return np.concatenate([plain, np.zeros(self.chart.size - len(plain))])

    def _missed(self, motion: Trajectory) -> np.ndarray:
        """From the start to the end of a motion, in tangent coordinates."""
        model, point = self.model, self.point
        end = np.array([motion[label.name][-1] for label in model.x_labels])
        T = np.array(self.chart.basis(point.x, point.z, point.p))
        for _, live, _ in self.chart.turned:
            rows = [row for _, row in live]
            if end[rows] @ point.x[rows] < 0:
                end[rows] = -end[rows]
        way = left_inverse(T) @ (end - point.x) if T.size else np.zeros(0)
        turns = [i for i, label in enumerate(self.chart.labels) if label.unit == "rad"]
        way[turns] -= 2 * np.pi * np.round(way[turns] / (2 * np.pi))
        return way

    def _resolved(
        self, motion: Trajectory, blocks: Callable[[Trajectory], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Monodromy of the equations along a motion, in as many intervals as it takes."""
        while True:
            A = blocks(motion)[1:-1]
            found = monodromy(A, self.period)
            if np.isfinite(found).all() and self._accurate(*found):
                return found
            # The series converges where an interval is short against the fastest motion.
            fast = float(np.abs(balanced(np.abs(A).mean(axis=0))[0]).sum(axis=1).max())
            wanted = 2.0 ** np.floor(np.log2(max(fast * self.period / 2, 1.0)))
            self.intervals = int(max(2 * self.intervals, min(wanted, _MOST)))
            if self.intervals > _MOST:
                raise NotPeriodic(
                    f"model '{self.model.name}': {_MOST} intervals of a period do not resolve its "
                    f"multipliers to {self.accuracy:g}; allow less accuracy"
                )
            motion = self._motion()

    def _accurate(self, M: np.ndarray, error: np.ndarray) -> bool:
        """Whether the error is small in the units in which M is fair."""
        if not len(M):
            return True
        scaled, scale = balanced(M)
        missed = np.linalg.norm(error * (scale / scale[:, None]))
        return bool(missed <= self.accuracy * max(1.0, float(np.linalg.norm(scaled))))

    def _kept(self, motion: Trajectory) -> np.ndarray:
        return tangent_blocks(self.model, self.chart, motion)

    def _left_out(self, motion: Trajectory) -> np.ndarray:
        """Transverse Jacobians in tangent coordinates at each saved point."""
        reduction = self.model.reduction
        if reduction is None or not all(reduction.inertial):
            raise ValueError(
                f"floquet of '{self.model.name}': motions without inertia were left out of the "
                "minimal model; compile_scene(minimal=False)"
            )
        T, every = left_out_tangent(self.model)[0], _arguments(self.model, motion)
        flat = np.array(ca.DM(reduction.transverse(*every)).full())
        return left_inverse(T) @ _split(flat, len(motion.t)) @ T


def _arguments(model: Model, motion: Trajectory) -> list[np.ndarray]:
    """Columns t, x, z, u and all parameters, one a point."""
    dae, m = model.dae, len(motion.t)
    groups = (dae.x_labels, dae.z_labels, dae.u_labels, dae.parameters.labels)
    columns = [np.array([motion[label.name] for label in g]).reshape(len(g), m) for g in groups]
    return [motion.t[None, :], *columns]


def _split(flat: np.ndarray, m: int) -> np.ndarray:
    """Matrices side by side as an array (m, rows, columns)."""
    return flat.reshape(len(flat), m, -1).transpose(1, 0, 2)


def tangent_blocks(model: Model, chart: Chart, motion: Trajectory) -> np.ndarray:
    """A (m, n, n) of q' = A q in tangent coordinates at each saved point of a motion."""
    t, x, z, u, every = _arguments(model, motion)
    p, m = every[: model.n_p], len(motion.t)

    def called(function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
        return _split(np.array(ca.DM(function(*arguments)).full()), m)

    A = called(model.function("dode_dx"), t, x, z, u, p)
    if model.n_z:
        f_z, g_x, g_z = (
            called(model.function(f), t, x, z, u, p) for f in ("dode_dz", "dalg_dx", "dalg_dz")
        )
        A = A - f_z @ np.linalg.solve(g_z, g_x)
    if not chart.size:
        return np.zeros((m, 0, 0))
    rates = np.array(model.function("ode")(t, x, z, u, p))
    T, turning = called(chart.basis, x, z, p), called(chart.turning, x, z, p, rates)
    return left_inverse(T) @ (A @ T - turning)


def monodromy(blocks: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Solution of q' = A(t) q over a period from unit starts, and its error.

    By Magnus' series of order 6 [Blanes, Casas, Oteo, Ros 2009, eq. 255]; the error is what that of
    order 4 at the same nodes differs by.

    Arguments:
        blocks: A (3 k, n, n) at three Gauss nodes in each of k equal intervals.
    """
    n = blocks.shape[1]
    if not n:
        return np.zeros((0, 0)), np.zeros((0, 0))
    _, scale = balanced(np.abs(blocks).mean(axis=0))
    h = 3 * period / len(blocks)
    first, middle, last = (h * blocks[i::3] * (scale / scale[:, None]) for i in range(3))
    a1, a2, a3 = middle, np.sqrt(15) / 3 * (last - first), 10 / 3 * (last - 2 * middle + first)
    c1 = _commuted(a1, a2)
    c2 = -_commuted(a1, 2 * a3 + c1) / 60
    omegas = (a1 + a3 / 12 + _commuted(-20 * a1 - a3 + c1, a2 + c2) / 240, a1 + a3 / 12 - c1 / 12)
    with np.errstate(over="ignore", invalid="ignore"):
        fine, coarse = (_product(_exponentials(omega)) for omega in omegas)
        back = scale[:, None] / scale
        return fine * back, (fine - coarse) * back


def _commuted(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a @ b - b @ a


def _product(factors: np.ndarray) -> np.ndarray:
    """The last factor times ... times the first."""
    while len(factors) > 1:
        if len(factors) % 2:
            factors = np.concatenate([factors[:-2], (factors[-1] @ factors[-2])[None]])
            continue
        factors = factors[1::2] @ factors[::2]
    return factors[0]


def _exponentials(A: np.ndarray) -> np.ndarray:
    """Exponential of each of many matrices, by scaling, a Taylor polynomial, and squaring."""
    largest = float(np.abs(A).sum(axis=-1).max(initial=0.0))
    halvings = max(0, int(np.ceil(np.log2(max(largest, 1e-300))))) if np.isfinite(largest) else 0
    A = A / 2.0**halvings
    term = np.broadcast_to(np.eye(A.shape[-1]), A.shape)
    result = term
    for k in range(1, _TERMS + 1):
        term = term @ A / k
        result = result + term
    for _ in range(halvings):
        result = result @ result
    return result


def _eigenvalues(M: np.ndarray, error: np.ndarray) -> Multipliers:
    """Multipliers, and errors: what the error of the matrix moves each by, and rounding."""
    if not len(M):
        return Multipliers(np.zeros(0, complex), np.zeros(0))
    scaled, scale = balanced(M)
    values, right = np.linalg.eig(scaled)
    left = np.linalg.pinv(right)
    condition = np.linalg.norm(right, axis=0) * np.linalg.norm(left, axis=1)
    moved = np.abs(((left / scale) @ error * (right.T * scale)).sum(axis=1))
    total = moved + _ROUNDING * condition * np.linalg.norm(scaled)
    order = np.argsort(-np.abs(values), kind="stable")
    return Multipliers(values[order].astype(complex), total[order])
