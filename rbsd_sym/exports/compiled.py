"""A model whose functions are those of a compiled library: the same numbers, machine code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca

from ..model.assembly import with_jacobian
from ..model.model import Model
from ..model.values import as_model
from . import c_names as names
from .generated import generated
from .load import OPTIMISED, build
from .loops import assembles, stub, with_loops


def compiled(model: Model, compiler: str | None = None, flags: Sequence[str] = OPTIMISED) -> Model:
    """The model with ode, alg and their Jacobians as machine code; integrators take it like any.

    It pays where many evaluations follow: building takes 0.5 s for one body and connector, seconds
    for flat models of thousands of instructions, and the library stays in the cache. Outputs and
    second derivatives stay as they were.

    Raises:
        CompilerMissing: there is no compiler.
        RuntimeError: the compiler failed; with its message.
    """
    model = as_model(model, "compiled").plain
    rates = [name for name, rows in (("ode", model.n_x), ("alg", model.n_z)) if rows]
    if not rates:
        return model  # nothing in the scene can move
    blocks = {f"d{name}_d{v}": model.function(f"d{name}_d{v}") for name in rates for v in "txzup"}
    full = {key: block for key, block in blocks.items() if block.nnz_out(0)}
    functions = full | {name: model.function(name) for name in rates}
    library = str(build(model.name, _source(model, functions), compiler, flags))
    found = {key: ca.external(names.kernel(model.name, key), library) for key in functions}
    symbols = [ca.MX.sym(v, found[rates[0]].sparsity_in(i)) for i, v in enumerate("txzup")]
    for name in rates:
        jacobian = [_block(found, f"d{name}_d{v}", blocks, symbols) for v in "txzup"]
        value = found[name](*symbols)
        found[name] = with_jacobian(name, symbols, value, jacobian)
    return replace(model, library=found)


def _source(model: Model, functions: dict[str, ca.Function]) -> str:
    """C of the functions; rates with the pattern of their Jacobian, for who sees only them."""
    generator = ca.CodeGenerator(f"{model.name}_compiled")
    loops = {}
    for name, function in functions.items():
        symbol = names.kernel(model.name, name)
        if assembles(model, name):
            loops[symbol] = name
            named = stub(model, name, symbol, name in ("ode", "alg"))
        else:
            symbols = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
            named = ca.Function(symbol, symbols, [function(*symbols)], list("txzup"), [name])
        generator.add(named, name in ("ode", "alg"))
    return with_loops(generated(generator, model), model, loops)


def _block(
    found: dict[str, ca.Function], key: str, blocks: dict[str, ca.Function], symbols: list[ca.MX]
) -> ca.MX:
    return found[key](*symbols) if key in found else ca.MX(*blocks[key].size_out(0))
