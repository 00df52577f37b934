"""Nonlinear springs along one axis: a cubic term, and a table of forces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from ..base.symbols import Scalar, is_number
from .effect import Answer, Effect, Rule, Sight


@dataclass(frozen=True, eq=False)
class Cubic(Effect):
    """Cubic spring along one axis.

        effects=[rs.Cubic(2, cubic=1e7, linear=2e4)]

    Picture: a spring that hardens or softens with its strain u, parallel to the connector's own.

    Free bodies: f acts along the axis on both markers, with the sign of the spring force.

        f = k u + c u^3,   U = k u^2 / 2 + c u^4 / 4

    Choosing numbers: the slope k + 3 c u^2 at the largest strain of interest determines c.

    Limits: the force of a softening spring (c < 0) is largest at u^2 = k / (3 |c|); beyond, its
    slope is negative.

    Arguments:
        axis: 0, 1, 2 for translation along x, y, z of the joint frame; 3, 4, 5 for rotation.
        cubic, linear: c (N/m3 or N m/rad3) and k (N/m or N m/rad), of either sign.
        name: label within the connector; by default cubic_<axis>.
    """

    axis: int
    cubic: Any
    linear: Any = 0.0
    name: str = ""
    rules: ClassVar[Mapping[str, Rule]] = {
        "cubic": Rule("N/m3", signed=True),
        "linear": Rule("N/m", signed=True),
    }

    def answer(self, sight: Sight) -> Answer:
        """Return force and energy."""
        u = sight.strain
        return Answer(
            self.linear * u + self.cubic * u**3, (self.linear + self.cubic * u * u / 2) * u * u / 2
        )


@dataclass(frozen=True, eq=False)
class Table(Effect):
    """Spring along one axis with a measured characteristic: a natural cubic spline through points.

        effects=[rs.Table(2, strain=[-0.01, 0, 0.02], force=[-500, 0, 300])]

    Picture: a test bench curve of force over deflection. The spline is C2 and continues straight
    beyond both ends; the energy is zero at the first point.

    Free bodies: the force acts along the axis on both markers, with the sign of the spring force.

    Choosing numbers: more points where the curve bends. The spline differs from straight lines
    between the points by at most h^2 / 8 times its second derivative, h the distance of two points;
    it overshoots at sharp bends.

    Limits: plain numbers only; no hysteresis. A falling branch is a negative stiffness.

    Arguments:
        axis: 0, 1, 2 for translation along x, y, z of the joint frame; 3, 4, 5 for rotation.
        strain: at least two increasing strains, m or rad.
        force: as many forces, N or N m.
        name: label within the connector; by default table_<axis>.

    Raises:
        TypeError, ValueError: strain or force is not a list of plain numbers.
    """

    axis: int
    strain: Sequence[float]
    force: Sequence[float]
    name: str = ""

    def __post_init__(self) -> None:
        for name in ("strain", "force"):
            object.__setattr__(self, name, _column(getattr(self, name), f"Table, {name}"))

    def _check(self, where: str) -> None:
        u, f = np.array(self.strain), np.array(self.force)
        if len(u) != len(f) or len(u) < 2:
            raise ValueError(
                f"{where}: {len(u)} strains and {len(f)} forces; give as many forces as strains, "
                "at least two"
            )
        if not np.isfinite([u, f]).all():
            raise ValueError(f"{where}: strains {u}, forces {f}; give finite numbers")
        if (np.diff(u) <= 0).any():
            raise ValueError(f"{where}: strains {self.strain} do not increase; sort the table")

    def answer(self, sight: Sight) -> Answer:
        """Return force and energy; the energy is zero at the first strain of the table."""
        knots, pieces = _natural_spline(np.array(self.strain), np.array(self.force))
        force, energy = ca.SX(0), ca.SX(0)
        stored, previous = 0.0, None
        for i, (start, c) in enumerate(zip(knots, pieces, strict=True)):
            if previous is not None:
                stored += float(_integral(previous[1], start - previous[0]))
            x = sight.strain - start
            # Nested selections from left to right: the last piece that begins below the strain
            # applies. The energy of all pieces before it is a number.
            here = i == 0 or sight.strain >= start
            value = c[0] + x * (c[1] + x * (c[2] + x * c[3]))
            force = value if i == 0 else ca.if_else(here, value, force)
            work = stored + _integral(c, x)
            energy = work if i == 0 else ca.if_else(here, work, energy)
            previous = (start, c)
        return Answer(force, energy)


def _column(values: Any, where: str) -> tuple[float, ...]:
    """Return a list of plain numbers as floats, or raise an error that names the field."""
    if is_number(values) or values is None:
        raise TypeError(f"{where}: {values!r}; give a list of numbers")
    for value in values:
        if not is_number(value):
            raise ValueError(f"{where}: {value!r} is {type(value).__name__}; give plain numbers")
        if isinstance(value, Scalar):
            raise TypeError(
                f"{where}: {value} is not a plain number; a table is fixed; give numbers"
            )
    return tuple(float(value) for value in values)


def _integral(c: np.ndarray, x: Any) -> Any:
    """Return the integral from 0 to x of the cubic polynomial with coefficients c."""
    return x * (c[0] + x * (c[1] / 2 + x * (c[2] / 3 + x * c[3] / 4)))


def _natural_spline(u: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where each piece begins, and its coefficients (a, b, c, d) of a + b x + c x^2 + d x^3.

    x is the distance from the beginning of the piece; the straight ends are pieces as well. The
    second derivatives solve the tridiagonal system of the natural spline [de Boor 1978, ch. IV];
    they vanish at both ends.
    """
    n, h = len(u), np.diff(u)
    slope = np.diff(f) / h
    A, r = np.eye(n), np.zeros(n)
    for i in range(1, n - 1):
        A[i, i - 1 : i + 2] = h[i - 1], 2 * (h[i - 1] + h[i]), h[i]
        r[i] = 6 * (slope[i] - slope[i - 1])
    M = np.linalg.solve(A, r)
    b = slope - h * (2 * M[:-1] + M[1:]) / 6
    inner = np.column_stack([f[:-1], b, M[:-1] / 2, np.diff(M) / (6 * h)])
    end = b[-1] + h[-1] * (M[-2] + M[-1]) / 2
    before, after = [f[0], b[0], 0.0, 0.0], [f[-1], end, 0.0, 0.0]
    return np.concatenate([u[:1], u]), np.vstack([before, inner, after])
