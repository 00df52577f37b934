"""Compile a generated folder, keep the library in a cache, and call it through CasADi."""

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
# Kind of a folder by its manifest: how a message names it, what loads it, what writes it.
_KINDS = {
    "model": ("a model", "load_c", "export_c"),
    "simulator": ("a simulator", "load_simulator", "export_simulator"),
    "optimal control problem": ("an optimal control problem", "load_problem", "export_problem"),
}


class CompilerMissing(RuntimeError):
    """No C compiler was found; only what builds C needs one.

    Install gcc or clang, or name a compiler by $CC or the argument `compiler`. Without one, use
    `model.function(name)`, whose numbers are the same.
    """


@dataclass(frozen=True, eq=False)
class Library:
    """The compiled functions of a model, as CasADi Functions; `load_c` returns it.

    >>> library.function("ode")(0, x, z, u, p)

    Fields:
        path: of the shared library in the cache.
        name, digest: of the model.
        functions: names of those that were exported.
    """

    path: Path
    name: str
    digest: str
    functions: tuple[str, ...]

    def function(self, name: str) -> ca.Function:
        """Return the CasADi Function (t, x, z, u, p) of that name, as in `model.function`.

        Derivatives take their further argument after p, as in the model. A function from a library
        cannot be differentiated further: export the derivative and ask for it by name.

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
    """Compile what `export_c` wrote, unless the cache holds it already, and load the library.

    Source and header are checked against the hashes in the manifest first, so an edited or
    half-copied folder is refused. The cache is $RBSD_SYM_CACHE, or rbsd_sym in the user's cache
    folder; its key includes the source text, the compiler and the flags.

    >>> rs.load_c("generated/swing", model).function("dode_dx")

    Arguments:
        source: what `export_c` returned, or the path of its folder.
        model: if given, the folder must have been written from this model (digests are compared).
        compiler: command of a C compiler; $CC, cc, gcc or clang by default.
        flags: compiler flags beside those for a shared library of C99.

    Raises:
        ValueError: the folder is stale, damaged, or of another model, kind or ABI.
        CompilerMissing: no C compiler was found.
        RuntimeError: the compiler failed; the message holds its output.
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
    """Return the path of a folder's compiled library, and the folder's manifest.

    Arguments:
        source, model, compiler, flags: as in `load_c`.
        kind: what the folder must hold, as its manifest says: "model", "simulator", ...
        suffix: of the names of source and header, after that of the model.

    Raises:
        ValueError, CompilerMissing, RuntimeError: as in `load_c`.
    """
    folder = source.folder if isinstance(source, Artefact) else Path(source)
    manifest = read_manifest(folder)
    own = manifest.get("kind", "model")
    if own != kind:
        what, load, _ = _KINDS.get(own, (f"'{own}'", "the version of rbsd_sym that wrote it", ""))
        raise ValueError(f"{folder}: holds {what}; use {load}")
    file = f"{manifest['name']}{suffix}"
    text = check_folder(folder, manifest, file, model)
    return build(f"{file}-{manifest['digest']}", text, compiler, flags), manifest


def labels_of(manifest: dict) -> dict[str, tuple[tuple[str, str, float], ...]]:
    """Return (name, unit, start) of each label in a manifest, by group ("x", "u", "p", ...)."""
    return {
        group: tuple((str(name), str(unit), float(start)) for name, unit, start in rows)
        for group, rows in manifest["labels"].items()
    }


def check_folder(folder: Path, manifest: dict, file: str, model: Model | None) -> str:
    """Check a folder against its manifest; return <file>.c with <file>.h inserted.

    Arguments:
        file: name of source and header without their endings.
        model: the folder must have been written from it, if it is given.

    Raises:
        ValueError: another ABI or model, a missing file, or one that was changed.
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
    # With the header inserted, one text holds all that determines the library: it is the key of the
    # cache, and the compiler reads it from a pipe without needing the folder.
    header = texts[f"{file}.h"]
    return texts[f"{file}.c"].replace(f'#include "{file}.h"\n', header, 1)


def build(name: str, text: str, compiler: str | None, flags: Sequence[str]) -> Path:
    """Return the path of the shared library of a C text, compiled unless the cache holds it.

    Arguments:
        name: first part of the library's file name.
        text: complete C99 source; it includes standard headers only.
        compiler, flags: as in `load_c`.

    Raises:
        CompilerMissing: no C compiler was found.
        RuntimeError: the compiler failed; the message holds its output.
        ValueError: the cache cannot be written.
    """
    # Everything that can change the machine code is part of the key, the version of the compiler
    # included, so a library in the cache never needs to be invalidated.
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
        "without it; install gcc or clang, set $CC, or use model.function(name)"
    )


@cache  # it starts a process
def _identity(compiler: tuple[str, ...]) -> str:
    """Return path, command and first line of the version of a compiler."""
    command = [*compiler, "--version"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"{shutil.which(compiler[0])} {compiler} {result.stdout.splitlines()[:1]}"


def _cache_folder() -> Path:
    """Return $RBSD_SYM_CACHE, or rbsd_sym in the user's cache folder."""
    chosen = os.environ.get("RBSD_SYM_CACHE")
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(chosen) if chosen else Path(base) / "rbsd_sym"


def _build(text: str, library: Path, compiler: list[str], flags: Sequence[str]) -> None:
    """Compile a C text into a shared library, completely or not at all."""
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(dir=library.parent, suffix=".part")
    except OSError as error:
        raise ValueError(
            f"{library.parent}: cannot be written ({error.strerror}); set RBSD_SYM_CACHE to a "
            "folder you may write to"
        ) from error
    os.close(handle)
    # The compiler writes to a temporary name in the cache, and renaming is atomic: a process that
    # builds the same library at the same time never loads half of it. Where two finish, the second
    # replaces the first by the same contents.
    shared = ["-std=c99", "-fPIC", "-shared"]
    # Linkers resolve symbols from left to right, hence -lm at the end.
    command = [*compiler, *shared, *flags, "-x", "c", "-", "-o", temporary, "-lm"]
    try:
        result = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
        if result.returncode:
            raise RuntimeError(f"{' '.join(command)} failed:\n{result.stderr[-2000:]}")
        os.chmod(temporary, 0o755)  # mkstemp keeps others out
        os.replace(temporary, library)
    finally:
        if os.path.exists(temporary):
            os.unlink(temporary)
