"""Stability of periodic motion: Floquet multipliers of disturbances over one period.

The motion is integrated over one period. Disturbances of it follow the linear equations q' = A(t) q
in tangent coordinates, which are integrated by exponentials of Magnus' series: these are exact for
constant A, however stiff.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from ..base.symbols import is_number
from ..integrators import Idas
from ..model.model import Model
from ..model.signals import Inputs
from ..model.trajectory import Trajectory
from ..model.values import Params, Point, Start, as_model, locate, make_experiment
from ..pipeline import IntegrationError, Integrator, as_integrator
from .linearize import balanced, left_out_tangent
from .tangent import Chart, chart_of, left_inverse

# The three Gauss nodes of an interval [0, 1].
NODES = 0.5 + np.array([-1, 0, 1]) * np.sqrt(15) / 10
# Intervals of a period, at least and at most.
_FEWEST, _MOST = 16, 8192
# Terms of the exponential's Taylor polynomial, after scaling to a norm below 1.
_TERMS = 18
# Relative error of the monodromy matrix: rounding, and the error of the motion itself.
_ROUNDING = 1e-10
# A motion that returns this close to its start, relative to 1 + |state|, is periodic.
_RETURNED = 1e-7
# Rates that differ after a period by less, relative to 1 + the largest, are those of a drive with
# this period: the rest is rounding.
_DRIVEN = 1e-6
# Newton iterations to find a periodic motion.
_SHOTS = 10
# Singular values below this fraction of the largest belong to directions in which every motion is
# periodic, such as a shift of a free body.
_FREE = 1e-8


class NotPeriodic(RuntimeError):
    """Raised by `floquet` when it finds no motion of the given period near the start.

    Also raised when the model's rates do not have this period (its drive has another one), and
    when the multipliers cannot be resolved to the accuracy that was asked for. The message says
    which of these it is and what to change: a start nearer to the periodic motion, the period of
    the drive, or less accuracy.
    """


class Multipliers(NamedTuple):
    """Eigenvalues (k,) of a monodromy matrix, and a bound (k,) on the error of each."""

    values: np.ndarray
    errors: np.ndarray

    def exponents(self, period: float) -> np.ndarray:
        """Return the growth rates log|m| / period (k,), 1/s.

        A modulus that differs from 1 by no more than its error counts as neutral: rate 0.
        """
        size = np.abs(self.values)
        rates = np.log(np.maximum(size, 1e-300)) / period
        return np.where(np.abs(size - 1) <= self.errors, 0.0, rates)


@dataclass(frozen=True, eq=False)
class Floquet:
    """Stability of a periodic motion, as found by `floquet`.

    A disturbance of the periodic motion is multiplied by the monodromy matrix in each period. The
    eigenvalues of this matrix are the multipliers m, and log|m| / period are growth rates. The
    motion is stable if no multiplier has a modulus above 1 by more than its error.

    Fields:
        period: s.
        kept: multipliers of the states of the model.
        left_out: multipliers of the states that a minimal model left out; empty for a full one.
        start: the state at which the periodic motion starts, by name.
        miss: distance of the motion from its start after a period, relative to 1 + |state|.
        intervals: number of intervals into which the period was divided.

    >>> found = floquet(model, 0.2)             # doctest: +SKIP
    >>> found.stable, found.multiplier          # doctest: +SKIP
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
        """Largest growth rate of all multipliers, 1/s; more than 0 is unstable."""
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
    """Find a periodic motion near a start, and compute its Floquet multipliers.

    Newton's method (shooting) finds the state from which the motion returns to itself after a
    period; rotations by whole turns count as a return. The multipliers are the eigenvalues of the
    monodromy matrix of q' = A(t) q along this motion, in tangent coordinates q, without the norms
    of quaternions. Motions that a minimal model left out have their own multipliers.

    Arguments:
        period: s; for a driven model that of its drive.
        integrator: for the motion, `Idas(rtol=1e-10, atol=1e-12)` by default.
        inputs, params: as for `simulate`.
        start: states near the periodic motion, as for `simulate`.
        t: time of the start, s.
        accuracy: of the monodromy matrix, relative to its norm; the intervals are halved until
            Magnus' series of orders 4 and 6 agree to it.

    Raises:
        TypeError: `model` is not a model, or `integrator` is a class or a name.
        ValueError: a period that is not positive, unknown names, a model with events.
        NotPeriodic: no periodic motion near the start, a drive of another period, or multipliers
            that 8192 intervals do not resolve.
        IntegrationError: the motion could not be integrated.

    >>> drive = {"base": lambda t: np.cos(30 * t)}               # doctest: +SKIP
    >>> floquet(model, 2 * np.pi / 30, inputs=drive).stable      # doctest: +SKIP
    """
    as_model(model, "floquet")
    where = f"floquet of '{model.name}'"
    if not (is_number(period) and np.isfinite(period) and period > 0):
        raise ValueError(f"{where}: period {period} s; give a positive, finite period")
    if model.events or model.dae.updates:
        raise ValueError(
            f"{where}: the model has events, and multipliers across jumps are not computed; give "
            "its effects smoothing"
        )
    point = locate(model, params=params, start=start, t=t)
    method = as_integrator(integrator or Idas(rtol=1e-10, atol=1e-12), "floquet")
    return _Orbit(model, period, inputs or {}, params or {}, method, accuracy).find(point)


