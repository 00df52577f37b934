"""Names in generated C: minted here and nowhere else."""

from __future__ import annotations

from collections.abc import Iterable

from ..base.names import c_name
from ..dae.members import Label


def function(model: str, name: str) -> str:
    """Symbol of an exported function."""
    return f"{model}_{c_name(name)}"


def kernel(model: str, name: str) -> str:
    """Symbol of CasADi's own function behind an exported one."""
    return f"{model}_casadi_{c_name(name)}"


def constant(model: str, *parts: str) -> str:
    """An enum constant."""
    return "_".join(c_name(part) for part in (model, *parts)).upper()


def indices(model: str, kind: str, labels: Iterable[Label]) -> list[tuple[str, Label]]:
    """Enum constant of each label.

    Raises:
        ValueError: two labels give one constant, since C constants are written in capitals.
    """
    rows = [(constant(model, kind, label.name), label) for label in labels]
    seen: dict[str, str] = {}
    for name, label in rows:
        if name in seen:
            raise ValueError(
                f"model '{model}': '{seen[name]}' and '{label.name}' are both {name} in C; rename "
                "one so that they differ by more than case"
            )
        seen[name] = label.name
    return rows
