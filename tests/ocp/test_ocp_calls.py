"""Optimal control of a model with tables and called Functions: the same optimum by every way."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from helpers.refusals import refused
from scenes.calls import CASES, MASS, START, STIFFNESS

import rbsd_sym as rs
from rbsd_sym.ocp import Collocation, Free, Phase, Problem, Shooting, export_problem, optimise


def problem(name: str, layout: str = "flat") -> Problem:
    """Bring the body on its spring and damper to rest elsewhere, with little force."""
    pull = rs.Input("pull", "N")

    def force(mbs: Any, t: Any, item: Any, u: Any, r: Any, v: Any, *rest: Any) -> list[Any]:
        return [0, 0, STIFFNESS * u[2] + CASES[name][0](u[2], v[2]), 0, 0, 0]

    body = rs.RigidBody("body", MASS, (1, 1.2, 1.4), position=(0, 0, START))
    ends = rs.Marker(rs.GROUND), rs.Marker("body")
    joint = rs.RigidBodySpringDamper("strut", *ends, force=force)
    load = rs.Load("push", rs.Marker("body"), force=(0, 0, pull))
    model = rs.compile_scene(rs.Scene("shock", [body], [joint], [load]), layout=layout)
    phase = Phase(0.3, integral=lambda v: 1e-6 * v["pull"] ** 2,
                  end={"body.p_z": 0.02, "body.v_z": 0.0})  # fmt: skip
    return Problem(model, [phase], inputs={"pull": Free()})


@pytest.mark.parametrize("name", ["spline", "spline of two", "never inlined", "Callback"])
def test_optimum(name: str) -> None:
    """Collocation in both layouts, and shooting, on 20 intervals."""
    one = optimise(problem(name), Collocation(20, 3)).cost
    assert optimise(problem(name, "kernels"), Collocation(20, 3)).cost == pytest.approx(one)
    assert optimise(problem(name), Shooting(20, 2)).cost == pytest.approx(one, rel=1e-3)


@pytest.mark.parametrize(("name", "words"), [
    ("Callback", ["model 'shock', strut: ", "no C code of doubled"]),
    ("table of two", ["model 'shock', hessian: ", "second derivatives of plane", "bspline"]),
])  # fmt: skip
def test_refusals(name: str, words: list[str], tmp_path: Path) -> None:
    folder = tmp_path / "c"
    refused(ValueError, lambda: export_problem(problem(name), Collocation(4, 2), folder), *words)
    assert not folder.exists()
