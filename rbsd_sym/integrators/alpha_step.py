"""One step of generalized-alpha on R3 x SO(3) as a CasADi function, with Newton's method inside.

The unknowns are increments: tangent steps of the coordinates, increments of first-order states, and
z. Velocities and accelerations follow from them. With accelerations as unknowns, an increment would
be a difference of numbers (h w)^2 times as large, w being an angular frequency: at h w = 1e4 that
costs eight digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce
from typing import Any, NamedTuple

import casadi as ca

from ..dae.dae import Dae
from ..dae.members import Kinematics, pick
from ..model.model import Model

# Newton iterations, at most; where the method converges it needs 2 to 5.
ITERATIONS = 12
# The predictor uses an old acceleration only if that changes a value by less than this fraction of
# 1 + |value|.
_LITTLE = 0.03
# Unit of the unknown that counts iterations (see `_Step._equations`), far below any tolerance.
_COUNT = 1e-30


class Coefficients(NamedTuple):
    """Coefficients of generalized-alpha.

    For a state y with y' = f(y), whose a approximates its rate, a step from 0 to 1 solves

        y1 = y0 + h ((1 - gamma) a0 + gamma a1)
        (1 - alpha_m) a1 + alpha_m a0 = (1 - alpha_f) f1 + alpha_f f0

    If y is the velocity of a coordinate q, then q1 = q0 + h y0 + h^2 ((1/2 - beta) a0 + beta a1).
    """

    alpha_m: float
    alpha_f: float
    gamma: float
    beta: float

    @property
    def shift(self) -> float:
        """Shift of a in time: the a at time t is y' at t + shift h, to second order in h."""
        # Both sides of the recursion, expanded about the start of the step.
        return self.alpha_m - self.alpha_f

    @property
    def error(self) -> float:
        """Local error of y1, in units of h^3 y'''."""
        # Taylor series: a = y' at t + shift h, plus k h^2 y''' with k from the recursion.
        m, s = self.alpha_m, self.shift
        k = ((1 - self.alpha_f) - (1 - m) * (1 + s) ** 2 - m * s * s) / 2
        return k + ((1 - self.gamma) * s * s + self.gamma * (1 + s) ** 2) / 2 - 1 / 6

    @property
    def error_of_position(self) -> float:
        """Local error of a coordinate, in units of h^3 v''; v'' h is a1 - a0."""
        return self.beta + self.shift / 2 - 1 / 6


def second_order(rho: float) -> Coefficients:
    """Return the coefficients for coordinates with velocities.

    [Chung, Hulbert 1993; Arnold, Bruels 2007]; rho = 1 is the trapezoidal rule.

    Arguments:
        rho: spectral radius at infinite frequency, 0 ... 1.
    """
    # For rho = 1 the recursion reads a1 - f1 = -(a0 - f0). From a = f at the start it keeps a = f,
    # but never loses a rounding error. a1 = f1 gives the same steps without carrying it on.
    if rho == 1:
        return Coefficients(0.0, 0.0, 0.5, 0.25)
    m, f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma = 0.5 + f - m
    return Coefficients(m, f, gamma, (gamma + 0.5) ** 2 / 4)


def first_order(rho: float) -> Coefficients:
    """Return the coefficients for states without velocities.

    [Jansen, Whiting, Hulbert 2000], with alpha_m and alpha_f counted from the end of the step as in
    `second_order`. All roots at infinite stiffness are -rho, whereas the coefficients of
    `second_order` would leave a root of -1/3 at rho = 0. rho = 0 is BDF2, rho = 1 the trapezoidal
    rule.

    Arguments:
        rho: spectral radius at infinite stiffness, 0 ... 1.
    """
    if rho == 1:
        return Coefficients(0.0, 0.0, 0.5, 0.0)
    return Coefficients((3 * rho - 1) / (2 * (rho + 1)), rho / (rho + 1), 1 / (rho + 1), 0.0)


