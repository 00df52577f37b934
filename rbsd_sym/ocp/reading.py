"""From the numbers of a program to a plan: states, Inputs, times, multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..integrators.driver import Run, assemble, settle
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from .chain import Chain
from .flight import Flight, Pilot, sizes
from .solution import Pieces
from .solvers import Answer
from .stage import Frame


@dataclass(frozen=True, eq=False)
class Leg:
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
    """What a program's variables mean."""

    frame: Frame
    s: np.ndarray
    legs: tuple[Leg, ...]


def read(chain: Chain, x: np.ndarray) -> Plan:
    """The plan of a program's variables."""
    frame = chain.frame
    columns = [
        x[a : a + part.n_w * part.count].reshape(part.count, part.n_w).T
        for part, (a, _) in zip(chain.nlp.segments, chain.nlp.offsets, strict=False)
    ]
    s = columns[0][frame.model.n_x : frame.model.n_x + frame.n_s, 0]
    legs, body, ends = [], chain.segments("interval"), chain.segments("end")
    for i in range(frame.n_phases):
        own, part = columns[body[i]], chain.nlp.segments[body[i]]
        interval, mesh = chain.intervals[i], chain.mesh[i]
        t0, length = (float(v) for v in frame.span(i, s))
        x_end = columns[ends[i]][: frame.model.n_x]
        size = interval.dense.size1_in(0)  # without slacks
        found = interval.dense.map(part.count)(own[:size], part.constants)
        saved = (mesh[:-1, None] + np.diff(mesh)[:, None] * interval.saved).reshape(-1)
        count = sum(kind == "u" for kind, _ in interval.variables) * frame.n_v
        legs.append(
            Leg(
                t0 + length * mesh,
                np.hstack([own[: frame.model.n_x], x_end]),
                own[frame.n_y : frame.n_y + count].T.copy(),
                t0 + length * saved,
                *(np.array(ca.DM(value)) for value in found),
            )
        )
    return Plan(frame, s, tuple(legs))


def pieces(plan: Plan) -> dict[str, Pieces]:
    """The Inputs that were found, by name, over all phases."""
    frame = plan.frame
    edges = np.concatenate([plan.legs[0].t, *(leg.t[1:] for leg in plan.legs[1:])])
    nodes = np.vstack([leg.nodes for leg in plan.legs])
    values = nodes.reshape(len(nodes), -1, max(frame.n_v, 1))
    return {
        frame.model.dae.u_labels[k].name: Pieces(edges, values[:, :, j].copy())
        for j, k in enumerate(frame.controls)
    }


def trajectory(plan: Plan, legs: list[tuple[np.ndarray, np.ndarray]] | None = None) -> Trajectory:
    """The plan as a `Trajectory`; of two phases that meet, the later one has the common time.

    Arguments:
        legs: other states and unknowns (n_x, n k + 1), (n_z, n k + 1) at the same times.
    """
    frame, model = plan.frame, plan.frame.model
    t = np.concatenate([*(leg.saved_t for leg in plan.legs), plan.legs[-1].t[-1:]])
    if legs is None:
        last = plan.legs[-1]
        x = np.hstack([*(leg.saved_x for leg in plan.legs), last.x[:, -1:]])
        z = np.hstack([*(leg.saved_z for leg in plan.legs), last.saved_z[:, -1:]])
    else:
        x = np.hstack([*(x[:, :-1] for x, _ in legs), legs[-1][0][:, -1:]])
        z = np.hstack([*(z[:, :-1] for _, z in legs), legs[-1][1][:, -1:]])
    own, values = pieces(plan), np.array([float(v) for v in frame.parameters(plan.s)])
    signals = tuple(
        own[v.name] if v.name in own else frame.problem.inputs[v.name] for v in model.dae.u_labels
    )
    experiment = Experiment(t, x[:, 0], z[:, 0], values[: model.n_p], signals, values[model.n_p :])
    result = Run(x.T.copy(), z.T.copy(), False, "", {})
    if model.n_z:
        settle(model, experiment, result)
    end = Outcome.reached_end
    return assemble(model, experiment, result.x, result.z, end, end.value, {})


