"""A `Dae` as a few kernels, each mapped over its instances: code that does not grow with the scene.

Parts with the same kernel and structure (which arguments are 0, 1, -1, frozen, or formulas) form a
group. A group has one kernel, into which common numbers are folded. It is called for every instance
with its own states and constants as arguments.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from ..base.program import identity
from ..dae.dae import Dae
from ..dae.members import Hold, numbers_of, pick
from ..dae.zeros import fold

_STRUCTURAL = (0.0, 1.0, -1.0)
_MANY = 8  # structures of a kernel; if there are more, all its instances form one group


@dataclass(frozen=True, eq=False)
class Group:
    """The N instances of one kernel.

    Fields:
        kernel: Function (t, w (n, 1), c (k, 1)) -> (r, 1), w being entries of [x; z; u; p].
        reads: (n, N) rows of w in [x; z; u; p], a column for each instance.
        constants: (k, N) values of c.
        writes: (r, N) rows of [ode; alg], or of out, to which the results are added.
    """

    kernel: ca.Function
    reads: np.ndarray
    constants: np.ndarray
    writes: np.ndarray


def groups(dae: Dae) -> list[Group]:
    """Group the parts and holds of a `Dae` by kernel and structure; they write to [ode; alg].

    Raises:
        ValueError: a part with symbols other than t, x, z, u, p of the model.
    """
    n, way = dae.x.numel(), dae.expansion
    reader = _Reader(dae, dae.states)
    instances = []
    for part in dae.parts:
        ode = [way.rows[row] if way else row for row in part.ode_rows]
        alg = [way.alg_rows[row] if way else None for row in part.ode_rows]
        writes = [
            i if i is not None else -1 if j is None else n + j
            for i, j in zip(ode, alg, strict=True)
        ]
        writes += [n + row for row in part.alg_rows]
        arguments = (part.kernel, part.reads, part.reads_z, part.constants, part.numbers)
        instances.append(reader.read(*arguments, tuple(writes)))
    return [*_grouped(dae, reader, instances), *(_held(dae, hold) for hold in dae.holds)]


def _held(dae: Dae, hold: Hold) -> Group:
    """Return a group for a hold alone: it depends on all that acts on what it holds."""
    value = dae.held(hold)
    every = ca.vertcat(dae.x, dae.z, dae.u, dae.p)
    reads = _uses(value, every)
    w, row = every[reads], np.array([[dae.x.numel() + hold.alg_row]])
    kernel = ca.Function("held", [dae.t, w, ca.SX(0, 1)], [ca.densify(value)])
    return Group(kernel, np.array(reads, int).reshape(-1, 1), np.zeros((0, 1)), row)


def output_groups(dae: Dae) -> list[Group]:
    """Group the requested outputs by kernel and structure; they write to out."""
    reader, instances, first = _Reader(dae, dae.measured), [], 0
    for name in dae.requested:
        output = dae.outputs[name]
        kernel, constants = output.build()
        writes = tuple(range(first, first + kernel.size1_out(0)))
        first += len(writes)
        arguments = (output.reads, output.reads_z, constants, numbers_of(constants), writes)
        instances.append(reader.read(kernel, *arguments))
    return _grouped(dae, reader, instances)


def _grouped(dae: Dae, reader: _Reader, instances: list[_Instance]) -> list[Group]:
    alike: dict[Hashable, list[_Instance]] = defaultdict(list)
    for instance in instances:
        if any(row >= 0 for row in instance.writes):
            alike[instance.key].append(instance)
    found = [
        _group(dae, reader.local, kind) for same in alike.values() for kind in _by_structure(same)
    ]
    return [group for group in found if group.writes.size]


@dataclass(frozen=True, eq=False)
class _Instance:
    """A kernel with arguments over local symbols w0, w1, ..., which all instances share.

    Fields:
        columns: arguments x, z and constants of the kernel, 0 where `numbers` has a number.
        numbers: of all arguments, NaN where they are symbolic.
        reads: rows of the local symbols in [x; z; u; p].
        writes: rows of the results in [ode; alg] or out, -1 for those that are left out.
        key: equal for instances that may form a group.
    """

    kernel: ca.Function
    columns: tuple[ca.SX, ca.SX, ca.SX]
    numbers: np.ndarray
    reads: tuple[int, ...]
    writes: tuple[int, ...]
    key: Hashable

    @property
    def structure(self) -> np.ndarray:
        """The numbers that are 0, 1 or -1, since these simplify a kernel; NaN for all others."""
        return np.where(np.isin(self.numbers, _STRUCTURAL), self.numbers, np.nan)


class _Reader:
    """Makes instances: writes arguments of kernels over local symbols."""

    def __init__(self, dae: Dae, states: ca.SX) -> None:
        self.states = ca.vertsplit(states) if states.numel() else []
        self.unknowns = ca.vertsplit(dae.z) if dae.z.numel() else []
        every = ca.vertcat(dae.x, dae.z, dae.u, dae.p)
        symbols = ca.vertsplit(every) if every.numel() else []
        self.rows = {symbol.element_hash(): i for i, symbol in enumerate(symbols)}
        self.local: list[ca.SX] = []

    def read(
        self,
        kernel: ca.Function,
        reads: tuple[int, ...],
        reads_z: tuple[int, ...],
        constants: ca.SX,
        numbers: np.ndarray,
        writes: tuple[int, ...],
    ) -> _Instance:
        """Return the instance of a kernel; the arguments are fields of a `Part`."""
        seen: dict[int, int] = {}
        columns = (
            ca.vertcat(ca.SX(0, 1), *(self.states[row] for row in reads)),
            ca.vertcat(ca.SX(0, 1), *(self.unknowns[row] for row in reads_z)),
            constants,
        )
        known = (*(numbers_of(column) for column in columns[:2]), numbers)
        x, z, c = (
            self._column(column, values, seen)
            for column, values in zip(columns, known, strict=True)
        )
        # Numbers may differ within a group, formulas may not: they are part of its kernel.
        every = ca.vertcat(x, z, c)
        symbolic = np.flatnonzero(np.isnan(np.concatenate(known))).tolist()
        pattern = tuple(row >= 0 for row in writes)
        key = (kernel.__hash__(), tuple(symbolic), identity(pick(every, symbolic)), pattern)
        return _Instance(kernel, (x, z, c), np.concatenate(known), tuple(seen), writes, key)

    def _column(self, column: ca.SX, values: np.ndarray, seen: dict[int, int]) -> ca.SX:
        """Return a column over local symbols, with 0 for its numbers."""
        out = ca.SX.zeros(len(values))
        for i in np.flatnonzero(np.isnan(values)):
            out[int(i)] = self._entry(column[int(i)], seen)
        return out

    def _entry(self, entry: ca.SX, seen: dict[int, int]) -> ca.SX:
        """Return a symbolic argument as a formula of local symbols and the time."""
        if entry.is_symbolic() and entry.element_hash() in self.rows:
            return self._name(entry, seen)
        symbols = [s for s in ca.symvar(entry) if s.element_hash() in self.rows]
        names = [self._name(symbol, seen) for symbol in symbols]
        return ca.substitute(entry, ca.vertcat(*symbols), ca.vertcat(*names))

    def _name(self, symbol: ca.SX, seen: dict[int, int]) -> ca.SX:
        """Return the local symbol of one of [x; z; u; p]; the instance's first is always w0."""
        place = seen.setdefault(self.rows[symbol.element_hash()], len(seen))
        while len(self.local) <= place:
            self.local.append(ca.SX.sym(f"w{len(self.local)}"))
        return self.local[place]


