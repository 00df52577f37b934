"""The check of a plan by simulation: IDAS integrates each interval with the Inputs found."""

from __future__ import annotations

import contextlib
import io
import math
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from .chain import Chain
from .mesh import inputs_at
from .plan import Flight, Plan, pieces, trajectory
from .traced import TracedProblem

RTOL = 1e-10
_ATOL = 1e-12
_SAFETY = 0.1  # as in `integrators.Idas`
_LARGE = 60  # states and unknowns, above which csparse is faster than qr
_FIRST_STEP = 1e-7  # of an interval, with algebraic unknowns


class FlightFailed(Exception):
    """IDAS stopped on an interval."""


class IntervalSimulator:
    """Integrates single intervals of a chain by IDAS.

    Each interval starts anew, so that jumps of Inputs between intervals are never stepped over.

    Arguments:
        degree: of the Inputs.
    """

    def __init__(self, chain: Chain, degree: int) -> None:
        self.chain, self.traced, self.degree = chain, chain.traced, degree

    def run(
        self,
        i: int,
        nodes: np.ndarray,
        s: np.ndarray,
        t0: float,
        step: float,
        x: np.ndarray,
        z: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return states and unknowns at the saved points of an interval and at its end, not at t0.

        Arguments:
            i: number of the phase.
            nodes: Inputs at their nodes (n_v (degree + 1),).
            s: constants (n_s,).
            t0, step: start and length of the interval, s.
            x, z: states at its start, and a guess of the unknowns there.

        Raises:
            FlightFailed: IDAS stopped.
        """
        p, model = np.concatenate([nodes, s, [t0, step]]), self.traced.model
        given: dict[str, Any] = {}
        if model.n_z:
            arguments = (t0, x, z, self._inputs(nodes, t0), self._parameters(s))
            z, good = model.plain.consistent(*arguments)
            if not good:
                raise FlightFailed("no consistent algebraic unknowns")
            # IDAS starts from wrong rates unless they are given, and they belong to its options.
            rates = np.array(model.plain.function("ode")(*arguments)).reshape(-1)
            given = {
                "calc_ic": False,
                "init_xdot": [float(step * rate) for rate in rates],
                "suppress_algebraic": True,
                "step0": _FIRST_STEP,
            }
        try:
            with contextlib.redirect_stderr(io.StringIO()):
                result = self._integrator(i, given)(x0=x, z0=z, p=p)
        except RuntimeError as error:
            raise FlightFailed(str(error).strip().splitlines()[-1]) from error
        return np.array(result["xf"]), np.array(result["zf"])

    def _inputs(self, nodes: np.ndarray, t0: float) -> np.ndarray:
        first = inputs_at(self.degree, 0.0, nodes, self.traced.n_v)
        return np.array([float(value) for value in self.traced.inputs(t0, first)])

    def _parameters(self, s: np.ndarray) -> np.ndarray:
        values = self.traced.parameters(s)[: self.traced.model.n_p]
        return np.array([float(value) for value in values])

    def _integrator(self, i: int, given: dict[str, Any]) -> ca.Function:
        if given:
            return self._built(i, given)
        return self._without_unknowns[i]

    @cached_property
    def _without_unknowns(self) -> list[ca.Function]:
        return [self._built(i, {}) for i in range(self.traced.n_phases)]

    def _built(self, i: int, given: dict[str, Any]) -> ca.Function:
        model = self.traced.model
        grid = [float(tau) for tau in (*self.chain.intervals[i].saved[1:], 1.0)]
        scale = _SAFETY / math.sqrt(max(1, model.n_x + model.n_z))
        large = model.n_x + model.n_z > _LARGE
        options = {
            "reltol": RTOL * scale,
            "abstol": _ATOL * scale,
            "max_num_steps": 100_000,
            "linear_solver": "csparse" if large else "qr",
            **given,
        }
        return ca.integrator("fly", "idas", self._dae, 0.0, grid, options)

    @cached_property
    def _dae(self) -> dict[str, Any]:
        """The model over one interval, with tau from 0 to 1 as its time."""
        traced, model = self.traced, self.traced.model
        rates = traced.rates()
        kind = ca.SX if rates.is_a("SXFunction") else ca.MX
        n_u = traced.n_v * (self.degree + 1)
        x, z = kind.sym("x", model.n_x), kind.sym("z", model.n_z)
        p, tau = kind.sym("p", n_u + traced.n_s + 2), kind.sym("tau")
        t, step = p[-2] + p[-1] * tau, p[-1]
        v = inputs_at(self.degree, tau, p[:n_u], traced.n_v)
        ode, alg = rates(t, x, z, v, p[n_u : n_u + traced.n_s])
        return {"t": tau, "x": x, "z": z, "p": p, "ode": step * ode, "alg": alg}


def flown(chain: Chain, plan: Plan, degree: int) -> tuple[Flight, np.ndarray]:
    """Simulate a plan; return the flight, and the error of each interval from the plan's states.

    Every interval is integrated twice: from the plan's own states at its start, for the error of
    the interval alone, and from where the simulation has come, for the flight.

    Raises:
        FlightFailed: IDAS stopped.
    """
    traced, simulator = plan.traced, IntervalSimulator(chain, degree)
    # Errors are relative to the size of states of one unit: a state that stays near zero, such as
    # a lateral deflection, is compared with how far the others move.
    size = _sizes(traced, np.hstack([phase.saved_x for phase in plan.phases]))[:, None]
    x, z = plan.phases[0].x[:, 0], plan.phases[0].saved_z[:, 0]
    errors, moved = [], []
    for i, phase in enumerate(plan.phases):
        k = len(chain.intervals[i].saved)
        if i and traced.terms[i].link is not None:
            x = _linked(plan, i, x, z)
        xs, zs = [x[:, None]], [z[:, None]]
        for j in range(len(phase.nodes)):
            given = (i, phase.nodes[j], plan.s, phase.t[j], phase.t[j + 1] - phase.t[j])
            own, _ = simulator.run(*given, phase.saved_x[:, j * k], phase.saved_z[:, j * k])
            wanted = np.hstack(
                [phase.saved_x[:, j * k + 1 : (j + 1) * k], phase.x[:, j + 1 : j + 2]]
            )
            errors.append(float((np.abs(own - wanted) / size).max(initial=0.0)))
            path, unknowns = simulator.run(*given, x, z)
            xs.append(path)
            zs.append(unknowns)
            x, z = path[:, -1], unknowns[:, -1]
        moved.append((np.hstack(xs), np.hstack(zs)))
    return _compared(plan, moved, size), np.array(errors)


def _linked(plan: Plan, i: int, x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """States just after the start of phase i, from those just before."""
    link = plan.traced.over("link", plan.traced.terms[i].link)
    before = len(np.concatenate([phase.nodes for phase in plan.phases[:i]])) - 1
    v = np.array([float(piece.at(before, [1.0])[0]) for piece in pieces(plan).values()])
    return np.array(link(plan.phases[i].t[0], x, z, v, plan.s)).reshape(-1)


def _compared(plan: Plan, moved: list[Any], size: np.ndarray) -> Flight:
    labels = plan.traced.model.x_labels
    found = (0.0, labels[0].name, float(plan.phases[0].t[0]))
    for phase, (x, _) in zip(plan.phases, moved, strict=True):
        gap = np.abs(x - np.hstack([phase.saved_x, phase.x[:, -1:]])) / size
        k, j = np.unravel_index(int(np.argmax(gap)), gap.shape)
        if gap[k, j] > found[0]:
            times = np.append(phase.saved_t, phase.t[-1])
            found = (float(gap[k, j]), labels[k].name, float(times[j]))
    return Flight(trajectory(plan, moved), found[0], found[1:])


def _sizes(traced: TracedProblem, x: np.ndarray) -> np.ndarray:
    """For each state the largest value (n,) of all states with its unit, 1 if that is 0."""
    units = [label.unit for label in traced.model.x_labels]
    top = np.abs(x).max(axis=1)
    largest = {
        unit: max(v for v, own in zip(top, units, strict=True) if own == unit) for unit in units
    }
    return np.array([largest[unit] or 1.0 for unit in units])
