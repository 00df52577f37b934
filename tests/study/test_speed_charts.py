"""The machinery of the speed charts: fronts, judges, rows of failures, pages, scenes for peers."""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from charts import contenders, pages, speed
from charts.contenders import POINTS, Contender
from charts.front import front, sober, time_at
from oracles import scenes
from scenes import reference
from scenes.speed import CASES, Case, rates

import rbsd_sym as rs

WITH_PEERS = [name for name in CASES if name not in ("stick_slip", "massless", "chain256")]
TINY = (1e-4, 1e-7)


def test_time_at_equal_error_on_a_closed_form() -> None:
    """Error (3 t)^-4: the time to 1e-6 is 1e6^(1/4) / 3, from runs on either side of it."""
    runs = [((3 * t) ** -4, t) for t in (0.5, 2.0, 7.0, 20.0, 90.0)]
    assert time_at(runs, 1e-6) == pytest.approx(1e6**0.25 / 3, rel=1e-12)
    for error, t in runs:
        assert time_at(runs, error) == pytest.approx(t, rel=1e-12)


def test_slow_runs_failures_and_lucky_plateaus_take_no_part() -> None:
    runs: list[tuple[float | None, float]] = [(1e-2, 1.0), (1e-4, 10.0), (1e-6, 100.0)]
    noise = [(1e-3, 50.0), (1e-5, 60.0), (None, 0.1), (math.nan, 0.1), (math.inf, 0.1), (0.0, 0.1),
             (1e-4, 11.0), (10.0, 2.0)]  # fmt: skip
    assert len(front(runs + noise)) == 2
    assert time_at(runs + noise, 1e-5) == pytest.approx(10**1.5, rel=1e-12)


def test_luck_does_not_win() -> None:
    """A run better than the next tighter one counts with the error of that one."""
    runs: list[tuple[float | None, float]] = [(1e-2, 1.0), (1e-9, 2.0), (1e-4, 4.0), (None, 5.0),
                                              (1e-6, 8.0)]  # fmt: skip
    assert sober(runs) == [(1e-2, 1.0), (1e-4, 2.0), (1e-4, 4.0), (None, 5.0), (1e-6, 8.0)]
    assert time_at(runs, 1e-6) == pytest.approx(2 ** (4 / 7), rel=1e-12)
    assert time_at(sober(runs), 1e-6) == pytest.approx(8.0)


def test_beyond_the_runs() -> None:
    runs = [(1e-4, 10.0), (1e-6, 100.0)]
    assert time_at(runs, 1e-7) is None
    assert time_at(runs, 1e-1) == pytest.approx(10.0)
    assert time_at([], 1e-3) is None
    assert time_at([(None, 1.0)], 1e-3) is None


@cache
def case() -> Case:
    return CASES["single"]()


@cache
def model() -> rs.Model:
    return rs.compile_scene(case().scene)


@pytest.fixture(scope="module")
def judge(tmp_path_factory: pytest.TempPathFactory) -> speed.Judge:
    return speed.judge_of(case(), model(), tmp_path_factory.mktemp("judge"))


def contender(
    run: Callable[[float], Any], family: str = "Idas", method: str = "Idas", fixed: bool = False,
    efforts: tuple[float, ...] = TINY,
) -> Contender:  # fmt: skip
    return Contender(family, method, efforts, fixed, run, lambda effort: 1e-3 / effort, str)


def simulated(scene: rs.Scene) -> Callable[[float], Any]:
    other, grid = rs.compile_scene(scene), np.linspace(0, case().t_end, POINTS + 1)
    return lambda rtol: rs.simulate(other, grid, rs.Idas(rtol, rtol / 100), throw=False)


def test_floor_is_no_smaller_than_the_reference_is_wrong(judge: speed.Judge) -> None:
    """Against the stored final state in extended precision."""
    assert judge.names[0] != judge.names[1]
    assert 0 < judge.floor < 1e-9
    assert reference.error("single", judge.reference) < 3 * judge.floor


def test_rows_of_a_run(judge: speed.Judge) -> None:
    loose, tight = speed.climb(contender(simulated(case().scene)), judge, 1e9)
    assert len(loose) == len(speed.COLUMNS)
    assert loose[speed.COLUMNS.index("outcome")] == "reached_end"
    for row in (loose, tight):
        parts = [row[speed.COLUMNS.index(f"error_{q}")] for q in speed.QUANTITIES]
        assert row[speed.ERROR] == max(parts)
        assert 0 < row[speed.AT_END] <= row[speed.ERROR]
    assert tight[speed.ERROR] < 1e-2 * loose[speed.ERROR] < 1e-4
    assert loose[speed.TIME] == 1e-3 / TINY[0]


