"""Rest and linear motion: against closed forms, the full model, and other coordinates."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes.reference import build
from scenes.small import GROUND, column

import rbsd_sym as rs
from rbsd_sym.analysis.equilibrium import Rest
from rbsd_sym.analysis.linearize import Linear, balanced
from rbsd_sym.analysis.tangent import chart_of
from rbsd_sym.model.values import locate

EPS = float(np.finfo(float).eps)


def axis_oscillator(m: float, k: object, d: object, outputs: list[str] | None = None) -> rs.Model:
    """One body that can move along y only, pulled by an input."""
    body = rs.RigidBody("b", m, (1, 1, 1))
    spring = rs.RigidBodySpringDamper(
        "s", GROUND, rs.Marker("b"), (1e3, k, 1e3, 1e2, 1e2, 1e2), (0, d, 0, 0, 0, 0)
    )
    load = rs.Load("pull", rs.Marker("b"), (0, rs.Input("force", "N"), 0))
    return rs.compile_scene(rs.Scene("oscillator", [body], [spring], [load], outputs=outputs))


def test_an_oscillator_has_the_matrices_of_the_textbook() -> None:
    m, k, d = 2.0, 450.0, 6.0
    model = axis_oscillator(m, k, d, ["b.position", "s.force_local"])
    linear = rs.linearize(model)
    assert [v.name for v in linear.states] == ["b.p_y", "b.v_y"]
    np.testing.assert_allclose(linear.A, [[0, 1], [-k / m, -d / m]], rtol=8 * EPS)
    np.testing.assert_allclose(linear.B, [[0], [1 / m]], rtol=8 * EPS)
    rows = [v.name for v in linear.outputs]
    assert linear.C[rows.index("b.position_y")].tolist() == [1, 0]
    force = linear.C[rows.index("s.force_local_y")]
    np.testing.assert_allclose(np.abs(force), [k, d], rtol=8 * EPS)
    assert not linear.D.any()
    w = math.sqrt(k / m)
    np.testing.assert_allclose(linear.frequencies, w / (2 * math.pi), rtol=1e-14)
    np.testing.assert_allclose(linear.damping_ratios, d / (2 * m * w), rtol=1e-13)
    assert linear.stable
    assert linear.kept.growth.max() == pytest.approx(-d / (2 * m), rel=1e-13)
    assert linear.abscissa == 0, "what was left out has springs without dampers"
    assert linear.inputs[0].name == "force"
    assert linear.inputs[0].unit == "N"
    np.testing.assert_array_equal(linear.B_tangent, linear.B)
    np.testing.assert_array_equal(linear.C_tangent, linear.C)
    mode = linear.mode(0)
    assert mode["b.p_y"] * linear.eigenvalues[0] == pytest.approx(mode["b.v_y"], rel=1e-13)


def test_overdamped_and_undamped_modes() -> None:
    over = rs.linearize(axis_oscillator(1.0, 100.0, 25.0))
    np.testing.assert_allclose(sorted(over.eigenvalues.real), [-20, -5], rtol=1e-13)
    np.testing.assert_allclose(over.damping_ratios, 1, rtol=1e-13)
    none = rs.linearize(axis_oscillator(1.0, 1e12, 0.0))
    # Real parts are rounding, and count as none, however stiff it is.
    assert none.abscissa == 0
    assert none.stable
    assert np.abs(none.kept.errors).max() < 1e-12 * 1e6
    np.testing.assert_allclose(none.frequencies, 1e6 / (2 * math.pi), rtol=1e-13)


def test_coupled_masses_have_the_modes_of_the_textbook() -> None:
    k = 300.0
    bodies = [rs.RigidBody(f"b{i}", 1.0, (1, 1, 1), position=(i, 0, 0)) for i in range(3)]
    ends = [rs.Marker(rs.GROUND), *(rs.Marker(f"b{i}") for i in range(3)), rs.Marker(rs.GROUND)]
    springs = [
        rs.RigidBodySpringDamper(
            f"s{i}", ends[i], ends[i + 1], (k, 0, 0, 0, 0, 0),
            offset=(0 if i == 0 else 1 if i < 3 else -2, 0, 0, 0, 0, 0),
        )
        for i in range(4)
    ]  # fmt: skip
    start = [rs.RigidBody(b.name, 1.0, (1, 1, 1), position=b.position, velocity=(0.1, 0, 0))
             for b in bodies]  # fmt: skip
    model = rs.compile_scene(rs.Scene("masses", start, springs))
    rest = rs.static_equilibrium(model)
    linear = rs.linearize(model, rest.point)
    # Three equal masses between walls: w^2 = 2 k (1 - cos(j pi / 4)).
    found = np.unique(np.round(linear.frequencies, 9)) * 2 * math.pi
    wanted = [math.sqrt(2 * k * (1 - math.cos(j * math.pi / 4))) for j in (1, 2, 3)]
    np.testing.assert_allclose(found, wanted, rtol=1e-8)


@pytest.mark.parametrize("minimal", [True, False])
def test_a_column_buckles_where_it_should_in_every_model(minimal: bool) -> None:
    model = rs.compile_scene(column(rs.Param("k", 1.0, "N m/rad")), minimal=minimal)
    rest = rs.static_equilibrium(model)
    assert rest.outcome is Rest.found
    height = 0.5 - 9.81 / 1e6
    assert rest.x["bar.p_z"] == pytest.approx(height, rel=4 * EPS)
    linear = rs.linearize(model, rest.point)
    expected = math.sqrt((9.81 * 0.5 - 1.0) / (0.08 + 0.25))
    assert linear.abscissa == pytest.approx(expected, rel=1e-4)  # the give of the hinge: 1e-5
    assert not linear.stable
    assert (len(linear.left_out.values) > 0) is minimal
    # The critical stiffness is m g l, but for the give of the hinge.
    for k, stable in ((0.999 * 4.905, False), (1.001 * 4.905, True)):
        params = {"k": k}
        rest = rs.static_equilibrium(model, params=params)
        assert rs.linearize(model, rest.point).stable is stable


def test_both_spectra_together_are_the_full_one_without_norms_of_quaternions() -> None:
    models = [rs.compile_scene(column(), minimal=minimal) for minimal in (True, False)]
    small, full = (rs.linearize(m, rs.static_equilibrium(m).point) for m in models)
    assert len(small.eigenvalues) == 2
    assert len(full.eigenvalues) == 12, "13 states, one of them a norm"
    assert len(small.spectrum.values) == 12
    ours, theirs = (np.sort_complex(np.round(s.spectrum.values, 6)) for s in (small, full))
    np.testing.assert_allclose(ours, theirs, atol=1e-6 * np.abs(theirs).max())
    assert small.abscissa == pytest.approx(full.abscissa, rel=1e-8)
    # Without the tangent space there is one eigenvalue more, the zero of the norm.
    plain = np.linalg.eigvals(full.A)
    assert len(plain) == 13
    assert np.abs(plain).min() < 1e-6


def test_coordinates_do_not_change_eigenvalues_at_rest() -> None:
    found = []
    for formulation in (rs.Quaternion(), rs.TaitBryan()):
        model = rs.compile_scene(build("coupled"), formulation)
        rest = rs.static_equilibrium(model)
        linear = rs.linearize(model, rest.point)
        assert linear.rate < 1e-10
        found.append(np.sort_complex(linear.eigenvalues))
    np.testing.assert_allclose(found[0], found[1], atol=1e-9 * np.abs(found[0]).max())


def test_tangent_coordinates_turn_with_the_body() -> None:
    """A free body that spins: small disturbances of its rotation turn, and none grows."""
    body = rs.RigidBody("b", 1.0, (1, 1, 1), angular_velocity=(0.3, -0.4, 1.2))
    model = rs.compile_scene(rs.Scene("free", [body], []), minimal=False)
    linear = rs.linearize(model)
    rows = [i for i, c in enumerate(linear.coordinates) if "rotation" in c.name]
    spin = np.array([0.3, -0.4, 1.2])
    cross = np.array([[0, -spin[2], spin[1]], [spin[2], 0, -spin[0]], [-spin[1], spin[0], 0]])
    # d(turn)/dt = dw - w x turn: exactly, since the basis turns along.
    np.testing.assert_allclose(linear.A_tangent[np.ix_(rows, rows)], -cross, atol=4 * EPS)
    assert linear.stable


def test_free_directions_are_told_and_stay_where_they_were() -> None:
    body = rs.RigidBody("b", 2.0, (1, 1, 1))
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("b"), (0, 0, 500, 0, 0, 0))
    model = rs.compile_scene(
        rs.Scene("sliding", [body], [spring], gravity=(0, 0, -9.81)), minimal=False
    )
    rest = rs.static_equilibrium(model, start={"b.p_x": 0.7, "b.v_x": 3.0})
    assert rest.outcome is Rest.found
    assert rest.x["b.p_x"] == pytest.approx(0.7, abs=4 * EPS)
    assert rest.x["b.v_x"] == 0
    assert rest.x["b.p_z"] == pytest.approx(-2 * 9.81 / 500, rel=8 * EPS)
    assert set(rest.free) == {"b.p_x", "b.p_y", "b.rotation_x", "b.rotation_y", "b.rotation_z"}
    assert "do not determine" in rest.report


def test_what_nothing_balances_is_told() -> None:
    body = rs.RigidBody("b", 1.0, (1, 1, 1))
    model = rs.compile_scene(rs.Scene("falling", [body], [], gravity=(0, 0, -9.81)))
    with pytest.raises(rs.EquilibriumError, match=r"b\.v_z changes by -9\.81 m/s per s.*b\.p_z"):
        rs.static_equilibrium(model)
    rest = rs.static_equilibrium(model, throw=False)
    assert rest.outcome is Rest.unbalanced
    assert rest.residual == pytest.approx(9.81, rel=4 * EPS)
    assert not rest.outcome.ok


def test_a_start_far_from_rest_relaxes_to_one() -> None:
    """Tilted by 33 degrees with a stretched stiff hinge: Newton's method alone gets stuck."""
    model = rs.compile_scene(column(), minimal=False)
    rest = rs.static_equilibrium(model, start={"bar.q_x": 0.3})
    assert rest.outcome is Rest.found
    q = np.array([rest.x[f"bar.q_{c}"] for c in "wxyz"])
    tilt = 2 * math.acos(min(1.0, abs(q[0]) / np.linalg.norm(q)))
    assert 1.0 * tilt == pytest.approx(9.81 * 0.5 * math.sin(tilt), rel=1e-3)
    assert tilt > 1.0


