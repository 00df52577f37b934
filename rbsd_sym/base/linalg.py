"""Linear equations that may not decide everything: least-norm solutions, free directions."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

_RANK = 1e-11  # of the largest singular value, rows and columns in fair units
_SMALL = 600  # equations, up to which singular values are taken at once
_REGULAR = 1e-11  # inverse condition of a large matrix that needs none
_PART = 1e-6  # of the leading entry of a direction, below which a name is left out
_NAMES = 6  # of one direction


class Slope:
    """A square matrix J for Newton steps, which may be singular.

    Rows are scaled to their largest entry, and then columns; a row of zeros stays as it is.
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
        """A residual in units of the rows."""
        return residual * self._row

    @cached_property
    def _parts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.linalg.svd(self._scaled)  # type: ignore[return-value]

    @cached_property
    def _inverse(self) -> np.ndarray | None:
        """Of a large regular matrix; singular values cost twenty times as much."""
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
        """The smallest of the steps s with least |J s - residual|."""
        r = self.scaled(residual)
        if not len(r):
            return r
        if self._inverse is not None:
            return self._column * (self._inverse @ r)
        U, values, Vt = self._parts
        k, N = self._rank, self.null
        step = self._column * (Vt[:k].T @ ((U[:, :k].T @ r) / values[:k]))
        return step - N @ np.linalg.lstsq(N, step, rcond=None)[0] if N.size else step

    @cached_property
    def null(self) -> np.ndarray:
        """Steps (n, k) that J does not feel, a column each."""
        if not len(self.J) or self._inverse is not None:
            return np.zeros((len(self.J), 0))
        return self._column[:, None] * self._parts[2][self._rank :].T


def _or_one(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0, values, 1.0)


def named_directions(null: np.ndarray, names: Sequence[str]) -> tuple[str, ...]:
    """Directions that span a null space, each by the names of the entries that move in it."""
    rows = _echelon(null.T.copy())
    found = []
    for row in rows:
        size = np.abs(row)
        moving = [names[int(i)] for i in np.argsort(-size, kind="stable") if size[i] > _PART]
        more = f" and {len(moving) - _NAMES} more" if len(moving) > _NAMES else ""
        found.append(" with ".join(moving[:_NAMES]) + more)
    return tuple(found)


def _echelon(rows: np.ndarray) -> np.ndarray:
    """The rows combined so that each has a leading entry 1, where all others are 0."""
    open_rows = list(range(len(rows)))
    while open_rows:
        size = np.abs(rows[open_rows])
        i, j = np.unravel_index(int(size.argmax()), size.shape)
        lead = open_rows.pop(int(i))
        rows[lead] = rows[lead] / rows[lead, j]
        for k in range(len(rows)):
            if k != lead:
                rows[k] = rows[k] - rows[k, j] * rows[lead]
    return rows
