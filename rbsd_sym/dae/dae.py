"""The waist: a semi-explicit DAE  x' = ode(t, x, z, u, p),  0 = alg,  y = out.

Nothing below knows what a body is, nothing above knows what C is. A `Dae` keeps its parts: each is
one kernel with the states it reads and the rows it adds to. The flat expressions come from calling
the parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ..base.names import near
from ..base.newton import newton
from .members import (
    Balance,
    Hold,
    Kinematics,
    Label,
    Output,
    Outputs,
    Parameters,
    Part,
    Rotation,
    Transition,
    Update,
    pick,
)
from .zeros import fold


@dataclass(frozen=True)
class Expansion:
    """The way back from a reduced model: the states of the full scene.

    Arguments:
        states: each full state as an expression of x, z and p, as the parts read it.
        labels: their names, units and start values.
        rows: for each full state its row in ode, None for one that is no state.
        alg_rows: for each full state its row in alg, None for one that has inertia.
        followers: motions whose coordinates are algebraic: no part reads their velocities (0 stands
            in `states`), which follow from the rates of the coordinates (`Dae.measured`).
        unknown: full states that were left out though they move: nothing here tells their value.
    """

    states: ca.SX
    labels: tuple[Label, ...]
    rows: tuple[int | None, ...]
    alg_rows: tuple[int | None, ...]
    followers: tuple[Balance, ...] = ()
    unknown: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Dae:
    """Symbols, parts, names, units and start values.

    Arguments:
        t, x, z, u, p: SX columns.
        x_start, z_start: SX columns over p.
        outputs: every quantity that can be asked for, by name.
        requested: names of the outputs in y, in order.
        only_requested: whether these are all that matters.
        idle_p: parameters without effect on x, z and y; they may act on other outputs.
        notes: what the user should know (audit of the scene, what was left out).
        rotations: which states are rotations, and of what kind.
        balances: the motions without inertia, until a pass has made them algebraic.
        motions: coordinates of the full scene, their velocities, and how steps move them.
        events: what happens where a function falls through zero, in the order in which it happens
            if several do so at once.
        holds: rows of alg that hold a quantity, on top of what parts add to them.
        updates: what is asked of data states after every accepted step.
        expansion: in a reduced model, what parts and outputs read instead of x.
        source: text that determines the model, for its digest.
    """

    name: str
    t: ca.SX
    x: ca.SX
    z: ca.SX
    u: ca.SX
    p: ca.SX
    x_labels: tuple[Label, ...]
    z_labels: tuple[Label, ...]
    u_labels: tuple[Label, ...]
    p_labels: tuple[Label, ...]
    x_start: ca.SX
    z_start: ca.SX
    parts: tuple[Part, ...]
    outputs: Mapping[str, Output]
    requested: tuple[str, ...]
    notes: tuple[str, ...] = ()
    rotations: tuple[Rotation, ...] = ()
    balances: tuple[Balance, ...] = ()
    motions: tuple[Kinematics, ...] = ()
    events: tuple[Transition, ...] = ()
    holds: tuple[Hold, ...] = ()
    updates: tuple[Update, ...] = ()
    expansion: Expansion | None = None
    only_requested: bool = False
    idle_p: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    idle_p_labels: tuple[Label, ...] = ()
    source: str = field(default="", repr=False)

    def __repr__(self) -> str:
        sizes = ", ".join(f"{kind} ({getattr(self, kind).numel()})" for kind in "xzup")
        return f"<Dae '{self.name}': {sizes}>"

    @cached_property
    def _rows(self) -> tuple[ca.SX, ca.SX]:
        ode, alg = [ca.SX(0)] * self.x.numel(), [ca.SX(0)] * self.z.numel()
        way = self.expansion
        for part in self.parts:
            d_ode, d_alg = self._called(part)
            for i, row in enumerate(part.ode_rows):
                j, k = (way.rows[row], way.alg_rows[row]) if way else (row, None)
                if j is not None:
                    ode[j] = ode[j] + d_ode[i]
                if k is not None:
                    alg[k] = alg[k] + d_ode[i]
            for i, row in enumerate(part.alg_rows):
                alg[row] = alg[row] + d_alg[i]
        for hold in self.holds:
            alg[hold.alg_row] += self._held(hold, ca.vertcat(ca.SX(0, 1), *ode))
        rows = ca.cse(ca.vertcat(ca.SX(0, 1), *ode, *alg))
        n = len(ode)
        return pick(rows, range(n)), pick(rows, range(n, rows.numel()))

    def _called(self, item: Any) -> list[ca.SX]:
        """Results of the kernel of a part, event, hold or update, flat."""
        reads = pick(self.states, item.reads)
        results = item.kernel(self.t, reads, pick(self.z, item.reads_z), item.constants)
        if self.expansion and not reads.is_valid_input():  # some reads never move
            everything = ca.vertcat(*self.symbols)
            return [fold(result, everything) for result in results]
        return list(results)

    def _held(self, hold: Hold, ode: ca.SX) -> ca.SX:
        value, weight = self._called(hold)
        return weight * (ca.jtimes(value, self.x, ode) + ca.jacobian(value, self.t))

    def held(self, hold: Hold) -> ca.SX:
        """What a hold adds to its row of alg, flat."""
        return self._held(hold, self.ode)

    @cached_property
    def zero(self) -> ca.SX:
        """Functions of the events, which fire as they fall through zero, flat (n_events, 1)."""
        return ca.vertcat(ca.SX(0, 1), *(self._fired[i][0] for i in range(len(self.events))))

    @cached_property
    def jump(self) -> ca.SX:
        """Change of the states by each event, a sparse column each (n_x, n_events)."""
        return ca.horzcat(ca.SX(self.x.numel(), 0), *(change for _, change in self._fired))

    @cached_property
    def _fired(self) -> list[tuple[ca.SX, ca.SX]]:
        """Zero function and change of the states of each event."""
        found, way = [], self.expansion
        for event in self.events:
            zero, changes = self._called(event)
            column = ca.SX(self.x.numel(), 1)
            for row, change in zip(event.rows, ca.vertsplit(changes), strict=True):
                place = way.rows[row] if way else row
                if place is not None and not change.is_zero():
                    column[place] = change
            found.append((zero, column))
        return found

    @cached_property
    def update(self) -> ca.SX:
        """[largest error; smallest recommended step, or -1; states with new data], flat."""
        error, step, x = ca.SX(0), ca.SX(-1), list(ca.vertsplit(self.x))
        for update in self.updates:
            own, wish, data = self._called(update)
            error = ca.fmax(error, own)
            both = ca.if_else(step < 0, wish, ca.fmin(step, wish))
            step = ca.if_else(wish < 0, step, both)
            for i, row in enumerate(update.rows):
                place = self.expansion.rows[row] if self.expansion else row
                if place is not None:
                    x[place] = data[i]
        return ca.cse(ca.vertcat(error, step, *x))

    @property
    def data(self) -> tuple[int, ...]:
        """Rows of the data states."""
        return tuple(i for i, label in enumerate(self.x_labels) if label.data)

    @property
    def states(self) -> ca.SX:
        """What parts and outputs read: the states of the full scene."""
        return self.expansion.states if self.expansion else self.x

    @cached_property
    def measured(self) -> ca.SX:
        """What outputs read: `states` with the velocities of algebraic coordinates.

        They follow from 0 = d alg/dt, with the rates of Inputs counted as zero.
        """
        if self.expansion is None or not self.expansion.followers:
            return self.states
        states, rates = list(ca.vertsplit(self.states)), self._rates_of_z
        for motion in self.expansion.followers:
            coordinates = pick(self.states, motion.coordinates)
            basis = motion.basis(coordinates)
            moved = ca.jtimes(coordinates, self.z, rates)
            velocities = ca.solve(basis.T @ basis, basis.T @ moved)
            for row, value in zip(motion.velocities, ca.vertsplit(velocities), strict=True):
                states[row] = value
        return ca.cse(ca.vertcat(*states))

    @property
    def _rates_of_z(self) -> ca.SX:
        push = ca.jacobian(self.alg, self.x) @ self.ode + ca.jacobian(self.alg, self.t)
        return -ca.solve(ca.jacobian(self.alg, self.z), push)

    @property
    def symbols(self) -> list[ca.SX]:
        """[t, x, z, u, p]: the arguments of every function of the model."""
        return [self.t, self.x, self.z, self.u, self.p]

    @property
    def ode(self) -> ca.SX:
        """Rates of the states, flat (n_x, 1)."""
        return self._rows[0]

    @property
    def alg(self) -> ca.SX:
        """Algebraic residuals, flat (n_z, 1)."""
        return self._rows[1]

    @cached_property
    def out(self) -> ca.SX:
        """The requested outputs, stacked."""
        return ca.cse(ca.vertcat(ca.SX(0, 1), *(self.output(name) for name in self.requested)))

    @property
    def aliases(self) -> Mapping[str, str]:
        """More names of outputs, each with the name that the output has."""
        return self.outputs.aliases if isinstance(self.outputs, Outputs) else {}

    @property
    def out_labels(self) -> tuple[Label, ...]:
        """A label for each row of `out`."""
        return tuple(label for name in self.requested for label in self.outputs[name].labels)

    def output(self, name: str) -> ca.SX:
        """Column of one output quantity, by name, over the symbols and `idle_p`.

        Raises:
            ValueError: no such output, or one that needs states that were left out.
        """
        self._check_output(name)
        out = self.outputs[name]
        kernel, constants = out.build()
        unknown = self.expansion.unknown if self.expansion else frozenset()
        lost = {row: ca.SX.sym("lost") for row in out.reads if row in unknown}
        states = list(ca.vertsplit(self.measured)) if lost else []
        for row, symbol in lost.items():
            states[row] = symbol
        x = pick(ca.vertcat(*states) if lost else self.measured, out.reads)
        value = kernel(self.t, x, pick(self.z, out.reads_z), constants)
        if lost and ca.depends_on(value, ca.vertcat(*lost.values())):
            raise ValueError(
                f"model '{self.name}': output '{name}' needs states that no requested output feels "
                f"and that were left out; add it to Scene(outputs=[...])"
            )
        return value

    def _check_output(self, name: str) -> None:
        if name not in self.outputs:
            there = near(name, self.outputs)
            raise ValueError(f"model '{self.name}': no output '{name}'; there are: {there}")

    @cached_property
    def parameters(self) -> Parameters:
        """The parameters of the scene, and which of them are in use."""
        return Parameters(self.p_labels, self.idle_p_labels, ca.vertcat(self.p, self.idle_p))

    def start_values(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start values of x and z for the given parameter values."""
        x0, z0 = (np.array(value).reshape(-1) for value in self._start(p))
        return x0, z0

    @cached_property
    def _start(self) -> ca.Function:
        return ca.Function("start", [self.p], [self.x_start, self.z_start])

    def consistent(
        self, t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, bool]:
        """The z that solves alg = 0, by Newton's method from the given z, and whether it does."""
        residual, jacobian = self._balance
        return newton(
            lambda z: np.array(residual(t, x, z, u, p)).reshape(-1),
            lambda z: np.array(ca.DM(jacobian(t, x, z, u, p))),
            np.array(z, float),
        )

    @cached_property
    def _balance(self) -> tuple[ca.Function, ca.Function]:
        """Alg and its derivative by z as Functions."""
        return (
            ca.Function("alg", self.symbols, [self.alg]),
            ca.Function("dalg_dz", self.symbols, [ca.jacobian(self.alg, self.z)]),
        )

    def verify(self) -> None:
        """Check sizes, labels and rows.

        Raises:
            ValueError: what is inconsistent, and where.
        """
        for kind in "xzup":
            labels, column = getattr(self, f"{kind}_labels"), getattr(self, kind)
            names = [label.name for label in labels]
            if len(names) != column.numel() or len(set(names)) != len(names):
                raise ValueError(
                    f"model '{self.name}': {column.numel()} entries of {kind} need as many "
                    f"different names; got {names}"
                )
        for part in self.parts:
            self._verify_part(part)
        for name in self.requested:
            self._check_output(name)

    def verify_symbols(self) -> None:
        """Check that nothing but t, x, z, u, p is in the flat expressions.

        Raises:
            ValueError: the symbols that are.
        """
        known = ca.vertcat(self.t, self.x, self.z, self.u, self.p)
        free = ca.Function("verify", [known], [self.ode, self.alg], {"allow_free": True}).free_sx()
        if free:
            raise ValueError(f"model '{self.name}': symbols {free} are no t, x, z, u, p of it")

    def _verify_part(self, part: Part) -> None:
        n_ode, n_alg = part.kernel.size1_out(0), part.kernel.size1_out(1)
        if n_ode != len(part.ode_rows) or n_alg != len(part.alg_rows):
            raise ValueError(
                f"model '{self.name}', part '{part.name}': kernel gives {n_ode} + {n_alg} rows, "
                f"indices name {len(part.ode_rows)} + {len(part.alg_rows)}"
            )
        if max(part.ode_rows, default=0) >= max(1, self.states.numel()):
            raise ValueError(f"model '{self.name}', part '{part.name}': row outside the states")

    def __str__(self) -> str:
        lines = [
            f"{self.name}: {self.x.numel()} states, {self.z.numel()} algebraic, "
            f"{self.u.numel()} inputs, {self.p.numel()} parameters"
        ]
        for title, kind in (
            ("states", "x"),
            ("algebraic", "z"),
            ("inputs", "u"),
            ("parameters", "p"),
        ):
            lines += table(title, getattr(self, f"{kind}_labels"))
        return "\n".join(lines + [f"note: {note}" for note in self.notes])


def table(title: str, labels: tuple[Label, ...]) -> list[str]:
    """Lines of a table of labels: index, name, start value with unit."""
    if not labels:
        return []
    width = max(len(label.name) for label in labels)
    rows = [
        f"  {i:4d}  {label.name:<{width}}  {label.start:.6g} {label.unit}".rstrip()
        + (" (data)" if label.data else "")
        for i, label in enumerate(labels)
    ]
    return [f"{title}:", *rows]