def test_massless_bodies_and_algebraic_unknowns() -> None:
    """Two springs in a row with a massless body between: half the stiffness, exactly eliminated."""
    mass = rs.RigidBody("m", 3.0, (1, 1, 1))
    between = rs.RigidBody("between", 0, 0)
    springs = [
        rs.RigidBodySpringDamper("s0", GROUND, rs.Marker("between"), [800.0] * 3 + [50.0] * 3),
        rs.RigidBodySpringDamper(
            "s1", rs.Marker("between"), rs.Marker("m"), [800.0] * 3 + [50.0] * 3
        ),
    ]
    scene = rs.Scene("row", [mass, between], springs, gravity=(0, 0, -9.81))
    model = rs.compile_scene(scene)
    assert model.n_z > 0
    rest = rs.static_equilibrium(model)
    assert rest.x["m.p_z"] == pytest.approx(-3 * 9.81 / 400, rel=1e-13)
    assert rest.z["between.p_z"] == pytest.approx(-3 * 9.81 / 800, rel=1e-13)
    linear = rs.linearize(model, rest.point)
    np.testing.assert_allclose(linear.A, [[0, 1], [-400 / 3, 0]], rtol=1e-13)
    # A point away from the balance is brought to it, where there is one.
    moved = rs.linearize(model, {"m.p_z": 0.5})
    assert moved.point.z[0] == pytest.approx(0.25, rel=1e-12)


