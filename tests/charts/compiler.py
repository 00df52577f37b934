"""What the compiler buys: rates and Jacobians in C, building, whole simulations, against peers.

`python tests/charts/compiler.py` writes generated/charts/compiler.md, .csv and .png in some
minutes; with Exudyn installed (`pip install '.[peers]'`) it is measured in the same run.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

# Helper threads of numpy's BLAS spin while they wait, on the core that is being measured.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from oracles import handwritten, scenes
from paths import CHARTS, environment
from scenes import reference

import rbsd_sym as rs

ERROR = 1e-6  # largest error of the final state that a run may have to count
REPEATS = 7
LINKS = (16, 64, 256, 1024)
# Fewest equal steps of the hand-written order 8 that stay below the error from there on, and the
# best setting of Exudyn, found by `peers.exudyn_runner.best`; both are checked in every run.
RK8_STEPS = {"single": 28, "chain16": 166, "chain256": 195}
EXUDYN = {
    "single": ("rotvec", "DOPRI5", 64), "chain16": ("rotvec", "DOPRI5", 304),
    "chain256": ("rxyz", "DOPRI5", 332),
}  # fmt: skip
_STYLE = {  # Okabe and Ito's colours, and a marker each
    "hand-written C, fixed steps of order 8": ("#000000", "x"),
    "exported C, Dop853": ("#0072B2", "o"),
    "exported C, ExplicitRK": ("#56B4E9", "v"),
    "IDAS, compiled functions": ("#009E73", "s"),
    "IDAS, CasADi's virtual machine": ("#E69F00", "D"),
    "Exudyn, best setting": ("#D55E00", "^"),
}
_LOOP = """
#define _POSIX_C_SOURCE 199309L
#include <time.h>
#include "NAME.h"
static double now(void)
{
  struct timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}
#define SECONDS(function) double seconds_##function(double *x, double *out, int n, int calls) {\\
  const double began = now(), kept = x[0]; \\
  for (int i = 0; i < calls; ++i) { NAME_##function(0, x, 0, 0, 0, out); \\
    x[0] = kept + 1e-15 * out[n - 1]; } \\
  return (now() - began) / calls; }
