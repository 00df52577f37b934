"""Passes that leave out what a scene does not need: `Dae -> (Dae, Reduction)`. See README.md."""

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
    """Return the `Dae` after all passes, and a record of what they left out.

    States that never move are gone, a body that turns about one axis has one angle, motions without
    inertia are algebraic, and what no requested output depends on is gone. The result is exact for
    all values of the remaining states, the inputs and the parameters.

    Raises:
        ValueError: a motion without inertia that its balance does not determine.
    """
    small = core(dae)
    return finish(dae, small, small)


def core(dae: Dae) -> Dae:
    """Apply the passes that depend on the motion only, not on the requested outputs."""
    return balance(planar(freeze(dae)))


def finish(full: Dae, small: Dae, written: Dae, shift: int = 0) -> tuple[Dae, Reduction]:
    """Apply the passes that depend on the requested outputs, and record what all passes left out.

    Arguments:
        full, small: a model before and after `core`.
        written: `small`, or the same motion as part of the states of another scene
            (`formulations/in_plane.py`).
        shift: row at which the states of `small` start among those of `written`.
    """
    # The account is taken on `small`, since `unused` may drop states that the reasons refer to.
    reduced = without_effect(unused(written))
    still = never_moving(small)
    left = dropped([shift + i for i in still], reduced)
    names = {d.name for d in left}

    # Probing the full model is left until someone reads the notes.
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
