"""Exported simulators: clean C, the references, Python's own steps, and a code for each failure."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.comparing import by_name, states
from helpers.compilers import C99, COMPILERS, built
from oracles import closed_forms
from scenes import reference, small
from scenes.driven import CLOSE, FORCES, GRID, KNOTS, D, K, M, piecewise_linear
from scenes.simulators import DOP, ERK, ROS, doomed, driven, free, hub, kelvin, servo

import rbsd_sym as rs
from rbsd_sym.base.tableau import A, C
from rbsd_sym.exports.simulator_load import _RunStats as Stats

OK, BAD_ARGUMENT, TOO_MANY, TOO_SMALL, NOT_FINITE, _, TAPE_FULL = range(7)
every_method = pytest.mark.parametrize("method", [DOP, ROS, ERK], ids=by_name)
pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
Load = Callable[..., rs.Simulator]


def call(simulator: rs.Simulator, function: str, *arguments: Any) -> tuple[int, Stats]:
    """Code and statistics of a C function; None is NULL, an array a pointer."""
    stats, kinds = Stats(), {float: ctypes.c_double, int: ctypes.c_int}
    given = [v if v is None else v.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
             if isinstance(v, np.ndarray) else kinds[type(v)](v) for v in arguments]  # fmt: skip
    library, name = ctypes.CDLL(str(simulator.path)), f"{simulator.name}_simulate{function}"
    return getattr(library, name)(*given, ctypes.byref(stats)), stats


@cache
def referenced(name: str) -> rs.Model:
    return rs.compile_scene(reference.build(name))


@pytest.fixture(scope="module")
def load(tmp_path_factory: pytest.TempPathFactory) -> Load:
    """The loaded simulator of a model and a method, exported once."""
    known: dict[Any, rs.Simulator] = {}

    def get(model: rs.Model, method: Any, sensitivities: bool = False, quick: bool = False) -> Any:
        key = (id(model), by_name(method), method.max_steps, sensitivities)
        if key not in known:
            folder, flags = tmp_path_factory.mktemp("simulator"), ["-O0" if quick else "-O1"]
            artefact = rs.export_simulator(model, folder, method, sensitivities)
            known[key] = rs.load_simulator(artefact, model, flags=flags)
        return known[key]

    return get


@pytest.mark.parametrize("compiler", [
    pytest.param(name, marks=[pytest.mark.slow] if i else []) for i, name in enumerate(COMPILERS)
])
@pytest.mark.parametrize(("model", "method", "sensitivities"), [
    (hub, DOP, True), (driven, DOP, False), (driven, ERK, False), (kelvin, ROS, False),
], ids=["hub-sensitivities", "driven-Dop853", "driven-ExplicitRK", "kelvin-Rosenbrock"])
def test_example_builds_without_a_warning_and_prints_what_python_gets(
    model: Any, method: Any, sensitivities: bool, compiler: str, load: Load, tmp_path: Path
) -> None:  # fmt: skip
    rs.export_simulator(model(), tmp_path, method, sensitivities)
    sources = ["example.c", f"{model().name}_simulate.c"]
    first, *rows = built(tmp_path, compiler, *C99, "-O2", *sources)
    trajectory = load(model(), method, sensitivities)(1.0, points=1)
    assert first == f"code 0 at t = 1 after {int(trajectory.stats['steps'])} steps"
    printed = np.array([float(row.split()[1]) for row in rows])
    expected = [trajectory[name][-1] for name in trajectory.states]
    np.testing.assert_allclose(printed, expected, rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize(("name", "method"), [
    pytest.param(n, m, marks=[pytest.mark.slow] if m is not DOP and n[0] in "pc" else [])
    for n in "single single_consistent coupled chain4 pair_consistent".split()
    for m in (DOP, ROS, ERK)
])
def test_final_states_of_the_references(name: str, method: Any, load: Load) -> None:
    simulator = load(referenced(name), method, quick=method is ROS)
    t_end, errors = reference.SCENES[name]["t_end"], []
    for tolerance in (1e-6, 1e-8, 1e-10):
        trajectory = simulator(t_end, rtol=tolerance, atol=tolerance / 100, points=100)
        errors.append(reference.error(name, trajectory))
        assert errors[-1] < 10 * tolerance
    assert errors[1] < max(errors[0] / 10, 1e-11)
    assert errors[2] < max(errors[1] / 10, 1e-11)


@pytest.mark.parametrize("name", ["hub", "single", "coupled", "single_consistent"])
def test_steps_of_python_and_c_are_the_same(name: str, load: Load) -> None:
    """Also where saved points lie within steps; the start is not at 0."""
    model = hub() if name == "hub" else referenced(name)
    t = np.linspace(0.3, 1.0, 61)
    given = {"inputs": {"F": 2.0}, "params": {"k": 250.0}} if name == "hub" else {}
    ours = rs.simulate(model, t, DOP, **given)
    theirs = load(model, DOP)(1.0, t_start=0.3, points=60, **given)
    for count in ("steps", "rejected_steps", "evaluations"):
        assert ours.stats[count] == theirs.stats[count], count
    assert np.abs(theirs.t - t).max() < 1e-15
    a, b = states(model, ours), states(model, theirs)
    assert np.abs(a - b).max() < 1e-10 < 1e-2 * np.ptp(a, axis=0).max()


def test_order_of_one_step_and_of_its_interpolant(load: Load) -> None:
    """Errors of one step fall with h^9, between its ends with h^8; in Python and C."""
    simulator, errors = load(driven(), DOP), []
    given = {"start": {"b.p_x": 0.3, "b.v_x": 0.15}, "params": {"k": 2.0}}
    for h in (0.5**0.5, 0.5, 0.125**0.5):
        found = simulator(h, points=50, rtol=1e-9, atol=6e3, **given)
        same = rs.simulate(driven(), found.t, rs.Dop853(1e-9, 6e3), **given)
        assert found.stats["steps"] == same.stats["steps"] == 1
        # The interpolant's coefficients are some hundreds, and compilers may contract products.
        apart = np.abs(states(driven(), same) - states(driven(), found)).max()
        assert apart < 100 * np.finfo(float).eps * np.abs(states(driven(), same)).max()
        exact = np.array(closed_forms.damped_oscillator(found.t, M, 2.0, D, 0.15, 0.3)).T
        error = np.abs(states(driven(), found) - exact)
        errors.append([error[-1, 0], error[:-1].max()])
    order = 2 * np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.abs(order - [9, 8]).max() < 0.4


@every_method
def test_samples(method: Any, load: Load) -> None:
    """Linear between, constant outside; the closed form, for Python too."""
    t, f = KNOTS, FORCES
    given = {"inputs": {"pull": (t, f)}}
    found = load(driven(), method)(2.0, **given, points=40, rtol=1e-10, atol=1e-12)
    same = rs.simulate(driven(), GRID, type(method)(1e-10, 1e-12), **given)
    exact = piecewise_linear(GRID, np.array([0, *t, 2]), np.array([1, *f, 1]), 0.0, 0.5)
    for trajectory in (found, same):
        assert np.abs(trajectory["b.p_x"] - exact).max() < 10 * CLOSE
        assert np.abs(trajectory["pull"] - np.interp(GRID, t, f)).max() < 1e-14


@every_method
def test_time_in_the_scene_and_driven_offsets_from_another_start(method: Any, load: Load) -> None:
    model, place = servo(), ([0.7, 1.1], [0.2, -0.1])
    assert (model.n_x, model.n_u) == (6, 1)
    tight = {"inputs": {"place": place}, "rtol": 1e-10, "atol": 1e-12}
    found = load(model, method)(1.5, t_start=0.5, points=20, **tight)
    exact = rs.simulate(model, found.t, rs.Idas(1e-11, 1e-13), inputs={"place": place})
    assert np.abs(states(model, found) - states(model, exact)).max() < 1e-7
    unmoved = load(model, method)(1.0, points=20, **tight)
    assert np.abs(states(model, unmoved) - states(model, exact)).max() > 1e-2


@every_method
def test_null_is_a_default_and_values_are_used(method: Any, load: Load) -> None:
    simulator, one, other = load(driven(), method), np.empty((5, 2)), np.empty((5, 2))
    tail = (1e-10, 1e-12, 5)
    assert call(simulator, "", 0.0, 2.0, None, None, None, *tail, one)[0] == OK
    x, u, p = np.array([0, 0.5]), np.zeros(1), np.array([K])
    assert call(simulator, "", 0.0, 2.0, x, u, p, *tail, other)[0] == OK
    assert np.array_equal(one, other)
    x, u, p = np.array([0.3, -1.0]), np.array([5.0]), np.array([90.0])
    assert call(simulator, "", 3.0, 5.0, x, u, p, *tail, other)[0] == OK
    t = np.arange(1, 6) * 0.4
    exact = np.array(closed_forms.damped_oscillator(t, M, 90.0, D, -1.0, 0.3 - 5 / 90)).T
    assert np.abs(other - exact - [5 / 90, 0]).max() < CLOSE


@every_method
def test_arguments_without_sense(method: Any, load: Load) -> None:
    simulator, out, nan, inf = load(driven(), method), np.zeros((3, 2)), np.nan, np.inf
    good = {"t0": 0.0, "t1": 1.0, "rtol": 1e-8, "atol": 1e-8, "n": 3}
    for wrong in ({"t1": -1.0}, {"t0": nan}, {"t1": inf}, {"rtol": 0.0}, {"atol": -1.0},
                  {"rtol": nan}, {"atol": inf}, {"n": 0}, {"n": -2}):  # fmt: skip
        t0, t1, rtol, atol, n = (good | wrong).values()
        code, _ = call(simulator, "", t0, t1, None, None, None, rtol, atol, n, out)
        assert (code, out.any()) == (BAD_ARGUMENT, False)
        with pytest.raises(ValueError, match=r"above 0|negative"):
            simulator(t1, t_start=t0, rtol=rtol, atol=atol, points=n)
    sampled = (0.0, 1.0, None, 2, np.array([1.0, 1.0]), np.zeros(2), None, 1e-8, 1e-8, 3, out)
    assert call(simulator, "_sampled", *sampled)[0] == BAD_ARGUMENT
    assert call(simulator, "", 1.0, 1.0, None, None, None, 1e-8, 1e-8, 3, out)[0] == OK
    assert (out == [0.0, 0.5]).all()  # no time passes
    for bad in ({"inputs": {"pul": 1.0}}, {"params": {"K": 1.0}}, {"start": {"b.p_y": 0.0}},
                {"inputs": {"pull": ([0, 0], [1, 2])}}, {"inputs": {"pull": ([0.0], [1.0])}}):
        with pytest.raises(ValueError, match="simulator 'oscillator'"):
            simulator(1.0, **bad)


def test_algebraic_unknowns(load: Load) -> None:
    """The velocity of a massless body by a closed form; seven unknowns as in `simulate`."""
    found = load(kelvin(), ROS)(0.5, points=50, rtol=1e-10, atol=1e-12)
    x = 12 / 80 + (0.4 - 12 / 80) * np.exp(-80 / 6 * found.t)
    assert np.abs(found["a.p_x"] - x).max() < CLOSE
    assert np.abs(found["a.v_x"] - (12 - 80 * x) / 6)[1:].max() < CLOSE
    model = rs.compile_scene(small.massless(), layout="kernels")
    exact = rs.simulate(model, np.linspace(0, 0.5, 11), rs.Idas(1e-11, 1e-13))
    found = load(model, ROS, quick=True)(0.5, points=10, rtol=1e-10, atol=1e-12)
    for label in (*model.x_labels, *model.dae.z_labels):
        difference = np.abs(found[label.name] - exact[label.name])[label in model.dae.z_labels :]
        assert difference.max() < 1e-7, label.name


@every_method
def test_blow_up_keeps_what_came_before(method: Any, load: Load) -> None:
    simulator, out = load(doomed(), method), np.full((53, 2), -7.0)
    code, stats = call(simulator, "", 0.0, 2.0, None, None, None, 1e-8, 1e-10, 53, out)
    assert 0.999 < stats.t < 1 + 1e-6
    t = 2 * np.arange(1, 54) / 53
    assert np.array_equal((out != -7).all(axis=1), t < stats.t)  # the others are not touched
    assert np.abs(out[t < stats.t, 0] * (1 - t[t < stats.t]) - 1).max() < 1e-4
    found = simulator(2.0, points=53)
    assert found.outcome.name == {TOO_MANY: "too_many_steps", TOO_SMALL: "step_too_small"}[code]
    assert np.array_equal(states(doomed(), found)[1:], out[t < stats.t])
    assert f"{found.outcome.value} at t = {stats.t:.9g} s" in found.report


@pytest.mark.parametrize("n", [1, 200])
def test_too_many_steps(n: int, load: Load) -> None:
    found = load(driven(), rs.Dop853(max_steps=15))(10.0, points=n)
    assert found.outcome is rs.Outcome.too_many_steps
    assert found.stats["steps"] + found.stats["rejected_steps"] == 15
    exact, _ = closed_forms.damped_oscillator(found.t, M, K, D, 0.5)
    assert np.abs(found["b.p_x"] - exact).max() < CLOSE
    assert (0 < found.t[-1] < 10) == (n > 1)


@every_method
def test_not_finite(method: Any, load: Load) -> None:
    """No call hangs."""
    nan, inf, out = np.full(2, np.nan), np.full(2, np.inf), np.empty((1, 2))
    for given in ((nan, None, None), (None, nan, None), (None, None, nan), (None, None, inf)):
        code, stats = call(load(driven(), method), "", 1.0, 2.0, *given, 1e-8, 1e-10, 1, out)
        assert (code, stats.t) == (NOT_FINITE, 1.0)


class Sensitive:
    """Derivatives of the hub's final state at one random point w = [x; u; p]."""

    def __init__(self, load: Load, layout: str, tolerance: float) -> None:
        self.model, rng = hub(layout), np.random.default_rng(3)
        self.simulator, self.tail = load(self.model, DOP, True), (tolerance, tolerance)
        self.n = n = self.model.n_x
        x = np.array([label.start for label in self.model.x_labels])
        self.w = np.concatenate([x + 0.1 * rng.standard_normal(n), [1.5, 280.0]])
        self.v = rng.standard_normal(n + 2) * np.append(np.ones(n + 1), 100)
        self.l, self.slope, self.gradient = rng.standard_normal(n), np.empty(n), np.empty(n + 2)

    def run(self, function: str, w: np.ndarray, *more: Any) -> tuple[int, Stats]:
        x, u, p = w[: self.n].copy(), w[self.n : -1].copy(), w[-1:].copy()
        return call(self.simulator, function, 0.2, 1.0, x, u, p, *self.tail, *more)

    def end(self, w: np.ndarray) -> np.ndarray:
        x1 = np.empty(self.n)
        assert self.run("", w, 1, x1)[0] == OK
        return x1

    def forward(self) -> tuple[np.ndarray, int]:
        x1 = np.empty(self.n)
        code, stats = self.run("_forward", self.w, self.v, x1, self.slope)
        assert code == OK
        return x1, stats.steps

    def adjoint(self, steps: int) -> tuple[int, np.ndarray, np.ndarray]:
        x1, tape = np.empty(self.n), np.full((steps + 1, self.n + 2), -7.0)
        code, _ = self.run("_adjoint", self.w, self.l, steps, tape, x1, self.gradient)
        assert (tape[steps] == -7).all()  # no more than it was given
        return code, x1, tape[:steps]


