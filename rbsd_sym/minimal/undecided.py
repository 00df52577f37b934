"""Directions that a balance without inertia does not decide, settled without changing the motion.

Let F(t, x, z) = 0 be the balance of motions that feel each other. Projectors onto left null spaces
are polynomials of the matrices (Faddeev-LeVerrier), so that they follow the motion exactly.

- Unknown velocities, and D = dF/dz singular (projector P): damping acts on some directions only, in
  the others F is a constraint on the states. Its derivative decides the velocity:
  0 = F + P tau F', which keeps F = 0, and draws a start that breaks it in within a few tau.
- No force at all along a direction (projector N), such as the spin of a point mass on a string,
  where that is not provable: 0 = F - N v, with v the velocity, or the way from the start.
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
_NOISE = 1e-13  # of the largest derivative in the model: smaller ones are rounding
_VIRTUAL = 1e-6  # of the real resistance, where the start alone decides nothing
_LEAK = 1e-6  # of what a projector may let through
_LARGEST = 12  # rows of a group; the price of a projector grows with their fourth power


@dataclass(frozen=True)
class Block:
    """A motion with unknowns: its full rows in alg and in z, and whether these are velocities."""

    motion: Balance
    acting: tuple[int, ...]
    unknowns: tuple[int, ...]
    damped: bool


def settle(dae: Dae, blocks: list[Block]) -> Dae:
    """The `Dae`, with undecided directions settled and noted.

    Raises:
        ValueError: directions that cannot be settled.
    """
    probe = _Sample(dae)
    if not blocks:
        return dae
    if probe.rank(probe.jacobian) == dae.z.numel():
        return _helped_at_start(probe, blocks)
    for group in _groups(probe, blocks):
        dae = _with_extra(dae, group, _extra(probe, group), _note(group))
    probe = _Sample(dae)
    if probe.rank(probe.jacobian) < dae.z.numel():
        names = ", ".join(label.name for label in dae.z_labels)
        raise ValueError(
            f"model '{dae.name}': motion without inertia ({names}): the balance of forces does not "
            "decide it; hold it by stiffness or damping, or give it a small mass and inertia"
        )
    return _helped_at_start(probe, blocks)


def _helped_at_start(probe: _Sample, blocks: list[Block]) -> Dae:
    """Virtual damping (or stiffness) where only the start itself decides nothing."""
    dae = probe.dae
    if probe.rank(probe.jacobian, at_start=True) == dae.z.numel():
        return dae
    for group in _groups(probe, blocks):
        rows = [row for row, _ in group.rows_of_blocks]
        D = probe.jacobian[rows, group.columns]
        if probe.rank(D, at_start=True) == len(rows):
            continue
        scales = ca.DM(probe.scales(D))
        note = (
            f"{group.name}: no inertia, and the start is a point where the balance decides nothing "
            f"in some direction; a virtual resistance of {_VIRTUAL:g} of the real one acts on it"
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
    """Blocks without damping in a group that is undecided and has damping elsewhere."""
    probe = _Sample(dae)
    if not blocks or probe.rank(probe.jacobian) == dae.z.numel():
        return []
    groups = [group.blocks for group in _groups(probe, blocks)]
    damped = [members for members in groups if any(block.damped for block in members)]
    return [block for members in damped for block in members if not block.damped]


class _Sample:
    """Values of matrices at the start and at points around it, and what they tell about ranks."""

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
        """Of alg with respect to z."""
        return ca.jacobian(self.dae.alg, self.dae.z)

    def values(self, matrix: ca.SX) -> list[np.ndarray]:
        """The matrix at the points."""
        function = ca.Function("probe", self.dae.symbols, [ca.densify(matrix)])
        return [np.array(function(*point)).reshape(matrix.shape) for point in self.points]

    def scales(self, matrix: ca.SX) -> np.ndarray:
        """Largest entry of each row over the points; rows of rounding are not raised."""
        largest = np.max([np.abs(value).max(axis=1) for value in self.values(matrix)], axis=0)
        return np.where(largest > self.noise, largest, max(self.noise / _NOISE, 1.0))

    @cached_property
    def noise(self) -> float:
        """What counts as rounding in a derivative of the balance."""
        rates = ca.jacobian(ca.vertcat(self.dae.ode, self.dae.alg), self.dae.x)
        return _NOISE * max(float(np.abs(v).max(initial=0.0)) for v in self.values(rates))

    def rank(self, matrix: ca.SX, at_start: bool = False) -> int:
        """Rank with scaled rows, at the start or the largest over the points."""
        scales = self.scales(matrix)[:, None]
        values = self.values(matrix)[: 1 if at_start else None]
        singular = [np.linalg.svd(value / scales, compute_uv=False) for value in values]
        return max(int((s > _RANK * max(s[0], 1.0)).sum()) for s in singular)


@dataclass(frozen=True)
class _Group:
    """Blocks that feel each other; for each its first row in alg and in z."""

    blocks: tuple[Block, ...]
    first_row: tuple[int, ...]
    first_column: tuple[int, ...]

    @property
    def name(self) -> str:
        """Names of the motions."""
        return ", ".join(block.motion.name for block in self.blocks)

    @property
    def rows_of_blocks(self) -> list[tuple[int, Block]]:
        """Rows in alg of the balances, with their block."""
        pairs = zip(self.blocks, self.first_row, strict=True)
        return [(first + i, b) for b, first in pairs for i in range(len(b.acting))]

    @property
    def columns(self) -> list[int]:
        """Rows in z of the unknowns."""
        pairs = zip(self.blocks, self.first_column, strict=True)
        return [first + i for b, first in pairs for i in range(len(b.unknowns))]


def _groups(probe: _Sample, blocks: list[Block]) -> list[_Group]:
    """Blocks joined by nonzeros of the Jacobian."""
    rows = np.cumsum([0, *(len(b.acting) for b in blocks)])
    columns = np.cumsum([0, *(len(b.unknowns) for b in blocks)])
    pattern = np.array(ca.DM(probe.jacobian.sparsity(), 1))
    n = len(blocks)
    joined = np.eye(n, dtype=bool)
    for i in range(n):
        for j in range(n):
            joined[i, j] |= pattern[rows[i] : rows[i + 1], columns[j] : columns[j + 1]].any()
    joined |= joined.T
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


def _extra(probe: _Sample, group: _Group) -> ca.SX | None:
    """What is added to the balance of a group; None where nothing is needed."""
    dae, rows = probe.dae, [row for row, _ in group.rows_of_blocks]
    F, z = dae.alg[rows], dae.z[group.columns]
    D = ca.jacobian(F, z)
    felt = ca.horzcat(D, ca.jacobian(F, dae.x))
    if probe.rank(D) == len(rows):
        return None
    if len(rows) > _LARGEST:
        raise ValueError(
            f"model '{dae.name}': {group.name}: {len(rows)} motions without inertia feel each "
            "other, and damping acts on some of their directions only; damp every direction, or "
            "give a body a small mass and inertia"
        )
    _check_nothing_acts(probe, felt, F, group)
    if not group.blocks[0].damped:
        return -_through(probe, felt, _motion(dae, group))
    rate = ca.jtimes(F, dae.x, dae.ode) + ca.jacobian(F, dae.t)
    return _through(probe, D, _TAU * rate) - _through(probe, felt, z)


def _check_nothing_acts(probe: _Sample, felt: ca.SX, F: ca.SX, group: _Group) -> None:
    """A force in a direction that neither states nor unknowns feel cannot be balanced."""
    sizes = [np.abs(value).max() for value in probe.values(F)]
    lost = [np.abs(value).max() for value in probe.values(_through(probe, felt, F))]
    if max(lost) > _LEAK * max(sizes) + probe.noise:
        raise ValueError(
            f"model '{probe.dae.name}': {group.name}: {max(lost):.3g} N (or N m) act on a motion "
            "without inertia that nothing resists; hold it by stiffness or damping, or give it a "
            "mass and inertia"
        )


def _motion(dae: Dae, group: _Group) -> ca.SX:
    """The velocities of a group, or its way from the start."""
    if group.blocks[0].damped:
        return dae.z[group.columns]
    return ca.vertcat(*(_away(dae, block) for block in group.blocks))


def _away(dae: Dae, block: Block) -> ca.SX:
    """Way of a motion from its start along its acting velocities."""
    way = dae.expansion
    if way is None:
        raise ValueError(f"model '{dae.name}': a balance is settled in a reduced model")
    c, start, turned = block.motion.away()
    rows = [block.motion.velocities.index(row) for row in block.acting]
    given = ca.vertcat(*(way.labels[row].start for row in block.motion.coordinates))
    at = way.states[list(block.motion.coordinates)]
    return ca.substitute(turned[rows], ca.vertcat(c, start), ca.vertcat(at, given))


def _through(probe: _Sample, matrix: ca.SX, vector: ca.SX) -> ca.SX:
    """The vector, in the left null space of a matrix, in the units of F where it has none."""
    n, scales = matrix.size1(), ca.DM(probe.scales(matrix))
    rank = probe.rank(matrix)
    if rank == n:
        return ca.SX.zeros(n)
    scaled = matrix / ca.repmat(scales, 1, matrix.size2())
    P = _left_null(scaled, rank)
    leak = max(np.abs(value).max(initial=0.0) for value in probe.values(P @ scaled))
    if leak > _LEAK:
        raise ValueError(
            f"model '{probe.dae.name}': a motion without inertia is damped in some directions "
            "only, and far more weakly in one than in another; damp every direction alike, or give "
            "it a small mass and inertia"
        )
    return scales * (P @ (vector / scales))


def _left_null(M: ca.SX, rank: int) -> ca.SX:
    """Projector onto the left null space of M (n, m) of known rank: q(M M') / q(0).

    q is the characteristic polynomial without its zero roots (Faddeev-LeVerrier recursion).
    """
    G, unit = M @ M.T, ca.SX.eye(M.size1())
    B, c = unit, ca.SX(1)
    for k in range(1, rank + 1):
        GB = G @ B
        c = -ca.trace(GB) / k
        B = GB + c * unit
    return ca.densify(B / c)


def _part(dae: Dae, name: str, rows: tuple[int, ...], extra: ca.SX) -> Part:
    """The expression as a part, which reads the states it depends on."""
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
            f"from the derivative of the balance, a start off it is drawn in within {_TAU:g} s"
        )
    return f"{group.name}: no inertia, and no force in some direction; there it stays at its start"
