"""Layout of the states of a scene: which rows belong to which body, and what they mean."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import casadi as ca
import numpy as np

from ..base.rotation import quat_exp, quat_matrix, quat_product
from ..base.symbols import TIME, to_expr
from ..dae.members import Balance, Kinematics, Label, Rotation, RotationKind
from ..mechanics.motion import Body, body_motion
from ..scene.elements import GROUND, Marker, RigidBody
from ..scene.scene import Scene
from .pack import axes_without_inertia, has_mass, rotation_pair


class Coordinates(Protocol):
    """Rotation coordinates of a body: the part that formulations choose differently.

    Rotations are given twice, as matrix and as quaternion, so that each choice uses the cheaper
    form.
    """

    @property
    def labels(self) -> tuple[tuple[str, str, str], ...]:
        """Quantity, component and unit of each coordinate, such as ("q", "w", "")."""
        ...

    @property
    def kind(self) -> RotationKind:
        """What kind of rotation coordinates these are."""
        ...

    def start(self, R_WB: ca.SX, q_WB: ca.SX) -> ca.SX:
        """Return the coordinates of a rotation, given as matrix (3, 3) and quaternion (4, 1)."""
        ...

    def orientation(self, r: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return rotation matrix (3, 3) and quaternion (4, 1) of the coordinates."""
        ...

    def rate(self, r: ca.SX, w_WB_B: ca.SX) -> ca.SX:
        """Return the rates of the coordinates for an angular velocity in body axes, rad/s."""
        ...


# One translation: its rate is its velocity, and a step is added. All bodies share these.
_VELOCITY = ca.SX.sym("v")
_TRANSLATION_RATE = ca.Function("kinematics", [ca.SX.sym("c"), _VELOCITY], [_VELOCITY])
_C, _STEP = ca.SX.sym("c"), ca.SX.sym("step")
_TRANSLATION_RETRACT = ca.Function("retract", [_C, _STEP], [_C + _STEP])


