"""Unused: leave out what no requested output depends on, now or later.

Dependence is read from sparsity patterns, which hold for all values, so that it is never missed.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np

from ..dae.dae import Dae, Expansion
from ..dae.members import Part, pick


def unused(dae: Dae) -> Dae:
    """Drop states and unknowns that no requested output depends on, now or later.

    It does so only for a scene with `outputs=[...]`; otherwise all states may be of interest. The
    outputs that need what was dropped are refused from then on (`Expansion.unknown`).
    """
    way = dae.expansion
    if not dae.only_requested or way is None:
        return dae
    kept_x, kept_z, kept_alg = _needed(dae)
    if len(kept_x) == dae.x.numel() and len(kept_z) == dae.z.numel():
        return dae
    events = tuple(event for i, event in enumerate(dae.events) if _acts(dae, i, kept_x))
    gone = [dae.x[i] for i in range(dae.x.numel()) if i not in kept_x]
    gone += [dae.z[i] for i in range(dae.z.numel()) if i not in kept_z]
    start = [dae.x_start[i] for i in range(dae.x.numel()) if i not in kept_x]
    start += [dae.z_start[i] for i in range(dae.z.numel()) if i not in kept_z]
    symbols = ca.vertcat(*gone)
    states = ca.vertsplit(way.states)
    # `lost` full states are no longer known; the others do not depend on what was dropped.
    lost = {i for i, state in enumerate(states) if ca.depends_on(state, symbols)}
    for motion in way.followers:
        lost |= set(motion.velocities) if lost & set(motion.coordinates) else set()
    x_place = {old: new for new, old in enumerate(sorted(kept_x))}
    alg_place = {old: new for new, old in enumerate(sorted(kept_alg))}
    rows = tuple(None if row is None else x_place.get(row) for row in way.rows)
    alg_rows = tuple(None if row is None else alg_place.get(row) for row in way.alg_rows)
    expansion = Expansion(
        ca.substitute(way.states, symbols, ca.vertcat(*start)),
        way.labels,
        rows,
        alg_rows,
        tuple(m for m in way.followers if not lost & set(m.velocities)),
        way.unknown | frozenset(lost),
    )
    return replace(
        _only(dae, sorted(kept_x), sorted(kept_z)),
        parts=tuple(
            _renumbered(part, alg_place)
            for part in dae.parts
            if _matters(part, rows, alg_rows, alg_place)
        ),
        events=events,
        holds=tuple(
            replace(hold, alg_row=alg_place[hold.alg_row])
            for hold in dae.holds
            if hold.alg_row in alg_place
        ),
        expansion=expansion,
    )


def _only(dae: Dae, x: list[int], z: list[int]) -> Dae:
    return replace(
        dae,
        x=pick(dae.x, x),
        x_start=pick(dae.x_start, x),
        x_labels=tuple(dae.x_labels[i] for i in x),
        z=pick(dae.z, z),
        z_start=pick(dae.z_start, z),
        z_labels=tuple(dae.z_labels[i] for i in z),
    )


def _needed(dae: Dae) -> tuple[set[int], set[int], set[int]]:
    """Return the states, unknowns and equations that the requested outputs depend on.

    An unknown needs every equation that it is in, and so all that these read. A state needs what
    its rate reads, and what the events that change it read. Events that change nothing or stop the
    run are results by themselves, and so need what they read.
    """
    n = dae.x.numel()
    xz = ca.vertcat(dae.x, dae.z)
    reads = _rows(ca.jacobian_sparsity(ca.vertcat(dae.ode, dae.alg), xz))
    watched: set[int] = set()
    for i, read in enumerate(_read_by_events(dae, xz)):
        changed = dae.jump[:, i].sparsity().row()
        for row in changed:
            reads[row] = [*reads[row], *read]
        watched |= set() if changed and not dae.events[i].stops else set(read)
    if dae.updates:
        for row in dae.data:
            reads[row] = [*reads[row], *_together(ca.jacobian_sparsity(dae.update, xz))]
    equations: dict[int, set[int]] = {}
    for row in range(n, len(reads)):
        for column in reads[row]:
            equations.setdefault(column, set()).add(row)
    todo = watched | set(_together(ca.jacobian_sparsity(dae.out, xz)))
    needed: set[int] = set()
    alg: set[int] = set()
    while todo:
        column = todo.pop()
        needed.add(column)
        rows = {column} if column < n else equations.get(column, set()) - alg
        alg |= {row for row in rows if row >= n}
        todo |= {other for row in rows for other in reads[row]} - needed
    x, z = ({i for i in needed if i < n}, {i - n for i in needed if i >= n})
    return x, z, {row - n for row in alg}


def _read_by_events(dae: Dae, xz: ca.SX) -> list[list[int]]:
    """Return for each event the columns that its zero function and its changes depend on."""
    return [
        _together(ca.jacobian_sparsity(ca.vertcat(dae.zero[i], ca.densify(dae.jump[:, i])), xz))
        for i in range(len(dae.events))
    ]


def _acts(dae: Dae, i: int, kept: set[int]) -> bool:
    """Whether an event changes a state that is kept, or is a result by itself."""
    changed = dae.jump[:, i].sparsity().row()
    return dae.events[i].stops or not changed or bool(set(changed) & kept)


def _together(pattern: ca.Sparsity) -> list[int]:
    """Return the columns with a nonzero."""
    return sorted({column for row in _rows(pattern) for column in row})


def _rows(pattern: ca.Sparsity) -> list[list[int]]:
    """Return the columns with a nonzero, row by row."""
    transposed = pattern.T
    bounds, columns = transposed.colind(), transposed.row()
    return [columns[a:b] for a, b in pairwise(bounds)]


def _matters(
    part: Part,
    rows: tuple[int | None, ...],
    alg_rows: tuple[int | None, ...],
    alg_place: dict[int, int],
) -> bool:
    """Whether a part adds to a row that is kept."""
    live = any(rows[row] is not None or alg_rows[row] is not None for row in part.ode_rows)
    return live or any(row in alg_place for row in part.alg_rows)


def _renumbered(part: Part, alg_place: dict[int, int]) -> Part:
    return replace(part, alg_rows=tuple(alg_place[row] for row in part.alg_rows))


def without_effect(dae: Dae) -> Dae:
    """Move parameters that affect neither the model nor its requested outputs from p to idle_p."""
    if not dae.p.numel():
        return dae
    everything = ca.vertcat(
        dae.ode, dae.alg, dae.x_start, dae.z_start, dae.out, dae.zero, ca.vec(dae.jump), dae.update
    )
    acts = np.array(ca.which_depends(everything, dae.p, 1, False), bool).reshape(-1)
    if acts.all():
        return dae
    kept, idle = ([int(i) for i in np.flatnonzero(mask)] for mask in (acts, ~acts))
    return replace(
        dae,
        p=pick(dae.p, kept),
        p_labels=tuple(dae.p_labels[i] for i in kept),
        idle_p=pick(dae.p, idle),
        idle_p_labels=tuple(dae.p_labels[i] for i in idle),
    )
