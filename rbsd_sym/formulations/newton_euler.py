"""Newton-Euler equations about the centre of mass; the choice of rotation coordinates is open.

m v' = f (world axes),  I w' + w x I w = tau (body axes).
"""

from __future__ import annotations

from collections.abc import Hashable

import casadi as ca
import numpy as np

from ..checks import at_default
from ..dae import Dae, Label, Part
from ..elements import GROUND, Load, RigidBody
from ..mechanics import Wrench, gyroscopic
from ..scene import Scene
from ..symbols import TIME, Leaf, default_values, to_expr
from .audit import audit
from .columns import (
    COMPLIANCE,
    INERTIA,
    MARKER,
    compliance_column,
    inertia_column,
    marker_column,
    marker_of,
)
from .connector import ConnectorWriter
from .layout import Coordinates, Layout, accelerations, kernel
from .outputs import OutputWriter


def write(scene: Scene, coordinates: Coordinates, formulation: str) -> Dae:
    """The scene as a `Dae`, one part for each body, load and active connector.

    Raises:
        ValueError: a body without mass or with a singular inertia, an unknown output.
    """
    for body in scene.bodies:
        _check_has_inertia(body)
    layout = Layout(scene, coordinates)
    cache: dict[Hashable, ca.Function] = {}
    connectors = tuple(ConnectorWriter(layout, i, cache) for i in range(len(scene.connectors)))
    writer = OutputWriter(layout, connectors, cache)
    outputs = writer.write()
    labels = [label for body in scene.bodies for label in layout.labels(body)]
    start = ca.vertcat(*(layout.start(body) for body in scene.bodies))
    values = default_values(start, scene.params).reshape(-1)
    return Dae(
        name=scene.name,
        t=TIME.expr,
        x=ca.vertcat(*(ca.SX.sym(label.name) for label in labels)),
        z=ca.SX(0, 1),
        u=_column(scene.inputs),
        p=_column(scene.params),
        x_labels=tuple(
            Label(label.name, label.unit, float(value))
            for label, value in zip(labels, values, strict=True)
        ),
        z_labels=(),
        u_labels=tuple(Label(v.name, v.unit, v.value) for v in scene.inputs),
        p_labels=tuple(Label(v.name, v.unit, v.value) for v in scene.params),
        x_start=start,
        z_start=ca.SX(0, 1),
        parts=(*_bodies(layout), *_loads(layout), *_connectors(connectors)),
        outputs=outputs,
        requested=writer.requested(outputs),
        notes=audit(scene),
        turns=layout.turns(),
        source=f"{formulation}\n{scene.text}",
    )


def _column(leaves: tuple[Leaf, ...]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(leaf.expr for leaf in leaves))


def _connectors(writers: tuple[ConnectorWriter, ...]) -> list[Part]:
    return [writer.part() for writer in writers if writer.connector.active and writer.carriers]


def _bodies(layout: Layout) -> list[Part]:
    """Kinematics, gravity and gyroscopic torque of each body."""
    x, c = ca.SX.sym("x", layout.size), ca.SX.sym("c", INERTIA + 3)
    inertia, inverse = ca.reshape(c[:9], 3, 3), ca.reshape(c[9:18], 3, 3)
    spin = -inverse @ gyroscopic(inertia, x[-3:])
    rates = ca.vertcat(layout.kinematic_rates(x)[:-6], c[INERTIA:], spin)
    function = kernel("body", x, c, rates, ca.SX(0, 1))
    gravity = to_expr(layout.scene.gravity)
    return [
        Part(body.name, function, layout.rows(i), (),
             ca.vertcat(inertia_column(body), gravity), layout.rows(i))
        for i, body in enumerate(layout.scene.bodies)
    ]  # fmt: skip


def _loads(layout: Layout) -> list[Part]:
    moving = [load for load in layout.scene.loads if load.marker.body != GROUND]
    functions = {frame: _load_kernel(layout, frame) for frame in {load.frame for load in moving}}
    return [_load_part(layout, load, functions[load.frame]) for load in moving]


def _load_part(layout: Layout, load: Load, function: ca.Function) -> Part:
    i = layout.index(load.marker.body)
    body = layout.scene.bodies[i]
    constants = ca.vertcat(
        marker_column(load.marker, body), compliance_column(body), to_expr(load.force),
        to_expr(load.torque),
    )  # fmt: skip
    return Part(load.name, function, layout.rows(i), (), constants, layout.velocity_rows(i))


def _load_kernel(layout: Layout, frame: str) -> ca.Function:
    x, c = ca.SX.sym("x", layout.size), ca.SX.sym("c", MARKER + COMPLIANCE + 6)
    marker, compliance = marker_of(c[:MARKER]), c[MARKER : MARKER + COMPLIANCE]
    body = layout.body(x)
    wrench = Wrench(c[-6:-3], c[-3:])
    if frame == "body":
        R_WB = body.motion.frame.R_WA
        wrench = Wrench(R_WB @ wrench.f, R_WB @ wrench.tau)
    return kernel("load", x, c, accelerations(body, marker, wrench, compliance), ca.SX(0, 1))


def _check_has_inertia(body: RigidBody) -> None:
    if float(at_default(np.array(body.mass))) == 0:
        raise ValueError(
            f"body '{body.name}': mass 0 kg; bodies without mass are not available yet; give it a "
            "small mass and inertia"
        )
    smallest = float(np.linalg.eigvalsh(at_default(body.inertia))[0])
    if smallest <= 0:
        raise ValueError(
            f"body '{body.name}': inertia has the principal value {smallest:.3g} kg m2; the "
            "equations divide by it; give a positive inertia about every axis"
        )
