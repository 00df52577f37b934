"""Eigenvalues and growth of linear systems M x' = J x in which some rows may have no inertia."""

from __future__ import annotations

import math

import numpy as np

# |1 / (eigenvalue - shift)| times the shift, below which an eigenvalue counts as infinite.
_INFINITE = 1e-4
# Relative backward error of an eigenvalue computation, with a generous margin.
_ROUNDING = 1e3 * float(np.finfo(float).eps)
_TENFOLD = math.log(10.0)
# Degree of the Taylor polynomial of the exponential, after scaling to a norm below 1/4.
_TERMS = 12


def finite_spectrum(block: np.ndarray, inertial: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the finite eigenvalues of M x' = J x (1/s), and an error bound of each (1/s).

    M is diagonal, with 0 where a row has no inertia. The eigenvalues come from inverting about a
    shift of the size of the spectrum; those 1e4 times larger than the shift count as infinite. A
    row of zeros without inertia is a direction that nothing determines; it counts as an eigenvalue
    0.

    Arguments:
        block: J (n, n).
        inertial: for each row whether it is a rate (True) or a balance of forces (False), (n,).

    Returns:
        Eigenvalues (k,) and errors (k,). An error is rounding times the condition number of the
        eigenvalue, so it is large for multiple eigenvalues.
    """
    mass = np.diag((inertial | ~block.any(axis=1)).astype(float))
    if mass.trace() == len(block):
        return _with_errors(block)
    # For second-order systems the entries of J are squares of frequencies, so the root of the
    # largest has the size of the spectrum. Eigenvalues w of (J - shift M)^-1 M are 1 / (s - shift);
    # s = infinity becomes the harmless w = 0.
    shift = 1 + np.sqrt(np.abs(block).max())
    inverse, errors = _with_errors(np.linalg.pinv(block - shift * mass) @ mass)
    finite = np.abs(inverse) * shift > _INFINITE
    return shift + 1 / inverse[finite], errors[finite] / np.abs(inverse[finite]) ** 2


def _with_errors(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the eigenvalues of A and their errors, by the condition of each eigenvalue."""
    values, right = np.linalg.eig(A)
    left = np.linalg.pinv(right)
    condition = np.linalg.norm(right, axis=0) * np.linalg.norm(left, axis=1)
    return values, _ROUNDING * condition * np.linalg.norm(A)


def growth_rates(blocks: np.ndarray, inertial: np.ndarray) -> np.ndarray:
    """Return the largest real part (1/s) of the eigenvalues of each block.

    Real parts within the rounding error of their eigenvalue count as 0.

    Condition numbers cost ten times the eigenvalues. If all rows have inertia they are computed
    only for the block that grows fastest, and its rounding error is used for all.

    Arguments:
        blocks: Jacobians (k, n, n), such as those at k points of a trajectory.
        inertial: as in `finite_spectrum`.
    """
    plain = inertial.all()
    rates = np.array(
        [_largest(np.linalg.eigvals(b)) if plain else _known(b, inertial)[0] for b in blocks]
    )
    if not plain or not rates.any():
        return rates
    # Multiple zero eigenvalues, common in rigid motion, come out as the square root of epsilon.
    worst = int(np.argmax(rates))
    rate, noise = _known(blocks[worst], inertial)
    rates[rates <= noise] = 0.0
    rates[worst] = rate
    return rates


def _largest(values: np.ndarray) -> float:
    return float(values.real.max(initial=0.0))


def _known(block: np.ndarray, inertial: np.ndarray) -> tuple[float, float]:
    """Return the largest real part that exceeds its error, and the largest that does not."""
    values, errors = finite_spectrum(block, inertial)
    certain = values.real > errors
    return _largest(values[certain]), _largest(values[~certain])


def growth_exponent(t: np.ndarray, blocks: np.ndarray, frozen: float) -> float:
    """Return by which exponent solutions of x' = J(t) x grow over the times t; 0 if they do not.

    Eigenvalues of J(t) decide little where the eigenvectors rotate. The propagator, a product of
    matrix exponentials, confirms their verdict if its growth reaches 80 % of `frozen` or a factor
    of ten (neutral motion drifts in proportion to time). If taking every second time gives a
    different result, the times are too far apart for a propagator, and `frozen` is returned.

    Arguments:
        t: times (k,), s.
        blocks: J at these times (k, n, n), 1/s.
        frozen: integral over time of the largest real part of the eigenvalues of J(t).
    """
    fine, coarse = (_exponent(t[::k], blocks[::k]) for k in (1, 2))
    least = min(0.8 * frozen, _TENFOLD)
    if abs(max(fine, least) - max(coarse, least)) > 0.1 * max(fine, least):
        return frozen
    return fine if fine > least else 0.0


def _exponent(t: np.ndarray, blocks: np.ndarray) -> float:
    """Logarithm of the spectral radius of the propagator, by the exponential midpoint rule."""
    product, size = np.eye(blocks.shape[1]), 0.0
    for step, before, after in zip(np.diff(t), blocks[:-1], blocks[1:], strict=True):
        product = _exponential(step * (before + after) / 2) @ product
        norm = float(np.linalg.norm(product))
        # The norm is split off as a logarithm, so that the product of many growing factors does not
        # overflow.
        product, size = product / norm, size + math.log(norm)
    radius = float(np.abs(np.linalg.eigvals(product)).max())
    return size + math.log(max(radius, 1e-300))


def _exponential(A: np.ndarray) -> np.ndarray:
    """Return the matrix exponential by scaling, a Taylor polynomial of degree 12, and squaring."""
    halvings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A)), 1e-300))) + 2)
    A = A / 2.0**halvings
    result = term = np.eye(len(A))
    for k in range(1, _TERMS + 1):
        term = term @ A / k
        result = result + term
    return np.linalg.matrix_power(result, 2**halvings)
