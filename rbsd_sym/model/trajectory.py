"""What goes into an integrator and what comes out: plain numpy, named columns, save and load."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Union
from zipfile import BadZipFile

import numpy as np

from ..base.files import write_whole

_FORMAT = 1


@dataclass(frozen=True, eq=False)
class Samples:
    """An input given by samples: linear between them, constant before the first and after the last.

    Arguments:
        t: increasing times (n,), s.
        values: (n,).
    """

    t: np.ndarray
    values: np.ndarray


Signal = Union[float, Samples, Callable[[Any], Any]]


@dataclass(frozen=True, eq=False)
class Experiment:
    """What to integrate: output times (n,), start x, z, values p, and one signal for each input.

    `idle` are values of parameters that only outputs outside y feel.
    """

    t: np.ndarray
    x: np.ndarray
    z: np.ndarray
    p: np.ndarray
    inputs: tuple[Signal, ...]
    idle: np.ndarray = field(default_factory=lambda: np.zeros(0))


class Outcome(Enum):
    """How an integration ended; the value is the message."""

    reached_end = "reached the end"
    event = "stopped at an event"
    endless_events = "events follow each other without end"
    too_many_steps = "too many steps within one output interval"
    step_too_small = "the step became too small"
    not_consistent = "no consistent start values found for the algebraic unknowns"
    not_finite = "a value is not finite"
    solver_failed = "the solver gave up"
    unstable_across_reduction = "a motion left out of the minimal model is unstable"

    @property
    def ok(self) -> bool:
        """Whether the trajectory is complete."""
        complete = (Outcome.reached_end, Outcome.event, Outcome.unstable_across_reduction)
        return self in complete


@dataclass(frozen=True, eq=False)
class Column:
    """Values of one quantity over time (n, ...) and its unit."""

    values: np.ndarray
    unit: str
    components: tuple[str, ...] = ("",)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States, inputs and outputs over time.

    `trajectory["arm.position"]` is an array of shape (n, 3), `trajectory["arm.p_x"]` a state (n,),
    `trajectory["pull"]` an input or a parameter. Outputs that nobody asked for yet are evaluated on
    demand while the model is at hand; a saved file holds those that were.

    Fields:
        t: (n,) s, up to the failure if there was one.
        columns: states, algebraic unknowns, inputs, and outputs evaluated so far.
        outcome, report: how it ended, and the full sentence with time, state and advice.
        stats: steps, evaluations, time in s, the linear solver.
        parameters: values used.
        digest: of the model.
        also: states the model left out; evaluated on demand, and always saved.
        events: (time in s, name) of each event, in the order in which they happened.
        aliases: more names of columns, each with the name that the column has.
    """

    name: str
    t: np.ndarray
    columns: dict[str, Column]
    outcome: Outcome
    report: str
    stats: Mapping[str, float | str]
    parameters: Mapping[str, float]
    states: tuple[str, ...]
    digest: str
    more: Callable[[Sequence[str], Trajectory], list[Column]] | None = field(
        default=None, repr=False
    )
    also: tuple[str, ...] = ()
    events: tuple[tuple[float, str], ...] = ()
    aliases: Mapping[str, str] = field(default_factory=dict, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        """What is sent to other processes: the columns evaluated so far, not the model."""
        return {**self.__dict__, "more": None}

    def __getitem__(self, name: str) -> np.ndarray:
        return self.column(name).values

    def __contains__(self, name: str) -> bool:
        try:
            self.column(name)
        except ValueError:
            return False
        return True

    def column(self, name: str) -> Column:
        """Values, unit and component names of a column, evaluated if needed.

        Raises:
            ValueError: no such column.
        """
        name = self.aliases.get(name, name)
        if name not in self.columns and name in self.parameters:
            return Column(np.full(len(self.t), self.parameters[name]), "")
        self.evaluate([name])
        return self.columns[name]

    def evaluate(self, names: Sequence[str]) -> None:
        """Evaluate columns together, which for many of them is much faster than one by one.

        Raises:
            ValueError: no such column.
        """
        known = dict.fromkeys(self.aliases.get(name, name) for name in names)
        missing = [name for name in known if name not in self.columns]
        if not missing:
            return
        if self.more is None:
            raise ValueError(
                f"trajectory '{self.name}': no column '{missing[0]}'; it holds "
                + ", ".join(self.columns)
            )
        self.columns.update(zip(missing, self.more(missing, self), strict=True))

    @property
    def state_at_end(self) -> dict[str, float]:
        """Last value of each state and unknown by name, as `simulate(start=...)` takes it."""
        return {name: float(self.columns[name].values[-1]) for name in self.states}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write one .npz file (no pickle), whole or not at all; the folder must exist.

        Raises:
            ValueError: the file cannot be written.
        """
        target = Path(path)
        target = target if target.suffix == ".npz" else target.with_name(target.name + ".npz")
        self.evaluate(self.also)
        header = {
            "format": _FORMAT,
            "name": self.name,
            "outcome": self.outcome.name,
            "report": self.report,
            "stats": dict(self.stats),
            "states": self.states,
            "parameters": dict(self.parameters),
            "digest": self.digest,
            "columns": [[key, c.unit, c.components] for key, c in self.columns.items()],
            "events": self.events,
            "aliases": {also: name for also, name in self.aliases.items() if name in self.columns},
        }
        arrays: dict[str, Any] = {
            f"column_{i}": c.values for i, c in enumerate(self.columns.values())
        }
        arrays |= {"header": np.array(json.dumps(header)), "t": self.t}
        write = partial(np.savez_compressed, allow_pickle=False, **arrays)
        return write_whole(target, write, f"trajectory '{self.name}'")

    @staticmethod
    def load(path: str | os.PathLike[str]) -> Trajectory:
        """Read what `save` wrote.

        Raises:
            ValueError: not such a file.
        """
        try:
            with open(path, "rb") as raw, np.load(raw, allow_pickle=False) as file:
                header = json.loads(str(file["header"]))
                if header["format"] != _FORMAT:
                    raise ValueError(f"format {header['format']}, this version reads {_FORMAT}")
                columns = {
                    name: Column(file[f"column_{i}"], unit, tuple(components))
                    for i, (name, unit, components) in enumerate(header["columns"])
                }
                t = file["t"]
        except (OSError, EOFError, KeyError, TypeError, ValueError, BadZipFile) as error:
            raise ValueError(f"{path}: no trajectory of rbsd_sym ({error})") from error
        return Trajectory(
            header["name"],
            t,
            columns,
            Outcome[header["outcome"]],
            header["report"],
            header["stats"],
            header["parameters"],
            tuple(header["states"]),
            header["digest"],
            events=tuple((float(at), str(name)) for at, name in header.get("events", ())),
            aliases=header.get("aliases", {}),
        )

    def __str__(self) -> str:
        return (
            f"{self.name}: {len(self.t)} points, t = {self.t[0]:.6g} ... {self.t[-1]:.6g} s; "
            f"{self.report}"
        )
