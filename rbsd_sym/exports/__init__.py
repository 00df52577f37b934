"""Exports: write a `Model` as a folder of C, compile such folders, and call the result.

`export_c` writes the functions of a model, `export_simulator` a whole simulation; `load_c`,
`load_simulator` and `compiled` build machine code, which is kept in a cache. `README.md` in this
folder says what a folder of C holds and how to add a target.
"""

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