def differences(end: Callable[[np.ndarray], np.ndarray], w: np.ndarray, v: np.ndarray) -> Any:
    """The derivative of end(w) along v."""
    return (end(w + 1e-5 * v) - end(w - 1e-5 * v)) / 2e-5


@pytest.mark.parametrize("layout", ["flat", "kernels"])
def test_sensitivities(layout: str, load: Load) -> None:
    """By differences at tight tolerance, and forward and adjoint by each other."""
    s = Sensitive(load, layout, 1e-12)
    x1, steps = s.forward()
    assert np.array_equal(x1, s.end(s.w))
    size = np.abs(s.slope).max()
    assert np.abs(differences(s.end, s.w, s.v) - s.slope).max() < 1e-6 * size
    code, x1_again, _ = s.adjoint(steps)
    assert (code, x1_again.tobytes()) == (OK, x1.tobytes())
    assert abs(s.gradient @ s.v - s.l @ s.slope) < 1e-12 * np.linalg.norm(s.l) * size
    assert np.abs(s.gradient[-2:]).min() > 1e-4  # input and parameter are felt
    assert s.adjoint(steps - 1)[0] == TAPE_FULL


def test_sensitivities_are_those_of_the_steps_taken(load: Load) -> None:
    """At 1e-3, by differences of the very steps on the tape, taken again in Python."""
    s = Sensitive(load, "flat", 1e-3)
    x1, steps = s.forward()
    tape, ode = s.adjoint(steps)[2], s.model.function("ode")

    def end(w: np.ndarray) -> np.ndarray:
        x, k = w[: s.n], np.zeros((12, s.n))
        for t, h in tape[:, :2]:
            for i in range(12):
                y = x + h * A[i, :12] @ k
                k[i] = np.array(ode(t + C[i] * h, y, [], w[s.n : -1], w[-1:]))[:, 0]
            x = x + h * A[12, :12] @ k
        return x

    assert np.abs(end(s.w) - x1).max() < 1e-12
    size = np.abs(s.slope).max()
    assert np.abs(differences(end, s.w, s.v) - s.slope).max() < 1e-8 * size
    exact = Sensitive(load, "flat", 1e-12)
    exact.forward()
    assert np.abs(exact.slope - s.slope).max() > 1e-6 * size  # those of the motion are others


