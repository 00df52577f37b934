"""Implicit methods: what they do to a mode that should ring.

An undamped mode of frequency w changes in amplitude and phase with every implicit step of length h.
Generalized-alpha below spectral radius 1, Radau and BDF of order 2 damp it, BDF of order 5
amplifies it between h w = 0.71 and 9.4; the trapezoidal rule and Legendre collocation keep its
amplitude at every step length, and only its phase is wrong. `Idas` damps it according to its
tolerance: over 100 periods by 0.9 % at rtol 1e-3, 1e-4 of it at 1e-6, 5e-7 at the default of 1e-8;
if IDAS receives the tolerances unchanged (`safety` of 1.4 for these two states), by 17 %, 1e-4 and
7e-6. Remedy: Legendre collocation or spectral radius 1 where a mode must ring; Radau or radius 0.5
where it must not; and with `Idas` the tolerance that the chart shows.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import Collocation, Dop853, ExplicitRK, GeneralizedAlpha, Idas, Rosenbrock
from rbsd_sym.study import Table

from .oscillators import amplitude, factor, legend_below, oscillator, style_of, swing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 6
_RADII = (1.0, 0.9, 0.5, 0.0)
_BDF = (2, 5)
# Tolerance below which order 2 takes a million steps.
_FINEST = 1e-7
_LINES = ("-", "--", "-.", ":")
_FORMULAS: dict[str, dict[str, Any]] = {
    **{
        f"generalized-alpha, radius {rho:g}" + (" (trapezoidal)" if rho == 1 else ""): style_of(
            "GeneralizedAlpha", ls=line, marker=""
        )
        for rho, line in zip(_RADII, _LINES, strict=True)
    },
    "Radau, order 5": style_of("Collocation", ls="-", marker=""),
    "Legendre, order 6": style_of("Collocation", ls="--", marker=""),
    **{
        f"BDF, order {order}": style_of("Idas", ls=line, marker="")
        for order, line in zip(_BDF, _LINES, strict=False)
    },
}
_ADAPTIVE: dict[str, dict[str, Any]] = {
    "Idas, order up to 5": style_of("Idas", ls="--"),
    "Idas, order up to 2": style_of("Idas", ls="-"),
    "Idas, order up to 5, safety 1.4": style_of("Idas", ls=":"),
    "Rosenbrock": style_of("Rosenbrock"),
    "ExplicitRK": style_of("ExplicitRK"),
    "Dop853": style_of("Dop853"),
}


def study(full: bool) -> dict[str, Table]:
    """Measure the factor of one step over h w, and amplitude after many periods over tolerance."""
    rows = []
    for h in np.logspace(-2, 3, 26 if full else 11):
        for name, roots in _roots(float(h)).items():
            size = float(np.abs(roots).max())
            angle = float(np.angle(roots[np.argmin(np.abs(roots - np.exp(1j * h)))]))
            rows.append((name, float(h), size, angle / float(h) - 1))
    periods = 100 if full else 10
    kept = []
    for rtol in np.logspace(-3, -12, 10) if full else (1e-4, 1e-8, 1e-11):
        for name, method in _adaptive(float(rtol)).items():
            if name == "Idas, order up to 2" and rtol < _FINEST:
                continue
            run = swing(method, 2 * math.pi * np.arange(periods + 1))
            gain = float(amplitude(run)[-1]) - 1 if run.outcome.ok else None
            kept.append((name, float(rtol), periods, gain, run.stats["steps"] / periods))  # type: ignore[operator]
    return {
        "one_step": Table(
            ("method", "h_w", "amplitude_kept", "phase_error"), ("", "", "", ""), tuple(rows)
        ),
        "many_periods": Table(
            ("method", "rtol", "periods", "amplitude_gained", "steps_per_period"),
            ("",) * 5,
            tuple(kept),
        ),
    }


def _adaptive(rtol: float) -> dict[str, Any]:
    atol = rtol * 1e-2
    return {
        "Idas, order up to 5": Idas(rtol, atol),
        "Idas, order up to 2": Idas(rtol, atol, max_order=2),
        "Idas, order up to 5, safety 1.4": Idas(rtol, atol, safety=math.sqrt(2)),
        "Rosenbrock": Rosenbrock(rtol, atol),
        "ExplicitRK": ExplicitRK(rtol, atol),
        "Dop853": Dop853(rtol, atol),
    }


def _roots(h: float) -> dict[str, np.ndarray]:
    """Return the factors by which one step of each method multiplies an oscillation of 1 rad/s."""
    alphas = [_alpha_roots(rho, h) for rho in _RADII]
    schemes = [np.array([factor(Collocation(h, 3, s), h)]) for s in ("radau", "legendre")]
    return dict(zip(_FORMULAS, [*alphas, *schemes, *(bdf_roots(k, h) for k in _BDF)], strict=True))


def _alpha_roots(rho: float, h: float) -> np.ndarray:
    """Return the eigenvalues of one step on position, velocity and the method's acceleration.

    The three are scaled to order 1: h v and h^2 a are as large as the position times max(h, 1)^2.
    """
    model = oscillator()
    step, columns = GeneralizedAlpha(h, rho).step_function(model), []
    p = [label.start for label in model.dae.p_labels]
    units = np.array([1.0, max(h, 1.0) / h, max(h, 1.0) ** 2 / h**2])
    for x, v, a in np.diag(units):
        new = step(0, h, [x, v], [0, -x], [0, a], [], [], p)
        columns.append(np.array([float(new[0][0]), float(new[0][1]), float(new[2][1])]) / units)
    return np.linalg.eigvals(np.array(columns).T).astype(complex)


def bdf_roots(order: int, h: float) -> np.ndarray:
    """Return the roots r of sum over j = 1 ... order of (1 - 1/r)^j / j = i h.

    They are the factors by which BDF multiplies an oscillation in one step [Hairer, Wanner 1996,
    V.1].

    Arguments:
        order: 1 ... 5.
        h: step times frequency.
    """
    # Coefficients in 1/r, lowest power first.
    polynomial = np.zeros(order + 1, complex)
    power = np.array([1.0])
    for j in range(1, order + 1):
        power = np.convolve(power, [1.0, -1.0])
        polynomial[: j + 1] += power / j
    polynomial[0] -= 1j * h
    return 1 / np.roots(polynomial[::-1])


def draw(tables: Tables) -> Figure:
    """Draw amplitude and phase of one step, and amplitude after many periods."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 8.6), layout="constrained")
    (kept, phase), (tolerance, steps) = figure.subplots(2, 2)
    table = tables["one_step"]
    for name, style in _FORMULAS.items():
        mine = table.column("method") == name
        h, size = table.column("h_w")[mine], table.column("amplitude_kept")[mine]
        kept.plot(h, size, **style, label=name)
        error = np.abs(table.column("phase_error")[mine])
        seen = (h < math.pi) & (error > 1e-15)
        phase.plot(h[seen], error[seen], **style)
    kept.set(
        xscale="log",
        ylim=(-0.05, 1.5),
        xlabel="step × frequency, h w",
        ylabel="amplitude kept in one step",
    )
    phase.set(
        xscale="log",
        yscale="log",
        ylim=(1e-14, 1),
        xlabel="step × frequency, h w",
        ylabel="|phase error| of one step, relative",
    )
    _draw_periods(tolerance, steps, tables["many_periods"])
    for panel in (kept, phase, tolerance, steps):
        panel.grid(alpha=0.3)
    legend_below(kept)
    legend_below(tolerance)
    return figure


def _draw_periods(tolerance: Any, steps: Any, table: Table) -> None:
    periods = int(table.column("periods")[0])
    for name, style in _ADAPTIVE.items():
        mine = table.column("method") == name
        gain = table.column("amplitude_gained")[mine]
        size = np.maximum(np.abs(gain), 1e-15)
        tolerance.plot(table.column("rtol")[mine], size, **style, label=name)
        steps.plot(table.column("steps_per_period")[mine], size, **style)
        for panel, column in ((tolerance, "rtol"), (steps, "steps_per_period")):
            grows = gain > 0
            panel.plot(
                table.column(column)[mine][grows],
                size[grows],
                "o",
                ms=10,
                mfc="none",
                color=style["color"],
            )
    label = f"|change of amplitude| in {periods} periods"
    tolerance.plot([], [], "o", ms=10, mfc="none", color="0.4", label="amplitude grows")
    tolerance.set(xscale="log", yscale="log", xlabel="rtol", ylabel=label)
    tolerance.invert_xaxis()
    steps.set(xscale="log", yscale="log", xlabel="steps in a period", ylabel=label)
