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

_SMALLEST = 1e-6  # of the step asked for: what a post-Newton step may cut it to
_ROUNDING = 1e-9  # of a step
Try = Callable[..., Any]
"""(state, h, data=None) -> the state after a step, or an `Outcome`."""


class Switch:
    """What happens to a state between steps.

    Fields:
        wish: step that the post-Newton step recommends next, s; infinite for none.
    """

    def __init__(
        self, model: Model, experiment: Experiment, attempt: Try, post: PostNewton, step: float
    ) -> None:
        self.model, self.experiment, self.attempt, self.post = model, experiment, attempt, post
        self.watch, self.wish, self.smallest = Watch(model, experiment), np.inf, step * _SMALLEST
        self._data = list(model.dae.data)
        self._point: Instant | None = None

    def begin(self, t: float, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """States and unknowns at the start, after what happens there."""
        if not self.model.events:
            return x, z
        self._point = self.watch.begin(t, x, z)
        return self._point.x, self._point.z

    def solved(self, s: Any, h: float) -> tuple[Any, float | None]:
        """The state after a step, with its data updated, and None; or, to cut it, a shorter step.

        See `post_newton` for the rules.
        """
        new = self.attempt(s, h)
        if not self.model.dae.updates or isinstance(new, Outcome):
            return new, None
        self.wish = np.inf
        for k in range(self.post.iterations + 1):
            u = self.watch.inputs(new.t)
            said = advice(self.model, new.t, new.x, new.z, u, self.experiment.p)
            wish = max(said.step, self.smallest) if said.step >= 0 else np.inf
            if said.error <= self.post.tolerance or h <= 1.001 * self.smallest:
                self.wish = wish
                return new._replace(x=said.x), None
            shorter = wish < h * (1 - _ROUNDING)
            if shorter or k == self.post.iterations:
                return new, max(self.smallest, wish if shorter else h / 2)
            new = self.attempt(s, h, data=said.x[self._data])
            if isinstance(new, Outcome):
                return new, None
        return new, None

    def after(self, s: Any, new: Any) -> Instant | None:
        """The point after the first event on the way, or with data that changed at its end."""
        if not self.model.events:
            changed = bool(self.model.dae.updates) and (new.x != s.x)[self._data].any()
            return self.watch.look(new.t, new.x, new.z) if changed else None
        start = self._point or self.watch.look(s.t, s.x, s.z)
        end = self.watch.look(new.t, new.x, new.z)
        found = self.watch.search(start, end, lambda _, t: self._within(s, t))
        if found is None:
            self._point = end
            return None
        self._point = self.watch.fire(found)
        return self._point

    def _within(self, s: Any, t: float) -> tuple[np.ndarray, np.ndarray] | None:
        """States and unknowns after a shorter step: smooth in its length, of the same order."""
        new = self.attempt(s, t - s.t - s.lag)
        return None if isinstance(new, Outcome) else (new.x, new.z)
