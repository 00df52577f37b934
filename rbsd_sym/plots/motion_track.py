"""What is drawn along a trajectory: boxes, spring ends, arrows and energies at given times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..base.symbols import TIME, Leaf, leaves_of, to_expr
from ..model.model import Model
from ..model.trajectory import Column, Trajectory
from ..scene.elements import GROUND, Marker
from .shapes import BodyDrawing, Drawing, box_of_inertia, corners, quaternion_matrix

_CUBE = 0.04  # edge of a body without inertia, over the scene's size
_DIAMETER = 0.05  # diameter of a spring, over the scene's size
_ARROW = 0.25  # length of the longest force and of the longest torque, over the scene's size


@dataclass(frozen=True, eq=False)
class Source:
    """Values over time from a trajectory, and from its model if that is known."""

    model: Model | None
    trajectory: Trajectory

    def column(self, name: str) -> Column:
        """Return a column of the trajectory, evaluated by the model if it is not held.

        Raises:
            ValueError: no such column.
        """
        held = name in self.trajectory.columns or name in self.trajectory.parameters
        if self.model is None or held or self.trajectory.more is not None:
            return self.trajectory.column(name)
        return self.model.measure(name, self.trajectory)

    def at(self, name: str, t: np.ndarray) -> np.ndarray:
        """Return the values (n, ...) of a column at times t (n,), s, interpolated linearly."""
        return self.between(self.column(name).values, t)

    def between(self, values: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Return values at times t (n,), s, interpolated linearly.

        Arguments:
            values: at the trajectory's times, along the first axis.
        """
        before, share = self._place(t)
        share = share.reshape(-1, *[1] * (values.ndim - 1))
        after = np.minimum(before + 1, len(values) - 1)
        return values[before] * (1 - share) + values[after] * share

    def _place(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        grid = self.trajectory.t
        before = np.clip(np.searchsorted(grid, t, "right") - 1, 0, max(len(grid) - 2, 0))
        width = grid[np.minimum(before + 1, len(grid) - 1)] - grid[before]
        share = np.divide(t - grid[before], width, out=np.zeros(len(t)), where=width > 0)
        return before, np.clip(share, 0, 1)

    def turns(self, body: str, t: np.ndarray) -> np.ndarray:
        """Return the rotation matrices (n, 3, 3) of a body at times t (n,), body to world."""
        # q and -q are the same rotation. Signs are chosen so that neighbours are close; then linear
        # interpolation, normalised, follows the shorter turn between them.
        q = np.array(self.column(f"{body}.quaternion").values)
        flips = np.sign(np.einsum("ij,ij->i", q[1:], q[:-1]))
        q[1:] *= np.cumprod(np.where(flips < 0, -1.0, 1.0))[:, None]
        q = self.between(q, t)
        return quaternion_matrix(q / np.linalg.norm(q, axis=1, keepdims=True))

    def numbers(self, array: Any, t: np.ndarray) -> np.ndarray:
        """Return an array (...) of the scene as numbers (n, ...) at times t (n,), s.

        Its entries may be expressions of TIME, Inputs and Params, whose values are those of the
        trajectory, or else their default.
        """
        array = np.asarray(array)
        if array.dtype != object:
            return np.broadcast_to(array, (len(t), *array.shape))
        # All entries are evaluated for all times by one call, a column for each time.
        leaves = sorted(leaves_of(array), key=lambda leaf: leaf.name)
        function = ca.Function(
            "numbers", [leaf.expr for leaf in leaves], [ca.densify(to_expr(array.reshape(-1)))]
        )
        values = function(*(self._leaf(leaf, t)[None, :] for leaf in leaves))
        return np.array(ca.DM(values)).T.reshape(-1, *array.shape) * np.ones(
            (len(t), *[1] * array.ndim)
        )

    def _leaf(self, leaf: Leaf, t: np.ndarray) -> np.ndarray:
        if leaf is TIME:
            return t
        known = self.trajectory
        if leaf.name in known.columns or leaf.name in known.parameters:
            return self.at(leaf.name, t)
        return np.full(len(t), leaf.value)


@dataclass(frozen=True, eq=False)
class Places:
    """Frames over time: positions (n, k, 3), m, and rotations (n, k, 3, 3), frame to world."""

    p: np.ndarray
    R: np.ndarray


@dataclass(frozen=True, eq=False)
class Track:
    """What is drawn at n times: the bodies and connectors with show=True, and all loads.

    Fields:
        t: times (n,), s.
        boxes, edges, fills: frames at the boxes' centres, edges (b, 3), m, colours (b, 3).
        ends: joint frames at the connectors' markers, two of each: 0, 1, 0, 1, ...
        fixed: which of these are on the ground.
        diameters, colours: of the springs (c,), m, and (c, 3).
        active: whether each spring acts (n, c).
        arrows: (name, unit, tails (n, 3), vectors (n, 3)) of forces and torques, world axes.
        extent: largest side of all that is drawn, m.
        up: unit vector (3,) against gravity, or z without gravity, world axes.
        kinetic, potential: energies (n,), J, potential from its least value; None if not known.
    """

    t: np.ndarray
    boxes: Places
    edges: np.ndarray
    fills: np.ndarray
    ends: Places
    fixed: np.ndarray
    diameters: np.ndarray
    colours: np.ndarray
    active: np.ndarray
    arrows: tuple[tuple[str, str, np.ndarray, np.ndarray], ...]
    extent: float
    up: np.ndarray
    kinetic: np.ndarray | None
    potential: np.ndarray | None

    @property
    def points(self) -> np.ndarray:
        """Points (n, k, 3), m, that must be inside the picture."""
        p = corners(self.boxes.p, self.boxes.R, self.edges)
        reach = np.repeat(self.diameters, 2)[:, None] / 2
        return np.concatenate(
            [
                p.reshape(len(self.t), -1, 3),
                self.ends.p + reach,
                self.ends.p - reach,
                *(np.stack([tails, tips], 1) for _, tails, tips in self.shafts),
            ],
            axis=1,
        )

    @property
    def largest(self) -> dict[str, float]:
        """Largest force and torque by unit, to which the lengths of arrows are relative."""
        sizes = [(unit, float(np.linalg.norm(v, axis=1).max())) for _, unit, _, v in self.arrows]
        return {unit: max(size for u, size in sizes if u == unit) for unit, _ in sizes}

    @property
    def shafts(self) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Unit, tails and tips (n, 3) of the arrows."""
        longest = self.largest
        return [
            (unit, tails, tails + vectors * _ARROW * self.extent / longest[unit])
            for _, unit, tails, vectors in self.arrows
        ]


def track(drawing: Drawing, source: Source, t: np.ndarray) -> Track:
    """Return what is drawn at times t (n,), s.

    Arguments:
        drawing: the scene as it is drawn.
        source: the trajectory.
    """
    poses = {body.name: _pose(body.name, source, t) for body in drawing.bodies}
    poses[GROUND] = (np.zeros((len(t), 3)), np.broadcast_to(np.eye(3), (len(t), 3, 3)))
    bodies = [body for body in drawing.bodies if body.show]
    connectors = [c for c in drawing.connectors if c.show]
    # Bodies that are not drawn still have poses, since markers and loads may be attached to them.
    every = [
        _frame(m, j, poses, source, t)
        for c in connectors
        for m, j in zip(c.markers, c.turned, strict=True)
    ]
    ends = _places(every, len(t))
    boxes, edges = _boxes(bodies, poses, source, t)
    arrows = _arrows(drawing, poses, source, t)
    extent = _extent(boxes, edges, ends, [tails for _, _, tails, _ in arrows])
    # Sizes that the user did not give depend on the scene's size, which the other boxes determine.
    edges[edges.max(axis=1, initial=0) == 0] = _CUBE * extent
    edge_of = {body.name: float(np.median(edges[i])) for i, body in enumerate(bodies)}
    diameters = [
        c.diameter or min(_DIAMETER * extent, *(edge_of.get(m.body, np.inf) for m in c.markers))
        for c in connectors
    ]
    gravity = source.numbers(drawing.gravity, t)[0]
    size = float(np.linalg.norm(gravity))
    kinetic, potential = _energies(drawing, source, t)
    return Track(
        t,
        boxes,
        edges,
        np.array([b.color for b in bodies]).reshape(-1, 3),
        ends,
        np.array([m.body == GROUND for c in connectors for m in c.markers], bool),
        np.array(diameters, float),
        np.array([c.color for c in connectors]).reshape(-1, 3),
        source.numbers([c.active for c in connectors], t) > 0.5,
        arrows,
        extent,
        -gravity / size if size else np.array([0.0, 0.0, 1.0]),
        kinetic,
        potential,
    )


def _pose(body: str, source: Source, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return source.at(f"{body}.position", t), source.turns(body, t)


def _places(frames: list[tuple[np.ndarray, np.ndarray]], n: int) -> Places:
    if not frames:
        return Places(np.zeros((n, 0, 3)), np.zeros((n, 0, 3, 3)))
    return Places(np.stack([p for p, _ in frames], 1), np.stack([R for _, R in frames], 1))


def _matrix(source: Source, rotation: np.ndarray, t: np.ndarray) -> np.ndarray:
    values = source.numbers(rotation, t)
    return quaternion_matrix(values) if values.shape[1:] == (4,) else values


def _frame(
    marker: Marker, joint: np.ndarray, poses: dict[str, Any], source: Source, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the position (n, 3) of a marker and the axes (n, 3, 3) of a joint frame on it."""
    p, R = poses[marker.body]
    place = p + np.einsum("nij,nj->ni", R, source.numbers(marker.position, t))
    return place, R @ _matrix(source, marker.rotation, t) @ _matrix(source, joint, t)


def _boxes(
    bodies: list[BodyDrawing], poses: dict[str, Any], source: Source, t: np.ndarray
) -> tuple[Places, np.ndarray]:
    frames, edges = [], []
    for body in bodies:
        size, axes = body.size, np.eye(3)
        if size is None:
            mass = float(source.numbers(body.mass, t[:1])[0])
            size, axes = box_of_inertia(mass, source.numbers(body.inertia, t[:1])[0])
        p, R = poses[body.name]
        frames.append((p + np.einsum("nij,nj->ni", R, source.numbers(body.com, t)), R @ axes))
        edges.append(size)
    return _places(frames, len(t)), np.array(edges).reshape(-1, 3)


def _extent(boxes: Places, edges: np.ndarray, ends: Places, tails: list[np.ndarray]) -> float:
    p = corners(boxes.p, boxes.R, edges).reshape(-1, 3)
    everything = np.vstack([p, ends.p.reshape(-1, 3), *tails])
    return float(np.ptp(everything, axis=0).max()) or 1.0


def _arrows(
    drawing: Drawing, poses: dict[str, Any], source: Source, t: np.ndarray
) -> tuple[tuple[str, str, np.ndarray, np.ndarray], ...]:
    found = []
    for load in drawing.loads:
        tails, _ = _frame(load.marker, np.eye(3), poses, source, t)
        R = poses[load.marker.body if load.frame == "body" else GROUND][1]
        for unit, vector in (("N", load.force), ("N m", load.torque)):
            vectors = np.einsum("nij,nj->ni", R, source.numbers(vector, t))
            if np.isfinite(vectors).all() and vectors.any():
                found.append((load.name, unit, tails, vectors))
    return tuple(found)


def _energies(
    drawing: Drawing, source: Source, t: np.ndarray
) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return kinetic and potential energy (n,), J, or None if an output is not known."""
    # A minimal model may have left out a state that the energy needs, and a saved file may not hold
    # the columns; the picture is then drawn without the bar.
    try:
        total = source.column("energy").values
        each = [source.column(f"{body.name}.kinetic_energy").values for body in drawing.bodies]
    except ValueError:
        return None, None
    kinetic = np.sum(each, axis=0)
    # The zero of the potential is arbitrary; from its least value both parts of the bar are
    # positive.
    potential = total - kinetic
    potential = potential - potential.min()
    if not float(np.max(kinetic + potential)) > 0:
        return None, None
    return source.between(kinetic, t), source.between(potential, t)
