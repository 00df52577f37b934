"""A model linearised about a state: matrices, eigenvalues, modes, and what a reduction left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..base.spectra import finite_spectrum
from ..dae.members import Label
from ..model.model import Model
from ..model.signals import Inputs
from ..model.values import Params, Point, Start, Where, locate
from .tangent import chart_of, left_inverse, left_out_basis

_SWEEPS = 40  # of balancing, which settles in a few
_SHOWN = 24  # eigenvalues in a printed table


class Spectrum(NamedTuple):
    """Eigenvalues (k,) in 1/s, by their size, and how far rounding may have moved each (k,)."""

    values: np.ndarray
    errors: np.ndarray

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequencies |s| / (2 pi), Hz."""
        return np.abs(self.values) / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """-Re(s) / |s|: 0 without damping, 1 where nothing oscillates, negative where it grows."""
        size = np.abs(self.values)
        return np.divide(-self.values.real, size, out=np.zeros(len(size)), where=size > 0) + 0.0

    @property
    def growth(self) -> np.ndarray:
        """Real parts, 1/s; those within their errors count as 0."""
        real = self.values.real
        return np.where(np.abs(real) <= self.errors, 0.0, real)


@dataclass(frozen=True, eq=False)
class Linear:
    """dx' = A dx + B du, dy = C dx + D du about a point, with the algebraic unknowns eliminated.

    Arguments:
        name: of the model.
        point: t, x, z, u, p.
        A, B, C, D: over the states, (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u).
        states, inputs, outputs: names and units of their rows and columns.
        basis: T (n_x, n) of tangent coordinates q: dx = T q. Their number n is that of the states
            but for the norms of quaternions, which move nothing, and data states, which have no
            rate.
        A_tangent: (n, n): q' = A_tangent q + B_tangent du along the motion, and dy = C T q + D du.
            Where the basis turns with the motion, its rate is in A_tangent.
        coordinates: names and units of q.
        kept: spectrum of A_tangent.
        modes: (n_x, n) the states' part in each mode of `kept`, in its order, largest entry 1.
        left_out: spectrum of the motions that a minimal model left out, empty for a full one.
            Both together are the spectrum of the full model.
        rate: largest rate of a state at the point, in its unit per s: 0 at rest. Away from rest,
            eigenvalues tell what a disturbance does at that instant.
    """

    name: str
    point: Point
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple[Label, ...]
    inputs: tuple[Label, ...]
    outputs: tuple[Label, ...]
    basis: np.ndarray
    A_tangent: np.ndarray
    coordinates: tuple[Label, ...]
    kept: Spectrum
    modes: np.ndarray
    left_out: Spectrum
    rate: float

    @property
    def B_tangent(self) -> np.ndarray:
        """(n, n_u)."""
        if not self.B.size:
            return np.zeros((len(self.A_tangent), self.B.shape[1]))
        return left_inverse(self.basis) @ self.B

    @property
    def C_tangent(self) -> np.ndarray:
        """(n_y, n)."""
        return self.C @ self.basis

    @property
    def eigenvalues(self) -> np.ndarray:
        """Of the states of the model, 1/s; those left out are in `left_out`."""
        return self.kept.values

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequency of each eigenvalue, Hz."""
        return self.kept.frequencies

    @property
    def damping_ratios(self) -> np.ndarray:
        """Damping ratio of each eigenvalue."""
        return self.kept.damping_ratios

    @cached_property
    def spectrum(self) -> Spectrum:
        """Of the full model: kept, then left out."""
        pairs = zip(self.kept, self.left_out, strict=True)
        return Spectrum(*(np.concatenate(pair) for pair in pairs))

    @property
    def abscissa(self) -> float:
        """Largest real part of the full spectrum, 1/s; what rounding may have made counts as 0."""
        return float(self.spectrum.growth.max(initial=-np.inf))

    @property
    def stable(self) -> bool:
        """Whether no disturbance grows exponentially; a neutral one, such as a free turn, may."""
        return self.abscissa <= 0

    def mode(self, index: int) -> dict[str, complex]:
        """Part of each state in a mode, by name."""
        return dict(zip((s.name for s in self.states), self.modes[:, index].tolist(), strict=True))

    def __repr__(self) -> str:
        return f"<Linear '{self.name}': {len(self.states)} states at t = {self.point.t:.6g} s>"

    def __str__(self) -> str:
        verdict = "unstable" if not self.stable else "stable" if self.abscissa < 0 else "neutral"
        lines = [
            f"{self.name} at t = {self.point.t:.6g} s: {verdict}, largest real part "
            f"{self.abscissa:.6g} 1/s, largest rate {self.rate:.3g}",
            *_listed("eigenvalues", self.kept, self._leaders()),
            *_listed("eigenvalues of what the minimal model left out", self.left_out, None),
        ]
        return "\n".join(lines)

    def _leaders(self) -> list[str]:
        """The state with the largest part in each mode."""
        if not self.states:
            return []
        return [self.states[int(i)].name for i in np.abs(self.modes).argmax(axis=0)]


def _listed(title: str, spectrum: Spectrum, leaders: Sequence[str] | None) -> list[str]:
    if not len(spectrum.values):
        return []
    lines = [f"{title}:", "      real 1/s   imaginary 1/s    frequency Hz   damping ratio"]
    rows = zip(*spectrum[:1], spectrum.frequencies, spectrum.damping_ratios, strict=True)
    for i, (value, frequency, ratio) in enumerate(rows):
        if i == _SHOWN:
            lines.append(f"  and {len(spectrum.values) - _SHOWN} more")
            break
        mostly = f"  {leaders[i]}" if leaders else ""
        lines.append(
            f"  {value.real:12.6g}  {value.imag:14.6g}  {frequency:14.6g}  {ratio:14.6g}{mostly}"
        )
    return lines


def linearize(
    model: Model,
    at: Where = None,
    *,
    inputs: Inputs | None = None,
    params: Params | None = None,
    start: Start | None = None,
    t: float | None = None,
) -> Linear:
    """A model linearised about a state, with exact derivatives.

    Arguments:
        at: an `Equilibrium` or a `Point`; a `Trajectory`, whose saved point at t is taken (the last
            one by default); a vector of states; by default the model's start.
        inputs, params: by name; the others keep their default, or what they are in `at`.
        start: values of states by name that differ from those of `at`. Algebraic unknowns are
            solved for, from these values.
        t: s, 0 by default.

    Raises:
        ValueError: unknown names, algebraic equations without a solution near z, or that do not
            determine the unknowns.
    """
    point = _consistent(model, locate(model, at, inputs=inputs, params=params, start=start, t=t))
    A, B, C, D = _matrices(model, point)
    chart, rates = chart_of(model), _column(model, "ode", point)
    T = _dense(chart.basis(point.x, point.z, point.p))
    turning = _dense(chart.turning(point.x, point.z, point.p, rates))
    A_tangent = left_inverse(T) @ (A @ T - turning) if T.size else np.zeros((0, 0))
    kept, vectors = spectrum_of(A_tangent, np.full(len(A_tangent), True))
    dae = model.dae
    return Linear(
        model.name,
        point,
        A,
        B,
        C,
        D,
        dae.x_labels,
        dae.u_labels,
        dae.out_labels,
        T,
        A_tangent,
        chart.labels,
        kept,
        _shapes(T, vectors),
        left_out_spectrum(model, point),
        float(np.abs(rates).max(initial=0.0)),
    )


def left_out_spectrum(model: Model, point: Point) -> Spectrum:
    """Spectrum of the motions that a minimal model left out, at a point of the model."""
    reduction = model.reduction
    if reduction is None or not reduction.inertial:
        return Spectrum(np.zeros(0, complex), np.zeros(0))
    p = np.concatenate([point.p, point.idle])
    block = _dense(reduction.transverse(point.t, point.x, point.z, point.u, p))
    T, own = left_out_tangent(model)
    return spectrum_of(left_inverse(T) @ block @ T, own)[0]


def left_out_tangent(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Basis T (n, m) of the states that never move; which tangent rows have inertia (m,)."""
    reduction = model.reduction
    if reduction is None:
        raise ValueError(f"model '{model.name}': nothing was left out of it")
    still = reduction.dropped[: len(reduction.inertial)]
    values = np.array([d.value for d in still])
    T = left_out_basis(model.dae, [d.name for d in still], values)
    massless = ~np.array(reduction.inertial)
    return T, ~np.array([bool((column != 0)[massless].any()) for column in T.T], bool)


