"""Speed against accuracy of every integrator, in every form, and of the peers, scene by scene.

`python tests/charts/speed.py [NAME ...]` writes generated/charts/speed/<scene>.png, .csv and .md
and the summary README.md there; without names all scenes, in half an hour. Exudyn and scipy
(`pip install '.[peers]'`) take part if they are there.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

# Helper threads of numpy's BLAS spin while they wait, on the core that is being measured.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from paths import CHARTS
from scenes.speed import CASES, Case

import rbsd_sym as rs
from charts import contenders, pages
from charts.contenders import POINTS, Contender
from charts.front import sober, time_at
from rbsd_sym.model.trajectory import Column, Trajectory
from rbsd_sym.study.work_precision import ErrorOf

TARGET = 1e-6
ENOUGH = 1e-10  # error beyond which no tighter setting is tried
_AGREED = 2e-8  # difference of two methods that are a reference
REPEATS = 5
QUANTITIES = ("position", "angle", "velocity", "angular_velocity")
COLUMNS = ("family", "method", "setting", "error", *(f"error_{q}" for q in QUANTITIES),
           "error_at_end", "time", "time_min", "time_max", "steps", "outcome", "floor")
ERROR, AT_END, TIME = (COLUMNS.index(c) for c in ("error", "error_at_end", "time"))
_UNITS = tuple("s" if c.startswith("time") else "" for c in COLUMNS)
_SHORT, _SPREAD = 0.02, 4.0  # s, and times the fastest: beyond, no run of a peer is made
_ALONE = 0.15  # s: longer runs are timed less than REPEATS times


class Limits(NamedTuple):
    """How far a scene's contenders climb: CPU seconds of a run, of ours and of peers."""

    ours: float = 0.15
    peers: float = 4.0
    apart: float = 0.5  # decades between tolerances
    first: int = 16  # steps of the peers' first runs


LIMITS = {
    "chain16": Limits(apart=1.0, first=64), "chain256": Limits(1.0, 2.5, 1.0, 128),
    "governor": Limits(0.3, 2.0, 1.0, 1024), "bricard": Limits(0.3, 1.5, 1.0, 512),
    "stick_slip": Limits(1.0, apart=1.0), "stiff1e3": Limits(0.2, 2.0),
    "stiff1e6": Limits(0.3, 6.0, 1.0, 65_536),
}  # fmt: skip


class Judge:
    """The error of a trajectory over the output times it has (all, or both ends), and at the end.

    Arguments:
        reference: at the output times.
        excursions: by quantity, the unit of errors.
        floor, names: how far the two methods of the reference are apart, and which they are.
    """

    def __init__(self, model: rs.Model, reference: Trajectory,
                 excursions: dict[str, float], floor: float,
                 names: tuple[str, str]) -> None:  # fmt: skip
        self.reference, self.floor, self.names = reference, floor, names
        self._all, self._bodies = ErrorOf(model, reference), ErrorOf(model, reference).bodies
        self._ends = ErrorOf(model, self._cut(reference))
        self._all.excursions = self._ends.excursions = excursions

    def __call__(self, trajectory: Trajectory) -> tuple[dict[str, float | None], float | None]:
        with np.errstate(all="ignore"):
            ends = self._ends(self._cut(trajectory))
            whole = ends if len(trajectory.t) == 2 else self._all(trajectory)
        return whole, _largest(ends)

    def _cut(self, trajectory: Trajectory) -> Trajectory:
        names = [f"{body}.{quantity}" for body in self._bodies for quantity in
                 ("position", "quaternion", "velocity", "angular_velocity")]  # fmt: skip
        trajectory.evaluate(names)
        columns = {name: Column(trajectory[name][[0, -1]], "") for name in names}
        return replace(trajectory, t=trajectory.t[[0, -1]], columns=columns, more=None)


def _largest(errors: Mapping[str, float | None]) -> float | None:
    """The largest error; None if there is none, or it is not finite."""
    largest = max((e for e in errors.values() if e is not None), default=None)
    return largest if largest is not None and math.isfinite(largest) else None


