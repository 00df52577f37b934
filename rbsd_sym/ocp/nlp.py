"""A chain of blocks as a nonlinear program, its derivatives put together from those of one block.

Block k has the variables w_k = [y_k; v_k] and gives the next y, rows and a cost:

    minimise sum cost(w_k)   with   y_{k+1} - next(w_k) = 0,   low <= rows(w_k) <= high,

in this order, which is the one fatrop wants (it calls a block a stage). Variables of different
blocks meet only in y_{k+1}, so that the Jacobian is one matrix a block and ones, and the Hessian is
block diagonal.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ..dae.members import Label
from ..exports.load import OPTIMISED, build

_PARTS = ("value", "jacobian", "gradient", "hessian")


class RowKind(Enum):
    """Meaning of a row of a block; the value is the word for it in the row's name."""

    motion = "motion"  # what an interval hands on is what comes next
    link = "link"  # what a node hands on is what comes next
    rate = "rate"  # an equation of motion at a collocation point
    balance = "balance"  # an algebraic equation
    norm = "norm"  # a quaternion is a unit quaternion
    start = "start"  # a start that follows from a Param to be found
    cycle = "return"  # the end of a periodic motion is its start
    copy = "copy"  # the constants of a periodic motion are its start
    path = "path"  # a condition along the path, at a point where its variables are
    limit = "limit"  # a condition or bound along the path, between such points
    end = "end"  # a condition at an end of a phase

    @property
    def is_equation(self) -> bool:
        """Whether it is one of the equations of motion, and not a condition of the problem."""
        return self in (RowKind.motion, RowKind.link, RowKind.rate, RowKind.balance)


_BARE = (RowKind.copy, RowKind.path, RowKind.limit, RowKind.end)  # named as what they are about


class Where(Enum):
    """Place of a segment in its phase; the value is the word for it in reports."""

    start = "start"
    path = "path"
    end = "end"


@dataclass(frozen=True)
class Row:
    """One row of a block; every block of a segment has the same.

    Fields:
        label: what it is about, with its unit.
        phase: number of the phase.
        node: place in the block at which it holds, from 0 (start) to 1 (end).
    """

    label: Label
    kind: RowKind
    phase: int
    node: float = 0.0

    @property
    def name(self) -> str:
        """The row in words, for people."""
        if self.kind in _BARE:
            return self.label.name
        return f"{self.kind.value} of {self.label.name}"


@dataclass(frozen=True)
class Variable:
    """One variable of a block; every block of a segment has the same.

    Fields:
        label: what it is, with its unit.
        node: its place in the block, from 0 (start) to 1 (end).
        loosens: of a slack the number of the row that may be missed by it, else None.
    """

    label: Label
    node: float = 0.0
    loosens: int | None = None

    @property
    def name(self) -> str:
        """The variable in words, for people."""
        return self.label.name


