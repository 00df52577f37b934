"""Tables: cells, units, text, Markdown, CSV."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rbsd_sym.study import Table


def sample() -> Table:
    return Table(
        ("law", "k", "error", "force"), ("", "N/m", "", "N"),
        (("a|b", 1000, 1.25e-7, [1, 2.5]), ("c", 2e3, None, None), ("d", 3e3, math.nan, [3, 4])),
    )  # fmt: skip


def test_columns_are_floats_where_all_cells_are_numbers() -> None:
    table = sample()
    assert table.column("k").dtype == float
    np.testing.assert_array_equal(table.column("error"), [1.25e-7, np.nan, np.nan])
    np.testing.assert_array_equal(table.column("force"), [[1, 2.5], [np.nan, np.nan], [3, 4]])
    assert table.column("law").tolist() == ["a|b", "c", "d"]
    assert table.rows[0][3] == (1, 2.5)
    flags = Table(("ok", "ragged", "none"), ("",) * 3, ((True, [1], None), (False, [1, 2], None)))
    assert flags.column("ok").dtype == bool
    assert flags.column("ragged").tolist() == [(1,), (1, 2)]
    assert flags.column("none").tolist() == [None, None]
    with pytest.raises(ValueError, match=r"no column 'm'; it has law, k"):
        table.column("m")


def test_numbers_of_numpy_and_casadi_become_plain() -> None:
    cells = (np.float32(0.5), np.int64(3), np.bool_(True), np.array([[1, 2]]), ca.DM(4), None)
    (row,) = Table(tuple("abcdef"), ("",) * 6, (cells,)).rows
    assert row == (0.5, 3, True, ((1, 2),), 4.0, None)
    assert Table(("a",), ("",), ((ca.DM([1, 2]),),)).rows == (((1.0, 2.0),),)
    assert [type(v) for v in row] == [float, int, bool, tuple, float, type(None)]
    for bad in (ca.SX.sym("x"), 1j, {1}, object()):
        with pytest.raises(TypeError, match="cannot be a cell; give a number"):
            Table(("a",), ("",), ((bad,),))


@pytest.mark.parametrize(
    ("columns", "units", "rows", "words"),
    [
        (("a", "a"), ("", ""), (), "all different"),
        (("a", "b"), ("",), (), "each has one unit"),
        (("a", "b"), ("", ""), ((1, 2), (1,)), "row 1 has 1 cells"),
    ],
)
def test_tables_that_do_not_fit(columns: Any, units: Any, rows: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        Table(columns, units, rows)


def test_text_and_markdown() -> None:
    lines = str(sample()).splitlines()
    assert [line.split() for line in lines[1:3]] == [
        ["a|b", "1000", "1.25e-07", "[1,", "2.5]"], ["c", "2000", "-", "-"],
    ]  # fmt: skip
    assert len({len(line) for line in lines}) == 1
    markdown = sample().to_markdown().splitlines()
    assert markdown[0] == "| law | k [N/m] | error | force [N] |"
    assert markdown[1] == "| --- | --: | --: | --: |"
    assert markdown[2] == "| a\\|b | 1000 | 1.25e-07 | [1, 2.5] |"
    assert str(Table(("a",), ("m",), ())) == "a [m]"


def test_units_are_set_by_name() -> None:
    assert sample().with_units({"error": "1"}).units == ("", "N/m", "1", "N")
    with pytest.raises(ValueError, match="no column 'eror'"):
        sample().with_units({"eror": "1"})


CELLS = st.one_of(
    st.none(),
    st.integers(-(10**20), 10**20),
    st.floats(),
    st.text(st.characters(codec="utf-8", exclude_characters="\0\r")),
    st.lists(st.floats(), max_size=3).map(tuple),
)


@given(st.lists(st.tuples(CELLS, CELLS), max_size=8))
def test_csv_keeps_every_digit(tmp_path_factory: Any, rows: list[tuple[Any, Any]]) -> None:
    table = Table(("a", "b, c"), ("N/m", ""), tuple(rows))
    path = table.to_csv(tmp_path_factory.getbasetemp() / "table.csv")
    with path.open(newline="", encoding="utf-8") as file:
        first, *read = csv.reader(file)
    assert first == ["a [N/m]", "b, c"]
    assert len(read) == len(rows)
    for row, texts in zip(rows, read, strict=True):
        for cell, text in zip(row, texts, strict=True):
            assert repr(back(text, type(cell))) == repr(cell)


def back(text: str, kind: type) -> Any:
    """A cell of the kind from its text in a CSV file."""
    if kind is type(None):
        return None if text == "" else text
    return tuple(json.loads(text)) if kind is tuple else kind(text)


def test_csv_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"cannot write .*make the folder"):
        sample().to_csv(tmp_path / "nowhere" / "table.csv")
    (tmp_path / "table.csv").mkdir()
    with pytest.raises(ValueError, match="cannot write"):
        sample().to_csv(tmp_path / "table.csv")
    assert [p.name for p in tmp_path.iterdir()] == ["table.csv"]
    text = Table(("a",), ("",), (("one\r\ntwo\rthree \udc80",),)).to_csv(tmp_path / "b.csv")
    assert text.read_bytes() == b'a\n"one\ntwo\nthree \\udc80"\n'
