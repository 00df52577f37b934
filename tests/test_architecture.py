"""The rules of the house, read from the source: rooms, floors, names, docstrings, lint, types."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
import types
from collections import Counter
from pathlib import Path

import pytest
from paths import ROOT, TESTS

import rbsd_sym

PACKAGE = ROOT / "rbsd_sym"
FILES = sorted(PACKAGE.rglob("*.py"))
FLOOR_ROW = re.compile(r"\| (\d+) \| ([\w`, ]+) \|")


def floors(house: Path) -> dict[str, int]:
    """Floor of each room of a folder, from the table of floors in its README."""
    rows = FLOOR_ROW.findall((house / "README.md").read_text(encoding="utf-8"))
    return {room: int(floor) for floor, rooms in rows for room in re.findall(r"\w+", rooms)}


HOUSES = {house: found for p in PACKAGE.rglob("README.md") if (found := floors(house := p.parent))}


def rooms(house: Path) -> dict[str, list[Path]]:
    """Files of each room: a file of the folder, or all files of a folder in it."""
    found: dict[str, list[Path]] = {}
    for path in sorted(house.rglob("*.py")):
        found.setdefault(path.relative_to(house).parts[0].removesuffix(".py"), []).append(path)
    return found


def imported_rooms(house: Path, path: Path) -> set[str]:
    """Rooms that a file in one of them imports, beyond its own."""
    depth, found = len(path.relative_to(house).parts) - 1, set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == depth + 1:
            found |= {node.module.split(".")[0]} if node.module else {a.name for a in node.names}
    return found


def test_houses() -> None:
    """The package and the folders that have floors of their own."""
    assert {house.relative_to(ROOT).as_posix() for house in HOUSES} >= {"rbsd_sym", "rbsd_sym/ocp"}
    assert len(rooms(PACKAGE / "ocp")) <= 20


@pytest.mark.parametrize("house", HOUSES, ids=lambda house: house.name)
def test_imports_go_down_only(house: Path) -> None:
    floor, files = HOUSES[house], rooms(house)
    assert set(floor) == set(files)
    for room, paths in files.items():
        for other in {name for path in paths for name in imported_rooms(house, path)}:
            assert floor[other] < floor[room], f"{room} (floor {floor[room]}) imports {other}"


def test_absolute_imports_of_the_package_are_not_used() -> None:
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                assert not (node.module or "").startswith("rbsd_sym"), path


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_habits(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            assert node.end_lineno is not None
            assert node.end_lineno - node.lineno < 60, f"{node.name} is over 60 lines"
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            assert getattr(node.exc.func, "id", "") not in ("Exception", "AssertionError")
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print":
            assert path.name == "__main__.py", "only the command line prints"
        if isinstance(node, ast.ImportFrom) and node.level:
            private = [a.name for a in node.names if a.name.startswith("_")]
            assert not private, f"{path}: {private} belong to another module"


def test_four_files_stand_at_the_root() -> None:
    files = {path.name for path in PACKAGE.glob("*.py")}
    assert files == {"__init__.py", "__main__.py", "pipeline.py", "version.py"}


def test_no_two_files_and_no_two_classes_of_one_name() -> None:
    stems = Counter(path.stem for path in FILES if path.stem != "__init__")
    classes = Counter(
        node.name
        for path in FILES
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.ClassDef)
    )
    for counts in (stems, classes):
        assert not [name for name, count in counts.items() if count > 1]


def test_no_name_hides_a_package() -> None:
    for name in rbsd_sym.__all__:
        if (PACKAGE / name).is_dir():
            assert isinstance(getattr(rbsd_sym, name), types.ModuleType), name


TAKES_APART = "split rsplit partition rpartition startswith endswith removeprefix removesuffix"
# Texts that are not names of states, outputs, inputs or parameters.
OTHER_TEXTS = {
    "__main__.py": "arguments of the command line, names of modules",
    "exports/dop853_text.py": "text of C",
    "exports/header.py": "text of C",
    "exports/simulator_casadi.py": "text of C",
    "exports/simulator_texts.py": "text of C",
    "study/log.py": "lines of a file",
    "study/table.py": "white space in a cell",
    "study/workers.py": "white space in a message",
}


def test_names_are_taken_apart_in_one_place() -> None:
    """Below the waist meaning comes from structure; what a user typed is read in base/names.py."""
    found = set()
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
                continue
            texts = [a for a in node.args if isinstance(getattr(a, "value", None), (str, bytes))]
            cuts = node.func.attr in TAKES_APART.split()
            whole = isinstance(node.func.value, ast.Name) and node.func.value.id in ("np", "ca")
            if cuts and not whole and (texts or not node.args or node.func.attr != "split"):
                found.add(str(path.relative_to(PACKAGE)))
    assert found - {"base/names.py"} == set(OTHER_TEXTS)


# Files that do what one place should do; the numbers may fall, and not rise.
SITES = {
    "ca.integrator(": 7,
    "ca.CodeGenerator(": 6,
    "contextlib.redirect_std": 4,
    "subprocess.": 1,
}


@pytest.mark.parametrize("text", SITES)
def test_sites_do_not_multiply(text: str) -> None:
    files = [str(path) for path in FILES if text in path.read_text()]
    assert len(files) <= SITES[text], files


# Code lines (without blanks, comments, docstrings) that a room may have; raised only in a commit
# that says why.
BUDGET = {
    "analysis": 1180, "base": 1070, "dae": 570, "exports": 1680, "formulations": 1480,
    "integrators": 2160, "laws": 900, "mechanics": 225, "minimal": 860, "model": 1370, "ocp": 3770,
    "plots": 1250, "scene": 900, "study": 1460, "__init__": 140, "__main__": 370, "pipeline": 100,
    "version": 5,
}  # fmt: skip


def code_lines(path: Path) -> int:
    """Lines that are neither blank, nor a comment, nor part of a docstring."""
    text = path.read_text()
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        holds = isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
        if holds and ast.get_docstring(node):
            documented |= set(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    rows = enumerate(text.splitlines(), start=1)
    return sum(
        bool(row.strip()) and not row.strip().startswith("#") and i not in documented
        for i, row in rows
    )


def test_rooms_keep_their_budgets() -> None:
    lines = {room: sum(map(code_lines, paths)) for room, paths in rooms(PACKAGE).items()}
    assert set(lines) == set(BUDGET)
    assert not {room: n for room, n in lines.items() if n > BUDGET[room]}


def test_formatting_by_hand_is_for_matrices() -> None:
    assert sum(path.read_text().count("fmt: " + "skip") for path in FILES) <= 2


def test_public_names_have_docstrings() -> None:
    for name in rbsd_sym.__all__:
        item = getattr(rbsd_sym, name)
        if callable(item) and not isinstance(item, rbsd_sym.Param):
            assert item.__doc__, name


def test_top_level_is_what_was_asked_for() -> None:
    allowed = {"pyproject.toml", "rbsd_sym", "tests", "models", "generated", "README.md"}
    there = {p.name for p in ROOT.iterdir() if not p.name.startswith(".")}
    assert {n for n in there if not n.endswith(".egg-info") and n != "build"} <= allowed


def test_oracles_are_independent() -> None:
    for path in (TESTS / "oracles").glob("*.py"):
        text = path.read_text()
        assert "import casadi" not in text, path
        assert "import rbsd_sym" not in text, path
        assert "from rbsd_sym" not in text, path


def test_tests_have_the_folders_of_the_package_and_those_their_readme_names() -> None:
    rooms, folders = (
        {path.name for path in parent.iterdir() if path.is_dir() and path.name[0] not in "._"}
        for parent in (PACKAGE, TESTS)
    )
    readme = (TESTS / "README.md").read_text(encoding="utf-8")
    assert not [name for name in folders - rooms if f"`{name}/`" not in readme]
    stems = [path.stem for path in TESTS.rglob("test_*.py")]
    assert len(set(stems)) == len(stems), "pytest knows test modules by their names"


def test_no_test_module_imports_another() -> None:
    for path in TESTS.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not [name for name in names if "test_" in name], path


@pytest.mark.parametrize(
    "command",
    [
        ["ruff", "check", "."],
        ["ruff", "format", "--check", "rbsd_sym", "models"],
        ["mypy", "rbsd_sym"],
    ],
    ids=["lint", "format", "types"],
)
def test_tools_are_content(command: list[str]) -> None:
    tool = Path(sys.executable).with_name(command[0])
    found = str(tool) if tool.exists() else shutil.which(command[0])
    if not found:
        pytest.skip(f"{command[0]} is not installed (extra 'test')")
    result = subprocess.run(
        [found, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-1000:]
