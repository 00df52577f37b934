"""Names: joining them for people, checking them for C, matching them with what a user typed.

In everything built on a `Dae`, facts come from structure (`dae.members.Label`, `Derivative`), never
from the text of a name. Only text that a user typed is taken apart, and only here.
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
# Most names in an error message.
_LISTED = 30
_JACOBIAN = re.compile(r"d(ode|alg|out|zero)_d([txzup])")
_DIRECTIONAL = re.compile(r"(ode|alg|out)_(hessian|forward|adjoint)")


def joined(owner: str, quantity: str, component: str = "") -> str:
    """Join the parts of a name for people; the result is never parsed.

    >>> joined("arm", "position", "x"), joined("", "energy")
    ('arm.position_x', 'energy')
    """
    name = f"{owner}.{quantity}" if owner else quantity
    return f"{name}_{component}" if component else name


def titled(name: str) -> str:
    """Return the axis title for a quantity: its name without owner and underscores.

    >>> titled("joint.force_local")
    'force local'
    """
    return name.rpartition(".")[2].replace("_", " ")


def near(name: object, known: Iterable[str]) -> str:
    """List known names that `name` may have been meant for, as text for an error message.

    These are the names with the same owner, the part before the dot; if there are none, all names.
    At most 30 are listed.

    >>> near("arm.positon", ["arm.position", "arm.velocity", "base.position"])
    'arm.position, arm.velocity'
    """
    every = list(known)
    owner = str(name).partition(".")[0]
    same = [key for key in every if key.partition(".")[0] == owner]
    return ", ".join((same or every)[:_LISTED]) or "none"


def c_name(name: str) -> str:
    """Return a name as part of a C identifier.

    >>> c_name("joint.force_local")
    'joint_force_local'
    """
    return name.replace(".", "_")


class Derivative(NamedTuple):
    """Which derivative a function of a model computes.

    Fields:
        of: what is differentiated: "ode", "alg", "out" or "zero" (the zero functions of events).
        by: one of "t", "x", "z", "u", "p" for a Jacobian; "" for the other kinds, which
            differentiate by w = [x; z; u; p].
        kind: "jacobian", "hessian", "forward" or "adjoint".
    """

    of: str
    by: str
    kind: str


def derivative(function: str) -> Derivative | None:
    """Return which derivative the function with this name computes; None if it is not a derivative.

    >>> derivative("dode_dx")
    Derivative(of='ode', by='x', kind='jacobian')
    """
    if match := _JACOBIAN.fullmatch(function):
        return Derivative(match[1], match[2], "jacobian")
    if match := _DIRECTIONAL.fullmatch(function):
        return Derivative(match[1], "", match[2])
    return None


def check_identifier(name: object, where: str) -> str:
    """Return the name if it is safe as a C identifier and as part of a file name.

    Arguments:
        name: what the user gave.
        where: beginning of the error message, such as "body".

    Raises:
        ValueError: the name is empty, longer than 63 characters or not an ASCII identifier; is a
            keyword of C or C++ or a name that CasADi refuses; or starts or ends with an underscore
            or has two in a row.
    """
    rule = None
    if not isinstance(name, str) or not name.isascii() or not name.isidentifier():
        rule = "a name is an ASCII identifier (letters, digits, single underscores)"
    elif name in _C_WORDS:
        rule = "the word is reserved in C, C++ or CasADi"
    # CasADi refuses double underscores; joining with `_` can make one of a leading or trailing one.
    elif "__" in name or name.startswith("_") or name.endswith("_"):
        rule = "underscores are single, and neither first nor last"
    # C99 guarantees 63 significant characters of an internal identifier (5.2.4.1).
    elif len(name) > 63:
        rule = "C distinguishes 63 characters of a name"
    if rule:
        raise ValueError(f"{where}: name {name!r}; {rule}; choose another, such as 'arm_1'")
    return str(name)