def _by_structure(same: list[_Instance]) -> list[list[_Instance]]:
    """Split instances by what is 0, 1 or -1, unless that makes too many kinds."""
    kinds: dict[bytes, list[_Instance]] = defaultdict(list)
    for instance in same:
        kinds[instance.structure.tobytes()].append(instance)
    return list(kinds.values()) if len(kinds) <= _MANY else [same]


def _group(dae: Dae, local: list[ca.SX], instances: list[_Instance]) -> Group:
    """Return the group of instances with one key; numbers that all share become part of the code.

    The others become constants c. What the folded kernel does not depend on is not gathered, and
    rows that are provably zero are not written.
    """
    first = instances[0]
    numbers = np.array([instance.numbers for instance in instances]).T.reshape(-1, len(instances))
    plain = ~np.isnan(first.numbers)
    vary = np.flatnonzero(plain & (numbers != numbers[:, :1]).any(axis=1))
    c, w = ca.SX.sym("c", len(vary)), ca.vertcat(ca.SX(0, 1), *local[: len(first.reads)])
    whole = ca.vertcat(*first.columns)
    whole[np.flatnonzero(plain).tolist()] = ca.DM(first.numbers[plain])
    whole[vary.tolist()] = c
    ends = np.cumsum([0, *(column.numel() for column in first.columns)])
    x, z, constants = (whole[a:b] for a, b in pairwise(ends))
    results = first.kernel(dae.t, x, z, constants)
    results = ca.vertcat(*results) if isinstance(results, tuple) else results
    rows = fold(results, ca.vertcat(dae.t, w, c))
    live = [i for i, row in enumerate(first.writes) if row >= 0 and not rows[i].is_zero()]
    rows = ca.cse(ca.densify(rows[live])) if live else ca.SX(0, 1)
    uses_w, uses_c = (np.array(_uses(rows, column), int) for column in (w, c))
    arguments = [dae.t, w[uses_w.tolist()], c[uses_c.tolist()]]
    return Group(
        _kernel(first.kernel.name(), arguments, rows),
        np.array([instance.reads for instance in instances], int).T[uses_w],
        numbers[vary][uses_c],
        np.array([instance.writes for instance in instances], int).T[live],
    )


def _kernel(name: str, arguments: list[ca.SX], rows: ca.SX) -> ca.Function:
    function = ca.Function(name, arguments, [rows], {"allow_free": True})
    if function.has_free():
        raise ValueError(
            f"kernel '{name}': symbols {function.free_sx()} are not t, x, z, u, p of the model; "
            "use Params, Inputs or TIME"
        )
    return ca.Function(name, arguments, [rows])


def _uses(rows: ca.SX, column: ca.SX) -> list[int]:
    """Return which entries of a column the rows depend on."""
    if not column.numel() or not rows.numel():
        return []
    return [i for i, used in enumerate(ca.which_depends(rows, column, 1, False)) if used]