def _consistent(model: Model, point: Point) -> Point:
    if not model.n_z:
        return point
    z, found = model.consistent(*point.arguments)
    if not found:
        raise ValueError(
            f"model '{model.name}': no algebraic unknowns found that solve their equations at "
            f"t = {point.t:.6g} s; give z near a solution"
        )
    return Point(point.t, point.x, z, point.u, point.p, point.idle)


def _matrices(model: Model, point: Point) -> list[np.ndarray]:
    """A, B, C, D with the unknowns eliminated: 0 = g_x dx + g_z dz + g_u du."""

    def slope(f: str, v: str) -> np.ndarray:
        return _dense(model.function(f"d{f}_d{v}")(*point.arguments))

    found = [slope(f, v) for f in ("ode", "out") for v in "xu"]
    if not model.n_z:
        return found
    try:
        moved = np.linalg.solve(
            slope("alg", "z"), np.hstack([slope("alg", "x"), slope("alg", "u")])
        )
    except np.linalg.LinAlgError:
        moved = np.full((model.n_z, model.n_x + model.n_u), np.nan)
    if not np.isfinite(moved).all():
        raise ValueError(
            f"model '{model.name}': at t = {point.t:.6g} s its algebraic equations do not "
            "determine the unknowns (singular Jacobian); linearise elsewhere, or add what decides"
        )
    ways = [moved[:, : model.n_x], moved[:, model.n_x :]]
    return [
        matrix - slope(f, "z") @ way
        for matrix, f, way in zip(found, ("ode", "ode", "out", "out"), ways * 2, strict=True)
    ]


