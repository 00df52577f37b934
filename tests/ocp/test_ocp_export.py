"""Problems in C: equal to Python, short, without globals; the solver against closed forms."""

from __future__ import annotations

import re
import shutil
import subprocess
import threading
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from paths import MODELS
from scenes.ocp import FORCE, SLEW, cart, hinged, massless_slew, oscillator, pressed_column

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file
from rbsd_sym.ocp import (
    Code,
    Collocation,
    Free,
    Ipopt,
    Phase,
    Problem,
    Shooting,
    export_problem,
    load_problem,
    optimise,
    transcribe,
)

compiler = pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
C99 = ["-std=c99", "-Wall", "-Werror", "-pedantic"]
NEAR = Collocation(3, 2, input_degree=1)
X, V = "cart.p_x", "cart.v_x"


@cache
def joint(layout: str = "auto") -> rs.Model:
    return rs.compile_scene(hinged(rs.Standard()), layout=layout)


def turned(soft: Any, horizon: Any, layout: str = "auto", start: Any = None) -> Problem:
    """Nonlinear, with rows along the path and at the end, and a cost of every kind."""
    phase = Phase(
        horizon, start=start or {}, path={"joint.torque_local": (-9, 9), "force": (-2, 3)},
        end={"body.quaternion": (0.6, 0.8, 0, 0)},
        integral=lambda v: v["force"] ** 2 + np.sin(v["t"]) * v["joint.torque_local"][0] ** 2,
        end_cost=lambda v: v["soft"] * v["energy"],
    )  # fmt: skip
    return Problem(joint(layout), phase, inputs={"force": Free(low=-3)}, params={"soft": soft},
                   fixed_start=not start)  # fmt: skip


def two_phases(lengths: tuple[Any, Any], k: Any) -> Problem:
    """A link, a horizon that is found, a Param of the stiffness that is not."""
    model = rs.compile_scene(oscillator(rs.Param("k", 4.0, "N/m")))
    first = Phase(lengths[0], integral=FORCE**2, end={"force": 0.1})
    second = Phase(lengths[1], link={V: lambda v: -0.5 * v[V] * v["k"]}, end={X: 0.0},
                   integral=FORCE**2, end_cost=rs.TIME)  # fmt: skip
    return Problem(model, [first, second], inputs={"force": Free()}, params={"k": k})


def massless(length: float) -> Problem:
    phase = Phase(length, end=SLEW.REST, integral=SLEW.PUSH**2 / 2)
    return Problem(rs.compile_scene(massless_slew()), phase, inputs={"push": Free()})


# Each: the problem exported, its method, p in C, and the problem with these numbers in it.
CASES: dict[str, Any] = {
    "collocation": (lambda: turned(3.0, 1.0), NEAR, (1.2, 3.7), lambda: turned(3.7, 1.2)),
    "found": (lambda: turned(Free(3.0, 1, 5), Free(1.0, 0.5)), Collocation((2, ), 3, "radau"), (),
              lambda: turned(Free(3.0, 1, 5), Free(1.0, 0.5))),
    "shooting": (lambda: two_phases((1.0, 1.5), 4.0), Shooting((2, [0, 0.3, 1]), 1, input_degree=1),
                 (0.7, 1.2, 5.0), lambda: two_phases((0.7, 1.2), 5.0)),
    "turned shooting": (lambda: turned(3.0, 1.0), Shooting([[0, 0.3, 1]], 1), (0.8, 4.1),
                        lambda: turned(4.1, 0.8)),
    "kernels": (lambda: turned(3.0, 1.0, "kernels"), Collocation(2, 2), (1.2, 3.7),
                lambda: turned(3.7, 1.2)),
    "phases": (lambda: two_phases((1.0, Free(1.0, 0.5, 3)), 4.0), Collocation((2, 3), 2),
               (0.7, 5.0), lambda: two_phases((0.7, Free(1.0, 0.5, 3)), 5.0)),
    "unknowns": (lambda: massless(5.0), Collocation(3, 2), (4.0,), lambda: massless(4.0)),
}  # fmt: skip


def relative(found: Any, expected: Any) -> float:
    found, expected = (np.array(ca.DM(value)) for value in (found, expected))
    return float(np.abs(found - expected).max() / max(1.0, np.abs(expected).max()))


