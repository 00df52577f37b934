"""What comes out of an integrator: named columns over time in plain numpy, saved and loaded."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from ..base.files import data_frame, write_whole
from ..base.names import joined

if TYPE_CHECKING:
    import pandas

_FORMAT = 1


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

    def __iter__(self) -> Iterator[str]:
        """Names of the columns it holds; outputs join them when they are first asked for."""
        return iter(tuple(self.columns))

    def __repr__(self) -> str:
        return (
            f"<Trajectory '{self.name}': {len(self.t)} times from {self.t[0]:.6g} to "
            f"{self.t[-1]:.6g} s, {self.outcome.name}>"
        )

    def to_pandas(self, names: Sequence[str] | None = None) -> pandas.DataFrame:
        """Return columns as a pandas DataFrame over the time in s.

        Arguments:
            names: of columns, also of outputs that are not evaluated yet; by default what the
                trajectory holds. A vector becomes a column for each component.

        Raises:
            ImportError: pandas is not installed.
            ValueError: no such column.

        >>> trajectory.to_pandas(["arm.position"])["arm.position_x"]  # doctest: +SKIP
        """
        frame = data_frame()
        chosen = list(self) if names is None else list(names)
        self.evaluate([name for name in chosen if name not in self.parameters])
        series: dict[str, np.ndarray] = {}
        for name in chosen:
            column = self.column(name)
            flat = column.values.reshape(len(self.t), -1)
            parts = column.components
            if len(parts) != flat.shape[1]:
                parts = tuple(str(i) for i in range(flat.shape[1])) if flat.shape[1] > 1 else ("",)
            series |= {joined("", name, part): flat[:, i] for i, part in enumerate(parts)}
        return frame(series, index=self.t)

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
