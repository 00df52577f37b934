"""`recommend` on scenes where the right family of methods is known, with large margins."""

from __future__ import annotations

import math
import re
import warnings
from functools import cache
from typing import Any

import numpy as np
import pytest
from scenes import massless, reference, speed

import rbsd_sym as rs
from rbsd_sym.model.values import make_experiment
from rbsd_sym.study.pilot import modes

EXPLICIT = (rs.Dop853, rs.ExplicitRK, rs.RK4)


@cache
def single() -> rs.Model:
    return rs.compile_scene(reference.build("single"))


@cache
def stiff() -> rs.Model:
    return rs.compile_scene(speed.stiff(1e6).scene)


@cache
def ringing() -> rs.Model:
    """A slow mode of 1 rad/s along x, an undamped one of 1e4 rad/s along y with next to nothing."""
    body = rs.RigidBody("body", 1, (1, 1, 1), position=(1, 1e-12, 0))
    spring = rs.RigidBodySpringDamper(
        "spring", rs.Marker(rs.GROUND), rs.Marker("body"), (1, 1e8, 0, 0, 0, 0)
    )
    return rs.compile_scene(rs.Scene("ringing", [body], [spring]))


def steps_of(table: rs.study.Table, method: str) -> float:
    rows = [row for row in table.rows if row[0] == method and row[2] is not None]
    return min(float(row[table.columns.index("steps")]) for row in rows)


def reached(pick: rs.study.Recommendation, rtol: float) -> bool:
    """Whether the table holds a run of what is recommended with such an error."""
    errors = pick.table.column("error")
    return bool((errors[np.isfinite(errors)] <= rtol).any())


@pytest.mark.parametrize("exported", [False, True])
def test_what_is_recommended_reaches_the_error(exported: bool) -> None:
    """Against the final state in extended precision; its error has another metric: 3 has room."""
    pick = rs.study.recommend(single(), 1e-6, 2.0, exported=exported, seconds=1.5)
    assert reached(pick, 1e-6)
    trajectory = rs.simulate(single(), 2.0, pick.integrator)
    assert reference.error("single", trajectory) < 3e-6
    if exported:
        assert isinstance(pick.integrator, (rs.Dop853, rs.ExplicitRK))  # Rosenbrock: 4 times
        assert set(pick.table.column("method")) == {"Dop853", "ExplicitRK", "Rosenbrock"}


def test_tighter_errors_cost_more_and_are_reached() -> None:
    loose, tight = (rs.study.recommend(single(), rtol, 2.0, seconds=1.5) for rtol in (1e-3, 1e-9))
    assert reached(loose, 1e-3)
    assert reached(tight, 1e-9)
    error = reference.error("single", rs.simulate(single(), 2.0, tight.integrator))
    assert error < 3e-9


def test_stiff_connectors_leave_out_explicit_methods() -> None:
    pick = rs.study.recommend(stiff(), 1e-6, 1.0, seconds=1.5)
    assert not isinstance(pick.integrator, EXPLICIT)
    found = re.search(r"Fastest mode (\S+) 1/s.* order 4 take (\S+) steps", pick.why)
    assert found
    J = np.array(stiff().function("dode_dx")(0, [v.start for v in stiff().x_labels], [], [], []))
    fastest = np.abs(np.linalg.eigvals(J)).max()
    assert float(found[1]) == pytest.approx(fastest, rel=0.02)  # or faster later
    assert float(found[2]) == pytest.approx(fastest / 2.8, rel=0.05)
    assert "leaves out ExplicitRK, Dop853, RK4" in pick.why
    assert str(pick) == pick.why


def test_undamped_fast_mode_tells_against_bdf_of_high_order() -> None:
    """Published: 80 times the steps; the fast mode is far below the error wanted."""
    pick = rs.study.recommend(ringing(), 1e-6, 10.0, seconds=1.5)
    assert not isinstance(pick.integrator, EXPLICIT)
    assert getattr(pick.integrator, "max_order", 2) == 2
    assert "A mode of 1e+04 rad/s is hardly damped" in pick.why
    rows = [row for row in pick.table.rows if row[0] == "Idas"]
    steps = [row[4] for row in rows if row[2] is not None]
    assert not steps or min(steps) > 10 * steps_of(pick.table, "Idas, order 2")


def test_events_and_algebraic_unknowns_get_methods_that_have_them() -> None:
    block = rs.RigidBody("block", 1, (1, 1, 1), velocity=(3, 0, 0))
    ends = rs.Marker(rs.GROUND), rs.Marker("block")
    rub = rs.RigidBodySpringDamper("floor", *ends, (50, 0, 0, 0, 0, 0),
                                   effects=[rs.Friction(0, 1, 0.3)])  # fmt: skip
    dry = rs.compile_scene(rs.Scene("dry", [block], [rub]))
    pick = rs.study.recommend(dry, 1e-5, 2.0, seconds=1.5)
    assert "kinds of events leave out" in pick.why
    found = rs.simulate(dry, 2.0, pick.integrator)
    exact = rs.simulate(dry, 2.0, rs.Idas(1e-11, 1e-13))
    assert len(found.events) == len(exact.events) > 2
    assert np.abs(found["block.p_x"] - exact["block.p_x"]).max() < 3e-5 * 0.8  # its excursion
    scene = massless.linked(0.0, massless.UNDAMPED)
    pick = rs.study.recommend(rs.compile_scene(scene), 1e-6, 0.5, seconds=1.5)
    assert not isinstance(pick.integrator, EXPLICIT)
    assert "algebraic unknowns leave out explicit methods" in pick.why