def library(problem: Problem, method: Any, folder: Path, solver: bool = False) -> Any:
    artefact = export_problem(problem, method, folder, solver)
    return load_problem(artefact, flags=["-O1"] if solver else ["-O0"])


@compiler
@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.slow] if name == "turned shooting" else [])
    for name in CASES
])  # fmt: skip
def test_functions_are_those_of_python(name: str, tmp_path: Path) -> None:
    """For other Params and horizons, at random points; the pattern is that of Python or wider."""
    build, method, p, other = CASES[name]
    found, nlp = library(build(), method, tmp_path), transcribe(other(), method)
    functions, rng = nlp.functions, np.random.default_rng(0)
    assert found.sizes["N_P"] == len(p)
    for scale in (0.0, 0.1):
        w = nlp.bounds["x0"] + scale * rng.standard_normal(nlp.n)
        lam, weight = rng.standard_normal(nlp.m), 1.3
        f, g = functions["nlp"](w, [])
        assert relative(found.objective(w, p), f) < 1e-13
        assert relative(found.constraints(w, p), g) < 1e-13
        assert relative(found.gradient(w, p), functions["nlp_grad_f"](w, [])[1]) < 1e-13
        jacobian = functions["nlp_jac_g"](w, [])[1]
        assert relative(found.jacobian(w, p), jacobian) < 1e-13
        assert (found.jacobian(w, p).sparsity() + jacobian.sparsity()).nnz() == found.sizes[
            "NNZ_JAC"]  # fmt: skip
        hessian = functions["nlp_hess_l"](w, [], weight, lam)
        assert relative(found.hessian(w, p, weight, lam), hessian) < 1e-13
    if p:
        assert abs(found.objective(w) - found.objective(w, p)) > 1e-6  # they matter


@compiler
def test_bounds_and_defaults(tmp_path: Path) -> None:
    found, model = library(turned(3.0, 1.0), NEAR, tmp_path), joint()
    state, p, w = found.defaults()
    assert p == pytest.approx([1.0, 3.0], abs=0)
    assert state == pytest.approx([v.start for v in model.x_labels], abs=0)
    assert [name for name, _, _ in found.labels["p"]] == ["horizon_0", "soft"]
    bounds = transcribe(turned(3.0, 1.0), NEAR).bounds
    assert np.array_equal(w, bounds["x0"])
    for ours, key in zip(found.bounds(), ("lbx", "ubx", "lbg", "ubg"), strict=True):
        assert np.array_equal(ours, bounds[key])
    measured = state + 0.01 * np.arange(len(state))
    names = [v.name for v in model.x_labels]
    turn = [names.index(f"body.q_{axis}") for axis in "wxyz"]
    measured[turn] = 0.5, 0.5, -0.5, 0.5
    start = dict(zip(names, measured.tolist(), strict=True))
    other = transcribe(turned(3.0, 1.0, start=start), NEAR).bounds
    for ours, key in zip(found.bounds(measured), ("lbx", "ubx", "lbg", "ubg"), strict=True):
        assert np.array_equal(ours, other[key])


@compiler
@pytest.mark.parametrize("cc", ["cc", pytest.param("clang", marks=pytest.mark.slow)])
@pytest.mark.parametrize("solver", [False, True])
def test_example_builds_without_a_warning_and_prints(cc: str, solver: bool, tmp_path: Path) -> None:
    if not shutil.which(cc):
        pytest.skip(f"no {cc}")
    export_problem(least(), EFFORT, tmp_path, solver)
    command = [cc, *C99, "-O1", "example.c", "cart_ocp.c", "-lm", "-o", "program"]
    subprocess.run(command, cwd=tmp_path, check=True)
    told = subprocess.run(["./program"], cwd=tmp_path, capture_output=True, text=True, check=True)
    lines = told.stdout.splitlines()
    assert len(lines) == (6 if solver else 3)
    if solver:
        assert lines[3] == "code 0 after 1 iterations"
        assert float(lines[4].split()[-1]) == pytest.approx(6.75, rel=1e-12)
        assert float(lines[5].split()[-1]) == pytest.approx(4.5, rel=1e-12)


def without_tables(text: str) -> str:
    return re.sub(r"static const \w+ \w+(\[\d*\])? ?= ?\s*\{.*?\};", "", text, flags=re.S)


