"""What is limited along a phase, and where a plan passes it between the points it was kept at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..dae.members import Label
from .stage import Frame


@dataclass(frozen=True, eq=False)
class Limits:
    """All conditions along a phase: rows, then states, unknowns and Inputs that have bounds.

    Fields:
        low, high: (n,).
        value: (t, x, z, v, s) -> (n, 1).
    """

    labels: tuple[Label, ...]
    low: np.ndarray
    high: np.ndarray
    value: ca.Function


@dataclass(frozen=True)
class Miss:
    """A condition that is not met.

    Fields:
        what: phase, kind and name.
        t: s.
        relative: how far the value is outside: of `misses` relative to 1 + |bound|, of
            `between_points` to the room between the bounds, or to the bound.
    """

    what: str
    t: float
    value: float
    bound: float
    unit: str
    relative: float

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return (
            f"{self.what} at t = {self.t:.6g} s is {self.value:.6g}{unit}, wanted {self.bound:.6g}"
            f"{unit} (missed by {abs(self.value - self.bound):.3g}{unit})"
        )


def groups(frame: Frame) -> dict[str, tuple[Label, ...]]:
    """Labels of the states, unknowns, and Inputs that are to be found."""
    dae = frame.model.dae
    return {
        "x": dae.x_labels,
        "z": dae.z_labels,
        "u": tuple(dae.u_labels[k] for k in frame.controls),
    }


def path_box(frame: Frame, i: int, kind: str) -> np.ndarray:
    """Bounds (2, n) of variables along a phase; of Inputs also those of the problem.

    Raises:
        ValueError: they contradict each other.
    """
    labels = groups(frame)[kind]
    box = frame.terms[i].path.limits(labels)
    if kind == "u":
        for k, label in enumerate(labels):
            own = frame.problem.inputs[label.name]
            pair = max(box[0, k], own.low), min(box[1, k], own.high)
            if pair[0] > pair[1]:
                raise ValueError(
                    f"phase {i}, path '{label.name}': bounds {box[0, k]:.6g} ... {box[1, k]:.6g} "
                    f"{label.unit} and those of the Input {own.low:.6g} ... {own.high:.6g} "
                    "contradict each other"
                )
            box[:, k] = pair
    return box


def limits(frame: Frame, i: int, input_degree: int) -> Limits:
    """What is limited along phase i; Inputs up to degree 1 are within bounds by their nodes."""
    dae, rows = frame.model.dae, frame.terms[i].path.rows
    columns = {"x": dae.x, "z": dae.z, "u": ca.vertcat(*(dae.u[k] for k in frame.controls))}
    labels, exprs, low, high = [*rows.labels], [rows.expr], [rows.low], [rows.high]
    for kind in "xzu" if input_degree > 1 else "xz":
        box = path_box(frame, i, kind)
        for k in np.flatnonzero(np.isfinite(box).any(axis=0)):
            labels.append(groups(frame)[kind][k])
            exprs.append(columns[kind][int(k)])
            low.append(box[:1, k])
            high.append(box[1:, k])
    value = frame.over("limits", ca.vertcat(*exprs))
    return Limits(tuple(labels), np.concatenate(low), np.concatenate(high), value)


def passed(limit: Limits, values: Any) -> np.ndarray:
    """How far values (n, points) are outside, relative to the room there is, or to the bound."""
    low, high = limit.low[:, None], limit.high[:, None]
    gap = np.maximum(np.maximum(low - values, values - high), 0.0)
    both = np.isfinite(high - low) & (high > low)
    largest = np.maximum(
        np.abs(np.where(np.isfinite(low), low, 0.0)), np.abs(np.where(np.isfinite(high), high, 0.0))
    )
    scale = np.where(both, np.where(both, high, 1.0) - np.where(both, low, 0.0), largest)
    return gap / np.where(scale > 0, scale, 1.0)
