"""Meshes over phases, and polynomials on an interval."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Union

import casadi as ca
import numpy as np

Intervals = Union[int, Sequence[Any]]
"""Number of equal intervals; or for each phase a number, or increasing fractions from 0 to 1."""


def meshes(intervals: Intervals, n_phases: int) -> tuple[np.ndarray, ...]:
    """Fractions from 0 to 1 of each phase.

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
    """Lagrange polynomials of the nodes (k,) at tau (n,): (n, k)."""
    found = np.ones((len(tau), len(nodes)))
    for j, node in enumerate(nodes):
        for i, other in enumerate(nodes):
            if i != j:
                found[:, j] *= (tau - other) / (node - other)
    return found


def slopes(nodes: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """Derivatives of the Lagrange polynomials of the nodes at tau: (n, k)."""
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
    """Points that carry an Input of that degree on an interval: its middle, or Chebyshev points.

    The ends are among them, so that bounds of a linear Input hold all over the interval.
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
    """Gauss-Legendre or Radau IIA points of a degree."""
    points = np.array(ca.collocation_points(degree, name), float)
    nodes = np.concatenate([[0.0], points])
    powers = np.arange(degree)
    weights = np.linalg.solve(points[None, :] ** powers[:, None], 1 / (powers + 1.0))
    end = basis(nodes, np.array([1.0]))[0]
    return Scheme(nodes, slopes(nodes, points), end, weights)


def same_input(degree: int, tau: Any) -> np.ndarray:
    """Values at tau of an Input by its nodes: (n, degree + 1)."""
    return basis(control_nodes(degree), np.atleast_1d(np.array(tau, float)))