def flown(chain: Chain, plan: Plan, degree: int) -> tuple[Flight, np.ndarray]:
    """The plan integrated by IDAS, and the error of each interval from the plan's own states.

    Raises:
        FlightFailed: IDAS stopped.
    """
    frame, pilot = plan.frame, Pilot(chain, degree)
    every = np.hstack([leg.saved_x for leg in plan.legs])
    size = sizes(frame, every)[:, None]
    x, z = plan.legs[0].x[:, 0], plan.legs[0].saved_z[:, 0]
    errors, legs = [], []
    for i, leg in enumerate(plan.legs):
        k = len(chain.intervals[i].saved)
        if i and frame.terms[i].link is not None:
            x = _linked(frame, i, leg, plan, x, z)
        xs, zs = [x[:, None]], [z[:, None]]
        for j in range(len(leg.nodes)):
            step = leg.t[j + 1] - leg.t[j]
            given = (i, leg.nodes[j], plan.s, leg.t[j], step)
            own, _ = pilot.fly(*given, leg.saved_x[:, j * k], leg.saved_z[:, j * k])
            wanted = np.hstack([leg.saved_x[:, j * k + 1 : (j + 1) * k], leg.x[:, j + 1 : j + 2]])
            errors.append(float((np.abs(own - wanted) / size).max(initial=0.0)))
            path, unknowns = pilot.fly(*given, x, z)
            xs.append(path)
            zs.append(unknowns)
            x, z = path[:, -1], unknowns[:, -1]
        legs.append((np.hstack(xs), np.hstack(zs)))
    flight = trajectory(plan, legs)
    planned = [np.hstack([leg.saved_x, leg.x[:, -1:]]) for leg in plan.legs]
    return _compared(frame, flight, plan, legs, planned, size), np.array(errors)


def _linked(frame: Frame, i: int, leg: Leg, plan: Plan, x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """States just after the start of a phase, from those just before."""
    link = frame.over("link", frame.terms[i].link)
    v = _last_inputs(plan, i - 1)
    return np.array(link(leg.t[0], x, z, v, plan.s)).reshape(-1)


def _last_inputs(plan: Plan, i: int) -> np.ndarray:
    n_v = plan.frame.n_v
    nodes = plan.legs[i].nodes[-1].reshape(-1, max(n_v, 1))
    piece = [Pieces(np.array([0.0, 1.0]), nodes[None, :, j]) for j in range(n_v)]
    return np.array([float(one.at(0, [1.0])[0]) for one in piece])


def _compared(
    frame: Frame,
    flight: Trajectory,
    plan: Plan,
    legs: list[Any],
    planned: list[Any],
    size: np.ndarray,
) -> Flight:
    found = (0.0, frame.model.x_labels[0].name, float(plan.legs[0].t[0]))
    for leg, (x, _), own in zip(plan.legs, legs, planned, strict=True):
        gap = np.abs(x - own) / size
        k, j = np.unravel_index(int(np.argmax(gap)), gap.shape)
        times = np.append(leg.saved_t, leg.t[-1])
        if gap[k, j] > found[0]:
            found = (float(gap[k, j]), frame.model.x_labels[k].name, float(times[j]))
    return Flight(flight, found[0], (found[1], found[2]))


def multipliers(chain: Chain, answer: Answer) -> dict[str, np.ndarray]:
    """Change of the cost by each condition's bound, by "<where> <name>", and costates.

    A costate is the change of the cost by the state, at the ends of intervals after the first.
    """
    found: dict[str, list[float]] = {}
    n_x = chain.frame.model.n_x
    for kind, part, (a, b) in zip(chain.kinds, chain.nlp.segments, chain.nlp.offsets, strict=False):
        lam_g = answer.lam_g[b : b + part.n_g * part.count].reshape(part.count, part.n_g)
        lam_x = answer.lam_x[a : a + part.n_w * part.count].reshape(part.count, part.n_w)
        where = "path" if kind == "interval" else kind
        for j, label in enumerate(part.rows):
            hidden = label.name.startswith(("rate of ", "balance of "))
            if j < part.n_next:
                if kind == "interval" and j < n_x:
                    name = f"costate of {part.variables[j].name}"
                    found.setdefault(name, []).extend(-lam_g[:, j])
            elif not hidden:
                found.setdefault(f"{where} {label.name}", []).extend(-lam_g[:, j])
        for j, label in enumerate(part.variables):
            bounded = np.isfinite(part.low[j]).any() or np.isfinite(part.high[j]).any()
            if bounded:
                found.setdefault(f"{where} {label.name}", []).extend(-lam_x[:, j])
    return {name: np.array(values) for name, values in found.items()}
