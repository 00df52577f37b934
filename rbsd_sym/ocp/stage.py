"""A problem on its symbols: what every transcription is made from."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ..base.symbols import is_number
from ..dae.members import Label
from ..formulations import ModelWarning, Quaternion, TaitBryan
from ..model.model import Model
from ..model.signals import symbolic
from ..pipeline import compile_scene
from ..scene.scene import Scene
from .names import LeftOut
from .problem import Free, Problem
from .terms import Terms, traced


@dataclass(frozen=True, eq=False)
class Frame:
    """A problem on the symbols of its model.

    Constants s, which every stage of the transcription carries along, are the free horizons, the
    free Params, and of a periodic problem the states at the start.

    Fields:
        controls: indices of the Inputs that are to be found.
        s_labels, s_low, s_high: constants; `start` of a label is its guess.
        cyclic: rows of the states that return, apart from quaternions.
        cyclic_turns: rows (4) of each quaternion that returns.
        carries: whether stages hand on the Inputs at their end, since a condition there feels them.
        notes: what the user should know.
    """

    problem: Problem
    model: Model
    terms: tuple[Terms, ...]
    controls: tuple[int, ...]
    s_labels: tuple[Label, ...]
    s_low: np.ndarray
    s_high: np.ndarray
    cyclic: tuple[int, ...]
    cyclic_turns: tuple[tuple[int, ...], ...]
    carries: bool
    notes: tuple[str, ...] = ()

    @property
    def n_phases(self) -> int:
        """Number of phases."""
        return len(self.terms)

    @property
    def n_s(self) -> int:
        """Number of constants."""
        return len(self.s_labels)

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
        """Size of what stages hand on: states, constants, Inputs."""
        return self.model.n_x + self.n_s + self.n_m

    def split(self, y: Any) -> tuple[Any, Any, Any]:
        """States, constants and Inputs of what stages hand on."""
        a, b, c = self.model.n_x, self.model.n_x + self.n_s, self.n_y
        none = type(y)(0, 1)  # what a slice of a 1 x 1 matrix would not be
        return y[:a], y[a:b] if b > a else none, y[b:c] if c > b else none

    @cached_property
    def _horizons(self) -> list[int | None]:
        """Place of each phase's horizon among the constants."""
        places: list[int | None] = []
        for phase in self.problem.stretches:
            free = isinstance(phase.horizon, Free)
            places.append(sum(p is not None for p in places) if free else None)
        return places

    def durations(self, s: Any) -> list[Any]:
        """Length of each phase in s."""
        return [
            phase.horizon if place is None else s[place]
            for phase, place in zip(self.problem.stretches, self._horizons, strict=True)
        ]

    def span(self, i: int, s: Any) -> tuple[Any, Any]:
        """Start and length of a phase in s."""
        lengths = self.durations(s)
        return sum(lengths[:i]), lengths[i]

    def parameters(self, s: Any) -> Any:
        """All parameters, those without effect on the motion last."""
        dae, given = self.model.dae, self.problem.params
        place, found = sum(p is not None for p in self._horizons), []
        for label in dae.parameters.labels:
            value = given.get(label.name, label.start)
            if isinstance(value, Free):
                found.append(s[place])
                place += 1
            else:
                found.append(float(value))
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
        return [dae.t, dae.x, dae.z, dae.u, ca.vertcat(dae.p, dae.idle_p)]

    def over(self, name: str, *expressions: ca.SX) -> ca.Function:
        """Function (t, x, z, v, s) of expressions over `symbols`, flat."""
        kernel = ca.Function(name, self.symbols, [ca.densify(e) for e in expressions])
        t, x, z, v, s = arguments = self._arguments(ca.SX)
        none = ca.SX(0, 1)
        u, p = ca.vertcat(none, *self.inputs(t, v)), ca.vertcat(none, *self.parameters(s))
        full = [t, x, z, u, p]
        results = kernel.call([ca.SX(a) for a in full])
        return ca.Function(name, arguments, [ca.cse(r) for r in results])

    def _arguments(self, kind: Any) -> list[Any]:
        sizes = {"t": 1, "x": self.model.n_x, "z": self.model.n_z, "v": self.n_v, "s": self.n_s}
        return [kind.sym(key, size) for key, size in sizes.items()]

    def point(self, i: int) -> ca.Function:
        """Function (t, x, z, v, s) -> rates, alg, cost per second, path rows of a phase."""
        dae, terms = self.model.dae, self.terms[i]
        own = (terms.integrand, terms.path.rows.expr)
        if not self.model.kernels:
            return self.over("point", dae.ode, dae.alg, *own)
        rest = self.over("rest", *own)
        arguments = self._arguments(ca.MX)
        return ca.Function("point", arguments, [*self._called(*arguments), *rest(*arguments)])

    def rates(self) -> ca.Function:
        """Function (t, x, z, v, s) -> rates, alg."""
        if not self.model.kernels:
            return self.over("rates", self.model.dae.ode, self.model.dae.alg)
        arguments = self._arguments(ca.MX)
        return ca.Function("rates", arguments, self._called(*arguments))

    def _called(self, t: Any, x: Any, z: Any, v: Any, s: Any) -> list[Any]:
        """Rates and alg by calls of the model's kernels."""
        p = ca.vertcat(ca.MX(0, 1), *self.parameters(s)[: self.model.n_p])
        full = [t, x, z, ca.vertcat(ca.MX(0, 1), *self.inputs(t, v)), p]
        return [ca.densify(self.model.plain.function(name)(*full)) for name in ("ode", "alg")]

    def node(self, *expressions: ca.SX) -> ca.Function:
        """Function (t, x, z, v, s) of expressions and of alg, for the ends of phases."""
        return self.over("node", *expressions, self.model.dae.alg)

    def feels(self, *expressions: ca.SX) -> tuple[bool, bool]:
        """Whether expressions depend on z, and on the Inputs that are to be found."""
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


