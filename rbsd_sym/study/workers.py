"""Outcomes of points in order of arrival, from our own processes or from a given executor."""

from __future__ import annotations

import functools
import multiprocessing
import os
import pickle
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any, Union

from .table import Cell, plain_items

Point = dict[str, Cell]
Outcome = tuple[Union[dict[str, Cell], None], Union[str, None]]
"""The result and None, or None and the reason of the failure in one line."""

Work = Generator[tuple[int, Outcome, bool], None, None]
"""Yields index of the point, outcome, and whether the outcome is due to fn and not the executor."""

Function = Callable[[Point], Any]
_EXIT_TIMEOUT = 5.0  # s, after which a worker process is killed


def name_of(fn: Function) -> str:
    """Return module and name of a function, of a partial's function, or of an object's class."""
    inner: Any = fn
    while isinstance(inner, functools.partial):
        inner = inner.func
    named = inner if hasattr(inner, "__qualname__") else type(inner)
    return f"{named.__module__}.{named.__qualname__}"


def not_importable(fn: Function, why: str) -> str:
    """Return the message about a function that other processes cannot import."""
    return (
        f"sweep: worker processes cannot import {name_of(fn)} ({why}); define it at the top level "
        "of a module or script, and make models inside it (functools.cache keeps them)"
    )


def reason(error: BaseException) -> str:
    """Return type and message of an exception, in one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def attempt(fn: Function, point: Point) -> Outcome:
    """Return the result of fn at a point in plain Python, or the reason of its failure."""
    # Exceptions are turned into text here, in the worker: some cannot be pickled, and others are
    # pickled but cannot be restored, which would break the executor. SystemExit is caught as well,
    # so that a function which calls sys.exit does not end its worker.
    try:
        result = fn(dict(point))
        named = result if isinstance(result, Mapping) else {"value": result}
        if result is None or not all(isinstance(key, str) for key in named):
            raise TypeError(
                f"{name_of(fn)} returned {result!r}; return a number, or a mapping of names to "
                "numbers"
            )
        return plain_items(named), None
    except (Exception, SystemExit) as error:
        return None, reason(error)


def lent(executor: Executor, fn: Function, points: Sequence[Point], todo: Sequence[int]) -> Work:
    """Yield the outcomes of the points `todo` from a given executor."""
    waiting, done = deque(todo), SimpleQueue[Future]()
    running: dict[Future, int] = {}
    try:
        while waiting or running:
            # Points are submitted only until a result arrives, so results of an executor that runs
            # each point while it is submitted are saved one by one, and not at the end.
            while waiting and done.empty():
                i = waiting.popleft()
                future = _submitted(executor, attempt, fn, points[i])
                running[future] = i
                future.add_done_callback(done.put)
            future = done.get()
            i, lasting = running.pop(future), True
            try:
                outcome = future.result()
            except Exception as error:
                outcome, lasting = (None, f"{reason(error)} (from the executor)"), False
            yield i, outcome, lasting
    finally:
        for future in running:
            future.cancel()


def own(fn: Function, pickled: bytes, points: Sequence[Point], todo: Sequence[int]) -> Work:
    """Yield the outcomes of the points `todo` from our own processes, one for each core.

    A process that dies makes its point a failure, and is replaced.

    Raises:
        ValueError: the processes cannot import fn.
        RuntimeError: no process can be started.
    """
    # Each process is a pool of one. In a larger pool the death of one process breaks the whole
    # pool, and it is unknown which point caused it.
    waiting, done = deque(todo), SimpleQueue[Future]()
    running: dict[Future, tuple[int, _Worker]] = {}
    workers: list[_Worker] = []
    try:
        workers += _started(min(_cores(), len(todo)), fn, pickled)
        idle = list(workers)
        while waiting or running:
            while waiting and idle:
                i, worker = waiting.popleft(), idle.pop()
                future = _submitted(worker.pool, _attempt_pickled, pickled, points[i])
                running[future] = i, worker
                future.add_done_callback(done.put)
            future = done.get()
            i, worker = running.pop(future)
            try:
                outcome = future.result()
            except BrokenExecutor:
                outcome = None, _lost(worker)
                workers.remove(worker)
                fresh = _started(1, fn, pickled) if waiting else []
                workers += fresh
                idle += fresh
            else:
                idle.append(worker)
            yield i, outcome, True
    finally:
        _stop(workers, at_once=bool(running))


def _submitted(executor: Executor, call: Callable[..., Outcome], *arguments: Any) -> Future:
    """Submit a call; return a future that has failed if the executor is already broken."""
    try:
        return executor.submit(call, *arguments)
    except BrokenExecutor as error:
        future: Future = Future()
        future.set_exception(error)
        return future


def _cores() -> int:
    """Return the number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.lru_cache(maxsize=1)  # what fn caches on itself survives from point to point
def _unpickled(pickled: bytes) -> Function:
    return pickle.loads(pickled)


def _attempt_pickled(pickled: bytes, point: Point) -> Outcome:
    return attempt(_unpickled(pickled), point)


def _import_error(pickled: bytes) -> str | None:
    """Return why a function cannot be imported in this process; None if it can."""
    try:
        _unpickled(pickled)
    except Exception as error:
        return reason(error)
    return None


def _prepare() -> None:
    """Set up a worker process: it ignores interrupts, and ends with its parent."""
    # Ctrl-C reaches all processes of a terminal; the parent handles it and ends the workers. A
    # parent that is killed cannot end them, so each watches it in a thread.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@dataclass(frozen=True, eq=False)
class _Worker:
    """A pool of one process, and that process."""

    pool: ProcessPoolExecutor
    process: BaseProcess


def _started(count: int, fn: Function, pickled: bytes) -> list[_Worker]:
    """Start worker processes and wait until they have imported fn.

    Raises:
        ValueError: they cannot import it.
        RuntimeError: they end before they can try.
    """
    context = multiprocessing.get_context("spawn")
    workers: list[_Worker] = []
    probes: list[Future] = []
    try:
        for _ in range(count):
            # A pool starts its process with the first call, and offers no public way to that
            # process, which is needed to kill it and to read its exit code.
            pool = ProcessPoolExecutor(1, context, _prepare)
            probes.append(pool.submit(_import_error, pickled))
            workers.append(_Worker(pool, next(iter(pool._processes.values()))))
        for why in [probe.result() for probe in probes]:
            if why:
                raise ValueError(not_importable(fn, why))
    except BrokenExecutor as error:
        _stop(workers, at_once=True)
        raise RuntimeError(
            "sweep: worker processes end before they run anything (their message is above); they "
            'import the script again, so put what it does under `if __name__ == "__main__":`'
        ) from error
    except BaseException:
        _stop(workers, at_once=True)
        raise
    return workers


def _lost(worker: _Worker) -> str:
    """Return the reason of the failure of a point whose process died."""
    worker.pool.shutdown()  # afterwards the exit code is known
    return (
        f"BrokenProcessPool: the process died during this point (exit code "
        f"{worker.process.exitcode}; negative is a signal, -9 often a lack of memory); call fn at "
        "this point to see why"
    )


def _stop(workers: Sequence[_Worker], at_once: bool) -> None:
    """End processes, idle ones in an orderly way, or all of them at once."""
    # Threads that fn has left behind would keep an idle process alive, hence the time limit.
    for worker in workers:
        if at_once:
            worker.process.kill()
        worker.pool.shutdown(wait=False, cancel_futures=True)
    for worker in workers:
        worker.process.join(_EXIT_TIMEOUT)
        worker.process.kill()
