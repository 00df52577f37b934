"""Work-precision studies: errors, failures as rows, orders of the fixed-step methods, the chart."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paths import MODELS

import rbsd_sym as rs
from rbsd_sym import __main__ as command_line


@cache
def tumbling() -> rs.Model:
    """A body that turns and swings on a soft connector."""
    body = rs.RigidBody("body", 1, (0.1, 0.2, 0.3), angular_velocity=(1, 2, 3))
    spring = rs.RigidBodySpringDamper(
        "spring", rs.Marker(rs.GROUND), rs.Marker("body", (0.1, 0.2, 0.3)), (100,) * 3 + (5,) * 3,
        (1,) * 6, law=rs.Consistent(),
    )  # fmt: skip
    return rs.compile_scene(rs.Scene("tumbling", [body], [spring]))


@cache
def reference() -> rs.study.Reference:
    return rs.study.converged(tumbling(), 0.5)


def table_of(integrators: Any, **options: Any) -> rs.study.Table:
    return rs.study.work_precision(
        tumbling(), integrators, 0.5, reference=reference(), repeats=1, **options
    )


def test_reference_knows_its_own_error() -> None:
    assert 0 < reference().floor < 1e-10
    assert len(set(reference().names)) == 2


def test_errors_fall_with_the_tolerance() -> None:
    table = table_of({"idas": [rs.Idas(t, 1e-2 * t) for t in (1e-3, 1e-6, 1e-9)]})
    error = table.column("error")
    assert (error[1:] < 0.1 * error[:-1]).all()
    parts = [table.column(f"error_{q}") for q in
             ("position", "angle", "velocity", "angular_velocity")]  # fmt: skip
    np.testing.assert_array_equal(np.max(parts, axis=0), error)
    low, middle, high = (table.column(name) for name in ("time_min", "time", "time_max"))
    assert ((low <= middle) & (middle <= high) & (low > 0)).all()
    assert list(table.column("setting")) == [
        "rtol 0.001, atol 1e-05", "rtol 1e-06, atol 1e-08", "rtol 1e-09, atol 1e-11"
    ]


@pytest.mark.parametrize(
    ("method", "order"),
    [(rs.RK4, 4), (lambda h: rs.Collocation(h, 1), 1), (lambda h: rs.Collocation(h, 2), 3),
     (lambda h: rs.Collocation(h, 1, "legendre"), 2),
     (lambda h: rs.Collocation(h, 2, "legendre"), 4)],
    ids=["rk4", "radau 1", "radau 2", "legendre 1", "legendre 2"],
)  # fmt: skip
def test_orders_of_fixed_steps(method: Any, order: int) -> None:
    error = table_of([method(h) for h in (0.0125, 0.00625, 0.003125)]).column("error")
    assert np.abs(np.log2(error[:-1] / error[1:]) - order).max() < 0.2


def test_a_failure_is_a_row() -> None:
    stiff = rs.RK4(0.25)
    table = table_of([rs.Idas(max_steps=1), stiff])
    assert table.column("outcome")[0] == "too_many_steps"
    assert table.rows[0][table.columns.index("error")] is None


def test_a_function_may_compete() -> None:
    def run() -> rs.Trajectory:
        return rs.simulate(tumbling(), np.linspace(0, 0.5, 21), rs.Dop853())

    (row,) = table_of({"mine": [run]}).rows
    assert row[:2] == ("mine", "run")
    other = {"mine": [lambda: rs.simulate(tumbling(), 0.5)]}
    with pytest.raises(ValueError, match="201 output times, the reference has 21"):
        table_of(other)
    with pytest.raises(ValueError, match="no integrators"):
        table_of([])


def test_contenders_fit_the_model() -> None:
    every = rs.study.contenders(tumbling(), 1.0)
    assert {"Idas", "Dop853", "RK4", "GeneralizedAlpha"} <= set(every)
    block = rs.RigidBody("block", 1, (1, 1, 1))
    held = rs.RigidBodySpringDamper("floor", rs.Marker(rs.GROUND), rs.Marker("block"), 0,
                                    effects=[rs.Friction(0, 1, 0.3)])  # fmt: skip
    dry = rs.study.contenders(rs.compile_scene(rs.Scene("dry", [block], [held])), 1.0)
    assert set(dry) == {"Idas", "Rosenbrock", "GeneralizedAlpha"}


def test_chart_of_a_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mini = str(MODELS / "mini.py")
    arguments = ["chart", mini, "--folder", str(tmp_path), "--repeats", "1", "--t-end", "0.2"]
    assert command_line.main(arguments) == 0
    assert "Rosenbrock" in capsys.readouterr().out
    for suffix in ("png", "md", "csv"):
        assert (tmp_path / "charts" / f"mini.{suffix}").stat().st_size > 500


@pytest.mark.parametrize("call", [
    lambda: rs.RK4(0), lambda: rs.Collocation(-1.0), lambda: rs.Collocation(0.1, 10),
    lambda: rs.Collocation(0.1, 3, "lobatto"),
])  # fmt: skip
def test_bad_steps(call: Any) -> None:
    with pytest.raises(ValueError, match=r"; give "):
        call()
