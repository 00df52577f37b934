"""Exports: a `Model` to files; one file per target."""

from .c import export_c
from .compiled import compiled
from .folder import Artefact
from .load import CompilerMissing, Library, load_c
from .simulator import export_simulator
from .simulator_load import Simulator, load_simulator

__all__ = [
    "Artefact",
    "CompilerMissing",
    "Library",
    "Simulator",
    "compiled",
    "export_c",
    "export_simulator",
    "load_c",
    "load_simulator",
]
