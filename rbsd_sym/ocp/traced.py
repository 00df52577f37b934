"""A problem on the symbols of its model: what every transcription is made from."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ..base.symbols import is_number
from ..dae.members import Label, Rotation, RotationKind
from ..formulations import ModelWarning, Quaternion, TaitBryan
from ..model.model import Model
from ..model.signals import symbolic
from ..pipeline import compile_scene
from ..scene.scene import Scene
from .problem import Free, Problem
from .terms import LeftOut, Terms, trace_phases


class Role(Enum):
    """Meaning of a constant of a problem."""

    horizon = auto()
    parameter = auto()
    start = auto()


@dataclass(frozen=True)
class Constant:
    """A number to be found that does not change in time; every block carries it along.

    Fields:
        index: of the phase (horizon), of the parameter in `Dae.parameters`, or of the state.
        label: for people; `start` is where the search begins.
        low, high: bounds.
    """

    role: Role
    index: int
    label: Label
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Turn:
    """A quaternion among the states: the rotation, and its rows (4) in x."""

    rotation: Rotation
    rows: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class TracedProblem:
    """A problem on the symbols of its model.

    Fields:
        terms: costs and conditions of each phase.
        controls: indices of the Inputs that are to be found, v.
        constants: s, the free horizons, the free Params, and of a periodic problem the states at
            the start, in this order.
        cyclic: rows of the states that return, apart from quaternions.
        cyclic_turns: the quaternions that return.
        carries: whether blocks hand on the Inputs at their end, since a condition there depends on
            them.
        notes: what the user should know.
    """

    problem: Problem
    model: Model
    terms: tuple[Terms, ...]
    controls: tuple[int, ...]
    constants: tuple[Constant, ...]
    cyclic: tuple[int, ...]
    cyclic_turns: tuple[Turn, ...]
    carries: bool = False
    notes: tuple[str, ...] = ()

    @property
    def n_phases(self) -> int:
        """Number of phases."""
        return len(self.terms)

    @property
    def n_s(self) -> int:
        """Number of constants."""
        return len(self.constants)

    @property
    def n_v(self) -> int:
        """Number of Inputs that are to be found."""
        return len(self.controls)

    @property
    def n_m(self) -> int:
        """Number of Inputs handed on."""
        return self.n_v if self.carries else 0

    @property
    def n_y(self) -> int:
        """Size of what blocks hand on: states, constants, Inputs."""
        return self.model.n_x + self.n_s + self.n_m

    @property
    def v_labels(self) -> tuple[Label, ...]:
        """Labels of the Inputs that are to be found."""
        return tuple(self.model.dae.u_labels[k] for k in self.controls)

    @cached_property
    def s_start(self) -> np.ndarray:
        """Constants where the search begins (n_s,)."""
        return np.array([c.label.start for c in self.constants], float)

    @cached_property
    def turns(self) -> list[Turn]:
        """The quaternions among the states."""
        return quaternions(self.model)

    def split(self, y: Any) -> tuple[Any, Any, Any]:
        """States, constants and Inputs of what blocks hand on."""
        a, b, c = self.model.n_x, self.model.n_x + self.n_s, self.n_y
        none = type(y)(0, 1)  # an empty slice of a 1 x 1 matrix would not have this shape
        return y[:a], y[a:b] if b > a else none, y[b:c] if c > b else none

    @cached_property
    def _places(self) -> dict[tuple[Role, int], int]:
        """Place of each constant in s, by role and index."""
        return {(c.role, c.index): k for k, c in enumerate(self.constants)}

    def durations(self, s: Any) -> list[Any]:
        """Length of each phase in s."""
        places = [self._places.get((Role.horizon, i)) for i in range(self.n_phases)]
        return [
            phase.horizon if place is None else s[place]
            for phase, place in zip(self.problem.sequence, places, strict=True)
        ]

    def span(self, i: int, s: Any) -> tuple[Any, Any]:
        """Start and length of a phase in s."""
        lengths = self.durations(s)
        return sum(lengths[:i]), lengths[i]

    def parameters(self, s: Any) -> list[Any]:
        """All parameters, those without effect on the motion last."""
        given, found = self.problem.params, []
        for k, label in enumerate(self.model.dae.parameters.labels):
            place = self._places.get((Role.parameter, k))
            own = float(given.get(label.name, label.start)) if place is None else s[place]
            found.append(own)
        return found

    def start_copy(self, s: Any) -> Any:
        """The states at the start, of a periodic problem."""
        return s[self.n_s - self.model.n_x :]

    def inputs(self, t: Any, v: Any) -> list[Any]:
        """All Inputs at a time, from those that are to be found."""
        free = dict(zip(self.controls, (v[i] for i in range(self.n_v)), strict=True))
        given = self._given(t) if len(free) < self.model.n_u else None
        return [free[i] if i in free else given[i] for i in range(self.model.n_u)]  # type: ignore[index]

    @cached_property
    def _given(self) -> ca.Function:
        """Inputs by time, zero where they are to be found."""
        dae, values = self.model.dae, []
        for i, label in enumerate(dae.u_labels):
            value = self.problem.inputs[label.name]
            expr = ca.SX(0) if i in self.controls else _signal(label, value, dae.t)
            values.append(expr)
        return ca.Function("given", [dae.t], [ca.vertcat(*values)])

    @cached_property
    def symbols(self) -> list[ca.SX]:
        """[t, x, z, u, all parameters] of the model, over which terms are written."""
        dae = self.model.dae
        return [dae.t, dae.x, dae.z, dae.u, dae.parameters.symbols]

    def arguments(self, kind: Any) -> list[Any]:
        """New symbols t, x, z, v, s, SX or MX, over which transcriptions are written."""
        sizes = {"t": 1, "x": self.model.n_x, "z": self.model.n_z, "v": self.n_v, "s": self.n_s}
        return [kind.sym(key, size) for key, size in sizes.items()]

    def over(self, name: str, *expressions: ca.SX) -> ca.Function:
        """Function (t, x, z, v, s) of expressions over `symbols`, flat."""
        # Called with numbers for the Inputs and Params that are given, the function comes back
        # with them folded in.
        kernel = ca.Function(name, self.symbols, [ca.densify(e) for e in expressions])
        t, x, z, v, s = arguments = self.arguments(ca.SX)
        none = ca.SX(0, 1)
        u, p = ca.vertcat(none, *self.inputs(t, v)), ca.vertcat(none, *self.parameters(s))
        full = [t, x, z, u, p]
        results = kernel.call([ca.SX(a) for a in full])
        return ca.Function(name, arguments, [ca.cse(r) for r in results])

    def point(self, i: int) -> ca.Function:
        """Function (t, x, z, v, s) -> rates, alg, cost per second, path rows of a phase."""
        dae, terms = self.model.dae, self.terms[i]
        own = (terms.integrand, terms.path.rows.expr)
        if not self.model.kernels:
            return self.over("point", dae.ode, dae.alg, *own)
        rest = self.over("rest", *own)
        arguments = self.arguments(ca.MX)
        return ca.Function("point", arguments, [*self._called(*arguments), *rest(*arguments)])

    def rates(self) -> ca.Function:
        """Function (t, x, z, v, s) -> rates, alg."""
        if not self.model.kernels:
            return self.over("rates", self.model.dae.ode, self.model.dae.alg)
        arguments = self.arguments(ca.MX)
        return ca.Function("rates", arguments, self._called(*arguments))

    def _called(self, t: Any, x: Any, z: Any, v: Any, s: Any) -> list[Any]:
        """Rates and alg by calls of the model's kernels."""
        p = ca.vertcat(ca.MX(0, 1), *self.parameters(s)[: self.model.n_p])
        full = [t, x, z, ca.vertcat(ca.MX(0, 1), *self.inputs(t, v)), p]
        return [ca.densify(self.model.plain.function(name)(*full)) for name in ("ode", "alg")]

    def node(self, *expressions: ca.SX) -> ca.Function:
        """Function (t, x, z, v, s) of expressions and of alg, for the ends of phases."""
        return self.over("node", *expressions, self.model.dae.alg)

    def depends(self, *expressions: ca.SX) -> tuple[bool, bool]:
        """Whether expressions depend on z, and on the Inputs that are to be found, also by z."""
        dae, both = self.model.dae, ca.vertcat(ca.SX(0, 1), *expressions)
        z = bool(self.model.n_z) and ca.depends_on(both, dae.z)
        u = ca.vertcat(ca.SX(0, 1), *(dae.u[i] for i in self.controls))
        direct = bool(self.controls) and ca.depends_on(both, u)
        return z, direct or (z and bool(self.controls) and ca.depends_on(dae.alg, u))


