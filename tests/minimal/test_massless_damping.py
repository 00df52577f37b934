"""Massless bodies damped in some directions, in minimal models, in C, and at random."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from charts import massless as chart
from helpers.comparing import largest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from oracles import scenes as oracle
from oracles.rotations import exp_so3
from scenes.massless import (
    TIGHTER,
    Data,
    massless,
    oracle_states,
    residual,
    scene_data,
    scene_of,
    spring,
    start_of,
    strung,
    unbalance,
    values_of_z,
)
from scenes.small import GROUND, LAWS

import rbsd_sym as rs


def with_start(scene: rs.Scene, body: str, start: dict[str, Any]) -> rs.Scene:
    """The scene with another start of one body."""
    bodies = [
        dataclasses.replace(b, **start) if b.name == body else b for b in scene.bodies
    ]
    return dataclasses.replace(scene, bodies=bodies)


def balanced(scene: rs.Scene, body: str) -> rs.Scene:
    """The scene with a body started where the springs alone balance it.

    Where damping acts in some directions only, any other start has forces that nothing resists.
    """
    loose = [dataclasses.replace(c, damping=0) for c in scene.connectors]
    model = rs.compile_scene(dataclasses.replace(scene, connectors=loose))
    values = {label.name: label.start for label in (*model.x_labels, *model.dae.z_labels)}
    pick = lambda names: [values[f"{body}.{name}"] for name in names.split()]  # noqa: E731
    place = {"rotation": np.array(pick("q_w q_x q_y q_z"))}
    place["rotation"] /= np.linalg.norm(place["rotation"])
    return with_start(scene, body, place | {"position": pick("p_x p_y p_z")})


# Damping in some directions only: the others are constraints, decided by their derivative.


def stuck(inertia: float) -> rs.Scene:
    """A point mass (or a small ball) with damped translation and undamped torsion."""
    J = (inertia,) * 3 if inertia else 0
    body = rs.RigidBody("b", 1, J, position=(0.3, 0.1, 0))
    mount = spring(
        "c", GROUND, rs.Marker("b"), [100, 100, 100, 50, 60, 70], [1, 1, 1, 0, 0, 0], "consistent"
    )
    return rs.Scene("stuck", [body], [mount], gravity=(0, 1, -9.81))


def maxwell_in_space(inertia: float) -> rs.Scene:
    """A Maxwell element along x, with springs along and about the other axes."""
    a = rs.RigidBody("a", inertia, (inertia,) * 3 if inertia else 0, position=(1, 0, 0))
    b = rs.RigidBody("b", 1, (0.2, 0.3, 0.4), position=(2, 0, 0))
    springs = [
        spring("k", GROUND, rs.Marker("a"), [100] * 6, law="consistent"),
        spring("d", rs.Marker("a"), rs.Marker("b"), [0] + [100] * 5, [5] + [0] * 5, "consistent",
               offset=[1, 0, 0, 0, 0, 0]),
    ]  # fmt: skip
    return rs.Scene("maxwell_in_space", [a, b], springs, gravity=(1, 0.2, 0.3))


def thin_rod(inertia: float) -> rs.Scene:
    """A rod on an undamped joint with torsion springs, also about the rod's axis."""
    rod = rs.RigidBody("b", 1, (inertia, 0.1, 0.1), position=(1, 0, 0))
    joint = spring(
        "c", GROUND, rs.Marker("b", (-1, 0, 0)), [1e3] * 3 + [10, 12, 14], law="consistent"
    )
    return rs.Scene("thin_rod", [rod], [joint], gravity=(0, 1, -9.81))


@pytest.mark.parametrize("build", [stuck, maxwell_in_space, thin_rod])
def test_partly_damped_motion_is_the_limit_of_small_inertia(build: Any) -> None:
    t, bare = np.linspace(0, 0.5, 26), build(0.0).bodies[0].name
    model = rs.compile_scene(build(0.0))
    assert any("others follow from the derivative" in note for note in model.dae.notes)
    limit = rs.simulate(model, t, rs.Idas(1e-9, 1e-11))
    inertias, found = np.array([1e-4, 1e-3, 1e-2]), []
    for inertia in inertias:
        scene = with_start(build(inertia), bare, start_of(limit, bare))
        full = rs.compile_scene(scene, minimal=False)
        path = rs.simulate(full, t, rs.Idas(1e-9, 1e-11))["b.position"]
        found.append(largest(path - limit["b.position"]))
    assert np.ptp(limit["b.position"], axis=0).max() > 0.3
    # Undamped fast motion of odd phase stirs the smallest errors, 1e-8 m: 0.1 in the slope.
    assert chart.slope(inertias, np.array(found)) == pytest.approx(1, abs=0.2)
    assert found[0] < 1e-4


