"""Assembled functions as C loops: gather what instances read, call their kernel, add the results.

CasADi's own code for mapped kernels copies all arguments and all results, whereas these loops work
on a few instances at a time. CasADi generates a stub for each function, with the signature, the
sparsity and whatever else its loader needs, and the body of the stub is replaced by a loop.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from ..model.assembly import Assembled, Piece
from ..model.model import Model
from .folder import template
from .lanes import functions_text, has_lanes, kernel_text

_ARGUMENTS = "const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem"

_DIFFERENT = f"CasADi {ca.CasadiMeta.version()} writes functions differently; use 3.8.2"
_QUIET = """#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-const-variable" /* of what was replaced */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif
"""


def assembles(model: Model, name: str) -> bool:
    """Return whether the function of that name is written as loops.

    All of it is left to CasADi's code generator if one of its kernels has no lanes.
    """
    own = ("zero", "zero_rate", "jump", "post_newton")
    if not model.kernels or name in (*model.dae.outputs, *own) or "zero_d" in name:
        return False
    return all(has_lanes(piece.function) for piece in model.assembly.assembled(name).pieces)


def stub(model: Model, name: str, symbol: str, with_pattern: bool = False) -> ca.Function:
    """Return a Function whose C code has the right signature and sparsity, but a body of no use.

    Arguments:
        name: of the function in the model.
        symbol: its name in C.
        with_pattern: also give its Jacobian the right sparsity.
    """
    parts = model.assembly.assembled(name)
    symbols = [ca.MX.sym(v, size) for v, size in zip("txzup", _sizes(model), strict=True)]
    value = ca.MX(parts.pattern, 1.0)
    if with_pattern:
        value = ca.MX(*parts.pattern.shape)
        for v, column in zip("txzup", symbols, strict=True):
            block = model.assembly.assembled(f"d{name}_d{v}").pattern
            value = value + ca.mtimes(ca.MX(ca.DM(block, 1.0)), column)
        value = ca.densify(value)
    names = [*"txzup"]
    if parts.letter:
        symbols, names = [*symbols, ca.MX.sym(parts.letter, parts.n_given)], [*names, parts.letter]
    return ca.Function(symbol, symbols, [value], names, [name.replace(".", "_")])


def with_loops(text: str, model: Model, stubs: Mapping[str, str]) -> str:
    """Return CasADi's code with the bodies of stubs replaced by loops over kernels.

    Arguments:
        text: C text of the code generator.
        stubs: name in the model of each stub, by its symbol in C.

    Raises:
        RuntimeError: this version of CasADi writes functions in another way.
    """
    if not stubs:
        return text
    kernels: dict[str, ca.Function] = {}
    loops = []
    for symbol, name in stubs.items():
        parts = model.assembly.assembled(name)
        own = {f"{symbol}_k{i}": piece.function for i, piece in enumerate(parts.pieces)}
        text = _call_loops(text, symbol)
        loops.append(_loops(model, symbol, parts, list(own)))
        kernels |= own
    head = template("lanes.c", {}) + functions_text(kernels.values())
    bodies = [kernel_text(function, symbol) for symbol, function in kernels.items()]
    return "\n".join([_QUIET, text, head, *bodies, *loops])


def _sizes(model: Model) -> tuple[int, ...]:
    return (1, model.n_x, model.n_z, model.n_u, model.n_p)


def _call_loops(text: str, symbol: str) -> str:
    """Make the stub call the loops instead of its own body."""
    head = rf"(CASADI_SYMBOL_EXPORT int {symbol}\([^)]*\){{\s*return )casadi_f\d+\("
    declared = rf"static int {symbol}_loops({_ARGUMENTS});\n\n\1{symbol}_loops("
    text, count = re.subn(head, declared, text)
    if count != 1:
        raise RuntimeError(_DIFFERENT)
    return text


def _loops(model: Model, symbol: str, parts: Assembled, kernels: Sequence[str]) -> str:
    """Return the C function that sets the result to zero and adds all pieces to it."""
    n, sizes = parts.pattern.nnz(), _sizes(model)[1:]
    lines = [
        f"static int {symbol}_loops({_ARGUMENTS})",
        "{",
        "  casadi_real *out = res[0];",
        *_stacked(sizes),
        *(["  const casadi_real *given = arg[5];", "  (void)given;"] if parts.letter else []),
        "  if (!out) return 0;",
        f"  for (int i = 0; i < {n}; ++i) out[i] = 0;",
    ]
    for kernel, piece in zip(kernels, parts.pieces, strict=True):
        lines += _loop(kernel, piece)
    return "\n".join([*lines, "  return 0;", "}", ""])


def _stacked(sizes: Sequence[int]) -> list[str]:
    """Return the lines that set `all` to [x; z; u; p], with zeros for a NULL."""
    lines = [f"  casadi_real all[{max(1, sum(sizes))}];"]
    first = 0
    for i, size in enumerate(sizes, start=1):
        if size:
            each = f"for (int i = 0; i < {size}; ++i) all[{first} + i] ="
            lines += [f"  if (arg[{i}]) {each} arg[{i}][i];", f"  else {each} 0;"]
        first += size
    return [
        *lines,
        "  const double t = arg[0] ? arg[0][0] : 0;",
        "  const lanes time = LANES_ALL(t);",
        "  (void)all, (void)time, (void)iw, (void)w, (void)mem;",
    ]


def _loop(kernel: str, piece: Piece) -> list[str]:
    """Return the loop over all instances of a kernel, LANES at a time.

    If their number is not a multiple of LANES, the spare lanes repeat the last instance, and their
    results are not used.
    """
    m, count = piece.places.shape
    tables, before, arguments = [_table("int", "places", piece.places)], [], ["&time"]
    groups = (
        ("int", "reads", piece.reads, "LANES_READ"),
        ("casadi_real", "constants", piece.constants, "LANES_CONSTANT"),
        ("int", "weights", piece.given, "LANES_GIVEN"),
    )
    for kind, name, values, way in groups:
        if values is None:
            continue
        arguments.append(f"{name}_of" if values.size else "0")
        if not values.size:
            continue
        n = values.shape[0]
        tables.append(_table(kind, name, values))
        before += [
            f"lanes {name}_of[{n}];",
            "{",
            f"  const {kind} *from[LANES];",
            "  for (int l = 0; l < LANES; ++l)",
            f"    from[l] = {name} + (i + l < {count} ? i + l : {count - 1}) * {n};",
            f"  for (int j = 0; j < {n}; ++j) {name}_of[j] = (lanes)EACH({way});",
            "}",
        ]
    test = "if (place >= 0) " if (piece.places < 0).any() else ""
    return [
        "  {",
        *(f"    {table}" for table in tables),
        f"    for (int i = 0; i < {count}; i += LANES) {{",
        f"      lanes values[{m}];",
        *(f"      {line}" for line in before),
        f"      {kernel}({', '.join(arguments)}, values);",
        f"      for (int l = 0; l < LANES && i + l < {count}; ++l)",
        f"        for (int j = 0; j < {m}; ++j) {{",
        f"          const int place = places[(i + l) * {m} + j];",
        f"          {test}out[place] += LANE(values[j], l);",
        "        }",
        "    }",
        "  }",
    ]


def _table(kind: str, name: str, values: np.ndarray) -> str:
    """Return a C array of values, a column for each instance, in lines of 24 numbers."""
    flat = values.T.reshape(-1).tolist()
    texts = [repr(float(v)) if kind == "casadi_real" else str(int(v)) for v in flat]
    lines = [", ".join(texts[i : i + 24]) for i in range(0, len(texts), 24)]
    return f"static const {kind} {name}[] = {{\n" + ",\n".join(lines) + "};"
