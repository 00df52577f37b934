"""Events along a run: which are watched, when they happen, in which order.

The rules, for all integrators:

- An event fires as its function falls through zero. Functions are known with their exact time
  derivatives at the points where one looks; between two of them their cubic tells of a crossing
  that the ends do not show.
- A function that is zero (to rounding) at the start, or after an event, counts on the side to which
  it moves; one that does not move counts as above.
- An event that may fire `at_once` also does so where the start, or another event, leaves its
  function below zero; any other one must have been above zero again before it can fire.
- Events at one instant happen in the order of the model's list. After each the algebraic unknowns
  are solved again and all events looked at anew. An event that has fired must have been above zero
  again before it can fire once more.
- Events without end end the run: ten instants within 1e-10 of it, thirty within 1e-6, a thousand
  within 1e-4, or a thousand events at one instant. So do changes of data by a post-Newton step that
  have to be searched for: two hundred within a thousandth of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..model.casadi_events import BAND, CLOSE, CROWD, INSTANT, Happened
from ..model.model import Model
from ..model.signals import is_constant
from ..model.trajectory import Outcome
from ..model.values import Experiment
from .driver import input_values

_CROWDS = ((CROWD, CLOSE), (30, 1e-6), (1000, 1e-4))  # instants, and their share of a run
SEARCHED = (*_CROWDS, (200, 1e-3))  # of changes of data
_FOUND = 1e-9  # a function that does not jump is nearer to zero where it was found to cross it
_DIFFERENCE = 1e-7  # of the run, for the rate of an input
_AT_ONCE = 1000
_DEPTH = 6  # halvings in search of a crossing that the ends do not show
_REFINED = 150  # looks in search of one crossing


class Instant(NamedTuple):
    """A state of the run, and there the functions of the events and their rates."""

    t: float
    x: np.ndarray
    z: np.ndarray
    zero: np.ndarray
    rate: np.ndarray


class EventsDoNotEnd(Exception):
    """Events that follow each other without end; `report` tells how many, and when."""

    def __init__(self, t: float, report: str) -> None:
        super().__init__(report)
        self.t, self.report = t, report


class Stopped(Exception):
    """An event that ends the run, and the point after it."""

    def __init__(self, point: Instant, name: str) -> None:
        self.point, self.name = point, name


class Inconsistent(Exception):
    """No algebraic unknowns after an event."""

    def __init__(self, t: float) -> None:
        self.t = t


class Lost(Exception):
    """The state could not be computed on the way to an event."""

    def __init__(self, t: float) -> None:
        self.t = t


class SegmentEnd(NamedTuple):
    """How a walk ended: no outcome but a failed run if IDAS failed; the last point, if known."""

    outcome: Outcome | None
    t: float
    report: str = ""
    failed: Any = None
    point: Instant | None = None


def guarded(go: Callable[[], Any]) -> Any:
    """What `go` returns, or the `SegmentEnd` that an event makes of it."""
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
        return SegmentEnd(outcome, lost.t, f"{outcome.value} after an event at t = {lost.t:.9g} s")
    except Lost as lost:
        outcome = Outcome.solver_failed
        report = (
            f"{outcome.value} in search of an event before t = {lost.t:.9g} s; tighten the "
            "tolerances, or look for a singularity there"
        )
        return SegmentEnd(outcome, lost.t, report)


Advance = Callable[[Instant, float], tuple[np.ndarray, np.ndarray] | None]
"""(point, t) -> x, z at the later time t, or None if that fails."""


@dataclass(eq=False)
class Watch:
    """The events of a model along one run.

    Fields:
        happened: what has fired so far.
        armed: whether each event would fire as it falls; kept up to date by `begin` and `pass_on`.
        at_once: whether each event may fire at once.

    Raises:
        ValueError: the model has events and no states.
    """

    model: Model
    experiment: Experiment
    happened: list[Happened] = field(default_factory=list)

    def __post_init__(self) -> None:
        e, events = self.experiment, self.model.dae.events
        if events and not self.model.n_x:
            raise ValueError(
                f"model '{self.model.name}': events, but nothing moves, so that no states are "
                "left; compile it with minimal=False"
            )
        self.instant = INSTANT * float(e.t[-1] - e.t[0]) + 4 * np.finfo(float).eps * abs(e.t[-1])
        self.armed = np.zeros(len(events), bool)
        self.at_once = np.array([event.at_once for event in events], bool)
        self._driven = not all(is_constant(signal) for signal in e.inputs)
        self._instants: list[float] = []
        self._floor = np.zeros(len(events))
        self._functions = tuple(self.model.function(f) for f in ("zero", "zero_rate", "jump"))

    def look(self, t: float, x: np.ndarray, z: np.ndarray) -> Instant:
        """The point with its functions and rates."""
        return self.look_at(np.array([t]), x[None, :], z[None, :])[0]

    def look_at(self, t: np.ndarray, x: np.ndarray, z: np.ndarray) -> list[Instant]:
        """Points at times (n,), states (n, n_x) and unknowns (n, n_z)."""
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
        """What moving inputs add to the rates, by differences."""
        step = _DIFFERENCE * float(self.experiment.t[-1] - self.experiment.t[0])
        inputs = self.experiment.inputs
        moves = (input_values(inputs, t + step) - input_values(inputs, t - step)) / (2 * step)
        slope = np.array(ca.DM(self.model.function("dzero_du")(t[None, :], x.T, z.T, u, p)))
        slope = slope.reshape(len(self.armed), len(t), len(u))
        return np.einsum("eku,uk->ke", slope, moves)

    def begin(self, t: float, x: np.ndarray, z: np.ndarray) -> Instant:
        """The first point, after what fires there at once.

        Raises:
            EventsDoNotEnd, Stopped, Inconsistent: see there.
        """
        point = self.look(t, x, z)
        self.armed = self.at_once | self._above(point)
        return self._cascade(point, [])

    def pass_on(self, point: Instant) -> None:
        """Take note of functions that have come above zero."""
        self.armed |= point.zero > 0

    def search(
        self, a: Instant, b: Instant, advance: Advance, depth: int = _DEPTH
    ) -> Instant | None:
        """The point of the first event between two points, if there is one.

        Raises:
            Lost: see there.
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
        """The point at a time.

        Raises:
            Lost: the way there fails.
        """
        state = advance(a, t)
        if state is None:
            raise Lost(t)
        return self.look(t, *state)

    def crossing(self, b: Instant) -> bool:
        """Whether an event has fired before a point, as far as it shows."""
        return bool((self.armed & (b.zero < -self._floor)).any())

    def hidden(self, a: Instant, b: Instant) -> float | None:
        """A time between at which a function may have crossed zero and come back, if any.

        That of the extremum of a cubic which lies on the other side of both ends.
        """
        # A cubic stays within 4/27 of the rates' way of its smaller end.
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
        """The first point at which an armed event has crossed, to an instant.

        [a, b] holds a crossing. The roots of cubics close in on it, halvings where they do not.

        Raises:
            Lost: see there.
        """
        left, right, slow = a, b, 0
        for _ in range(_REFINED):
            width = right.t - left.t
            if width <= self.instant:
                break
            if slow < 2:
                guess = _first_root(left, right, self.armed, self._floor)
                # At an end, look just beyond it, to have the crossing between both.
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
        """What happens at a point that `locate` has found.

        Raises:
            EventsDoNotEnd, Stopped, Inconsistent: see there.
        """
        self.armed |= self._above(point)  # also what has just come up, and may turn back
        first = self.armed & (point.zero <= self._width(point))
        found = first & (np.abs(point.zero) <= _FOUND)
        excess = 2 * (np.abs(point.zero[found]) - self._floor[found])
        self._floor[found] = np.maximum(self._floor[found], excess)
        point = self._cascade(point, list(np.flatnonzero(first & (point.zero < 0))))
        self.count(point.t)
        return point

    def count(self, t: float, crowds: Sequence[tuple[int, float]] = _CROWDS) -> None:
        """Count an instant at which something happened.

        Raises:
            EventsDoNotEnd: too many, too close.
        """
        self._instants.append(t)
        run = float(self.experiment.t[-1] - self.experiment.t[0])
        for count, share in crowds:
            recent = self._instants[-count:]
            if len(recent) == count and recent[-1] - recent[0] <= share * run:
                how = f"the last {count} within {recent[-1] - recent[0]:.3g} s"
                raise self._endless(t, how)

    def _cascade(self, point: Instant, due: list[int]) -> Instant:
        """Fire what is due, in order, until nothing is."""
        for _ in range(_AT_ONCE):
            due = due or list(np.flatnonzero(self._due(point)))
            if not due:
                return point
            point, due = self._fired(point, int(min(due))), []
        raise self._endless(point.t, f"{_AT_ONCE} of them at once")

    def _endless(self, t: float, how: str) -> EventsDoNotEnd:
        last = f", the last '{self.happened[-1].name}'" if self.happened else " (changes of data)"
        number = len(self.happened) or len(self._instants)
        return EventsDoNotEnd(t, f"{number} events up to t = {t:.9g} s, {how}{last}")

    def _fired(self, point: Instant, i: int) -> Instant:
        t, x = point.t, point.x
        u, p = self.inputs(t), self.experiment.p
        jump = np.array(self._functions[2](t, x, point.z, u, p)[:, i]).reshape(-1)
        self.happened.append(Happened(t, self.model.events[i]))
        z, consistent = point.z, True
        if self.model.n_z:
            z, consistent = self.model.consistent(t, x + jump, z, u, p)
        after = self.look(t, x + jump, z)
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
        """What counts as zero: some instants of its motion, and the rounding at its last event."""
        return np.maximum(BAND * self.instant * np.abs(point.rate), 2 * self._floor)

    def _above(self, point: Instant) -> np.ndarray:
        """Events whose function is above zero, or on it and not about to fall."""
        width = self._width(point)
        return (point.zero > width) | ((point.zero >= -width) & (point.rate >= 0))

    def _due(self, point: Instant) -> np.ndarray:
        """Armed events that fire now."""
        width = self._width(point)
        falls = (np.abs(point.zero) <= width) & (point.rate < 0)
        return self.armed & (falls | (self.at_once & (point.zero < -width)))

    def inputs(self, t: float) -> np.ndarray:
        """Values of the inputs."""
        return input_values(self.experiment.inputs, np.array([t]))[:, 0]


