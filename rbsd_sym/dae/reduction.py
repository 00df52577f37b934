"""What the passes left out of a model, and the Jacobian that shows whether that was harmless."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca


@dataclass(frozen=True)
class Dropped:
    """A state of the full scene that is not in the model, its default value, and the reason."""

    name: str
    value: float
    reason: str


@dataclass(frozen=True)
class Replaced:
    """A state of the full scene that follows from states of the model.

    Arguments:
        name: of the state.
        how: formula, or what it depends on.
        is_rate: whether it is the velocity of a motion without inertia, the rate of its
            coordinates.
    """

    name: str
    how: str
    is_rate: bool = False


@dataclass(frozen=True, eq=False)
class Reduction:
    """Account of a reduction: what was left out, and what is needed to judge it.

    Leaving out states that never move is exact, but the motion may be unstable against disturbances
    of them (buckling, for example); `transverse` shows that.

    Arguments:
        dropped: states that are gone; first those that never move, in the order of `transverse`.
        replaced: states that follow from others.
        inertial: for each state that never moves, whether its row is a rate (True) or a force that
            must vanish.
        build, probe: functions that make `transverse` and `suspects` when these are first asked
            for.
    """

    dropped: tuple[Dropped, ...]
    replaced: tuple[Replaced, ...]
    inertial: tuple[bool, ...]
    build: Callable[[], ca.Function]
    probe: Callable[[], tuple[str, ...]]

    @cached_property
    def transverse(self) -> ca.Function:
        """Jacobian (n, n) of the dropped rates by the dropped states, on the motion that was kept.

        It is a Function of (t, x, z, u, p), with idle parameters at the end of p. On that motion
        the full Jacobian is block triangular, so that its spectrum is that of the small model
        together with that of this block (except for a zero, the norm of a quaternion, where an
        angle replaced it).
        """
        return self.build()

    @cached_property
    def suspects(self) -> tuple[str, ...]:
        """States that random probing finds at rest, although no proof allows leaving them out."""
        return self.probe()

    @cached_property
    def varies(self) -> bool:
        """Whether `transverse` depends on anything but the parameters."""
        block = self.transverse
        return any(block.jac_sparsity(0, i).nnz() > 0 for i in range(4))
