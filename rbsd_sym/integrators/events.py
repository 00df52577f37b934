"""Events along a run: when they fire, and in which order.

The rules, for all integrators:

- An event fires where its function falls through zero. The functions and their exact time
  derivatives are evaluated at check points along the run; the cubic through two neighbouring points
  shows a crossing between them that their signs do not show.
- A function that is zero (to rounding) at the start, or after an event, counts as being on the side
  to which it moves; one that does not move counts as above.
- An event fires only while it is armed. It is armed where its function is above zero, and spent
  once it has fired or another event has put its function below zero. An event with `at_once` is
  armed at the start even below zero, stays armed where another event puts its function below zero,
  and then fires at once.
- Events at one instant fire in the order of the model's list. After each one the algebraic unknowns
  are solved again, and all events are checked again.
- Endless events end the run: ten instants with events within 1e-10 of the run, thirty within 1e-6,
  a thousand within 1e-4, or a thousand events at one instant. So do changes of data by post-Newton
  steps whose times have to be searched for: two hundred within a thousandth of the run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..model.casadi_events import BAND, CLOSE, CROWD, INSTANT, Fired
from ..model.model import Model
from ..model.signals import is_constant
from ..model.trajectory import Outcome
from ..model.values import Experiment
from .driver import input_values

# So many instants with events within such a fraction of the run are endless.
_CROWDS = ((CROWD, CLOSE), (30, 1e-6), (1000, 1e-4))
# The same for changes of data by post-Newton steps, whose times are searched for.
SEARCHED = (*_CROWDS, (200, 1e-3))
# A continuous function is smaller than this where its crossing was located; a larger value is a
# jump of the function.
_FOUND = 1e-9
# Half the difference in time for the rate of an input, as a fraction of the run.
_DIFFERENCE = 1e-7
# Events at one instant, at most.
_AT_ONCE = 1000
# Depth of the search for a crossing that the signs at the ends do not show.
_DEPTH = 6
# Iterations in search of one crossing.
_REFINED = 150


class Instant(NamedTuple):
    """A check point of a run: the state, and the functions of the events.

    Fields:
        t: s.
        x, z: states (n_x,) and algebraic unknowns (n_z,).
        zero, rate: functions of the events (n_events,) and their rates per s.
    """

    t: float
    x: np.ndarray
    z: np.ndarray
    zero: np.ndarray
    rate: np.ndarray


class EventsDoNotEnd(Exception):
    """Events follow each other without end; `report` says how many, and when."""

    def __init__(self, t: float, report: str) -> None:
        super().__init__(report)
        self.t, self.report = t, report


class Stopped(Exception):
    """An event ends the run; `point` is the point after it."""

    def __init__(self, point: Instant, name: str) -> None:
        self.point, self.name = point, name


class Inconsistent(Exception):
    """No algebraic unknowns solve their equations after an event, at time `t`."""

    def __init__(self, t: float) -> None:
        self.t = t


class Lost(Exception):
    """The state at time `t` could not be computed in search of an event."""

    def __init__(self, t: float) -> None:
        self.t = t


class SegmentEnd(NamedTuple):
    """How a run, or a part of it, ended.

    Fields:
        outcome: None if IDAS failed; then `failed` is its `Run`, which says why.
        t: time at the end, s.
        report: sentence about the end; "" for the outcome's own.
        point: the last point, if the run ended at an event.
    """

    outcome: Outcome | None
    t: float
    report: str = ""
    failed: Any = None
    point: Instant | None = None


def guarded(go: Callable[[], Any]) -> Any:
    """Call `go`, and turn the exceptions of this module into a `SegmentEnd`.

    Returns:
        What `go` returns, or how an event, or the search for it, ended the run.
    """
    try:
        return go()
    except EventsDoNotEnd as endless:
        outcome = Outcome.endless_events
        return SegmentEnd(outcome, endless.t, f"{outcome.value}: {endless.report}")
    except Stopped as stopped:
        t, outcome = stopped.point.t, Outcome.event
        report = f"{outcome.value} '{stopped.name}' at t = {t:.9g} s"
        return SegmentEnd(outcome, t, report, point=stopped.point)
    except Inconsistent as lost:
        outcome = Outcome.not_consistent
        report = (
            f"{outcome.value} after an event at t = {lost.t:.9g} s; check what the event changes, "
            "or give the bodies without mass inertia"
        )
        return SegmentEnd(outcome, lost.t, report)
    except Lost as lost:
        outcome = Outcome.solver_failed
        report = (
            f"{outcome.value} in search of an event before t = {lost.t:.9g} s; tighten the "
            "tolerances, or check for a singularity there"
        )
        return SegmentEnd(outcome, lost.t, report)


Advance = Callable[[Instant, float], tuple[np.ndarray, np.ndarray] | None]
"""(point, t) -> x, z at the later time t (s), or None if that fails."""


@dataclass(eq=False)
class Watch:
    """The events of a model along one run: which are armed, and which have fired.

    A method calls `begin` at the start; for each step `search` between the points at its ends, and
    if that finds an event `fire`, from which point the method starts again.

    Fields:
        fired: the events that have fired so far.
        armed: (n_events,) whether each event fires when its function next falls through zero.
        at_once: (n_events,) whether each event also fires where it is put below zero.
        instant: s; times closer than this are one.

    Raises:
        ValueError: the model has events, but no states.
    """

    model: Model
    experiment: Experiment
    fired: list[Fired] = field(default_factory=list)

    def __post_init__(self) -> None:
        e, events = self.experiment, self.model.dae.events
        if events and not self.model.n_x:
            raise ValueError(
                f"model '{self.model.name}': events, but nothing moves, so that no states are "
                "left; compile it with minimal=False"
            )
        # A fraction of the run, but no less than the rounding of the time itself.
        self.instant = INSTANT * float(e.t[-1] - e.t[0]) + 4 * np.finfo(float).eps * abs(e.t[-1])
        self.armed = np.zeros(len(events), bool)
        self.at_once = np.array([event.at_once for event in events], bool)
        self._driven = not all(is_constant(signal) for signal in e.inputs)
        self._instants: list[float] = []
        self._floor = np.zeros(len(events))
        self._functions = tuple(self.model.function(f) for f in ("zero", "zero_rate", "jump"))

    def check(self, t: float, x: np.ndarray, z: np.ndarray) -> Instant:
        """Evaluate the functions of the events at one point."""
        return self.check_all(np.array([t]), x[None, :], z[None, :])[0]

    def check_all(self, t: np.ndarray, x: np.ndarray, z: np.ndarray) -> list[Instant]:
        """Evaluate the functions of the events at times (n,), states (n, n_x), unknowns (n, n_z).

        Rates include those of varying inputs; a rate that is not finite counts as 0.
        """
        if not t.size:
            return []
        u = input_values(self.experiment.inputs, t)
        p = np.repeat(self.experiment.p[:, None], len(t), axis=1)
        values = [np.array(f(t[None, :], x.T, z.T, u, p)) for f in self._functions[:2]]
        zero, rate = (np.reshape(v, (-1, len(t))).T for v in values)
        if self._driven:
            rate = rate + self._by_inputs(t, x, z, u, p)
        rate = np.where(np.isfinite(rate), rate, 0.0)
        return [Instant(float(t[k]), x[k], z[k], zero[k], rate[k]) for k in range(len(t))]

    def _by_inputs(
        self, t: np.ndarray, x: np.ndarray, z: np.ndarray, u: np.ndarray, p: np.ndarray
    ) -> np.ndarray:
        """Return what varying inputs add to the rates (n_events, n), by central differences."""
        step = _DIFFERENCE * float(self.experiment.t[-1] - self.experiment.t[0])
        inputs = self.experiment.inputs
        moves = (input_values(inputs, t + step) - input_values(inputs, t - step)) / (2 * step)
        slope = np.array(ca.DM(self.model.function("dzero_du")(t[None, :], x.T, z.T, u, p)))
        slope = slope.reshape(len(self.armed), len(t), len(u))
        return np.einsum("eku,uk->ke", slope, moves)

    def begin(self, t: float, x: np.ndarray, z: np.ndarray) -> Instant:
        """Arm the events at the start, fire those that are due, and return the point after them.

        Raises:
            EventsDoNotEnd, Stopped, Inconsistent: an event has ended the run.
        """
        point = self.check(t, x, z)
        self.armed = self.at_once | self._above(point)
        return self._cascade(point, [])

    def pass_on(self, point: Instant) -> None:
        """Arm the events whose functions are above zero at a point."""
        self.armed |= point.zero > 0

    def search(
        self, a: Instant, b: Instant, advance: Advance, depth: int = _DEPTH
    ) -> Instant | None:
        """Find the first event between two points; return None if there is none.

        Arguments:
            a, b: neighbouring points, a before b.
            advance: computes the state between them, from a.
            depth: how often the interval may still be divided for crossings that the signs at its
                ends do not show.

        Returns:
            The point just behind the crossing, before anything has fired.

        Raises:
            Lost: a state between the points could not be computed.
        """
        if self.crossing(b):
            return self.locate(a, b, advance)
        between = self.hidden(a, b) if depth else None
        if between is None:
            self.pass_on(b)
            return None
        middle = self.reach(a, between, advance)
        found = self.search(a, middle, advance, depth - 1)
        return found if found is not None else self.search(middle, b, advance, depth - 1)

    def reach(self, a: Instant, t: float, advance: Advance) -> Instant:
        """Advance from a to time t (s), and check the events there.

        Raises:
            Lost: the state at t could not be computed.
        """
        state = advance(a, t)
        if state is None:
            raise Lost(t)
        return self.check(t, *state)

    def crossing(self, b: Instant) -> bool:
        """Return whether an armed event has its function below zero at a point."""
        return bool((self.armed & (b.zero < -self._floor)).any())

    def hidden(self, a: Instant, b: Instant) -> float | None:
        """Return a time at which a function may have crossed zero and come back, or None.

        It is the time of an extremum of the cubic through both ends, with both rates, which lies on
        the other side of zero.
        """
        # The part of a Hermite cubic that comes from the end rates is at most 4/27 of h times each
        # of them, and the rest lies between the end values. Functions farther from 0 are skipped.
        reach = (b.t - a.t) * (np.abs(a.rate) + np.abs(b.rate)) * 4 / 27
        near = np.minimum(np.abs(a.zero), np.abs(b.zero)) <= reach
        for i in np.flatnonzero(near & ((a.zero < 0) == (b.zero < 0))):
            if b.zero[i] > 0 and not self.armed[i]:
                continue
            s = _extremum(a, b, int(i))
            if s is not None:
                return a.t + s * (b.t - a.t)
        return None

    def locate(self, a: Instant, b: Instant, advance: Advance) -> Instant:
        """Find the first point at which an armed event has crossed zero, to within an instant.

        The interval [a, b] must hold a crossing. It is narrowed by roots of cubics, and halved
        where these do not help.

        Raises:
            Lost: a state between the points could not be computed.
        """
        left, right, slow = a, b, 0
        for _ in range(_REFINED):
            width = right.t - left.t
            if width <= self.instant:
                break
            # Two iterations in a row that did not halve the interval: the function is not like a
            # cubic here, and bisection is sure to make progress.
            if slow < 2:
                guess = _first_root(left, right, self.armed, self._floor)
                # A guess at an end is moved inwards, so that the interval shrinks around the root.
                guess = max(left.t + self.instant / 2, min(guess, right.t - self.instant / 2))
            else:
                guess, slow = (left.t + right.t) / 2, 0
            point = self.reach(a, guess, advance)
            if self.crossing(point):
                right = point
            else:
                left = point
            slow = slow + 1 if right.t - left.t > width / 2 else 0
        return right

    def fire(self, point: Instant) -> Instant:
        """Fire the events at a point that `search` has found, and return the point after them.

        Raises:
            EventsDoNotEnd, Stopped, Inconsistent: an event has ended the run.
        """
        # Includes functions that came above zero since the last check and fall again here.
        self.armed |= self._above(point)
        # Rounding keeps a continuous function off zero where its crossing was located. Twice this
        # remainder counts as zero from now on, so that the same crossing is not found again.
        first = self.armed & (point.zero <= self._width(point))
        found = first & (np.abs(point.zero) <= _FOUND)
        excess = 2 * (np.abs(point.zero[found]) - self._floor[found])
        self._floor[found] = np.maximum(self._floor[found], excess)
        point = self._cascade(point, list(np.flatnonzero(first & (point.zero < 0))))
        self.count(point.t)
        return point

    def count(self, t: float, crowds: Sequence[tuple[int, float]] = _CROWDS) -> None:
        """Count an instant with an event or a change of data.

        Arguments:
            t: s.
            crowds: pairs (number of instants, fraction of the run) that count as endless.

        Raises:
            EventsDoNotEnd: too many instants are too close.
        """
        self._instants.append(t)
        run = float(self.experiment.t[-1] - self.experiment.t[0])
        for count, share in crowds:
            recent = self._instants[-count:]
            if len(recent) == count and recent[-1] - recent[0] <= share * run:
                how = f"the last {count} within {recent[-1] - recent[0]:.3g} s"
                raise self._endless(t, how)

    def _cascade(self, point: Instant, due: list[int]) -> Instant:
        """Fire the events that are due, in order, until none is.

        Arguments:
            due: indices of events to fire first, without another check.
        """
        for _ in range(_AT_ONCE):
            due = due or list(np.flatnonzero(self._due(point)))
            if not due:
                return point
            point, due = self._fired(point, int(min(due))), []
        raise self._endless(point.t, f"{_AT_ONCE} of them at once")

    def _endless(self, t: float, how: str) -> EventsDoNotEnd:
        last = f", the last '{self.fired[-1].name}'" if self.fired else " (changes of data)"
        number = len(self.fired) or len(self._instants)
        remedy = "raise the tolerance of PostNewton"
        if self.fired:
            remedy = "give the effects smoothing, or let an event stop the run"
        return EventsDoNotEnd(t, f"{number} events up to t = {t:.9g} s, {how}{last}; {remedy}")

    def _fired(self, point: Instant, i: int) -> Instant:
        """Fire event i, and return the point after it."""
        t, x = point.t, point.x
        u, p = self.inputs(t), self.experiment.p
        jump = np.array(self._functions[2](t, x, point.z, u, p)[:, i]).reshape(-1)
        self.fired.append(Fired(t, self.model.events[i]))
        z, consistent = point.z, True
        if self.model.n_z:
            z, consistent = self.model.consistent(t, x + jump, z, u, p)
        after = self.check(t, x + jump, z)
        if not consistent:
            raise Inconsistent(t)
        above = self._above(after)
        # What another event puts below zero has not fallen through it.
        self.armed &= self.at_once | (after.zero >= -self._width(after))
        self.armed |= above
        self.armed[i] = above[i]
        if self.model.dae.events[i].stops:
            raise Stopped(after, self.model.events[i])
        return after

    def _width(self, point: Instant) -> np.ndarray:
        """Return the size (n_events,) below which a function counts as zero.

        It is the change within a few instants, or the rounding found where it last crossed zero.
        """
        return np.maximum(BAND * self.instant * np.abs(point.rate), 2 * self._floor)

    def _above(self, point: Instant) -> np.ndarray:
        """Return which functions are above zero, or at zero and not falling."""
        width = self._width(point)
        return (point.zero > width) | ((point.zero >= -width) & (point.rate >= 0))

    def _due(self, point: Instant) -> np.ndarray:
        """Return which armed events fire now."""
        width = self._width(point)
        falls = (np.abs(point.zero) <= width) & (point.rate < 0)
        return self.armed & (falls | (self.at_once & (point.zero < -width)))

    def inputs(self, t: float) -> np.ndarray:
        """Return the values (n_u,) of the inputs at time t (s)."""
        return input_values(self.experiment.inputs, np.array([t]))[:, 0]


def _coefficients(a: Instant, b: Instant, i: int) -> tuple[float, float, float, float]:
    """Return the coefficients c of the Hermite cubic of function i between two points.

    c[0] + c[1] s + c[2] s^2 + c[3] s^3 over s = 0 ... 1 has the values and rates of both ends.
    """
    h = b.t - a.t
    f0, f1, d0, d1 = a.zero[i], b.zero[i], h * a.rate[i], h * b.rate[i]
    return f0, d0, 3 * (f1 - f0) - 2 * d0 - d1, 2 * (f0 - f1) + d0 + d1


def _extremum(a: Instant, b: Instant, i: int) -> float | None:
    """Return the s in 0 ... 1 of an extremum of the cubic on the other side of zero, or None."""
    c = _coefficients(a, b, i)
    slope = np.roots([3 * c[3], 2 * c[2], c[1]])
    for s in sorted(float(root.real) for root in slope if abs(root.imag) < 1e-12):
        if 0 < s < 1 and (c[0] + s * (c[1] + s * (c[2] + s * c[3])) < 0) != (a.zero[i] < 0):
            return s
    return None


def _first_root(a: Instant, b: Instant, armed: np.ndarray, floor: np.ndarray) -> float:
    """Return the earliest time at which the cubic of an armed function falls below -floor."""
    first = 1.0
    for i in np.flatnonzero(armed & (b.zero < -floor)):
        c = _coefficients(a, b, int(i))
        c = (c[0] + floor[i], *c[1:])
        inside = (s for s in _roots(c) if 0 <= s <= 1)
        falling = (s for s in inside if c[1] + s * (2 * c[2] + 3 * s * c[3]) < 0)
        first = min([first, *falling])
    return a.t + first * (b.t - a.t)


def _roots(c: tuple[float, float, float, float]) -> list[float]:
    """Return the real roots of c[0] + c[1] s + c[2] s^2 + c[3] s^3."""
    largest = max(map(abs, c))
    # A leading coefficient of rounding alone would cost the other roots their digits.
    kept = [k for k in range(4) if abs(c[k]) > 1e-13 * largest]
    if not kept or kept[-1] == 0:
        return []
    roots = np.roots(c[kept[-1] :: -1])
    found = []
    for root in (float(r.real) for r in roots if abs(r.imag) < 1e-9):
        # One Newton step removes the rounding of the eigenvalue solver behind np.roots.
        value = c[0] + root * (c[1] + root * (c[2] + root * c[3]))
        slope = c[1] + root * (2 * c[2] + 3 * root * c[3])
        found.append(root - value / slope if slope else root)
    return found
