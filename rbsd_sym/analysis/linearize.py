"""Linear model about a state: matrices, eigenvalues, modes, and those of states left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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

# Sweeps of balancing, at most; it settles in a few.
_SWEEPS = 40
# Eigenvalues in a printed table.
_SHOWN = 24


class Spectrum(NamedTuple):
    """Eigenvalues (k,) in 1/s, by rising modulus, and a bound (k,) on the rounding in each."""

    values: np.ndarray
    errors: np.ndarray

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequencies |s| / (2 pi), Hz."""
        return np.abs(self.values) / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """-Re(s) / |s|: 0 without damping, 1 without oscillation, negative for growth."""
        size = np.abs(self.values)
        return np.divide(-self.values.real, size, out=np.zeros(len(size)), where=size > 0) + 0.0

    @property
    def growth(self) -> np.ndarray:
        """Real parts (k,), 1/s; those within their errors count as 0."""
        real = self.values.real
        return np.where(np.abs(real) <= self.errors, 0.0, real)


@dataclass(frozen=True, eq=False)
class Linear:
    """A model linearised about a point, as returned by `linearize`.

    dx' = A dx + B du, dy = C dx + D du, with the algebraic unknowns eliminated. Eigenvalues and
    modes are those of tangent coordinates q, dx = T q, so that the norm of a quaternion does not
    add an eigenvalue 0. `print(linear)` shows a table of frequencies and damping ratios.

    Arguments:
        name: of the model.
        point: t, x, z, u, p.
        A, B, C, D: over the states, (n_x, n_x), (n_x, n_u), (n_y, n_x), (n_y, n_u).
        states, inputs, outputs: names and units of their rows and columns.
        basis: T (n_x, n). Each state has its tangent coordinate, but a quaternion has three, and
            data states have none, since they have no rate.
        A_tangent: (n, n) of q' = A_tangent q + B_tangent du along the motion; dy = C T q + D du. It
            includes the rate of the basis where that turns with the motion.
        coordinates: names and units of q.
        kept: spectrum of A_tangent.
        modes: (n_x, n), one column for each eigenvalue of `kept`: the states in this mode, scaled
            so that the largest entry is 1.
        left_out: spectrum of the states that a minimal model left out, empty for a full model.
            `kept` and `left_out` together are the spectrum of the full model.
        rate: largest rate of a state at the point, in its unit per s; 0 at rest. Away from rest the
            eigenvalues describe a disturbance at that instant only, not over time.

    >>> linear = linearize(model, static_equilibrium(model))  # doctest: +SKIP
    >>> linear.stable, linear.frequencies, linear.mode(0)     # doctest: +SKIP
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
        """Matrix (n, n_u) of q' = A_tangent q + B_tangent du."""
        if not self.B.size:
            return np.zeros((len(self.A_tangent), self.B.shape[1]))
        return left_inverse(self.basis) @ self.B

    @property
    def C_tangent(self) -> np.ndarray:
        """Matrix (n_y, n) of dy = C_tangent q + D du."""
        return self.C @ self.basis

    @property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues (n,) of the states of the model, 1/s; `left_out` has those left out."""
        return self.kept.values

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequency |s| / (2 pi) of each eigenvalue (n,), Hz."""
        return self.kept.frequencies

    @property
    def damping_ratios(self) -> np.ndarray:
        """Damping ratio -Re(s) / |s| of each eigenvalue (n,)."""
        return self.kept.damping_ratios

    @cached_property
    def spectrum(self) -> Spectrum:
        """Spectrum of the full model: that of the states kept, then that of those left out."""
        pairs = zip(self.kept, self.left_out, strict=True)
        return Spectrum(*(np.concatenate(pair) for pair in pairs))

    @property
    def abscissa(self) -> float:
        """Largest real part of the full spectrum, 1/s; within its rounding error it counts as 0."""
        return float(self.spectrum.growth.max(initial=-np.inf))

    @property
    def stable(self) -> bool:
        """Whether no disturbance grows exponentially.

        A neutral one, such as a shift of a free body, may still grow in proportion to time.
        """
        return self.abscissa <= 0

    def mode(self, index: int) -> dict[str, complex]:
        """Return the complex amplitude of each state in a mode, by name, the largest being 1.

        Arguments:
            index: of the eigenvalue in `eigenvalues`.
        """
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
        """Return the name of the state with the largest amplitude in each mode."""
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
    """Linearise a model about a state, with exact derivatives.

    dx' = A dx + B du, dy = C dx + D du, where y are the outputs requested by the scene. With
    algebraic unknowns, 0 = g_x dx + g_z dz + g_u du is solved for dz.

    Arguments:
        at: an `Equilibrium` or a `Point`; a `Trajectory`, whose saved point at t is taken (the last
            one by default); a vector of states (n_x,); states by name; by default the model's
            start.
        inputs, params: values by name; the others are those of `at`, or keep their default.
        start: values of states by name that differ from those of `at`. For algebraic unknowns they
            are the guess from which their equations are solved.
        t: time in s; by default that of `at`, or 0.

    Raises:
        TypeError: `model` is not a model, or `start` is of an unknown kind.
        ValueError: unknown names; algebraic equations without a solution near z, or that do not
            determine the unknowns; derivatives that are not finite.

    >>> linear = linearize(model, static_equilibrium(model))  # doctest: +SKIP
    >>> linear.A.shape, linear.frequencies                    # doctest: +SKIP
    """
    point = _consistent(model, locate(model, at, inputs=inputs, params=params, start=start, t=t))
    A, B, C, D = _matrices(model, point)
    chart, rates = chart_of(model), _column(model, "ode", point)
    # dx = T q with a basis T that turns with the motion: q' = T^+ (A T - T') q.
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
    """Return the spectrum of the states that a minimal model left out, at a point of the model."""
    reduction = model.reduction
    if reduction is None or not reduction.inertial:
        return Spectrum(np.zeros(0, complex), np.zeros(0))
    p = np.concatenate([point.p, point.idle])
    block = _dense(reduction.transverse(point.t, point.x, point.z, point.u, p))
    T, own = left_out_tangent(model)
    return spectrum_of(left_inverse(T) @ block @ T, own)[0]


