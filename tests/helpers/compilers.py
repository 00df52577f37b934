"""C compilers of this machine, what they are told, and the files they are given."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
C99 = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]


def built(folder: Path, *command: str) -> list[str]:
    """Lines that the program prints which a command builds."""
    subprocess.run([*command, "-lm", "-o", "program"], cwd=folder, check=True)
    run = subprocess.run(["./program"], cwd=folder, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return run.stdout.splitlines()


def files_of(folder: Path) -> dict[str, bytes]:
    """Bytes of every file below a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
