"""The smallest model of a scene, also where its plane of motion is no coordinate plane."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any, Protocol

import casadi as ca
import numpy as np

from ..dae.dae import Dae, Expansion
from ..dae.members import Hold, Label, Part
from ..dae.reduction import Reduction
from ..minimal import core, finish
from ..scene.scene import Scene
from . import ModelWarning
from .layout import Layout
from .plane import Plane, planes


class Formulation(Protocol):
    """A choice of coordinates: writes a scene as a `Dae`, and is the coordinates of its layout."""

    def write(self, scene: Scene) -> Dae:
        """The scene as a `Dae`."""
        ...


def smallest(scene: Scene, formulation: Any) -> tuple[Dae, Reduction]:
    """The reduced model; written in the axes of a plane of motion where that makes it smaller."""
    full = formulation.write(scene)
    small = core(full)
    best = (full, small, small, 0)
    if _turns_freely(scene, formulation, small):
        for plane in planes(scene):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ModelWarning)  # of this scene they are out
                other = formulation.write(plane.scene)
            flat = core(other)
            if _size(flat) < _size(best[1]):
                layout = Layout(plane.scene, formulation)
                best = (other, flat, _in_scene(full, flat, plane, layout), full.x.numel())
    return finish(*best)


def _size(dae: Dae) -> int:
    return int(dae.x.numel() + dae.z.numel())


def _turns_freely(scene: Scene, formulation: Any, small: Dae) -> bool:
    """Whether a body has kept more than one coordinate of its rotation."""
    layout, way = Layout(scene, formulation), small.expansion
    if way is None:
        return False
    moving = ca.vertcat(small.x, small.z)
    states = ca.vertsplit(way.states)
    for i in range(len(scene.bodies)):
        rows = layout.rows(i)[3:-6]
        live = [row for row in rows if states[row].is_symbolic()]
        if len(live) > 1 and ca.depends_on(way.states[live], moving):
            return True
    return False


def _in_scene(full: Dae, flat: Dae, plane: Plane, layout: Layout) -> Dae:
    """The model in the axes of a plane, with the states of the original scene before its own."""
    way, n = flat.expansion, full.x.numel()
    if way is None:
        raise ValueError(f"model '{full.name}': not reduced")
    renamed = _labels(plane, layout, way)
    labels = {old.name: new for old, new in zip(way.labels, renamed, strict=True)}
    measured = flat.measured if way.followers else flat.states
    bodies = layout.size * len(plane.turned)
    states = ca.vertcat(plane.way_back(layout, measured[:bodies]), measured[bodies:n], way.states)
    x, z = (
        ca.vertcat(ca.SX(0, 1), *(ca.SX.sym(labels[label.name].name) for label in own))
        for own in (flat.x_labels, flat.z_labels)
    )
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
        parts=tuple(_shifted(part, n) for part in flat.parts),
        events=tuple(_moved(event, n) for event in flat.events),
        holds=tuple(_moved(hold, n) for hold in flat.holds),
        updates=tuple(_moved(update, n) for update in flat.updates),
        motions=tuple(
            replace(m, coordinates=_plus(m.coordinates, n), velocities=_plus(m.velocities, n))
            for m in flat.motions
        ),
        balances=(),
        # Rows of the scene's rotations, then those of the same rotations in axes of the plane.
        rotations=(
            *full.rotations,
            *(
                replace(r, coordinates=_plus(r.coordinates, n), velocity=_plus(r.velocity, n))
                for r in flat.rotations
            ),
        ),
        notes=(*flat.notes, f"the motion is planar, with normal ({normal})"),
        expansion=Expansion(
            states,
            (*full.x_labels, *(labels[label.name] for label in way.labels)),
            (*nothing, *way.rows),
            (*nothing, *way.alg_rows),
        ),
        source=f"minimal\n{full.source}",
    )


def _plus(rows: tuple[int, ...], n: int) -> tuple[int, ...]:
    return tuple(row + n for row in rows)


def _shifted(part: Part, n: int) -> Part:
    return replace(part, reads=_plus(part.reads, n), ode_rows=_plus(part.ode_rows, n))


def _moved(item: Any, n: int) -> Any:
    """An event, hold or update with the states it reads, and changes, n rows further down."""
    changes = {} if isinstance(item, Hold) else {"rows": _plus(item.rows, n)}
    return replace(item, reads=_plus(item.reads, n), **changes)


def _labels(plane: Plane, layout: Layout, way: Expansion) -> list[Label]:
    """Labels of the states in the plane; those that mean what they do in the scene keep theirs."""
    labels = list(way.labels)
    for i, turned in enumerate(plane.turned):
        rows, same = layout.rows(i), bool((turned == np.eye(3)).all())
        renamed = [] if plane.keeps_world else [*rows[:3], *rows[-6:-3]]
        renamed += [] if plane.keeps_world and same else [*rows[3:-6], *rows[-3:]]
        for row in renamed:
            labels[row] = replace(labels[row], quantity=f"plane_{labels[row].quantity}")
    return labels
