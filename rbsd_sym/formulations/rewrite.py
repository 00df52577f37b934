"""Elements of a scene rewritten in other axes, without spurious couplings from rounding.

An entry that is zero in exact arithmetic must be exactly zero in the new scene: otherwise the
passes of `minimal`, which prove zeros structurally, find coupled motion.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import wraps
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..base.checks import at_default, is_symbolic
from ..base.symbols import Scalar, leaves_of, to_expr
from ..scene.elements import GROUND, Load, Marker, RigidBody, RigidBodySpringDamper
from ..scene.mbs import Mbs, seen_as
from ..scene.scene import Scene
from .pack import rotation_pair

# Relative rounding error of a few products of rotations and vectors.
ROUNDING = 16 * float(np.finfo(float).eps)
EYE = np.eye(3)
# Operations that are linear in their arguments, and the factor of each argument.
_SUMS = {ca.OP_ADD: (1, 1), ca.OP_SUB: (1, -1), ca.OP_NEG: (-1,), ca.OP_TWICE: (2,)}


def matrix_at_start(rotation: np.ndarray) -> np.ndarray:
    """Return a checked rotation as a matrix (3, 3) of floats, every symbol at its default."""
    value = at_default(rotation)
    if value.shape == (3, 3):
        return value
    M = left(value) * (1, -1, -1, -1)
    # b -> q b q*, on pure quaternions b.
    return (M @ M)[1:, 1:] / (value @ value)


def quaternion_of(rotation: np.ndarray) -> np.ndarray:
    """Return a rotation of numbers as a quaternion (4,), with the sign that a start has."""
    return np.array(ca.DM(rotation_pair(rotation)[1])).reshape(4)


def left(q: np.ndarray) -> np.ndarray:
    """Return the matrix (4, 4) of the product q b as a linear map of b."""
    w, x, y, z = q
    return np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])


def snap(values: Any, scale: float, exact: tuple[float, ...] = (0.0,)) -> np.ndarray:
    """Return values with those within rounding of an exact number replaced by it.

    Arguments:
        values: numbers of any shape.
        scale: size of the numbers that the values were computed from; rounding is 16 epsilon times
            it.
        exact: numbers to snap to.
    """
    out = np.array(values, float)
    for number in exact:
        out[np.abs(out - number) <= ROUNDING * scale] = number
    return out


def snap_rotation(product: np.ndarray) -> np.ndarray:
    """Return a product of rotations with entries near -1, 0 and 1 made exact."""
    return snap(product, 1.0, (-1.0, 0.0, 1.0))


def _terms(expr: ca.SX) -> Iterator[tuple[int, float, ca.SX]]:
    """Yield a scalar expression as a sum of terms (key, factor, atom).

    Equal atoms have equal keys; the key of the constant term is 0.
    """
    pending = [(expr, 1.0)]
    while pending:
        expr, factor = pending.pop()
        if expr.is_constant():
            yield 0, factor * float(expr), ca.SX(1)
            continue
        op, parts = expr.op(), [expr.dep(i) for i in range(expr.n_dep())]
        if op in _SUMS:
            pending += [(part, factor * w) for part, w in zip(parts, _SUMS[op], strict=True)]
        # CasADi writes the number of a product first.
        elif op == ca.OP_MUL and parts[0].is_constant():
            pending.append((parts[1], factor * float(parts[0])))
        elif op == ca.OP_DIV and parts[1].is_constant():
            pending.append((parts[0], factor / float(parts[1])))
        else:
            yield expr.element_hash(), factor, expr


def times(A: np.ndarray, v: np.ndarray, scale: float = 0.0) -> np.ndarray:
    """Return A v (m,), with entries that are only rounding set to zero.

    The threshold is 16 epsilon times the norm of v plus the scale. A vector of symbols is
    decomposed into numbers times atoms, and the numbers of each atom are treated alike, so that
    multiples of one Param that cancel leave nothing.

    Arguments:
        A: numbers (m, n).
        v: numbers or expressions (n,).
        scale: size of the numbers whose difference v is.
    """
    if not is_symbolic(v):
        return snap(A @ v, float(np.linalg.norm(v)) + scale)
    numbers: dict[int, np.ndarray] = {}
    atoms: dict[int, ca.SX] = {}
    # After cse, equal subexpressions are one node, which makes their hashes equal.
    for i, expr in enumerate(ca.vertsplit(ca.cse(to_expr(v)))):
        for key, factor, atom in _terms(expr):
            atoms[key] = atom
            numbers.setdefault(key, np.zeros(len(v)))[i] += factor
    rows = [ca.SX(0)] * len(A)
    for key, column in numbers.items():
        product = snap(A @ column, float(np.linalg.norm(column)) + (0.0 if key else scale))
        rows = [row + float(c) * atoms[key] for row, c in zip(rows, product, strict=True)]
    out: np.ndarray = np.empty(len(A), dtype=object)
    out[:] = [float(row) if row.is_constant() else Scalar(row, leaves_of(v)) for row in rows]
    return out


class Axes(NamedTuple):
    """New axes N of a body (or of the world, V) relative to its own axes B.

    Fields:
        turn: R_NB (3, 3).
        q_NB: quaternion (4,) of the same rotation.
        origin: origin of N in B (3,), m; it may be symbolic.
        scale: size of the coordinates, m.
        level: coordinates in N (3,), m, to which nearby ones are set.
    """

    turn: np.ndarray  # R_NB
    q_NB: np.ndarray
    origin: np.ndarray  # of N, in B
    scale: float  # size of the coordinates
    level: np.ndarray  # coordinates in N that near ones are set to

    def point(self, p: np.ndarray) -> np.ndarray:
        """Return a point (3,), given in B, in N; m."""
        # p - origin may be a difference of nearly equal numbers, whose rounding error is that of
        # the coordinates.
        out = times(self.turn, p - self.origin, self.scale)
        for i, value in enumerate(self.level):
            if not isinstance(out[i], Scalar) and abs(out[i] - value) <= ROUNDING * self.scale:
                out[i] = value
        return out

    def tensor(self, T: np.ndarray) -> np.ndarray:
        """Return a symmetric tensor (3, 3), given in B, in N."""
        out = times(np.kron(self.turn, self.turn), T.reshape(9)).reshape(3, 3)
        # Rounding differs between mirrored entries; the tensor must stay exactly symmetric.
        for i, j in ((1, 0), (2, 0), (2, 1)):
            out[i, j] = out[j, i]
        return out

    def marker(self, m: Marker) -> Marker:
        """Return a marker on B as a marker on N."""
        R = m.rotation
        if not is_symbolic(R):
            R = snap_rotation(self.turn @ matrix_at_start(R))
        elif R.shape == (3, 3):
            R = times(np.kron(self.turn, EYE), R.reshape(9)).reshape(3, 3)
        else:
            R = times(left(self.q_NB), R)
        return replace(m, position=self.point(m.position), rotation=R)


def body_in(body: RigidBody, axes: dict[str, Axes]) -> RigidBody:
    """Return the body with axes N, its origin at the centre of mass."""
    own, world, R_WB = axes[body.name], axes[GROUND], matrix_at_start(body.rotation)
    # The new origin is the centre of mass: v_com = v + R (w x com).
    swing = times(R_WB, np.cross(body.angular_velocity, body.com))
    speed = float(np.linalg.norm(at_default(body.velocity)))
    return replace(
        body,
        inertia=own.tensor(body.inertia),
        com=np.zeros(3),
        position=world.point(body.position + times(R_WB, body.com)),
        rotation=EYE,
        velocity=times(world.turn, body.velocity + swing, speed),
        angular_velocity=times(own.turn, body.angular_velocity),
    )


def connector_in(
    scene: Scene, item: int, Q: np.ndarray, axes: dict[str, Axes]
) -> RigidBodySpringDamper:
    """Return a connector of the scene in the new axes.

    Joint frames become part of the markers where both are numbers. Joint frames that are oblique to
    all axes of N are rotated to be parallel to N, together with K, D and the offsets, where the law
    allows it: planar motion shows only in parallel frames. User functions are called with the scene
    as it was given.

    Arguments:
        scene: the original scene.
        item: which of its connectors.
        Q: R_WV (3, 3), the new world axes in the old.
        axes: new axes of each body and of the ground, by name.
    """
    c = scene.connectors[item]
    frames = [(getattr(c, f"marker{i}"), getattr(c, f"rotation_marker{i}")) for i in "01"]
    if not any(is_symbolic(m.rotation) or is_symbolic(joint) for m, joint in frames):
        frames = [
            (replace(m, rotation=matrix_at_start(m.rotation) @ matrix_at_start(joint)), EYE)
            for m, joint in frames
        ]
    (marker0, joint0), (marker1, joint1) = ((axes[m.body].marker(m), joint) for m, joint in frames)
    changes: dict[str, Any] = {}
    users = {name: getattr(c, name) for name in ("force", "events", "post_newton_step")}
    # User functions and effects refer to the axes of the joint frame, so only connectors without
    # them may have it rotated.
    plain = joint0 is EYE and joint1 is EYE and c.law.turns_with_frames
    plain = plain and not c.effects and not any(users.values())
    if plain and not (np.abs(marker0.rotation) == 1).any():
        P = marker0.rotation.T
        marker0 = replace(marker0, rotation=EYE)
        marker1 = replace(marker1, rotation=snap_rotation(marker1.rotation @ P))
        changes = _turned(c, P.T)
    changes |= {name: _as_given(user, scene, Q) for name, user in users.items() if user}
    return replace(
        c,
        marker0=marker0,
        rotation_marker0=joint0,
        marker1=marker1,
        rotation_marker1=joint1,
        **changes,
    )


def _as_given(user: Any, scene: Scene, Q: np.ndarray) -> Any:
    """Wrap a user function so that it is called as in the scene with its original axes."""

    @wraps(user)
    def called(mbs: Mbs, *rest: Any) -> Any:
        seen, rotJ0, rotJ1 = seen_as(mbs, scene.connectors, Q)
        return user(seen, *rest[:-3], rotJ0, rotJ1, rest[-1])

    return called


def _turned(c: RigidBodySpringDamper, R: np.ndarray) -> dict[str, np.ndarray]:
    """Return K, D and offsets for joint frames A R': components u become R u."""
    # Row by row, R K R' is kron(R, R) applied to K; translation and rotation are rotated alike.
    both = np.kron(np.eye(2), R)
    changes = {
        name: times(np.kron(both, both), getattr(c, name).reshape(36)).reshape(6, 6)
        for name in ("stiffness", "damping")
    }
    if c.law.needs_symmetric_stiffness:
        K = changes["stiffness"]
        # The same for K, which laws with a potential require to be symmetric.
        changes["stiffness"] = np.where(np.tri(6, k=-1, dtype=bool), K.T, K)
    offsets = {name: times(both, getattr(c, name)) for name in ("offset", "velocity_offset")}
    return changes | offsets


def load_in(load: Load, axes: dict[str, Axes]) -> Load:
    """Return the load in the axes of its marker, with force and torque rotated along."""
    own = axes[load.marker.body]
    turn = (own if load.frame == "body" else axes[GROUND]).turn
    force, torque = times(turn, load.force), times(turn, load.torque)
    return replace(load, marker=own.marker(load.marker), force=force, torque=torque)
