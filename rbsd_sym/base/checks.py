"""Checks of the numbers that users give: shape, finiteness, rotations, inertia tensors."""

from __future__ import annotations

from typing import Any

import numpy as np

from .symbols import Scalar, default_values, is_number, leaves_of, to_expr

_EPS = float(np.finfo(float).eps)
# Larger than the rounding error of any textbook construction of a rotation.
_ROTATION_TOLERANCE = 1e-9


def numbers(value: Any, shape: tuple[int, ...], where: str, unit: str = "") -> np.ndarray:
    """Return `value` as a read-only array of the given shape.

    The array holds floats or, if any entry is symbolic, Python objects.

    Arguments:
        value: a number, nested lists or an array; entries are numbers, Params, Inputs, TIME or
            expressions of them.
        shape: the shape required; () for a single number.
        where: beginning of the error message, such as "body 'arm', position".
        unit: unit that the error message prints after a number.

    Raises:
        ValueError: wrong shape, rows of different length, NaN or infinity.
        TypeError: an entry that is neither a number nor an expression.
    """
    unit = f" {unit}" if unit else ""
    try:
        array = np.array(value, dtype=object)
    except ValueError as error:
        raise ValueError(f"{where}: rows of different length; give shape {shape}") from error
    if array.shape != shape:
        raise ValueError(
            f"{where}: {value!r} has shape {array.shape}; shape {shape} is required; add or remove "
            "entries"
        )
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
    """Return whether an array made by `numbers` holds any symbolic entry."""
    return array.dtype == object


def at_default(array: np.ndarray) -> np.ndarray:
    """Return the array as floats, with every symbol replaced by its default value."""
    if not is_symbolic(array):
        return array
    return default_values(to_expr(array), leaves_of(array)).reshape(array.shape)


def matrix6(value: Any, where: str) -> np.ndarray:
    """Return a 6x6 stiffness or damping matrix as a checked array.

    Arguments:
        value: 6x6 in the order translation, rotation; or 6 numbers, its diagonal; or 0, the zero
            matrix.
        where: beginning of the error message.

    Raises:
        ValueError, TypeError: any other shape, or entries that `numbers` rejects.
    """
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
            f"{where}: shape {array.shape}; 6x6 is required, or 6 numbers for the diagonal; add or "
            "remove entries (translation comes first, then rotation)"
        )
    return numbers(value, (6, 6), where)


def vector6(value: Any, where: str) -> np.ndarray:
    """Return 6 numbers, translation first, as a checked array; a plain 0 is the zero vector.

    Raises:
        ValueError, TypeError: any other shape, or entries that `numbers` rejects.
    """
    if is_number(value) and not isinstance(value, Scalar) and value == 0:
        value = np.zeros(6)
    return numbers(value, (6,), where)


def rotation(value: Any, where: str) -> np.ndarray:
    """Return a checked rotation, in the form in which it was given.

    Entries within rounding (4 epsilon) of -1, 0 and 1 become exact, so that `cos(pi/2)` leaves no
    spurious coupling in the model. A quaternion is normalised. Symbolic rotations are only checked
    for their shape.

    Arguments:
        value: a rotation matrix (3, 3) or a unit quaternion (4,), scalar first.
        where: beginning of the error message.

    Raises:
        ValueError: wrong shape; a matrix that is not orthonormal within 1e-9 or has determinant -1;
            a quaternion whose norm differs from 1 by more than 1e-9.
    """
    shape = np.shape(np.array(value, dtype=object))
    if shape == (4,):
        return _quaternion(numbers(value, (4,), where), where)
    matrix = numbers(value, (3, 3), where)
    if is_symbolic(matrix):
        return matrix
    # Entries of 1e200 overflow to infinity or NaN here; the comparison below then rejects them, and
    # that is why it is written as `not defect <= ...`.
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
    """Return a read-only copy in which entries within 4 epsilon of -1, 0 and 1 are exact."""
    out = array.copy()
    for exact in (-1.0, 0.0, 1.0):
        out[np.abs(out - exact) <= 4 * _EPS] = exact
    out.flags.writeable = False
    return out


def inertia(value: Any, where: str) -> np.ndarray:
    """Return an inertia tensor about the centre of mass, body axes, as (3, 3) in kg m2.

    Symbolic entries are checked at the default values of their Params.

    Arguments:
        value: 3x3; or 3 principal values; or 6 values (Ixx, Iyy, Izz, Iyz, Ixz, Ixy).
        where: beginning of the error message.

    Raises:
        ValueError: wrong shape, not symmetric, a negative principal value, or principal values that
            break the triangle inequality.
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
            f"{where}: shape {array.shape}; 3x3 is required; or give 3 principal values, or 6 "
            "values (Ixx, Iyy, Izz, Iyz, Ixz, Ixy)"
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
    # For a real mass distribution a + b - c = 2 integral z^2 dm >= 0, with z along the axis of c.
    # The margin of 1e-9 admits flat bodies, for which equality holds up to rounding.
    if a + b < c * (1 - 1e-9):
        raise ValueError(
            f"{where}: inertia {a:.6g} + {b:.6g} < {c:.6g} kg m2 breaks the triangle inequality; "
            "no rigid body has it; check axes and units"
        )