def _signal(label: Label, value: Any, t: ca.SX) -> ca.SX:
    if is_number(value):
        return ca.SX(float(value))
    expr = symbolic(value, t)
    if expr is None:
        raise ValueError(
            f"Problem, input '{label.name}': the function cannot be traced with a symbol; use "
            "numpy functions and rbsd_sym.where instead of branches"
        )
    return ca.SX(expr)


def trace_problem(problem: Problem) -> TracedProblem:
    """Put a problem on the symbols of its model, with all states where it needs one left out.

    Raises:
        ValueError, TypeError: what is wrong with the problem, and where.
    """
    model, notes = problem.model, []
    still = _never_moving(problem)
    try:
        terms = trace_phases(problem, model, still)
    except LeftOut as left:
        model = _whole(model, left.name)
        terms = trace_phases(problem, model, still if problem.starts_fixed else {})
        notes.append(
            f"'{left.name}' was left out of the minimal model; all {model.n_x} states are back"
        )
    controls = tuple(
        i
        for i, label in enumerate(model.dae.u_labels)
        if isinstance(problem.inputs[label.name], Free)
    )
    cyclic, turns = _returning(problem, model)
    traced = TracedProblem(
        problem, model, terms, controls, _constants(problem, model), cyclic, turns
    )
    if any(traced.depends(t.start.rows.expr)[1] for t in terms):
        raise ValueError(
            "Problem, start: a condition that depends on an Input to be found, which may jump; "
            "put it on the path"
        )
    # An Input is a variable of the interval that it acts on. A node behind it can only know its
    # value if that is handed on like a state.
    links = [t.link for t in terms if t.link is not None]
    at_end = [*links, *(e for t in terms for e in (t.end.rows.expr, t.end_cost))]
    return replace(traced, carries=traced.depends(*at_end)[1], notes=tuple(notes))


