"""The same scenes elsewhere and with other body axes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

import rbsd_sym as rs
from rbsd_sym.formulations.plane import planes

from .small import EYE, Array

FORMULATIONS = [rs.Quaternion(), rs.TaitBryan()]


def matrix(q: Any) -> Array:
    """Rotation matrix of a unit quaternion, scalar first."""
    w, x, y, z = q
    return np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def unit(rng: np.random.Generator, n: int = 4) -> Array:
    """A random unit vector, or quaternion."""
    v = rng.standard_normal(n)
    return v / np.linalg.norm(v)


def some_rotation(rng: np.random.Generator) -> Array:
    return matrix(unit(rng))


# The same scene elsewhere, and with other body axes: what `planes` has to undo.


def carried(scene: rs.Scene, R: Array, o: Any = (0, 0, 0)) -> rs.Scene:
    """Everything moved by p -> o + R p, the ground markers and gravity too."""

    def marker(m: rs.Marker) -> rs.Marker:
        if m.body != rs.GROUND:
            return m
        return rs.Marker(m.body, np.add(o, R @ m.position), R @ m.rotation)

    bodies = [
        replace(b, position=np.add(o, R @ b.position), rotation=R @ b.rotation,
                velocity=R @ b.velocity)
        for b in scene.bodies
    ]  # fmt: skip
    connectors = [
        replace(c, marker0=marker(c.marker0), marker1=marker(c.marker1)) for c in scene.connectors
    ]
    loads = [
        replace(v, force=R @ v.force, torque=R @ v.torque) if v.frame == "world" else v
        for v in scene.loads
    ]
    return replace(
        scene, bodies=bodies, connectors=connectors, loads=loads, gravity=R @ scene.gravity
    )


def reframed(scene: rs.Scene, S: dict[str, Array], by_joint: bool = False) -> rs.Scene:
    """Body axes turned by S: R_WB -> R_WB S; joint frames stay where they are.

    They are turned back in the markers, or in the joint rotations.
    """
    S = {**S, rs.GROUND: EYE}

    def marker(m: rs.Marker) -> rs.Marker:
        R = m.rotation if by_joint else S[m.body].T @ m.rotation
        return rs.Marker(m.body, S[m.body].T @ m.position, R)

    def joint(m: rs.Marker, R: Array) -> Array:
        return m.rotation.T @ S[m.body].T @ m.rotation @ R if by_joint else R

    bodies = [
        replace(b, rotation=b.rotation @ S[b.name], inertia=S[b.name].T @ b.inertia @ S[b.name],
                com=S[b.name].T @ b.com, angular_velocity=S[b.name].T @ b.angular_velocity)
        for b in scene.bodies
    ]  # fmt: skip
    connectors = [
        replace(c, marker0=marker(c.marker0), marker1=marker(c.marker1),
                rotation_marker0=joint(c.marker0, c.rotation_marker0),
                rotation_marker1=joint(c.marker1, c.rotation_marker1))
        for c in scene.connectors
    ]  # fmt: skip
    return replace(scene, bodies=bodies, connectors=connectors)


def shuffled(scene: rs.Scene, seed: int, R: Array | None = None, far: float = 0.0) -> rs.Scene:
    """The scene carried by a random rotation (or R) and a shift, with random body axes."""
    rng = np.random.default_rng(seed)
    S = {body.name: some_rotation(rng) for body in scene.bodies}
    R = some_rotation(rng) if R is None else R
    return carried(reframed(scene, S, by_joint=bool(seed % 2)), R, far * rng.standard_normal(3))


def sizes(scene: rs.Scene) -> list[int]:
    """Number of states of the minimal model of each candidate."""
    return [rs.compile_scene(plane.scene).n_x for plane in planes(scene)]
