"""An upright body on a vibrating hinge: vibrating fast enough, it stays upright [Kapitza 1951]."""

import numpy as np

import rbsd_sym as rs

# Distance from the hinge to the centre of mass, m.
LENGTH = 0.5
T_END = 1.0
COLUMNS = ("body.position", "pivot.force_local")


def scene() -> rs.Scene:
    """Return the pendulum: 1 kg, 1 m high, on a hinge driven up and down.

    The Params `amplitude` (m) and `frequency` (Hz) describe the drive. The hinge is elastic; its
    natural frequency is 30 times that of the drive, so that it follows to 0.1 %. Without the drive
    gravity topples the body at a rate of 3.8 1/s.
    """
    amplitude = rs.Param("amplitude", 0.1, "m")
    frequency = rs.Param("frequency", 20.0, "Hz")
    w = 2 * np.pi * frequency
    # For 1 kg: a natural frequency of 30 w and a damping ratio of 0.1.
    k, d = (30 * w) ** 2, 6 * w
    body = rs.RigidBody(
        "body", 1.0, (1 / 12, 1 / 12, 1e-3), position=(0, 0, LENGTH), size=(0.05, 0.05, 1)
    )
    pivot = rs.RigidBodySpringDamper(
        "pivot",
        rs.Marker(rs.GROUND),
        rs.Marker("body", (0, 0, -LENGTH)),
        stiffness=(k, k, k, 0, 0, 1),
        damping=(d, d, d, 0.02, 0.02, 0.02),
        offset=(0, 0, amplitude * np.sin(w * rs.TIME), 0, 0, 0),
    )
    return rs.Scene("kapitza", [body], [pivot], gravity=(0, 0, -9.81))


# What `python -m rbsd_sym stability models/kapitza.py` maps: both axes, and the drive's period.
STABILITY = {
    "x": {"frequency": np.linspace(5, 30, 14)},
    "y": {"amplitude": np.linspace(0.01, 0.36, 15)},
    "period": lambda point: 1 / point["frequency"],
}
