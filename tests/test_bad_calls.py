"""Slips in calls and damaged files: each ends in one error that says what to do."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rbsd_sym as rs

BODY = rs.RigidBody("b", 1, (1, 1, 1))


def pushed() -> rs.Model:
    """A free body with a force input."""
    push = rs.Input("push", "N")
    load = rs.Load("load", rs.Marker("b"), force=(push, 0, 0))
    return rs.compile_scene(rs.Scene("pushed", [BODY], [], [load]))


def raises_later(t: float) -> float:
    """Branches on t, so it is called with numbers; no value after half a second."""
    if t > 0.5:
        raise KeyError("no data")
    return 1.0


INTEGRATORS = [rs.Idas(), rs.Rosenbrock(), rs.ExplicitRK()]


@pytest.mark.parametrize("integrator", INTEGRATORS, ids=lambda i: type(i).__name__)
def test_exception_in_an_input_function_reaches_the_user(integrator: Any) -> None:
    with pytest.raises(ValueError, match=r"input function 'raises_later'.*no data") as caught:
        rs.simulate(pushed(), 1.0, integrator, inputs={"push": raises_later})
    assert isinstance(caught.value.__cause__, KeyError)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rs.Idas(max_step=-1), "max_step -1"),
        (lambda: rs.Idas(max_steps=0), "max_steps 0.*whole number"),
        (lambda: rs.Idas(first_step=0), "first_step 0"),
        (lambda: rs.Idas(safety=-1), "safety -1"),
        (lambda: rs.Idas(max_order=6), "max_order 6.*1 ... 5"),
        (lambda: rs.Rosenbrock(max_step=float("nan")), "max_step nan"),
        (lambda: rs.ExplicitRK(max_steps=2.5), "max_steps 2.5"),
        (lambda: rs.simulate(pushed(), 1.0, rs.Idas(linear_solver="foo")), "refuses the options"),
    ],
)
def test_integrator_options(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: rs.simulate(pushed(), 1.0, rs.Idas), r"give an object, such as Idas\(\)"),
        (lambda: rs.Input("a", 1.0), "unit 1.0.*order"),
        (lambda: rs.Scene("s", BODY, []), "bodies: RigidBody; give a list"),
        (lambda: rs.Scene("s", [1], []), "holds a int; each entry is a RigidBody"),
        (lambda: rs.Scene("s", [BODY], [], outputs="energy"), "outputs: str; give a list"),
        (lambda: rs.where("x", 1, 2), "where: 'x' is not a number"),
    ],
)
def test_wrong_types(make: Callable[[], Any], words: str) -> None:
    with pytest.raises(TypeError, match=words):
        make()


@pytest.mark.parametrize("unit", ["*/ int x; /*", "a\nb", "|", "m" * 33, "N\\"])
def test_units_cannot_leave_a_c_comment(unit: str) -> None:
    with pytest.raises(ValueError, match="printed into C comments"):
        rs.Param("k", 1.0, unit)


def test_symbol_may_not_hide_an_output() -> None:
    body = rs.RigidBody("b", rs.Param("energy", 10.0), (1, 1, 1))
    with pytest.raises(ValueError, match="'energy' is a symbol, but also an output"):
        rs.Scene("s", [body], [])


def test_rounding_does_not_make_a_stiffness_unsymmetric() -> None:
    K = np.diag([600.0] * 6)
    K[0, 1], K[1, 0] = 0.01, 0.01 + 1.5e-14
    ends = rs.Marker(rs.GROUND), rs.Marker("b")
    rs.RigidBodySpringDamper("c", *ends, K, law=rs.Consistent())
    K[1, 0] = 0.01 + 1e-8
    with pytest.raises(ValueError, match="symmetric"):
        rs.RigidBodySpringDamper("c", *ends, K, law=rs.Consistent())


@pytest.mark.parametrize("keep", [0, 200, 1000])
def test_truncated_trajectory_files(keep: int, tmp_path: Path) -> None:
    path = rs.simulate(pushed(), 1.0).save(tmp_path / "run")
    damaged = tmp_path / "damaged.npz"
    damaged.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match="not a trajectory of rbsd_sym"):
        rs.Trajectory.load(damaged)


def test_damaged_manifest(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").write_text(json.dumps({"rbsd_sym": "0"}))
    with pytest.raises(ValueError, match="not of rbsd_sym"):
        rs.load_c(tmp_path)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="no gcc")
def test_compiler_of_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    artefact = rs.export_c(pushed(), tmp_path / "pushed")
    monkeypatch.setenv("CC", "gcc -m64")
    assert os.path.exists(rs.load_c(artefact).path)
    monkeypatch.setenv("CC", "no_such_compiler")
    with pytest.raises(rs.CompilerMissing, match=r"no C compiler found \(no_such_compiler\)"):
        rs.load_c(artefact)


def test_failure_between_outputs_says_after() -> None:
    def grow(mbs: Any, t: Any, i: Any, u: Any, *rest: Any) -> list[Any]:
        return [-2 * u[0] ** 3, 0, 0, 0, 0, 0]  # x'' = 2 x^3 from 1, 1: x = 1 / (1 - t)

    body = rs.RigidBody("b", 1, (1, 1, 1), position=(1, 0, 0), velocity=(1, 0, 0))
    spring = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), 0, force=grow)
    model = rs.compile_scene(rs.Scene("pole", [body], [spring]))
    known = rs.simulate(model, [0, 0.5, 2], rs.Idas(), throw=False)
    assert known.stats["t_failed"] == pytest.approx(1.0, abs=1e-3)
    unknown = rs.simulate(model, [0, 0.5, 2], rs.ExplicitRK(max_steps=2000), throw=False)
    assert "after t = 0.5 s" in unknown.report
    np.testing.assert_allclose(unknown["b.position"][-1, 0], 2.0, rtol=1e-6)


def test_an_input_function_gives_numbers_not_symbols() -> None:
    strength = rs.Param("strength", 2.0)
    with pytest.raises(ValueError, match="uses the symbol strength; it must return a number"):
        rs.simulate(pushed(), 1.0, inputs={"push": lambda t: strength * t})


def test_an_input_function_that_changes_its_mind_is_asked_again() -> None:
    strength = [1.0]
    model = pushed()
    push = lambda t: strength[0] + 0 * t  # noqa: E731
    first = rs.simulate(model, 1.0, inputs={"push": push})["b.position"][-1, 0]
    strength[0] = 2.0
    second = rs.simulate(model, 1.0, inputs={"push": push})["b.position"][-1, 0]
    assert first == pytest.approx(0.5, rel=1e-9)
    assert second == pytest.approx(1.0, rel=1e-9)
