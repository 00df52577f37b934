"""Scenes and models for the tests of generalized-alpha."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from oracles.rotations import exp_so3

import rbsd_sym as rs
from scenes import massless, published, reference

GROUND = rs.Marker(rs.GROUND)
FORMULATIONS = {"quaternion": rs.Quaternion(), "tait_bryan": rs.TaitBryan()}
TIGHT = rs.Idas(1e-11, 1e-13)


@cache
def model_of(name: str, formulation: str = "quaternion", minimal: bool = True) -> rs.Model:
    return rs.compile_scene(SCENES[name](), FORMULATIONS[formulation], minimal)


def oscillator() -> rs.Scene:
    """One state and its velocity, at 1 rad/s."""
    body = rs.RigidBody("b", 1.0, [1, 1, 1], velocity=[0.1, 0, 0])
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("b"), [1, 0, 0, 0, 0, 0])
    return rs.Scene("oscillator", [body], [spring])


def driven() -> rs.Scene:
    """A damped oscillator under an input, and a rotation that the input does not reach."""
    body = rs.RigidBody("b", 2.0, [1, 1, 1], velocity=[0.7, 0, 0])
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), [50, 0, 0, 0, 0, 0], [3, 0, 0, 0, 0, 0]
    )
    pull = rs.Load("pull", rs.Marker("b"), force=(rs.Input("f", "N"), 0, 0))
    return rs.Scene("driven", [body], [spring], [pull])


def kelvin() -> rs.Scene:
    """A massless body on a spring (1 N/m) and a damper (1 N s/m): x' = -x, and x' is algebraic."""
    body = rs.RigidBody("a", 0, 0, position=(0.4, 0, 0))
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("a"), [1] * 6, [1] * 6)
    return rs.Scene("kelvin", [body], [spring])


def maxwell() -> rs.Scene:
    """A tumbling body with two Maxwell branches, whose forces are states of first order."""
    body = rs.RigidBody(
        "b", 1.0, [1, 2, 3], velocity=[0.7, 0.5, 0.2], angular_velocity=[0.3, 0.2, 1.5]
    )
    branches = (rs.Maxwell(0, 100.0, 3.0), rs.Maxwell(4, 20.0, 1.0))
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), [50, 60, 70, 8, 9, 10], effects=branches
    )
    return rs.Scene("maxwell", [body], [spring], gravity=(0, 0, -9.81))


def rod() -> rs.Scene:
    """A thin rod: its spin about its own axis is algebraic, the other two have inertia."""
    body = rs.RigidBody(
        "r", 1.0, (0, 0.1, 0.1), position=(1, 0, 0), velocity=(0, 0.5, 0.2),
        angular_velocity=(0, 1, -2),
    )  # fmt: skip
    K = np.array([300, 400, 500, 20, 30, 40.0])
    ends = rs.Marker(rs.GROUND, (0.5, 0, 0)), rs.Marker("r", (-0.5, 0.05, 0))
    spring = rs.RigidBodySpringDamper("s", *ends, K, 0.02 * K, law=rs.Consistent())
    return rs.Scene("rod", [body], [spring], gravity=(0.1, 0, -9.81))


def pendulum() -> rs.Scene:
    """Planar in a tilted plane: three coordinates in axes of that plane."""
    R, k = exp_so3([0.3, 0.5, -0.2]), 500.0
    body = rs.RigidBody(
        "b", 1.0, [0.01, 0.02, 0.03], position=R @ [1, 0, 0], rotation=R,
        velocity=R @ [0, 0.5, 0], angular_velocity=[0, 0, 0.5],
    )  # fmt: skip
    hinge = rs.RigidBodySpringDamper(
        "c", rs.Marker(rs.GROUND, (0, 0, 0), R), rs.Marker("b", [-1, 0, 0]),
        [k, k, k, 50, 50, 0], [1, 1, 1, 0.1, 0.1, 0],
    )  # fmt: skip
    return rs.Scene("pendulum", [body], [hinge], gravity=R @ [0, -9.81, 0])


TUMBLING = {
    "mass": 2.0, "inertia": np.diag([0.1, 0.2, 0.25]), "position": np.array([0.1, 0.05, -0.2]),
    "rotation": exp_so3([0.3, -0.2, 0.5]), "velocity": np.array([0.3, -1, 0.5, 3, -2, 5]),
}  # fmt: skip
K_TUMBLING = np.array([400, 500, 700, 25, 50, 32.0])
TIP = np.array([0.1, 0.2, -0.1])
WEIGHT = np.array([0, 0, -9.81])


def tumbling(law: Any = None) -> rs.Scene:
    """A body that turns once a second, on a damped spring at a corner."""
    T = TUMBLING
    body = rs.RigidBody(
        "b", T["mass"], T["inertia"], position=T["position"], rotation=T["rotation"],
        velocity=T["velocity"][:3], angular_velocity=T["velocity"][3:],
    )  # fmt: skip
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b", TIP), K_TUMBLING, 0.01 * K_TUMBLING, law=law or rs.Standard()
    )
    return rs.Scene("tumbling", [body], [spring], gravity=WEIGHT)


SCENES = {
    "oscillator": oscillator, "driven": driven, "kelvin": kelvin, "maxwell": maxwell, "rod": rod,
    "pendulum": pendulum, "tumbling": tumbling, "heavy_top": published.heavy_top,
    "link": lambda: massless.linked(0.0, massless.UNDAMPED),
    "damped_link": lambda: massless.linked(0.0, massless.DAMPED),
} | {name: lambda name=name: reference.build(name) for name in reference.SCENES}  # fmt: skip


def start_of(model: rs.Model) -> list[np.ndarray]:
    """x, z, u, p at their start."""
    dae = model.dae
    groups = (model.x_labels, dae.z_labels, dae.u_labels, dae.p_labels)
    return [np.array([label.start for label in labels]) for labels in groups]


def path(model: rs.Model, t_end: float, integrator: Any) -> np.ndarray:
    """States and unknowns at 21 times."""
    found = rs.simulate(model, np.linspace(0, t_end, 21), integrator)
    return np.array([found[name] for name in found.states])
