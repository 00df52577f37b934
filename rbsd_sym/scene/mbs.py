"""`mbs`, the first argument of user functions: what they may ask of the scene they belong to."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any, NoReturn

import numpy as np

from ..base.rotation import quat_matrix
from ..base.symbols import Array, Scalar, SymbolError, leaves_of, to_array, to_expr
from ..laws import Intrinsic
from .elements import RigidBodySpringDamper


class Mbs:
    """The scene, as a user function of a connector sees it while it is traced; nothing is written.

    The function is called once, with symbols, before the model exists. So what a run computes comes
    to it by its arguments, and what a run changes is a Param, an Input or data of the connector.

    Fields:
        variables: numbers and tables given as `Scene(variables={...})`.

    Use:
        k = mbs.GetObjectParameter(itemNumber, "stiffness")
        up = mbs.frame_to_world(itemNumber, 0).T @ [0, 0, 1]
    """

    __slots__ = ("_connectors", "_frames", "_item", "_where", "variables")

    def __init__(
        self,
        where: str,
        item: int,
        connectors: Sequence[RigidBodySpringDamper],
        frames: tuple[np.ndarray, np.ndarray],
        variables: Mapping[str, Any],
    ) -> None:
        own = {
            "_where": where,
            "_item": item,
            "_connectors": tuple(connectors),
            "_frames": frames,
            "variables": Variables(variables, where),
        }
        for name, value in own.items():
            object.__setattr__(self, name, value)

    def GetObjectParameter(self, objectNumber: int, parameterName: str) -> Any:
        """A parameter of a connector of the scene, by its documented name or by ours.

        Arguments:
            objectNumber: index of the connector in the scene; `itemNumber` is that of the function.
            parameterName: "stiffness", "velocityOffset", "rotationMarker0", "activeConnector", ...,
                or a field of `RigidBodySpringDamper`.

        Returns numbers as copies (6x6, 6, 3x3; floats or symbols). Markers are numbered over the
        connectors: those of connector i are 2 i and 2 i + 1.

        Raises:
            ValueError: no such connector or parameter.
        """
        connector: RigidBodySpringDamper = self._connectors[self._index(objectNumber)]
        if parameterName in _DOCUMENTED:
            return _DOCUMENTED[parameterName](connector, int(objectNumber))
        own = [field.name for field in fields(connector)]
        if parameterName in own:
            return _copy(connector, parameterName)
        raise ValueError(
            f"{self._where}: mbs.GetObjectParameter has no parameter {parameterName!r}; there are: "
            + ", ".join(dict.fromkeys([*_DOCUMENTED, *own]))
        )

    def frame_to_world(self, itemNumber: int, marker: int) -> np.ndarray:
        """The rotation (3, 3) of the joint frame at marker 0 or 1 to the world: A_0 or A_1.

        A_i = R_body R_marker R_joint, of the function's own connector, at the time of the call.

        Raises:
            ValueError: another connector, no such marker.
        """
        if self._index(itemNumber) != self._item:
            raise ValueError(
                f"{self._where}: mbs.frame_to_world({itemNumber}, {marker}) is of another "
                f"connector; only the frames of this one are known: give itemNumber, {self._item}"
            )
        if marker not in (0, 1):
            raise ValueError(
                f"{self._where}: mbs.frame_to_world({itemNumber}, {marker!r}); a connector has the "
                "markers 0 and 1; give one of them"
            )
        return self._frames[marker].copy()

    def _index(self, number: Any) -> int:
        count = len(self._connectors)
        whole = isinstance(number, (int, np.integer)) and not isinstance(number, bool)
        if not (whole and 0 <= number < count):
            raise ValueError(
                f"{self._where}: mbs has no connector {number!r}; they are numbered 0 ... "
                f"{count - 1} as in the scene; give itemNumber for the function's own"
            )
        return int(number)

    def __getattr__(self, name: str) -> NoReturn:
        if name[:2] == "__":  # Python and numpy ask for these, not the user
            raise AttributeError(name)
        raise SymbolError(
            f"mbs.{name} is not available, since the function is called once, with symbols; mbs "
            "has GetObjectParameter, frame_to_world and variables; what a run computes comes by "
            "displacement, rotation, velocity and angularVelocity; what it changes is a Param, an "
            "Input or data of the connector"
        )

    def __setattr__(self, name: str, value: Any) -> NoReturn:
        raise SymbolError(
            f"mbs.{name} = ...; mbs cannot be written; keep what a run changes in data of the "
            "connector, and give numbers as Scene(variables={...})"
        )


class Variables(Mapping[str, Any]):
    """The variables of a scene; they can be read, and arrays are copies."""

    def __init__(self, values: Mapping[str, Any], where: str) -> None:
        self._values, self._where = dict(values), where

    def __getitem__(self, name: str) -> Any:
        if name not in self._values:
            raise ValueError(
                f"{self._where}: mbs.variables has no {name!r}; it holds: "
                f"{', '.join(map(repr, self._values)) or 'nothing'}; give it as "
                f"Scene(variables={{{name!r}: ...}})"
            )
        value = self._values[name]
        return _marked_copy(value) if isinstance(value, np.ndarray) else value

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def get(self, name: str, default: Any = None) -> Any:
        """The variable, or the default."""
        return self[name] if name in self._values else default

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __setitem__(self, name: str, value: Any) -> NoReturn:
        raise SymbolError(
            f"mbs.variables[{name!r}] = ...; variables cannot be written, since the function is "
            "called once; keep what a run changes in data of the connector"
        )


def seen_as(
    mbs: Mbs, connectors: Sequence[RigidBodySpringDamper], R_WV: np.ndarray
) -> tuple[Mbs, np.ndarray, np.ndarray]:
    """The `mbs` of a scene written in world axes V as that of the same scene in W; rotJ0, rotJ1.

    Arguments:
        connectors: as they are written in W.
        R_WV: turns components in V into those in W.
    """
    frames = (R_WV @ mbs._frames[0], R_WV @ mbs._frames[1])
    seen = Mbs(mbs._where, mbs._item, connectors, frames, mbs.variables)
    own = connectors[mbs._item]
    return seen, joint_rotation(own, 0), joint_rotation(own, 1)


def joint_rotation(connector: RigidBodySpringDamper, marker: int) -> np.ndarray:
    """`rotation_marker0` or `rotation_marker1` as a matrix (3, 3), a copy."""
    value = (connector.rotation_marker0, connector.rotation_marker1)[marker]
    if value.shape == (3, 3):
        return _marked_copy(value)
    matrix = to_array(quat_matrix(to_expr(value)), leaves_of(value))
    symbolic = value.dtype == object
    return matrix if symbolic else np.array([[float(v) for v in row] for row in matrix])


def _marked_copy(value: np.ndarray) -> np.ndarray:
    return value.copy().view(Array) if value.dtype == object else value.copy()


def _copy(connector: RigidBodySpringDamper, name: str) -> Any:
    if name in _ROTATIONS:
        return joint_rotation(connector, _ROTATIONS[name])
    value = getattr(connector, name)
    return _marked_copy(value) if isinstance(value, np.ndarray) else value


def _of(name: str) -> Callable[[RigidBodySpringDamper, int], Any]:
    return lambda connector, item: _copy(connector, name)


def _active(connector: RigidBodySpringDamper, item: int) -> Any:
    active = connector.active
    return active > 0.5 if isinstance(active, Scalar) else active


def _intrinsic(connector: RigidBodySpringDamper, item: int) -> bool:
    return isinstance(connector.law, Intrinsic)


_ROTATIONS = {"rotation_marker0": 0, "rotation_marker1": 1}
_DOCUMENTED: dict[str, Callable[[RigidBodySpringDamper, int], Any]] = {
    "name": _of("name"),
    "markerNumbers": lambda connector, item: [2 * item, 2 * item + 1],
    "nodeNumber": lambda connector, item: -1,  # data belong to the connector, not to a node
    "stiffness": _of("stiffness"),
    "damping": _of("damping"),
    "offset": _of("offset"),
    "velocityOffset": _of("velocity_offset"),
    "rotationMarker0": _of("rotation_marker0"),
    "rotationMarker1": _of("rotation_marker1"),
    "activeConnector": _active,
    "intrinsicFormulation": _intrinsic,
    "useIntrinsicFormulation": _intrinsic,
    "springForceTorqueUserFunction": lambda connector, item: connector.force or 0,
    "postNewtonStepUserFunction": lambda connector, item: connector.post_newton_step or 0,
    "Vshow": _of("show"),
    "VdrawSize": lambda connector, item: connector.draw_size or -1.0,
    "drawSize": lambda connector, item: connector.draw_size or -1.0,
    "Vcolor": lambda connector, item: (-1.0,) * 4 if connector.color is None else connector.color,
}
