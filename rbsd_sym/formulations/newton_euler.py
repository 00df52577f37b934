"""Newton-Euler equations about the centre of mass, for any choice of rotation coordinates.

m v' = f (world axes),   I w' + w x I w = tau (body axes)
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ..base.checks import at_default
from ..base.symbols import TIME, Leaf, default_values, to_expr
from ..dae.dae import Dae
from ..dae.members import Label, Part
from ..mechanics.motion import Wrench, gyroscopic, torque_on_body
from ..scene.elements import GROUND, Load, RigidBody
from ..scene.scene import Scene
from .audit import audit
from .connector import ConnectorWriter
from .layout import Coordinates, Layout, accelerations, kernel
from .outputs import OutputWriter
from .pack import (
    COMPLIANCE,
    INERTIA,
    MARKER,
    axes_without_inertia,
    compliance_column,
    has_mass,
    inertia_column,
    marker_column,
    marker_of,
)


def write(scene: Scene, coordinates: Coordinates, formulation: str) -> Dae:
    """Return the scene as a `Dae`, with one part for each body, load and active connector.

    Arguments:
        scene: the scene.
        coordinates: rotation coordinates of its bodies.
        formulation: name of the formulation, for the digest of the model.

    Raises:
        ValueError: an inertia that is singular other than about a body axis, or an unknown output.
    """
    for body in scene.bodies:
        _check_inertia(body)
    layout = Layout(scene, coordinates)
    cache: dict[Hashable, Any] = {}
    connectors = tuple(ConnectorWriter(layout, i, cache) for i in range(len(scene.connectors)))
    writer = OutputWriter(layout, connectors, cache)
    outputs = writer.write()
    acting = [writer for writer in connectors if writer.connector.acts]
    labels, start = _states(layout, acting)
    unknowns = tuple(label for writer in acting for label in writer.unknowns)
    return Dae(
        name=scene.name,
        t=TIME.expr,
        x=ca.vertcat(*(ca.SX.sym(label.name) for label in labels)),
        z=ca.vertcat(ca.SX(0, 1), *(ca.SX.sym(label.name) for label in unknowns)),
        u=_column(scene.inputs),
        p=_column(scene.params),
        x_labels=labels,
        z_labels=unknowns,
        u_labels=tuple(Label("", v.name, "", v.unit, v.value) for v in scene.inputs),
        p_labels=tuple(Label("", v.name, "", v.unit, v.value) for v in scene.params),
        x_start=start,
        z_start=ca.SX.zeros(len(unknowns)),
        parts=(*_bodies(layout), *_loads(layout), *(writer.part() for writer in acting)),
        outputs=outputs,
        requested=writer.requested(outputs),
        only_requested=bool(scene.outputs),
        notes=audit(scene),
        rotations=layout.rotations(),
        balances=tuple(b for i in range(len(scene.bodies)) for b in layout.balances(i)),
        motions=tuple(m for i in range(len(scene.bodies)) for m in layout.motions(i)),
        events=tuple(event for writer in acting for event in writer.events()),
        holds=tuple(hold for writer in acting for hold in writer.holds()),
        updates=tuple(update for writer in acting for update in writer.updates()),
        source=f"{formulation}\n{scene.text}",
    )


def _states(layout: Layout, acting: list[ConnectorWriter]) -> tuple[tuple[Label, ...], ca.SX]:
    """Return labels and start values: of the bodies, then of the connectors' own states."""
    scene = layout.scene
    labels = [label for body in scene.bodies for label in layout.labels(body)]
    own = [label for writer in acting for label in writer.labels]
    bodies = ca.vertcat(*(layout.start(body) for body in scene.bodies))
    # Labels show numbers at the default values of Params; the start itself keeps the symbols.
    values = default_values(bodies, scene.params).reshape(-1)
    found = [replace(label, start=float(v)) for label, v in zip(labels, values, strict=True)]
    return (*found, *own), ca.vertcat(bodies, *(label.start for label in own))


def _column(leaves: tuple[Leaf, ...]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(leaf.expr for leaf in leaves))


def _bodies(layout: Layout) -> list[Part]:
    """Return a part for each body: kinematics, gravity and gyroscopic torque."""
    x, c = ca.SX.sym("x", layout.size), ca.SX.sym("c", INERTIA + 3)
    inertia, inverse = ca.reshape(c[:9], 3, 3), ca.reshape(c[9:18], 3, 3)
    spin = -inverse @ gyroscopic(inertia, x[-3:])
    rates = ca.vertcat(layout.kinematic_rates(x)[:-6], c[INERTIA:], spin)
    function = kernel("body", x, c, rates, ca.SX(0, 1))
    # Without mass the row holds a force, in which gravity has no part.
    gravity, none = to_expr(layout.scene.gravity), ca.SX(3, 1)
    return [
        Part(
            body.name,
            function,
            layout.rows(i),
            (),
            ca.vertcat(inertia_column(body), gravity if has_mass(body) else none),
            layout.rows(i),
        )
        for i, body in enumerate(layout.scene.bodies)
    ]


def _loads(layout: Layout) -> list[Part]:
    moving = [load for load in layout.scene.loads if load.marker.body != GROUND]
    functions = {frame: _load_kernel(layout, frame) for frame in {load.frame for load in moving}}
    return [_load_part(layout, load, functions[load.frame]) for load in moving]


def _load_part(layout: Layout, load: Load, function: ca.Function) -> Part:
    i = layout.index(load.marker.body)
    body = layout.scene.bodies[i]
    constants = ca.vertcat(
        marker_column(load.marker, body),
        compliance_column(body),
        to_expr(load.force),
        to_expr(load.torque),
    )
    return Part(load.name, function, layout.rows(i), (), constants, layout.velocity_rows(i))


def _load_kernel(layout: Layout, frame: str) -> ca.Function:
    x, c = ca.SX.sym("x", layout.size), ca.SX.sym("c", MARKER + COMPLIANCE + 6)
    marker, compliance = marker_of(c[:MARKER]), c[MARKER : MARKER + COMPLIANCE]
    body = layout.body(x)
    wrench = Wrench(c[-6:-3], c[-3:])
    if frame == "body":
        R_WB = body.motion.frame.R_WA
        wrench = Wrench(R_WB @ wrench.f, R_WB @ wrench.tau)
    torque = torque_on_body(body, marker.p_BA, wrench)
    return kernel("load", x, c, accelerations(wrench.f, torque, compliance), ca.SX(0, 1))


def _check_inertia(body: RigidBody) -> None:
    if has_mass(body) and float(at_default(np.array(body.mass))) == 0:
        raise ValueError(
            f"body '{body.name}': mass is a Param of default 0 kg; whether a body has mass is part "
            "of the structure; write mass=0, inertia=0, or give the Param a positive default"
        )
    massless = axes_without_inertia(body)
    # Axes without inertia become balances of torque; about the others the inertia is inverted.
    rest = np.delete(np.delete(at_default(body.inertia), massless, 0), massless, 1)
    # A rod whose axis is oblique to the body frame has a singular inertia without a row of zeros.
    smallest = float(np.linalg.eigvalsh(rest)[0]) if rest.size else 1.0
    if smallest <= 1e-14 * float(np.abs(rest).max(initial=0.0)):
        raise ValueError(
            f"body '{body.name}': inertia has the principal value {smallest:.3g} kg m2 about an "
            "axis that is no axis of the body frame; turn the body frame along the rod, or give a "
            "positive inertia about every axis"
        )
