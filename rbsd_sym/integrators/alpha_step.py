"""One step of generalized-alpha on R3 x SO(3) as a CasADi function, with Newton's method inside.

Unknowns are increments: tangent steps of the coordinates, steps of first-order states, and z.
Velocities and accelerations follow from them. An unknown acceleration would give the increment as a
difference of numbers as large as (h w)^2 times it: at h w = 1e4 that costs eight digits.
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

ITERATIONS = 12  # of Newton's method; where it converges it needs 2 to 5
_LITTLE = 0.03  # of 1 + |value|
_COUNT = 1e-30  # see `_Step._equations`


class Coefficients(NamedTuple):
    """Coefficients of generalized-alpha.

    With y' = f at the ends of the step, and y1 = y0 + h v0 + h^2 ((1/2 - beta) a0 + beta a1) for
    what has a velocity v and an acceleration a:

        y1 = y0 + h ((1 - gamma) a0 + gamma a1)
        (1 - alpha_m) a1 + alpha_m a0 = (1 - alpha_f) f1 + alpha_f f0
    """

    alpha_m: float
    alpha_f: float
    gamma: float
    beta: float

    @property
    def shift(self) -> float:
        """The a at time t is y' at t + shift h, to second order: both sides of the recursion."""
        return self.alpha_m - self.alpha_f

    @property
    def error(self) -> float:
        """Local error of y1, in units of h^3 y'''.

        By Taylor series: a = y' at t + shift h, plus k h^2 y''' with k from the recursion.
        """
        m, s = self.alpha_m, self.shift
        k = ((1 - self.alpha_f) - (1 - m) * (1 + s) ** 2 - m * s * s) / 2
        return k + ((1 - self.gamma) * s * s + self.gamma * (1 + s) ** 2) / 2 - 1 / 6

    @property
    def error_of_position(self) -> float:
        """Local error of a coordinate, in units of h^3 v''; v'' h is a1 - a0."""
        return self.beta + self.shift / 2 - 1 / 6


def second_order(rho: float) -> Coefficients:
    """For coordinates with velocities; rho is the spectral radius at infinite frequency.

    [Chung, Hulbert 1993; Arnold, Bruels 2007]. For rho = 1 the recursion reads
    a1 - f1 = -(a0 - f0): from a = f at the start it stays a = f, but rounding is carried on for
    ever. So a1 = f1 is used, which gives the same steps: those of the trapezoidal rule, since
    beta = 1/4 and gamma = 1/2.
    """
    if rho == 1:
        return Coefficients(0.0, 0.0, 0.5, 0.25)
    m, f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    gamma = 0.5 + f - m
    return Coefficients(m, f, gamma, (gamma + 0.5) ** 2 / 4)


def first_order(rho: float) -> Coefficients:
    """For states without velocities [Jansen, Whiting, Hulbert 2000], alphas counted from the end.

    All roots at infinite stiffness are -rho; with `second_order` the second would be -1/3 at
    rho = 0. Rho = 0 is BDF2, rho = 1 the trapezoidal rule (see `second_order`).
    """
    if rho == 1:
        return Coefficients(0.0, 0.0, 0.5, 0.0)
    return Coefficients((3 * rho - 1) / (2 * (rho + 1)), rho / (rho + 1), 1 / (rho + 1), 0.0)


class Moved(NamedTuple):
    """What a step moves: one unknown increment.

    Fields:
        slot: row of x where its rate and its a are kept.
        velocity: row of the full scene whose value is its rate; None for a row of ode.
        second: whether the slot is a velocity, and the increment that of its coordinate.
        with_velocity: whether it gets the coefficients of `second_order`.
        beside: rows of x that tell its size.
    """

    slot: int
    velocity: int | None
    second: bool
    with_velocity: bool
    beside: tuple[int, ...]


@dataclass(frozen=True)
class Tangent:
    """A motion with at least one live coordinate: its tangent step, component by component.

    Fields:
        parts: for each velocity its `Moved`, or None for a constant one.
        live: positions among the coordinates, and rows of x.
    """

    motion: Kinematics
    parts: tuple[Moved | None, ...]
    live: tuple[tuple[int, int], ...]


