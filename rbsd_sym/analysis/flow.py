"""The flow of a model, an integration by CasADi, and its derivatives."""

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
from .wrt import Directions, Measure


class Flow:
    """The flow (start states, parameters) -> states at the output times, and its derivatives.

    Arguments:
        e: the experiment to integrate.
        method: an integrator with an entry in `PLUGINS`.
        directions: what derivatives are by.
        trajectory: the integrated experiment; derivatives are taken along it.
    """

    def __init__(
        self,
        model: Model,
        e: Experiment,
        method: Any,
        directions: Directions,
        trajectory: Trajectory,
    ) -> None:
        self.model, self.e, self.directions, self.trajectory = model, e, directions, trajectory
        self.x = np.array([trajectory[label.name] for label in model.x_labels])
        z = [trajectory[label.name] for label in model.dae.z_labels]
        self.z = np.array(z).reshape(model.n_z, len(e.t))
        self.u = input_values(e.inputs, e.t)
        self._flow = self._built(method)
        constant = [float(s) for s in e.inputs if is_constant(s)]  # type: ignore[arg-type]
        self._q = np.concatenate([e.p, constant])
        chosen = [i for i, s in enumerate(e.inputs) if is_constant(s)]
        self._seeds_q = np.vstack([directions.p, directions.u[chosen]])

    def _built(self, method: Any) -> ca.Function:
        """Build the Function (start x, q) -> x at the output times after the start, a column each.

        q are the parameters, then the constant inputs.
        """
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
        """Evaluate a derivative of the flow.

        Raises:
            IntegrationError: the integration failed, or a result is not finite.
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
        report = (
            f"{outcome.value} while integrating derivatives ({why}); give a shorter step or "
            "tighter tolerances"
        )
        return IntegrationError(replace(self.trajectory, outcome=outcome, report=report))

    def forward(self, measures: list[Measure]) -> dict[str, np.ndarray]:
        """Return derivatives (n, ..., n_wrt) at every output time, by forward sensitivities.

        Arguments:
            measures: outputs and states to differentiate.
        """
        # Seeds are scaled to the size of each parameter, since integrators apply the tolerances of
        # the states to the sensitivities, too.
        n, size, scale = len(self.e.t), len(self.directions.labels), self.directions.scale
        seeds = self.directions.x * scale, self._seeds_q * scale
        nominal = self._flow(self.e.x, self._q)
        (found,) = self._called(self._flow.forward(size), self.e.x, self._q, nominal, *seeds)
        # Columns are the times of the first direction, then those of the second, ...
        moved = found.reshape(self.model.n_x, size, n - 1).transpose(2, 0, 1) / scale
        dx = np.concatenate([self.directions.x[None], moved])
        results: dict[str, np.ndarray] = {m.name: [] for m in measures}  # type: ignore[misc]
        for k in range(n):
            dz = -self._unknowns(k, dx[k])
            for m in measures:
                by_x, by_z, rest = self._slopes(m, k)
                value = by_x @ dx[k] + by_z @ dz + rest
                results[m.name].append(value.reshape(*m.shape, size))  # type: ignore[attr-defined]
        return {name: np.array(values) for name, values in results.items()}

    def adjoint(self, measures: list[Measure]) -> dict[str, np.ndarray]:
        """Return derivatives (..., n_wrt) at the end, by adjoint sensitivities.

        Arguments:
            measures: outputs and states to differentiate; the cost grows with their entries.
        """
        n, last = len(self.e.t), len(self.e.t) - 1
        slopes = [self._slopes(m, last) for m in measures]
        g = self._unknown_slopes(last)
        rows = [by_x - by_z @ g[0] for by_x, by_z, _ in slopes]
        rests = [rest - by_z @ g[1] for _, by_z, rest in slopes]
        weights, rest = np.vstack(rows), np.vstack(rests)
        # Seeds of size 1, for the reason given in `forward`.
        scale = np.abs(weights).max(axis=1)
        scale[scale == 0] = 1.0
        count = len(weights)
        seeds = np.zeros((self.model.n_x, count, n - 1))
        seeds[:, :, -1] = (weights / scale[:, None]).T
        nominal = self._flow(self.e.x, self._q)
        by_start, by_q = self._called(
            self._flow.reverse(count), self.e.x, self._q, nominal, seeds.reshape(self.model.n_x, -1)
        )
        total = (by_start.T @ self.directions.x + by_q.T @ self._seeds_q) * scale[:, None] + rest
        results, first = {}, 0
        for m, row in zip(measures, rows, strict=True):
            results[m.name] = total[first : first + len(row)].reshape(*m.shape, -1)
            first += len(row)
        return results

    def _at(self, k: int) -> tuple[Any, ...]:
        return self.e.t[k], self.x[:, k], self.z[:, k], self.u[:, k]

    def _slopes(self, m: Measure, k: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return derivatives of a measure at time k: by x, by z, and the rest.

        The rest are its explicit derivatives along the directions, by parameters and inputs.
        """
        p = np.concatenate([self.e.p, self.e.idle])
        by_x, by_z, by_u, by_p = (np.array(v) for v in m.slopes(*self._at(k), p))
        seeds_p = np.vstack([self.directions.p, self.directions.idle])
        rest = by_u @ self.directions.u + by_p @ seeds_p
        return by_x, by_z.reshape(len(by_x), self.model.n_z), rest

    def _unknown_slopes(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Return minus the derivatives of z by x, and along the directions by u and p, at time k.

        From 0 = g_x dx + g_z dz + g_u du + g_p dp.
        """
        model, n = self.model, len(self.directions.labels)
        if not model.n_z:
            return np.zeros((0, model.n_x)), np.zeros((0, n))
        g_x, g_z, g_u, g_p = (
            np.array(ca.DM(model.function(f"dalg_d{v}")(*self._at(k), self.e.p)).full())
            for v in "xzup"
        )
        along = g_u @ self.directions.u + g_p @ self.directions.p
        both = np.linalg.solve(g_z, np.hstack([g_x, along]))
        return both[:, : model.n_x], both[:, model.n_x :]

    def _unknowns(self, k: int, dx: np.ndarray) -> np.ndarray:
        by_x, along = self._unknown_slopes(k)
        return by_x @ dx + along
