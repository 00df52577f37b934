"""Generalized-alpha: the step function and its C, the choice of steps, failures."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scenes.alpha import GROUND, SCENES, TIGHT, model_of, path, start_of

import rbsd_sym as rs
from rbsd_sym.integrators.alpha_step import Groups, rates_function, step_function
from rbsd_sym.integrators.generalized_alpha import GeneralizedAlpha, Stepper
from rbsd_sym.model.trajectory import Outcome
from rbsd_sym.model.values import make_experiment

COMPILER = shutil.which("gcc") or shutil.which("cc")


def stepper(model: rs.Model, rho: float = 0.9) -> Stepper:
    return Stepper(model, make_experiment(model, [0, 1], {}, {}, {}), rho, 1e-10)


# The step function


@pytest.mark.skipif(not COMPILER, reason="no C compiler")
@pytest.mark.parametrize(
    ("name", "layout"), [("tumbling", "flat"), ("rod", "flat"), ("chain4", "kernels")]
)
def test_step_function_generates_to_c(name: str, layout: str, tmp_path: Path) -> None:
    """Operations come in the same order: differences are those of fused ones and of exp and sin."""
    model = rs.compile_scene(SCENES[name](), layout=layout)
    step = step_function(model, 0.9, 1e-9)
    generator = ca.CodeGenerator("step.c")
    generator.add(step)
    (tmp_path / "step.c").write_text(generator.dump())
    library = tmp_path / "step.so"
    subprocess.run(
        [COMPILER, "-std=c99", "-O0", "-shared", "-fPIC", "step.c", "-o", library, "-lm"],
        cwd=tmp_path, check=True, capture_output=True,
    )  # fmt: skip
    compiled = ca.external("alpha_step", str(library))
    x, z, u, p = start_of(model)
    rate = rates_function(model)(0, x, z, u, p)
    for ours, theirs in zip(*(f(0, 2e-3, x, rate, rate, z, u, p) for f in (step, compiled)),
                            strict=True):
        np.testing.assert_allclose(np.array(theirs), np.array(ours), rtol=1e-12, atol=1e-12)
    for f in (step, compiled):
        *_, size, count = f(0, 2e-3, x * np.nan, rate, rate, z, u, p)
        assert float(size) == np.inf
        assert not float(count) > 12


@pytest.mark.parametrize("name", ["pair_consistent", "damped_link"])
def test_kernels_and_compiled_models_take_the_same_steps(name: str) -> None:
    """Sums in another order: 1e-16 of 1e6 N/m, over 50 steps."""
    flat = model_of(name)
    others = [rs.compile_scene(SCENES[name](), layout="kernels")]
    others += [rs.compiled(flat, flags=["-O0"])] if COMPILER and name == "pair_consistent" else []
    exact = path(flat, 0.1, GeneralizedAlpha(2.5e-3))
    for model in others:
        assert model.calls
        found = path(model, 0.1, GeneralizedAlpha(2.5e-3))
        np.testing.assert_allclose(found, exact, rtol=0, atol=1e-9)


def test_single_steps_leave_the_state_as_it_was() -> None:
    """A step tried, cut and tried again is the step; data states hold during a step, then stay."""
    s = stepper(model_of("tumbling"))
    start = s.start(0.0, *start_of(s.model)[:2])
    whole = s.try_step(start, 0.01)
    s.try_step(start, 0.003)
    again = s.try_step(start, 0.01)
    assert not isinstance(whole, Outcome)
    assert not isinstance(again, Outcome)
    assert (whole.x == again.x).all()
    assert whole.t == 0.01
    assert s.tried == 3


def test_data_states_are_no_unknowns_and_may_be_changed_for_a_step() -> None:
    """A spring in series with a slider (Plastic): its plastic strain moves the spring's origin."""
    body = rs.RigidBody("b", 1.0, [1, 1, 1], velocity=[0.1, 0, 0])
    slider = rs.Plastic(0, 30.0, 1e3)
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), [1, 0, 0, 0, 0, 0], effects=(slider,)
    )
    model = rs.compile_scene(rs.Scene("slider", [body], [spring]))
    names = [label.name for label in model.x_labels]
    data = [names[i] for i in model.dae.data]
    assert len(data) == 2
    assert not set(Groups(model.dae).slots) & set(model.dae.data)
    s = stepper(model)
    start = s.start(0.0, *start_of(model)[:2])
    plain = s.try_step(start, 0.01)
    values = np.where([name.endswith("_plastic") for name in data], 0.02, 0.0)
    moved = s.try_step(start, 0.01, values)
    assert not isinstance(plain, Outcome)
    assert not isinstance(moved, Outcome)
    assert (plain.x[s.data] == start.x[s.data]).all()
    assert sorted(moved.x[s.data]) == [0.0, 0.02]
    row = names.index("b.v_x")
    assert moved.rate[row] - plain.rate[row] == pytest.approx(30 * 0.02, rel=0.01)


