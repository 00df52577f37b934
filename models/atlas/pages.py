"""The pages of the atlas, found in this folder, and the files made from a page."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NamedTuple

from rbsd_sym.__main__ import load_model_file
from rbsd_sym.base.files import write_whole
from rbsd_sym.study import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tables = Mapping[str, Table]
# Longest table that the page shows; longer ones are linked.
_ROWS = 40
_COMMAND = "python -m rbsd_sym stability --all"


class Page(NamedTuple):
    """One page of the atlas.

    Fields:
        number: its place.
        name: name of its module.
        title, text: from the docstring of the module.
        study: function (full) that measures and returns tables by name.
        draw: function (tables) that returns the figure.
    """

    number: int
    name: str
    title: str
    text: str
    study: Callable[[bool], Tables]
    draw: Callable[[Tables], Figure]


def model_file(name: str) -> ModuleType:
    """Return a scene file of models/, loaded as a module."""
    return load_model_file(Path(__file__).parents[1] / f"{name}.py")


def pages() -> tuple[Page, ...]:
    """Return all pages in the order of their numbers."""
    found = []
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        page = importlib.import_module(f".{module.name}", __package__)
        if hasattr(page, "NUMBER"):
            title, _, text = (page.__doc__ or "").partition("\n")
            found.append(
                Page(
                    page.NUMBER, module.name, title.rstrip("."), text.strip(), page.study, page.draw
                )
            )
    return tuple(sorted(found))


def make(page: Page, folder: Path, full: bool = True) -> Tables:
    """Measure a page, write its figure (.png), tables (.csv) and text (.md), and return the tables.

    Arguments:
        page: the page.
        folder: existing folder to write to.
        full: measure all points; otherwise only a few, within seconds.

    Raises:
        ValueError: the folder cannot be written to.
    """
    tables = page.study(full)
    stem, who = f"{page.number:02d}_{page.name}", f"atlas '{page.name}'"
    figure = page.draw(tables)
    write_whole(
        folder / f"{stem}.png", lambda file: figure.savefig(file, dpi=110, format="png"), who
    )
    lines = [f"# {page.title}", page.text, f"![{page.title}]({stem}.png)", f"`{_COMMAND}`"]
    for name, table in tables.items():
        file = table.to_csv(folder / f"{stem}_{name}.csv").name
        short = len(table.rows) <= _ROWS
        shown = table.to_markdown() if short else f"{len(table.rows)} rows: [{file}]({file})"
        lines.append(f"## {name.replace('_', ' ')}\n\n{shown}")
    _write(folder / f"{stem}.md", lines)
    return tables


def contents(folder: Path) -> Path:
    """Write README.md, a list of all pages with their figures, and return its path.

    Raises:
        ValueError: the folder cannot be written to.
    """
    lines = ["# Where methods fail", f"`{_COMMAND}` makes these pages again."]
    for page in pages():
        stem = f"{page.number:02d}_{page.name}"
        lines.append(
            f"## [{page.number}. {page.title}]({stem}.md)\n\n{page.text}\n\n"
            f"![{page.title}]({stem}.png)"
        )
    return _write(folder / "README.md", lines)


def _write(path: Path, paragraphs: list[str]) -> Path:
    text = "\n\n".join(paragraphs) + "\n"
    return write_whole(path, lambda file: file.write(text.encode()), f"atlas '{path.stem}'")
