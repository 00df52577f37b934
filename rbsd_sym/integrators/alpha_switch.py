"""Events and post-Newton steps between the steps of generalized-alpha."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ..model.model import Model
from ..model.trajectory import Outcome
from ..model.values import Experiment
from .events import Instant, Watch
from .post_newton import PostNewton, advice

# Post-Newton steps may shorten a step to this fraction of the one asked for.
_SMALLEST = 1e-6
# Relative rounding of a step.
_ROUNDING = 1e-9
Try = Callable[..., Any]
"""(state, h, data=None) -> the state after a step, or an `Outcome`."""


class Switch:
    """Events and post-Newton steps of one run, which change a state between two steps.

    Arguments:
        attempt: tries a step, `Stepper.try_step`.
        step: the step asked for, s.

    Fields:
        proposed: next step that the post-Newton step recommends, s; infinite for none.
    """

    def __init__(
        self, model: Model, experiment: Experiment, attempt: Try, post: PostNewton, step: float
    ) -> None:
        self.model, self.experiment, self.attempt, self.post = model, experiment, attempt, post
        self.watch, self.proposed, self.smallest = (
            Watch(model, experiment),
            np.inf,
            step * _SMALLEST,
        )
        self._data = list(model.dae.data)
        self._point: Instant | None = None

    def begin(self, t: float, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states and unknowns at the start, after the events that fire there."""
        if not self.model.events:
            return x, z
        self._point = self.watch.begin(t, x, z)
        return self._point.x, self._point.z

    def solved(self, s: Any, h: float) -> tuple[Any, float | None]:
        """Solve a step with its post-Newton steps, by the rules in `post_newton`.

        Returns:
            The state after the step (or the `Outcome` of a failure) and None; or, if the step has
            to be shortened, a state to be discarded and the shorter step in s.
        """
        new = self.attempt(s, h)
        if not self.model.dae.updates or isinstance(new, Outcome):
            return new, None
        self.proposed = np.inf
        for k in range(self.post.iterations + 1):
            u = self.watch.inputs(new.t)
            response = advice(self.model, new.t, new.x, new.z, u, self.experiment.p)
            proposed = max(response.step, self.smallest) if response.step >= 0 else np.inf
            # At the smallest step an error above the tolerance is accepted: no step could be cut.
            if response.error <= self.post.tolerance or h <= 1.001 * self.smallest:
                self.proposed = proposed
                return new._replace(x=response.x), None
            shorter = proposed < h * (1 - _ROUNDING)
            if shorter or k == self.post.iterations:
                return new, max(self.smallest, proposed if shorter else h / 2)
            new = self.attempt(s, h, data=response.x[self._data])
            if isinstance(new, Outcome):
                return new, None
        return new, None

    def after(self, s: Any, new: Any) -> Instant | None:
        """Fire the first event within a step.

        Arguments:
            s, new: states before and after the step.

        Returns:
            The point after the event, or the end of the step if its data changed there, from which
            the integration has to start again; None if neither happened.
        """
        if not self.model.events:
            changed = bool(self.model.dae.updates) and (new.x != s.x)[self._data].any()
            return self.watch.check(new.t, new.x, new.z) if changed else None
        start = self._point or self.watch.check(s.t, s.x, s.z)
        end = self.watch.check(new.t, new.x, new.z)
        found = self.watch.search(start, end, lambda _, t: self._within(s, t))
        if found is None:
            self._point = end
            return None
        self._point = self.watch.fire(found)
        return self._point

    def _within(self, s: Any, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Return states and unknowns at a time within a step, by a shorter step, or None.

        Unlike an interpolant it has the accuracy of the method, and it is smooth in t.
        """
        new = self.attempt(s, t - s.t - s.lag)
        return None if isinstance(new, Outcome) else (new.x, new.z)
