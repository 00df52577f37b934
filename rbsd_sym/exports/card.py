"""The model card: the README.md of a generated folder, written for whoever finds that folder."""

from __future__ import annotations

from .. import version
from ..dae.members import Label
from ..model.model import Model
from .header import Exported


def card_text(model: Model, functions: list[Exported]) -> str:
    """Return the text of README.md: sizes, use, functions with their cost, states and notes."""
    dae, name = model.dae, model.name
    lines = [
        f"# {name}",
        "",
        f"A model of rigid bodies and 6-DOF spring-dampers, written by rbsd_sym {version.VERSION}: "
        f"`x' = ode(t, x, z, u, p)`, `0 = alg`, `y = out`. Digest `{model.digest}`.",
        "",
        f"{model.n_x} states, {model.n_z} algebraic unknowns, {model.n_u} inputs, {model.n_p} "
        f"parameters, {len(dae.out_labels)} outputs.",
        "",
        "## Use",
        "",
        "```sh",
        f"cc -std=c99 -O2 example.c {name}.c -lm -o example && ./example",
        "```",
        "",
        f"`{name}.h` is the contract: functions, sizes, indices with units. To write this folder "
        "again:",
        "",
        "```python",
        "import rbsd_sym as rs",
        "rs.export_c(rs.compile_scene(scene), folder)",
        "```",
        "",
        "## Functions",
        "",
        "| function | result | instructions |",
        "|---|---|---|",
    ]
    for f in functions:
        size = f"{f.rows} x {f.columns}, {f.numbers} nonzeros" if f.sparse else f"{f.numbers}"
        cost = "mapped kernels" if model.kernels else f.kernel.n_instructions()
        lines.append(f"| `{name}_{f.name.replace('.', '_')}` | {size} | {cost} |")
    lines += ["", "## States kept", "", *_rows(dae.x_labels)]
    for title, labels in (
        ("Algebraic unknowns", dae.z_labels),
        ("Inputs", dae.u_labels),
        ("Parameters", dae.p_labels),
    ):
        if labels:
            lines += ["", f"## {title}", "", *_rows(labels)]
    lines += _events(model)
    lines += ["", "## States dropped", ""]
    if model.dropped:
        lines += ["| state | value | why |", "|---|---|---|"]
        lines += [f"| `{d.name}` | {d.value!r} | {d.reason} |" for d in model.dropped]
    else:
        lines.append("None.")
    if model.replaced:
        lines += ["", "## States replaced", "", "| state | is |", "|---|---|"]
        lines += [f"| `{r.name}` | `{r.how}` |" for r in model.replaced]
    if dae.idle_p_labels:
        lines += ["", "## Parameters without effect", ""]
        lines += [f"- `{label.name}` = {label.start!r} {label.unit}" for label in dae.idle_p_labels]
    if model.notes:
        lines += ["", "## Notes", "", *(f"- {note}" for note in model.notes)]
    return "\n".join([*lines, ""])


def _events(model: Model) -> list[str]:
    if not model.events:
        return []
    return [
        "",
        "## Events",
        "",
        "Each fires as its entry of `zero` falls through zero; then its "
        "column of `jump` is added to the states, and the algebraic unknowns solve `alg` again. "
        "Those that happen at once do so in this order.",
        "",
        *(f"{i}. `{name}`" for i, name in enumerate(model.events)),
    ]


def _rows(labels: tuple[Label, ...]) -> list[str]:
    rows = [f"| {i} | `{v.name}` | {v.unit or '1'} | {v.start!r} |" for i, v in enumerate(labels)]
    return ["| index | name | unit | start |", "|---|---|---|---|", *rows]
