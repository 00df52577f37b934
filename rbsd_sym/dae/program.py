"""SX Functions as lists of instructions: replayed with other arguments, and compared.

Facts of CasADi 3.8, found by experiment, on which this file rests:

- An interpolant, a Callback, an external Function, and a Function that is never inlined are each one
  instruction `OP_CALL` of an SX Function. `which_function()` of its node gives the callee; its
  inputs and outputs are the nonzeros of all arguments and results, -1 for results without use.
- `SX.unary(op, x)` and `SX.binary(op, x, y)` return 0 for every op that they do not know, such as
  `OP_CALL`. Who replays instructions must not let an unknown one reach them.
- `jacobian`, `jtimes`, `hessian`, `jacobian_sparsity`, `which_depends`, `depends_on`, `substitute`,
  `symvar`, `cse` and the C code generator treat calls correctly. `is_constant()` is False for a call
  of numbers, and `is_equal` for two calls with the same arguments.
- `str` prints 6 digits of a number, and of a callee only its name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import casadi as ca
import numpy as np

# Instructions of one and of two arguments that `SX.unary` and `SX.binary` can repeat.
_ONE = frozenset(
    getattr(ca, f"OP_{name}")
    for name in (
        "NEG EXP LOG SQRT SQ TWICE SIN COS TAN ASIN ACOS ATAN NOT FLOOR CEIL FABS SIGN ERF INV SINH "
        "COSH TANH ASINH ACOSH ATANH ERFINV LOG1P EXPM1"
    ).split()
)
_TWO = frozenset(
    getattr(ca, f"OP_{name}")
    for name in (
        "ADD SUB MUL DIV POW CONSTPOW LT LE EQ NE AND OR FMOD COPYSIGN IF_ELSE_ZERO FMIN FMAX ATAN2 "
        "HYPOT REMAINDER"
    ).split()
)
# Callees of these classes are formulas and tables: what they give for numbers is a number for good.
_FIXED = frozenset(("LinearInterpolant", "BSplineInterpolant", "SXFunction", "MXFunction", "Map"))


def repeated(op: int, node: ca.SX, arguments: Sequence[ca.SX]) -> list[ca.SX]:
    """Return the results of one instruction for other arguments.

    A call of a table or a formula with numbers gives numbers. An instruction that is not known
    stays as it is.

    Arguments:
        op: `Function.instruction_id` of the instruction.
        node: its entry in `Function.instructions_sx`, over the arguments of that Function.
        arguments: scalars, equal in value to what the instruction had.
    """
    if op in _ONE:
        return [ca.SX.unary(op, *arguments)]
    if op in _TWO:
        return [ca.SX.binary(op, *arguments)]
    return _called(node.which_function(), arguments) if op == ca.OP_CALL else [node]


def _called(callee: ca.Function, arguments: Sequence[ca.SX]) -> list[ca.SX]:
    patterns = [callee.sparsity_in(i) for i in range(callee.n_in())]
    ends = np.cumsum([0, *(pattern.nnz() for pattern in patterns)])
    given = [
        ca.SX(pattern, ca.vertcat(ca.SX(0, 1), *arguments[a:b]))
        for pattern, a, b in zip(patterns, ends, ends[1:], strict=False)
    ]
    if all(argument.is_constant() for argument in arguments) and _is_fixed(callee):
        numbers = callee.call([ca.DM(value) for value in given])
        if all(number.is_regular() for number in numbers):
            return [ca.SX(value) for number in numbers for value in number.nonzeros()]
    # The third argument keeps the call a call, however the callee was made.
    results = callee.call(given, False, True)
    return [result.nz[i] for result in results for i in range(result.nnz())]


def _is_fixed(callee: ca.Function) -> bool:
    """Whether a Function gives the same numbers for the same arguments, whoever wrote it."""
    return all(f.class_name() in _FIXED for f in (callee, *callee.find_functions()))


def identity(column: ca.SX) -> str:
    """Return a text that two columns share only if they are the same formulas of the same symbols.

    All digits of numbers and the content of callees are part of it, unlike `str`. A Callback has no
    content that can be read; it is identified within this process.
    """
    if column.is_valid_input():  # symbols alone: their names say it all
        return str(column)
    return content(ca.Function("same", ca.symvar(column), [column]))


def content(function: ca.Function) -> str:
    """Return a hash of all that a Function computes, callees included; see `identity`."""
    callbacks = [
        str(hash(f))
        for f in (function, *function.find_functions())
        if f.class_name() == "CallbackInternal"
    ]
    return hashlib.sha256(" ".join([function.serialize(), *callbacks]).encode()).hexdigest()
