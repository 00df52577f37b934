"""BDF of high order on undamped stiff connectors, and Jacobians by differences.

On the imaginary axis, where the eigenvalues of undamped modes lie, BDF of order 3 to 5 multiplies
what it does not resolve by more than 1. A fast mode of amplitude 1e-8 beside a slow motion then
grows until the error control detects it, and the step has to follow it from there: 83,763 steps of
IDAS instead of 1,033 with `max_order=2`. On the flyball governor CVODES at rtol 1e-3 reports
success and is wrong by up to 4 m/s, and so is `ExplicitRK` at 1e-2; `Idas`, with its margin of
safety, is not. Differences in place of exact Jacobians have errors in proportion to the stiffness,
3e-8 of it forward and 6e-11 central: in a stiff pendulum they exceed the entries of the slow motion
at 4e8 and 2e11 N/m. Newton's method is affected late: its iterations are the same up to 3e7 N/m,
and a third more at 1e8. Remedy: `max_order=2`, `Rosenbrock` or `GeneralizedAlpha` for undamped
stiff connectors, tight tolerances for BDF of order 5.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from rbsd_sym import (
    GROUND,
    ExplicitRK,
    GeneralizedAlpha,
    Idas,
    Marker,
    Model,
    ModelWarning,
    Outcome,
    RigidBody,
    RigidBodySpringDamper,
    Rosenbrock,
    Scene,
    Trajectory,
    compile_scene,
    simulate,
)
from rbsd_sym.integrators.driver import Run, Verdict, run
from rbsd_sym.model.values import Experiment
from rbsd_sym.plots.style import COLOURS
from rbsd_sym.study import Table

from . import difference_jacobian
from .implicit_damping import bdf_roots
from .oscillators import legend_below, style_of
from .pages import model_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 11
# Frequency (rad/s) and amplitude (m) of the mode that should not matter.
_FAST, _TINY = 1e4, 1e-8
# Length of a run, s.
_END = 10.0
# Reference of the flyball governor after 1 s, in extended precision: rod_0.v_y (m/s) and the height
# of the slider (m).
SPEED, HEIGHT = -0.903124289663356422, 0.485000928413884402
# Safety factor with which IDAS receives the given tolerances unchanged, for four states.
_AS_THEY_ARE = 2.0
# Steps: practically no limit.
_MANY = 10_000_000
_STYLES: dict[str, dict[str, Any]] = {
    "CVODES, order up to 5": {"color": "0.5", "marker": "P", "ms": 6, "ls": ":"},
    "Idas": style_of("Idas"),
    "Idas, max_order 2": style_of("Idas", ls="--", mfc="white"),
    "Rosenbrock": style_of("Rosenbrock"),
    "ExplicitRK": style_of("ExplicitRK"),
    "GeneralizedAlpha": style_of("GeneralizedAlpha", ls=""),
}


@dataclass(frozen=True)
class _Cvodes:
    """SUNDIALS CVODES with its own defaults, through CasADi: BDF of order up to 5."""

    rtol: float
    atol: float
    count: ClassVar[Mapping[str, str]] = {"steps": "nsteps", "newton_iterations": "nniters"}

    def solve(self, model: Model, experiment: Experiment) -> Trajectory:
        """Integrate the model over the times of the experiment."""
        options = {"reltol": self.rtol, "abstol": self.atol, "max_num_steps": _MANY}
        return run(model, experiment, "cvodes", options, _judge, self.count)


def _judge(result: Run) -> Verdict:
    return Verdict(Outcome.solver_failed, None, "tighten the tolerances")


@cache
def two_modes() -> Model:
    """Return 1 kg at 1 rad/s from 1 m, and 1 kg at 1e4 rad/s from 1e-8 m, without coupling."""
    bodies = [
        RigidBody("slow", 1, (1, 1, 1), position=(1, 0, 0)),
        RigidBody("fast", 1, (1, 1, 1), position=(_TINY, 0, 0)),
    ]
    springs = [
        RigidBodySpringDamper(f"on_{b}", Marker(GROUND), Marker(b), [k, 0, 0, 0, 0, 0])
        for b, k in (("slow", 1.0), ("fast", _FAST**2))
    ]
    return compile_scene(Scene("two_modes", bodies, springs))


def study(full: bool) -> dict[str, Table]:
    """Measure roots of BDF, the fast mode, the governor, and Jacobians by differences."""
    rows = [
        (order, float(h), float(np.abs(bdf_roots(order, float(h))).max()))
        for order in (1, 2, 3, 4, 5)
        for h in np.logspace(-1.5, 1.5, 37 if full else 13)
    ]
    stiffnesses = np.logspace(3, 14, 23 if full else 5)
    return {
        "roots": Table(("order", "h_w", "largest_root"), ("", "", ""), tuple(rows)),
        "fast_mode": _fast_mode((1, 2, 3, 4, 5) if full else (2, 5)),
        "governor": _governor(full),
        "jacobian": difference_jacobian.digits(stiffnesses),
        "newton": difference_jacobian.newton(np.logspace(3, 8 if full else 5, 11 if full else 2)),
    }


def _fast_mode(orders: tuple[int, ...]) -> Table:
    rows = []
    for order in orders:
        method = Idas(1e-6, 1e-6, max_order=order, safety=_AS_THEY_ARE, max_steps=_MANY)
        end = simulate(two_modes(), [0, _END], method, throw=False)
        left = math.hypot(end["fast.p_x"][-1], end["fast.v_x"][-1] / _FAST)
        error = abs(float(end["slow.p_x"][-1]) - math.cos(_END))
        rows.append((order, end.stats["steps"], end.stats["newton_iterations"], left, error))
    return Table(
        ("max_order", "steps", "newton_iterations", "fast_amplitude_left", "error_of_slow"),
        ("", "", "", "m", "m"),
        tuple(rows),
    )


@cache
def governor() -> Model:
    """Return the flyball governor: undamped modes up to 2.8e4 rad/s beside a slow motion."""
    # Its hinges about the local y are valid below 90 degrees, which they never reach.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ModelWarning)
        return compile_scene(model_file("governor").scene())


def _governor(full: bool) -> Table:
    loose = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8) if full else (1e-8,)
    runs: list[tuple[str, float, float, Any]] = [
        ("CVODES, order up to 5", 1e-3, atol, _Cvodes(1e-3, atol)) for atol in loose
    ]
    kinds: dict[str, Any] = {
        "CVODES, order up to 5": _Cvodes,
        "Idas": Idas,
        "Idas, max_order 2": lambda rtol, atol: Idas(rtol, atol, max_order=2),
        "Rosenbrock": Rosenbrock,
        "ExplicitRK": ExplicitRK,
    }
    for name, kind in kinds.items():
        for rtol in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7) if full else (1e-3,):
            if full or name in ("Idas", "Rosenbrock"):
                runs.append((name, rtol, rtol * 1e-2, kind(rtol, rtol * 1e-2)))
    for step in (1e-2, 1e-3, 1e-4) if full else (1e-2,):
        runs.append(("GeneralizedAlpha", step, 0.0, GeneralizedAlpha(step)))
    rows = []
    for name, rtol, atol, method in runs:
        end = simulate(governor(), [0, 1.0], method, throw=False)
        speed, height = end["rod_0.v_y"][-1] - SPEED, end["slider.position"][-1, 2] - HEIGHT
        steps = end.stats.get("steps")
        rows.append(
            (name, rtol, atol, abs(float(speed)), abs(float(height)), steps, end.outcome.name)
        )
    return Table(
        ("method", "rtol_or_step", "atol", "error_of_speed", "error_of_height", "steps", "outcome"),
        ("", "", "", "m/s", "m", "", ""),
        tuple(rows),
    )


def draw(tables: Tables) -> Figure:
    """Draw roots, steps, errors of the governor, and what differences do to Jacobians."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.5, 8.0), layout="constrained")
    panels: Any = figure.subplots(2, 3)
    (roots, steps, over_tolerance), (over_steps, digits, newton) = panels
    _draw_roots(roots, tables["roots"])
    _draw_fast_mode(steps, tables["fast_mode"])
    _draw_governor(over_tolerance, over_steps, tables["governor"])
    digits.axhline(
        difference_jacobian.GRAVITY, color="0.6", ls="--", label="entries of slow motion"
    )
    for panel, table, column, label in (
        (digits, "jacobian", "largest_error", "largest error of the Jacobian [1/s²]"),
        (newton, "newton", "newton_iterations", "Newton iterations of Idas, max_order 2"),
    ):
        for kind, style in zip(difference_jacobian.KINDS, ("o-", "^--", "s:"), strict=True):
            mine = tables[table].column("jacobian") == kind
            k, values = (tables[table].column(c)[mine] for c in ("stiffness", column))
            if values.any():
                panel.plot(
                    k,
                    values,
                    style,
                    label=f"{kind} Jacobian",
                    ms=4,
                    color=COLOURS[difference_jacobian.KINDS.index(kind)],
                )
        panel.set(xscale="log", yscale="log", xlabel="stiffness of the joint [N/m]", ylabel=label)
        legend_below(panel)
    for panel in panels.ravel():
        panel.grid(alpha=0.3)
    return figure