class _Orbit:
    """The search for a periodic motion, and the linear equations along it."""

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
        """Find the periodic motion near a point, and its multipliers."""
        self.point, labels = point, self.chart.labels
        self._check_drive()
        for _ in range(_SHOTS):
            motion = self._motion()
            missed = self._missed(motion)
            miss = np.abs(missed) / (1 + self._sizes())
            found = self._resolved(motion, self._kept)
            if miss.max(initial=0.0) <= _RETURNED:
                break
            # Newton's method for end(q) - q = 0, whose derivative is the monodromy matrix minus
            # one. It is singular in directions in which every motion is periodic: the least-squares
            # solution does not move the start along them.
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
        """Check, by the rates of one state, that the drive of the model has the period.

        Raises:
            NotPeriodic: the rates at this state differ after a period.
        """
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
        """Integrate from the start over one period, with the nodes of all intervals saved."""
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
        """Return the absolute values of the states behind the tangent coordinates, 0 for angles."""
        plain = np.abs(self.point.x[self.chart.plain])
        return np.concatenate([plain, np.zeros(self.chart.size - len(plain))])

    def _missed(self, motion: Trajectory) -> np.ndarray:
        """Return the distance from the start to the end of a motion, in tangent coordinates."""
        model, point = self.model, self.point
        end = np.array([motion[label.name][-1] for label in model.x_labels])
        T = np.array(self.chart.basis(point.x, point.z, point.p))
        # q and -q are the same rotation; after an odd number of turns the motion ends at the other.
        for _, live, _ in self.chart.turned:
            rows = [row for _, row in live]
            if end[rows] @ point.x[rows] < 0:
                end[rows] = -end[rows]
        distance = left_inverse(T) @ (end - point.x) if T.size else np.zeros(0)
        angles = [i for i, label in enumerate(self.chart.labels) if label.unit == "rad"]
        distance[angles] -= 2 * np.pi * np.round(distance[angles] / (2 * np.pi))
        return distance

    def _resolved(
        self, motion: Trajectory, blocks: Callable[[Trajectory], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute a monodromy matrix and its error, in as many intervals as its accuracy needs.

        Arguments:
            blocks: motion -> A (m, n, n) of q' = A q at its saved times.
        """
        while True:
            A = blocks(motion)[1:-1]
            found = monodromy(A, self.period)
            if np.isfinite(found).all() and self._accurate(*found):
                return found
            # Magnus' series converges where an interval is short against the fastest motion. So the
            # norm of A gives the number of intervals, rather than many halvings.
            fast = float(np.abs(balanced(np.abs(A).mean(axis=0))[0]).sum(axis=1).max())
            wanted = 2.0 ** np.floor(np.log2(max(fast * self.period / 2, 1.0)))
            self.intervals = int(max(2 * self.intervals, min(wanted, _MOST)))
            if self.intervals > _MOST:
                raise NotPeriodic(
                    f"model '{self.model.name}': {_MOST} intervals of a period do not resolve its "
                    f"multipliers to {self.accuracy:g}; give a larger number for accuracy"
                )
            motion = self._motion()

    def _accurate(self, M: np.ndarray, error: np.ndarray) -> bool:
        """Return whether the error is small, in coordinates scaled so that M is balanced."""
        if not len(M):
            return True
        scaled, scale = balanced(M)
        missed = np.linalg.norm(error * (scale / scale[:, None]))
        return bool(missed <= self.accuracy * max(1.0, float(np.linalg.norm(scaled))))

    def _kept(self, motion: Trajectory) -> np.ndarray:
        return tangent_blocks(self.model, self.chart, motion)

    def _left_out(self, motion: Trajectory) -> np.ndarray:
        """Return the transverse Jacobians in tangent coordinates at each saved point.

        Raises:
            ValueError: motions without inertia were left out; they have no rates.
        """
        reduction = self.model.reduction
        if reduction is None or not all(reduction.inertial):
            raise ValueError(
                f"floquet of '{self.model.name}': motions without inertia were left out of the "
                "minimal model, and they have no rates; use compile_scene(minimal=False)"
            )
        T, every = left_out_tangent(self.model)[0], _arguments(self.model, motion)
        flat = np.array(ca.DM(reduction.transverse(*every)).full())
        return left_inverse(T) @ _split(flat, len(motion.t)) @ T


def _arguments(model: Model, motion: Trajectory) -> list[np.ndarray]:
    """Return t, x, z, u and all parameters along a motion, one column for each point."""
    dae, m = model.dae, len(motion.t)
    groups = (dae.x_labels, dae.z_labels, dae.u_labels, dae.parameters.labels)
    columns = [np.array([motion[label.name] for label in g]).reshape(len(g), m) for g in groups]
    return [motion.t[None, :], *columns]


def _split(flat: np.ndarray, m: int) -> np.ndarray:
    """Split m matrices side by side, as a mapped Function returns them, into (m, rows, columns)."""
    return flat.reshape(len(flat), m, -1).transpose(1, 0, 2)


def tangent_blocks(model: Model, chart: Chart, motion: Trajectory) -> np.ndarray:
    """Return A (m, n, n) of q' = A q in tangent coordinates at each saved point of a motion.

    q is a small disturbance, dx = T q. From dx' = (df/dx) dx follows A = T^+ ((df/dx) T - T'),
    where T^+ is the left inverse, and T' the rate of the basis along the motion. Algebraic unknowns
    are eliminated.

    Arguments:
        chart: the tangent coordinates of the model, `chart_of(model)`.
        motion: a trajectory of the model, saved at m times.
    """
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
    """Solve q' = A(t) q over a period from unit starts, and estimate the error.

    By Magnus' series of order 6 [Blanes, Casas, Oteo, Ros 2009, eq. 255]: over each interval the
    solution is exp(Omega), and the product of all exponentials is the monodromy matrix. The error
    is the difference from the series of order 4 at the same nodes.

    Arguments:
        blocks: A (3 k, n, n) at the three Gauss nodes `NODES` in each of k equal intervals, 1/s.
        period: s.

    Returns:
        The monodromy matrix (n, n) and its error (n, n); entries are not finite where it overflows.
    """
    n = blocks.shape[1]
    if not n:
        return np.zeros((0, 0)), np.zeros((0, 0))
    _, scale = balanced(np.abs(blocks).mean(axis=0))
    h = 3 * period / len(blocks)
    # In balanced coordinates the exponentials lose no digits to units; `back` undoes the scaling.
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
    """Return the product of matrices (k, n, n), the last factor on the left."""
    # Neighbours are multiplied pairwise, in log2(k) vectorised rounds.
    while len(factors) > 1:
        if len(factors) % 2:
            factors = np.concatenate([factors[:-2], (factors[-1] @ factors[-2])[None]])
            continue
        factors = factors[1::2] @ factors[::2]
    return factors[0]


def _exponentials(A: np.ndarray) -> np.ndarray:
    """Return the exponential of each matrix (k, n, n), by scaling, Taylor series and squaring."""
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
    """Return the eigenvalues of M, by falling modulus, and a bound on the error of each."""
    if not len(M):
        return Multipliers(np.zeros(0, complex), np.zeros(0))
    scaled, scale = balanced(M)
    values, right = np.linalg.eig(scaled)
    left = np.linalg.pinv(right)
    condition = np.linalg.norm(right, axis=0) * np.linalg.norm(left, axis=1)
    # First-order perturbation: an error E of M moves eigenvalue i by left_i E right_i. Rounding may
    # be in any direction, so it counts with the condition |left_i| |right_i|.
    moved = np.abs(((left / scale) @ error * (right.T * scale)).sum(axis=1))
    total = moved + _ROUNDING * condition * np.linalg.norm(scaled)
    order = np.argsort(-np.abs(values), kind="stable")
    return Multipliers(values[order].astype(complex), total[order])
