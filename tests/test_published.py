"""Published scenes against their values; each test says which integrator reaches them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.comparing import largest
from scenes import published
from scenes.published import Array

import rbsd_sym as rs

WEIGHT = published.BRICARD_ENERGY  # energy of Bricard's linkage at the start, J


def point(trajectory: rs.Trajectory, body: str, local: Any) -> Array:
    """World position (n, 3) of a point of a body."""
    return trajectory[f"{body}.position"] + trajectory[f"{body}.rotation_matrix"] @ np.array(local)


def world_spin(trajectory: rs.Trajectory, body: str) -> Array:
    """Angular velocity (n, 3) in world axes."""
    w_B = trajectory[f"{body}.angular_velocity"]
    return np.einsum("nij,nj->ni", trajectory[f"{body}.rotation_matrix"], w_B)


@pytest.mark.parametrize(
    "integrator", [rs.Idas(1e-10, 1e-12), rs.Rosenbrock(1e-10, 1e-12), rs.ExplicitRK(1e-10, 1e-12)],
    ids=lambda integrator: type(integrator).__name__,
)  # fmt: skip
def test_mini_closed_form(integrator: Any) -> None:
    trajectory = rs.simulate(rs.compile_scene(published.mini()), 1.0, integrator)
    assert trajectory["body.position"][-1, 1] == pytest.approx(published.MINI_Y, rel=1e-8)


@pytest.mark.parametrize(
    "integrator", [rs.Idas(1e-12, 1e-13), rs.Rosenbrock(1e-11, 1e-13), rs.ExplicitRK(1e-11, 1e-13)],
    ids=lambda integrator: type(integrator).__name__,
)  # fmt: skip
def test_user_force(integrator: Any) -> None:
    model = rs.compile_scene(published.user_force())
    trajectory = rs.simulate(model, [0, *published.USER_FORCE_R], integrator)
    r = point(trajectory, "body", [0.1, 0.1, 0.1])[1:, :2].sum(axis=1)
    assert largest(r - list(published.USER_FORCE_R.values())) < 1e-10


@pytest.mark.parametrize("body_first", [False, True])
def test_intrinsic_displacement_does_not_depend_on_marker_order(body_first: bool) -> None:
    model = rs.compile_scene(published.brick_on_ground(rs.Intrinsic(), body_first))
    times = [0, *published.INTRINSIC_DISPLACEMENT]
    trajectory = rs.simulate(model, times, rs.ExplicitRK(1e-11, 1e-12))
    expected = list(published.INTRINSIC_DISPLACEMENT.values())
    assert largest(trajectory["body.displacement"][1:] - expected) < 1e-9


@pytest.mark.parametrize("body_first", [False, True])
def test_standard_centre_depends_on_marker_order(body_first: bool) -> None:
    """The two orders end 0.03 m apart."""
    model = rs.compile_scene(published.brick_on_ground(rs.Standard(), body_first))
    trajectory = rs.simulate(model, 1.0, rs.ExplicitRK(1e-11, 1e-12))
    assert largest(trajectory["body.position"][-1] - published.STANDARD_CENTRE[body_first]) < 1e-9


@pytest.mark.parametrize(
    "integrator", [rs.ExplicitRK(1e-13, 1e-14), rs.Idas(1e-14, 1e-14)],
    ids=lambda integrator: type(integrator).__name__,
)  # fmt: skip
def test_intrinsic_pair(integrator: Any) -> None:
    """The pair amplifies a start perturbation by up to 4e7, hence the tolerances near epsilon."""
    model = rs.compile_scene(published.brick_pair(rs.Intrinsic()))
    trajectory = rs.simulate(model, [0, 1.0], integrator)
    w = world_spin(trajectory, "left")[-1]
    assert largest(w - published.INTRINSIC_PAIR_SPIN) < 1e-7 * np.linalg.norm(w)
    assert trajectory["energy"] == pytest.approx(np.array([628.054, 622.024]), abs=6e-4)
    moment = np.linalg.norm(trajectory["angular_momentum"], axis=1)
    assert moment[0] < 1e-12  # 20 kg at 1 m, 170 kg m2/s of spin that cancels
    assert moment[1] == pytest.approx(0.1963, abs=6e-5)


def p3(trajectory: rs.Trajectory) -> Array:
    """Start of Bricard's rod 3 (n, 3)."""
    return point(trajectory, "rod3", [-0.5, 0, 0])


