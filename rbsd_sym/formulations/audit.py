"""What an engineer should be told about a scene before it is integrated."""

from __future__ import annotations

import warnings

import numpy as np

from ..base.checks import at_default
from ..scene.elements import RigidBodySpringDamper
from ..scene.scene import Scene

_SOFT = 1e-2  # an axis softer than this, relative to the two others, is a hinge


class ModelWarning(UserWarning):
    """A scene that can be built, but may not behave as its author expects."""


def audit(scene: Scene) -> tuple[str, ...]:
    """Notes on the connectors; a hinge about a wrong axis is warned of as well."""
    notes: list[str] = []
    for connector in scene.connectors:
        if connector.idle:
            notes.append(f"connector '{connector.name}' is not active and left out")
            continue
        if connector.force is not None:
            continue
        trouble = _wrong_hinge(connector)
        if trouble:
            warnings.warn(trouble, ModelWarning, stacklevel=5)
            notes.append(trouble)
        for title in ("stiffness", "damping"):
            notes += _definiteness(connector.name, title, at_default(getattr(connector, title)))
    return tuple(notes)


def _wrong_hinge(connector: RigidBodySpringDamper) -> str:
    stiffness = np.abs(np.diag(at_default(connector.stiffness))[3:])
    for axis in connector.law.soft_axes_with_trouble:
        others = np.delete(stiffness, axis)
        if stiffness[axis] < _SOFT * others.min():
            fate = ("flutters", "jumps at 90 degrees", "")[axis]
            return (
                f"connector '{connector.name}': {type(connector.law).__name__} law with a soft "
                f"rotation axis, local {'xyz'[axis]} ({stiffness[axis]:.3g} N m/rad beside "
                f"{others.min():.3g}); such a hinge {fate} at large angles; turn the joint frame "
                "so that its z is the hinge axis (rotation_marker0, rotation_marker1), or use "
                "law=Consistent()"
            )
    return ""


def _definiteness(name: str, title: str, matrix: np.ndarray) -> list[str]:
    notes, scale = [], float(np.abs(matrix).max())
    skew = float(np.abs(matrix - matrix.T).max())
    if skew > 1e-12 * scale:
        notes.append(f"connector '{name}': {title} is unsymmetric by {skew:.3g}")
    lowest = float(np.linalg.eigvalsh((matrix + matrix.T) / 2)[0])
    if lowest < -1e-12 * scale:
        notes.append(f"connector '{name}': {title} is indefinite, lowest eigenvalue {lowest:.3g}")
    return notes