@dataclass(frozen=True, eq=False)
class BlockFunctions:
    """A block with its derivatives by w, c being constants.

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
    def derived(name: str, w: Any, c: Any, following: Any, rows: Any, cost: Any) -> BlockFunctions:
        """Differentiate expressions of w and c, SX or MX."""
        both = ca.densify(ca.vertcat(following, rows))
        weight, weights = type(w).sym("weight"), type(w).sym("weights", both.numel())
        gradient = ca.gradient(cost, w)
        lagrangian = weight * cost + ca.dot(weights, both)
        hessian = ca.hessian(lagrangian, w)[0]
        return BlockFunctions(
            ca.Function(f"{name}_value", [w, c], [both, cost]),
            ca.Function(f"{name}_jacobian", [w, c], [ca.jacobian(both, w)]),
            ca.Function(f"{name}_gradient", [w, c], [ca.densify(gradient)]),
            ca.Function(f"{name}_hessian", [w, c, weight, weights], [hessian]),
        )

    def compiled(self, name: str, compiler: str | None = None) -> BlockFunctions:
        """Return the same functions as machine code, built once and kept in the cache of libraries.

        Raises:
            CompilerMissing: there is no compiler.
            RuntimeError: the compiler failed; with its message.
        """
        symbols = {part: f"{name}_{part}" for part in _PARTS}
        generator = ca.CodeGenerator(f"{name}_stage")
        for part, symbol in symbols.items():
            function: ca.Function = getattr(self, part)
            own = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
            generator.add(ca.Function(symbol, own, function.call(own)))
        library = str(build(f"{name}-stage", str(generator.dump()), compiler, OPTIMISED))
        return BlockFunctions(*(ca.external(symbols[part], library) for part in _PARTS))


@dataclass(frozen=True, eq=False)
class Segment:
    """Blocks of one kind, in a row.

    Fields:
        where, phase: where the blocks are, and the number of the phase.
        constants: (n_c, count).
        n_y, n_next: size of y here, and of what a block hands on (0 in the last one).
        low, high, guess: of the variables (n_w, count).
        row_low, row_high: of the rows after those that hand on y (n_g - n_next,).
        variables, rows: what they are, of every block (n_w,), (n_g,).
        fractions: of the phase, that each block spans (count, 2).
    """

    where: Where
    phase: int
    functions: BlockFunctions
    constants: np.ndarray
    n_y: int
    n_next: int
    low: np.ndarray
    high: np.ndarray
    guess: np.ndarray
    row_low: np.ndarray
    row_high: np.ndarray
    variables: tuple[Variable, ...]
    rows: tuple[Row, ...]
    fractions: np.ndarray

    @property
    def count(self) -> int:
        """Number of blocks."""
        return self.constants.shape[1]

    @property
    def n_w(self) -> int:
        """Variables of a block."""
        return self.low.shape[0]

    @property
    def n_g(self) -> int:
        """Equations and rows of a block."""
        return self.n_next + len(self.row_low)

    def columns(self, values: np.ndarray) -> np.ndarray:
        """Values of all its variables or rows (n count,) as a column a block (n, count)."""
        return values.reshape(self.count, -1).T


@dataclass(frozen=True, eq=False)
class Nlp:
    """Segments in a chain: a nonlinear program with exact derivatives.

    It is what `transcribe` returns and what solvers take. `functions` holds CasADi Functions under
    the names that `nlpsol` uses, `bounds` the start and all bounds:

        nlp = transcribe(problem, Collocation(20))
        cost, rows = nlp.functions["nlp"](nlp.bounds["x0"], [])

    Fields:
        segments: in the order in which time passes.
    """

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
        """Start x0 and bounds lbx, ubx of the variables (n,), bounds lbg, ubg of the rows (m,)."""
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
        """Sizes of the chain as fatrop asks for them: N, nx, nu, ng."""
        # "States" are y, "controls" all other variables of a block, so that rows between them count
        # as path constraints.
        nx, nu, ng = [], [], []
        for part in self.segments:
            nx += [part.n_y] * part.count
            nu += [part.n_w - part.n_y] * part.count
            ng += [len(part.row_low)] * part.count
        return {"N": len(nx) - 1, "nx": nx, "nu": nu, "ng": ng}

    def split(self, x: np.ndarray) -> list[np.ndarray]:
        """Variables (n,) of each segment, a column a block (n_w, count)."""
        starts = [first for first, _ in self.offsets]
        return [
            part.columns(x[a:b])
            for part, a, b in zip(self.segments, starts, starts[1:], strict=False)
        ]

    def _blocks(self, x: Any) -> list[Any]:
        """Symbols of the variables of each segment, a column a block."""
        return [
            ca.reshape(x[start : start + part.n_w * part.count], part.n_w, part.count)
            for part, (start, _) in zip(self.segments, self.offsets, strict=False)
        ]

    @cached_property
    def functions(self) -> dict[str, ca.Function]:
        """Functions by CasADi's names: nlp, nlp_grad_f, nlp_jac_g, nlp_hess_l (full), nlp_grad."""
        x, p = ca.MX.sym("x", self.n), ca.MX.sym("p", 0)
        blocks, f = self._blocks(x), ca.MX(0)
        values, gradients, jacobian = [], [], []
        for k, part in enumerate(self.segments):
            block, c = part.functions, ca.DM(part.constants)
            value, cost = _mapped(block.value, part.count)(blocks[k], c)
            following = self._following(blocks, k)
            if part.n_next:
                value = ca.vertcat(following - value[: part.n_next, :], value[part.n_next :, :])
            values.append(ca.vec(value))
            f += ca.sum2(cost)
            # One Function a segment, mapped over its blocks: the graph does not grow with their
            # number.
            own = _mapped(block.gradient, part.count)(blocks[k], c)
            gradients.append(ca.vec(own))
            jacobian.append(_nonzeros(_mapped(block.jacobian, part.count)(blocks[k], c)))
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
        """The y that comes after each block of a segment, a column each."""
        part = self.segments[k]
        own = blocks[k][: part.n_next, 1:]
        if k + 1 == len(blocks):
            return own
        return ca.horzcat(own, blocks[k + 1][: part.n_next, 0])

    def _jacobian(self, nonzeros: list[Any]) -> Any:
        """Scatter [-d next; d rows] of each block, and ones for y_{k+1}, by index."""
        rows, columns, values = [], [], []
        for k, part in enumerate(self.segments):
            first, top = self.offsets[k]
            i, j = _pattern(part.functions.jacobian.sparsity_out(0))
            sign = np.where(i < part.n_next, -1.0, 1.0)
            block = np.arange(part.count)
            rows.append((i[:, None] + top + part.n_g * block).T.reshape(-1))
            columns.append((j[:, None] + first + part.n_w * block).T.reshape(-1))
            values.append(nonzeros[k] * ca.DM(np.tile(sign, part.count)))
            ones = np.arange(part.n_next)
            # What a block hands on is the first n_next variables of the block after it, also where
            # that is the first one of the next segment.
            starts = first + part.n_w * (block + 1)
            rows.append((ones[:, None] + top + part.n_g * block).T.reshape(-1))
            columns.append((ones[:, None] + starts).T.reshape(-1))
            values.append(ca.MX(ca.DM.ones(part.n_next * part.count)))
        return _scattered(self.m, self.n, rows, columns, values)

    def _hessian(self, blocks: list[Any], weight: Any, weights: Any) -> Any:
        rows, columns, values = [], [], []
        for k, part in enumerate(self.segments):
            first, top = self.offsets[k]
            own = ca.reshape(weights[top : top + part.n_g * part.count], part.n_g, part.count)
            if part.n_next:  # g holds minus what is handed on
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
    """Return nonzeros as a column, block by block."""
    return ca.vec(ca.MX(matrix).nz[:]) if matrix.nnz() else ca.MX(0, 1)


def _pattern(sparsity: ca.Sparsity) -> tuple[np.ndarray, np.ndarray]:
    rows, columns = sparsity.get_triplet()
    return np.array(rows, int), np.array(columns, int)


def _scattered(n: int, m: int, rows: list[Any], columns: list[Any], values: list[Any]) -> Any:
    """Return the sparse matrix with these entries, each at a place of its own.

    CasADi orders nonzeros column by column, so the values are gathered in that order.
    """
    i, j = (np.concatenate(parts) if parts else np.zeros(0) for parts in (rows, columns))
    order = np.lexsort((i, j))
    pattern = ca.Sparsity.triplet(
        n, m, i[order].astype(int).tolist(), j[order].astype(int).tolist()
    )
    return ca.MX(pattern, ca.vertcat(*values).nz[order.astype(int).tolist()])
