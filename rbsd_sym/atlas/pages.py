"""The pages of the atlas, found in this folder, and the files made of one."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ..files import write_whole
from ..study import Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tables = Mapping[str, Table]
_COMMAND = "python -m rbsd_sym stability --all"


class Page(NamedTuple):
    """One failure: its place in the atlas, what it is about, how it is measured and drawn."""

    number: int
    name: str
    title: str
    text: str
    study: Callable[[bool], Tables]
    draw: Callable[[Tables], Figure]


def pages() -> tuple[Page, ...]:
    """All pages, by their numbers."""
    package = __name__.rpartition(".")[0]
    found = []
    for module in pkgutil.iter_modules([str(Path(__file__).parent)]):
        page = importlib.import_module(f"{package}.{module.name}")
        if hasattr(page, "NUMBER"):
            title, _, text = page.__doc__.partition("\n")
            found.append(
                Page(
                    page.NUMBER, module.name, title.rstrip("."), text.strip(), page.study, page.draw
                )
            )
    return tuple(sorted(found))


def make(page: Page, folder: Path, full: bool = True) -> Tables:
    """Measure a page and write its figure (.png), tables (.csv) and text (.md); the tables.

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
        table.to_csv(folder / f"{stem}_{name}.csv")
        lines.append(f"## {name.replace('_', ' ')}\n\n{table.to_markdown()}")
    text = "\n\n".join(lines) + "\n"
    write_whole(folder / f"{stem}.md", lambda file: file.write(text.encode()), who)
    return tables
