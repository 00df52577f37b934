"""The file of a sweep: a header, then one line of JSON for each outcome, in order of arrival.

A line is written by one call; if a process was killed while writing, the incomplete line is removed
at the next start. While a sweep runs, a lock of the operating system keeps other processes out. The
lock ends with the process; there is none on Windows or on file systems without locks, and threads
of one process are not kept apart. NaN and infinities are written as `NaN` and `Infinity`, which
Python's json reads although the JSON standard excludes them.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
from collections.abc import Callable, Iterator, Sequence
from io import FileIO
from typing import Any, Union

from .workers import Outcome, Point

FORMAT = "rbsd_sym sweep 1"
Path = Union[str, "os.PathLike[str]"]
Keep = Callable[[int, Outcome], None]


def header(fn: str, points: Sequence[Point]) -> dict[str, Any]:
    """Return the first line of a file, which identifies a sweep: its function's name, its points.

    The values of the points are represented by their SHA-256 hash.
    """
    values = [list(points[0]), [[point[key] for key in points[0]] for point in points]]
    digest = hashlib.sha256(json.dumps(values).encode()).hexdigest()
    return {"format": FORMAT, "fn": fn, "keys": values[0], "points": len(points), "sha256": digest}


@contextlib.contextmanager
def opened(
    file: Path | None, head: dict[str, Any], points: Sequence[Point]
) -> Iterator[tuple[dict[int, Outcome], Keep]]:
    """Open the file of a sweep, locked until the context ends.

    Arguments:
        file: created if needed; None keeps nothing.
        head: of `header`, for these points.
        points: of the sweep; outcomes are written with their point.

    Yields:
        Outcomes of earlier calls by index of the point, and a function that appends one.

    Raises:
        ValueError: the file is that of another sweep or of something else, is in use by another
            process, or cannot be written.
    """
    if file is None:
        yield {}, lambda i, outcome: None
        return
    try:
        stream = FileIO(file, "a+")
    except OSError as error:
        raise ValueError(
            f"{file}: cannot be written ({error.strerror}); make its folder, or choose another file"
        ) from error
    with stream:
        _lock(stream, file)
        known = _resumed(stream, file, head)

        def keep(i: int, outcome: Outcome) -> None:
            end = {"result": outcome[0]} if outcome[1] is None else {"error": outcome[1]}
            _append(stream, file, {"point": i, "at": points[i], **end})

        yield known, keep


def _lock(stream: FileIO, file: Path) -> None:
    """Keep other processes out, where the system supports locks; the lock ends with the process."""
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.lockf(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Only these two mean that somebody else holds the lock; other errors come from file systems
        # that have no locks, on which a sweep runs without one.
        if error.errno in (errno.EACCES, errno.EAGAIN):
            raise ValueError(
                f"{file}: another process runs a sweep on it; wait for it, or choose another file"
            ) from error


def _resumed(stream: FileIO, file: Path, head: dict[str, Any]) -> dict[int, Outcome]:
    """Read the outcomes in the file and prepare it to be continued.

    A new file gets its header; an incomplete last line is removed.
    """
    stream.seek(0)
    first, *lines = stream.read().split(b"\n")
    if not lines and _text(head).startswith(first):  # new, or killed before the header was whole
        stream.truncate(0)
        _append(stream, file, head)
        return {}
    _check_header(file, first, head)
    # The text after the last line end is empty, or a line whose writing was interrupted.
    stream.truncate(stream.tell() - len(lines[-1]))
    rows = (_row(line, head["points"]) for line in lines[:-1])
    return {row[0]: row[1] for row in rows if row is not None}


def _check_header(file: Path, line: bytes, head: dict[str, Any]) -> None:
    try:
        there = json.loads(line)
        form = there["format"]
    except (ValueError, TypeError, KeyError):
        form = None
    if form != FORMAT:
        raise ValueError(f"{file}: not a file of '{FORMAT}'; choose another file")
    for key, what in (("fn", "function"), ("keys", "names"), ("points", "number of points")):
        if there.get(key) != head[key]:
            raise ValueError(
                f"{file}: is of another sweep, its {what}: {there.get(key)}, here {head[key]}; "
                "delete it, or choose another file"
            )
    if there != head:
        raise ValueError(
            f"{file}: is of another sweep, with other values of the points; delete it, or choose "
            "another file"
        )


def _row(line: bytes, n: int) -> tuple[int, Outcome] | None:
    """Return index and outcome of a line; None if it is damaged, so that the point runs again."""
    try:
        row = json.loads(line)
        i, result, error = row["point"], row.get("result"), row.get("error")
    except (ValueError, TypeError, KeyError, AttributeError):
        return None
    if type(i) is int and 0 <= i < n and isinstance(result, dict) != isinstance(error, str):
        return i, (result, error)
    return None


def _text(record: dict[str, Any]) -> bytes:
    return json.dumps(record).encode() + b"\n"


def _append(stream: FileIO, file: Path, record: dict[str, Any]) -> None:
    text = _text(record)
    # The stream is unbuffered, and a call may write a part only, such as on a full disk.
    try:
        while text:
            text = text[stream.write(text) :]
    except OSError as error:
        raise ValueError(
            f"{file}: cannot be written ({error.strerror}); earlier points are kept; make room, "
            "and call again"
        ) from error
