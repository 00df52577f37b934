"""A problem's functions, and on request a solver, as one dependency-free C file."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from .. import version
from ..exports import c_names as names
from ..exports.folder import MANIFEST, Artefact, sha256, template, write_folder
from ..exports.generated import generated
from ..exports.header import banner
from .export_texts import Sizes, card_text, example_text, header_text, problem_name
from .interval import Method
from .mesh import control_nodes
from .nlp import Segment
from .parametric import Parametric, parametric
from .problem import Problem

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


def export_problem(
    problem: Problem,
    method: Method,
    folder: str | os.PathLike[str],
    solver: bool = False,
    guess: Any = None,
) -> Artefact:
    """Write <name>_ocp.h and .c, example.c, manifest.json and README.md into a folder.

    The measured state, which replaces what `start` of the first phase says, and the Params and
    horizons that are given are arguments in C. Time in costs and conditions begins at 0 with each
    plan; what depends on the time of day belongs into a Param.

    Arguments:
        method: `Collocation` or `Shooting` with explicit steps. Shooting has fewest variables,
            collocation the shortest code.
        folder: made if needed; one that holds another kind of export is refused.
        solver: also a solver by sequential quadratic programming, which takes exact second
            derivatives and CasADi's active-set method qrqp. For up to some hundred variables, and
            conditions that can be met as linearised at the guess: soften those of states. It stops
            where cost and conditions are stationary, which from a start as good to either side may
            be a saddle.
        guess: as in `optimise`; where the search starts by default.

    Raises:
        ValueError, TypeError: what is wrong with the problem; a periodic one; a method that cannot
            be written to C; names that collide in C; a folder that cannot be written.
    """
    made = parametric(problem, method, guess)
    model = made.frame.model
    name, target = problem_name(model), Path(folder)
    sizes = _sizes(made, solver)
    texts = {
        f"{name}.h": header_text(made, sizes),
        f"{name}.c": _source(made, method, sizes),
        "example.c": example_text(made, sizes),
        "README.md": card_text(made, sizes, repr(method)),
    }
    functions = [*_FUNCTIONS, *(["shift"] if sizes.shifts else []), *(["solve"] if solver else [])]
    texts[MANIFEST] = _manifest(made, sizes, functions, texts)
    write_folder(target, texts)
    return Artefact(target, model.name, model.digest, tuple(functions))


def _manifest(made: Parametric, sizes: Sizes, functions: list[str], texts: dict[str, str]) -> str:
    model, frame = made.frame.model, made.frame
    states = zip(model.x_labels, made.state, strict=True)
    groups = {
        "x": [[v.name, v.unit, float(value)] for v, value in states],
        "u": [[v.name, v.unit, v.start] for v in _inputs(made)],
        "p": [[v.name, v.unit, v.start] for v in made.p_labels],
        "s": [[v.name, v.unit, v.start] for v in frame.s_labels],
    }
    content = {
        "rbsd_sym": version.VERSION,
        "abi": version.ABI,
        "casadi": ca.CasadiMeta.version(),
        "name": model.name,
        "digest": model.digest,
        "kind": PROBLEM,
        "functions": functions,
        "sizes": sizes.numbers,
        "labels": groups,
        "files": {name: sha256(text) for name, text in sorted(texts.items())},
    }
    return json.dumps(content, indent=1) + "\n"


def _inputs(made: Parametric) -> list[Any]:
    return [made.frame.model.dae.u_labels[k] for k in made.frame.controls]


def _patterns(made: Parametric) -> tuple[ca.Sparsity, ca.Sparsity]:
    """Of the constraints' Jacobian and the Hessian, columns as the C code writes them."""
    nlp, handed = made.chain.nlp, 0
    jac: tuple[list[int], list[int]] = [], []
    hess: tuple[list[int], list[int]] = [], []
    above = 0  # rows of the stage before begin here
    for (first, top), part, stage in zip(nlp.offsets, nlp.segments, made.stages, strict=False):
        j_rows, j_columns = stage.jacobian.sparsity_out(0).get_triplet()
        h_rows, h_columns = stage.hessian.sparsity_out(0).get_triplet()
        for k in range(part.count):
            at, down = first + k * part.n_w, top + k * part.n_g
            jac[0].extend([*range(above, above + handed), *(down + i for i in j_rows)])
            jac[1].extend([*range(at, at + handed), *(at + j for j in j_columns)])
            hess[0].extend(at + i for i in h_rows)
            hess[1].extend(at + j for j in h_columns)
            handed, above = part.n_next, down
    return ca.Sparsity.triplet(nlp.m, nlp.n, *jac), ca.Sparsity.triplet(nlp.n, nlp.n, *hess)