@pytest.mark.parametrize("law", ["standard", "consistent"])
def test_rod_follows_a_driven_torsion_spring(law: str) -> None:
    """No inertia about its axis and no damping: the angle is the driven one, a pure constraint."""
    angle = 0.5 * np.sin(8 * rs.TIME)
    joint = spring(
        "c", GROUND, rs.Marker("b"), [100] * 3 + [20] * 3, law=law, offset=[0, 0, 0, angle, 0, 0]
    )
    scene = rs.Scene("rod", [rs.RigidBody("b", 1, (0, 0.1, 0.1))], [joint])
    t = np.linspace(0, 1, 41)
    found = rs.simulate(rs.compile_scene(scene, minimal=False), t, rs.Idas(1e-9, 1e-11))
    assert largest(found["c.rotation"][:, 0] - 0.5 * np.sin(8 * t)) < 1e-8
    assert largest(found["b.w_x"] - 4 * np.cos(8 * t)) < 1e-6  # the rate of the above over 1 ms


def swinging_rod(inertia: float) -> rs.Scene:
    """A rod on a joint without torsion: nothing decides its spin, at the start and elsewhere."""
    rod = rs.RigidBody("b", 1, (inertia, 0.1, 0.1), position=(1, 0, 0))
    K, D = [1e3] * 3 + [0] * 3, [2] * 3 + [0] * 3
    joint = spring("c", GROUND, rs.Marker("b", (-1, 0, 0)), K, D, "consistent")
    return rs.Scene("swinging_rod", [rod], [joint], gravity=(0, 1, -9.81))


def test_start_that_decides_nothing_is_helped_without_harm() -> None:
    """The virtual resistance, 1e-6 of the real one, acts on a spin that the path hardly feels."""
    t = np.linspace(0, 0.4, 21)
    model = rs.compile_scene(swinging_rod(0.0))
    assert any("virtual resistance" in note for note in model.dae.notes)
    found = rs.simulate(model, t, rs.Idas(1e-9, 1e-11))
    light = rs.compile_scene(swinging_rod(1e-6), minimal=False)
    path = rs.simulate(light, t, rs.Idas(1e-9, 1e-11))["b.position"]
    assert np.ptp(path, axis=0).max() > 0.3
    assert largest(found["b.w_x"]) < 1e-6
    assert largest(found["b.position"] - path) < 1e-10


@pytest.mark.parametrize(("law", "row"), [("standard", 0), ("consistent", 4)])
def test_constraints_of_partial_damping_hold_by_the_oracle(law: str, row: int) -> None:
    """One damped direction of six, in space: five balances are constraints, and are kept."""
    data = scene_data(law, 0.0)
    data["connectors"][0]["damping"] = np.diag(np.eye(6)[row] * (30.0 if row < 3 else 1.0))
    model = rs.compile_scene(balanced(scene_of(data), "b0"))
    found = rs.simulate(model, np.linspace(0, 0.2, 11), rs.Idas(1e-9, 1e-11))
    assert unbalance(data, oracle_states(found, 2)) < 1e-8  # kept by integration: 10 rtol


def levered(D: Any) -> rs.Scene:
    """As `stuck`, with the spring at a lever, started in the balance of its springs."""
    body = rs.RigidBody("b", 1, 0, position=(0.3, 0.1, 0))
    marker, K = rs.Marker("b", (0.1, 0.05, 0.2)), [100, 100, 100, 50, 60, 70]
    mount = spring("c", GROUND, marker, K, D, "consistent")
    scene = rs.Scene("levered", [body], [mount], gravity=(0, 1, -9.81))
    loose = dataclasses.replace(scene, connectors=[dataclasses.replace(mount, damping=0)])
    z = {label.name: label.start for label in rs.compile_scene(loose).dae.z_labels}
    q = np.array([z[f"b.q_{part}"] for part in "wxyz"])
    return with_start(scene, "b", {"rotation": q / np.linalg.norm(q)})


