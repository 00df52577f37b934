"""Call a function at many points, spread over processes or a cluster; the results are a table.

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
    """Call a function at every point, spread over processes; return one row for each, in order.

    An example is in the docstring of `rbsd_sym.study`.

    Arguments:
        fn: takes a point as a dict; returns a number (column `value`) or a mapping of names to
            numbers, texts or lists. All results have the same names.
        points: mappings of names to numbers or texts, all with the same names. They may repeat.
        executor: where to run, a `concurrent.futures.Executor`; by default processes of this
            machine, for which a script needs `if __name__ == "__main__":`.
        file: results are appended to it as they arrive, as lines of JSON. Repeating the call
            continues where an earlier one stopped, even if that was killed. The file identifies
            fn by its name only: delete it after a change of fn.
        retry_failed: run points again that failed according to the file; otherwise their failures
            are kept.

    Returns:
        Columns of the points, columns of the results, and `error`: None, or in one line why the
        point failed; its results are then None. Call fn(point) to see the traceback.

    Raises:
        ValueError: bad points; a function that processes cannot import; names of results that
            differ or clash with others; a file of something else, or in use.
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
        # Closing the generator ends its processes, also if an exception or Ctrl-C ends the loop.
        with contextlib.closing(work):
            _gather(listed, results, work, keep)
    return _table(listed, results)


def _gather(points: Sequence[Point], results: dict[int, Outcome], work: Work, keep: Keep) -> None:
    """Add outcomes to the results as they arrive, and to the file if they are due to fn itself."""
    for i, outcome in results.items():
        _check_names(points, results, i, outcome)
    for i, outcome, lasting in work:
        _check_names(points, results, i, outcome)
        results[i] = outcome
        if lasting:
            keep(i, outcome)


def _checked(points: Iterable[Mapping[str, Any]]) -> list[Point]:
    """Return the points as dicts of plain numbers and texts.

    Raises:
        ValueError: a point of another kind, or with other names than the first one.
    """
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
    """Return the function pickled for our own processes; empty if an executor is given.

    Raises:
        ValueError: it is not a function, or cannot be pickled; not an executor.
    """
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
    except Exception as error:  # pickle raises exceptions of many types
        raise ValueError(not_importable(fn, reason(error))) from error


def _check_names(
    points: Sequence[Point], results: Mapping[int, Outcome], i: int, outcome: Outcome
) -> None:
    """Check that a result has the names of the others, and none of a point's or the table's own."""
    if outcome[0] is None:
        return
    names = list(outcome[0])
    taken = sorted(set(names) & {*points[i], "error"})
    if taken:
        raise ValueError(
            f"sweep, point {i}: the result has '{taken[0]}', which the points have, or the table "
            "itself; rename it"
        )
    # All earlier results passed this check, so comparing with one that did not fail is enough.
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
