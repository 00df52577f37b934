"""Speed, printed and never asserted: run `pytest -m benchmark -s`."""

from __future__ import annotations

import shutil
import statistics
import subprocess
import time
from pathlib import Path

import pytest
from paths import MODELS
from scenes import reference
from scenes.small import chain

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file

pytestmark = pytest.mark.benchmark

_LOOP = """
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <time.h>
#include "NAME.h"
int main(void) {
  double x[NX], rates[NX], sum = 0;
  NAME_defaults(x, 0, 0, 0);
  for (int i = 0; i < NX; ++i) x[i] += 0.1 * ((7 * i) % 11 - 5) / 5; /* angles away from zero */
  struct timespec a, b;
  clock_gettime(CLOCK_MONOTONIC, &a);
  for (int i = 0; i < CALLS; ++i) {
    NAME_FUNCTION(0, x, 0, 0, 0, rates);
    sum += rates[NX - 1];
    x[0] += 1e-9 * sum; /* so that no call can be left out */
  }
  clock_gettime(CLOCK_MONOTONIC, &b);
  printf("%g %g\\n", ((b.tv_sec - a.tv_sec) * 1e9 + (b.tv_nsec - a.tv_nsec)) / CALLS, sum);
  return 0;
}
"""


def nanoseconds_in_c(model: rs.Model, folder: Path, calls: int = 1_000_000) -> float:
    """Median over 7 runs of the time of one call of the exported rates, compiled with -O2."""
    rs.export_c(model, folder, ["ode"])
    text = _LOOP.replace("NAME_FUNCTION", f"{model.name}_ode").replace("NAME", model.name)
    text = text.replace("NX", str(model.n_x)).replace("CALLS", str(calls))
    (folder / "loop.c").write_text(text)
    command = ["cc", "-O2", "-std=c99", "loop.c", f"{model.name}.c", "-lm", "-o", "loop"]
    subprocess.run(command, cwd=folder, check=True)
    runs = [subprocess.run(["./loop"], cwd=folder, capture_output=True, text=True, check=True)
            for _ in range(7)]  # fmt: skip
    return statistics.median(float(run.stdout.split()[0]) for run in runs)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("name", ["single", "single_consistent", "coupled"])
def test_rates_of_one_body_and_connector(name: str, tmp_path: Path) -> None:
    model = rs.compile_scene(reference.build(name))
    took = nanoseconds_in_c(model, tmp_path / name)
    print(f"\nrates of {name}, compiled C: {took:.0f} ns a call (goal: below 250)")
    assert took > 0


@pytest.mark.parametrize("rtol", [1e-6, 1e-8])
def test_mini_by_idas(rtol: float) -> None:
    model = rs.compile_scene(reference.build("mini"))
    integrator = rs.Idas(rtol=rtol, atol=rtol * 1e-2)
    times = []
    for _ in range(11):
        started = time.perf_counter()
        rs.simulate(model, 1.0, integrator)
        times.append(time.perf_counter() - started)
    took = 1e3 * statistics.median(times)
    print(f"\nmini by IDAS at rtol {rtol:g}: {took:.2f} ms (goal: below 5)")
    assert min(times) > 0


def test_sizes_of_minimal_models() -> None:
    scenes = {
        "`mini`": reference.build("mini"),
        "planar pendulum": chain(1, rs.Standard()),
        "planar chain of 20": chain(20, rs.Standard()),
        "the same, one marker off the plane": chain(20, rs.Standard(), 0.1),
        "`engine_mounts`": load_model_file(MODELS / "engine_mounts.py").scene(),
    }
    print()
    for name, scene in scenes.items():
        full, small = rs.compile_scene(scene, minimal=False), rs.compile_scene(scene)
        print(
            f"| {name} | {full.n_x} | {small.n_x} | {full.operations('ode')} "
            f"| {small.operations('ode')} |"
        )
        assert small.n_x <= full.n_x


def test_time_of_the_passes() -> None:
    """A planar chain of 100 links, from scene to minimal model."""
    for law in (rs.Standard(), rs.Consistent()):
        scene, times = chain(100, law), []
        for _ in range(3):
            started = time.perf_counter()
            model = rs.compile_scene(scene)
            times.append(time.perf_counter() - started)
        name = type(law).__name__
        print(f"\nplanar chain of 100, {name}: {statistics.median(times):.2f} s (goal: below 5)")
        assert model.n_x == 600


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_long_spatial_chain_from_scene_to_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RBSD_SYM_CACHE", str(tmp_path / "cache"))
    started = time.perf_counter()
    model = rs.compile_scene(chain(256, rs.Standard(), 0.1))
    artefact = rs.export_c(model, tmp_path / "chain")
    rs.load_c(artefact)
    size = (artefact.folder / "chain.c").stat().st_size
    took = time.perf_counter() - started
    print(f"\nspatial chain of 256, to a compiled library: {took:.1f} s, {size / 1e6:.2f} MB of C")
    assert model.kernels
