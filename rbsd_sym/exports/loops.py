"""Assembled functions as C loops: gather what an instance reads, call its kernel, add the results.

CasADi's own code for mapped kernels copies all arguments and all results; these loops keep an
instance in cache. CasADi writes the kernels, and a stub for each function: its signature, its
sparsity and the rest of what its loader asks for. What the stub calls is replaced by our loops.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from ..assembly import Assembled, Piece
from ..model import Model

_ARGUMENTS = "const casadi_real** arg, casadi_real** res, casadi_int* iw, casadi_real* w, int mem"

_DIFFERENT = f"CasADi {ca.CasadiMeta.version()} writes functions differently; use 3.8.2"
_QUIET = """#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-const-variable" /* of what was replaced */
#pragma GCC diagnostic ignored "-Wunused-function"
#endif
"""


def assembles(model: Model, name: str) -> bool:
    """Whether the function of that name is written as loops."""
    own = ("zero", "zero_rate", "jump", "post_newton")
    return model.kernels and name not in (*model.dae.outputs, *own) and "zero_d" not in name


def stub(model: Model, name: str, symbol: str, with_pattern: bool = False) -> ca.Function:
    """A function with the signature and the sparsity of the real one; on request its Jacobian's."""
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


def add_kernels(generator: ca.CodeGenerator, model: Model, stubs: Mapping[str, str]) -> None:
    """Add the kernels of functions (symbol: name) to CasADi's code."""
    for symbol, name in stubs.items():
        for i, piece in enumerate(model.assembly.assembled(name).pieces):
            symbols = piece.function.sx_in()
            generator.add(ca.Function(f"{symbol}_k{i}", symbols, [piece.function(*symbols)]))


def with_loops(text: str, model: Model, stubs: Mapping[str, str]) -> str:
    """CasADi's code with the bodies of the stubs replaced, and the loops after it."""
    loops = []
    for symbol, name in stubs.items():
        parts = model.assembly.assembled(name)
        kernels = []
        for i in range(len(parts.pieces)):
            text, kernel = _strip(text, f"{symbol}_k{i}")
            kernels.append(kernel)
        text = _call_loops(text, symbol)
        loops.append(_loops(model, symbol, parts, kernels))
    return "\n".join([_QUIET, text, *loops]) if loops else text


def _sizes(model: Model) -> tuple[int, ...]:
    return (1, model.n_x, model.n_z, model.n_u, model.n_p)


def _strip(text: str, symbol: str) -> tuple[str, str]:
    """Drop what CasADi writes for callers of a kernel; the name of its static function."""
    head = rf"CASADI_SYMBOL_EXPORT int {symbol}\([^)]*\){{\s*return (casadi_f\d+)\("
    match = re.search(head + r".*?(?=/\* |\Z)", text, re.S)
    if match is None:
        raise RuntimeError(_DIFFERENT)
    return text[: match.start()] + text[match.end() :], match[1]


def _call_loops(text: str, symbol: str) -> str:
    """Let the stub call our loops."""
    head = rf"(CASADI_SYMBOL_EXPORT int {symbol}\([^)]*\){{\s*return )casadi_f\d+\("
    declared = rf"static int {symbol}_loops({_ARGUMENTS});\n\n\1{symbol}_loops("
    text, count = re.subn(head, declared, text)
    if count != 1:
        raise RuntimeError(_DIFFERENT)
    return text


def _loops(model: Model, symbol: str, parts: Assembled, kernels: Sequence[str]) -> str:
    n, sizes = parts.pattern.nnz(), _sizes(model)[1:]
    lines = [
        f"static int {symbol}_loops({_ARGUMENTS})", "{",
        "  casadi_real *out = res[0];",
        *_stacked(sizes),
        "  if (!out) return 0;",
        f"  for (int i = 0; i < {n}; ++i) out[i] = 0;",
    ]  # fmt: skip
    for kernel, piece in zip(kernels, parts.pieces, strict=True):
        lines += _loop(kernel, piece)
    return "\n".join([*lines, "  return 0;", "}", ""])


def _stacked(sizes: Sequence[int]) -> list[str]:
    """All = [x; z; u; p], a NULL read as zeros."""
    lines = [f"  casadi_real all[{max(1, sum(sizes))}];"]
    first = 0
    for i, size in enumerate(sizes, start=1):
        if size:
            each = f"for (int i = 0; i < {size}; ++i) all[{first} + i] ="
            lines += [f"  if (arg[{i}]) {each} arg[{i}][i];", f"  else {each} 0;"]
        first += size
    return [*lines, "  (void)all, (void)iw, (void)w, (void)mem;"]


def _loop(kernel: str, piece: Piece) -> list[str]:
    count = piece.reads.shape[1]
    tables, before, after = [], [], []
    m = piece.places.shape[0]
    arguments = ["arg[0]", "in", "0"]
    tables.append(_table("int", "reads", piece.reads))
    if piece.reads.size:
        n = piece.reads.shape[0]
        before.append(f"for (int j = 0; j < {n}; ++j) in[j] = all[reads[i * {n} + j]];")
    if piece.constants.size:
        tables.append(_table("casadi_real", "constants", piece.constants))
        arguments[2] = f"constants + i * {piece.constants.shape[0]}"
    if piece.given is not None:
        k = piece.given.shape[0]
        tables.append(_table("int", "given", piece.given))
        arguments.append("with")
        value = f"given[i * {k} + j] < 0 ? 0 : arg[5][given[i * {k} + j]]"
        before.append(f"for (int j = 0; j < {k}; ++j) with[j] = arg[5] ? ({value}) : 0;")
    tables.append(_table("int", "places", piece.places))
    place = f"places[i * {m} + j]"
    test = f"if ({place} >= 0) " if (piece.places < 0).any() else ""
    after.append(f"for (int j = 0; j < {m}; ++j) {test}out[{place}] += values[j];")
    sizes = [f"in[{max(1, piece.reads.shape[0])}]", f"values[{m}]"]
    sizes += [f"with[{piece.given.shape[0]}]"] if piece.given is not None else []
    sizes += [f"work[{max(1, piece.function.sz_w())}]"]
    return [
        "  {", *(f"    {table}" for table in tables if table),
        f"    for (int i = 0; i < {count}; ++i) {{",
        f"      casadi_real {', '.join(sizes)};",
        f"      const casadi_real *from[{max(4, piece.function.sz_arg())}] = "
        f"{{{', '.join(arguments)}}};",
        f"      casadi_real *to[{max(1, piece.function.sz_res())}] = {{values}};",
        *(f"      {line}" for line in before),
        f"      if ({kernel}(from, to, 0, work, 0)) return 1;",
        *(f"      {line}" for line in after),
        "    }", "  }",
    ]  # fmt: skip


def _table(kind: str, name: str, values: np.ndarray) -> str:
    """Instance by instance; no line of it grows beyond what an editor shows."""
    if not values.size:
        return ""
    flat = values.T.reshape(-1).tolist()
    texts = [repr(float(v)) if kind == "casadi_real" else str(int(v)) for v in flat]
    lines = [", ".join(texts[i : i + 24]) for i in range(0, len(texts), 24)]
    return f"static const {kind} {name}[] = {{\n" + ",\n".join(lines) + "};"
