"""Numbers of scene elements as columns of constants for the kernels, and back."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import casadi as ca
import numpy as np

from ..base.rotation import matrix_quat, quat_matrix, quat_product
from ..base.symbols import TIME, Scalar, leaves_of, to_expr
from ..mechanics.motion import MarkerOnBody, inverse3
from ..scene.elements import Marker, RigidBody

MARKER = 22  # p (3), R (9), q (4), v (3), w (3)
INERTIA = 18  # inertia (9), its inverse (9)
COMPLIANCE = 10  # 1 / mass, inverse inertia (9)
BODY = 16  # mass, inertia (9), com (3), start position of the frame's origin (3)


# As CasADi Functions these are one call each, which keeps the build time per element short.
_MATRIX = ca.SX.sym("A", 3, 3)
_MATRIX_QUAT = ca.Function("matrix_quat", [_MATRIX], [matrix_quat(_MATRIX)])
_INVERSE3 = ca.Function("inverse3", [_MATRIX], [inverse3(_MATRIX)])
_STILL = ca.SX.zeros(6)


def rotation_pair(rotation: np.ndarray) -> tuple[ca.SX, ca.SX]:
    """Return matrix (3, 3) and quaternion (4, 1) of a checked rotation, given as either."""
    value = to_expr(rotation)
    if rotation.shape == (4,):
        return quat_matrix(value), value
    return value, _MATRIX_QUAT(value)


def _marker_function() -> ca.Function:
    """Return a Function (position, rotations of marker and joint) -> first 16 entries."""
    p, A, B = ca.SX.sym("p", 3), ca.SX.sym("A", 3, 3), ca.SX.sym("B", 3, 3)
    q = quat_product(matrix_quat(A), matrix_quat(B))
    return ca.Function("marker", [p, A, B], [ca.vertcat(p, ca.vec(A @ B), q)])


_MARKER = _marker_function()


def marker_column(marker: Marker, body: RigidBody | None, joint: np.ndarray | None = None) -> ca.SX:
    """Return a marker as a column (22, 1): p, R, q and its own velocities v, w, all in body axes.

    The position is relative to the centre of mass, the rotation includes that of the joint. The
    velocities are the explicit derivatives by TIME; Inputs count as constant.

    Arguments:
        marker: the marker.
        body: the body that carries it; None for the ground.
        joint: rotation from joint frame to marker; None for none.
    """
    turned = np.eye(3) if joint is None else joint
    given = [marker.position, marker.rotation, turned, body.com if body else np.zeros(3)]
    if all(v.dtype != object for v in given) and marker.rotation.shape == turned.shape == (3, 3):
        # Plain numbers need no symbolic algebra.
        place = marker.position - given[3]
        return ca.vertcat(ca.SX(_MARKER(place, marker.rotation, turned)), _STILL)
    R, q = rotation_pair(marker.rotation)
    if joint is not None:
        R_joint, q_joint = rotation_pair(joint)
        R, q = R @ R_joint, quat_product(q, q_joint)
    p = to_expr(marker.position) - (to_expr(body.com) if body else 0)
    driven = TIME in leaves_of([marker.position, marker.rotation, () if joint is None else joint])
    return ca.vertcat(p, ca.vec(R), q, _velocity(p, R) if driven else _STILL)


def _velocity(p: ca.SX, R: ca.SX) -> ca.SX:
    # R' R^T is the cross-product matrix of the angular velocity.
    spin = ca.reshape(ca.jacobian(ca.vec(R), TIME.expr), 3, 3) @ R.T
    w = ca.vertcat(spin[2, 1], spin[0, 2], spin[1, 0])
    return ca.densify(ca.vertcat(ca.jacobian(p, TIME.expr), w))


def marker_of(c: ca.SX) -> MarkerOnBody:
    """Return the marker that a column holds."""
    return MarkerOnBody(c[:3], ca.reshape(c[3:12], 3, 3), c[12:16], c[16:19], c[19:22])


def has_mass(body: RigidBody) -> bool:
    """Return whether the mass is anything but a plain zero."""
    return not _is_plain_zero(body.mass)


def axes_without_inertia(body: RigidBody) -> tuple[int, ...]:
    """Return the body axes (0, 1, 2) whose row of the inertia consists of plain zeros.

    All three for a body without inertia, one for a thin rod.
    """
    return tuple(i for i in range(3) if all(_is_plain_zero(v) for v in body.inertia[i]))


def _is_plain_zero(value: object) -> bool:
    return not isinstance(value, Scalar) and float(value) == 0.0  # type: ignore[arg-type]


def inertia_column(body: RigidBody) -> ca.SX:
    """Return inertia and the inverse that the rates use, (18, 1); see `compliance_column`."""
    return ca.vertcat(ca.vec(to_expr(body.inertia)), compliance_column(body)[1:])


def compliance_column(body: RigidBody) -> ca.SX:
    """Return 1 / mass and the inverse inertia, (10, 1): what turns a wrench into accelerations.

    For a motion without mass or inertia it is 1, so that the row of ode holds the force or torque
    itself, which must vanish (`Dae.balances`).
    """
    inertia = to_expr(body.inertia)
    for i in axes_without_inertia(body):
        inertia[i, i] = 1
    mass = to_expr(body.mass) if has_mass(body) else ca.SX(1)
    return ca.vertcat(1 / mass, ca.vec(_INVERSE3(inertia)))


def body_column(body: RigidBody) -> ca.SX:
    """Return what the outputs of a body need, (16, 1): mass, inertia, com, start position."""
    return ca.vertcat(
        to_expr(body.mass), ca.vec(to_expr(body.inertia)), to_expr(body.com), to_expr(body.position)
    )


class ConnectorConstants(NamedTuple):
    """Constants of a connector by name; their column holds them in this order.

    Fields:
        markers: columns of both markers with their joint frames (`marker_column`).
        stiffness, damping: (36, 1), column by column; offset, velocity_offset: (6, 1).
        compliances: of the moving bodies it touches (`compliance_column`).
        active: (1, 1) if a number switches the connector, else (0, 1).
        functions: values of the Params and Inputs in each user function, as in `Functions`.
        effects: numbers of each effect.
    """

    markers: tuple[ca.SX, ...]
    stiffness: ca.SX
    damping: ca.SX
    offset: ca.SX
    velocity_offset: ca.SX
    compliances: tuple[ca.SX, ...]
    active: ca.SX
    functions: tuple[ca.SX, ...]
    effects: tuple[ca.SX, ...]

    def _parts(self) -> Iterator[ca.SX]:
        for field in self:
            yield from field if isinstance(field, tuple) else (field,)

    @property
    def column(self) -> ca.SX:
        """All of them as one column."""
        return ca.vertcat(*self._parts())

    def over(self, column: ca.SX) -> ConnectorConstants:
        """The same names over the entries of another column of the same length."""
        ends = np.cumsum([0, *(part.numel() for part in self._parts())]).tolist()
        pieces = iter([column[a:b] for a, b in pairwise(ends)])
        fields = (
            tuple(next(pieces) for _ in field) if isinstance(field, tuple) else next(pieces)
            for field in self
        )
        return ConnectorConstants(*fields)
