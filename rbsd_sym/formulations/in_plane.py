"""The smallest model of a scene, also if its plane of motion is not a coordinate plane."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any, Protocol

import casadi as ca
import numpy as np

from ..dae.dae import Dae, Expansion
from ..dae.members import Label
from ..dae.reduction import Reduction
from ..minimal import core, finish
from ..scene.scene import Scene
from . import ModelWarning
from .layout import Layout
from .plane import Plane, planes


class Formulation(Protocol):
    """A choice of coordinates that can write a scene as a `Dae`.

    `Quaternion` and `TaitBryan` are the two; a formulation also serves as the `Coordinates` of a
    `Layout`.
    """

    def write(self, scene: Scene) -> Dae:
        """Return the scene as a `Dae`."""
        ...


def smallest(scene: Scene, formulation: Any) -> tuple[Dae, Reduction]:
    """Return the smallest model of a scene, and the account of what was left out.

    The passes of `minimal` recognise planar motion only if its normal is a world axis. If a body
    keeps more than one rotation coordinate, the scene is written again in the axes of each
    candidate plane, and the smallest result is kept; its states are mapped back to those of the
    original scene.

    Arguments:
        scene: the scene.
        formulation: a `Formulation`.
    """
    full = formulation.write(scene)
    small = core(full)
    best = (full, small, small, 0)
    if _turns_freely(scene, formulation, small):
        for plane in planes(scene):
            with warnings.catch_warnings():
                # The first `write` has issued the warnings of this scene already.
                warnings.simplefilter("ignore", ModelWarning)
                # Expensive, and therefore only for scenes in which some body turns freely.
                other = formulation.write(plane.scene)
            flat = core(other)
            if _size(flat) < _size(best[1]):
                layout = Layout(plane.scene, formulation)
                best = (other, flat, _in_scene(full, flat, plane, layout), full.x.numel())
    return finish(*best)


def _size(dae: Dae) -> int:
    return int(dae.x.numel() + dae.z.numel())


def _turns_freely(scene: Scene, formulation: Any, small: Dae) -> bool:
    """Return whether some body has kept more than one rotation coordinate."""
    layout, expansion = Layout(scene, formulation), small.expansion
    if expansion is None:
        return False
    moving = ca.vertcat(small.x, small.z)
    states = ca.vertsplit(expansion.states)
    for i in range(len(scene.bodies)):
        # The rotation coordinates; where the planar pass has found an angle, at most one of them is
        # still a state of its own.
        rows = layout.rows(i)[3:-6]
        live = [row for row in rows if states[row].is_symbolic()]
        if len(live) > 1 and ca.depends_on(expansion.states[live], moving):
            return True
    return False


def _in_scene(full: Dae, flat: Dae, plane: Plane, layout: Layout) -> Dae:
    """Return the model in the axes of a plane, as a reduction of the original scene.

    Its full states are those of the original scene, n rows, followed by those of the scene in the
    plane, so that outputs of the original scene and parts of the other both find what they read.
    """
    expansion, n = flat.expansion, full.x.numel()
    if expansion is None:
        raise ValueError(f"model '{full.name}': not reduced; apply `minimal.core` first")
    renamed = _labels(plane, layout, expansion)
    labels = {old.name: new for old, new in zip(expansion.labels, renamed, strict=True)}
    measured = flat.measured if expansion.followers else flat.states
    bodies = layout.size * len(plane.turned)
    states = ca.vertcat(
        plane.way_back(layout, measured[:bodies]), measured[bodies:n], expansion.states
    )
    x, z = (
        ca.vertcat(ca.SX(0, 1), *(ca.SX.sym(labels[label.name].name) for label in own))
        for own in (flat.x_labels, flat.z_labels)
    )
    # The symbols take the names of the new labels, since code and messages show them.
    states = ca.substitute(states, ca.vertcat(flat.x, flat.z), ca.vertcat(x, z))
    nothing: tuple[int | None, ...] = (None,) * n
    normal = ", ".join(f"{v:.6g}" for v in plane.normal)
    return replace(
        full,
        x=x,
        z=z,
        x_start=flat.x_start,
        z_start=flat.z_start,
        x_labels=tuple(labels[label.name] for label in flat.x_labels),
        z_labels=tuple(replace(labels[label.name], start=label.start) for label in flat.z_labels),
        parts=_further_down(flat.parts, n, "reads", "ode_rows"),
        events=_further_down(flat.events, n, "reads", "rows"),
        holds=_further_down(flat.holds, n, "reads"),
        updates=_further_down(flat.updates, n, "reads", "rows"),
        motions=_further_down(flat.motions, n, "coordinates", "velocities"),
        balances=(),
        # Rows of the scene's rotations, then those of the same rotations in axes of the plane.
        rotations=(*full.rotations, *_further_down(flat.rotations, n, "coordinates", "velocity")),
        notes=(*flat.notes, f"the motion is planar, with normal ({normal})"),
        expansion=Expansion(
            states,
            (*full.x_labels, *(labels[label.name] for label in expansion.labels)),
            (*nothing, *expansion.rows),
            (*nothing, *expansion.alg_rows),
        ),
        source=f"minimal\n{full.source}",
    )


def _further_down(items: tuple[Any, ...], n: int, *fields: str) -> tuple[Any, ...]:
    """Return parts, events, ... whose rows of full states, in these fields, are n further down."""
    return tuple(
        replace(item, **{key: tuple(row + n for row in getattr(item, key)) for key in fields})
        for item in items
    )


def _labels(plane: Plane, layout: Layout, expansion: Expansion) -> list[Label]:
    """Return labels of the states in the plane.

    A state that means the same as in the original scene keeps its label; the others are called
    plane_<quantity>.
    """
    labels = list(expansion.labels)
    for i, turned in enumerate(plane.turned):
        rows, same = layout.rows(i), bool((turned == np.eye(3)).all())
        renamed = [] if plane.keeps_world else [*rows[:3], *rows[-6:-3]]
        renamed += [] if plane.keeps_world and same else [*rows[3:-6], *rows[-3:]]
        for row in renamed:
            labels[row] = replace(labels[row], quantity=f"plane_{labels[row].quantity}")
    return labels