def check_levered(D: Any, integrator: Any) -> None:
    """The path equals that of a ball of 1e-5 kg m2, which is 5e-7 m from the limit."""
    scene, t = levered(D), np.linspace(0, 0.5, 11)
    ball = with_start(scene, "b", {"inertia": np.eye(3) * 1e-5})
    light = rs.simulate(rs.compile_scene(ball, minimal=False), t, rs.Idas(1e-9, 1e-11))
    found = rs.simulate(rs.compile_scene(scene), t, integrator)
    assert largest(found["b.position"] - light["b.position"]) < 2e-6


@pytest.mark.parametrize("torsion", [0.1, 1e-3, 0.0], ids=["damped", "weakly damped", "undamped"])
def test_levered_point_mass(torsion: float) -> None:
    """Where the torsion is undamped, translation damps one rotation with 1e-6 of the others."""
    check_levered([1, 1, 1] + [torsion] * 3, rs.Idas())


@pytest.mark.xfail(
    raises=rs.IntegrationError, strict=True,
    reason="1e-6 of the damping in one direction: as stiff as that, and z loses as many digits",
)  # fmt: skip
@pytest.mark.parametrize("integrator", [rs.Rosenbrock(), rs.Idas(1e-10, 1e-12)])
def test_levered_point_mass_at_other_tolerances(integrator: Any) -> None:
    check_levered([1, 1, 1, 0, 0, 0], integrator)


# Minimal models.


@pytest.mark.parametrize(
    ("law", "damping"), [("standard", 0.01), ("consistent", 0.0)]
)
def test_planar_scene_with_a_massless_link(law: str, damping: float) -> None:
    K = np.array([1000, 1200, 1500, 200, 300, 150.0])
    b = rs.RigidBody("b", 2, (0.2, 0.3, 0.4), position=(2, 0.1, 0), angular_velocity=(0, 0, 1))
    springs = [
        spring("c1", GROUND, rs.Marker("a", (-1, 0.1, 0)), K, damping * K, law),
        spring("c2", rs.Marker("a", (0.2, 0, 0)), rs.Marker("b", (-0.8, 0.1, 0)), K, damping * K,
               law),
    ]  # fmt: skip
    scene = rs.Scene("planar", [massless("a", 1, 0, 0), b], springs, gravity=(0, -9.81, 0))
    small, full = (rs.compile_scene(scene, None, minimal) for minimal in (True, False))
    assert (small.n_x, small.n_z) == ((9, 3) if damping else (6, 3))
    assert (full.n_x, full.n_z) == ((20, 6) if damping else (13, 7))
    unknowns = {label.name for label in small.dae.z_labels}
    assert unknowns == (
        {"a.v_x", "a.v_y", "a.w_z"} if damping else {"a.p_x", "a.p_y", "a.angle_z"}
    )
    gone = {dropped.name: dropped.value for dropped in small.dropped}
    still = "p_z q_x q_y v_z w_x w_y".split()
    assert {f"a.{name}": 0.0 for name in still}.items() <= gone.items()
    ours, theirs = (rs.simulate(model, np.linspace(0, 0.5, 11), TIGHTER) for model in (small, full))
    of_body = ("position", "rotation_matrix", "velocity", "angular_velocity")
    of_spring = ("force_local", "torque_local", "force0", "torque1", "dissipated_power")
    names = [f"{body}.{name}" for body in "ab" for name in of_body]
    names += [f"{c}.{name}" for c in ("c1", "c2") for name in of_spring]
    for name in (*names, "energy", "momentum"):
        size = max(1.0, largest(theirs[name]))
        assert largest(ours[name] - theirs[name]) < 1e-9 * size, name  # 100 times rtol
    assert set(ours["a.p_z"]) == {0.0}


def column(law: str, mass: float, damping: float) -> Data:
    """An upright column of two links of 1 m on weak hinges, at rest on its springs (1e6 N/m)."""
    give, none = 9.81e-6, np.zeros(3)
    bodies = [
        {"mass": m, "inertia": m * np.array(J), "position": [0, 0, z], "velocity": none,
         "angular_velocity": none}
        for m, J, z in ((mass, [0.1, 0.1, 0.01], 0.5 - give), (1.0, [0.08, 0.07, 0.01],
                                                               1.5 - 2 * give))
    ]  # fmt: skip
    hinges = [
        {"body0": i - 1, "body1": i, "position0": [0, 0, 0.5 if i else 0], "offset": np.zeros(6),
         "position1": [0, 0, -0.5], "stiffness": np.diag([1e6] * 3 + torsion),
         "damping": damping * np.eye(6)}
        for i, torsion in enumerate(([6.0, 7, 50], [5.0, 8, 50]))
    ]  # fmt: skip
    return {"gravity": [0, 0, -9.81], "law": law, "bodies": bodies, "connectors": hinges}


