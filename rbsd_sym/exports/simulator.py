"""A whole simulation as one dependency-free C file: the model and an adaptive method."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

import casadi as ca

from ..model.model import Model
from ..model.values import as_model
from .c import call_lines, manifest_text
from .dop853_text import explicit_parts, tangent_parts
from .folder import MANIFEST, Artefact, template, write_folder
from .generated import generated
from .loops import assembles, stub, with_loops
from .simulator_casadi import casadi_text
from .simulator_texts import (
    card_text,
    example_text,
    header_text,
    simulator_file,
    simulator_marks,
    simulator_name,
)

SIMULATOR = "simulator"


@runtime_checkable
class Exportable(Protocol):
    """An integrator that can be written to C.

    `plugin` names CasADi's method; "" stands for DOP853, which has a C text of its own.
    """

    plugin: ClassVar[str]
    solves_algebraic: ClassVar[bool]
    rtol: float
    atol: float
    max_steps: int

    @property
    def casadi_options(self) -> Mapping[str, Any]:
        """Options of the plugin."""
        ...


def export_simulator(
    model: Model,
    folder: str | os.PathLike[str],
    integrator: Exportable,
    sensitivities: bool = False,
) -> Artefact:
    """Write <name>_simulate.h and .c, example.c, manifest.json and README.md into a folder.

    Arguments:
        folder: made if needed; one that holds another kind of export is refused.
        integrator: `Dop853()`, `Rosenbrock()` or `ExplicitRK()`. Tolerances are arguments in C;
            max_steps and the options are fixed by the export.
        sensitivities: also derivatives of the final state by start state, inputs and parameters,
            forward and adjoint, exact for the steps taken; with `Dop853()`.

    Raises:
        ValueError: a method that cannot be written to C, or not for this model.
    """
    model = as_model(model, "export_simulator").plain
    _check(model, integrator, sensitivities)
    name = simulator_name(model)
    source = (
        casadi_text(model, integrator)
        if integrator.plugin
        else _explicit(model, integrator, sensitivities)
    )
    texts = {
        f"{name}.h": header_text(model, integrator, sensitivities),
        f"{name}.c": source,
        "example.c": example_text(model, integrator),
        "README.md": card_text(model, integrator, sensitivities),
    }
    more = {
        "kind": SIMULATOR,
        "functions": {},
        "method": type(integrator).__name__,
        "rtol": integrator.rtol,
        "atol": integrator.atol,
        "sensitivities": sensitivities,
        "moves": bool(ca.symvar(model.dae.x_start)),
    }
    more |= {"events": list(model.events)} if model.events else {}
    texts[MANIFEST] = manifest_text(model, texts, ("x", "z", "u", "p", "idle_p"), more)
    target = Path(folder)
    write_folder(target, texts)
    return Artefact(target, model.name, model.digest, ())


def _check(model: Model, integrator: Exportable, sensitivities: bool) -> None:
    kind = type(integrator).__name__
    if not isinstance(integrator, Exportable):
        raise ValueError(
            f"export_simulator: {kind} cannot be written to plain C; give Dop853(), Rosenbrock() "
            "or ExplicitRK()"
        )
    if model.n_z and not integrator.solves_algebraic:
        raise ValueError(
            f"model '{model.name}': {model.n_z} algebraic unknowns, and {kind} integrates ODEs "
            "only; give Rosenbrock()"
        )
    if model.dae.updates or (model.events and not integrator.plugin):
        what = "post_newton_step" if model.dae.updates else "events"
        raise ValueError(
            f"model '{model.name}': {what}, which {kind} does not have in C; "
            + (
                "use GeneralizedAlpha().step_function(model)"
                if model.dae.updates
                else "give Rosenbrock() or ExplicitRK()"
            )
        )
    if not model.n_x:
        raise ValueError(f"model '{model.name}': no states, so there is nothing to integrate")
    if sensitivities and integrator.plugin:
        raise ValueError(f"export_simulator: {kind} has no sensitivities in C; give Dop853()")


def _explicit(model: Model, integrator: Exportable, sensitivities: bool) -> str:
    wanted = ["ode", *(("ode_forward", "ode_adjoint") if sensitivities else ())]
    generator = ca.CodeGenerator(f"{model.name}_sim_casadi")
    wrappers, loops = [], {}
    for key in wanted:
        symbol = f"{model.name}_sim_casadi_{key}"
        if assembles(model, key):
            loops[symbol], kernel = key, stub(model, key, symbol)
        else:
            kernel = _renamed(model.function(key), symbol)
        generator.add(kernel)
        wrappers.append(_wrapper(model, key, kernel))
    text = with_loops(generated(generator, model), model, loops)
    marks = simulator_marks(model, integrator) | explicit_parts()
    marks |= tangent_parts() if sensitivities else {}
    watch = "dop853_tangent" if sensitivities else "dop853_plain"
    files = ["simulator_common", "dop853", watch, "dop853_run", "simulator_constant"]
    files += ["dop853_sensitivity"] if sensitivities else []
    texts = [template(f"{file}.c", marks) for file in files]
    return simulator_file(model, text, [*wrappers, *texts])


def _renamed(function: ca.Function, name: str) -> ca.Function:
    symbols = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    result = ca.densify(function(*symbols))
    return ca.Function(name, symbols, [result], function.name_in(), function.name_out())


def _wrapper(model: Model, key: str, kernel: ca.Function) -> str:
    given = str(kernel.name_in(5)) if kernel.n_in() > 5 else ""
    extra = f", const double *{given}" if given else ""
    return "\n".join(
        [
            f"static int {model.name}_sim_{key}(double t, const double *x, const double *z, "
            f"const double *u, const double *p{extra}, double *result)",
            *call_lines(kernel, "result", given),
        ]
    )
