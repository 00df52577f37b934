"""Passes that leave out what a scene does not need: `Dae -> (Dae, Reduction)`."""

from __future__ import annotations

from ..dae import Dae
from ..reduction import Reduction
from .balance import balance
from .freeze import freeze
from .planar import planar
from .suspects import suspects
from .transverse import dropped, inertial, replaced, transverse
from .unused import unused, without_effect

__all__ = ["balance", "freeze", "planar", "reduce"]


def reduce(dae: Dae) -> tuple[Dae, Reduction]:
    """All passes: what never moves, turns about one axis, has no inertia, is felt by no output.

    The small model is exact for every value of the states it keeps, the inputs and the parameters.
    """
    reduced = without_effect(unused(balance(planar(freeze(dae)))))
    left = dropped(dae, reduced)
    return reduced, Reduction(
        left,
        replaced(dae, reduced),
        inertial(dae, reduced),
        lambda: transverse(dae, reduced),
        lambda: suspects(dae, {d.name for d in left}),
    )
