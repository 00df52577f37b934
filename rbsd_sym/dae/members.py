"""What a `Dae` is made of: labels, parts, outputs, events, and what its motions mean.

Each part is one kernel with the states it reads and the rows it adds to. Kernels are shared by all
instances of a kind: Function (t, x, z, c) -> results, over the states and unknowns that an instance
reads and its column of constants c.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from ..base.names import joined
from ..base.program import identity


@dataclass(frozen=True)
class Label:
    """What one entry of x, z, u, p or y is, with its unit and start (or default) value.

    Fields:
        owner: the body, connector, ... that it belongs to; "" for what belongs to the whole scene.
        quantity: such as "p", "q" or "force_local"; of an Input or Param its name.
        component: such as "x"; "" for a scalar.
        data: whether it is a state without rate, which only events and updates change.

    >>> Label("arm", "p", "x", "m").name
    'arm.p_x'
    """

    owner: str
    quantity: str
    component: str = ""
    unit: str = ""
    start: float = 0.0
    data: bool = False

    @cached_property
    def name(self) -> str:
        """The label in one word, for people; nothing is read back from it."""
        return joined(self.owner, self.quantity, self.component)


@dataclass(frozen=True)
class Instance:
    """One instance of a kernel: kernel(t, x[reads], z[reads_z], constants).

    Arguments:
        kernel: Function (t, x, z, c) -> results, shared by all instances of a kind.
        constants: column over (t, u, p); plain numbers fold into the code.
    """

    name: str
    kernel: ca.Function
    reads: tuple[int, ...]
    reads_z: tuple[int, ...]
    constants: ca.SX


@dataclass(frozen=True)
class Part(Instance):
    """Adds to rates and equations.

    Arguments:
        kernel: gives (what is added to `ode_rows`, to `alg_rows`).
    """

    ode_rows: tuple[int, ...]
    alg_rows: tuple[int, ...] = ()

    @cached_property
    def numbers(self) -> np.ndarray:
        """The constants, NaN where they are symbolic."""
        return numbers_of(self.constants)

    @cached_property
    def signature(self) -> tuple[bytes, str]:
        """What equal constants have in common, to be compared."""
        symbolic = np.flatnonzero(np.isnan(self.numbers)).tolist()
        return self.numbers.tobytes(), identity(pick(self.constants, symbolic))


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

    owner: str
    quantity: str
    unit: str
    components: tuple[str, ...]
    shape: tuple[int, ...]
    build: Callable[[], tuple[ca.Function, ca.SX]]
    reads: tuple[int, ...]
    reads_z: tuple[int, ...] = ()

    @property
    def name(self) -> str:
        """Such as "joint.force_local"; of a quantity of the scene the bare quantity."""
        return joined(self.owner, self.quantity)

    @property
    def labels(self) -> tuple[Label, ...]:
        """A label for each component."""
        return tuple(Label(self.owner, self.quantity, c, self.unit) for c in self.components)


class RotationKind(Enum):
    """How coordinates describe a rotation R_WB, with their rates for w, the velocity in B."""

    quaternion = "unit quaternion (w, x, y, z), scalar first; q' = q (0, w) / 2"
    tait_bryan = "Tait-Bryan angles x, y, z; R = Rx Ry Rz"


@dataclass(frozen=True)
class Rotation:
    """Rows of the states that are a rotation, and of its angular velocity (in axes that turn).

    In a reduced model they are rows of the states of the full scene, as `Kinematics` has them.
    """

    owner: str
    kind: RotationKind
    coordinates: tuple[int, ...]
    velocity: tuple[int, ...]


@dataclass(frozen=True)
class Kinematics:
    """Coordinates and the velocities that move them: what Lie-group integrators need.

    Arguments:
        owner, quantity: what moves, such as "arm" and "rotation".
        coordinates, velocities: rows of the states.
        retract: Function (coordinates, step) -> coordinates moved by a tangent step, which is time
            times velocity to first order: p + step, or R exp(step) for a rotation.
    """

    owner: str
    quantity: str
    coordinates: tuple[int, ...]
    velocities: tuple[int, ...]
    retract: ca.Function


@dataclass(frozen=True)
class Transition(Instance):
    """A zero function, and what happens when it falls through zero.

    Arguments:
        kernel: Function (t, x, z, c) -> (zero (1), change of the states in `rows`).
        at_once: fires also where a start or another event leaves the function below zero; otherwise
            it must have been above.
        stops: ends the integration.
    """

    rows: tuple[int, ...]
    at_once: bool = False
    stops: bool = False


@dataclass(frozen=True)
class Hold(Instance):
    """A row of alg that holds a quantity where it is: alg[row] += weight d(value)/dt.

    Arguments:
        kernel: Function (t, x, z, c) -> (value, weight). The value depends on t and x only; Inputs
            count as constant.
    """

    alg_row: int


@dataclass(frozen=True)
class Update(Instance):
    """What is asked of data states after a step was solved.

    Arguments:
        kernel: Function (t, x, z, c) -> (error, recommended step (s), new data).
        rows: the data states.
    """

    rows: tuple[int, ...]


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


class Parameters(NamedTuple):
    """The parameters of a scene: those in use, then those without effect on x, z and y.

    Fields:
        used, idle: their labels; idle ones may act on outputs that were not requested.
        symbols: column of both.
    """

    used: tuple[Label, ...]
    idle: tuple[Label, ...]
    symbols: ca.SX

    @property
    def labels(self) -> tuple[Label, ...]:
        """Labels of both."""
        return (*self.used, *self.idle)
