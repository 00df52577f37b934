"""Perspective view: points on the screen, order of boxes, hidden points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_FAR = 4.0  # distance of the eye from the centre, over the radius of what is shown
_SORTED_BY_PAIRS = 80  # boxes, up to which they are sorted by pairs; more are sorted by distance


class Camera(NamedTuple):
    """The eye's position (3,), m, and unit vectors (3,) of its picture, all in world axes."""

    eye: np.ndarray
    right: np.ndarray
    above: np.ndarray
    ahead: np.ndarray

    def screen(self, points: np.ndarray) -> np.ndarray:
        """Return the place on the screen (..., 2) of points (..., 3) in front of the eye.

        The screen is at unit distance from the eye, so its coordinates have no unit.
        """
        ray = points - self.eye
        depth = ray @ self.ahead
        return np.stack([ray @ self.right / depth, ray @ self.above / depth], -1)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the distance (...) of points (..., 3) from the eye, m."""
        return np.linalg.norm(points - self.eye, axis=-1)


def level(up: np.ndarray) -> np.ndarray:
    """Return axes (3, 3) as columns: two horizontal ones and up, near x, y, z if up is near z."""
    near = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    first = near - (near @ up) * up
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(up, first), up])


def camera(points: np.ndarray, up: np.ndarray, elevation: float, azimuth: float) -> Camera:
    """Return a camera that sees all points (k, 3) from an elevation and an azimuth in degrees.

    Arguments:
        up: vertical unit vector (3,), world axes.
    """
    axes = level(up)
    local = points @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    radius = float(np.linalg.norm(high - low)) / 2 or 1.0
    a, b = np.radians(elevation), np.radians(azimuth)
    back = axes @ np.array([np.cos(a) * np.cos(b), np.cos(a) * np.sin(b), np.sin(a)])
    right = axes @ np.array([-np.sin(b), np.cos(b), 0.0])
    eye = axes @ ((low + high) / 2) + _FAR * radius * back
    return Camera(eye, right, np.cross(back, right), -back)


def hidden(
    eye: np.ndarray, points: np.ndarray, centres: np.ndarray, axes: np.ndarray, edges: np.ndarray
) -> np.ndarray:
    """Return which points (k, 3) are inside or behind one of the boxes (b,).

    Arguments:
        eye: position (3,), m.
        centres, axes, edges: of the boxes, (b, 3), (b, 3, 3) to world, (b, 3).
    """
    # The slab method: in a box's axes the ray from the eye (0) to a point (1) is between the two
    # planes of each pair of faces for an interval of its parameter. If the three intervals overlap,
    # the ray meets the box, and it hides the point if it is entered before the point. The margin
    # 1e-4 keeps points on a surface from being hidden by it, 1e-300 avoids a division by zero.
    if not len(centres) or not len(points):
        return np.zeros(len(points), bool)
    start = np.einsum("bij,bi->bj", axes, eye - centres)[:, None, :]
    end = np.einsum("bij,bki->bkj", axes, points - centres[:, None, :])
    ray = np.where(end == start, 1e-300, end - start)
    half = edges[:, None, :] / 2
    one, other = (-half - start) / ray, (half - start) / ray
    enters = np.minimum(one, other).max(axis=2)
    leaves = np.maximum(one, other).min(axis=2)
    return ((enters < leaves) & (enters < 1 - 1e-4) & (leaves > 0)).any(axis=0)


def back_to_front(
    eye: np.ndarray, centres: np.ndarray, axes: np.ndarray, edges: np.ndarray
) -> list[int]:
    """Return the order in which boxes are painted, those behind others first.

    Of two boxes, the one on the eye's side of a plane between them is in front. The plane is
    parallel to a face of one of them, chosen where they are furthest apart.

    Arguments:
        eye, centres, axes, edges: as in `hidden`.
    """
    count = len(centres)
    distance = np.linalg.norm(centres - eye, axis=1)
    if not 1 < count <= _SORTED_BY_PAIRS:
        return [int(i) for i in np.argsort(-distance)]
    gap, in_front = _planes(eye, centres, axes, edges)
    over = np.where(gap >= gap.T, in_front, ~in_front.T)  # over[i, j]: j is painted after i
    over = np.triu(over, 1) | np.tril(~over.T, -1)
    # Painted next is the furthest box that is not in front of any other one left; if boxes overlap
    # in a cycle, where there is none, simply the furthest.
    order, rest = [], list(np.argsort(-distance))
    while rest:
        free = [i for i in rest if not over[rest, i].any()] or rest
        order.append(int(free[0]))
        rest.remove(free[0])
    return order


def _planes(
    eye: np.ndarray, centres: np.ndarray, axes: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the widest gap (b, b) along a face normal of box i, and if the eye is on j's side.

    A negative gap means that the boxes overlap along all three normals.
    """
    # along[i, j, k]: from centre i to centre j along normal k of box i; reach: half the extent of
    # box j in that direction; view: place of the eye in the axes of box i.
    half = edges / 2
    along = np.einsum("iak,ija->ijk", axes, centres[None, :, :] - centres[:, None, :])
    reach = np.einsum("ijkl,jl->ijk", np.abs(np.einsum("iak,jal->ijkl", axes, axes)), half)
    gap = np.abs(along) - half[:, None, :] - reach
    view = np.einsum("iak,ia->ik", axes, eye - centres)[:, None, :]
    in_front = np.sign(along) * view > half[:, None, :] + gap / 2
    best = gap.argmax(axis=2)[:, :, None]
    chosen = (np.take_along_axis(array, best, 2)[:, :, 0] for array in (gap, in_front))
    return next(chosen), next(chosen)
