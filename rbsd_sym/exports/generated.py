"""The C text of CasADi's code generator, checked for functions that have no C code."""

from __future__ import annotations

import re

import casadi as ca

from ..model.model import Model

# CasADi writes these without complaint: a Function as an #error line or as one of another library,
# and erfinv as a function of math.h, which it is not.
_WITHOUT_C = re.compile(
    r"/\* (\w+):[^\n]*\*/\nstatic int [^\n]*\n\s*#error"
    r"|^int (\w+)\(const casadi_real\*\* arg,[^\n]*;$"
    r"|\b(erfinv)\(",
    re.MULTILINE,
)


def generated(generator: ca.CodeGenerator, model: Model) -> str:
    """Return the text of a generator, if all of it is C that needs no other library.

    Raises:
        ValueError: something in it has no C code: a Callback, a rootfinder, `erfinv`.
    """
    text = str(generator.dump())
    names = sorted({"".join(found) for found in _WITHOUT_C.findall(text)})
    if not names:
        return text
    dae = model.dae
    callers = {
        part.name: None
        for part in (*dae.parts, *dae.events, *dae.holds, *dae.updates)
        for f in (part.kernel, *part.kernel.find_functions())
        if any(f"{name}(" in f.str(True) for name in names)
    }
    by = f", {', '.join(callers)}" if callers else ""
    raise ValueError(
        f"model '{model.name}'{by}: there is no C code of {', '.join(names)}; use a formula or "
        "casadi.interpolant instead, or simulate the model in Python"
    )