SECONDS(ode)
SECONDS(dode_dx)
"""


def model_of(name: str) -> rs.Model:
    """The scene of that name, compiled."""
    return rs.compile_scene(reference.build(name))


def medians(contenders: Mapping[str, Callable[[], float]]) -> dict[str, tuple[float, float]]:
    """Median and smallest of the seconds each gives, measured in turn."""
    taken: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(REPEATS):
        for name, measure in contenders.items():
            gc.collect()
            taken[name].append(measure())
    return {name: (statistics.median(v), min(v)) for name, v in taken.items()}


def cpu(run: Callable[[], Any], times: int = 1) -> float:
    """CPU seconds of one run."""
    began = time.thread_time()
    for _ in range(times):
        run()
    return (time.thread_time() - began) / times


def functions(name: str, hand: ctypes.CDLL, folder: Path) -> tuple[Any, ...]:
    """Row: scene, states, ns of the rates by hand and generated, ratios, Jacobian over rates."""
    model, scene = model_of(name), reference.data(name)
    rs.export_c(model, folder, ["ode", "dode_dx"])
    (folder / "loop.c").write_text(_LOOP.replace("NAME", name))
    library = folder / "loop.so"
    command = ["cc", "-O2", "-std=c99", "-fPIC", "-shared", "loop.c", f"{name}.c", "-lm"]
    subprocess.run([*command, "-o", str(library)], cwd=folder, check=True)
    loaded = ctypes.CDLL(str(library))
    state = scenes.start_state(scene)
    state += 0.1 * np.random.default_rng(1).normal(size=state.shape)  # angles away from zero
    x, calls = state.reshape(-1).copy(), max(20, 300_000 // state.size)

    def generated(function: str, size: int) -> float:
        out, call = np.zeros(size), getattr(loaded, f"seconds_{function}")
        call.restype = ctypes.c_double
        pointers = (v.ctypes.data_as(ctypes.c_void_p) for v in (x, out))
        return call(*pointers, ctypes.c_int(size), ctypes.c_int(calls))

    nonzeros = model.function("dode_dx").nnz_out(0)
    found = medians({
        "hand": lambda: handwritten.seconds_per_call(hand, scene, state, calls),
        "ode": lambda: generated("ode", model.n_x),
        "dode_dx": lambda: generated("dode_dx", nonzeros),
    })
    (hand_s, hand_min), (ode, ode_min), (jacobian, _) = found.values()
    return (name, model.n_x, 1e9 * hand_s, 1e9 * ode, ode / hand_s, ode_min / hand_min,
            jacobian / ode)  # fmt: skip


def building(links: int) -> tuple[Any, ...]:
    """Row: links, seconds and peak memory from scene to library and through a short simulation."""
    with tempfile.TemporaryDirectory() as cache:
        script = (
            "import json, resource, sys, time\n"
            "from charts import compiler as chart\nimport rbsd_sym as rs\n"
            "from pathlib import Path\n"
            "folder = Path(sys.argv[1]); began = time.perf_counter()\n"
            f"model = chart.model_of('chain{links}')\n"
            "artefact = rs.export_c(model, folder / 'c'); rs.load_c(artefact)\n"
            "took = time.perf_counter() - began\n"
            "rs.simulate(rs.compiled(model), [0, 0.02])\n"
            "peak = [resource.getrusage(w).ru_maxrss / 1e6 for w in (0, -1)]\n"
            f"size = (folder / 'c' / 'chain{links}.c').stat().st_size / 1e6\n"
            "print(json.dumps([took, size, max(peak)]))\n"
        )
        own = environment(RBSD_SYM_CACHE=cache)
        done = subprocess.run([sys.executable, "-c", script, cache], env=own, check=True,
                              capture_output=True, text=True)  # fmt: skip
    return (links, *json.loads(done.stdout))


def fastest(run: Callable[[float], np.ndarray], error: Callable[[np.ndarray], float]) -> float:
    """The tolerance that takes the least CPU time; it and all tighter ones stay below ERROR."""
    good: list[tuple[float, float]] = []
    for tolerance in 10.0 ** np.arange(-8, -1.4, 0.25):
        if error(run(tolerance)) > ERROR:
            break  # looser ones may be lucky
        good.append((min(cpu(lambda t=tolerance: run(t)) for _ in range(3)), float(tolerance)))
    return min(good)[1]


def simulations(name: str, hand: ctypes.CDLL, folder: Path) -> list[tuple[Any, ...]]:
    """Rows: scene, method, ms, error, setting."""
    scene, model = reference.data(name), model_of(name)
    t_end, steps = scene["t_end"], RK8_STEPS[name]
    exact = handwritten.rk8(hand, scene, t_end, 6 * steps)
    path = [scenes.start_state(scene)]
    for _ in range(20):
        path.append(handwritten.rk8(hand, scene, t_end / 20, steps // 5, path[-1]))
    sizes = handwritten.excursions(path)

    def error(state: np.ndarray) -> float:
        return float(handwritten.error(state.reshape(-1, 13), exact, sizes))

    def state_of(trajectory: rs.Trajectory) -> np.ndarray:
        return np.array([trajectory[label.name][-1] for label in model.x_labels])

    runs: dict[str, Callable[[float], np.ndarray]] = {}
    for method in (rs.Dop853(), rs.ExplicitRK()):
        key = type(method).__name__
        simulator = rs.load_simulator(rs.export_simulator(model, folder / key, method))
        runs[f"exported C, {key}"] = c_call(simulator, model.n_x, t_end)
    for title, candidate in (("compiled functions", rs.compiled(model)),
                             ("CasADi's virtual machine", model)):  # fmt: skip
        runs[f"IDAS, {title}"] = lambda r, m=candidate: state_of(
            rs.simulate(m, [0, t_end], rs.Idas(rtol=r, atol=r / 100))
        )
    chosen = {key: fastest(run, error) for key, run in runs.items()}
    count = 20 if name == "single" else 1
    contenders = {"hand-written C, fixed steps of order 8": lambda: handwritten.seconds_of_rk8(
        hand, scene, t_end, steps)}  # fmt: skip
    contenders |= {key: lambda run=run, key=key: cpu(lambda: run(chosen[key]), count)
                   for key, run in runs.items()}  # fmt: skip
    errors = {key: error(run(chosen[key])) for key, run in runs.items()}
    errors |= {"hand-written C, fixed steps of order 8": error(
        handwritten.rk8(hand, scene, t_end, steps))}  # fmt: skip
    settings = {key: f"rtol {value:.1e}" for key, value in chosen.items()}
    settings["hand-written C, fixed steps of order 8"] = f"{steps} steps"
    if peer := exudyn(name, scene):
        contenders["Exudyn, best setting"], state, setting = peer
        errors["Exudyn, best setting"] = error(state)
        settings["Exudyn, best setting"] = setting
    times = medians(contenders)
    return [(name, key, 1e3 * times[key][0], 1e3 * times[key][1], errors[key], settings[key])
            for key in contenders]  # fmt: skip


def c_call(simulator: rs.Simulator, n_x: int, t_end: float) -> Callable[[float], np.ndarray]:
    """The final state at a tolerance, by the C function itself."""
    out = np.zeros(n_x)
    pointer, none = out.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), None

    def run(rtol: float) -> np.ndarray:
        simulator.function(0.0, t_end, none, 1, none, none, none, rtol, rtol / 10, 1, pointer, none)
        return out

    return run


def exudyn(name: str, scene: dict[str, Any]) -> tuple[Callable[[], float], np.ndarray, str] | None:
    """CPU time of Exudyn's solve call, its final state and setting; None if it is not installed."""
    try:
        from peers.exudyn_runner import Setting, System
    except ImportError:
        return None
    node, solver, steps = EXUDYN[name]
    system, setting = System(scene, node), Setting(node, solver, steps)
    state = system.run(setting, scene["t_end"]).state
    return (
        lambda: system.run(setting, scene["t_end"]).cpu_seconds, state,
        f"{solver}, {node} nodes, {steps} steps",
    )  # fmt: skip


