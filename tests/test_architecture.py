"""The rules of the house, read from the source: floors, sizes, names, docstrings, lint, types."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT, TESTS

import rbsd_sym

PACKAGE = ROOT / "rbsd_sym"
FILES = sorted(PACKAGE.rglob("*.py"))
FLOOR_ROW = re.compile(r"\| (\d+) \| ([\w`, ]+) \|")


def floors(readme: Path) -> dict[str, int]:
    """Floor of each unit, from the table of floors in a README."""
    rows = FLOOR_ROW.findall(readme.read_text(encoding="utf-8"))
    return {unit: int(floor) for floor, units in rows for unit in re.findall(r"\w+", units)}


FLOOR = floors(PACKAGE / "README.md")


def unit_of(path: Path) -> str:
    """The unit a file belongs to: its module, or the folder below the package."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imported_units(path: Path) -> set[str]:
    """Units of the package that a file imports, beyond its own folder."""
    depth = len(path.relative_to(PACKAGE).parts) - 1
    units = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == depth + 1:
            units |= {node.module.split(".")[0]} if node.module else {a.name for a in node.names}
    return units


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_down_only(path: Path) -> None:
    unit = unit_of(path)
    if unit == "__init__":
        return
    for other in imported_units(path):
        assert FLOOR[other] < FLOOR[unit], f"{unit} (floor {FLOOR[unit]}) imports {other}"


def test_absolute_imports_of_the_package_are_not_used() -> None:
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                assert not (node.module or "").startswith("rbsd_sym"), path


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_sizes_and_habits(path: Path) -> None:
    text = path.read_text()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            assert node.end_lineno is not None
            assert node.end_lineno - node.lineno < 60, f"{node.name} is over 60 lines"
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            assert getattr(node.exc.func, "id", "") not in ("Exception", "AssertionError")
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "print":
            assert path.name == "__main__.py", "only the command line prints"


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
