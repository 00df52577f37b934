"""Connector laws: from the relative motion of two markers to their wrenches; one file per law.

`Standard`, `Intrinsic` and `Consistent` define what the strain and its rate are. Effects, such as
`Contact` and `Friction`, add forces along one component of the strain, or act on the whole wrench.
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
