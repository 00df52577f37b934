"""Scenes and problems of the tests of optimal control."""

from __future__ import annotations

from typing import Any

import numpy as np
from paths import MODELS

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file
from rbsd_sym.ocp import Solution

from .small import GROUND, column

SLEW = load_model_file(MODELS / "flexible_slew.py")
TURN = load_model_file(MODELS / "reorientation.py")
# [Wie, Sinha, Liu 1993], two masses and a spring, in more digits than published there.
SLEW_TIME = 4.2178665104510231598
SWITCHES = np.array([1.002678430378163679, 2.1089332552255115799, 3.2151880800728594808])
SLEW_EFFORT = 0.2973110416781024533
# [Bilimoria, Wie 1993], half a turn.
TURN_TIME = 3.243083277452
EIGENAXIS = 2 * np.sqrt(np.pi)
FORCE = rs.Input("force", "N")


def cart(**kwargs: Any) -> rs.Scene:
    """1 kg on a line, pushed by an Input: x'' = u."""
    body = rs.RigidBody("cart", 1.0, (1, 1, 1), **kwargs)
    return rs.Scene("cart", [body], [], [rs.Load("push", rs.Marker("cart"), force=(FORCE, 0, 0))])


def oscillator(stiffness: Any = 4.0) -> rs.Scene:
    """1 kg on a spring along x, pushed by an Input."""
    body = rs.RigidBody("cart", 1.0, (1, 1, 1), position=(0.5, 0, 0))
    spring = rs.RigidBodySpringDamper("spring", GROUND, rs.Marker("cart"),
                                      (stiffness, 0, 0, 0, 0, 0))  # fmt: skip
    return rs.Scene("oscillator", [body], [spring],
                    [rs.Load("push", rs.Marker("cart"), force=(FORCE, 0, 0))])  # fmt: skip


def massless_slew() -> rs.Scene:
    """The two masses of the slew with a massless joint in the middle of the rod."""
    bodies = [rs.RigidBody("hub", 1, (1, 1, 1)), rs.RigidBody("mid", 0, 0, position=(0.5, 0, 0)),
              rs.RigidBody("tip", 1, (1, 1, 1), position=(1, 0, 0))]  # fmt: skip
    rods = [
        rs.RigidBodySpringDamper(name, rs.Marker(a), rs.Marker(b), (2, 1, 1, 1, 1, 1),
                                 offset=(0.5, 0, 0, 0, 0, 0))
        for name, a, b in (("near", "hub", "mid"), ("far", "mid", "tip"))
    ]  # fmt: skip
    load = rs.Load("motor", rs.Marker("hub"), force=(SLEW.PUSH, 0, 0))
    return rs.Scene("massless_slew", bodies, rods, [load])


def pressed_column() -> rs.Scene:
    """The upright bar on a weak hinge that gives, pushed along its axis."""
    push = rs.Load("push", rs.Marker("bar"), force=(0, 0, FORCE))
    return column(support=1e4, loads=[push])


def hinged(law: Any = None) -> rs.Scene:
    """A body on a connector with a Param, Consistent by default, and a torque: nonlinear."""
    soft = rs.Param("soft", 3.0, "N m/rad")
    body = rs.RigidBody("body", 1.3, (1, 1.5, 2), position=(0.2, 0.1, 0))
    joint = rs.RigidBodySpringDamper(
        "joint", GROUND, rs.Marker("body", (-0.2, -0.1, 0)), [50, 60, 70, soft, 4, 5], [1] * 6,
        law=law or rs.Consistent(),
    )  # fmt: skip
    torque = rs.Load("motor", rs.Marker("body"), torque=(FORCE, FORCE * 0.5, 0), frame="body")
    return rs.Scene("hinged", [body], [joint], [torque])


def flies(found: Solution) -> bool:
    """IDAS follows the plan within the sum of the errors of its intervals.

    The factor is room for their growth: none of these motions lets a disturbance grow, but in
    proportion to time.
    """
    assert found.flown is not None
    return found.flown.difference < 3 * float(found.interval_errors.sum()) + 1e-9
