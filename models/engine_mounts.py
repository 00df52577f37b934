"""A 120 kg engine block on four inclined rubber mounts, shaken by an unbalance force."""

import math

import numpy as np

import rbsd_sym as rs

T_END = 1.0
COLUMNS = ("engine.displacement", "front_left.force_local", "shake")
INPUTS = {"shake": lambda t: 400.0 * np.sin(2 * math.pi * 12.0 * t)}


def _inclined(angle: float) -> list[list[float]]:
    """Mount frame turned about the vehicle's long axis (x), so that its z points to the block."""
    c, s = math.cos(angle), math.sin(angle)
    return [[1, 0, 0], [0, c, -s], [0, s, c]]


def scene() -> rs.Scene:
    """Mounts at the corners below the block; the stiffness of rubber along z is a parameter."""
    stiffness = rs.Param("mount_stiffness", 1.8e5, "N/m")
    shake = rs.Input("shake", "N")
    engine = rs.RigidBody(
        "engine",
        mass=120,
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
