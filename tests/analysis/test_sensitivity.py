"""Derivatives of simulations: against the complex step on closed forms, and central differences."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.closed_forms import free_symmetric_top

import rbsd_sym as rs

GROUND = rs.Marker(rs.GROUND)
NAMES = ("k", "d", "h", "pull", "b.v_y")
VALUES = (500.0, 5.0, 0.1, 3.0, 1.0)
TIMES = np.linspace(0, 1, 6)
SERVED = (
    (rs.Idas(), 1e-7),
    (rs.Idas(rtol=1e-10, atol=1e-12), 1e-9),
    (rs.Collocation(0.01, 4), 1e-9),
    (rs.Collocation(0.02, 3, "legendre"), 3e-6),
    (rs.RK4(0.002), 1e-6),
    (rs.Rosenbrock(max_step=0.01), 5e-8),
    (rs.ExplicitRK(max_step=0.01), 2e-8),
)


def oscillator(start: float = 0.1, speed: float = 1.0, load: bool = True) -> rs.Model:
    """1 kg on a spring along y; stiffness, damping and the start are Params, the pull an Input."""
    k, d = rs.Param("k", VALUES[0], "N/m"), rs.Param("d", VALUES[1], "N s/m")
    h = rs.Param("h", start, "m")
    body = rs.RigidBody("b", 1, (1, 1, 1), position=(0, h, 0), velocity=(0, speed, 0))
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), [1e3, k, 1e3, 1e2, 1e2, 1e2], [1, d, 1, 1, 1, 1]
    )
    pull = rs.Load("l", rs.Marker("b"), (0, rs.Input("pull", "N", VALUES[3] if load else 0), 0))
    return rs.compile_scene(rs.Scene("oscillator", [body], [spring], [pull]))


def closed_form(t: np.ndarray, k: complex, d: complex, h: complex, F: complex, v: complex) -> list:
    """y(t) of y'' + d y' + k y = F from (h, v), analytic in all five."""
    a = d / 2
    w, rest = (k - a * a) ** 0.5, F / k
    C, S = np.cos(w * t), np.sin(w * t) / w
    return rest + np.exp(-a * t) * ((h - rest) * C + (v + a * (h - rest)) * S)


def complex_step(values: tuple[float, ...] = VALUES) -> np.ndarray:
    """Derivatives (n, 5) of the closed form, to rounding."""
    columns = []
    for i in range(5):
        moved = [complex(v, 1e-30 * (j == i)) for j, v in enumerate(values)]
        columns.append(closed_form(TIMES, *moved).imag / 1e-30)  # type: ignore[attr-defined]
    return np.array(columns).T


@pytest.mark.parametrize(("integrator", "bound"), SERVED, ids=lambda v: str(v)[:45])
def test_an_oscillator_against_the_complex_step(integrator: object, bound: float) -> None:
    expected = complex_step()
    size = np.abs(expected).max(axis=0)
    forward = rs.sensitivity(oscillator(), TIMES, NAMES, ["b.p_y", "b.position"],
                             integrator=integrator)  # fmt: skip
    assert forward["b.p_y"].shape == (6, 5)
    assert forward["b.position"].shape == (6, 3, 5)
    assert np.abs((forward["b.p_y"] - expected) / size).max() < bound
    np.testing.assert_array_equal(forward["b.position"][:, 1], forward["b.p_y"])
    assert not forward["b.position"][:, [0, 2]].any()
    adjoint = rs.sensitivity(oscillator(), TIMES, NAMES, "b.p_y", "adjoint", integrator)
    assert adjoint["b.p_y"].shape == (5,)
    assert np.abs((adjoint["b.p_y"] - expected[-1]) / size).max() < bound


