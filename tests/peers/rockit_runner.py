"""Rockit 0.6.7 on two problems that are also in models/, with the transcription of `Collocation`.

The equations of motion are written out by hand, as rockit wants them. Found by running it: its
Jacobian has the states at the start of intervals and at the points as variables, like ours, and the
Inputs of an interval once; `expand` makes one flat graph of all, which IPOPT evaluates fastest.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import casadi as ca
import rockit

SILENT = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False, "record_time": True}


class Result(NamedTuple):
    """Size of the program, and what IPOPT did; seconds of its call, one for each run."""

    variables: int
    equations: int
    nonzeros: int
    iterations: int
    cost: float
    seconds: tuple[float, ...]


def effort() -> tuple[Any, Any]:
    """Two masses and a spring from rest to rest in 5 s, with least integral of u^2 / 2."""
    ocp = rockit.Ocp(T=5.0)
    p, q, v, w = (ocp.state() for _ in range(4))
    u = ocp.control()
    pull = q - p - 1
    for state, rate in ((p, v), (q, w), (v, u + pull), (w, -pull)):
        ocp.set_der(state, rate)
    for state, start, end in ((p, 0, 1), (q, 1, 2), (v, 0, 0), (w, 0, 0)):
        ocp.subject_to(ocp.at_t0(state) == start)
        ocp.subject_to(ocp.at_tf(state) == end)
        ocp.set_initial(state, start + (end - start) * ocp.t / 5.0)
    ocp.add_objective(ocp.integral(u**2 / 2))
    return ocp, ocp.objective


def turn() -> tuple[Any, Any]:
    """Half a turn about z in least time, three torques of at most 1 N m, unit inertia."""
    guess, t_guess = 3.3, 3.3
    ocp = rockit.Ocp(T=rockit.FreeTime(guess))
    q, w, tau = ocp.state(4), ocp.state(3), ocp.control(3)
    s, r = q[0], q[1:]
    ocp.set_der(q, 0.5 * ca.vertcat(-ca.dot(r, w), s * w + ca.cross(r, w)))
    ocp.set_der(w, tau)
    ocp.subject_to(ocp.at_t0(q) == ca.DM([1, 0, 0, 0]))
    ocp.subject_to(ocp.at_t0(w) == 0)
    ocp.subject_to(ocp.at_tf(q[:3]) == 0)
    ocp.subject_to(ocp.at_tf(w) == 0)
    ocp.subject_to((-1 <= tau) <= 1)  # noqa: SIM300, bounds as rockit wants them
    ocp.subject_to((1 <= ocp.T) <= 10)  # noqa: SIM300
    angle = ca.pi / 2 * ocp.t / t_guess
    ocp.set_initial(q, ca.vertcat(ca.cos(angle), 0, 0, ca.sin(angle)))
    t = ocp.t
    signs = (ca.if_else(ca.logic_and(t > 0.4, t < 1.0), -1, 1), ca.if_else(t < 1.6, -1, 1),
             ca.if_else(t < 1.7, 1, -1))  # fmt: skip
    ocp.set_initial(tau, ca.vertcat(*signs))
    ocp.add_objective(ocp.T)
    return ocp, ocp.objective


PROBLEMS: dict[str, Callable[[], tuple[Any, Any]]] = {"effort": effort, "turn": turn}


def run(
    name: str, intervals: int, degree: int, tol: float = 1e-9, expand: bool = False,
    repeats: int = 5,
) -> Result:  # fmt: skip
    """Solve a problem of `PROBLEMS` several times from the same start, Inputs constant."""
    ocp, cost = PROBLEMS[name]()
    options = {**SILENT, "expand": expand, "ipopt.tol": tol, "ipopt.bound_relax_factor": 0.0}
    ocp.solver("ipopt", options)
    ocp.method(rockit.DirectCollocation(N=intervals, M=1, degree=degree, scheme="radau"))
    seconds, found, stats = [], None, {}
    for _ in range(repeats):
        found = ocp.solve()
        stats = found.stats
        if not stats["success"]:
            raise RuntimeError(f"rockit, {name}: {stats['return_status']}")
        seconds.append(float(stats["t_wall_total"]))
    opti = ocp._method.opti
    pattern = ca.jacobian_sparsity(opti.g, opti.x)
    return Result(int(opti.nx), int(opti.ng), int(pattern.nnz()), int(stats["iter_count"]),
                  float(found.value(cost)), tuple(seconds))  # fmt: skip
