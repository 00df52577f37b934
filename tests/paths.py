"""Where things are in the repository."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
MODELS = ROOT / "models"
REFERENCE = TESTS / "reference"
CHARTS = ROOT / "generated" / "charts"


def stored(name: str) -> Any:
    """Multiprecision values in `reference/<name>.json`: "laws", "scenes" or "derivatives"."""
    return json.loads((REFERENCE / f"{name}.json").read_text())


def environment(*folders: Path, **more: str) -> dict[str, str]:
    """Variables for a process of its own that imports the package, helpers of tests, folders."""
    given = os.pathsep.join(str(folder) for folder in (ROOT, TESTS, *folders))
    return {**os.environ, "PYTHONPATH": given, **more}