def _coefficients(a: Instant, b: Instant, i: int) -> tuple[float, float, float, float]:
    """The cubic through two values with two rates, over s = 0 ... 1."""
    h = b.t - a.t
    f0, f1, d0, d1 = a.zero[i], b.zero[i], h * a.rate[i], h * b.rate[i]
    return f0, d0, 3 * (f1 - f0) - 2 * d0 - d1, 2 * (f0 - f1) + d0 + d1


def _extremum(a: Instant, b: Instant, i: int) -> float | None:
    """Where the cubic has crossed zero and comes back, if it does."""
    c = _coefficients(a, b, i)
    slope = np.roots([3 * c[3], 2 * c[2], c[1]])
    for s in sorted(float(root.real) for root in slope if abs(root.imag) < 1e-12):
        if 0 < s < 1 and (c[0] + s * (c[1] + s * (c[2] + s * c[3])) < 0) != (a.zero[i] < 0):
            return s
    return None


def _first_root(a: Instant, b: Instant, armed: np.ndarray, floor: np.ndarray) -> float:
    """The earliest time at which the cubic of a crossing function falls below -floor."""
    first = 1.0
    for i in np.flatnonzero(armed & (b.zero < -floor)):
        c = _coefficients(a, b, int(i))
        c = (c[0] + floor[i], *c[1:])
        inside = (s for s in _roots(c) if 0 <= s <= 1)
        falling = (s for s in inside if c[1] + s * (2 * c[2] + 3 * s * c[3]) < 0)
        first = min([first, *falling])
    return a.t + first * (b.t - a.t)


def _roots(c: tuple[float, float, float, float]) -> list[float]:
    """Real roots of c[0] + c[1] s + c[2] s^2 + c[3] s^3."""
    largest = max(map(abs, c))
    # A leading coefficient of rounding alone would cost the other roots their digits.
    kept = [k for k in range(4) if abs(c[k]) > 1e-13 * largest]
    if not kept or kept[-1] == 0:
        return []
    roots = np.roots(c[kept[-1] :: -1])
    found = []
    for root in (float(r.real) for r in roots if abs(r.imag) < 1e-9):
        value = c[0] + root * (c[1] + root * (c[2] + root * c[3]))
        slope = c[1] + root * (2 * c[2] + 3 * root * c[3])
        found.append(root - value / slope if slope else root)
    return found