def left_out_tangent(model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return the tangent coordinates of the states that a minimal model left out.

    Returns:
        Their basis T (n, m) over the n states that never move, in the order of the transverse
        Jacobian; and whether each coordinate has inertia (m,).

    Raises:
        ValueError: it is a full model.
    """
    reduction = model.reduction
    if reduction is None:
        raise ValueError(
            f"model '{model.name}': it is a full model, without a transverse Jacobian; compile "
            "with minimal=True"
        )
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
            f"t = {point.t:.6g} s; give values near a solution (start={{name: value}})"
        )
    return replace(point, z=z)


def _matrices(model: Model, point: Point) -> list[np.ndarray]:
    """Return A, B, C, D with the unknowns eliminated by 0 = g_x dx + g_z dz + g_u du."""

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
            "determine the unknowns (singular Jacobian); linearise elsewhere, or add stiffness or "
            "damping to the bodies without mass"
        )
    # minus dz/dx and dz/du, for A and B, then again for C and D.
    by = [moved[:, : model.n_x], moved[:, model.n_x :]]
    return [
        matrix - slope(f, "z") @ dz
        for matrix, f, dz in zip(found, ("ode", "ode", "out", "out"), by * 2, strict=True)
    ]


def _column(model: Model, name: str, point: Point) -> np.ndarray:
    return np.array(model.function(name)(*point.arguments)).reshape(-1)


def _dense(value: Any) -> np.ndarray:
    return np.array(ca.DM(value).full())


def _shapes(T: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return modes (n_x, n) in the states, the largest entry of each being 1."""
    modes = T.astype(complex) @ vectors
    if not modes.size:
        return modes
    largest = modes[np.abs(modes).argmax(axis=0), np.arange(modes.shape[1])]
    return modes / np.where(largest == 0, 1, largest)


def spectrum_of(J: np.ndarray, inertial: np.ndarray) -> tuple[Spectrum, np.ndarray]:
    """Compute spectrum and eigenvectors of M x' = J x, where M is diagonal with entries 1 and 0.

    J is balanced first, so that differences in units and stiffness do not look like rounding.

    Arguments:
        J: (n, n), 1/s.
        inertial: (n,) whether a row is a rate (1 in M) or a balance without inertia (0 in M).

    Returns:
        The spectrum, and the eigenvectors (n, k) in its order, which are zero if some row has no
        inertia.

    Raises:
        ValueError: J is not finite.
    """
    if not np.isfinite(J).all():
        raise ValueError("linearize: a derivative is not finite; check the state and parameters")
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
    """Balance a matrix: return D^-1 A D with rows and columns of like norm, and the diagonal of D.

    [Parlett, Reinsch 1969]. The eigenvalues stay the same, and rounding errors become those of a
    matrix in comparable units. D holds powers of 2, so that the scaling itself is exact.

    Arguments:
        A: (n, n).
    """
    A, scale = A.copy(), np.ones(len(A))
    size = np.abs(A) - np.diag(np.abs(np.diag(A)))
    for _ in range(_SWEEPS):
        settled = True
        for i in range(len(A)):
            column, row = float(size[:, i].sum()), float(size[i].sum())
            if not (column and row):
                continue
            # Multiplying column i by f and dividing row i by it makes both norms equal for
            # f = sqrt(row / column); the nearest power of 2 is exact.
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
