"""Texts of an exported simulator: header, card, example, and the frame of the source."""

from __future__ import annotations

from typing import Any

from .. import version
from ..dae.members import Label
from ..model.model import Model
from . import c_names as names
from .c import defaults_body
from .folder import template
from .header import banner, enum_lines, index_lines


def simulator_name(model: Model) -> str:
    """Return the name of the files without their ending, which is that of the main function."""
    return f"{model.name}_simulate"


def simulator_marks(model: Model, integrator: Any) -> dict[str, Any]:
    """Return the marks that all C templates use."""
    rows = model.n_x + model.n_z
    return {
        "name": model.name,
        "NAME": names.constant(model.name, "sim"),
        "N": rows,
        "N_U": max(1, model.n_u),
        "N_P": max(1, model.n_p),
        "N_W": rows + model.n_u + model.n_p,
        "MAX_STEPS": integrator.max_steps,
    }


def simulator_file(model: Model, code: str, parts: list[str]) -> str:
    """Return the source: CasADi's code, start values, and the parts of the method.

    Arguments:
        code: what CasADi generated.
        parts: filled templates, in an order in which C can compile them.
    """
    title = f"{simulator_name(model)}.c: a model and the method that integrates it"
    return "\n".join(
        [
            banner(model, title),
            f'#include "{simulator_name(model)}.h"\n',
            "#include <float.h>\n#include <math.h>\n#include <stddef.h>\n#include <string.h>\n",
            "#if defined(__GNUC__)\n"
            '#pragma GCC diagnostic ignored "-Wunused-parameter" '
            "/* of CasADi's common signature */\n"
            "#endif\n",
            code,
            f"void {model.name}_simulate_defaults(double *x, double *z, double *u, double *p)",
            defaults_body(model),
            *parts,
        ]
    )


def header_text(model: Model, integrator: Any, sensitivities: bool) -> str:
    """Return the text of <name>_simulate.h."""
    upper, dae, rows = names.constant(model.name, "sim"), model.dae, model.n_x + model.n_z
    groups = (
        ("x", "States: unit, start value.", dae.x_labels),
        ("z", "Algebraic unknowns: unit, start value.", dae.z_labels),
        ("u", "Inputs: unit, default value.", dae.u_labels),
        ("p", "Parameters: unit, default value.", dae.p_labels),
    )
    sizes = [(f"{upper}_N_{kind.upper()}", len(labels), "") for kind, _, labels in groups]
    indices = [line for group in groups for line in index_lines(f"{model.name}_sim", *group)]
    # Estimates of how many vectors of the states' size are on the stack at once; for DOP853 they
    # are 16 slopes and a few states, and with sensitivities the slopes of the derivatives too.
    stack = 8 * rows * (120 if integrator.plugin else 70 if sensitivities else 30)
    marks = {
        "name": model.name,
        "NAME": upper,
        "SIZES": "\n".join(enum_lines(sizes)),
        "INDICES": "\n".join(indices),
        "N_X": model.n_x,
        "N_U": model.n_u,
        "N_P": model.n_p,
        "N": rows,
        "N_W": rows + model.n_u + model.n_p,
        "N_ROW": rows + 2,
        "RTOL": integrator.rtol,
        "ATOL": integrator.atol,
        "STACK": _about(stack),
        "ROWS": "states, then the algebraic unknowns," if model.n_z else "states",
        "SENSITIVITIES": "",
        "EVENT_CODES": "",
        "EVENT_FIELDS": "",
    }
    if model.events:
        marks |= _of_events(model, upper)
    if sensitivities:
        marks["SENSITIVITIES"] = template("simulate_sensitivity.h", marks)
    title = f"{simulator_name(model)}.h: the scene integrated by {type(integrator).__name__}"
    return banner(model, title) + template("simulate.h", marks)


def _of_events(model: Model, upper: str) -> dict[str, str]:
    """Return the marks of the header that a model with events fills."""
    events = tuple(Label("", name) for name in model.events)
    indices = index_lines(f"{model.name}_sim", "event", "Events.", events)
    # The mark is just before the brace that closes the enum of codes. So this text closes that enum
    # itself, and leaves the enum of the events open for the brace of the template.
    return {
        "EVENT_CODES": (
            f",\n  {upper}_ENDLESS_EVENTS = 7, /* ever faster, at stats->t */"
            f"\n  {upper}_STOPPED = 8 /* by an event, at stats->t */\n}};\n\n"
            + "\n".join(indices).strip().removesuffix("};").rstrip()
        ),
        "EVENT_FIELDS": (
            "  long events; /* how many have happened */\n"
            "  long room; /* given: how many to tell; at most 64 between two points are */\n"
            "  double *t_event; /* given, or NULL: their times, s */\n"
            "  int *which; /* given, or NULL: their indices */\n"
        ),
    }


def _about(count: int) -> int:
    """Return a count rounded up to one significant digit."""
    size = 10 ** (len(str(count)) - 1)
    return -(-count // size) * size


def example_text(model: Model, integrator: Any) -> str:
    """Return the text of example.c, which simulates one second and prints the state at its end."""
    name, upper = simulator_name(model), names.constant(model.name, "sim")
    rows = f"{upper}_N_X + {upper}_N_Z"
    return "\n".join(
        [
            banner(model, "example.c: one second from the start values"),
            f"/* Build and run: cc -std=c99 -O2 example.c {name}.c -lm -o example && ./example */",
            "#include <stdio.h>",
            f'#include "{name}.h"',
            "",
            "int main(void)",
            "{",
            f"  double end[{rows}];",
            f"  {model.name}_stats stats;",
            f"  const int code = {name}(0.0, 1.0, NULL, NULL, NULL, {integrator.rtol!r}, "
            f"{integrator.atol!r}, 1, end, &stats);",
            '  printf("code %d at t = %.17g after %ld steps\\n", code, stats.t, stats.steps);',
            "  if (code) return code;",
            f'  for (int i = 0; i < {rows}; ++i) printf("%d %.17g\\n", i, end[i]);',
            "  return 0;",
            "}",
            "",
        ]
    )


def card_text(model: Model, integrator: Any, sensitivities: bool) -> str:
    """Return the text of README.md: what the folder holds, its use, and how to write it again."""
    name, method = simulator_name(model), type(integrator).__name__
    more = ", sensitivities=True" if sensitivities else ""
    lines = [
        f"# {name}",
        "",
        f"A scene of rigid bodies and 6-DOF spring-dampers with the method that integrates it, "
        f"{method}, in one C file without dependencies, written by rbsd_sym {version.VERSION}. "
        f"Digest `{model.digest}`.",
        "",
        f"{model.n_x} states, {model.n_z} algebraic unknowns, {model.n_u} inputs, {model.n_p} "
        "parameters.",
        "",
        "## Use",
        "",
        "```sh",
        f"cc -std=c99 -O2 example.c {name}.c -lm -o example && ./example",
        "```",
        "",
        f"`{name}.h` is the contract. To write this folder again:",
        "",
        "```python",
        "import rbsd_sym as rs",
        f"rs.export_simulator(rs.compile_scene(scene), folder, rs.{integrator!r}{more})",
        "```",
        "",
        f"Tolerances, times and inputs are arguments; at most {integrator.max_steps} steps"
        + (" between two points." if integrator.plugin else " in all."),
        "",
    ]
    return "\n".join(lines)
