"""Stage functions as machine code."""

from __future__ import annotations

import casadi as ca

from ..exports.load import OPTIMISED, build
from .nlp import StageFunctions

_PARTS = ("value", "jacobian", "gradient", "hessian")


def compiled_stage(name: str, stage: StageFunctions, compiler: str | None = None) -> StageFunctions:
    """The same stage in C, built once and kept in the cache of compiled libraries.

    Raises:
        CompilerMissing: there is no compiler.
        RuntimeError: the compiler failed; with its message.
    """
    symbols = {part: f"{name}_{part}" for part in _PARTS}
    generator = ca.CodeGenerator(f"{name}_stage")
    for part, symbol in symbols.items():
        function: ca.Function = getattr(stage, part)
        own = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
        generator.add(ca.Function(symbol, own, function.call(own)))
    library = str(build(f"{name}-stage", str(generator.dump()), compiler, OPTIMISED))
    return StageFunctions(*(ca.external(symbols[part], library) for part in _PARTS))
