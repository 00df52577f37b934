"""Export of a model's functions as plain C99: header, source, example, manifest and card."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import casadi as ca

from .. import version
from ..base.names import derivative
from ..model.model import Model
from ..model.values import as_model
from . import c_names as names
from .card import card_text
from .example import example_text
from .folder import MANIFEST, Artefact, sha256, write_folder
from .generated import generated
from .header import Exported, banner, defaults_signature, header_text, signature
from .loops import assembles, stub, with_loops

_ALWAYS = ("ode", "alg", "out", "zero", "jump")
_JACOBIANS = tuple(f"d{f}_d{v}" for f in ("ode", "alg") for v in "xzup")


def export_c(
    model: Model, folder: str | os.PathLike[str], functions: Sequence[str] | None = None
) -> Artefact:
    """Write the functions of a model as C99 without dependencies.

    The folder receives <name>.h, <name>.c, example.c, manifest.json and README.md (the model
    card), either all of them or none. Every function has the signature
    `int <name>_ode(t, x, z, u, p, result)`, returns 0 on success, allocates nothing and is
    re-entrant; the header documents sizes, indices and units.

    >>> artefact = rs.export_c(model, "generated/swing")
    >>> rates = rs.load_c(artefact).function("ode")

    Arguments:
        model: what `compile_scene` returns.
        folder: created if needed; files of an earlier export there are replaced.
        functions: names as in `model.function`, including those of second derivatives. The default
            is ode, alg, out, zero, jump and the Jacobians of ode and alg, without those that have
            no nonzeros.

    Returns:
        The `Artefact`, which `load_c` takes.

    Raises:
        ValueError: unknown function, names that collide in C, a folder that cannot be written or
            that holds foreign files.
    """
    # The functions of a `compiled` model call a library, so they cannot be written as C.
    model = as_model(model, "export_c").plain
    chosen = _default(model) if functions is None else functions
    named = (model.dae.aliases.get(name, name) for name in chosen)
    exported = [_exported(model, name) for name in dict.fromkeys(named)]
    target = Path(folder)
    texts = {
        f"{model.name}.h": header_text(model, exported),
        f"{model.name}.c": source_text(model, exported),
        "example.c": example_text(model, exported),
        "README.md": card_text(model, exported),
    }
    sizes = {f.name: {"rows": f.rows, "columns": f.columns, "numbers": f.numbers} for f in exported}
    kinds = ("x", "z", "u", "p", "out")
    more = {"functions": sizes} | ({"events": list(model.events)} if model.events else {})
    texts[MANIFEST] = manifest_text(model, texts, kinds, more)
    write_folder(target, texts)
    return Artefact(target, model.name, model.digest, tuple(f.name for f in exported))


def _default(model: Model) -> list[str]:
    there = [
        name for name in (*_ALWAYS, *_JACOBIANS) if name == "ode" or model.function(name).nnz_out(0)
    ]
    return [*there, *(["post_newton"] if model.dae.updates else [])]


def _exported(model: Model, name: str) -> Exported:
    function = model.function(name)
    found = derivative(name)
    # In C a result is either a plain array of all rows, or the nonzeros of a matrix whose pattern
    # is exported beside it. Explicit time derivatives of ode and alg are single dense columns, so
    # they are plain arrays although they are derivatives.
    by_time = found is not None and found.by == "t" and found.of != "out"
    jacobian = found is not None and bool(found.by) and not by_time
    sparse = function.size2_out(0) > 1 or name == "jump" or jacobian
    symbol, letters = names.kernel(model.name, name), function.name_in()
    if assembles(model, name):
        return Exported(name, stub(model, name, symbol), sparse)
    symbols = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    result = function(*symbols)
    expression = result if sparse else ca.densify(result)
    kernel = ca.Function(symbol, symbols, [expression], letters, [names.c_name(name)])
    return Exported(name, kernel, sparse)


def source_text(model: Model, functions: list[Exported]) -> str:
    """Return the text of <name>.c: CasADi's code, and around each function one of plain C."""
    generator = ca.CodeGenerator(f"{model.name}_casadi", {"with_header": False})
    for f in functions:
        generator.add(f.kernel)
    # For models of many equal parts CasADi writes a stub only, whose body `with_loops` replaces.
    loops = {f.kernel.name(): f.name for f in functions if assembles(model, f.name)}
    parts = [
        banner(model, f"{model.name}.c: kernels by CasADi, each behind one plain C function"),
        f'#include "{model.name}.h"\n',
        "#if defined(__GNUC__)\n"
        '#pragma GCC diagnostic ignored "-Wunused-parameter" /* of CasADi\'s common signature */\n'
        "#endif\n",
        with_loops(generated(generator, model), model, loops),
        defaults_signature(model.name),
        defaults_body(model),
        *(_wrapper(model, f) for f in functions),
    ]
    return "\n".join(parts)