def test_size_does_not_grow_with_the_intervals(tmp_path: Path) -> None:
    """All that grows are tables: patterns, bounds, guess."""
    texts = []
    for n in (10, 40, 160):
        export_problem(SLEW.least_effort(), Collocation(n, 3), tmp_path)
        texts.append((tmp_path / "flexible_slew_ocp.c").read_text())
    bare = [re.sub(r"\d+", "0", without_tables(text)) for text in texts]
    assert bare[0] == bare[1] == bare[2]
    assert len(texts[2]) - len(texts[1]) < 6 * (len(texts[1]) - len(texts[0]))


@compiler
def test_no_mutable_globals_and_no_allocation(tmp_path: Path) -> None:
    export_problem(least(), EFFORT, tmp_path, solver=True)
    text = (tmp_path / "cart_ocp.c").read_text()
    assert "malloc" not in text
    assert "calloc" not in text
    if not shutil.which("nm"):
        pytest.skip("no nm")
    subprocess.run(["cc", "-std=c99", "-fno-pie", "-c", "cart_ocp.c"], cwd=tmp_path, check=True)
    told = subprocess.run(["nm", "cart_ocp.o"], cwd=tmp_path, capture_output=True, text=True,
                          check=True)  # fmt: skip
    # A pattern that is not there is a pointer, 0 for ever, which CasADi forgets to call const.
    moving = [line for line in told.stdout.splitlines() if re.search(r" [bBdDcC] ", line)]
    assert [line for line in moving if not re.search(r"_s\d+$", line)] == []


def test_the_same_bytes_twice_and_only_its_folder(tmp_path: Path) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    for folder in folders:
        export_problem(least(), EFFORT, folder, solver=True)
    assert sorted(p.name for p in folders[0].iterdir()) == [
        "README.md", "cart_ocp.c", "cart_ocp.h", "example.c", "manifest.json"]  # fmt: skip
    for file in folders[0].iterdir():
        assert file.read_bytes() == (folders[1] / file.name).read_bytes()


EFFORT = Collocation(4, 3, input_degree=1)


def least(length: float = 2.0, high: float = np.inf) -> Problem:
    phase = Phase(length, end={X: 3.0, V: 0.0}, integral=FORCE**2 / 2)
    return Problem(rs.compile_scene(cart()), phase, inputs={"force": Free(low=-high, high=high)})


@pytest.fixture(scope="module")
def effort(tmp_path_factory: pytest.TempPathFactory) -> Any:
    if not shutil.which("cc"):
        pytest.skip("needs a C compiler")
    return library(least(), EFFORT, tmp_path_factory.mktemp("effort"), solver=True)


def place(effort: Any, values: dict[str, float]) -> np.ndarray:
    return np.array([values[name] for name, _, _ in effort.labels["x"]])


def test_least_effort_from_any_state_in_any_time(effort: Any) -> None:
    """u(0) = 6 d / T^2 - 4 v / T, cost (12 (d - v T/2)^2 / T^2 + v^2) / (2 T)."""
    w = effort.defaults()[2]
    for x, v, T in ((0.0, 0.0, 2.0), (1.0, -0.7, 1.5), (3.5, 0.4, 4.0)):
        found = effort.solve(place(effort, {X: x, V: v}), w, p=[T])
        d = 3.0 - x
        assert (found.code, found.iterations) == (Code.optimal, 1)
        assert found.u[0] == pytest.approx(6 * d / T**2 - 4 * v / T, rel=1e-11, abs=1e-11)
        cost = (12 * (d - v * T / 2) ** 2 / T**2 + v**2) / (2 * T)
        assert found.cost == pytest.approx(cost, rel=1e-11)
        assert effort.inputs(found.w, 3, 1.0)[0] == pytest.approx(-6 * d / T**2 + 2 * v / T,
                                                                 rel=1e-10)  # fmt: skip
        again = effort.solve(place(effort, {X: x, V: v}), found.w, found.lam, [T])
        assert (again.code, again.iterations, again.programs) == (Code.optimal, 0, 0)


