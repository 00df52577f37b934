"""Direct collocation: polynomials on intervals that meet the equations of motion at points."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import casadi as ca
import numpy as np

from .conditions import limits
from .mesh import (
    Interval,
    Intervals,
    Refinement,
    Scheme,
    basis,
    check_method,
    input_groups,
    inputs_at,
    scheme,
)
from .nlp import BlockFunctions, RowKind
from .traced import TracedProblem

_MOST_POINTS = 9  # CasADi has tables up to here
_SAVED = np.array([0.0, 0.25, 0.5, 0.75])
_CHECKED = 4  # places for each point of an interval, at which limits are checked


@dataclass(frozen=True, repr=False)
class DirectCollocation:
    """Direct collocation, public as `rs.ocp.Collocation`.

    On each interval states are polynomials of `degree`, Inputs of `input_degree`. The equations of
    motion hold at the collocation points. `legendre` has order 2 degree at the ends of intervals
    and keeps the norm of quaternions; `radau` has order 2 degree - 1 and damps what is much faster
    than an interval [Betts 2010, sec. 4.5; Hairer, Wanner 1996, sec. IV.5]. Conditions along the
    path hold at the points, those of states also at the ends of intervals; `Solution.between` says
    where the plan passes them elsewhere. For example `optimise(problem, Collocation(30, degree=4,
    refine=1e-6))`.

    Arguments:
        intervals: number of equal intervals; or for each phase a number, or increasing fractions
            from 0 to 1.
        degree: 1 ... 9.
        scheme: "radau" or "legendre".
        input_degree: 0 for Inputs constant on each interval; at most degree - 1. Inputs may jump
            from one interval to the next.
        path_points: further points, evenly over each interval, at which all conditions along the
            path hold.
        refine: largest relative error of one interval that is wanted. The mesh is refined, and the
            problem solved again, until a simulation by IDAS confirms it, and until jumps of bounded
            Inputs are placed as well. None for one solution on the mesh as given.
        rounds: of refinement at most.

    Raises:
        ValueError: options out of these ranges.
    """

    intervals: Intervals = 20
    degree: int = 3
    scheme: str = "legendre"
    input_degree: int = 0
    path_points: int = 0
    refine: float | None = None
    rounds: int = 12

    def __post_init__(self) -> None:
        if self.degree not in range(1, _MOST_POINTS + 1):
            raise ValueError(f"Collocation: degree {self.degree!r}; it is 1 ... {_MOST_POINTS}")
        if self.scheme not in ("radau", "legendre"):
            raise ValueError(f"Collocation: scheme {self.scheme!r}; it is 'radau' or 'legendre'")
        if not isinstance(self.path_points, int) or self.path_points < 0:
            raise ValueError(f"Collocation: path_points {self.path_points!r}; a whole number >= 0")
        check_method("Collocation", self, self.degree - 1)

    def __repr__(self) -> str:
        given = ", ".join(f"{f.name}={getattr(self, f.name)!r}" for f in fields(self))
        return f"Collocation({given})"

    @property
    def refinement(self) -> Refinement | None:
        """Rule for when to stop refining."""
        return (
            None if self.refine is None else Refinement(self.refine, self.rounds, self.degree + 1)
        )

    def interval(self, traced: TracedProblem, i: int) -> Interval:
        """Write the block of phase i: w = [y; Inputs at their nodes; x, z at each point].

        At each point tau_j the polynomials through the states meet the equations of motion, and
        the quadrature through the points adds up the cost:

            sum_k slope_jk x_k = step ode_j,   0 = alg_j,   cost = step sum_j weight_j integrand_j
        """
        on, point = self._symbols(traced, i), traced.point(i)
        limit = limits(traced, i, self.input_degree)
        step, rows, cost = on.length * on.c[0], [], 0
        taus = [float(tau) for tau in on.rule.nodes[1:]]
        for j, tau in enumerate(taus):
            at = (on.time(tau), on.states[j + 1], on.unknowns[j], on.inputs(tau), on.s)
            rate, alg, q, path = point(*at)
            slope = sum(on.rule.slope[j, k] * x for k, x in enumerate(on.states))
            rows += [slope - step * rate, alg, path]
            cost += step * on.rule.weights[j] * q
        # Conditions of states, unknowns and Inputs are bounds of variables at the points; between
        # points they are rows, like all others.
        extra = [k / (self.path_points + 1) for k in range(1, self.path_points + 1)]
        for tau in extra:
            x, z = on.between(np.array([tau]))
            rows.append(limit.value(on.time(tau), x, z, on.inputs(tau), on.s))
        # Legendre points leave out the end, where the polynomial through all nodes is evaluated;
        # the last Radau point is the end, and the weights pick it.
        x_end = sum(on.rule.end[k] * x for k, x in enumerate(on.states))
        handed = on.inputs(1.0) if traced.n_m else type(on.w)(0, 1)
        following = ca.vertcat(x_end, on.s, handed)
        functions = BlockFunctions.derived(
            "interval", on.w, on.c, following, ca.vertcat(*rows), cost
        )
        checked = np.arange(1, _CHECKED * self.degree) / (_CHECKED * self.degree)
        return Interval(
            functions,
            variables=input_groups(self.input_degree)
            + tuple((group, tau) for tau in taus for group in "xz"),
            rows=tuple(
                (k, tau) for tau in taus for k in (RowKind.rate, RowKind.balance, RowKind.path)
            )
            + tuple((RowKind.limit, tau) for tau in extra),
            saved=_SAVED,
            dense=ca.Function("dense", [on.w, on.c], on.between(_SAVED)),
            limits=limit,
            checked=checked,
            check=ca.Function("check", [on.w, on.c], on.between(checked)),
        )

    def _symbols(self, traced: TracedProblem, i: int) -> _Symbols:
        """Make the symbols of a block."""
        model = traced.model
        kind = ca.MX if model.kernels else ca.SX
        n_u, n_xz = traced.n_v * (self.input_degree + 1), model.n_x + model.n_z
        w = kind.sym("w", traced.n_y + n_u + n_xz * self.degree)
        c = kind.sym("c", 2)  # length and start of the interval, as fractions of the phase
        x0, s, _ = traced.split(w[: traced.n_y])
        starts = [traced.n_y + n_u + j * n_xz for j in range(self.degree)]
        return _Symbols(
            w,
            c,
            s,
            w[traced.n_y : traced.n_y + n_u],
            *traced.span(i, s),
            [x0, *(w[a : a + model.n_x] for a in starts)],
            [w[a + model.n_x : a + n_xz] for a in starts],
            scheme(self.scheme, self.degree),
            self.input_degree,
            traced.n_v,
        )


@dataclass(frozen=True, eq=False)
class _Symbols:
    """Symbols: variables, constants, Inputs at nodes, states at 0 and the points, unknowns."""

    w: Any
    c: Any
    s: Any
    nodes: Any
    t0: Any
    length: Any
    states: list[Any]
    unknowns: list[Any]
    rule: Scheme
    input_degree: int
    n_v: int

    def time(self, tau: float) -> Any:
        """Time at a place of the interval."""
        return self.t0 + self.length * (self.c[1] + self.c[0] * tau)

    def inputs(self, tau: float) -> Any:
        """Inputs that are to be found, there."""
        return inputs_at(self.input_degree, tau, self.nodes, self.n_v)

    def between(self, taus: np.ndarray) -> list[Any]:
        """States (n_x, n), unknowns (n_z, n) at places of the interval, by their polynomials."""
        x = ca.horzcat(*self.states) @ ca.DM(basis(self.rule.nodes, taus).T)
        # Unknowns have no value at the start of an interval: their degree is lower by one.
        z = ca.horzcat(*self.unknowns) @ ca.DM(basis(self.rule.nodes[1:], taus).T)
        return [x, z]
