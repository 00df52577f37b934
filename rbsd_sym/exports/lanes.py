"""Kernels as C functions that work on several instances at once.

CasADi's own C code takes one instance after another. Here every number is a vector with one entry
(lane) for each of four instances; with compilers other than GCC and Clang it has a single lane.
Each lane goes through the operations of CasADi's code in the same order, so that results are equal.
"""

from __future__ import annotations

from collections.abc import Iterable

import casadi as ca

_INFIX = {
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2. * {0}",
    ca.OP_INV: "1. / {0}",
    ca.OP_ASSIGN: "{0}",
    ca.OP_LT: "LANES_TEST({0} < {1})",
    ca.OP_LE: "LANES_TEST({0} <= {1})",
    ca.OP_EQ: "LANES_TEST({0} == {1})",
    ca.OP_NE: "LANES_TEST({0} != {1})",
    ca.OP_AND: "LANES_TEST(({0} != 0) & ({1} != 0))",
    ca.OP_OR: "LANES_TEST(({0} != 0) | ({1} != 0))",
    ca.OP_NOT: "LANES_TEST({0} == 0)",
    ca.OP_SIGN: "LANES_TEST({0} > 0) - LANES_TEST({0} < 0)",
    ca.OP_IF_ELSE_ZERO: "LANES_IF({0}, {1})",
}
_OF_ONE = {
    getattr(ca, f"OP_{name.upper()}"): name
    for name in (
        "sqrt",
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "sinh",
        "cosh",
        "tanh",
        "asinh",
        "acosh",
        "atanh",
        "exp",
        "log",
        "log1p",
        "expm1",
        "fabs",
        "floor",
        "ceil",
        "erf",
    )
}
_OF_TWO = {
    getattr(ca, f"OP_{name.upper()}"): name
    for name in ("atan2", "pow", "fmin", "fmax", "fmod", "copysign", "hypot", "remainder")
} | {ca.OP_CONSTPOW: "pow"}


_OWN = frozenset((ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST))


def has_lanes(function: ca.Function) -> bool:
    """Whether `kernel_text` knows every operation of an SX Function.

    It does not know calls of tables and of Functions that are never inlined, for instance: their C
    code takes one instance.
    """
    codes = {function.instruction_id(i) for i in range(function.n_instructions())}
    return codes <= _OWN | _INFIX.keys() | _OF_ONE.keys() | _OF_TWO.keys()


def functions_text(kernels: Iterable[ca.Function]) -> str:
    """Return the C text of those functions of math.h that the kernels call, for all lanes."""
    codes = {k.instruction_id(i) for k in kernels for i in range(k.n_instructions())}
    lines = []
    one = "const lanes *a", "LANE(*a, l)"
    two = "const lanes *a, const lanes *b", "LANE(*a, l), LANE(*b, l)"
    for table, (arguments, entries) in ((_OF_ONE, one), (_OF_TWO, two)):
        for name in sorted({table[code] for code in codes if code in table}):
            lines += [
                f"#define LANES_{name}(l) {name}({entries})",
                f"LANES_INLINE void lanes_{name}({arguments}, lanes *r) "
                f"{{ *r = (lanes)EACH(LANES_{name}); }}",
            ]
    return "\n".join(lines)


def kernel_text(function: ca.Function, name: str) -> str:
    """Return the C text of a function (arguments ..., out) on lanes.

    Arguments:
        function: SX Function with one result, of operations that have lanes (`has_lanes`).
        name: of the C function.
    """
    letters = [f"a{k}" for k in range(function.n_in())]
    count = max(1, function.sz_w())
    numbers = [f"w{k}" for k in range(count)]
    taken = ", ".join(f"const lanes *{a}" for a in letters)
    lines = [
        f"LANES_KERNEL void {name}({taken}, lanes *out)",
        "{",
        *(f"  lanes {', '.join(numbers[i : i + 20])};" for i in range(0, count, 20)),
        *(f"  {_line(function, k)}" for k in range(function.n_instructions())),
        f"  {', '.join(f'(void){a}' for a in letters)};",
        "}",
    ]
    return "\n".join(lines)


def _line(function: ca.Function, k: int) -> str:
    code, to = function.instruction_id(k), function.instruction_output(k)
    inputs = function.instruction_input(k)
    if code == ca.OP_OUTPUT:
        return f"out[{to[1]}] = w{inputs[0]};"
    arguments = [f"w{i}" for i in inputs]
    called = _OF_ONE.get(code) or _OF_TWO.get(code)
    # Arguments go by pointer, since vectors by value are passed differently with and without AVX.
    if called:
        return f"lanes_{called}({', '.join(f'&{a}' for a in arguments)}, &w{to[0]});"
    if code == ca.OP_CONST:
        value = f"LANES_ALL({_number(function.instruction_constant(k))})"
    elif code == ca.OP_INPUT:
        value = f"a{inputs[0]}[{inputs[1]}]"
    else:
        value = _INFIX[code].format(*arguments)
    return f"w{to[0]} = {value};"


def _number(value: float) -> str:
    special = {"inf": "INFINITY", "-inf": "-INFINITY", "nan": "NAN"}
    return special.get(repr(float(value)), repr(float(value)))