def growth_of(data: Data) -> float:
    """Largest real part of the spectrum about the start, from the oracle by complex steps."""
    start = oracle.start_state(data)
    columns = []
    for i in range(start.size):
        x = start.astype(complex).reshape(-1)
        x[i] += 1e-30j
        columns.append(oracle.rates(data, x.reshape(start.shape)).imag.reshape(-1) / 1e-30)
    return float(np.linalg.eigvals(np.array(columns).T).real.max())


def check_column(law: str, damping: float) -> None:
    """The small model sees z only, and still tells how fast the column falls over."""
    model = rs.compile_scene(scene_of(column(law, 0.0, damping)))
    kept = {label.name for label in (*model.x_labels, *model.dae.z_labels)}
    assert kept <= {"b0.p_z", "b0.v_z", "b1.p_z", "b1.v_z"}
    with pytest.warns(rs.ModelWarning, match=r"grows with \d\.\d+ 1/s"):
        found = rs.simulate(model, np.linspace(0, 0.15, 16))
    assert found.outcome is rs.Outcome.unstable_across_reduction
    expected = growth_of(column(law, 1e-5, damping))  # in error by its share of the mass
    assert expected > 2
    assert model.transverse_growth(found).rate == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("law", LAWS)
def test_falling_column_with_a_massless_link_is_reported(law: str) -> None:
    check_column(law, 0.0)


def test_falling_column_on_damped_hinges_is_reported() -> None:
    check_column("consistent", 0.3)


# Exports and integrators.


