"""C of models with tables and called Functions: equal numbers, or a refusal by name."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.comparing import by_name, close, points
from helpers.compilers import COMPILERS
from helpers.refusals import refused
from scenes.calls import CALLBACK, CASES, T_END, Damper, Doubled, S, pair, shock

import rbsd_sym as rs

needs_compiler = pytest.mark.skipif(not COMPILERS, reason="no C compiler")
both_layouts = pytest.mark.parametrize("layout", ["flat", "kernels"])
IN_C = [name for name in CASES if name != "Callback"]


def check(model: rs.Model, folder: Path) -> None:
    """The functions in C beside those in Python."""
    connector = model.dae.parts[-1].name
    names = ["ode", "dode_dx", "ode_adjoint", f"{connector}.force_local"]
    library = rs.load_c(rs.export_c(model, folder, names), flags=["-O0"])
    machine = rs.compiled(model, flags=["-O0"])
    for point in points(model):
        for function in names:
            more = [np.arange(model.n_x)] if function == "ode_adjoint" else []
            ours = model.function(function)(*point, *more)
            close(library.function(function)(*point, *more), ours, 1e-13)
        close(machine.function("ode")(*point), model.function("ode")(*point), 1e-13)


@needs_compiler
@both_layouts
@pytest.mark.parametrize("name", IN_C)
def test_exported_functions(name: str, layout: str, tmp_path: Path) -> None:
    check(rs.compile_scene(shock(CASES[name][0]), layout=layout, minimal=False), tmp_path)


@needs_compiler
@pytest.mark.parametrize("name", ["table", "MX never inlined"])
def test_several_instances(name: str, tmp_path: Path) -> None:
    check(pair(CASES[name][0], 3, layout="kernels", minimal=False), tmp_path)


@needs_compiler
@both_layouts
@pytest.mark.parametrize("method", [rs.Dop853(), rs.Rosenbrock(), rs.ExplicitRK()], ids=by_name)
def test_exported_simulators(method: Any, layout: str, tmp_path: Path) -> None:
    for name in ("table of two", "MX never inlined"):
        model = rs.compile_scene(shock(CASES[name][0]), layout=layout)
        rs.export_simulator(model, tmp_path / name[:3], method)
        run = rs.load_simulator(tmp_path / name[:3], model)(T_END)
        ours = rs.simulate(model, [0, T_END], rs.ExplicitRK(1e-10, 1e-12))
        close(run["body.p_z"][-1], ours["body.p_z"][-1], 1e-6)


@needs_compiler
def test_operations_without_lanes_are_left_to_casadi(tmp_path: Path) -> None:
    """A kernel with a call is no loop over lanes, others of the model are."""
    model = pair(CASES["table"][0], 3, layout="kernels", minimal=False)
    plain = pair(lambda u, v: 300 * v, 3, layout="kernels", minimal=False)
    for which, loops in ((model, False), (plain, True)):
        rs.export_c(which, tmp_path / str(loops), ["ode"])
        assert ("lanes" in (tmp_path / str(loops) / "pair.c").read_text()) is loops


# Refusals.


def _rootfinder() -> ca.Function:
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    return ca.rootfinder("solved", "newton", {"x": x, "p": p, "g": x**3 + x - p})


WITHOUT_C: dict[str, Damper] = {
    "doubled": lambda u, v: CALLBACK(v),
    "solved": lambda u, v: _rootfinder()(0, v),
    "erfinv": lambda u, v: ca.erfinv(v.expr / 9),
}


@both_layouts
@pytest.mark.parametrize("name", WITHOUT_C)
def test_what_has_no_c_is_refused(name: str, layout: str, tmp_path: Path) -> None:
    """In Python it runs; every export names the connector and the Function, and writes nothing."""
    model = pair(WITHOUT_C[name], layout=layout)
    assert rs.simulate(model, 0.1).outcome.ok
    for export in (
        lambda: rs.export_c(model, tmp_path / "c"),
        lambda: rs.export_simulator(model, tmp_path / "s", rs.Dop853()),
        lambda: rs.export_simulator(model, tmp_path / "r", rs.Rosenbrock()),
        lambda: rs.compiled(model),
    ):
        refused(ValueError, export, "model 'pair', j0: ", f"no C code of {name}", "interpolant")
    assert not list(tmp_path.iterdir())


def test_what_has_no_derivatives_is_refused() -> None:
    callback = Doubled("rough", {})
    refused(ValueError, lambda: rs.compile_scene(shock(lambda u, v: callback(v))),
            "connector 'strut', force: ", "no derivatives of rough", "enable_fd")  # fmt: skip


@needs_compiler
def test_a_function_of_another_library_is_refused(tmp_path: Path) -> None:
    """It runs in Python; C that calls it would not stand on its own."""
    far, code = ca.Function("far", [S], [70 * S]), ca.CodeGenerator("far.c")
    for function in (far, far.forward(1), far.reverse(1)):
        code.add(function)
    (tmp_path / "far.c").write_text(code.dump())
    command = [COMPILERS[0], "-shared", "-fPIC", "far.c", "-lm", "-o", "far.so"]
    subprocess.run(command, cwd=tmp_path, check=True)
    outside = ca.external("far", str(tmp_path / "far.so"))
    model = rs.compile_scene(shock(lambda u, v: outside(v)))
    assert rs.simulate(model, 0.1).outcome.ok
    target = tmp_path / "c"
    refused(ValueError, lambda: rs.export_c(model, target), "model 'shock', strut: ", "code of far")
