"""Exported C of models with events: functions under the one signature, and whole simulations."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from oracles import discontinuities as closed
from paths import MODELS
from scenes.events import dropped

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
STICK_SLIP = load_model_file(MODELS / "stick_slip.py").scene
METHODS = (rs.Rosenbrock(1e-10, 1e-12), rs.ExplicitRK(1e-10, 1e-12))


def simulator(model: rs.Model, folder: Path, method: Any) -> rs.Simulator:
    return rs.load_simulator(rs.export_simulator(model, folder, method), model)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_bounces_in_c(method: Any, tmp_path: Path) -> None:
    run = simulator(dropped(rs.Impact(2, 0.8)), tmp_path, method)(1.1)
    times = np.array([t for t, _ in run.events])
    exact, _ = closed.ball_impacts(len(times), 0.1, 9.81, 0.8)
    assert len(times) == 9
    assert np.abs(times - exact).max() < 1e-12  # free flight: the methods are exact
    assert {name for _, name in run.events} == {"floor.impact_z_hits"}
    heights, _ = closed.state_at(closed.ball_phases(0.1, 9.81, 0.8), run.t)
    assert np.abs(run["ball.p_z"] - heights).max() < 1e-12


@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8])
def test_contact_in_c(stiffness: float, tmp_path: Path) -> None:
    run = simulator(dropped(rs.Contact(2, stiffness)), tmp_path, rs.Rosenbrock(1e-12, 1e-14))(0.2)
    (closes, _), (opens, _) = run.events
    contact = closed.drop_contact(1, stiffness, 0.1, 9.81)
    assert abs((opens - closes) / contact.duration - 1) < 1e-9


def test_same_events_in_c_as_in_python(tmp_path: Path) -> None:
    model, method = rs.compile_scene(STICK_SLIP()), rs.Rosenbrock(1e-12, 1e-14)
    here, there = rs.simulate(model, 20.0, method), simulator(model, tmp_path, method)(20.0)
    assert [name for _, name in here.events] == [name for _, name in there.events]
    phases = closed.belt_phases(20, 1, 4, 10, 0.4, 0.3, 0.5, 0, 0.5)
    for run in (here, there):
        times = [t for t, _ in run.events]
        assert np.abs(np.array(times) - [p.start for p in phases[1:]]).max() < 1e-9
        place, speed = closed.state_at(phases, run.t)
        assert np.abs(run["block.p_x"] - place).max() < 1e-9
        assert np.abs(run["block.v_x"] - speed).max() < 2e-9


def test_event_that_meets_an_output_time(tmp_path: Path) -> None:
    """Slip begins at t = 2, where one stretch of the C simulation ends and the next begins."""
    run = simulator(rs.compile_scene(STICK_SLIP()), tmp_path, rs.Rosenbrock())
    for points in (200, 201, 7, 20, 1):
        (first, name), *_ = run(20.0, points=points).events
        assert name == "spring.friction_x_slips"
        assert first == pytest.approx(2, abs=1e-8)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_endless_bounces_end_in_c(method: Any, tmp_path: Path) -> None:
    run = simulator(dropped(rs.Impact(2, 0.5)), tmp_path, method)(2.0)
    end = closed.ball_zeno(0.1, 9.81, 0.5)
    assert run.outcome is rs.Outcome.endless_events
    assert run.t[-1] <= end < run.t[-1] + 0.01
    assert 20 < run.stats["events"] < 100
    assert abs(run.events[-1][0] - end) < 1e-9


def test_stop_in_c(tmp_path: Path) -> None:
    def events(mbs: Any, t: Any, item: Any, data: Any, u: Any, *rest: Any) -> list[rs.Event]:
        return [rs.Event(u[2] - 0.05, stop=True, name="half")]

    model = dropped(events=events)
    run = simulator(model, tmp_path, rs.ExplicitRK())(1.0)
    reference = rs.simulate(model, 1.0, rs.ExplicitRK())
    t_half = np.sqrt(2 * 0.05 / 9.81)
    for found in (run, reference):
        assert found.outcome is rs.Outcome.event
        assert found.events == ((pytest.approx(t_half, abs=1e-12), "floor.half"),)
        assert found.t[-1] <= t_half < found.t[-1] + 0.005


def test_inputs_and_parameters_in_events(tmp_path: Path) -> None:
    k = rs.Param("k", 1e4, "N/m")
    model = dropped(rs.Contact(2, k))
    run = simulator(model, tmp_path, rs.Rosenbrock(1e-12, 1e-14))
    for value in (1e4, 4e4):
        (closes, _), (opens, _) = run(0.2, params={"k": value}).events
        assert opens - closes == pytest.approx(
            closed.drop_contact(1, value, 0.1, 9.81).duration, rel=1e-9
        )
    belt = rs.Input("belt", "m/s", 0.5)
    model = rs.compile_scene(STICK_SLIP(belt))
    sampled = simulator(model, tmp_path / "belt", rs.Rosenbrock(1e-12, 1e-14))
    phases = closed.belt_phases(6, 1, 4, 10, 0.4, 0.3, 0.5, 0, 0.5)
    times = [t for t, _ in sampled(6.0, inputs={"belt": ([0, 3, 6], [0.5, 0.5, 0.5])}).events]
    assert np.abs(np.array(times) - [p.start for p in phases[1:]]).max() < 1e-9


def test_functions_of_events_in_c(tmp_path: Path) -> None:
    model = rs.compile_scene(STICK_SLIP())
    artefact = rs.export_c(model, tmp_path)
    assert {"zero", "jump"} <= set(artefact.functions)
    library = rs.load_c(artefact, model)
    rng = np.random.default_rng(5)
    for _ in range(20):
        x, z = rng.standard_normal(3), rng.standard_normal(1)
        x[2] = rng.integers(-1, 2)
        for name in ("zero", "jump"):
            here, there = (np.array(ca.DM(f.function(name)(0.0, x, z, [], [])))
                           for f in (model, library))  # fmt: skip
            assert np.abs(here - there).max() <= 1e-15 * (1 + np.abs(here).max())
    header = (tmp_path / "stick_slip.h").read_text()
    assert "STICK_SLIP_N_EVENTS = 3" in header
    assert "STICK_SLIP_EVENT_SPRING_FRICTION_X_STICKS = 0" in header


def test_example_of_a_simulator_with_events_runs(tmp_path: Path) -> None:
    rs.export_simulator(dropped(rs.Impact(2, 0.8)), tmp_path, rs.ExplicitRK())
    strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function"]
    files = ["example.c", "drop_simulate.c"]
    subprocess.run(["cc", *strict, *files, "-lm", "-o", "run"], cwd=tmp_path, check=True)
    out = subprocess.run([tmp_path / "run"], capture_output=True, text=True, check=True).stdout
    assert "code 0 at t = 1 " in out


def test_caller_may_do_without_the_record(tmp_path: Path) -> None:
    """NULL for the statistics, and no room for events."""
    model = dropped(rs.Impact(2, 0.8))
    run = simulator(model, tmp_path, rs.ExplicitRK())
    end = np.zeros(3)
    none = None
    code = run.function(0.0, 1.0, none, 1, none, none, none, 1e-10, 1e-12, 1,
                        end.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), none)  # fmt: skip
    assert code == 0
    assert end[0] == pytest.approx(run(1.0, rtol=1e-10, atol=1e-12)["ball.p_z"][-1], abs=1e-12)


def test_what_c_does_not_do(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"model 'drop': events.*Rosenbrock\(\) or ExplicitRK"):
        rs.export_simulator(dropped(rs.Impact(2, 0.8)), tmp_path, rs.Dop853())
    model = dropped(data=[0.0], post_newton_step=lambda mbs, t, i, data, *rest: [0, -1, data[0]])
    with pytest.raises(ValueError, match=r"model 'drop': post_newton_step.*step_function"):
        rs.export_simulator(model, tmp_path, rs.Rosenbrock())
