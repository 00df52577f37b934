"""Writing a folder of generated files: whole or not at all, and never over a foreign file."""

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
    """What an export wrote: the folder, the model's name and digest, the functions in it."""

    folder: Path
    name: str
    digest: str
    functions: tuple[str, ...]


def template(file: str, marks: Mapping[str, Any]) -> str:
    """The text of a template with its marks replaced."""
    text = resources.files(__package__).joinpath(f"{file}.in").read_text()
    return re.sub(r"@(\w+)@", lambda match: str(marks[match[1]]), text)


def sha256(text: str) -> str:
    """Hash of a file's text, as it stands in the manifest."""
    return hashlib.sha256(text.encode()).hexdigest()


def read_manifest(folder: Path) -> dict:
    """The manifest of a generated folder.

    Raises:
        ValueError: there is none, or it is damaged.
    """
    try:
        manifest = json.loads((folder / MANIFEST).read_text())
    except (OSError, ValueError) as error:
        raise ValueError(
            f"{folder}: no readable {MANIFEST} ({error}); export the model there again"
        ) from error
    wanted = {"rbsd_sym", "abi", "name", "digest", "functions", "files"}
    if not isinstance(manifest, dict) or not wanted <= set(manifest):
        raise ValueError(f"{folder}: {MANIFEST} is not of rbsd_sym; choose another folder")
    return manifest


def write_folder(folder: Path, texts: Mapping[str, str]) -> None:
    """Write the files and put them in place together, the manifest last.

    Raises:
        ValueError: the folder cannot be written, or holds a file of that name that is not ours.
    """
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
        fresh.chmod(0o755)
        try:
            fresh.rename(folder)
            return
        except OSError:  # another process was faster: its folder is there now
            if not folder.is_dir():
                raise
    for name in sorted(names, key=lambda name: name == MANIFEST):
        os.replace(fresh / name, folder / name)


def _refuse_foreign(folder: Path, texts: Mapping[str, str]) -> None:
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"{folder}: is a file; give a folder")
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
