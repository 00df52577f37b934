"""Proof of zeros: expressions replayed with an interval for every node.

CasADi folds 0 x and x + 0 as it builds. What it cannot see needs signs: atan2(0, x) is zero where x
is a square root. A node whose interval is one point becomes that number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import casadi as ca


class Bounds(NamedTuple):
    """Bounds of a value; the states themselves are finite, of any size."""

    low: float
    high: float

    @property
    def is_point(self) -> bool:
        """Whether the value is known."""
        return self.low == self.high and math.isfinite(self.low)


ANY = Bounds(-math.inf, math.inf)
_ZERO = Bounds(0.0, 0.0)
_UNIT = Bounds(-1.0, 1.0)


def fold(expression: ca.SX, symbols: ca.SX) -> ca.SX:
    """The column with every node that is provably one number replaced by it.

    Arguments:
        expression: column (n, 1) over the symbols.
        symbols: column of all symbols in it; each may take any finite value.
    """
    if expression.is_constant():
        return expression
    program = ca.Function("fold", [symbols], [ca.densify(expression)])
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
        out = outputs[0]
        if op == ca.OP_INPUT:
            values[out], bounds[out] = symbols[inputs[1]], ANY
        elif op == ca.OP_CONST:
            number = program.instruction_constant(k)
            values[out], bounds[out] = ca.SX(number), Bounds(number, number)
        else:
            arguments = [values[i] for i in inputs]
            value = (ca.SX.binary if len(inputs) == 2 else ca.SX.unary)(op, *arguments)
            bound = _bound(op, [bounds[i] for i in inputs])
            if value.is_constant():
                bound = Bounds(float(value), float(value))
            values[out] = ca.SX(bound.low) if bound.is_point else value
            bounds[out] = bound
    return ca.vertcat(*rows)


def _bound(op: int, arguments: list[Bounds]) -> Bounds:
    rule = _RULES.get(op)
    bound = rule(*arguments) if rule else ANY
    exact = _ZERO in arguments or all(a.is_point for a in arguments)
    if bound.is_point and not exact:  # rounding closed it, not a proof
        return Bounds(math.nextafter(bound.low, -math.inf), math.nextafter(bound.high, math.inf))
    return bound


def _times(a: Bounds, b: Bounds) -> Bounds:
    if a == _ZERO or b == _ZERO:
        return _ZERO
    products = [x * y for x in a for y in b]
    if any(math.isnan(p) for p in products):  # 0 times infinity: the factor is finite, any size
        low = 0.0 if min(a.low, b.low) >= 0 else -math.inf
        return Bounds(low, math.inf)
    return Bounds(min(products), max(products))


def _square(a: Bounds) -> Bounds:
    high = max(a.low * a.low, a.high * a.high)
    low = 0.0 if a.low <= 0 <= a.high else min(a.low * a.low, a.high * a.high)
    return Bounds(low, high)


def _over(a: Bounds, b: Bounds) -> Bounds:
    if a == _ZERO and (b.low > 0 or b.high < 0):
        return _ZERO
    if b.low > 0 and math.isfinite(b.low):
        return _times(a, Bounds(1 / b.high if b.high else math.inf, 1 / b.low))
    if b.low >= 0 and a.low >= 0:
        return Bounds(0.0, math.inf)
    return ANY


def _atan2(y: Bounds, x: Bounds) -> Bounds:
    """atan2(0, x) is 0 for x >= 0 (also at 0, in C); any other angle is bounded by pi."""
    if y == _ZERO and x.low >= 0:
        return _ZERO
    return Bounds(0.0 if y.low >= 0 else -math.pi, math.pi)


def _sqrt(a: Bounds) -> Bounds:
    return Bounds(math.sqrt(max(a.low, 0.0)), math.sqrt(max(a.high, 0.0)))


def _absolute(a: Bounds) -> Bounds:
    low = 0.0 if a.low <= 0 <= a.high else min(abs(a.low), abs(a.high))
    return Bounds(low, max(abs(a.low), abs(a.high)))


def _truth(*_: Bounds) -> Bounds:
    return Bounds(0.0, 1.0)


def _sum(a: Bounds, b: Bounds) -> Bounds:
    return Bounds(a.low + b.low, a.high + b.high)


def _negative(a: Bounds) -> Bounds:
    return Bounds(-a.high, -a.low)


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
    ca.OP_SIN: lambda a: _ZERO if a == _ZERO else _UNIT,
    ca.OP_COS: lambda a: _UNIT,
    ca.OP_TAN: lambda a: _ZERO if a == _ZERO else ANY,
    ca.OP_TANH: lambda a: _ZERO if a == _ZERO else _UNIT,
    ca.OP_ASIN: lambda a: _ZERO if a == _ZERO else ANY,
    ca.OP_ATAN: lambda a: _ZERO if a == _ZERO else ANY,
    ca.OP_ATAN2: _atan2,
    ca.OP_FMAX: lambda a, b: Bounds(max(a.low, b.low), max(a.high, b.high)),
    ca.OP_FMIN: lambda a, b: Bounds(min(a.low, b.low), min(a.high, b.high)),
    ca.OP_LT: _truth,
    ca.OP_LE: _truth,
    ca.OP_EQ: _truth,
    ca.OP_NE: _truth,
    ca.OP_NOT: _truth,
    ca.OP_AND: _truth,
    ca.OP_OR: _truth,
    ca.OP_IF_ELSE_ZERO: lambda c, a: Bounds(min(a.low, 0.0), max(a.high, 0.0)),
}
