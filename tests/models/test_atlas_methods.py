"""Six pages of the atlas: explicit and implicit limits, long runs, stiffness, BDF, events.

Each page is measured once in its short form; the full forms are slow tests.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import discontinuities, tumbling
from oracles.dissipation import spectral_radius
from scenes import published

import rbsd_sym as rs
from models.atlas import (
    bdf_order,
    explicit_limit,
    implicit_damping,
    long_runs,
    oscillators,
    stick_slip_zeno,
    stiffness_sweep,
)
from rbsd_sym.plots import precision_chart as precision
from rbsd_sym.plots import style
from rbsd_sym.study import Table

PAGES = {
    "explicit_limit": explicit_limit,
    "implicit_damping": implicit_damping,
    "long_runs": long_runs,
    "stiffness_sweep": stiffness_sweep,
    "bdf_order": bdf_order,
    "stick_slip_zeno": stick_slip_zeno,
}
EPSILON = np.finfo(float).eps


@cache
def tables(name: str) -> dict[str, Table]:
    return PAGES[name].study(False)


def rows(table: Table, **wanted: Any) -> list[dict[str, Any]]:
    """Rows as dictionaries, those with the given cells."""
    found = [dict(zip(table.columns, row, strict=True)) for row in table.rows]
    return [row for row in found if all(row[key] == value for key, value in wanted.items())]


def row(table: Table, **wanted: Any) -> dict[str, Any]:
    (found,) = rows(table, **wanted)
    return found


@pytest.mark.parametrize("name", PAGES)
def test_every_page_is_drawn(name: str, tmp_path: Path) -> None:
    """Warnings are errors here, those of matplotlib too."""
    figure = PAGES[name].draw(tables(name))
    figure.savefig(tmp_path / "page.png")
    assert all(panel.get_xlabel() for panel in figure.axes if panel.has_data())
    assert all(len(table.rows) < 300 for table in tables(name).values())


def test_methods_have_the_colours_of_the_work_precision_charts() -> None:
    assert oscillators.METHODS == precision._METHODS
    for method in oscillators.METHODS:
        place = precision._place(method, [method], 0)
        assert oscillators.style_of(method)["color"] == style.COLOURS[place]


# 5: explicit methods


def test_limit_of_rk4_without_damping_is_2_83_at_every_stiffness() -> None:
    """sqrt(8): |R(iz)|^2 = 1 - z^6/72 + z^8/576."""
    measured = rows(tables("explicit_limit")["boundary"], method="RK4", damping_ratio=0.0)
    assert {r["stiffness"] for r in measured} >= {1e2, 1e12}
    for r in measured:
        assert r["measured_h_w"] == pytest.approx(math.sqrt(8), rel=1e-2)


def stability_polynomial(method: str, z: complex) -> complex:
    """RK4: exp to z^4; the pair: exp to z^5, and 77/51200 z^6 (of its nodes 0, 2/9, 5/16, ...)."""
    if method == "RK4":
        return sum(z**i / math.factorial(i) for i in range(5))
    return sum(z**i / math.factorial(i) for i in range(6)) + 77 / 51200 * z**6


@pytest.mark.parametrize("method", ["RK4", "ExplicitRK"])
def test_explicit_limits_are_those_of_the_stability_polynomial(method: str) -> None:
    """1 % inside nothing grows, 1 % outside something does, at each damping and stiffness."""
    measured = rows(tables("explicit_limit")["boundary"], method=method)
    assert len({r["damping_ratio"] for r in measured}) >= 8
    for r in measured:
        ratio = r["damping_ratio"]
        root = np.emath.sqrt(ratio**2 - 1.0)
        size = [
            max(abs(stability_polynomial(method, scale * r["measured_h_w"] * eigenvalue))
                for eigenvalue in (-ratio + root, -ratio - root))
            for scale in (0.99, 1.01)
        ]  # fmt: skip
        assert size[0] < 1 < size[1], r


def test_the_pair_gains_amplitude_where_rk4_loses_it() -> None:
    """h w = 1.1: 2e-4 a step gained, 1 % lost."""
    table = tables("explicit_limit")["undamped"]
    for method in ("RK4", "ExplicitRK"):
        for r in rows(table, method=method):
            exact = abs(stability_polynomial(method, 1j * r["h_w"]))
            assert r["factor_per_step"] == pytest.approx(exact, rel=1e-8)
            if 0.8 < r["h_w"] < 2.7:
                assert (r["factor_per_step"] > 1) == (method == "ExplicitRK")


@pytest.mark.parametrize(
    ("z", "kept"),
    [(0.2, 0.41294), *(pytest.param(*pair, marks=pytest.mark.slow)
                       for pair in ((0.05, 0.99978), (0.1, 0.98622)))],
)  # fmt: skip
def test_energy_that_rk4_keeps_over_1e6_steps(z: float, kept: float) -> None:
    """Published, and 1 - z^6/72 + z^8/576 a step."""
    run = oscillators.swing(rs.RK4(z), z * np.linspace(0, 1e6, 5))
    energy = float(oscillators.amplitude(run)[-1]) ** 2
    assert energy == pytest.approx(kept, abs=5e-6)
    assert energy == pytest.approx((1 - z**6 / 72 + z**8 / 576) ** 1e6, rel=1e-8)


# 6: implicit methods


def test_amplitude_that_one_implicit_step_keeps() -> None:
    """Against the oracle of generalized-alpha, and the Padé approximants of collocation."""
    table = tables("implicit_damping")["one_step"]
    for r in rows(table):
        z, name, kept = 1j * r["h_w"], r["method"], r["amplitude_kept"]
        if name.startswith("generalized"):
            rho = float(name.split()[2])
            assert kept == pytest.approx(spectral_radius(r["h_w"], rho), abs=1e-7), r
        elif name.startswith("Radau"):
            top = 1 + 2 * z / 5 + z**2 / 20
            assert kept == pytest.approx(
                abs(top / (1 - 3 * z / 5 + 3 * z**2 / 20 - z**3 / 60)), abs=1e-9
            )
        elif name.startswith("Legendre"):
            assert kept == pytest.approx(1, abs=1e-9)


def test_phase_errors_are_of_the_order_of_the_methods() -> None:
    """Trapezoidal: tan(phase/2) = z/2. Legendre, order 6: -z^6/100800, the leading term."""
    table = tables("implicit_damping")["one_step"]
    for r in rows(table, method="generalized-alpha, radius 1 (trapezoidal)"):
        if r["h_w"] > 3:
            continue  # less than two steps a period tell no phase
        exact = 2 * math.atan(r["h_w"] / 2) / r["h_w"] - 1
        assert r["phase_error"] == pytest.approx(exact, abs=1e-9)
    for r in rows(table, method="Legendre, order 6"):
        if 0.1 < r["h_w"] < 0.5:
            assert r["phase_error"] == pytest.approx(-r["h_w"] ** 6 / 100800, rel=0.05)


@pytest.mark.parametrize(
    ("order", "low", "high"), [(3, 0.0, 1.9364), (4, 0.0, 4.7138), (5, 0.711, 9.3915)]
)
def test_bdf_is_unstable_on_the_imaginary_axis(order: int, low: float, high: float) -> None:
    """The published intervals of h w, to their last digit."""
    radius = lambda h: np.abs(implicit_damping.bdf_roots(order, h)).max()  # noqa: E731
    within = np.linspace(max(low * 1.001, 0.05), high * 0.9999, 50)
    assert min(map(radius, within)) > 1
    assert radius(high * 1.0001) < 1
    if low:
        assert radius(low * 0.999) < 1


def test_idas_damps_a_mode_that_should_ring_as_its_tolerance_lets_it() -> None:
    """In 10 periods: 1e-4 at rtol 1e-4, below 1e-8 at 1e-11, with ten times the steps."""
    table = tables("implicit_damping")["many_periods"]
    name = "Idas, order up to 5"
    loose, tight = (row(table, method=name, rtol=rtol) for rtol in (1e-4, 1e-11))
    assert 1e-5 < -loose["amplitude_gained"] < 1e-2
    assert abs(tight["amplitude_gained"]) < 1e-8
    assert tight["steps_per_period"] > 8 * loose["steps_per_period"]
    given = row(table, method="Idas, order up to 5, safety 1.4", rtol=1e-4)
    assert abs(given["amplitude_gained"]) > 3 * abs(loose["amplitude_gained"])


# 7: long runs


@pytest.mark.parametrize("offset", published.TUMBLING_HALF_PERIOD)
def test_published_half_periods(offset: float) -> None:
    """Oracle and page, to rounding; half a period mirrors the spin."""
    inertia, w = (1.0, 2.0, 3.0), (offset, 1.0, offset)
    half = published.TUMBLING_HALF_PERIOD[offset]
    assert tumbling.half_period(inertia, w) == pytest.approx(half, rel=1e-14)
    assert long_runs.half_period(inertia, w) == pytest.approx(half, rel=1e-14)
    mirrored = tumbling.tumbling([half], inertia, w)[0]
    assert mirrored == pytest.approx([-offset, -1, offset], abs=1e-13 / offset)


def test_tumbling_follows_the_elliptic_functions() -> None:
    """Over one and a half periods, at times of no symmetry, by Legendre with short steps."""
    w = (long_runs.OFFSET, 1.0, long_runs.OFFSET)
    times = np.linspace(0, 60, 41)
    run = rs.simulate(long_runs.tumbling(), times, rs.Collocation(0.05, 3, "legendre"))
    exact = tumbling.tumbling(times, (1.0, 2.0, 3.0), w)
    assert np.abs(run["body.angular_velocity"] - exact).max() < 1e-9
    assert np.abs(exact).max() > 0.9
    assert exact[:, 1].min() < -0.9  # it has turned over


def test_who_keeps_the_energy_of_an_oscillator() -> None:
    table = tables("long_runs")["oscillator"]
    final = {r["method"]: r["energy_gained"] for r in rows(table, periods=100.0)}
    steps, h = 3000, 2 * math.pi / 30
    assert final["RK4"] == pytest.approx((1 - h**6 / 72 + h**8 / 576) ** steps - 1, rel=1e-3)
    assert abs(final["GeneralizedAlpha, radius 1"]) < 100 * EPSILON
    assert abs(final["Legendre, order 6"]) < 1000 * 50 * EPSILON
    for method in ("Idas", "Rosenbrock", "ExplicitRK", "Dop853", "Radau, order 5"):
        assert abs(final[method]) > 1e-9, method  # and it grows: ten times the periods,
        early = row(table, method=method, periods=10.0)["energy_gained"]
        assert 5 < final[method] / early < 20, method


def test_who_keeps_what_of_a_tumbling_body() -> None:
    final = {r["method"]: r for r in rows(tables("long_runs")["tumbling"], periods=10.0)}
    legendre, alpha = final["Legendre, order 6"], final["GeneralizedAlpha, radius 1"]
    rk4 = final["RK4"]
    assert abs(legendre["energy_gained"]) < 1e-10
    assert abs(legendre["quaternion_gained"]) < 1e-10
    assert abs(alpha["quaternion_gained"]) < 100 * EPSILON
    assert rk4["quaternion_gained"] < -1e-6
    assert rk4["energy_gained"] < -1e-7
    assert alpha["spin_error"] > 50 * rk4["spin_error"]
    assert final["Dop853"]["spin_error"] < 1e-7


# 8: stiffness


def test_explicit_methods_pay_for_stiffness_with_steps_and_give_up() -> None:
    table = tables("stiffness_sweep")["sweep"]
    soft, stiff = (row(table, method="ExplicitRK", stiffness=k) for k in (1e3, 1e6))
    assert 10 < stiff["steps"] / soft["steps"] < 40  # sqrt(1000) is 32
    assert row(table, method="ExplicitRK", stiffness=1e14)["outcome"] == "too_many_steps"
    assert row(table, method="Dop853", stiffness=1e14)["outcome"] == "too_many_steps"
    blown = row(table, method="RK4", stiffness=1e9)
    assert blown["outcome"] == "not_finite"
    assert row(table, method="RK4", stiffness=1e6)["error"] > 1  # h w = 3.3, success reported


def test_double_precision_ends_idas_and_rosenbrock() -> None:
    table = tables("stiffness_sweep")["sweep"]
    for method in ("Idas", "Idas, max_order 2"):
        assert row(table, method=method, stiffness=1e14)["outcome"] == "step_too_small"
    assert row(table, method="Legendre, order 6", stiffness=1e14)["error"] > 1e-4


def test_generalized_alpha_and_radau_survive_every_stiffness() -> None:
    """Phase error of order 2: 2 turns in steps of 1e-3 s; the same at every stiffness."""
    table = tables("stiffness_sweep")["sweep"]
    for method, bound in (("GeneralizedAlpha, radius 0.9", 5e-5), ("Radau, order 5", 5e-8)):
        for r in rows(table, method=method):
            assert r["outcome"] == "reached_end"
            assert r["error"] < bound, r


# 11: BDF


def test_a_tiny_fast_mode_costs_bdf_of_order_5_eighty_times_the_steps() -> None:
    """Published: 83,763 and 1,033 steps; the exact counts hang on the rounding of the machine."""
    table = tables("bdf_order")["fast_mode"]
    high, low = row(table, max_order=5), row(table, max_order=2)
    assert high["steps"] == pytest.approx(83_763, rel=0.3)
    assert low["steps"] == pytest.approx(1_033, rel=0.1)
    assert low["error_of_slow"] < 1e-3


def test_the_governor_at_loose_tolerance_is_wrong_and_reports_success() -> None:
    table = tables("bdf_order")["governor"]
    wrong = rows(table, method="CVODES, order up to 5", rtol_or_step=1e-3)
    assert {r["outcome"] for r in wrong} == {"reached_end"}
    assert max(r["error_of_speed"] for r in wrong) > 0.5  # of 0.9 m/s
    for method in ("Idas", "Rosenbrock", "GeneralizedAlpha"):
        for r in rows(table, method=method):
            assert r["error_of_speed"] < 1e-3, r


def test_the_governor_is_the_published_one() -> None:
    own = bdf_order.governor()
    start = [label.start for label in own.x_labels]
    modes = np.linalg.eigvals(np.array(own.function("dode_dx")(0, start, [], [], [])))
    assert np.abs(modes).max() == pytest.approx(published.GOVERNOR_STIFFEST, rel=5e-4)
    assert published.GOVERNOR_SPEED[1.0] == bdf_order.SPEED
    assert published.GOVERNOR_HEIGHT[1.0] == bdf_order.HEIGHT


def test_differences_lose_digits_in_proportion_to_the_stiffness() -> None:
    """Forward: half a step times the second derivative, k L sin or cos; eps^(1/2) is 1.5e-8."""
    table = tables("bdf_order")["jacobian"]
    for way, least, most in (("forward", 5e-9, 1e-7), ("central", 5e-12, 1e-9)):
        for r in rows(table, jacobian=way):
            assert least < r["largest_error"] / r["stiffness"] < most, r
    stiffest = max(r["stiffness"] for r in rows(table))
    assert row(table, jacobian="forward", stiffness=stiffest)["largest_error"] > 1e3 * 9.81
    for r in rows(tables("bdf_order")["newton"]):
        exact = row(tables("bdf_order")["newton"], jacobian="exact", stiffness=r["stiffness"])
        assert r["outcome"] == "reached_end"
        assert 0.7 < r["newton_iterations"] / exact["newton_iterations"] < 1.4


# 12: stick-slip and Zeno


def test_the_page_knows_the_closed_form_of_stick_slip() -> None:
    times = np.linspace(0, 10, 201)
    phases = discontinuities.belt_phases(10.0, 1.0, 4.0, 10.0, 0.4, 0.3, 0.5, 0.0, 0.5)
    exact, _ = discontinuities.state_at(phases, times)
    np.testing.assert_allclose(stick_slip_zeno.belt_path(times), exact, rtol=0, atol=1e-12)


def test_regularised_friction_is_wrong_by_its_width_and_events_are_not() -> None:
    table = tables("stick_slip_zeno")["friction"]
    for method, bound in (("Idas", 1e-6), ("Rosenbrock", 1e-7), ("GeneralizedAlpha", 1e-3)):
        sharp = row(table, method=method, width=0.0)
        assert sharp["outcome"] == "reached_end"
        assert sharp["events"] == 5  # slip, stick, slip, stick, slip
        assert sharp["error"] < bound, sharp
    for method in ("Idas", "Rosenbrock", "ExplicitRK"):
        wide, narrow = (row(table, method=method, width=w)["error"] for w in (1e-2, 1e-4))
        assert wide > 0.1
        assert narrow > 1e-3
        assert narrow < wide / 10
    steps = [row(table, method="ExplicitRK", width=w)["steps"] for w in (1e-2, 1e-4)]
    assert steps[1] > 20 * steps[0]


def test_a_ball_that_bounces_without_end_ends_every_run() -> None:
    """Within 1e-6 of the closed form, after at most a few hundred bounces, never beyond it."""
    exact = discontinuities.ball_zeno(1.0, 9.81, 0.5)
    for r in rows(tables("stick_slip_zeno")["endless"]):
        assert r["outcome"] == "endless_events", r
        assert 0 < exact - r["end"] < 1e-6 * exact, r
        assert 20 < r["events"] < 100
    impacts, _ = discontinuities.ball_impacts(45, 1.0, 9.81, 0.5)
    for r in rows(tables("stick_slip_zeno")["bounces"]):
        assert abs(r["time"] - impacts[r["bounce"] - 1]) < 1e-9, r


def test_a_ball_on_a_damped_contact_comes_to_rest() -> None:
    for r in rows(tables("stick_slip_zeno")["rest"]):
        assert r["outcome"] == "reached_end"
        assert r["height"] == pytest.approx(-9.81 / 1e6, abs=1e-9)


# Full forms


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_full_studies_keep_their_shape(name: str) -> None:
    full = PAGES[name].study(True)
    assert list(full) == list(tables(name))
    assert all(len(table.rows) < 300 for table in full.values())
    PAGES[name].draw(full)
