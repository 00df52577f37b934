"""A film of every model.

`python tests/charts/gallery.py [NAME ...]` writes generated/gallery/<name>.gif. Of a model with a
`problem()` the film shows the plan, of the others the motion that `run` gives.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import ModuleType

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from paths import MODELS, ROOT

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file

FOLDER = ROOT / "generated" / "gallery"
LONGEST = 4.0  # s
DPI, FPS = 60, 12


def motion(file: ModuleType) -> tuple[rs.Model, rs.Trajectory]:
    """The model and what it does."""
    if hasattr(file, "problem"):
        guess = getattr(file, "GUESS", None)
        solution = rs.ocp.optimise(file.problem(), getattr(file, "METHOD", None), guess)
        return solution.model, solution.trajectory
    model = rs.compile_scene(file.scene())
    t_end = getattr(file, "T_END", 1.0)
    return model, rs.simulate(model, t_end, inputs=getattr(file, "INPUTS", {}))


def main(names: list[str]) -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for path in sorted(MODELS.glob("*.py")):
        if names and path.stem not in names:
            continue
        started = time.perf_counter()
        model, trajectory = motion(load_model_file(path))
        length = min(LONGEST, max(1.0, float(trajectory.t[-1] - trajectory.t[0])))
        film = rs.plots.animate(
            model, trajectory, FOLDER / f"{path.stem}.gif", fps=FPS, duration=length, dpi=DPI
        )
        took = time.perf_counter() - started
        print(f"{film.name}: {film.stat().st_size // 1024} kB, {took:.1f} s")


if __name__ == "__main__":
    main(sys.argv[1:])
