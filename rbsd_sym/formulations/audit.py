"""Findings about a scene that an engineer should know before integrating it."""

from __future__ import annotations

import warnings

import numpy as np

from ..base.checks import at_default
from ..scene.elements import RigidBodySpringDamper
from ..scene.scene import Scene

# A rotation axis softer than this fraction of the two others counts as a hinge.
_SOFT = 1e-2


class ModelWarning(UserWarning):
    """Warning about a scene or a run that is possible, but may not behave as its author expects.

    Examples are a hinge about an axis for which the law is not valid, and motion that was left out
    of a minimal model although disturbances of it grow. To turn such a warning into an error:

        warnings.simplefilter("error", rs.ModelWarning)
    """


def audit(scene: Scene) -> tuple[str, ...]:
    """Return notes on the connectors of a scene, with every symbol at its default value.

    They name connectors that are not active, hinges about an axis for which the law is not valid,
    and matrices that are unsymmetric or indefinite. Connectors with a user force are not examined.
    For an invalid hinge a `ModelWarning` is issued as well.
    """
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
    """Return what is wrong with a hinge about an axis that the law does not allow, or ""."""
    stiffness = np.abs(np.diag(at_default(connector.stiffness))[3:])
    for axis in connector.law.soft_axes_with_trouble:
        others = np.delete(stiffness, axis)
        if stiffness[axis] < _SOFT * others.min():
            failure = ("flutters", "jumps at 90 degrees", "")[axis]
            return (
                f"connector '{connector.name}': {type(connector.law).__name__} law with a soft "
                f"rotation axis, local {'xyz'[axis]} ({stiffness[axis]:.3g} N m/rad beside "
                f"{others.min():.3g}); such a hinge {failure} at large angles; turn the joint "
                "frame so that its z is the hinge axis (rotation_marker0, rotation_marker1), or "
                "use law=Consistent()"
            )
    return ""


def _definiteness(name: str, title: str, matrix: np.ndarray) -> list[str]:
    """Return notes on a matrix that is unsymmetric or not positive semidefinite."""
    notes, scale = [], float(np.abs(matrix).max())
    skew = float(np.abs(matrix - matrix.T).max())
    if skew > 1e-12 * scale:
        notes.append(f"connector '{name}': {title} is unsymmetric by {skew:.3g}")
    lowest = float(np.linalg.eigvalsh((matrix + matrix.T) / 2)[0])
    if lowest < -1e-12 * scale:
        notes.append(f"connector '{name}': {title} is indefinite, lowest eigenvalue {lowest:.3g}")
    return notes
