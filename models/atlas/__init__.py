"""The stability atlas: where methods fail, and which remedies work; one page per failure.

    python -m rbsd_sym stability --all

A page is a module of this folder. Its docstring is the title and, after a blank line, the text of
the page. `NUMBER` gives its place; `study(full)` measures and returns tables by name, within
seconds unless `full`; `draw(tables)` returns the figure.
"""

from .pages import Page, contents, make, pages

__all__ = ["Page", "contents", "make", "pages"]
