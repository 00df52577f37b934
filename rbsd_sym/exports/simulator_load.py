"""Compile an exported simulator and call it from Python: one call is one whole simulation."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..base.symbols import is_number
from ..model.model import Model
from ..model.signals import Inputs
from ..model.trajectory import Column, Outcome, Trajectory
from ..model.values import Params
from .folder import Artefact
from .load import OPTIMISED, build_folder, labels_of
from .simulator import SIMULATOR

# Outcome of each code that the C function returns, in the order of the enum in its header. Code 1,
# a bad argument, is raised before it is looked up here.
_OUTCOMES = (
    Outcome.reached_end,
    Outcome.solver_failed,
    Outcome.too_many_steps,
    Outcome.step_too_small,
    Outcome.not_finite,
    Outcome.not_consistent,
    Outcome.solver_failed,
    Outcome.endless_events,
    Outcome.event,
)
_ROOM = 10_000  # events of which time and name are recorded
_DOUBLES = ctypes.POINTER(ctypes.c_double)


# Layout of the struct <name>_stats in the header, field by field.
class _RunStats(ctypes.Structure):
    _fields_ = (
        ("t", ctypes.c_double),
        ("last_step", ctypes.c_double),
        ("steps", ctypes.c_long),
        ("rejected", ctypes.c_long),
        ("evaluations", ctypes.c_long),
    )


class _EventStats(_RunStats):
    _fields_ = (  # type: ignore[assignment]
        ("events", ctypes.c_long),
        ("room", ctypes.c_long),
        ("t_event", _DOUBLES),
        ("which", ctypes.POINTER(ctypes.c_int)),
    )

    @classmethod
    def with_room(cls, events: bool) -> _RunStats:
        """Return empty statistics, with arrays to record events if the model has any."""
        if not events:
            return _RunStats()
        stats = cls()
        stats.room = _ROOM
        stats.t_event = (ctypes.c_double * _ROOM)()
        stats.which = (ctypes.c_int * _ROOM)()
        return stats


@dataclass(frozen=True, eq=False)
class Simulator:
    """A compiled simulator; a call runs one simulation. `load_simulator` returns it.

    It can be pickled and sent to other processes of the same machine, where it loads the library
    again; the model is not sent with it, so trajectories made there have no outputs.

    >>> simulator = rs.load_simulator("generated/swing_sim", model)
    >>> trajectory = simulator(2.0, params={"k": 3e4}, inputs={"push": ([0, 1, 2], [0, 5, 0])})

    Fields:
        path: of the shared library in the cache.
        name, digest: of the model.
        labels: name, unit and start value of each entry of "x", "z", "u", "p", and of parameters
            that have no effect on the motion, "idle_p".
        rtol, atol: tolerances of a call that gives none.
        moves: whether the start depends on parameters; changing them then needs the model.
        model: if known, it evaluates the outputs of trajectories.
        events: names of the model's events.
    """

    path: Path
    name: str
    digest: str
    labels: Mapping[str, Sequence[tuple[str, str, float]]]
    rtol: float
    atol: float
    moves: bool = False
    model: Model | None = field(default=None, repr=False, compare=False)
    events: tuple[str, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "model": None}

    @property
    def function(self) -> Any:
        """The C function <name>_simulate_sampled as a ctypes function.

        Calling it directly avoids what Python adds to each call of the simulator.
        """
        return _loaded(str(self.path), f"{self.name}_simulate_sampled")

    def __call__(
        self,
        t_end: float,
        *,
        inputs: Inputs | None = None,
        params: Params | None = None,
        start: Mapping[str, float] | None = None,
        points: int = 200,
        t_start: float = 0.0,
        rtol: float | None = None,
        atol: float | None = None,
    ) -> Trajectory:
        """Simulate from `t_start` to `t_end` (s); a failure is data in `trajectory.outcome`.

        Arguments:
            inputs: by name: a number, or samples (times, values), linear between them.
            params: values by name; the others keep their default.
            start: values of states by name; the others keep their default. Values of algebraic
                unknowns are ignored, since they follow from the states.
            points: number of output times after the start, equally spaced.
            rtol, atol: relative and absolute local error; by default those of the export.

        Raises:
            ValueError: unknown names, times that do not increase, numbers that are not positive.
        """
        # Parameters that affect outputs only are not arguments in C; the trajectory keeps them.
        idle = [name for name, _, _ in self.labels["idle_p"]]
        p = self._values("p", {k: v for k, v in (params or {}).items() if k not in idle})
        unknowns = [name for name, _, _ in self.labels["z"]]
        given = {k: v for k, v in (start or {}).items() if k not in unknowns}
        x = self._start(given, p, bool(params))
        times, u = self._samples(inputs or {})
        tolerances = (self.rtol if rtol is None else rtol, self.atol if atol is None else atol)
        n = len(self.labels["x"]) + len(self.labels["z"])
        out, stats = np.full((points, n), np.nan), _EventStats.with_room(bool(self.events))
        code = self.function(
            t_start,
            t_end,
            _pointer(x),
            len(times),
            _pointer(times),
            _pointer(u),
            _pointer(p),
            *tolerances,
            points,
            _pointer(out),
            ctypes.byref(stats),
        )
        if code == 1:
            raise ValueError(
                f"simulator '{self.name}': from {t_start} to {t_end} s, {points} points, rtol, "
                f"atol {tolerances}; give times that increase, and points and tolerances above 0"
            )
        t = np.append(t_start, t_start + (t_end - t_start) * np.arange(1, points + 1) / points)
        values = {name: value for name, _, value in self.labels["idle_p"]} | dict(params or {})
        names = [name for name, _, _ in self.labels["p"]]
        values |= {name: float(v) for name, v in zip(names, p, strict=True)}
        return self._trajectory(t, x, out, times, u, p, values, code, stats)

    def _start(self, given: Mapping[str, float], p: np.ndarray, changed: bool) -> np.ndarray:
        if self.moves and self.model is not None:
            return self._values("x", given, self.model.dae.start_values(p)[0])
        if self.moves and changed and len(given) < len(self.labels["x"]):
            raise ValueError(
                f"simulator '{self.name}': its start depends on parameters; load it with the model "
                "(load_simulator(folder, model)), or give all of start"
            )
        return self._values("x", given)

    def _values(
        self, kind: str, given: Mapping[str, float], base: np.ndarray | None = None
    ) -> np.ndarray:
        names = [name for name, _, _ in self.labels[kind]]
        usual = [start for _, _, start in self.labels[kind]]
        values = np.array(usual if base is None else base, float)
        for name, value in given.items():
            if name not in names:
                raise ValueError(
                    f"simulator '{self.name}': no {name!r}; there are: {', '.join(names) or 'none'}"
                )
            values[names.index(name)] = value
        return values

    def _samples(self, inputs: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
        """Return the times (n,) of all samples, and the values (n, n_u) of all inputs there."""
        constant = {k: float(v) for k, v in inputs.items() if is_number(v)}
        base = self._values("u", constant | dict.fromkeys(set(inputs) - set(constant), 0.0))
        sampled = {k: _parts(v) for k, v in inputs.items() if k not in constant}
        if not sampled:
            return np.zeros(1), base[None, :].copy()
        for name, value in sampled.items():
            good = len(value) == 2 and value[0].ndim == 1 and value[0].shape == value[1].shape
            if not (good and len(value[0]) > 1 and (np.diff(value[0]) > 0).all()):
                raise ValueError(
                    f"simulator '{self.name}', input '{name}': give a number or samples (times, "
                    "values) of one length of at least 2, times increasing"
                )
        # The C function takes one set of times for all inputs. On the union of all times each
        # input is still linear between neighbours, so nothing is lost by interpolating it.
        times = np.unique(np.concatenate([t for t, _ in sampled.values()]))
        u = np.repeat(base[None, :], len(times), axis=0)
        names = [name for name, _, _ in self.labels["u"]]
        for name, (t, values) in sampled.items():
            u[:, names.index(name)] = np.interp(times, t, values)
        return times, np.ascontiguousarray(u)

    def _trajectory(
        self,
        t: np.ndarray,
        x: np.ndarray,
        out: np.ndarray,
        times: np.ndarray,
        u: np.ndarray,
        p: np.ndarray,
        parameters: Mapping[str, float],
        code: int,
        stats: _RunStats,
    ) -> Trajectory:
        # The C function returns algebraic unknowns at the output times but not at the start; only
        # the model can solve for those.
        z = np.full(len(self.labels["z"]), np.nan)
        if self.model is not None and len(z):
            guess = self.model.dae.start_values(p)[1]
            first = np.array([np.interp(t[0], times, column) for column in u.T])
            z, _ = self.model.consistent(float(t[0]), x, guess, first, p)
        # After a failure, rows beyond the time reached were never written; the factor allows for
        # rounding of an output time that was just reached.
        rows = np.vstack([np.concatenate([x, z]), out])
        reached = t <= stats.t * (1 + 1e-14) if code else np.full(len(t), True)
        n = max(1, int(reached.sum()))
        names = [*self.labels["x"], *self.labels["z"]]
        columns = {name: Column(rows[:n, i], unit) for i, (name, unit, _) in enumerate(names)}
        for i, (name, unit, _) in enumerate(self.labels["u"]):
            columns[name] = Column(np.interp(t[:n], times, u[:, i]), unit)
        outcome = _OUTCOMES[code]
        report = outcome.value if outcome.ok else f"{outcome.value} at t = {stats.t:.9g} s"
        numbers = {
            "steps": float(stats.steps),
            "rejected_steps": float(stats.rejected),
            "evaluations": float(stats.evaluations),
        }
        happened: list[tuple[float, str]] = []
        if isinstance(stats, _EventStats):
            numbers["events"] = float(stats.events)
            happened = [
                (stats.t_event[k], self.events[stats.which[k]])
                for k in range(min(stats.events, _ROOM))
            ]
        return Trajectory(
            self.name,
            t[:n],
            columns,
            outcome,
            report,
            numbers,
            parameters,
            tuple(name for name, _, _ in names),
            self.digest,
            self.model.measure_all if self.model else None,
            self.model.left_out if self.model else (),
            tuple(happened),
            self.model.dae.aliases if self.model else {},
        )


@cache  # keeps the library loaded, and the types of its arguments set
def _loaded(path: str, name: str) -> Any:
    function, number, whole = getattr(ctypes.CDLL(path), name), ctypes.c_double, ctypes.c_int
    function.restype = whole
    function.argtypes = (
        number,
        number,
        _DOUBLES,
        whole,
        _DOUBLES,
        _DOUBLES,
        _DOUBLES,
        number,
        number,
        whole,
        _DOUBLES,
        ctypes.c_void_p,
    )
    return function


def _parts(value: Any) -> tuple[np.ndarray, ...]:
    """Return the times and values of samples, or an empty tuple for anything else."""
    try:
        return tuple(np.array(part, float) for part in value)
    except (TypeError, ValueError):
        return ()


def _pointer(values: np.ndarray) -> Any:
    return values.ctypes.data_as(_DOUBLES)


def load_simulator(
    source: Artefact | str | os.PathLike[str],
    model: Model | None = None,
    compiler: str | None = None,
    flags: Sequence[str] = OPTIMISED,
) -> Simulator:
    """Compile what `export_simulator` wrote, unless the cache holds it already, and load it.

    Source and header are checked against the hashes in the manifest first, so an edited or
    half-copied folder is refused.

    >>> simulator = rs.load_simulator("generated/swing_sim", model)
    >>> simulator(2.0)["arm.position"]

    Arguments:
        source: what `export_simulator` returned, or the path of its folder.
        model: if given, the folder must have been written from this model. Trajectories then have
            outputs, and the algebraic unknowns at the start, which are NaN otherwise.
        compiler, flags: as in `load_c`.

    Raises:
        ValueError: the folder is stale, damaged, not a simulator, or of another model or ABI.
        CompilerMissing: no C compiler was found.
        RuntimeError: the compiler failed; the message holds its output.
    """
    path, manifest = build_folder(source, SIMULATOR, "_simulate", model, compiler, flags)
    labels = {"idle_p": (), **labels_of(manifest)}
    return Simulator(
        path,
        str(manifest["name"]),
        str(manifest["digest"]),
        labels,
        float(manifest["rtol"]),
        float(manifest["atol"]),
        bool(manifest.get("moves")),
        model,
        tuple(manifest.get("events", ())),
    )
