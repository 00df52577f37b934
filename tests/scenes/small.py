"""Small scenes for many tests: one body, a chain, a star, a column, a body without mass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import rbsd_sym as rs

Array = NDArray[np.float64]
LAWS = {"standard": rs.Standard(), "intrinsic": rs.Intrinsic(), "consistent": rs.Consistent()}
GROUND, BODY = rs.Marker(rs.GROUND), rs.Marker("b")
EYE = np.eye(3)


def one_body(
    connector: dict[str, Any] | None = None, body: dict[str, Any] | None = None, **scene: Any
) -> rs.Scene:
    """A body b on a connector c to the ground."""
    b = rs.RigidBody("b", **{"mass": 1.0, "inertia": (1.0, 2.0, 2.5), **(body or {})})
    c = rs.RigidBodySpringDamper(
        "c", **{"marker0": GROUND, "marker1": BODY, "stiffness": [100] * 6, **(connector or {})}
    )
    return rs.Scene("scene", [b], [c], **scene)


def massless() -> rs.Scene:
    """A body without inertia between two springs, the second damped."""
    a = rs.RigidBody("a", 0, 0, position=(1, 0, 0))
    b = rs.RigidBody("b", 2, (0.1, 0.2, 0.3), position=(2, 0, 0))
    joints = [
        rs.RigidBodySpringDamper("j", rs.Marker(rs.GROUND), rs.Marker("a", (-1, 0, 0)), [100] * 6),
        rs.RigidBodySpringDamper("k", rs.Marker("a"), rs.Marker("b", (-1, 0, 0)), [100] * 6,
                                 law=rs.Consistent()),
    ]  # fmt: skip
    return rs.Scene("massless", [a, b], joints, gravity=(0, 1, -2))


def star(n: int) -> rs.Scene:
    """A hub that carries n bodies on stiffness of their own, some of them Params."""
    hub = rs.RigidBody("hub", 5, (1, 1.2, 1.5), angular_velocity=(0, 0, 1))
    k = rs.Param("k", 300.0, "N/m")
    bodies = [
        rs.RigidBody(f"b{i}", 1 + i / 10, (0.1, 0.1, 0.2), position=(np.cos(i), np.sin(i), 0.3))
        for i in range(n)
    ]
    arms = [
        rs.RigidBodySpringDamper(
            f"c{i}", rs.Marker("hub", b.position), rs.Marker(b.name),
            [k if i % 3 == 0 else 100 + i, 100, 100, 10, 10, 10], [1] * 6, law=rs.Intrinsic(),
        )
        for i, b in enumerate(bodies)
    ]  # fmt: skip
    pull = rs.Load("pull", rs.Marker("hub", (0.1, 0, 0)), (rs.Input("F", "N"), 0, np.sin(rs.TIME)))
    return rs.Scene("star", [hub, *bodies], arms, [pull], gravity=(0, 0, -9.81))


def blow_up(
    mbs: Any, t: Any, item: Any, displacement: Any, rotation: Any, velocity: Any, *rest: Any
) -> list[Any]:
    """x'' = 2 x^3: with x = x' = 1 at the start x = 1/(1 - t), which has no end beyond 1 s."""
    return [-2 * displacement[0] ** 3, 0, 0, 0, 0, 0]


def chain(n: int, law: Any, off: float = 0.0, hinge: Array = EYE, **body: Any) -> rs.Scene:
    """Links along x that fall in the xy plane; `off` moves one marker out, `hinge` turns joints."""
    bodies, joints = [], []
    for i in range(n):
        out = off if i == n // 2 else 0.0
        numbers = {"mass": 1, "inertia": (0.01, 0.1, 0.1), **(body if i == 0 else {})}
        bodies.append(rs.RigidBody(f"b{i}", position=(i + 0.5, 0, 0), **numbers))
        joints.append(rs.RigidBodySpringDamper(
            f"j{i}", rs.Marker(f"b{i - 1}", (0.5, 0, 0), hinge) if i
            else rs.Marker(rs.GROUND, (0, 0, 0), hinge), rs.Marker(f"b{i}", (-0.5, 0, out), hinge),
            [1e5] * 3 + [1e3] * 3, [10] * 3 + [1] * 3, law=law,
        ))  # fmt: skip
    return rs.Scene("chain", bodies, joints, gravity=(0, -9.81, 0))


def column(
    k: Any = 1.0, damping: Any = 0, length: float = 0.5, support: float = 1e6, loads: Any = ()
) -> rs.Scene:
    """An upright bar of 1 kg that buckles where its hinge resists tilting by k < m g length.

    Arguments:
        k: N m/rad, a number or a Param.
        damping: of the hinge, as a connector takes it.
        length: m, from the hinge to the centre of mass.
        support: N/m, what the hinge gives along its axes.
    """
    bar = rs.RigidBody("bar", 1.0, (0.08, 0.08, 0.01), position=(0, 0, length))
    hinge = rs.RigidBodySpringDamper(
        "hinge", GROUND, rs.Marker("bar", (0, 0, -length)), [support] * 3 + [k, k, 1.0], damping,
        law=rs.Consistent(),
    )  # fmt: skip
    return rs.Scene("column", [bar], [hinge], loads, gravity=(0, 0, -9.81))
