"""simulate(): inputs, parameters, restarts, grids, files, failures, and errors that follow rtol."""

from __future__ import annotations

import dataclasses
import importlib
import inspect
import math
import os
import pickle
import pkgutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.comparing import by_name
from numpy.typing import NDArray
from oracles import closed_forms, rotations
from scenes import reference
from scenes.driven import (
    CLOSE,
    FORCES,
    GRID,
    KNOTS,
    D,
    K,
    M,
    oscillator,
    piecewise_linear,
    sine_driven,
)
from scenes.simulators import doomed

import rbsd_sym as rs
import rbsd_sym.integrators

Array = NDArray[np.float64]
TIGHT = [rs.Idas(1e-10, 1e-12), rs.Rosenbrock(1e-10, 1e-12), rs.ExplicitRK(1e-10, 1e-12)]
every_integrator = pytest.mark.parametrize("integrator", TIGHT, ids=by_name)


@pytest.fixture(scope="module")
def driven() -> rs.Model:
    """The oscillator with input `pull` and parameter `k`."""
    return oscillator(rs.Input("pull", "N"), rs.Param("k", K, "N/m"))


@every_integrator
def test_constant_input(driven: rs.Model, integrator: Any) -> None:
    trajectory = rs.simulate(driven, GRID, integrator, inputs={"pull": 3.0})
    expected = piecewise_linear(GRID, GRID[[0, -1]], np.array([3.0, 3.0]), 0.0, 0.5)
    assert np.abs(trajectory["b.p_x"] - expected).max() < CLOSE
    assert (trajectory["pull"] == 3.0).all()


class Counted:
    """A function of time that counts its calls with plain numbers."""

    def __init__(self, function: Callable[[Any], Any]) -> None:
        self.function, self.calls = function, 0

    def __call__(self, t: Any) -> Any:
        self.calls += isinstance(t, float)
        return self.function(t)


@every_integrator
@pytest.mark.parametrize("sin", [np.sin, math.sin], ids=["traced", "called"])
def test_function_as_input(driven: rs.Model, integrator: Any, sin: Any) -> None:
    """np.sin is traced with a symbol, so Python is called for the output column only."""
    pull = Counted(lambda t: 3 * sin(4 * t))
    trajectory = rs.simulate(driven, GRID, integrator, inputs={"pull": pull})
    assert np.abs(trajectory["b.p_x"] - sine_driven(GRID, 3.0, 4.0, 0.0, 0.5)).max() < CLOSE
    assert (pull.calls == len(GRID)) == (sin is np.sin)
    assert np.abs(trajectory["pull"] - 3 * np.sin(4 * GRID)).max() < 1e-15


@every_integrator
def test_function_that_branches(driven: rs.Model, integrator: Any) -> None:
    def pull(t: float) -> float:
        if t < 0.5:
            return 1.0
        return -2.0

    trajectory = rs.simulate(driven, GRID, integrator, inputs={"pull": pull})
    first = GRID <= 0.5
    before = piecewise_linear(GRID[first], np.array([0, 0.5]), np.array([1.0, 1.0]), 0.0, 0.5)
    assert np.abs(trajectory["b.p_x"][first] - before).max() < CLOSE
    x, v = trajectory["b.p_x"][first][-1], trajectory["b.v_x"][first][-1]
    after = piecewise_linear(GRID[~first], np.array([0.5, 2]), np.array([-2.0, -2.0]), x, v)
    assert np.abs(trajectory["b.p_x"][~first] - after).max() < CLOSE


@every_integrator
def test_samples_are_linear_between_and_constant_outside(
    driven: rs.Model, integrator: Any
) -> None:
    trajectory = rs.simulate(driven, GRID, integrator, inputs={"pull": (KNOTS, FORCES)})
    knots, forces = np.array([0, *KNOTS, 2.0]), np.array([1.0, *FORCES, 1.0])
    expected = piecewise_linear(GRID, knots, forces, 0.0, 0.5)
    # Steps are not ended at the kinks, which costs an adaptive method a digit.
    assert np.abs(trajectory["b.p_x"] - expected).max() < 10 * CLOSE
    assert np.abs(trajectory["pull"] - np.interp(GRID, KNOTS, FORCES)).max() == 0


