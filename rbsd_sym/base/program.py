"""SX Functions as lists of instructions: repeated with other arguments, and identified.

Facts of CasADi 3.8, found by experiment, that this file rests on:

- A call of an interpolant, a Callback, an external Function or one never inlined is a single
  instruction `OP_CALL` of an SX Function. `which_function()` of its node is the callee; its inputs
  and outputs are the nonzeros of all arguments and results, -1 for a result that is not used.
- `SX.unary(op, x)` and `SX.binary(op, x, y)` return 0 for every op that they do not know, such as
  `OP_CALL`, so that code which repeats instructions must not pass them one it does not know either.
- `jacobian`, `jtimes`, `hessian`, `jacobian_sparsity`, `which_depends`, `depends_on`, `substitute`,
  `symvar`, `cse` and the C code generator treat calls correctly. `is_constant()` is False for a
  call with numbers, and so is `is_equal` for two calls with the same arguments.
- `str` prints 6 digits of a number, and of a callee only its name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import cache

import casadi as ca
import numpy as np

_CODES = 128  # instructions of CasADi are numbered below
_FORMULAS = frozenset(
    ("LinearInterpolant", "BSplineInterpolant", "SXFunction", "MXFunction", "Map")
)


def repeated(op: int, node: ca.SX, arguments: Sequence[ca.SX]) -> list[ca.SX]:
    """Return the results of an instruction for other arguments.

    A call stays a call of the same Function. With numbers only it becomes numbers, if the callee is
    a table or a formula and so always gives the same. An instruction that is not known stays as it
    is.

    Arguments:
        op: `Function.instruction_id` of the instruction.
        node: its entry in `Function.instructions_sx`.
        arguments: scalars that are equal to the instruction's own, in a simpler form.
    """
    if op in _operations():
        return [(ca.SX.binary if len(arguments) == 2 else ca.SX.unary)(op, *arguments)]
    return _called(node.which_function(), arguments) if op == ca.OP_CALL else [node]


@cache
def _operations() -> frozenset[int]:
    """Operations that `SX.unary` or `SX.binary` can build, found by trying all codes."""
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    built = [
        (op, node)
        for op in range(_CODES)
        # CasADi has a code of its own for powers with a constant exponent.
        for node in (ca.SX.unary(op, a), ca.SX.binary(op, a, b), ca.SX.binary(op, a, 0.7))
    ]
    return frozenset(op for op, node in built if not node.is_constant() and node.op() == op)


def _called(callee: ca.Function, arguments: Sequence[ca.SX]) -> list[ca.SX]:
    patterns = [callee.sparsity_in(i) for i in range(callee.n_in())]
    ends = np.cumsum([0, *(pattern.nnz() for pattern in patterns)])
    given = [
        ca.SX(pattern, ca.vertcat(ca.SX(0, 1), *arguments[a:b]))
        for pattern, a, b in zip(patterns, ends, ends[1:], strict=False)
    ]
    if all(argument.is_constant() for argument in arguments) and _is_formula(callee):
        numbers = callee.call([ca.DM(value) for value in given])
        if all(number.is_regular() for number in numbers):
            return [ca.SX(value) for number in numbers for value in number.nonzeros()]
    # Whether it is inlined may have been asked for by the caller alone, so it is asked for again.
    results = callee.call(given, False, True)
    return [result.nz[i] for result in results for i in range(result.nnz())]


def _is_formula(callee: ca.Function) -> bool:
    """Whether a Function is known to give the same values whenever it is called."""
    return all(f.class_name() in _FORMULAS for f in (callee, *callee.find_functions()))


def identity(column: ca.SX) -> str:
    """Return a text that two columns share only if they are the same formulas of the same symbols.

    In contrast to `str`, all digits of numbers and the content of callees count. A Callback has no
    content that could be read, and is identified within this process only.
    """
    if column.is_valid_input():  # symbols only, whose names say it all
        return str(column)
    return content(ca.Function("same", ca.symvar(column), [column]))


def content(function: ca.Function) -> str:
    """Return a hash of all that a Function computes, its callees included; see `identity`."""
    callbacks = [
        str(hash(f))
        for f in (function, *function.find_functions())
        if f.class_name() == "CallbackInternal"
    ]
    return hashlib.sha256(" ".join([function.serialize(), *callbacks]).encode()).hexdigest()


def check_second_derivatives(function: ca.Function, where: str) -> None:
    """Check that CasADi has the second derivatives of all callees of a Function.

    It takes those of linear tables to be zero. Tables of several numbers are multilinear between
    grid points, so that mixed ones are not.

    Raises:
        ValueError: there is such a table.
    """
    names = [
        callee.name()
        for callee in function.find_functions()
        if callee.class_name() == "LinearInterpolant" and callee.nnz_in() > 1
    ]
    if names:
        raise ValueError(
            f"{where}: CasADi leaves out mixed second derivatives of {', '.join(names)}, linear in "
            "several numbers; make it by casadi.interpolant(..., 'bspline', ...)"
        )


def without_derivative(function: ca.Function) -> list[str]:
    """Return the names of the callees of a Function of which CasADi has no derivatives."""
    names = []
    for callee in function.find_functions():
        try:
            callee.forward(1)
        except RuntimeError:
            names.append(callee.name())
    return names
