"""An integration by CasADi and its derivatives."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from ..integrators.driver import casadi_dae, input_values
from ..model.model import Model
from ..model.signals import is_constant
from ..model.trajectory import Outcome, Trajectory
from ..model.values import Experiment
from ..pipeline import IntegrationError
from .flow_options import PLUGINS
from .wrt import Measure, Way


class Flow:
    """An integration and its derivatives."""

    def __init__(
        self, model: Model, e: Experiment, method: Any, way: Way, trajectory: Trajectory
    ) -> None:
        self.model, self.e, self.way, self.trajectory = model, e, way, trajectory
        self.x = np.array([trajectory[label.name] for label in model.x_labels])
        z = [trajectory[label.name] for label in model.dae.z_labels]
        self.z = np.array(z).reshape(model.n_z, len(e.t))
        self.u = input_values(e.inputs, e.t)
        self._flow = self._built(method)
        constant = [float(s) for s in e.inputs if is_constant(s)]  # type: ignore[arg-type]
        self._q = np.concatenate([e.p, constant])
        chosen = [i for i, s in enumerate(e.inputs) if is_constant(s)]
        self._way_q = np.vstack([way.p, way.u[chosen]])

    def _built(self, method: Any) -> ca.Function:
        """(start x, parameters) -> x at the output times after the start, a column each."""
        model, e = self.model, self.e
        plugin, options = PLUGINS[type(method)](method, model, e)
        kept: list[Any] = []
        dae = casadi_dae(model, e.inputs, kept)
        del dae["u"]
        grid = [float(t) for t in e.t]
        inner = ca.integrator(model.name, plugin, dae, grid[0], grid[1:], options)
        x0, q = ca.MX.sym("x0", model.n_x), ca.MX.sym("q", dae["p"].numel())
        flow = inner(x0=x0, z0=self.z[:, 0], p=q)["xf"]
        return ca.Function("flow", [x0, q], [flow], ["x0", "q"], ["xf"])

    def _called(self, function: ca.Function, *arguments: Any) -> list[np.ndarray]:
        """Results of a derivative of the flow.

        Raises:
            IntegrationError: it failed, or is not finite.
        """
        try:
            found = function(*arguments)
        except RuntimeError as error:
            raise self._failed(str(error).strip().splitlines()[-1]) from error
        every = found if isinstance(found, tuple) else (found,)
        values = [np.array(ca.DM(v).full()) for v in every]
        if not all(np.isfinite(v).all() for v in values):
            raise self._failed("a derivative is not finite")
        return values

    def _failed(self, why: str) -> IntegrationError:
        outcome = Outcome.solver_failed
        report = f"{outcome.value} on the way to derivatives ({why}); take shorter or tighter steps"
        return IntegrationError(replace(self.trajectory, outcome=outcome, report=report))

    def forward(self, measures: list[Measure]) -> dict[str, np.ndarray]:
        """Derivatives (n, ..., n_wrt) at every output time."""
        n, size, scale = len(self.e.t), len(self.way.labels), self.way.scale
        seeds = self.way.x * scale, self._way_q * scale
        nominal = self._flow(self.e.x, self._q)
        (found,) = self._called(self._flow.forward(size), self.e.x, self._q, nominal, *seeds)
        # Columns are the times of the first direction, then those of the second, ...
        moved = found.reshape(self.model.n_x, size, n - 1).transpose(2, 0, 1) / scale
        dx = np.concatenate([self.way.x[None], moved])
        results: dict[str, np.ndarray] = {m.name: [] for m in measures}  # type: ignore[misc]
        for k in range(n):
            dz = -self._unknowns(k, dx[k])
            for m in measures:
                by_x, by_z, rest = self._slopes(m, k)
                value = by_x @ dx[k] + by_z @ dz + rest
                results[m.name].append(value.reshape(*m.shape, size))  # type: ignore[attr-defined]
        return {name: np.array(values) for name, values in results.items()}

    def adjoint(self, measures: list[Measure]) -> dict[str, np.ndarray]:
        """Derivatives (..., n_wrt) at the end."""
        n, last = len(self.e.t), len(self.e.t) - 1
        slopes = [self._slopes(m, last) for m in measures]
        g = self._unknown_slopes(last)
        rows = [by_x - by_z @ g[0] for by_x, by_z, _ in slopes]
        rests = [rest - by_z @ g[1] for _, by_z, rest in slopes]
        weights, rest = np.vstack(rows), np.vstack(rests)
        scale = np.abs(weights).max(axis=1)
        scale[scale == 0] = 1.0
        count = len(weights)
        seeds = np.zeros((self.model.n_x, count, n - 1))
        seeds[:, :, -1] = (weights / scale[:, None]).T
        nominal = self._flow(self.e.x, self._q)
        by_start, by_q = self._called(
            self._flow.reverse(count), self.e.x, self._q, nominal, seeds.reshape(self.model.n_x, -1)
        )
        total = (by_start.T @ self.way.x + by_q.T @ self._way_q) * scale[:, None] + rest
        results, first = {}, 0
        for m, row in zip(measures, rows, strict=True):
            results[m.name] = total[first : first + len(row)].reshape(*m.shape, -1)
            first += len(row)
        return results

    def _at(self, k: int) -> tuple[Any, ...]:
        return self.e.t[k], self.x[:, k], self.z[:, k], self.u[:, k]

    def _slopes(self, m: Measure, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of a measure by x, by z, and along wrt by what is no state."""
        p = np.concatenate([self.e.p, self.e.idle])
        by_x, by_z, by_u, by_p = (np.array(v) for v in m.slopes(*self._at(k), p))
        rest = by_u @ self.way.u + by_p @ np.vstack([self.way.p, self.way.idle])
        return by_x, by_z.reshape(len(by_x), self.model.n_z), rest

    def _unknown_slopes(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Minus the derivatives of z by x, and along wrt by parameters and inputs."""
        model, n = self.model, len(self.way.labels)
        if not model.n_z:
            return np.zeros((0, model.n_x)), np.zeros((0, n))
        g_x, g_z, g_u, g_p = (
            np.array(ca.DM(model.function(f"dalg_d{v}")(*self._at(k), self.e.p)).full())
            for v in "xzup"
        )
        both = np.linalg.solve(g_z, np.hstack([g_x, g_u @ self.way.u + g_p @ self.way.p]))
        return both[:, : model.n_x], both[:, model.n_x :]

    def _unknowns(self, k: int, dx: np.ndarray) -> np.ndarray:
        by_x, along = self._unknown_slopes(k)
        return by_x @ dx + along
