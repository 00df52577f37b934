"""Instructions of CasADi: repeated, bounded, and compared, for every operation that there is.

The oracle is plain evaluation of the expression before any pass.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes.calls import (
    CALLBACK,
    CURVE,
    INSIDE,
    MASS,
    PLANE,
    SEVERAL,
    SQUARE,
    STIFFNESS,
    Doubled,
    shock,
)

import rbsd_sym as rs
from rbsd_sym.base.program import content, identity
from rbsd_sym.dae.zeros import ANY, Bounds, _bound, fold

NAMES = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
A, B, C = (ca.SX.sym(name) for name in "abc")
SYMBOLS = ca.vertcat(A, B, C)


def _built(code: int, count: int) -> bool:
    """Whether `SX.unary` or `SX.binary` makes an expression of that operation."""
    made = (ca.SX.unary if count == 1 else ca.SX.binary)(code, *ca.vertsplit(SYMBOLS[:count]))
    return not made.is_constant() and made.op() == code and made.n_dep() == count


PRINTS = ca.OP_PRINTME  # to the screen; it is tested by itself
ONE = [code for code in NAMES if _built(code, 1)]
TWO = [code for code in NAMES if _built(code, 2) and code != PRINTS]
CALLS: list[Any] = [
    lambda a, b: CURVE(a), lambda a, b: PLANE(ca.vertcat(a, b)), lambda a, b: SQUARE(a - b),
    lambda a, b: INSIDE(ca.vertcat(b, a)), lambda a, b: SEVERAL(ca.vertcat(a, 0, b))[1][1],
    lambda a, b: ca.if_else(a > b, CURVE(a), SQUARE(b), True), lambda a, b: CALLBACK(a),
    lambda a, b: ca.conditional(a > 0, [SQUARE(b)], a * b),
    lambda a, b: ca.pw_lin(a, ca.DM([-1, 0, 2]), ca.DM([3, 0, 1])),
    lambda a, b: ca.sum2(CURVE.map(2)(ca.horzcat(a, b))),
]  # fmt: skip


def test_operations_are_all_there() -> None:
    """As many as CasADi 3.8 has; a new one must be looked at."""
    assert len(ONE) + len(TWO) >= 47
    assert {ca.OP_ERFINV, ca.OP_LOG1P, ca.OP_FLOOR, ca.OP_SIGN} <= set(ONE)
    assert {ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_HYPOT, ca.OP_IF_ELSE_ZERO} <= set(TWO)


def values(expression: ca.SX, points: np.ndarray) -> np.ndarray:
    """The expression (n, 1) at points (3, m): (n, m)."""
    return np.array(ca.Function("plain", [SYMBOLS], [ca.densify(expression)])(points))


def check(expression: ca.SX, points: np.ndarray) -> None:
    """Folding changes no value that is a number, and loses no symbol that any value depends on."""
    folded = fold(expression, SYMBOLS)
    before, after = values(expression, points), values(folded, points)
    known = np.isfinite(before)
    np.testing.assert_allclose(after[known], before[known], rtol=1e-12, atol=1e-300)
    for i in range(3):
        others = points.copy()
        others[i] = points[i, ::-1]
        moved = values(expression, others)
        matters = (moved != before) & np.isfinite(moved) & known
        if matters.any():
            assert ca.depends_on(folded, SYMBOLS[i])


POINTS = np.random.default_rng(0).normal(size=(3, 40)) * [[0.8], [0.6], [1.5]]


@pytest.mark.parametrize("code", ONE, ids=NAMES.get)
def test_operations_of_one_number(code: int) -> None:
    arguments = A, A * B, A - 0.3, ca.fabs(C), C**2
    check(ca.vertcat(*(ca.SX.unary(code, x) for x in arguments)), POINTS)


@pytest.mark.parametrize("code", TWO, ids=NAMES.get)
def test_operations_of_two_numbers(code: int) -> None:
    pairs = [(A, B), (B, A * C), (A, ca.SX(0.7)), (ca.SX(0.7), B), (ca.sqrt(C), A), (A, ca.SX(0)),
             (A < B, C)]  # fmt: skip
    check(ca.vertcat(*(ca.SX.binary(code, *pair) for pair in pairs)), POINTS)


@pytest.mark.parametrize("call", CALLS)
def test_calls(call: Any) -> None:
    pairs = [(A, B), (B, ca.SX(0.7)), (C * A, ca.atan2(0, ca.fabs(B))), (ca.SX(0.3), A)]
    check(ca.vertcat(*(call(*pair) for pair in pairs)), POINTS)


def test_printing_goes_on(capfd: pytest.CaptureFixture[str]) -> None:
    folded = fold(ca.SX.binary(PRINTS, A * C, 3), SYMBOLS)
    capfd.readouterr()
    assert values(folded, np.array([[2.0], [0.0], [5.0]])) == 10
    assert capfd.readouterr().out.startswith("|> 3 : 1")


def test_calls_with_numbers_are_numbers_if_they_are_formulas() -> None:
    zero = ca.atan2(0, ca.fabs(A))  # provably 0, which CasADi does not see
    calls = CURVE(zero), CURVE(zero + 0.06), SQUARE(zero - 2), CALLBACK(zero)
    at = fold(ca.vertcat(*calls), SYMBOLS)
    np.testing.assert_array_equal(np.array(ca.DM(at[:3])).reshape(-1), [0, 330, -10000])
    assert not at[3].is_constant()
    assert fold(ca.vertcat(ca.SX(np.nan) * A, A + np.inf), SYMBOLS).is_constant() is False


# Bounds.

EDGES = [-np.inf, -2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 3.0, np.inf]
intervals = st.builds(
    lambda ends, minus: Bounds(min(ends), max(ends), minus and min(ends) <= 0 <= max(ends)),
    st.tuples(st.sampled_from(EDGES[:-1]), st.sampled_from(EDGES[1:])).filter(
        lambda ends: ends[0] <= ends[1]
    ),
    st.booleans(),
)


def inside(bounds: Bounds, rng: np.random.Generator) -> np.ndarray:
    """Finite numbers within bounds, the ends among them."""
    low, high = (float(np.clip(v, -50, 50)) for v in bounds[:2])
    zeros = [0.0] if low <= 0 <= high else []
    numbers = [low, high, *np.clip(rng.normal(size=6), low, high), *rng.uniform(low, high, 6)]
    return np.array([v or 0.0 for v in numbers] + zeros + ([-0.0] if bounds.minus else []))


@pytest.mark.parametrize("code", [*ONE, *TWO], ids=NAMES.get)
@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_bounds_hold(code: int, data: st.DataObject) -> None:
    """For every number within the bounds of the arguments, zeros of both signs among them."""
    rng, count = np.random.default_rng(0), 1 if code in ONE else 2
    arguments = [data.draw(intervals) for _ in range(count)]
    found = _bound(code, arguments)
    grid = np.array(np.meshgrid(*(inside(b, rng) for b in arguments))).reshape(count, 1, -1)
    reached = np.array(_operation(code)(*grid)).reshape(-1)
    reached = reached[~np.isnan(reached)]
    room = 1e-14 * (1 + np.abs(reached))
    assert ((reached >= found.low - room) & (reached <= found.high + room)).all(), found
    if not found.minus and not found.is_point:  # a point is replaced, by a plain 0
        assert not (np.signbit(reached) & (reached == 0)).any(), found
    if code in (ca.OP_ERFINV, ca.OP_CEIL):  # without a rule
        assert found == ANY


@cache
def _operation(code: int) -> ca.Function:
    symbols = ca.vertsplit(SYMBOLS[: 1 if code in ONE else 2])
    made = (ca.SX.unary if code in ONE else ca.SX.binary)(code, *symbols)
    return ca.Function("operation", symbols, [made])


def test_an_angle_from_minus_zero_is_pi() -> None:
    """Ceil(a) is -0.0 for a in (-1, 0), and so is its root: no proof that the angle is 0."""
    check(ca.atan2(0, ca.sqrt(ca.ceil(A))), np.tile(np.linspace(-0.9, 0.9, 7), (3, 1)))
    assert fold(ca.atan2(0, ca.sqrt(A**2 + B**2)), SYMBOLS).is_zero()
    assert fold(ca.atan2(0, ca.sqrt(1 - ca.cos(A) ** 2)), SYMBOLS).is_zero()


# Random formulas.

leaves = st.sampled_from([A, B, C, ca.SX(0), ca.SX(1), ca.SX(-0.5), ca.SX(2)])
formulas = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.tuples(st.sampled_from(ONE), inner).map(lambda v: ca.SX.unary(*v)),
        st.tuples(st.sampled_from(TWO), inner, inner).map(lambda v: ca.SX.binary(*v)),
        st.tuples(st.sampled_from(CALLS), inner, inner).map(lambda v: v[0](*v[1:])),
        inner.map(lambda v: ca.atan2(0, ca.sqrt(v))),
    ),
    max_leaves=12,
)


def _numbers_all_the_way(expression: ca.SX, points: np.ndarray) -> np.ndarray:
    """Points at which every intermediate result is finite and not -0.0.

    Bounds hold for numbers, and CasADi keeps no -0.0 either: it takes 0 x and -0 for 0.
    """
    program = ca.Function("program", [SYMBOLS], [ca.densify(expression)])
    nodes = program.instructions_sx()
    steps = [k for k in range(program.n_instructions()) if program.instruction_id(k) not in (
        ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CALL)]  # fmt: skip
    between = values(nodes[steps], points) if steps else np.zeros((1, points.shape[1]))
    known = np.isfinite(between) & ~(np.signbit(between) & (between == 0))
    return points[:, known.all(axis=0)]


@settings(deadline=None, max_examples=300)
@given(formula=formulas)
def test_random_formulas(formula: ca.SX) -> None:
    points = _numbers_all_the_way(formula, POINTS)
    if points.shape[1] > 1:
        check(formula, points)


# Identity.


def test_identity_tells_formulas_apart() -> None:
    other = ca.interpolant("curve", "linear", [[0.0, 1.0]], [0.0, 1.0])
    same = ca.interpolant("curve", "linear", [[0.0, 1.0]], [0.0, 1.0])
    texts = [identity(f) for f in (A, B, A * 0.1234567, A * 0.12345671, CURVE(A), other(A), A + A)]
    assert len(set(texts)) == len(texts)
    assert identity(other(A)) == identity(same(A))
    twins = [Doubled("cb", {"enable_fd": True}, factor) for factor in (1.0, 2.0)]
    assert len({content(ca.Function("f", [A], [twin(A)])) for twin in twins}) == 2


# Every operation as a user's force.


@pytest.mark.parametrize("code", [*ONE, *TWO], ids=NAMES.get)
def test_forces_of_every_operation(code: int) -> None:
    """Rates of every model, beside the operation applied to travel and speed."""

    def operation(u: ca.SX, v: ca.SX) -> ca.SX:
        return ca.SX.unary(code, u) if code in ONE else ca.SX.binary(code, u, v)

    exact = ca.Function("exact", [A, B], [operation(A, B)])
    for layout in ("flat", "kernels"):
        for minimal in (True, False):
            scene = shock(lambda u, v: operation(u.expr, v.expr))
            model = rs.compile_scene(scene, layout=layout, minimal=minimal)
            names = [label.name for label in model.x_labels]
            z, v = names.index("body.p_z"), names.index("body.v_z")
            assert (model.n_x == 2) is minimal
            x = np.tile([[label.start] for label in model.x_labels], POINTS.shape[1])
            x[[z, v]] = POINTS[:2]
            force = STIFFNESS * POINTS[0] + np.array(exact(POINTS[:1], POINTS[1:2]))[0]
            rates = np.array(model.function("ode")(0, x, [], [], []))
            np.testing.assert_allclose(rates[v], -force / MASS, rtol=1e-12)