def check_freedom(traced: TracedProblem) -> None:
    """Check that anything is to be found.

    Raises:
        ValueError: nothing is.
    """
    if not traced.controls and not traced.constants:
        raise ValueError(
            f"model '{traced.model.name}': nothing is to be found; make an Input, a Param or a "
            "horizon Free"
        )


def _never_moving(problem: Problem) -> dict[str, float]:
    """States that provably never move in this problem, with their values.

    Those that a minimal model leaves out, while all of them begin where the model does. With them
    redundant conditions are found, also for a model that keeps all states.
    """
    model = problem.model
    small = _small(model) if problem.starts_fixed else model
    never = len(small.reduction.inertial) if small.reduction else 0
    still = {d.name: d.value for d in small.dropped[:never]}
    moved = {name for phase in problem.sequence for name in (*phase.start, *phase.link)}
    return {} if moved & set(still) else still


def _small(model: Model) -> Model:
    """The minimal model of the same scene, if it is known."""
    if model.reduction is not None or not isinstance(model.scene, Scene):
        return model
    scene = model.scene

    def build() -> Model:
        with warnings.catch_warnings():
            # The user was warned of this scene when the full model was compiled.
            warnings.simplefilter("ignore", ModelWarning)
            return compile_scene(scene, _coordinates(model))

    return model.cached("minimal", build)


def _coordinates(model: Model) -> Quaternion | TaitBryan:
    """The formulation that a model was written with."""
    kinds = {rotation.kind for rotation in model.dae.rotations}
    return Quaternion() if RotationKind.quaternion in kinds else TaitBryan()


def _whole(model: Model, name: str) -> Model:
    """The model with all states, in the same coordinates."""
    if not isinstance(model.scene, Scene):
        raise ValueError(
            f"model '{model.name}': '{name}' was left out; compile the scene with minimal=False"
        )
    return compile_scene(model.scene, _coordinates(model), minimal=False)


def state_rows(model: Model, rows: Sequence[int]) -> tuple[int, ...] | None:
    """Rows in x of states of the full scene, None if one of them is not a state of the model."""
    way = model.dae.expansion
    found = [way.rows[row] if way else row for row in rows]
    places = tuple(row for row in found if row is not None)
    return places if len(places) == len(found) else None


def quaternions(model: Model) -> list[Turn]:
    """The quaternions among the states of a model; one that became an angle is not."""
    found = []
    for rotation in model.dae.rotations:
        rows = state_rows(model, rotation.coordinates)
        if rotation.kind is RotationKind.quaternion and rows:
            found.append(Turn(rotation, rows))
    return found


def _returning(problem: Problem, model: Model) -> tuple[tuple[int, ...], tuple[Turn, ...]]:
    """Rows of the states that return, and quaternions."""
    if not problem.periodic:
        return (), ()
    place = {label.name: i for i, label in enumerate(model.x_labels)}
    wanted: Iterable[str] = place if isinstance(problem.periodic, bool) else problem.periodic
    for name in wanted:
        if name not in place:
            raise ValueError(f"Problem, periodic: no state '{name}'; there are: {', '.join(place)}")
    chosen = {place[name] for name in wanted}
    turns = [turn for turn in quaternions(model) if set(turn.rows) <= chosen]
    for turn in turns:
        chosen -= set(turn.rows)
    return tuple(sorted(chosen)), tuple(turns)


def _constants(problem: Problem, model: Model) -> tuple[Constant, ...]:
    found = []
    for i, phase in enumerate(problem.sequence):
        free = phase.horizon
        if isinstance(free, Free):
            label = Label("", f"horizon of phase {i}", unit="s", start=free.start())
            found.append(Constant(Role.horizon, i, label, free.low, free.high))
    for k, label in enumerate(model.dae.parameters.labels):
        value = problem.params.get(label.name)
        if isinstance(value, Free):
            own = replace(label, start=value.start(label.start))
            found.append(Constant(Role.parameter, k, own, value.low, value.high))
    for k, v in enumerate(model.x_labels if problem.periodic else ()):
        label = Label("", f"start of {v.name}", unit=v.unit, start=v.start)
        found.append(Constant(Role.start, k, label, -np.inf, np.inf))
    return tuple(found)
