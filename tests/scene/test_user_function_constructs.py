"""Constructs of user functions that are written for numbers: each traces, or says what to write.

What traces is compared with the same function called with numbers.
"""

from __future__ import annotations

import linecache
import math
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rbsd_sym as rs

EPS = float(np.finfo(float).eps)
K = np.diag([4000.0, 5000.0, 7000.0, 250.0, 500.0, 325.0])
K[0, 1] = K[1, 0] = 300.0
D = np.diag([40.0, 50.0, 70.0, 2.0, 5.0, 3.0])
OFFSET = [0.1, -0.2, 0.3, 0.04, 0.05, -0.06]
NAMES = "mbs, t, item, u, r, v, w, k, d, J0, J1, off"


def force(body: str) -> Callable[..., Any]:
    """A user function with the documented arguments and these lines."""
    lines = [f"def force({NAMES}):\n", *(f"    {line}\n" for line in body.split("\n"))]
    space: dict[str, Any] = {"np": np, "math": math, "rs": rs}
    exec(compile("".join(lines), "<user>", "exec"), space)
    linecache.cache["<user>"] = (0, None, lines, "<user>")  # messages quote the line
    return space["force"]


def model_of(function: Callable[..., Any]) -> rs.Model:
    """A free body on that force, all states kept."""
    body = rs.RigidBody("b", 2.0, (0.3, 0.4, 0.5))
    joint = rs.RigidBodySpringDamper(
        "joint", rs.Marker(rs.GROUND), rs.Marker("b"), K, D, OFFSET, force=function
    )
    outputs = ["joint.ForceLocal", "joint.TorqueLocal"]
    return rs.compile_scene(rs.Scene("one", [body], [joint], outputs=outputs), minimal=False)


def arguments(model: rs.Model, t: float, x: np.ndarray) -> list[Any]:
    """What the element's documentation hands over there, as numbers."""
    outputs = ("DisplacementLocal", "Rotation", "VelocityLocal", "AngularVelocityLocal")
    motion = [np.array(model.function(f"joint.{n}")(t, x, [], [], []))[:, 0] for n in outputs]
    return [None, t, 0, *motion, K.copy(), D.copy(), np.eye(3), np.eye(3), np.array(OFFSET)]


TRACES = r"""
return [k[i][i] * u[i] for i in range(3)] + [0] * 3
return [*(np.sign(v) * np.abs(v) ** 1.5), 0, 0, 0]
return [np.sign(u[0]), np.sign(-u[1]), np.sign(0 * u[2]), 0, 0, 0]
return [*np.floor(4 * u), *np.ceil(4 * u)]
return [np.floor(u[0] / 0.3), math.floor(3 * u[1]), math.ceil(3 * u[2]), *np.trunc(4 * v)]
return [*np.clip(u, -0.5, 0.5), *np.clip(100 * r, v, 2 + np.abs(v))]
return [np.clip(k[0][0] * u[0], -900, 900), u.clip(0)[1], *np.zeros(4)]
return [np.interp(u[0], [-1, 0, 0.4, 2], [5, -3, 2, 9]), *np.interp(v, [-1, 1], [0, 10]), 0, 0]
return [np.interp(u[0], [-0.1, 0.1], [1, 2], left=-7, right=7 * v[0]), 0, 0, 0, 0, 0]
return [np.maximum(u[0], 0), np.maximum(0.0, u[1]), np.minimum(u[2], v[2]), *np.fmax(v, r)]
return [*np.where(u > 0, 900 * u, 200 * u), 0, 0, 0]
return [np.where(u[0] > 0, k[0][0], d[0][0]), np.where(t > 0.5, 3.0, 4.0), 0, 0, 0, 0]
return [abs(u[0]), np.abs(v[0]), np.fabs(v[1]), *abs(r)]
return [*(-400 * (np.linalg.norm(u) - 0.3) * u / np.linalg.norm(u)), 0, 0, 0]
x = np.array([*u, *r])\nreturn k @ (x - off) + d @ np.array([*v, *w])
return np.dot(k, np.hstack([u, r]) - off)
f = k[:3, :3] @ u + np.cross(w, v)\nreturn np.concatenate([f, np.zeros(3)])
return [np.sum(u), sum(v), u.sum() + v.mean(), np.dot(u, v), u @ v, np.prod(v)]
return [*(np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]]) @ np.array([u[0], v[1], 1.0])), 0, 0, 0]
return [np.sqrt(u[0] ** 2 + u[1] ** 2), np.hypot(u[0], u[1]), np.arctan2(u[1], u[0]), 0, 0, 0]
return [np.heaviside(u[0], 0.5), *np.heaviside(v, 1.0), np.heaviside(-v[0], 0), 0]
return [*(50 * np.exp(-np.abs(u))), *np.tanh(v / 0.1)]
return [(u[0] > 0) * k[0][0] * u[0], (u[1] > 0) * 1.0, 3 * (v[0] < v[1]), 0, 0, 0]
return [*(np.diag([1.0, 2.0, 3.0]) @ u), *(np.eye(3) @ v)]
return (np.zeros((6, 6)) + k) @ np.concatenate((u, r))
return u.tolist() + list(r)
f = np.hstack((u[::-1], v[1:], r[-1]))\nreturn f
f = [0] * 6\nf[2] = -k[2][2] * u[2]\nreturn f
f = np.zeros(6, dtype=object)\nf[2] = -k[2][2] * u[2]\nf[:2] += u[:2]\nreturn f
f = np.zeros_like(u)\nf[2] = u[2]\nreturn [*f, 0, 0, 0]
u = np.array(u)\nreturn [*np.maximum(-u, 0), *np.sign(np.array([v[0], w[1], 0.0]))]
x = np.asarray(u)\nreturn [*np.where(x > 0.1, x, -x), np.max(x), np.min(x), np.ptp(x)]
return [u[0] % 0.3, v[1] % 1, 7 % u[2], u[0] // 0.3, *np.mod(r, 0.1)][:6]
return [*np.select([u > 0.5, u > 0], [k[0, 0] * u, 2 * u], -1.0), 0, 0, 0]
a, b = u > 0, v > 0\nreturn [*np.logical_and(a, b), *np.logical_or(a, np.logical_not(b))] * 1
return [*((u > 0) & (v > 0)) * 1.0, *(~(u > 0) | (v > 0)) * 2.0]
return [np.any(u > 0) * 3, np.all(v > 0) * 2, *np.rint(3 * u), np.round(5 * v[0])]
return [*(J0.T @ u), *(J1 @ np.outer(u, v) @ w)]
return [np.einsum('i,ij,j', u, k[:3, :3], v), np.trace(np.outer(u, w)), *np.kron(u[:2], v[:2])]
return [np.float64(2.0) * u[0], u[1] * np.float64(3), *(np.array([1.0, 2.0]) * u[0]), 0, 0]
return [np.sin(t), np.cos(3 * t) * u[0], np.sin(2 * np.pi * t), np.deg2rad(u[1]), t, item]
return [np.polyval([3.0, -2.0, 1.0], u[0]), rs.where(u[0] > 0, 1, 2), np.cbrt(v[0]), 0, 0, 0]
return [np.copysign(5.0, v[0]), np.square(u[0]), np.power(u[0], 3), 2 ** u[1], np.exp2(u[1]), 0]
""".strip().splitlines()  # fmt: skip


