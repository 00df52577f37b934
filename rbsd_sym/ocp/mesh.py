"""Meshes over phases, and one interval of a mesh as the transcriptions give it.

A mesh divides each phase into intervals by fractions from 0 to 1. On an interval an Input is a
polynomial through its nodes; what else varies there is up to the transcription, which gives one
`Interval` for all intervals of a phase.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Union

import casadi as ca
import numpy as np

from ..base.symbols import is_number
from .conditions import Limits
from .nlp import BlockFunctions, RowKind
from .traced import TracedProblem

Intervals = Union[int, Sequence[Any]]
"""Number of equal intervals; or for each phase a number, or increasing fractions from 0 to 1."""


def meshes(intervals: Intervals, n_phases: int) -> tuple[np.ndarray, ...]:
    """Return the fractions from 0 to 1 at which the intervals of each phase end.

    Raises:
        ValueError: numbers that are not positive, fractions that do not increase from 0 to 1.
    """
    per_phase: list[Any]
    if isinstance(intervals, (int, np.integer)):
        per_phase = [intervals] * n_phases
    else:
        per_phase = list(intervals)
        flat = bool(per_phase) and all(np.ndim(part) == 0 for part in per_phase)
        numbers = all(isinstance(part, (int, np.integer)) for part in per_phase)
        if flat and n_phases == 1 and not (numbers and per_phase[0] != 0):
            per_phase = [per_phase]
    # By now [0, 0.2, 1] of a single phase is one entry, and [10, 20] an entry for each of two.
    if len(per_phase) != n_phases:
        raise ValueError(
            f"intervals: {len(per_phase)} entries for {n_phases} phases; give one number, or an "
            "entry for each phase"
        )
    return tuple(_mesh(part) for part in per_phase)


def _mesh(part: Any) -> np.ndarray:
    if np.ndim(part) == 0:
        if not isinstance(part, (int, np.integer)) or part < 1:
            raise ValueError(f"intervals: {part!r}; a number of intervals is whole and positive")
        return np.linspace(0.0, 1.0, int(part) + 1)
    mesh = np.array(part, float)
    good = mesh.ndim == 1 and len(mesh) > 1 and mesh[0] == 0 and mesh[-1] == 1
    if not good or not (np.diff(mesh) > 0).all():
        raise ValueError(
            f"intervals: fractions {part!r}; they increase from 0 to 1, such as [0, 0.2, 1]"
        )
    return mesh


def basis(nodes: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return the Lagrange polynomials of the nodes (k,) at tau (n,): (n, k)."""
    found = np.ones((len(tau), len(nodes)))
    for j, node in enumerate(nodes):
        for i, other in enumerate(nodes):
            if i != j:
                found[:, j] *= (tau - other) / (node - other)
    return found


