"""Passes that leave out what a scene does not need: `Dae -> (Dae, Reduction)`."""

from __future__ import annotations

import numpy as np

from ..dae.dae import Dae
from ..dae.reduction import Reduction
from .balance import balance
from .freeze import freeze
from .planar import planar
from .probing import at_rest
from .transverse import dropped, inertial, never_moving, replaced, transverse
from .unused import unused, without_effect

__all__ = ["balance", "core", "finish", "reduce"]


def reduce(dae: Dae) -> tuple[Dae, Reduction]:
    """All passes: what never moves, turns about one axis, has no inertia, is felt by no output.

    The small model is exact for every value of the states it keeps, the inputs and the parameters.
    """
    small = core(dae)
    return finish(dae, small, small)


def core(dae: Dae) -> Dae:
    """The passes that look at the motion alone."""
    return balance(planar(freeze(dae)))


def finish(full: Dae, small: Dae, written: Dae, shift: int = 0) -> tuple[Dae, Reduction]:
    """The passes that look at what is wanted, and the account of all that was left out.

    Arguments:
        full, small: a model before and after `core`.
        written: the small one again, perhaps with its states among those of another scene.
        shift: where they start there.
    """
    reduced = without_effect(unused(written))
    still = never_moving(small)
    left = dropped([shift + i for i in still], reduced)
    names = {d.name for d in left}

    def seen() -> tuple[str, ...]:
        labels = reduced.expansion.labels[shift:] if reduced.expansion else ()
        return tuple(
            name for i in np.flatnonzero(at_rest(full)) if (name := labels[i].name) not in names
        )

    return reduced, Reduction(
        left,
        replaced(left, reduced),
        inertial(full, still),
        lambda: transverse(full, small, written, reduced),
        seen,
    )
