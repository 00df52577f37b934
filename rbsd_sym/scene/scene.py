"""The checked description of a scene: its elements, its symbols, its text and digest."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ..base import checks
from ..base.names import check_identifier
from ..base.program import identity
from ..base.symbols import TIME, Input, Leaf, Param, Scalar, is_number, leaves_of
from ..mechanics.quantities import SCENE_QUANTITIES
from .elements import GROUND, Load, Marker, RigidBody, RigidBodySpringDamper
from .functions import Traced, trace_events, trace_force, trace_post_newton

_ZERO3 = (0.0, 0.0, 0.0)
_OUTSIDE = {"show", "size", "color", "draw_size", "effects"}  # drawing, and what has its own text


class Functions(NamedTuple):
    """The user functions of one connector."""

    force: Traced | None = None
    events: Traced | None = None
    post_newton: Traced | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene: bodies, connectors, loads, gravity and the outputs that are requested.

    Arguments:
        name: identifier; it names the generated files and C functions.
        bodies, connectors, loads: the elements, with unique names.
        gravity: world axes, m/s2.
        outputs: names of the outputs the model's `out` holds, such as "joint.force_local"; None
            asks for all of them in a small scene, for none in a large one.
        variables: numbers, tables and Params by name, which user functions of connectors read as
            `mbs.variables[name]`.

    Raises:
        ValueError: unknown body, duplicate names, no body.
    """

    name: str
    bodies: Sequence[RigidBody]
    connectors: Sequence[RigidBodySpringDamper]
    loads: Sequence[Load] = ()
    gravity: Any = _ZERO3
    outputs: Sequence[str] | None = None
    variables: Mapping[str, Any] = field(default_factory=dict, kw_only=True)

    def __post_init__(self) -> None:
        check_identifier(self.name, "scene")
        where = f"scene '{self.name}'"
        values: dict[str, Any] = {
            title: _sequence(where, title, getattr(self, title))
            for title in ("bodies", "connectors", "loads")
        }
        values["gravity"] = checks.numbers(self.gravity, (3,), f"{where}, gravity", "m/s2")
        if self.outputs is not None:
            values["outputs"] = _sequence(where, "outputs", self.outputs)
        if not isinstance(self.variables, Mapping):
            raise TypeError(
                f"{where}, variables: {type(self.variables).__name__}; give names and values, such "
                "as {'gap': 0.01}"
            )
        values["variables"] = dict(self.variables)
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check_elements()
        self._check_symbols()

    def _check_elements(self) -> None:
        kinds = (("bodies", RigidBody), ("connectors", RigidBodySpringDamper), ("loads", Load))
        seen: dict[str, str] = {}
        for title, kind in kinds:
            for item in getattr(self, title):
                if not isinstance(item, kind):
                    raise TypeError(
                        f"scene '{self.name}', {title}: holds a {type(item).__name__}; each entry "
                        f"is a {kind.__name__}; check the order of the arguments"
                    )
                if item.name in seen:
                    raise ValueError(
                        f"scene '{self.name}': name '{item.name}' in {title} and {seen[item.name]};"
                        " names are unique; rename one"
                    )
                seen[item.name] = title
        if not self.bodies:
            raise ValueError(f"scene '{self.name}': no bodies; give at least one RigidBody")
        for where, marker in self._markers():
            self._check_body(where, marker.body)

    def _check_body(self, where: str, name: str) -> None:
        names = [body.name for body in self.bodies]
        if name != GROUND and name not in names:
            raise ValueError(f"{where}: no body '{name}'; bodies are: {', '.join(names)}, ground")

    def _markers(self) -> list[tuple[str, Marker]]:
        markers = [
            (f"connector '{c.name}', marker{i}", m)
            for c in self.connectors
            for i, m in enumerate((c.marker0, c.marker1))
        ]
        return markers + [(f"load '{load.name}'", load.marker) for load in self.loads]

    def _check_symbols(self) -> None:
        owner: dict[str, Leaf] = {}
        for leaf in self.leaves:
            if owner.setdefault(leaf.name, leaf) is not leaf or (
                leaf is not TIME and leaf.name == TIME.name
            ):
                raise ValueError(
                    f"scene '{self.name}': two different symbols are called '{leaf.name}'; "
                    "make one Param or Input and use it in every place ('t' is the time)"
                )
            if leaf.name in [quantity.name for quantity in SCENE_QUANTITIES]:
                raise ValueError(
                    f"scene '{self.name}': '{leaf.name}' is a symbol, but also an output of every "
                    "scene; give the Param or Input another name"
                )

    def __repr__(self) -> str:
        counts = f"{len(self.bodies)} bodies, {len(self.connectors)} connectors"
        return f"<Scene '{self.name}': {counts}, {len(self.loads)} loads>"

    @property
    def elements(self) -> tuple[Any, ...]:
        """Bodies, connectors and loads."""
        return (*self.bodies, *self.connectors, *self.loads)

    @cached_property
    def traced(self) -> tuple[Functions, ...]:
        """The user functions of each connector, traced once with symbols."""
        return tuple(self._functions(i) for i in range(len(self.connectors)))

    def _functions(self, item: int) -> Functions:
        c = self.connectors[item]
        if not c.acts:
            return Functions()
        rest = (item, self.connectors, self.variables)
        return Functions(
            trace_force(c.force, *rest) if c.force else None,
            trace_events(c.events, *rest) if c.events else None,
            trace_post_newton(c.post_newton_step, *rest) if c.post_newton_step else None,
        )

    @cached_property
    def leaves(self) -> tuple[Leaf, ...]:
        """Every Param, Input and TIME used, by name."""
        found = leaves_of(self.gravity)
        for item in self.elements:
            for entry in fields(item):
                value = getattr(item, entry.name)
                found |= leaves_of(
                    [value.position, value.rotation] if isinstance(value, Marker) else value
                )
        for connector in self.connectors:
            found |= frozenset().union(*(effect.leaves for effect in connector.effects))
        for functions in self.traced:
            found |= frozenset(leaf for f in functions if f for leaf in f.leaves)
        return tuple(sorted(found, key=lambda leaf: leaf.name))

    @property
    def params(self) -> tuple[Param, ...]:
        """The Params used, by name."""
        return tuple(leaf for leaf in self.leaves if isinstance(leaf, Param))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """The Inputs used, by name."""
        return tuple(leaf for leaf in self.leaves if isinstance(leaf, Input))

    @cached_property
    def text(self) -> str:
        """Canonical text of all that determines the model; drawing attributes are left out."""
        lines = [f"scene {self.name}", f"gravity {_text(self.gravity)}", f"outputs {self.outputs}"]
        lines += [f"{type(v).__name__} {v.name} {v.value!r} {v.unit}" for v in self.leaves]
        for item in self.elements:
            parts = (
                f"{f.name}={_text(getattr(item, f.name))}"
                for f in fields(item)
                if f.name not in _OUTSIDE and not callable(getattr(item, f.name))
            )
            lines.append(f"{type(item).__name__} " + " ".join(parts))
        lines += [
            f"{name} {traced.text}"
            for functions in self.traced
            for name, traced in functions._asdict().items()
            if traced
        ]
        lines += [effect.text for c in self.connectors if not c.idle for effect in c.effects]
        return "\n".join(lines)

    @property
    def digest(self) -> str:
        """Hash of the scene's text."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:16]


def _sequence(where: str, title: str, value: Any) -> tuple[Any, ...]:
    """A list or tuple as a tuple; a single element or a string is a slip."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Sequence):
        raise TypeError(f"{where}, {title}: {type(value).__name__}; give a list, such as [arm]")
    return tuple(value)


def _text(value: Any) -> str:
    if isinstance(value, Marker):
        return f"({value.body} {_text(value.position)} {_text(value.rotation)})"
    if isinstance(value, np.ndarray):
        return "[" + " ".join(_text(item) for item in value.flat) + "]"
    if isinstance(value, Scalar):
        return identity(value.expr)
    return repr(float(value)) if is_number(value) else str(value)
