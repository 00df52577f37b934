"""Minimal models: what is left out, that nothing is lost, and that attacks keep what they need."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.comparing import by_name, compare
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenes import reference
from scenes.small import BODY, GROUND, LAWS, chain, column, one_body

import rbsd_sym as rs


def kept(scene: rs.Scene, **options: Any) -> set[str]:
    """Names of the states the minimal model keeps."""
    return {label.name for label in rs.compile_scene(scene, **options).x_labels}


@pytest.mark.parametrize("law", LAWS.values(), ids=by_name)
@pytest.mark.parametrize(("n", "offset", "states"), [(1, 0, 6), (20, 0, 120), (20, 0.1, 260)])
def test_sizes_of_chains(law: Any, n: int, offset: float, states: int) -> None:
    assert rs.compile_scene(chain(n, law, offset)).n_x == states


def test_size_of_mini_and_of_tait_bryan() -> None:
    mini = reference.build("mini")
    assert rs.compile_scene(mini).n_x == 2
    assert rs.compile_scene(mini, rs.TaitBryan()).n_x == 2
    assert rs.compile_scene(chain(3, rs.Consistent()), rs.TaitBryan()).n_x == 18
    assert rs.compile_scene(mini, minimal=False).n_x == 13
    model = rs.compile_scene(mini)
    assert len(model.dropped) == 11
    assert "b0.q_w = 1" in str(model)


# Every scene that is built to fool the pass keeps the states that can move.


def test_input_that_is_zero_at_the_start_keeps_its_direction() -> None:
    push = rs.Input("push", "N")
    scene = one_body()
    load = rs.Load("load", BODY, force=(push, 0, 0))
    assert kept(scene) == set()
    assert kept(rs.Scene("s", scene.bodies, scene.connectors, [load])) == {"b.p_x", "b.v_x"}


def test_parameter_that_is_zero_by_default_keeps_what_it_can_move() -> None:
    weight = rs.Param("weight", 0.0, "m/s2")
    assert kept(one_body(gravity=(0, 0, weight))) == {"b.p_z", "b.v_z"}


def test_offset_that_depends_on_time_keeps_its_direction() -> None:
    assert kept(one_body({"offset": [0, np.sin(rs.TIME), 0, 0, 0, 0]})) == {"b.p_y", "b.v_y"}


def test_springs_that_cancel_at_the_start_only() -> None:
    pulls = [
        rs.RigidBodySpringDamper(name, GROUND, BODY, [100] * 6, offset=(s, 0, 0, 0, 0, 0))
        for name, s in (("left", -1), ("right", 1))
    ]
    body = rs.RigidBody("b", 1, (1, 1, 1))
    assert kept(rs.Scene("s", [body], pulls)) == set()  # equal springs: it stays in the middle
    k = rs.Param("k", 100.0)
    right = rs.RigidBodySpringDamper("right", GROUND, BODY, [k] + [100] * 5, offset=(1,) + (0,) * 5)
    assert kept(rs.Scene("s", [body], [pulls[0], right])) == {"b.p_x", "b.v_x"}


def test_symmetric_start_of_two_bodies_is_kept() -> None:
    bodies = [rs.RigidBody(n, 1, (1, 1, 1), velocity=(v, 0, 0)) for n, v in (("a", 1), ("b", -1))]
    spring = rs.RigidBodySpringDamper("c", rs.Marker("a"), rs.Marker("b"), [10] * 6)
    assert kept(rs.Scene("s", bodies, [spring])) == {"a.p_x", "a.v_x", "b.p_x", "b.v_x"}


def test_user_force_that_looks_at_another_axis() -> None:
    def force(mbs: Any, t: Any, i: Any, u: Any, th: Any, v: Any, w: Any, *rest: Any) -> list[Any]:
        return [100 * u[0], 100 * u[1] + 3 * u[0], 0, 0, 0, 0]

    moving = one_body({"force": force}, {"velocity": (1, 0, 0)})
    assert kept(moving) == {"b.p_x", "b.v_x", "b.p_y", "b.v_y"}


def test_coupled_stiffness_and_gyroscopic_torque_keep_what_they_reach() -> None:
    K = np.diag([100.0] * 6)
    K[0, 4] = K[4, 0] = 5.0
    names = kept(one_body({"stiffness": K, "law": rs.Consistent()}, {"velocity": (1, 0, 0)}))
    assert {"b.p_x", "b.w_y"} <= names
    spun = one_body({"stiffness": [0] * 6}, {"angular_velocity": (1, 1, 0)})
    assert {"b.w_x", "b.w_y", "b.w_z"} <= kept(spun)


def test_standard_pendulum_about_y_is_not_frozen_for_its_law_leaves_the_plane() -> None:
    """Past 90 degrees the Tait-Bryan roll of a turn about y jumps to pi: there is no plane."""
    link = rs.RigidBody("b", 1, (0.01, 0.1, 0.1), position=(0.5, 0, 0))
    for law, states in ((rs.Standard(), 13), (rs.Consistent(), 6)):
        joint = rs.RigidBodySpringDamper(
            "j", GROUND, rs.Marker("b", (-0.5, 0, 0)), [1e5] * 3 + [1e3] * 3, law=law
        )
        scene = rs.Scene("s", [link], [joint], gravity=(0, 0, -9.81))
        assert rs.compile_scene(scene).n_x == states


# Nothing is lost.


@pytest.mark.parametrize("law", LAWS.values(), ids=by_name)
def test_minimal_equals_full_for_a_chain(law: Any) -> None:
    assert compare(chain(3, law)) < 1e-9


@pytest.mark.parametrize("name", ["mini", "single", "chain4"])
def test_minimal_equals_full_for_reference_scenes(name: str) -> None:
    assert compare(reference.build(name), 0.2) < 1e-9


def test_angle_counts_turns() -> None:
    spinner = one_body({"stiffness": [0] * 6}, {"angular_velocity": (0, 0, 7.0)})
    model = rs.compile_scene(spinner)
    assert [label.name for label in model.x_labels] == ["b.angle_z"]
    trajectory = rs.simulate(model, 10.0)
    assert trajectory["b.angle_z"][-1] == pytest.approx(70.0, rel=1e-9)
    c, s = np.cos(70.0), np.sin(70.0)
    np.testing.assert_allclose(
        trajectory["b.rotation_matrix"][-1], [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-7
    )


def test_dropped_states_cannot_be_started_elsewhere() -> None:
    model = rs.compile_scene(reference.build("mini"))
    with pytest.raises(ValueError, match=r"b0\.p_x.*left out.*minimal=False"):
        rs.simulate(model, 1.0, start={"b0.p_x": 0.1})


finite = st.floats(-1, 1).map(lambda v: round(v, 3))


@st.composite
def random_scene(draw: st.DrawFn) -> rs.Scene:
    """Bodies in a row, aligned or not, on connectors with zero and non-zero rows."""
    n = draw(st.integers(1, 2))
    aligned = draw(st.booleans())
    law = draw(st.sampled_from(list(LAWS.values())))
    bodies, joints = [], []
    for i in range(n):
        inertia = np.array([draw(st.floats(1, 2)) for _ in range(3)])
        bodies.append(rs.RigidBody(
            f"b{i}", draw(st.floats(0.5, 3)), inertia,
            position=(i, 0, 0) if aligned else [i, draw(finite), draw(finite)],
            velocity=draw(st.sampled_from([(0, 0, 0), (1, 0, 0), (0, 0, -1), (0.5, 0.2, 0)])),
            angular_velocity=draw(st.sampled_from([(0, 0, 0), (0, 0, 2), (1, 0, 0), (0.3, 1, 0)])),
        ))  # fmt: skip
        rows = [draw(st.sampled_from([0.0, 20.0, 100.0])) for _ in range(6)]
        place = (draw(finite), draw(finite), 0 if aligned else draw(finite))
        joints.append(rs.RigidBodySpringDamper(
            f"j{i}", rs.Marker(f"b{i - 1}", place) if i else GROUND, rs.Marker(f"b{i}"), rows,
            [0.02 * k for k in rows], law=law,
        ))  # fmt: skip
    gravity = draw(st.sampled_from([(0, 0, 0), (0, -9.81, 0), (0, 0, -9.81)]))
    return rs.Scene("random", bodies, joints, gravity=gravity)


def rates_vanish(scene: rs.Scene, seed: int) -> float:
    """Largest rate of a dropped state over random values of the others, relative to all rates."""
    small, full = rs.compile_scene(scene), rs.compile_scene(scene, minimal=False)
    gone = [d.name for d in small.dropped]
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((small.n_x, 40)) * 2
    states = np.array(small.function("states")(0, x, [], [], [])).reshape(-1, 40)
    rates = np.array(full.function("ode")(0, states[: full.n_x], [], [], []))
    labels = [label.name for label in full.x_labels]
    rows = [labels.index(name) for name in gone]
    return float(np.abs(rates[rows]).max(initial=0.0) / (1 + np.abs(rates).max()))


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(scene=random_scene(), seed=st.integers(0, 1000))
@pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")
def test_random_scenes_are_sound(scene: rs.Scene, seed: int) -> None:
    assert rates_vanish(scene, seed) < 1e-12


@pytest.mark.slow
@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(scene=random_scene())
@pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")
def test_random_scenes_equal_the_full_model(scene: rs.Scene) -> None:
    assert compare(scene, 0.3) < 1e-9


# What the small model cannot see.


def test_buckling_hidden_by_the_minimal_model_is_reported() -> None:
    model = rs.compile_scene(column())
    assert {label.name for label in model.x_labels} == {"bar.p_z", "bar.v_z"}
    with pytest.warns(rs.ModelWarning, match=r"grows with \d\.\d+ 1/s"):
        trajectory = rs.simulate(model, 0.1)
    assert trajectory.outcome is rs.Outcome.unstable_across_reduction
    with pytest.raises(rs.IntegrationError, match="unstable") as caught:
        rs.simulate(model, 0.1, throw_unstable=True)
    assert caught.value.trajectory.t[-1] == 0.1
    assert model.reduction is not None
    # An upright pendulum at rest on its springs: growth^2 = (m g l - k) / (I + m l^2), but for the
    # give of the hinge, 1e6 N/m.
    at_rest = [0.5 - 9.81e-6, 0.0]
    block = np.array(model.reduction.transverse(0, at_rest, [], [], []))
    expected = np.sqrt((9.81 * 0.5 - 1.0) / (0.08 + 0.25))
    assert np.linalg.eigvals(block).real.max() == pytest.approx(expected, rel=1e-3)
    # Started unstretched it bounces, and at the bottom carries twice its weight.
    growth = model.transverse_growth(trajectory)
    assert growth.rate == pytest.approx(np.sqrt((2 * 9.81 * 0.5 - 1.0) / (0.08 + 0.25)), rel=1e-2)


def test_both_spectra_together_are_the_full_one() -> None:
    small, full = rs.compile_scene(column()), rs.compile_scene(column(), minimal=False)
    assert small.reduction is not None
    x = [label.start for label in small.x_labels]
    X = [label.start for label in full.x_labels]
    parts = [np.array(ca_matrix) for ca_matrix in (
        small.function("dode_dx")(0, x, [], [], []), small.reduction.transverse(0, x, [], [], []))]
    ours = np.concatenate([np.linalg.eigvals(part) for part in parts])
    whole = np.linalg.eigvals(np.array(full.function("dode_dx")(0, X, [], [], [])))
    # Defective zeros (rigid turns, the norm) are known to sqrt(epsilon) only; others to 1e-10.
    for value in whole[np.abs(whole) > 1e-3]:
        assert np.abs(ours - value).min() < 1e-10 * np.abs(whole).max()
    assert len(ours) == len(whole)


def test_states_replaced_by_an_angle_cannot_be_started_elsewhere() -> None:
    model = rs.compile_scene(chain(1, rs.Consistent()))
    with pytest.raises(ValueError, match=r"b0\.q_z.*it is sin\(\(b0\.angle_z/2\)\).*minimal=F"):
        rs.simulate(model, 1.0, start={"b0.q_z": 0.1})


def test_saved_file_speaks_of_the_full_scene(tmp_path: Path) -> None:
    trajectory = rs.simulate(rs.compile_scene(reference.build("mini")), 0.1)
    saved = rs.Trajectory.load(trajectory.save(tmp_path / "mini"))
    assert set(saved["b0.q_w"]) == {1.0}
    assert set(saved["b0.p_x"]) == {0.0}
    assert saved.state_at_end == trajectory.state_at_end
    with pytest.raises(ValueError, match=r"no column 'b0\.position'"):
        saved["b0.position"]  # an output nobody asked for before saving


def test_planar_state_survives_saving(tmp_path: Path) -> None:
    model = rs.compile_scene(chain(1, rs.Consistent()))
    trajectory = rs.simulate(model, 0.2)
    saved = rs.Trajectory.load(trajectory.save(tmp_path / "chain"))
    half = trajectory["b0.angle_z"] / 2
    np.testing.assert_allclose(saved["b0.q_w"], np.cos(half), atol=1e-15)
    np.testing.assert_allclose(saved["b0.q_z"], np.sin(half), atol=1e-15)


# Only what the requested outputs feel.


def bob(outputs: Any = None, law: Any = None) -> rs.Scene:
    """A spinning body whose isotropic spring, at its centre, does not feel the rotation."""
    body = rs.RigidBody("b", 2, (1, 2, 3), position=(1, 0, 0), angular_velocity=(1, 2, 3))
    spring = rs.RigidBodySpringDamper(
        "c", GROUND, BODY, (50, 60, 70, 0, 0, 0), (1, 1, 1, 0, 0, 0), law=law or rs.Standard()
    )
    return rs.Scene("s", [body], [spring], gravity=(0, 1, -9.81), outputs=outputs)


def test_states_that_no_requested_output_feels_are_dropped() -> None:
    assert rs.compile_scene(bob()).n_x == 13
    assert rs.compile_scene(bob(["b.angular_velocity"])).n_x == 3
    model = rs.compile_scene(bob(["b.position", "c.force_local"]))
    assert {v.name[:3] for v in model.x_labels} == {"b.p", "b.v"}
    assert {d.name: d.reason for d in model.dropped}["b.w_x"] == "no requested output depends on it"
    times = np.linspace(0, 1, 5)
    small = rs.simulate(model, times, rs.ExplicitRK(1e-11, 1e-13))
    whole = rs.simulate(rs.compile_scene(bob(), minimal=False), times, rs.ExplicitRK(1e-11, 1e-13))
    for name in ("b.position", "c.force_local", "b.p_z", "momentum"):
        np.testing.assert_allclose(small[name], whole[name], rtol=1e-9, atol=1e-9)


def test_what_needs_dropped_states_is_refused_with_the_remedy(tmp_path: Path) -> None:
    model = rs.compile_scene(bob(["b.position"]))
    trajectory = rs.simulate(model, 0.1)
    for name in ("b.quaternion", "energy"):
        with pytest.raises(ValueError, match=rf"{name}.*outputs=\["):
            trajectory[name]
    with pytest.raises(ValueError, match=r"b\.q_w.*no requested output depends.*minimal=False"):
        rs.simulate(model, 0.1, start={"b.q_w": 1.0})
    saved = rs.Trajectory.load(trajectory.save(tmp_path / "bob"))
    assert "b.p_x" in saved
    assert "b.w_x" not in saved


def test_an_output_that_feels_everything_keeps_everything() -> None:
    assert rs.compile_scene(bob(["b.position"], rs.Consistent())).n_x == 13  # torque by Am
    assert rs.compile_scene(bob(["angular_momentum"])).n_x == 13
    assert rs.compile_scene(bob(["energy"])).n_x == 9  # it needs no orientation


def test_parameters_without_effect_are_not_in_the_model_nor_in_c(tmp_path: Path) -> None:
    k, side, spare = (rs.Param(name, 100.0) for name in ("k", "side", "spare"))
    scene = one_body({"stiffness": [side, side, k, 10, 10, 10]}, gravity=(0, 0, -9.81))
    idle = rs.RigidBodySpringDamper("idle", GROUND, BODY, [spare] * 6, active=False)
    outputs = ["b.position", "c.force_local"]
    scene = rs.Scene("s", scene.bodies, [*scene.connectors, idle], gravity=(0, 0, -9.81),
                     outputs=outputs)  # fmt: skip
    model = rs.compile_scene(scene)
    assert (model.n_x, model.n_p) == (2, 1)
    artefact = rs.export_c(model, tmp_path / "s")
    header = (artefact.folder / "s.h").read_text()
    assert "S_P_K" in header
    assert "SIDE" not in header.upper()
    assert "SPARE" not in header.upper()
    values = {"side": 3.0, "spare": 7.0, "k": 50.0}  # accepted, and remembered
    trajectory = rs.simulate(model, 0.1, params=values)
    assert trajectory.parameters == values
    full = rs.simulate(rs.compile_scene(scene, minimal=False), 0.1, params=values)
    np.testing.assert_allclose(trajectory["b.position"], full["b.position"], atol=1e-7)


def test_stability_of_what_was_left_out_sees_its_own_parameters() -> None:
    side = rs.Param("side", 100.0)
    scene = one_body({"stiffness": [side, 100, 100, 10, 10, 10]}, gravity=(0, 0, -9.81))
    model = rs.compile_scene(rs.Scene("s", scene.bodies, scene.connectors, gravity=scene.gravity,
                                      outputs=["b.position"]))  # fmt: skip
    assert model.n_p == 0
    assert rs.simulate(model, 1.0).outcome is rs.Outcome.reached_end
    with pytest.warns(rs.ModelWarning, match="grows with 5 1/s"):  # sqrt(25 N/m / 1 kg)
        rs.simulate(model, 1.0, params={"side": -25.0})


def test_inactive_connector_is_not_in_c(tmp_path: Path) -> None:
    scene = one_body({"active": False})
    model = rs.compile_scene(scene)
    assert not [name for name in model.dae.requested if name.startswith("c.")]
    trajectory = rs.simulate(model, 0.1)
    assert np.all(trajectory["c.force0"] == 0)  # still there when asked for


def test_printed_model_tells_what_was_replaced() -> None:
    text = str(rs.compile_scene(chain(1, rs.Consistent())))
    assert "b0.q_w = cos((b0.angle_z/2))" in text
    assert "b0.p_z = 0: its rate is zero" in text


def test_zeros_that_are_seen_but_not_proven_are_named(tmp_path: Path) -> None:
    """Two mounts, mirror images of each other: their pitch moments cancel, by no syntax."""
    mounts = [
        rs.RigidBodySpringDamper(
            name, rs.Marker(rs.GROUND, (x, 0, 0)), rs.Marker("b", (x, 0, 0)), [1e4] * 3 + [10] * 3,
            law=rs.Consistent(),
        )
        for name, x in (("left", -0.3), ("right", 0.3))
    ]  # fmt: skip
    body = rs.RigidBody("b", 10, (1, 1, 1))
    model = rs.compile_scene(rs.Scene("s", [body], mounts, gravity=(0, 0, -9.81)))
    assert {"b.p_z", "b.v_z", "b.angle_y", "b.w_y"} <= {v.name for v in model.x_labels}
    assert model.reduction is not None
    assert {"b.p_x", "b.q_y", "b.w_y"} <= set(model.reduction.suspects)
    assert "b.p_z" not in model.reduction.suspects
    card = (rs.export_c(model, tmp_path / "s").folder / "README.md").read_text()
    for text in (str(model), card):
        assert "could not be proven" in text


def test_nothing_is_suspected_where_everything_moves() -> None:
    for scene in (chain(3, rs.Consistent()), reference.build("coupled")):
        model = rs.compile_scene(scene)
        assert model.reduction is not None
        assert model.reduction.suspects == ()
