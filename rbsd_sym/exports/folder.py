"""Folders of generated files: written completely or not at all, and never over a foreign file."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Artefact:
    """What an export wrote; the functions `load_...` take it in place of a path.

    Fields:
        folder: where the files are.
        name: of the model; C symbols begin with it.
        digest: of the model, 16 hexadecimal digits; loading compares it with that of a model.
        functions: names of the exported functions; none for a simulator.
    """

    folder: Path
    name: str
    digest: str
    functions: tuple[str, ...]


def template(file: str, marks: Mapping[str, Any]) -> str:
    """Return the text of a template with its marks replaced.

    Arguments:
        file: name of the template in this package, without the ending ".in".
        marks: value of each mark; @NAME@ in the template becomes `str(marks["NAME"])`.

    Raises:
        KeyError: the template has a mark that is not given.
    """
    text = resources.files(__package__).joinpath(f"{file}.in").read_text()
    return re.sub(r"@(\w+)@", lambda match: str(marks[match[1]]), text)


def sha256(text: str) -> str:
    """Return the hash of a file's text, as the manifest records it."""
    return hashlib.sha256(text.encode()).hexdigest()


def read_manifest(folder: Path) -> dict:
    """Read the manifest of a generated folder.

    Raises:
        ValueError: the folder has no manifest, or a damaged one.
    """
    try:
        manifest = json.loads((folder / MANIFEST).read_text())
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{folder}: no readable {MANIFEST} ({error}); export the model to this folder again"
        ) from error
    wanted = {"rbsd_sym", "abi", "name", "digest", "functions", "files"}
    if not isinstance(manifest, dict) or not wanted <= set(manifest):
        raise ValueError(
            f"{folder}: {MANIFEST} is not of rbsd_sym, or is damaged; choose another folder"
        )
    return manifest


def write_folder(folder: Path, texts: Mapping[str, str]) -> None:
    """Write files (name to text) into a folder, completely or not at all.

    Raises:
        ValueError: the folder cannot be written, holds another kind of export, or holds a file of
            one of these names that no export wrote.
    """
    # All files are first written into a fresh folder beside the target, on the same file system:
    # a full disk or an interrupt then leaves the target as it was, and moving is only renaming.
    try:
        _refuse_foreign(folder, texts)
        folder.parent.mkdir(parents=True, exist_ok=True)
        fresh = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
        try:
            for name, text in texts.items():
                (fresh / name).write_text(text)
            _move(fresh, folder, list(texts))
        finally:
            shutil.rmtree(fresh, ignore_errors=True)
    except OSError as error:
        raise ValueError(
            f"{folder}: cannot be written ({error.strerror}); choose a folder you may write to"
        ) from error


def _move(fresh: Path, folder: Path, names: list[str]) -> None:
    if not folder.exists():
        fresh.chmod(0o755)  # mkdtemp keeps others out
        try:
            fresh.rename(folder)
            return
        except OSError:  # another process may have created the folder in the meantime
            if not folder.is_dir():
                raise
    # The manifest, which holds the hashes of the others, is replaced last. If the process ends in
    # between, hashes and files do not fit, and `check_folder` refuses the mixture.
    for name in sorted(names, key=lambda name: name == MANIFEST):
        os.replace(fresh / name, folder / name)


def _refuse_foreign(folder: Path, texts: Mapping[str, str]) -> None:
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is a file; give the path of a folder")
    # A file is ours if the manifest beside it lists it. Files of other names are not touched.
    there = [name for name in texts if (folder / name).exists()]
    if not there:
        return
    ours = {}
    if (folder / MANIFEST).exists():
        before = read_manifest(folder)
        ours = before["files"]
        kind, now = (m.get("kind", "model") for m in (before, json.loads(texts[MANIFEST])))
        if kind != now:
            raise ValueError(f"{folder}: holds a {kind}, not a {now}; choose another folder")
    foreign = [name for name in there if name not in ours and name != MANIFEST]
    if foreign:
        raise ValueError(
            f"{folder}: holds {', '.join(foreign)}, which rbsd_sym did not write; choose another "
            "folder, or move the file away"
        )
