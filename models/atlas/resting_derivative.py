"""Derivatives at rest.

The logarithm of a rotation is 0/0 at zero rotation, where every connector starts. Four forms are
compared by the derivatives of the energy along one motion, up to the third (which the exact Hessian
of an optimal control problem contains): the textbook's acos(...) / (2 sin) is NaN up to 1e-8 rad; 2
atan2(|v|, w) / |v| is NaN at rest and noise near it; a guard that takes the limit near rest removes
the NaN and silently leaves a third derivative that is wrong by 12 %; the form used here has no
branch and no division by an angle, and is accurate to 1e-14. The textbook's form fails once more
close to 180 degrees.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from rbsd_sym.base.rotation import (
    quat_conjugate,
    quat_exp,
    quat_half,
    quat_log,
    quat_matrix,
    quat_product,
)
from rbsd_sym.plots.style import COLOURS, MARKERS, STYLES
from rbsd_sym.study import Table

from .exact_energy import Pose, exact_orders
from .law_scenes import legend_below, panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .pages import Tables

NUMBER = 14
ANGLES = (0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-2, 1.0, 3.0)
_AXIS = np.array([-0.62, -0.77, 0.13]) / np.linalg.norm([-0.62, -0.77, 0.13])
# Angle below which the guarded form takes the limit, rad.
_GUARD = 1e-8
_FORM_COLOURS = (COLOURS[1], COLOURS[4], COLOURS[6], COLOURS[0])
# Value at which an error of zero is drawn.
_EXACT = 1e-17


def textbook_log(q: Any) -> Any:
    """Return the skew part of R times angle / (2 sin(angle)), angle = acos((trace - 1) / 2)."""
    R = quat_matrix(q)
    angle = ca.acos((R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2)
    skew = ca.vertcat(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    return angle / (2 * ca.sin(angle)) * skew


def naive_log(q: Any) -> Any:
    """Return 2 atan2(|v|, w) v / |v| of the quaternion (w, v)."""
    n = ca.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    return 2 * ca.atan2(n, q[0]) / n * q[1:]


def guarded_log(q: Any) -> Any:
    """Return the naive form, replaced by its limit 2 v below 1e-8 rad."""
    n2 = q[1] ** 2 + q[2] ** 2 + q[3] ** 2
    near = n2 < (_GUARD / 2) ** 2
    n = ca.sqrt(ca.if_else(near, 1, n2))
    return ca.if_else(near, 2, 2 * ca.atan2(n, q[0]) / n) * q[1:]


FORMS: dict[str, Callable[[Any], Any]] = {
    "acos / 2 sin": textbook_log,
    "atan2 / |v|": naive_log,
    "atan2 / |v|, guarded": guarded_log,
    "used here": quat_log,
}


def orders(log: Callable[[Any], Any], pose: Pose) -> np.ndarray:
    """Return U and its first three derivatives (4,), by CasADi, with a given form of the logarithm.

    Arguments:
        log: function of a quaternion that returns the rotation vector.
        pose: markers, direction of motion, and spring.
    """
    p0, q0, p1, q1, d, K, offset = (ca.DM(np.array(part, float)) for part in pose)
    s = ca.SX.sym("s")
    q0_moved = quat_product(quat_exp(s * d[3:6]), q0)
    q = quat_product(quat_conjugate(q0_moved), quat_product(quat_exp(s * d[9:]), q1))
    R_WM = quat_matrix(quat_product(q0_moved, quat_half(q)))
    u = ca.vertcat(R_WM.T @ (p1 - p0 + s * (d[6:9] - d[:3])), log(q)) - offset
    column = [ca.dot(u, K @ u) / 2]
    for _ in range(3):
        column.append(ca.jacobian(column[-1], s))
    return np.array(ca.Function("orders", [s], [ca.vertcat(*column)])(0))[:, 0]


def pose_at(angle: float) -> Pose:
    """Return markers 0.37 m apart and rotated by an angle (rad), on a spring with an offset."""
    q1 = np.array(quat_exp(ca.DM(angle * _AXIS)))[:, 0].tolist()
    direction = (-0.2, -0.3, 1.0, -1.2, 0.7, -1.1, -0.3, -0.8, 1.4, 0.6, 2.4, 0.6)
    stiffness = np.diag([4000.0, 5000.0, 7000.0, 250.0, 500.0, 325.0]).tolist()
    offset = (0.01, -0.02, 0.03, 0.1, 0.2, 0.3)
    return Pose((0, 0, 0), (1, 0, 0, 0), (0.1, 0.2, 0.3), q1, direction, stiffness, offset)


def study(full: bool) -> Tables:
    """Measure errors of U and its derivatives over the angle, and of the logarithm close to pi."""
    angles = sorted({*ANGLES, *np.logspace(-13, 0, 27)}) if full else ANGLES
    rows = []
    for angle in angles:
        pose = pose_at(angle)
        exact = np.array(exact_orders(pose))
        rows += [(name, angle, *(orders(log, pose) / exact - 1)) for name, log in FORMS.items()]
    gaps = [(gap, *_errors_at_pi(gap)) for gap in np.logspace(-1, -9, 17)]
    columns = ("form", "angle", "value", "first", "second", "third")
    return {
        "derivatives": Table(columns, ("", "rad", "", "", "", ""), tuple(rows)),
        "near_pi": Table(("gap", "textbook", "used_here"), ("rad", "rad", "rad"), tuple(gaps)),
    }


def _errors_at_pi(gap: float) -> tuple[float, float]:
    """Return errors of two logarithms of the rotation by pi - gap, rad."""
    half = (np.pi - gap) / 2
    q = ca.DM([np.sin(gap / 2), *(np.sin(half) * _AXIS)])
    exact = (np.pi - gap) * _AXIS
    logs = (np.array(log(q))[:, 0] for log in (textbook_log, quat_log))
    first, second = (float(np.linalg.norm(log - exact)) for log in logs)
    return first, second


def draw(tables: Tables) -> Figure:
    """Draw the error of the third derivative over the angle, and of the logarithm close to pi."""
    figure, axes = panels()
    errors, near = tables["derivatives"], tables["near_pi"]
    for i, name in enumerate(FORMS):
        mine = errors.column("form") == name
        # A logarithmic axis has no zero: rest is drawn at 1e-15.
        angle = np.maximum(errors.column("angle")[mine], 1e-15)
        error = np.maximum(np.abs(errors.column("third")[mine]), _EXACT)
        style = {"color": _FORM_COLOURS[i]}
        good = np.isfinite(error)
        axes[0].plot(
            angle[good], error[good], MARKERS[i] + STYLES[i], ms=5, lw=1.3, label=name, **style
        )
        axes[0].plot(
            angle[~good],
            np.full((~good).sum(), 0.96 - 0.05 * i),
            "x",
            ms=9,
            mew=2,
            transform=axes[0].get_xaxis_transform(),
            **style,
        )
    axes[0].plot([], [], "kx", ms=9, mew=2, label="NaN")
    axes[0].set(
        xscale="log",
        yscale="log",
        xlabel="rotation [rad]",
        ylabel="error of the third derivative, relative",
    )
    axes[0].set_xticks(
        [1e-15, 1e-12, 1e-9, 1e-6, 1e-3, 1], ["rest", *("1e-12 1e-9 1e-6 1e-3 1".split())]
    )
    axes[0].minorticks_off()
    gap = near.column("gap")
    for name, i in (("textbook", 0), ("used_here", 3)):
        error = np.maximum(near.column(name), _EXACT)
        axes[1].plot(gap, error, MARKERS[i] + STYLES[i], ms=5, lw=1.3, color=_FORM_COLOURS[i])
    axes[1].set(
        xscale="log",
        yscale="log",
        xlabel="distance from 180 degrees [rad]",
        ylabel="error of the rotation vector [rad]",
    )
    legend_below(figure, axes[0], 5)
    return figure
