"""A model with the same functions as machine code, for simulations in Python."""

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
    """Return the model with ode, alg and their Jacobians as machine code.

    Every integrator takes the result as it takes the original, and the numbers are the same. It
    pays if many evaluations follow: building takes 0.5 s for one body and connector, and seconds
    for flat models of thousands of instructions. The library stays in the cache, so the same model
    is built once. Outputs and second derivatives are not compiled.

    >>> trajectory = rs.simulate(rs.compiled(model), 10.0)

    Arguments:
        model: what `compile_scene` returns.
        compiler: command of a C compiler; $CC, cc, gcc or clang by default.
        flags: compiler flags beside those for a shared library of C99.

    Raises:
        CompilerMissing: no C compiler was found.
        RuntimeError: the compiler failed; the message holds its output.
    """
    model = as_model(model, "compiled").plain
    rates = [name for name, rows in (("ode", model.n_x), ("alg", model.n_z)) if rows]
    if not rates:
        return model  # nothing in the scene can move
    # Blocks of the Jacobian without nonzeros are not compiled; `_block` puts zeros in their place.
    blocks = {f"d{name}_d{v}": model.function(f"d{name}_d{v}") for name in rates for v in "txzup"}
    full = {key: block for key, block in blocks.items() if block.nnz_out(0)}
    functions = full | {name: model.function(name) for name in rates}
    library = str(build(model.name, _source(model, functions), compiler, flags))
    found = {key: ca.external(names.kernel(model.name, key), library) for key in functions}
    symbols = [ca.MX.sym(v, found[rates[0]].sparsity_in(i)) for i, v in enumerate("txzup")]
    # CasADi cannot differentiate an external function, so the exact Jacobian, compiled as well, is
    # attached to it: implicit integrators and sensitivities need one.
    for name in rates:
        jacobian = [_block(found, f"d{name}_d{v}", blocks, symbols) for v in "txzup"]
        value = found[name](*symbols)
        found[name] = with_jacobian(name, symbols, value, jacobian)
    return replace(model, library=found)


def _source(model: Model, functions: dict[str, ca.Function]) -> str:
    """Return C source of the functions, including the Jacobian's sparsity pattern of ode and alg.

    The caller of an external function sees nothing but the library, so the pattern must be in it.
    """
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
