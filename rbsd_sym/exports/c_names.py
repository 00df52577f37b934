"""Names in generated C; all of them are made in this file."""

from __future__ import annotations

from collections.abc import Iterable

from ..base.names import c_name
from ..dae.members import Label


def function(model: str, name: str) -> str:
    """Return the C symbol of an exported function, such as `swing_dode_dx`."""
    return f"{model}_{c_name(name)}"


def kernel(model: str, name: str) -> str:
    """Return the C symbol of CasADi's function that an exported one calls."""
    return f"{model}_casadi_{c_name(name)}"


def constant(model: str, *parts: str) -> str:
    """Return the name of an enum constant: model name and parts in capitals, joined by _."""
    return "_".join(c_name(part) for part in (model, *parts)).upper()


def indices(model: str, kind: str, labels: Iterable[Label]) -> list[tuple[str, Label]]:
    """Return (enum constant, label) for each label, such as (SWING_X_ARM_P_X, arm.p_x).

    Raises:
        ValueError: two labels have the same constant, as names that differ by case alone do.
    """
    rows = [(constant(model, kind, label.name), label) for label in labels]
    seen: dict[str, str] = {}
    for name, label in rows:
        if name in seen:
            raise ValueError(
                f"model '{model}': '{seen[name]}' and '{label.name}' are both {name} in C; C "
                "constants are written in capitals; rename one of them"
            )
        seen[name] = label.name
    return rows
