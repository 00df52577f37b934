"""Named scenes whose minimal model is smaller than the full one: sizes, and that nothing is lost.

Every state of the full scene and every output is compared along whole trajectories, to 1e-9 of how
far it moves.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from charts import minimal_table
from helpers.comparing import traffic
from paths import MODELS
from scenes import reference
from scenes.small import GROUND, chain, one_body

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file

TOLERANCE = 1e-9
_STILL = 1e-9  # a quantity that moves by less, relative to others of its unit, does not move
RUNGE_KUTTA = rs.ExplicitRK(1e-11, 1e-13)


@dataclass(frozen=True)
class Case:
    """A scene with the number of states of its minimal model, and how it is driven."""

    build: Callable[[], rs.Scene]
    states: int
    t_end: float
    inputs: Mapping[str, Any] = field(default_factory=dict)
    params: Mapping[str, float] = field(default_factory=dict)
    formulation: Any = None


def pendulum() -> rs.Scene:
    """A rod of 1 m on a stiff hinge about z, let go from the horizontal."""
    rod = rs.RigidBody("rod", 1.0, (0.01, 0.08, 0.09), position=(0.5, 0, 0))
    hinge = rs.RigidBodySpringDamper(
        "hinge", GROUND, rs.Marker("rod", (-0.5, 0, 0)), [1e4] * 3 + [1e3, 1e3, 0], [5] * 6
    )
    return rs.Scene("pendulum", [rod], [hinge], gravity=(0, -9.81, 0))


def links(n: int, law: Any) -> rs.Scene:
    """Links of 0.5 m along x on soft hinges about z, let go from the horizontal."""
    bodies, joints = [], []
    for i in range(n):
        place = (0.5 * i + 0.25, 0, 0)
        bodies.append(rs.RigidBody(f"link{i}", 0.5, (0.01, 0.02, 0.03), position=place))
        joints.append(rs.RigidBodySpringDamper(
            f"joint{i}", rs.Marker(f"link{i - 1}", (0.25, 0, 0)) if i else GROUND,
            rs.Marker(f"link{i}", (-0.25, 0, 0)), [1e3] * 3 + [50, 50, 5], [1] * 3 + [0.1] * 3,
            law=law,
        ))  # fmt: skip
    return rs.Scene("links", bodies, joints, gravity=(0, -9.81, 0))


def shaken() -> rs.Scene:
    """A plate between two bushings in the xy plane; the strain offset of the left one moves."""
    plate = rs.RigidBody("plate", 2.0, (0.2, 0.3, 0.4), position=(0.1, 0, 0), com=(0, 0.05, 0))
    t = rs.TIME
    offset = [0.02 * t * t, 0.05 * np.sin(7 * t), 0, 0, 0, 0.3 * np.sin(4 * t)]
    left, right = (
        rs.RigidBodySpringDamper(
            name, rs.Marker(rs.GROUND, (x, 0, 0)), rs.Marker("plate", (x, 0.1, 0)),
            [300, 400, 500, 20, 30, 40], [4, 5, 6, 0.2, 0.3, 0.4], offset=moved,
        )
        for name, x, moved in (("left", -0.4, offset), ("right", 0.4, 0))
    )  # fmt: skip
    return rs.Scene("shaken", [plate], [left, right], gravity=(0, -9.81, 0))


def drill() -> rs.Scene:
    """A spindle fed along z and twisted about z by two Inputs, which are zero by default."""
    feed, twist = rs.Input("feed", "N"), rs.Input("twist", "N m")
    spindle = rs.RigidBody("spindle", 3.0, (0.05, 0.05, 0.02))
    guide = rs.RigidBodySpringDamper(
        "guide", GROUND, rs.Marker("spindle"), [1e4, 1e4, 800, 500, 500, 10],
        [10, 10, 5, 1, 1, 0.01], law=rs.Consistent(),
    )  # fmt: skip
    work = rs.Load("work", rs.Marker("spindle"), force=(0, 0, feed), torque=(0, 0, twist))
    return rs.Scene("drill", [spindle], [guide], [work])


def sledge() -> rs.Scene:
    """A body that slides along x without a spring, and bounces along y, at a height by Param."""
    height = rs.Param("height", 0.0, "m")
    body = rs.RigidBody("body", 2.0, (1, 1, 1), position=(0, 0, height), velocity=(0.7, 0, 0))
    rail = rs.RigidBodySpringDamper(
        "rail", rs.Marker(rs.GROUND, (0, 0, height)), rs.Marker("body"), [0, 200, 300, 0, 20, 0],
        [0, 1, 1, 0, 0, 1],
    )  # fmt: skip
    latch = rs.RigidBodySpringDamper(
        "latch", rs.Marker(rs.GROUND, (1, 1, 1)), rs.Marker("body", (0.1, 0.2, 0.3)), [900] * 6,
        active=False,
    )  # fmt: skip
    return rs.Scene("sledge", [body], [rail, latch], gravity=(0, -9.81, 0))


def rotors() -> rs.Scene:
    """Two bodies that turn about z, one of them in a bearing, the other one started at 200 deg."""
    start = (np.cos(np.deg2rad(100)), 0, 0, np.sin(np.deg2rad(100)))
    free = rs.RigidBody("free", 1.0, (1, 2, 3), rotation=start, angular_velocity=(0, 0, -30))
    borne = rs.RigidBody("borne", 1.0, (1, 2, 3), angular_velocity=(0, 0, 40))
    bearing = rs.RigidBodySpringDamper(
        "bearing", GROUND, rs.Marker("borne"), [1e4] * 3 + [1e3, 1e3, 0], [10] * 3 + [1, 1, 0],
        law=rs.Consistent(),
    )  # fmt: skip
    return rs.Scene("rotors", [free, borne], [bearing])


def pair(law: Any) -> rs.Scene:
    """Two plates in the xz plane, one on the ground and one on the other, set swinging."""
    first = rs.RigidBody("first", 1, (0.1, 0.3, 0.2), position=(0.5, 0, 0), velocity=(0, 0, 2))
    second = rs.RigidBody(
        "second", 2, (0.2, 0.4, 0.3), position=(1.5, 0, 0.1), angular_velocity=(0, -4, 0)
    )
    markers = (
        ("base", GROUND, rs.Marker("first", (-0.5, 0, 0))),
        ("link", rs.Marker("first", (0.5, 0, 0)), rs.Marker("second", (-0.5, 0, 0))),
    )
    connectors = [
        rs.RigidBodySpringDamper(
            name, one, other, [600, 700, 800, 80, 50, 90], [5, 5, 5, 1, 0.5, 1], law=law
        )
        for name, one, other in markers
    ]
    return rs.Scene("pair", [first, second], connectors)


def engine() -> rs.Scene:
    """An engine on two inclined mounts in the xz plane, in which gravity and the shaking lie."""
    shake = rs.Input("shake", "N")
    block = rs.RigidBody("block", 120, (4.5, 9.0, 8.0, 0, -0.6, 0), com=(0.02, 0, 0.05))
    mounts = []
    for name, x, angle in (("front", 0.3, -0.6), ("rear", -0.3, 0.5)):
        c, s = np.cos(angle), np.sin(angle)
        frame = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        mounts.append(rs.RigidBodySpringDamper(
            name, rs.Marker(rs.GROUND, (x, 0, -0.25)), rs.Marker("block", (x, 0, -0.25)),
            [7e4, 7e4, 1.8e5, 900, 900, 600], [350, 350, 900, 1, 1, 1],
            rotation_marker0=frame, rotation_marker1=frame, law=rs.Consistent(),
        ))  # fmt: skip
    unbalance = rs.Load("unbalance", rs.Marker("block", (0.1, 0, 0.1)), force=(0, 0, shake))
    return rs.Scene("engine", [block], mounts, [unbalance], gravity=(0, 0, -9.81))


def hardening() -> rs.Scene:
    """A body on a user force that is cubic along x and linear along the other axes."""

    def force(mbs: Any, t: Any, i: Any, u: Any, th: Any, v: Any, w: Any, *rest: Any) -> list[Any]:
        return [50 * u[0] + 400 * u[0] ** 3 + v[0], 70 * u[1], 90 * u[2], *(5 * a for a in th)]

    body = rs.RigidBody("body", 1.0, (1, 2, 2.5), velocity=(5, 0, 0))
    spring = rs.RigidBodySpringDamper("spring", GROUND, rs.Marker("body"), 0, force=force)
    return rs.Scene("hardening", [body], [spring])


# A body that moves in a plane keeps 6 states: two coordinates, an angle, and their three rates.
CASES = {
    # Along y only: place and speed.
    "mini": Case(lambda: reference.build("mini"), 2, 1.0),
    "pendulum": Case(pendulum, 6, 1.0),
    "chain_of_5": Case(lambda: links(5, rs.Standard()), 30, 0.5),
    "damped_with_moving_offset": Case(shaken, 6, 2.0),
    # Along and about z: p_z, v_z, angle_z, w_z.
    "driven_by_inputs": Case(
        drill, 4, 2.0,
        {"feed": lambda t: 40 * np.sin(5 * t), "twist": lambda t: 2 * np.cos(2 * t) - t},
    ),
    # p_y and v_y bounce; p_x grows with a v_x that stays 0.7 m/s and so is no state. The connector
    # that is not active would move all the others.
    "inactive_and_zero_rows": Case(sledge, 3, 2.0, params={"height": 0.3}),
    # An angle each; the angular velocities are constant. 14 and 19 turns.
    "rotors": Case(rotors, 2, 3.0),
    "intrinsic_pair": Case(lambda: pair(rs.Intrinsic()), 12, 1.0),
    # Tait-Bryan angles need no angle of their own: a_z is one of the three that are there.
    "tait_bryan_chain": Case(
        lambda: links(3, rs.Consistent()), 18, 0.5, formulation=rs.TaitBryan()
    ),
    "engine_in_a_plane": Case(engine, 6, 0.5, {"shake": lambda t: 400 * np.sin(75 * t)}),
    # Along x only.
    "user_force": Case(hardening, 2, 2.0),
}


def both(case: Case, integrator: Any) -> tuple[rs.Model, rs.Trajectory, rs.Trajectory]:
    """The full model, and the trajectories of the minimal and of the full one."""
    times = np.linspace(0, case.t_end, 41)
    models = [rs.compile_scene(case.build(), case.formulation, m) for m in (True, False)]
    small, full = (
        rs.simulate(model, times, integrator, inputs=case.inputs, params=case.params)
        for model in models
    )
    assert small.outcome is rs.Outcome.reached_end  # and not unstable in what was left out
    return models[1], small, full


def quantities(model: rs.Model) -> dict[str, tuple[str, ...]]:
    """What is compared: names of columns, those of a quaternion's four states together."""
    found: dict[str, tuple[str, ...]] = {name: (name,) for name in model.dae.outputs}
    for label in model.x_labels:
        body, state = label.name.split(".")
        key = f"{body}.q" if state.startswith("q_") else label.name
        found[key] = (*found.get(key, ()), label.name)
    return found