def judge_of(case: Case, model: rs.Model, folder: Path) -> Judge:
    """Errors against a reference on which two methods agree; excursions at 200 intervals."""
    grid, fast = np.linspace(0, case.t_end, POINTS + 1), rs.compiled(model)
    path = rs.simulate(fast, np.linspace(0, case.t_end, 201), rs.Idas(1e-8, 1e-10))
    excursions = ErrorOf(model, path).excursions
    if model.events or model.n_z:
        found = rs.study.converged(model, grid)
        return Judge(model, found.trajectory, excursions, found.floor, found.names)
    # Of a long chain rounding in stiff forces leaves no more digits, and steps without number.
    tight, most = (1e-12, 500_000) if model.n_x <= 1000 else (1e-10, 20_000)
    simulator = rs.load_simulator(
        rs.export_simulator(model, folder / "reference", rs.Dop853(max_steps=most)), model
    )
    methods = [*([rs.Rosenbrock(1e-10, 1e-12)] if model.n_x <= 100 else []),
               rs.Idas(10 * tight, tight / 10), rs.ExplicitRK(tight, tight / 100)]  # fmt: skip
    first = simulator(case.t_end, rtol=tight, atol=tight / 100, points=POINTS)
    name = "Dop853"
    if not first.outcome.ok:  # too stiff for it
        name, first = type(methods[0]).__name__, rs.simulate(fast, grid, methods.pop(0))
    measure, best = ErrorOf(model, first), (math.inf, "")
    measure.excursions = excursions
    for other in methods:
        second = rs.simulate(fast, grid, other, throw=False)
        if second.outcome.ok:
            found = measure(second).values()
            floor = max(e for e in found if e is not None)
            best = min(best, (floor, type(other).__name__))
        if best[0] < _AGREED:
            break
    return Judge(model, first, excursions, best[0], (name, best[1]))


def attempt(contender: Contender, effort: float, judge: Judge) -> tuple[Any, ...]:
    """A row: the error of one run and the times of its repeats; a failure is one, too."""
    began = time.thread_time()
    trajectory = contender.run(effort)
    took = max(time.thread_time() - began, 1e-9)
    errors: dict[str, float | None] = dict.fromkeys(QUANTITIES)
    at_end = None
    if trajectory.outcome.ok:
        errors, at_end = judge(trajectory)
    error = _largest(errors)
    if error is None:
        errors = dict.fromkeys(QUANTITIES)
    repeats = max(1, min(REPEATS, round(_ALONE / took))) if error is not None else 1
    times = [took]
    if trajectory.outcome.ok:
        clocked = [contender.clock(effort) for _ in range(repeats)]
        times = times if any(map(math.isnan, clocked)) else clocked
    outcome = trajectory.outcome.name
    if trajectory.outcome.ok and error is None:
        outcome = "not_finite"
    return (contender.family, contender.method, contender.word(effort), error, *errors.values(),
            at_end, statistics.median(times), min(times), max(times), trajectory.stats.get("steps"),
            outcome, judge.floor)  # fmt: skip


def climb(
    contender: Contender, judge: Judge, cap: float, first: float = 0.0, spread: float = math.inf
) -> list[tuple[Any, ...]]:
    """Rows of rising effort, until the error is small enough or a run would take too long.

    Where equal steps get below the target between two runs, three more close in on it.

    Arguments:
        cap: CPU seconds of a run; once one has reached the target, at most `spread` times as long.
        first: steps to begin with.
    """
    found: dict[float, tuple[Any, ...]] = {}
    failures = 0
    for effort in contender.efforts:
        if contender.fixed and effort < first:
            continue
        found[effort] = row = attempt(contender, effort, judge)
        error, took = row[ERROR], row[TIME]
        failures = failures + 1 if error is None else 0
        if error is not None and error < TARGET:
            cap = min(cap, max(_SHORT, spread * took))
        if (error is not None and error < max(ENOUGH, 2 * judge.floor)) or 2 * took > cap:
            break
        if not contender.fixed and (failures == 2 or (failures and took > cap)):
            break
    if contender.fixed:
        _close_in(contender, judge, found)
        found = dict(sorted(found.items()))
    return list(found.values())


def _close_in(contender: Contender, judge: Judge, found: dict[float, tuple[Any, ...]]) -> None:
    good = lambda row: row[ERROR] is not None and row[ERROR] < TARGET  # noqa: E731
    efforts = list(found)
    pairs = [(a, b) for a, b in itertools.pairwise(efforts)
             if not good(found[a]) and good(found[b])]  # fmt: skip
    if not pairs:
        return
    low, high = pairs[0]
    for _ in range(3):
        middle = POINTS * round(math.sqrt(low * high) / POINTS)
        if not low < middle < high:
            return
        found[middle] = row = attempt(contender, middle, judge)
        low, high = (low, middle) if good(row) else (middle, high)


