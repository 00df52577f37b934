"""`derive(dae) -> Model`: the functions of a model, with exact derivatives, by name."""

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

# Eigenvalue problems along a trajectory: cube of the block's size times the number of points. This
# much takes about 30 ms.
_EIGENVALUE_WORK = 5e6
# Up to this many states left out, their propagator over up to _POINTS saved points is affordable.
_PROPAGATED = 60
_POINTS = 400
# Models with fewer parts are always written flat.
_FEW_PARTS = 20
# Instructions of ode, beyond which flat code takes long to compile and gains little.
_MANY_OPERATIONS = 4_000

Built = TypeVar("Built")


class Growth(NamedTuple):
    """Growth of a small disturbance of the states that a minimal model left out.

    Fields:
        rate: largest growth rate along the run, 1/s.
        t: time at which it occurs, s.
        exponent: integral of the rate over the run; the disturbance grows by exp(exponent).
    """

    rate: float
    t: float
    exponent: float


@dataclass(frozen=True, eq=False)
class Model:
    """The functions of x' = ode(t, x, z, u, p), 0 = alg, y = out, each with exact derivatives.

    `compile_scene` makes one. `model.function(name)` returns a CasADi Function of (t, x, z, u, p),
    one column each, in SI units and in the order of the labels. The names are `ode` (n_x, 1), `alg`
    (n_z, 1), `out` (the requested outputs, stacked), any output such as "joint.force_local", and
    for f in ode, alg, out

    - d<f>_d<v>, v in t, x, z, u, p: the exact, sparse Jacobians;
    - <f>_hessian (t, x, z, u, p, l): second derivatives of l'f by w = [x; z; u; p], sparse, (n_w,
      n_w), l (rows of f, 1);
    - <f>_forward (t, x, z, u, p, v): the derivative along v (n_w, 1);
    - <f>_adjoint (t, x, z, u, p, l): the gradient of l'f by w.

    A model with `events` also has `zero`, one function for each event, which fires where the
    function falls through zero, with the Jacobians d<f>_d<v>; `zero_rate`, their total time
    derivatives; and `jump`, the change of x by each event, one sparse column each. With post-Newton
    steps, `post_newton` is [largest error; smallest recommended step in s, or -1; x with new data].

    Arguments:
        dae: the equations, labels, outputs and events.
        reduction: what a minimal model left out, and why; None for a full model.
        kernels: functions call one kernel for each kind of part, mapped over its instances;
            otherwise they are flat. The numbers are the same.
        library: compiled functions, by name, to be used in place of CasADi's own.
        scene: the scene it was compiled from; pictures, `study.domain` and `ocp` read it.

    >>> print(model)                                              # doctest: +SKIP
    >>> rates = model.function("ode")(0.0, x, z, u, p)            # doctest: +SKIP
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
        """Name of the scene, and of the generated C."""
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
        """Name, unit and start value of each state, in the order of x."""
        return self.dae.x_labels

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """The states left out of a minimal model, with their constant values and the reasons."""
        return self.reduction.dropped if self.reduction else ()

    @property
    def replaced(self) -> tuple[Replaced, ...]:
        """The states of the full scene that follow from states of the model, and how."""
        return self.reduction.replaced if self.reduction else ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for the user: on the scene, and on states that may be redundant."""
        suspects = self.reduction.suspects if self.reduction else ()
        note = (
            f"possibly redundant: {', '.join(suspects)}; random sampling shows no motion, but it "
            "could not be proven, so these states stay in the model"
        )
        return (*self.dae.notes, *([note] if suspects else []))

    @property
    def digest(self) -> str:
        """Hash of the scene's text, the formulation and the package version, 16 hex digits."""
        return hashlib.sha256(f"{VERSION}\n{self.dae.source}".encode()).hexdigest()[:16]

    @property
    def symbols(self) -> list[ca.SX]:
        """The arguments [t, x, z, u, p] of all functions, as SX columns."""
        return self.dae.symbols

    def expression(self, name: str) -> ca.SX:
        """Return what the function of a name computes, as a flat expression over `symbols`.

        Derivatives along a direction (`_hessian`, `_forward`, `_adjoint`) and `zero_rate` are
        Functions only.

        Raises:
            ValueError: no function or output has that name; the message lists close ones.
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
        """Return the result of `build`, which is called once for each key and kept with the model.

        This is the only access to the cache, both for this class and for values derived from a
        model elsewhere, such as integrators and tangent coordinates. The key must contain
        everything that the result depends on besides the model.

        Arguments:
            key: hashable, such as ("integrator", plugin, options).
            build: makes the value.
        """
        if key not in self._cache:
            self._cache[key] = build()
        return self._cache[key]

    def function(self, name: str) -> ca.Function:
        """Return the CasADi Function of a name, built at the first call and then kept.

        Arguments:
            name: "ode", "dode_dx", "joint.force_local", ...; the class lists them.

        Raises:
            ValueError: no function or output has that name.

        >>> model.function("dode_dx").sparsity_out(0)  # doctest: +SKIP
        """
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
        """Build the total time derivative of the zero functions along the solution.

        Inputs count as constant; `integrators.events.Watch` adds what varying ones contribute.
        """
        symbols = [ca.MX.sym("t"), *(ca.MX.sym(k, getattr(self, f"n_{k}")) for k in "xzup")]
        needed = ("ode", "dzero_dt", "dzero_dx", "dzero_dz", "dalg_dt", "dalg_dx", "dalg_dz")
        f = {name: self.function(name)(*symbols) for name in needed}
        rate = f["dzero_dt"] + f["dzero_dx"] @ f["ode"]
        if self.n_z:
            # z' follows from d alg/dt = 0: alg_z z' = -(alg_t + alg_x x').
            push = ca.densify(f["dalg_dt"] + f["dalg_dx"] @ f["ode"])
            rate -= f["dzero_dz"] @ ca.solve(f["dalg_dz"], push)
        return ca.Function("zero_rate", symbols, [ca.densify(rate)], list("txzup"), ["zero_rate"])

    @property
    def events(self) -> tuple[str, ...]:
        """Names of the events, in the order in which they fire when several do so at once."""
        return tuple(event.name for event in self.dae.events)

    @property
    def plain(self) -> Model:
        """The model with CasADi's own functions in place of compiled ones.

        Compiled functions have no derivatives beyond the exported ones.
        """
        if not self.library:
            return self
        return self.cached("plain", lambda: replace(self, library={}))

    @property
    def calls(self) -> bool:
        """Whether `ode` and `alg` are to be called as Functions rather than inlined.

        True for kernels, whose flat expressions are large, and for compiled functions.
        """
        return self.kernels or bool(self.library)

    @property
    def assembly(self) -> Assembly:
        """The model as groups of kernels."""
        return self.cached("assembly", lambda: Assembly(self.dae))

    def consistent(
        self, t: float, x: np.ndarray, z: np.ndarray, u: np.ndarray, p: np.ndarray
    ) -> tuple[np.ndarray, bool]:
        """Solve 0 = alg(t, x, z, u, p) for z by Newton's method from the given z.

        Returns:
            z (n_z,), and whether it is a solution.
        """
        residual, jacobian = self.function("alg"), self.function("dalg_dz")
        return newton(
            lambda z: np.array(residual(t, x, z, u, p)).reshape(-1),
            lambda z: np.array(ca.DM(jacobian(t, x, z, u, p))),
            np.array(z, float),
        )

    def _over_all_parameters(self, name: str) -> ca.Function:
        """Return the function of a name over t, x, z, u and all parameters [p; idle_p]."""
        if not self.dae.parameters.idle:
            return self.function(name)
        return self._measuring((name,))

    def _measuring(self, names: tuple[str, ...]) -> ca.Function:
        """Return the Function (t, x, z, u, all parameters) -> the value of each name."""

        def build() -> ca.Function:
            arguments = [*self.symbols[:4], self.dae.parameters.symbols]
            return ca.Function(
                "measure", arguments, [ca.densify(self.expression(name)) for name in names]
            )

        return self.cached(("measure", names), build)

    @property
    def left_out(self) -> tuple[str, ...]:
        """Names of the full scene's states that are not in x or z, but follow from them."""
        expansion = self.dae.expansion
        if expansion is None:
            return ()
        kept = {label.name for label in (*self.x_labels, *self.dae.z_labels)}
        return tuple(
            label.name
            for i, label in enumerate(expansion.labels)
            if label.name not in kept and i not in expansion.unknown
        )

    def measure(self, name: str, trajectory: Trajectory) -> Column:
        """Evaluate an output, or a state that was left out, along a trajectory of this model.

        Arguments:
            name: such as "joint.force_local" or, for a state that was left out, "arm.p_z".

        Returns:
            Values (n, ...) at the saved times, with unit and component names.

        Raises:
            ValueError: no such output, or one that needs states that were left out and are unknown.
        """
        if name in self.left_out:
            every = self.measure("states", trajectory)
            labels = self.dae.expansion.labels if self.dae.expansion else ()
            row = [label.name for label in labels].index(name)
            return Column(every.values[:, row], labels[row].unit)
        values = self._over_all_parameters(name)(*self._arguments(trajectory))
        return self._column(name, values)

    def measure_all(self, names: Sequence[str], trajectory: Trajectory) -> list[Column]:
        """Evaluate several outputs along a trajectory, as `measure` does for one.

        All outputs go into one Function, which shares their common expressions; this is much faster
        than one by one.
        """
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
        """Compute how fast a disturbance of the states left out grows along a trajectory.

        The rates are the largest real parts of the eigenvalues of the transverse Jacobian at saved
        points (up to 50, fewer for large blocks); those within the rounding of a multiple zero
        count as zero. Where they show growth while the block varies along the run, the propagator
        of the block over the saved points decides. A full model has none: its growth is zero.
        """
        start = float(trajectory.t[0])
        if self.reduction is None or not self.reduction.inertial:
            return Growth(0.0, start, 0.0)
        inertial = np.array(self.reduction.inertial)
        n = len(inertial)
        # A constant block has the same eigenvalues everywhere: one point is exact.
        if not self.reduction.varies:
            rate = float(growth_rates(self._transverse(trajectory, 1)[1], inertial)[0])
            return Growth(rate, start, rate * float(trajectory.t[-1] - start))
        count = int(np.clip(_EIGENVALUE_WORK / n**3, 2, 50))
        t, blocks = self._transverse(trajectory, count)
        rates = growth_rates(blocks, inertial)
        worst = int(np.argmax(rates))
        exponent = float(np.sum(np.diff(t) * (rates[1:] + rates[:-1]) / 2))
        # Frozen eigenvalues may have positive real parts although the varying motion does not grow,
        # and only the propagator can tell. It needs a rate in every row.
        if exponent > 0 and inertial.all() and n <= _PROPAGATED:
            exponent = growth_exponent(*self._transverse(trajectory, _POINTS), exponent)
        return Growth(float(rates[worst]), float(t[worst]), exponent)

    def _transverse(self, trajectory: Trajectory, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Return times and transverse Jacobians (k, n, n) at up to `count` of the saved points."""
        if self.reduction is None:
            raise ValueError(
                f"model '{self.name}': it is a full model, without a transverse Jacobian; compile "
                "with minimal=True"
            )
        n, last = len(self.reduction.inertial), len(trajectory.t) - 1
        picked = np.linspace(0, last, min(last + 1, count)).astype(int)
        columns = (column[:, picked] for column in self._arguments(trajectory))
        flat = np.array(ca.DM(self.reduction.transverse(*columns)))
        return trajectory.t[picked], flat.reshape(n, len(picked), n).transpose(1, 0, 2)

    def _arguments(self, trajectory: Trajectory) -> list[np.ndarray]:
        """Return t, x, z, u and all parameters along a trajectory, one column for each point."""
        dae = self.dae
        groups = (dae.x_labels, dae.z_labels, dae.u_labels, dae.parameters.labels)
        columns = [self._columns(trajectory, labels) for labels in groups]
        return [trajectory.t[None, :], *columns]

    @staticmethod
    def _columns(trajectory: Trajectory, labels: tuple[Label, ...]) -> np.ndarray:
        rows = [trajectory[label.name] for label in labels]
        return np.array(rows).reshape(len(labels), len(trajectory.t))

    def operations(self, name: str) -> int:
        """Return the number of scalar instructions of a function, a measure of its cost.

        With `kernels` this is exact for "ode" only: of any other function it counts the calls.
        """
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
    """Build the `Model` of a `Dae`, after checking that the `Dae` is consistent.

    Arguments:
        dae: the equations.
        reduction: what passes left out of them; None for a full model.
        kernels: whether functions call mapped kernels or are flat; by default kernels where there
            are at least 20 parts and ode takes more than 4000 instructions.

    Raises:
        ValueError: labels, rows and symbols of the `Dae` contradict each other.
    """
    dae.verify()
    if kernels or (kernels is None and len(dae.parts) >= _FEW_PARTS):
        model = Model(dae, reduction, True)
        if kernels or model.assembly.operations > _MANY_OPERATIONS:
            return model
    dae.verify_symbols()
    return Model(dae, reduction, False)
