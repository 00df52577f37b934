"""A scene rewritten in the axes of a plane in which it may move.

The passes of `minimal` recognise planar motion if its normal is a world axis and no body is rotated
about any other axis at the start. `planes` searches for a plane at the start and returns an
equivalent scene for which both hold; `Plane.way_back` maps its states to those of the original.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import casadi as ca
import numpy as np

from ..base.checks import at_default, is_symbolic
from ..base.rotation import quat_product
from ..scene.elements import GROUND
from ..scene.scene import Scene
from .layout import Layout
from .pack import rotation_pair
from .rewrite import (
    EYE,
    Axes,
    body_in,
    connector_in,
    left,
    load_in,
    matrix_at_start,
    quaternion_of,
    snap,
    snap_rotation,
    times,
)

# Relative distance from a plane, and angle (rad) from its normal, that careful input keeps.
_FLAT = 1e-12
# Relative width below which vectors lie on one line.
_THIN = 1e-9
# Most planes that are tried.
_CANDIDATES = 4


@dataclass(frozen=True, eq=False)
class Plane:
    """A scene rewritten in the axes of a plane in which it may move, and the map back.

    Arguments:
        scene: the equivalent scene, in world axes V and in body axes N at the centres of mass that
            are parallel to V at the start. Its numbers differ from exact ones by rounding only.
        Q: R_WV (3, 3), one column of which is the normal; the identity if the world axes are kept.
        origin: of V, world axes (3,), m; p_W = origin + Q p_V.
        turned: R_BN (3, 3) of each body, from its new axes to its own.
        quaternions: of R_NB (4,), with the sign that gives the start of the original scene.
        place: which axis of V (0, 1, 2) is the normal.
    """

    scene: Scene
    Q: np.ndarray
    origin: np.ndarray
    turned: tuple[np.ndarray, ...]
    quaternions: tuple[np.ndarray, ...]
    place: int

    @property
    def normal(self) -> np.ndarray:
        """Unit normal of the plane, world axes (3,)."""
        return self.Q[:, self.place]

    @property
    def keeps_world(self) -> bool:
        """Whether positions and velocities mean the same as in the original scene."""
        return bool((self.Q == EYE).all() and not self.origin.any())

    def way_back(self, layout: Layout, x: ca.SX) -> ca.SX:
        """Return the bodies' states in the original scene (n, 1) from those in this one.

        Arguments:
            layout: layout of the rewritten scene, in any coordinates.
            x: column of its bodies' states, symbols or numbers.
        """
        (Q, q_WV), columns = rotation_pair(self.Q), []
        for states, R_BN, q_NB in zip(layout.split(x), self.turned, self.quaternions, strict=True):
            body, turn = layout.body(states), ca.SX(ca.DM(R_BN))
            p_VN, R_VN, q_VN = body.motion.frame
            q_WB = quat_product(quat_product(q_WV, q_VN), ca.DM(q_NB))
            columns += [
                ca.DM(self.origin) + Q @ p_VN,
                layout.coordinates.start(Q @ R_VN @ turn.T, q_WB),
                Q @ body.motion.v_WA,
                turn @ body.w_WB_B,
            ]
        return ca.vertcat(*columns)


def planes(scene: Scene) -> Iterator[Plane]:
    """Yield planes in which the scene may move, best first; at most four, none for a spatial scene.

    The search uses numbers, with every symbol at its default. Whether a candidate really gives a
    smaller model is for the passes of `minimal` to prove.
    """
    for body in scene.bodies:
        low, _, high = np.linalg.eigvalsh(at_default(body.inertia))
        # A rod without inertia about its axis must keep its own axes (`pack.axes_without_inertia`).
        if is_symbolic(body.rotation) or low <= _FLAT * high != 0:
            return
    start = _at_start(scene)
    for n, place in islice(start.normals(), _CANDIDATES):
        if _is_axis(n) and n[place]:
            yield written_in(scene, EYE, np.zeros(3), place)
        else:
            foot = n * snap(n @ start.points[0], start.reach)
            yield written_in(scene, start.plane_axes(n, place), foot, place)


def written_in(scene: Scene, Q: np.ndarray, origin: np.ndarray, place: int = 2) -> Plane:
    """Return the scene in world axes V, with body axes parallel to V at the start.

    Arguments:
        scene: the original scene.
        Q: R_WV (3, 3).
        origin: of V, world axes (3,), m.
        place: which axis of V is the normal.
    """
    start, q_VW = _at_start(scene), quaternion_of(Q) * (1, -1, -1, -1)
    # All points of the plane have the coordinate of the first one along the normal; those that
    # differ by rounding are set to it exactly.
    level = times(Q.T, start.points[0] - origin, start.reach)
    axes = {GROUND: Axes(Q.T, q_VW, origin, start.reach, level)}
    for body, R in zip(scene.bodies, start.rotations, strict=True):
        q_NB = snap_rotation(left(q_VW) @ quaternion_of(body.rotation))
        size = float(np.linalg.norm(at_default(body.com)))
        axes[body.name] = Axes(snap_rotation(Q.T @ R), q_NB, body.com, size, np.zeros(3))
    written = replace(
        scene,
        bodies=[body_in(body, axes) for body in scene.bodies],
        connectors=[connector_in(scene, i, Q, axes) for i in range(len(scene.connectors))],
        loads=[load_in(load, axes) for load in scene.loads],
        gravity=times(Q.T, scene.gravity),
    )
    own = [axes[body.name] for body in scene.bodies]
    return Plane(
        written, Q, origin, tuple(a.turn.T for a in own), tuple(a.q_NB for a in own), place
    )


def _is_axis(n: np.ndarray) -> bool:
    return int(np.count_nonzero(n)) == 1


def _distinct(axes: np.ndarray) -> np.ndarray:
    """Return the directions (k, 3) that differ, up to sign, each once and in order."""
    # Signs make the first entry that is not small positive; directions equal to 9 digits are one.
    # Adding 0.0 turns -0 into 0.
    lead = np.take_along_axis(axes, np.argmax(np.abs(axes) > _THIN, axis=1)[:, None], axis=1)
    _, first = np.unique(np.round(axes * np.sign(lead), 9) + 0.0, axis=0, return_index=True)
    return axes[np.sort(first)]


def _across(a: np.ndarray, n: np.ndarray) -> np.ndarray:
    """Return the length of the components of vectors a (..., 3) across the unit vector n."""
    return np.linalg.norm(np.cross(a, n), axis=-1)


class _Start(NamedTuple):
    """Poses and directions at the start, as numbers in world axes, every symbol at its default."""

    rotations: np.ndarray  # R_WB of each body (k, 3, 3)
    inertias: np.ndarray  # (k, 3, 3)
    joints: np.ndarray  # joint frames A_0 to world (k, 3, 3)
    points: np.ndarray  # centres of mass, and where forces act (k, 3)
    reach: float  # largest distance of a point or body frame from the world origin, m
    pulls: list[np.ndarray]  # gravity, velocities, forces, offsets: (k, 3) each
    turning: np.ndarray  # angular velocities and torques (k, 3)

    def in_plane(self, n: np.ndarray | None = None) -> np.ndarray:
        """Return vectors that must lie in the plane of motion, scaled to lengths of at most 1.

        Arguments:
            n: normal of the plane, if known.
        """
        groups = [self.points - self.points[0], *self.pulls]
        # If the world axes are not rotated, offsets along the normal do not matter.
        if n is not None and _is_axis(n):
            groups = [] if len(self.turning) else self.pulls[:-1]
        sizes = [np.linalg.norm(group, axis=1).max(initial=0.0) for group in groups]
        scaled = [group / size for group, size in zip(groups, sizes, strict=True) if size > 0]
        return np.vstack([np.zeros((3, 3)), *scaled])

    def normals(self) -> Iterator[tuple[np.ndarray, int]]:
        """Yield unit normals that the start allows, each with the axis of V that it becomes.

        This is the axis that it is in the joint frames, which then rotate about one of their own
        axes, which the passes recognise. World axes are left out if every body starts parallel to
        the world and every joint rotates about one of its own axes, because the passes see such a
        plane in the original scene.
        """
        frames = np.concatenate([self.joints, self.rotations])
        axes = frames.transpose(0, 2, 1)[:, ::-1].reshape(-1, 3)
        flat = (np.abs(self.in_plane() @ axes.T) <= _FLAT).all(axis=0)
        suggested = _distinct(axes[flat | (np.count_nonzero(snap_rotation(axes), axis=1) == 1)])
        seen, upright = list[np.ndarray](), (self.rotations == EYE).all()
        if len(self.turning):
            suggested = self.turning[:1]
        else:
            # Singular values of all vectors in the plane: the last right singular vector is the
            # normal if they span exactly two dimensions.
            _, (long, wide, thick), rows = np.linalg.svd(self.in_plane(), full_matrices=False)
            if thick <= _FLAT * long and wide > _THIN * long:
                suggested = rows[2:]
        for n in suggested / np.linalg.norm(suggested, axis=1)[:, None]:
            near = axes[_across(axes, n) <= _THIN]
            # An axis of a frame is known more accurately than the fit through a sum of points.
            n = near[0] if len(near) else n
            n = snap_rotation(n / np.linalg.norm(n))
            if not self.admits(n) or any(_across(other, n) <= _THIN for other in seen):
                continue
            seen.append(n)
            along = _across(self.joints.transpose(0, 2, 1), n) <= _THIN
            # Each joint frame votes for the axis that is parallel to the normal; ties go to z.
            votes = along.sum(axis=0)
            place = 2 - int(votes[::-1].argmax())
            if _is_axis(n) and not votes.any():
                place = int(np.abs(n).argmax())
            if not (upright and _is_axis(n) and n[place] and along.any(axis=1).all()):
                yield n, place

    def admits(self, n: np.ndarray) -> bool:
        """Return whether rotations, vectors and inertias allow motion in the plane of normal n."""
        flat = np.abs(self.in_plane(n) @ n) <= _FLAT
        parallel = _across(self.turning, n) <= _FLAT * np.linalg.norm(self.turning, axis=1)
        sizes = np.abs(self.inertias).max(axis=(1, 2))
        # n must be a principal axis of every inertia, or rotation about n would cause torques about
        # the other axes.
        principal = _across(self.inertias @ n, n) <= _FLAT * sizes
        return bool(flat.all() and parallel.all() and principal.all())

    def plane_axes(self, n: np.ndarray, place: int) -> np.ndarray:
        """Return R_WV for a plane.

        The axis after n is along gravity if that lies in the plane, else along the first lever
        between points.
        """
        (g,), levers = self.pulls[0], self.points - self.points[0]
        floor = _THIN * max(float(np.linalg.norm(levers, axis=1).max()), 1e-3)
        falls = [g] if abs(g @ n) <= _FLAT * np.linalg.norm(g) else []
        for v in (*falls, *levers, *EYE):
            e1 = np.cross(np.cross(n, v), n)
            if np.linalg.norm(e1) > floor:
                break
        e1 = snap(e1 / np.linalg.norm(e1), 1.0)
        # Right-handed with n as third axis; a cyclic shift makes it axis `place` and stays
        # right-handed.
        Q = np.column_stack([e1, np.cross(n, e1), n])
        return snap_rotation(np.roll(Q, place - 2, axis=1))


def _at_start(scene: Scene) -> _Start:
    """Return the start of a scene as numbers."""
    R = {b.name: snap_rotation(matrix_at_start(quaternion_of(b.rotation))) for b in scene.bodies}
    R[GROUND] = EYE
    p = {body.name: at_default(body.position) for body in scene.bodies} | {GROUND: np.zeros(3)}
    joints, points, speeds, inertias, turning, offsets, forces, markers = ([] for _ in range(8))
    for body in scene.bodies:
        com, w = at_default(body.com), at_default(body.angular_velocity)
        points.append(p[body.name] + R[body.name] @ com)
        speeds.append(at_default(body.velocity) + R[body.name] @ np.cross(w, com))
        turning.append(R[body.name] @ w)
        inertias.append(R[body.name] @ at_default(body.inertia) @ R[body.name].T)
    for c in (c for c in scene.connectors if not c.idle):
        A = (
            R[c.marker0.body]
            @ matrix_at_start(c.marker0.rotation)
            @ matrix_at_start(c.rotation_marker0)
        )
        joints.append(A)
        offsets += [A @ at_default(v)[:3] for v in (c.offset, c.velocity_offset)]
        markers += [c.marker0, c.marker1]
    for load in (load for load in scene.loads if load.marker.body != GROUND):
        turn = R[load.marker.body] if load.frame == "body" else EYE
        forces.append(turn @ at_default(load.force))
        turning.append(turn @ at_default(load.torque))
        markers += [load.marker] if is_symbolic(load.force) or load.force.any() else []
    points += [p[m.body] + R[m.body] @ at_default(m.position) for m in markers]
    kinds = (at_default(scene.gravity), speeds, forces, offsets)
    return _Start(
        np.array([R[body.name] for body in scene.bodies]),
        np.array(inertias),
        np.array(joints).reshape(-1, 3, 3),
        np.array(points),
        float(np.linalg.norm([*points, *p.values()], axis=1).max()),
        [np.array(vectors).reshape(-1, 3) for vectors in kinds],
        np.array([v for v in turning if v.any()]).reshape(-1, 3),
    )
