"""A chain of stages as a nonlinear program, its derivatives put together from those of one stage.

Stage k has the variables w_k = [y_k; v_k] and gives the next y, rows and a cost:

    minimise sum cost(w_k)   with   y_{k+1} - next(w_k) = 0,   low <= rows(w_k) <= high,

in this order, which is the one fatrop wants. Variables of different stages meet only in y_{k+1}, so
that the Jacobian is one block a stage and ones, and the Hessian is block diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ..dae.members import Label


@dataclass(frozen=True, eq=False)
class StageFunctions:
    """A stage with its derivatives by w, c being constants.

    Fields:
        value: (w, c) -> [next; rows], cost.
        jacobian: (w, c) -> d[next; rows]/dw, sparse.
        gradient: (w, c) -> gradient of the cost, dense.
        hessian: (w, c, weight of the cost, weights of [next; rows]) -> Hessian by w, sparse, both
            triangles.
    """

    value: ca.Function
    jacobian: ca.Function
    gradient: ca.Function
    hessian: ca.Function

    @staticmethod
    def derived(name: str, w: Any, c: Any, following: Any, rows: Any, cost: Any) -> StageFunctions:
        """From expressions of w and c, SX or MX."""
        both = ca.densify(ca.vertcat(following, rows))
        weight, weights = type(w).sym("weight"), type(w).sym("weights", both.numel())
        gradient = ca.gradient(cost, w)
        lagrangian = weight * cost + ca.dot(weights, both)
        hessian = ca.hessian(lagrangian, w)[0]
        return StageFunctions(
            ca.Function(f"{name}_value", [w, c], [both, cost]),
            ca.Function(f"{name}_jacobian", [w, c], [ca.jacobian(both, w)]),
            ca.Function(f"{name}_gradient", [w, c], [ca.densify(gradient)]),
            ca.Function(f"{name}_hessian", [w, c, weight, weights], [hessian]),
        )


@dataclass(frozen=True, eq=False)
class Segment:
    """Stages of one kind, in a row.

    Fields:
        constants: (n_c, count).
        n_y, n_next: size of y here, and of what the stage hands on (0 in the last one).
        low, high, guess: of the variables (n_w, count).
        row_low, row_high: (n_rows,).
        variables, rows: names and units, for messages.
        when: time of each variable and each row as a fraction of the stage (n_w,), (n_rows,).
        phase: number of the phase, and `fractions` (count, 2) of it that each stage spans.
        kinds: of each row: "motion" and "link" hand on y, "rate" and "alg" are equations, "path",
            "start" and "end" are conditions.
    """

    functions: StageFunctions
    constants: np.ndarray
    n_y: int
    n_next: int
    low: np.ndarray
    high: np.ndarray
    guess: np.ndarray
    row_low: np.ndarray
    row_high: np.ndarray
    variables: tuple[Label, ...]
    rows: tuple[Label, ...]
    when: tuple[np.ndarray, np.ndarray]
    phase: int
    fractions: np.ndarray
    kinds: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of stages."""
        return self.constants.shape[1]

    @property
    def n_w(self) -> int:
        """Variables of a stage."""
        return self.low.shape[0]

    @property
    def n_g(self) -> int:
        """Equations and rows of a stage."""
        return self.n_next + len(self.row_low)


