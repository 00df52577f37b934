"""`handwritten.c` for scenes in the format of `scenes`: rates, integration of order 8, and times.

Law `standard`, principal inertias and marker frames along their bodies' axes; anything else raises
ValueError. States are arrays (n_bodies, 13) as in `scenes`.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from . import scenes
from .rotations import Array, from_quaternion
from .scenes import GROUND, Scene

SOURCE = Path(__file__).with_suffix(".c")
_EVALUATIONS = 12  # of the rates, in one step of rk8
_DOUBLES = np.ctypeslib.ndpointer(np.float64, flags="C_CONTIGUOUS")
_BODY = np.dtype([("inverse_mass", "f8"), ("inverse_inertia", "f8", 3), ("gyration", "f8", 3)])
_CONNECTOR = np.dtype([
    ("body0", "i4"), ("body1", "i4"), ("position0", "f8", 3), ("position1", "f8", 3),
    ("stiffness", "f8", 6), ("damping", "f8", 6), ("offset", "f8", 6), ("full", "u8"),
])  # fmt: skip
_BODY_KEYS = {"mass", "inertia", "position", "velocity", "angular_velocity", "rotation"}
_CONNECTOR_KEYS = {
    "body0", "body1", "position0", "position1", "stiffness", "damping", "offset", "law",
}  # fmt: skip


class _Scene(ctypes.Structure):
    """`hw_scene`; the arrays it points to live as long as it does."""

    _fields_ = (
        ("n_bodies", ctypes.c_int), ("n_connectors", ctypes.c_int),
        ("gravity", ctypes.c_double * 3), ("bodies", ctypes.c_void_p),
        ("connectors", ctypes.c_void_p), ("frames", ctypes.c_void_p),
    )  # fmt: skip


def build(folder: Path, options: Sequence[str] = ()) -> ctypes.CDLL:
    """The library, compiled into a folder; the option -DHW_LIBM takes atan2 from the C library."""
    path = folder / "handwritten.so"
    command = ["cc", "-O2", "-std=c99", "-Wall", "-Wextra", "-fPIC", "-shared", *options]
    subprocess.run([*command, str(SOURCE), "-lm", "-o", str(path)], check=True)
    library = ctypes.CDLL(str(path))
    scene, count, number = ctypes.POINTER(_Scene), ctypes.c_int, ctypes.c_double
    for name, result, arguments in (
        ("hw_angle_of", number, (number, number)),
        ("hw_rates", None, (scene, _DOUBLES, _DOUBLES)),
        ("hw_rk8", count, (scene, _DOUBLES, number, count, _DOUBLES)),
        ("hw_seconds_of_rk8", number, (scene, _DOUBLES, number, count, _DOUBLES)),
        ("hw_seconds_per_call", number, (scene, _DOUBLES, count, _DOUBLES)),
    ):
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


def _body(body: dict[str, Any]) -> tuple[float, Array, Array]:
    """One entry of `hw_body`: 1/m, 1/I, and (I_y - I_z)/I_x with its cyclic followers."""
    I = np.asarray(body["inertia"], dtype=float)
    if I.ndim != 1 or set(body) - _BODY_KEYS:
        raise ValueError(f"handwritten.c takes no such body: {body}")
    return 1.0 / body["mass"], 1.0 / I, (np.roll(I, -1) - np.roll(I, -2)) / I


def _to_c(scene: Scene) -> _Scene:
    """The scene as `hw_scene`; K and D that are not both diagonal go to `full`."""
    bodies = np.array([_body(body) for body in scene["bodies"]], dtype=_BODY)
    connectors = np.zeros(len(scene["connectors"]), dtype=_CONNECTOR)
    kept: list[Any] = [bodies, connectors, np.zeros((len(bodies), 9))]
    for row, connector in zip(connectors, scene["connectors"], strict=True):
        law = connector.get("law", scene.get("law"))
        if law != "standard" or set(connector) - _CONNECTOR_KEYS:
            raise ValueError(f"handwritten.c takes no such connector: {connector}")
        K_and_D = np.array([connector["stiffness"], connector["damping"]], dtype=float)
        for key in ("body0", "body1", "position0", "position1", "offset"):
            row[key] = connector[key]
        row["stiffness"], row["damping"] = np.einsum("kii->ki", K_and_D)
        if np.any(K_and_D[:, ~np.eye(6, dtype=bool)]):
            row["full"] = K_and_D.ctypes.data
            kept.append(K_and_D)
    out = _Scene(len(bodies), len(connectors), tuple(scene["gravity"]), *_addresses(kept[:3]))
    out.kept = kept
    return out


def _addresses(arrays: Sequence[Array]) -> list[int]:
    """Where the arrays' numbers begin."""
    return [array.ctypes.data for array in arrays]