def test_warm_start_moves_by_an_interval(effort: Any) -> None:
    """Blocks of w and lam move by one; the last repeats its inputs from the states at the end."""
    found = effort.solve(place(effort, {X: 0.0, V: 0.0}), effort.defaults()[2])
    w, lam = effort.shift(found.w, found.lam)
    stride, rows = (effort.sizes["N_W"] - 2) // 4, effort.sizes["N_G"] // 4
    assert np.array_equal(w[: 3 * stride], found.w[stride : 4 * stride])
    end = found.w[-2:]
    last = w[3 * stride : 4 * stride]
    assert np.array_equal(last[:2], end)
    assert np.array_equal(last[2:4], found.w[3 * stride + 2 : 3 * stride + 4])  # inputs stay
    assert all(np.array_equal(last[k : k + 2], end) for k in range(4, stride, 2))
    assert np.array_equal(w[-2:], end)
    m = effort.sizes["N_W"]
    assert np.array_equal(lam[m : m + 3 * rows], found.lam[m + rows : m + 4 * rows])


def test_codes(effort: Any, tmp_path: Path) -> None:
    w, still = effort.defaults()[2], place(effort, {X: 0.0, V: 0.0})
    assert effort.solve(still, w, max_iterations=0).code is Code.iteration_limit
    assert effort.solve(still, w, tol=0.0).code is Code.bad_argument
    assert effort.solve(still, w, max_iterations=-1).code is Code.bad_argument
    assert effort.solve(np.full(2, np.nan), w).code is Code.bad_argument
    assert effort.solve(still, w, p=[np.inf]).code is Code.bad_argument
    assert effort.solve(still, np.full(len(w), 1e200)).code is Code.not_finite
    weak = library(least(high=2.0), EFFORT, tmp_path, solver=True)  # 3 N are needed
    found = weak.solve(still, w)
    assert found.code is Code.infeasible
    assert found.violation > 0.01
    assert weak.solve(still, w, p=[2.6]).code is Code.optimal
    with pytest.raises(ValueError, match="x: 3 numbers; there are 2"):
        effort.solve([0, 0, 0], w)


def test_threads_with_memory_of_their_own(effort: Any) -> None:
    w, states = effort.defaults()[2], [place(effort, {X: x, V: 0.1}) for x in (0.0, 1.0, 2.0)]
    alone = [effort.solve(state, w).w for state in states]
    wrong: list[int] = []

    def work(k: int) -> None:
        mine = load_again(effort)
        for _ in range(100):
            if not np.array_equal(mine.solve(states[k], w).w, alone[k]):
                wrong.append(k)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


def load_again(effort: Any) -> Any:
    """The same library with other memory."""
    fields = ("path", "name", "digest", "sizes", "labels", "functions")
    return type(effort)(*(getattr(effort, name) for name in fields))


def half_turn(miss: Any, guess: float) -> Problem:
    """Half a turn about z in 4 s with bounded torques; `miss` is what q_z costs per second."""
    turn = load_model_file(MODELS / "reorientation.py")
    axes = "xyz"
    phase = Phase(4.0, integral=lambda v: miss(v["body.q_z"]) + sum(
        0.2 * v[f"body.w_{a}"] ** 2 + 0.05 * v[f"tau_{a}"] ** 2 for a in axes))  # fmt: skip
    return Problem(rs.compile_scene(turn.scene()), phase,
                   inputs={f"tau_{a}": Free(guess, -1, 1) for a in axes})  # fmt: skip


@compiler
@pytest.mark.parametrize("method", [
    Collocation(12, 2, "radau"), pytest.param(Shooting(12, 1), marks=pytest.mark.slow),
])  # fmt: skip
def test_a_turn_with_bounded_torques_is_that_of_ipopt(method: Any, tmp_path: Path) -> None:
    problem = half_turn(lambda q: (q - 1) ** 2, 0.0)
    mine = library(problem, method, tmp_path, solver=True)
    found = mine.solve(None, mine.defaults()[2])
    best = Ipopt().solve(transcribe(problem, method), {}, None)
    assert best.outcome.ok
    assert (found.code, found.iterations < 10) == (Code.optimal, True)
    assert found.cost == pytest.approx(best.cost, rel=1e-7)
    assert np.abs(found.w - best.x).max() < 1e-4  # IPOPT stays off the bounds
    assert found.violation < 1e-8 > found.optimality


@compiler
def test_a_saddle_is_where_newton_steps_may_end(tmp_path: Path) -> None:
    """A cost that turns either way lower, from rest: no motion is stationary, and no minimum."""
    problem = half_turn(lambda q: 1 - q**2, 0.1)
    mine = library(problem, Collocation(12, 2, "radau"), tmp_path, solver=True)
    found = mine.solve(None, mine.defaults()[2])
    best = Ipopt().solve(transcribe(problem, Collocation(12, 2, "radau")), {}, None)
    assert found.code is Code.optimal
    assert found.cost == pytest.approx(4.0, abs=1e-9)
    assert best.cost < 2.6
    near = mine.solve(None, best.x + 0.02)
    assert near.code is Code.optimal
    assert near.cost == pytest.approx(best.cost, rel=1e-7)


