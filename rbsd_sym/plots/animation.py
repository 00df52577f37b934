"""Pictures of a scene in motion: one time as a figure, or all of it as a GIF or a page.

A body is a box of its `size`, or else the cuboid of uniform density with its mass and inertia;
either is centred at the centre of mass. A body without inertia is a small cube. A connector is a
spring between its markers, with its joint frames (x orange, y green, z blue); one that is not
active is grey and dashed, one without length a ring; what is behind a box shines through. Its
diameter is `draw_size`, or 5 % of the scene, less on small bodies. Triangles are fixed to the
ground, arrows are loads (torques with two heads), each unit relative to its largest. The grid is
perpendicular to gravity and below everything; without gravity, to z. The bar is the energy,
potential above its least value. Between points of the trajectory poses are interpolated.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..base.files import write_whole
from ..base.symbols import is_number
from ..model.model import Model
from ..model.trajectory import Trajectory
from ..scene.scene import Scene
from .motion_files import Palette, sampled, write_gif, write_page
from .motion_stage import Film, Stage
from .motion_track import Source, track
from .shapes import Drawing, drawing_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MOST = 1500  # frames of a file
_GRID = 200  # times that the limits of a snapshot are taken from
_SUFFIXES = (".gif", ".html")


class _Numbers(NamedTuple):
    """Bounds of an argument and what it is."""

    low: float
    high: float
    rule: str


_RULES = {
    "fps": _Numbers(0.1, 50, "pictures per second, 0.1 to 50 (players of GIFs show no more)"),
    "duration": _Numbers(1e-3, 3600, "the length of the film, 0.001 to 3600 s; None is real time"),
    "dpi": _Numbers(30, 300, "pixels per inch, 30 to 300"),
    "elevation": _Numbers(-90, 90, "degrees above the ground, -90 to 90"),
    "azimuth": _Numbers(-360, 360, "degrees about the vertical, -360 to 360; 0 looks from x"),
}


def animate(
    model: Model,
    traj: Trajectory,
    path: str | os.PathLike[str],
    scene: Scene | None = None,
    *,
    fps: float = 20.0,
    duration: float | None = None,
    dpi: float = 100.0,
    elevation: float = 20.0,
    azimuth: float = -60.0,
    column: str | None = None,
) -> Path:
    """Write a film of a motion, whole or not at all; what is drawn is told in `plots.motion`.

    Arguments:
        traj: of the model, or loaded.
        path: ends in .gif, or in .html for a page with a player that needs nothing else.
        scene: which the model was compiled from; only if `model.scene` is not known.
        fps: pictures per second.
        duration: of the film, s; by default that of the motion.
        elevation, azimuth: from where one looks, degrees.
        column: such as "joint.force_local", drawn beside over time.

    Raises:
        ValueError: another suffix, an unknown column, numbers out of bounds, no scene, a folder
            that cannot be written to.
    """
    target = _target(path)
    given = {"fps": fps, "dpi": dpi, "elevation": elevation, "azimuth": azimuth}
    _check("animate", given if duration is None else given | {"duration": duration})
    times, slow = _times(traj, fps, duration)
    stage = _stage("animate", model, traj, scene, times, (elevation, azimuth), column)
    clocks = [_clock(t, _digits(times), slow) for t in times]
    film = Film(stage, clocks, dpi)

    def write(file: Any) -> None:
        palette = Palette(film.still, [film.picture(k) for k in sampled(len(clocks))])
        if target.suffix.lower() == ".gif":
            write_gif(file, film.pictures(), palette, fps, len(clocks))
        else:
            write_page(file, film.pictures(), palette, fps, clocks, f"{stage.name}: motion")

    return write_whole(target, write, "animate")


def snapshot(
    model: Model,
    traj: Trajectory,
    t: float,
    scene: Scene | None = None,
    *,
    elevation: float = 20.0,
    azimuth: float = -60.0,
    column: str | None = None,
) -> Figure:
    """The picture of a motion at one time, as `animate` draws it, in limits of the whole motion.

    Arguments:
        t: s, within the trajectory.

    Raises:
        ValueError: a time outside of the trajectory; else as in `animate`.
    """
    _check("snapshot", {"elevation": elevation, "azimuth": azimuth})
    first, last = float(traj.t[0]), float(traj.t[-1])
    if not is_number(t) or not first <= float(t) <= last:
        raise ValueError(
            f"snapshot: t {t!r} s; the trajectory goes from {first:.6g} to {last:.6g} s; choose a "
            "time within, or simulate longer"
        )
    picked = np.linspace(0, len(traj.t) - 1, min(len(traj.t), _GRID)).round().astype(int)
    times = np.append(traj.t[picked], float(t))
    stage = _stage("snapshot", model, traj, scene, times, (elevation, azimuth), column)
    most = _digits(times[:-1])
    exact = (d for d in range(2, most) if np.isclose(round(float(t), d), float(t), rtol=0))
    stage.show(len(times) - 1, _clock(float(t), next(exact, most), 1.0))
    return stage.figure


def _target(path: str | os.PathLike[str]) -> Path:
    target = Path(path)
    if target.suffix.lower() not in _SUFFIXES:
        raise ValueError(
            f"animate: path '{target}'; films are .gif or .html; give such a name, or take "
            "plots.snapshot(...).savefig for one picture"
        )
    return target


def _check(where: str, values: dict[str, Any]) -> None:
    for name, value in values.items():
        low, high, rule = _RULES[name]
        if not is_number(value) or not low <= float(value) <= high:
            raise ValueError(f"{where}: {name} {value!r}; it is {rule}; choose another")


def _times(traj: Trajectory, fps: float, duration: float | None) -> tuple[np.ndarray, float]:
    """Times of the pictures, and how much longer the film takes than the motion."""
    first, last = float(traj.t[0]), float(traj.t[-1])
    length = last - first if duration is None else duration
    count = round(length * fps) + 1 if last > first else 1
    if count > _MOST:
        raise ValueError(
            f"animate: {count} pictures ({length:.6g} s, fps {fps:g}); a film has up to {_MOST}; "
            "give a shorter duration, or fewer fps"
        )
    count = max(count, min(2, len(traj.t)))
    slow = (count - 1) / fps / (last - first) if last > first else 1.0
    return np.linspace(first, last, count), 1.0 if duration is None else slow


def _digits(times: np.ndarray) -> int:
    """Decimals with which the time changes from picture to picture."""
    step = float(np.ptp(times)) / max(len(times) - 1, 1)
    return int(np.clip(np.ceil(-np.log10(step * 1.0001)), 2, 9)) if step > 0 else 2


def _clock(t: float, digits: int, slow: float) -> str:
    """The time as text, and the speed of the film if it is not that of the motion."""
    pace = ""
    if abs(slow - 1) > 0.01:
        pace = f" ({slow:.3g}x slower)" if slow > 1 else f" ({1 / slow:.3g}x faster)"
    return f"t = {t:.{digits}f} s{pace}"


def _stage(
    where: str,
    model: Model,
    traj: Trajectory,
    scene: Scene | None,
    times: np.ndarray,
    view: tuple[float, float],
    column: str | None,
) -> Stage:
    drawing = _drawing(where, model, scene)
    if traj.digest != model.digest:
        raise ValueError(
            f"{where}: trajectory '{traj.name}' of digest {traj.digest}, model '{model.name}' of "
            f"{model.digest}; a film needs the model of its trajectory; simulate this one"
        )
    source = Source(model, traj)
    beside = (column, traj.t, source.column(column)) if column is not None else None
    return Stage(drawing.name, track(drawing, source, times), view, beside)


def _drawing(where: str, model: Model, scene: Scene | None) -> Drawing:
    chosen = scene if scene is not None else getattr(model, "scene", None)
    if chosen is None:
        raise ValueError(
            f"{where}: model '{model.name}' does not carry its scene; a picture needs it; give "
            "scene=... as compiled"
        )
    if not isinstance(chosen, Scene):
        raise TypeError(f"{where}: scene is a {type(chosen).__name__}; give the rbsd_sym.Scene")
    for body in chosen.bodies:
        if f"{body.name}.position" not in model.dae.outputs:
            raise ValueError(
                f"{where}: body '{body.name}' of scene '{chosen.name}' is not in model "
                f"'{model.name}'; give the scene that it was compiled from"
            )
    return drawing_of(chosen)