def _sizes(made: Parametric, solver: bool) -> Sizes:
    frame, nlp = made.frame, made.chain.nlp
    jac, hess = _patterns(made)
    calls = [getattr(stage, part) for stage in made.stages for part in _PARTS]
    numbers = {
        "N_X": frame.model.n_x,
        "N_U": frame.n_v,
        "N_P": len(made.p_labels),
        "N_W": nlp.n,
        "N_G": nlp.m,
        "NNZ_JAC": jac.nnz(),
        "NNZ_HESS": hess.nnz(),
    }
    stack = 8 * max(f.sz_w() + f.sz_iw() + f.sz_arg() + f.sz_res() for f in calls)
    stack += 8 * max(stage.jacobian.nnz_out(0) for stage in made.stages)
    if solver:
        qp = _quadratic_program(problem_name(frame.model), jac, hess)
        own = 8 * (nlp.n + nlp.m) + 2 * nlp.n + jac.nnz() + hess.nnz()
        numbers |= {"N_WORK": own + qp.sz_w(), "N_IWORK": max(1, qp.sz_iw())}
    mesh = made.chain.mesh[0]
    equal = bool(np.ptp(np.diff(mesh)) < 1e-12)
    fixed = not any(label.name.startswith("horizon of") for label in frame.s_labels)
    shifts = frame.n_phases == 1 and equal and fixed
    return Sizes(numbers, jac, hess, stack, shifts, solver)


def _quadratic_program(name: str, jac: ca.Sparsity, hess: ca.Sparsity) -> ca.Function:
    """CasADi's qrqp for programs of these patterns, silent."""
    options = {
        "print_header": False,
        "print_info": False,
        "print_iter": False,
        "error_on_fail": False,
    }
    return ca.conic(f"{name}_casadi_qp", "qrqp", {"h": hess, "a": jac}, options)


def _source(made: Parametric, method: Method, sizes: Sizes) -> str:
    name = problem_name(made.frame.model)
    generator = ca.CodeGenerator(f"{name}_runtime", {"casadi_int": "int", "with_header": False})
    calls = []
    for k, stage in enumerate(made.stages):
        for part in _PARTS:
            function: ca.Function = getattr(stage, part)
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
    code = generated(generator, made.frame.model)
    files = [
        "ocp_problem",
        *(["ocp_shift"] if sizes.shifts else []),
        *(["ocp_solve"] if sizes.solver else []),
    ]
    return "\n".join(
        [
            banner(made.frame.model, f"{name}.c: functions of an optimal control problem"),
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
    """Add a function.

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
    frame, part = made.frame, made.chain.nlp.segments[0]
    offsets, at = [0], frame.n_y
    groups = {"u": frame.n_v, "x": frame.model.n_x, "z": frame.model.n_z}
    for kind, _ in made.chain.intervals[0].variables:
        offsets += [at] if kind == "x" else []
        at += groups[kind]
    tables = [
        *_stage_tables(made),
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
        "name": problem_name(frame.model),
        "NAME": names.constant(frame.model.name, "ocp"),
        "TABLES": "\n".join(tables) + "\n",
        "N_SEGMENTS": len(made.stages),
        "N_Y": frame.n_y,
        "STRIDE": part.n_w,
        "N_ROWS": part.n_g,
        "N_INTERVALS": part.count,
        "N_STATES": len(offsets),
        "N_NODES": method.input_degree + 1,
        "N_BLOCK": max(1, *(stage.jacobian.nnz_out(0) for stage in made.stages)),
    }


def _stage_tables(made: Parametric) -> list[str]:
    """The table of segments, and the tables it points to."""
    nlp, name, lines, rows = made.chain.nlp, problem_name(made.frame.model), [], []
    for k, (part, stage) in enumerate(zip(nlp.segments, made.stages, strict=True)):
        low, high = (_rows(part, side) for side in (part.row_low, part.row_high))
        lines += [
            _table("double", f"c{k}", part.constants.T.reshape(-1)),
            _table("double", f"low{k}", low),
            _table("double", f"high{k}", high),
            _table("int", f"columns{k}", np.array(stage.jacobian.sparsity_out(0).colind())),
        ]
        first, top = nlp.offsets[k]
        numbers = (part.count, part.n_w, part.n_g, part.n_next, len(part.constants), first, top)
        kernels = (_kernel(name, k, p) for p in _PARTS)
        rows.append(
            f"  {{{', '.join(str(n) for n in numbers)}, c{k}, low{k}, high{k}, columns{k}, "
            f"{stage.hessian.nnz_out(0)},\n   {', '.join(kernels)}}}"
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