# Steps


def test_intervals_are_cut_into_the_fewest_equal_steps() -> None:
    """0.1 / 0.01 is 10 steps and no sliver, 0.025 / 0.01 is 3."""
    for times, steps in (([0, 0.1, 0.2, 0.3], 30), ([0, 0.025, 0.05], 6), ([0, 0.01, 0.02], 2),
                         ([0, 0.004, 0.02], 3), (np.linspace(0, 1, 8), 7 * 15)):
        found = rs.simulate(model_of("oscillator"), times, GeneralizedAlpha(0.01))
        assert found.stats["steps"] == steps
        assert (found.t == np.array(times)).all()


def test_shorter_steps_where_newton_fails() -> None:
    """Steps of 50 ms at 13 rad/s; one is too long to be solved."""
    found = rs.simulate(model_of("pair_consistent"), [0, 0.5, 1.0], GeneralizedAlpha(0.05, 0.5))
    assert found.stats["rejected_steps"] > 0
    assert found.outcome is Outcome.reached_end


@pytest.mark.parametrize(("name", "t_end"), [("single", 0.4), ("maxwell", 2.0), ("kelvin", 40.0)])
def test_error_falls_with_the_tolerance(name: str, t_end: float) -> None:
    """A local error of h^3 within the tolerance leaves tol^(2/3): 1e-2 over three decades."""
    model = model_of(name)
    exact = path(model, t_end, TIGHT)
    errors, steps, rejected = [], [], 0.0
    for tolerance in (1e-3, 1e-4, 1e-5, 1e-6):
        method = GeneralizedAlpha(t_end / 8, 0.8, tolerance, tolerance)
        found = rs.simulate(model, np.linspace(0, t_end, 21), method)
        values = np.array([found[state] for state in found.states])
        errors.append(np.abs(values - exact).max())
        steps.append(found.stats["steps"])
        rejected += found.stats["rejected_steps"]
    assert rejected > 0
    assert errors[-1] < errors[0] / 20
    assert steps[-1] / steps[-2] == pytest.approx(10 ** (1 / 3), rel=0.25)


def test_adaptive_steps_step_over_a_stiff_vibration() -> None:
    """The pivot's 2.6e3 rad/s (1e-6 m) do not bind the steps; the top's turning does."""
    found = rs.simulate(model_of("heavy_top"), [0, 0.2], GeneralizedAlpha(1e-3, 0.5, 1e-4, 1e-4))
    assert found.stats["steps"] < 0.2 * 2.6e3


# Failures


def growing(force: Any) -> rs.Scene:
    """A massless body on a spring whose force never exceeds 1 N, under a load."""

    def law(mbs: Any, t: Any, item: Any, displacement: Any, rotation: Any, *rest: Any) -> list[Any]:
        return [np.tanh(displacement[0]), displacement[1], displacement[2], *rotation]

    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("a"), np.zeros(6), force=law)
    load = rs.Load("l", rs.Marker("a"), force=(force, 0, 0))
    bodies = [rs.RigidBody("a", 0, 0), rs.RigidBody("b", 1.0, [1, 1, 1], velocity=[1, 0, 0])]
    other = rs.RigidBodySpringDamper("o", GROUND, rs.Marker("b"), [5] * 6)
    return rs.Scene("growing", bodies, [spring, other], [load])


