"""A problem's functions, and on request a solver, as one dependency-free C file.

The C code of one block of each segment is CasADi's; tables say where it goes in the program, so
that the code does not grow with the number of intervals.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from .. import version
from ..base.program import check_second_derivatives
from ..dae.members import Label
from ..exports import c_names as names
from ..exports.folder import MANIFEST, Artefact, sha256, template, write_folder
from ..exports.generated import generated
from ..exports.header import banner, enum_lines, index_lines
from .mesh import Method, control_nodes
from .nlp import Segment, Where
from .parametric import Parametric, parametric
from .problem import Problem
from .traced import Role

PROBLEM = "optimal control problem"
_PARTS = ("value", "jacobian", "gradient", "hessian")
_SOLVER = {"LEAST_SHIFT": "1e-4", "MOST_SHIFTS": 8, "MOST_HALVINGS": 25, "MEMORY": 4}
_FUNCTIONS = (
    "objective",
    "gradient",
    "constraints",
    "jacobian",
    "hessian",
    "bounds",
    "defaults",
    "inputs",
)


class Code(IntEnum):
    """Return code of an exported solver, in C and as `code` of the result in Python.

    Only `optimal` says that the plan is a solution. After `iteration_limit`, which is what a real
    time loop with one iteration a call sees, the plan is one iteration closer to the solution;
    after `infeasible` and `stalled` look
    at violation and optimality. The header explains each code.
    """

    optimal = 0
    iteration_limit = 1
    infeasible = 2
    stalled = 3
    not_finite = 4
    bad_argument = 5
    failed = 6


_MEANING = {
    Code.optimal: "or the function was evaluated",
    Code.iteration_limit: "a step nearer, and to be used as such with max_iterations 1",
    Code.infeasible: "the linearised conditions contradict each other; soften those of states",
    Code.stalled: "no step lowers cost and violation; see stats for how near it is",
    Code.not_finite: "a function or derivative is not finite",
    Code.bad_argument: "NULL where there is none, numbers that are not finite, tol not above 0",
    Code.failed: "a function could not be evaluated",
}


@dataclass(frozen=True, eq=False)
class Sizes:
    """Sizes of an exported problem, and what is exported.

    Fields:
        numbers: sizes by the names of their constants in C.
        jacobian, hessian: patterns of the whole program.
        stack: bytes.
        shifts: whether a plan can be moved by an interval: one phase of a given length, equal
            intervals.
        solver: whether a solver is exported.
    """

    numbers: Mapping[str, int]
    jacobian: ca.Sparsity
    hessian: ca.Sparsity
    stack: int
    shifts: bool
    solver: bool


def export_problem(
    problem: Problem,
    method: Method,
    folder: str | os.PathLike[str],
    solver: bool = False,
    guess: Any = None,
) -> Artefact:
    """Write a problem to C: <name>_ocp.h and .c, example.c, manifest.json and README.md.

    For a receding horizon, for example:

        artefact = export_problem(problem, Collocation(20, 3), "generated/plan", solver=True)
        library = load_problem(artefact)
        step = library.solve(measured, library.defaults()[2])   # step.u: Inputs to apply

    The measured state, which replaces what `start` of the first phase says, and the Params and
    horizons that are given are arguments in C. Time in costs and conditions begins at 0 with each
    plan; what depends on the what depends on absolute time belongs in a Param.

    Arguments:
        problem: what to find; not a periodic one.
        method: `Collocation` or `Shooting` with explicit steps. Shooting has fewest variables,
            collocation the shortest code.
        folder: made if needed; one that holds another kind of export is refused.
        solver: also a solver by sequential quadratic programming, which takes exact second
            derivatives and CasADi's active-set method qrqp. For up to some hundred variables, and
            conditions that can be met as linearised at the guess: soften those of states. It stops
            where cost and conditions are stationary, which from a start as good to either side may
            be a saddle.
        guess: as in `optimise`; where the search starts by default.

    Returns:
        The folder, with names of the functions in it.

    Raises:
        ValueError, TypeError: what is wrong with the problem; a periodic one; a method that cannot
            be written to C; names that collide in C; a folder that cannot be written.
    """
    made = parametric(problem, method, guess)
    model, name, target = made.traced.model, made.name, Path(folder)
    for block in made.blocks:
        check_second_derivatives(block.value, f"model '{model.name}', hessian")
    sizes = _sizes(made, solver)
    texts = {
        f"{name}.h": _header(made, sizes),
        f"{name}.c": _source(made, method, sizes),
        "example.c": _example(made, sizes),
        "README.md": _card(made, sizes, repr(method)),
    }
    functions = [*_FUNCTIONS, *(["shift"] if sizes.shifts else []), *(["solve"] if solver else [])]
    texts[MANIFEST] = _manifest(made, sizes, functions, texts)
    write_folder(target, texts)
    return Artefact(target, model.name, model.digest, tuple(functions))


def _manifest(made: Parametric, sizes: Sizes, functions: list[str], texts: dict[str, str]) -> str:
    model = made.traced.model
    labels = {group.letter: group.labels for group in _groups(made)}
    labels["s"] = tuple(c.label for c in made.traced.constants)
    content = {
        "rbsd_sym": version.VERSION,
        "abi": version.ABI,
        "casadi": ca.CasadiMeta.version(),
        "name": model.name,
        "digest": model.digest,
        "kind": PROBLEM,
        "functions": functions,
        "sizes": sizes.numbers,
        "labels": {
            letter: [[v.name, v.unit, v.start] for v in own] for letter, own in labels.items()
        },
        "files": {name: sha256(text) for name, text in sorted(texts.items())},
    }
    return json.dumps(content, indent=1) + "\n"


def _patterns(made: Parametric) -> tuple[ca.Sparsity, ca.Sparsity]:
    """Patterns of the constraints' Jacobian and the Hessian, columns as the C code writes them."""
    nlp, handed = made.chain.nlp, 0
    jac: tuple[list[int], list[int]] = [], []
    hess: tuple[list[int], list[int]] = [], []
    above = 0  # rows of the block before begin here
    for (first, top), part, block in zip(nlp.offsets, nlp.segments, made.blocks, strict=False):
        j_rows, j_columns = block.jacobian.sparsity_out(0).get_triplet()
        h_rows, h_columns = block.hessian.sparsity_out(0).get_triplet()
        for k in range(part.count):
            at, down = first + k * part.n_w, top + k * part.n_g
            # A block's first columns also hold the ones of the rows of the block before.
            jac[0].extend([*range(above, above + handed), *(down + i for i in j_rows)])
            jac[1].extend([*range(at, at + handed), *(at + j for j in j_columns)])
            hess[0].extend(at + i for i in h_rows)
            hess[1].extend(at + j for j in h_columns)
            handed, above = part.n_next, down
    return ca.Sparsity.triplet(nlp.m, nlp.n, *jac), ca.Sparsity.triplet(nlp.n, nlp.n, *hess)


