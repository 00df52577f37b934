"""One interval of a phase, as the transcriptions give it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np

from .between import Limits
from .mesh import Intervals, control_nodes
from .nlp import StageFunctions
from .stage import Frame


@dataclass(frozen=True, eq=False)
class Interval:
    """A stage between two points of the mesh: w = [y; blocks], c = [length, start] as fractions.

    Fields:
        variables: blocks after y: "u", "x" or "z", and where on the interval (0 ... 1).
        rows: blocks of rows: "rate", "alg" (equal to zero), "path" or "between" (all that is
            limited), and where.
        saved: points of the interval at which a trajectory is saved, the first 0, all below 1.
        dense: (w, c) -> x (n_x, saved), z (n_z, saved).
        limits: what is limited along the phase.
        checked, check: points at which a plan is held against the limits, and as `dense` there.
    """

    functions: StageFunctions
    variables: tuple[tuple[str, float], ...]
    rows: tuple[tuple[str, float], ...]
    saved: np.ndarray
    dense: ca.Function
    limits: Limits
    checked: np.ndarray
    check: ca.Function


@dataclass(frozen=True)
class Refinement:
    """When to stop refining: error of one interval, rounds; and the order of its error."""

    tolerance: float
    rounds: int
    order: int


class Method(Protocol):
    """A transcription: gives the stage of an interval."""

    @property
    def intervals(self) -> Intervals:
        """The mesh."""
        ...

    @property
    def input_degree(self) -> int:
        """Degree of the Inputs on an interval."""
        ...

    @property
    def refinement(self) -> Refinement | None:
        """When to stop refining, None for one solution."""
        ...

    def interval(self, frame: Frame, i: int) -> Interval:
        """The stage of an interval of phase i."""
        ...


def input_blocks(degree: int) -> tuple[tuple[str, float], ...]:
    """Blocks of variables of the Inputs on an interval."""
    return tuple(("u", float(tau)) for tau in control_nodes(degree))


def inputs_at(weights: Any, nodes: Any, n_v: int) -> Any:
    """Inputs (n_v, 1) at a point, from their values at the nodes, node by node."""
    count = len(weights) if isinstance(weights, np.ndarray) else weights.numel()
    if count == 1:  # constant
        return nodes
    found = sum(weights[k] * nodes[k * n_v : (k + 1) * n_v] for k in range(count))
    return found


def lagrange(nodes: np.ndarray, tau: Any) -> Any:
    """Lagrange polynomials of the nodes at a symbol."""
    found = []
    for j, node in enumerate(nodes):
        term = 1.0
        for k, other in enumerate(nodes):
            if k != j:
                term = term * (tau - other) / (node - other)
        found.append(term)
    return ca.vertcat(*found)


def check_method(method: Any, highest: int) -> None:
    """The degree of the Inputs and the refinement make sense.

    Raises:
        ValueError: they do not.
    """
    where, degree = type(method).__name__, method.input_degree
    if not isinstance(degree, int) or not 0 <= degree <= highest:
        raise ValueError(f"{where}: input_degree {degree!r}; it is 0 ... {highest} here")
    refine = method.refine
    if refine is not None and not (isinstance(refine, float) and 0 < refine < 1):
        raise ValueError(
            f"{where}: refine {refine!r}; it is a relative error between 0 and 1, or None"
        )
    if not (isinstance(method.rounds, int) and method.rounds > 0):
        raise ValueError(f"{where}: rounds {method.rounds!r}; a whole number above 0")