@compiler
def test_bounds_that_hold_the_plan(tmp_path: Path) -> None:
    """A limit of speed: as `optimise` finds it, from the default and from another state."""
    phase = Phase(2.0, end={X: 3.0, V: 0.0}, path={V: (-1, 1.8)}, integral=FORCE**2 / 2)

    def problem(start: Any = None) -> Problem:
        own = Phase(2.0, start or {}, phase.end, phase.path, phase.integral)
        return Problem(rs.compile_scene(cart()), own, inputs={"force": Free(low=-6, high=6)})

    mine = library(problem(), Collocation(10, 3), tmp_path, solver=True)
    for start in ({X: 0.0, V: 0.0}, {X: 0.4, V: 0.9}):
        found = mine.solve(place(mine, start), mine.defaults()[2])
        best = optimise(problem(start), Collocation(10, 3), fly=False)
        assert found.code is Code.optimal
        assert found.cost == pytest.approx(best.cost, rel=1e-7)
        assert found.u[0] == pytest.approx(best.inputs["force"](0.0), abs=1e-5)


@compiler
def test_the_loop_closes_on_another_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    """A spring 60 % stiffer than planned for; and the plans are those of Python."""
    loop = load_model_file(MODELS / "receding_horizon.py")
    run = loop.close_the_loop(8.0)
    assert run.said == "plans by the exported solver in C"
    assert np.abs(run.push).max() <= 1 + 1e-9
    miss = {name: abs(run.states[name][-1] - goal) for name, goal in loop.GOAL.items()}
    assert max(miss.values()) < 0.02
    monkeypatch.setenv("CC", "no-such-compiler")
    again = loop.close_the_loop(3 * loop.STEP)
    assert again.said.startswith("no C compiler found")
    assert np.abs(again.push - run.push[:3]).max() < 1e-7
    assert len(loop.picture(again).axes) == 3


def test_what_cannot_be_exported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = rs.compile_scene(cart())
    inputs = {"force": Free()}
    with pytest.raises(ValueError, match="periodic"):
        export_problem(Problem(model, Phase(1.0), inputs, periodic=True), NEAR, tmp_path)
    with pytest.raises(ValueError, match="nothing is to be found"):
        export_problem(Problem(model, Phase(1.0), {"force": 1.0}), NEAR, tmp_path)
    stiff = Shooting(2, 1, integrator=rs.Rosenbrock())
    with pytest.raises(ValueError, match="with explicit steps"):
        export_problem(Problem(model, Phase(1.0), inputs), stiff, tmp_path / "stiff")
    same = rs.compile_scene(oscillator(rs.Param("Horizon_0", 4.0, "N/m")))
    with pytest.raises(ValueError, match="both OSCILLATOR_OCP_P_HORIZON_0 in C"):
        export_problem(Problem(same, Phase(1.0), inputs), NEAR, tmp_path)
    rs.export_c(model, tmp_path)
    with pytest.raises(ValueError, match="optimal control problem"):
        export_problem(least(), EFFORT, tmp_path)
    with pytest.raises(ValueError, match="holds a model; use load_c"):
        load_problem(tmp_path)
    artefact = export_problem(least(), EFFORT, tmp_path / "mine")
    with pytest.raises(ValueError, match="holds an optimal control problem; use load_problem"):
        rs.load_c(artefact)
    with pytest.raises(ValueError, match="does not match model"):
        load_problem(artefact, rs.compile_scene(pressed_column()))
    if shutil.which("cc"):
        plain = load_problem(artefact, model, flags=["-O0"])
        with pytest.raises(ValueError, match="solver=True"):
            plain.solve(None, plain.defaults()[2])
        free = library(two_phases((1.0, Free(1.0, 0.5, 3)), 4.0), NEAR, tmp_path / "free")
        with pytest.raises(ValueError, match="equal intervals"):
            free.shift(free.defaults()[2])
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(rs.CompilerMissing, match="no C compiler found"):
        load_problem(artefact)
