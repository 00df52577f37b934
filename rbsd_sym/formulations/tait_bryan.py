"""Rotation by Tait-Bryan xyz angles: 12 states per body, singular at a pitch of 90 degrees."""

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
    """Formulation with Tait-Bryan xyz angles, R = Rx Ry Rz: every body has 12 states.

        rs.compile_scene(scene, formulation=rs.TaitBryan())

    The states are the position of the centre of mass (world, m), three angles a (rad), the velocity
    of the centre of mass (world, m/s) and the angular velocity (body axes, rad/s). There is one
    state fewer than with quaternions and no norm to preserve. The rates of the angles divide by
    cos(a_y): use it only for bodies whose pitch stays well below 90 degrees. All laws are
    available.
    """

    labels: ClassVar[tuple[tuple[str, str, str], ...]] = tuple(("a", axis, "rad") for axis in "xyz")
    kind: ClassVar[RotationKind] = RotationKind.tait_bryan

    def write(self, scene: Scene) -> Dae:
        """Return the scene as a `Dae` with states <body>.p_x ... a_x ... v_x ... w_z.

        Raises:
            ValueError: see `newton_euler.write`.
        """
        return newton_euler.write(scene, self, "tait_bryan")

    def start(self, R_WB: ca.SX, q_WB: ca.SX) -> ca.SX:
        """Return the start value of the coordinates: the angles (3, 1) of the rotation, rad."""
        return matrix_xyz(R_WB)

    def orientation(self, r: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return rotation matrix (3, 3) and unit quaternion (4, 1) of the angles."""
        return xyz_matrix(r), xyz_quat(r)

    def rate(self, r: ca.SX, w_WB_B: ca.SX) -> ca.SX:
        """Return the rates of the angles, rad/s; singular at a pitch of 90 degrees."""
        return xyz_rate(r, w_WB_B)
