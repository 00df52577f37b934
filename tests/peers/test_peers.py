"""The runner of Exudyn (optional) against the reference scenes; its own speed is not judged."""

from __future__ import annotations

import copy
import sys
from typing import Any

import pytest
from oracles import rotations
from oracles.scenes import final_state, simulate, start_state
from paths import stored

sys.__dict__.setdefault("exudynFast", True)  # before the first import, as the runner does
exudyn = pytest.importorskip("exudyn")

from peers import exudyn_runner as runner
from peers.exudyn_runner import Setting

SCENES = stored("scenes")["scenes"]
NODES = ("rotvec", "ep", "rxyz")


def turned() -> dict[str, Any]:
    """`pair` with two moving bodies turned by like rotations, one inertia a full matrix."""
    scene = copy.deepcopy(SCENES["pair"])
    turns, speeds = ([0.4, -0.7, 1.1], [0.5, -0.6, 0.9]), ([1.0, -2.0, 3.0], [0.3, 0.7, -1.2])
    for body, turn, w_B in zip(scene["bodies"], turns, speeds, strict=True):
        body.update(rotation=rotations.exp_so3(turn), angular_velocity=w_B)
    scene["bodies"][1]["inertia"] = [[0.5, 0.1, -0.05], [0.1, 0.4, 0.02], [-0.05, 0.02, 0.3]]
    return scene


@pytest.mark.parametrize("node", NODES)
@pytest.mark.parametrize("name", ["single", "coupled", "chain16", "pair", "turned"])
def test_start_is_read_back(name: str, node: str) -> None:
    scene = turned() if name == "turned" else SCENES[name]
    off = runner.distance(runner.System(scene, node).state(), start_state(scene))
    assert off.max() < 1e-12


@pytest.mark.parametrize(("name", "setting", "bound"), [
    *((name, Setting("rxyz", "RK67", 2000), 1e-9) for name in ("mini", "single", "coupled")),
    *((name, Setting("rxyz", "RK67", 2000), 1e-9) for name in ("chain1", "chain4", "chain16")),
    ("single", Setting("rotvec", "DOPRI5", 20, 1e-9), 1e-6),
    ("chain4", Setting("rotvec", "RK44", 1000), 1e-6),
    ("chain4", Setting("rotvec", "DOPRI5", 500, linear="EXUdense", per_body=False), 1e-6),
    *(("coupled", Setting(node, "GeneralizedAlpha", 8000), 1e-6) for node in NODES),
    ("coupled", Setting("ep", "TrapezoidalIndex2", 8000), 1e-6),
    ("pair_intrinsic", Setting("rotvec", "RK67", 4000), 1e-6),
])  # fmt: skip
def test_final_state_is_the_reference(name: str, setting: Setting, bound: float) -> None:
    result = runner.run(SCENES[name], setting)
    assert runner.distance(result.state, final_state(SCENES[name])).max() < bound
    assert 0 < result.cpu_seconds < 10


@pytest.mark.parametrize("law", ["standard", "intrinsic"])
def test_turned_bodies_move_as_the_oracle_says(law: str) -> None:
    scene = {**turned(), "law": law}
    expected = simulate(scene, 0.05, 20)  # later the angles of `standard` jump
    for setting, bound in (
        (Setting("rotvec", "RK67", 500), 1e-8),
        (Setting("rxyz", "RK67", 500), 1e-8),
        (Setting("ep", "GeneralizedAlpha", 16000), 1e-5),  # of 30 rad/s
    ):
        state = runner.run(scene, setting, 0.05).state
        assert runner.distance(state, expected).max() < bound, setting


def test_a_system_runs_again_from_its_start() -> None:
    system, setting = runner.System(SCENES["chain4"], "rotvec"), Setting("rotvec", "RK44", 600)
    states: list[Any] = []
    first = system.run(setting, 0.5, states.append).state
    assert runner.distance(states[0], start_state(SCENES["chain4"])).max() < 1e-12
    assert len(states) == 600
    assert (system.run(setting, 0.5).state == first).all()


def test_best_is_below_the_error() -> None:
    scene = SCENES["single"]
    setting, result, error, tries = runner.best(scene, final_state(scene), 1e-5)
    assert error < 1e-5
    assert runner.distance(result.state, final_state(scene)).max() < 1e-4
    assert setting in [t.setting for t in tries]


def test_what_exudyn_cannot_do_is_said() -> None:
    with pytest.raises(ValueError, match="no law 'consistent'"):
        runner.System(SCENES["pair_consistent"], "rotvec")
    with pytest.raises(ValueError, match="no node"):
        runner.System(SCENES["single"], "euler")
    joint = {**SCENES["single"]["connectors"][0], "velocity_offset": [0.0] * 6}
    with pytest.raises(ValueError, match="velocity_offset"):
        runner.System({**SCENES["single"], "connectors": [joint]}, "rotvec")
    with pytest.raises(runner.Failure):
        runner.run(SCENES["chain4"], Setting("rotvec", "RK44", 20))
    with pytest.raises(runner.Failure):
        runner.run(SCENES["single"], Setting("ep", "RK44", 1000))
