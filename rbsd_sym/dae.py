"""The waist: a semi-explicit DAE  x' = ode(t, x, z, u, p),  0 = alg,  y = out.

Nothing below knows what a body is, nothing above knows what C is. A `Dae` keeps its parts: each is
one kernel with the states it reads and the rows it adds to. The flat expressions come from calling
the parts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca
import numpy as np

from .newton import newton
from .zeros import fold


@dataclass(frozen=True)
class Label:
    """Name, unit and start (or default) value of one entry of x, z, u, p or y."""

    name: str
    unit: str
    start: float = 0.0


@dataclass(frozen=True)
class Part:
    """One kernel instance: rows[i] += kernel(t, x[reads], z[reads_z], constants)[i].

    Arguments:
        kernel: Function (t, x, z, c) -> (ode rows, alg rows), shared by all instances of a kind.
        constants: column over (t, u, p); plain numbers fold into the code.
    """

    name: str
    kernel: ca.Function
    reads: tuple[int, ...]
    reads_z: tuple[int, ...]
    constants: ca.SX
    ode_rows: tuple[int, ...]
    alg_rows: tuple[int, ...] = ()

    @cached_property
    def numbers(self) -> np.ndarray:
        """The constants, NaN where they are symbolic."""
        return numbers_of(self.constants)

    @cached_property
    def signature(self) -> tuple[bytes, tuple[str, ...]]:
        """What equal constants have in common, to be compared."""
        symbolic = np.flatnonzero(np.isnan(self.numbers))
        return self.numbers.tobytes(), tuple(str(self.constants[int(i)]) for i in symbolic)


def pick(column: ca.SX, index: Sequence[int]) -> ca.SX:
    """Entries of a column as a column, also none of them."""
    return column[list(index)] if index else ca.SX(0, 1)


def numbers_of(column: ca.SX) -> np.ndarray:
    """Entries of a column as numbers, NaN where they are symbolic."""
    if column.is_constant():
        return np.array(ca.DM(column)).reshape(-1)
    entries = ca.vertsplit(column) if column.numel() else []
    return np.array([float(v) if v.is_constant() else np.nan for v in entries])


@dataclass(frozen=True)
class Output:
    """A named quantity: value = kernel(t, x[reads], z[reads_z], constants), built on demand.

    `build` gives the kernel, which all instances of a kind share, and the constants.
    """

    name: str
    unit: str
    components: tuple[str, ...]
    shape: tuple[int, ...]
    build: Callable[[], tuple[ca.Function, ca.SX]]
    reads: tuple[int, ...]
    reads_z: tuple[int, ...] = ()

    @property
    def labels(self) -> tuple[Label, ...]:
        """A label for each component: `arm.position_x`, or the bare name of a scalar."""
        if self.components == ("",):
            return (Label(self.name, self.unit),)
        return tuple(Label(f"{self.name}_{part}", self.unit) for part in self.components)


@dataclass(frozen=True)
class Turn:
    """Where a rotation lives: rows of a quaternion (w, x, y, z) and of its angular velocity.

    The angular velocity is in axes that turn along: q' = q (0, w) / 2.
    """

    name: str
    quaternion: tuple[int, int, int, int]
    velocity: tuple[int, int, int]


@dataclass(frozen=True)
class Balance:
    """A motion without inertia: its rows of `ode` hold a force or torque, which must vanish.

    Arguments:
        coordinates, velocities: rows of the motion; coordinates' = kinematics(both).
        idle: those of the velocities that have no inertia.
        kinematics: Function (coordinates, velocities) -> rates, linear in the velocities.
    """

    name: str
    coordinates: tuple[int, ...]
    velocities: tuple[int, ...]
    idle: tuple[int, ...]
    kinematics: ca.Function

    def basis(self, coordinates: ca.SX) -> ca.SX:
        """Rates of the coordinates for unit velocities, a column each."""
        units = ca.horzsplit(ca.SX.eye(len(self.velocities)))
        return ca.horzcat(*(self.kinematics(coordinates, unit) for unit in units))

    def away(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Symbols of coordinates and start, and the way between along each velocity."""
        c, start = (ca.SX.sym(name, len(self.coordinates)) for name in ("c", "start"))
        return c, start, self.basis(c).T @ (c - start)


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
        turns: the quaternions among the states, so that passes know them without knowing bodies.
        balances: the motions without inertia, until a pass has made them algebraic.
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
    turns: tuple[Turn, ...] = ()
    balances: tuple[Balance, ...] = ()
    expansion: Expansion | None = None
    only_requested: bool = False
    idle_p: ca.SX = field(default_factory=lambda: ca.SX(0, 1))
    idle_p_labels: tuple[Label, ...] = ()
    source: str = field(default="", repr=False)

    @cached_property
    def _rows(self) -> tuple[ca.SX, ca.SX]:
        ode, alg = [ca.SX(0)] * self.x.numel(), [ca.SX(0)] * self.z.numel()
        way = self.expansion
        for part in self.parts:
            reads = pick(self.states, part.reads)
            d_ode, d_alg = self.contribution(part, reads)
            if way and not reads.is_valid_input():  # some reads never move
                d_ode = fold(d_ode, ca.vertcat(*self.symbols))
            for i, row in enumerate(part.ode_rows):
                j, k = (way.rows[row], way.alg_rows[row]) if way else (row, None)
                if j is not None:
                    ode[j] = ode[j] + d_ode[i]
                if k is not None:
                    alg[k] = alg[k] + d_ode[i]
            for i, row in enumerate(part.alg_rows):
                alg[row] = alg[row] + d_alg[i]
        rows = ca.cse(ca.vertcat(ca.SX(0, 1), *ode, *alg))
        n = len(ode)
        return pick(rows, range(n)), pick(rows, range(n, rows.numel()))

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

    def contribution(self, part: Part, states: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rows that a part adds to ode and alg for given values of the states it reads."""
        return part.kernel(self.t, states, pick(self.z, part.reads_z), part.constants)

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
        if name in self.outputs:
            return
        owner = name.split(".")[0]
        close = [key for key in self.outputs if key.split(".")[0] == owner]
        there = ", ".join(close or sorted({k.split(".")[0] for k in self.outputs}))
        raise ValueError(f"model '{self.name}': no output '{name}'; there are: {there}")

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
        for i, label in enumerate(labels)
    ]
    return [f"{title}:", *rows]