def slopes(nodes: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Return the derivatives of the Lagrange polynomials of the nodes at tau: (n, k)."""
    found = np.zeros((len(tau), len(nodes)))
    for j, node in enumerate(nodes):
        for i, other in enumerate(nodes):
            if i == j:
                continue
            term = np.full(len(tau), 1 / (node - other))
            for k, third in enumerate(nodes):
                if k not in (i, j):
                    term *= (tau - third) / (node - third)
            found[:, j] += term
    return found


def control_nodes(degree: int) -> np.ndarray:
    """Return the nodes of an Input of that degree on an interval: its middle, or Chebyshev points.

    The ends are among Chebyshev's, so that bounds of a linear Input hold all over the interval.
    """
    if degree == 0:
        return np.array([0.5])
    return (1 - np.cos(np.pi * np.arange(degree + 1) / degree)) / 2


@dataclass(frozen=True)
class Scheme:
    """Collocation points of an interval and what goes with them.

    Fields:
        nodes: 0 and the points (d + 1,).
        slope: (d, d + 1), derivatives at the points of the polynomial through all nodes.
        end: (d + 1,), its value at 1.
        weights: (d,) of the quadrature.
    """

    nodes: np.ndarray
    slope: np.ndarray
    end: np.ndarray
    weights: np.ndarray


def scheme(name: str, degree: int) -> Scheme:
    """Return the scheme of the Gauss-Legendre or Radau IIA points of a degree."""
    points = np.array(ca.collocation_points(degree, name), float)
    nodes = np.concatenate([[0.0], points])
    powers = np.arange(degree)
    # The quadrature through the points is exact for powers below the degree.
    weights = np.linalg.solve(points[None, :] ** powers[:, None], 1 / (powers + 1.0))
    end = basis(nodes, np.array([1.0]))[0]
    return Scheme(nodes, slopes(nodes, points), end, weights)


def inputs_at(degree: int, tau: Any, nodes: Any, n_v: int) -> Any:
    """Inputs (n_v, 1) at a place of the interval, a number or a symbol.

    Arguments:
        nodes: all Inputs at the first node, then at the next (n_v (degree + 1),).
    """
    if not degree:
        return nodes
    at = control_nodes(degree)
    weights = basis(at, np.array([tau]))[0] if is_number(tau) else _lagrange(at, tau)
    return sum(weights[k] * nodes[k * n_v : (k + 1) * n_v] for k in range(degree + 1))


def _lagrange(nodes: np.ndarray, tau: Any) -> Any:
    """Return the Lagrange polynomials of the nodes at a symbol."""
    found = []
    for j, node in enumerate(nodes):
        term = 1.0
        for k, other in enumerate(nodes):
            if k != j:
                term = term * (tau - other) / (node - other)
        found.append(term)
    return ca.vertcat(*found)


@dataclass(frozen=True, eq=False)
class Interval:
    """A block between two points of the mesh: w = [y; groups], c = [length, start] as fractions.

    Fields:
        variables: groups after y: "u", "x" or "z", and where on the interval (0 ... 1).
        rows: groups of rows after what is handed on, and where: `rate` and `balance` are equal to
            zero, `path` are the path's rows, `limit` all that is limited there.
        saved: points of the interval at which a trajectory is saved, the first 0, all below 1.
        dense: (w, c) -> x (n_x, saved), z (n_z, saved).
        limits: what is limited along the phase.
        checked, check: points at which a plan is compared with the limits, and as `dense` there.
    """

    functions: BlockFunctions
    variables: tuple[tuple[str, float], ...]
    rows: tuple[tuple[RowKind, float], ...]
    saved: np.ndarray
    dense: ca.Function
    limits: Limits
    checked: np.ndarray
    check: ca.Function

    @property
    def input_nodes(self) -> int:
        """Number of nodes of the Inputs."""
        return sum(group == "u" for group, _ in self.variables)


@dataclass(frozen=True)
class Refinement:
    """Rule for when to stop refining: error of one interval, its order, and rounds at most."""

    tolerance: float
    rounds: int
    order: int


class Method(Protocol):
    """A transcription, which writes the block of an interval; a class with these can be one."""

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
        """Rule for when to stop refining, None for one solution."""
        ...

    def interval(self, traced: TracedProblem, i: int) -> Interval:
        """Write the block of an interval of phase i; its variables are y, input groups, others."""
        ...


def input_groups(degree: int) -> tuple[tuple[str, float], ...]:
    """Groups of variables of the Inputs on an interval."""
    return tuple(("u", float(tau)) for tau in control_nodes(degree))


def check_method(where: str, method: Any, highest: int) -> None:
    """Check the degree of the Inputs and the refinement.

    Raises:
        ValueError: they make no sense.
    """
    degree, refine = method.input_degree, method.refine
    if not isinstance(degree, int) or not 0 <= degree <= highest:
        raise ValueError(f"{where}: input_degree {degree!r}; it is 0 ... {highest} here")
    if refine is not None and not (isinstance(refine, float) and 0 < refine < 1):
        raise ValueError(
            f"{where}: refine {refine!r}; it is a relative error between 0 and 1, or None"
        )
    if not (isinstance(method.rounds, int) and method.rounds > 0):
        raise ValueError(f"{where}: rounds {method.rounds!r}; a whole number above 0")
