"""The same problems, transcription and solver in rbsd_sym and in rockit, one run on one machine.

`python tests/charts/ocp_peers.py` writes generated/charts/ocp_peers.md; rockit is in the extra
`peers`.
"""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

if not __package__:  # run as a script, from a checkout that is not installed
    sys.path[:0] = [str(folder) for folder in Path(__file__).resolve().parents[1:3]]

from paths import CHARTS
from scenes.ocp import SLEW, TURN

from rbsd_sym.ocp import Collocation, Fatrop, Ipopt, optimise
from rbsd_sym.study import Table

DEGREE, REPEATS = 4, 5
INTERVALS = {"effort": 20, "turn": 30}
TITLES = {
    "effort": "least effort of two masses and a spring, 5 s",
    "turn": "half a turn in least time, three bounded torques, quaternion",
}


class Row(NamedTuple):
    """What one program did with one problem; `seconds` is the median of the solver's call."""

    program: str
    variables: int
    equations: int
    nonzeros: int
    iterations: int
    cost: float
    seconds: float


def ours(name: str, solver: Any, compiled: bool, repeats: int = REPEATS) -> Row:
    """The problem of models/ with `Collocation(n, 4, "radau")`."""
    if name == "effort":
        problem, guess = SLEW.least_effort(), None
    else:
        problem, guess = TURN.problem(), TURN.GUESS
    method = Collocation(INTERVALS[name], DEGREE, "radau")
    found = [optimise(problem, method, guess, solver, fly=False, compiled=compiled)
             for _ in range(repeats)]  # fmt: skip
    stats = found[-1].stats
    how = f"rbsd_sym, {type(solver).__name__}, {'compiled' if compiled else 'interpreted'}"
    numbers = (int(stats[key]) for key in ("variables", "equations", "nonzeros", "iterations"))
    times = [float(run.stats["time"]) for run in found]
    return Row(how, *numbers, found[-1].cost, float(np.median(times)))


def theirs(name: str, expand: bool, repeats: int = REPEATS) -> Row:
    """The same in rockit, with IPOPT."""
    from peers import rockit_runner as runner

    found = runner.run(name, INTERVALS[name], DEGREE, expand=expand, repeats=repeats)
    how = f"rockit, Ipopt, {'expand' if expand else 'as it is'}"
    return Row(how, *found[:5], float(np.median(found.seconds)))


def table(name: str, repeats: int = REPEATS) -> Table:
    """Sizes, iterations and times of one problem."""
    runs = [
        lambda: theirs(name, False, 1), lambda: theirs(name, True, 1),
        lambda: ours(name, Ipopt(), False, 1), lambda: ours(name, Ipopt(), True, 1),
        lambda: ours(name, Fatrop(), False, 1),
    ]  # fmt: skip
    turns = [[run() for run in runs] for _ in range(repeats)]  # in turn: the load changes
    times = np.median([[row.seconds for row in turn] for turn in turns], axis=0)
    rows = [row._replace(seconds=float(s)) for row, s in zip(turns[-1], times, strict=True)]
    each = [(*row, 1e3 * row.seconds / max(1, row.iterations)) for row in rows]
    columns = (*Row._fields[:-1], "time", "per_iteration")
    return Table(columns, ("", "", "", "", "", "", "s", "ms"), tuple(each))


def page() -> str:
    """All problems as text."""
    lines = [
        "# Optimal control: rockit and rbsd_sym", "", "`python tests/charts/ocp_peers.py`", "",
        f"rockit {version('rockit-meco')}, rbsd_sym from this checkout, both with CasADi "
        f"{ca.CasadiMeta.version()} in one process. The same intervals, Radau points of degree "
        f"{DEGREE}, Inputs constant on an interval, IPOPT with tol 1e-9 and bound_relax_factor 0, "
        f"the same start. Time of the solver's call, median of {REPEATS}, taken in turn. rockit "
        "counts bounds of Inputs and horizon among its equations; rbsd_sym hands a free horizon "
        "from interval to interval, so that it has more variables. Iterations of the turn, which "
        "is not convex, change with rounding.", "",
    ]  # fmt: skip
    for name, title in TITLES.items():
        lines += [f"## {title}, {INTERVALS[name]} intervals", "", table(name).to_markdown(), ""]
    return "\n".join(lines)


def main() -> None:
    """Write the page."""
    folder = CHARTS
    folder.mkdir(parents=True, exist_ok=True)
    text = page()
    (folder / "ocp_peers.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