class Moved(NamedTuple):
    """One unknown increment of a step: of a tangent coordinate, or of a first-order state.

    Fields:
        slot: row of x in whose place its rate and its a are stored.
        velocity: row of the full scene's states whose value is its rate; None if a row of ode is.
        second: whether the slot is a velocity, and the increment that of its coordinate.
        with_velocity: whether it gets the coefficients of `second_order`.
        scale_rows: rows of x whose absolute values are the scale of the increment.
    """

    slot: int
    velocity: int | None
    second: bool
    with_velocity: bool
    scale_rows: tuple[int, ...]


@dataclass(frozen=True)
class Tangent:
    """A motion with at least one coordinate that is a state: its tangent step, by component.

    Fields:
        motion: its coordinates and velocities, as rows of the full scene's states.
        parts: for each velocity its `Moved`, or None for a constant one.
        live: the coordinates that are states: positions among the motion's coordinates, and rows
            of x.
    """

    motion: Kinematics
    parts: tuple[Moved | None, ...]
    live: tuple[tuple[int, int], ...]


class Groups:
    """The increments of a step, sorted by kind, from the kinematics of a `Dae`.

    - A velocity that is a state and has a coordinate that is one: second order.
    - A velocity that is not a state, but follows from x and z (a damped motion without inertia):
      the tangent step is integrated like a first-order state, with its history in the slot of a
      coordinate.
    - A constant velocity: the tangent step is time times velocity.
    - Every other state is of first order, except data states, which do not move.

    Fields:
        tangents: the motions, component by component.
        rest: the increments of the other states.
        moved: all increments, in the order of the unknowns.
    """

    def __init__(self, dae: Dae) -> None:
        self.dae = dae
        self.tangents = tuple(t for m in dae.motions if (t := self._tangent(m)) is not None)
        parts = [part for tangent in self.tangents for part in tangent.parts if part is not None]
        done = {row for t in self.tangents for _, row in t.live}
        done |= {part.slot for part in parts} | set(dae.data)
        velocities = {self._place(row) for motion in dae.motions for row in motion.velocities}
        free = [row for row in range(dae.x.numel()) if row not in done]
        self.rest = tuple(Moved(row, None, False, row in velocities, (row,)) for row in free)
        self.moved = (*parts, *self.rest)

    def _place(self, row: int) -> int | None:
        """Return the row of x of a state of the full scene, or None."""
        return self.dae.expansion.rows[row] if self.dae.expansion else row

    def _tangent(self, motion: Kinematics) -> Tangent | None:
        dae = self.dae
        places = [self._place(row) for row in motion.coordinates]
        live = tuple((i, place) for i, place in enumerate(places) if place is not None)
        moving, scale_rows = ca.vertcat(dae.x, dae.z), tuple(place for _, place in live)
        slots, parts = iter(scale_rows), list[Moved | None]()
        for row in motion.velocities:
            place = self._place(row)
            if place is not None:
                parts.append(Moved(place, None, True, True, scale_rows))
            elif ca.depends_on(dae.states[row], moving):
                slot = next(slots, None)
                if slot is None:
                    return None
                parts.append(Moved(slot, row, False, False, scale_rows))
            else:
                parts.append(None)
        return Tangent(motion, tuple(parts), live) if live else None

    @property
    def slots(self) -> list[int]:
        """Row of x for each increment."""
        return [part.slot for part in self.moved]

    @cached_property
    def _velocities(self) -> tuple[ca.Function, ca.Function]:
        """Functions (x, z, p) -> the rates that are not rows of ode; their derivatives by x, z."""
        dae = self.dae
        rows = [part.velocity for part in self.moved if part.velocity is not None]
        value, symbols = pick(dae.states, rows), [dae.x, dae.z, dae.p]
        slopes = [ca.jacobian(value, v) for v in (dae.x, dae.z)]
        return ca.Function("velocities", symbols, [value]), ca.Function("slopes", symbols, slopes)

    @cached_property
    def _rows(self) -> list[int]:
        """Rows of the rates of all increments in [ode; velocities]."""
        rows, place = list[int](), int(self.dae.x.numel())
        for part in self.moved:
            rows.append(part.slot if part.velocity is None else place)
            place += part.velocity is not None
        return rows

    def rates(self, model: Model, t: Any, x: Any, z: Any, u: Any, p: Any) -> Any:
        """Return the rates of all increments, in order, as expressions."""
        ode = model.function("ode")(t, x, z, u, p)
        both = ca.vertcat(ode, self._velocities[0](x, z, p))
        return both[self._rows] if self.moved else both[:0]

    def slopes(self, model: Model, by_x: ca.MX, by_z: ca.MX, *at: ca.MX) -> ca.MX:
        """Return the derivatives of the rates by the variables of which x and z are functions.

        Arguments:
            by_x, by_z: derivatives of x and z by these variables.
            at: t, x, z, u, p.
        """
        ode = [model.function(f"dode_d{v}")(*at) for v in "xz"]
        own = self._velocities[1](at[1], at[2], at[4])
        total = [ca.vertcat(a, b)[self._rows, :] for a, b in zip(ode, own, strict=True)]
        return total[0] @ by_x + total[1] @ by_z


