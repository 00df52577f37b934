"""Massless bodies: a start in balance, what is refused, and unknowns that are driven fast."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.comparing import largest
from scenes.massless import ground, massless, residual, spring, strung, values_of_z
from scenes.small import GROUND

import rbsd_sym as rs

BRIEF = [0, 0.01]


@pytest.mark.parametrize(
    ("place", "turn"),
    [((1.2, 0.1, -1), (9, 3, -2, 1)), ((0, 3, 0), (1, 1, 1, 1))],
)
def test_guess_off_the_balance_is_moved_to_it_and_reported(place: Any, turn: Any) -> None:
    model, near = rs.compile_scene(strung(place, turn)), rs.compile_scene(strung())
    # Newton's method ends at rounding: 1e-13 of metres and of a unit quaternion.
    np.testing.assert_allclose(values_of_z(model), values_of_z(near), atol=1e-11)
    # By hand: springs of 1000 and 1500 N/m in series along x, pulled by 0.1 m (but for the turn).
    start = {label.name: label for label in model.dae.z_labels}
    assert start["a.p_x"].start == pytest.approx(1 + 0.1 * 1500 / 2500, abs=1e-3)
    q = [start[f"a.q_{part}"].start for part in "wxyz"]
    assert np.linalg.norm(q) == pytest.approx(1, rel=1e-12)
    [note] = [note for note in model.dae.notes if "consistent start" in note]
    assert f"a.p_x = {start['a.p_x'].start:.6g} m (given {place[0]:g})" in note
    assert note in str(model)
    first = rs.simulate(model, BRIEF)
    assert first["a.p_x"][0] == pytest.approx(start["a.p_x"].start, abs=1e-11)
    assert residual(model, first, slice(1)) < 1e-10


def test_start_of_an_unknown_is_a_guess_and_of_a_state_is_kept() -> None:
    model = rs.compile_scene(strung())
    own = rs.simulate(model, BRIEF)
    guessed = rs.simulate(model, BRIEF, start={"a.p_x": 1.4, "a.q_x": 0.3})
    for name in ("a.position", "a.quaternion", "b.position"):
        np.testing.assert_allclose(guessed[name], own[name], atol=1e-10)
    moved = rs.simulate(model, BRIEF, start={"b.p_x": 2.3})
    assert moved["b.p_x"][0] == 2.3
    # The share of 1500 / 2500 of another 0.2 m.
    assert moved["a.p_x"][0] - own["a.p_x"][0] == pytest.approx(0.12, abs=1e-3)
    assert residual(model, moved, slice(1)) < 1e-10
    with pytest.raises(ValueError, match=r"a\.v_x"):
        rs.simulate(model, BRIEF, start={"a.v_x": 3.0})


def test_start_follows_the_parameters() -> None:
    model = rs.compile_scene(strung(k=rs.Param("k", 1000.0, "N/m")))
    soft = rs.simulate(model, BRIEF, params={"k": 500.0})
    assert soft["a.p_x"][0] == pytest.approx(1 + 0.1 * 1500 / 2000, abs=1e-3)
    assert residual(model, soft, slice(1)) < 1e-10


def saturated(pull: Any, beside: bool = True) -> rs.Scene:
    """A massless body on a spring that gives at most 5 N, under a load; a moving body beside it."""

    def force(mbs: Any, t: Any, i: Any, u: Any, th: Any, *rest: Any) -> list[Any]:
        return [5 * np.tanh(20 * u[0]), 100 * u[1], 100 * u[2], *(50 * angle for angle in th)]

    bodies = [massless("a", 0, 0, 0)]
    springs = [spring("c", GROUND, rs.Marker("a"), 0, force=force)]
    if beside:
        bodies.append(rs.RigidBody("b", 1, (1, 1, 1), velocity=(1, 0, 0)))
        springs.append(spring("d", GROUND, rs.Marker("b"), [100] * 6))
    load = rs.Load("load", rs.Marker("a"), force=(pull, 0, 0))
    return rs.Scene("saturated", bodies, springs, [load])


@pytest.mark.parametrize("integrator", [rs.Idas(), rs.Rosenbrock()], ids=["idas", "rosenbrock"])
def test_balance_without_solution_is_an_outcome(integrator: Any) -> None:
    held, t = rs.compile_scene(saturated(4.0)), np.linspace(0, 0.1, 11)
    assert values_of_z(held)[0] == pytest.approx(np.arctanh(0.8) / 20, rel=1e-12)
    assert rs.simulate(held, t, integrator).outcome is rs.Outcome.reached_end
    model = rs.compile_scene(saturated(6.0))
    assert any("no consistent start values" in note for note in model.dae.notes)
    found = rs.simulate(model, t, integrator, throw=False)
    assert found.outcome is rs.Outcome.not_consistent
    assert "start={name: value}" in found.report
    with pytest.raises(rs.IntegrationError, match="no consistent start values"):
        rs.simulate(model, t, integrator)


def test_balance_that_is_lost_on_the_way_stops_the_run_there() -> None:
    """40 N/s against at most 5 N: lost at 0.125 s. Output every 2 ms."""
    model = rs.compile_scene(saturated(rs.Input("pull", "N")))
    ramp, t = {"pull": lambda t: 40 * t}, np.linspace(0, 0.2, 101)
    for integrator in (rs.Idas(), rs.Rosenbrock()):
        found = rs.simulate(model, t, integrator, inputs=ramp, throw=False)
        assert not found.outcome.ok
        assert 0.12 <= found.t[-1] <= 0.125
    assert largest(5 * np.tanh(20 * found["a.p_x"]) - 40 * found.t) < 1e-6


def check_driven_fast(integrator: Any) -> None:
    """A massless body follows 10 N sin(50 t) on 100 N/m, while the states swing at 1 rad/s."""
    b = rs.RigidBody("b", 1, (1, 1, 1), velocity=(1, 0, 0))
    springs = [
        spring("c", GROUND, rs.Marker("a"), [100] * 6),
        spring("d", GROUND, rs.Marker("b"), [1] + [100] * 5),
    ]
    load = rs.Load("load", rs.Marker("a"), force=(10 * np.sin(50 * rs.TIME), 0, 0))
    model = rs.compile_scene(rs.Scene("fast", [massless("a", 0, 0, 0), b], springs, [load]))
    found = rs.simulate(model, np.linspace(0, 2, 81), integrator)
    assert largest(found["b.p_x"] - np.sin(found.t)) < 1e-7
    assert largest(found["a.p_x"] - 0.1 * np.sin(50 * found.t)) < 1e-7


@pytest.mark.parametrize("integrator", [rs.Idas(), rs.Rosenbrock()], ids=["idas", "rosenbrock"])
def test_unknown_driven_faster_than_the_states(integrator: Any) -> None:
    """The step is chosen for 1 rad/s: z must be solved for at saved points, not interpolated."""
    check_driven_fast(integrator)


@pytest.mark.parametrize("minimal", [True, False])
def test_load_that_nothing_resists_is_refused(minimal: bool) -> None:
    loose = spring("c", GROUND, rs.Marker("a"), [100, 0, 100, 50, 50, 50])
    load = rs.Load("load", rs.Marker("a"), force=(0, 1, 0))
    scene = rs.Scene("loose", [massless("a", 0, 0, 0)], [loose], [load])
    with pytest.raises(ValueError, match=r"a\.y.*1 N.*nothing resists.*mass and inertia"):
        rs.compile_scene(scene, None, minimal)


def test_scene_that_is_algebraic_throughout() -> None:
    """Quasi-static: a massless body that follows a load; alg is all there is."""
    model = rs.compile_scene(saturated(rs.Input("pull", "N"), beside=False))
    assert (model.n_x, model.n_z) == (0, 1)
    found = rs.simulate(model, np.linspace(0, 0.1, 21), inputs={"pull": lambda t: 40 * t})
    assert largest(5 * np.tanh(20 * found["a.p_x"]) - 40 * found.t) < 1e-12


@pytest.mark.parametrize(
    "options",
    [{"inertia": 0, "velocity": (1, 0, 0)}, {"inertia": (0, 1, 1), "angular_velocity": (3, 0, 0)}],
    ids=["sliding point mass", "rod spun about its axis"],
)
def test_one_state_beside_a_motion_that_nothing_acts_on(options: dict[str, Any]) -> None:
    model = rs.compile_scene(rs.Scene("lone", [rs.RigidBody("b", 1, **options)], []))
    assert (model.n_x, model.n_z) == (1, 0)


def test_start_is_found_where_velocities_are_large() -> None:
    """One damper of the two, a start off the balance: forces of 300 N, a spin of 660 rad/s."""
    rng = np.random.default_rng(7)
    spread = lambda: rng.uniform(-0.2, 0.2, 3)  # noqa: E731
    for _ in range(3):
        K = np.concatenate([rng.uniform(200, 2000, 3), rng.uniform(20, 200, 3)])
        a_in, a_out = rs.Marker("a", spread() - [1, 0, 0]), rs.Marker("a", spread())
        springs = [
            spring("c0", ground(*spread()), a_in, K, 0.001 * K, "consistent"),
            spring("c1", a_out, rs.Marker("b", spread() - [1, 0, 0]), K, law="consistent"),
        ]
        b = rs.RigidBody("b", 1, (0.1, 0.1, 0.1), position=(2, 0, 0))
        model = rs.compile_scene(rs.Scene("fast", [massless("a", 1, 0, 0), b], springs))
        rs.simulate(model, [0, 1e-6])
