"""A 120 kg engine block on four inclined rubber mounts, shaken by an unbalance force."""

import math

import numpy as np

import rbsd_sym as rs

T_END = 1.0
COLUMNS = ("engine.displacement", "front_left.force_local", "shake")
INPUTS = {"shake": lambda t: 400.0 * np.sin(2 * math.pi * 12.0 * t)}


def _inclined(angle: float) -> list[list[float]]:
    """Return a mount frame rotated about the vehicle's long axis x; z points to the block."""
    c, s = math.cos(angle), math.sin(angle)
    return [[1, 0, 0], [0, c, -s], [0, s, c]]


def scene() -> rs.Scene:
    """Return the engine on mounts below its corners; `mount_stiffness` (N/m along z) is a Param."""
    stiffness = rs.Param("mount_stiffness", 1.8e5, "N/m")
    shake = rs.Input("shake", "N")
    engine = rs.RigidBody(
        "engine",
        mass=120,
        # Ixx, Iyy, Izz, Iyz, Ixz, Ixy about the centre of mass, kg m2.
        inertia=(4.5, 9.0, 8.0, 0.3, -0.6, 0.2),
        com=(0.02, 0.0, 0.05),
        size=(0.7, 0.5, 0.55),
    )
    mounts = []
    for name, x, y in (
        ("front_left", 0.3, 0.25),
        ("front_right", 0.3, -0.25),
        ("rear_left", -0.3, 0.25),
        ("rear_right", -0.3, -0.25),
    ):
        mounts.append(
            rs.RigidBodySpringDamper(
                name,
                rs.Marker(rs.GROUND, (x, y, -0.25)),
                rs.Marker("engine", (x, y, -0.25)),
                # Rubber is softer in shear than in compression. Rotation matters little here: the
                # distance of the mounts resists it.
                stiffness=[0.4 * stiffness, 0.4 * stiffness, stiffness, 120, 120, 60],
                damping=(350, 350, 900, 1, 1, 1),
                rotation_marker0=_inclined(math.copysign(math.radians(35), y)),
                rotation_marker1=_inclined(math.copysign(math.radians(35), y)),
                law=rs.Consistent(),
                draw_size=0.06,
            )
        )
    pulley = rs.Marker("engine", (0.1, 0, 0.1))
    unbalance = rs.Load("unbalance", pulley, force=(0, 0.3 * shake, shake))
    return rs.Scene("engine_mounts", [engine], mounts, [unbalance], gravity=(0, 0, -9.81))