def columns(trajectory: rs.Trajectory, names: tuple[str, ...]) -> np.ndarray:
    """Values (n, components)."""
    parts = [trajectory[name].reshape(len(trajectory.t), -1) for name in names]
    return np.hstack(parts)


def sizes(model: rs.Model, full: rs.Trajectory) -> dict[str, float]:
    """Largest absolute value in the scene by unit, for what does not move itself."""
    size: dict[str, float] = {}
    for names in quantities(model).values():
        unit = full.column(names[0]).unit
        size[unit] = max(size.get(unit, 0.0), float(np.abs(columns(full, names)).max()))
    return size


def scale_of(name: str, values: np.ndarray, full: rs.Trajectory, size: float) -> float:
    """How far a quantity moves; where it does not, the size of its like."""
    excursion = float(np.abs(values - values[0]).max())
    if name.endswith("_power"):  # a small difference of large powers
        excursion = max(excursion, traffic(full, name.split(".")[0]))
    return excursion if excursion > _STILL * size else size


def errors(case: Case, integrator: Any) -> dict[str, float]:
    """Difference of minimal and full relative to the excursion, by quantity."""
    model, small, full = both(case, integrator)
    size, found = sizes(model, full), {}
    for name, names in quantities(model).items():
        ours, theirs = columns(small, names), columns(full, names)
        difference = np.abs(ours - theirs).max(axis=1)
        if name.endswith((".q", ".quaternion")):  # q and -q are one rotation
            difference = np.minimum(difference, np.abs(ours + theirs).max(axis=1))
        scale = scale_of(name, theirs, full, size[full.column(names[0]).unit])
        # A unit of which the scene holds nothing but zeros has no size.
        found[name] = float(difference.max()) / max(scale, float(np.finfo(float).eps))
    return found


