"""The C export: builds cleanly, equals the model, is deterministic, stays in its folder."""

from __future__ import annotations

import difflib
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from helpers.compilers import C99, COMPILERS, files_of
from oracles import closed_forms
from paths import MODELS, ROOT
from scenes import reference

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file

needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler")


@pytest.fixture(scope="module")
def engine() -> rs.Model:
    """A model with an input, a parameter, loads and rotated joint frames."""
    return rs.compile_scene(load_model_file(MODELS / "engine_mounts.py").scene())


def random_arguments(model: rs.Model, seed: int) -> list[np.ndarray]:
    """t, x, z, u, p near the start."""
    rng = np.random.default_rng(seed)
    x = np.array([label.start for label in model.x_labels])
    p = np.array([label.start for label in model.dae.p_labels])
    x = x + 0.1 * rng.standard_normal(model.n_x)
    return [np.array(0.3), x, np.zeros(0), rng.standard_normal(model.n_u), p]


@needs_compiler
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("name", ["mini", "single_consistent", "pair_intrinsic"])
def test_builds_without_a_warning_and_prints_what_python_says(
    compiler: str, name: str, tmp_path: Path
) -> None:
    model = rs.compile_scene(reference.build(name))
    rs.export_c(model, tmp_path)
    build = [compiler, *C99, "example.c", f"{name}.c", "-lm", "-o", "example"]
    subprocess.run(build, cwd=tmp_path, check=True)
    run = ["./example"]
    printed = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True, check=True)
    values = dict(line.split(" = ") for line in printed.stdout.splitlines())
    x = [label.start for label in model.x_labels]
    rates = np.array(model.function("ode")(0, x, [], [], [])).reshape(-1)
    jacobian = np.array(model.function("dode_dx")(0, x, [], [], []))
    for i, rate in enumerate(rates):
        assert float(values[f"ode[{i}]"]) == pytest.approx(rate, rel=1e-13, abs=1e-13)
    printed_jacobian = np.zeros_like(jacobian)
    for key, value in values.items():
        if key.startswith("dode_dx"):
            i, j = key[8:-1].split(",")
            printed_jacobian[int(i), int(j)] = float(value)
    np.testing.assert_allclose(printed_jacobian, jacobian, rtol=1e-13, atol=1e-13)


_RUNGE_KUTTA = """
#include <stdio.h>
#include "mini.h"
int main(void) {
  double x[MINI_N_X], y[MINI_N_X], k[4][MINI_N_X];
  const double h = 1e-4, part[4] = {0, 0.5, 0.5, 1};
  mini_defaults(x, NULL, NULL, NULL);
  for (int step = 0; step < 10000; ++step) {
    for (int s = 0; s < 4; ++s) {
      for (int i = 0; i < MINI_N_X; ++i) y[i] = x[i] + (s ? part[s] * h * k[s - 1][i] : 0);
      if (mini_ode(step * h, y, NULL, NULL, NULL, k[s])) return 1;
    }
    for (int i = 0; i < MINI_N_X; ++i)
      x[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
  }
  printf("%.17g", x[MINI_X_BODY_P_Y]);
  return 0;
}
"""


@needs_compiler
@pytest.mark.parametrize("minimal", [True, False])
def test_mini_integrated_in_c_meets_the_closed_form(minimal: bool, tmp_path: Path) -> None:
    """Classical Runge-Kutta in C with h w = 2e-3, which leaves (h w)^4 / 120 w t = 4e-12."""
    scene = load_model_file(MODELS / "mini.py").scene()
    rs.export_c(rs.compile_scene(scene, minimal=minimal), tmp_path)
    (tmp_path / "main.c").write_text(_RUNGE_KUTTA)
    build = [COMPILERS[0], *C99, "main.c", "mini.c", "-lm", "-o", "main"]
    subprocess.run(build, cwd=tmp_path, check=True)
    printed = subprocess.run(["./main"], cwd=tmp_path, capture_output=True, text=True, check=True)
    y, _ = closed_forms.damped_oscillator(1.0, 1.0, 500.0, 5.0, 1000.0)
    assert float(printed.stdout) == pytest.approx(float(y), rel=1e-8)


@needs_compiler
def test_library_equals_the_model(engine: rs.Model, tmp_path: Path) -> None:
    artefact = rs.export_c(engine, tmp_path)
    library = rs.load_c(artefact, engine)
    for name in artefact.functions:
        for seed in range(3):
            arguments = random_arguments(engine, seed)
            theirs = np.array(library.function(name)(*arguments))
            ours = np.array(engine.function(name)(*arguments))
            scale = np.abs(ours).max()
            np.testing.assert_allclose(theirs, ours, rtol=1e-13, atol=1e-13 * scale)


