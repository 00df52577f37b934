"""Members of a `Dae`: labels, parts, outputs, events, and what its coordinates mean.

A kernel is a CasADi Function (t, x, z, c) -> results, over the states and unknowns that an instance
reads and its column c of constants. All instances of a kind share it, which keeps expressions and
generated C small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
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
    """Name, unit and start (or default) value of one entry of x, z, u, p or y.

    Fields:
        owner: body, connector or other element that it belongs to; "" if it belongs to the whole
            scene.
        quantity: such as "p", "q" or "force_local"; for an Input or Param its name.
        component: such as "x"; "" for a scalar.
        unit: SI unit; "" without one.
        start: start value of a state or unknown, default value of an input or parameter.
        data: whether it is a data state: its rate is zero, and only events and updates change it.

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
        """The parts joined for people; nothing is ever read back from it."""
        return joined(self.owner, self.quantity, self.component)


@dataclass(frozen=True)
class Instance:
    """One use of a shared kernel: kernel(t, x[reads], z[reads_z], constants).

    Arguments:
        name: element that it belongs to, for messages.
        kernel: Function (t, x, z, c) -> results.
        reads: rows of the states of the full scene.
        reads_z: rows of z.
        constants: column c over t, u and p; plain numbers fold into the code.
    """

    name: str
    kernel: ca.Function
    reads: tuple[int, ...]
    reads_z: tuple[int, ...]
    constants: ca.SX


@dataclass(frozen=True)
class Part(Instance):
    """A contribution to rates and equations: a body, a load or a connector.

    Arguments:
        kernel: returns what is added to `ode_rows`, and what is added to `alg_rows`.
        ode_rows: rows of the states of the full scene.
        alg_rows: rows of alg.
    """

    ode_rows: tuple[int, ...]
    alg_rows: tuple[int, ...] = ()

    @cached_property
    def numbers(self) -> np.ndarray:
        """The constants as floats (n,), NaN where they are symbolic."""
        return numbers_of(self.constants)

    @cached_property
    def signature(self) -> tuple[bytes, str]:
        """A hashable value; parts have equal constants exactly if it is equal."""
        # NaNs have equal bytes, so that the numbers compare as bytes; symbolic entries compare by
        # their algorithm.
        symbolic = np.flatnonzero(np.isnan(self.numbers)).tolist()
        return self.numbers.tobytes(), identity(pick(self.constants, symbolic))


def pick(column: ca.SX, index: Sequence[int]) -> ca.SX:
    """Return the given entries of a column as a column; (0, 1) if there are none."""
    return column[list(index)] if index else ca.SX(0, 1)


def numbers_of(column: ca.SX) -> np.ndarray:
    """Return the entries of a column as floats (n,), NaN where they are symbolic."""
    # The common case, and much faster than entry by entry.
    if column.is_constant():
        return np.array(ca.DM(column)).reshape(-1)
    entries = ca.vertsplit(column) if column.numel() else []
    return np.array([float(v) if v.is_constant() else np.nan for v in entries])