def test_inputs_params_and_start_are_heard() -> None:
    """A load by an input that makes the motion: without it there would be nothing to judge by."""
    pull = rs.Input("pull", "N")
    k = rs.Param("k", 1.0, "N/m")
    body = rs.RigidBody("body", 1, (1, 1, 1))
    spring = rs.RigidBodySpringDamper("spring", rs.Marker(rs.GROUND), rs.Marker("body"),
                                      [k, 0, 0, 0, 0, 0])  # fmt: skip
    load = rs.Load("load", rs.Marker("body"), force=(pull, 0, 0))
    model = rs.compile_scene(rs.Scene("driven", [body], [spring], [load]))
    wave = lambda t: 5 * np.sin(3 * t)  # noqa: E731
    pick = rs.study.recommend(model, 1e-5, 2.0, seconds=2, inputs={"pull": wave},
                              params={"k": 400.0}, start={"body.p_x": 0.1})  # fmt: skip
    assert "Fastest mode 20 1/s" in pick.why
    assert reached(pick, 1e-5)


def test_modes_of_a_known_system() -> None:
    """1 and 1e4 rad/s, undamped; with unknowns they are those of the reduced motion."""
    trajectory = rs.simulate(ringing(), [0.0, 0.1])
    found = modes(ringing(), trajectory, make_experiment(ringing(), 0.1))
    assert found.fastest == pytest.approx(1e4, rel=1e-9)
    assert abs(found.damping) < 1e-9
    assert found.ringing == pytest.approx(1e4, rel=1e-9)
    damped = rs.simulate(stiff(), [0.0, 1e-3])
    found = modes(stiff(), damped, make_experiment(stiff(), 1e-3))
    assert found.damping == pytest.approx(1, abs=0.01)
    a, b = rs.RigidBody("a", 0, 0), rs.RigidBody("b", 2.0, (1, 1, 1), velocity=(1, 0, 0))
    joints = [
        rs.RigidBodySpringDamper(f"c{i}", rs.Marker(one), rs.Marker(other), [k] + [500] * 5)
        for i, (one, other, k) in enumerate(((rs.GROUND, "a", 300.0), ("a", "b", 200.0)))
    ]
    series = rs.compile_scene(rs.Scene("series", [a, b], joints))
    path = rs.simulate(series, [0.0, 0.1])
    w = math.sqrt(300 * 200 / 500 / 2.0)
    assert series.n_z == 1
    assert modes(series, path, make_experiment(series, 0.1)).fastest == pytest.approx(w, rel=1e-9)


@pytest.mark.parametrize(("options", "message"), [
    ({"rtol": 0}, "rtol 0; it is a number above 0 and below 0.1"),
    ({"rtol": 0.5}, "rtol 0.5; it is"), ({"rtol": "tight"}, "rtol 'tight'; it is"),
    ({"rtol": 1e-12}, "below 1e-10 no pilot run can resolve"), ({"t_end": -1}, "t_end -1 s; it is"),
    ({"t_end": math.nan}, "t_end nan s; it is"), ({"seconds": 0}, "seconds 0 s; it is"),
    ({"params": {"k": 1.0}}, "no parameter 'k'"),
])  # fmt: skip
def test_bad_requests(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        rs.study.recommend(single(), **options)


def test_what_cannot_be_recommended_is_said() -> None:
    with pytest.raises(TypeError, match="model is a Scene; give a model, such as compile_scene"):
        rs.study.recommend(reference.build("single"))  # type: ignore[arg-type]
    still = rs.Scene("still", [rs.RigidBody("body", 1, (1, 1, 1))], [])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rs.ModelWarning)
        nothing = rs.compile_scene(still)
    with pytest.raises(ValueError, match="no states, so there is nothing to integrate"):
        rs.study.recommend(nothing)

    def hook(mbs: Any, t: Any, item: Any, data: Any, displacement: Any, *rest: Any) -> Any:
        return [0.0, -1.0, data[0]]

    body = rs.RigidBody("body", 1, (1, 1, 1), position=(1, 0, 0))
    ends = rs.Marker(rs.GROUND), rs.Marker("body")
    spring = rs.RigidBodySpringDamper("spring", *ends, [9, 0, 0, 0, 0, 0], data=[0.0],
                                      post_newton_step=hook)  # fmt: skip
    model = rs.compile_scene(rs.Scene("hooked", [body], [spring]))
    with pytest.raises(ValueError, match="no integrator for it can be exported"):
        rs.study.recommend(model, 1e-3, 1.0, exported=True, seconds=0.5)
    pick = rs.study.recommend(model, 1e-3, 1.0, seconds=0.5)
    assert set(pick.table.column("method")) <= {"Idas", "Idas, order 2", "GeneralizedAlpha"}