def test_bricard() -> None:
    """Undamped modes at 3.5e3 rad/s, so an explicit method is as good as any."""
    model = rs.compile_scene(published.bricard())
    trajectory = rs.simulate(model, np.linspace(0, 0.5, 51), rs.ExplicitRK(1e-9, 1e-10))
    for t, expected in published.BRICARD_P3.items():
        assert largest(p3(trajectory)[round(t / 0.01)] - expected) < 1e-8
    assert largest(trajectory["energy"] - trajectory["energy"][0]) < 4e-8 * WEIGHT
    assert trajectory["energy"][0] == pytest.approx(-WEIGHT, rel=1e-12)


def test_bricard_rosenbrock() -> None:
    model = rs.compile_scene(published.bricard())
    trajectory = rs.simulate(model, [0, 0.1], rs.Rosenbrock(1e-9, 1e-10))
    assert largest(p3(trajectory)[-1] - published.BRICARD_P3[0.1]) < 1e-8


@pytest.mark.parametrize(("k", "before", "at"), [(1e6, 0.35, 0.46), (1e5, 0.50, 0.64)])
def test_bricard_with_hinges_about_local_x_blows_up(k: float, before: float, at: float) -> None:
    """The build warns for every hinge, and rightly: the energy grows a hundredfold."""
    with pytest.warns(rs.ModelWarning, match="soft rotation axis, local x") as caught:
        model = rs.compile_scene(published.bricard(k, k / 100, free="x"))
    assert len(caught) == 6
    trajectory = rs.simulate(model, [0, before, at], rs.ExplicitRK(1e-9, 1e-10))
    change = np.abs(trajectory["energy"] - trajectory["energy"][0]) / WEIGHT
    assert change[1] < 1e-2
    assert change[2] > 100


@pytest.mark.parametrize("at", [1.0, pytest.param(2.0, marks=pytest.mark.slow)])
def test_heavy_top(at: float) -> None:
    """Undamped pivot at 2e4 rad/s: 140,000 explicit steps a second.

    At 2 s the published z is 3e-9 off (a digit: ...5537033, which the oracle and we agree on).
    """
    model = rs.compile_scene(published.heavy_top())
    trajectory = rs.simulate(model, [0, at], rs.ExplicitRK(1e-9, 1e-10))
    assert largest(trajectory["top.position"][-1] - published.HEAVY_TOP_CENTRE[at]) < 1e-7


def governor() -> rs.Model:
    """The flyball governor; its shaft-rod hinges turn about local y, which warns."""
    with pytest.warns(rs.ModelWarning, match="soft rotation axis, local y") as caught:
        model = rs.compile_scene(published.governor())
    assert len(caught) == 2
    return model


def test_governor_stiffest_mode() -> None:
    model = governor()
    start = [label.start for label in model.x_labels]
    modes = np.linalg.eigvals(np.array(model.function("dode_dx")(0, start, [], [], [])))
    assert np.abs(modes).max() == pytest.approx(published.GOVERNOR_STIFFEST, rel=5e-4)


@pytest.mark.parametrize(
    "integrator", [rs.ExplicitRK(1e-9, 1e-10), rs.Rosenbrock(1e-9, 1e-10)],
    ids=lambda integrator: type(integrator).__name__,
)  # fmt: skip
def test_governor_start(integrator: Any) -> None:
    trajectory = rs.simulate(governor(), [0, 0.001, 0.1], integrator)
    for i, t in ((1, 0.001), (2, 0.1)):
        assert abs(trajectory["rod_0.v_y"][i] - published.GOVERNOR_SPEED[t]) < 1e-8
    assert abs(trajectory["slider.position"][2, 2] - published.GOVERNOR_HEIGHT[0.1]) < 1e-8


def test_governor() -> None:
    trajectory = rs.simulate(governor(), [0, 1.0], rs.ExplicitRK(1e-9, 1e-10))
    assert abs(trajectory["rod_0.v_y"][-1] - published.GOVERNOR_SPEED[1.0]) < 1e-6
    assert abs(trajectory["slider.position"][-1, 2] - published.GOVERNOR_HEIGHT[1.0]) < 1e-6


@pytest.mark.parametrize("e", published.TUMBLING_HALF_PERIOD)
def test_tumbling_about_the_intermediate_axis(e: float) -> None:
    """Half a period mirrors the spin; the error grows as 1/e on the way.

    w_z keeps its sign: |H|^2 - 2 T I_2 = 3 w_z^2 - w_x^2 = 2 e^2 > 0 never lets it be zero. (The
    published end state has -e there.)
    """
    trajectory = rs.simulate(
        rs.compile_scene(published.tumbling(e)), [0, published.TUMBLING_HALF_PERIOD[e]],
        rs.ExplicitRK(1e-13, 1e-14),
    )  # fmt: skip
    assert largest(trajectory["body.angular_velocity"][-1] - [-e, -1, e]) < 1e-12 / e