def _column(model: Model, name: str, point: Point) -> np.ndarray:
    return np.array(model.function(name)(*point.arguments)).reshape(-1)


def _dense(value: Any) -> np.ndarray:
    return np.array(ca.DM(value).full())


def _shapes(T: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Modes in the states, their largest entries 1."""
    modes = T.astype(complex) @ vectors
    if not modes.size:
        return modes
    largest = modes[np.abs(modes).argmax(axis=0), np.arange(modes.shape[1])]
    return modes / np.where(largest == 0, 1, largest)


def spectrum_of(J: np.ndarray, inertial: np.ndarray) -> tuple[Spectrum, np.ndarray]:
    """Spectrum of M x' = J x, M diagonal with 0 where a row has no inertia, and eigenvectors.

    States are scaled first, so that units and stiffness do not look like rounding.

    Raises:
        ValueError: values that are not finite.
    """
    if not np.isfinite(J).all():
        raise ValueError("linearize: a derivative is not finite; look at the state and parameters")
    if not len(J):
        return Spectrum(np.zeros(0, complex), np.zeros(0)), np.zeros((0, 0), complex)
    scaled, scale = balanced(J)
    values, errors = finite_spectrum(scaled, inertial)
    vectors = np.zeros((len(J), len(values)), complex)
    if inertial.all():
        values, vectors = np.linalg.eig(scaled)
        vectors = vectors * scale[:, None]
    order = np.lexsort((values.imag, np.round(np.abs(values), 9)))
    return Spectrum(values[order].astype(complex), errors[order]), vectors[:, order]


def balanced(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """D^-1 A D with rows and columns of like size, and the diagonal of D, powers of 2.

    [Parlett, Reinsch 1969]: eigenvalues stay, their condition is that of a matrix in fair units.
    """
    A, scale = A.copy(), np.ones(len(A))
    size = np.abs(A) - np.diag(np.abs(np.diag(A)))
    for _ in range(_SWEEPS):
        settled = True
        for i in range(len(A)):
            column, row = float(size[:, i].sum()), float(size[i].sum())
            if not (column and row):
                continue
            factor = 2.0 ** round(float(np.log2(row / column)) / 2)
            if factor != 1.0:
                settled = False
                scale[i] *= factor
                for matrix in (A, size):
                    matrix[:, i] *= factor
                    matrix[i] /= factor
        if settled:
            break
    return A, scale