@dataclass(frozen=True)
class Output:
    """A named quantity: value = kernel(t, x[reads], z[reads_z], constants), built on demand.

    Arguments:
        owner, quantity, unit, components: see `Label`; one component per entry of the value.
        shape: shape of the value at one time; () for a scalar.
        build: function that returns the kernel, which all instances of a kind share, and the
            constants.
        reads, reads_z: rows of the states of the full scene, and of z.
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
        """Such as "joint.force_local"; without an owner just the quantity, such as "energy"."""
        return joined(self.owner, self.quantity)

    @property
    def labels(self) -> tuple[Label, ...]:
        """A label for each component."""
        return tuple(Label(self.owner, self.quantity, c, self.unit) for c in self.components)


class RotationKind(Enum):
    """How coordinates describe a rotation R_WB; w is the angular velocity in B."""

    quaternion = "unit quaternion (w, x, y, z), scalar first; q' = q (0, w) / 2"
    tait_bryan = "Tait-Bryan angles x, y, z; R = Rx Ry Rz"


@dataclass(frozen=True, eq=False)
class Outputs(Mapping[str, Output]):
    """Outputs by name, found under additional names as well.

    Iteration and length count every output once, under its own name.

    Arguments:
        named: outputs by their names.
        aliases: further names, each with the name of the output it means.
    """

    named: Mapping[str, Output]
    aliases: Mapping[str, str]

    def __getitem__(self, name: str) -> Output:
        return self.named[self.aliases.get(name, name)]

    def __iter__(self) -> Iterator[str]:
        return iter(self.named)

    def __len__(self) -> int:
        return len(self.named)


@dataclass(frozen=True)
class Rotation:
    """States that describe a rotation, for integrators and exports that treat rotations as such.

    Arguments:
        owner: the body.
        kind: what the coordinates are.
        coordinates, velocity: rows of the states of the full scene; the angular velocity is in axes
            that turn with the body.
    """

    owner: str
    kind: RotationKind
    coordinates: tuple[int, ...]
    velocity: tuple[int, ...]


@dataclass(frozen=True)
class Kinematics:
    """Coordinates, and how velocities move them; what Lie-group integrators and projections need.

    Arguments:
        owner, quantity: what moves, such as "arm" and "rotation".
        coordinates, velocities: rows of the states of the full scene.
        retract: Function (coordinates, step) -> coordinates moved by a tangent step, which to first
            order is time times velocity: p + step for a position, R exp(step) for a rotation.
    """

    owner: str
    quantity: str
    coordinates: tuple[int, ...]
    velocities: tuple[int, ...]
    retract: ca.Function


@dataclass(frozen=True)
class Transition(Instance):
    """An event: a zero function, and the change of states when it falls through zero.

    Arguments:
        kernel: Function (t, x, z, c) -> (zero function (1), change of the states in `rows`).
        rows: states of the full scene that change.
        at_once: whether it also fires where the start or another event leaves the function below
            zero; otherwise the function must have been above zero before.
        stops: whether it ends the integration.
    """

    rows: tuple[int, ...]
    at_once: bool = False
    stops: bool = False


@dataclass(frozen=True)
class Hold(Instance):
    """A row of alg that keeps a quantity constant: alg[alg_row] += weight d(value)/dt.

    Arguments:
        kernel: Function (t, x, z, c) -> (value, weight). The value depends on t and x only; Inputs
            count as constant.
        alg_row: the row of alg.
    """

    alg_row: int


@dataclass(frozen=True)
class Update(Instance):
    """A function that is called after every accepted step and may change data states.

    Arguments:
        kernel: Function (t, x, z, c) -> (error, recommended step in s, new data).
        rows: the data states, rows of the states of the full scene.
    """

    rows: tuple[int, ...]


@dataclass(frozen=True)
class Balance:
    """A motion without inertia: its rows of ode hold a force or torque, which must vanish.

    Arguments:
        name: such as "arm.x" or "arm.rotation", for messages.
        coordinates, velocities: rows of the motion; coordinates' = kinematics(coordinates,
            velocities).
        idle: those rows of the velocities that have no inertia.
        kinematics: Function (coordinates, velocities) -> rates, linear in the velocities.
    """

    name: str
    coordinates: tuple[int, ...]
    velocities: tuple[int, ...]
    idle: tuple[int, ...]
    kinematics: ca.Function

    def basis(self, coordinates: ca.SX) -> ca.SX:
        """Return the rates of the coordinates for unit velocities, one column per velocity."""
        # The kinematics is linear in the velocities: its matrix has one column per unit velocity.
        units = ca.horzsplit(ca.SX.eye(len(self.velocities)))
        return ca.horzcat(*(self.kinematics(coordinates, unit) for unit in units))

    def away(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return symbols of coordinates and start, and their difference along each velocity."""
        c, start = (ca.SX.sym(name, len(self.coordinates)) for name in ("c", "start"))
        return c, start, self.basis(c).T @ (c - start)


class Parameters(NamedTuple):
    """The parameters of a scene: those in use, then those without effect on x, z and y.

    Fields:
        used, idle: their labels; idle ones may act on outputs that were not requested.
        symbols: SX column of both.
    """

    used: tuple[Label, ...]
    idle: tuple[Label, ...]
    symbols: ca.SX

    @property
    def labels(self) -> tuple[Label, ...]:
        """Labels of both, in the order of `symbols`."""
        return (*self.used, *self.idle)
