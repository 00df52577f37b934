"""Compiled models, derivatives by name in C; and of all exports: folders, cache, threads."""

from __future__ import annotations

import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.comparing import by_name, close, points, states
from helpers.compilers import C99, COMPILERS, built, files_of
from paths import environment
from scenes import small
from scenes.driven import GRID
from scenes.simulators import DOP, ERK, ROS, driven, hub, kelvin, servo

import rbsd_sym as rs

QUICK = ["-O0"]
every_method = pytest.mark.parametrize("method", [DOP, ROS, ERK], ids=by_name)
pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")


@cache
def massless(layout: str = "flat") -> rs.Model:
    """13 states and 7 unknowns."""
    return rs.compile_scene(small.massless(), layout=layout)


MODELS: dict[str, Callable[[], rs.Model]] = {
    "driven": driven, "servo": servo, "massless": massless,
    "hub of kernels": lambda: hub("kernels"),
    "massless of kernels": lambda: massless("kernels"),
}  # fmt: skip
every_model = pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.slow] if name == "massless" else []) for name in MODELS
])  # fmt: skip


@every_model
def test_functions_are_those_of_the_model(name: str) -> None:
    ours = MODELS[name]()
    theirs = rs.compiled(ours, flags=QUICK)
    rates = ["ode", "alg"] if ours.n_z else ["ode"]
    assert set(rates) <= set(theirs.library)
    assert (theirs.digest, theirs.calls) == (ours.digest, True)
    symbols = [ca.MX.sym(v, ours.function("ode").size1_in(i)) for i, v in enumerate("txzup")]
    rng = np.random.default_rng(0)
    for f in rates:
        value = theirs.function(f)(*symbols)
        for point in points(ours):
            close(ours.function(f)(*point), theirs.function(f)(*point), 1e-13)
            for i, v in enumerate("txzup"):
                a, b = (m.function(f"d{f}_d{v}")(*point) for m in (ours, theirs))
                assert a.sparsity() == b.sparsity()
                close(a, b, 1e-13)
                seen = ca.Function("seen", symbols, [ca.jacobian(value, symbols[i])])
                close(a, seen(*point), 1e-13)
            extra = rng.standard_normal(ours.function(f"{f}_hessian").size1_in(5))
            close(*(m.function(f"{f}_hessian")(*point, extra) for m in (ours, theirs)))


@pytest.mark.parametrize("method", [rs.Idas(), ROS, ERK, DOP], ids=by_name)
@pytest.mark.parametrize("pull", [
    2.0, lambda t: 3 * np.sin(4 * t), lambda t: 3 * math.sin(4 * t), ([0, 0.7, 1.5], [1, -2, 3]),
], ids=["constant", "traced", "called", "samples"])  # fmt: skip
def test_trajectories_with_inputs(pull: Any, method: Any) -> None:
    given = {"inputs": {"pull": pull}, "params": {"k": 55.0}}
    ours, theirs = (rs.simulate(m, GRID, method, **given)
                    for m in (driven(), rs.compiled(driven())))  # fmt: skip
    assert ours.stats["steps"] == theirs.stats["steps"] > 10
    for name in ("b.p_x", "b.v_x", "pull", "k", "energy", "c.force_local", "b.position"):
        assert np.abs(ours[name] - theirs[name]).max() < 1e-9, name
    assert np.ptp(theirs["b.p_x"]) > 0.1


@every_model
@pytest.mark.parametrize("method", [rs.Idas(), ROS, ERK, DOP], ids=by_name)
def test_trajectories(name: str, method: Any) -> None:
    ours = MODELS[name]()
    theirs = rs.compiled(ours, flags=QUICK)
    if ours.n_z and method in (ERK, DOP):
        with pytest.raises(ValueError, match="7 algebraic unknowns"):
            rs.simulate(theirs, 0.5, method)
        return
    a, b = (rs.simulate(m, np.linspace(0.2, 0.6, 9), method) for m in (ours, theirs))
    if isinstance(method, rs.Idas):
        assert (a.stats["steps"], a.stats["jacobians"]) == (b.stats["steps"], b.stats["jacobians"])
    assert np.abs(states(ours, a) - states(ours, b)).max() < 1e-8
    assert np.abs(a["energy"] - b["energy"]).max() < 1e-6 * np.abs(a["energy"]).max()