@pytest.mark.parametrize("body", TRACES)
def test_traces(body: str) -> None:
    function = force(body.replace("\\n", "\n"))
    model, rng = model_of(function), np.random.default_rng(17)
    for _ in range(4):
        t, x = rng.uniform(0, 1), rng.normal(size=13)
        found = np.concatenate([
            np.array(model.function(f"joint.{n}")(t, x, [], [], []))[:, 0]
            for n in ("force_local", "torque_local")
        ])  # fmt: skip
        with warnings.catch_warnings():  # numpy adds and multiplies truth values in its own way
            warnings.simplefilter("ignore", DeprecationWarning)
            expected = np.array(function(*arguments(model, t, x)), float)
        assert np.abs(found - expected).max() <= 64 * EPS * max(1.0, np.abs(expected).max())


IF, MAX, MIN = "rbsd_sym.where(a > b, x, y)", "np.maximum(a, b)", "np.minimum(a, b)"
FILLED = "f = [0] * 6; f[2] = x"
REFUSED = [
    ("if u[0] > 0:\n    return [1.0] * 6\nreturn [0.0] * 6", ["no truth value", IF]),
    ("return [k[0][0] * u[0] if u[0] > 0 else 0.0] + [0.0] * 5", ["no truth value", IF]),
    ("while u[0] > 0:\n    u = u - 1\nreturn [0] * 6", ["no truth value", IF]),
    ("return [max(u[0], 0.0)] + [0.0] * 5", ["no truth value", MAX]),
    ("return [min(u[0], v[0])] + [0.0] * 5", ["no truth value", MIN]),
    ("return [(u[0] > 0 and v[0] > 0) * 1.0] + [0.0] * 5", ["np.logical_and(a, b)"]),
    ("return [(0 < u[0] < 1) * 1.0] + [0.0] * 5", ["no truth value", "np.logical_and(a, b)"]),
    ("return [*sorted(u), 0, 0, 0]", ["no truth value", IF]),
    ("f = np.zeros(6)\nf[2] = u[2]\nreturn f", [FILLED, "np.zeros(6, dtype=object)"]),
    ("f = np.zeros(6)\nf[:3] = u\nreturn f", [FILLED, "np.zeros(6, dtype=object)"]),
    ("f = np.zeros(6)\nf += u[0]\nreturn f", ["Cannot cast", "dtype('float64')"]),
    ("return [math.sin(u[0])] + [0] * 5", ["np.sin(x) for math.sin(x)", "here np.sin for math"]),
    ("return [math.asin(u[0])] + [0] * 5", ["here np.arcsin for math.asin"]),
    ("return [float(u[0])] + [0] * 5", ["x for float(x)"]),
    ("return [int(u[0])] + [0] * 5", ["np.trunc(x) for int(x)"]),
    ("return [round(u[0])] + [0] * 5", ["np.rint(x) for round(x)"]),
    ("return [sum(1 for _ in range(u[0]))] + [0] * 5", ["range(n)", "rbsd_sym.where(i < x, a, b)"]),
    ("return [[1.0, 2.0][u[0]]] + [0] * 5", ["index", "rbsd_sym.where"]),
    ("x = np.array(u, float)\nreturn [*x, 0, 0, 0]", ["np.array(x) for np.array(x, float)"]),
    ("return [*u[u > 0], 0, 0, 0]", ["indices", "np.where"]),
    ("return [np.linalg.norm(u, 1)] + [0] * 5", ["ord 1", "np.sum(np.abs(x))"]),
    ("return [np.where(u > 0)[0]] + [0] * 5", ["np.where(a > b, x, y)"]),
    ("return [*(np.linalg.inv(np.outer(u, v)) @ u), 0, 0, 0]", ["inv", "casadi"]),
    ("return [np.interp(u[0], u, [1, 2, 3])] + [0] * 5", ["is not a number", "write"]),
    ("return [np.interp(u[0], range(2000), range(2000))] + [0] * 5", ["2000 points", "at most"]),
    ("return [u.height] + [0] * 5", ["height", "it is called as (mbs, t, item"]),
]


