"""Header, card and example of an exported problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from .. import version
from ..dae.members import Label
from ..exports import c_names as names
from ..exports.folder import template
from ..exports.header import banner, enum_lines, index_lines
from ..model.model import Model
from .parametric import Parametric

_CODES = (
    ("OPTIMAL", 0, "or the function was evaluated"),
    ("ITERATION_LIMIT", 1, "a step nearer, and to be used as such with max_iterations 1"),
    ("INFEASIBLE", 2, "the linearised conditions contradict each other; soften those of states"),
    ("STALLED", 3, "no step lowers cost and violation; see stats for how near it is"),
    ("NOT_FINITE", 4, "a function or derivative is not finite"),
    ("BAD_ARGUMENT", 5, "NULL where there is none, numbers that are not finite, tol not above 0"),
    ("FAILED", 6, "a function could not be evaluated"),
)


@dataclass(frozen=True, eq=False)
class Sizes:
    """What the texts of an export need.

    Fields:
        numbers: sizes by the names of their constants in C.
        stack: bytes.
        shifts: whether a plan can be moved by an interval: one phase of a given length, equal
            intervals.
    """

    numbers: Mapping[str, int]
    jacobian: ca.Sparsity
    hessian: ca.Sparsity
    stack: int
    shifts: bool
    solver: bool


def problem_name(model: Model) -> str:
    """Name of the files, and prefix of the functions."""
    return f"{model.name}_ocp"


def header_text(made: Parametric, sizes: Sizes) -> str:
    """The text of <name>_ocp.h.

    Raises:
        ValueError: names that collide in C.
    """
    model, name = made.frame.model, problem_name(made.frame.model)
    upper = names.constant(name)
    marks: dict[str, Any] = {
        **sizes.numbers,
        "name": name,
        "NAME": upper,
        "DIGEST": model.digest,
        "SIZES": "\n".join(enum_lines((f"{upper}_{k}", n, "") for k, n in sizes.numbers.items())),
        "INDICES": "\n".join(_indices(made, name)),
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
    chosen = _CODES if solver else (_CODES[0], _CODES[-1])
    return [(f"{upper}_{key}", value, f" /* {words} */") for key, value, words in chosen]


def _groups(made: Parametric) -> list[tuple[str, str, tuple[Label, ...]]]:
    frame = made.frame
    states = tuple(
        Label("", v.name, "", v.unit, float(value))
        for v, value in zip(frame.model.x_labels, made.state, strict=True)
    )
    inputs = tuple(frame.model.dae.u_labels[k] for k in frame.controls)
    constants = tuple(
        Label("", v.name.replace(" ", "_"), "", v.unit, v.start) for v in frame.s_labels
    )
    return [
        ("x", "Measured states: unit, default value.", states),
        ("u", "Inputs that are found: unit, default value.", inputs),
        ("p", "Arguments p: unit, default value.", made.p_labels),
        ("s", "Constants that are found: unit, value at the start of the search.", constants),
    ]


def _indices(made: Parametric, name: str) -> list[str]:
    lines: list[str] = []
    for kind, title, labels in _groups(made):
        found = index_lines(name, kind, title, labels)
        lines += found
    return lines


def _layout(made: Parametric, upper: str) -> list[tuple[str, int, str]]:
    frame, nlp = made.frame, made.chain.nlp
    body, end = made.chain.segments("interval"), made.chain.segments("end")
    rows = [(f"{upper}_CONSTANT", frame.model.n_x, ""), (f"{upper}_U", frame.n_y, "")]
    for i in range(frame.n_phases):
        part = nlp.segments[body[i]]
        rows += [
            (f"{upper}_PHASE_{i}", nlp.offsets[body[i]][0], ""),
            (f"{upper}_STRIDE_{i}", part.n_w, ""),
            (f"{upper}_INTERVALS_{i}", part.count, ""),
            (f"{upper}_END_{i}", nlp.offsets[end[i]][0], ""),
        ]
    return rows


def example_text(made: Parametric, sizes: Sizes) -> str:
    """A program that evaluates the problem where the search starts, and solves it if it can."""
    name = problem_name(made.frame.model)
    upper = names.constant(name)
    lines = [
        banner(made.frame.model, "example.c: the problem where the search starts"),
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


def card_text(made: Parametric, sizes: Sizes, method: str) -> str:
    """The text of README.md."""
    model, name = made.frame.model, problem_name(made.frame.model)
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
    for _, title, labels in _groups(made):
        if labels:
            head, _, rest = title.partition(":")
            lines += [
                f"## {head}",
                "",
                f"| index | name | {rest.strip(' .').replace(',', ' |')} |",
                "|---|---|---|---|",
            ]
            lines += [
                f"| {i} | `{v.name}` | {v.unit or '1'} | {v.start!r} |"
                for i, v in enumerate(labels)
            ]
            lines.append("")
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
