"""Outcomes of points as they come, from processes of our own or from an executor handed in."""

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
Outcome = tuple[Union[dict[str, Cell], None], Union[str, None]]  # the result, or why there is none
Work = Generator[tuple[int, Outcome, bool], None, None]  # point, outcome, whether it is fn's own
Function = Callable[[Point], Any]
_LAST_WORDS = 5.0  # s


def name_of(fn: Function) -> str:
    """Module and name of a function, of the one inside a partial, or of an object's class."""
    inner: Any = fn
    while isinstance(inner, functools.partial):
        inner = inner.func
    named = inner if hasattr(inner, "__qualname__") else type(inner)
    return f"{named.__module__}.{named.__qualname__}"


def not_importable(fn: Function, why: str) -> str:
    """What to do about a function that other processes cannot have."""
    return (
        f"sweep: worker processes cannot have {name_of(fn)} ({why}); define it at the top level of "
        "a module or script, and make models inside it (functools.cache keeps them)"
    )


def reason(error: BaseException) -> str:
    """Type and message of an exception, in one line."""
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text}" if text else type(error).__name__


def attempt(fn: Function, point: Point) -> Outcome:
    """The result in plain Python, or why there is none: no exception crosses between processes."""
    try:
        result = fn(dict(point))
        named = result if isinstance(result, Mapping) else {"value": result}
        if result is None or not all(isinstance(key, str) for key in named):
            raise TypeError(f"{name_of(fn)} gave {result!r}; return a number or names to numbers")
        return plain_items(named), None
    except (Exception, SystemExit) as error:
        return None, reason(error)


def lent(executor: Executor, fn: Function, points: Sequence[Point], todo: Sequence[int]) -> Work:
    """Outcomes from an executor handed in."""
    waiting, done = deque(todo), SimpleQueue[Future]()
    flight: dict[Future, int] = {}
    try:
        while waiting or flight:
            while waiting and done.empty():
                i = waiting.popleft()
                future = _submitted(executor, attempt, fn, points[i])
                flight[future] = i
                future.add_done_callback(done.put)
            future = done.get()
            i, lasting = flight.pop(future), True
            try:
                outcome = future.result()
            except Exception as error:
                outcome, lasting = (None, f"{reason(error)} (from the executor)"), False
            yield i, outcome, lasting
    finally:
        for future in flight:
            future.cancel()


def own(fn: Function, pickled: bytes, points: Sequence[Point], todo: Sequence[int]) -> Work:
    """Outcomes from processes of our own; one that dies tells of its point, and is replaced.

    Each process is a pool of one, so there is no doubt which point it ran.

    Raises:
        ValueError: the processes cannot import fn.
        RuntimeError: no process can be started.
    """
    waiting, done = deque(todo), SimpleQueue[Future]()
    flight: dict[Future, tuple[int, _Worker]] = {}
    crew: list[_Worker] = []
    try:
        crew += _started(min(_cores(), len(todo)), fn, pickled)
        idle = list(crew)
        while waiting or flight:
            while waiting and idle:
                i, worker = waiting.popleft(), idle.pop()
                future = _submitted(worker.pool, _attempt_pickled, pickled, points[i])
                flight[future] = i, worker
                future.add_done_callback(done.put)
            future = done.get()
            i, worker = flight.pop(future)
            try:
                outcome = future.result()
            except BrokenExecutor:
                outcome = None, _lost(worker)
                crew.remove(worker)
                fresh = _started(1, fn, pickled) if waiting else []
                crew += fresh
                idle += fresh
            else:
                idle.append(worker)
            yield i, outcome, True
    finally:
        _stop(crew, at_once=bool(flight))


def _submitted(executor: Executor, call: Callable[..., Outcome], *arguments: Any) -> Future:
    """The future of a call; a failed one if the executor is broken already."""
    try:
        return executor.submit(call, *arguments)
    except BrokenExecutor as error:
        future: Future = Future()
        future.set_exception(error)
        return future


def _cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@functools.lru_cache(maxsize=1)
def _unpickled(pickled: bytes) -> Function:
    return pickle.loads(pickled)


def _attempt_pickled(pickled: bytes, point: Point) -> Outcome:
    return attempt(_unpickled(pickled), point)


def _import_error(pickled: bytes) -> str | None:
    """Why a function cannot be had in this process."""
    try:
        _unpickled(pickled)
    except Exception as error:
        return reason(error)
    return None


def _prepare() -> None:
    """Set up a worker process: an interrupt is its parent's business, and it ends with it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@dataclass(frozen=True, eq=False)
class _Worker:
    """A pool of one process, and the process."""

    pool: ProcessPoolExecutor
    process: BaseProcess


def _started(count: int, fn: Function, pickled: bytes) -> list[_Worker]:
    """Workers that have imported fn."""
    context = multiprocessing.get_context("spawn")
    crew: list[_Worker] = []
    probes: list[Future] = []
    try:
        for _ in range(count):
            pool = ProcessPoolExecutor(1, context, _prepare)
            probes.append(pool.submit(_import_error, pickled))  # starts the process
            crew.append(_Worker(pool, next(iter(pool._processes.values()))))
        for why in [probe.result() for probe in probes]:
            if why:
                raise ValueError(not_importable(fn, why))
    except BrokenExecutor as error:
        _stop(crew, at_once=True)
        raise RuntimeError(
            "sweep: worker processes end before they run anything (their message is above); they "
            'import the script again, so what it does belongs under `if __name__ == "__main__":`'
        ) from error
    except BaseException:
        _stop(crew, at_once=True)
        raise
    return crew


def _lost(worker: _Worker) -> str:
    """Why the point failed whose process died."""
    worker.pool.shutdown()  # afterwards the exit code is known
    return (
        f"BrokenProcessPool: the process died during this point (exit code "
        f"{worker.process.exitcode}; negative is a signal, -9 often a lack of memory)"
    )


def _stop(crew: Sequence[_Worker], at_once: bool) -> None:
    """End processes: idle ones by themselves, unless threads of theirs go on; or all at once."""
    for worker in crew:
        if at_once:
            worker.process.kill()
        worker.pool.shutdown(wait=False, cancel_futures=True)
    for worker in crew:
        worker.process.join(_LAST_WORDS)
        worker.process.kill()