def test_points_are_given_in_many_ways() -> None:
    model = axis_oscillator(1.0, rs.Param("k", 500.0, "N/m"), 5.0)
    run = rs.simulate(model, 1.0, params={"k": 700.0}, inputs={"force": 2.0})
    by_trajectory = rs.linearize(model, run, t=float(run.t[50]))
    assert by_trajectory.A[1, 0] == -700
    assert by_trajectory.point.x.tolist() == [run["b.p_y"][50], run["b.v_y"][50]]
    assert by_trajectory.point.u.tolist() == [2.0]
    by_name = rs.linearize(model, run.state_at_end, params={"k": 700.0})
    assert by_name.point.x.tolist() == rs.linearize(model, run).point.x.tolist()
    by_vector = rs.linearize(model, [0.1, 0.2], inputs={"force": lambda t: 3 + t}, t=1.0)
    assert by_vector.point.x.tolist() == [0.1, 0.2]
    assert by_vector.point.u.tolist() == [4.0]
    assert rs.linearize(model, by_vector.point, params={"k": 600.0}).A[1, 0] == -600


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"at": {"b.p_z": 0.1}}, r"'b\.p_z' was left out.*minimal=False"),
        ({"start": {"c.p_y": 0.1}}, r"no state 'c\.p_y'; there are: b\.p_y, b\.v_y"),
        ({"at": [0.1]}, r"1 states; it has 2"),
        ({"at": "rest"}, r"give a vector of 2 numbers"),
        ({"start": {"b.p_y": float("nan")}}, r"'b\.p_y': nan m; give a finite number"),
        ({"params": {"m": 1.0}}, r"no parameter 'm'; there are: k"),
        ({"inputs": {"f": 1.0}}, r"no input 'f'; there are: force"),
        ({"t": float("inf")}, r"time: inf s"),
    ],
)
def test_bad_points_are_refused(given: dict, message: str) -> None:
    model = axis_oscillator(1.0, rs.Param("k", 500.0, "N/m"), 5.0)
    with pytest.raises(ValueError, match=message):
        rs.linearize(model, **given)


