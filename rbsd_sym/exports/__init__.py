"""Exports: a `Model` to files; one file per target."""

from .c import export_c
from .compiled import compiled
from .files import Artefact
from .load import CompilerMissing, Library, load_c

__all__ = ["Artefact", "CompilerMissing", "Library", "compiled", "export_c", "load_c"]
