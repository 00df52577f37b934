"""Connector laws: relative motion of two markers to a wrench; one file per law.

`Standard`, `Intrinsic` and `Consistent` say what strain and rate are; effects, such as `Contact`,
add forces along one component of them.
"""

from .consistent import Consistent
from .contact import Contact, stops
from .effect import AXES, Effect, Own, value_at_default
from .fracture import Fracture
from .friction import Friction, LuGre
from .impact import Impact
from .intrinsic import Intrinsic
from .law import Law, Relative, Response, SpringDamper, respond, while_on
from .maxwell import Maxwell
from .plastic import Plastic
from .standard import Standard
from .stiffness import Cubic, Table

__all__ = [
    "AXES",
    "Consistent",
    "Contact",
    "Cubic",
    "Effect",
    "Fracture",
    "Friction",
    "Impact",
    "Intrinsic",
    "Law",
    "LuGre",
    "Maxwell",
    "Own",
    "Plastic",
    "Relative",
    "Response",
    "SpringDamper",
    "Standard",
    "Table",
    "respond",
    "stops",
    "value_at_default",
    "while_on",
]
