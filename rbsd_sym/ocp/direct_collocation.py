"""Direct collocation: polynomials on intervals that meet the equations of motion at points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from .between import limits
from .interval import Interval, Refinement, check_method, input_blocks, inputs_at
from .mesh import Intervals, Scheme, basis, same_input, scheme
from .nlp import StageFunctions
from .stage import Frame

_MOST_POINTS = 9  # CasADi has tables up to here
_SAVED = np.array([0.0, 0.25, 0.5, 0.75])
_CHECKED = 4  # places for each point of an interval, at which limits are looked at


@dataclass(frozen=True)
class Collocation:
    """States are polynomials of `degree` on each interval, Inputs of `input_degree`.

    The equations of motion hold at the collocation points. `legendre` has order 2 degree at the
    ends of intervals and keeps the norm of quaternions; `radau` has order 2 degree - 1 and damps
    what is much faster than an interval [Betts 2010, sec. 4.5; Hairer, Wanner 1996, sec. IV.5].
    Conditions along the path hold at the points, those of states also at the ends of intervals;
    `Solution.between` tells where the plan passes them elsewhere.

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
            problem solved again, until IDAS bears it out, and until jumps of bounded Inputs are
            placed as well. None for one solution on the mesh as given.
        rounds: of refinement at most.
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
        check_method(self, self.degree - 1)

    @property
    def refinement(self) -> Refinement | None:
        """When to stop refining."""
        return (
            None if self.refine is None else Refinement(self.refine, self.rounds, self.degree + 1)
        )

    def interval(self, frame: Frame, i: int) -> Interval:
        """A stage of phase i: w = [y; Inputs at their nodes; x, z at each point]."""
        on, point = self._stage(frame, i), frame.point(i)
        limit = limits(frame, i, self.input_degree)
        step, rows, cost = on.length * on.c[0], [], 0
        taus = [float(tau) for tau in on.rule.nodes[1:]]
        for j, tau in enumerate(taus):
            at = (on.time(tau), on.states[j + 1], on.unknowns[j], on.inputs(tau), on.s)
            rate, alg, q, path = point(*at)
            slope = sum(on.rule.slope[j, k] * x for k, x in enumerate(on.states))
            rows += [slope - step * rate, alg, path]
            cost += step * on.rule.weights[j] * q
        extra = [k / (self.path_points + 1) for k in range(1, self.path_points + 1)]
        for tau in extra:
            x, z = on.between(np.array([tau]))
            rows.append(limit.value(on.time(tau), x, z, on.inputs(tau), on.s))
        x_end = sum(on.rule.end[k] * x for k, x in enumerate(on.states))
        handed = on.inputs(1.0) if frame.n_m else type(on.w)(0, 1)
        following = ca.vertcat(x_end, on.s, handed)
        functions = StageFunctions.derived(
            "interval", on.w, on.c, following, ca.vertcat(*rows), cost
        )
        checked = np.arange(1, _CHECKED * self.degree) / (_CHECKED * self.degree)
        return Interval(
            functions,
            variables=input_blocks(self.input_degree)
            + tuple((k, tau) for tau in taus for k in "xz"),
            rows=tuple((k, tau) for tau in taus for k in ("rate", "alg", "path"))
            + tuple(("between", tau) for tau in extra),
            saved=_SAVED,
            dense=ca.Function("dense", [on.w, on.c], on.between(_SAVED)),
            limits=limit,
            checked=checked,
            check=ca.Function("check", [on.w, on.c], on.between(checked)),
        )

    def _stage(self, frame: Frame, i: int) -> _Stage:
        """The symbols of a stage."""
        model = frame.model
        kind = ca.MX if model.kernels else ca.SX
        n_u, n_xz = frame.n_v * (self.input_degree + 1), model.n_x + model.n_z
        w = kind.sym("w", frame.n_y + n_u + n_xz * self.degree)
        c = kind.sym("c", 2)  # length and start of the interval, as fractions of the phase
        x0, s, _ = frame.split(w[: frame.n_y])
        starts = [frame.n_y + n_u + j * n_xz for j in range(self.degree)]
        return _Stage(
            w,
            c,
            s,
            w[frame.n_y : frame.n_y + n_u],
            *frame.span(i, s),
            [x0, *(w[a : a + model.n_x] for a in starts)],
            [w[a + model.n_x : a + n_xz] for a in starts],
            scheme(self.scheme, self.degree),
            self.input_degree,
            frame.n_v,
        )


@dataclass(frozen=True, eq=False)
class _Stage:
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
        return inputs_at(same_input(self.input_degree, tau)[0], self.nodes, self.n_v)

    def between(self, taus: np.ndarray) -> list[Any]:
        """States (n_x, n), unknowns (n_z, n) at places of the interval, by their polynomials."""
        x = ca.horzcat(*self.states) @ ca.DM(basis(self.rule.nodes, taus).T)
        z = ca.horzcat(*self.unknowns) @ ca.DM(basis(self.rule.nodes[1:], taus).T)
        return [x, z]
