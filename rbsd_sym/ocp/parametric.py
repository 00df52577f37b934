"""A problem from any state, for any Params and horizons: what a receding horizon asks for.

Params and horizons that are given become constants of an extended problem, as if they were to be
found; its stages are then written without them among the variables, and with them as arguments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..dae.members import Label
from .chain import Chain, chained
from .guess import from_conditions, from_user
from .interval import Method
from .mesh import meshes
from .nlp import StageFunctions
from .problem import Free, Phase, Problem
from .solution import Solution
from .stage import Frame, framed
from .warm import warm_start

_LONG = 60_000  # instructions, above which calls stay calls
_SHORTEST = 1e-9  # of a horizon: what a Phase takes as a lower bound


@dataclass(frozen=True, eq=False)
class Parametric:
    """A transcribed problem whose first states and Params are arguments.

    Fields:
        chain: at the default state and Params; all states at its start are fixed.
        stages: of each segment, functions of (w, c, p) for f and g as CasADi's `nlp` has them but
            for the y that comes after: `value` is [-next; rows], the Hessian's pattern has the
            whole diagonal.
        p_labels: lengths of the horizons that are given, and Params; `start` is the default.
        state: default of the measured states (n_x,).
    """

    chain: Chain
    stages: tuple[StageFunctions, ...]
    p_labels: tuple[Label, ...]
    state: np.ndarray

    @property
    def frame(self) -> Frame:
        """The problem on its symbols."""
        return self.chain.frame


def parametric(problem: Problem, method: Method, guess: Any = None) -> Parametric:
    """The problem from a measured state, which replaces what `start` of its first phase says.

    Raises:
        ValueError, TypeError: what is wrong with the problem; a periodic one; nothing to be found.
    """
    if problem.periodic:
        raise ValueError(
            "Problem: periodic, so its start is to be found and cannot be measured; give one with "
            "periodic=False"
        )
    first = framed(problem)
    if not first.controls and not first.n_s:
        raise ValueError(
            f"model '{first.model.name}': nothing is to be found; make an Input, a Param or a "
            "horizon Free"
        )
    state = from_conditions(first).x(0, np.zeros(1))[:, 0]
    fixed = _measured(problem, first, state)
    own, wide = framed(fixed), framed(_widened(fixed, first))
    mesh = meshes(method.intervals, own.n_phases)
    start = (
        warm_start(own, guess, mesh, method.input_degree)[0]
        if isinstance(guess, Solution)
        else from_user(own, guess)
    )
    chain = _chain(own, method, mesh, start)
    extended = _chain(wide, method, mesh, from_conditions(wide))
    stages = _Lowering(wide, {label.name for label in own.s_labels})
    flat = not own.model.kernels
    lowered = [
        stages.lowered(f"stage{k}", _flat(part.functions) if flat else part.functions, part.n_next)
        for k, part in enumerate(extended.nlp.segments)
    ]
    return Parametric(chain, tuple(lowered), stages.labels, state)


def _flat(stage: StageFunctions) -> StageFunctions:
    """Without calls, which take most of the time in C; where CasADi can, and it stays short."""
    try:
        found = StageFunctions(
            stage.value.expand(),
            stage.jacobian.expand(),
            stage.gradient.expand(),
            stage.hessian.expand(),
        )
    except RuntimeError:  # an integrator with steps of its own
        return stage
    return found if found.hessian.n_instructions() < _LONG else stage


def _chain(frame: Frame, method: Method, mesh: tuple[np.ndarray, ...], guess: Any) -> Chain:
    return chained(frame, [method.interval(frame, i) for i in range(frame.n_phases)], mesh, guess)


def _measured(problem: Problem, frame: Frame, state: np.ndarray) -> Problem:
    """All states at the start fixed."""
    labels = frame.model.x_labels
    values = {label.name: float(v) for label, v in zip(labels, state, strict=True)}
    phases = [replace(problem.stretches[0], start=values), *problem.stretches[1:]]
    return replace(problem, model=frame.model, phases=phases, fixed_start=False)


def _widened(problem: Problem, frame: Frame) -> Problem:
    """Horizons and Params that are given as constants to be found."""
    dae = frame.model.dae
    params = dict(problem.params)
    for label in dae.parameters.labels:
        value = params.get(label.name, label.start)
        params[label.name] = value if isinstance(value, Free) else Free(float(value))
    return replace(problem, phases=[_open(phase) for phase in problem.stretches], params=params)


def _open(phase: Phase) -> Phase:
    if isinstance(phase.horizon, Free):
        return phase
    length = float(phase.horizon)
    return replace(phase, horizon=Free(length, low=_SHORTEST * length))


class _Lowering:
    """Takes constants out of the variables of stages."""

    def __init__(self, wide: Frame, found: set[str]) -> None:
        names = [label.name for label in wide.s_labels]
        self._n_x, self._n_s, self._n_y = wide.model.n_x, wide.n_s, wide.n_y
        self._taken = [k for k, name in enumerate(names) if name not in found]
        self.labels = tuple(_argument(wide.s_labels[k]) for k in self._taken)

    def lowered(self, name: str, stage: StageFunctions, n_next: int) -> StageFunctions:
        """The stage with arguments (w, c, p)."""
        kind = ca.SX if stage.value.is_a("SXFunction") else ca.MX
        n, taken = stage.value.numel_in(0), [self._n_x + k for k in self._taken]
        kept = _without(n, taken)
        n_rows = stage.value.numel_out(0)
        rows = _without(n_rows, taken if n_next else [])
        n_c = stage.value.numel_in(1)
        w, c, p = kind.sym("w", len(kept)), kind.sym("c", n_c), kind.sym("p", len(taken))
        whole = _placed(kind, n, kept, w, taken, p)
        given = len(rows) - n_rows + n_next  # rows of [-next]
        sign = ca.DM([-1.0 if k < given else 1.0 for k in range(len(rows))])
        both, cost = stage.value(whole, c)
        jacobian = ca.mtimes(ca.diag(sign), stage.jacobian(whole, c)[rows, kept])
        weight, weights = kind.sym("weight"), kind.sym("weights", len(rows))
        zeros = kind.zeros(n_rows - len(rows))
        every = _placed(kind, n_rows, rows, sign * weights, _without(n_rows, rows), zeros)
        hessian = stage.hessian(whole, c, weight, every)[kept, kept]
        pattern = hessian.sparsity() + ca.Sparsity.diag(len(kept))
        symbols, more = [w, c, p], [w, c, p, weight, weights]
        return StageFunctions(
            ca.Function(f"{name}_value", symbols, [ca.densify(sign * both[rows]), cost]),
            ca.Function(f"{name}_jacobian", symbols, [jacobian]),
            ca.Function(f"{name}_gradient", symbols, [ca.densify(stage.gradient(whole, c)[kept])]),
            ca.Function(f"{name}_hessian", more, [ca.project(hessian, pattern)]),
        )


def _argument(label: Label) -> Label:
    head, _, number = label.name.rpartition(" ")
    horizon = head == "horizon of phase"
    return Label("", f"horizon_{number}" if horizon else label.name, "", label.unit, label.start)


def _without(n: int, taken: Sequence[int]) -> list[int]:
    out = set(taken)
    return [k for k in range(n) if k not in out]


def _placed(kind: Any, n: int, kept: Sequence[int], a: Any, taken: Sequence[int], b: Any) -> Any:
    """The column with a at the places kept and b at those taken."""
    if not n:
        return kind(0, 1)
    place = np.argsort([*kept, *taken])
    return ca.densify(ca.vertcat(a, b))[[int(k) for k in place]]
