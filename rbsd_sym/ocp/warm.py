"""Starting from an earlier solution: its values on any mesh, its multipliers on the same one."""

from __future__ import annotations

import numpy as np

from .chain import Chain
from .guess import Guess
from .reading import Plan, pieces
from .solution import Solution
from .stage import Frame


def from_solution(frame: Frame, plan: Plan, chain: Chain) -> Guess:
    """A guess that is the plan, interpolated between its saved points."""
    own = list(pieces(plan).values())

    def along(i: int) -> np.ndarray:
        k, mesh = chain.intervals[i].saved, chain.mesh[i]
        inner = (mesh[:-1, None] + np.diff(mesh)[:, None] * k).reshape(-1)
        return np.append(inner, 1.0)

    grids = [along(i) for i in range(frame.n_phases)]

    def x(i: int, at: np.ndarray) -> np.ndarray:
        leg = plan.legs[i]
        return _between(grids[i], np.hstack([leg.saved_x, leg.x[:, -1:]]), at)

    def z(i: int, at: np.ndarray) -> np.ndarray:
        saved = plan.legs[i].saved_z
        return _between(grids[i], np.hstack([saved, saved[:, -1:]]), at)

    def v(i: int, at: np.ndarray) -> np.ndarray:
        before = sum(len(leg.nodes) for leg in plan.legs[:i])
        mesh = chain.mesh[i]
        k = np.clip(np.searchsorted(mesh, at, side="right") - 1, 0, len(mesh) - 2)
        tau = (at - mesh[k]) / (mesh[k + 1] - mesh[k])
        return np.array(
            [
                [
                    float(piece.at(before + int(a), [float(b)])[0])
                    for a, b in zip(k, tau, strict=True)
                ]
                for piece in own
            ]
        ).reshape(len(own), len(at))

    return Guess(plan.s, x, z, v)


def _between(grid: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    return np.array([np.interp(at, grid, row) for row in values]).reshape(len(values), len(at))


def warm_start(
    frame: Frame, earlier: Solution, mesh: tuple[np.ndarray, ...], degree: int
) -> tuple[Guess, dict[str, np.ndarray]]:
    """A guess, and multipliers where the program has the same shape.

    Raises:
        ValueError: the solution is of another model or has other phases.
    """
    raw = earlier.raw
    names = [label.name for label in frame.model.x_labels]
    theirs = [label.name for label in earlier.model.x_labels]
    if (
        names != theirs
        or raw.plan.frame.n_phases != frame.n_phases
        or (len(raw.plan.s) != frame.n_s or raw.plan.frame.controls != frame.controls)
    ):
        raise ValueError(
            f"guess: the solution of '{earlier.trajectory.name}' has other states, Inputs, free "
            "constants or phases than this problem; give its trajectory instead"
        )
    guess = from_solution(frame, raw.plan, raw.chain)
    same = raw.degree == degree and all(
        a.shape == b.shape and np.allclose(a, b, rtol=0, atol=1e-12)
        for a, b in zip(raw.mesh, mesh, strict=True)
    )
    if not same:
        return guess, {}
    answer = raw.answer
    return guess, {"x0": answer.x, "lam_x0": answer.lam_x, "lam_g0": answer.lam_g}