def check(name: str, integrator: Any) -> None:
    """Every quantity of a case agrees."""
    found = errors(CASES[name], integrator)
    wrong = {key: value for key, value in found.items() if not value < TOLERANCE}  # NaN is wrong
    assert not wrong


@pytest.mark.parametrize("name", CASES)
def test_number_of_states(name: str) -> None:
    case = CASES[name]
    small, full = (rs.compile_scene(case.build(), case.formulation, m) for m in (True, False))
    assert small.n_x == case.states < full.n_x
    assert full.n_x == (12 if case.formulation else 13) * len(case.build().bodies)


@pytest.mark.parametrize("name", CASES)
def test_minimal_equals_full(name: str) -> None:
    check(name, RUNGE_KUTTA)


@pytest.mark.parametrize("name", ["intrinsic_pair", "engine_in_a_plane"])
def test_minimal_equals_full_by_idas(name: str) -> None:
    check(name, rs.Idas(1e-11, 1e-13))


def table_scenes() -> dict[str, tuple[rs.Scene, float]]:
    """Scenes of the table, and the seconds to integrate; inputs keep their default."""
    mounts = load_model_file(MODELS / "engine_mounts.py").scene()
    sideways = replace(reference.build("chain16"), gravity=(0, -9.6, 0))
    spinner = one_body({"stiffness": [0] * 6}, {"angular_velocity": (0, 0, 7.0)})
    return {
        "`mini`": (reference.build("mini"), 1.0),
        "planar pendulum": (chain(1, rs.Standard()), 1.0),
        "planar chain of 20": (chain(20, rs.Standard()), 0.2),
        "the same, one marker off the plane": (chain(20, rs.Standard(), 0.1), 0.2),
        "`chain16`, gravity along y only": (sideways, 0.2),
        "`engine_mounts`": (mounts, 1.0),
        "engine on two mounts in a plane": (engine(), 1.0),
        "planar pair, Consistent": (pair(rs.Consistent()), 1.0),
        "free spinner": (spinner, 10.0),
    }


@pytest.mark.benchmark
@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_table_of_what_minimal_saves(tmp_path: Path) -> None:
    rows = [
        minimal_table.measure(name, scene, t_end, tmp_path / str(i))
        for i, (name, (scene, t_end)) in enumerate(table_scenes().items())
    ]
    print(f"\n{minimal_table.markdown(rows)}")
    for row in rows:
        for title in ("states", "instructions"):
            full, small = row.values[title]
            assert small <= full, f"{row.scene}: {title}"
