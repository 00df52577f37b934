"""The scripts of optimal control in models/, and the command that runs them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import MODELS
from scenes.ocp import SLEW_EFFORT, SLEW_TIME, SWITCHES, flies

import rbsd_sym as rs
from rbsd_sym import __main__ as command_line
from rbsd_sym.ocp import Collocation, Solution, optimise

CRANE, MOUNTS, ARM = (
    command_line.load_model_file(MODELS / f"{name}.py") for name in ("crane", "mount_design", "arm")
)


def found_by(file: Any, **changes: Any) -> Solution:
    """The solution that the command line finds."""
    given = {"method": file.METHOD, "guess": getattr(file, "GUESS", None),
             "solver": getattr(file, "SOLVER", None)}  # fmt: skip
    return optimise(file.problem(), **{**given, **changes})


@pytest.fixture(scope="module")
def crane() -> Solution:
    return found_by(CRANE)


@pytest.fixture(scope="module")
def mounts() -> Solution:
    return found_by(MOUNTS)


@pytest.fixture(scope="module")
def arm() -> Solution:
    return found_by(ARM)


def clearance(found: Solution) -> np.ndarray:
    place, half, height = CRANE.WALL
    x, z = found.trajectory["load.p_x"], found.trajectory["load.p_z"]
    return ((x - place) / half) ** 2 + (z / height) ** 2


def test_the_crane_touches_the_wall_and_leaves_no_swing(crane: Solution) -> None:
    assert flies(crane)
    assert crane.mesh_error < 1e-5
    # It holds at the collocation points, 0.02 s apart; between them 1e-4 of it is cut off.
    assert clearance(crane).min() == pytest.approx(1.0, abs=1e-4)
    assert crane.multipliers["path wall"].max() > 1e-2
    last = {name: value for name, value in crane.flown.trajectory.state_at_end.items()  # type: ignore[union-attr]
            if name in {label.name for label in crane.model.x_labels}}  # fmt: skip
    after = rs.simulate(crane.model, 5.0, rs.Idas(1e-10, 1e-12), start=last)
    assert np.abs(after["load.position"] - [5.0, 0, 0]).max() < 1e-4


@pytest.mark.slow
def test_a_finer_mesh_changes_the_cost_of_the_crane_little(crane: Solution) -> None:
    finer = found_by(CRANE, method=Collocation(90, degree=5, input_degree=2))
    assert finer.cost == pytest.approx(crane.cost, rel=1e-5)


def test_a_crane_that_swings_little_is_two_masses_and_a_spring() -> None:
    """The difference falls with the square of the angle, which grows with the distance."""
    time, spring = np.sqrt(CRANE.LENGTH / CRANE.GRAVITY), CRANE.WEIGHT / CRANE.LENGTH
    gaps = []
    for distance in (0.5, 0.25):
        effort = SLEW_EFFORT * (spring * distance) ** 2 * time
        least = optimise(CRANE.level(distance, 5 * time), Collocation(20, 5, input_degree=4))
        fastest = optimise(CRANE.level(distance), Collocation(20, 4, refine=1e-6))
        switches = fastest.inputs["drive"].switches(0.0) / time
        gaps.append([least.cost / effort - 1, fastest.cost / time - SLEW_TIME,
                     *(switches - SWITCHES)])  # fmt: skip
        assert flies(least)
        assert flies(fastest)
    assert np.abs(gaps[1]).max() < 2e-3
    assert np.array(gaps[0]) / gaps[1] == pytest.approx(4.0, rel=0.05)


def cost_and_travel(model: rs.Model, stiffness: float, damping: float) -> tuple[float, float]:
    """Of a design, by simulation: transmitted force squared (kN2 s), largest travel (m)."""
    t = np.linspace(0, MOUNTS.T_END, 4001)
    run = rs.simulate(model, t, params={"stiffness": stiffness, "damping": damping})
    force = run["left.force0"] + run["right.force0"] + [0, 0, MOUNTS.MASS * MOUNTS.GRAVITY]
    square = (force**2).sum(axis=1) / 1e6
    travel = max(np.abs(run[f"{name}.displacement_local"]).max() for name in ("left", "right"))
    return float(((square[1:] + square[:-1]) / 2 * np.diff(t)).sum()), float(travel)


def test_no_better_mounts_are_near(mounts: Solution) -> None:
    assert flies(mounts)
    assert mounts.mesh_error < 1e-4
    k, d = mounts.params["stiffness"], mounts.params["damping"]
    assert 5.1e4 < k < 9.9e5
    assert 110 < d < 9.9e3  # the bounds of both are far
    cost, travel = cost_and_travel(mounts.model, k, d)
    assert cost == pytest.approx(mounts.cost, rel=1e-4)
    # Travel is limited at some points; peaks between them are a thousandth higher at most.
    assert MOUNTS.TRAVEL * 0.999 < travel < MOUNTS.TRAVEL * 1.001
    for factor, other in ((1.0, 0.8), (1.0, 1.25), (1.05, 1.15), (0.95, 1.0), (0.95, 0.85),
                          (1.3, 1.5)):  # fmt: skip
        near, far = cost_and_travel(mounts.model, k * factor, d * other)
        if factor < 1:
            assert near < cost
            assert far > 1.02 * travel  # softer mounts pass on less, but move too far
        else:
            assert near > cost


@pytest.mark.slow
def test_a_finer_mesh_changes_the_mounts_little(mounts: Solution) -> None:
    fine = Collocation(tuple(np.linspace(0, 1, 201) ** 0.7), degree=5, path_points=6)
    finer = found_by(MOUNTS, method=fine)
    assert finer.params["stiffness"] == pytest.approx(mounts.params["stiffness"], rel=1e-3)
    assert finer.cost == pytest.approx(mounts.cost, rel=1e-3)


def test_the_arm_is_held_back_by_its_joints(arm: Solution) -> None:
    assert flies(arm)
    assert arm.mesh_error < 5e-4
    plan = arm.trajectory
    deflection = [np.abs(plan[f"{name}.displacement_local"]).max() for name in ARM.TOP]
    # At the points the limit holds; between them it is passed by a thousandth at most.
    assert ARM.GIVES * 0.999 < max(deflection) < ARM.GIVES * 1.001
    for name, top in ARM.TOP.items():
        assert np.abs(plan[f"{name}_torque"]).max() == pytest.approx(top, rel=1e-4)
    assert plan["fore.angle_z"][-1] == pytest.approx(sum(ARM.TURN), abs=1e-8)
    assert plan["fore.w_z"][-1] == pytest.approx(0.0, abs=1e-8)
    reach = ARM.LENGTH * np.array([np.cos(1.2) + np.cos(0.4), np.sin(1.2) + np.sin(0.4)])
    tip = plan["fore.position"][-1][:2] + ARM.LENGTH / 2 * np.array([np.cos(0.4), np.sin(0.4)])
    assert np.abs(tip - reach).max() < 1.1e-4


@pytest.mark.slow
def test_a_finer_mesh_changes_the_time_of_the_arm_little(arm: Solution) -> None:
    """Torques linear on each interval converge; held on each of 40 they cost 14 ms more."""
    finer = found_by(ARM, method=replace(ARM.METHOD, intervals=160))
    assert arm.t_end - 5e-4 < finer.t_end < arm.t_end
    held = found_by(ARM, method=Collocation(40, degree=4, scheme="radau"))
    assert held.t_end > arm.t_end + 0.01


@pytest.mark.slow
def test_joints_that_may_give_way_save_time(arm: Solution) -> None:
    free = optimise(ARM.problem(gives=0.1), ARM.METHOD, ARM.GUESS, ARM.SOLVER)
    assert free.t_end < arm.t_end - 0.015
    most = [np.abs(free.trajectory[f"{name}.displacement_local"]).max() for name in ARM.TOP]
    assert max(most) > 1.5 * ARM.GIVES


@pytest.mark.parametrize("file", [CRANE, MOUNTS, ARM], ids=lambda file: file.__name__)
def test_pictures(file: Any, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    fixture = {"crane": "crane", "mount_design": "mounts", "arm": "arm"}[file.__name__]
    file.picture(request.getfixturevalue(fixture)).savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").stat().st_size > 1e4


SLEW = (MODELS / "flexible_slew.py").read_text()


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "quick.py"
    file.write_text(SLEW.replace("METHOD = rs.ocp.Collocation(20, degree=4, refine=1e-8)",
                                 "METHOD = rs.ocp.Collocation(8, degree=4)"))  # fmt: skip
    given = ["--folder", str(tmp_path), "--animate", "html", "--progress"]
    assert command_line.main(["ocp", str(file), *given]) == 0
    told = capsys.readouterr()
    assert "flexible_slew: optimal; cost" in told.out
    assert told.err.count("violation") > 5
    folder = tmp_path / "flexible_slew"
    kept = rs.Trajectory.load(folder / "flexible_slew_plan.npz")
    assert kept["tip.p_x"][-1] == pytest.approx(2.0, abs=1e-8)
    for suffix in ("png", "html"):
        assert (folder / f"flexible_slew_plan.{suffix}").stat().st_size > 1e4


def test_command_tells_why_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "hopeless.py"
    hopeless = SLEW.replace("Collocation(20, degree=4, refine=1e-8)", "Collocation(6, degree=3)")
    file.write_text(hopeless.replace("rs.ocp.Free(4.0, low=1.0, high=10.0)", "1.0"))
    assert command_line.main(["ocp", str(file), "--folder", str(tmp_path)]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("error: flexible_slew: no motion found that meets all conditions")
    assert "end 'hub.p_x' at t = 1 s is 0.10627 m, wanted 1 m" in error
    assert command_line.main(["ocp", str(MODELS / "mini.py")]) == 1
    assert "defines no problem()" in capsys.readouterr().err


@pytest.mark.slow
def test_command_names_params_that_were_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["ocp", str(MODELS / "mount_design.py"), "--folder", str(tmp_path)]
    assert command_line.main(given) == 0
    assert "  stiffness = 127" in capsys.readouterr().out
