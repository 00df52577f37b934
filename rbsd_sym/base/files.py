"""Files written whole or not at all, and the data frames of pandas."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any


def write_whole(path: Path, write: Callable[[IO[bytes]], object], who: str) -> Path:
    """Write a file by a temporary one in the same folder, which must exist.

    Arguments:
        write: gets the open file.
        who: begins the error message.

    Raises:
        ValueError: the file cannot be written.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with open(temporary, "wb") as file:
            write(file)
        os.replace(temporary, path)
    except OSError as error:
        why = error.strerror or error
        raise ValueError(
            f"{who}: cannot write to {path.parent} ({why}); make the folder, or choose another"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)
    return path


def data_frame() -> Any:
    """Return pandas' DataFrame, imported only when it is asked for.

    Raises:
        ImportError: pandas is not installed.
    """
    try:
        return importlib.import_module("pandas").DataFrame
    except ImportError as error:
        raise ImportError("to_pandas: pandas is not installed; run pip install pandas") from error
