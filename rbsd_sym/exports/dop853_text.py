"""The coefficients of DOP853 as C: unrolled stages, and tables for the derivatives of a step."""

from __future__ import annotations

import numpy as np

from ..base.tableau import E3, E5, A, C, D


def explicit_parts() -> dict[str, str]:
    """Return C text for the marks of `dop853.c.in`, by mark.

    Coefficients are those of `base.tableau` [Hairer, Norsett, Wanner 1993, sec. II.5 and II.10].
    """
    # Stages 1 to 11 lead to the end of the step (row 12 of A). Stages 13 to 15 serve only the
    # interpolant of order 7, so the C code evaluates them if an output point lies inside the step.
    stages = [_stage(s, "k[0]" if s == 0 else f"k[{s}]", "y") for s in range(1, 12)]
    end = [_loop("y", A[12]), _call("t + h", "y", "k[12]")]
    extended = [_stage(s, f"k[{s}]", "z") for s in range(13, 16)]
    dense = [f"      const double f{j + 3} = h * ({_sum(row)});" for j, row in enumerate(D)]
    return {
        "STAGES": "\n".join([*stages, *end]),
        "ERROR_5": _sum(E5),
        "ERROR_3": _sum(E3),
        "EXTENDED": "\n".join("    " + line for part in extended for line in part.split("\n")),
        "DENSE": "\n".join(dense),
    }


def tangent_parts() -> dict[str, str]:
    """Return C text for the marks of `dop853_tangent.c.in`, by mark."""
    # Derivatives of a step run through the stages forwards and backwards in loops, which need the
    # coefficients as tables; the values of a step are unrolled.
    rows = ["  {" + ", ".join(repr(float(v)) for v in row[:12]) + "}" for row in A[:13]]
    return {"NODES": ", ".join(repr(float(v)) for v in C[:12]), "WEIGHTS": ",\n".join(rows)}


def _sum(row: np.ndarray) -> str:
    # Zeros are left out, which saves operations; repr() keeps every digit of the others.
    terms = [
        f"{'-' if v < 0 else '+'} {abs(float(v))!r} * k[{j}][i]" for j, v in enumerate(row) if v
    ]
    text = " ".join(terms)
    return text[2:] if text.startswith("+") else text


def _loop(target: str, row: np.ndarray) -> str:
    return f"  for (int i = 0; i < N; ++i)\n    {target}[i] = x[i] + h * ({_sum(row)});"


def _call(time: str, argument: str, slope: str) -> str:
    return f"  if (rates(s, {time}, {argument}, {slope})) return 1;"


def _stage(s: int, slope: str, argument: str) -> str:
    return "\n".join([_loop(argument, A[s]), _call(f"t + {float(C[s])!r} * h", argument, slope)])
