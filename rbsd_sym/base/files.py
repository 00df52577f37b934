"""Writing files completely or not at all, and access to the data frames of pandas."""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any


def write_whole(path: Path, write: Callable[[IO[bytes]], object], who: str) -> Path:
    """Write a file so that it is either complete or unchanged, and return its path.

    The content goes to a temporary file in the same folder, which then replaces the target in one
    step.

    Arguments:
        path: the file; its folder must exist.
        write: function that is called with the file, open for writing bytes.
        who: beginning of the error message.

    Raises:
        ValueError: the file cannot be written.
    """
    temporary = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        with open(temporary, "wb") as file:
            write(file)
        # Renaming within one file system is atomic: readers find the old file or the new one, also
        # if this process is killed halfway.
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
    """Return the class DataFrame of pandas, importing pandas only now.

    Raises:
        ImportError: pandas is not installed.
    """
    try:
        return importlib.import_module("pandas").DataFrame
    except ImportError as error:
        raise ImportError("to_pandas: pandas is not installed; run pip install pandas") from error