class Groups:
    """What a step moves, and how, from the kinematics of a `Dae`.

    - A velocity that is a state, with a live coordinate: second order.
    - One that is no state but follows from x and z (a damped motion without inertia): the tangent
      step is integrated like a first-order state; its history takes the slot of a coordinate.
    - A constant one: the step is time times velocity.
    - Every other state is of first order, data apart.
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
        """Row of x of a full state."""
        return self.dae.expansion.rows[row] if self.dae.expansion else row

    def _tangent(self, motion: Kinematics) -> Tangent | None:
        dae = self.dae
        places = [self._place(row) for row in motion.coordinates]
        live = tuple((i, place) for i, place in enumerate(places) if place is not None)
        moving, beside = ca.vertcat(dae.x, dae.z), tuple(place for _, place in live)
        slots, parts = iter(beside), list[Moved | None]()
        for row in motion.velocities:
            place = self._place(row)
            if place is not None:
                parts.append(Moved(place, None, True, True, beside))
            elif ca.depends_on(dae.states[row], moving):
                slot = next(slots, None)
                if slot is None:
                    return None
                parts.append(Moved(slot, row, False, False, beside))
            else:
                parts.append(None)
        return Tangent(motion, tuple(parts), live) if live else None

    @property
    def slots(self) -> list[int]:
        """Row of x for each increment."""
        return [part.slot for part in self.moved]

    @cached_property
    def _velocities(self) -> tuple[ca.Function, ca.Function]:
        """(x, z, p) -> rates that are no row of ode; their derivatives by x and z."""
        dae = self.dae
        rows = [part.velocity for part in self.moved if part.velocity is not None]
        value, symbols = pick(dae.states, rows), [dae.x, dae.z, dae.p]
        slopes = [ca.jacobian(value, v) for v in (dae.x, dae.z)]
        return ca.Function("velocities", symbols, [value]), ca.Function("slopes", symbols, slopes)

    @cached_property
    def _rows(self) -> list[int]:
        """Rows of all rates in [ode; velocities]."""
        rows, place = list[int](), int(self.dae.x.numel())
        for part in self.moved:
            rows.append(part.slot if part.velocity is None else place)
            place += part.velocity is not None
        return rows

    def rates(self, model: Model, t: Any, x: Any, z: Any, u: Any, p: Any) -> Any:
        """Rates of all that is moved, in order."""
        ode = model.function("ode")(t, x, z, u, p)
        both = ca.vertcat(ode, self._velocities[0](x, z, p))
        return both[self._rows] if self.moved else both[:0]

    def slopes(self, model: Model, by_x: ca.MX, by_z: ca.MX, *at: ca.MX) -> ca.MX:
        """Derivatives of the rates at (t, x, z, u, p) by what x and z have these derivatives by."""
        ode = [model.function(f"dode_d{v}")(*at) for v in "xz"]
        own = self._velocities[1](at[1], at[2], at[4])
        total = [ca.vertcat(a, b)[self._rows, :] for a, b in zip(ode, own, strict=True)]
        return total[0] @ by_x + total[1] @ by_z


def rates_function(model: Model) -> ca.Function:
    """(t, x, z, u, p) -> the rate kept with each row of x, which a start needs."""

    def build() -> ca.Function:
        layout = Groups(model.dae)
        symbols = _symbols(model, t=1, x=model.n_x, z=model.n_z, u=model.n_u, p=model.n_p)
        rates, place = layout.rates(model, *symbols), {row: i for i, row in enumerate(layout.slots)}
        rows = [place.get(row, len(place)) for row in range(model.n_x)]
        value = ca.vertcat(rates, 0)[rows] if rows else rates
        return ca.Function("rates", symbols, [ca.densify(value)], [*"txzup"], ["rates"])

    return model.cached("generalized_alpha rates", build)


def step_function(model: Model, rho: float, tolerance: float) -> ca.Function:
    """(t0, h, x0, rate0, a0, z0, u1, p) -> (x1, rate1, a1, z1, size, iterations).

    `rate` holds y' (of a velocity its acceleration) and `a` the method's own, a row for each state,
    zero where none is kept; a0 = rate0 at a start. Inputs u1 are those at the end of the step. It
    failed unless size <= tolerance: the largest correction of Newton's last iteration, relative to
    1 + |value|, infinite where a value is not finite. It generates to C.

    Arguments:
        rho: spectral radius at infinite frequency, 0 ... 1.
        tolerance: where Newton's method stops; more than 1e-15.
    """
    key = ("generalized_alpha step", rho, tolerance)
    return model.cached(key, lambda: _Step(model, rho).function(tolerance))


def _symbols(model: Model, **sizes: int) -> list[Any]:
    """Symbols of the kind that the model's functions take."""
    kind = ca.MX if model.calls else ca.SX
    return [kind.sym(name, n) for name, n in sizes.items()]


