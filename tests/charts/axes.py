"""One choice at a time: laws, coordinates, minimal models, exact Jacobians, compiled functions.

`python tests/charts/axes.py` writes generated/charts/speed/axes.png, .md and .csv in about two
minutes: CPU time to an error of 1e-6, as in `speed.py`, with everything else equal.
"""

from __future__ import annotations

import math
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import casadi as ca
import numpy as np

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from paths import CHARTS
from scenes import reference
from scenes.speed import Case, stiff

import rbsd_sym as rs
from charts import contenders, pages, speed
from charts.contenders import POINTS, Contender
from charts.front import sober, time_at
from rbsd_sym.model.trajectory import Column, Outcome, Trajectory
from rbsd_sym.plots.style import COLOURS, MARKERS

CAP = 0.5  # CPU seconds of a run
_APART = 0.5  # decades between tolerances


class Entry(NamedTuple):
    """One measurement: on which axis, of which scene, which variant and method."""

    axis: str
    scene: str
    variant: str
    method: str
    contender: Contender
    case: Case
    model: rs.Model


@cache
def named(name: str, law: Any = None, flat: bool = False) -> Case:
    """A reference scene, with another law, or with gravity in its plane alone."""
    scene = reference.build(name)
    if law is not None:
        scene = replace(scene, connectors=[replace(c, law=law) for c in scene.connectors])
    if flat:
        scene = replace(scene, gravity=(0, -9.6, 0))
    return Case(scene, reference.data(name)["t_end"])


def idas(model: rs.Model, t_end: float, label: str) -> Contender:
    """Idas at a range of tolerances."""
    grid = np.linspace(0, t_end, POINTS + 1)
    run = lambda r: rs.simulate(model, grid, rs.Idas(r, r / 100), throw=False)  # noqa: E731
    return Contender(label, label, contenders.tolerances(_APART), False, run,
                     lambda r: contenders.cpu(lambda: run(r)), lambda r: f"rtol {r:.1e}")


def dop853(model: rs.Model, t_end: float, folder: Path) -> Contender:
    """Dop853, exported."""
    every = contenders.exported(model, t_end, _APART, folder)
    return next(c for c in every if c.family == "Dop853")


def bare_idas(model: rs.Model, t_end: float, exact: bool) -> Contender:
    """CasADi's IDAS, set up as by `Idas`, on rates that CasADi may differentiate, or may not.

    Without derivatives of its own a Function is differenced by CasADi (central differences).
    """
    options = {} if exact else {
        "enable_fd": True, "enable_forward": False, "enable_reverse": False,
        "enable_jacobian": False,
    }  # fmt: skip
    symbols = model.symbols
    given = {"is_diff_in": [False, True, False, False, False]} | options
    rates = ca.Function("rates", symbols, [model.function("ode")(*symbols)], given)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", model.n_x)
    dae = {"t": t, "x": x, "ode": rates(t, x, [], [], [])}
    grid = np.linspace(0, t_end, POINTS + 1)
    x0 = np.array([label.start for label in model.x_labels])

    @cache
    def built(rtol: float) -> ca.Function:
        share = 0.1 / math.sqrt(model.n_x)
        return ca.integrator("bare", "idas", dae, 0, list(grid[1:]), {
            "reltol": rtol * share, "abstol": rtol / 100 * share, "max_num_steps": 100_000,
            "linear_solver": "qr" if model.n_x <= 60 else "csparse",
        })  # fmt: skip

    def run(rtol: float) -> Trajectory:
        try:
            values = np.vstack([x0, np.array(built(rtol)(x0=x0)["xf"]).T])
        except RuntimeError as error:
            return contenders.failed(model.name, str(error))
        columns = {v.name: Column(values[:, i], v.unit) for i, v in enumerate(model.x_labels)}
        names, done = tuple(v.name for v in model.x_labels), Outcome.reached_end
        stats = {"steps": float(built(rtol).stats()["nsteps"])}
        return Trajectory(model.name, grid, columns, done, done.value, stats, {}, names,
                          model.digest, model.measure_all, model.left_out)  # fmt: skip

    label = "Idas, interpreted"
    return Contender(label, label, contenders.tolerances(_APART), False, run,
                     lambda r: contenders.cpu(lambda: built(r)(x0=x0)), lambda r: f"rtol {r:.1e}")


def entries(folder: Path) -> Iterator[Entry]:
    """Everything that is measured."""
    number = iter(range(100))

    def both(axis: str, scene: str, variant: str, case: Case, model: rs.Model) -> Iterator[Entry]:
        place = folder / str(next(number))
        for contender in (dop853(model, case.t_end, place),
                          idas(rs.compiled(model), case.t_end, "Idas, compiled")):  # fmt: skip
            yield Entry(axis, scene, variant, contender.method, contender, case, model)

    for name in ("single", "chain4"):
        for law in (rs.Standard(), rs.Intrinsic(), rs.Consistent()):
            case = named(name, law)
            yield from both("law", name, type(law).__name__, case, rs.compile_scene(case.scene))
    for name in ("coupled", "chain4"):
        for form in (rs.Quaternion(), rs.TaitBryan()):
            case = named(name)
            model = rs.compile_scene(case.scene, form)
            yield from both("coordinates", name, type(form).__name__, case, model)
    mini = named("mini")
    for name, case in (("mini", mini), ("flat chain4", named("chain4", flat=True))):
        for minimal in (False, True):
            model = rs.compile_scene(case.scene, minimal=minimal)
            variant = "minimal" if minimal else "full"
            yield from both("states", name, variant, case, model)
    for name, case in (("single", named("single")), ("stiff1e3", stiff(1e3)),
                       ("chain4", named("chain4"))):  # fmt: skip
        model = rs.compile_scene(case.scene, layout="flat")
        for exact in (True, False):
            contender = bare_idas(model, case.t_end, exact)
            yield Entry("Jacobian", name, "exact" if exact else "differences", contender.method,
                        contender, case, model)  # fmt: skip
    for name in ("single", "chain4", "chain16"):
        case = named(name)
        model = rs.compile_scene(case.scene)
        for form, candidate in (("interpreted", model), ("compiled", rs.compiled(model))):
            contender = idas(candidate, case.t_end, "Idas")
            yield Entry("functions", name, form, "Idas", contender, case, model)