AS_IN_PYTHON: dict[str, Callable[[Load], tuple[float, float]]] = {
    "unknowns at the start":
        lambda load: (load(kelvin(), ROS)(0.5, points=5)["a.v_x"][0], (12 - 80 * 0.4) / 6),
    "outputs of a model with parameters without effect":
        lambda load: (load(free(0.1, rs.Param("k", 7.0)), DOP)(1.0)["energy"][-1], 0.5),
    "parameters that move the start": lambda load: (
        load(free(rs.Param("x0", 0.1)), DOP)(1.0, params={"x0": 0.7})["b.p_x"][0], 0.7),
}  # fmt: skip


@pytest.mark.parametrize("name", AS_IN_PYTHON)
def test_values_that_python_gives(name: str, load: Load) -> None:
    found, right = AS_IN_PYTHON[name](load)
    assert found == pytest.approx(right, rel=1e-9)


def test_the_last_point_is_always_written(load: Load) -> None:
    """Also where t + (t1 - t) rounds below t1."""
    simulator, rng, none = load(free(0.1), DOP), np.random.default_rng(0), (None, None, None)
    for t0, span in rng.uniform([0.1, 0.5], [1.0, 2.0], (4000, 2)).tolist():
        x1 = np.full(1, np.nan)
        code, stats = call(simulator, "", t0, t0 + span, *none, 1e-5, 1e-5, 1, x1)
        assert (code, stats.t, x1[0]) == (OK, t0 + span, pytest.approx(0.1 + span, rel=1e-12))