@pytest.mark.parametrize("method", [rs.Rosenbrock(1e-9, 1e-11), rs.Idas(1e-10, 1e-12)])
def test_events(method: Any) -> None:
    """CasADi's methods search events by derivatives that compiled functions do not have."""
    ball = rs.RigidBody("ball", 1, (1, 1, 1), position=(0, 0, 1))
    floor = rs.RigidBodySpringDamper(
        "floor", rs.Marker(rs.GROUND), rs.Marker("ball"), 0, effects=rs.Impact(2, 0.5)
    )
    model = rs.compiled(rs.compile_scene(rs.Scene("drop", [ball], [floor], gravity=(0, 0, -9.81))))
    run = rs.simulate(model, [0, 0.8], method)
    fall = np.sqrt(2 / 9.81)
    np.testing.assert_allclose([t for t, _ in run.events], [fall], rtol=1e-9)
    assert run["ball.velocity"][-1, 2] == pytest.approx(9.81 * (fall / 2 - (0.8 - fall)), rel=1e-8)


def test_a_model_that_stands_still() -> None:
    still = rs.compile_scene(rs.Scene("still", [rs.RigidBody("b", 1, [1, 1, 1])], []))
    assert len(rs.simulate(rs.compiled(still), 1.0)["b.position"]) == 201


def test_exports_of_a_compiled_model(tmp_path: Path) -> None:
    """They are those of the plain model; C that calls the library would not be free of it."""
    for name, model in (("plain", driven()), ("compiled", rs.compiled(rs.compiled(driven())))):
        for i, method in enumerate((DOP, ROS)):
            rs.export_simulator(model, tmp_path / name / str(i), method, method is DOP)
        rs.export_c(model, tmp_path / name / "model", ["ode", "dode_dx", "ode_hessian"])
    assert files_of(tmp_path / "plain") == files_of(tmp_path / "compiled")


def build_in(folder: str) -> list[float]:
    """Run by another process: rates of a compiled model, its library built in a cache folder."""
    os.environ["RBSD_SYM_CACHE"] = folder
    model = rs.compiled(driven())
    return [float(v) for v in np.array(model.function("ode")(0, [1, 2], [], [3], [4])).ravel()]


