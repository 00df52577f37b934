"""A function called at many points, spread over processes or a cluster; rows in a table.

points --check--> todo --workers--> outcomes --log--> file
                                        +-----------> ResultTable
"""

from __future__ import annotations

import contextlib
import os
import pickle
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from typing import Any

from .log import Keep, header, opened
from .table import ResultTable, plain_items
from .workers import Outcome, Point, Work, lent, name_of, not_importable, own, reason


def sweep(
    fn: Callable[[Point], Any],
    points: Iterable[Mapping[str, Any]],
    executor: Executor | None = None,
    file: str | os.PathLike[str] | None = None,
    retry_failed: bool = False,
) -> ResultTable:
    """Call a function at every point, spread over processes; one row for each point, in order.

    Arguments:
        fn: takes a point as a dict; returns a number (column `value`) or a mapping of names to
            numbers, texts or lists. Every result has the same names.
        points: mappings of names to numbers or texts, all with the same names. They may repeat.
        executor: where to run; by default processes, for which a script needs a main guard.
        file: results are appended here as they come, as lines of JSON. The same call goes on
            where the last one was stopped, however it was. It knows fn by its name alone: delete
            the file after a change of fn.
        retry_failed: run points again that failed according to the file; otherwise they are kept.

    Returns:
        Columns of the points, of the results, and `error`: None, or in one line why the point
        failed (its results are None). Calling fn(point) shows more.

    Raises:
        ValueError: bad points, a function that processes cannot import, names of results that
            differ or clash, a file of something else or in use.
        RuntimeError: no worker process can be started.
    """
    listed = _checked(points)
    pickled = _checked_function(fn, executor)
    with opened(file, header(name_of(fn), listed), listed) as (known, keep):
        results = {i: o for i, o in known.items() if not (retry_failed and o[1])}
        todo = [i for i in range(len(listed)) if i not in results]
        if executor is None:
            work = own(fn, pickled, listed, todo)
        else:
            work = lent(executor, fn, listed, todo)
        with contextlib.closing(work):
            _gather(listed, results, work, keep)
    return _table(listed, results)


def _gather(points: Sequence[Point], results: dict[int, Outcome], work: Work, keep: Keep) -> None:
    """Add outcomes to the results as they come, and to the file those that are fn's own."""
    for i, outcome in results.items():
        _check_names(points, results, i, outcome)
    for i, outcome, lasting in work:
        _check_names(points, results, i, outcome)
        results[i] = outcome
        if lasting:
            keep(i, outcome)


def _checked(points: Iterable[Mapping[str, Any]]) -> list[Point]:
    """The points as dicts of plain numbers and texts."""
    form = "give a list of mappings such as {'k': 1e3, 'law': 'a'}"
    if isinstance(points, (Mapping, str)) or not isinstance(points, Iterable):
        raise ValueError(f"sweep: points is a {type(points).__name__}; {form}")
    listed: list[Point] = []
    for i, point in enumerate(points):
        if not isinstance(point, Mapping) or not all(isinstance(key, str) for key in point):
            raise ValueError(f"sweep, point {i}: {point!r}; {form}")
        if "error" in point:
            raise ValueError(f"sweep, point {i}: 'error' is a column of the result; rename it")
        try:
            values = plain_items(point)
        except TypeError as error:
            raise ValueError(f"sweep, point {i}, {error}") from error
        for key, value in values.items():
            if value is None or isinstance(value, tuple):
                raise ValueError(f"sweep, point {i}, '{key}': {value}; give a number or a text")
        if listed and values.keys() != listed[0].keys():
            raise ValueError(
                f"sweep, point {i}: it has {', '.join(values)}, point 0 has "
                f"{', '.join(listed[0])}; all points have the same names"
            )
        listed.append(values)
    if not listed or not listed[0]:
        raise ValueError(f"sweep: no points, or points without names; {form}")
    return listed


def _checked_function(fn: Callable[[Point], Any], executor: Any) -> bytes:
    """The function as a pickle for our own processes; empty for an executor handed in."""
    if not callable(fn):
        raise ValueError(f"sweep: fn is a {type(fn).__name__}; give a function of one point")
    if executor is not None:
        if not isinstance(executor, Executor):
            raise ValueError(
                f"sweep: executor {executor!r}; give a concurrent.futures.Executor, such as "
                "ProcessPoolExecutor(4, multiprocessing.get_context('spawn')), or the "
                "get_executor() of a Dask client"
            )
        return b""
    try:
        return pickle.dumps(fn)
    except Exception as error:  # pickle raises errors of many kinds
        raise ValueError(not_importable(fn, reason(error))) from error


def _check_names(
    points: Sequence[Point], results: Mapping[int, Outcome], i: int, outcome: Outcome
) -> None:
    """The names of a result: those of the others, none that a point or the table has."""
    if outcome[0] is None:
        return
    names = list(outcome[0])
    taken = sorted(set(names) & {*points[i], "error"})
    if taken:
        raise ValueError(
            f"sweep, point {i}: the result has '{taken[0]}', which the points have, or the table "
            "itself; rename it"
        )
    for k, (other, _) in results.items():
        if other is not None:
            if set(other) != set(names):
                raise ValueError(
                    f"sweep, point {i}: the result has {', '.join(names)}, that of point {k} "
                    f"{', '.join(other)}; all results have the same names (if fn has changed, "
                    "delete the file)"
                )
            return


def _table(points: Sequence[Point], results: Mapping[int, Outcome]) -> ResultTable:
    keys, rows = tuple(points[0]), []
    there = (results[i][0] for i in range(len(points)))
    names = tuple(next((result for result in there if result is not None), {}))
    for i, point in enumerate(points):
        result, error = results[i]
        cells = [result[name] if result is not None else None for name in names]
        rows.append((*(point[key] for key in keys), *cells, error))
    columns = (*keys, *names, "error")
    return ResultTable(columns, ("",) * len(columns), tuple(rows))
