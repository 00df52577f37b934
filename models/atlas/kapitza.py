"""Kapitza's pendulum: what stands only because it shakes.

An upright body on a free hinge falls over. Shaken up and down fast enough it stays upright, and
shaken too far it falls again, by a parametric resonance. Eigenvalues at rest show none of this:
they give the same fall, 3.81 1/s, at every point of the map. Nor does the motion itself: the
smallest model has no tilt at all, and its own multipliers decay everywhere. The multipliers of the
tilt that the model left out, over one period of the drive, give the map (`study.stability_map` with
a period). The boundary agrees with that of the damped Mathieu equation to 0.1 %, the compliance of
the hinge; the common formula, amplitude times circular frequency = sqrt(2 g l) with the reduced
length l, is drawn beside it. Simulations of the full model from a small tilt, on the right, confirm
it. Remedy: judge a driven motion by its multipliers, not by eigenvalues.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import Idas, Model, compile_scene, linearize, simulate, static_equilibrium
from rbsd_sym.analysis.floquet import floquet
from rbsd_sym.plots import stability_map as draw_map
from rbsd_sym.plots.style import COLOURS, STYLES
from rbsd_sym.study import Table
from rbsd_sym.study.stability_map import stability_map

from .pages import model_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 13
scene = model_file("kapitza").scene
# m, kg m2 about the hinge, m/s2, N m s/rad.
LENGTH, INERTIA, GRAVITY, DAMPING = 0.5, 1 / 12 + 0.25, 9.81, 0.02
# Length of the simple pendulum with the same frequency, for 1 kg, m.
REDUCED = INERTIA / LENGTH
# Tilt at the start of a simulation, rad.
_TILT = 1e-3
# Length of a simulation, s.
_SPAN = 3.0
_RUNS = ((20.0, 0.02, "too little"), (20.0, 0.1, "enough"), (20.0, 0.35, "too far"))
_HARMONICS = 12


def theory(frequency: float) -> tuple[float, float]:
    """Return the amplitudes (m) between which the body stays upright on a rigid hinge.

    J f'' + c f' + (-m g l + m l a w^2 sin(w t)) f = 0 for the tilt f. At the lower boundary it has
    a solution with the period of the drive, at the upper one with twice that period. Their Fourier
    coefficients obey (D + a B) x = 0 (Hill's determinants [McLachlan 1947, sec. 6.20]).

    Arguments:
        frequency: of the drive, Hz.
    """
    w, bounds = 2 * math.pi * frequency, []
    # Harmonics n w for the period of the drive, (n + 1/2) w for twice the period.
    for shift in (0.0, 0.5):
        n = np.arange(-_HARMONICS, _HARMONICS + (shift == 0)) + shift
        # sin(w t) couples neighbouring harmonics with 1 / 2i.
        D = np.diag(-INERTIA * (n * w) ** 2 + 1j * n * w * DAMPING - GRAVITY * LENGTH)
        B = LENGTH * w * w / 2j * (np.eye(len(n), k=-1) - np.eye(len(n), k=1))
        # 1 / a is an eigenvalue of -D^-1 B, also where B is singular; the largest real one belongs
        # to the smallest amplitude.
        inverse = np.linalg.eigvals(-np.linalg.solve(D, B))
        real = inverse[np.abs(inverse.imag) < 1e-9 * np.abs(inverse).max()].real
        bounds.append(1 / float(real.max()))
    return bounds[0], bounds[1]


def study(full: bool) -> dict[str, Table]:
    """Measure the map, its boundary against theory, and simulations at three points."""
    model = compile_scene(scene())
    frequencies = np.linspace(4, 30, 24) if full else np.linspace(6, 30, 4)
    amplitudes = np.linspace(0.01, 0.4, 22) if full else np.linspace(0.02, 0.4, 4)
    found = stability_map(
        model,
        {"frequency": list(frequencies)},
        {"amplitude": list(amplitudes)},
        period=lambda point: 1 / point["frequency"],
    )
    runs, tilt = _simulated(model)
    return {
        "map": found,
        "boundary": _boundary(model, (6, 10, 15, 20, 30) if full else (20,)),
        "theory": _theory(np.linspace(4, 30, 105 if full else 27)),
        "runs": runs,
        "tilt": tilt,
    }


def _theory(frequencies: np.ndarray) -> Table:
    rows = [
        (float(f), *theory(float(f)), math.sqrt(2 * GRAVITY * REDUCED) / (2 * math.pi * float(f)))
        for f in frequencies
    ]
    return Table(("frequency", "lower", "upper", "formula"), ("Hz", "m", "m", "m"), tuple(rows))


def _boundary(model: Model, frequencies: tuple[float, ...]) -> Table:
    """Return the boundary by root finding on the multipliers, and by theory."""
    rows = []
    for f in frequencies:

        def rate(amplitude: float, f: float = f) -> float:
            at = {"amplitude": amplitude, "frequency": f}
            return floquet(model, 1 / f, params=at, accuracy=1e-4).abscissa

        low, high = theory(f)
        found = [_root(rate, 0.995 * bound, 1.005 * bound) for bound in (low, high)]
        rows.append((float(f), found[0], low, found[1], high))
    names = ("frequency", "lower", "lower_theory", "upper", "upper_theory")
    return Table(names, ("Hz", *["m"] * 4), tuple(rows))


def _root(rate: Callable[[float], float], low: float, high: float) -> float:
    """Return where a rate changes sign, by the Illinois method (regula falsi)."""
    at_low, at_high = rate(low), rate(high)
    while True:
        middle = (low * at_high - high * at_low) / (at_high - at_low)
        value = rate(middle)
        if abs(value) < 1e-3 or abs(high - low) < 1e-5 * high:
            return middle
        if value * at_high < 0:
            low, at_low = high, at_high
        else:
            # Illinois: halve the value at the end that stays, or the method would converge from one
            # side only.
            at_low /= 2
        high, at_high = middle, value


def _simulated(small: Model) -> tuple[Table, Table]:
    """Return runs of the full model from a small tilt on the periodic motion, and the tilts."""
    model, rows, columns = compile_scene(scene(), minimal=False), [], []
    t = np.linspace(0, _SPAN, 301)
    for frequency, amplitude, _ in _RUNS:
        params = {"frequency": frequency, "amplitude": amplitude}
        motion = floquet(small, 1 / frequency, params=params)
        rest = linearize(small, static_equilibrium(small, params=params).point)
        # The run starts on the periodic motion of the upright body, tilted a little.
        z, v = motion.start["body.p_z"], motion.start["body.v_z"]
        start = {
            "body.q_w": math.cos(_TILT / 2),
            "body.q_x": math.sin(_TILT / 2),
            "body.v_z": v,
            "body.p_y": -LENGTH * math.sin(_TILT),
            "body.p_z": z - LENGTH * (1 - math.cos(_TILT)),
        }
        run = simulate(model, t, Idas(), params=params, start=start)
        upright = run["body.rotation_matrix"][:, 2, :2]
        tilt = np.arcsin(np.clip(np.linalg.norm(upright, axis=1), 0, 1))
        tilt = np.where(run["body.rotation_matrix"][:, 2, 2] < 0, np.pi - tilt, tilt)
        columns.append(np.degrees(tilt))
        own = float(motion.kept.exponents(1 / frequency).max())
        rows.append(
            (
                frequency,
                amplitude,
                rest.abscissa,
                own,
                motion.abscissa,
                motion.multiplier,
                _rate(t, tilt),
                float(columns[-1].max()),
            )
        )
    names = (
        "frequency",
        "amplitude",
        "at_rest",
        "own_motion",
        "left_out",
        "multiplier",
        "simulated",
        "largest_tilt",
    )
    units = ("Hz", "m", "1/s", "1/s", "1/s", "", "1/s", "deg")
    labels = ("t", *(f"tilt_{i}" for i in range(len(_RUNS))))
    series = tuple(zip(t.tolist(), *(c.tolist() for c in columns), strict=True))
    return Table(names, units, tuple(rows)), Table(labels, ("s", *["deg"] * len(_RUNS)), series)


def _rate(t: np.ndarray, tilt: np.ndarray) -> float:
    """Return the growth rate of the tilt while it is small, from its mean square early and late."""
    large = np.flatnonzero(tilt > 0.1)
    n = int(large[0]) if large.size else len(t)
    first, last = tilt[n // 2 - n // 4 : n // 2], tilt[n - n // 4 : n]
    gap = float(t[n - n // 4] - t[n // 2 - n // 4])
    return math.log(float(np.sqrt((last**2).mean() / (first**2).mean()))) / gap


def draw(tables: Tables) -> Figure:
    """Draw the map with the theory over it, and the tilt over time at three points."""
    figure = draw_map(tables["map"])
    figure.set_size_inches(11.0, 5.0)
    left: Any = figure.axes[0]
    size = left.get_xlim(), left.get_ylim()
    curves = tables["theory"]
    for name, colour, style, label in (
        ("lower", "#E69F00", "--", "Mathieu equation"),
        ("upper", "#E69F00", "--", None),
        ("formula", "#009E73", ":", "sqrt(2 g l) / w"),
    ):
        left.plot(
            curves.column("frequency"), curves.column(name), style, color=colour, lw=2, label=label
        )
    left.set(xlim=size[0], ylim=size[1], title="growth of a tilt over a period of the drive")
    for legend in figure.legends:
        legend.remove()
    left.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, frameon=False, fontsize="small"
    )
    _draw_runs(figure, left, tables)
    return figure


def _draw_runs(figure: Any, left: Any, tables: Tables) -> None:
    grid = left.get_gridspec()
    wide = type(grid)(1, 2, figure=figure, width_ratios=(1.3, 1))
    left.set_subplotspec(wide[0])
    right = figure.add_subplot(wide[1])
    tilt = tables["tilt"]
    for i, (frequency, amplitude, what) in enumerate(_RUNS):
        colour, style = COLOURS[(3, 1, 4)[i]], STYLES[i]
        t, angle = tilt.column("t"), tilt.column(f"tilt_{i}")
        fallen = np.flatnonzero(angle > 90)
        until = int(fallen[0]) if fallen.size else len(t)
        right.plot(
            t[:until], angle[:until], style, color=colour, lw=1.2, label=f"{amplitude:g} m: {what}"
        )
        left.plot(frequency, amplitude, "o^s"[i], color=colour, mec="white", ms=9)
    right.set(
        yscale="log",
        xlabel="time [s]",
        ylabel="tilt [deg]",
        ylim=(1e-3, 200),
        title=f"simulated at {_RUNS[0][0]:g} Hz from 0.06 deg",
    )
    right.grid(alpha=0.3)
    right.legend(
        loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3, frameon=False, fontsize="small"
    )