@pytest.mark.parametrize("kind", [
    lambda f: f, lambda f: lambda t: f * np.sin(t), lambda f: lambda t: f * math.sin(t),
    lambda f: ([0, 1, 2], [0, f, 0]),
], ids=["constant", "traced", "called", "samples"])  # fmt: skip
def test_every_run_has_its_own_input(driven: rs.Model, kind: Any) -> None:
    """The model is linear and starts at rest: answers are in proportion, none is a stale one."""
    start = {"b.v_x": 0.0}
    ends = [rs.simulate(driven, 1.0, TIGHT[2], inputs={"pull": kind(f)}, start=start)["b.p_x"][-1]
            for f in (1.0, 2.0, -3.0)]  # fmt: skip
    assert np.abs(np.array(ends) - ends[0] * np.array([1, 2, -3])).max() < CLOSE
    assert abs(ends[0]) > 1e-3


def test_time_in_the_scene_equals_an_input(driven: rs.Model) -> None:
    model = oscillator(3 * np.sin(4 * rs.TIME))
    assert model.n_u == 0
    trajectory = rs.simulate(model, GRID, TIGHT[0])
    assert np.abs(trajectory["b.p_x"] - sine_driven(GRID, 3.0, 4.0, 0.0, 0.5)).max() < CLOSE


def test_parameters(driven: rs.Model) -> None:
    trajectory = rs.simulate(driven, GRID, TIGHT[2], params={"k": 90.0})
    expected, _ = closed_forms.damped_oscillator(GRID, M, 90.0, D, 0.5)
    assert np.abs(trajectory["b.p_x"] - expected).max() < CLOSE
    assert trajectory.parameters == {"k": 90.0}
    assert (trajectory["k"] == 90.0).all()
    again = rs.simulate(driven, GRID, TIGHT[2])
    expected, _ = closed_forms.damped_oscillator(GRID, M, K, D, 0.5)
    assert np.abs(again["b.p_x"] - expected).max() < CLOSE
    assert again.parameters == {"k": K}


def test_parameters_move_the_start() -> None:
    x0 = rs.Param("x0", 0.1, "m")
    body = rs.RigidBody("b", 1.0, [1, 1, 1], position=[x0, 0, 0], velocity=[1, 0, 0])
    model = rs.compile_scene(rs.Scene("free", [body], []))
    assert rs.simulate(model, 1.0)["b.position"][0, 0] == 0.1
    assert rs.simulate(model, 1.0, params={"x0": 0.7})["b.position"][0, 0] == 0.7
    both = rs.simulate(model, 1.0, params={"x0": 0.7}, start={"b.p_x": 2.0})
    assert both["b.position"][0, 0] == 2.0


def test_start(driven: rs.Model) -> None:
    start = {"b.p_x": 0.3, "b.v_x": -1.0}
    trajectory = rs.simulate(driven, GRID, TIGHT[2], start=start)
    expected, _ = closed_forms.damped_oscillator(GRID, M, K, D, -1.0, 0.3)
    assert np.abs(trajectory["b.p_x"] - expected).max() < CLOSE
    assert rs.simulate(driven, GRID)["b.v_x"][0] == 0.5  # the next run starts as described


@every_integrator
def test_restart_continues_the_trajectory(driven: rs.Model, integrator: Any) -> None:
    """The input depends on time, so the second part must also start at its own time."""
    inputs = {"pull": lambda t: 3 * np.sin(4 * t)}
    whole = rs.simulate(driven, GRID, integrator, inputs=inputs)
    first = rs.simulate(driven, GRID[:21], integrator, inputs=inputs)
    assert set(first.state_at_end) == {label.name for label in driven.x_labels}
    second = rs.simulate(driven, GRID[20:], integrator, inputs=inputs, start=first.state_at_end)
    assert second.t[0] == first.t[-1]
    for name in ("b.position", "b.velocity", "c.force_local"):
        joined = np.concatenate([first[name], second[name][1:]])
        assert np.abs(joined - whole[name]).max() < CLOSE * K, name


def test_output_grids(driven: rs.Model) -> None:
    uniform = rs.simulate(driven, 2.0, TIGHT[2])
    assert uniform.t == pytest.approx(np.linspace(0, 2, 201), abs=1e-15)
    for grid in ([0, 0.013, 1.1, 2.0], np.array([0, 2]), (0, 1e-9, 2.0)):
        trajectory = rs.simulate(driven, grid, TIGHT[2])
        assert trajectory.t == pytest.approx(np.array(grid, float), abs=0)
        assert len(trajectory["b.position"]) == len(grid)
        assert abs(trajectory["b.p_x"][-1] - uniform["b.p_x"][-1]) < CLOSE
    late = rs.simulate(driven, [5.0, 7.0], TIGHT[2])
    assert abs(late["b.p_x"][-1] - uniform["b.p_x"][-1]) < CLOSE  # nothing depends on time here