def _sizes(made: Parametric, solver: bool) -> Sizes:
    traced, nlp = made.traced, made.chain.nlp
    jac, hess = _patterns(made)
    calls = [getattr(block, part) for block in made.blocks for part in _PARTS]
    numbers = {
        "N_X": traced.model.n_x,
        "N_U": traced.n_v,
        "N_P": len(made.p_labels),
        "N_W": nlp.n,
        "N_G": nlp.m,
        "NNZ_JAC": jac.nnz(),
        "NNZ_HESS": hess.nnz(),
    }
    # Work memory of the functions is on the stack, at most one function's at a time, and one block
    # of the Jacobian.
    stack = 8 * max(f.sz_w() + f.sz_iw() + f.sz_arg() + f.sz_res() for f in calls)
    stack += 8 * max(block.jacobian.nnz_out(0) for block in made.blocks)
    if solver:
        qp = _quadratic_program(made.name, jac, hess)
        own = 8 * (nlp.n + nlp.m) + 2 * nlp.n + jac.nnz() + hess.nnz()
        numbers |= {"N_WORK": own + qp.sz_w(), "N_IWORK": max(1, qp.sz_iw())}
    # A plan that is moved on by an interval has its values at the same places of the mesh only if
    # all intervals are equally long, and stay so.
    mesh = made.chain.mesh[0]
    equal = bool(np.ptp(np.diff(mesh)) < 1e-12)
    fixed = not any(constant.role is Role.horizon for constant in traced.constants)
    shifts = traced.n_phases == 1 and equal and fixed
    return Sizes(numbers, jac, hess, stack, shifts, solver)


