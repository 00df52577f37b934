"""What passes left out of a model, and the way to judge it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca


@dataclass(frozen=True)
class Dropped:
    """A state that is not in the model, its default value, and why it is not."""

    name: str
    value: float
    reason: str


@dataclass(frozen=True)
class Replaced:
    """A state of the full scene that follows from states of the model, and how.

    `is_rate` marks the velocity of a motion without inertia: the rate of its coordinates.
    """

    name: str
    how: str
    is_rate: bool = False


@dataclass(frozen=True, eq=False)
class Reduction:
    """What a pass left out, and what is needed to judge it.

    Arguments:
        dropped: the states that are gone; first those that never move, in the order of
            `transverse`.
        replaced: the states that follow from others.
        inertial: for each state that never moves whether its row is a rate, or a force that must
            vanish.
        build, probe: make `transverse` and `suspects`, when first asked for.
    """

    dropped: tuple[Dropped, ...]
    replaced: tuple[Replaced, ...]
    inertial: tuple[bool, ...]
    build: Callable[[], ca.Function]
    probe: Callable[[], tuple[str, ...]]

    @cached_property
    def transverse(self) -> ca.Function:
        """Jacobian of the dropped rates by the dropped states, on the kept manifold.

        Function (t, x, z, u, p). The full Jacobian is block triangular there, so its spectrum and
        that of the small model together are the full one (but for one zero, the norm of the
        quaternion, where an angle stands for it).
        """
        return self.build()

    @cached_property
    def suspects(self) -> tuple[str, ...]:
        """States that random probing sees at rest, but that no proof allows to leave out."""
        return self.probe()

    @cached_property
    def varies(self) -> bool:
        """Whether `transverse` depends on anything but the parameters."""
        block = self.transverse
        return any(block.jac_sparsity(0, i).nnz() > 0 for i in range(4))
