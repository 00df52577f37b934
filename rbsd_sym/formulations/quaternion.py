"""Rotation by a unit quaternion: no singularity, 13 states per body."""

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
    """The default formulation: every body has 13 states and no singular orientation.

        rs.compile_scene(scene, formulation=rs.Quaternion())

    The states are the position of the centre of mass (world, m), a unit quaternion (body to world,
    scalar first), the velocity of the centre of mass (world, m/s) and the angular velocity (body
    axes, rad/s):

        p' = v,   q' = q (0, w) / 2,   m v' = f,   I w' + w x I w = tau

    Rotation matrices are divided by q.q, so that drift of the norm cannot change the dynamics. The
    norm itself is not corrected.
    """

    labels: ClassVar[tuple[tuple[str, str, str], ...]] = tuple(("q", axis, "") for axis in "wxyz")
    kind: ClassVar[RotationKind] = RotationKind.quaternion

    def write(self, scene: Scene) -> Dae:
        """Return the scene as a `Dae` with states <body>.p_x ... q_w ... v_x ... w_z.

        Raises:
            ValueError: see `newton_euler.write`.
        """
        return newton_euler.write(scene, self, "quaternion")

    def start(self, R_WB: ca.SX, q_WB: ca.SX) -> ca.SX:
        """Return the start value of the coordinates: the quaternion itself."""
        return q_WB

    def orientation(self, r: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return rotation matrix (3, 3) and quaternion (4, 1), which may have any norm."""
        return quat_matrix(r), r

    def rate(self, r: ca.SX, w_WB_B: ca.SX) -> ca.SX:
        """Return the rates of the coordinates, q' = q (0, w) / 2."""
        return quat_rate(r, w_WB_B)
