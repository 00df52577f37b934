"""Passes that leave out what a scene does not need: `Dae -> (Dae, Reduction)`."""

from __future__ import annotations

from ..dae import Dae, Reduction
from .balance import balance
from .freeze import freeze
from .planar import planar
from .transverse import dropped, inertial, transverse

__all__ = ["balance", "freeze", "planar", "reduce"]


def reduce(dae: Dae) -> tuple[Dae, Reduction]:
    """All passes: what never moves, turns about one axis, motions without inertia.

    The small model is exact for every value of the states it keeps, the inputs and the parameters.
    """
    reduced = balance(planar(freeze(dae)))
    return reduced, Reduction(
        dropped(dae, reduced), inertial(dae, reduced), lambda: transverse(dae, reduced)
    )
