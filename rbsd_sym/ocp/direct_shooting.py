"""Multiple shooting: each interval integrated by a method of its own, with exact derivatives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from ..base import tableau
from ..integrators import Rosenbrock
from .conditions import limits
from .mesh import Interval, Intervals, Refinement, check_method, input_groups, inputs_at
from .nlp import BlockFunctions, RowKind
from .traced import TracedProblem

_RK4 = np.array(
    [[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1.0, 0], [1 / 6, 1 / 3, 1 / 3, 1 / 6]]
)
_RK4_NODES = np.array([0, 0.5, 0.5, 1.0])
_HIGHEST = 5  # degree of the Inputs


@dataclass(frozen=True)
class Shooting:
    """Multiple shooting: each interval is integrated from states that are variables.

    Explicit steps are of the classical method of order 4, or of order 8 [Hairer, Norsett, Wanner
    1993]; they are stable while step times frequency stays below 2.8, or 5.5. `Rosenbrock` is for
    stiff models and algebraic unknowns. It chooses its own steps; since the result is not smooth
    where their number changes, its tolerances should be much smaller than the solver's. Conditions
    along the path hold at the ends of steps. For example `optimise(problem, Shooting(20, steps=2,
    order=8))`.

    Arguments:
        intervals: as in `Collocation`.
        steps: equal steps of an interval.
        order: 4 or 8.
        integrator: a `Rosenbrock(rtol, atol)` instead of explicit steps; `steps` is then the
            number of points at which conditions along the path hold.
        input_degree, refine, rounds: as in `Collocation`.

    Raises:
        ValueError: options that make no sense; when used, a model with algebraic unknowns and
            explicit steps.
    """

    intervals: Intervals = 20
    steps: int = 4
    order: int = 4
    integrator: Rosenbrock | None = None
    input_degree: int = 0
    refine: float | None = None
    rounds: int = 12

    def __post_init__(self) -> None:
        if not isinstance(self.steps, int) or self.steps < 1:
            raise ValueError(f"Shooting: steps {self.steps!r}; a whole number above 0")
        if self.order not in (4, 8):
            raise ValueError(f"Shooting: order {self.order!r}; it is 4 or 8")
        if self.integrator is not None and not isinstance(self.integrator, Rosenbrock):
            raise TypeError(
                f"Shooting: integrator {self.integrator!r}; give Rosenbrock(rtol, atol), or steps "
                "and order of an explicit method"
            )
        check_method("Shooting", self, _HIGHEST)

    @property
    def refinement(self) -> Refinement | None:
        """Rule for when to stop refining."""
        return None if self.refine is None else Refinement(self.refine, self.rounds, self.order)

    @property
    def _taus(self) -> np.ndarray:
        return np.arange(self.steps + 1) / self.steps

    def interval(self, traced: TracedProblem, i: int) -> Interval:
        """Write the block of phase i: w = [y; Inputs at their nodes].

        Raises:
            ValueError: explicit steps for a model with algebraic unknowns.
        """
        model = traced.model
        if model.n_z and self.integrator is None:
            raise ValueError(
                f"model '{model.name}': {model.n_z} algebraic unknowns, which explicit steps do "
                "not solve; use Shooting(integrator=Rosenbrock()) or Collocation()"
            )
        n_u = traced.n_v * (self.input_degree + 1)
        w, c = ca.MX.sym("w", traced.n_y + n_u), ca.MX.sym("c", 2)
        x, s, _ = traced.split(w[: traced.n_y])
        nodes = w[traced.n_y :]
        t0, length = traced.span(i, s)
        start, step = t0 + length * c[1], length * c[0]
        march = self._rosenbrock if self.integrator else self._explicit
        states, unknowns, cost = march(traced, i, x, nodes, s, start, step)
        limit, rows = limits(traced, i, self.input_degree), []
        for j, tau in enumerate(self._taus[1:]):
            v = inputs_at(self.input_degree, tau, nodes, traced.n_v)
            at = (start + step * tau, states[j + 1], unknowns[j + 1], v, s)
            # States at the end of the interval are the next block's variables, and have their
            # bounds there; rows for them here would be redundant.
            rows.append(limit.value(*at) if tau < 1 else traced.point(i)(*at)[3])
        v_end = inputs_at(self.input_degree, 1.0, nodes, traced.n_v)
        handed = v_end if traced.n_m else ca.MX(0, 1)
        following = ca.vertcat(states[-1], s, handed)
        dense = ca.Function("dense", [w, c], [ca.horzcat(*states[:-1]), ca.horzcat(*unknowns[:-1])])
        return Interval(
            BlockFunctions.derived("interval", w, c, following, ca.vertcat(*rows), cost),
            variables=input_groups(self.input_degree),
            rows=(*((RowKind.limit, float(tau)) for tau in self._taus[1:-1]), (RowKind.path, 1.0)),
            saved=self._taus[:-1],
            dense=dense,
            limits=limit,
            checked=self._taus[:-1],
            check=dense,
        )

    def _explicit(
        self, traced: TracedProblem, i: int, x: Any, nodes: Any, s: Any, start: Any, step: Any
    ) -> tuple[list[Any], list[Any], Any]:
        """States and unknowns at the ends of steps, and the cost of the interval."""
        one, cost, states = self._step(traced, i), ca.MX(0), [x]
        for tau in self._taus[:-1]:
            x, q = one(float(tau), x, nodes, s, start, step)
            cost += q
            states.append(x)
        return states, [ca.MX(0, 1)] * len(states), cost

    def _step(self, traced: TracedProblem, i: int) -> ca.Function:
        """Function (place on the interval, x, nodes, s, start, length) -> x after a step, cost."""
        point = traced.point(i)
        kind = ca.SX if point.is_a("SXFunction") else ca.MX
        sizes = {
            "tau": 1,
            "x": traced.model.n_x,
            "nodes": traced.n_v * (self.input_degree + 1),
            "s": traced.n_s,
            "start": 1,
            "length": 1,
        }
        tau, x, nodes, s, start, length = symbols = [kind.sym(k, n) for k, n in sizes.items()]
        table, when = self._table
        share = 1 / self.steps
        slopes: list[tuple[Any, Any]] = []
        z = kind(0, 1)
        for row, node in zip(table[:-1], when, strict=True):
            place = tau + share * node
            v = inputs_at(self.input_degree, place, nodes, traced.n_v)
            moved = x + share * length * _combined(row, [slope for slope, _ in slopes])
            rate, _, q, _ = point(start + length * place, moved, z, v, s)
            slopes.append((rate, q))
        ends = [_combined(table[-1], [part[k] for part in slopes]) for k in (0, 1)]
        after = [x + share * length * ends[0], share * length * ends[1]]
        return ca.Function("step", symbols, after)

    @property
    def _table(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows of Runge-Kutta coefficients, the last one for the end; and the nodes."""
        if self.order == 4:
            return _RK4, _RK4_NODES
        n = tableau.N_STAGES
        return tableau.A[: n + 1, :n], tableau.C[:n]

    def _rosenbrock(
        self, traced: TracedProblem, i: int, x: Any, nodes: Any, s: Any, start: Any, step: Any
    ) -> tuple[list[Any], list[Any], Any]:
        """States and unknowns at the points of an interval, and its cost, by CasADi's method."""
        model, point, method = traced.model, traced.point(i), self.integrator or Rosenbrock()
        kind = ca.SX if point.is_a("SXFunction") else ca.MX
        n_u = traced.n_v * (self.input_degree + 1)
        # Time runs over the interval as tau from 0 to 1, since CasADi's integrator has a fixed end
        # and the length may be free: x' and the cost are multiplied by the length.
        own_x, own_z = kind.sym("x", model.n_x), kind.sym("z", model.n_z)
        p, tau = kind.sym("p", n_u + traced.n_s + 2), kind.sym("tau")
        v = inputs_at(self.input_degree, tau, p[:n_u], traced.n_v)
        t = p[-2] + p[-1] * tau
        rate, alg, q, _ = point(t, own_x, own_z, v, p[n_u : n_u + traced.n_s])
        dae = {
            "t": tau,
            "x": own_x,
            "z": own_z,
            "p": p,
            "ode": p[-1] * rate,
            "alg": alg,
            "quad": p[-1] * q,
        }
        options = {"reltol": method.rtol, "abstol": method.atol, **method.casadi_options}
        grid = [float(value) for value in self._taus[1:]]
        solve = ca.integrator("interval", "rosenbrock", dae, 0.0, grid, options)
        found = solve(x0=x, z0=_start_unknowns(traced), p=ca.vertcat(nodes, s, start, step))
        states = [x, *ca.horzsplit(found["xf"])]
        unknowns = ca.horzsplit(found["zf"]) if model.n_z else [ca.MX(0, 1)] * self.steps
        return states, [unknowns[0], *unknowns], found["qf"][:, -1]


def _combined(row: np.ndarray, values: list[Any]) -> Any:
    """Add up the values weighted by a row, without its zeros."""
    parts = [float(a) * value for a, value in zip(row, values, strict=False) if a]
    return sum(parts[1:], parts[0]) if parts else 0.0


def _start_unknowns(traced: TracedProblem) -> np.ndarray:
    """Start of Newton's method for the algebraic unknowns (n_z,)."""
    values = [float(value) for value in traced.parameters(traced.s_start)[: traced.model.n_p]]
    return traced.model.dae.start_values(np.array(values))[1]
