"""Linear systems that may be singular: minimum-norm solutions and the directions left free."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

# Singular values below this fraction of the largest count as zero, after scaling.
_RANK = 1e-11
# Number of equations up to which the singular values are always computed.
_SMALL = 600
# Inverse condition number above which a large matrix counts as regular.
_REGULAR = 1e-11
# Entries below this fraction of the leading entry of a direction are not named.
_PART = 1e-6
# Most names in the description of one direction.
_NAMES = 6


class Slope:
    """A square Jacobian J for Newton steps, which may be singular.

    Rows are scaled by their largest entry, then columns, before the rank is decided, so that it
    does not depend on the units of equations and unknowns. A row of zeros stays as it is. Up to 600
    equations the rank comes from singular values; a larger matrix is inverted directly if it is
    well conditioned.

        step = -Slope(J).solve(residual)

    Arguments:
        J: numbers (n, n). If any is not finite, `finite` is False and nothing else may be used.
    """

    def __init__(self, J: np.ndarray) -> None:
        self.J = J
        self.finite = bool(np.isfinite(J).all())
        if self.finite:
            self._row = 1 / _or_one(np.abs(J).max(axis=1, initial=0.0))
            scaled = J * self._row[:, None]
            self._column = 1 / _or_one(np.abs(scaled).max(axis=0, initial=0.0))
            self._scaled = scaled * self._column

    def scaled(self, residual: np.ndarray) -> np.ndarray:
        """Return a residual (n,) with each row divided by the largest entry of that row of J."""
        return residual * self._row

    @cached_property
    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.linalg.svd(self._scaled)  # type: ignore[return-value]

    @cached_property
    def _inverse(self) -> np.ndarray | None:
        """Inverse of the scaled matrix if it is large and regular; else None."""
        # The singular value decomposition of a large matrix costs about twenty times its inverse.
        if len(self.J) <= _SMALL:
            return None
        try:
            inverse = np.linalg.inv(self._scaled)
        except np.linalg.LinAlgError:
            return None
        condition = np.linalg.norm(inverse, 1) * np.linalg.norm(self._scaled, 1)
        return inverse if condition * _REGULAR < 1 else None

    @property
    def _rank(self) -> int:
        values = self._parts[1]
        return int((values > _RANK * values.max(initial=0.0)).sum())

    def solve(self, residual: np.ndarray) -> np.ndarray:
        """Return the step s (n,) of minimum norm among those that minimise |J s - residual|.

        The residual is measured in the units of its rows, the norm of s in the units of the
        unknowns.
        """
        r = self.scaled(residual)
        if not len(r):
            return r
        if self._inverse is not None:
            return self._column * (self._inverse @ r)
        U, values, Vt = self._parts
        k, N = self._rank, self.null
        step = self._column * (Vt[:k].T @ ((U[:, :k].T @ r) / values[:k]))
        # The step above has minimum norm in scaled unknowns; removing its part in the null space
        # makes the norm minimal in the unknowns themselves.
        return step - N @ np.linalg.lstsq(N, step, rcond=None)[0] if N.size else step

    @cached_property
    def null(self) -> np.ndarray:
        """Basis (n, k) of the null space of J, one direction per column; k = 0 if J is regular."""
        if not len(self.J) or self._inverse is not None:
            return np.zeros((len(self.J), 0))
        return self._column[:, None] * self._parts[2][self._rank :].T


def _or_one(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0, values, 1.0)


def named_directions(null: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """Describe directions that span a null space by the names of the entries that change in them.

    Arguments:
        null: basis (n, k), one direction per column.
        names: n names.

    Returns:
        k descriptions, such as "a.p_x with b.p_x"; the entry that changes most comes first.
    """
    rows = _echelon(null.T.copy())
    found = []
    for row in rows:
        size = np.abs(row)
        moving = [names[int(i)] for i in np.argsort(-size, kind="stable") if size[i] > _PART]
        more = f" and {len(moving) - _NAMES} more" if len(moving) > _NAMES else ""
        found.append(" with ".join(moving[:_NAMES]) + more)
    return tuple(found)


def _echelon(rows: np.ndarray) -> np.ndarray:
    """Combine rows so that each has a leading entry 1 in a column where all others are 0."""
    open_rows = list(range(len(rows)))
    while open_rows:
        size = np.abs(rows[open_rows])
        # Gauss-Jordan elimination with full pivoting over the rows that have no leading entry yet.
        i, j = np.unravel_index(int(size.argmax()), size.shape)
        lead = open_rows.pop(int(i))
        rows[lead] = rows[lead] / rows[lead, j]
        for k in range(len(rows)):
            if k != lead:
                rows[k] = rows[k] - rows[k, j] * rows[lead]
    return rows
