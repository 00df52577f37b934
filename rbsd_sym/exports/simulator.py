"""Export of a whole simulation, model and adaptive integrator, as one C file."""

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
    """An integrator that `export_simulator` can write to C.

    Fields:
        plugin: name of CasADi's integrator plugin; "" for DOP853, for which this package has
            templates of its own.
        solves_algebraic: whether it integrates models with algebraic unknowns.
        rtol, atol: tolerances that the example and the loader use by default.
        max_steps: largest number of steps (for plugins between two output times), fixed in the C
            code.
    """

    plugin: ClassVar[str]
    solves_algebraic: ClassVar[bool]
    rtol: float
    atol: float
    max_steps: int

    @property
    def casadi_options(self) -> Mapping[str, Any]:
        """Options of CasADi's plugin."""
        ...


def export_simulator(
    model: Model,
    folder: str | os.PathLike[str],
    integrator: Exportable,
    sensitivities: bool = False,
) -> Artefact:
    """Write a whole simulation as one C file without dependencies.

    The folder receives <name>_simulate.h, <name>_simulate.c, example.c, manifest.json and
    README.md, either all of them or none. The C function takes times, start, inputs (constant or
    sampled), parameters and tolerances, chooses its steps itself, allocates nothing, and returns a
    code; the header documents it.

    >>> artefact = rs.export_simulator(model, "generated/swing_sim", rs.Dop853())
    >>> trajectory = rs.load_simulator(artefact, model)(2.0, params={"k": 3e4})

    Arguments:
        model: what `compile_scene` returns.
        folder: created if needed; one that holds another kind of export is refused.
        integrator: `Dop853()`, or for stiff models and algebraic unknowns `Rosenbrock()`, or
            `ExplicitRK()`. Tolerances are arguments in C; max_steps and the other options are
            fixed by the export. IDAS needs its library and cannot be exported.
        sensitivities: also write derivatives of the final state by start state, inputs and
            parameters, forward and adjoint, exact for the steps taken; with `Dop853()` only.

    Returns:
        The `Artefact`, which `load_simulator` takes.

    Raises:
        ValueError: an integrator that cannot be written to C, or not for this model (algebraic
            unknowns, events, post-Newton steps, no states); a folder that cannot be written.
    """
    # The functions of a `compiled` model call a library, so they cannot be written as C.
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
    texts[MANIFEST] = _manifest(model, integrator, sensitivities, texts)
    target = Path(folder)
    write_folder(target, texts)
    return Artefact(target, model.name, model.digest, ())


def _manifest(
    model: Model, integrator: Exportable, sensitivities: bool, texts: Mapping[str, str]
) -> str:
    more = {
        "kind": SIMULATOR,
        "functions": {},
        "method": type(integrator).__name__,
        "rtol": integrator.rtol,
        "atol": integrator.atol,
        "sensitivities": sensitivities,
        # Start values that depend on parameters are constants in C, at the defaults of these.
        "moves": bool(ca.symvar(model.dae.x_start)),
    }
    more |= {"events": list(model.events)} if model.events else {}
    return manifest_text(model, texts, ("x", "z", "u", "p", "idle_p"), more)


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
            f"model '{model.name}': {what}, which {kind} does not support in C; "
            + (
                "use GeneralizedAlpha().step_function(model)"
                if model.dae.updates
                else "give Rosenbrock() or ExplicitRK()"
            )
        )
    if not model.n_x:
        raise ValueError(
            f"model '{model.name}': no states, so there is nothing to integrate; call its outputs "
            "through export_c, or compile with minimal=False"
        )
    if sensitivities and integrator.plugin:
        raise ValueError(f"export_simulator: {kind} has no sensitivities in C; give Dop853()")


def _explicit(model: Model, integrator: Exportable, sensitivities: bool) -> str:
    """Return the source for DOP853: the rates and our own templates of the method."""
    # CasADi generates the rates only. Forward and adjoint products of the rates carry the
    # derivatives through each stage, so that they are exact for the steps taken.
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
    # CasADi names a C function after its Function, so it is made again under the C symbol.
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
