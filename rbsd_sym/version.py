"""Version of the package, and of the shape of the generated headers."""

VERSION = "0.1.0"

ABI = 1
"""Changes when the shape of the C header changes; the loader refuses others."""
