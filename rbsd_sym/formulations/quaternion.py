"""Rotation by a unit quaternion: no singularity, 13 states a body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from ..base.rotation import quat_matrix, quat_rate
from ..dae.dae import Dae
from ..dae.members import RotationKind
from ..scene.scene import Scene
from . import newton_euler


@dataclass(frozen=True)
class Quaternion:
    """Bodies by position, quaternion (scalar first), velocity, angular velocity (body axes).

    Rotation matrices divide by q.q, so that drift of the norm cannot change the dynamics.
    """

    labels: ClassVar[tuple[tuple[str, str, str], ...]] = tuple(("q", axis, "") for axis in "wxyz")
    kind: ClassVar[RotationKind] = RotationKind.quaternion

    def write(self, scene: Scene) -> Dae:
        """The scene as a `Dae` with states <body>.p_x ... q_w ... v_x ... w_z."""
        return newton_euler.write(scene, self, "quaternion")

    def start(self, R_WB: ca.SX, q_WB: ca.SX) -> ca.SX:
        """The quaternion."""
        return q_WB

    def orientation(self, r: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rotation matrix and the quaternion itself, of any norm."""
        return quat_matrix(r), r

    def rate(self, r: ca.SX, w_WB_B: ca.SX) -> ca.SX:
        """Q' = q (0, w) / 2."""
        return quat_rate(r, w_WB_B)
