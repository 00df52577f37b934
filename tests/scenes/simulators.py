"""Models for the tests of simulators and compiled functions, and the methods to export."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

import rbsd_sym as rs

from . import driven as line
from . import small

DOP, ROS, ERK = rs.Dop853(), rs.Rosenbrock(), rs.ExplicitRK()


@cache
def driven() -> rs.Model:
    """An oscillator with input `pull` and parameter `k`."""
    return line.oscillator(rs.Input("pull", "N"), rs.Param("k", line.K, "N/m"))


@cache
def hub(layout: str = "flat") -> rs.Model:
    """Two bodies in space, with an input, a parameter, and time."""
    return rs.compile_scene(small.star(1), layout=layout)


def on_ground(name: str, body: rs.RigidBody, *K_and_D: Any, **options: Any) -> rs.Model:
    """The model of one body on one connector."""
    loads, gravity = options.pop("loads", ()), options.pop("gravity", (0, 0, 0))
    ends = rs.Marker(rs.GROUND), rs.Marker(body.name, options.pop("at", (0, 0, 0)))
    joint = rs.RigidBodySpringDamper("c", *ends, *K_and_D, **options)
    return rs.compile_scene(rs.Scene(name, [body], [joint], loads, gravity=gravity))


@cache
def servo() -> rs.Model:
    """A body that turns and moves in a plane; one offset is an input, one moves with time."""
    body = rs.RigidBody("b", 1.5, (0.1, 0.2, 0.3), velocity=(0.2, 0, 0))
    offset = [rs.Input("place", "m"), 0.1 * np.sin(3 * rs.TIME), 0, 0, 0, 0]
    K_and_D = [90, 60, 50, 3, 3, 3], [2, 2, 2, 0.1, 0.1, 0.1]
    return on_ground("servo", body, *K_and_D, offset=offset, at=(0.2, 0.1, 0), gravity=(0, -1, 0))


@cache
def kelvin() -> rs.Model:
    """c x' = F - k x without mass: one state and one unknown, the velocity."""
    body, pull = rs.RigidBody("a", 0, 0, position=(0.4, 0, 0)), (12.0, 0, 0)
    loads = [rs.Load("pull", rs.Marker("a"), force=pull)]
    return on_ground("kelvin", body, [80] + [90] * 5, [6] * 6, loads=loads)


@cache
def doomed() -> rs.Model:
    """x'' = 2 x^3, so that x = 1 / (1 - t)."""
    body = rs.RigidBody("b", 1.0, [1, 1, 1], position=[1, 0, 0], velocity=[1, 0, 0])
    return on_ground("doomed", body, 0, force=small.blow_up)


def free(x0: Any, k: Any = 0.0) -> rs.Model:
    """A body that flies along x; what holds it across is never felt."""
    body = rs.RigidBody("b", 1.0, [1, 1, 1], position=[x0, 0, 0], velocity=[1, 0, 0])
    return on_ground("free", body, [0, k, 0, 0, 0, 0])
