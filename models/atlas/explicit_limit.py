"""Explicit methods on stiff connectors: where a step is too long.

A mode of frequency w that is not resolved grows with every explicit step, however slow the motion
of interest is. `RK4` amplifies it from h w = 2.828 on without damping, at every stiffness; damping
above critical makes it worse, since the limit falls as 1 over the damping ratio. The pair of order
5(4) of `ExplicitRK`, here with fixed steps, amplifies an undamped mode from h w = 0.729 on: by 9 %
in 1000 steps at 1, by a factor of 184 at 1.6; its error control has to detect that. Two percent of
damping raise its limit to 2.1. Remedy: steps below the limit of the stiffest connector, or an
implicit method (`Rosenbrock`, `Idas`, `GeneralizedAlpha`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import RK4, ExplicitRK
from rbsd_sym.study import Table

from .oscillators import amplitude, factor, legend_below, style_of, swing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 5
# Steps before the first measurement of the amplitude, and again before the second.
_STEPS = 300
# Relative excess of a step, so that a whole number of them fits into an interval.
_ROUNDING = 1e-9
# Steps over which the chart shows the growth.
_RUN = 1000
_RATIOS = (0.0, 0.1, 0.5, 2.0)
_MORE_RATIOS = (0.02, 0.05, 0.2, 0.3, 0.4, 0.6, 0.7, 0.8, 0.9, 0.95)
# Stiffness (N/m) at which the boundary is measured for more damping ratios.
_STIFF = 1e6
_METHODS = ("RK4", "ExplicitRK")


def study(full: bool) -> dict[str, Table]:
    """Measure and predict limits of h w over stiffness and damping, and growth without damping."""
    coefficients = {method: _polynomial(method) for method in _METHODS}
    points = [(float(k), ratio) for ratio in _RATIOS for k in np.logspace(2, 12, 11 if full else 3)]
    points += [(_STIFF, ratio) for ratio in (_MORE_RATIOS if full else _MORE_RATIOS[::3])]
    rows = []
    for method in _METHODS:
        predicted = {ratio: limit(coefficients[method], ratio) for _, ratio in points}
        rows += [
            (method, k, ratio, _measured(method, k, ratio), predicted[ratio]) for k, ratio in points
        ]
    growth = [
        (method, float(h), abs(factor(_fixed(method, float(h)), float(h))))
        for method in _METHODS
        for h in np.linspace(0.1, 3.6, 36 if full else 8)
    ]
    return {
        "boundary": Table(
            ("method", "stiffness", "damping_ratio", "measured_h_w", "predicted_h_w"),
            ("", "N/m", "", "", ""),
            tuple(rows),
        ),
        "undamped": Table(("method", "h_w", "factor_per_step"), ("", "", ""), tuple(growth)),
        "polynomial": Table(
            ("method", *(f"z{i}" for i in range(7))),
            ("",) * 8,
            tuple((method, *coefficients[method]) for method in _METHODS),
        ),
    }


def _fixed(method: str, h: float) -> Any:
    if method == "RK4":
        return RK4(h * (1 + _ROUNDING))
    return ExplicitRK(options={"step_size": h * (1 + _ROUNDING)})


def _polynomial(method: str) -> tuple[float, ...]:
    """Return the coefficients, up to z^6, of the factor by which a step multiplies a mode.

    Those up to the order are known; the last one of the pair, which has order 5 and six effective
    stages, is measured in one step.
    """
    order = {"RK4": 4, "ExplicitRK": 5}[method]
    known = [1 / math.factorial(i) for i in range(order + 1)]
    if method == "ExplicitRK":
        # One step with z = i multiplies by the sum of c_k i^k; subtracting the known terms leaves
        # the last.
        rest = factor(_fixed(method, 1.0), 1.0) - sum(c * 1j**i for i, c in enumerate(known))
        known.append((rest / 1j**6).real)
    return (*known, *[0.0] * (7 - len(known)))


def _eigenvalue(ratio: float) -> complex:
    """Return the eigenvalue of x'' + 2 ratio x' + x = 0, the faster one if both are real."""
    root = math.sqrt(abs(1 - ratio**2))
    return complex(-ratio, root) if ratio < 1 else complex(-ratio - root)


