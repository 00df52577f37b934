"""Sweeps over processes, threads and Dask, with failures, interruption and resumption."""

from __future__ import annotations

import functools
import math
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from paths import TESTS, environment
from scenes.reference import build

import rbsd_sym as rs
from rbsd_sym.study import sweep

POINTS = [{"k": k, "law": "a"} for k in range(6)]


class Serial(Executor):
    """Runs each call at once in this process; counts them."""

    def __init__(self) -> None:
        self.calls = 0

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future:
        self.calls += 1
        future: Future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


class Cancelling(Serial):
    """An executor that cancels its second call."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future:
        if self.calls != 1:
            return super().submit(fn, *args, **kwargs)
        self.calls += 1
        future: Future = Future()
        future.cancel()
        return future


def square(point: dict[str, Any]) -> float:
    return point["k"] ** 2


def later_first(point: dict[str, Any]) -> dict[str, Any]:
    time.sleep(0.02 * (6 - point["k"]))
    return {"square": square(point), "list": np.arange(2) + point["k"]}


def fails_at_three(point: dict[str, Any]) -> dict[str, Any]:
    if point["k"] == 3:
        raise ValueError("three\n  is too many")
    return {"square": square(point), "done": True}


def dies_at_three(point: dict[str, Any]) -> float:
    if point["k"] == 3:
        os._exit(7)
    return square(point)


def interrupts_at_three(point: dict[str, Any]) -> float:
    if point["k"] == 3:
        raise KeyboardInterrupt
    return square(point)


def odd_values(point: dict[str, Any]) -> dict[str, Any]:
    values = {"nan": math.nan, "inf": math.inf, "minus": -math.inf, "zero": -0.0}
    return {"x": values[point["which"]], "texts": ["a", point["which"]], "none": None}


def slow_after_three(point: dict[str, Any]) -> float:
    if point["k"] >= 3:
        time.sleep(60)
    return os.getpid()


def leaves(point: dict[str, Any]) -> None:
    sys.exit("enough")


def end_of_mini(point: dict[str, Any]) -> dict[str, Any]:
    """The real thing: a reference scene with other parameters of the integrator and the start."""
    model = mini()
    start = {model.dae.x_labels[-1].name: point["velocity"]}
    trajectory = rs.simulate(model, point["t_end"], start=start)
    return {"energy": trajectory["energy"][-1], "outcome": trajectory.outcome.name}


@functools.cache
def mini() -> rs.Model:
    return rs.compile_scene(build("mini"))


def stuck(point: dict[str, Any]) -> None:
    """An exception that cannot be pickled."""
    raise rs.IntegrationError(rs.simulate(mini(), 0.1))


def test_rows_come_in_the_order_of_the_points() -> None:
    with ThreadPoolExecutor(6) as pool:
        table = sweep(later_first, POINTS, pool)
        assert pool.submit(square, {"k": 2}).result() == 4, "it is not shut down"
    assert table.columns == ("k", "law", "square", "list", "error")
    np.testing.assert_array_equal(table.column("square"), np.arange(6.0) ** 2)
    np.testing.assert_array_equal(table.column("list"), np.arange(6)[:, None] + [0.0, 1.0])
    assert table.column("error").tolist() == [None] * 6


def test_processes_of_our_own_with_a_failure_and_a_file(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    table = sweep(fails_at_three, POINTS, file=file)
    assert table.rows[3] == (3, "a", None, None, "ValueError: three is too many")
    np.testing.assert_array_equal(table.column("square"), [0, 1, 4, np.nan, 16, 25])
    serial = Serial()
    assert sweep(fails_at_three, POINTS, serial, file).rows == table.rows
    assert serial.calls == 0, "the failed point is kept"
    sweep(fails_at_three, POINTS, serial, file, retry_failed=True)
    assert serial.calls == 1


def test_a_process_that_dies_costs_its_point_alone(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    table = sweep(dies_at_three, POINTS, file=file)
    assert "BrokenProcessPool: the process died during this point (exit code 7" in table.rows[3][-1]
    np.testing.assert_array_equal(table.column("value"), [0, 1, 4, np.nan, 16, 25])
    assert sweep(dies_at_three, POINTS, Serial(), file).rows == table.rows


def test_a_pool_handed_in_that_breaks_says_nothing_of_its_points(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        table = sweep(dies_at_three, POINTS, pool, file)
    assert all("BrokenProcessPool" in row[-1] for row in table.rows[3:])
    again = sweep(square_as("dies_at_three"), POINTS, Serial(), file)
    np.testing.assert_array_equal(again.column("value"), np.arange(6.0) ** 2)


def square_as(name: str) -> Callable[[dict[str, Any]], float]:
    """`square` under the name of another function: a file knows functions by name."""

    def renamed(point: dict[str, Any]) -> float:
        return square(point)

    renamed.__qualname__ = name
    return renamed


def test_cancelled_points_are_run_again(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    table = sweep(square, POINTS, Cancelling(), file)
    assert table.rows[1][-1] == "CancelledError (from the executor)"
    serial = Serial()
    assert sweep(square, POINTS, serial, file).rows[1] == (1, "a", 1, None)
    assert serial.calls == 1


def test_an_interrupted_sweep_goes_on(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    with pytest.raises(KeyboardInterrupt):
        sweep(interrupts_at_three, POINTS, Serial(), file)
    assert len(file.read_text().splitlines()) == 1 + 3
    serial = Serial()
    table = sweep(square_as("interrupts_at_three"), POINTS, serial, file)
    assert serial.calls == 3
    np.testing.assert_array_equal(table.column("value"), np.arange(6.0) ** 2)


def test_any_torn_end_of_a_file_is_redone(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    whole = sweep(square, POINTS[:3], Serial(), file)
    text = file.read_bytes()
    for end in range(len(text)):
        file.write_bytes(text[:end])
        serial = Serial()
        assert sweep(square, POINTS[:3], serial, file) == whole
        assert serial.calls == min(3, 4 - text[:end].count(b"\n"))
        assert file.read_bytes() == text
    lines = text.splitlines(keepends=True)
    for damaged in (b"\0\0\n", b"[1]\n", b'{"point": 9, "error": "x"}\n', b'{"point": 1}\n'):
        file.write_bytes(b"".join([*lines[:2], damaged, *lines[3:]]))
        assert sweep(square, POINTS[:3], Serial(), file) == whole


def test_files_of_something_else_are_refused_and_left_alone(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    sweep(square, POINTS, Serial(), file)
    text = file.read_bytes()
    others: list[tuple[Any, Any, str]] = [
        (fails_at_three, POINTS, "of another sweep, its function.*test_study.square.*delete it"),
        (square, POINTS[:5], "its number of points: 6, here 5"),
        (square, [{"k": 1.0}] * 6, "its names"),
        (square, POINTS[::-1], "other values of the points"),
    ]
    for fn, points, words in others:
        with pytest.raises(ValueError, match=words):
            sweep(fn, points, Serial(), file)
        assert file.read_bytes() == text
    for foreign in (b"k,value\n1,1\n", b"no line end", b'{"format": "other"}\n', b"[]\n"):
        file.write_bytes(foreign)
        with pytest.raises(ValueError, match=r"not a file of 'rbsd_sym sweep 1'; choose another"):
            sweep(square, POINTS, Serial(), file)
        assert file.read_bytes() == foreign
    with pytest.raises(ValueError, match=r"cannot be written .*make its folder"):
        sweep(square, POINTS, Serial(), tmp_path / "nowhere" / "sweep.jsonl")


@pytest.mark.parametrize("executor", [Serial(), None], ids=["serial", "processes"])
def test_nan_and_infinities_survive(tmp_path: Path, executor: Executor | None) -> None:
    points = [{"which": which} for which in ("nan", "inf", "minus", "zero", "nan")]
    file = tmp_path / "sweep.jsonl"
    table = sweep(odd_values, points, executor, file)
    again = sweep(odd_values, points, Serial(), file)
    assert repr(again.rows) == repr(table.rows)
    assert repr(table.column("x").tolist()) == "[nan, inf, -inf, -0.0, nan]"
    assert table.rows[0][2:4] == (("a", "nan"), None)


SCRIPT = """
import sys
from test_study import slow_after_three
import rbsd_sym as rs
if __name__ == "__main__":
    rs.study.sweep(slow_after_three, [{"k": k} for k in range(6)], file=sys.argv[1])
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_sweep_that_is_stopped_or_killed_leaves_its_file_and_no_process(
    tmp_path: Path, how: signal.Signals
) -> None:
    script, file = tmp_path / "script.py", tmp_path / "sweep.jsonl"
    script.write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, script, file], env=environment(TESTS / "study"),
        stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    wait_for(lambda: file.exists() and file.read_text().count("\n") == 4)
    with pytest.raises(ValueError, match="another process runs a sweep on it"):
        sweep(slow_after_three, [{"k": k} for k in range(6)], Serial(), file)
    process.send_signal(how)
    _, errors = process.communicate(timeout=120)
    assert process.returncode != 0
    assert ("KeyboardInterrupt" in errors) == (how is signal.SIGINT)
    serial = Serial()
    fn = square_as("slow_after_three")
    table = sweep(fn, [{"k": k} for k in range(6)], serial, file)
    assert serial.calls == 3
    for pid in table.column("value")[:3]:
        wait_for(lambda pid=int(pid): not runs(pid))


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.02)


