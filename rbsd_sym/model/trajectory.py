"""The result of an integration: named columns over time in plain numpy, saved and loaded."""

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
    """How an integration ended; the value of a member is its message.

    `simulate(..., throw=False)` returns a failure as data in `trajectory.outcome`, and
    `trajectory.report` says when and why it happened and what to do. `ok` is true of `reached_end`,
    `event` (an `Event` with `stop=True` ended the run) and `unstable_across_reduction` (the
    trajectory is complete, but a motion that the minimal model left out is unstable).

    >>> Outcome.event.ok, Outcome.solver_failed.ok
    (True, False)
    """

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
        """Whether the trajectory is complete: it reached the end, or an event that stops it."""
        complete = (Outcome.reached_end, Outcome.event, Outcome.unstable_across_reduction)
        return self in complete


@dataclass(frozen=True, eq=False)
class Column:
    """Values (n, ...) of one quantity at n times, its unit, and the names of its components."""

    values: np.ndarray
    unit: str
    components: tuple[str, ...] = ("",)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States, inputs and outputs over time, in SI units.

    `trajectory["arm.position"]` is an array of shape (n, 3), `trajectory["arm.p_x"]` a state (n,),
    `trajectory["pull"]` an input or a parameter. Outputs are evaluated when they are first asked
    for, which needs the model: a trajectory loaded from a file, or sent from another process, holds
    only the outputs that were evaluated before.

    Fields:
        name: of the model.
        t: (n,) s, up to the failure if there was one.
        columns: states, algebraic unknowns, inputs, and the outputs evaluated so far, by name.
        outcome, report: how the run ended, and a sentence with time, state and advice.
        stats: number of steps, evaluations and so on, the time spent in s, the linear solver.
        parameters: values used, by name.
        states: names of the states and algebraic unknowns.
        digest: of the model (`Model.digest`).
        more: evaluates further columns; None without a model.
        also: names of the states that the model left out; evaluated on demand, and always saved.
        events: (time in s, name) of each event, in the order in which they fired.
        aliases: further names of columns, each with the name of its column.

    >>> trajectory = simulate(model, 2.0)                             # doctest: +SKIP
    >>> trajectory["arm.position"][-1], trajectory.state_at_end       # doctest: +SKIP
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
        """Return what is pickled for other processes: all fields, but without the model."""
        return {**self.__dict__, "more": None}

    def __getitem__(self, name: str) -> np.ndarray:
        return self.column(name).values

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the columns held; outputs join them when first asked for."""
        return iter(tuple(self.columns))

    def __repr__(self) -> str:
        return (
            f"<Trajectory '{self.name}': {len(self.t)} times from {self.t[0]:.6g} to "
            f"{self.t[-1]:.6g} s, {self.outcome.name}>"
        )

    def to_pandas(self, names: Sequence[str] | None = None) -> pandas.DataFrame:
        """Return columns as a pandas DataFrame over the time in s.

        Arguments:
            names: of columns, including outputs not evaluated yet; by default all columns that the
                trajectory holds. A vector becomes one column for each component.

        Raises:
            ImportError: pandas is not installed.
            ValueError: there is no column of that name.

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
        """Return values, unit and component names of a column, evaluated if needed.

        Arguments:
            name: of a state, algebraic unknown, input, parameter or output; a parameter becomes a
                constant column.

        Raises:
            ValueError: there is no column of that name.
        """
        name = self.aliases.get(name, name)
        if name not in self.columns and name in self.parameters:
            return Column(np.full(len(self.t), self.parameters[name]), "")
        self.evaluate([name])
        return self.columns[name]

    def evaluate(self, names: Sequence[str]) -> None:
        """Evaluate outputs together and keep them, much faster than one by one.

        Arguments:
            names: of outputs, or of columns that are held already.

        Raises:
            ValueError: there is no column of that name, or it needs the model, which a loaded
                trajectory does not have.
        """
        known = dict.fromkeys(self.aliases.get(name, name) for name in names)
        missing = [name for name in known if name not in self.columns]
        if not missing:
            return
        if self.more is None:
            raise ValueError(
                f"trajectory '{self.name}': no column '{missing[0]}'; it holds "
                + ", ".join(self.columns)
                + "; use one of these, or a trajectory that still has its model for other outputs"
            )
        self.columns.update(zip(missing, self.more(missing, self), strict=True))

    @property
    def state_at_end(self) -> dict[str, float]:
        """Last value of each state and algebraic unknown by name, for `simulate(start=...)`."""
        return {name: float(self.columns[name].values[-1]) for name in self.states}

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the trajectory to one .npz file, whole or not at all.

        The file holds numbers and text (no pickle): all columns evaluated so far, and the states
        that the model left out. The model itself is not saved.

        Arguments:
            path: of the file; ".npz" is appended if missing. The folder must exist.

        Returns:
            The path written.

        Raises:
            ValueError: the file cannot be written.
        """
        target = Path(path)
        target = target if target.suffix == ".npz" else target.with_name(target.name + ".npz")
        # Later there is no model to compute the states that it left out.
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
        """Read a trajectory that `save` wrote.

        It holds the columns that were saved; further outputs need the model.

        Raises:
            ValueError: the file cannot be read, or is not a trajectory of this format.
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
            raise ValueError(
                f"{path}: not a trajectory of rbsd_sym ({error}); give a file that "
                "Trajectory.save wrote"
            ) from error
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
