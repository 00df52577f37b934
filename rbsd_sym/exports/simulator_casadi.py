"""CasADi's Rosenbrock and explicit integrators as C, with times and tolerances as arguments.

CasADi fixes the interval and the tolerances of an integrator when it is constructed, and its
generated code reports nothing about the run. Here the interval is scaled to [0, 1] and made a
parameter, and a few lines of the generated text are replaced.
"""

from __future__ import annotations

import re
from typing import Any

import casadi as ca

from ..model.casadi_events import INSTANT, NEVER, RECORD, add_events, begin, clean_data, n_extra
from ..model.casadi_events import integrator as with_events
from ..model.model import Model
from . import c_names as names
from .folder import template
from .generated import generated
from .simulator_texts import simulator_file, simulator_marks


def casadi_text(model: Model, integrator: Any) -> str:
    """Return the source of a simulator with CasADi's integrator over s in [0, 1].

    Arguments:
        integrator: an `Exportable` with a plugin.

    Raises:
        RuntimeError: this version of CasADi generates its integrators differently.
    """
    # Parameters q of the integrator: p; the inputs at both ends of the interval, linear between;
    # then t0, t1 - t0, rtol, atol, the first step over t1 - t0, and with events the time in s
    # within which two of them count as simultaneous. As t = t0 + s (t1 - t0), the rates are
    # dx/ds = (t1 - t0) ode.
    n_q = model.n_p + 2 * model.n_u + (6 if model.events else 5)
    # Flat models are written as scalar code. Models of kernels are called instead of expanded, and
    # events need branches that evaluate one side only; both are MX.
    symbol = ca.SX if not model.calls and model.function("ode").is_a("SXFunction") else ca.MX
    symbol = ca.MX if model.events else symbol
    s, q = symbol.sym("s"), symbol.sym("q", n_q)
    x, z = symbol.sym("x", model.n_x), symbol.sym("z", model.n_z)
    p, first, last, more = ca.vertsplit(
        q, [0, model.n_p, model.n_p + model.n_u, model.n_p + 2 * model.n_u, n_q]
    )
    arguments = (more[0] + s * more[1], clean_data(model, x), z, first + s * (last - first), p)
    dae = {
        "t": s,
        "x": x,
        "z": z,
        "p": q,
        "ode": more[1] * model.function("ode")(*arguments),
        "alg": model.function("alg")(*arguments),
    }
    # The values of these tolerances are irrelevant: `_at_run_time` replaces them by arguments.
    options = dict(integrator.casadi_options) | {"reltol": 1e-6, "abstol": 1e-8}
    name = f"{model.name}_sim_run"
    if model.events:
        dae, transition = add_events(model, dae, arguments, more[5])
        run = with_events(name, integrator.plugin, dae, (0.0, 1.0), transition, INSTANT, options)
    else:
        run = ca.integrator(name, integrator.plugin, dae, 0.0, [1.0], options)
    generator = ca.CodeGenerator(f"{model.name}_sim_casadi")
    generator.add(run)
    if model.events:
        generator.add(begin(model, f"{model.name}_sim_begin"))
    text = _at_run_time(
        generated(generator, model), model.n_p + 2 * model.n_u + 2, bool(model.events)
    )
    marks = simulator_marks(model, integrator) | _sizes(text, run.name(), "SZ") | {"N_Q": n_q}
    marks |= _event_marks(model, text)
    files = ("simulator_common", "simulator_casadi", "simulator_constant")
    return simulator_file(model, text, [template(f"{file}.c", marks) for file in files])


def _event_marks(model: Model, text: str) -> dict[str, Any]:
    """Return the marks of the templates that differ for a model with events."""
    upper, extra = names.constant(model.name, "sim"), n_extra(model) if model.events else 0
    marks: dict[str, Any] = {
        "name": model.name,
        "NAME": upper,
        "N_X": model.n_x,
        "N_Z": model.n_z,
        "N_E": extra,
        "FIRST_Z": model.n_x + extra,
        "N_I": model.n_x + extra + model.n_z,
    }
    idle = dict.fromkeys(("BEGIN", "WATCH", "TELL", "KEEP", "INSTANT", "DUE", "MANY"), "")
    if not model.events:
        return marks | idle
    marks |= _sizes(text, f"{model.name}_sim_begin", "B")
    marks |= {"RECORD": RECORD, "NEVER": NEVER, "INSTANT_OF_RUN": repr(INSTANT)}
    return marks | {
        "KEEP": "  own.room = stats->room, own.t_event = stats->t_event, own.which = stats->which;"
        "\n",
        "INSTANT": f"  more[5] = {INSTANT!r} * (run->t1 - run->t0);\n",
        "MANY": f"    if (report[6]) return {upper}_ENDLESS_EVENTS;\n",
        **{
            key: template(f"simulator_{key.lower()}.c", marks)
            for key in ("BEGIN", "WATCH", "TELL", "DUE")
        },
    }


def _sizes(text: str, function: str, mark: str) -> dict[str, str]:
    keys = ("arg", "res", "iw", "w")
    return {f"{mark}_{key.upper()}": _size(text, function, key) for key in keys}


def _at_run_time(text: str, place: int, events: bool) -> str:
    """Replace the numbers that CasADi writes into its integrator by entries of its parameters.

    Arguments:
        text: code that CasADi generated.
        place: index of rtol in q; the length of the interval precedes it, atol and the first step
            follow.
        events: whether the model has events.

    Raises:
        RuntimeError: this version of CasADi generates its integrators differently.
    """
    # The integrator has no quadratures, so their result, res[2], is free to return time reached,
    # steps, rejected steps, evaluations, next and last step to the C code around it.
    report = (
        "d.t, (casadi_real)d.n_steps, (casadi_real)d.n_reject, (casadi_real)d.n_rhs, d.h_next, d.h"
    )
    if events:
        report += ", d.status == IVP_TOO_MANY_EVENTS"
    copies = " ".join(f"res[2][{i}] = {v};" for i, v in enumerate(report.split(", ")))
    for pattern, new in (
        (r"  p\.reltol = [^;]+;", f"  p.reltol = arg[2][{place}];"),
        (r"  p\.abstol = [^;]+;", f"  p.abstol = arg[2][{place + 1}];"),
        # The largest step is given in s, and the integrator's own time is s in [0, 1].
        (r"  p\.h_max = ([^;]+);", rf"  p.h_max = \1 / arg[2][{place - 1}];"),
        (r"  p\.h_init = [^;]+;", f"  p.h_init = arg[2][{place + 2}];"),
        (
            r"      if \(d\.status != IVP_SUCCESS\) return 1;",
            f"      if (res[2]) {{ {copies} }}\n      if (d.status != IVP_SUCCESS) return 1;",
        ),
    ):
        text, count = re.subn(pattern, new, text)
        # A line that was not found exactly once would leave CasADi's fixed number in force, and
        # the simulator would ignore an argument without any sign of it.
        if count != 1:
            raise RuntimeError(
                f"CasADi {ca.CasadiMeta.version()} generates its integrators differently; use 3.8.2"
            )
    return text


def _size(text: str, function: str, key: str) -> str:
    """Return the size of a work array, as the generated code states it, and at least 1."""
    match = re.search(rf"int {function}_work\([^)]*\) {{.*?\*sz_{key} = (\d+);", text, re.S)
    return match[1] if match and match[1] != "0" else "1"