def _quadratic_program(name: str, jac: ca.Sparsity, hess: ca.Sparsity) -> ca.Function:
    """Make CasADi's qrqp for programs of these patterns, silent."""
    options = {
        "print_header": False,
        "print_info": False,
        "print_iter": False,
        "error_on_fail": False,
    }
    return ca.conic(f"{name}_casadi_qp", "qrqp", {"h": hess, "a": jac}, options)


def _source(made: Parametric, method: Method, sizes: Sizes) -> str:
    name = made.name
    generator = ca.CodeGenerator(f"{name}_runtime", {"casadi_int": "int", "with_header": False})
    calls = []
    for k, block in enumerate(made.blocks):
        for part in _PARTS:
            function: ca.Function = getattr(block, part)
            flat = function.is_a("SXFunction")
            symbols = function.sx_in() if flat else function.mx_in()
            symbol = _kernel(name, k, part)
            result = [ca.cse(r) for r in function.call(symbols)] if flat else function.call(symbols)
            calls.append(ca.Function(symbol, symbols, result))
            _add(generator, calls[-1], method)
    marks: dict[str, Any] = _marks(made, sizes, method) | {
        "SZ_ARG": max(5, *(f.sz_arg() for f in calls)),
        "SZ_RES": max(2, *(f.sz_res() for f in calls)),
        "SZ_IW": max(1, *(f.sz_iw() for f in calls)),
        "SZ_W": max(1, *(f.sz_w() for f in calls)),
    }
    if sizes.solver:
        qp = _quadratic_program(name, sizes.jacobian, sizes.hessian)
        generator.add(qp)
        marks |= _SOLVER | {"QP_ARG": max(12, qp.sz_arg()), "QP_RES": max(4, qp.sz_res())}
    code = generated(generator, made.traced.model)
    files = [
        "ocp_problem",
        *(["ocp_shift"] if sizes.shifts else []),
        *(["ocp_solve"] if sizes.solver else []),
    ]
    return "\n".join(
        [
            banner(made.traced.model, f"{name}.c: functions of an optimal control problem"),
            f'#include "{name}.h"\n',
            "#include <math.h>\n#include <stddef.h>\n#include <string.h>\n",
            "#if defined(__GNUC__)\n"
            '#pragma GCC diagnostic ignored "-Wunused-parameter" '
            "/* of CasADi's common signature */\n"
            "#endif\n",
            code,
            *(template(f"{file}.c", marks) for file in files),
        ]
    )


def _add(generator: ca.CodeGenerator, function: ca.Function, method: Method) -> None:
    """Add a function to the code.

    Raises:
        ValueError: CasADi cannot write it to C.
    """
    try:
        generator.add(function)
    except RuntimeError as error:
        raise ValueError(
            f"{type(method).__name__}: CasADi cannot write its integrator to C "
            f"({str(error).strip().splitlines()[-1]}); use Collocation(), or Shooting() with "
            "explicit steps"
        ) from error


def _kernel(name: str, k: int, part: str) -> str:
    return f"{name}_casadi_{part}{k}"


