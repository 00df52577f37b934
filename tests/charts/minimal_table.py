"""What a minimal model saves: sizes and times of a scene, full against minimal, as a table."""

from __future__ import annotations

import ctypes
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import rbsd_sym as rs
from rbsd_sym.model.values import make_experiment

RUNS = 5
IDAS = rs.Idas(rtol=1e-8, atol=1e-10)
IN_C = rs.Dop853(rtol=1e-6, atol=1e-8)
_REPEATED = 5e-3  # s of CPU time that one measurement takes at least


@dataclass(frozen=True)
class Row:
    """Quantities of one scene by their title: (full, minimal)."""

    scene: str
    t_end: float
    values: Mapping[str, tuple[float, float]]


def cpu_ms(action: Callable[[], object]) -> float:
    """CPU time of one call, of this thread: numpy's helpers also burn time while they wait."""
    started = time.thread_time()
    action()
    return 1e3 * (time.thread_time() - started)


def medians(timers: Sequence[Callable[[], float]]) -> list[float]:
    """Median of each timer; they take turns, so that a busy machine is unfair to none.

    The first round is not counted: it builds what is kept.
    """
    rounds = [[timer() for timer in timers] for _ in range(RUNS + 1)]
    return [statistics.median(column) for column in zip(*rounds[1:], strict=True)]


def exported_bytes(model: rs.Model, folder: Path) -> int:
    """Size of the C source with the functions that are exported by default."""
    rs.export_c(model, folder)
    return (folder / f"{model.name}.c").stat().st_size


def simulator_timer(model: rs.Model, t_end: float, folder: Path) -> Callable[[], float]:
    """A timer of one run of the exported simulator, the C call alone."""
    simulator = rs.load_simulator(rs.export_simulator(model, folder, IN_C))
    out, none = np.zeros(model.n_x), None
    pointer = out.ctypes.data_as(ctypes.POINTER(ctypes.c_double))

    def run() -> None:
        code = simulator.function(
            0.0, t_end, none, 1, none, none, none, IN_C.rtol, IN_C.atol, 1, pointer, none
        )
        assert code == 0
        assert np.isfinite(out).all()

    count = 1 + int(1e3 * _REPEATED / cpu_ms(run))
    return lambda: cpu_ms(lambda: [run() for _ in range(count)]) / count


def measure(name: str, scene: rs.Scene, t_end: float, folder: Path) -> Row:
    """Everything about one scene; times are CPU times in ms for a run of `t_end` seconds.

    `simulate` is the whole call; `of it IDAS` leaves out the check of the motion that a minimal
    model has left out. `Dop853 in C` is the exported simulator.
    """
    models = [rs.compile_scene(scene, minimal=minimal) for minimal in (False, True)]
    whole, idas, in_c = [], [], []
    for model, kind in zip(models, ("full", "minimal"), strict=True):
        experiment = make_experiment(model, t_end, {}, {}, {})
        whole.append(lambda m=model: cpu_ms(lambda: rs.simulate(m, t_end, IDAS)))
        idas.append(lambda m=model, e=experiment: cpu_ms(lambda: IDAS.solve(m, e)))
        in_c.append(simulator_timer(model, t_end, folder / kind / "simulator"))
    found = {
        "states": [model.n_x for model in models],
        "instructions": [model.operations("ode") for model in models],
        "bytes of C": [
            exported_bytes(model, folder / kind / "all")
            for model, kind in zip(models, ("full", "minimal"), strict=True)
        ],
        "simulate": medians(whole),
        "of it IDAS": medians(idas),
        "Dop853 in C": medians(in_c),
    }
    return Row(name, t_end, {title: (v[0], v[1]) for title, v in found.items()})


def markdown(rows: list[Row]) -> str:
    """The rows as a Markdown table: full, minimal and their ratio for each quantity."""
    head = ["scene", "t_end, s"]
    for title in rows[0].values:
        unit = "" if title in ("states", "instructions", "bytes of C") else ", ms"
        head += [f"{title}{unit}: full", "minimal", "ratio"]
    lines = [head, ["---"] * len(head)]
    for row in rows:
        cells = [row.scene, f"{row.t_end:g}"]
        for full, small in row.values.values():
            cells += [_number(full), _number(small), f"{full / small:.1f}"]
        lines.append(cells)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.3g}"