def test_wrong_and_broken_contenders_are_rows(judge: speed.Judge, tmp_path: Path) -> None:
    """A run in half the gravity claims success; one that cannot be built has no error at all."""
    light = simulated(replace(case().scene, gravity=(0, 0, -4.9)))
    broken = lambda effort: contenders.failed("single", "no")  # noqa: E731
    rows = [
        *speed.climb(contender(light, "RK4", "wrong"), judge, 1e9),
        *speed.climb(contender(broken, "Rosenbrock", "broken"), judge, 1e9),
        *speed.climb(contender(simulated(case().scene)), judge, 1e9),
    ]
    wrong, failures = rows[:2], rows[2:4]
    assert all(row[speed.ERROR] > 0.1 and row[-2] == "reached_end" for row in wrong)
    assert all(row[speed.ERROR] is None and row[-2] == "solver_failed" for row in failures)
    table = rs.study.Table(speed.COLUMNS, ("",) * len(speed.COLUMNS), tuple(rows))
    times = speed.times_of(rows)
    assert list(times) == [("Idas", "Idas")]
    drawn = pages.draw("single", table, times, 1e-6).axes[0]
    labels = [text.get_text() for text in drawn.get_legend().get_texts()]
    assert {"Idas", "wrong", "broken", "failed, at the top"} < set(labels)
    assert any("of no use" in label for label in labels)
    crosses = [line for line in drawn.lines if line.get_marker() == "x" and len(line.get_xdata())]
    assert sum(len(line.get_xdata()) for line in crosses) == len(failures)
    pages.write(tmp_path, case(), table, judge.names, (times, times), ("Idas", ""))
    pages.summary(tmp_path)
    text = (tmp_path / "single.md").read_text()
    assert "Not reached by: broken; wrong." in text
    with (tmp_path / "single.csv").open() as file:
        assert len(list(csv.reader(file))) == 1 + len(rows)
    assert "| [single](single.md) | Idas |" in (tmp_path / "README.md").read_text()


def test_equal_steps_close_in_on_the_target(judge: speed.Judge) -> None:
    """Three more runs between the last that misses 1e-6 and the first that does not."""
    grid = np.linspace(0, case().t_end, POINTS + 1)
    run = lambda n: rs.simulate(model(), grid, rs.RK4(case().t_end / n), throw=False)  # noqa: E731
    rows = speed.climb(contender(run, fixed=True, efforts=(512.0, 4096.0)), judge, 1e9)
    tried = [float(row[2]) for row in rows]
    assert len(tried) == 5
    assert tried == sorted(tried)
    assert {512, 1448, 4096} < set(tried)
    good = {n: row[speed.ERROR] < 1e-6 for n, row in zip(tried, rows, strict=True)}
    ends = max(n for n in tried if not good[n]), min(n for n in tried if good[n])
    assert 1 < ends[1] / ends[0] < 8 ** (1 / 8) * 1.02


@pytest.mark.parametrize("name", WITH_PEERS)
@pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")
def test_peers_get_the_same_scene(name: str) -> None:
    """Rates at a state off the start: the oracle's, with what lies beside its format, and ours."""
    given = CASES[name]()
    full = rs.compile_scene(given.scene, minimal=False)
    state = scenes.start_state(given.peer)  # type: ignore[arg-type]
    state = state + 0.01 * np.random.default_rng(1).normal(size=state.shape)
    p = [label.start for label in full.dae.p_labels]
    ours = np.array(full.function("ode")(0.03, state.reshape(-1), [], [], p)).reshape(-1, 13)
    theirs = rates(given, 0.03, state)
    assert np.abs(ours - theirs).max() < 1e-13 * np.abs(theirs).max()


def test_states_of_peers_become_columns() -> None:
    """At the start those of the scene, with the centre of mass away from the body's origin."""
    given = CASES["governor"]()
    start = scenes.start_state(given.peer)  # type: ignore[arg-type]
    made = contenders.trajectory_of(given, np.array([0.0, 1.0]), [start, start])
    for body in given.scene.bodies:
        for ours, theirs in (("position", body.position), ("velocity", body.velocity),
                             ("angular_velocity", body.angular_velocity)):  # fmt: skip
            expected = np.array(theirs, float)
            assert np.abs(made[f"{body.name}.{ours}"] - expected).max() < 1e-14


@pytest.mark.parametrize("name", ["governor", "bricard", "stiff1e3"])
@pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")
def test_exudyn_runs_turned_joints_and_point_springs(name: str) -> None:
    """Of order 6 in 1600 steps it has errors below 1e-10; `rotvec` nodes do not get there."""
    sys.__dict__.setdefault("exudynFast", True)
    pytest.importorskip("exudyn")
    given = CASES[name]()._replace(t_end=0.01)
    every = contenders.exudyn_methods(given)
    found = next(c for c in every if c.method == "Exudyn RK67, rxyz").run(1600.0)
    assert len(found.t) == POINTS + 1
    ours = rs.simulate(rs.compile_scene(given.scene), found.t, rs.Idas(1e-11, 1e-13))
    for body in given.scene.bodies:
        for column in ("position", "velocity", "angular_velocity"):
            a, b = found[f"{body.name}.{column}"], ours[f"{body.name}.{column}"]
            assert np.abs(a - b).max() < 1e-8 * max(1.0, np.abs(b).max()), column


def test_an_unknown_scene_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert speed.main(["marble_run"]) == 1
    assert "no scene marble_run" in capsys.readouterr().out
