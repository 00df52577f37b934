"""Results: the plan, read from the numbers of a program, and the solution of a problem."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from ..integrators.driver import Run, assemble, settle
from ..model.model import Model
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .chain import Chain
from .mesh import basis, control_nodes
from .nlp import RowKind, Where
from .problem import Problem
from .solvers import NlpAnswer, OptimisationOutcome
from .traced import TracedProblem


@dataclass(frozen=True, eq=False)
class Pieces:
    """An Input over time: a polynomial on each interval, constant before and after.

    `Solution.inputs` holds one for every Input that was found. It is a function of the time in s,
    so that `simulate(model, solution.trajectory.t, inputs=solution.inputs)` takes it as it is.

    Fields:
        edges: ends of the intervals (n + 1,), s.
        values: at the nodes of each interval (n, degree + 1), in the unit of the Input.
    """

    edges: np.ndarray
    values: np.ndarray

    def __call__(self, t: float) -> float:
        """Return the value at a time; where it jumps, the one after."""
        last = len(self.edges) - 2
        k = int(np.clip(np.searchsorted(self.edges, t, side="right") - 1, 0, last))
        tau = (t - self.edges[k]) / (self.edges[k + 1] - self.edges[k])
        return float(self.at(k, np.clip([tau], 0.0, 1.0))[0])

    def at(self, k: int, tau: Any) -> np.ndarray:
        """Return the values on interval k at places (n,) of it, from 0 to 1."""
        nodes = control_nodes(self.values.shape[1] - 1)
        return basis(nodes, np.array(tau, float)) @ self.values[k]

    @property
    def jumps(self) -> np.ndarray:
        """Change from each interval to the next (n - 1,)."""
        n = len(self.edges) - 1
        ends = np.array([self.at(k, [0.0, 1.0]) for k in range(n)])
        return ends[1:, 0] - ends[:-1, 1]

    def switches(self, threshold: float) -> np.ndarray:
        """Return the times at which the value crosses a threshold, s.

        Where it does so by way of one interval with a value between, the time at which a jump would
        have the same mean.
        """
        n, found, k = len(self.edges) - 1, [], 0
        mean = np.array([self.at(k, np.linspace(0, 1, 9)).mean() for k in range(n)])
        while k < n - 1:
            if (mean[k] - threshold) * (mean[k + 1] - threshold) >= 0:
                k += 1
                continue
            # The interval nearer to the threshold holds the jump: its mean divides it in proportion
            # to the values before and after.
            inner = k if abs(mean[k] - threshold) < abs(mean[k + 1] - threshold) else k + 1
            before, after = mean[max(inner - 1, 0)], mean[min(inner + 1, n - 1)]
            share = (mean[inner] - after) / (before - after) if before != after else 1.0
            start, end = self.edges[inner], self.edges[inner + 1]
            found.append(start + float(np.clip(share, 0.0, 1.0)) * (end - start))
            k = max(k + 1, inner)
        return np.array(found)


@dataclass(frozen=True)
class Miss:
    """A condition that is not met: `print(miss)` says which, when, and by how much.

    `Solution.between` lists those that a plan exceeds between the points at which they are kept,
    and the report of a failed optimisation is made from them.

    Fields:
        what: phase, place and name, such as "end 'cart.p_x'".
        t: s.
        value, bound: in `unit`.
        relative: how far the value is outside: in the report of a failure relative to 1 + |bound|,
            between points relative to the distance of the two bounds, or to the only one.
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


@dataclass(frozen=True, eq=False)
class Flight:
    """A plan checked by simulation: IDAS integrates the model with the Inputs found.

    `Solution.flown` holds it. A small `difference` says that the motion does what was planned; it
    is larger than the errors of the intervals where the motion itself lets disturbances grow.

    Fields:
        trajectory: from the plan's start with the plan's Inputs, through all phases.
        difference: largest distance of a state from the plan, relative to the size of the states of
            its unit.
        worst: the state and the time in s of it.
    """

    trajectory: Trajectory
    difference: float
    worst: tuple[str, float]


@dataclass(frozen=True, eq=False)
class PhasePlan:
    """A phase of a plan.

    Fields:
        t: (n + 1,) ends of the intervals, s.
        x: states at the ends of intervals (n_x, n + 1).
        nodes: Inputs that were found, at their nodes (n, n_v (degree + 1)).
        saved_t, saved_x, saved_z: at the saved points of all intervals (n k,), (n_x, n k), ...
    """

    t: np.ndarray
    x: np.ndarray
    nodes: np.ndarray
    saved_t: np.ndarray
    saved_x: np.ndarray
    saved_z: np.ndarray


@dataclass(frozen=True, eq=False)
class Plan:
    """Meaning of a program's variables: constants s, and the motion of each phase."""

    traced: TracedProblem
    s: np.ndarray
    phases: tuple[PhasePlan, ...]

    @property
    def edges(self) -> np.ndarray:
        """Ends of all intervals of all phases, s."""
        return np.concatenate([self.phases[0].t, *(phase.t[1:] for phase in self.phases[1:])])


@dataclass(frozen=True, eq=False)
class Raw:
    """Data for a warm start: the program's answer on its mesh, and the degree of the Inputs."""

    answer: NlpAnswer
    degree: int
    plan: Plan
    chain: Chain