@pytest.mark.skipif(not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler")
@pytest.mark.parametrize("damping", [0.0, 0.01])
def test_exported_c_has_the_algebraic_part(damping: float, tmp_path: Path) -> None:
    """With outputs that follow from d alg/dt, and start values that are consistent."""
    outputs = ["b0.velocity", "b0.angular_velocity", "c0.force_local"]
    model = rs.compile_scene(scene_of(scene_data("standard", damping), outputs=outputs))
    artefact = rs.export_c(model, tmp_path)
    wanted = {"ode", "alg", "out", "dode_dx", "dode_dz", "dalg_dx", "dalg_dz"}
    assert wanted <= set(artefact.functions)
    library = rs.load_c(artefact, model, flags=["-O0"])
    header = (tmp_path / "scene.h").read_text()
    assert f"SCENE_N_Z = {model.n_z}" in header
    assert ("SCENE_Z_B0_V_X" if damping else "SCENE_Z_B0_P_X") in header
    x, z = np.array([label.start for label in model.x_labels]), values_of_z(model)
    rng = np.random.default_rng(0)
    for size in (0.0, 0.1, 0.1):
        point = [0.3, *(v + size * rng.standard_normal(v.size) for v in (x, z))]
        for name in artefact.functions:
            theirs = np.array(library.function(name)(*point, [], []))
            ours = np.array(model.function(name)(*point, [], []))
            np.testing.assert_allclose(theirs, ours, rtol=1e-13, atol=1e-13 * largest(ours))
    assert largest(library.function("alg")(0, x, z, [], [])) < 1e-10
    assert repr(float(z[0])) in (tmp_path / "scene.c").read_text()


def test_explicit_runge_kutta_refuses_and_names_the_others() -> None:
    model = rs.compile_scene(strung())
    with pytest.raises(ValueError, match=r"strung.*7 algebraic.*Idas\(\) or Rosenbrock\(\)"):
        rs.simulate(model, 0.1, rs.ExplicitRK())


@pytest.mark.parametrize(("law", "damping"), [("intrinsic", 0.0), ("consistent", 0.01)])
def test_tait_bryan_angles_give_the_same_motion(law: str, damping: float) -> None:
    """Full turns are not reached; 1e-9 is ten times what either leaves at rtol 1e-11."""
    scene, t = scene_of(scene_data(law, damping)), np.linspace(0, 0.5, 11)
    models = [rs.compile_scene(scene, way) for way in (rs.Quaternion(), rs.TaitBryan())]
    sizes = [(20, 6), (18, 6)] if damping else [(13, 7), (12, 6)]
    assert [(model.n_x, model.n_z) for model in models] == sizes
    ours, theirs = (rs.simulate(model, t, TIGHTER) for model in models)
    for body in ("b0", "b1"):
        for name in ("position", "rotation_matrix", "velocity", "angular_velocity"):
            one, other = ours[f"{body}.{name}"], theirs[f"{body}.{name}"]
            assert largest(one - other) < 1e-9 * max(1.0, largest(other)), f"{body}.{name}"


# Random scenes.

# Rows of D over rows of K: in all directions, in none, or with zero rows, for the two connectors.
_ALL, _NONE, _X = [1] * 6, [0] * 6, [1, 0, 0, 0, 0, 0]
MASKS = {
    "undamped": (_NONE, _NONE), "damped": (_ALL, _ALL), "outer": (_NONE, _ALL),
    "translation": ([1, 1, 1, 0, 0, 0], _NONE), "rotation": ([0, 0, 0, 1, 1, 1],) * 2,
    "one row": (_X, _NONE),
}  # fmt: skip


@st.composite
def random_scene(draw: st.DrawFn) -> tuple[str, rs.Scene]:
    """A massless body between the ground and a massive body: how it is damped, and the scene.

    With zero rows of damping it starts in balance: elsewhere forces that nothing resists throw it,
    and one start in five cannot be integrated.
    """
    kind = draw(st.sampled_from(["undamped", "undamped", *MASKS]))
    law = draw(st.sampled_from(["consistent", *LAWS]))
    rng = np.random.default_rng(draw(st.integers(0, 2**16)))
    marker = lambda body, base: rs.Marker(  # noqa: E731
        body, base + rng.uniform(-0.2, 0.2, 3), exp_so3(rng.uniform(-0.2, 0.2, 3))
    )
    bodies = [massless("a", 1, 0, 0), rs.RigidBody(
        "b", rng.uniform(0.5, 3), rng.uniform(0.1, 0.15, 3), position=(2, 0, 0),
        velocity=rng.uniform(-0.5, 0.5, 3), angular_velocity=rng.uniform(-1, 1, 3),
    )]  # fmt: skip
    inner, link = np.zeros(3), np.array([-1.0, 0, 0])
    pairs = (marker(rs.GROUND, inner), marker("a", link)), (marker("a", inner), marker("b", link))
    springs = []
    for i, (ends, mask) in enumerate(zip(pairs, MASKS[kind], strict=True)):
        K = np.concatenate([rng.uniform(200, 2000, 3), rng.uniform(20, 200, 3)])
        D = 0.02 * K * np.array(mask)
        springs.append(spring(f"c{i}", *ends, K, D, law))
    scene = rs.Scene("random", bodies, springs, gravity=rng.uniform(-5, 5, 3))
    return kind, scene if kind in ("undamped", "damped") else balanced(scene, "a")


def simpson(values: np.ndarray, h: float) -> float:
    """Integral over an odd number of equidistant points."""
    inner = 4 * values[1::2].sum() + 2 * values[2:-1:2].sum()
    return float(h / 3 * (values[0] + inner + values[-1]))


@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True)
@given(drawn=random_scene())
def test_random_massless_scenes(drawn: tuple[str, rs.Scene]) -> None:
    kind, scene = drawn
    model = rs.compile_scene(scene)
    t = np.linspace(0, 0.1, 61)
    found = rs.simulate(model, t, rs.Idas(1e-8, 1e-10))
    forces = max(largest(found[f"c{i}.force0"]) for i in (0, 1))
    assert residual(model, found) < 1e-9 * forces  # solved for at each saved point
    if isinstance(scene.connectors[0].law, rs.Consistent):
        lost = sum(found[f"c{i}.dissipated_power"] for i in (0, 1))
        change = found["energy"][-1] - found["energy"][0] + simpson(lost, t[1] - t[0])
        moved = largest(found["energy"] - found["energy"][0]) + largest(found["b.kinetic_energy"])
        # Undamped, integration alone is in error; else Simpson's rule over relaxation in 20 ms.
        assert abs(change) < (1e-6 if kind == "undamped" else 1e-4) * moved
