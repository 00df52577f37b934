"""A massless body against small masses: the error of its neighbour, as numbers and as a chart.

`python tests/massless_chart.py` writes generated/charts/massless.png.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[1]
if str(ROOT) not in sys.path:  # run as a script, from a checkout that is not installed
    sys.path.append(str(ROOT))

import rbsd_sym as rs

MASSES = np.logspace(-5, -2, 7)
T_END = 0.2
UNDAMPED, DAMPED = 0.0, 0.02  # s: damping matrix over stiffness matrix
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


def scene(mass: float, damping: float, start: Mapping[str, Any] | None = None) -> rs.Scene:
    """Ground - spring - link - spring - body (1 kg); the link has `mass` and that inertia."""
    K = np.array([1000, 1200, 1500, 200, 300, 400], float)
    inertia = (mass, mass, mass) if mass else 0
    link = rs.RigidBody("link", mass, inertia, **(start or {"position": (1, 0, 0)}))
    body = rs.RigidBody(
        "body", 1.0, (0.1, 0.2, 0.3), position=(2, 0.1, 0), velocity=(0, 0.5, 0.3)
    )
    markers = (
        ("inner", rs.Marker(rs.GROUND), rs.Marker("link", (-1, 0, 0))),
        ("outer", rs.Marker("link"), rs.Marker("body", (-1, 0, 0))),
    )
    springs = [
        rs.RigidBodySpringDamper(name, one, other, K, damping * K, law=rs.Consistent())
        for name, one, other in markers
    ]
    return rs.Scene("link", [link, body], springs, gravity=(0.3, -1, 0.5))


def start_of(trajectory: rs.Trajectory, body: str) -> dict[str, Any]:
    """Pose and velocities of a body at the first point, as RigidBody takes them."""
    q = trajectory[f"{body}.quaternion"][0]
    start = {
        name: trajectory[f"{body}.{name}"][0]
        for name in ("position", "velocity", "angular_velocity")
    }
    return start | {"rotation": q / np.linalg.norm(q)}


def errors(damping: float, masses: Sequence[float] | np.ndarray) -> np.ndarray:
    """Largest distance (m) of the body's path from that beside a massless link, for each mass.

    The link starts where the massless one is, so that it is in balance: its fast motion is then as
    small as its mass.
    """
    limit = rs.simulate(rs.compile_scene(scene(0.0, damping)), _TIMES, _REFERENCE)
    found = []
    for mass in masses:
        full = rs.compile_scene(scene(mass, damping, start_of(limit, "link")), minimal=False)
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
    print(draw(ROOT / "generated" / "charts" / "massless.png"))
