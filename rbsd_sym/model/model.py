"""`derive(dae) -> Model`: every function with exact derivatives, by name."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import casadi as ca
import numpy as np

from ..base.names import c_name, derivative
from ..base.newton import newton
from ..base.spectra import growth_exponent, growth_rates
from ..dae.dae import Dae, table
from ..dae.members import Label
from ..dae.reduction import Dropped, Reduction, Replaced
from ..version import VERSION
from .assembly import Assembly
from .trajectory import Column, Trajectory

_EIGENVALUE_WORK = 5e6  # cube of the block's size times the number of points: about 30 ms
_PROPAGATED = 60  # states left out, up to which their propagator is affordable
_POINTS = 400  # for it
_FEW_PARTS = 20
_MANY_OPERATIONS = 4_000  # of ode; beyond it flat code takes long to compile, and gains little

Built = TypeVar("Built")


class Growth(NamedTuple):
    """Growth of a disturbance of what a minimal model left out.

    Fields:
        rate: the largest, 1/s, and `t` the time it occurs, s.
        exponent: its integral over the run; the disturbance grows by exp(exponent).
    """

    rate: float
    t: float
    exponent: float


@dataclass(frozen=True, eq=False)
class Model:
    """A `Dae` with its functions; they take (t, x, z, u, p), a column each.

    Names: `ode`, `alg`, `out`, any output such as "joint.force_local", and for f in ode, alg, out

    - d<f>_d<v>, v in t, x, z, u, p: the exact, sparse Jacobians;
    - <f>_hessian (t, x, z, u, p, l): second derivatives of l'f by w = [x; z; u; p], sparse, (n_w,
      n_w), l (rows of f, 1);
    - <f>_forward (t, x, z, u, p, v): the derivative along v (n_w, 1);
    - <f>_adjoint (t, x, z, u, p, l): the gradient of l'f by w.

    Of events (`events` are their names): `zero`, functions that fire as they fall through zero,
    with Jacobians as f has; `zero_rate`, their total time derivative; `jump`, the change of the
    states by each, a sparse column each. `post_newton`: [largest error; smallest recommended step
    or -1; states with new data].

    Arguments:
        kernels: functions call one kernel for each kind of part, mapped over its instances;
            otherwise they are flat. The numbers are the same.
        library: compiled functions, by name, that stand in for ours.
        scene: what it was compiled from; carried for pictures, and read by nothing else.
    """

    dae: Dae
    reduction: Reduction | None = None
    kernels: bool = False
    library: Mapping[str, ca.Function] = field(default_factory=dict, repr=False)
    _cache: dict[Hashable, Any] = field(default_factory=dict, repr=False, init=False)
    scene: object | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        return (
            f"<Model '{self.name}': {self.n_x} states, {self.n_z} algebraic, {self.n_u} inputs, "
            f"{self.n_p} parameters>"
        )

    @property
    def name(self) -> str:
        """Name of the scene."""
        return self.dae.name

    @property
    def n_x(self) -> int:
        """Number of differential states."""
        return int(self.dae.x.numel())

    @property
    def n_z(self) -> int:
        """Number of algebraic unknowns."""
        return int(self.dae.z.numel())

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return int(self.dae.u.numel())

    @property
    def n_p(self) -> int:
        """Number of parameters."""
        return int(self.dae.p.numel())

    @property
    def x_labels(self) -> tuple[Label, ...]:
        """Name, unit and start value of each state."""
        return self.dae.x_labels

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """The states left out, their values and why."""
        return self.reduction.dropped if self.reduction else ()

    @property
    def replaced(self) -> tuple[Replaced, ...]:
        """The states of the full scene that follow from others, and how."""
        return self.reduction.replaced if self.reduction else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know: of the scene, and of states that probing sees at rest."""
        seen = self.reduction.suspects if self.reduction else ()
        note = (
            f"kept without need, perhaps: {', '.join(seen)}: random values show no motion, but no "
            "proof was found that there is none for all values"
        )
        return (*self.dae.notes, *([note] if seen else []))

    @property
    def digest(self) -> str:
        """Hash of the scene's text, the formulation and the version of this package."""
        return hashlib.sha256(f"{VERSION}\n{self.dae.source}".encode()).hexdigest()[:16]

    @property
    def symbols(self) -> list[ca.SX]:
        """The arguments [t, x, z, u, p]."""
        return self.dae.symbols

    def expression(self, name: str) -> ca.SX:
        """What the function of that name computes, over `symbols`.

        Raises:
            ValueError: no function of that name.
        """
        if name in ("ode", "alg", "out", "zero", "jump"):
            return getattr(self.dae, name)
        if name == "post_newton":
            return self.dae.update
        if name == "states":
            return self.dae.measured
        found = derivative(name)
        if found and found.by:
            return ca.jacobian(getattr(self.dae, found.of), getattr(self.dae, found.by))
        return self.dae.output(name)

    def cached(self, key: Hashable, build: Callable[[], Built]) -> Built:
        """Return what `build` makes, built at the first call with this key and kept with the model.

        It is the only way into the cache, for this class and for what is derived from a model, such
        as integrators and tangent coordinates. The key names what is built, and all that it depends
        on beside the model.
        """
        if key not in self._cache:
            self._cache[key] = build()
        return self._cache[key]

    def function(self, name: str) -> ca.Function:
        """The CasADi Function of that name, built at the first call."""
        name = self.dae.aliases.get(name, name)
        if name in self.library:
            return self.library[name]
        return self.cached(("function", name), lambda: self._built(name))

    def _built(self, name: str) -> ca.Function:
        if name == "zero_rate":
            return self._zero_rate()
        found = derivative(name)
        mapped = found.of != "zero" if found else name in ("ode", "alg", "out")
        if (found and not found.by) or (self.kernels and mapped):
            return self.assembly.function(name)
        safe, expression = c_name(name), self.expression(name)
        defaults = [label.start for label in self.dae.parameters.idle]
        if defaults:
            expression = ca.substitute(expression, self.dae.idle_p, ca.DM(defaults))
        return ca.Function(safe, self.symbols, [expression], list("txzup"), [safe])

    def _zero_rate(self) -> ca.Function:
        """Total time derivative of the zero functions along the solution."""
        symbols = [ca.MX.sym("t"), *(ca.MX.sym(k, getattr(self, f"n_{k}")) for k in "xzup")]
        needed = ("ode", "dzero_dt", "dzero_dx", "dzero_dz", "dalg_dt", "dalg_dx", "dalg_dz")
        f = {name: self.function(name)(*symbols) for name in needed}
        rate = f["dzero_dt"] + f["dzero_dx"] @ f["ode"]
        if self.n_z:
            push = ca.densify(f["dalg_dt"] + f["dalg_dx"] @ f["ode"])
            rate -= f["dzero_dz"] @ ca.solve(f["dalg_dz"], push)
        return ca.Function("zero_rate", symbols, [ca.densify(rate)], list("txzup"), ["zero_rate"])

    @property
    def events(self) -> tuple[str, ...]:
        """Names of the events, in the order in which they happen."""
        return tuple(event.name for event in self.dae.events)

    @property
    def plain(self) -> Model:
        """The model with functions of its own in place of compiled ones."""
        if not self.library:
            return self
        return self.cached("plain", lambda: replace(self, library={}))

    @property
    def calls(self) -> bool:
        """Whether `ode` and `alg` are to be called, since their flat expressions do not pay."""
        return self.kernels or bool(self.library)

    @property
    def assembly(self) -> Assembly:
        """The model as groups of kernels."""
        return self.cached("assembly", lambda: Assembly(self.dae))

    def consistent(
        self, t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, bool]:
        """The z that solves alg = 0, by Newton's method from the given z, and whether it does."""
        residual, jacobian = self.function("alg"), self.function("dalg_dz")
        return newton(
            lambda z: np.array(residual(t, x, z, u, p)).reshape(-1),
            lambda z: np.array(ca.DM(jacobian(t, x, z, u, p))),
            np.array(z, float),
        )

    def _over_all_parameters(self, name: str) -> ca.Function:
        """The function of that name with the parameters without effect on the model after p."""
        if not self.dae.parameters.idle:
            return self.function(name)
        return self._measuring((name,))

    def _measuring(self, names: tuple[str, ...]) -> ca.Function:
        """Function of t, x, z, u and all parameters -> what each name means."""

        def build() -> ca.Function:
            arguments = [*self.symbols[:4], self.dae.parameters.symbols]
            return ca.Function(
                "measure", arguments, [ca.densify(self.expression(name)) for name in names]
            )

        return self.cached(("measure", names), build)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of the full scene's states that are not states of this model, but are known."""
        way = self.dae.expansion
        if way is None:
            return ()
        kept = {label.name for label in (*self.x_labels, *self.dae.z_labels)}
        return tuple(
            label.name
            for i, label in enumerate(way.labels)
            if label.name not in kept and i not in way.unknown
        )

    def measure(self, name: str, trajectory: Trajectory) -> Column:
        """An output, or a state that was left out, along a trajectory of this model."""
        if name in self.left_out:
            every = self.measure("states", trajectory)
            labels = self.dae.expansion.labels if self.dae.expansion else ()
            row = [label.name for label in labels].index(name)
            return Column(every.values[:, row], labels[row].unit)
        values = self._over_all_parameters(name)(*self._arguments(trajectory))
        return self._column(name, values)

    def measure_all(self, names: Sequence[str], trajectory: Trajectory) -> list[Column]:
        """`measure` for many names: their outputs in one Function, which is much faster."""
        names = [self.dae.aliases.get(name, name) for name in names]
        together = [name for name in dict.fromkeys(names) if name in self.dae.outputs]
        if len(together) < 2:
            return [self.measure(name, trajectory) for name in names]
        function = self._measuring(tuple(together))
        values = function.call([ca.DM(a) for a in self._arguments(trajectory)])
        found = {name: self._column(name, v) for name, v in zip(together, values, strict=True)}
        return [found[name] if name in found else self.measure(name, trajectory) for name in names]

    def _column(self, name: str, values: ca.DM) -> Column:
        output = self.dae.outputs.get(name)
        shape = output.shape if output else (values.shape[0],)
        unit = output.unit if output else ""
        components = output.components if output else tuple(v.name for v in self.dae.out_labels)
        return Column(np.array(values).T.reshape(-1, *shape), unit, components)

    def transverse_growth(self, trajectory: Trajectory) -> Growth:
        """How fast a disturbance of the states left out grows along a trajectory.

        From the eigenvalues of the transverse Jacobian at saved points (up to 50, fewer for large
        blocks); real parts within the rounding of a multiple zero count as zero. Where these tell
        of growth while the block varies, its propagator over the saved points has the last word.
        """
        start = float(trajectory.t[0])
        if self.reduction is None or not self.reduction.inertial:
            return Growth(0.0, start, 0.0)
        inertial = np.array(self.reduction.inertial)
        n = len(inertial)
        if not self.reduction.varies:
            rate = float(growth_rates(self._transverse(trajectory, 1)[1], inertial)[0])
            return Growth(rate, start, rate * float(trajectory.t[-1] - start))
        count = int(np.clip(_EIGENVALUE_WORK / n**3, 2, 50))
        t, blocks = self._transverse(trajectory, count)
        rates = growth_rates(blocks, inertial)
        worst = int(np.argmax(rates))
        exponent = float(np.sum(np.diff(t) * (rates[1:] + rates[:-1]) / 2))
        if exponent > 0 and inertial.all() and n <= _PROPAGATED:
            exponent = growth_exponent(*self._transverse(trajectory, _POINTS), exponent)
        return Growth(float(rates[worst]), float(t[worst]), exponent)

    def _transverse(self, trajectory: Trajectory, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Times and transverse Jacobians (k, n, n) at up to `count` of the saved points."""
        if self.reduction is None:
            raise ValueError(f"model '{self.name}': nothing was left out of it")
        n, last = len(self.reduction.inertial), len(trajectory.t) - 1
        picked = np.linspace(0, last, min(last + 1, count)).astype(int)
        columns = (column[:, picked] for column in self._arguments(trajectory))
        flat = np.array(ca.DM(self.reduction.transverse(*columns)))
        return trajectory.t[picked], flat.reshape(n, len(picked), n).transpose(1, 0, 2)

    def _arguments(self, trajectory: Trajectory) -> list[np.ndarray]:
        """Columns t, x, z, u and all parameters along a trajectory, one a point."""
        dae = self.dae
        groups = (dae.x_labels, dae.z_labels, dae.u_labels, dae.parameters.labels)
        columns = [self._columns(trajectory, labels) for labels in groups]
        return [trajectory.t[None, :], *columns]

    @staticmethod
    def _columns(trajectory: Trajectory, labels: tuple[Label, ...]) -> np.ndarray:
        rows = [trajectory[label.name] for label in labels]
        return np.array(rows).reshape(len(labels), len(trajectory.t))

    def operations(self, name: str) -> int:
        """Number of scalar instructions of a function (with kernels, of ode only)."""
        if self.kernels and name == "ode":
            return self.assembly.operations
        return int(self.function(name).n_instructions())

    @property
    def _layout_text(self) -> str:
        return f" in {len(self.assembly.groups)} kernels" if self.kernels else ""

    def __str__(self) -> str:
        jacobian = self.function("dode_dx")
        lines = [
            f"model {self.name}: {self.n_x} states, {self.n_z} algebraic, {self.n_u} inputs, "
            f"{self.n_p} parameters, digest {self.digest}",
            f"cost: ode {self.operations('ode')} instructions{self._layout_text}, dode_dx "
            f"{jacobian.nnz_out(0)} nonzeros",
            *table("states kept", self.dae.x_labels),
            *table("algebraic unknowns", self.dae.z_labels),
            *table("inputs", self.dae.u_labels),
            *table("parameters", self.dae.p_labels),
            *table("parameters without effect", self.dae.idle_p_labels),
            *(["events, in order:"] if self.events else []),
            *(f"  {event.name}" for event in self.dae.events),
        ]
        if self.replaced:
            lines.append("states replaced:")
            lines += [f"  {r.name} = {r.how}" for r in self.replaced]
        if self.dropped:
            lines.append("states dropped:")
            lines += [f"  {d.name} = {d.value:.6g}: {d.reason}" for d in self.dropped]
        else:
            lines.append("states dropped: none")
        return "\n".join(lines + [f"note: {note}" for note in self.notes])


def derive(dae: Dae, reduction: Reduction | None = None, kernels: bool | None = None) -> Model:
    """A `Model` of a verified `Dae`, and of what was left out of it.

    Arguments:
        kernels: the layout of its functions; by default flat for small models.
    """
    dae.verify()
    if kernels or (kernels is None and len(dae.parts) >= _FEW_PARTS):
        model = Model(dae, reduction, True)
        if kernels or model.assembly.operations > _MANY_OPERATIONS:
            return model
    dae.verify_symbols()
    return Model(dae, reduction, False)
