"""Direct collocation: polynomials on intervals that meet the equations of motion at points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from .frame import Frame
from .interval import Interval, Refinement, check_method, input_blocks, inputs_at
from .mesh import Intervals, basis, same_input, scheme
from .nlp import StageFunctions

_MOST_POINTS = 9  # CasADi has tables up to here
_SAVED = np.array([0.0, 0.25, 0.5, 0.75])


@dataclass(frozen=True)
class Collocation:
    """States are polynomials of `degree` on each interval, Inputs of `input_degree`.

    The equations of motion hold at the collocation points. `legendre` has order 2 degree at the
    ends of intervals and keeps the norm of quaternions; `radau` has order 2 degree - 1 and damps
    what is much faster than an interval [Betts 2010, sec. 4.5; Hairer, Wanner 1996, sec. IV.5].
    Conditions along the path hold at the points, those of states also at the ends of intervals.

    Arguments:
        intervals: number of equal intervals; or for each phase a number, or increasing fractions
            from 0 to 1.
        degree: 1 ... 9.
        scheme: "radau" or "legendre".
        input_degree: 0 for Inputs constant on each interval; at most degree - 1. Inputs may jump
            from one interval to the next.
        refine: largest relative error of one interval that is wanted. The mesh is refined, and the
            problem solved again, until IDAS bears it out, and until jumps of bounded Inputs are
            placed as well. None for one solution on the mesh as given.
        rounds: of refinement at most.
    """

    intervals: Intervals = 20
    degree: int = 3
    scheme: str = "legendre"
    input_degree: int = 0
    refine: float | None = None
    rounds: int = 12

    def __post_init__(self) -> None:
        if self.degree not in range(1, _MOST_POINTS + 1):
            raise ValueError(f"Collocation: degree {self.degree!r}; it is 1 ... {_MOST_POINTS}")
        if self.scheme not in ("radau", "legendre"):
            raise ValueError(f"Collocation: scheme {self.scheme!r}; it is 'radau' or 'legendre'")
        check_method(self, self.degree - 1)

    @property
    def refinement(self) -> Refinement | None:
        """When to stop refining."""
        return (
            None if self.refine is None else Refinement(self.refine, self.rounds, self.degree + 1)
        )

    def interval(self, frame: Frame, i: int) -> Interval:
        """A stage of phase i: w = [y; Inputs at their nodes; x, z at each point]."""
        model, point, rule = frame.model, frame.point(i), scheme(self.scheme, self.degree)
        kind = ca.SX if point.is_a("SXFunction") else ca.MX
        n_u, n_xz = frame.n_v * (self.input_degree + 1), model.n_x + model.n_z
        w = kind.sym("w", frame.n_y + n_u + n_xz * self.degree)
        c = kind.sym("c", 2)  # length and start of the interval, as fractions of the phase
        x0, s, _ = frame.split(w[: frame.n_y])
        nodes = w[frame.n_y : frame.n_y + n_u]
        t0, length = frame.span(i, s)
        step, rows, cost = length * c[0], [], kind(0)
        states, unknowns = [x0], []
        for j in range(self.degree):
            a = frame.n_y + n_u + j * n_xz
            states.append(w[a : a + model.n_x])
            unknowns.append(w[a + model.n_x : a + n_xz])
        for j in range(self.degree):
            tau = rule.nodes[j + 1]
            v = inputs_at(same_input(self.input_degree, tau)[0], nodes, frame.n_v)
            t = t0 + length * (c[1] + c[0] * tau)
            rate, alg, q, path = point(t, states[j + 1], unknowns[j], v, s)
            slope = sum(rule.slope[j, k] * x for k, x in enumerate(states))
            rows += [slope - step * rate, alg, path]
            cost += step * rule.weights[j] * q
        x_end = sum(rule.end[k] * x for k, x in enumerate(states))
        v_end = inputs_at(same_input(self.input_degree, 1.0)[0], nodes, frame.n_v)
        following = ca.vertcat(x_end, s, v_end[: frame.n_m] if frame.n_m else kind(0, 1))
        functions = StageFunctions.derived("interval", w, c, following, ca.vertcat(*rows), cost)
        taus = [float(tau) for tau in rule.nodes[1:]]
        return Interval(
            functions,
            variables=input_blocks(self.input_degree)
            + tuple((k, tau) for tau in taus for k in "xz"),
            rows=tuple((k, tau) for tau in taus for k in ("rate", "alg", "path")),
            saved=_SAVED,
            dense=self._dense(w, c, states, unknowns, rule.nodes),
        )

    def _dense(
        self, w: Any, c: Any, states: list[Any], unknowns: list[Any], nodes: np.ndarray
    ) -> ca.Function:
        """(w, c) -> x, z at the saved points, by their polynomials."""
        x = ca.horzcat(*states) @ ca.DM(basis(nodes, _SAVED).T)
        z = ca.horzcat(*unknowns) @ ca.DM(basis(nodes[1:], _SAVED).T)
        return ca.Function("dense", [w, c], [x, z])