def test_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes and threads at once, once built never again, nothing half is ever loaded."""
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setenv("RBSD_SYM_CACHE", str(folder))
    (folder / "oscillator-0.part").write_bytes(b"\x7fELF half a library")
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = list(pool.map(build_in, [str(folder)] * 2))
    with ThreadPoolExecutor(2) as pool:
        models = list(pool.map(lambda _: rs.compiled(driven(), flags=QUICK), range(4)))
    expected = np.array(driven().function("ode")(0, [1, 2], [], [3], [4])).ravel()
    for rates in (*found, *(np.array(m.function("ode")(0, [1, 2], [], [3], [4])) for m in models)):
        np.testing.assert_allclose(np.ravel(rates), expected, rtol=1e-14)
    stamps = {p: p.stat().st_mtime_ns for p in folder.iterdir()}
    assert sorted(p.suffix for p in stamps) == [".part", ".so", ".so"]
    rs.compiled(driven())
    assert {p: p.stat().st_mtime_ns for p in folder.iterdir()} == stamps
    with pytest.raises(RuntimeError, match="failed:"):
        rs.compiled(driven(), flags=["--no-such-flag"])
    assert len(list(folder.iterdir())) == 3
    monkeypatch.setenv("RBSD_SYM_CACHE", str(tmp_path / "other"))
    (tmp_path / "other").mkdir()
    for path in folder.glob("*.so"):
        (tmp_path / "other" / path.name).touch()
    with pytest.raises(RuntimeError, match="oscillator-"):
        rs.compiled(driven())


@pytest.mark.parametrize("variable", ["", "icc"])
def test_no_compiler(variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", variable)
    folder = rs.export_simulator(driven(), tmp_path / "simulator", DOP)
    for build in (lambda: rs.compiled(driven()), lambda: rs.load_simulator(folder)):
        with pytest.raises(rs.CompilerMissing, match=r"no C compiler found .*works without"):
            build()


NAMES = ["dode_dt", "ode_hessian", "ode_forward", "ode_adjoint"]
NAMES += [name.replace("ode", "alg") for name in NAMES]


@pytest.mark.parametrize(("layout", "in_space"), [
    ("flat", False), ("kernels", True), pytest.param("flat", True, marks=pytest.mark.slow),
    pytest.param("kernels", False, marks=pytest.mark.slow),
])  # fmt: skip
def test_derivatives_by_name_in_c(layout: str, in_space: bool, tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    model = hub(layout) if in_space else massless(layout)
    wanted = NAMES if model.n_z else [*NAMES[:4], "dout_dt", "out_forward"]
    artefact = rs.export_c(model, tmp_path / model.name, wanted)
    library = rs.load_c(artefact, model, flags=[*QUICK, *C99[1:]])
    assert library.functions == tuple(wanted)
    for name in wanted:
        ours, theirs = model.function(name), library.function(name)
        for point in points(model, 2):
            extra = [rng.standard_normal(ours.size1_in(5))] if ours.n_in() > 5 else []
            a, b = ours(*point, *extra), theirs(*point, *extra)
            assert a.nnz() == b.nnz() or "hessian" not in name
            close(a, b, 1e-13)
    assert np.array(model.function("dode_dt")(*points(model, 1)[0])).any() == (not model.n_z)


_PROGRAM = """
#include <stdio.h>
#include <stdlib.h>
#include "oscillator.h"
#include "oscillator_simulate.h"
enum { POINTS = 7, N = OSCILLATOR_N_X, N_W = N + 2 };
static double *numbers(size_t n) { return (double *)malloc(n * sizeof(double)); }
int main(void)
{
  const double times[3] = {0.2, 0.5, 0.9}, pull[3] = {2, -2, 3}, x[N] = {0.3, 0.5}, p[1] = {90};
  const double l[N] = {0.7, -3}, v[N_W] = {1, 2, 3, 4};
  double *out = numbers(POINTS * N), nan[1] = {0}, rates[N], gradient[N_W];
  double hessian[OSCILLATOR_ODE_HESSIAN_NNZ];
  const int *first = oscillator_ode_hessian_colind(), *row = oscillator_ode_hessian_row();
  oscillator_stats stats;
  nan[0] /= nan[0];
  if (oscillator_ode_hessian(0.1, x, NULL, pull, p, l, hessian)) return 1;
  if (oscillator_ode_forward(0.1, x, NULL, pull, p, v, rates)) return 2;
  if (oscillator_ode_adjoint(0.1, x, NULL, pull, p, l, gradient)) return 3;
  if (oscillator_simulate(0.1, 1, NULL, NULL, NULL, 1e-8, 1e-10, POINTS, out, NULL)) return 4;
  if (oscillator_simulate_sampled(-1, 1, x, 3, times, pull, p, 1e-6, 1e-8, POINTS, out, &stats))
    return 5;
  if (oscillator_simulate(1, 0, x, NULL, p, 1e-8, 1e-10, POINTS, out, &stats)
      != OSCILLATOR_SIM_BAD_ARGUMENT) return 6;
  if (!oscillator_simulate(0, 1, x, NULL, nan, 1e-8, 1e-10, POINTS, out, NULL)) return 7;
#ifdef SENSITIVITIES
  double x1[N], dx1[N], g[N_W];
  if (oscillator_simulate_forward(0, 1, x, pull, p, 1e-6, 1e-8, v, x1, dx1, &stats)) return 8;
  const int n = (int)stats.steps;
  double *tape = numbers(n * (N + 2));
  if (oscillator_simulate_adjoint(0, 1, x, pull, p, 1e-6, 1e-8, l, n, tape, x1, g, NULL)) return 9;
  if (oscillator_simulate_adjoint(0, 1, x, pull, p, 1e-6, 1e-8, l, n - 1, tape, x1, g, NULL)
      != OSCILLATOR_SIM_TAPE_FULL) return 10;
  free(tape);
#endif
  free(out);
  for (int j = 0; j < N_W; ++j)
    for (int k = first[j]; k < first[j + 1]; ++k) printf("%d %d %.17g\\n", row[k], j, hessian[k]);
  for (int i = 0; i < N; ++i) printf("5 %d %.17g\\n", i, rates[i]);
  for (int i = 0; i < N_W; ++i) printf("6 %d %.17g\\n", i, gradient[i]);
  return 0;
}
"""


@every_method
def test_programs_in_c_and_cpp(method: Any, tmp_path: Path) -> None:
    """Every function of both exports, under sanitizers, with arrays of the exact size.

    l' ode = l_x v + l_v (pull - k x - d v) / m, where only k and x have a second derivative.
    """
    defines = ["-DSENSITIVITIES"] if method is DOP else []
    rs.export_simulator(driven(), tmp_path, method, bool(defines))
    rs.export_c(driven(), tmp_path / "model", NAMES[1:4])
    for path in (tmp_path / "model").glob("oscillator.?"):
        shutil.copy(path, tmp_path)
    sources, m, d, k, x = ["oscillator_simulate.c", "oscillator.c"], 2.0, 0.8, 90.0, 0.3
    numbers = {(0, 3): 3 / m, (3, 0): 3 / m, (5, 0): 2.0, (5, 1): (3 - k - d * 2 - 4 * x) / m,
               (6, 0): 3 * k / m, (6, 1): 0.7 + 3 * d / m, (6, 2): -3 / m, (6, 3): 3 * x / m}
    sanitize = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
    commands = [[COMPILERS[0], *C99, *sanitize, *defines, "main.c", *sources]]
    if shutil.which("g++"):
        subprocess.run([COMPILERS[0], *C99, "-c", *sources], cwd=tmp_path, check=True)
        commands += [["g++", *C99[1:], *defines, "main.cpp", *(f"{s[:-2]}.o" for s in sources)]]
    for command in commands:
        (tmp_path / "main.c").write_text(_PROGRAM)
        (tmp_path / "main.cpp").write_text(_PROGRAM)
        rows = [line.split() for line in built(tmp_path, *command)]
        found = {(int(i), int(j)): float(value) for i, j, value in rows}
        assert found == pytest.approx(numbers, rel=1e-13)


@every_method
def test_simulators_of_both_layouts(method: Any, tmp_path: Path) -> None:
    ends = []
    for layout in ("flat", "kernels"):
        artefact = rs.export_simulator(hub(layout), tmp_path / layout, method)
        found = rs.load_simulator(artefact, flags=QUICK)(
            0.6, params={"k": 250.0}, inputs={"F": ([0, 0.3, 0.7], [1, -2, 3])}, points=9
        )
        ends.append(states(hub(), found))
    assert np.abs(ends[0] - ends[1]).max() < 1e-9


def test_trajectories_of_simulators(tmp_path: Path) -> None:
    """Columns, outputs with a model, files, restarts."""
    artefact = rs.export_simulator(driven(), tmp_path, DOP)
    given = {"params": {"k": 50.0}, "inputs": {"pull": 3.0}}
    simulator, bare = rs.load_simulator(artefact, driven()), rs.load_simulator(tmp_path)
    found, same = simulator(2.0, **given, points=40), rs.simulate(driven(), GRID, DOP, **given)
    assert list(found.columns) == ["b.p_x", "b.v_x", "pull"]
    for name in ("b.p_x", "pull", "k", "energy", "b.position", "c.force_local", "b.p_z"):
        assert found[name].shape == same[name].shape
        assert np.abs(found[name] - same[name]).max() < 1e-11, name
    assert found.column("b.v_x").unit == "m/s"
    assert (found.parameters, found.digest) == ({"k": 50.0}, driven().digest)
    with pytest.raises(ValueError, match=r"no column 'energy'; it holds b.p_x, b.v_x, pull"):
        bare(2.0)["energy"]
    loaded = rs.Trajectory.load(found.save(tmp_path / "run"))
    assert np.array_equal(loaded["energy"], found["energy"])
    half = simulator(1.0, **given, points=20)
    rest = bare(2.0, start=half.state_at_end, **given, points=20, t_start=1.0)
    assert np.abs(rest["b.p_x"] - found["b.p_x"][20:]).max() < 1e-8


def test_restart_with_unknowns(tmp_path: Path) -> None:
    simulator = rs.load_simulator(rs.export_simulator(kelvin(), tmp_path, ROS))
    half = simulator(0.2, points=2)
    rest = simulator(0.4, start=half.state_at_end, points=2, t_start=0.2)
    assert rest["a.p_x"][-1] == pytest.approx(simulator(0.4)["a.p_x"][-1], rel=1e-7)


@every_method
def test_threads_do_not_disturb_each_other(method: Any, tmp_path: Path) -> None:
    model = driven() if method is ROS else hub()
    simulator = rs.load_simulator(rs.export_simulator(model, tmp_path, method), flags=["-O1"])

    def run(k: float) -> bytes:
        return states(model, simulator(3.0, params={"k": k}, points=20)).tobytes()

    jobs = [20.0 + i for i in range(25)]
    alone = [run(k) for k in jobs]
    assert len(set(alone)) == len(jobs)
    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(run, jobs * 4)) == alone * 4


def test_other_processes(tmp_path: Path) -> None:
    """A simulator is sent as it is; what comes back is the same to the bit."""
    simulator = rs.load_simulator(rs.export_simulator(driven(), tmp_path, DOP), driven())
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = list(pool.map(simulator, [1.0, 2.0, 3.0, 4.0]))
    for t_end, theirs in zip([1.0, 2.0, 3.0, 4.0], found, strict=True):
        assert theirs["b.p_x"].tobytes() == simulator(t_end)["b.p_x"].tobytes()
        with pytest.raises(ValueError, match="no column 'energy'"):
            theirs["energy"]


def test_what_has_no_simulator(tmp_path: Path) -> None:
    refused = [(massless(), method, f"7 algebraic unknowns, and {by_name(method)} integrates ODEs")
               for method in (DOP, ERK)]  # fmt: skip
    still = rs.compile_scene(rs.Scene("still", [rs.RigidBody("b", 1, [1, 1, 1])], []))
    refused += [(still, DOP, "'still': no states"), (driven(), rs.Idas(), "Idas cannot be written")]
    for model, method, words in refused:
        with pytest.raises(ValueError, match=words):
            rs.export_simulator(model, tmp_path / "new", method)
    with pytest.raises(ValueError, match="Rosenbrock has no sensitivities"):
        rs.export_simulator(driven(), tmp_path / "new", ROS, sensitivities=True)
    assert not (tmp_path / "new").exists()


def test_folders_of_two_kinds(tmp_path: Path) -> None:
    model, both = driven(), (lambda f: rs.export_c(driven(), f),
                             lambda f: rs.export_simulator(driven(), f, DOP))  # fmt: skip
    for first, second, words in ((*both, "a model, not a simulator"),
                                 (*both[::-1], "a simulator, not a model")):  # fmt: skip
        folder = tmp_path / words
        first(folder)
        before = files_of(folder)
        with pytest.raises(ValueError, match=f"holds {words}; choose another folder"):
            second(folder)
        assert files_of(folder) == before
    of_model, folder = tmp_path / "a model, not a simulator", tmp_path / "a simulator, not a model"
    with pytest.raises(ValueError, match="holds a simulator; use load_simulator"):
        rs.load_c(folder)
    for wrong in (of_model, tmp_path):
        with pytest.raises(ValueError, match=r"holds a model; use load_c|no readable manifest"):
            rs.load_simulator(wrong)
    (folder / "notes.txt").write_text("mine")
    rs.export_simulator(model, folder, ROS)  # the same kind: replaced
    assert (folder / "notes.txt").read_text() == "mine"
    assert "casadi" in (folder / "oscillator_simulate.c").read_text()
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "oscillator_simulate.c").write_text("mine")
    with pytest.raises(ValueError, match=r"oscillator_simulate.c, which rbsd_sym did not write"):
        both[1](tmp_path / "foreign")
    assert files_of(tmp_path / "foreign") == {"oscillator_simulate.c": b"mine"}


def test_stale_and_edited_folders(tmp_path: Path) -> None:
    rs.export_simulator(driven(), tmp_path, DOP)
    with pytest.raises(ValueError, match=r"does not match .*run export_simulator\("):
        rs.load_simulator(tmp_path, servo())
    for name in ("oscillator_simulate.h", "oscillator_simulate.c"):
        rs.export_simulator(driven(), tmp_path, DOP)
        with (tmp_path / name).open("a") as file:
            file.write("\n")
        with pytest.raises(ValueError, match=f"{name} is not the file that was written"):
            rs.load_simulator(tmp_path)
        (tmp_path / name).unlink()
        with pytest.raises(ValueError, match=f"{name} is missing; export the model again"):
            rs.load_simulator(tmp_path)


_EXPORT = """
import sys
import scenes.simulators as s
import rbsd_sym as rs
for layout in ("flat", "kernels"):
    rs.export_simulator(s.hub(layout), f"{sys.argv[1]}/{layout}", s.DOP, True)
for method in (s.ROS, s.ERK):
    rs.export_simulator(s.driven(), f"{sys.argv[1]}/{type(method).__name__}", method)
"""


def test_exports_are_deterministic(tmp_path: Path) -> None:
    for seed in ("1", "2"):
        command = [sys.executable, "-c", _EXPORT, str(tmp_path / seed)]
        subprocess.run(command, check=True, env=environment(PYTHONHASHSEED=seed))
    assert len(files_of(tmp_path / "1")) == 20
    assert files_of(tmp_path / "1") == files_of(tmp_path / "2")
