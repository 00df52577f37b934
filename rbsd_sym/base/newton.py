"""Newton's method for small systems in which rounding decides when to stop."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_SETTLED = 1e-12  # last step, relative to the unknowns
_GOOD = 1e-8  # last step of a run that rounding has stopped


def newton(
    residual: Callable[[np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray], np.ndarray],
    z: np.ndarray,
    most: int = 50,
) -> tuple[np.ndarray, bool]:
    """A root near z, and whether it is one.

    Steps are halved until the residual falls, each row in units of its largest derivative. Where it
    falls no more the last step tells whether that is rounding.

    Arguments:
        residual, jacobian: of z (n,), with values (n,) and (n, n).
    """
    if not z.size:
        return z, True
    r = residual(z)
    for _ in range(most):
        J = jacobian(z)
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
            if np.isfinite(after) and after < (1 - factor / 4) * before:
                break
            factor /= 2
        else:
            return z, size <= _GOOD
        z, r = trial, r_trial
        if factor == 1.0 and size <= _SETTLED:
            return z, True
    return z, False
