"""Outputs of a scene: quantities of bodies, connectors and the whole, built on demand."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass

import casadi as ca

from ..base.names import joined, near
from ..base.symbols import to_expr
from ..dae.members import Output, Outputs
from ..mechanics.quantities import (
    BODY_QUANTITIES,
    CONNECTOR_ACTIVE,
    CONNECTOR_TANGENTS,
    DOCUMENTED,
    SCENE_QUANTITIES,
    BodyView,
    Quantity,
)
from .connector import ConnectorWriter
from .layout import Layout, kernel
from .pack import BODY, body_column

# Number of bodies and connectors up to which all outputs are requested by default.
_ALL_UP_TO = 10


@dataclass(frozen=True, eq=False)
class OutputWriter:
    """Writes the outputs of a scene.

    Arguments:
        layout: rows and coordinates of the scene.
        connectors: writers of all connectors.
        cache: kernels by quantity, shared by all bodies and connectors.
    """

    layout: Layout
    connectors: tuple[ConnectorWriter, ...]
    cache: dict[Hashable, ca.Function]

    def write(self) -> Outputs:
        """Return every output by name: <body>.<quantity>, <connector>.<quantity>, <quantity>.

        Those of connectors are found by their documented names as well. An output costs nothing
        until its `build` is called.
        """
        outputs: dict[str, Output] = {}

        def add(
            owner: str,
            q: Quantity,
            reads: tuple[int, ...],
            build: Callable,
            reads_z: tuple[int, ...] = (),
        ) -> None:
            output = Output(owner, q.name, q.unit, q.components, q.shape, build, reads, reads_z)
            outputs[output.name] = output

        for i, body in enumerate(self.layout.scene.bodies):
            for q in BODY_QUANTITIES:
                add(
                    body.name,
                    q,
                    self.layout.rows(i),
                    lambda q=q, body=body: (self._of_body(q), body_column(body)),
                )
        for writer in self.connectors:
            for q in writer.quantities:
                add(
                    writer.connector.name,
                    q,
                    writer.reads,
                    lambda q=q, writer=writer: writer.measure(q),
                    writer.reads_z,
                )
        bodies = tuple(range(self.layout.size * len(self.layout.scene.bodies)))
        own = tuple(row for writer in self.connectors for row in writer.own_rows)
        unknown = tuple(row for writer in self.connectors for row in writer.reads_z)
        for q in SCENE_QUANTITIES:
            add("", q, (*bodies, *own), lambda q=q: self._of_scene(q), unknown)
        owners = [writer.connector.name for writer in self.connectors]
        pairs = [(owner, *pair) for owner in owners for pair in DOCUMENTED.items()]
        also = {joined(owner, given): joined(owner, ours) for owner, given, ours in pairs}
        return Outputs(outputs, also)

    def requested(self, outputs: Outputs) -> tuple[str, ...]:
        """Return the names of the outputs in y: those the scene asks for, or all of a small scene.

        All of a small scene are those of at most 10 bodies and connectors, except tangents,
        `active`, and what belongs to connectors that never act.

        Raises:
            ValueError: the scene asks for an output that does not exist.
        """
        scene = self.layout.scene
        if scene.outputs is None:
            small = len(scene.bodies) + len(scene.connectors) <= _ALL_UP_TO
            idle = {c.name for c in scene.connectors if c.idle}
            asked = {q.name for q in (*CONNECTOR_TANGENTS, CONNECTOR_ACTIVE)}
            return tuple(
                name
                for name, output in outputs.items()
                if small and output.owner not in idle and output.quantity not in asked
            )
        for name in scene.outputs:
            if name not in outputs:
                raise ValueError(
                    f"scene '{scene.name}', outputs: no output '{name}'; there are: "
                    + near(name, outputs)
                )
        return tuple(outputs[name].name for name in scene.outputs)

    def _view(self, x: ca.SX, c: ca.SX) -> BodyView:
        inertia = ca.reshape(c[1:10], 3, 3)
        return BodyView(self.layout.body(x), c[0], inertia, c[10:13], c[13:16])

    def _of_body(self, q: Quantity) -> ca.Function:
        if ("body", q) not in self.cache:
            x, c = ca.SX.sym("x", self.layout.size), ca.SX.sym("c", BODY)
            self.cache["body", q] = kernel(q.name, x, c, q.measure(self._view(x, c)))
        return self.cache["body", q]

    def _of_scene(self, q: Quantity) -> tuple[ca.Function, ca.SX]:
        scene = self.layout.scene
        n = self.layout.size * len(scene.bodies)
        x = ca.SX.sym("x", n + sum(len(w.own_rows) for w in self.connectors))
        z = ca.SX.sym("z", sum(len(w.reads_z) for w in self.connectors))
        columns = [to_expr(scene.gravity), *(body_column(body) for body in scene.bodies)]
        # The kernel of each connector is called with symbols for its constants, which are appended
        # to those of the bodies.
        stored, symbols = ca.SX(0), []
        summed = q.of_connectors
        for writer, part in ((w, summed) for w in self.connectors if summed is not None):
            function, column = writer.measure(part)
            columns.append(column)
            symbols.append(ca.SX.sym("c", column.numel()))
            stored += function(0, x[list(writer.reads)], z[list(writer.reads_z)], symbols[-1])
        c = ca.SX.sym("c", 3 + BODY * len(scene.bodies))
        views = [
            self._view(part, c[3 + BODY * i : 3 + BODY * (i + 1)])
            for i, part in enumerate(self.layout.split(x[:n]))
        ]
        value = q.measure((views, c[:3], stored))
        return kernel(q.name, x, ca.vertcat(c, *symbols), value, z=z), ca.vertcat(*columns)