@needs_compiler
def test_header_is_fit_for_cpp_and_null_reads_as_nothing(engine: rs.Model, tmp_path: Path) -> None:
    rs.export_c(engine, tmp_path)
    (tmp_path / "main.cpp").write_text(
        '#include "engine_mounts.h"\n#include <cstdio>\n#include <cstring>\nint main() {\n'
        "  double x[ENGINE_MOUNTS_N_X], u[ENGINE_MOUNTS_N_U], p[ENGINE_MOUNTS_N_P];\n"
        "  double r[ENGINE_MOUNTS_N_X];\n"
        "  engine_mounts_defaults(x, nullptr, u, p);\n"
        "  if (engine_mounts_ode(0, x, nullptr, u, p, r)) return 1;\n"
        '  std::printf("%s %.17g %d", ENGINE_MOUNTS_DIGEST, r[ENGINE_MOUNTS_X_ENGINE_V_Z],\n'
        "              ENGINE_MOUNTS_ABI);\n}\n"
    )
    if shutil.which("g++") is None:
        pytest.skip("no C++ compiler")
    subprocess.run(["gcc", *C99, "-c", "engine_mounts.c"], cwd=tmp_path, check=True)
    subprocess.run(
        ["g++", "-Wall", "-Wextra", "-Werror", "-pedantic", "main.cpp", "engine_mounts.o", "-lm"],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    run = subprocess.run(["./a.out"], cwd=tmp_path, capture_output=True, text=True, check=True)
    digest, fall, abi = run.stdout.split()
    assert (digest, abi) == (engine.digest, "1")
    assert float(fall) == pytest.approx(-9.81, rel=1e-12)  # unstretched mounts: it falls freely


@needs_compiler
def test_sanitizers_find_nothing(engine: rs.Model, tmp_path: Path) -> None:
    rs.export_c(engine, tmp_path)
    flags = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
    command = ["gcc", *C99, *flags, "example.c", "engine_mounts.c", "-lm", "-o", "example"]
    subprocess.run(command, cwd=tmp_path, check=True)
    run = subprocess.run(["./example"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith("ode[0]")


@needs_compiler
def test_concurrent_builds_do_not_clash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RBSD_SYM_CACHE", str(tmp_path / "cache"))
    model = rs.compile_scene(reference.build("mini"))
    artefact = rs.export_c(model, tmp_path / "mini")
    with ThreadPoolExecutor(4) as pool:
        libraries = list(pool.map(lambda _: rs.load_c(artefact), range(8)))
    assert len({library.path for library in libraries}) == 1
    assert [p.suffix for p in (tmp_path / "cache").iterdir()] == [".so"]
    stamp = libraries[0].path.stat().st_mtime_ns
    assert rs.load_c(artefact).path.stat().st_mtime_ns == stamp, "the cache is used"
    assert rs.load_c(artefact, flags=["-O0"]).path != libraries[0].path


def test_deterministic_across_processes_and_hash_seeds(tmp_path: Path) -> None:
    script = (
        "import sys, rbsd_sym as rs\n"
        "from rbsd_sym.__main__ import load_model_file\n"
        "from pathlib import Path\n"
        "scene = load_model_file(Path('models/engine_mounts.py')).scene()\n"
        "rs.export_c(rs.compile_scene(scene), sys.argv[1])\n"
    )
    for seed in ("1", "2"):
        subprocess.run(
            [sys.executable, "-c", script, str(tmp_path / seed)],
            cwd=ROOT, check=True, env={**os.environ, "PYTHONHASHSEED": seed},
        )  # fmt: skip
    assert files_of(tmp_path / "1") == files_of(tmp_path / "2")


def test_writes_only_inside_its_folder(engine: rs.Model, tmp_path: Path) -> None:
    (tmp_path / "beside.txt").write_text("mine")
    rs.export_c(engine, tmp_path / "out")
    assert {p.name for p in tmp_path.iterdir()} == {"beside.txt", "out"}
    assert set(files_of(tmp_path / "out")) == {
        "engine_mounts.h", "engine_mounts.c", "example.c", "manifest.json", "README.md",
    }  # fmt: skip
    (tmp_path / "out" / "notes.txt").write_text("mine too")
    rs.export_c(engine, tmp_path / "out")
    assert (tmp_path / "out" / "notes.txt").read_text() == "mine too"


def test_sparse_outputs_and_jacobians_of_outputs(tmp_path: Path) -> None:
    model = rs.compile_scene(reference.build("mini"))
    artefact = rs.export_c(model, tmp_path, ["c0.force_local", "dout_dx", "dode_dx"])
    assert artefact.functions == ("c0.force_local", "dout_dx", "dode_dx")
    header = (tmp_path / "mini.h").read_text()
    assert "int mini_c0_force_local(double t" in header
    manifest = json.loads((tmp_path / "manifest.json").read_text())
    nonzeros = model.expression("dout_dx").nnz()
    assert manifest["functions"]["dout_dx"]["numbers"] == nonzeros


@pytest.mark.parametrize("name", ["mini", "engine_mounts"])
def test_specimens_are_what_is_generated(
    name: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    model = rs.compile_scene(load_model_file(MODELS / f"{name}.py").scene())
    stored = ROOT / "generated" / name
    if request.config.getoption("--update-golden"):
        rs.export_c(model, stored)
    rs.export_c(model, tmp_path / name)
    same_casadi = (
        json.loads((stored / "manifest.json").read_text())["casadi"] == ca.CasadiMeta.version()
    )
    if not same_casadi:
        pytest.skip("specimens were written with another CasADi, whose version stands in them")
    for file in (f"{name}.h", "README.md", "example.c", "manifest.json", f"{name}.c"):
        old, new = (stored / file).read_text(), (tmp_path / name / file).read_text()
        difference = difflib.unified_diff(old.splitlines(), new.splitlines(), "stored", "generated")
        assert old == new, "\n".join(list(difference)[:40]) + "\nrewrite with --update-golden"


def test_scenes_that_move_differently_have_different_digests() -> None:
    def pushed(size: float) -> str:
        body = rs.RigidBody("b", 1, (1, 1, 1))
        load = rs.Load("push", rs.Marker("b"), force=(size, 0, 0))
        return rs.Scene("s", [body], [], [load]).digest

    assert pushed(1.0) != pushed(2.0)
    assert pushed(1.0) == pushed(1.0)
