"""The pages of the speed charts: figure, table and text of a scene, and the summary of all."""

from __future__ import annotations

import csv
import os
import platform
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from scenes.speed import CASES, Case

import rbsd_sym as rs
from rbsd_sym.plots.style import COLOURS, MARKERS

COMMAND = "python tests/charts/speed.py"
# Times faster than Exudyn at its best, at equal error 1e-6, that were aimed at.
GOALS = {"single": 2.0, "chain16": 10.0, "chain256": 10.0, "stiff1e6": 25.0}
_FAMILIES = (
    "Idas", "Rosenbrock", "ExplicitRK", "Dop853", "GeneralizedAlpha", "Collocation", "RK4",
)  # fmt: skip
# Peers in greys and olive, dashed: none of the colours of our methods.
_PEERS = {"Exudyn, explicit": ("#777777", "*", "--"), "Exudyn, implicit": ("#777777", "p", ":"),
          "scipy": ("#8A8A2A", "h", "--")}  # fmt: skip
_SUMMARY = (
    "scene", "ours", "ours [ms]", "in Python", "in Python [ms]", "Exudyn", "Exudyn [ms]", "scipy",
    "scipy [ms]", "ours at end [ms]", "Exudyn at end", "Exudyn at end [ms]", "recommended",
    "times best", "recommended export", "times best export", "floor",
)  # fmt: skip
_USELESS = 0.1  # error of a run that claims success
_TOP = 3.0  # errors above are drawn there
Times = Mapping[tuple[str, str], float]
TIME, LOW, HIGH = 9, 10, 11  # columns


def name_of(integrator: Any) -> str:
    """The name under which the charts have an integrator."""
    kind = type(integrator).__name__
    if kind == "Idas" and integrator.max_order < 5:
        return f"Idas(max_order={integrator.max_order})"
    if kind == "Collocation":
        return f"Collocation {integrator.scheme}, {integrator.degree} points"
    return kind


def chosen(table: rs.study.Table, times: Times) -> dict[str, str]:
    """The method to draw of each family: the fastest at the target, else the most accurate."""
    found: dict[str, str] = {}
    for family in dict.fromkeys(row[0] for row in table.rows):
        own = [row for row in table.rows if row[0] == family]
        reached = {m: took for (f, m), took in times.items() if f == family}
        if reached:
            found[str(family)] = min(reached, key=lambda m: reached[m])
        else:
            best = min(own, key=lambda row: np.inf if row[3] is None else row[3])
            found[str(family)] = str(best[1])
    order = [*_FAMILIES, *_PEERS]
    return dict(sorted(found.items(), key=lambda item: order.index(item[0])))


def draw(title: str, table: rs.study.Table, times: Times, target: float) -> Any:
    """Error against CPU time of the best form of each family."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.6, 4.8), layout="constrained")
    panel: Any = figure.subplots()
    drawn = chosen(table, times)
    rows = [row for row in table.rows if drawn[str(row[0])] == row[1]]
    good = [row for row in rows if row[3] is not None and row[3] > 0]
    span = [1e3 * min(r[LOW] for r in good) / 1.5, 1e3 * max(r[HIGH] for r in good) * 1.5]
    panel.set(xscale="log", yscale="log", xlabel="CPU time [ms]", xlim=span, title=title,
              ylabel="largest error, relative to excursion")  # fmt: skip
    for family, method in drawn.items():
        _line(panel, [row for row in rows if row[1] == method], family, method, span)
    floor = float(table.column("floor")[0])
    low = min(panel.get_ylim()[0], floor / 3 if floor > 0 else np.inf)
    panel.axhspan(low, floor, color="0.9", lw=0, label="not resolved by the reference")
    panel.set_ylim(low, 2 * _TOP)
    panel.axhline(target, color="0.3", lw=0.8, ls="-")
    panel.annotate(f"{target:g}", (1.0, target), xycoords=("axes fraction", "data"), fontsize=8,
                   xytext=(-3, 2), textcoords="offset points", ha="right")  # fmt: skip
    _legend(panel, rows)
    return figure


def _legend(panel: Any, rows: Sequence[Any]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    if any(row[3] is None for row in rows):
        panel.plot([], [], "x", color="black", label="failed, at the top")
    if any(row[3] is not None and row[3] > _USELESS for row in rows):
        panel.plot([], [], "o", ms=10, mfc="none", color="black",
                   label=f"error above {_USELESS:g}: of no use")  # fmt: skip
    few = np.ptp(np.log10(panel.get_xlim())) < 3
    panel.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5) if few else (1,)))
    panel.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.grid(alpha=0.3)
    handles, labels = panel.get_legend_handles_labels()
    lines = [i for i, h in enumerate(handles) if hasattr(h, "has_xerr")]
    order = [*lines, *(i for i in range(len(handles)) if i not in lines)]
    panel.legend([handles[i] for i in order], [labels[i] for i in order], loc="upper left",
                 bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize="small")  # fmt: skip


def _line(panel: Any, rows: Sequence[Any], family: str, method: str, span: Sequence[float]) -> None:
    if family in _PEERS:
        colour, marker, style = _PEERS[family]
    else:
        i = _FAMILIES.index(family)
        colour, marker, style = COLOURS[i], MARKERS[i], "-"
    runs = sorted((row for row in rows if row[3] is not None and row[3] > 0), key=lambda r: r[TIME])
    time, low, high = (1e3 * np.array([row[i] for row in runs], float) for i in (TIME, LOW, HIGH))
    error = np.minimum([row[3] for row in runs], _TOP)
    panel.errorbar(time, error, xerr=[time - low, high - time], color=colour, marker=marker,
                   ls=style, ms=5, lw=1.3, elinewidth=0.8, label=method)  # fmt: skip
    useless = error > _USELESS
    panel.plot(time[useless], error[useless], "o", ms=10, mfc="none", color=colour)
    broken = [1e3 * row[TIME] for row in rows if row[3] is None]
    panel.plot(np.clip(broken, *span), np.full(len(broken), 0.975), "x", color=colour,
               transform=panel.get_xaxis_transform(), clip_on=False)  # fmt: skip


def machine() -> str:
    """What it was measured on."""
    model = platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        lines = [v for v in info.read_text().splitlines() if "model name" in v]
        names = [v.split(":")[1].strip() for v in lines]
        model = names[0] if names else model
    versions = [f"rbsd_sym {rs.__version__}"]
    for package in ("casadi", "exudyn", "scipy"):
        try:
            versions.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            versions.append(f"no {package}")
    return f"{model}, {os.cpu_count()} cores, {platform.system()}; {', '.join(versions)}"


_HOW = """\
Error: the largest over the output times (eight intervals) of position, rotation angle, velocity
and angular velocity of all bodies, each relative to its excursion: the largest distance from the
start over the run. Runs of Exudyn that choose their own steps are judged at the end alone.

