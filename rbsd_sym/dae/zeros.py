"""Proof of zeros: expressions replayed with an interval for every intermediate result.

CasADi simplifies 0 x and x + 0 while it builds an expression. Others take signs: atan2(0, x) is
zero if x is a square root. A result whose interval is a single point is replaced by that number.

The proofs must be sound, since a state whose rate is proven to be zero leaves the model. An
operation without a rule here may have any value, and it is never replaced.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca

from ..base.program import repeated


class Bounds(NamedTuple):
    """Bounds of a value, wherever that value and those it was computed from are numbers (not NaN).

    States, inputs and parameters are finite, of any size.

    Fields:
        minus: whether the value may be -0.0, which atan2 tells from 0.0: ceil(-0.5), for instance.
    """

    low: float
    high: float
    minus: bool = True

    @property
    def is_point(self) -> bool:
        """Whether only one finite value is possible."""
        return self.low == self.high and math.isfinite(self.low)

    @property
    def is_zero(self) -> bool:
        """Whether the value is 0, of either sign."""
        return self.low == self.high == 0

    @property
    def is_positive(self) -> bool:
        """Whether the value is 0.0 or larger."""
        return self.low >= 0 and not self.minus


ANY = Bounds(-math.inf, math.inf)
_ZERO = Bounds(0.0, 0.0, False)
_UNIT = Bounds(-1.0, 1.0)


def fold(expression: ca.SX, symbols: ca.SX) -> ca.SX:
    """Return the column with every intermediate result that is provably one number replaced by it.

    Calls of tables and of Functions that are never inlined are kept (see `program.repeated`).

    Arguments:
        expression: column (n, 1) over the symbols.
        symbols: column of all symbols in it; each may take any finite value.
    """
    if expression.is_constant():
        return expression
    program = ca.Function("fold", [symbols], [ca.densify(expression)])
    nodes = program.instructions_sx()
    size = program.sz_w()
    values: list[ca.SX] = [ca.SX(0)] * size
    bounds: list[Bounds] = [ANY] * size
    rows: list[ca.SX] = [ca.SX(0)] * expression.numel()
    for k in range(program.n_instructions()):
        op = program.instruction_id(k)
        inputs, outputs = program.instruction_input(k), program.instruction_output(k)
        if op == ca.OP_OUTPUT:
            rows[outputs[1]] = values[inputs[0]]
            continue
        if op == ca.OP_INPUT:
            results, bound = [symbols[inputs[1]]], ANY
        elif op == ca.OP_CONST:
            results, bound = [ca.SX(program.instruction_constant(k))], ANY
        else:
            results = repeated(op, nodes[k], [values[i] for i in inputs])
            bound = _bound(op, [bounds[i] for i in inputs])
        for out, value in zip(outputs, results, strict=True):
            if out >= 0:  # a result of a call without use has no place
                own = _known(value) if value.is_constant() else bound
                values[out] = ca.SX(own.low) if own.is_point else value
                bounds[out] = own
    return ca.vertcat(*rows)


def _known(value: ca.SX) -> Bounds:
    number = float(value)
    return ANY if math.isnan(number) else Bounds(number, number, False)


def _bound(op: int, arguments: list[Bounds]) -> Bounds:
    rule = _RULES.get(op)
    bound = rule(*arguments) if rule else ANY
    if math.isnan(bound.low) or math.isnan(bound.high):  # such as infinity less infinity
        return ANY
    exact = any(a.is_zero for a in arguments) or all(a.is_point for a in arguments)
    # Bounds are rounded to nearest, so that a narrow interval may close to a point that it is not.
    if bound.is_point and not exact:
        return Bounds(math.nextafter(bound.low, -math.inf), math.nextafter(bound.high, math.inf))
    return bound


def _times(a: Bounds, b: Bounds) -> Bounds:
    if a.is_zero or b.is_zero:
        return _ZERO
    products, minus = [x * y for x in a[:2] for y in b[:2]], not (a.is_positive and b.is_positive)
    # 0 times an infinite bound: the factor itself is finite, so that only its sign is known.
    if any(math.isnan(p) for p in products):
        low = 0.0 if min(a.low, b.low) >= 0 else -math.inf
        return Bounds(low, math.inf, minus)
    return Bounds(min(products), max(products), minus)


def _square(a: Bounds) -> Bounds:
    high = max(a.low * a.low, a.high * a.high)
    low = 0.0 if a.low <= 0 <= a.high else min(a.low * a.low, a.high * a.high)
    return Bounds(low, high, False)


def _over(a: Bounds, b: Bounds) -> Bounds:
    if a.is_zero and (b.low > 0 or b.high < 0):
        return _ZERO
    if b.low > 0 and math.isfinite(b.low):
        return _times(a, Bounds(1 / b.high if b.high else math.inf, 1 / b.low, False))
    if a.is_positive and b.is_positive:
        return Bounds(0.0, math.inf, False)
    return ANY


def _atan2(y: Bounds, x: Bounds) -> Bounds:
    """Bounds of atan2, which is within pi: in C atan2(0, x) is 0 for x >= 0.0, but pi for -0.0."""
    if y.is_zero and x.is_positive:
        return _ZERO
    return Bounds(0.0, math.pi, False) if y.is_positive else Bounds(-math.pi, math.pi)


def _sqrt(a: Bounds) -> Bounds:
    return Bounds(math.sqrt(max(a.low, 0.0)), math.sqrt(max(a.high, 0.0)), a.minus)


def _absolute(a: Bounds) -> Bounds:
    low = 0.0 if a.low <= 0 <= a.high else min(abs(a.low), abs(a.high))
    return Bounds(low, max(abs(a.low), abs(a.high)), False)


def _truth(*_: Bounds) -> Bounds:
    return Bounds(0.0, 1.0, False)


def _sum(a: Bounds, b: Bounds) -> Bounds:
    return Bounds(a.low + b.low, a.high + b.high, a.minus and b.minus)


def _negative(a: Bounds) -> Bounds:
    return Bounds(-a.high, -a.low, a.low <= 0 <= a.high)


def _largest(a: Bounds, b: Bounds) -> Bounds:
    return Bounds(max(a.low, b.low), max(a.high, b.high), a.minus or b.minus)


def _smallest(a: Bounds, b: Bounds) -> Bounds:
    return Bounds(min(a.low, b.low), min(a.high, b.high), a.minus or b.minus)


_RULES: dict[int, Callable[..., Bounds]] = {
    ca.OP_ADD: _sum,
    ca.OP_SUB: lambda a, b: _sum(a, _negative(b)),
    ca.OP_NEG: _negative,
    ca.OP_MUL: _times,
    ca.OP_DIV: _over,
    ca.OP_INV: lambda a: _over(Bounds(1.0, 1.0), a),
    ca.OP_TWICE: lambda a: _sum(a, a),
    ca.OP_SQ: _square,
    ca.OP_SQRT: _sqrt,
    ca.OP_FABS: _absolute,
    ca.OP_SIN: lambda a: _ZERO if a.is_zero else _UNIT,
    ca.OP_COS: lambda a: _UNIT,
    ca.OP_TAN: lambda a: _ZERO if a.is_zero else ANY,
    ca.OP_TANH: lambda a: _ZERO if a.is_zero else _UNIT,
    ca.OP_ASIN: lambda a: _ZERO if a.is_zero else ANY,
    ca.OP_ATAN: lambda a: _ZERO if a.is_zero else ANY,
    ca.OP_ATAN2: _atan2,
    ca.OP_FMAX: _largest,
    ca.OP_FMIN: _smallest,
    ca.OP_LT: _truth,
    ca.OP_LE: _truth,
    ca.OP_EQ: _truth,
    ca.OP_NE: _truth,
    ca.OP_NOT: _truth,
    ca.OP_AND: _truth,
    ca.OP_OR: _truth,
    ca.OP_IF_ELSE_ZERO: lambda c, a: Bounds(min(a.low, 0.0), max(a.high, 0.0), a.minus),
}
