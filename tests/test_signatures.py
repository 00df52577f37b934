"""Public functions take what they have in common under one name, in one order."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import rbsd_sym as rs

GIVEN = ("inputs", "params", "start")
"""Values by name, in their order; only ever by keyword."""


def public_functions() -> dict[str, Callable]:
    """Functions of the public names, and calls of what they return."""
    homes = {"rs": rs, "rs.study": rs.study, "rs.plots": rs.plots, "rs.ocp": rs.ocp}
    found = {
        f"{home}.{name}": getattr(module, name)
        for home, module in homes.items()
        for name in module.__all__
        if inspect.isfunction(getattr(module, name))
    }
    return found | {"Simulator.__call__": rs.Simulator.__call__}


FUNCTIONS = public_functions()
TAKING = {k: f for k, f in FUNCTIONS.items() if set(GIVEN) & set(inspect.signature(f).parameters)}


def test_there_is_something_to_check() -> None:
    expected = {"rs.simulate", "rs.sensitivity", "rs.linearize", "rs.static_equilibrium",
                "rs.floquet", "rs.study.work_precision", "rs.study.recommend",
                "rs.study.stability_map", "Simulator.__call__"}  # fmt: skip
    assert expected <= set(TAKING)


@pytest.mark.parametrize("name", TAKING)
def test_values_by_name_are_keywords_in_one_order(name: str) -> None:
    parameters = inspect.signature(TAKING[name]).parameters
    there = [key for key in parameters if key in GIVEN]
    assert there == [key for key in GIVEN if key in parameters], name
    for key in there:
        assert parameters[key].kind is inspect.Parameter.KEYWORD_ONLY, f"{name}: {key}"
        assert parameters[key].default is None, f"{name}: {key}"
    keywords = [k for k, p in parameters.items() if p.kind is inspect.Parameter.KEYWORD_ONLY]
    assert keywords[: len(there)] == there, f"{name}: they come first among the keywords"


@pytest.mark.parametrize("name", [k for k, f in FUNCTIONS.items()
                                  if k != "rs.export_simulator"
                                  and "integrator" in inspect.signature(f).parameters])  # fmt: skip
def test_the_integrator_is_the_last_argument_by_position(name: str) -> None:
    parameters = inspect.signature(FUNCTIONS[name]).parameters
    by_position = [k for k, p in parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
    assert by_position[-1] == "integrator"
    assert parameters["integrator"].default is None


@pytest.mark.parametrize("name", FUNCTIONS)
def test_subjects_come_first_and_hints_are_whole(name: str) -> None:
    function = FUNCTIONS[name]
    parameters = inspect.signature(function).parameters
    hints = function.__annotations__
    for key in parameters:
        assert key == "self" or key in hints, f"{name}: {key}"
    if "model" in parameters and not name.startswith(("rs.load", "rs.ocp.load")):
        assert next(iter(parameters)) == "model", name


def test_inputs_are_typed() -> None:
    assert "Inputs" in rs.simulate.__annotations__["inputs"]
    assert (Path(rs.__file__).parent / "py.typed").is_file()


def oscillator() -> rs.Model:
    """A body that swings along x about 0.1 m; k is a Param."""
    k = rs.Param("k", 40.0, "N/m")
    body = rs.RigidBody("b", 1.0, (0.1, 0.1, 0.1))
    spring = rs.RigidBodySpringDamper(
        "s", rs.Marker(rs.GROUND), rs.Marker("b"), [k, 0, 0, 0, 0, 0], [2.0] + [0] * 5,
        offset=(0.1, 0, 0, 0, 0, 0),
    )  # fmt: skip
    return rs.compile_scene(rs.Scene("oscillator", [body], [spring]))


def test_a_rest_is_a_start_and_a_place_to_linearise_at() -> None:
    model = oscillator()
    rest = rs.static_equilibrium(model)
    run = rs.simulate(model, 1.0, start=rest)
    assert np.abs(run["b.p_x"] - 0.1).max() < 1e-12
    assert rs.simulate(model, 1.0, start=rest.point)["b.p_x"][-1] == run["b.p_x"][-1]
    assert rs.linearize(model, rest).A[1].tolist() == [-40.0, -2.0]
    assert rs.linearize(model, rest, params={"k": 90.0}).A[1].tolist() == [-90.0, -2.0]
    gradient = rs.sensitivity(model, [0.0, 0.5], ["k"], ["b.p_x"], start=rest)
    assert np.abs(gradient["b.p_x"]).max() < 1e-9, "at rest the stiffness does not matter"


@pytest.mark.parametrize("call", [
    lambda scene: rs.simulate(scene, 1.0),
    lambda scene: rs.sensitivity(scene, 1.0, ["k"], ["b.p_x"]),
    rs.linearize,
    rs.static_equilibrium,
    lambda scene: rs.floquet(scene, 1.0),
    lambda scene: rs.export_c(scene, "never"),
    lambda scene: rs.export_simulator(scene, "never", rs.Dop853()),
    rs.compiled,
    rs.study.recommend,
    lambda scene: rs.study.work_precision(scene, [rs.Idas()]),
    lambda scene: rs.study.domain(scene, None),
])  # fmt: skip
def test_a_scene_is_not_a_model(call: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: E501
    monkeypatch.chdir(tmp_path)
    with pytest.raises(TypeError, match=r"\w+: model is a Scene; give a model, such as compile_sc"):
        call(oscillator().scene)
    assert not list(tmp_path.iterdir())


def test_a_marker_takes_a_body_or_its_name() -> None:
    body = rs.RigidBody("b", 1.0, (0.1, 0.1, 0.1))
    assert rs.Marker(body, (1, 0, 0)).body == rs.Marker("b").body == "b"
    with pytest.raises(TypeError, match=r"body 3; give a body, its name, or rbsd_sym\.GR"):
        rs.Marker(3)  # type: ignore[arg-type]


@pytest.mark.parametrize(("given", "message"), [
    ({"integrator": "dop853"}, r"integrator 'dop853'; give an object, such as Idas\(\)"),
    ({"integrator": rs.Dop853}, r"integrator Dop853; give an object, such as Idas\(\)"),
    ({"start": 0.3}, r"start: float; give values of states by name"),
    ({"start": [0.3, 0.0]}, r"start: list; give values of states by name"),
    ({"params": [40.0]}, r"parameters: list; give values by name"),
    ({"inputs": 3.0}, r"inputs: float; give values by name"),
])  # fmt: skip
def test_wrong_kinds_are_named(given: dict, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        rs.simulate(oscillator(), 1.0, **given)


def test_a_point_of_another_model_is_refused() -> None:
    other = rs.RigidBody("other", 1.0, (0.1, 0.1, 0.1))
    k = rs.Param("k", 40.0)
    spring = rs.RigidBodySpringDamper(
        "s", rs.Marker(rs.GROUND), rs.Marker("other"), [k, 0, 0, 0, 0, 0],
        offset=(0.1, 0, 0, 0, 0, 0),
    )  # fmt: skip
    stranger = rs.compile_scene(rs.Scene("stranger", [other], [spring]))
    assert (stranger.n_x, stranger.n_p) == (oscillator().n_x, oscillator().n_p)
    with pytest.raises(ValueError, match=r"states other\.p_x, other\.v_x is of another model"):
        rs.simulate(oscillator(), 1.0, start=rs.static_equilibrium(stranger))
    with pytest.raises(ValueError, match="of another model"):
        rs.linearize(oscillator(), rs.locate(stranger))


def test_reprs_are_short() -> None:
    model = oscillator()
    run = rs.simulate(model, [0, 0.1])
    rest = rs.static_equilibrium(model)
    table = rs.study.Table(("a",), ("m",), ((1.0,),))
    shown = [model, model.dae, run, rest, rs.linearize(model, rest), table]
    scene = model.scene
    assert isinstance(scene, rs.Scene)
    shown += [scene, *scene.bodies, *scene.connectors]
    assert all(len(repr(one)) < 100 for one in shown)
    assert repr(model) == "<Model 'oscillator': 2 states, 0 algebraic, 0 inputs, 1 parameters>"


def test_trajectories_and_tables_become_data_frames() -> None:
    pytest.importorskip("pandas")
    run = rs.simulate(oscillator(), [0, 0.1, 0.2])
    assert list(run) == ["b.p_x", "b.v_x"]
    frame = run.to_pandas(["b.p_x", "b.position", "k"])
    assert list(frame.columns) == ["b.p_x", "b.position_x", "b.position_y", "b.position_z", "k"]
    assert frame.index.tolist() == [0, 0.1, 0.2]
    assert (frame["b.position_x"] == run["b.position"][:, 0]).all()
    assert list(run) == ["b.p_x", "b.v_x", "b.position"]
    table = rs.study.Table(("a", "b"), ("m", ""), ((1.0, "x"), (2.0, "y")))
    assert table.to_pandas()["a"].tolist() == [1.0, 2.0]


def test_without_pandas_there_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pandas", None)
    with pytest.raises(ImportError, match="pandas is not installed; run pip install pandas"):
        rs.simulate(oscillator(), [0, 0.1]).to_pandas()