Time: CPU time, the median of up to five runs, after one that builds. Of our integrators it is the
whole call of `simulate`; of an exported simulator its C function, called from Python; of Exudyn
its solve call alone, without building the system and reading results; of scipy `solve_ivp`.
"""


def write(
    folder: Path, case: Case, table: rs.study.Table, names: tuple[str, str],
    both: tuple[Times, Times], recommended: tuple[str, str],
) -> None:  # fmt: skip
    """The files of one scene, and its line for the summary.

    Arguments:
        both: times at the target by the error over the run, and by that at the end alone.
    """
    times = both[0]
    name, floor = case.scene.name, float(table.column("floor")[0])
    figure = draw(f"{name}, {case.t_end:g} s", table, times, 1e-6)
    figure.savefig(folder / f"{name}.png", dpi=110, bbox_inches="tight")
    table.to_csv(folder / f"{name}.csv")
    at_end = {key: 1e3 * took for key, took in both[1].items()}
    ranked = sorted(times.items(), key=lambda item: item[1])
    fastest = rs.study.Table(
        ("method", "over the run", "at the end alone"), ("", "ms", "ms"),
        tuple((key[1], 1e3 * took, at_end.get(key)) for key, took in ranked),
    )  # fmt: skip
    never = sorted({str(row[1]) for row in table.rows} - {m for _, m in times})
    parts = [
        f"# {name}: error against CPU time", case.note, f"![{name}]({name}.png)",
        f"`{COMMAND} {name}` on {machine()}",
        f"Reference: {names[0]} and {names[1]}, which differ by {floor:.2g}.", _HOW,
        "## Time to an error of 1e-6",
        "Between the runs of a method, along the convex lower front in logarithms; a run counts "
        "with the larger of its own error and that of the next tighter one, so that luck does not "
        "win.",
        fastest.to_markdown(),
        f"Not reached by: {'; '.join(never)}." if never else "",
        f"All {len(table.rows)} runs, with settings, errors by quantity, steps, times and how they "
        f"ended: [{name}.csv]({name}.csv).",
    ]  # fmt: skip
    (folder / f"{name}.md").write_text("\n\n".join(p.strip() for p in parts if p) + "\n")
    _keep(folder / "summary.csv", _summary_row(name, floor, both, recommended))


def _summary_row(
    name: str, floor: float, both: tuple[Times, Times], recommended: tuple[str, str]
) -> dict[str, str]:
    times, at_end = both

    def best(want: Any, of: Times = times) -> tuple[str, float]:
        return min(((m, took) for (f, m), took in of.items() if want(f, m)),
                   key=lambda v: v[1], default=("", np.nan))  # fmt: skip

    found = {
        "ours": best(lambda f, m: f in _FAMILIES),
        "in Python": best(lambda f, m: f in _FAMILIES and "exported" not in m),
        "Exudyn": best(lambda f, m: f.startswith("Exudyn")),
        "scipy": best(lambda f, m: f == "scipy"),
        "ours at end": best(lambda f, m: f in _FAMILIES, at_end),
        "Exudyn at end": best(lambda f, m: f.startswith("Exudyn"), at_end),
    }
    row = {"scene": name, "floor": f"{floor:.1e}"}
    for key, (method, took) in found.items():
        row |= {f"{key} [ms]": f"{1e3 * took:.4g}" if method else ""}
        row |= {key: method} if key != "ours at end" else {}
    by_name = {method: took for (_, method), took in times.items()}
    in_c = best(lambda f, m: "exported" in m)[1]
    for title, pick, form, fastest in (
        ("", recommended[0], "compiled", found["in Python"][1]),
        (" export", recommended[1], "exported C", in_c),
    ):
        took = by_name.get(f"{pick}, {form}")
        row |= {f"recommended{title}": pick,
                f"times best{title}": f"{took / fastest:.2f}" if took else ""}  # fmt: skip
    return row


def _keep(path: Path, row: Mapping[str, str]) -> None:
    """Put a row in the place of the scene's former one."""
    with_it = {r["scene"]: r for r in read(path)} | {row["scene"]: dict(row)}
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, _SUMMARY, lineterminator="\n")
        writer.writeheader()
        writer.writerows(with_it.values())


