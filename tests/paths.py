"""Where things are in the repository."""

from __future__ import annotations

import os
from pathlib import Path

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
MODELS = ROOT / "models"
REFERENCE = TESTS / "reference"
CHARTS = ROOT / "generated" / "charts"


def environment(*folders: Path, **more: str) -> dict[str, str]:
    """Variables for a process of its own that imports the package, helpers of tests, folders."""
    given = os.pathsep.join(str(folder) for folder in (ROOT, TESTS, *folders))
    return {**os.environ, "PYTHONPATH": given, **more}
