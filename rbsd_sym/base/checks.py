"""Checks of numbers that users hand in: shape, finiteness, rotation, inertia."""

from __future__ import annotations

from typing import Any

import numpy as np

from .symbols import Scalar, default_values, is_number, leaves_of, to_expr

_EPS = float(np.finfo(float).eps)
_ROTATION_TOLERANCE = 1e-9  # larger than rounding of any textbook construction of a rotation


def numbers(value: Any, shape: tuple[int, ...], where: str, unit: str = "") -> np.ndarray:
    """`value` as a read-only array of the given shape: floats, or objects if any is symbolic.

    Raises:
        ValueError: wrong shape, NaN or infinite.
        TypeError: an entry that is neither a float nor a Param, Input or expression of them.
    """
    unit = f" {unit}" if unit else ""
    try:
        array = np.array(value, dtype=object)
    except ValueError as error:
        raise ValueError(f"{where}: rows of different length; give shape {shape}") from error
    if array.shape != shape:
        raise ValueError(f"{where}: shape {array.shape}; the rule is {shape}; got {value!r}")
    for item in array.flat:
        if not is_number(item):
            raise TypeError(
                f"{where}: {item!r} is {type(item).__name__}; each entry is a float, a Param, an "
                "Input, TIME or an expression of them"
            )
        if not isinstance(item, Scalar) and not np.isfinite(item):
            raise ValueError(f"{where}: {item}{unit}; numbers are finite; check where it came from")
    if not any(isinstance(item, Scalar) for item in array.flat):
        array = array.astype(float)
    array.flags.writeable = False
    return array


def is_symbolic(array: np.ndarray) -> bool:
    """Whether any entry is a symbol."""
    return array.dtype == object


def at_default(array: np.ndarray) -> np.ndarray:
    """The array as floats, every symbol at its default value."""
    if not is_symbolic(array):
        return array
    return default_values(to_expr(array), leaves_of(array)).reshape(array.shape)


def matrix6(value: Any, where: str) -> np.ndarray:
    """A 6x6 matrix; a 6-vector is its diagonal, a plain 0 is the zero matrix."""
    if is_number(value) and not isinstance(value, Scalar) and value == 0:
        return numbers(np.zeros((6, 6)), (6, 6), where)
    array = np.array(value, dtype=object)
    if array.shape == (6,):
        diagonal = numbers(value, (6,), where)
        full = np.zeros((6, 6), dtype=diagonal.dtype)
        np.fill_diagonal(full, diagonal)
        return numbers(full, (6, 6), where)
    if array.shape != (6, 6):
        raise ValueError(
            f"{where}: shape {array.shape}; the rule is 6x6, or 6 numbers for the diagonal; "
            "translation comes first, then rotation"
        )
    return numbers(value, (6, 6), where)


def vector6(value: Any, where: str) -> np.ndarray:
    """A 6-vector, translation first; a plain 0 is the zero vector."""
    if is_number(value) and not isinstance(value, Scalar) and value == 0:
        value = np.zeros(6)
    return numbers(value, (6,), where)


def rotation(value: Any, where: str) -> np.ndarray:
    """A rotation matrix (3, 3) or a unit quaternion (4,), scalar first.

    Entries within rounding (4 epsilon) of -1, 0 and 1 become exact, so that `cos(pi/2)` leaves no
    spurious coupling in the model. Symbolic rotations are taken as they are.

    Raises:
        ValueError: wrong shape, not orthonormal within 1e-9, determinant -1, not a unit quaternion.
    """
    shape = np.shape(np.array(value, dtype=object))
    if shape == (4,):
        return _quaternion(numbers(value, (4,), where), where)
    matrix = numbers(value, (3, 3), where)
    if is_symbolic(matrix):
        return matrix
    with np.errstate(over="ignore", invalid="ignore"):
        defect = float(np.abs(matrix.T @ matrix - np.eye(3)).max())
    if not defect <= _ROTATION_TOLERANCE:
        raise ValueError(
            f"{where}: R'R differs from the identity by {defect:.3g}; a rotation matrix is "
            "orthonormal within 1e-9; normalise it, or give a unit quaternion (w, x, y, z)"
        )
    if np.linalg.det(matrix) < 0:
        raise ValueError(
            f"{where}: determinant -1; a rotation has +1, this is a reflection; check the axes' "
            "order and signs"
        )
    return _exact(matrix)


def _quaternion(q: np.ndarray, where: str) -> np.ndarray:
    if is_symbolic(q):
        return q
    with np.errstate(over="ignore"):
        norm = float(np.linalg.norm(q))
    if abs(norm - 1) > _ROTATION_TOLERANCE:
        raise ValueError(
            f"{where}: quaternion of norm {norm:.6g}; a rotation needs norm 1 within 1e-9; divide "
            "by the norm (scalar first: w, x, y, z)"
        )
    return _exact(q / norm)


def _exact(array: np.ndarray) -> np.ndarray:
    out = array.copy()
    for exact in (-1.0, 0.0, 1.0):
        out[np.abs(out - exact) <= 4 * _EPS] = exact
    out.flags.writeable = False
    return out


def inertia(value: Any, where: str) -> np.ndarray:
    """Inertia about the centre of mass, body axes, as 3x3, in kg m2.

    Arguments:
        value: 3x3, or 3 principal values, or 6 values (Ixx, Iyy, Izz, Iyz, Ixz, Ixy).

    Raises:
        ValueError: wrong shape, unsymmetric, not positive definite, triangle inequality broken.
    """
    array = np.array(value, dtype=object)
    if array.shape == (3,):
        full = np.diag(array) if not any(isinstance(v, Scalar) for v in array) else _diagonal(array)
        array = np.array(full, dtype=object)
    elif array.shape == (6,):
        xx, yy, zz, yz, xz, xy = array
        array = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], dtype=object)
    if array.shape != (3, 3):
        raise ValueError(
            f"{where}: shape {array.shape}; the rule is 3x3, 3 principal values, or 6 values "
            "(Ixx, Iyy, Izz, Iyz, Ixz, Ixy)"
        )
    matrix = numbers(array, (3, 3), where, "kg m2")
    _check_inertia(at_default(matrix), where)
    return matrix


def _diagonal(values: np.ndarray) -> np.ndarray:
    full = np.zeros((3, 3), dtype=object)
    np.fill_diagonal(full, values)
    return full


def _check_inertia(matrix: np.ndarray, where: str) -> None:
    scale = float(np.abs(matrix).max())
    skew = float(np.abs(matrix - matrix.T).max())
    if skew > 1e-12 * scale:
        raise ValueError(
            f"{where}: inertia is unsymmetric by {skew:.3g} kg m2; an inertia matrix is symmetric; "
            "check the products of inertia"
        )
    a, b, c = np.linalg.eigvalsh(matrix)
    if a < 0:
        raise ValueError(
            f"{where}: inertia has the principal value {a:.6g} kg m2; they are positive; check "
            "signs and units"
        )
    if a + b < c * (1 - 1e-9):
        raise ValueError(
            f"{where}: inertia {a:.6g} + {b:.6g} < {c:.6g} kg m2 breaks the triangle inequality; "
            "no rigid body has it; check axes and units"
        )
