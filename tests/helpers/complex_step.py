"""CasADi functions in complex arithmetic, and derivatives by complex steps.

The imaginary part of f(x + i h) / h is the derivative without cancellation, so that h may be so
small that the next term is far below rounding [Squire, Trapp 1998, SIAM Review 40(1)].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

STEP = 1e-50


def _atan2(y: Any, x: Any) -> Any:
    """Of real parts, and its differential: exact while the square of the step vanishes."""
    slope = (x.real * y.imag - y.real * x.imag) / (x.real**2 + y.real**2)
    return np.arctan2(y.real, x.real) + 1j * slope


def _where(test: Any, value: Any) -> Any:
    return np.where(test.real != 0, value, 0.0)


_UNARY: dict[int, Callable[[Any], Any]] = {
    ca.OP_ASSIGN: lambda a: a, ca.OP_NEG: lambda a: -a, ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: 2 * a, ca.OP_INV: lambda a: 1 / a, ca.OP_SQRT: np.sqrt,
    ca.OP_SIN: np.sin, ca.OP_COS: np.cos, ca.OP_TAN: np.tan, ca.OP_EXP: np.exp, ca.OP_LOG: np.log,
    ca.OP_ASIN: np.arcsin, ca.OP_ACOS: np.arccos, ca.OP_ATAN: np.arctan, ca.OP_TANH: np.tanh,
    ca.OP_FABS: lambda a: np.where(a.real < 0, -a, a), ca.OP_SIGN: lambda a: np.sign(a.real) + 0j,
    ca.OP_NOT: lambda a: (a.real == 0) + 0j,
}  # fmt: skip
_BINARY: dict[int, Callable[[Any, Any], Any]] = {
    ca.OP_ADD: lambda a, b: a + b, ca.OP_SUB: lambda a, b: a - b, ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b, ca.OP_ATAN2: _atan2, ca.OP_IF_ELSE_ZERO: _where,
    ca.OP_POW: lambda a, b: a**b, ca.OP_CONSTPOW: lambda a, b: a**b,
    ca.OP_LT: lambda a, b: (a.real < b.real) + 0j, ca.OP_LE: lambda a, b: (a.real <= b.real) + 0j,
    ca.OP_EQ: lambda a, b: (a.real == b.real) + 0j, ca.OP_NE: lambda a, b: (a.real != b.real) + 0j,
    ca.OP_AND: lambda a, b: ((a.real != 0) & (b.real != 0)) + 0j,
    ca.OP_OR: lambda a, b: ((a.real != 0) | (b.real != 0)) + 0j,
    ca.OP_FMIN: lambda a, b: np.where(a.real <= b.real, a, b),
    ca.OP_FMAX: lambda a, b: np.where(a.real >= b.real, a, b),
}  # fmt: skip


def values(function: ca.Function, arguments: Sequence[Any]) -> list[np.ndarray]:
    """Nonzeros (nnz, n) of each result, from complex columns (size, n) of each dense argument."""
    flat = function.expand()
    n = max(np.shape(a)[1] for a in arguments)
    given = [np.broadcast_to(np.array(a, complex), (np.shape(a)[0], n)) for a in arguments]
    found = [np.zeros((flat.nnz_out(k), n), complex) for k in range(flat.n_out())]
    work: list[Any] = [None] * flat.sz_w()
    for k in range(flat.n_instructions()):
        code, args, to = flat.instruction_id(k), flat.instruction_input(k), (
            flat.instruction_output(k))  # fmt: skip
        if code == ca.OP_OUTPUT:
            found[to[0]][to[1]] = work[args[0]]
        elif code == ca.OP_CONST:
            work[to[0]] = np.full(n, flat.instruction_constant(k), complex)
        elif code == ca.OP_INPUT:
            work[to[0]] = given[args[0]][args[1]]
        elif code in _UNARY:
            work[to[0]] = _UNARY[code](work[args[0]])
        else:
            work[to[0]] = _BINARY[code](work[args[0]], work[args[1]])
    return found


def jacobian(function: ca.Function, arguments: Sequence[Any], wrt: int = 0) -> list[np.ndarray]:
    """Derivatives (nnz, n) of each result by argument `wrt` (n, 1)."""
    x = np.array(arguments[wrt], complex).reshape(-1, 1)
    moved = [np.array(a, complex).reshape(-1, 1) for a in arguments]
    moved[wrt] = x + 1j * STEP * np.eye(len(x))
    return [value.imag / STEP for value in values(function, moved)]
