"""Tangent coordinates of the states: one for each degree of freedom.

A quaternion has four entries and three degrees of freedom; its norm moves nothing, and as a
coordinate it would add a meaningless eigenvalue 0. Data states have no rate, and no coordinate.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from ..dae.dae import Dae
from ..dae.members import Kinematics, Label, pick
from ..model.model import Model


class Chart:
    """The tangent coordinates of a model, and how steps along them move its states.

    Fields:
        labels: of the tangent coordinates: first the states that are their own, then the rotations
            (body axes, rad) of motions with quaternions.
        plain: rows of x that are their own tangent coordinates.
        turned: the other motions, each with its live coordinates (index in the motion, row of x)
            and the indices of its tangent step that are coordinates here.
    """

    def __init__(self, model: Model) -> None:
        self.dae, self.model = model.dae, model
        expansion = self.dae.expansion
        self._place = expansion.rows if expansion else tuple(range(model.n_x))
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
        """Return a motion with its live coordinates and tangent components, or None.

        None if it has no more live coordinates than degrees of freedom: these are plain states.
        """
        live = [
            (i, row)
            for i, c in enumerate(motion.coordinates)
            if (row := self._place[c]) is not None
        ]
        if len(live) < 2:
            return None
        kept = _acting(motion, pick(self.dae.states, motion.coordinates), [i for i, _ in live])
        return (motion, live, kept) if len(kept) < len(live) else None

    @property
    def size(self) -> int:
        """Number of tangent coordinates."""
        return len(self.labels)

    @cached_property
    def _moved(self) -> tuple[ca.SX, ca.SX]:
        """The step (size, 1), and the states moved by it (n_x, 1)."""
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
        """(x, z, p, step) -> the states (n_x, 1) moved by a tangent step (size, 1)."""
        dae, (step, moved) = self.dae, self._moved
        return ca.Function("retract", [dae.x, dae.z, dae.p, step], [ca.densify(moved)])

    @cached_property
    def _basis(self) -> ca.SX:
        step, moved = self._moved
        return ca.substitute(ca.jacobian(moved, step), step, ca.SX.zeros(self.size))

    @cached_property
    def basis(self) -> ca.Function:
        """(x, z, p) -> T (n_x, size), the derivative of `retract` by a step, at step 0."""
        return ca.Function("basis", [self.dae.x, self.dae.z, self.dae.p], [ca.densify(self._basis)])

    @cached_property
    def turning(self) -> ca.Function:
        """(x, z, p, rates of x) -> T' (n_x, size), the rate of the basis along a motion, 1/s."""
        rates = ca.SX.sym("rates", self.dae.x.numel())
        column = ca.densify(ca.vec(self._basis))
        turned = ca.reshape(ca.jtimes(column, self.dae.x, rates), *self._basis.shape)
        arguments = [self.dae.x, self.dae.z, self.dae.p, rates]
        return ca.Function("turning", arguments, [ca.densify(turned)])


def chart_of(model: Model) -> Chart:
    """Return the tangent coordinates of a model, built once and kept with it."""
    return model.cached("tangent coordinates", lambda: Chart(model))


def _acting(motion: Kinematics, coordinates: ca.SX, live: list[int]) -> list[int]:
    """Return which components of a motion's tangent step move its live coordinates."""
    step = ca.SX.sym("step", len(motion.velocities))
    moved = ca.jacobian(motion.retract(coordinates, step)[live], step)
    slope = ca.simplify(ca.substitute(moved, step, ca.SX.zeros(step.numel())))
    return [i for i in range(step.numel()) if ca.sparsify(slope[:, i]).nnz()]


def left_inverse(T: np.ndarray) -> np.ndarray:
    """Return (T'T)^-1 T' of one basis (n, m), or of many (k, n, m), which has full column rank."""
    turned = np.swapaxes(T, -1, -2)
    return np.linalg.solve(turned @ T, turned)


def left_out_basis(dae: Dae, names: list[str], values: np.ndarray) -> np.ndarray:
    """Return the basis T (n, m) of states that a minimal model left out.

    A quaternion of which all entries were left out has three columns, those of its rotations.

    Arguments:
        dae: the reduced model.
        names: of the n states that never move, in the order of the transverse Jacobian.
        values: their constant values (n,).
    """
    place = {name: i for i, name in enumerate(names)}
    labels = dae.expansion.labels if dae.expansion else dae.x_labels
    columns, done = [], set()
    for motion in dae.motions:
        rows = [place.get(labels[c].name) for c in motion.coordinates]
        if len(rows) <= len(motion.velocities) or None in rows:
            continue
        # The basis is constant, since these coordinates never move.
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