@pytest.mark.parametrize(("body", "words"), REFUSED, ids=[body for body, _ in REFUSED])
def test_is_refused_with_the_line_that_works(body: str, words: list[str]) -> None:
    with pytest.raises(TypeError) as caught:
        model_of(force(body))
    message = str(caught.value)
    assert caught.type is TypeError
    assert message.startswith("connector 'joint', force: "), message
    for word in words:
        assert word in message, message


def test_the_line_is_quoted() -> None:
    def limited(mbs, t, item, u, r, v, w, k, d, J0, J1, off) -> list[Any]:
        push = np.exp(u[0])
        return [math.exp(push) + 1.0, 0, 0, 0, 0, 0]

    with pytest.raises(TypeError, match=r"line \d+, `return \[math.exp\(push\).*np.exp for math"):
        model_of(limited)


def test_points_of_a_table_and_ties() -> None:
    """At the points themselves, at halves that are rounded, and where signs change."""
    at, values = [-2.0, -1.0, 0.5, 0.5, 3.0], [1.0, -1.0, 4.0, 2.0, 2.5]
    body = (f"return [np.interp(u[0], {at}, {values}), np.rint(u[0]), np.sign(u[0]), "
            "np.heaviside(u[0], 0.25), np.maximum(u[0], 0), np.floor(u[0])]")  # fmt: skip
    model = model_of(force(body))
    for x0 in (*at, -7.0, 9.0, 0.0, 1.5, 2.5, -0.5, -2.5):
        x = np.array([x0, 0, 0, 1, *[0.0] * 9])
        found = np.array(model.function("out")(0, x, [], [], []))[:, 0]
        expected = [np.interp(x0, at, values), np.rint(x0), np.sign(x0), np.heaviside(x0, 0.25),
                    max(x0, 0), math.floor(x0)]  # fmt: skip
        if x0 == 0.5:  # a jump: either side is right
            assert found[0] in (4.0, 2.0)
            expected[0] = found[0]
        assert np.array_equal(found, expected), x0


def test_a_norm_at_rest_has_finite_derivatives() -> None:
    model = model_of(force("return [100 * np.linalg.norm(u), *(u * np.linalg.norm(u)), 0, 0]"))
    x = np.array([0, 0, 0, 1, *[0.0] * 9])
    assert np.isfinite(np.array(model.function("dode_dx")(0, x, [], [], []))).all()
    assert np.array_equal(np.array(model.function("out")(0, x, [], [], [])), np.zeros((6, 1)))


def test_numpy_is_left_as_it_was() -> None:
    """While a function is traced np.array keeps symbols; afterwards it is numpy's own again."""
    before = np.array, np.asarray
    for body in ("return [*np.array(u), 0, 0, 0]", "return [*np.sort(np.array(u)), 0, 0, 0]"):
        try:
            model_of(force(body))
        except TypeError:
            assert "sort" in body
        assert (np.array, np.asarray) == before
    assert type(np.array([rs.Param("a", 1.0)])) is np.ndarray


def test_symbols_outside_of_user_functions() -> None:
    """Numbers of a scene go through the same functions; names of methods stay."""
    p = rs.Param("p", -0.3)
    x = [np.sign(p), np.floor(p), np.ceil(p), np.maximum(p, 0), np.clip(p, -0.1, 1), abs(p)]
    body = rs.RigidBody("b", 1, (1, 1, 1))
    joint = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), np.eye(6), offset=x)
    model = rs.compile_scene(rs.Scene("one", [body], [joint]), minimal=False)
    at = np.array([0, 0, 0, 1, *[0.0] * 9])
    for value in (-0.3, 0.3):
        force_at = np.array(model.function("c.force_local")(0, at, [], [], [value]))[:, 0]
        expected = [np.sign(value), np.floor(value), np.ceil(value)]
        assert np.array_equal(force_at, -np.array(expected))
    assert repr(p.sign()) == "sign(p)"
