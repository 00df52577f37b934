"""A massless body against small masses: the error of its neighbour, as numbers and as a chart.

`python tests/charts/massless.py` writes generated/charts/massless.png.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from paths import CHARTS
from scenes.massless import DAMPED, UNDAMPED, linked, start_of

import rbsd_sym as rs

MASSES = np.logspace(-5, -2, 7)
T_END = 0.2
_TIMES = np.linspace(0.0, T_END, 21)
_REFERENCE = rs.Idas(1e-10, 1e-12)
# Errors of 1e-7 m are wanted: 1e-9 m is enough, and the fast motion of 1e-5 kg costs steps.
_INTEGRATOR = rs.Idas(1e-8, 1e-10)

# Okabe and Ito's colours: told apart by readers with any colour vision, and by their markers.
_SERIES = (
    (UNDAMPED, "#0072B2", "o", "springs without damping (massless link: algebraic)"),
    (DAMPED, "#D55E00", "s", "springs with damping (massless link: first order)"),
)
_EXPLANATION = (
    "Ground, spring, link, spring, body of 1 kg that moves by 7 cm in 0.2 s:\n"
    "the body's path beside a link with mass, against its path beside a massless one"
)


def errors(damping: float, masses: Sequence[float] | np.ndarray) -> np.ndarray:
    """Largest distance (m) of the body's path from that beside a massless link, for each mass.

    The link starts where the massless one is, so that it is in balance: its fast motion is then as
    small as its mass.
    """
    limit = rs.simulate(rs.compile_scene(linked(0.0, damping)), _TIMES, _REFERENCE)
    found = []
    for mass in masses:
        full = rs.compile_scene(linked(mass, damping, start_of(limit, "link")), minimal=False)
        path = rs.simulate(full, _TIMES, _INTEGRATOR)["body.position"]
        found.append(np.linalg.norm(path - limit["body.position"], axis=1).max())
    return np.array(found)


def slope(masses: Sequence[float] | np.ndarray, values: np.ndarray) -> float:
    """Exponent of the power law fitted to errors over masses."""
    return float(np.polyfit(np.log(masses), np.log(values), 1)[0])


def draw(path: str | Path, masses: Sequence[float] | np.ndarray = MASSES) -> Path:
    """Write the chart; its folder is made if needed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.6, 5.8), layout="constrained")
    panel, masses = figure.subplots(), np.array(masses, float)
    lowest, highest = np.inf, 0.0
    for damping, colour, marker, label in _SERIES:
        values = errors(damping, masses)
        lowest, highest = min(lowest, values.min()), max(highest, values.max())
        panel.loglog(
            masses, values, marker + "-", color=colour, ms=7, lw=1.5,
            label=f"{label}, fitted slope {slope(masses, values):.3f}",
        )  # fmt: skip
    # Apart from the data, which would hide it.
    reference = lowest / 3 * masses / masses[0]
    panel.loglog(masses, reference, "--", color="0.35", lw=1.5, label="for comparison: slope 1")
    panel.set_ylim(top=20 * highest)  # room for the legend
    panel.set_xlabel("mass of the link [kg]; its inertia has the same number [kg m²]", fontsize=12)
    panel.set_ylabel("largest distance between the two paths [m]", fontsize=12)
    figure.suptitle("A massless link is the limit of a light one", x=0.095, ha="left", fontsize=15)
    panel.set_title(_EXPLANATION, loc="left", fontsize=11)
    panel.grid(alpha=0.3)
    panel.tick_params(labelsize=11)
    panel.legend(fontsize=11, loc="upper left")
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=150)
    return target


if __name__ == "__main__":
    print(draw(CHARTS / "massless.png"))
