"""Names: how they are joined for people, checked for C, and matched with what a user typed.

Below the waist facts come from structure (`dae.members.Label`, `Derivative`), never from the text
of a name. What a user typed is the only text that is taken apart, here and nowhere else.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

_C_WORDS = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while bool class namespace new delete template this operator "
    "private public protected virtual try catch throw using friend explicit export mutable asm "
    "and or not xor true false main jac hess null NULL nan inf".split()
)
_LISTED = 30  # names in an error message
_JACOBIAN = re.compile(r"d(ode|alg|out|zero)_d([txzup])")
_DIRECTIONAL = re.compile(r"(ode|alg|out)_(hessian|forward|adjoint)")


def joined(owner: str, quantity: str, component: str = "") -> str:
    """Name of a quantity for people: "arm.position_x"; "gravity" where nothing owns it."""
    name = f"{owner}.{quantity}" if owner else quantity
    return f"{name}_{component}" if component else name


def titled(name: str) -> str:
    """Title of an axis that shows a quantity: "force local" of "joint.force_local"."""
    return name.rpartition(".")[2].replace("_", " ")


def near(name: object, known: Iterable[str]) -> str:
    """Known names to list where `name` is not one of them: those of its owner, or else the first.

    >>> near("arm.positon", ["arm.position", "arm.velocity", "base.position"])
    'arm.position, arm.velocity'
    """
    every = list(known)
    owner = str(name).partition(".")[0]
    same = [key for key in every if key.partition(".")[0] == owner]
    return ", ".join((same or every)[:_LISTED]) or "none"


def c_name(name: str) -> str:
    """A name such as "joint.force_local" as part of a C identifier."""
    return name.replace(".", "_")


class Derivative(NamedTuple):
    """What a function of a model differentiates.

    Fields:
        of: "ode", "alg", "out" or "zero".
        by: one of "t", "x", "z", "u", "p" in a Jacobian; "" in the others, which are by
            w = [x; z; u; p].
        kind: "jacobian", "hessian", "forward" or "adjoint".
    """

    of: str
    by: str
    kind: str


def derivative(function: str) -> Derivative | None:
    """What the function of that name differentiates, None if it is not a derivative.

    >>> derivative("dode_dx")
    Derivative(of='ode', by='x', kind='jacobian')
    """
    if match := _JACOBIAN.fullmatch(function):
        return Derivative(match[1], match[2], "jacobian")
    if match := _DIRECTIONAL.fullmatch(function):
        return Derivative(match[1], "", match[2])
    return None


def check_identifier(name: object, where: str) -> str:
    """Return the name if it can safely be a C identifier and part of a file name.

    Raises:
        ValueError: it is empty, too long, not an ASCII identifier, a C or C++ keyword, a name
            CasADi refuses, or starts, ends or doubles an underscore.
    """
    rule = None
    if not isinstance(name, str) or not name.isascii() or not name.isidentifier():
        rule = "a name is an ASCII identifier (letters, digits, single underscores)"
    elif name in _C_WORDS:
        rule = "the word is reserved in C, C++ or CasADi"
    elif "__" in name or name.startswith("_") or name.endswith("_"):
        rule = "underscores stand single and inside the name"
    elif len(name) > 63:
        rule = "C distinguishes 63 characters of a name"
    if rule:
        raise ValueError(f"{where}: name {name!r}; {rule}; choose another, such as 'arm_1'")
    return str(name)