def read(path: Path) -> list[dict[str, str]]:
    """Rows of the summary so far."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def summary(folder: Path) -> None:
    """README.md of the charts: one line a scene, goals and what was reached."""
    order = list(CASES)
    known = [row for row in read(folder / "summary.csv") if row["scene"] in order]
    rows = sorted(known, key=lambda row: order.index(row["scene"]))
    lines = ["| scene | fastest of ours | ms | fastest in `simulate` | ms | Exudyn at its best "
             "| ms | times faster | at the end alone | goal | scipy | ms | times faster |",
             "|---|---|--:|---|--:|---|--:|--:|--:|---|---|--:|--:|"]  # fmt: skip
    advice = ["| scene | `simulate` | over the fastest | export | over the fastest |",
              "|---|---|--:|---|--:|"]  # fmt: skip
    for r in rows:
        ratio = {peer: _ratio(r[f"{peer} [ms]"], r["ours [ms]"]) for peer in ("Exudyn", "scipy")}
        ratio["end"] = _ratio(r["Exudyn at end [ms]"], r["ours at end [ms]"])
        goal = GOALS.get(r["scene"])
        lines.append("| " + " | ".join([
            f"[{r['scene']}]({r['scene']}.md)", r["ours"], r["ours [ms]"], r["in Python"],
            r["in Python [ms]"], r["Exudyn"] or "-", r["Exudyn [ms]"] or "-", ratio["Exudyn"],
            ratio["end"], _verdict(goal, [ratio["Exudyn"], ratio["end"]]), r["scipy"] or "-",
            r["scipy [ms]"] or "-", ratio["scipy"],
        ]) + " |")  # fmt: skip
        advice.append("| " + " | ".join([
            r["scene"], r["recommended"] or "-", r["times best"] or "-",
            r["recommended export"] or "-", r["times best export"] or "-"]) + " |")  # fmt: skip
    text = "\n\n".join([
        "# Speed against accuracy", f"`{COMMAND}` on {machine()}. The charts are linked below; "
        "[one choice at a time](axes.md) has laws, coordinates, minimal models and Jacobians.",
        "CPU time to an error of 1e-6, each method at its best setting, interpolated along the "
        "convex lower front of its runs (each with the larger of its own error and that of the "
        "next tighter one, so that luck does not win); all methods judged over the whole run, and "
        "again at its end alone, where transients are forgotten. A dash: the peer cannot run the "
        "scene, or no run of affordable length gets there; then the ratio has no number.",
        "\n".join(lines),
        _HOW.strip(),
        "## What `study.recommend` says",
        "The integrator that `recommend` picks for an error of 1e-6, and its time in the chart "
        "over that of the fastest: of all in `simulate` with compiled functions, and of all that "
        "can be exported to C.", "\n".join(advice),
    ])  # fmt: skip
    (folder / "README.md").write_text(text + "\n")


def _ratio(peer: str, ours: str) -> str:
    return f"{float(peer) / float(ours):.1f}" if peer and ours else "-"


def _verdict(goal: float | None, ratios: Sequence[str]) -> str:
    """Whether both ratios reach the goal."""
    if goal is None:
        return ""
    known = [float(ratio) for ratio in ratios if ratio != "-"]
    if not known:
        return f"{goal:g}: no run of Exudyn gets there"
    reached = min(known) >= goal
    return f"{goal:g}: {'reached' if reached else 'missed'}"
