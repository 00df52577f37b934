"""A scene as it is drawn, and the shapes it is drawn with: boxes, springs, arrows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..scene.elements import Load, Marker, RigidBody, RigidBodySpringDamper
from ..scene.scene import Scene
from .style import COLOURS

FILLS = tuple(colour for colour in COLOURS if colour != "#000000")  # a black box has no shades
SPRING = "#333333"
INACTIVE = "#9A9A9A"
_THIN = 0.03  # least edge of a box over its longest, so that rods and discs are visible
_TURNS = 7  # of a spring
_POINTS = 12  # of one turn
_LEAD = 0.12  # straight part of a spring at each end, over its length


@dataclass(frozen=True, eq=False)
class BodyDrawing:
    """A body as it is drawn.

    Fields:
        mass, inertia, com: as in `RigidBody`, possibly symbolic.
        size: edges (3,) of its box, m; None for those that follow from mass and inertia.
        color: red, green, blue, 0 to 1.
    """

    name: str
    mass: Any
    inertia: np.ndarray
    com: np.ndarray
    size: np.ndarray | None
    color: tuple[float, ...]
    show: bool


@dataclass(frozen=True, eq=False)
class ConnectorDrawing:
    """A connector as it is drawn.

    Fields:
        turned: rotations of its joint frames to its markers, possibly symbolic.
        diameter: of the spring, m; None for one that follows from the scene's size.
        color: red, green, blue, 0 to 1.
    """

    name: str
    markers: tuple[Marker, Marker]
    turned: tuple[np.ndarray, np.ndarray]
    diameter: float | None
    color: tuple[float, ...]
    show: bool
    active: Any  # a bool, or a number that is on above 0.5


@dataclass(frozen=True, eq=False)
class Drawing:
    """A scene as it is drawn; a trajectory gives values to the symbols in its numbers.

    Raises:
        ValueError: nothing would be drawn.
    """

    name: str
    bodies: tuple[BodyDrawing, ...]
    connectors: tuple[ConnectorDrawing, ...]
    loads: tuple[Load, ...]
    gravity: np.ndarray

    def __post_init__(self) -> None:
        shown = [b.show for b in self.bodies] + [c.show for c in self.connectors]
        if not any(shown) and not self.loads:
            raise ValueError(
                f"scene '{self.name}': show=False everywhere; a picture needs something to show; "
                "set show=True on a body or a connector"
            )


def drawing_of(scene: Scene) -> Drawing:
    """Return a scene as it is drawn, with its drawing attributes checked.

    Raises:
        ValueError: a size, draw_size or color that cannot be drawn; nothing to draw.
    """
    bodies = tuple(_body(body, i) for i, body in enumerate(scene.bodies))
    connectors = tuple(_connector(connector) for connector in scene.connectors)
    return Drawing(scene.name, bodies, connectors, tuple(scene.loads), scene.gravity)


def _body(body: RigidBody, index: int) -> BodyDrawing:
    where = f"body '{body.name}'"
    size = None if body.size is None else _lengths(body.size, (3,), f"{where}, size")
    color = _colour(body.color, FILLS[index % len(FILLS)], where)
    return BodyDrawing(body.name, body.mass, body.inertia, body.com, size, color, body.show)


def _connector(c: RigidBodySpringDamper) -> ConnectorDrawing:
    where = f"connector '{c.name}'"
    diameter = c.draw_size
    if diameter is not None:
        diameter = float(_lengths(diameter, (), f"{where}, draw_size"))
    color = _colour(c.color, INACTIVE if c.idle else SPRING, where)
    turned = (c.rotation_marker0, c.rotation_marker1)
    return ConnectorDrawing(
        c.name, (c.marker0, c.marker1), turned, diameter, color, c.show, c.active
    )


def _lengths(value: Any, shape: tuple[int, ...], where: str) -> np.ndarray:
    rule = "three positive lengths (x, y, z) in m" if shape else "a positive length in m"
    try:
        array = np.array(value, float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != shape or not np.isfinite(array).all() or not (array > 0).all():
        raise ValueError(f"{where}: {value!r}; it is {rule}; give that, or leave it out")
    return array


def _colour(value: Any, default: str, where: str) -> tuple[float, ...]:
    from matplotlib.colors import to_rgb

    try:
        return to_rgb(default if value is None else value)
    except ValueError as error:
        raise ValueError(
            f"{where}, color: {value!r}; it is a colour of matplotlib; write '#0072B2' or 'tab:red'"
        ) from error


def box_of_inertia(mass: float, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges (3,), m, and axes (3, 3), box to body, of the cuboid of uniform density.

    A cuboid has the principal inertias I_1 = mass (a_2^2 + a_3^2) / 12 and so on in turn. Solved
    for its edges, a_1 = sqrt(6 (I_2 + I_3 - I_1) / mass) and so on. Edges are at least 3 % of the
    longest; without mass or inertia they are zero.

    Arguments:
        mass: kg.
        inertia: about the centre of mass, body axes (3, 3), kg m2.
    """
    # A diagonal inertia keeps the body's axes: an eigenvalue solver would sort them, and where two
    # inertias are equal it may return any axes.
    if np.any(inertia - np.diag(np.diag(inertia))):
        principal, axes = np.linalg.eigh(inertia)
        axes = axes * np.sign(np.linalg.det(axes))
    else:
        principal, axes = np.diag(inertia), np.eye(3)
    if mass <= 0:
        return np.zeros(3), np.eye(3)
    edges = np.sqrt(np.maximum(6 * (principal.sum() - 2 * principal) / mass, 0.0))
    return np.maximum(edges, _THIN * edges.max()), axes