class _Step:
    """How the step function is put together.

    Unknowns are y, in units of 1 + |value|: increments, steps of z, and one that counts iterations.
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
        self.lengths = [_largest([dae.x[row] for row in m.beside]) for m in self.layout.moved]
        self.units = [1 + length for length in self.lengths]

    def function(self, tolerance: float) -> ca.Function:
        """The whole step: guess, Newton's method, and what follows from its result."""
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
        """What determines the end of a step, beside the unknowns."""
        return [given[name] for name in ("h", "x0", "rate0", "a0", "z0", "p")]

    def _origin(self, i: int) -> ca.SX:
        """What an increment is counted from: h v0, or 0 where that is larger than the coordinate.

        From h v0 the acceleration follows without a difference of close numbers. From 0 the
        increment itself does, where steps are much longer than a period.
        """
        part = self.layout.moved[i]
        free = self.h * self.dae.x[part.slot]
        return free * (ca.fabs(free) <= self.lengths[i]) if part.second else ca.SX(0)

    def _guess(self) -> ca.Function:
        """The unknowns of a step at constant a, as far as a moves but little.

        Of a stiff oscillation it would lead far away.
        """
        column = ca.SX.zeros(self.n_y)
        for i, part in enumerate(self.layout.moved):
            free = self.h * self.dae.x[part.slot] if part.second else ca.SX(0)
            bent = self.a0[part.slot] * (self.h**2 / 2 if part.second else self.h)
            bent = bent * (ca.fabs(bent) <= _LITTLE * self.units[i])
            column[i] = (free + bent - self._origin(i)) / self.units[i]
        return ca.Function("guess", self.arguments[1:], [column])

    def _end(self) -> list[ca.SX]:
        """[x1, rate1, a1, z1] from the unknowns."""
        dae, y, h, n = self.dae, self.y, self.h, self.dae.x.numel()
        x1, rate1, a1 = (list(ca.vertsplit(v)) for v in (dae.x, ca.SX.zeros(n), ca.SX.zeros(n)))
        steps = dict[Moved, ca.SX]()
        for i, part in enumerate(self.layout.moved):
            k, row = self.second if part.with_velocity else self.first, part.slot
            change, old = self.units[i] * y[i], self.a0[row]
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
        """Move the coordinates by their tangent steps."""
        states = self.dae.states
        for tangent in self.layout.tangents:
            motion = tangent.motion
            pairs = zip(motion.velocities, tangent.parts, strict=True)
            step = [self.h * states[row] if part is None else steps[part] for row, part in pairs]
            moved = motion.retract(pick(states, motion.coordinates), ca.vertcat(*step))
            for i, row in tangent.live:
                x1[row] = moved[i]

    def _weights(self, h: Any) -> Any:
        """Factors that turn rates into increments."""
        return ca.vertcat(*(h**2 if part.second else h for part in self.layout.moved))

    def _equations(self, end: ca.Function) -> tuple[ca.Function, ca.Function | None]:
        """(y, t0, h, ...) -> (residual, y), and for functions that are called its derivative, too.

        The result y is where the last correction of Newton's method started from. The last unknown
        counts the iterations: the root of exp(c) is farther away by 1 after each.
        """
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
        """Derivative of the residual, by the chain rule.

        CasADi's own would call the model's Jacobian once for each of many directions.
        """
        model, slots = self.model, self.layout.slots
        x1, rate1, _, z1 = self._end()
        ways = [ca.jacobian(v, self.y) for v in (x1, z1, rate1[slots] if slots else self.y[:0])]
        slopes = ca.Function("slopes", self.arguments, ways, {"cse": True})
        by_x, by_z, kept = slopes(y, *self._own(named))
        count = ca.MX(1, self.n_y)
        count[0, self.n_y - 1] = ca.exp(y[-1] / _COUNT)
        rows = [count]
        if model.n_z:
            alg = [model.function(f"dalg_d{v}")(*at) for v in "xz"]
            rows.insert(0, alg[0] @ by_x + alg[1] @ by_z)
        if slots:
            felt = self.layout.slopes(model, by_x, by_z, *at)
            rows.insert(0, ca.diag(self._weights(named["h"])) @ (kept - felt))
        return ca.vertcat(*rows)


def _largest(values: Sequence[ca.SX]) -> ca.SX:
    """The largest absolute value."""
    return reduce(ca.fmax, map(ca.fabs, values))


def _verdict(n: int) -> ca.Function:
    """(y, y before) -> (largest last correction, iterations); NaN is no correction at all."""
    y, before = ca.SX.sym("y", n), ca.SX.sym("before", n)
    size = _largest(ca.vertsplit(y - before))
    finite = ca.sumsqr(y) < ca.inf
    results = [ca.if_else(finite, size, ca.inf), -y[-1] / _COUNT]
    return ca.Function("verdict", [y, before], results)
