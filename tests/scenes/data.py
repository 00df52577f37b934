"""Models of bodies on connectors with data states, and methods at rtol 1e-10 to run them."""

from __future__ import annotations

from typing import Any

import rbsd_sym as rs

from . import effects

TIGHT = {name: effects.TIGHT[name] for name in ("idas", "rosenbrock", "explicit")}


def names(model: rs.Model) -> list[str]:
    return [label.name for label in model.x_labels]


def compiled(bodies: Any, connectors: Any, *args: Any, **scene: Any) -> rs.Model:
    return rs.compile_scene(rs.Scene("s", bodies, connectors, **scene), *args)
