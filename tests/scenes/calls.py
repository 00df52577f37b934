"""Dampers described by tables and by Functions that CasADi calls instead of inlining them.

Each has a second form for numbers, by `np.interp` or in closed form, which knows nothing of CasADi.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

import rbsd_sym as rs

MASS, STIFFNESS, START, T_END = 20.0, 9e3, 0.04, 0.6
SPEEDS = [-1.2, -0.4, -0.06, 0.0, 0.06, 0.4, 1.2]
FORCES = [-700.0, -520.0, -210.0, 0.0, 330.0, 900.0, 1300.0]
GRID = list(np.linspace(-1.5, 1.5, 7))


class Doubled(ca.Callback):
    """A Python function of one number that CasADi knows nothing of but how to call it."""

    def __init__(self, name: str, options: dict[str, Any], factor: float = 400.0) -> None:
        ca.Callback.__init__(self)
        self.factor = factor
        self.construct(name, options)

    def eval(self, arguments: Any) -> list[ca.DM]:
        return [self.factor * arguments[0]]


def piecewise(v: float) -> float:
    """`SPEEDS` and `FORCES`, linear between, and beyond as in the last interval."""
    at = int(np.clip(np.searchsorted(SPEEDS, v) - 1, 0, len(SPEEDS) - 2))
    slope = (FORCES[at + 1] - FORCES[at]) / (SPEEDS[at + 1] - SPEEDS[at])
    return FORCES[at] + slope * (v - SPEEDS[at])


def _cubic(v: Any) -> Any:
    return 150 * v**3 + 220 * v


S, PAIR, THREE = ca.SX.sym("s"), ca.MX.sym("pair", 2), ca.SX.sym("three", 3)
NEVER = {"never_inline": True}
CURVE = ca.interpolant("curve", "linear", [SPEEDS], FORCES)
TWO = [f * (1 + 0.5 * g) for f in FORCES for g in GRID]  # the first argument varies fastest
PLANE = ca.interpolant("plane", "linear", [GRID, SPEEDS], TWO)
SMOOTH = ca.interpolant("smooth", "bspline", [GRID], [_cubic(g) for g in GRID])
SURFACE = ca.interpolant(
    "surface", "bspline", [GRID, GRID], [_cubic(b) * (1 + a * a) for b in GRID for a in GRID]
)
SQUARE = ca.Function("square", [S], [2500 * S * ca.fabs(S)], NEVER)
INSIDE = ca.Function("inside", [PAIR], [PAIR[0] ** 2 * 300 + CURVE(PAIR[1])], NEVER)
SEVERAL = ca.Function("several", [THREE], [ca.norm_2(THREE), 800 * THREE[1:]], NEVER)
CHOICE = ca.Function.if_else("choice", SQUARE, ca.Function("none", [S], [50 * S]), NEVER)
MAPPED = ca.Function("twice", [PAIR], [CURVE.map(2)(PAIR.T)], NEVER)
CALLBACK = Doubled("doubled", {"enable_fd": True})

Damper = Callable[[Any, Any], Any]
# By name: what the user's force returns for travel u and speed v, and the same in numpy.
CASES: dict[str, tuple[Damper, Damper]] = {
    "table": (lambda u, v: CURVE(v), lambda u, v: piecewise(v)),
    "table of two": (lambda u, v: PLANE(_column(u, v)),
                     lambda u, v: piecewise(v) * (1 + 0.5 * u)),
    "spline": (lambda u, v: SMOOTH(v), lambda u, v: _cubic(v)),
    "spline of two": (lambda u, v: SURFACE(_column(u, v)), lambda u, v: _cubic(v) * (1 + u * u)),
    "never inlined": (lambda u, v: SQUARE(v), lambda u, v: 2500 * v * abs(v)),
    "MX never inlined": (lambda u, v: INSIDE(_column(u, v)),
                         lambda u, v: 300 * u * u + piecewise(v)),
    "one of several results": (lambda u, v: SEVERAL(ca.vertcat(u.expr, 0, v.expr))[1][1],
                               lambda u, v: 800 * v),
    "call of a call": (lambda u, v: SQUARE(CURVE(v) / 1000), lambda u, v: 2500 * piecewise(v) *
                       abs(piecewise(v)) / 1e6),
    "choice of Functions": (lambda u, v: CHOICE(v.expr > 0, v),
                            lambda u, v: 2500 * v * v if v > 0 else 50 * v),
    "map": (lambda u, v: ca.sum2(MAPPED(_column(u, v))),
            lambda u, v: piecewise(u) + piecewise(v)),
    "Callback": (lambda u, v: CALLBACK(v), lambda u, v: 400 * v),
    "short circuit": (lambda u, v: ca.if_else(v.expr > 0, 700 * v.expr, CURVE(v), True),
                      lambda u, v: 700 * v if v > 0 else piecewise(v)),
    "conditional": (lambda u, v: ca.conditional(v.expr > 0, [90 * v.expr], CURVE(v)),
                    lambda u, v: piecewise(v) if v > 0 else 90 * v),
    "pw_lin": (lambda u, v: ca.pw_lin(v.expr, ca.DM(SPEEDS), ca.DM(FORCES)),
               lambda u, v: piecewise(v)),
}  # fmt: skip


def _column(*numbers: Any) -> ca.SX:
    return ca.vertcat(*(number.expr for number in numbers))


def shock(damper: Damper) -> rs.Scene:
    """A body that moves along z on a spring and the damper; nothing acts in other directions."""

    def force(mbs: Any, t: Any, item: Any, u: Any, r: Any, v: Any, w: Any, *rest: Any) -> list[Any]:
        return [0, 0, STIFFNESS * u[2] + damper(u[2], v[2]), 0, 0, 0]

    body = rs.RigidBody("body", MASS, (1, 1.2, 1.4), position=(0, 0, START))
    ends = rs.Marker(rs.GROUND), rs.Marker("body")
    return rs.Scene("shock", [body], [rs.RigidBodySpringDamper("strut", *ends, 0, force=force)])


def pair(damper: Damper, count: int = 2, **options: Any) -> rs.Model:
    """Free bodies in a row whose connectors call the damper along every axis."""
    def force(mbs: Any, t: Any, item: Any, u: Any, r: Any, v: Any, w: Any, *rest: Any) -> list[Any]:
        forces = [900 * u[i] + damper(u[i], v[i]) for i in range(3)]
        return forces + [9 * r[i] + 0.1 * damper(r[i], w[i]) for i in range(3)]

    bodies = [rs.RigidBody(f"b{i}", 3 + i, (1, 1.2, 1.4), position=(0.3 * i, 0.02, 0.05 * i))
              for i in range(count)]  # fmt: skip
    joints = [
        rs.RigidBodySpringDamper(f"j{i}", rs.Marker(f"b{i}", (0.1, 0.05, 0)),
                                 rs.Marker(f"b{i + 1}", (0, 0, 0.1)), 0, force=force)
        for i in range(count - 1)
    ]  # fmt: skip
    return rs.compile_scene(rs.Scene("pair", bodies, joints), **options)
