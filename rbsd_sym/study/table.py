"""A small table of named columns with units, which studies return."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import casadi as ca
import numpy as np

from ..base.files import data_frame, write_whole

if TYPE_CHECKING:
    import pandas

Cell = Union[float, str, tuple, None]


def plain(value: Any) -> Cell:
    """Return the value as plain Python: a number, a text, None, or a tuple of such.

    Numbers and arrays of numpy and CasADi are converted; a column of CasADi becomes a flat tuple.

    Raises:
        TypeError: it is something else, such as a symbol.
    """
    if isinstance(value, ca.DM):
        value = value.full()[:, 0] if value.is_column() else value.full()
        value = value[0] if value.shape == (1,) else value
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return tuple(plain(v) for v in value)
    # bool is tested first, since it is a subclass of int and would become 0 or 1.
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, (int, float)):
        return int(value) if isinstance(value, int) else float(value)
    raise TypeError(
        f"a {type(value).__name__} cannot be a cell; give a number, a text, None, or a list of such"
    )


def plain_items(items: Mapping[str, Any]) -> dict[str, Cell]:
    """Return a mapping with its values as plain Python.

    Raises:
        TypeError: a value is of another kind; the message names it.
    """
    values: dict[str, Cell] = {}
    for key, value in items.items():
        try:
            values[key] = plain(value)
        except TypeError as error:
            raise TypeError(f"'{key}': {error}") from error
    return values


def _is_number(cell: Cell) -> bool:
    """Return whether a cell is a number or a list of numbers."""
    if isinstance(cell, tuple):
        return all(map(_is_number, cell))
    return isinstance(cell, (int, float)) and not isinstance(cell, bool)


@dataclass(frozen=True)
class ResultTable:
    """A table of named columns with units; `print(table)` shows it aligned.

    >>> table = rs.study.Table(("k", "error"), ("N/m", ""), ((1e3, 1e-6), (2e3, 3e-6)))
    >>> table.column("k")
    array([1000., 2000.])

    Fields:
        columns: names, all different.
        units: of the columns, "" if there is none.
        rows: one cell for each column: a number, a text, None, or a tuple of such (lists and
            arrays become tuples).

    Raises:
        ValueError: names that repeat, another number of units, or a row of another length.
        TypeError: a cell of another kind.
    """

    columns: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def __post_init__(self) -> None:
        n, names = len(self.columns), ", ".join(self.columns)
        if len(set(self.columns)) < n or len(self.units) != n:
            raise ValueError(
                f"table: columns {names} with {len(self.units)} units; names are all different, "
                "and each has one unit"
            )
        rows = tuple(tuple(plain(cell) for cell in row) for row in self.rows)
        for i, row in enumerate(rows):
            if len(row) != n:
                raise ValueError(f"table: row {i} has {len(row)} cells; the columns are {names}")
        for field, value in (("columns", self.columns), ("units", self.units), ("rows", rows)):
            object.__setattr__(self, field, tuple(value))

    def column(self, name: str) -> np.ndarray:
        """Return a column as an array with an entry for each row.

        Numbers give floats (n,), lists of k numbers floats (n, k), None among them NaN; truth
        values give bool (n,), anything else objects (n,).

        Raises:
            ValueError: no such column.
        """
        if name not in self.columns:
            raise ValueError(f"table: no column '{name}'; it has {', '.join(self.columns)}")
        cells = [row[self.columns.index(name)] for row in self.rows]
        there = [cell for cell in cells if cell is not None]
        if there and all(map(_is_number, there)):
            # Lists of different lengths, and integers beyond floats, remain objects.
            with contextlib.suppress(ValueError, OverflowError):
                missing = np.full(np.array(there, float).shape[1:], np.nan)
                return np.array([missing if c is None else c for c in cells], float)
        if cells and all(isinstance(cell, bool) for cell in cells):
            return np.array(cells)
        # np.array(cells, object) would make a matrix of tuples of one length.
        objects = np.empty(len(cells), object)
        for i, cell in enumerate(cells):
            objects[i] = cell
        return objects

    def with_units(self, units: Mapping[str, str]) -> ResultTable:
        """Return the table with other units of some columns, {name: unit}; cells stay as they are.

        Raises:
            ValueError: no such column.
        """
        for name in units:
            self.column(name)
        there = zip(self.columns, self.units, strict=True)
        return replace(self, units=tuple(units.get(name, unit) for name, unit in there))

    def to_csv(self, path: str | os.PathLike[str]) -> Path:
        """Write a file of comma-separated values, completely or not at all.

        The first line holds `name [unit]`. Numbers keep every digit, None is empty, a list is
        written as JSON.

        Arguments:
            path: of the file, in a folder that exists.

        Raises:
            ValueError: the file cannot be written.
        """
        text, target = io.StringIO(newline=""), Path(path)
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self._titles())
        writer.writerows([_in_csv(cell) for cell in row] for row in self.rows)
        data = text.getvalue().encode(errors="backslashreplace")
        return write_whole(target, lambda file: file.write(data), "table")

    def to_markdown(self) -> str:
        """Return the table as Markdown, numbers to six significant digits."""
        cells = [[text.replace("|", "\\|") for text in line] for line in self._lines()]
        rule = ["--:" if right else "---" for right in self._right()]
        return "\n".join(f"| {' | '.join(line)} |" for line in (cells[0], rule, *cells[1:])) + "\n"

    def to_pandas(self) -> pandas.DataFrame:
        """Return the table as a pandas DataFrame; units are left out.

        Raises:
            ImportError: pandas is not installed.
        """
        return data_frame()([list(row) for row in self.rows], columns=list(self.columns))

    def __repr__(self) -> str:
        return f"<Table of {len(self.rows)} rows: {', '.join(self.columns)}>"

    def __str__(self) -> str:
        lines, right = self._lines(), self._right()
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(
                text.rjust(width) if flush else text.ljust(width)
                for text, width, flush in zip(line, widths, right, strict=True)
            ).rstrip()
            for line in lines
        )

    def _titles(self) -> list[str]:
        pairs = zip(self.columns, self.units, strict=True)
        return [f"{name} [{unit}]" if unit else name for name, unit in pairs]

    def _lines(self) -> list[list[str]]:
        return [self._titles(), *([_shown(cell) for cell in row] for row in self.rows)]

    def _right(self) -> list[bool]:
        """Return which columns are aligned to the right: those of numbers."""
        return [self.column(name).dtype == float for name in self.columns]


def _shown(cell: Cell) -> str:
    if isinstance(cell, tuple):
        return f"[{', '.join(map(_shown, cell))}]"
    if isinstance(cell, float):
        return f"{cell:.6g}"
    return "-" if cell is None else " ".join(str(cell).split())


def _in_csv(cell: Cell) -> Any:
    # The csv module does not quote a lone carriage return, which readers take for a line end.
    if isinstance(cell, str):
        return cell.replace("\r\n", "\n").replace("\r", "\n")
    return json.dumps(cell) if isinstance(cell, tuple) else cell