def _marks(made: Parametric, sizes: Sizes, method: Method) -> dict[str, Any]:
    traced, part = made.traced, made.chain.nlp.segments[0]
    # Places of the states in a block: the last block of a moved plan gets those at the end.
    offsets, at = [0], traced.n_y
    widths = {"u": traced.n_v, "x": traced.model.n_x, "z": traced.model.n_z}
    for group, _ in made.chain.intervals[0].variables:
        offsets += [at] if group == "x" else []
        at += widths[group]
    tables = [
        *_segment_tables(made),
        _table("double", "low_default", made.chain.nlp.bounds["lbx"]),
        _table("double", "high_default", made.chain.nlp.bounds["ubx"]),
        _table("double", "guess", made.chain.nlp.bounds["x0"]),
        _table("double", "state_default", made.state),
        _table("double", "p_default", np.array([v.start for v in made.p_labels], float)),
        _table("double", "input_nodes", control_nodes(method.input_degree)),
        *([_table("int", "states_at", np.array(offsets))] if sizes.shifts else []),
        *(
            _table("int", f"{what}_{key}", np.array(getattr(pattern, key)(), int))
            for what, pattern in (("jacobian", sizes.jacobian), ("hessian", sizes.hessian))
            for key in ("colind", "row")
        ),
    ]
    return {
        **sizes.numbers,
        "name": made.name,
        "NAME": names.constant(made.name),
        "TABLES": "\n".join(tables) + "\n",
        "N_SEGMENTS": len(made.blocks),
        "N_Y": traced.n_y,
        "STRIDE": part.n_w,
        "N_ROWS": part.n_g,
        "N_INTERVALS": part.count,
        "N_STATES": len(offsets),
        "N_NODES": method.input_degree + 1,
        "N_BLOCK": max(1, *(block.jacobian.nnz_out(0) for block in made.blocks)),
    }


def _segment_tables(made: Parametric) -> list[str]:
    """The table of segments, and the tables it points to."""
    nlp, name, lines, rows = made.chain.nlp, made.name, [], []
    for k, (part, block) in enumerate(zip(nlp.segments, made.blocks, strict=True)):
        low, high = (_rows(part, side) for side in (part.row_low, part.row_high))
        lines += [
            _table("double", f"c{k}", part.constants.T.reshape(-1)),
            _table("double", f"low{k}", low),
            _table("double", f"high{k}", high),
            _table("int", f"columns{k}", np.array(block.jacobian.sparsity_out(0).colind())),
        ]
        first, top = nlp.offsets[k]
        numbers = (part.count, part.n_w, part.n_g, part.n_next, len(part.constants), first, top)
        kernels = (_kernel(name, k, p) for p in _PARTS)
        rows.append(
            f"  {{{', '.join(str(n) for n in numbers)}, c{k}, low{k}, high{k}, columns{k}, "
            f"{block.hessian.nnz_out(0)},\n   {', '.join(kernels)}}}"
        )
    return [*lines, "static const struct segment segments[] = {\n" + ",\n".join(rows) + "};"]


def _rows(part: Segment, side: np.ndarray) -> np.ndarray:
    return np.concatenate([np.zeros(part.n_next), side])


def _table(kind: str, name: str, values: np.ndarray) -> str:
    texts = [_number(v) if kind == "double" else str(int(v)) for v in values] or ["0"]
    lines = [", ".join(texts[i : i + 16]) for i in range(0, len(texts), 16)]
    return f"static const {kind} {name}[] = {{\n" + ",\n".join(lines) + "};"


def _number(value: float) -> str:
    if np.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


