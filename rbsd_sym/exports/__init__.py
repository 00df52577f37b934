"""Exports: a `Model` to files; one file per target."""

from .c import export_c
from .compiled import compiled
from .files import Artefact
from .load import CompilerMissing, Library, load_c
from .simulate import Simulator, load_simulator
from .simulator import export_simulator

__all__ = [
    "Artefact", "CompilerMissing", "Library", "Simulator", "compiled", "export_c",
    "export_simulator", "load_c", "load_simulator",
]  # fmt: skip
