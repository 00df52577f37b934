"""An exported problem, compiled and called from Python."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ..exports.folder import Artefact
from ..exports.load import OPTIMISED, build_folder, labels_of
from ..model.model import Model
from .export import PROBLEM, Code

_DOUBLES = ctypes.POINTER(ctypes.c_double)


class Step(NamedTuple):
    """Result of one call of an exported solver.

    Fields:
        w, lam: the plan (N_W,), and the multipliers of its bounds and rows (N_W + N_G,).
        u: Inputs at its start (N_U,), which a receding horizon applies.
        iterations, programs: steps taken, and quadratic programs solved for them.
        violation: largest, of an equation or bound.
        optimality: largest slope of the Lagrangian, relative to the largest multiplier.
    """

    code: Code
    w: np.ndarray
    lam: np.ndarray
    u: np.ndarray
    iterations: int
    programs: int
    cost: float
    violation: float
    optimality: float


class _SolverStats(ctypes.Structure):
    _fields_ = (
        ("iterations", ctypes.c_int),
        ("programs", ctypes.c_int),
        ("cost", ctypes.c_double),
        ("violation", ctypes.c_double),
        ("optimality", ctypes.c_double),
    )


@dataclass(frozen=True, eq=False)
class ProblemLibrary:
    """The compiled C functions of an exported problem, from `load_problem`.

    None for a state or p means the defaults. A receding horizon is a loop over

        step = library.solve(measured, w, lam)
        w, lam = library.shift(step.w, step.lam)    # one interval later

    with `_, _, w = library.defaults()` and lam = None before it. Arrays that are handed in are
    copied, not changed. Each thread needs a `ProblemLibrary` of its own.

    Fields:
        path: of the shared library; name, digest: of the model.
        sizes: by the names of the header's constants.
        labels: of "x" measured states, "u" Inputs, "p" arguments, "s" constants: (name, unit,
            default).
        functions: names of what was exported.
    """

    path: Path
    name: str
    digest: str
    sizes: Mapping[str, int]
    labels: Mapping[str, Sequence[tuple[str, str, float]]]
    functions: tuple[str, ...]

    def defaults(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the default state (N_X,), p (N_P,), and where the search starts (N_W,)."""
        found = tuple(np.zeros(self.sizes[key]) for key in ("N_X", "N_P", "N_W"))
        self._call("defaults", *found)
        return found  # type: ignore[return-value]

    def bounds(self, state: Any = None) -> tuple[np.ndarray, ...]:
        """Return lower and upper bounds of w (N_W,), then those of the rows (N_G,)."""
        found = tuple(np.zeros(self.sizes[key]) for key in ("N_W", "N_W", "N_G", "N_G"))
        self._call("bounds", self._given(state, "x"), *found)
        return found

    def objective(self, w: Any, p: Any = None) -> float:
        """Return the cost."""
        return float(self._value("objective", 1, w, p)[0])

    def constraints(self, w: Any, p: Any = None) -> np.ndarray:
        """Return the rows (N_G,)."""
        return self._value("constraints", self.sizes["N_G"], w, p)

    def gradient(self, w: Any, p: Any = None) -> np.ndarray:
        """Return the derivative of the cost (N_W,)."""
        return self._value("gradient", self.sizes["N_W"], w, p)

    def jacobian(self, w: Any, p: Any = None) -> ca.DM:
        """Return the derivative of the rows, sparse (N_G, N_W)."""
        pattern = self._pattern("jacobian", self.sizes["N_G"])
        return ca.DM(pattern, self._value("jacobian", pattern.nnz(), w, p))

    def hessian(self, w: Any, p: Any, weight: float, weights: Any) -> ca.DM:
        """Return the second derivative of weight cost + weights' rows, sparse, both triangles."""
        pattern = self._pattern("hessian", self.sizes["N_W"])
        out = np.zeros(max(1, pattern.nnz()))
        self._checked(
            self._call(
                "hessian",
                self._given(w, "w"),
                self._given(p, "p"),
                ctypes.c_double(weight),
                self._given(weights, "g"),
                out,
            )
        )
        return ca.DM(pattern, out[: pattern.nnz()])

    def inputs(self, w: Any, k: int = 0, tau: float = 0.0) -> np.ndarray:
        """Return the Inputs (N_U,) of a plan on interval k of the first phase, at a fraction."""
        u = np.zeros(self.sizes["N_U"])
        self._call("inputs", self._given(w, "w"), ctypes.c_int(k), ctypes.c_double(tau), u)
        return u

    def shift(self, w: Any, lam: Any = None) -> tuple[np.ndarray, np.ndarray | None]:
        """Return a plan and its multipliers one interval later.

        Raises:
            ValueError: not exported, since intervals differ, or the horizon is free.
        """
        self._check("shift", "one phase of a given length with equal intervals")
        w = self._given(w, "w")
        lam = None if lam is None else np.array(lam, float)
        self._call("shift", w, lam)
        return w, lam

    def solve(
        self,
        state: Any,
        w: Any,
        lam: Any = None,
        p: Any = None,
        tol: float = 1e-8,
        max_iterations: int = 50,
    ) -> Step:
        """Solve from a state (N_X,) and a guess w (N_W,).

        Arguments:
            lam: multipliers of a solution before, zeros by default.
            p: Params and horizons (N_P,).
            tol: on violation and optimality.

        Raises:
            ValueError: not exported, arguments of the wrong size.
        """
        self._check("solve", "solver=True")
        n, stats = self.sizes["N_W"] + self.sizes["N_G"], _SolverStats()
        w, u = self._given(w, "w"), np.zeros(self.sizes["N_U"])
        lam = np.zeros(n) if lam is None else _sized(lam, n, "lam")
        code = self._call(
            "solve",
            self._given(state, "x"),
            self._given(p, "p"),
            ctypes.c_double(tol),
            ctypes.c_int(max_iterations),
            w,
            lam,
            u,
            ctypes.byref(stats),
            *self._memory,
        )
        return Step(
            Code(code),
            w,
            lam,
            u,
            stats.iterations,
            stats.programs,
            stats.cost,
            stats.violation,
            stats.optimality,
        )

    @cached_property
    def _memory(self) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(self.sizes["N_WORK"]), np.zeros(self.sizes["N_IWORK"], ctypes.c_int)

    @cached_property
    def _library(self) -> ctypes.CDLL:
        return ctypes.CDLL(str(self.path))

    def _call(self, function: str, *arguments: Any) -> int:
        given = [_pointer(a) if isinstance(a, np.ndarray) else a for a in arguments]
        return int(getattr(self._library, f"{self.name}_ocp_{function}")(*given))

    def _value(self, function: str, size: int, w: Any, p: Any) -> np.ndarray:
        out = np.zeros(max(1, size))
        self._checked(self._call(function, self._given(w, "w"), self._given(p, "p"), out))
        return out[:size]

    def _pattern(self, function: str, rows: int) -> ca.Sparsity:
        columns = self.sizes["N_W"]
        found: list[list[int]] = []
        for key, size in (("colind", columns + 1), ("row", 0)):
            get = getattr(self._library, f"{self.name}_ocp_{function}_{key}")
            get.restype = ctypes.POINTER(ctypes.c_int)
            found.append(get()[: size or found[0][-1]])
        return ca.Sparsity(rows, columns, *found)

    def _given(self, value: Any, letter: str) -> np.ndarray | None:
        if value is None and letter in "xp":
            return None
        return _sized(value, self.sizes[f"N_{letter.upper()}"], letter)

    def _check(self, function: str, remedy: str) -> None:
        if function not in self.functions:
            raise ValueError(
                f"problem of '{self.name}': no function '{function}' was exported; it needs "
                f"{remedy}"
            )

    def _checked(self, code: int) -> None:
        if code:
            raise RuntimeError(f"problem of '{self.name}': {Code(code).name}")