@every_integrator
def test_statistics(driven: rs.Model, integrator: Any) -> None:
    stats = rs.simulate(driven, GRID, integrator).stats
    assert stats["evaluations"] >= stats["steps"] >= 40
    assert stats["time"] > 0
    assert stats["time_build"] >= 0


def test_file_round_trip(driven: rs.Model, tmp_path: Path) -> None:
    trajectory = rs.simulate(driven, GRID, inputs={"pull": lambda t: np.sin(t)})
    force = trajectory["c.force_local"]
    path = trajectory.save(tmp_path / "run.v1")
    assert path.name == "run.v1.npz"
    loaded = rs.Trajectory.load(path)
    for name in (*trajectory.states, "pull", "k", "c.force_local"):
        assert np.array_equal(loaded[name], trajectory[name]), name
        assert loaded.column(name).unit == trajectory.column(name).unit
    assert np.array_equal(loaded.t, trajectory.t)
    for field in ("name", "outcome", "report", "stats", "parameters", "states", "digest"):
        assert getattr(loaded, field) == getattr(trajectory, field), field
    assert loaded.state_at_end == trajectory.state_at_end
    assert force.shape == (41, 3)
    with pytest.raises(ValueError, match=r"no column 'b.position'; it holds b.p_x"):
        loaded["b.position"]
    with np.load(path, allow_pickle=False) as file:  # raises if any array were pickled
        assert all(file[name].dtype != object for name in file.files)


