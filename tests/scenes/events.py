"""Scenes and runs of the tests of events: a ball, a swing, marks over methods, a limit of time.

Free flight is a polynomial, which every method integrates exactly: its times are good to rounding,
and 1e-10 has room for the search. Where a spring or an input sets the error, methods run at rtol
1e-12.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest

import rbsd_sym as rs

EXACT = 1e-10
G = 9.81
METHODS = {
    "idas": rs.Idas(), "rosenbrock": rs.Rosenbrock(), "explicit": rs.ExplicitRK(),
    "dop853": rs.Dop853(),
}  # fmt: skip
TIGHT = {
    "idas": rs.Idas(1e-12, 1e-14), "rosenbrock": rs.Rosenbrock(1e-12, 1e-14),
    "explicit": rs.ExplicitRK(1e-12, 1e-14), "dop853": rs.Dop853(1e-12, 1e-14),
}  # fmt: skip
CASADI = ("rosenbrock", "explicit")


@pytest.fixture(autouse=True)
def within_seconds() -> Iterator[None]:
    """A run that hangs is a failure."""

    def stop(*_: Any) -> None:
        raise TimeoutError("still running after 20 s")

    if hasattr(signal, "SIGALRM"):
        signal.signal(signal.SIGALRM, stop)
        signal.alarm(20)
    yield
    if hasattr(signal, "SIGALRM"):
        signal.alarm(0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)


class Seen(NamedTuple):
    """What a user function of events looks at."""

    t: Any
    data: Any
    u: Any
    th: Any
    v: Any
    w: Any


def watch(function: Callable[[Seen], Any]) -> Callable[..., Any]:
    """A function of `Seen` as a connector's `events`."""
    return lambda mbs, t, item, data, u, th, v, w, *rest: function(Seen(t, data, u, th, v, w))


def body(name: str = "b", **given: Any) -> rs.RigidBody:
    return rs.RigidBody(name, **({"mass": 1.0, "inertia": (1.0, 1.2, 1.4)} | given))


def joint(name: str = "c", marker: Any = "b", function: Any = None, **given: Any) -> Any:
    """A connector from the ground, without spring, with events of `Seen`."""
    given |= {"events": watch(function)} if function else {}
    ends = {"marker0": rs.Marker(rs.GROUND), "marker1": rs.Marker(marker), "stiffness": 0}
    return rs.RigidBodySpringDamper(name, **(ends | given))


def ball(function: Any = None, height: float = 1.0, speed: float = 0.0, gravity: Any = G,
         **connector: Any) -> rs.Model:  # fmt: skip
    """A body in free flight along z."""
    bodies = [body(position=(0, 0, height), velocity=(0, 0, speed))]
    joints = [joint(function=function, **connector)]
    return rs.compile_scene(rs.Scene("ball", bodies, joints, gravity=(0, 0, -gravity)))


def swing(function: Any, x: float = 0.0, v: float = 1.0, k: float = 1.0, **rest: Any) -> rs.Model:
    """A mass on a spring along x."""
    spring = joint(function=function, stiffness=[k, 0, 0, 0, 0, 0], **rest)
    scene = rs.Scene("swing", [body(position=(x, 0, 0), velocity=(v, 0, 0))], [spring])
    return rs.compile_scene(scene, minimal=False)


def dropped(*effects: Any, **more: Any) -> rs.Model:
    """1 kg at 0.1 m above a floor."""
    ball = rs.RigidBody("ball", 1, (0.1, 0.1, 0.1), position=(0, 0, 0.1))
    floor = rs.RigidBodySpringDamper(
        "floor", rs.Marker(rs.GROUND), rs.Marker("ball"), 0, effects=effects, **more
    )
    return rs.compile_scene(rs.Scene("drop", [ball], [floor], gravity=(0, 0, -9.81)))


@cache
def bouncing() -> rs.Model:
    """A ball with a user's impulse where it meets the floor, with Params g and e."""
    e = rs.Param("e", 0.8)
    return ball(
        lambda s: [rs.Event(s.u[2], impulse=[0, 0, (1 + e) * s.v[2], 0, 0, 0])],
        gravity=rs.Param("g", G, "m/s2"),
    )  # fmt: skip


def run(model: rs.Model, times: Any, method: str, among: Any = METHODS, **rest: Any) -> Any:
    return rs.simulate(model, times, among[method], throw=False, **rest)


def times_of(trajectory: rs.Trajectory) -> np.ndarray:
    return np.array([t for t, _ in trajectory.events])


def names_of(trajectory: rs.Trajectory) -> list[str]:
    return [name.split(".")[1] for _, name in trajectory.events]


def by_method(*fails: str, why: str = "", among: Any = tuple(METHODS)) -> Any:
    """Parametrize over methods, of which some are known to fail, and why."""
    mark = [pytest.mark.xfail(strict=True, reason=why)]
    return pytest.mark.parametrize(
        "method", [pytest.param(m, marks=mark if m in fails else []) for m in among]
    )