def _sized(value: Any, size: int, what: str) -> np.ndarray:
    """Return a contiguous copy."""
    array = np.array(value, float).reshape(-1)
    if len(array) != size:
        raise ValueError(f"{what}: {len(array)} numbers; there are {size}")
    return array


def _pointer(values: np.ndarray) -> Any:
    kind = _DOUBLES if values.dtype == float else ctypes.POINTER(ctypes.c_int)
    return values.ctypes.data_as(kind)


def load_problem(
    source: Artefact | str | os.PathLike[str],
    model: Model | None = None,
    compiler: str | None = None,
    flags: Sequence[str] = OPTIMISED,
) -> ProblemLibrary:
    """Compile what `export_problem` wrote, if the cache does not hold it yet, and load it.

    For example `load_problem("generated/plan", model).solve(measured, w)`.

    Arguments:
        source: what `export_problem` returned, or its folder.
        model: if given, the folder must be of this very model.
        compiler, flags: as in `load_c`.

    Raises:
        ValueError: the folder is stale, damaged, of another kind, model or ABI.
        CompilerMissing: there is no compiler.
        RuntimeError: the compiler failed; with its message.
    """
    path, manifest = build_folder(source, PROBLEM, "_ocp", model, compiler, flags)
    name, digest = str(manifest["name"]), str(manifest["digest"])
    return ProblemLibrary(
        path, name, digest, manifest["sizes"], labels_of(manifest), tuple(manifest["functions"])
    )