def quaternion_matrix(q: np.ndarray) -> np.ndarray:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4), scalar first."""
    w, x, y, z = np.moveaxis(q, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


_SIGNS = np.array([[i, j, k] for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
FACES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
"""Corners of each face of a box, in the order -x, +x, -y, +y, -z, +z."""
NORMALS = np.repeat(np.eye(3), 2, axis=0) * np.tile([-1.0, 1.0], 3)[:, None]
"""Outward normals (6, 3) of these faces in the box's axes."""


def corners(centres: np.ndarray, axes: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return corners (..., 8, 3) of boxes.

    Arguments:
        centres: (..., 3), m.
        axes: (..., 3, 3), box to world.
        edges: (..., 3), m.
    """
    local = _SIGNS * (edges / 2)[..., None, :]
    return centres[..., None, :] + np.einsum("...ij,...kj->...ki", axes, local)


def spring(start: np.ndarray, end: np.ndarray, axis: np.ndarray, diameter: float) -> np.ndarray:
    """Return points (k, 3), m, of a helical spring.

    Arguments:
        start, end: of the spring (3,), m.
        axis: unit vector (3,); a spring without length is drawn as a ring about it.
        diameter: m.
    """
    # A little of the axis is mixed into the direction, so that a spring which passes through zero
    # length turns over smoothly instead of having no direction.
    along = end - start
    soft = 0.2 * diameter * (1 if along @ axis >= 0 else -1)
    direction = along + soft * axis
    direction = direction / np.linalg.norm(direction)
    first = np.cross(direction, _aside(direction, axis))
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    s = np.linspace(0, 1, _TURNS * _POINTS + 1)
    angle = 2 * np.pi * _TURNS * s[:, None]
    around = (np.cos(angle) * first + np.sin(angle) * second) * diameter / 2
    coil = start + (_LEAD + (1 - 2 * _LEAD) * s[:, None]) * along + around
    leads = start + _LEAD * along, end - _LEAD * along
    return np.vstack([start, leads[0], coil, leads[1], end])


def _aside(direction: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Return a vector that is not parallel to the direction, and turns with the axis."""
    # Rounding makes the choice the same while the direction changes a little, so the coil does not
    # jump about its axis from picture to picture.
    others = np.roll(axis, 1), np.roll(axis, 2)
    return min((axis, *others, *np.eye(3)), key=lambda v: round(abs(float(v @ direction)), 1))


def arrow_head(tail: np.ndarray, tip: np.ndarray, length: float) -> np.ndarray:
    """Return the triangle (3, 2) at the tip of an arrow, tip first; all are points on the screen.

    Arguments:
        length: of the head; it is never longer than the arrow.
    """
    along = tip - tail
    norm = float(np.linalg.norm(along))
    along = along / norm if norm > 0 else np.array([1.0, 0.0])
    side = np.array([-along[1], along[0]])
    back = tip - min(length, norm) * along
    half = 0.38 * min(length, norm)
    return np.array([tip, back + half * side, back - half * side])


def nice_step(length: float, cells: int = 8) -> float:
    """Return the step, 1, 2 or 5 times a power of ten, that cuts a length into about `cells`."""
    raw = length / cells
    power = 10.0 ** np.floor(np.log10(raw))
    steps: Sequence[float] = (1, 2, 5, 10)
    return float(power * min(steps, key=lambda step: abs(np.log(step * power / raw))))
