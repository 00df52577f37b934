"""Wrong input: the error's type, the place it names, and the words of what, rule and remedy."""

from __future__ import annotations

import contextlib
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.refusals import ARM, INF, NAN, body, compiled, joint, load, refused, scene, table
from hypothesis import given, settings
from hypothesis import strategies as st

import rbsd_sym as rs


def with_force(force: Any) -> rs.Model:
    """A model with a user force."""
    return compiled(connectors=[joint(force=force)])


SHEAR = np.eye(6) + np.eye(6, k=1)
FINITE = ("numbers are finite", "check where it came from")


@table([
    (ValueError, lambda: body(position=[0, 0]), "body 'arm', position: ", "(2,)", "(3,)"),
    (ValueError, lambda: body(com=None), "body 'arm', com: ", "None", "(3,)"),
    (ValueError, lambda: body(mass=[1.0]), "body 'arm', mass: ", "(1,)"),
    (ValueError, lambda: body(position=[0, NAN, 0]), "body 'arm', position: ", "nan m", *FINITE),
    (ValueError, lambda: body(velocity=[INF, 0, 0]), "body 'arm', velocity: ", "inf m/s", *FINITE),
    (ValueError, lambda: body(mass=NAN), "body 'arm', mass: ", "nan kg", *FINITE),
    (TypeError, lambda: body(com=["a", 0, 0]), "body 'arm', com: ", "'a' is str", "float"),
    (TypeError, lambda: body(position=[1j, 0, 0]), "body 'arm', position: ", "complex", "float"),
    (ValueError, lambda: body(rotation=np.eye(2)), "body 'arm', rotation: ", "(2, 2)", "(3, 3)"),
    (ValueError, lambda: body(rotation=np.diag([1, 1, 1.1])), "body 'arm', rotation: ",
     "differs from the identity by 0.21", "orthonormal", "normalise"),
    (ValueError, lambda: body(rotation=np.diag([1, 1, -1])), "body 'arm', rotation: ",
     "determinant -1", "reflection", "check the axes"),
    (ValueError, lambda: body(rotation=[0, 0, 0, 0]), "body 'arm', rotation: ", "norm 0",
     "needs norm 1", "divide"),
    (ValueError, lambda: body(rotation=[2, 0, 0, 0]), "body 'arm', rotation: ", "norm 2",
     "needs norm 1", "divide"),
    (ValueError, lambda: body(mass=-1), "body 'arm': ", "mass -1.0 kg", "positive"),
    (ValueError, lambda: body(mass=0), "body 'arm': ", "mass 0 kg with inertia", "give a mass"),
    (ValueError, lambda: compiled(bodies=[body(mass=rs.Param("m", 0.0), inertia=0)]),
     "body 'arm': ", "Param of default 0 kg", "write mass=0"),
    (ValueError, lambda: compiled(bodies=[body(inertia=[[1, 1, 0], [1, 1, 0], [0, 0, 2]])]),
     "body 'arm': ", "no axis of the body frame", "along the rod"),
    (ValueError, lambda: compiled(bodies=[body(mass=0, inertia=0)], connectors=[],
                                  loads=[rs.Load("push", rs.Marker("arm"), force=(0, 2.5, 0))]),
     "model 'bench': arm.y: ", "2.5 N", "nothing resists", "hold it by stiffness"),
    (ValueError, lambda: body(inertia=[1, 1, 3]), "body 'arm': ", "1 + 1 < 3 kg m2",
     "triangle inequality", "no rigid body", "check axes and units"),
    (ValueError, lambda: body(inertia=[[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]), "body 'arm': ",
     "unsymmetric by 0.1 kg m2", "symmetric", "check the products of inertia"),
    (ValueError, lambda: body(inertia=[-1, 1, 1]), "body 'arm': ", "principal value -1 kg m2",
     "positive", "check signs and units"),
    (ValueError, lambda: body(inertia=1.0), "body 'arm': ", "()", "3x3"),
    (ValueError, lambda: body(mass=rs.Param("m", -1.0)), "body 'arm': ", "mass -1.0 kg"),
    (ValueError, lambda: body(mass=rs.Input("m", value=1.0)), "body 'arm', mass: ", "'m'",
     "varies in time", "use a Param"),
    (ValueError, lambda: body(position=[rs.TIME, 0, 0]), "body 'arm', position: ", "'t'",
     "varies in time", "use a Param"),
    (ValueError, lambda: body(name=rs.GROUND), "body 'ground': ", "taken", "choose another"),
    (TypeError, lambda: rs.Marker(7), "marker: ", "7", "a body, its name", "GROUND"),
    (ValueError, lambda: rs.Marker("arm", [1, 2]), "marker on 'arm', position: ", "(2,)", "(3,)"),
    (ValueError, lambda: rs.Marker("arm", rotation=np.ones((3, 3))), "marker on 'arm', rotation: ",
     "orthonormal"),
])  # fmt: skip
def test_bodies_and_markers(row: tuple[Any, ...]) -> None:
    refused(*row)


@table([
    (ValueError, lambda: joint(stiffness=[1] * 5), "connector 'joint', stiffness: ", "(5,)", "6x6",
     "translation comes first"),
    (ValueError, lambda: joint(stiffness=3.0), "connector 'joint', stiffness: ", "()", "6x6"),
    (ValueError, lambda: joint(damping=[NAN] * 6), "connector 'joint', damping: ", "nan", *FINITE),
    (ValueError, lambda: joint(offset=[1, 2]), "connector 'joint', offset: ", "(2,)", "(6,)"),
    (ValueError, lambda: joint(velocity_offset=[INF] * 6), "connector 'joint', velocity_offset: ",
     "inf", *FINITE),
    (ValueError, lambda: joint(rotation_marker0=np.diag([1, -1, 1])),
     "connector 'joint', rotation_marker0: ", "reflection"),
    (ValueError, lambda: joint(rotation_marker1=[1, 1, 0, 0]),
     "connector 'joint', rotation_marker1: ", "norm 1.41421"),
    (ValueError, lambda: joint(stiffness=SHEAR, law=rs.Consistent()),
     "connector 'joint', stiffness: ", "(1, 0) is 0.0", "(0, 1) is 1.0", "symmetric",
     "(K + K')/2", "another law"),
    (TypeError, lambda: joint(law=rs.Consistent), "connector 'joint': ", "<class", "Consistent()"),
    (TypeError, lambda: joint(law="standard"), "connector 'joint': ", "'standard'", "Consistent()"),
    (TypeError, lambda: joint(marker0="arm"), "connector 'joint': ", "marker0 is 'arm'", "Marker"),
    (TypeError, lambda: joint(force=3), "connector 'joint': ", "force 3", "function"),
    (TypeError, lambda: joint(post_newton_step=3), "connector 'joint': ", "post_newton_step 3",
     "function"),
    (ValueError, lambda: joint(data=1.0), "connector 'joint', data: ", "1.0", "list"),
    (TypeError, lambda: load(marker="arm"), "load 'push': ", "'arm'", "a Marker"),
    (ValueError, lambda: load(frame="local"), "load 'push': ", "'local'", "'world' or 'body'"),
    (ValueError, lambda: load(force=[1.0]), "load 'push', force: ", "(1,)", "(3,)"),
    (ValueError, lambda: load(torque=[0, NAN, 0]), "load 'push', torque: ", "nan N m", *FINITE),
])  # fmt: skip
def test_connectors_and_loads(row: tuple[Any, ...]) -> None:
    refused(*row)


def stiff(*params: rs.Param) -> rs.Scene:
    """A scene with Params in its stiffness."""
    return scene(connectors=[joint(stiffness=[*params, *[1.0] * (6 - len(params))])])


@table([
    (ValueError, lambda: scene(connectors=[joint(marker1=rs.Marker("amr"))]),
     "connector 'joint', marker1: ", "no body 'amr'", "bodies are: arm, ground"),
    (ValueError, lambda: scene(loads=[load(marker=rs.Marker("amr"))]), "load 'push': ",
     "no body 'amr'", "bodies are: arm, ground"),
    (ValueError, lambda: scene(bodies=[body(), body()]), "scene 'bench': ", "'arm' in bodies",
     "unique", "rename"),
    (ValueError, lambda: scene(connectors=[joint(name="arm")]), "scene 'bench': ",
     "'arm' in connectors and bodies", "unique", "rename"),
    (ValueError, lambda: scene(bodies=[], connectors=[]), "scene 'bench': ", "no bodies",
     "at least one RigidBody"),
    (ValueError, lambda: scene(gravity=9.81), "scene 'bench', gravity: ", "()", "(3,)"),
    (ValueError, lambda: compiled(outputs=["arm.positon"]), "scene 'bench', outputs: ",
     "no output 'arm.positon'", "arm.position"),
    (ValueError, lambda: stiff(rs.Param("k", 1.0), rs.Param("k", 1.0)), "scene 'bench': ",
     "called 'k'", "use it in every place"),
    (ValueError, lambda: stiff(rs.Param("t", 1.0)), "scene 'bench': ", "called 't'", "is the time"),
    (ValueError, lambda: rs.Param("k", NAN), "param 'k': ", "nan", "finite number"),
    (ValueError, lambda: rs.Param("k", None), "param 'k': ", "None", "give a float"),
    (ValueError, lambda: rs.Input("pull", value=INF), "input 'pull': ", "inf", "finite number"),
])  # fmt: skip
def test_scenes(row: tuple[Any, ...]) -> None:
    refused(*row)


@pytest.mark.parametrize(("name", "rule"), [
    ("", "identifier"), ("1st", "identifier"), ("a b", "identifier"), ("arm-1", "identifier"),
    ("ä", "identifier"), (None, "identifier"), (7, "identifier"), ("for", "reserved"),
    ("double", "reserved"), ("jac", "reserved"), ("null", "reserved"), ("a__b", "single"),
    ("_a", "single"), ("a_", "single"), ("x" * 64, "63 characters"),
])  # fmt: skip
@pytest.mark.parametrize(("where", "make"), [
    ("body", body), ("connector", joint), ("load", load), ("scene", scene), ("input", rs.Input),
    ("param", lambda name: rs.Param(name, 1.0)),
])  # fmt: skip
def test_names(where: str, make: Callable[..., Any], name: Any, rule: str) -> None:
    words = (f"{where}: ", f"name {name!r}", rule, "choose another")
    refused(ValueError, lambda: make(name=name), *words)


@table([
    (ValueError, lambda: with_force(lambda *a: [0] * 5), "connector 'joint', force: ", "5 numbers",
     "returns 6"),
    (ValueError, lambda: with_force(lambda *a: None), "connector 'joint', force: ", "returns 6"),
    (ValueError, lambda: with_force(lambda *a: [NAN] * 6), "connector 'joint', force: ", "entry 0",
     "finite"),
    (TypeError, lambda: with_force(lambda *a: ["a"] * 6), "connector 'joint', force: ", "'a'",
     "return numbers"),
    (TypeError, lambda: with_force(lambda m, t, i, d, *a: [1 if d[0] > 0 else 0] * 6),
     "connector 'joint', force: ", "no truth value", "if", "rbsd_sym.where"),
    (TypeError, lambda: with_force(lambda m, t, i, d, *a: [0 if d[0] == 0 else 1] * 6),
     "connector 'joint', force: ", "no truth value", "if", "rbsd_sym.where"),
    (TypeError, lambda: with_force(lambda m, t, i, d, *a: [max(d[0], 0)] * 6),
     "connector 'joint', force: ", "no truth value", "max", "rbsd_sym.where"),
    (TypeError, lambda: with_force(lambda m, t, i, d, *a: [math.sin(d[0])] * 6),
     "connector 'joint', force: ", "not a number", "np.sin", "math"),
    (ValueError, lambda: with_force(lambda *a: [ca.SX.sym("q")] * 6), "connector 'joint', force: ",
     "q", "Params, Inputs"),
])  # fmt: skip
def test_user_functions(row: tuple[Any, ...]) -> None:
    refused(*row)


def test_wrong_kinds_of_thing() -> None:
    with pytest.raises(TypeError, match=r"^scene 'bench', bodies: .* each entry is a RigidBody"):
        scene(bodies=[3.0])
    with pytest.raises(TypeError, match=r"^connector 'joint', force: .* 1 positional argument"):
        with_force(lambda displacement: [0] * 6)


@pytest.fixture(scope="module")
def model() -> rs.Model:
    """A model with the input `pull` and the parameter `k`."""
    pull = load(force=[rs.Input("pull", "N"), 0, 0])
    return compiled(connectors=[joint(stiffness=[rs.Param("k", 10.0, "N/m")] * 6)], loads=[pull])


@pytest.mark.parametrize("times", [0, -1.0, NAN, INF, None, "1", [0], [0, 0], [0, 2, 1], [0, NAN],
                                   [[0, 1]]], ids=str)  # fmt: skip
def test_times(model: rs.Model, times: Any) -> None:
    rule = "give a positive, finite end time" if isinstance(times, (int, float)) else "increase"
    refused(ValueError, lambda: rs.simulate(model, times), "simulate: ", rule)


WHERE = "model 'bench'"


@pytest.mark.parametrize(("options", "words"), [
    ({"inputs": {"pul": 1}}, (f"{WHERE}: ", "no input 'pul'", "there are: pull")),
    ({"params": {"kk": 1}}, (f"{WHERE}: ", "no parameter 'kk'", "there are: k")),
    ({"start": {"arm.px": 1}}, (f"{WHERE}: ", "no state 'arm.px'", "arm.p_x")),
    ({"params": {"k": NAN}}, (f"{WHERE}, parameter 'k': ", "nan N/m", "finite")),
    ({"params": {"k": "1"}}, (f"{WHERE}, parameter 'k': ", "'1' N/m", "finite")),
    ({"start": {"arm.p_x": INF}}, (f"{WHERE}, state 'arm.p_x': ", "inf m", "finite")),
    ({"inputs": {"pull": NAN}}, (f"{WHERE}, input 'pull': ", "nan N", "finite")),
    ({"inputs": {"pull": None}}, (f"{WHERE}, input 'pull': ", "None", "samples (times, values)")),
    ({"inputs": {"pull": [1, 2, 3]}}, (f"{WHERE}, input 'pull': ", "[1, 2, 3]", "samples")),
    ({"inputs": {"pull": ([0, 1], [1, 2, 3])}}, (f"{WHERE}, input 'pull': ", "(2,) and (3,)",
                                                 "one length")),
    ({"inputs": {"pull": ([[0, 1]], [[1, 2]])}}, (f"{WHERE}, input 'pull': ", "(1, 2)", "length")),
    ({"inputs": {"pull": ([0], [1])}}, (f"{WHERE}, input 'pull': ", "at least 2")),
    ({"inputs": {"pull": ([1, 0], [1, 2])}}, (f"{WHERE}, input 'pull': ", "give increasing times")),
    ({"inputs": {"pull": ([0, 1], [NAN, 1])}}, (f"{WHERE}, input 'pull': ", "finite values")),
], ids=lambda value: next(iter(value.values())) if isinstance(value, dict) else "")  # fmt: skip
def test_experiments(model: rs.Model, options: dict[str, Any], words: tuple[str, ...]) -> None:
    refused(ValueError, lambda: rs.simulate(model, 1.0, **options), *words)


def test_unknown_outputs(model: rs.Model) -> None:
    trajectory = rs.simulate(model, 0.1)
    for call in (lambda: trajectory["arm.positon"], lambda: model.function("arm.positon")):
        refused(ValueError, call, WHERE, "no output 'arm.positon'", "arm.position, ")
    assert "arm.positon" not in trajectory


@pytest.mark.parametrize("integrator", [rs.Idas, rs.Rosenbrock, rs.ExplicitRK])
@pytest.mark.parametrize("option", ["rtol", "atol"])
@pytest.mark.parametrize("value", [-1e-6, 0, NAN, INF, "1e-6", None], ids=str)
def test_tolerances(integrator: Any, option: str, value: Any) -> None:
    words = (f"{integrator.__name__}: ", f"{option} {value!r}", "number in 0 ...")
    refused(ValueError, lambda: integrator(**{option: value}), *words)


IDAS = [("max_order", 0), ("max_order", 6), ("safety", 0.0), ("safety", NAN)]


@pytest.mark.parametrize(("option", "value"), IDAS)
def test_idas_options(option: str, value: Any) -> None:
    refused(ValueError, lambda: rs.Idas(**{option: value}), "Idas: ", f"{option} {value}")


@pytest.fixture
def exported(model: rs.Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A generated folder, with a cache of its own."""
    monkeypatch.setenv("RBSD_SYM_CACHE", str(tmp_path / "cache"))
    return rs.export_c(model, tmp_path / "bench").folder


@pytest.mark.parametrize("inside", ["", "sub"])
def test_export_where_a_file_is_in_the_way(model: rs.Model, tmp_path: Path, inside: str) -> None:
    (tmp_path / "taken").write_text("mine")
    folder = tmp_path / "taken" / inside
    refused(ValueError, lambda: rs.export_c(model, folder), f"{folder}: ", "folder")
    assert (tmp_path / "taken").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["taken"]


def test_export_spares_a_foreign_file(model: rs.Model, tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("mine")
    refused(ValueError, lambda: rs.export_c(model, tmp_path), f"{tmp_path}: ", "README.md",
            "did not write", "choose another folder")
    assert (tmp_path / "README.md").read_text() == "mine"
    assert [path.name for path in tmp_path.iterdir()] == ["README.md"]


def test_export_of_what_cannot_be_named(model: rs.Model, tmp_path: Path) -> None:
    twins, new = compiled(bodies=[body(), body(name="ARM")]), tmp_path / "new"
    refused(ValueError, lambda: rs.export_c(model, new, functions=["arm.positon"]), WHERE,
            "no output 'arm.positon'")
    refused(ValueError, lambda: rs.export_c(twins, new), WHERE, "'arm.p_x'", "'ARM.p_x'",
            "capitals", "rename")
    assert not new.exists()


@pytest.mark.parametrize("variable", ["", "icc"])
def test_no_compiler(exported: Path, monkeypatch: pytest.MonkeyPatch, variable: str) -> None:
    monkeypatch.setenv("PATH", str(exported))
    monkeypatch.setenv("CC", variable)
    words = ("no C compiler found", variable or "cc, gcc, clang", "works without")
    refused(rs.CompilerMissing, lambda: rs.load_c(exported), *words)
    with pytest.raises(rs.CompilerMissing, match=r"^[^\n]+$"):
        rs.load_c(exported)


def manifest_of(folder: Path, **changes: Any) -> None:
    """Change entries of the manifest."""
    text = (folder / "manifest.json").read_text()
    (folder / "manifest.json").write_text(json.dumps(json.loads(text) | changes))


@pytest.mark.parametrize(("spoil", "words"), [
    (lambda f: (f / "bench.c").write_text((f / "bench.c").read_text() + "/* mine */\n"),
     ("bench.c is not the file", "hash differs")),
    (lambda f: (f / "bench.h").unlink(), ("bench.h is missing",)),
    (lambda f: manifest_of(f, abi=999), ("ABI 999", "this version has")),
    (lambda f: (f / "manifest.json").unlink(), ("no readable manifest.json",)),
    (lambda f: (f / "manifest.json").write_text("{"), ("no readable manifest.json",)),
], ids=["edited", "missing", "abi", "no manifest", "damaged"])  # fmt: skip
def test_load_refuses(exported: Path, spoil: Any, words: tuple[str, ...]) -> None:
    spoil(exported)
    refused(ValueError, lambda: rs.load_c(exported), f"{exported}: ", *words, "again")


def test_load_refuses_another_model(exported: Path) -> None:
    other = compiled(gravity=[0, 0, -9.81])
    refused(ValueError, lambda: rs.load_c(exported, other), f"{exported}: ", "does not match",
            other.digest, "export_c(model, folder)")


def test_library_without_the_function(exported: Path) -> None:
    library = rs.load_c(exported)
    refused(ValueError, lambda: library.function("arm.position"), "library of 'bench': ",
            "no function 'arm.position'", "it has ode", "export_c(functions=")


MAKERS: list[tuple[Callable[..., Any], str]] = [
    (body, "name mass inertia com position rotation velocity angular_velocity"),
    (lambda **changes: rs.Marker(**({"body": "arm"} | changes)), "body position rotation"),
    (joint, "name marker0 marker1 stiffness damping offset velocity_offset rotation_marker0 "
            "rotation_marker1 law force post_newton_step data"),
    (load, "name marker force torque frame"),
    (scene, "name bodies connectors loads gravity outputs"),
    (lambda **changes: rs.Param(**({"name": "k", "value": 1.0} | changes)), "name value"),
    (lambda **changes: rs.Input(**({"name": "pull"} | changes)), "name value"),
]  # fmt: skip
FIELDS = [(make, field) for make, fields in MAKERS for field in fields.split()]
floats = st.floats(allow_nan=True, allow_infinity=True) | st.floats(-2, 2)
entries = (st.none() | st.booleans() | st.integers() | floats | st.text(max_size=4)
           | st.complex_numbers() | st.binary(max_size=3) | st.sampled_from([rs.TIME, ARM, rs]))
nested = st.recursive(entries, lambda inner: st.lists(inner, max_size=6)
                      | st.dictionaries(st.text(max_size=2), inner, max_size=2), max_leaves=10)
shaped = st.sampled_from([3, 4, 6]).flatmap(lambda n: st.lists(floats, min_size=n, max_size=n))
square = st.sampled_from([3, 6]).flatmap(lambda n: st.lists(
    st.lists(floats, min_size=n, max_size=n), min_size=n, max_size=n))


@pytest.mark.parametrize(("make", "field"), FIELDS)
@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(value=nested | shaped | square)
def test_garbage_is_refused_or_taken(make: Callable[..., Any], field: str, value: Any) -> None:
    """Nothing but ValueError and TypeError, and no numpy warning, ever leaves a constructor."""
    with contextlib.suppress(ValueError, TypeError):
        make(**{field: value})