@dataclass(frozen=True, eq=False)
class Solution:
    """A plan, what it costs, and how far a simulation confirms it.

    Returned by `optimise`. `print(solution)` sums it up; `solution.trajectory["tip.position"]` is
    the planned motion, `solution.inputs["push"]` a function of time, and
    `solution.multipliers["end cart.p_x"]` the price of that condition.

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
            its start. `mesh_error` is the largest. Empty if the plan was not simulated.
        flown: the whole plan simulated by IDAS, and the difference.
        between: conditions along the path that a plan by `Collocation` exceeds between the points
            at which they are kept: of each the worst place found at four times as many points.
        multipliers: changes of the cost by the bound of a condition, by "start", "path" or "end"
            and its name, as often as it is kept; "costate of <state>" at the ends of intervals.
        stats: iterations and time (s) of the solver, over all rounds; time_flight and time_build
            (s); variables, equations, nonzeros of the Jacobian, rounds, the solver's message.
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
    outcome: OptimisationOutcome
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
        """Largest relative error of one interval, NaN if the plan was not simulated."""
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
    """Raised by `optimise` if there is no plan.

    The message is the report: what could not be met, where, when and by how much. `solution` holds
    what was reached, as `optimise(..., throw=False)` would return it.
    """

    def __init__(self, solution: Solution) -> None:
        super().__init__(f"{solution.trajectory.name}: {solution.report}")
        self.solution = solution


def read(chain: Chain, x: np.ndarray) -> Plan:
    """Return the plan of a program's variables (n,)."""
    traced, columns = chain.traced, chain.nlp.split(x)
    s = columns[0][traced.model.n_x : traced.model.n_x + traced.n_s, 0]
    phases, body, ends = [], chain.segments(Where.path), chain.segments(Where.end)
    for i in range(traced.n_phases):
        own, part = columns[body[i]], chain.nlp.segments[body[i]]
        interval, mesh = chain.intervals[i], chain.mesh[i]
        t0, length = (float(v) for v in traced.span(i, s))
        x_end = columns[ends[i]][: traced.model.n_x]
        size = interval.dense.size1_in(0)  # without slacks
        found = interval.dense.map(part.count)(own[:size], part.constants)
        saved = (mesh[:-1, None] + np.diff(mesh)[:, None] * interval.saved).reshape(-1)
        count = interval.input_nodes * traced.n_v
        phases.append(
            PhasePlan(
                t0 + length * mesh,
                np.hstack([own[: traced.model.n_x], x_end]),
                own[traced.n_y : traced.n_y + count].T.copy(),
                t0 + length * saved,
                *(np.array(ca.DM(value)) for value in found),
            )
        )
    return Plan(traced, s, tuple(phases))


def pieces(plan: Plan) -> dict[str, Pieces]:
    """Return the Inputs that were found, by name, over all phases."""
    traced, nodes = plan.traced, np.vstack([phase.nodes for phase in plan.phases])
    values = nodes.reshape(len(nodes), -1, max(traced.n_v, 1))
    return {
        label.name: Pieces(plan.edges, values[:, :, j].copy())
        for j, label in enumerate(traced.v_labels)
    }


def trajectory(plan: Plan, moved: list[tuple[np.ndarray, np.ndarray]] | None = None) -> Trajectory:
    """Return the plan as a `Trajectory`; where two phases meet, the later one has the time.

    Arguments:
        moved: other states and unknowns of each phase (n_x, n k + 1), (n_z, n k + 1) at the same
            times.
    """
    model, phases = plan.traced.model, plan.phases
    t = np.concatenate([*(phase.saved_t for phase in phases), phases[-1].t[-1:]])
    if moved is None:
        last = phases[-1]
        x = np.hstack([*(phase.saved_x for phase in phases), last.x[:, -1:]])
        z = np.hstack([*(phase.saved_z for phase in phases), last.saved_z[:, -1:]])
    else:
        x = np.hstack([*(x[:, :-1] for x, _ in moved), moved[-1][0][:, -1:]])
        z = np.hstack([*(z[:, :-1] for _, z in moved), moved[-1][1][:, -1:]])
    values = np.array([float(v) for v in plan.traced.parameters(plan.s)])
    given = {**plan.traced.problem.inputs, **pieces(plan)}
    signals = tuple(given[label.name] for label in model.dae.u_labels)
    experiment = Experiment(t, x[:, 0], z[:, 0], values[: model.n_p], signals, values[model.n_p :])
    result = Run(x.T.copy(), z.T.copy(), False, "", {})
    if model.n_z:
        # Unknowns of the plan are polynomials of a lower degree; outputs take those that balance.
        settle(model, experiment, result)
    end = Outcome.reached_end
    return assemble(model, experiment, result.x, result.z, end, end.value, {})


def multipliers(chain: Chain, answer: NlpAnswer) -> dict[str, np.ndarray]:
    """Changes of the cost by each condition's bound, by "<where> <name>", and costates.

    A costate is the change of the cost by the state, at the ends of intervals after the first.
    """
    found: dict[str, list[float]] = {}
    nlp, n_x = chain.nlp, chain.traced.model.n_x
    for part, (_, top), lam in zip(
        nlp.segments, nlp.offsets, nlp.split(answer.lam_x), strict=False
    ):
        lam_g = part.columns(answer.lam_g[top : top + part.n_g * part.count])
        for j, row in enumerate(part.rows):
            if row.kind is RowKind.motion and j < n_x:
                found.setdefault(f"costate of {row.label.name}", []).extend(-lam_g[j])
            elif not row.kind.is_equation:
                found.setdefault(f"{part.where.value} {row.name}", []).extend(-lam_g[j])
        for j, variable in enumerate(part.variables):
            if np.isfinite(part.low[j]).any() or np.isfinite(part.high[j]).any():
                found.setdefault(f"{part.where.value} {variable.name}", []).extend(-lam[j])
    return {name: np.array(values) for name, values in found.items()}
