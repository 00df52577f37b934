"""The plan flown: each interval integrated by IDAS with the Inputs found."""

from __future__ import annotations

import contextlib
import io
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ..model.trajectory import Trajectory
from .chain import Chain
from .interval import inputs_at, lagrange
from .mesh import basis, control_nodes
from .stage import Frame

RTOL = 1e-10
_ATOL = 1e-12
_SAFETY = 0.1  # as in `integrators.Idas`
_LARGE = 60  # states and unknowns, above which csparse is faster than qr
_FIRST_STEP = 1e-7  # of an interval, with algebraic unknowns


@dataclass(frozen=True, eq=False)
class Flight:
    """What IDAS makes of a plan.

    Fields:
        trajectory: from the plan's start with the plan's Inputs, through all phases.
        difference: largest distance of a state from the plan, relative to the size of the states of
            its unit.
        worst: the state and the time in s of it.
    """

    trajectory: Trajectory
    difference: float
    worst: tuple[str, float]


class FlightFailed(Exception):
    """IDAS stopped on an interval."""


class Pilot:
    """Integrates intervals of a chain from given states."""

    def __init__(self, chain: Chain, degree: int) -> None:
        self.chain, self.frame, self.degree = chain, chain.frame, degree

    def fly(
        self,
        i: int,
        nodes: np.ndarray,
        s: np.ndarray,
        t0: float,
        step: float,
        x: np.ndarray,
        z: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """States and unknowns at the saved points of an interval after its start, and at its end.

        Raises:
            FlightFailed: IDAS stopped.
        """
        p, model = np.concatenate([nodes, s, [t0, step]]), self.frame.model
        given: dict[str, Any] = {}
        if model.n_z:
            arguments = (t0, x, z, self._inputs(nodes, t0), self._parameters(s))
            z, good = model.plain.consistent(*arguments)
            if not good:
                raise FlightFailed("no consistent algebraic unknowns")
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
        first = inputs_at(basis(control_nodes(self.degree), np.zeros(1))[0], nodes, self.frame.n_v)
        return np.array([float(value) for value in self.frame.inputs(t0, first)])

    def _parameters(self, s: np.ndarray) -> np.ndarray:
        values = self.frame.parameters(s)[: self.frame.model.n_p]
        return np.array([float(value) for value in values])

    def _integrator(self, i: int, given: dict[str, Any]) -> ca.Function:
        if given:
            return self._built(i, given)
        return self._without_unknowns[i]

    @cached_property
    def _without_unknowns(self) -> list[ca.Function]:
        return [self._built(i, {}) for i in range(self.frame.n_phases)]

    def _built(self, i: int, given: dict[str, Any]) -> ca.Function:
        model = self.frame.model
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
        frame, model = self.frame, self.frame.model
        rates = frame.rates()
        kind = ca.SX if rates.is_a("SXFunction") else ca.MX
        n_u = frame.n_v * (self.degree + 1)
        x, z = kind.sym("x", model.n_x), kind.sym("z", model.n_z)
        p, tau = kind.sym("p", n_u + frame.n_s + 2), kind.sym("tau")
        t, step = p[-2] + p[-1] * tau, p[-1]
        v = inputs_at(lagrange(control_nodes(self.degree), tau), p[:n_u], frame.n_v)
        ode, alg = rates(t, x, z, v, p[n_u : n_u + frame.n_s])
        return {"t": tau, "x": x, "z": z, "p": p, "ode": step * ode, "alg": alg}


def sizes(frame: Frame, x: np.ndarray) -> np.ndarray:
    """For each state the largest value (n,) of all states with its unit, 1 if that is 0."""
    units = [label.unit for label in frame.model.x_labels]
    top = np.abs(x).max(axis=1)
    largest = {
        unit: max(v for v, own in zip(top, units, strict=True) if own == unit) for unit in units
    }
    return np.array([largest[unit] or 1.0 for unit in units])
