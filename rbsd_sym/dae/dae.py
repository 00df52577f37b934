"""The waist of the package: a semi-explicit DAE x' = ode(t, x, z, u, p), 0 = alg, y = out.

Formulations write a `Dae`, passes reduce it, models and exports read it: nothing above it knows
what C is, nothing below it what a body is. A `Dae` keeps its parts; each is one kernel (a CasADi
Function shared by all instances of a kind) with the states it reads and the rows it adds to. The
flat expressions result from calling the parts.
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
    """How the states of the full scene follow from those of a reduced model.

    Parts, outputs and events still read the full states; a pass changes only this map.

    Arguments:
        states: each full state (n_full, 1) as an expression of x, z and p, as the parts read it.
        labels: their names, units and start values.
        rows: for each full state its row in x and ode; None if it is not a state.
        alg_rows: for each full state without inertia its row in alg; None for the others.
        followers: motions whose coordinates are algebraic unknowns. No part reads their velocities
            (`states` holds 0), which follow from the rates of the coordinates (`Dae.measured`).
        unknown: full states that move but were left out because no requested output depends on
            them; the model does not determine their values.
    """

    states: ca.SX
    labels: tuple[Label, ...]
    rows: tuple[int | None, ...]
    alg_rows: tuple[int | None, ...]
    followers: tuple[Balance, ...] = ()
    unknown: frozenset[int] = frozenset()


@dataclass(frozen=True)
class Dae:
    """A model as symbols, parts, names, units and start values; an immutable value.

    Every pass takes a `Dae` and returns another; `verify` checks one.

        dae = rs.compile_scene(scene).dae
        ca.jacobian(dae.ode, dae.x)

    Arguments:
        name: name of the model, a C identifier.
        t, x, z, u, p: SX columns: time (s), differential states, algebraic unknowns, inputs,
            parameters.
        x_labels, z_labels, u_labels, p_labels: a `Label` for each entry.
        x_start, z_start: start values, SX columns over p.
        parts: what adds to ode and alg.
        outputs: every quantity that can be asked for, by name; built on demand.
        requested: names of the outputs in y, in order.
        only_requested: whether no other output matters, so that states without effect on these may
            be left out.
        idle_p, idle_p_labels: parameters without effect on x, z and y; they may act on other
            outputs.
        notes: what the user should know: findings about the scene, what was left out.
        rotations: which states are rotations, and of what kind.
        balances: motions without inertia, until a pass has made them algebraic.
        motions: coordinates of the full scene, their velocities, and how a step moves them.
        events: what happens where a function falls through zero, in the order in which simultaneous
            events take place.
        holds: rows of alg that keep a quantity constant, in addition to what the parts add to them.
        updates: functions that may change data states after every accepted step.
        expansion: in a reduced model, how the full states that parts and outputs read follow from
            x.
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
        """Return the flat ode and alg: the sums of what all parts and holds add to them."""
        ode, alg = [ca.SX(0)] * self.x.numel(), [ca.SX(0)] * self.z.numel()
        expansion = self.expansion
        for part in self.parts:
            d_ode, d_alg = self._called(part)
            for i, row in enumerate(part.ode_rows):
                # A row without inertia is an equation: its force goes to alg, not to a rate.
                j, k = (expansion.rows[row], expansion.alg_rows[row]) if expansion else (row, None)
                if j is not None:
                    ode[j] = ode[j] + d_ode[i]
                if k is not None:
                    alg[k] = alg[k] + d_ode[i]
            for i, row in enumerate(part.alg_rows):
                alg[row] = alg[row] + d_alg[i]
        for hold in self.holds:
            # The derivative along ode contains the unknown force itself, which makes the row
            # solvable.
            alg[hold.alg_row] += self._held(hold, ca.vertcat(ca.SX(0, 1), *ode))
        # Connectors on one body repeat its kinematics; one pass over all rows removes the
        # repetitions.
        rows = ca.cse(ca.vertcat(ca.SX(0, 1), *ode, *alg))
        n = len(ode)
        return pick(rows, range(n)), pick(rows, range(n, rows.numel()))

    def _called(self, item: Any) -> list[ca.SX]:
        """Return the results of the kernel of a part, event, hold or update, flat."""
        reads = pick(self.states, item.reads)
        results = item.kernel(self.t, reads, pick(self.z, item.reads_z), item.constants)
        # States that never move are numbers here. CasADi then folds products with 0 by itself, but
        # not what needs a sign, such as atan2(0, sqrt(y)).
        if self.expansion and not reads.is_valid_input():
            # Rows that were left out may still hold parameters without effect.
            everything = ca.vertcat(*self.symbols, self.idle_p)
            return [fold(result, everything) for result in results]
        return list(results)

    def _held(self, hold: Hold, ode: ca.SX) -> ca.SX:
        """Return weight d(value)/dt of a hold, the time derivative taken along ode."""
        value, weight = self._called(hold)
        return weight * (ca.jtimes(value, self.x, ode) + ca.jacobian(value, self.t))

    def held(self, hold: Hold) -> ca.SX:
        """Return what a hold adds to its row of alg, as a flat expression (1, 1)."""
        return self._held(hold, self.ode)

    @cached_property
    def zero(self) -> ca.SX:
        """Zero functions of the events, flat (n_events, 1); events fire as these fall below 0."""
        return ca.vertcat(ca.SX(0, 1), *(self._fired[i][0] for i in range(len(self.events))))

    @cached_property
    def jump(self) -> ca.SX:
        """Change of x by each event, sparse (n_x, n_events), one column per event."""
        return ca.horzcat(ca.SX(self.x.numel(), 0), *(change for _, change in self._fired))

    @cached_property
    def _fired(self) -> list[tuple[ca.SX, ca.SX]]:
        """Zero function, and change of x as a sparse column, of each event."""
        found, expansion = [], self.expansion
        for event in self.events:
            zero, changes = self._called(event)
            # Sparse: an event changes few states, and states that never move have no row.
            column = ca.SX(self.x.numel(), 1)
            for row, change in zip(event.rows, ca.vertsplit(changes), strict=True):
                place = expansion.rows[row] if expansion else row
                if place is not None and not change.is_zero():
                    column[place] = change
            found.append((zero, column))
        return found

    @cached_property
    def update(self) -> ca.SX:
        """Results of all updates, flat (2 + n_x, 1).

        It holds the largest error, the smallest recommended step in s (-1 if none is recommended),
        and the states with their new data.
        """
        error, step, x = ca.SX(0), ca.SX(-1), list(ca.vertsplit(self.x))
        for update in self.updates:
            own_error, own_step, data = self._called(update)
            error = ca.fmax(error, own_error)
            # A negative step means that nothing is recommended; otherwise the smallest counts.
            both = ca.if_else(step < 0, own_step, ca.fmin(step, own_step))
            step = ca.if_else(own_step < 0, step, both)
            for i, row in enumerate(update.rows):
                place = self.expansion.rows[row] if self.expansion else row
                if place is not None:
                    x[place] = data[i]
        return ca.cse(ca.vertcat(error, step, *x))

    @property
    def data(self) -> tuple[int, ...]:
        """Rows of x that are data states: constant but for events and updates."""
        return tuple(i for i, label in enumerate(self.x_labels) if label.data)

    @property
    def states(self) -> ca.SX:
        """States of the full scene (n_full, 1), which parts and events read."""
        return self.expansion.states if self.expansion else self.x

    @cached_property
    def measured(self) -> ca.SX:
        """States that outputs read: `states`, completed by velocities of algebraic coordinates.

        For coordinates c(z) of a motion without inertia, 0 = d alg/dt gives z', and the velocities
        v are the solution of basis(c) v = (dc/dz) z'. The rates of Inputs count as zero.
        """
        if self.expansion is None or not self.expansion.followers:
            return self.states
        states, rates = list(ca.vertsplit(self.states)), self._rates_of_z
        for motion in self.expansion.followers:
            coordinates = pick(self.states, motion.coordinates)
            basis = motion.basis(coordinates)
            moved = ca.jtimes(coordinates, self.z, rates)
            # Least squares, since a quaternion has four coordinates for three velocities; the
            # equations are consistent, so the residual is zero.
            velocities = ca.solve(basis.T @ basis, basis.T @ moved)
            for row, value in zip(motion.velocities, ca.vertsplit(velocities), strict=True):
                states[row] = value
        return ca.cse(ca.vertcat(*states))

    @property
    def _rates_of_z(self) -> ca.SX:
        """Return z' = -(d alg/dz)^-1 (d alg/dx ode + d alg/dt), flat."""
        # 0 = d alg/dt = (d alg/dz) z' + push.
        push = ca.jacobian(self.alg, self.x) @ self.ode + ca.jacobian(self.alg, self.t)
        return -ca.solve(ca.jacobian(self.alg, self.z), push)

    @property
    def symbols(self) -> list[ca.SX]:
        """[t, x, z, u, p]: the arguments of every function of the model."""
        return [self.t, self.x, self.z, self.u, self.p]

    @property
    def ode(self) -> ca.SX:
        """Rates of the states, a flat expression (n_x, 1)."""
        return self._rows[0]

    @property
    def alg(self) -> ca.SX:
        """Residuals of the algebraic equations, a flat expression (n_z, 1)."""
        return self._rows[1]

    @cached_property
    def out(self) -> ca.SX:
        """The requested outputs, stacked into one flat column (n_y, 1)."""
        return ca.cse(ca.vertcat(ca.SX(0, 1), *(self.output(name) for name in self.requested)))

    @property
    def aliases(self) -> Mapping[str, str]:
        """Additional names of outputs, each with the name of the output it means."""
        return self.outputs.aliases if isinstance(self.outputs, Outputs) else {}

    @property
    def out_labels(self) -> tuple[Label, ...]:
        """A label for each row of `out`."""
        return tuple(label for name in self.requested for label in self.outputs[name].labels)

    def output(self, name: str) -> ca.SX:
        """Return one output quantity as a flat column over the symbols and `idle_p`.

            dae.output("joint.force_local")

        Arguments:
            name: name of the quantity, such as "arm.position" or "energy".

        Raises:
            ValueError: there is no such output, or it needs states that were left out.
        """
        self._check_output(name)
        out = self.outputs[name]
        kernel, constants = out.build()
        unknown = self.expansion.unknown if self.expansion else frozenset()
        # A state that was left out becomes a symbol of its own: whether the output really depends
        # on it shows in the result.
        lost = {row: ca.SX.sym("lost") for row in out.reads if row in unknown}
        states = list(ca.vertsplit(self.measured)) if lost else []
        for row, symbol in lost.items():
            states[row] = symbol
        x = pick(ca.vertcat(*states) if lost else self.measured, out.reads)
        value = kernel(self.t, x, pick(self.z, out.reads_z), constants)
        if lost and ca.depends_on(value, ca.vertcat(*lost.values())):
            raise ValueError(
                f"model '{self.name}': output '{name}' needs states that were left out, because no "
                "requested output depends on them; add it to Scene(outputs=[...])"
            )
        return value

    def _check_output(self, name: str) -> None:
        if name not in self.outputs:
            there = near(name, self.outputs)
            raise ValueError(f"model '{self.name}': no output '{name}'; there are: {there}")

    @cached_property
    def parameters(self) -> Parameters:
        """All parameters of the scene, and which of them are in use."""
        return Parameters(self.p_labels, self.idle_p_labels, ca.vertcat(self.p, self.idle_p))

    def start_values(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the start values of x (n_x,) and z (n_z,) for parameter values p (n_p,).

        Those of z are guesses for `consistent`.
        """
        x0, z0 = (np.array(value).reshape(-1) for value in self._start(p))
        return x0, z0

    @cached_property
    def _start(self) -> ca.Function:
        return ca.Function("start", [self.p], [self.x_start, self.z_start])

    def consistent(
        self, t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, bool]:
        """Solve alg = 0 for z by Newton's method from the given z.

        Arguments:
            t: time, s.
            x, z, u, p: numbers, (n_x,), (n_z,), (n_u,), (n_p,).

        Returns:
            z (n_z,), and whether it is a solution.
        """
        residual, jacobian = self._balance
        return newton(
            lambda z: np.array(residual(t, x, z, u, p)).reshape(-1),
            lambda z: np.array(ca.DM(jacobian(t, x, z, u, p))),
            np.array(z, float),
        )

    @cached_property
    def _balance(self) -> tuple[ca.Function, ca.Function]:
        """Return alg and its Jacobian by z as Functions of t, x, z, u, p."""
        return (
            ca.Function("alg", self.symbols, [self.alg]),
            ca.Function("dalg_dz", self.symbols, [ca.jacobian(self.alg, self.z)]),
        )

    def verify(self) -> None:
        """Check that sizes, labels and rows agree; cheap enough to run after every pass.

        Raises:
            ValueError: what is inconsistent, and where.
        """
        for kind in "xzup":
            labels, column = getattr(self, f"{kind}_labels"), getattr(self, kind)
            names = [label.name for label in labels]
            if len(names) != column.numel() or len(set(names)) != len(names):
                raise ValueError(
                    f"model '{self.name}': {column.numel()} entries of {kind} need as many "
                    f"different names; correct {names}"
                )
        for part in self.parts:
            self._verify_part(part)
        for name in self.requested:
            self._check_output(name)

    def verify_symbols(self) -> None:
        """Check that the flat expressions contain no symbols but t, x, z, u and p.

        Raises:
            ValueError: which other symbols they contain.
        """
        known = ca.vertcat(self.t, self.x, self.z, self.u, self.p)
        free = ca.Function("verify", [known], [self.ode, self.alg], {"allow_free": True}).free_sx()
        if free:
            raise ValueError(
                f"model '{self.name}': expressions contain the symbols {free}; only t, x, z, u and "
                "p of the model are allowed; make them Params or Inputs"
            )

    def _verify_part(self, part: Part) -> None:
        n_ode, n_alg = part.kernel.size1_out(0), part.kernel.size1_out(1)
        if n_ode != len(part.ode_rows) or n_alg != len(part.alg_rows):
            raise ValueError(
                f"model '{self.name}', part '{part.name}': the kernel returns {n_ode} + {n_alg} "
                f"rows; ode_rows and alg_rows have {len(part.ode_rows)} + {len(part.alg_rows)}; "
                "make them agree"
            )
        if max(part.ode_rows, default=0) >= max(1, self.states.numel()):
            raise ValueError(
                f"model '{self.name}', part '{part.name}': ode_rows has row {max(part.ode_rows)}; "
                f"the scene has {self.states.numel()} states; correct the rows"
            )

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
    """Return a table of labels as lines: index, name, start value with unit, a mark for data.

    Without labels there are no lines, not even the title.
    """
    if not labels:
        return []
    width = max(len(label.name) for label in labels)
    rows = [
        f"  {i:4d}  {label.name:<{width}}  {label.start:.6g} {label.unit}".rstrip()
        + (" (data)" if label.data else "")
        for i, label in enumerate(labels)
    ]
    return [f"{title}:", *rows]
