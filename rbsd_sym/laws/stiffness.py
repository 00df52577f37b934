"""Springs that are not linear: a cubic term, and a table."""

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
    """Force c u^3 (plus k u), energy c u^4 / 4 (plus k u^2 / 2).

    Arguments:
        axis: 0, 1, 2 for translation along the joint's x, y, z, 3, 4, 5 for rotation.
        cubic, linear: c (N/m3, or N m/rad3) and k; negative ones soften.
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
        """Force and energy."""
        u = sight.strain
        return Answer(
            self.linear * u + self.cubic * u**3, (self.linear + self.cubic * u * u / 2) * u * u / 2
        )


@dataclass(frozen=True, eq=False)
class Table(Effect):
    """Force through given points: the natural cubic spline, C2, straight beyond its ends.

    Between points it differs from straight lines by at most h^2/8 of its second derivative; a
    table of straight lines with sharp bends overshoots there, so give more points.

    Arguments:
        axis: 0, 1, 2 for translation along the joint's x, y, z, 3, 4, 5 for rotation.
        strain: increasing, m or rad; at least two.
        force: N or N m, one for each strain.
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
            raise ValueError(f"{where}: strains {u}, forces {f}; all are finite")
        if (np.diff(u) <= 0).any():
            raise ValueError(f"{where}: strains {self.strain} do not increase; sort the table")

    def answer(self, sight: Sight) -> Answer:
        """Force and energy, zero at the first strain of the table."""
        knots, pieces = _natural_spline(np.array(self.strain), np.array(self.force))
        force, energy = ca.SX(0), ca.SX(0)
        stored, previous = 0.0, None
        for i, (start, c) in enumerate(zip(knots, pieces, strict=True)):
            if previous is not None:
                stored += float(_integral(previous[1], start - previous[0]))
            x = sight.strain - start
            here = i == 0 or sight.strain >= start
            value = c[0] + x * (c[1] + x * (c[2] + x * c[3]))
            force = value if i == 0 else ca.if_else(here, value, force)
            work = stored + _integral(c, x)
            energy = work if i == 0 else ca.if_else(here, work, energy)
            previous = (start, c)
        return Answer(force, energy)


def _column(values: Any, where: str) -> tuple[float, ...]:
    if is_number(values) or values is None:
        raise TypeError(f"{where}: {values!r}; give a list of numbers")
    for value in values:
        if not is_number(value):
            raise ValueError(f"{where}: {value!r} is {type(value).__name__}; give plain numbers")
        if isinstance(value, Scalar):
            raise TypeError(f"{where}: {value} is no plain number; a table is fixed")
    return tuple(float(value) for value in values)


def _integral(c: np.ndarray, x: Any) -> Any:
    return x * (c[0] + x * (c[1] / 2 + x * (c[2] / 3 + x * c[3] / 4)))


def _natural_spline(u: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and coefficients (a + b x + c x^2 + d x^3) of each piece, the straight ends included.

    Second derivatives from the tridiagonal system [de Boor 1978, ch. IV], zero at both ends.
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
