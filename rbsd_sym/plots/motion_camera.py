"""Perspective: points on the screen, which box is in front, which points are hidden."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

_FAR = 4.0  # distance of the eye from the centre, over the radius of what is shown
_SORTED_BY_PAIRS = 80  # boxes; beyond it they are sorted by distance


class Camera(NamedTuple):
    """An eye and the axes of its picture, world axes."""

    eye: np.ndarray
    right: np.ndarray
    above: np.ndarray
    ahead: np.ndarray

    def screen(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) on the screen (..., 2)."""
        way = points - self.eye
        depth = way @ self.ahead
        return np.stack([way @ self.right / depth, way @ self.above / depth], -1)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Distance (...) of points (..., 3) from the eye."""
        return np.linalg.norm(points - self.eye, axis=-1)


def level(up: np.ndarray) -> np.ndarray:
    """Axes (3, 3), columns: two level ones, near x and y where up is near z, and up."""
    near = np.eye(3)[0] if abs(up[0]) < 0.9 else np.eye(3)[1]
    first = near - (near @ up) * up
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(up, first), up])


def camera(points: np.ndarray, up: np.ndarray, elevation: float, azimuth: float) -> Camera:
    """A camera that sees all points (k, 3) from an elevation and an azimuth in degrees."""
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
    """Which points (k, 3) are inside or behind one of the boxes (k,)."""
    if not len(centres) or not len(points):
        return np.zeros(len(points), bool)
    start = np.einsum("bij,bi->bj", axes, eye - centres)[:, None, :]
    end = np.einsum("bij,bki->bkj", axes, points - centres[:, None, :])
    way = np.where(end == start, 1e-300, end - start)
    half = edges[:, None, :] / 2
    one, other = (-half - start) / way, (half - start) / way
    enters = np.minimum(one, other).max(axis=2)
    leaves = np.maximum(one, other).min(axis=2)
    return ((enters < leaves) & (enters < 1 - 1e-4) & (leaves > 0)).any(axis=0)


def back_to_front(
    eye: np.ndarray, centres: np.ndarray, axes: np.ndarray, edges: np.ndarray
) -> list[int]:
    """Order in which boxes are painted.

    Of two boxes the one on the eye's side of a plane between them is in front; the plane is
    parallel to a face of one of them, where they are furthest apart.
    """
    count = len(centres)
    distance = np.linalg.norm(centres - eye, axis=1)
    if not 1 < count <= _SORTED_BY_PAIRS:
        return [int(i) for i in np.argsort(-distance)]
    gap, in_front = _planes(eye, centres, axes, edges)
    over = np.where(gap >= gap.T, in_front, ~in_front.T)  # over[i, j]: j is painted after i
    over = np.triu(over, 1) | np.tril(~over.T, -1)
    order, rest = [], list(np.argsort(-distance))
    while rest:
        free = [i for i in rest if not over[rest, i].any()] or rest
        order.append(int(free[0]))
        rest.remove(free[0])
    return order


def _planes(
    eye: np.ndarray, centres: np.ndarray, axes: np.ndarray, edges: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Widest gap (B, B) along a face normal of box i, and whether j is on the eye's side of it."""
    half = edges / 2
    along = np.einsum("iak,ija->ijk", axes, centres[None, :, :] - centres[:, None, :])
    reach = np.einsum("ijkl,jl->ijk", np.abs(np.einsum("iak,jal->ijkl", axes, axes)), half)
    gap = np.abs(along) - half[:, None, :] - reach
    view = np.einsum("iak,ia->ik", axes, eye - centres)[:, None, :]
    in_front = np.sign(along) * view > half[:, None, :] + gap / 2
    best = gap.argmax(axis=2)[:, :, None]
    chosen = (np.take_along_axis(array, best, 2)[:, :, 0] for array in (gap, in_front))
    return next(chosen), next(chosen)