def rates_function(model: Model) -> ca.Function:
    """Return the Function (t, x, z, u, p) -> the rate stored with each row of x, for a start."""

    def build() -> ca.Function:
        layout = Groups(model.dae)
        symbols = _symbols(model, t=1, x=model.n_x, z=model.n_z, u=model.n_u, p=model.n_p)
        rates, place = layout.rates(model, *symbols), {row: i for i, row in enumerate(layout.slots)}
        rows = [place.get(row, len(place)) for row in range(model.n_x)]
        value = ca.vertcat(rates, 0)[rows] if rows else rates
        return ca.Function("rates", symbols, [ca.densify(value)], [*"txzup"], ["rates"])

    return model.cached("generalized_alpha rates", build)


def step_function(model: Model, rho: float, tolerance: float) -> ca.Function:
    """Return one step as a CasADi Function, which can be generated to C.

    (t0, h, x0, rate0, a0, z0, u1, p) -> (x1, rate1, a1, z1, size, iterations), with times in s.
    `rate` holds the rate of each state (of a velocity the acceleration), `a` the method's own
    approximation of it; both have a row for each state, zero where there is none. At a start a0 is
    rate0. u1 are the inputs at the end of the step. `size` is the largest correction of the last
    Newton iteration, relative to 1 + |value|, and infinite if a value is not finite: the step has
    failed unless size <= tolerance.

    Arguments:
        rho: spectral radius at infinite frequency, 0 ... 1.
        tolerance: size of a correction at which Newton's method stops; more than 1e-15.
    """
    key = ("generalized_alpha step", rho, tolerance)
    return model.cached(key, lambda: _Step(model, rho).function(tolerance))


def _symbols(model: Model, **sizes: int) -> list[Any]:
    """Return symbols of the kind that the model's functions take: MX for kernels, SX if flat."""
    kind = ca.MX if model.calls else ca.SX
    return [kind.sym(name, n) for name, n in sizes.items()]


