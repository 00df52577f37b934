"""The compiled library of a generated folder: built once, kept in a cache, called from CasADi."""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import casadi as ca

from .. import version
from ..model.model import Model
from . import c_names as names
from .folder import Artefact, read_manifest, sha256

OPTIMISED = ("-O2",)
_KINDS = {  # of a folder, by its manifest: in a sentence, what loads it, what writes it
    "model": ("a model", "load_c", "export_c"),
    "simulator": ("a simulator", "load_simulator", "export_simulator"),
    "optimal control problem": ("an optimal control problem", "load_problem", "export_problem"),
}


class CompilerMissing(RuntimeError):
    """There is no C compiler on this machine; everything but building C works without one."""


@dataclass(frozen=True, eq=False)
class Library:
    """A compiled model; `function(name)` is the CasADi Function (t, x, z, u, p) of the C code."""

    path: Path
    name: str
    digest: str
    functions: tuple[str, ...]

    def function(self, name: str) -> ca.Function:
        """A function of the library.

        Raises:
            ValueError: it was not exported.
        """
        if name not in self.functions:
            raise ValueError(
                f"library of '{self.name}': no function '{name}'; it has "
                f"{', '.join(self.functions)}; export it with export_c(functions=[...])"
            )
        return ca.external(names.kernel(self.name, name), str(self.path))


def load_c(
    source: Artefact | str | os.PathLike[str],
    model: Model | None = None,
    compiler: str | None = None,
    flags: Sequence[str] = OPTIMISED,
) -> Library:
    """Compile a generated folder, if the cache does not hold it yet, and load it.

    Arguments:
        source: what `export_c` gave, or its folder.
        model: if given, the folder must be of this very model.
        compiler: $CC, cc, gcc or clang by default.
        flags: beyond those that make a shared library of C99.

    Raises:
        ValueError: the folder is stale, damaged, or of another model or ABI.
        CompilerMissing: there is no compiler.
        RuntimeError: the compiler failed; with its message.
    """
    path, manifest = build_folder(source, "model", "", model, compiler, flags)
    name, digest = str(manifest["name"]), str(manifest["digest"])
    return Library(path, name, digest, tuple(manifest["functions"]))


def build_folder(
    source: Artefact | str | os.PathLike[str],
    kind: str,
    suffix: str,
    model: Model | None,
    compiler: str | None,
    flags: Sequence[str],
) -> tuple[Path, dict]:
    """The library of a generated folder, compiled if the cache does not hold it yet; its manifest.

    Arguments:
        kind: what the folder is to hold.
        suffix: of its files' names, after the model's.

    Raises:
        ValueError, CompilerMissing, RuntimeError: as `load_c`; the folder holds something else.
    """
    folder = source.folder if isinstance(source, Artefact) else Path(source)
    manifest = read_manifest(folder)
    own = manifest.get("kind", "model")
    if own != kind:
        what, load, _ = _KINDS.get(own, (f"'{own}'", "the version that wrote it", ""))
        raise ValueError(f"{folder}: holds {what}; use {load}")
    file = f"{manifest['name']}{suffix}"
    text = check_folder(folder, manifest, file, model)
    return build(f"{file}-{manifest['digest']}", text, compiler, flags), manifest


def labels_of(manifest: dict) -> dict[str, tuple[tuple[str, str, float], ...]]:
    """Name, unit and start of each label in a manifest, by group."""
    return {
        group: tuple((str(name), str(unit), float(start)) for name, unit, start in rows)
        for group, rows in manifest["labels"].items()
    }


def check_folder(folder: Path, manifest: dict, file: str, model: Model | None) -> str:
    """The text to compile: <file>.c with <file>.h in it, if both are what was written.

    Raises:
        ValueError: they are not, or of another model or ABI.
    """
    if manifest["abi"] != version.ABI:
        raise ValueError(
            f"{folder}: written for ABI {manifest['abi']}, this version has {version.ABI}; export "
            "the model again"
        )
    if model is not None and manifest["digest"] != model.digest:
        raise ValueError(
            f"{folder}: library model {manifest['digest']} does not match model {model.digest}; "
            f"run {_KINDS[manifest.get('kind', 'model')][2]}(model, folder) again"
        )
    texts = {}
    for name in (f"{file}.c", f"{file}.h"):
        try:
            texts[name] = text = (folder / name).read_text()
        except OSError as error:
            raise ValueError(f"{folder}: {name} is missing; export the model again") from error
        if sha256(text) != manifest["files"].get(name):
            raise ValueError(
                f"{folder}: {name} is not the file that was written (its hash differs); export the "
                "model again"
            )
    header = texts[f"{file}.h"]
    return texts[f"{file}.c"].replace(f'#include "{file}.h"\n', header, 1)


def build(name: str, text: str, compiler: str | None, flags: Sequence[str]) -> Path:
    """The shared library of a C text; from the cache, if it holds that of the very same text.

    The key is the text, the compiler with its version, and the flags.

    Raises:
        CompilerMissing: there is no compiler.
        RuntimeError: the compiler failed; with its message.
        ValueError: the cache cannot be written.
    """
    chosen = _compiler(compiler)
    parts = [version.VERSION, str(version.ABI), text, _identity(tuple(chosen)), " ".join(flags)]
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:24]
    library = _cache_folder() / f"{name}-{key}.so"
    if not library.exists():
        _build(text, library, chosen, flags)
    return library


def _compiler(compiler: str | None) -> list[str]:
    chosen = compiler or os.environ.get("CC", "")
    wanted = [chosen] if chosen else ["cc", "gcc", "clang"]
    for name in wanted:
        words = shlex.split(name)  # $CC may carry flags, such as "gcc -m64"
        if words and shutil.which(words[0]):
            return words
    raise CompilerMissing(
        f"no C compiler found ({', '.join(wanted)}); building C needs one, everything else works "
        "without: use model.function(name)"
    )


@cache
def _identity(compiler: tuple[str, ...]) -> str:
    command = [*compiler, "--version"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"{shutil.which(compiler[0])} {compiler} {result.stdout.splitlines()[:1]}"


def _cache_folder() -> Path:
    """$RBSD_SYM_CACHE, or rbsd_sym in the user's cache folder."""
    chosen = os.environ.get("RBSD_SYM_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(chosen) if chosen else Path(base) / "rbsd_sym"


def _build(text: str, library: Path, compiler: list[str], flags: Sequence[str]) -> None:
    """Compile under a temporary name and put it in place: half a library is never seen."""
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=library.parent, suffix=".part")
    except OSError as error:
        raise ValueError(
            f"{library.parent}: cannot be written ({error.strerror}); set RBSD_SYM_CACHE to a "
            "folder you may write to"
        ) from error
    os.close(handle)
    shared = ["-std=c99", "-fPIC", "-shared"]
    command = [*compiler, *shared, *flags, "-x", "c", "-", "-o", temporary, "-lm"]
    try:
        result = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
        if result.returncode:
            raise RuntimeError(f"{' '.join(command)} failed:\n{result.stderr[-2000:]}")
        os.chmod(temporary, 0o755)
        os.replace(temporary, library)
    finally:
        if os.path.exists(temporary):
            os.unlink(temporary)
