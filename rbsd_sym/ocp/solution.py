"""What an optimisation gives: the plan, what it costs, and whether it flies."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..model.model import Model
from ..model.trajectory import Trajectory
from .between import Miss
from .flight import Flight
from .mesh import basis, control_nodes
from .problem import Problem
from .solvers import Answer, Outcome


@dataclass(frozen=True, eq=False)
class Pieces:
    """An Input over time: a polynomial on each interval, constant before and after.

    Fields:
        edges: ends of the intervals (n + 1,), s.
        values: at the nodes of each interval (n, degree + 1).
    """

    edges: np.ndarray
    values: np.ndarray

    def __call__(self, t: float) -> float:
        """The value at a time; where it jumps, the one after."""
        last = len(self.edges) - 2
        k = int(np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, last))
        tau = (t - self.edges[k]) / (self.edges[k + 1] - self.edges[k])
        return float(self.at(k, np.clip([tau], 0.0, 1.0))[0])

    def at(self, k: int, tau: Any) -> np.ndarray:
        """Values on interval k at points (n,) of it."""
        nodes = control_nodes(self.values.shape[1] - 1)
        return basis(nodes, np.array(tau, float)) @ self.values[k]

    @property
    def jumps(self) -> np.ndarray:
        """Change from each interval to the next (n - 1,)."""
        n = len(self.edges) - 1
        ends = np.array([self.at(k, [0.0, 1.0]) for k in range(n)])
        return ends[1:, 0] - ends[:-1, 1]

    def switches(self, threshold: float) -> np.ndarray:
        """Times at which the value crosses a threshold, s.

        Where it does so by way of one interval with a value between, the time at which a jump would
        have the same mean.
        """
        n, found, k = len(self.edges) - 1, [], 0
        mean = np.array([self.at(k, np.linspace(0, 1, 9)).mean() for k in range(n)])
        while k < n - 1:
            if (mean[k] - threshold) * (mean[k + 1] - threshold) >= 0:
                k += 1
                continue
            inner = k if abs(mean[k] - threshold) < abs(mean[k + 1] - threshold) else k + 1
            before, after = mean[max(inner - 1, 0)], mean[min(inner + 1, n - 1)]
            share = (mean[inner] - after) / (before - after) if before != after else 1.0
            start, end = self.edges[inner], self.edges[inner + 1]
            found.append(start + float(np.clip(share, 0.0, 1.0)) * (end - start))
            k = max(k + 1, inner)
        return np.array(found)


@dataclass(frozen=True, eq=False)
class Raw:
    """What a warm start needs: the program's answer on its mesh."""

    mesh: tuple[np.ndarray, ...]
    answer: Answer
    degree: int
    plan: Any
    chain: Any


@dataclass(frozen=True, eq=False)
class Solution:
    """A plan and what is known of it.

    Fields:
        model: the one planned with, which has all states if the problem needed one left out.
        trajectory: states, Inputs and outputs at the mesh and between, like that of `simulate`.
            Where an Input jumps, its value is the one after.
        inputs: what was found, by name, as functions of t that `simulate` takes.
        durations: of the phases, s; `params` the values used.
        mesh: times of the intervals' ends (n + 1,), s.
        cost, outcome, report: how it ended, and the full sentence with the reason.
        interval_errors: of each interval, relative to the size of the states of one unit: how far
            IDAS at rtol 1e-10 is from the plan at its saved points, from the plan's own states at
            its start. `mesh_error` is the largest. Empty if not flown.
        flown: the whole plan integrated by IDAS, and the difference.
        between: conditions along the path that a plan by `Collocation` passes between the points at
            which they are kept: of each the worst place found at four times as many points.
        multipliers: by name of a condition, the changes of the cost by its bound; "costate of
            <state>" at the ends of intervals.
        stats: iterations and time (s) of the solver, over all rounds; time_flight and time_build
            (s); variables, equations, nonzeros of the Jacobian, rounds, what the solver said.
        notes: what the user should know.
    """

    problem: Problem
    model: Model
    trajectory: Trajectory
    inputs: Mapping[str, Pieces]
    durations: tuple[float, ...]
    params: Mapping[str, float]
    mesh: np.ndarray
    cost: float
    outcome: Outcome
    report: str
    interval_errors: np.ndarray
    flown: Flight | None
    between: tuple[Miss, ...]
    multipliers: Mapping[str, np.ndarray]
    stats: Mapping[str, float | str]
    notes: tuple[str, ...]
    raw: Raw = field(repr=False)

    @property
    def t_end(self) -> float:
        """Total duration in s."""
        return float(sum(self.durations))

    @property
    def mesh_error(self) -> float:
        """Largest relative error of one interval, NaN if not flown."""
        return float(self.interval_errors.max()) if len(self.interval_errors) else float("nan")

    def __str__(self) -> str:
        lines = [
            f"{self.trajectory.name}: {self.report}; cost {self.cost:.9g}, "
            f"{self.t_end:.9g} s, {len(self.mesh) - 1} intervals"
        ]
        if self.flown:
            lines.append(
                f"mesh error {self.mesh_error:.2g}; flown by IDAS it differs by "
                f"{self.flown.difference:.2g} (in {self.flown.worst[0]})"
            )
        counts = ", ".join(
            f"{key} {value if isinstance(value, str) else f'{value:.4g}'}"
            for key, value in self.stats.items()
        )
        return "\n".join([*lines, counts, *(f"note: {note}" for note in self.notes)])


class OptimisationError(RuntimeError):
    """An optimisation without a plan; `solution` holds what was reached, and why."""

    def __init__(self, solution: Solution) -> None:
        super().__init__(f"{solution.trajectory.name}: {solution.report}")
        self.solution = solution
