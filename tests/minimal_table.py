"""What a minimal model saves: sizes and times of a scene, full against minimal, as a table."""

from __future__ import annotations

import statistics
import subprocess
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import rbsd_sym as rs
from rbsd_sym.pipeline import make_experiment

RUNS = 5
IDAS = rs.Idas(rtol=1e-8, atol=1e-10)
_WORK = 1e8  # instructions of all repetitions together: long enough for the clock
_RK4 = """
#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <time.h>
#include "@NAME.h"
static double x[@N], y[@N], k[4][@N], u[@U + 1], p[@P + 1];
int main(void) {
  const double h = @H, part[4] = {0, 0.5, 0.5, 1};
  double size = 0;
  struct timespec a, b;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &a);
  for (int run = 0; run < @REPEATS; ++run) {
    @NAME_defaults(x, NULL, u, p);
    for (int n = 0; n < @STEPS; ++n) {
      for (int s = 0; s < 4; ++s) {
        for (int i = 0; i < @N; ++i) y[i] = s ? x[i] + part[s] * h * k[s - 1][i] : x[i];
        if (@NAME_ode((n + part[s]) * h, y, NULL, u, p, k[s])) return 1;
      }
      for (int i = 0; i < @N; ++i)
        x[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
    }
  }
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &b);
  for (int i = 0; i < @N; ++i) size += fabs(x[i]);
  printf("%.9g %.9g\\n", ((b.tv_sec - a.tv_sec) * 1e3 + (b.tv_nsec - a.tv_nsec) / 1e6) / @REPEATS,
         size);
  return 0;
}
"""


@dataclass(frozen=True)
class Row:
    """Quantities of one scene by their title: (full, minimal)."""

    scene: str
    t_end: float
    step: float
    values: Mapping[str, tuple[float, float]]


def stable_step(model: rs.Model) -> float:
    """A step 1, 2 or 5 times a power of ten with h |lambda| <= 1 at the start.

    The method itself stands up to about 2.7; the rest is for eigenvalues that grow on the way.
    """
    p = np.array([label.start for label in model.dae.p_labels])
    u = [label.start for label in model.dae.u_labels]
    x, z = model.dae.start_values(p)
    eigenvalues = np.linalg.eigvals(np.array(model.function("dode_dx")(0, x, z, u, p)))
    limit = 1 / np.abs(eigenvalues).max()
    power = 10.0 ** np.floor(np.log10(limit))
    return float(max(m * power for m in (1, 2, 5) if m * power <= limit))


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


def rk4_program(model: rs.Model, t_end: float, step: float, folder: Path) -> Path:
    """The compiled program that runs the classical Runge-Kutta method on the exported rates."""
    rs.export_c(model, folder, ["ode"])
    steps = round(t_end / step)
    repeats = 1 + int(_WORK / (4 * steps * (model.operations("ode") + 4 * model.n_x)))
    words = {
        "NAME": model.name, "REPEATS": repeats, "STEPS": steps, "N": model.n_x, "U": model.n_u,
        "P": model.n_p, "H": repr(step),
    }  # fmt: skip
    text = _RK4
    for word, value in words.items():
        text = text.replace(f"@{word}", str(value))
    (folder / "rk4.c").write_text(text)
    command = ["cc", "-O2", "-std=c99", "rk4.c", f"{model.name}.c", "-lm", "-o", "rk4"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "rk4"


def rk4_ms(program: Path) -> float:
    """Time of one integration, as the program measures it.

    Raises:
        ValueError: the result is not finite, so the step was not stable.
    """
    run = subprocess.run([str(program)], capture_output=True, text=True, check=True)
    took, size = (float(word) for word in run.stdout.split())
    if not np.isfinite(size):
        raise ValueError(f"{program}: the step is not stable")
    return took


def measure(name: str, scene: rs.Scene, t_end: float, folder: Path) -> Row:
    """Everything about one scene; times are CPU times in ms for a run of `t_end` seconds.

    `simulate` is the whole call; `of it IDAS` leaves out the check of the motion that a minimal
    model has left out. The step is that of the full model for both.
    """
    models = [rs.compile_scene(scene, minimal=minimal) for minimal in (False, True)]
    step = stable_step(models[0])
    whole, idas, rk4 = [], [], []
    for model, kind in zip(models, ("full", "minimal"), strict=True):
        experiment = make_experiment(model, t_end, {}, {}, {})
        program = rk4_program(model, t_end, step, folder / kind / "ode")
        whole.append(lambda m=model: cpu_ms(lambda: rs.simulate(m, t_end, IDAS)))
        idas.append(lambda m=model, e=experiment: cpu_ms(lambda: IDAS.solve(m, e)))
        rk4.append(lambda p=program: rk4_ms(p))
    found = {
        "states": [model.n_x for model in models],
        "instructions": [model.operations("ode") for model in models],
        "bytes of C": [
            exported_bytes(model, folder / kind / "all")
            for model, kind in zip(models, ("full", "minimal"), strict=True)
        ],
        "simulate": medians(whole),
        "of it IDAS": medians(idas),
        "RK4 in C": medians(rk4),
    }
    return Row(name, t_end, step, {title: (v[0], v[1]) for title, v in found.items()})


def markdown(rows: list[Row]) -> str:
    """The rows as a Markdown table: full, minimal and their ratio for each quantity."""
    head = ["scene", "t_end, s", "step, s"]
    for title in rows[0].values:
        unit = "" if title in ("states", "instructions", "bytes of C") else ", ms"
        head += [f"{title}{unit}: full", "minimal", "ratio"]
    lines = [head, ["---"] * len(head)]
    for row in rows:
        cells = [row.scene, f"{row.t_end:g}", f"{row.step:g}"]
        for full, small in row.values.values():
            cells += [_number(full), _number(small), f"{full / small:.1f}"]
        lines.append(cells)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _number(value: float) -> str:
    return str(value) if isinstance(value, int) else f"{value:.3g}"
