"""Functions of a model from mapped kernels: gather arguments, map a kernel, add its results.

Derivatives are made in the same way: each kernel is differentiated once, and the nonzeros of its
derivative are added at the places that each instance has in the derivative of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from ..base.names import derivative
from ..base.program import check_second_derivatives
from ..dae.dae import Dae
from .kernels import Group, groups, output_groups


@dataclass(frozen=True, eq=False)
class Piece:
    """A function that is called for each of the N instances of a group.

    Fields:
        function: (t, w, c) or (t, w, c, given) -> values (m, 1).
        reads: (n, N) rows of w in [x; z; u; p], a column for each instance.
        constants: (k, N) values of c.
        places: (m, N) nonzeros of the result to which the values are added, -1 for none.
        given: (g, N) rows of the sixth argument of the model's function (multipliers, or a
            direction) that the instance reads, -1 for a zero; None if there is no such argument.
    """

    function: ca.Function
    reads: np.ndarray
    constants: np.ndarray
    places: np.ndarray
    given: np.ndarray | None = None


class Assembled(NamedTuple):
    """A function of the model as pieces.

    Fields:
        pattern: sparsity of its result, whose nonzeros the pieces add up.
        letter, n_given: name and length of its sixth argument; "" and 0 if it has five.
    """

    pieces: list[Piece]
    pattern: ca.Sparsity
    letter: str = ""
    n_given: int = 0


@dataclass(frozen=True, eq=False)
class _Term:
    """Values (m, N) of a mapped kernel, and the places to which they are added, -1 for none."""

    values: ca.MX
    places: np.ndarray


def scatter_add(terms: Sequence[_Term], size: int) -> ca.MX:
    """Return the column (size, 1) of the sums of all values at each place.

    The work is linear in the number of values.
    """
    if not terms or not size:
        return ca.MX(ca.DM.zeros(size, 1))
    # CasADi makes values that are all zero, such as the slope of a switch, a sparse column.
    stack = ca.vertcat(*(ca.densify(ca.vec(term.values)) for term in terms), 0)
    places = np.concatenate([term.places.T.reshape(-1) for term in terms])
    sources = np.flatnonzero(places >= 0)
    order = sources[np.argsort(places[sources], kind="stable")]
    there, first, counts = np.unique(places[order], return_index=True, return_counts=True)
    # Gather the first value of each place; places without a value take the zero at the end.
    index = np.full(size, len(places))
    index[there] = order[first]
    total = stack.nz[index.tolist()]
    if counts.max(initial=0) > 1:
        again = counts > 1
        by_count = np.argsort(-counts[again], kind="stable")
        more = _layers(stack, order, first[again][by_count] + 1, counts[again][by_count] - 1)
        rows = there[again][by_count].tolist()
        total.nz[rows] = total.nz[rows] + more
    return total


def _layers(stack: ca.MX, order: np.ndarray, first: np.ndarray, counts: np.ndarray) -> ca.MX:
    """Return sums of counts[i] values each, from order[first[i]] on; counts fall with i.

    A layer holds the k-th values of all sums with at least k. Since counts fall, layer k is as long
    as the first sums of layer k - 1, so that layers are added as whole vectors, the shortest first.
    """
    total = ca.MX(0, 1)
    for layer in range(int(counts.max()) - 1, -1, -1):
        wide = int((counts > layer).sum())
        values = stack.nz[order[first[:wide] + layer].tolist()]
        n = total.numel()
        if n == 0:
            total = values
        elif n == wide:
            total = total + values
        else:
            total = ca.vertcat(total + values[:n], values[n:])
    return total


def with_jacobian(
    name: str, symbols: Sequence[ca.MX], value: ca.MX, blocks: Sequence[ca.MX]
) -> ca.Function:
    """Return the Function (t, x, z, u, p) -> value with its exact sparse Jacobian attached.

    Without it, CasADi would differentiate the gathering and the adding.

    Arguments:
        blocks: derivatives by t, x, z, u and p.
    """
    given = ca.MX.sym("given", value.numel())
    jacobian = ca.Function(
        f"jac_{name}",
        [*symbols, given],
        blocks,
        [*"txzup", f"out_{name}"],
        [f"jac_{name}_{kind}" for kind in "txzup"],
    )
    options = {"custom_jacobian": jacobian, "jac_penalty": 0}
    return ca.Function(name, symbols, [value], list("txzup"), [name], options)


class Assembly:
    """The functions of a `Dae` in the layout "kernels", with the names that `Model` gives them."""

    def __init__(self, dae: Dae) -> None:
        self.dae = dae
        self.groups = groups(dae)
        sizes = {kind: int(getattr(dae, kind).numel()) for kind in "xzup"}
        self.symbols = [ca.MX.sym("t"), *(ca.MX.sym(kind, n) for kind, n in sizes.items())]
        self.w = ca.vertcat(*self.symbols[1:])
        starts = np.cumsum([0, *sizes.values()])
        self.inputs = {k: range(a, b) for k, (a, b) in zip("xzup", pairwise(starts), strict=True)}
        self._known: dict[str, Assembled] = {}
        n, m = sizes["x"], sizes["z"]
        self.outputs = {"ode": range(n), "alg": range(n, n + m), "out": range(len(dae.out_labels))}

    @cached_property
    def _output_groups(self) -> list[Group]:
        return output_groups(self.dae)

    def _groups_of(self, name: str) -> list[Group]:
        return self._output_groups if name == "out" else self.groups

    @property
    def operations(self) -> int:
        """Scalar instructions of one evaluation of ode and alg."""
        return sum(g.kernel.n_instructions() * g.reads.shape[1] for g in self.groups)

    def function(self, name: str) -> ca.Function:
        """Return ode, alg, out or one of their derivatives as a CasADi Function."""
        parts = self.assembled(name)
        given = ca.MX.sym(parts.letter or "none", parts.n_given)
        terms = [_Term(self._mapped(piece, given), piece.places) for piece in parts.pieces]
        value = ca.MX(parts.pattern, scatter_add(terms, parts.pattern.nnz()))
        if name in ("ode", "alg"):
            blocks = [self.function(f"d{name}_d{v}")(*self.symbols) for v in "txzup"]
            return with_jacobian(name, self.symbols, value, blocks)
        symbols, names = [*self.symbols], [*"txzup"]
        if parts.letter:
            symbols, names = [*symbols, given], [*names, parts.letter]
        return ca.Function(name, symbols, [value], names, [name])

    def assembled(self, name: str) -> Assembled:
        """Return ode, alg, out or one of their derivatives in pieces."""
        if name not in self._known:
            found = derivative(name)
            if found is None:
                self._known[name] = self._value(name)
            elif found.by:
                self._known[name] = self._jacobian(found.of, found.by)
            else:
                second = {
                    "hessian": self._hessian,
                    "forward": self._forward,
                    "adjoint": self._adjoint,
                }
                self._known[name] = second[found.kind](found.of)
        return self._known[name]

    def _value(self, name: str) -> Assembled:
        pieces = [_piece(g, g.kernel, places) for g, places in self._writing(name)]
        return Assembled(pieces, ca.Sparsity.dense(len(self.outputs[name]), 1))

    def _jacobian(self, name: str, by: str) -> Assembled:
        """Return the sparse derivative of ode, alg or out by t (explicit), x, z, u or p."""
        if by == "t":
            return self._by_time(name)
        rows, columns = self.outputs[name], self.inputs[by]
        tangents = [self._tangents(group, rows, columns) for group in self._groups_of(name)]
        found = [term for term in tangents if term is not None]
        return _matrix(found, len(rows), len(columns))

    def _by_time(self, name: str) -> Assembled:
        """Return the explicit derivative by time, a dense column."""
        pieces = []
        for group, places in self._writing(name):
            t, w, c = group.kernel.sx_in()
            rate = ca.densify(ca.jacobian(group.kernel(t, w, c), t))
            if not rate.is_zero():
                pieces.append(_piece(group, ca.Function("by_time", [t, w, c], [rate]), places))
        return Assembled(pieces, ca.Sparsity.dense(len(self.outputs[name]), 1))

    def _hessian(self, name: str) -> Assembled:
        """Return the second derivatives of l'f by w = [x; z; u; p], sparse and symmetric.

        Raises:
            ValueError: a callee of which CasADi leaves out second derivatives.
        """
        found = []
        for group, writes in self._writing(name):
            check_second_derivatives(group.kernel, f"model '{self.dae.name}', {name}_hessian")
            t, w, c = group.kernel.sx_in()
            scale = ca.SX.sym("l", group.kernel.size1_out(0))
            second, _ = ca.hessian(ca.dot(scale, group.kernel(t, w, c)), w)
            i, j = (np.array(index, int) for index in second.sparsity().get_triplet())
            if len(i):
                function = ca.Function("second", [t, w, c, scale], [second.nz[:]])
                piece = _piece(group, function, writes, writes)
                found.append((piece, group.reads[i], group.reads[j]))
        n = self.w.numel()
        return _matrix(found, n, n)._replace(letter="l", n_given=len(self.outputs[name]))

    def _forward(self, name: str) -> Assembled:
        """Return the derivative of f along a direction v of w, a column."""
        pieces = []
        for group, places in self._writing(name):
            t, w, c = group.kernel.sx_in()
            seed = ca.SX.sym("v", w.numel())
            rate = ca.densify(ca.jtimes(group.kernel(t, w, c), w, seed))
            function = ca.Function("forward", [t, w, c, seed], [rate])
            pieces.append(_piece(group, function, places, group.reads))
        pattern = ca.Sparsity.dense(len(self.outputs[name]), 1)
        return Assembled(pieces, pattern, "v", self.w.numel())

    def _adjoint(self, name: str) -> Assembled:
        """Return the gradient of l'f by w, a column."""
        pieces = []
        for group, writes in self._writing(name):
            t, w, c = group.kernel.sx_in()
            scale = ca.SX.sym("l", group.kernel.size1_out(0))
            rate = ca.densify(ca.jtimes(group.kernel(t, w, c), w, scale, True))
            function = ca.Function("adjoint", [t, w, c, scale], [rate])
            pieces.append(_piece(group, function, group.reads, writes))
        pattern = ca.Sparsity.dense(self.w.numel(), 1)
        return Assembled(pieces, pattern, "l", len(self.outputs[name]))

    def _writing(self, name: str) -> list[tuple[Group, np.ndarray]]:
        """Return the groups that write to ode, alg or out, and to which rows; -1 for others."""
        pairs = [(g, _within(g.writes, self.outputs[name])) for g in self._groups_of(name)]
        return [(group, writes) for group, writes in pairs if (writes >= 0).any()]

    def _tangents(
        self, group: Group, rows: range, columns: range
    ) -> tuple[Piece, np.ndarray, np.ndarray] | None:
        """Return the nonzeros of a kernel's Jacobian, and their rows and columns in a block."""
        t, w, c = group.kernel.sx_in()
        jacobian = ca.jacobian(group.kernel(t, w, c), w)
        i, j = (np.array(index, int) for index in jacobian.sparsity().get_triplet())
        at = _within(group.writes, rows)[i], _within(group.reads, columns)[j]
        inside = ((at[0] >= 0) & (at[1] >= 0)).any(axis=1)
        if not inside.any():
            return None
        kept = ca.cse(jacobian.nz[np.flatnonzero(inside).tolist()])
        function = ca.Function("tangents", [t, w, c], [kept])
        return _piece(group, function, at[0]), at[0][inside], at[1][inside]

    def _mapped(self, piece: Piece, given: ca.MX) -> ca.MX:
        """Return the values of all instances, a column each."""
        n = piece.reads.shape[1]
        constants = ca.MX(ca.DM(piece.constants))
        arguments = [self.symbols[0], _gather(self.w, piece.reads), constants]
        if piece.given is not None:
            arguments.append(_gather(given, piece.given))
        if n == 1:
            return piece.function(*arguments)
        name = f"{piece.function.name()}_{n}"
        return piece.function.map(name, "serial", n, [0], [])(*arguments)