def defaults_body(model: Model) -> str:
    """Return the body of the C function that fills in start and default values."""
    # repr() is the shortest text that reads back as the same double, so the values in C are exact
    # and the file is the same on every run.
    dae = model.dae
    lines = ["{"]
    for kind in "xzup":
        labels = getattr(dae, f"{kind}_labels")
        if not labels:
            lines.append(f"  (void)({kind});")
            continue
        values = ", ".join(repr(float(label.start)) for label in labels)
        lines += [
            f"  static const double {kind}_start[{len(labels)}] = {{{values}}};",
            f"  if ({kind}) {{",
            f"    for (int i = 0; i < {len(labels)}; ++i) {kind}[i] = {kind}_start[i];",
            "  }",
        ]
    return "\n".join([*lines, "}", ""])


def call_lines(kernel: ca.Function, result: str, given: str) -> list[str]:
    """Return the body of a C function that calls the one which CasADi generated.

    Arguments:
        kernel: CasADi's function of t, x, z, u, p and possibly a sixth argument.
        result: name of the C array for the result.
        given: name of the sixth argument, "" if there is none.
    """
    # CasADi reports the sizes of its work arrays, so they are local arrays: nothing is allocated,
    # and calls from several threads share nothing. C99 has no arrays of size 0, hence the 1.
    return [
        "{",
        f"  const double *arg[{max(kernel.n_in(), kernel.sz_arg())}] = {{0}};",
        f"  double *res[{max(1, kernel.sz_res())}] = {{0}};",
        f"  casadi_int iw[{max(1, kernel.sz_iw())}];",
        f"  double w[{max(1, kernel.sz_w())}];",
        "  arg[0] = &t;",
        "  arg[1] = x;",
        "  arg[2] = z;",
        "  arg[3] = u;",
        "  arg[4] = p;",
        *([f"  arg[5] = {given};"] if given else []),
        f"  res[0] = {result};",
        f"  return {kernel.name()}(arg, res, iw, w, 0);",
        "}",
        "",
    ]


def _wrapper(model: Model, f: Exported) -> str:
    lines = [signature(model.name, f), *call_lines(f.kernel, names.c_name(f.name), f.given)]
    if f.sparse:
        pattern = f.kernel.sparsity_out(0)
        for what, values in (("colind", pattern.colind()), ("row", pattern.row())):
            numbers = ", ".join(str(value) for value in values) or "0"
            lines += [
                f"const int *{names.function(model.name, f.name)}_{what}(void)",
                "{",
                f"  static const int {what}[] = {{{numbers}}};",
                f"  return {what};",
                "}",
                "",
            ]
    return "\n".join(lines)


def manifest_text(
    model: Model, texts: Mapping[str, str], kinds: Sequence[str], more: Mapping[str, Any]
) -> str:
    """Return the text of manifest.json: origin, labels and hashes of the other files.

    Arguments:
        texts: file name to text, of every other file of the folder.
        kinds: groups of labels to list, such as "x" or "p"; each label is [name, unit, start].
        more: further entries of the manifest.
    """
    # No date and no path is recorded, so the same model gives the same bytes. The manifest cannot
    # hold its own hash; it is checked by being complete.
    content = {
        "rbsd_sym": version.VERSION,
        "abi": version.ABI,
        "casadi": ca.CasadiMeta.version(),
        "name": model.name,
        "digest": model.digest,
        **more,
        "labels": {
            kind: [[v.name, v.unit, v.start] for v in getattr(model.dae, f"{kind}_labels")]
            for kind in kinds
        },
        "files": {name: sha256(text) for name, text in sorted(texts.items())},
    }
    return json.dumps(content, indent=1) + "\n"