def _draw_roots(panel: Any, table: Table) -> None:
    for order in (1, 2, 3, 4, 5):
        mine = table.column("order") == order
        panel.plot(
            table.column("h_w")[mine],
            table.column("largest_root")[mine],
            ("-", "--", "-.", ":", "-")[order - 1],
            color=COLOURS[order - 1],
            label=f"order {order}",
        )
    panel.axhline(1, color="0.4", lw=0.8)
    panel.set(
        xscale="log",
        xlabel="step × frequency, h w",
        title="undamped oscillator",
        ylabel="amplitude kept in one step of BDF",
    )
    legend_below(panel, 3)


def _draw_fast_mode(panel: Any, table: Table) -> None:
    order, steps = table.column("max_order"), table.column("steps")
    panel.bar(order, steps, color=COLOURS[0], width=0.6)
    for at, value in zip(order, steps, strict=True):
        panel.text(at, 1.2 * value, f"{value:,.0f}", ha="center", fontsize=8)
    panel.set(
        yscale="log",
        ylim=(100, 1e7),
        xlabel="highest order that IDAS may use",
        ylabel="steps for 10 s",
        title="slow mode beside a tiny fast one",
        xticks=[1, 2, 3, 4, 5],
    )


def _draw_governor(over_tolerance: Any, over_steps: Any, table: Table) -> None:
    for name, style in _STYLES.items():
        mine = table.column("method") == name
        if not mine.any():
            continue
        error = np.maximum(table.column("error_of_speed")[mine], 1e-14)
        if name != "GeneralizedAlpha":
            rtol = table.column("rtol_or_step")[mine]
            over_tolerance.plot(rtol, error, **(style | {"ls": ""}), label=name)
        over_steps.plot(table.column("steps")[mine], error, **(style | {"ls": ""}), label=name)
    over_tolerance.set(xlabel="rtol", title="flyball governor, all report success")
    over_tolerance.invert_xaxis()
    over_steps.set(xlabel="steps", title="flyball governor")
    for panel in (over_tolerance, over_steps):
        panel.set(xscale="log", yscale="log", ylabel="error of the rod's speed at 1 s [m/s]")
        panel.axhline(abs(SPEED), color="0.6", lw=1, ls="--", label="the speed itself")
        legend_below(panel)