def _start(scene: Scene, state: Array | None) -> Array:
    """A copy of the state that C may write to, the scene's start unless given."""
    start = scenes.start_state(scene) if state is None else state
    out = np.array(start, dtype=np.float64, order="C")
    if out.shape != (len(scene["bodies"]), 13):
        raise ValueError(f"state of shape {out.shape}")
    return out


def rates(library: ctypes.CDLL, scene: Scene, state: Array) -> Array:
    """Time derivative of the state, as `scenes.rates`."""
    x = _start(scene, state)
    out = np.empty_like(x)
    library.hw_rates(_to_c(scene), x, out)
    return out


def rk8(
    library: ctypes.CDLL, scene: Scene, t_end: float, steps: int, state: Array | None = None
) -> Array:
    """The state after equal steps of order 8, from the scene's start or from a given state."""
    x = _start(scene, state)
    if library.hw_rk8(_to_c(scene), x, t_end, steps, np.empty((_EVALUATIONS + 1, x.size))):
        raise FloatingPointError(f"{steps} steps are too few, or the motion has no end")
    return x


def seconds_of_rk8(library: ctypes.CDLL, scene: Scene, t_end: float, steps: int) -> float:
    """CPU time of `rk8` from the scene's start, the integration alone, measured in C."""
    x = _start(scene, None)
    work = np.empty((_EVALUATIONS + 1, x.size))
    return library.hw_seconds_of_rk8(_to_c(scene), x, t_end, steps, work)


def seconds_per_call(library: ctypes.CDLL, scene: Scene, state: Array, calls: int) -> float:
    """CPU time of one evaluation of the rates, measured in C over many calls."""
    x = _start(scene, state)
    return library.hw_seconds_per_call(_to_c(scene), x, calls, np.empty((2, x.size)))


def _observed(state: Array) -> list[Array]:
    """Position, rotation matrix, velocity and angular velocity of every body, (n, ...) each."""
    rotation = np.array([from_quaternion(x[3:7]) for x in state])
    return [state[:, :3], rotation, state[:, 7:10], state[:, 10:]]


def excursions(trajectory: Sequence[Array]) -> list[Array]:
    """Largest distance from the start over some states, at least 1e-3: 4 quantities, (n,) each.

    The measure of `scenes.reference.error`.
    """
    observed = [np.array(values) for values in zip(*map(_observed, trajectory), strict=True)]
    distances = (np.abs(values - values[0]).max(axis=0) for values in observed)
    return [np.maximum(d.reshape(len(d), -1).max(axis=1), 1e-3) for d in distances]


def error(state: Array, reference: Array, excursion: Sequence[Array]) -> float:
    """Largest difference over the four quantities, each relative to its excursion."""
    pairs = zip(_observed(state), _observed(reference), excursion, strict=True)
    return max((np.abs(a - b).reshape(len(a), -1).max(axis=1) / size).max() for a, b, size in pairs)


def chain(links: int) -> Scene:
    """The scenes `chain1`, `chain4`, `chain16` of `reference/scenes.json` with any number of links.

    Bricks of 1 x 0.1 x 0.2 m and 20 kg hang at the ground and in a row along x from joint to joint.
    """
    stiffness = np.diag([1e6, 1e6, 1e6, 1e4, 1e5, 1e5]).tolist()
    damping = np.diag([2e3, 2e3, 2e3, 20.0, 200.0, 200.0]).tolist()
    inertia = [0.08333333333333336, 1.7333333333333334, 1.6833333333333333]
    at_rest = {"velocity": [0.0] * 3, "angular_velocity": [0.0] * 3}
    return {
        "t_end": 1.0,
        "gravity": [0.0, 2.0, -9.6],
        "law": "standard",
        "bodies": [
            {"mass": 20.0, "inertia": inertia, "position": [0.5 + i, 0.0, 0.0], **at_rest}
            for i in range(links)
        ],
        "connectors": [
            {
                "body0": GROUND if i == 0 else i - 1,
                "body1": i,
                "position0": [0.0 if i == 0 else 0.5, 0.0, 0.0],
                "position1": [-0.5, 0.0, 0.0],
                "stiffness": stiffness,
                "damping": damping,
                "offset": [0.0] * 6,
            }
            for i in range(links)
        ],
    }
