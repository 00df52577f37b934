"""A problem from any state, for any Params and horizons: what a receding horizon asks for.

Params and horizons that are given become constants of an extended problem, as if they were to be
found; its blocks are then written without them among the variables, and with them as arguments.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ..dae.members import Label
from .chain import Chain, Guess, chained
from .guess import first_guess, from_conditions
from .mesh import Method, meshes
from .nlp import BlockFunctions
from .problem import Free, Phase, Problem
from .traced import Constant, Role, TracedProblem, check_freedom, trace_problem

_LONG = 60_000  # instructions, above which calls stay calls
_SHORTEST = 1e-9  # of a horizon: what a Phase takes as a lower bound


@dataclass(frozen=True, eq=False)
class Parametric:
    """A transcribed problem whose first states and Params are arguments.

    Fields:
        chain: at the default state and Params; all states at its start are fixed.
        blocks: of each segment, functions of (w, c, p) for f and g as CasADi's `nlp` has them but
            for the y that comes after: `value` is [-next; rows], the Hessian's pattern has the
            whole diagonal.
        p_labels: lengths of the horizons that are given, and Params; `start` is the default.
        state: default of the measured states (n_x,).
    """

    chain: Chain
    blocks: tuple[BlockFunctions, ...]
    p_labels: tuple[Label, ...]
    state: np.ndarray

    @property
    def traced(self) -> TracedProblem:
        """The problem on its symbols."""
        return self.chain.traced

    @property
    def name(self) -> str:
        """Name of the files in C, and prefix of the functions."""
        return f"{self.traced.model.name}_ocp"


def parametric(problem: Problem, method: Method, guess: Any = None) -> Parametric:
    """Transcribe a problem from a measured state, which replaces `start` of its first phase.

    Raises:
        ValueError, TypeError: what is wrong with the problem; a periodic one; nothing to be found.
    """
    if problem.periodic:
        raise ValueError(
            "Problem: periodic, so its start is to be found and cannot be measured; give one with "
            "periodic=False"
        )
    first = trace_problem(problem)
    check_freedom(first)
    state = from_conditions(first).x(0, np.zeros(1))[:, 0]
    fixed = _measured(problem, first, state)
    # `own` gives the variables and their bounds, `wide` the functions: its chain has the same
    # blocks, with all Params and horizons among the constants.
    own, wide = trace_problem(fixed), trace_problem(_widened(fixed))
    mesh = meshes(method.intervals, own.n_phases)
    start, _ = first_guess(own, guess, mesh, method.input_degree)
    chain = _chain(own, method, mesh, start)
    extended = _chain(wide, method, mesh, from_conditions(wide))
    lowering, flat = _Lowering(wide, own), not own.model.kernels
    blocks = [
        lowering.lowered(
            f"stage{k}", _flat(part.functions) if flat else part.functions, part.n_next
        )
        for k, part in enumerate(extended.nlp.segments)
    ]
    return Parametric(chain, tuple(blocks), lowering.labels, state)


def _flat(block: BlockFunctions) -> BlockFunctions:
    """Return a block without calls, which take most of the time in C.

    It comes back as it is if CasADi cannot write its calls out, or if that would be long.
    """
    try:
        found = BlockFunctions(
            block.value.expand(),
            block.jacobian.expand(),
            block.gradient.expand(),
            block.hessian.expand(),
        )
    except RuntimeError:  # an integrator with steps of its own
        return block
    return found if found.hessian.n_instructions() < _LONG else block


def _chain(
    traced: TracedProblem, method: Method, mesh: tuple[np.ndarray, ...], guess: Guess
) -> Chain:
    return chained(
        traced, [method.interval(traced, i) for i in range(traced.n_phases)], mesh, guess
    )


def _measured(problem: Problem, traced: TracedProblem, state: np.ndarray) -> Problem:
    """The problem with all states at the start fixed."""
    labels = traced.model.x_labels
    values = {label.name: float(v) for label, v in zip(labels, state, strict=True)}
    phases = [replace(problem.sequence[0], start=values), *problem.sequence[1:]]
    return replace(problem, model=traced.model, phases=phases, fixed_start=False)


def _widened(problem: Problem) -> Problem:
    """The problem with the horizons and Params that are given as constants to be found."""
    params = dict(problem.params)
    for label in problem.model.dae.parameters.labels:
        value = params.get(label.name, label.start)
        params[label.name] = value if isinstance(value, Free) else Free(float(value))
    return replace(problem, phases=[_open(phase) for phase in problem.sequence], params=params)


def _open(phase: Phase) -> Phase:
    if isinstance(phase.horizon, Free):
        return phase
    length = float(phase.horizon)
    return replace(phase, horizon=Free(length, low=_SHORTEST * length))


class _Lowering:
    """Takes constants out of the variables of blocks: those of `wide` that `own` does not find."""

    def __init__(self, wide: TracedProblem, own: TracedProblem) -> None:
        found = {(c.role, c.index) for c in own.constants}
        taken = [k for k, c in enumerate(wide.constants) if (c.role, c.index) not in found]
        self._taken = [wide.model.n_x + k for k in taken]  # places in y
        self.labels = tuple(_argument(wide.constants[k]) for k in taken)

    def lowered(self, name: str, block: BlockFunctions, n_next: int) -> BlockFunctions:
        """Return the block with arguments (w, c, p)."""
        kind = ca.SX if block.value.is_a("SXFunction") else ca.MX
        n, taken = block.value.numel_in(0), self._taken
        kept = _without(n, taken)
        n_rows = block.value.numel_out(0)
        rows = _without(n_rows, taken if n_next else [])
        n_c = block.value.numel_in(1)
        w, c, p = kind.sym("w", len(kept)), kind.sym("c", n_c), kind.sym("p", len(taken))
        whole = _placed(kind, n, kept, w, taken, p)
        given = len(rows) - n_rows + n_next  # rows of [-next]
        # Rows that hand on a constant to itself go with it. Those that stay are -next in g.
        sign = ca.DM([-1.0 if k < given else 1.0 for k in range(len(rows))])
        both, cost = block.value(whole, c)
        jacobian = ca.mtimes(ca.diag(sign), block.jacobian(whole, c)[rows, kept])
        weight, weights = kind.sym("weight"), kind.sym("weights", len(rows))
        zeros = kind.zeros(n_rows - len(rows))
        every = _placed(kind, n_rows, rows, sign * weights, _without(n_rows, rows), zeros)
        # The solver shifts the Hessian's diagonal, so that its pattern must hold all of it.
        hessian = block.hessian(whole, c, weight, every)[kept, kept]
        pattern = hessian.sparsity() + ca.Sparsity.diag(len(kept))
        symbols, more = [w, c, p], [w, c, p, weight, weights]
        return BlockFunctions(
            ca.Function(f"{name}_value", symbols, [ca.densify(sign * both[rows]), cost]),
            ca.Function(f"{name}_jacobian", symbols, [jacobian]),
            ca.Function(f"{name}_gradient", symbols, [ca.densify(block.gradient(whole, c)[kept])]),
            ca.Function(f"{name}_hessian", more, [ca.project(hessian, pattern)]),
        )


def _argument(constant: Constant) -> Label:
    """Label of a constant as an argument in C."""
    if constant.role is Role.horizon:
        return replace(constant.label, quantity=f"horizon_{constant.index}")
    return constant.label


def _without(n: int, taken: Sequence[int]) -> list[int]:
    out = set(taken)
    return [k for k in range(n) if k not in out]


def _placed(kind: Any, n: int, kept: Sequence[int], a: Any, taken: Sequence[int], b: Any) -> Any:
    """The column with a at the places kept and b at those taken."""
    if not n:
        return kind(0, 1)
    place = np.argsort([*kept, *taken])
    return ca.densify(ca.vertcat(a, b))[[int(k) for k in place]]