@dataclass(frozen=True, eq=False)
class Layout:
    """Rows of the states of a scene.

    Body after body: position (3), rotation coordinates, velocity (3), angular velocity (3); then
    the own states of each connector. The unknown forces of connectors are rows of z.

    Arguments:
        scene: the scene.
        coordinates: rotation coordinates of its bodies.
    """

    scene: Scene
    coordinates: Coordinates

    @property
    def size(self) -> int:
        """Number of states of one body."""
        return 9 + len(self.coordinates.labels)

    @cached_property
    def _indices(self) -> dict[str, int]:
        return {body.name: i for i, body in enumerate(self.scene.bodies)}

    def index(self, name: str) -> int:
        """Return the index of a body in the scene."""
        return self._indices[name]

    def rows(self, index: int) -> tuple[int, ...]:
        """Return the rows of a body, in the order of its states."""
        return tuple(range(index * self.size, (index + 1) * self.size))

    def velocity_rows(self, index: int) -> tuple[int, ...]:
        """Return the rows of velocity and angular velocity of a body."""
        return self.rows(index)[-6:]

    @cached_property
    def _own(self) -> list[tuple[int, int]]:
        """First row, and row after the last, of each connector's own states."""
        counts = [len(c.own) for c in self.scene.connectors]
        ends = self.size * len(self.scene.bodies) + np.cumsum([0, *counts])
        return [(int(a), int(b)) for a, b in pairwise(ends)]

    @cached_property
    def _unknown(self) -> list[tuple[int, int]]:
        """The same for each connector's unknown forces, rows of z."""
        ends = np.cumsum([0, *(len(c.unknowns) for c in self.scene.connectors)])
        return [(int(a), int(b)) for a, b in pairwise(ends)]

    def own_rows(self, connector: int) -> tuple[int, ...]:
        """Return the rows of the data and internal states of a connector."""
        return tuple(range(*self._own[connector]))

    def unknown_rows(self, connector: int) -> tuple[int, ...]:
        """Return the rows of z that are the unknown forces of a connector."""
        return tuple(range(*self._unknown[connector]))

    def rotations(self) -> tuple[Rotation, ...]:
        """Return the rotations of all bodies."""
        return tuple(
            Rotation(body.name, self.coordinates.kind, self.rows(i)[3:-6], self.rows(i)[-3:])
            for i, body in enumerate(self.scene.bodies)
        )

    @cached_property
    def _turning(self) -> ca.Function:
        r, w = ca.SX.sym("r", len(self.coordinates.labels)), ca.SX.sym("w", 3)
        return ca.Function("kinematics", [r, w], [self.coordinates.rate(r, w)])

    def motions(self, index: int) -> list[Kinematics]:
        """Return the motions of a body: three translations and the rotation."""
        body, rows = self.scene.bodies[index], self.rows(index)
        v = rows[-6:-3]
        moves = [
            Kinematics(body.name, axis, rows[i : i + 1], v[i : i + 1], _TRANSLATION_RETRACT)
            for i, axis in enumerate("xyz")
        ]
        return [*moves, Kinematics(body.name, "rotation", rows[3:-6], rows[-3:], self._retract)]

    @cached_property
    def _retract(self) -> ca.Function:
        """Function (coordinates, step) -> coordinates of R exp(step), step in body axes, rad."""
        r, step = ca.SX.sym("r", len(self.coordinates.labels)), ca.SX.sym("step", 3)
        _, q = self.coordinates.orientation(r)
        turned = quat_product(q, quat_exp(step))
        found = self.coordinates.start(quat_matrix(turned), turned)
        # `start` returns angles within one turn; those of a state count turns, so the nearest
        # equivalent ones are taken.
        if self.coordinates.kind is RotationKind.tait_bryan:
            found = found + 2 * ca.pi * ca.floor((r - found) / (2 * ca.pi) + 0.5)
        return ca.Function("retract", [r, step], [found])

    def balances(self, index: int) -> list[Balance]:
        """Return the motions of a body that have no inertia: its three translations, its rotation.

        A thin rod has no inertia about its own axis; its rotation is a balance with one idle
        velocity.
        """
        body, rows = self.scene.bodies[index], self.rows(index)
        v, w = rows[-6:-3], rows[-3:]
        balances = []
        if not has_mass(body):
            balances = [
                Balance(
                    f"{body.name}.{axis}",
                    rows[i : i + 1],
                    v[i : i + 1],
                    v[i : i + 1],
                    _TRANSLATION_RATE,
                )
                for i, axis in enumerate("xyz")
            ]
        axes = axes_without_inertia(body)
        if axes:
            # The coordinates of a rotation belong to all three velocities, whichever of them have
            # inertia.
            idle = tuple(w[i] for i in axes)
            name = f"{body.name}.rotation"
            balances.append(Balance(name, rows[3:-6], w, idle, self._turning))
        return balances

    def carriers(self, *markers: Marker) -> list[int]:
        """Return the indices of the moving bodies that carry the markers, each once."""
        names = [marker.body for marker in markers if marker.body != GROUND]
        return [self.index(name) for name in dict.fromkeys(names)]

    def labels(self, body: RigidBody) -> list[Label]:
        """Return the labels of a body's states, without start values."""
        names = [("p", axis, "m") for axis in "xyz"] + [*self.coordinates.labels]
        names += [(q, axis, unit) for q, unit in (("v", "m/s"), ("w", "rad/s")) for axis in "xyz"]
        return [Label(body.name, *name) for name in names]

    def start(self, body: RigidBody) -> ca.SX:
        """Return the start values of a body's states, over the Params.

        The scene gives the body frame's origin; the states belong to the centre of mass.
        """
        R_WB, q_WB = rotation_pair(body.rotation)
        w_B, com = to_expr(body.angular_velocity), to_expr(body.com)
        # The scene describes the origin of the body frame: v_com = v_origin + R (w x com).
        position = to_expr(body.position) + R_WB @ com
        velocity = to_expr(body.velocity) + R_WB @ ca.cross(w_B, com)
        return ca.vertcat(position, self.coordinates.start(R_WB, q_WB), velocity, w_B)

    def split(self, x: ca.SX) -> list[ca.SX]:
        """Return the states of several bodies, body by body."""
        return [x[i : i + self.size] for i in range(0, x.numel(), self.size)]

    def body(self, x: ca.SX) -> Body:
        """Return the motion of a body from its own states (n, 1)."""
        n = len(self.coordinates.labels)
        R_WB, q_WB = self.coordinates.orientation(x[3 : 3 + n])
        return body_motion(x[:3], R_WB, q_WB, x[3 + n : 6 + n], x[6 + n : 9 + n])

    def kinematic_rates(self, x: ca.SX) -> ca.SX:
        """Return the rates (n, 1) of position and rotation coordinates; 0 for the velocities."""
        n = len(self.coordinates.labels)
        rate = self.coordinates.rate(x[3 : 3 + n], x[6 + n : 9 + n])
        return ca.vertcat(x[3 + n : 6 + n], rate, ca.SX.zeros(6))


def accelerations(f_W: ca.SX, tau_B: ca.SX, compliance: ca.SX) -> ca.SX:
    """Return (v', w') caused by a force and a torque at the centre of mass, (6, 1).

    Arguments:
        f_W: force, world axes, N.
        tau_B: torque, body axes, N m.
        compliance: column of `pack.compliance_column`: 1 / mass, then the inverse inertia.
    """
    return ca.vertcat(compliance[0] * f_W, ca.reshape(compliance[1:], 3, 3) @ tau_B)


def kernel(name: str, x: ca.SX, c: ca.SX, *results: ca.SX, z: ca.SX | None = None) -> ca.Function:
    """Return a Function (t, x, z, c) -> results, each result dense.

    Arguments:
        name: name of the kernel; it appears in generated C.
        x, c, z: columns of symbols; z defaults to an empty one.
        results: expressions over t, x, z and c.
    """
    # Kernels are mapped over instances and their results scattered by row, so a result must have an
    # entry for every row.
    dense = [ca.densify(result) for result in results]
    return ca.Function(name, [TIME.expr, x, ca.SX.sym("z", 0) if z is None else z, c], dense)