class _Step:
    """The parts of the step function.

    The unknowns y, in units of 1 + |value|, are the increments, the changes of z, and one that
    counts the iterations.
    """

    def __init__(self, model: Model, rho: float) -> None:
        self.model, self.dae, self.layout = model, model.dae, Groups(model.dae)
        self.second, self.first = second_order(rho), first_order(rho)
        n, dae = model.n_x, model.dae
        self.n_y = len(self.layout.moved) + model.n_z + 1
        self.sizes = {
            "t0": 1,
            "h": 1,
            "x0": n,
            "rate0": n,
            "a0": n,
            "z0": model.n_z,
            "u1": model.n_u,
            "p": model.n_p,
        }
        own = [ca.SX.sym(name, k) for name, k in (("y", self.n_y), ("h", 1), ("r", n), ("a", n))]
        self.y, self.h, self.rate0, self.a0 = own
        self.arguments = [self.y, self.h, dae.x, self.rate0, self.a0, dae.z, dae.p]
        self.lengths = [_largest([dae.x[row] for row in m.scale_rows]) for m in self.layout.moved]
        self.units = [1 + length for length in self.lengths]

    def function(self, tolerance: float) -> ca.Function:
        """Build the whole step: predictor, Newton's method, and the state at the end."""
        end = ca.Function("end", self.arguments, self._end(), {"cse": True})
        residual, derivative = self._equations(end)
        options = {
            "abstol": 0,
            "abstolStep": tolerance,
            "max_iter": ITERATIONS,
            "error_on_fail": False,
        }
        if derivative:
            options["jacobian_function"] = derivative
        newton = ca.rootfinder("newton", "fast_newton", residual, options)
        given = {name: ca.MX.sym(name, n) for name, n in self.sizes.items()}
        found, before = newton(self._guess()(*self._own(given)), *given.values())
        results = [*end(found, *self._own(given)), *_verdict(self.n_y)(found, before)]
        names = ["x1", "rate1", "a1", "z1", "size", "iterations"]
        return ca.Function("alpha_step", [*given.values()], results, [*given], names)

    @staticmethod
    def _own(given: dict[str, Any]) -> list[Any]:
        """Return the arguments that determine the end of a step, together with the unknowns."""
        return [given[name] for name in ("h", "x0", "rate0", "a0", "z0", "p")]

    def _origin(self, i: int) -> ca.SX:
        """Return the value from which an increment is counted: h v0, or 0."""
        # Counted from h v0, the acceleration follows without a difference of close numbers. Where
        # h v0 exceeds the coordinate, steps are much longer than a period, and the increment is
        # the small number: then it is counted from 0.
        part = self.layout.moved[i]
        free = self.h * self.dae.x[part.slot]
        return free * (ca.fabs(free) <= self.lengths[i]) if part.second else ca.SX(0)

    def _guess(self) -> ca.Function:
        """Build the predictor: the unknowns of a step with constant a."""
        # In a stiff oscillation a changes sign many times within a step; the change it predicts is
        # then large, and is dropped.
        column = ca.SX.zeros(self.n_y)
        for i, part in enumerate(self.layout.moved):
            free = self.h * self.dae.x[part.slot] if part.second else ca.SX(0)
            bent = self.a0[part.slot] * (self.h**2 / 2 if part.second else self.h)
            bent = bent * (ca.fabs(bent) <= _LITTLE * self.units[i])
            column[i] = (free + bent - self._origin(i)) / self.units[i]
        return ca.Function("guess", self.arguments[1:], [column])

    def _end(self) -> list[ca.SX]:
        """Return [x1, rate1, a1, z1] as expressions of the unknowns."""
        dae, y, h, n = self.dae, self.y, self.h, self.dae.x.numel()
        x1, rate1, a1 = (list(ca.vertsplit(v)) for v in (dae.x, ca.SX.zeros(n), ca.SX.zeros(n)))
        steps = dict[Moved, ca.SX]()
        for i, part in enumerate(self.layout.moved):
            k, row = self.second if part.with_velocity else self.first, part.slot
            change, old = self.units[i] * y[i], self.a0[row]
            # The equations of `Coefficients`, solved for a1, y1 and f1 (here rate1).
            if part.second:
                start, free = self._origin(i), h * dae.x[row]
                steps[part] = start + change
                a1[row] = (((start - free) + change) / h**2 - (0.5 - k.beta) * old) / k.beta
                x1[row] = dae.x[row] + h * ((1 - k.gamma) * old + k.gamma * a1[row])
            else:
                steps[part] = change
                a1[row] = (change / h - (1 - k.gamma) * old) / k.gamma
            mean = (1 - k.alpha_m) * a1[row] + k.alpha_m * old
            rate1[row] = (mean - k.alpha_f * self.rate0[row]) / (1 - k.alpha_f)
        for part in self.layout.rest:
            x1[part.slot] = dae.x[part.slot] + steps[part]
        self._retract(steps, x1)
        n_z, m = dae.z.numel(), len(self.layout.moved)
        z1 = [dae.z[i] + (1 + ca.fabs(dae.z[i])) * y[m + i] for i in range(n_z)]
        return [ca.vertcat(ca.SX(0, 1), *column) for column in (x1, rate1, a1, z1)]

    def _retract(self, steps: dict[Moved, ca.SX], x1: list[ca.SX]) -> None:
        """Move the coordinates in x1 by their tangent steps."""
        states = self.dae.states
        for tangent in self.layout.tangents:
            motion = tangent.motion
            pairs = zip(motion.velocities, tangent.parts, strict=True)
            step = [self.h * states[row] if part is None else steps[part] for row, part in pairs]
            moved = motion.retract(pick(states, motion.coordinates), ca.vertcat(*step))
            for i, row in tangent.live:
                x1[row] = moved[i]

    def _weights(self, h: Any) -> Any:
        """Return the factors that turn rates into increments."""
        return ca.vertcat(*(h**2 if part.second else h for part in self.layout.moved))

    def _equations(self, end: ca.Function) -> tuple[ca.Function, ca.Function | None]:
        """Build (y, t0, h, ...) -> (residual, y), and for models with kernels its derivative."""
        # CasADi's rootfinder returns neither the size of its last correction nor the number of its
        # iterations. The second result is the y at which the residual was last evaluated, that is
        # before the last correction. The row exp(c) has no root: each Newton correction of it is
        # exactly -1, here in units of _COUNT, so that c counts the iterations.
        model, slots = self.model, self.layout.slots
        y, *given = _symbols(model, y=self.n_y, **self.sizes)
        named = dict(zip(self.sizes, given, strict=True))
        x1, rate1, _, z1 = end(y, *self._own(named))
        at = (named["t0"] + named["h"], x1, z1, named["u1"], named["p"])
        rows = [_COUNT * ca.exp(y[-1] / _COUNT)]
        if model.n_z:
            rows.insert(0, model.function("alg")(*at))
        if slots:
            missing = rate1[slots] - self.layout.rates(model, *at)
            rows.insert(0, self._weights(named["h"]) * missing)
        results = [ca.vertcat(*rows), y]
        residual = ca.Function("residual", [y, *given], results, {"cse": not model.calls})
        if not model.calls:
            return residual, None
        matrix = self._slope(y, named, at)
        return residual, ca.Function("jac_residual", [y, *given], [matrix, *results])

    def _slope(self, y: ca.MX, named: dict[str, ca.MX], at: tuple[ca.MX, ...]) -> ca.MX:
        """Return the derivative of the residual by y, by the chain rule."""
        # CasADi's own derivative would call the model's functions once for each of many directions.
        model, slots = self.model, self.layout.slots
        x1, rate1, _, z1 = self._end()
        ends = (x1, z1, rate1[slots] if slots else self.y[:0])
        jacobians = [ca.jacobian(v, self.y) for v in ends]
        slopes = ca.Function("slopes", self.arguments, jacobians, {"cse": True})
        by_x, by_z, kept = slopes(y, *self._own(named))
        count = ca.MX(1, self.n_y)
        count[0, self.n_y - 1] = ca.exp(y[-1] / _COUNT)
        rows = [count]
        if model.n_z:
            alg = [model.function(f"dalg_d{v}")(*at) for v in "xz"]
            rows.insert(0, alg[0] @ by_x + alg[1] @ by_z)
        if slots:
            of_rates = self.layout.slopes(model, by_x, by_z, *at)
            rows.insert(0, ca.diag(self._weights(named["h"])) @ (kept - of_rates))
        return ca.vertcat(*rows)


def _largest(values: Sequence[ca.SX]) -> ca.SX:
    """Return the largest absolute value."""
    return reduce(ca.fmax, map(ca.fabs, values))


def _verdict(n: int) -> ca.Function:
    """Build (y, y before the last correction) -> (size of this correction, iterations)."""
    y, before = ca.SX.sym("y", n), ca.SX.sym("before", n)
    size = _largest(ca.vertsplit(y - before))
    # fmax drops NaN, so a value that is not finite would look like a small correction.
    finite = ca.sumsqr(y) < ca.inf
    results = [ca.if_else(finite, size, ca.inf), -y[-1] / _COUNT]
    return ca.Function("verdict", [y, before], results)