def test_a_trajectory_of_another_model_or_time_is_refused() -> None:
    model = axis_oscillator(1.0, 500.0, 5.0)
    other = rs.compile_scene(column(), minimal=False)
    run = rs.simulate(model, 0.1)
    with pytest.raises(ValueError, match="has other states"):
        rs.linearize(other, run)
    with pytest.raises(ValueError, match=r"not a saved time.*nearest is 0\.1 s"):
        rs.linearize(model, run, t=0.2)
    with pytest.raises(ValueError, match="of another model"):
        rs.linearize(other, locate(model), params={})


def _random_scene(rng: np.random.Generator) -> rs.Scene:
    """Two bodies on three soft connectors at random places."""
    def marker(name: str) -> rs.Marker:
        return rs.Marker(name, rng.uniform(-0.3, 0.3, 3))

    bodies = [
        rs.RigidBody(f"b{i}", rng.uniform(1, 3), rng.uniform(0.1, 0.15, 3),
                     position=rng.uniform(-0.2, 0.2, 3))
        for i in range(2)
    ]  # fmt: skip
    ends = [(rs.GROUND, "b0"), ("b0", "b1"), (rs.GROUND, "b1")]
    springs = [
        rs.RigidBodySpringDamper(
            f"s{i}", marker(a), marker(b), rng.uniform(200, 900, 6), rng.uniform(2, 9, 6),
            offset=rng.uniform(-0.1, 0.1, 6), law=rs.Consistent(),
        )
        for i, (a, b) in enumerate(ends)
    ]  # fmt: skip
    return rs.Scene("random", bodies, springs, gravity=(0, 0, -9.81))


@settings(max_examples=2, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_random_scenes_rest_and_decay_as_their_eigenvalues_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = rs.compile_scene(_random_scene(rng))
    rest = rs.static_equilibrium(model)
    assert rest.outcome is Rest.found
    assert rest.residual < 1e-9
    linear = rs.linearize(model, rest.point)
    assert linear.stable, "a symmetric stiffness with damping, at a rest that was relaxed to"
    assert len(linear.eigenvalues) == model.n_x - 2
    # A small disturbance follows exp(A t): to second order in its size, and to the tolerance.
    chart, small = chart_of(model), 1e-5
    step = small * rng.standard_normal(chart.size)
    x = np.array(chart.retract(rest.point.x, rest.point.z, rest.point.p, step)).reshape(-1)
    t = 2 / np.abs(linear.eigenvalues).max()
    names = [v.name for v in model.x_labels]
    run = rs.simulate(
        model, [0.0, t], rs.Idas(rtol=1e-11, atol=1e-13), start=dict(zip(names, x, strict=True))
    )
    end = np.array([run[name][-1] for name in names]) - rest.point.x
    values, vectors = np.linalg.eig(linear.A_tangent)
    flow = (vectors * np.exp(values * t)) @ np.linalg.inv(vectors)
    error = np.abs(end - linear.basis @ (flow @ step).real).max()
    assert error < 1e4 * small**2 + 1e-9, error


@given(st.integers(0, 2**32 - 1), st.integers(1, 6))
def test_balancing_keeps_eigenvalues(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    units = 2.0 ** rng.integers(-20, 20, n)
    A = rng.standard_normal((n, n))
    scaled, scale = balanced(A * units[:, None] / units)
    assert np.abs(scaled).max() < 64 * np.abs(A).max()
    np.testing.assert_array_equal(scaled, (A * units[:, None] / units) * (scale / scale[:, None]))


def test_what_is_printed_tells_both_spectra() -> None:
    model = rs.compile_scene(column())
    linear: Linear = rs.linearize(model, rs.static_equilibrium(model).point)
    text = str(linear)
    assert "unstable, largest real part 3.43998 1/s" in text
    assert "eigenvalues of what the minimal model left out" in text
    assert "frequency Hz" in text