def draw(runs: rs.study.Table, built: rs.study.Table) -> Any:
    """Left: CPU time of a simulation at one error; right: time and size of building."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.5, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.7, 1))
    names = list(dict.fromkeys(runs.column("scene")))
    for method, (colour, marker) in _STYLE.items():
        rows = [row for row in runs.rows if row[1] == method]
        left.plot([names.index(row[0]) for row in rows], [row[2] for row in rows], marker,
                  color=colour, label=method, ls=":", lw=0.8, ms=7)  # fmt: skip
    left.set_yscale("log")
    left.set_xticks(range(len(names)), names)
    left.margins(x=0.15)
    left.set_ylabel("CPU time [ms]")
    left.set_title(f"one simulation with an error below {ERROR:g}", fontsize="medium")
    left.legend(fontsize="small", frameon=False, loc="upper left")
    links = built.column("links")
    for column, colour, marker in (("time [s]", "#0072B2", "o"), ("C [MB]", "#D55E00", "s")):
        right.loglog(links, built.column(column), marker + "-", color=colour, label=column)
    right.loglog(links, built.column("C [MB]")[0] * links / links[0], ":", color="#000000",
                 label="in proportion")  # fmt: skip
    right.set_xticks(links, [str(int(n)) for n in links])
    right.set_xlabel("links of a spatial chain")
    right.set_title("from scene to compiled library", fontsize="medium")
    right.legend(fontsize="small", frameon=False)
    for panel in (left, right):
        panel.grid(alpha=0.3, which="major")
        panel.minorticks_off()
    return figure


def main() -> None:
    """Measure, and write table and picture."""
    names: Sequence[str] = ("single", "chain16", "chain256")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        hand = handwritten.build(folder)
        rates = rs.study.Table(
            ("scene", "states", "by hand [ns]", "generated [ns]", "ratio", "ratio of minima",
             "Jacobian / rates"), ("",) * 7,
            tuple(functions(name, hand, folder / f"f_{name}") for name in names),
        )  # fmt: skip
        runs = rs.study.Table(
            ("scene", "method", "median [ms]", "smallest [ms]", "error", "setting"), ("",) * 6,
            tuple(row for name in names for row in simulations(name, hand, folder / f"s_{name}")),
        )  # fmt: skip
    built = rs.study.Table(("links", "time [s]", "C [MB]", "peak memory [GB]"), ("",) * 4,
                           tuple(building(n) for n in LINKS))  # fmt: skip
    target = CHARTS
    target.mkdir(parents=True, exist_ok=True)
    text = "\n\n".join([
        "# The compiler, measured",
        f"Made by `python tests/charts/compiler.py`; CPU time, medians of {REPEATS} in turn.",
        "## One evaluation", rates.to_markdown(),
        f"## One simulation, error below {ERROR:g}", runs.to_markdown(),
        "## From scene to compiled library, and one short simulation", built.to_markdown(),
    ])  # fmt: skip
    (target / "compiler.md").write_text(text + "\n")
    runs.to_csv(target / "compiler.csv")
    draw(runs, built).savefig(target / "compiler.png", dpi=110)
    print(text)


if __name__ == "__main__":
    main()
