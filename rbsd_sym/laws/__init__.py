"""Connector laws: relative motion of two markers to a wrench; one file per law."""

from .base import Law, Relative, Response, SpringDamper, respond
from .consistent import Consistent
from .intrinsic import Intrinsic
from .standard import Standard

__all__ = [
    "Consistent", "Intrinsic", "Law", "Relative", "Response", "SpringDamper", "Standard",
    "respond",
]  # fmt: skip