def test_outputs_depend_on_parameters_directly_and_through_states() -> None:
    """The spring's force: k y + d y'; forward and adjoint mode by different ways."""
    model, integrator = oscillator(), rs.Collocation(0.01, 4)
    names = ["b.p_y", "b.v_y", "s.force_local", "energy"]
    forward = rs.sensitivity(model, TIMES, NAMES, names, integrator=integrator)
    run = forward.trajectory
    force = VALUES[0] * forward["b.p_y"] + VALUES[1] * forward["b.v_y"]
    force[:, 0] += run["b.p_y"]
    force[:, 1] += run["b.v_y"]
    found = forward["s.force_local"][:, 1] * np.sign(run["s.force_local"][0, 1] * run["b.p_y"][0])
    np.testing.assert_allclose(found, force, atol=1e-12 * np.abs(force).max())
    adjoint = rs.sensitivity(model, TIMES, NAMES, names, "adjoint", integrator)
    for name in names:
        scale = np.abs(forward[name][-1]).max()
        np.testing.assert_allclose(adjoint[name], forward[name][-1], atol=1e-10 * scale)
    assert forward.by("b.p_y", "k").shape == (6,)
    assert [label.unit for label in forward.wrt] == ["N/m", "N s/m", "m", "N", "m/s"]
    assert [label.start for label in forward.wrt] == list(VALUES)
    assert forward.units["s.force_local"]


def test_starts_given_or_asked_for_no_longer_follow_a_parameter() -> None:
    model, integrator = oscillator(), rs.Collocation(0.02, 4)
    free = rs.sensitivity(model, TIMES, ["h"], ["b.p_y"], integrator=integrator)
    assert free["b.p_y"][0, 0] == 1
    fixed = rs.sensitivity(
        model, TIMES, ["h"], ["b.p_y"], integrator=integrator, start={"b.p_y": 0.1}
    )
    assert not fixed["b.p_y"].any()
    both = rs.sensitivity(model, TIMES, ["h", "b.p_y"], ["b.p_y"], integrator=integrator)
    assert not both["b.p_y"][:, 0].any()
    np.testing.assert_allclose(both["b.p_y"][:, 1], free["b.p_y"][:, 0], rtol=1e-13, atol=1e-13)


def test_why_one_step_methods_need_a_longest_step() -> None:
    """At rest the states never move, so nothing tells an adaptive method that derivatives do."""
    model = oscillator(0.0, 0.0, load=False)
    exact = complex_step((VALUES[0], VALUES[1], 0.0, 0.0, 0.0))[:, 4]
    good = rs.sensitivity(model, TIMES, ["b.v_y"], ["b.p_y"])
    assert np.abs(good["b.p_y"][:, 0] - exact).max() < 1e-8
    for kind in (rs.Rosenbrock, rs.ExplicitRK):
        with pytest.raises(ValueError, match=r"chooses its steps by the states.*max_step="):
            rs.sensitivity(model, TIMES, ["b.v_y"], ["b.p_y"], integrator=kind())
        wide = rs.sensitivity(
            model, TIMES, ["b.v_y"], ["b.p_y"], integrator=kind(max_step=1.0)
        )
        assert np.abs(wide["b.p_y"][:, 0] - exact).max() > 0.1 * np.abs(exact).max()
        fine = rs.sensitivity(model, TIMES, ["b.v_y"], ["b.p_y"], integrator=kind(max_step=0.005))
        assert np.abs(fine["b.p_y"][:, 0] - exact).max() < 1e-7


def test_a_free_top_by_its_spin() -> None:
    """Angular velocity of a symmetric top by its own start: against the complex step in numpy."""
    body = rs.RigidBody("b", 1.0, (0.4, 0.4, 0.1), angular_velocity=(0.5, 0.2, 3.0))
    model = rs.compile_scene(rs.Scene("top", [body], []), minimal=False)
    names = ["b.w_x", "b.w_y", "b.w_z"]
    found = rs.sensitivity(model, [0, 0.7], names, ["b.angular_velocity", "b.rotation_matrix"])
    spin, h = np.array([0.5, 0.2, 3.0]), 1e-5
    for i in range(3):
        ends = [
            free_symmetric_top(0.7, 0.4, 0.1, np.eye(3), spin + s * h * np.eye(3)[i])
            for s in (1, -1)
        ]
        R, w = ((a - b) / (2 * h) for a, b in zip(*ends, strict=True))
        # Central differences: h^2 third derivatives, and rounding over h.
        np.testing.assert_allclose(found["b.angular_velocity"][-1, :, i], w, atol=1e-7)
        np.testing.assert_allclose(found["b.rotation_matrix"][-1, ..., i], R, atol=1e-7)


