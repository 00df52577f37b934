"""Eigenvalues and growth of linear motion x' = J x, also where rows have no inertia."""

from __future__ import annotations

import math

import numpy as np

_INFINITE = 1e-4  # of an inverse eigenvalue times the shift
_ROUNDING = 1e3 * float(np.finfo(float).eps)  # of a matrix and its eigenvalues, with room
_TENFOLD = math.log(10.0)
_TERMS = 12  # of the exponential's series, after scaling


def finite_spectrum(block: np.ndarray, inertial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues of M x' = J x, M diagonal with 0 where a row has no inertia, and their errors.

    By inversion about a shift of the size of the spectrum; what lies 1e4 times further out is
    infinite. A row of zeros without inertia is a direction that nothing decides, and counts as 0.
    Errors are rounding times the condition of each eigenvalue, large for multiple ones (1/s).
    """
    mass = np.diag((inertial | ~block.any(axis=1)).astype(float))
    if mass.trace() == len(block):
        return _with_errors(block)
    shift = 1 + np.sqrt(np.abs(block).max())
    inverse, errors = _with_errors(np.linalg.pinv(block - shift * mass) @ mass)
    finite = np.abs(inverse) * shift > _INFINITE
    return shift + 1 / inverse[finite], errors[finite] / np.abs(inverse[finite]) ** 2


def _with_errors(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    values, right = np.linalg.eig(A)
    left = np.linalg.pinv(right)
    condition = np.linalg.norm(right, axis=0) * np.linalg.norm(left, axis=1)
    return values, _ROUNDING * condition * np.linalg.norm(A)


def growth_rates(blocks: np.ndarray, inertial: np.ndarray) -> np.ndarray:
    """Largest real part of the eigenvalues of each block (k, n, n), 0 within their rounding.

    What rounding is, the block with the largest tells: conditions cost ten times the eigenvalues.
    """
    plain = inertial.all()
    rates = np.array(
        [_largest(np.linalg.eigvals(b)) if plain else _known(b, inertial)[0] for b in blocks]
    )
    if not plain or not rates.any():
        return rates
    worst = int(np.argmax(rates))
    rate, noise = _known(blocks[worst], inertial)
    rates[rates <= noise] = 0.0
    rates[worst] = rate
    return rates


def _largest(values: np.ndarray) -> float:
    return float(values.real.max(initial=0.0))


def _known(block: np.ndarray, inertial: np.ndarray) -> tuple[float, float]:
    """Largest real part beyond its error, and the largest that is rounding."""
    values, errors = finite_spectrum(block, inertial)
    certain = values.real > errors
    return _largest(values[certain]), _largest(values[~certain])


def growth_exponent(t: np.ndarray, blocks: np.ndarray, frozen: float) -> float:
    """Growth of x' = J(t) x from blocks at times t, as an exponent; 0 if there is none.

    Arguments:
        frozen: the integral of the largest real part over time, which tells little where the
            eigenvectors turn. The spectral radius of the propagator must bear it out: agree with it
            to a fifth, or tell of more than tenfold growth, since neutral motion drifts in
            proportion to time. `frozen` stands where the times are too far apart for a propagator:
            every second one gives another answer.
    """
    fine, coarse = (_exponent(t[::k], blocks[::k]) for k in (1, 2))
    least = min(0.8 * frozen, _TENFOLD)
    if abs(max(fine, least) - max(coarse, least)) > 0.1 * max(fine, least):
        return frozen
    return fine if fine > least else 0.0


def _exponent(t: np.ndarray, blocks: np.ndarray) -> float:
    """Midpoint exponentials, multiplied; the size is kept apart, so that nothing overflows."""
    product, size = np.eye(blocks.shape[1]), 0.0
    for step, before, after in zip(np.diff(t), blocks[:-1], blocks[1:], strict=True):
        product = _exponential(step * (before + after) / 2) @ product
        norm = float(np.linalg.norm(product))
        product, size = product / norm, size + math.log(norm)
    radius = float(np.abs(np.linalg.eigvals(product)).max())
    return size + math.log(max(radius, 1e-300))


def _exponential(A: np.ndarray) -> np.ndarray:
    """exp(A) by scaling, a Taylor polynomial, and squaring."""
    halvings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A)), 1e-300))) + 2)
    A = A / 2.0**halvings
    result = term = np.eye(len(A))
    for k in range(1, _TERMS + 1):
        term = term @ A / k
        result = result + term
    return np.linalg.matrix_power(result, 2**halvings)
