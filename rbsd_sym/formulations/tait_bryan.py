"""Rotation by Tait-Bryan xyz angles: 12 states a body, singular at a pitch of 90 degrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from ..base.rotation import matrix_xyz, xyz_matrix, xyz_quat, xyz_rate
from ..dae.dae import Dae
from ..dae.members import RotationKind
from ..scene.scene import Scene
from . import newton_euler


@dataclass(frozen=True)
class TaitBryan:
    """Bodies by position, xyz angles (R = Rx Ry Rz), velocity, angular velocity (body axes).

    One state fewer than the quaternion and no norm to keep; not for bodies that turn about their y
    axis by 90 degrees.
    """

    labels: ClassVar[tuple[tuple[str, str, str], ...]] = tuple(("a", axis, "rad") for axis in "xyz")
    kind: ClassVar[RotationKind] = RotationKind.tait_bryan

    def write(self, scene: Scene) -> Dae:
        """The scene as a `Dae` with states <body>.p_x ... a_x ... v_x ... w_z."""
        return newton_euler.write(scene, self, "tait_bryan")

    def start(self, R_WB: ca.SX, q_WB: ca.SX) -> ca.SX:
        """The angles of the rotation matrix."""
        return matrix_xyz(R_WB)

    def orientation(self, r: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Rotation matrix and unit quaternion of the angles."""
        return xyz_matrix(r), xyz_quat(r)

    def rate(self, r: ca.SX, w_WB_B: ca.SX) -> ca.SX:
        """Rates of the angles."""
        return xyz_rate(r, w_WB_B)