@dataclass(frozen=True, eq=False)
class Nlp:
    """Segments in a chain."""

    segments: tuple[Segment, ...]

    @cached_property
    def offsets(self) -> list[tuple[int, int]]:
        """First variable and first row of each segment, and the ends."""
        found, n, m = [], 0, 0
        for part in self.segments:
            found.append((n, m))
            n, m = n + part.n_w * part.count, m + part.n_g * part.count
        return [*found, (n, m)]

    @property
    def n(self) -> int:
        """Number of variables."""
        return self.offsets[-1][0]

    @property
    def m(self) -> int:
        """Number of equations and rows."""
        return self.offsets[-1][1]

    def _stacked(self, name: str) -> np.ndarray:
        return np.concatenate([getattr(part, name).T.reshape(-1) for part in self.segments])

    @property
    def bounds(self) -> dict[str, np.ndarray]:
        """x0, lbx, ubx, lbg, ubg."""
        rows = {}
        for key, side in (("lbg", "row_low"), ("ubg", "row_high")):
            rows[key] = np.concatenate(
                [
                    np.tile(np.concatenate([np.zeros(p.n_next), getattr(p, side)]), p.count)
                    for p in self.segments
                ]
            )
        names = {"x0": "guess", "lbx": "low", "ubx": "high"}
        return {key: self._stacked(name) for key, name in names.items()} | rows

    @property
    def structure(self) -> dict[str, Any]:
        """N, nx, nu, ng: what fatrop asks for."""
        nx, nu, ng = [], [], []
        for part in self.segments:
            nx += [part.n_y] * part.count
            nu += [part.n_w - part.n_y] * part.count
            ng += [len(part.row_low)] * part.count
        return {"N": len(nx) - 1, "nx": nx, "nu": nu, "ng": ng}

    def blocks(self, x: Any) -> list[Any]:
        """Variables of each segment, a column a stage."""
        return [
            ca.reshape(x[start : start + part.n_w * part.count], part.n_w, part.count)
            for part, (start, _) in zip(self.segments, self.offsets, strict=False)
        ]

    @cached_property
    def functions(self) -> dict[str, ca.Function]:
        """By CasADi's names: nlp, nlp_grad_f, nlp_jac_g, nlp_hess_l (full), nlp_grad."""
        x, p = ca.MX.sym("x", self.n), ca.MX.sym("p", 0)
        blocks, f = self.blocks(x), ca.MX(0)
        values, gradients, jacobian = [], [], []
        for k, part in enumerate(self.segments):
            stage, c = part.functions, ca.DM(part.constants)
            value, cost = _mapped(stage.value, part.count)(blocks[k], c)
            following = self._following(blocks, k)
            if part.n_next:
                value = ca.vertcat(following - value[: part.n_next, :], value[part.n_next :, :])
            values.append(ca.vec(value))
            f += ca.sum2(cost)
            own = _mapped(stage.gradient, part.count)(blocks[k], c)
            gradients.append(ca.vec(own))
            jacobian.append(_nonzeros(_mapped(stage.jacobian, part.count)(blocks[k], c)))
        g, grad = ca.vertcat(*values), ca.densify(ca.vertcat(*gradients))
        jac = self._jacobian(jacobian)
        weight, weights = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", self.m)
        hess = self._hessian(blocks, weight, weights)
        both, out = [x, p], ["x", "p"]
        lag, lag_names = [x, p, weight, weights], ["x", "p", "lam_f", "lam_g"]
        slope = weight * grad + ca.mtimes(jac.T, weights)
        return {
            "nlp": ca.Function("nlp", both, [f, g], out, ["f", "g"]),
            "nlp_grad_f": ca.Function("nlp_grad_f", both, [f, grad], out, ["f", "grad_f_x"]),
            "nlp_jac_g": ca.Function("nlp_jac_g", both, [g, jac], out, ["g", "jac_g_x"]),
            "nlp_hess_l": ca.Function("nlp_hess_l", lag, [hess], lag_names, ["hess_gamma_x_x"]),
            "nlp_grad": ca.Function(
                "nlp_grad",
                lag,
                [f, g, slope, ca.MX(0, 1)],
                lag_names,
                ["f", "g", "grad_gamma_x", "grad_gamma_p"],
            ),
        }

    def _following(self, blocks: list[Any], k: int) -> Any:
        """What comes after each stage of a segment, a column each."""
        part = self.segments[k]
        own = blocks[k][: part.n_next, 1:]
        if k + 1 == len(blocks):
            return own
        return ca.horzcat(own, blocks[k + 1][: part.n_next, 0])

    def _jacobian(self, nonzeros: list[Any]) -> Any:
        """[-d next; d rows] of each stage and ones for y_{k+1}, scattered by index."""
        rows, columns, values = [], [], []
        for k, part in enumerate(self.segments):
            first, top = self.offsets[k]
            i, j = _pattern(part.functions.jacobian.sparsity_out(0))
            sign = np.where(i < part.n_next, -1.0, 1.0)
            stage = np.arange(part.count)
            rows.append((i[:, None] + top + part.n_g * stage).T.reshape(-1))
            columns.append((j[:, None] + first + part.n_w * stage).T.reshape(-1))
            values.append(nonzeros[k] * ca.DM(np.tile(sign, part.count)))
            ones = np.arange(part.n_next)
            starts = first + part.n_w * (stage + 1)
            rows.append((ones[:, None] + top + part.n_g * stage).T.reshape(-1))
            columns.append((ones[:, None] + starts).T.reshape(-1))
            values.append(ca.MX(ca.DM.ones(part.n_next * part.count)))
        return _scattered(self.m, self.n, rows, columns, values)

    def _hessian(self, blocks: list[Any], weight: Any, weights: Any) -> Any:
        rows, columns, values = [], [], []
        for k, part in enumerate(self.segments):
            first, top = self.offsets[k]
            own = ca.reshape(weights[top : top + part.n_g * part.count], part.n_g, part.count)
            if part.n_next:
                own = ca.vertcat(-own[: part.n_next, :], own[part.n_next :, :])
            hessian = _mapped(part.functions.hessian, part.count)
            found = hessian(blocks[k], ca.DM(part.constants), ca.repmat(weight, 1, part.count), own)
            i, j = _pattern(part.functions.hessian.sparsity_out(0))
            shift = first + part.n_w * np.arange(part.count)
            rows.append((i[:, None] + shift).T.reshape(-1))
            columns.append((j[:, None] + shift).T.reshape(-1))
            values.append(_nonzeros(found))
        return _scattered(self.n, self.n, rows, columns, values)


def _mapped(function: ca.Function, count: int) -> ca.Function:
    return function.map(count) if count > 1 else function


def _nonzeros(matrix: Any) -> Any:
    """Nonzeros as a column, stage by stage."""
    return ca.vec(ca.MX(matrix).nz[:]) if matrix.nnz() else ca.MX(0, 1)


def _pattern(sparsity: ca.Sparsity) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = sparsity.get_triplet()
    return np.array(rows, int), np.array(columns, int)


def _scattered(n: int, m: int, rows: list[Any], columns: list[Any], values: list[Any]) -> Any:
    """The sparse matrix with these entries, each at a place of its own."""
    i, j = (np.concatenate(parts) if parts else np.zeros(0) for parts in (rows, columns))
    order = np.lexsort((i, j))
    pattern = ca.Sparsity.triplet(
        n, m, i[order].astype(int).tolist(), j[order].astype(int).tolist()
    )
    return ca.MX(pattern, ca.vertcat(*values).nz[order.astype(int).tolist()])
