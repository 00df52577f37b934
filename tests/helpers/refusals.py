"""Elements that are right but for one change, and what an error has to say of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

import rbsd_sym as rs

NAN, INF = float("nan"), float("inf")
ARM = rs.Marker("arm")


def body(**changes: Any) -> rs.RigidBody:
    """A body that moves in every direction, right but for the changes."""
    right = {"name": "arm", "mass": 1.0, "inertia": [1.0, 1.2, 1.4], "velocity": [1, 2, 3],
             "angular_velocity": [1, 2, 3]}  # fmt: skip
    return rs.RigidBody(**(right | changes))


def joint(**changes: Any) -> rs.RigidBodySpringDamper:
    """A connector that is right but for the changes."""
    right = {"name": "joint", "marker0": rs.Marker(rs.GROUND), "marker1": ARM, "stiffness": [1] * 6}
    return rs.RigidBodySpringDamper(**(right | changes))


def load(**changes: Any) -> rs.Load:
    """A load that is right but for the changes."""
    return rs.Load(**({"name": "push", "marker": ARM} | changes))


def scene(**changes: Any) -> rs.Scene:
    """A scene that is right but for the changes."""
    return rs.Scene(**({"name": "bench", "bodies": [body()], "connectors": [joint()]} | changes))


def compiled(**changes: Any) -> rs.Model:
    """The model of a scene that is right but for the changes."""
    return rs.compile_scene(scene(**changes))


def refused(kind: type[Exception], call: Callable[[], Any], *words: str) -> None:
    """The call raises exactly this kind, in the form "where: what; rule or remedy".

    The message starts with the first word and has all others.
    """
    with pytest.raises(kind) as caught:
        call()
    message = str(caught.value)
    assert caught.type is kind, message
    assert message.startswith(words[0]), message
    assert "; " in message, message
    for word in words[1:]:
        assert word in message, message


def table(rows: list[tuple[Any, ...]]) -> Any:
    """Parametrize over (kind, call, where, words...); the id is the place and what is wrong."""
    ids = [f"{i} {' '.join(row[2:4])}".replace("[", "(") for i, row in enumerate(rows)]
    return pytest.mark.parametrize("row", rows, ids=ids)