def _header(made: Parametric, sizes: Sizes) -> str:
    """The text of <name>_ocp.h.

    Raises:
        ValueError: names that collide in C.
    """
    model, name, upper = made.traced.model, made.name, names.constant(made.name)
    indices = [
        index_lines(name, group.letter, f"{group.head}: {', '.join(group.columns)}.", group.labels)
        for group in _groups(made)
    ]
    marks: dict[str, Any] = {
        **sizes.numbers,
        "name": name,
        "NAME": upper,
        "DIGEST": model.digest,
        "SIZES": "\n".join(enum_lines((f"{upper}_{k}", n, "") for k, n in sizes.numbers.items())),
        "INDICES": "\n".join(line for lines in indices for line in lines),
        "LAYOUT": "\n".join(enum_lines(_layout(made, upper))),
        "CODES": "\n".join(enum_lines(_codes(upper, sizes.solver))[1:-1]),
        "STACK": max(100, -(-sizes.stack // 100) * 100 + 500),
        "N_LAM": sizes.numbers["N_W"] + sizes.numbers["N_G"],
    }
    marks["SHIFT"] = template("ocp_shift.h", marks) if sizes.shifts else ""
    marks["SOLVE"] = template("ocp_solve.h", marks) if sizes.solver else ""
    title = f"{name}.h: an optimal control problem from a measured state"
    return banner(model, title) + template("ocp_problem.h", marks)


def _codes(upper: str, solver: bool) -> list[tuple[str, int, str]]:
    """Codes of the solver, or those of the functions alone."""
    chosen = Code if solver else (Code.optimal, Code.failed)
    return [
        (f"{upper}_{code.name.upper()}", code.value, f" /* {_MEANING[code]} */") for code in chosen
    ]


class _LabelGroup(NamedTuple):
    """Numbers of one kind in C: the letter in their constants, title and columns of their table."""

    letter: str
    head: str
    columns: tuple[str, str]
    labels: tuple[Label, ...]


def _groups(made: Parametric) -> list[_LabelGroup]:
    traced, default = made.traced, ("unit", "default value")
    states = tuple(
        replace(label, start=float(value))
        for label, value in zip(traced.model.x_labels, made.state, strict=True)
    )
    constants = tuple(
        replace(c.label, quantity=f"horizon_of_phase_{c.index}")
        if c.role is Role.horizon
        else c.label
        for c in traced.constants
    )
    return [
        _LabelGroup("x", "Measured states", default, states),
        _LabelGroup("u", "Inputs that are found", default, traced.v_labels),
        _LabelGroup("p", "Arguments p", default, made.p_labels),
        _LabelGroup(
            "s", "Constants that are found", ("unit", "value at the start of the search"), constants
        ),
    ]


def _layout(made: Parametric, upper: str) -> list[tuple[str, int, str]]:
    traced, nlp = made.traced, made.chain.nlp
    body, end = made.chain.segments(Where.path), made.chain.segments(Where.end)
    rows = [(f"{upper}_CONSTANT", traced.model.n_x, ""), (f"{upper}_U", traced.n_y, "")]
    for i in range(traced.n_phases):
        part = nlp.segments[body[i]]
        rows += [
            (f"{upper}_PHASE_{i}", nlp.offsets[body[i]][0], ""),
            (f"{upper}_STRIDE_{i}", part.n_w, ""),
            (f"{upper}_INTERVALS_{i}", part.count, ""),
            (f"{upper}_END_{i}", nlp.offsets[end[i]][0], ""),
        ]
    return rows


def _example(made: Parametric, sizes: Sizes) -> str:
    """A program that evaluates the problem where the search starts, and solves it if it can."""
    name, upper = made.name, names.constant(made.name)
    lines = [
        banner(made.traced.model, "example.c: the problem where the search starts"),
        f"/* Build and run: cc -std=c99 -O2 example.c {name}.c -lm -o example && ./example */",
        "#include <stdio.h>",
        f'#include "{name}.h"',
        "",
        f"static double w[{upper}_N_W], g[{upper}_N_G + 1], jacobian[{upper}_NNZ_JAC + 1];",
    ]
    if sizes.solver:
        lines += [f"static double work[{upper}_N_WORK];", f"static int iwork[{upper}_N_IWORK];"]
    lines += [
        "",
        "int main(void)",
        "{",
        "  double f = 0, largest = 0;",
        f"  {name}_defaults(NULL, NULL, w);",
        f"  if ({name}_objective(w, NULL, &f) || {name}_constraints(w, NULL, g)) return 1;",
        f"  if ({name}_jacobian(w, NULL, jacobian)) return 1;",
        f"  for (int k = 0; k < {upper}_NNZ_JAC; ++k) {{",
        "    if (jacobian[k] > largest) largest = jacobian[k];",
        "  }",
        '  printf("objective %.17g\\nfirst row %.17g\\nlargest derivative %.17g\\n", f, g[0], '
        "largest);",
    ]
    if sizes.solver:
        lines += [
            f"  double u0[{upper}_N_U + 1] = {{0}};",
            f"  {name}_stats stats;",
            f"  const int code = {name}_solve(NULL, NULL, 1e-8, 50, w, NULL, u0, &stats, work, "
            "iwork);",
            '  printf("code %d after %d iterations\\ncost %.17g\\nfirst input %.17g\\n", code, '
            "stats.iterations, stats.cost, u0[0]);",
            "  return code;",
        ]
    else:
        lines += ["  return 0;"]
    return "\n".join([*lines, "}", ""])


def _card(made: Parametric, sizes: Sizes, method: str) -> str:
    """The text of README.md."""
    model, name = made.traced.model, made.name
    n = sizes.numbers
    more = ", solver=True" if sizes.solver else ""
    lines = [
        f"# {name}",
        "",
        "An optimal control problem about rigid bodies and 6-DOF spring-dampers, from any measured "
        f"state, written by rbsd_sym {version.VERSION} with `{method}`. Digest `{model.digest}`.",
        "",
        f"{n['N_W']} variables, {n['N_G']} rows, {n['NNZ_JAC']} nonzeros of the Jacobian, "
        f"{n['NNZ_HESS']} of the Hessian.",
        "",
        "## Use",
        "",
        "```sh",
        f"cc -std=c99 -O2 example.c {name}.c -lm -o example && ./example",
        "```",
        "",
        f"`{name}.h` is the contract: functions, sizes, indices with units. A C compiler is needed "
        "to build this, and nothing else; without one, `rs.ocp.optimise` solves the same problem "
        "in Python. To write this folder again:",
        "",
        "```python",
        "import rbsd_sym as rs",
        f"rs.ocp.export_problem(problem, rs.ocp.{method}, folder{more})",
        "```",
        "",
    ]
    if sizes.solver:
        lines += [*_loop(name, names.constant(name), sizes.shifts), ""]
    for group in _groups(made):
        if group.labels:
            lines += [
                f"## {group.head}",
                "",
                f"| index | name | {' | '.join(group.columns)} |",
                "|---|---|---|---|",
                *(
                    f"| {i} | `{v.name}` | {v.unit or '1'} | {v.start!r} |"
                    for i, v in enumerate(group.labels)
                ),
                "",
            ]
    return "\n".join(lines)


def _loop(name: str, upper: str, shifts: bool) -> list[str]:
    """The receding horizon in C."""
    return [
        "## Receding horizon",
        "",
        "```c",
        f"{name}_defaults(NULL, p, w); /* and lam begins as zeros */",
        "for (;;) {",
        "  measure(state);",
        f"  code = {name}_solve(state, p, 1e-6, 20, w, lam, u0, &stats, work, iwork);",
        f"  if (code != {upper}_OPTIMAL) judge(code, &stats); /* w is the best known plan */",
        "  apply(u0);",
        *(
            [f"  {name}_shift(w, lam); /* if an interval has passed by the next call */"]
            if shifts
            else []
        ),
        "}",
        "```",
    ]
