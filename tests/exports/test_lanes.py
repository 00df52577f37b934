"""Kernels of several instances at once: every operation, any number of instances, any compiler."""

from __future__ import annotations

import ctypes
import subprocess
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.compilers import C99, COMPILERS

import rbsd_sym as rs
from rbsd_sym.exports.folder import template
from rbsd_sym.exports.lanes import functions_text, has_lanes, kernel_text

EPS = np.finfo(float).eps
WAYS = [(c, flag) for c in COMPILERS for flag in ("-O2", "-O0", "-DLANES_SCALAR")]
pytestmark = pytest.mark.skipif(not COMPILERS, reason="no C compiler")


def every_operation() -> ca.Function:
    """All operations of one and of two numbers, a in (0, 1), b of either sign, c = -1, 0 or 1."""
    t, w, k = ca.SX.sym("t"), ca.SX.sym("w", 3), ca.SX.sym("k")
    a, b, c = ca.vertsplit(w)
    found = [
        a + b, a - b, a * b, a / b, -b, b**2, 2 * b, 1 / b, ca.sqrt(a), ca.sin(b), ca.cos(b),
        ca.tan(b), ca.asin(a), ca.acos(a), ca.atan(b), ca.sinh(b), ca.cosh(b), ca.tanh(b),
        ca.asinh(b), ca.acosh(1 + a), ca.atanh(a), ca.exp(b), ca.log(a), ca.log1p(a), ca.expm1(b),
        ca.fabs(b), ca.floor(b), ca.ceil(b), ca.erf(b), ca.sign(c), ca.sign(b), ca.atan2(b, c),
        a**b, a**3.7, ca.fmin(a, b), ca.fmax(a, b), ca.fmod(b, a), ca.copysign(a, b),
        ca.hypot(a, b), ca.remainder(b, a), a < b, a <= b, ca.eq(c, 0), ca.ne(c, 0),
        ca.logic_and(a < b, c), ca.logic_or(a < b, c), ca.logic_not(c), ca.if_else(a < b, k, t),
        ca.if_else(c, 1 / c, b), ca.SX(0.1), ca.SX(np.inf), ca.SX(-np.inf), ca.SX(np.nan),
    ]  # fmt: skip
    return ca.Function("every", [t, w, k], [ca.vertcat(*found)])


def library(compiler: str, flags: list[str], text: str, folder: Path) -> Any:
    (folder / "kernel.c").write_text(text)
    command = [compiler, *C99, "-fPIC", "-shared", *flags, "kernel.c", "-lm", "-o", "kernel.so"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert built.stderr == ""
    return ctypes.CDLL(str(folder / "kernel.so"))


@pytest.mark.parametrize(("compiler", "flag"), WAYS)
def test_every_operation_is_that_of_casadi(compiler: str, flag: str, tmp_path: Path) -> None:
    function = every_operation()
    codes = {function.instruction_id(i) for i in range(function.n_instructions())}
    assert len(codes) > 44
    n = function.nnz_out(0)
    text = "\n".join([
        "#include <math.h>", template("lanes.c", {}), functions_text([function]),
        kernel_text(function, "kernel"),
        "void run(double t, const double *x, const double *c, double *y);",
        "void run(double t, const double *x, const double *c, double *y)", "{",
        f"  lanes w[3], k[1], time = LANES_ALL(t), out[{n}];",
        "  for (int l = 0; l < LANES; ++l) {",
        "    for (int j = 0; j < 3; ++j) LANE(w[j], l) = x[3 * l + j];",
        "    LANE(k[0], l) = c[l];", "  }",
        "  kernel(&time, w, k, out);",
        f"  for (int l = 0; l < LANES; ++l) for (int j = 0; j < {n}; ++j)",
        f"    y[{n} * l + j] = LANE(out[j], l);", "}", "",
    ])  # fmt: skip
    run = library(compiler, [flag], text, tmp_path).run
    rng = np.random.default_rng(0)
    lanes = 1 if "SCALAR" in flag else 4
    for signs in ([-1, 0, 1, 0], [0, 1, 0, -1], [1, -1, -1, 1]):
        x = np.column_stack([rng.random(4), rng.normal(size=4), signs])
        c, y = rng.normal(size=4), np.zeros((4, n))
        run(ctypes.c_double(0.7), *(ctypes.c_void_p(v.ctypes.data) for v in (x, c, y)))
        exact = np.array(function(0.7, x.T, c[None, :])).T
        np.testing.assert_allclose(y[:lanes], exact[:lanes], rtol=8 * EPS, atol=0)


def test_operations_that_have_lanes() -> None:
    t, w, k = (ca.SX.sym(name) for name in "twk")
    table = ca.interpolant("table", "linear", [[0, 1]], [0, 1])
    for odd in (ca.erfinv(w), table(w)):
        assert not has_lanes(ca.Function("odd", [t, w, k], [ca.sin(w) + odd]))
    assert has_lanes(every_operation())


def links(count: int) -> rs.Scene:
    """A hanging chain of so many links."""
    bodies = [rs.RigidBody(f"b{i}", 1 + i, (1, 1.1, 1.2), position=(i, 0, 0)) for i in range(count)]
    ends = [rs.Marker(rs.GROUND), *(rs.Marker(b.name, (0.4, 0, 0)) for b in bodies)]
    joints = [
        rs.RigidBodySpringDamper(f"j{i}", ends[i], rs.Marker(body.name, (-0.4, 0, 0)),
                                 [900 + i] * 3 + [5, 6, 7], [3] * 3 + [0.1] * 3)
        for i, body in enumerate(bodies)
    ]  # fmt: skip
    return rs.Scene("links", bodies, joints, gravity=(0, 0.3, -9.81))


@pytest.mark.parametrize("count", range(1, 7))
def test_any_number_of_instances(count: int, tmp_path: Path) -> None:
    """Also those that do not fill all lanes; with multipliers and directions, too."""
    model = rs.compile_scene(links(count), layout="kernels", minimal=False)
    flat = rs.compile_scene(links(count), layout="flat", minimal=False)
    names = ["ode", "dode_dx", "ode_forward", "ode_adjoint"]
    rs.export_c(model, tmp_path, names)
    found = rs.load_c(tmp_path, flags=("-O1",))
    rng = np.random.default_rng(count)
    x = np.array([label.start for label in model.x_labels]) + 0.1 * rng.normal(size=model.n_x)
    for name in names:
        more = [rng.normal(size=model.function(name).size1_in(5))] if "_" in name[3:] and (
            name != "dode_dx") else []  # fmt: skip
        given = (0.0, x, [], [], [], *more)
        exact = np.array(flat.function(name)(*given))
        scale = np.abs(exact).max()
        assert np.abs(np.array(found.function(name)(*given)) - exact).max() < 50 * EPS * scale, name