@pytest.mark.parametrize(
    "tolerances", [{}, {"rtol": 1e-3, "atol": 1e-3}], ids=["fixed", "adaptive"]
)
def test_failures_keep_the_trajectory(tolerances: dict[str, float]) -> None:
    """No solution from t = 0.5 s on; no number from 0.5 s on; too many steps."""
    unsolvable = rs.compile_scene(growing(2 * rs.TIME))
    body = rs.RigidBody("b", 1.0, [1, 1, 1])
    load = rs.Load("l", rs.Marker("b"), force=(np.sqrt(0.5 - rs.TIME), 0, 0))
    imaginary = rs.compile_scene(rs.Scene("imaginary", [body], [], [load]))
    times = np.linspace(0, 1, 11)
    for model, outcomes in ((unsolvable, (Outcome.solver_failed, Outcome.not_finite)),
                            (imaginary, (Outcome.not_finite,))):
        found = rs.simulate(model, times, GeneralizedAlpha(0.01, **tolerances), throw=False)
        assert found.outcome in outcomes
        assert len(found.t) in (5, 6)
        assert found.stats["t_failed"] == pytest.approx(0.5, abs=0.011)
        assert all(np.isfinite(found[name]).all() for name in found.states)
        assert f"at t = {found.stats['t_failed']:.9g} s" in found.report
    found = rs.simulate(
        model_of("single"), times, GeneralizedAlpha(1e-3, max_steps=250, **tolerances), throw=False
    )
    if tolerances:
        assert found.outcome is Outcome.reached_end
    else:
        assert found.outcome is Outcome.too_many_steps
        assert (len(found.t), found.stats["steps"]) == (3, 250)


def test_a_start_without_solution_is_told() -> None:
    found = rs.simulate(
        rs.compile_scene(growing(2.0 + rs.TIME)), [0, 1], GeneralizedAlpha(0.1), throw=False
    )
    assert found.outcome is Outcome.not_consistent
    assert len(found.t) == 1


def test_models_without_states() -> None:
    """A massless body alone follows its load; a body that nothing moves stays."""
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("a"), [20] * 6)
    load = rs.Load("l", rs.Marker("a"), force=(3 * rs.TIME, 0, 0))
    scene = rs.Scene("hanging", [rs.RigidBody("a", 0, 0)], [spring], [load])
    found = rs.simulate(rs.compile_scene(scene), [0, 1, 2], GeneralizedAlpha(0.5))
    assert found["a.position"][:, 0] == pytest.approx([0, 0.15, 0.3], abs=1e-12)
    still = rs.compile_scene(rs.Scene("still", [rs.RigidBody("a", 1.0, [1, 1, 1])], []))
    assert rs.simulate(still, [0, 1], GeneralizedAlpha(1e-9))["a.position"].shape == (2, 3)
    alone = growing(2 * rs.TIME)
    alone = dataclasses.replace(alone, bodies=alone.bodies[:1], connectors=alone.connectors[:1])
    found = rs.simulate(rs.compile_scene(alone), [0, 0.4, 1], GeneralizedAlpha(0.1), throw=False)
    assert found.outcome in (Outcome.solver_failed, Outcome.not_finite)
    assert found["a.p_x"][1] == pytest.approx(np.arctanh(0.8), abs=1e-12)
    assert len(found.t) == 2
    assert "at t = 0.49" in found.report


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": -0.1}, "GeneralizedAlpha: step -0.1 s; give a positive, finite number"),
        ({"step": 0}, "step 0 s; give a positive"),
        ({"step": np.inf}, "step inf s; give a positive, finite number"),
        ({"step": np.nan}, "step nan s; give a positive, finite number"),
        ({"step": "1e-3"}, "step '1e-3' s; give a positive"),
        ({"step": True}, "step True s; give a positive"),
        ({"spectral_radius": -0.1}, "spectral_radius -0.1; give a number in 0 ... 1"),
        ({"spectral_radius": 1.1}, "spectral_radius 1.1; give a number in 0 ... 1"),
        ({"spectral_radius": None}, "spectral_radius None; give a number in 0 ... 1"),
        ({"rtol": 1e-6}, "rtol 1e-06 and atol None; give both"),
        ({"atol": 1e-6}, "rtol None and atol 1e-06; give both"),
        ({"rtol": 0.0, "atol": 1e-6}, "rtol 0.0; give a number in 0 ... 1"),
        ({"rtol": 1e-6, "atol": -1.0}, "atol -1.0; give a positive, finite number"),
        ({"newton_tolerance": 0.0}, "newton_tolerance 0.0; give a number in 1e-15 ... 0.001"),
        ({"max_steps": 0}, "max_steps 0; give a whole number above 0"),
        ({"max_steps": 1e6}, "max_steps 1000000.0; give a whole number above 0"),
    ],
)
def test_bad_arguments_are_told(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match="GeneralizedAlpha") as caught:
        GeneralizedAlpha(**{"step": 0.1} | arguments)
    assert message in str(caught.value)