def test_algebraic_unknowns_follow_exactly() -> None:
    """A massless body between two springs: half the stiffness, half the way."""
    k = rs.Param("k", 800.0, "N/m")
    mass = rs.RigidBody("m", 2.0, (1, 1, 1), position=(0, 0, 0.1))
    between = rs.RigidBody("between", 0, 0, position=(0, 0, 0.05))
    K = [k, k, k, 50.0, 50.0, 50.0]
    springs = [
        rs.RigidBodySpringDamper("s0", GROUND, rs.Marker("between"), K),
        rs.RigidBodySpringDamper("s1", rs.Marker("between"), rs.Marker("m"), K),
    ]
    model = rs.compile_scene(rs.Scene("row", [mass, between], springs))
    assert model.n_z > 0
    w = np.sqrt(400.0 / 2)
    for mode in ("forward", "adjoint"):
        found = rs.sensitivity(model, [0, 0.3, 0.5], ["k", "m.p_z"], ["between.position", "m.p_z"],
                               mode)  # fmt: skip
        end = {name: found[name][-1] if mode == "forward" else found[name]
               for name in ("between.position", "m.p_z")}  # fmt: skip
        by_k = -0.1 * 0.5 * np.sin(w * 0.5) * w / (2 * 800.0)
        expected = np.array([by_k, np.cos(w * 0.5)])
        np.testing.assert_allclose(end["m.p_z"], expected, atol=1e-8)
        np.testing.assert_allclose(end["between.position"][2], expected / 2, atol=1e-8)


def test_inputs_that_vary_in_time() -> None:
    """Traced functions and samples: the derivative by k is that of central differences."""
    model = oscillator()
    samples = (np.linspace(0, 1, 11), np.linspace(0, 1, 11) ** 2)
    for signal in (lambda t: 3 * np.sin(5 * t), samples):
        given = {"pull": signal}
        method = rs.Collocation(0.005, 4)
        found = rs.sensitivity(model, TIMES, ["k"], ["b.p_y"], integrator=method, inputs=given)
        h, ends = 0.02, []
        for s in (1, -1):
            run = rs.simulate(model, TIMES, method, inputs=given, params={"k": 500.0 + s * h})
            ends.append(run["b.p_y"])
        differences = (ends[0] - ends[1]) / (2 * h)
        # h^2 / 6 of the third derivative (3e-4 m, and 0.02 for each further one), and rounding / h.
        np.testing.assert_allclose(found["b.p_y"][:, 0], differences, atol=3e-11, rtol=0)
        with pytest.raises(ValueError, match="'pull' varies in time"):
            rs.sensitivity(model, TIMES, ["pull"], ["b.p_y"], inputs=given)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mode": "reverse"}, "mode 'reverse'; give 'forward' or 'adjoint'"),
        ({"wrt": []}, r"wrt \[\]; give at least one name"),
        ({"wrt": ["k", "k"]}, "each once"),
        ({"wrt": ["mass"]}, r"no parameter, input or state 'mass'; there are: b\.p_y"),
        ({"wrt": ["b.p_z"]}, r"'b\.p_z' has no start value of its own"),
        ({"outputs": ["b.positon"]}, r"no output 'b\.positon'"),
        ({"integrator": rs.GeneralizedAlpha(0.01)}, "GeneralizedAlpha does not support deriv"),
        ({"integrator": rs.Dop853()}, "Dop853 does not support derivatives"),
        ({"inputs": {"pull": lambda t: 1.0 if t > 0.5 else 0.0}}, "takes floats only"),
        ({"params": {"m": 1.0}}, "no parameter 'm'"),
    ],
)
def test_bad_calls_are_refused(change: dict, message: str) -> None:
    call = {"times": TIMES, "wrt": ["k"], "outputs": ["b.p_y"]} | change
    with pytest.raises(ValueError, match=message):
        rs.sensitivity(oscillator(), **call)


def test_events_are_refused() -> None:
    body = rs.RigidBody("b", 1.0, (1, 1, 1), position=(0, 0, 1))
    floor = rs.RigidBodySpringDamper(
        "floor", GROUND, rs.Marker("b"), 0, effects=[rs.Impact(2, restitution=0.5)]
    )
    model = rs.compile_scene(rs.Scene("ball", [body], [floor], gravity=(0, 0, -9.81)))
    with pytest.raises(ValueError, match=r"events \(.*derivatives across jumps"):
        rs.sensitivity(model, 1.0, ["b.v_z"], ["b.p_z"])


def test_a_failed_integration_is_raised() -> None:
    with pytest.raises(rs.IntegrationError, match="too many steps"):
        rs.sensitivity(oscillator(), TIMES, ["k"], ["b.p_y"], integrator=rs.Idas(max_steps=3))
