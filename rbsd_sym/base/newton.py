"""Newton's method for small dense systems, iterated until rounding limits the residual."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Size of a full Newton step, relative to 1 + |z|, at which the iteration has converged.
_SETTLED = 1e-12
# The same for an iteration that rounding has stopped.
_GOOD = 1e-8


def newton(
    residual: Callable[[np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray], np.ndarray],
    z: np.ndarray,
    most: int = 50,
) -> tuple[np.ndarray, bool]:
    """Return a root near z, and whether it is one.

    A step is halved until the residual decreases, with each row measured in units of its largest
    derivative. The iteration ends when a full step is below 1e-12 relative to 1 + |z|. If no
    fraction of a step decreases the residual, the point counts as a root if the last step was below
    1e-8: only rounding is left then.

    Arguments:
        residual: function of z (n,) with values (n,).
        jacobian: function of z (n,) with values (n, n).
        z: starting point (n,); with n = 0 it is the root.
        most: largest number of iterations.

    Returns:
        The last point (n,), and False if the Jacobian became singular or a value not finite, if the
        residual stopped decreasing away from a root, or after `most` iterations.
    """
    if not z.size:
        return z, True
    r = residual(z)
    for _ in range(most):
        J = jacobian(z)
        # Rows may be forces, torques or positions; in these units one number measures all of them.
        # A row of zeros cannot be solved for.
        scale = np.abs(J).max(axis=1)
        if not (np.isfinite(J).all() and np.isfinite(r).all() and scale.all()):
            return z, False
        try:
            step = np.linalg.solve(J / scale[:, None], r / scale)
        except np.linalg.LinAlgError:
            return z, False
        size = float((np.abs(step) / (1 + np.abs(z))).max())
        before, factor = float(np.linalg.norm(r / scale)), 1.0
        while factor > 1e-4:
            trial = z - factor * step
            r_trial = residual(trial)
            after = float(np.linalg.norm(r_trial / scale))
            # Sufficient decrease: the linear model predicts a factor of 1 - `factor`; a quarter of
            # the decrease it predicts is required.
            if np.isfinite(after) and after < (1 - factor / 4) * before:
                break
            factor /= 2
        else:
            return z, size <= _GOOD
        z, r = trial, r_trial
        if factor == 1.0 and size <= _SETTLED:
            return z, True
    return z, False