def _piece(
    group: Group, function: ca.Function, places: np.ndarray, given: np.ndarray | None = None
) -> Piece:
    return Piece(function, group.reads, group.constants, places, given)


def _within(rows: np.ndarray, part: range) -> np.ndarray:
    """Return rows counted from the start of a range, -1 for those outside."""
    return np.where((rows >= part.start) & (rows < part.stop), rows - part.start, -1)


def _gather(column: ca.MX, rows: np.ndarray) -> ca.MX:
    """Return entries of a dense column, a column for each instance (n, N); 0 for row -1."""
    if (rows < 0).any():
        column, rows = ca.vertcat(column, 0), np.where(rows < 0, column.numel(), rows)
    return ca.reshape(column.nz[rows.T.reshape(-1).tolist()], *rows.shape)


def _matrix(
    found: Sequence[tuple[Piece, np.ndarray, np.ndarray]], n_rows: int, n_columns: int
) -> Assembled:
    """Return the sparse matrix to which pieces add values at rows and columns; -1 is outside."""
    # The code of an entry is its index in the dense matrix, column by column as CasADi counts.
    codes = [np.where((i >= 0) & (j >= 0), j * n_rows + i, -1) for _, i, j in found]
    every = np.concatenate([np.zeros(0, int), *(code.reshape(-1) for code in codes)])
    used = np.unique(every[every >= 0])
    pieces = [
        replace(piece, places=np.where(code >= 0, np.searchsorted(used, code), -1))
        for (piece, _, _), code in zip(found, codes, strict=True)
    ]
    columns = np.searchsorted(used // max(n_rows, 1), np.arange(n_columns + 1))
    rows = (used % max(n_rows, 1)).tolist()
    return Assembled(pieces, ca.Sparsity(n_rows, n_columns, columns.tolist(), rows))