def limit(coefficients: Sequence[float], ratio: float) -> float:
    """Return the h w from which on a step multiplies a mode of given damping ratio by more than 1.

    Arguments:
        coefficients: of the stability polynomial, lowest power first.
        ratio: damping ratio.
    """
    eigenvalue = _eigenvalue(ratio)

    def grows(h: float) -> bool:
        return abs(sum(c * (h * eigenvalue) ** i for i, c in enumerate(coefficients))) > 1 + 1e-12

    low = 0.1
    while not grows(low + 0.01):
        low += 0.01
    return _bisect(grows, low, low + 0.01, 1e-9)


def _bisect(grows: Any, low: float, high: float, width: float) -> float:
    while high / low > 1 + width:
        # Geometric mean: the width of the bracket is relative.
        middle = math.sqrt(low * high)
        low, high = (low, middle) if grows(middle) else (middle, high)
    return math.sqrt(low * high)


def _measured(method: str, k: float, ratio: float) -> float:
    """Return the h w from which on the amplitude of a simulation grows, by bisection."""
    w = math.sqrt(k)

    def grows(h_w: float) -> bool:
        h = h_w / w
        # Starting transients are over after the first measurement.
        times = h * np.array([0, _STEPS, 2 * _STEPS])
        run = swing(_fixed(method, h), times, k, 2 * ratio * w)
        size = amplitude(run, k)
        return len(size) < 3 or not size[2] <= size[1]

    return _bisect(grows, 0.2, 4.0, 2e-3)


def draw(tables: Tables) -> Figure:
    """Draw the stability regions with measurements, the limits over stiffness, and the growth."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 4.6), layout="constrained")
    region, over_stiffness, growth = figure.subplots(1, 3)
    _draw_regions(region, tables)
    _draw_limits(over_stiffness, tables["boundary"])
    for method in _METHODS:
        table = tables["undamped"]
        mine = table.column("method") == method
        gain = np.exp(np.clip(_RUN * np.log(table.column("factor_per_step")[mine]), -20, 20))
        growth.plot(table.column("h_w")[mine], gain, **style_of(method, ms=3), label=method)
    growth.axhline(1, color="0.4", lw=0.8)
    growth.set(
        xlabel="step × frequency, h w",
        ylabel=f"amplitude after {_RUN} steps / at the start",
        yscale="log",
        ylim=(1e-4, 1e4),
        title="no damping",
    )
    for panel in (region, over_stiffness, growth):
        panel.grid(alpha=0.3)
        legend_below(panel)
    return figure


def _draw_regions(panel: Any, tables: Tables) -> None:
    re, im = np.meshgrid(np.linspace(-4.0, 0.4, 400), np.linspace(0, 4.2, 320))
    polynomials, points = tables["polynomial"], tables["boundary"]
    for method, *coefficients in polynomials.rows:
        own = style_of(str(method), ls="")
        size = np.abs(np.polyval([float(c) for c in coefficients[::-1]], re + 1j * im))  # type: ignore[arg-type]
        panel.contour(re, im, size, levels=[1.0], colors=[own["color"]], linewidths=1.2)
        mine = (points.column("method") == method) & (points.column("stiffness") == _STIFF)
        z = np.array(
            [
                h * _eigenvalue(ratio)
                for h, ratio in zip(
                    points.column("measured_h_w")[mine],
                    points.column("damping_ratio")[mine],
                    strict=True,
                )
            ]
        )
        panel.plot(z.real, z.imag, **own, label=f"{method}: measured")
    panel.axvline(0, color="0.4", lw=0.8)
    panel.set(
        xlabel="h × real part of the eigenvalue",
        ylabel="h × imaginary part",
        aspect="equal",
        title="lines: |stability polynomial| = 1",
    )


def _draw_limits(panel: Any, table: Table) -> None:
    styles = {0.0: "-", 0.1: "--", 0.5: "-.", 2.0: ":"}
    for method in _METHODS:
        for ratio, style in styles.items():
            mine = (table.column("method") == method) & (table.column("damping_ratio") == ratio)
            k = table.column("stiffness")[mine]
            h = table.column("measured_h_w")[mine]
            panel.plot(
                k, h, **style_of(method, ls=style, ms=3), label=f"{method}, damping {ratio:g}"
            )
    panel.set(
        xscale="log",
        xlabel="stiffness [N/m]",
        ylabel="longest stable step × frequency, h w",
        ylim=(0, None),
        title="measured, 1 kg",
    )
