"""example.c of a model: a short program that evaluates the rates and a Jacobian and prints them."""

from __future__ import annotations

from ..model.model import Model
from . import c_names as names
from .header import Exported, banner


def example_text(model: Model, functions: list[Exported]) -> str:
    """Return the text of example.c; it prints ode and the nonzeros of dode_dx at the start."""
    name, there = model.name, {f.name: f for f in functions}
    size = {kind: max(1, getattr(model, f"n_{kind}")) for kind in "xzup"}
    lines = [
        banner(model, "example.c: the rates and their Jacobian at the start"),
        f"/* Build and run: cc -std=c99 example.c {name}.c -lm -o example && ./example */",
        "#include <stdio.h>",
        f'#include "{name}.h"',
        "",
        "int main(void)",
        "{",
        *(f"  double {kind}[{n}] = {{0}};" for kind, n in size.items()),
        f"  {name}_defaults(x, z, u, p);",
    ]
    for key in ("ode", "dode_dx"):
        if key in there:
            lines += _print(name, there[key])
    return "\n".join([*lines, "  return 0;", "}", ""])


def _print(model: str, f: Exported) -> list[str]:
    symbol = names.function(model, f.name)
    lines = [
        f"  double {f.name}[{max(1, f.numbers)}] = {{0}};",
        f"  if ({symbol}(0.0, x, z, u, p, {f.name})) return 1;",
    ]
    if not f.sparse:
        return [
            *lines,
            f"  for (int i = 0; i < {f.numbers}; ++i) "
            f'printf("{f.name}[%d] = %.17g\\n", i, {f.name}[i]);',
        ]
    return [
        *lines,
        f"  for (int j = 0; j < {f.columns}; ++j) {{",
        f"    for (int k = {symbol}_colind()[j]; k < {symbol}_colind()[j + 1]; ++k) {{",
        f'      printf("{f.name}[%d,%d] = %.17g\\n", {symbol}_row()[k], j, {f.name}[k]);',
        "    }",
        "  }",
    ]
