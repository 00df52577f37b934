"""Long runs: which methods keep energy, momentum and the length of a quaternion.

An undamped oscillator over 1e5 periods, and a free body that tumbles about its intermediate axis,
whose exact motion is known by elliptic functions. `RK4`, Radau and the adaptive methods lose or
gain a little with every step, so that the error grows with time: `RK4` with 30 steps per period has
lost 97 % of the energy after 1e5 of them. The trapezoidal rule (`GeneralizedAlpha` of spectral
radius 1) keeps it to rounding, and Legendre collocation to 1.5e-15 per step. For the tumbling body
Legendre keeps energy and the length of the quaternion, both of which are quadratic;
`GeneralizedAlpha` keeps the length, because it advances the body by rotations. What remains
constant says little about the motion: `GeneralizedAlpha`, of order 2, is off by 1e-4 rad/s after
one period and completely after 1000. Remedy: Legendre collocation with three stages, or `Dop853`
with a tight tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from rbsd_sym import (
    RK4,
    Collocation,
    Dop853,
    ExplicitRK,
    GeneralizedAlpha,
    Idas,
    Model,
    RigidBody,
    Rosenbrock,
    Scene,
    compile_scene,
    simulate,
)
from rbsd_sym.study import Table

from .oscillators import amplitude, style_of, swing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 7
# Spin about the other two axes, rad/s.
OFFSET = 0.01
_INERTIA = (1.0, 2.0, 3.0)
# Steps: practically no limit.
_MANY = 1_000_000_000
_ENDURING = ("GeneralizedAlpha, radius 1", "Legendre, order 6", "RK4")
# Periods of the oscillator for the other methods, whose errors continue as they began.
_OTHERS = 10_000
# The smallest error that the charts show.
_ROUNDING = 1e-16
_STYLES: dict[str, dict[str, Any]] = {
    "Idas": style_of("Idas"),
    "Rosenbrock": style_of("Rosenbrock"),
    "ExplicitRK": style_of("ExplicitRK"),
    "Dop853": style_of("Dop853"),
    "GeneralizedAlpha, radius 1": style_of("GeneralizedAlpha"),
    "GeneralizedAlpha, radius 0.9": style_of("GeneralizedAlpha", ls="--"),
    "Legendre, order 6": style_of("Collocation", ls="--"),
    "Radau, order 5": style_of("Collocation"),
    "RK4": style_of("RK4"),
}


def half_period(inertia: Sequence[float], w: Sequence[float]) -> float:
    """Return the time (s) after which a free body's w_x and w_y have changed sign.

    It is 2 K(k) / rate, for I_x < I_y < I_z and H^2 > 2 T I_y [Landau, Lifshitz, Mechanics, sec.
    37], with K(k) from the arithmetic-geometric mean of 1 and sqrt(1 - k^2).

    Arguments:
        inertia: principal inertias, kg m2.
        w: angular velocity in body axes, rad/s.
    """
    A, B, C = inertia
    # H^2 - 2 T I, summed so that the spin about the axis of I drops out without cancellation.
    lead, slack = (
        sum(i * (i - one) * s * s for i, s in zip(inertia, w, strict=True)) for one in (A, B)
    )
    a, b = 1.0, math.sqrt((C - A) * slack / ((C - B) * lead))
    for _ in range(40):
        a, b = (a + b) / 2, math.sqrt(a * b)
    return math.pi / a / math.sqrt((C - B) * lead / (A * B * C))


@cache
def tumbling() -> Model:
    """Return a free body that spins at 1 rad/s about its intermediate axis, slightly disturbed."""
    body = RigidBody("body", 1, _INERTIA, angular_velocity=(OFFSET, 1, OFFSET))
    return compile_scene(Scene("tumbling", [body], []))


def methods(period: float) -> dict[str, Any]:
    """Return the methods; fixed steps are a 30th of a period, with three stages a 10th."""
    short, long = period / 30, period / 10
    return {
        "Idas": Idas(1e-8, 1e-10, max_steps=_MANY),
        "Rosenbrock": Rosenbrock(1e-8, 1e-10, max_steps=_MANY),
        "ExplicitRK": ExplicitRK(1e-8, 1e-10, max_steps=_MANY),
        "Dop853": Dop853(1e-8, 1e-10, max_steps=_MANY),
        "GeneralizedAlpha, radius 1": GeneralizedAlpha(short, 1.0, max_steps=_MANY),
        "GeneralizedAlpha, radius 0.9": GeneralizedAlpha(short, 0.9, max_steps=_MANY),
        "Legendre, order 6": Collocation(long, 3, "legendre"),
        "Radau, order 5": Collocation(long, 3, "radau"),
        "RK4": RK4(short),
    }


def study(full: bool) -> dict[str, Table]:
    """Measure what each method keeps over 1e5 periods of an oscillator, 1000 of a tumbling body."""
    return {
        "oscillator": _oscillator(100_000 if full else 100),
        "tumbling": _tumbling(1000 if full else 10),
    }


def _sampled_periods(last: int) -> np.ndarray:
    """Return the numbers of periods 0, 1, 3, 10, 30, ... up to the last."""
    powers = 10 ** np.arange(round(math.log10(last)) + 1)
    return np.array([0, *sorted({*powers, *(3 * powers[:-1])})], float)


def _oscillator(last: int) -> Table:
    period, rows = 2 * math.pi, []
    for name, method in methods(period).items():
        periods = _sampled_periods(last if name in _ENDURING else min(last, _OTHERS))
        run = swing(method, period * periods)
        size = amplitude(run)
        rows += [(name, n, float(a) ** 2 - 1) for n, a in zip(periods[1:], size[1:], strict=False)]
    return Table(("method", "periods", "energy_gained"), ("", "", ""), tuple(rows))


def _tumbling(last: int) -> Table:
    model = tumbling()
    start = (OFFSET, 1.0, OFFSET)
    period, rows = 2 * half_period(_INERTIA, start), []
    periods = _sampled_periods(last)
    # The body turns six times in a period, so a sixth of it determines the fixed steps.
    for name, method in methods(period / 6).items():
        run = simulate(model, period * periods, method, throw=False)
        energy, moment = run["energy"], run["angular_momentum"]
        q = np.array([run[f"body.q_{c}"] for c in "wxyz"])
        spin = np.abs(run["body.angular_velocity"] - start).max(axis=1)
        drift = np.linalg.norm(moment - moment[0], axis=1) / np.linalg.norm(moment[0])
        length = np.linalg.norm(q, axis=0) - 1
        rows += [
            (
                name,
                n,
                float(energy[i] / energy[0] - 1),
                float(drift[i]),
                float(length[i]),
                float(spin[i]),
            )
            for i, n in enumerate(periods[: len(run.t)])
            if i
        ]
    return Table(
        ("method", "periods", "energy_gained", "momentum_error", "quaternion_gained", "spin_error"),
        ("", "", "", "", "", "rad/s"),
        tuple(rows),
    )


def draw(tables: Tables) -> Figure:
    """Draw errors over periods: the oscillator's energy, and four of the tumbling body."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 7.6), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    shown = (
        ("oscillator", "energy_gained", "oscillator: |energy gained|, relative"),
        ("tumbling", "energy_gained", "tumbling: |energy gained|, relative"),
        ("tumbling", "momentum_error", "tumbling: momentum error, relative"),
        ("tumbling", "quaternion_gained", "tumbling: |length of quaternion - 1|"),
        ("tumbling", "spin_error", "tumbling: spin error [rad/s]"),
    )
    for panel, (name, column, label) in zip(panels, shown, strict=False):
        table = tables[name]
        for method, style in _STYLES.items():
            mine = table.column("method") == method
            size = np.maximum(np.abs(table.column(column)[mine]), _ROUNDING)
            panel.plot(table.column("periods")[mine], size, **style, label=method)
        panel.set(
            xscale="log", yscale="log", xlabel="periods", ylabel=label, ylim=(_ROUNDING / 3, 30)
        )
        panel.grid(alpha=0.3)
    panels[5].axis("off")
    panels[5].legend(*panels[0].get_legend_handles_labels(), loc="center", frameon=False)
    return figure
