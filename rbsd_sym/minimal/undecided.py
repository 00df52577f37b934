"""Directions that a balance without inertia does not determine; the motion stays as it is.

Let F(t, x, z) = 0 be the balance of coupled motions. Left null spaces of its derivatives are the
undetermined directions. Projectors onto them are written as polynomials of the matrices
(Faddeev-LeVerrier), so that they are exact along the whole motion.

- Unknown velocities, D = dF/dz singular with projector P: damping acts along some directions only,
  and along the others F is a constraint on the states. Its derivative determines the velocity:
  0 = F + P tau F' keeps F = 0, and lets a violation at the start decay within a few tau.
- No force at all along a direction (projector N) where that could not be proven, such as the spin
  of a point mass on a string: 0 = F - N v, with v the velocity, or the displacement from the start.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from ..dae.dae import Dae
from ..dae.members import Balance, Part

_TAU = 1e-3  # s; the result does not depend on it, rounding grows with its inverse
_RANK = 1e-9  # of a singular value, relative to the largest; rows are scaled
_NOISE = 1e-13  # of the largest derivative in the model; smaller ones are rounding
_VIRTUAL = 1e-6  # of the real resistance, if only at the start something is undetermined
_LEAK = 1e-6  # largest component that a projector may leave where there should be none
_LARGEST = 12  # rows of a group; the size of a projector grows with their fourth power


@dataclass(frozen=True)
class Block:
    """A motion with algebraic unknowns.

    Fields:
        acting, unknowns: full rows of its balances and of its unknowns.
        damped: whether the unknowns are velocities; otherwise they are coordinates.
    """

    motion: Balance
    acting: tuple[int, ...]
    unknowns: tuple[int, ...]
    damped: bool


def settle(dae: Dae, blocks: list[Block]) -> Dae:
    """Return the `Dae` with undetermined directions settled, and a note on each.

    Raises:
        ValueError: directions that cannot be settled.
    """
    sample = _Sample(dae)
    if not blocks:
        return dae
    if sample.rank(sample.jacobian) == dae.z.numel():
        return _helped_at_start(sample, blocks)
    for group in _groups(sample, blocks):
        dae = _with_extra(dae, group, _extra(sample, group), _note(group))
    sample = _Sample(dae)
    if sample.rank(sample.jacobian) < dae.z.numel():
        names = ", ".join(label.name for label in dae.z_labels)
        raise ValueError(
            f"model '{dae.name}': motion without inertia ({names}): the balance of forces does not "
            "decide it; hold it by stiffness or damping, or give it a small mass and inertia"
        )
    return _helped_at_start(sample, blocks)


def _helped_at_start(sample: _Sample, blocks: list[Block]) -> Dae:
    """Add virtual damping (or stiffness) to groups that are undetermined at the start only."""
    dae = sample.dae
    if sample.rank(sample.jacobian, at_start=True) == dae.z.numel():
        return dae
    for group in _groups(sample, blocks):
        rows = [row for row, _ in group.rows_of_blocks]
        D = sample.jacobian[rows, group.columns]
        if sample.rank(D, at_start=True) == len(rows):
            continue
        scales = ca.DM(sample.scales(D))
        note = (
            f"{group.name}: no inertia, and at the start the balance leaves some direction "
            f"undetermined; a virtual resistance of {_VIRTUAL:g} of the real one acts on it"
        )
        dae = _with_extra(dae, group, -_VIRTUAL * scales * _motion(dae, group), note)
    return dae


def _with_extra(dae: Dae, group: _Group, extra: ca.SX | None, note: str) -> Dae:
    if extra is None:
        return dae
    rows = tuple(row for row, _ in group.rows_of_blocks)
    part = _part(dae, group.name, rows, extra)
    return replace(dae, parts=(*dae.parts, part), notes=(*dae.notes, note))


def mixed(dae: Dae, blocks: list[Block]) -> list[Block]:
    """Return the undamped blocks of undetermined groups in which other blocks are damped."""
    sample = _Sample(dae)
    if not blocks or sample.rank(sample.jacobian) == dae.z.numel():
        return []
    groups = [group.blocks for group in _groups(sample, blocks)]
    damped = [members for members in groups if any(block.damped for block in members)]
    return [block for members in damped for block in members if not block.damped]


class _Sample:
    """Values of matrices at the start and at random points around it, for decisions on ranks."""

    def __init__(self, dae: Dae, points: int = 5) -> None:
        self.dae = dae
        rng = np.random.default_rng(0)
        u = np.array([label.start for label in dae.u_labels])
        p = np.array([label.start for label in dae.p_labels])
        x, z = dae.start_values(p)
        self.points = [
            (
                0.1 * k,
                *(v + (0.1 if k else 0.0) * rng.standard_normal(v.size) for v in (x, z)),
                u,
                p,
            )
            for k in range(points)
        ]

    @cached_property
    def jacobian(self) -> ca.SX:
        """Derivative of alg by z."""
        return ca.jacobian(self.dae.alg, self.dae.z)

    def values(self, matrix: ca.SX) -> list[np.ndarray]:
        """Return the matrix at all points."""
        function = ca.Function("sample", self.dae.symbols, [ca.densify(matrix)])
        return [np.array(function(*point)).reshape(matrix.shape) for point in self.points]

    def scales(self, matrix: ca.SX) -> np.ndarray:
        """Return the largest entry of each row over the points; a common one for mere rounding."""
        largest = np.max([np.abs(value).max(axis=1) for value in self.values(matrix)], axis=0)
        return np.where(largest > self.noise, largest, max(self.noise / _NOISE, 1.0))

    @cached_property
    def noise(self) -> float:
        """Size up to which derivatives of the balance count as rounding."""
        rates = ca.jacobian(ca.vertcat(self.dae.ode, self.dae.alg), self.dae.x)
        return _NOISE * max(float(np.abs(v).max(initial=0.0)) for v in self.values(rates))

    def rank(self, matrix: ca.SX, at_start: bool = False) -> int:
        """Return the rank with scaled rows, at the start or the largest over the points."""
        scales = self.scales(matrix)[:, None]
        values = self.values(matrix)[: 1 if at_start else None]
        singular = [np.linalg.svd(value / scales, compute_uv=False) for value in values]
        return max(int((s > _RANK * max(s[0], 1.0)).sum()) for s in singular)


@dataclass(frozen=True)
class _Group:
    """Coupled blocks; for each its first row in alg and in z."""

    blocks: tuple[Block, ...]
    first_row: tuple[int, ...]
    first_column: tuple[int, ...]

    @property
    def name(self) -> str:
        """Names of the motions."""
        return ", ".join(block.motion.name for block in self.blocks)

    @property
    def rows_of_blocks(self) -> list[tuple[int, Block]]:
        """Rows of the balances in alg, each with its block."""
        pairs = zip(self.blocks, self.first_row, strict=True)
        return [(first + i, b) for b, first in pairs for i in range(len(b.acting))]

    @property
    def columns(self) -> list[int]:
        """Rows of the unknowns in z."""
        pairs = zip(self.blocks, self.first_column, strict=True)
        return [first + i for b, first in pairs for i in range(len(b.unknowns))]


def _groups(sample: _Sample, blocks: list[Block]) -> list[_Group]:
    """Return the groups of blocks that nonzeros of the Jacobian couple."""
    rows = np.cumsum([0, *(len(b.acting) for b in blocks)])
    columns = np.cumsum([0, *(len(b.unknowns) for b in blocks)])
    pattern = np.array(ca.DM(sample.jacobian.sparsity(), 1))
    n = len(blocks)
    joined = np.eye(n, dtype=bool)
    for i in range(n):
        for j in range(n):
            joined[i, j] |= pattern[rows[i] : rows[i + 1], columns[j] : columns[j + 1]].any()
    joined |= joined.T
    # The transitive closure of what is coupled directly (Warshall).
    for k in range(n):
        joined |= joined[:, k : k + 1] & joined[k : k + 1, :]
    first = {int(np.argmax(row)): np.flatnonzero(row) for row in joined}
    return [
        _Group(
            tuple(blocks[i] for i in members),
            tuple(int(rows[i]) for i in members),
            tuple(int(columns[i]) for i in members),
        )
        for members in first.values()
    ]


def _extra(sample: _Sample, group: _Group) -> ca.SX | None:
    """Return what is added to the balance of a group; None if it is determined."""
    dae, rows = sample.dae, [row for row, _ in group.rows_of_blocks]
    F, z = dae.alg[rows], dae.z[group.columns]
    D = ca.jacobian(F, z)
    resists = ca.horzcat(D, ca.jacobian(F, dae.x))
    if sample.rank(D) == len(rows):
        return None
    if len(rows) > _LARGEST:
        raise ValueError(
            f"model '{dae.name}': {group.name}: {len(rows)} coupled motions without inertia, with "
            "damping along some of their directions only; damp every direction, or give a body a "
            "small mass and inertia"
        )
    _check_nothing_acts(sample, resists, F, group)
    if not group.blocks[0].damped:
        return -_through(sample, resists, _motion(dae, group))
    rate = ca.jtimes(F, dae.x, dae.ode) + ca.jacobian(F, dae.t)
    return _through(sample, D, _TAU * rate) - _through(sample, resists, z)


def _check_nothing_acts(sample: _Sample, resists: ca.SX, F: ca.SX, group: _Group) -> None:
    """Check that no force acts along a direction along which nothing resists it."""
    sizes = [np.abs(value).max() for value in sample.values(F)]
    lost = [np.abs(value).max() for value in sample.values(_through(sample, resists, F))]
    if max(lost) > _LEAK * max(sizes) + sample.noise:
        raise ValueError(
            f"model '{sample.dae.name}': {group.name}: {max(lost):.3g} N (or N m) act on a motion "
            "without inertia that nothing resists; hold it by stiffness or damping, or give it a "
            "mass and inertia"
        )


def _motion(dae: Dae, group: _Group) -> ca.SX:
    """Return the velocities of a group, or its displacement from the start."""
    if group.blocks[0].damped:
        return dae.z[group.columns]
    return ca.vertcat(*(_away(dae, block) for block in group.blocks))


def _away(dae: Dae, block: Block) -> ca.SX:
    """Return the displacement of a motion from its start along its acting velocities."""
    way = dae.expansion
    if way is None:
        raise ValueError(f"model '{dae.name}': a balance is settled in a reduced model")
    c, start, turned = block.motion.away()
    rows = [block.motion.velocities.index(row) for row in block.acting]
    given = ca.vertcat(*(way.labels[row].start for row in block.motion.coordinates))
    at = way.states[list(block.motion.coordinates)]
    return ca.substitute(turned[rows], ca.vertcat(c, start), ca.vertcat(at, given))


def _through(sample: _Sample, matrix: ca.SX, vector: ca.SX) -> ca.SX:
    """Project a vector onto the left null space of a matrix, in scaled rows."""
    n, scales = matrix.size1(), ca.DM(sample.scales(matrix))
    rank = sample.rank(matrix)
    if rank == n:
        return ca.SX.zeros(n)
    scaled = matrix / ca.repmat(scales, 1, matrix.size2())
    P = _left_null(scaled, rank)
    leak = max(np.abs(value).max(initial=0.0) for value in sample.values(P @ scaled))
    if leak > _LEAK:
        raise ValueError(
            f"model '{sample.dae.name}': a motion without inertia is damped in some directions "
            "only, and far more weakly in one than in another; damp every direction alike, or give "
            "it a small mass and inertia"
        )
    return scales * (P @ (vector / scales))


def _left_null(M: ca.SX, rank: int) -> ca.SX:
    """Return the projector onto the left null space of M (n, m) of known rank: q(M M') / q(0).

    q is the characteristic polynomial of M M' without its zero roots, by the recursion of Faddeev
    and LeVerrier: rational in the entries of M, without the pivots of a factorisation.
    """
    G, unit = M @ M.T, ca.SX.eye(M.size1())
    B, c = unit, ca.SX(1)
    for k in range(1, rank + 1):
        GB = G @ B
        c = -ca.trace(GB) / k
        B = GB + c * unit
    return ca.densify(B / c)


def _part(dae: Dae, name: str, rows: tuple[int, ...], extra: ca.SX) -> Part:
    """Return the expression as a part that reads the states it depends on."""
    states = ca.vertsplit(dae.states)
    symbols = [i for i, state in enumerate(states) if state.is_symbolic()]
    used = ca.which_depends(extra, ca.vertcat(*(states[i] for i in symbols)))
    reads = tuple(i for i, is_used in zip(symbols, used, strict=True) if is_used)
    x, c = ca.vertcat(*(states[i] for i in reads)), ca.vertcat(dae.u, dae.p)
    arguments = [dae.t, x, ca.SX.sym("z", 0), c]
    kernel = ca.Function("undecided", arguments, [ca.SX(0, 1), extra])
    return Part(f"{name} undecided", kernel, reads, (), c, (), rows)


def _note(group: _Group) -> str:
    if group.blocks[0].damped:
        return (
            f"{group.name}: no inertia, and damping in some directions only; the others follow "
            f"from the derivative of the balance; a violation at the start decays in {_TAU:g} s"
        )
    return f"{group.name}: no inertia, and no force in some direction; there it stays at its start"