def runs(pid: int) -> bool:
    """Whether the process is there, and not just waiting to be buried."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_script_without_a_main_guard_is_told(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.replace('__name__ == "__main__"', "True"))
    result = subprocess.run(
        [sys.executable, script, tmp_path / "sweep.jsonl"], env=environment(TESTS / "study"),
        capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert result.returncode == 1
    assert 'put what it does under `if __name__ == "__main__":`' in result.stderr.splitlines()[-1]


def test_exceptions_and_exits_are_rows() -> None:
    with pytest.raises(TypeError, match="argument"):
        pickle.loads(pickle.dumps(_Awkward(1, 2)))
    awkward = sweep(raises_awkward, [{"k": 1}])  # would break a plain pool
    assert awkward.rows == ((1, "_Awkward: 1 and 2"),)
    table = sweep(stuck, [{"k": 1}])
    assert table.columns == ("k", "error")
    assert table.rows[0][1].startswith("IntegrationError: mini: ")
    assert sweep(leaves, [{"k": 1}], Serial()).rows == ((1, "SystemExit: enough"),)
    nothing = sweep(print_nothing, [{"k": 1}], Serial()).rows[0][1]
    assert "print_nothing returned None; return a number" in nothing
    symbol = sweep(lambda point: {"x": ca.SX.sym("x")}, [{"k": 1}], Serial()).rows[0][1]
    assert symbol == (
        "TypeError: 'x': a SX cannot be a cell; give a number, a text, None, or a list of such"
    )


class _Awkward(Exception):
    """One that pickles, but does not come back."""

    def __init__(self, one: int, two: int) -> None:
        super().__init__(f"{one} and {two}")


def raises_awkward(point: Any) -> float:
    raise _Awkward(1, 2)


def print_nothing(point: dict[str, Any]) -> None:
    return None


@pytest.mark.parametrize(
    ("points", "words"),
    [
        ([], "no points"),
        ([{}], "points without names"),
        ({"k": [1, 2]}, "points is a dict; give a list of mappings"),
        ("abc", "points is a str"),
        (3, "points is a int"),
        ([1, 2], "point 0: 1; give a list"),
        ([{1: 2}], "point 0"),
        ([{"k": 1}, {"c": 1}], "point 1: it has c, point 0 has k"),
        ([{"k": 1}, {"k": 1, "c": 1}], "point 1: it has k, c, point 0 has k"),
        ([{"error": 1}], "'error' is a column of the result; rename"),
        ([{"k": [1, 2]}], r"'k': \(1, 2\); give a number or a text"),
        ([{"k": None}], "'k': None; give a number or a text"),
        ([{"k": 1j}], "point 0, 'k': a complex cannot be a cell"),
        ([{"value": 1}], "the result has 'value', which the points have"),
    ],
)
def test_points_that_do_not_fit(points: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        sweep(lambda point: 1.0, points, Serial())


def test_functions_that_do_not_fit() -> None:
    remedy = "cannot import .*define it at the top level"
    with pytest.raises(ValueError, match=f"lambda.*{remedy}|{remedy}"):
        sweep(lambda point: 1.0, POINTS)
    with pytest.raises(ValueError, match=remedy):
        sweep(functools.partial(end_of_mini, mini()), POINTS)
    with pytest.raises(ValueError, match="fn is a float; give a function"):
        sweep(1.0, POINTS)  # type: ignore[arg-type]
    for executor in (4, ProcessPoolExecutor):
        with pytest.raises(ValueError, match=r"give a concurrent.futures.Executor, such as"):
            sweep(square, POINTS, executor)  # type: ignore[arg-type]


def test_a_function_that_workers_cannot_import() -> None:
    missing = square_as("nowhere_to_be_found")
    module = sys.modules[__name__]
    module.nowhere_to_be_found = missing  # type: ignore[attr-defined]
    try:
        with pytest.raises(ValueError, match=r"nowhere_to_be_found.*AttributeError.*top level"):
            sweep(missing, POINTS)
    finally:
        del module.nowhere_to_be_found  # type: ignore[attr-defined]


def test_results_with_other_names_stop_the_sweep(tmp_path: Path) -> None:
    file = tmp_path / "sweep.jsonl"
    with pytest.raises(ValueError, match="point 2: the result has b, that of point 0 a; all"):
        sweep(lambda point: {"ab"[point["k"] // 2]: 1}, POINTS[:4], Serial(), file)
    assert len(file.read_text().splitlines()) == 1 + 2
    with pytest.raises(ValueError, match="'error', which the points have, or the table itself"):
        sweep(lambda point: {"error": 1}, POINTS, Serial())


def test_points_may_repeat_and_hold_numbers_of_numpy() -> None:
    points = [{"k": np.float64(2)}, {"k": np.float64(2)}, {"k": np.int32(3)}]
    seen: list[Any] = []
    table = sweep(lambda point: seen.append(type(point["k"])) or square(point), points, Serial())
    assert table.column("value").tolist() == [4, 4, 9]
    assert seen == [float, float, int]
    assert sweep(square, iter(POINTS), Serial()).column("value")[-1] == 25


def test_simulations_in_processes_give_the_same_numbers() -> None:
    points = [{"velocity": v, "t_end": t} for v in (0.1, 0.5) for t in (0.2, 0.4)]
    table = sweep(end_of_mini, points).with_units({"velocity": "m/s", "energy": "J"})
    assert set(table.column("outcome")) == {"reached_end"}
    assert table.rows == sweep(end_of_mini, points, Serial()).rows
    assert len(set(table.column("energy"))) == 4


@pytest.mark.filterwarnings("default")  # of Dask and what it needs
def test_dask() -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        executor = client.get_executor()
        table = sweep(fails_at_three, POINTS + POINTS, executor)
        assert executor.submit(square, {"k": 3}).result() == 9, "it is not shut down"
    assert [row[-1] for row in table.rows].count("ValueError: three is too many") == 2
    np.testing.assert_array_equal(table.column("square"), [0, 1, 4, np.nan, 16, 25] * 2)