def measure() -> rs.study.Table:
    """Axis, scene, variant, method, states, ms at the target, and the smallest error reached."""
    rows, judges = [], {}
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as temporary:
        warnings.simplefilter("ignore", rs.ModelWarning)
        for k, entry in enumerate(entries(Path(temporary) / "runs")):
            key = id(entry.case)
            if key not in judges:
                folder = Path(temporary) / f"judge{k}"
                model = rs.compile_scene(entry.case.scene)
                judges[key] = speed.judge_of(entry.case, model, folder)
            runs = speed.climb(entry.contender, judges[key], CAP)
            points = [(run[speed.ERROR], run[speed.TIME]) for run in runs]
            took = time_at(sober(points), speed.TARGET)
            known = [run[speed.ERROR] for run in runs if run[speed.ERROR] is not None]
            rows.append((entry.axis, entry.scene, entry.variant, entry.method, entry.model.n_x,
                         None if took is None else 1e3 * took, min(known, default=None),
                         judges[key].floor))  # fmt: skip
    columns = ("axis", "scene", "variant", "method", "states", "time at 1e-6", "least error",
               "floor")  # fmt: skip
    return rs.study.Table(columns, ("", "", "", "", "", "ms", "", ""), tuple(rows))


def draw(table: rs.study.Table) -> Any:
    """A panel for each axis: time of each variant beside the others."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, NullFormatter

    axes = list(dict.fromkeys(str(row[0]) for row in table.rows))
    lines = [list(dict.fromkeys((row[1], row[3]) for row in table.rows if row[0] == axis))
             for axis in axes]  # fmt: skip
    figure = Figure(figsize=(8.0, 1.2 + 0.34 * sum(map(len, lines)) + 0.5 * len(axes)),
                    layout="constrained")  # fmt: skip
    panels: Any = figure.subplots(len(axes), 1, sharex=True,
                                  height_ratios=[len(own) + 0.6 for own in lines])  # fmt: skip
    for axis, own, panel in zip(axes, lines, panels, strict=True):
        variants = list(dict.fromkeys(str(row[2]) for row in table.rows if row[0] == axis))
        for i, variant in enumerate(variants):
            mine = [row for row in table.rows if row[0] == axis and row[2] == variant]
            reached = [(row[5], own.index((row[1], row[3]))) for row in mine if row[5] is not None]
            panel.plot(*zip(*reached, strict=True), MARKERS[i], color=COLOURS[i], ms=7,
                       label=variant)  # fmt: skip
        panel.set_yticks(range(len(own)), [f"{scene}: {method}" for scene, method in own],
                         fontsize=8)  # fmt: skip
        panel.set(xscale="log", ylim=(len(own) - 0.5, -0.5))
        panel.grid(alpha=0.3)
        panel.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), frameon=False, fontsize=8,
                     title=axis, title_fontsize=9, alignment="left")  # fmt: skip
    panels[-1].set_xlabel("CPU time to an error of 1e-6 [ms]")
    panels[-1].xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panels[-1].xaxis.set_minor_formatter(NullFormatter())
    return figure


def ratios(table: rs.study.Table) -> list[str]:
    """A sentence for each scene and method: every variant over the first one."""
    groups: dict[tuple[Any, ...], list[Any]] = {}
    for row in table.rows:
        groups.setdefault((row[0], row[1], row[3]), []).append(row)
    found = []
    for (axis, scene, method), rows in groups.items():
        first = rows[0]
        said = [f"{row[2]} {row[5] / first[5]:.2f}" if row[5] and first[5] else f"{row[2]} -"
                for row in rows[1:]]  # fmt: skip
        found.append(f"- {axis}, {scene}, {method}: {', '.join(said)} times {first[2]}")
    return found


def main() -> None:
    """Measure, and write table and picture."""
    table = measure()
    target = CHARTS / "speed"
    target.mkdir(parents=True, exist_ok=True)
    text = "\n\n".join([
        "# One choice at a time", f"`python tests/charts/axes.py` on {pages.machine()}",
        "CPU time to an error of 1e-6, interpolated along the convex lower front of runs at many "
        "tolerances; errors and times as in the [charts of the scenes](README.md). Laws move the "
        "bodies differently: each has a reference of its own. Jacobians: the same IDAS call on the "
        "interpreted rates, which CasADi differentiates exactly or by central differences.",
        "![axes](axes.png)", "\n".join(ratios(table)), table.to_markdown(),
    ])  # fmt: skip
    (target / "axes.md").write_text(text + "\n")
    table.to_csv(target / "axes.csv")
    draw(table).savefig(target / "axes.png", dpi=110)
    print(text)


if __name__ == "__main__":
    main()