def times_of(rows: Iterable[Sequence[Any]], column: int = ERROR) -> pages.Times:
    """Seconds at the target of each method (family, name) that reaches it."""
    runs: dict[tuple[str, str], list[tuple[Any, float]]] = {}
    for row in rows:
        runs.setdefault((row[0], row[1]), []).append((row[column], row[TIME]))
    found = {key: time_at(sober(points), TARGET) for key, points in runs.items()}
    return {key: took for key, took in found.items() if took is not None}


def _best_two(rows: Iterable[Sequence[Any]]) -> set[str]:
    """The two fastest methods of each family."""
    times, found = times_of(rows), set()
    for family in {family for family, _ in times}:
        ranked = sorted((took, method) for (f, method), took in times.items() if f == family)
        found |= {method for _, method in ranked[:2]}
    return found


def peers(case: Case, judge: Judge, limits: Limits) -> list[tuple[Any, ...]]:
    """Rows of Exudyn and scipy.

    Of Exudyn every solver with every node first, with sparse matrices; then the other choices
    (dense matrices, mass matrices, Newton's method, damping) of the two best of each kind. A run
    that would take four times the fastest one that reaches the target is not made.
    """
    rows: list[tuple[Any, ...]] = []
    for contender in contenders.scipy_methods(case, 1.0):
        rows += _told(contender, climb(contender, judge, 1.0, spread=_SPREAD))
    stages = (
        contenders.exudyn_methods(case),
        contenders.exudyn_variants(case, lambda: _best_two(rows)),
    )
    for contender in itertools.chain(*stages):
        times = times_of(row for row in rows if row[0].startswith("Exudyn"))
        at_best = min(times.values(), default=limits.peers)
        cap = min(limits.peers, max(_SHORT, _SPREAD * at_best))
        rows += _told(contender, climb(contender, judge, cap, limits.first, _SPREAD))
    return rows


def _told(contender: Contender, rows: list[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """The rows; that they are there is told on stderr."""
    print(f"  {contender.method}: {len(rows)} runs", file=sys.stderr, flush=True)
    return rows


def measured(case: Case, limits: Limits) -> tuple[rs.study.Table, Judge]:
    """The table of a scene, and what judged it."""
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as temporary:
        warnings.simplefilter("ignore", rs.ModelWarning)
        model, folder = rs.compile_scene(case.scene), Path(temporary)
        judge, rows = judge_of(case, model, folder), []
        for contender in itertools.chain(
            contenders.exported(model, case.t_end, limits.apart, folder),
            contenders.ours(model, case.t_end, limits.apart),
        ):
            rows += _told(contender, climb(contender, judge, limits.ours))
        others = peers(case, judge, limits)
    return rs.study.Table(COLUMNS, _UNITS, (*rows, *others)), judge


def recommended(case: Case, seconds: float = 10.0) -> tuple[str, str]:
    """Names of the integrators that `recommend` picks for `simulate` and for an export."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.ModelWarning)
        model = rs.compiled(rs.compile_scene(case.scene))
    names = []
    for exported in (False, True):
        try:
            pick = rs.study.recommend(
                model, TARGET, case.t_end, exported=exported, seconds=seconds
            )
            names.append(pages.name_of(pick.integrator))
        except ValueError:
            names.append("")
    return names[0], names[1]


def main(names: Sequence[str]) -> int:
    """Measure the scenes of these names, all by default; write charts and summary."""
    unknown = set(names) - set(CASES)
    if unknown:
        print(f"no scene {', '.join(sorted(unknown))}; there are {', '.join(CASES)}")
        return 1
    target = CHARTS / "speed"
    target.mkdir(parents=True, exist_ok=True)
    for name in names or CASES:
        began, cpu = time.perf_counter(), time.process_time()
        case = CASES[name]()
        table, judge = measured(case, LIMITS.get(name, Limits()))
        times = times_of(table.rows), times_of(table.rows, AT_END)
        pages.write(target, case, table, judge.names, times, recommended(case))
        took = time.perf_counter() - began, time.process_time() - cpu
        print(f"{name}: {took[0]:.0f} s, CPU {took[1]:.0f} s, {len(table.rows)} runs, reference "
              f"good to {judge.floor:.1e} ({', '.join(judge.names)})", flush=True)  # fmt: skip
    pages.summary(target)
    return 0


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        sys.exit(main(sys.argv[1:]))
