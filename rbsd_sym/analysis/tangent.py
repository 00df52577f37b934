"""Tangent coordinates of the states: as many as there are ways to move.

A quaternion has four entries and three ways to turn; the fourth, its norm, moves nothing and would
be an eigenvalue 0 of no meaning. Data states have no rate, and no coordinate.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from ..dae.dae import Dae
from ..dae.members import Kinematics, Label, pick
from ..model.model import Model


class Chart:
    """How steps in tangent coordinates move the states of a model.

    Fields:
        labels: of the tangent coordinates: states as they are, then the turns of quaternions.
        plain: rows of the former.
        turned: motions of the latter, each with its live coordinates (index in the motion, row of
            x) and the components of its tangent step.
    """

    def __init__(self, model: Model) -> None:
        self.dae, self.model = model.dae, model
        way = self.dae.expansion
        self._place = way.rows if way else tuple(range(model.n_x))
        self.turned = [turn for m in self.dae.motions if (turn := self._turn(m)) is not None]
        done = {row for _, live, _ in self.turned for _, row in live} | set(self.dae.data)
        self.plain = [row for row in range(model.n_x) if row not in done]
        labels = [model.x_labels[row] for row in self.plain]
        for motion, _, kept in self.turned:
            labels += [Label(motion.owner, motion.quantity, "xyz"[i], "rad") for i in kept]
        self.labels = tuple(labels)

    def _turn(
        self, motion: Kinematics
    ) -> tuple[Kinematics, list[tuple[int, int]], list[int]] | None:
        """A motion with more live coordinates than ways to move: those, and the ways."""
        live = [
            (i, row)
            for i, c in enumerate(motion.coordinates)
            if (row := self._place[c]) is not None
        ]
        if len(live) < 2:
            return None
        kept = ways(motion, pick(self.dae.states, motion.coordinates), [i for i, _ in live])
        return (motion, live, kept) if len(kept) < len(live) else None

    @property
    def size(self) -> int:
        """Number of tangent coordinates."""
        return len(self.labels)

    @cached_property
    def _moved(self) -> tuple[ca.SX, ca.SX]:
        """The step, and the states moved by it."""
        dae, step = self.dae, ca.SX.sym("step", self.size)
        x, first = list(ca.vertsplit(dae.x)) if dae.x.numel() else [], len(self.plain)
        for i, row in enumerate(self.plain):
            x[row] = x[row] + step[i]
        for motion, live, kept in self.turned:
            turn = ca.SX.zeros(len(motion.velocities))
            for i in kept:
                turn[i], first = step[first], first + 1
            moved = motion.retract(pick(dae.states, motion.coordinates), turn)
            for i, row in live:
                x[row] = moved[i]
        return step, ca.vertcat(ca.SX(0, 1), *x)

    @cached_property
    def retract(self) -> ca.Function:
        """(x, z, p, step) -> the states moved by a tangent step."""
        dae, (step, moved) = self.dae, self._moved
        return ca.Function("retract", [dae.x, dae.z, dae.p, step], [ca.densify(moved)])

    @cached_property
    def _basis(self) -> ca.SX:
        step, moved = self._moved
        return ca.substitute(ca.jacobian(moved, step), step, ca.SX.zeros(self.size))

    @cached_property
    def basis(self) -> ca.Function:
        """(x, z, p) -> T (n_x, size): how the states move with each tangent coordinate."""
        return ca.Function("basis", [self.dae.x, self.dae.z, self.dae.p], [ca.densify(self._basis)])

    @cached_property
    def turning(self) -> ca.Function:
        """(x, z, p, rates of x) -> T': how the basis turns along a motion."""
        rates = ca.SX.sym("rates", self.dae.x.numel())
        column = ca.densify(ca.vec(self._basis))
        turned = ca.reshape(ca.jtimes(column, self.dae.x, rates), *self._basis.shape)
        arguments = [self.dae.x, self.dae.z, self.dae.p, rates]
        return ca.Function("turning", arguments, [ca.densify(turned)])


def chart_of(model: Model) -> Chart:
    """The chart of a model, kept with it."""
    return model.cached("tangent coordinates", lambda: Chart(model))


def ways(motion: Kinematics, coordinates: ca.SX, live: list[int]) -> list[int]:
    """Which components of a motion's tangent step move its live coordinates."""
    step = ca.SX.sym("step", len(motion.velocities))
    moved = ca.jacobian(motion.retract(coordinates, step)[live], step)
    slope = ca.simplify(ca.substitute(moved, step, ca.SX.zeros(step.numel())))
    return [i for i in range(step.numel()) if ca.sparsify(slope[:, i]).nnz()]


def left_inverse(T: np.ndarray) -> np.ndarray:
    """(T'T)^-1 T' of one basis (n, m), or of many (k, n, m)."""
    turned = np.swapaxes(T, -1, -2)
    return np.linalg.solve(turned @ T, turned)


def left_out_basis(dae: Dae, names: list[str], values: np.ndarray) -> np.ndarray:
    """T (n, m) of states that a minimal model left out, without the norms of quaternions at rest.

    Arguments:
        names: of the states that never move, in the order of the transverse Jacobian.
        values: theirs.
    """
    place = {name: i for i, name in enumerate(names)}
    labels = dae.expansion.labels if dae.expansion else dae.x_labels
    columns, done = [], set()
    for motion in dae.motions:
        rows = [place.get(labels[c].name) for c in motion.coordinates]
        if len(rows) <= len(motion.velocities) or None in rows:
            continue
        where = [row for row in rows if row is not None]
        step = ca.SX.sym("step", len(motion.velocities))
        moved = motion.retract(ca.DM(values[where]), step)
        slope = np.array(ca.DM(ca.substitute(ca.jacobian(moved, step), step, 0 * step)))
        block = np.zeros((len(names), slope.shape[1]))
        block[where] = slope
        columns.append(block)
        done |= set(where)
    plain = np.eye(len(names))[:, [i for i in range(len(names)) if i not in done]]
    return np.hstack([plain, *columns])