def test_file_is_whole_or_absent(
    driven: rs.Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trajectory = rs.simulate(driven, GRID)
    before = trajectory.save(tmp_path / "kept").read_bytes()

    def half(file: Any, **arrays: Any) -> None:
        file.write(b"PK")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez_compressed", half)
    for name in ("kept", "new"):
        with pytest.raises(ValueError, match="no space left"):
            trajectory.save(tmp_path / name)
    assert os.listdir(tmp_path) == ["kept.npz"]
    assert (tmp_path / "kept.npz").read_bytes() == before


def test_file_in_no_folder_or_of_another_kind(driven: rs.Model, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"cannot write to .*missing .*make the folder"):
        rs.simulate(driven, GRID).save(tmp_path / "missing" / "run")
    np.savez(tmp_path / "foreign.npz", t=np.zeros(3))
    np.savez(tmp_path / "pickled.npz", header=np.array([{"format": 1}], dtype=object))
    (tmp_path / "text.npz").write_text("t, x\n")
    for name in ("foreign", "pickled", "text", "absent"):
        with pytest.raises(ValueError, match=f"{name}.npz: not a trajectory of rbsd_sym"):
            rs.Trajectory.load(tmp_path / f"{name}.npz")


@pytest.mark.parametrize("integrator", [
    rs.Idas(1e-10, 1e-12, max_steps=2000), rs.Rosenbrock(1e-10, 1e-12),
    rs.ExplicitRK(1e-10, 1e-12),
], ids=by_name)  # fmt: skip
def test_blow_up_keeps_the_trajectory(integrator: Any, tmp_path: Path) -> None:
    trajectory = rs.simulate(doomed(), np.arange(0, 2, 0.0375), integrator, throw=False)
    assert trajectory.outcome in (rs.Outcome.too_many_steps, rs.Outcome.step_too_small)
    assert not trajectory.outcome.ok
    assert trajectory.t[-1] == pytest.approx(0.975)  # the last grid point before 1 s
    expected = 1 / (1 - trajectory.t)
    assert np.abs(trajectory["b.position"][:, 0] / expected - 1).max() < 1e-6
    assert 0.975 <= trajectory.stats["t_failed"] < 1.0 + 1e-6
    for word in (trajectory.outcome.value, "last saved state at t = 0.975 s", "b.v_x", "m/s", "; "):
        assert word in trajectory.report, word
    loaded = rs.Trajectory.load(trajectory.save(tmp_path / "failed"))
    assert (loaded.outcome, loaded.report) == (trajectory.outcome, trajectory.report)
    with pytest.raises(rs.IntegrationError, match=r"^doomed: ") as caught:
        rs.simulate(doomed(), np.arange(0, 2, 0.0375), integrator)
    assert caught.value.trajectory.report in str(caught.value)
    assert np.array_equal(caught.value.trajectory["b.p_x"], trajectory["b.p_x"])


@pytest.mark.parametrize("kind", [rs.Idas, rs.Rosenbrock, rs.ExplicitRK])
def test_too_many_steps(driven: rs.Model, kind: Any) -> None:
    integrator = kind(1e-10, 1e-12, max_steps=60)
    trajectory = rs.simulate(driven, [0, 1e-3, 2e-3, 10.0, 11.0], integrator, throw=False)
    assert trajectory.outcome is rs.Outcome.too_many_steps
    assert list(trajectory.t) == [0, 1e-3, 2e-3]
    expected, _ = closed_forms.damped_oscillator(trajectory.t, M, K, D, 0.5)
    assert np.abs(trajectory["b.p_x"] - expected).max() < CLOSE
    assert "raise max_steps" in trajectory.report


TURN = np.array([1.0, 1.0, 1.0])
POLE = rotations.rotation_about(1, np.pi / 2)


@every_integrator
def test_tait_bryan_body_through_the_pole(integrator: Any) -> None:
    """A free spherical body meets a pitch of 90 degrees at 1 s.

    The angles' rates have a peak there, as narrow as the body passes near. Whether the integrator
    sees it is chance; either way it keeps what is right and returns nothing that is wrong.
    """
    body = rs.RigidBody("b", 1, [1, 1, 1], rotation=POLE @ rotations.exp_so3(-TURN),
                        angular_velocity=TURN)  # fmt: skip
    model = rs.compile_scene(rs.Scene("pole", [body], []), rs.TaitBryan(), minimal=False)
    trajectory = rs.simulate(model, GRID, integrator, throw=False)
    expected = np.array([POLE @ rotations.exp_so3((t - 1) * TURN) for t in trajectory.t])
    assert np.abs(trajectory["b.rotation_matrix"] - expected).max() < 1e-6
    if trajectory.outcome.ok:
        assert trajectory.t[-1] == 2.0
    else:
        assert trajectory.t[-1] == pytest.approx(1.0, abs=0.051)
        assert "b.a_" in trajectory.report


@every_integrator
def test_tait_bryan_body_at_the_pole(integrator: Any) -> None:
    """Started at the singularity nothing can be done but say so, at the start."""
    body = rs.RigidBody("b", 1, [1, 1, 1], angular_velocity=TURN)
    model = rs.compile_scene(rs.Scene("pole", [body], []), rs.TaitBryan(), minimal=False)
    trajectory = rs.simulate(model, GRID, integrator, start={"b.a_y": np.pi / 2}, throw=False)
    assert trajectory.outcome in (rs.Outcome.step_too_small, rs.Outcome.solver_failed)
    assert list(trajectory.t) == [0.0]
    assert trajectory["b.position"].shape == (1, 3)
    assert "fastest there: b.a_x" in trajectory.report


def integrators_found() -> list[type]:
    """Every class with a `solve` in a module of rbsd_sym.integrators."""
    package = rbsd_sym.integrators
    modules = [importlib.import_module(f"{package.__name__}.{module.name}")
               for module in pkgutil.iter_modules(package.__path__)]
    return [kind for module in modules for _, kind in inspect.getmembers(module, inspect.isclass)
            if kind.__module__ == module.__name__ and hasattr(kind, "solve")]


def error_at(model: rs.Model, integrator: Any) -> float:
    """Largest error of the oscillator over 2 s, relative to its amplitude."""
    trajectory = rs.simulate(model, GRID, integrator)
    expected, _ = closed_forms.damped_oscillator(GRID, M, K, D, 0.5)
    return float(np.abs(trajectory["b.p_x"] - expected).max() / np.abs(expected).max())


@pytest.mark.parametrize("kind", integrators_found())
def test_error_follows_tolerance_or_step(driven: rs.Model, kind: Any) -> None:
    """Adaptive: within 10 rtol, falling by 100 or more for 1e3. Fixed step: order 2 or better."""
    if any(field.name == "step" for field in dataclasses.fields(kind)):
        coarse, fine = (error_at(driven, kind(h)) for h in (5e-3, 2.5e-3))
        assert coarse / fine > 3.6
        assert fine < 1e-3
        return
    tolerances = [1e-4, 1e-7, 1e-10]
    errors = [error_at(driven, kind(rtol, 1e-2 * rtol)) for rtol in tolerances]
    assert all(error < 10 * rtol for error, rtol in zip(errors, tolerances, strict=True)), errors
    assert all(a > 100 * b for a, b in pairwise(errors)), errors


def test_trajectories_and_failures_travel_between_processes() -> None:
    trajectory = rs.simulate(rs.compile_scene(reference.build("mini")), 0.1)
    energy = trajectory["energy"]
    copy = pickle.loads(pickle.dumps(trajectory))
    assert (copy["energy"] == energy).all()
    with pytest.raises(ValueError, match="no column 'momentum'"):
        copy["momentum"]
    failure = pickle.loads(pickle.dumps(rs.IntegrationError(trajectory)))
    assert str(failure) == str(rs.IntegrationError(trajectory))
    assert (failure.trajectory.t == trajectory.t).all()
