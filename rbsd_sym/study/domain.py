"""Where a motion leaves the range of angles in which its laws and coordinates are unique."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..dae.members import RotationKind
from ..laws import Standard
from ..model.model import Model
from ..model.trajectory import Trajectory
from ..model.values import as_model
from ..scene.scene import Scene
from .table import ResultTable

_MARGIN = 5.0  # deg: angles that came this close to their limit are reported
_VECTOR = "turn the joint frames so that rest is at zero, or keep the angle below 180 deg"
_PITCH = "use law=Consistent(), or turn the joint frame so that the hinge axis is its z"
_BODY = "use formulation=Quaternion()"


class _Limit(NamedTuple):
    """Size (n,) of an angle, its limit, both rad, and after which points (n - 1,) it jumped."""

    where: str
    angle: str
    size: np.ndarray
    limit: float
    jumped: np.ndarray
    remedy: str


def domain(model: Model, trajectory: Trajectory, margin: float = _MARGIN) -> ResultTable:
    """Return the angles of connectors and bodies that came near a limit, or passed it.

    The rotation vector of `Intrinsic` and `Consistent` jumps at 180 degrees. `Standard` measures
    Tait-Bryan angles: their pitch is singular at 90 degrees, their roll and yaw jump at 180. Bodies
    in `TaitBryan` coordinates are singular at a pitch of 90 degrees. A jump is detected between two
    saved points, and its time interpolated linearly, so save often enough that nothing turns by
    more than about 90 degrees in between.

    >>> print(rs.study.domain(model, trajectory))

    Arguments:
        model: compiled from a scene.
        trajectory: of this model.
        margin: deg; angles that stayed further away from their limit are left out.

    Returns:
        A table with a row for each angle: where, angle, limit (deg), nearest (deg), t (s) of the
        nearest value or of the first passage, crossed, and remedy.

    Raises:
        ValueError: the model was not compiled from a scene.
    """
    as_model(model, "domain")
    rows = [
        row
        for limit in _limits(model, trajectory)
        if (row := _row(limit, trajectory.t))[3] >= row[2] - margin
    ]
    columns = ("where", "angle", "limit", "nearest", "t", "crossed", "remedy")
    return ResultTable(columns, ("", "", "deg", "deg", "s", "", ""), tuple(rows))


def _limits(model: Model, trajectory: Trajectory) -> list[_Limit]:
    if not isinstance(model.scene, Scene):
        raise ValueError(
            f"model '{model.name}': it does not carry its scene; compile it with "
            "compile_scene(scene)"
        )
    found: list[_Limit] = []
    for connector in model.scene.connectors:
        if connector.acts:
            where = f"connector '{connector.name}', {type(connector.law).__name__}"
            angles = trajectory[f"{connector.name}.rotation"]
            limits_of = _of_angles if isinstance(connector.law, Standard) else _of_vector
            found += limits_of(where, angles)
    expansion = model.dae.expansion
    labels = expansion.labels if expansion else model.x_labels
    for rotation in model.dae.rotations:
        kept = expansion is None or expansion.rows[rotation.coordinates[1]] is not None
        if rotation.kind is RotationKind.tait_bryan and kept:
            # These angles are states, which grow beyond 90 degrees without wrapping. So the pitch
            # is folded back at 90 degrees, and passing that value counts as a jump, too.
            a = np.column_stack([trajectory[labels[row].name] for row in rotation.coordinates])
            turn = np.abs(np.diff(a[:, [0, 2]], axis=0))
            size = np.pi / 2 - np.abs(np.abs(a[:, 1]) - np.pi / 2)
            jumped = (turn > np.pi / 2).all(axis=1) | (np.diff(np.abs(a[:, 1]) > np.pi / 2) != 0)
            where = f"body '{rotation.owner}', TaitBryan"
            found.append(_Limit(where, "pitch", size, np.pi / 2, jumped, _BODY))
    return found


def _of_vector(where: str, rotation: np.ndarray) -> list[_Limit]:
    # Beyond 180 degrees the vector continues from the opposite side, a jump of nearly 2 pi; half of
    # that separates it from a turn between two points.
    jumped = np.linalg.norm(np.diff(rotation, axis=0), axis=1) > np.pi
    size = np.linalg.norm(rotation, axis=1)
    return [_Limit(where, "rotation", size, np.pi, jumped, _VECTOR)]


def _of_angles(where: str, rotation: np.ndarray) -> list[_Limit]:
    # Where the pitch passes 90 degrees, roll and yaw both jump by pi. Where one of these alone
    # passes 180 degrees, it jumps by 2 pi. Thresholds lie half way to the next smaller case.
    turn, size = np.abs(np.diff(rotation, axis=0)), np.abs(rotation)
    over = (turn[:, 0] > np.pi / 2) & (turn[:, 2] > np.pi / 2)
    limits = [_Limit(where, "pitch", size[:, 1], np.pi / 2, over, _PITCH)]
    for i, name in ((0, "roll"), (2, "yaw")):
        wrapped = (turn[:, i] > 3 * np.pi / 2) & ~over
        limits.append(_Limit(where, name, size[:, i], np.pi, wrapped, _VECTOR))
    return limits


def _row(limit: _Limit, t: np.ndarray) -> tuple[Any, ...]:
    crossed = bool(limit.jumped.any())
    # The time of a passage is interpolated by the distances from the limit before and after it.
    if crossed:
        i = int(np.argmax(limit.jumped))
        before, after = (max(limit.limit - size, 0.0) for size in limit.size[i : i + 2])
        share = before / (before + after) if before + after > 0 else 0.5
        nearest, at = limit.limit, t[i] + share * (t[i + 1] - t[i])
    else:
        i = int(np.argmax(limit.size))
        nearest, at = limit.size[i], t[i]
    degrees = (float(np.rad2deg(value)) for value in (limit.limit, nearest))
    return (limit.where, limit.angle, *degrees, float(at), crossed, limit.remedy)