def framed(problem: Problem) -> Frame:
    """A problem on its symbols, its model with all states where it needs one that was left out.

    Raises:
        ValueError, TypeError: what is wrong with the problem, and where.
    """
    model, notes = problem.model, []
    still = _standing(problem)
    try:
        terms = traced(problem, model, still)
    except LeftOut as left:
        model = _whole(model, left.name)
        terms = traced(problem, model, still if problem.starts_fixed else {})
        notes.append(
            f"'{left.name}' was left out of the minimal model; all {model.n_x} states are back"
        )
    controls = tuple(
        i
        for i, label in enumerate(model.dae.u_labels)
        if isinstance(problem.inputs[label.name], Free)
    )
    cyclic, turns = _returning(problem, model)
    labels, low, high = _constants(problem, model)
    bare = Frame(problem, model, terms, controls, labels, low, high, cyclic, turns, False)
    links = [ca.SX(0, 1) if t.link is None else t.link for t in terms]
    carries = any(bare.feels(t.end.rows.expr, t.end_cost)[1] for t in terms)
    carries |= bare.feels(*links)[1]
    for t in terms:
        if bare.feels(t.start.rows.expr)[1]:
            raise ValueError(
                "Problem, start: a condition that depends on an Input to be found, which may jump; "
                "put it on the path"
            )
    return Frame(
        problem, model, terms, controls, labels, low, high, cyclic, turns, carries, tuple(notes)
    )


def _standing(problem: Problem) -> dict[str, float]:
    """States that provably stand still in this problem, with their values.

    Those that a minimal model leaves out, while all of them begin where the model does. With them
    redundant conditions are found, also for a model that keeps all states.
    """
    model = problem.model
    small = _small(model) if problem.starts_fixed else model
    never = len(small.reduction.inertial) if small.reduction else 0
    still = {d.name: d.value for d in small.dropped[:never]}
    moved = {name for phase in problem.stretches for name in (*phase.start, *phase.link)}
    return {} if moved & set(still) else still


def _small(model: Model) -> Model:
    """The minimal model of the same scene, if it is known."""
    if model.reduction is not None or not isinstance(model.scene, Scene):
        return model
    scene = model.scene

    def build() -> Model:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ModelWarning)  # of this scene they are out
            return compile_scene(scene, _coordinates(model))

    return model.cached("minimal", build)


def _coordinates(model: Model) -> Quaternion | TaitBryan:
    """The formulation that a model was written with."""
    labels = model.dae.expansion.labels if model.dae.expansion else model.x_labels
    turns = any(label.name.endswith(".q_w") for label in labels)
    return Quaternion() if turns else TaitBryan()


def _whole(model: Model, name: str) -> Model:
    """The model with all states, in the same coordinates."""
    if not isinstance(model.scene, Scene):
        raise ValueError(
            f"model '{model.name}': '{name}' was left out; compile the scene with minimal=False"
        )
    return compile_scene(model.scene, _coordinates(model), minimal=False)


def _returning(
    problem: Problem, model: Model
) -> tuple[tuple[int, ...], tuple[tuple[int, ...], ...]]:
    """Rows of the states that return, and quaternions."""
    if not problem.periodic:
        return (), ()
    names = [label.name for label in model.x_labels]
    if problem.periodic is True:
        chosen = set(range(len(names)))
    else:
        wanted: Sequence[str] = problem.periodic  # type: ignore[assignment]
        for name in wanted:
            if name not in names:
                raise ValueError(
                    f"Problem, periodic: no state '{name}'; there are: {', '.join(names)}"
                )
        chosen = {names.index(name) for name in wanted}
    turns = [rows for rows in quaternions(model) if set(rows) <= chosen]
    for rows in turns:
        chosen -= set(rows)
    return tuple(sorted(chosen)), tuple(turns)


def quaternions(model: Model) -> list[tuple[int, ...]]:
    """Rows (4) of the quaternions among the states of a model."""
    rows = {label.name: i for i, label in enumerate(model.x_labels)}
    found = []
    for name in rows:
        if name.endswith(".q_w"):
            parts = [f"{name[:-1]}{axis}" for axis in "wxyz"]
            if all(part in rows for part in parts):
                found.append(tuple(rows[part] for part in parts))
    return found


def _constants(problem: Problem, model: Model) -> tuple[tuple[Label, ...], np.ndarray, np.ndarray]:
    free: list[tuple[str, str, Free, float | None]] = []
    for i, phase in enumerate(problem.stretches):
        if isinstance(phase.horizon, Free):
            free.append((f"horizon of phase {i}", "s", phase.horizon, None))
    for label in model.dae.parameters.labels:
        value = problem.params.get(label.name)
        if isinstance(value, Free):
            free.append((label.name, label.unit, value, label.start))
    labels = [
        Label("", name, "", unit, value.start(default)) for name, unit, value, default in free
    ]
    low, high = [value.low for _, _, value, _ in free], [value.high for _, _, value, _ in free]
    if problem.periodic:
        labels += [Label("", f"start of {v.name}", "", v.unit, v.start) for v in model.x_labels]
        low += [-np.inf] * model.n_x
        high += [np.inf] * model.n_x
    return tuple(labels), np.array(low, float), np.array(high, float)
