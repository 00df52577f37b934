"""The stability atlas: where methods fail, and what survives; a page for each failure.

    python -m rbsd_sym stability --all

A page is a module of this folder: its docstring is the title, a blank line, and what there is to
see; `NUMBER` orders it; `study(full) -> {name: Table}` measures, in seconds unless full; and
`draw(tables) -> Figure` shows the tables.
"""

from .pages import Page, contents, make, pages

__all__ = ["Page", "contents", "make", "pages"]
