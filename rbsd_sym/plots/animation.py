"""Pictures of a scene in motion: one time as a figure, or all of it as a GIF or an HTML page.

A body is drawn as a box of its `size`, or as the cuboid of uniform density that has its mass and
inertia; both are centred at the centre of mass. A body without inertia is a small cube. A connector
is a spring between its markers, with its joint frames (x orange, y green, z blue). It is grey and
dashed if the connector is not active, a ring if its length is zero, and pale where it is behind a
box. Its diameter is `draw_size`, or 5 % of the scene's size, less on small bodies. Triangles are
markers on the ground. Arrows are loads, torques with two heads; lengths are relative to the largest
force or torque. The grid is perpendicular to gravity, or to z without gravity, and below
everything. The bar shows kinetic energy and above it potential energy, counted from its least
value. Poses between the points of the trajectory are interpolated.
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

_MOST = 1500  # pictures of a film
_GRID = 200  # times from which the limits of a snapshot are taken
_SUFFIXES = (".gif", ".html")


class _Numbers(NamedTuple):
    """Bounds of a numeric argument, and its meaning for messages."""

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
    """Write a film of a motion, completely or not at all, and return its path.

    Bodies are boxes, connectors springs, loads arrows; the module's docstring has the details. The
    view is in perspective and fixed, and holds everything that is drawn at any time.

    >>> rs.plots.animate(model, trajectory, "motion.gif", column="joint.force_local")

    Arguments:
        model: with which the trajectory was made.
        traj: from `simulate`, or loaded from a file.
        path: ends in .gif, or in .html for a page with a player that needs no other file. The
            folder must exist.
        scene: from which the model was compiled; needed only if `model.scene` is None.
        fps: pictures per second, 0.1 to 50.
        duration: of the film, s; by default that of the motion.
        dpi: pixels per inch, 30 to 300.
        elevation, azimuth: of the viewer above the ground and about the vertical, degrees.
        column: a column of the trajectory, drawn over time beside the scene.

    Raises:
        TypeError: `scene` is not a scene.
        ValueError: another suffix, an unknown column, numbers out of bounds, more than 1500
            pictures, no scene, a trajectory of another model, a folder that cannot be written.
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
    """Return the picture of a motion at one time, as `animate` draws it.

    The limits are those of the whole motion, so pictures at several times can be compared.

    >>> rs.plots.snapshot(model, trajectory, 0.5).savefig("half_a_second.png")

    Arguments:
        model, traj, scene, elevation, azimuth, column: as in `animate`.
        t: s, within the trajectory; poses between saved points are interpolated.

    Raises:
        ValueError: a time outside of the trajectory; otherwise as in `animate`.
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
    # The fewest decimals that show this time exactly, or else as many as a film would have.
    most = _digits(times[:-1])
    exact = (d for d in range(2, most) if np.isclose(round(float(t), d), float(t), rtol=0))
    stage.show(len(times) - 1, _clock(float(t), next(exact, most), 1.0))
    return stage.figure


def _target(path: str | os.PathLike[str]) -> Path:
    target = Path(path)
    if target.suffix.lower() not in _SUFFIXES:
        raise ValueError(
            f"animate: path '{target}'; films are .gif or .html; give such a name, or for one "
            "picture use plots.snapshot(...).savefig"
        )
    return target


def _check(where: str, values: dict[str, Any]) -> None:
    for name, value in values.items():
        low, high, rule = _RULES[name]
        if not is_number(value) or not low <= float(value) <= high:
            raise ValueError(f"{where}: {name} {value!r}; it is {rule}; give another number")


def _times(traj: Trajectory, fps: float, duration: float | None) -> tuple[np.ndarray, float]:
    """Return the times of the pictures, and the length of the film over that of the motion."""
    first, last = float(traj.t[0]), float(traj.t[-1])
    length = last - first if duration is None else duration
    count = round(length * fps) + 1 if last > first else 1
    if count > _MOST:
        raise ValueError(
            f"animate: {count} pictures ({length:.6g} s, fps {fps:g}); a film has up to {_MOST}; "
            "give a shorter duration, or fewer fps"
        )
    # A motion shorter than one picture still gets its first and its last.
    count = max(count, min(2, len(traj.t)))
    slow = (count - 1) / fps / (last - first) if last > first else 1.0
    return np.linspace(first, last, count), 1.0 if duration is None else slow


def _digits(times: np.ndarray) -> int:
    """Return the number of decimals at which the time changes from picture to picture."""
    step = float(np.ptp(times)) / max(len(times) - 1, 1)
    return int(np.clip(np.ceil(-np.log10(step * 1.0001)), 2, 9)) if step > 0 else 2


def _clock(t: float, digits: int, slow: float) -> str:
    """Return the time as text, with the speed of the film if it is not that of the motion."""
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
    # Columns of another model may have the same names and other meanings.
    if traj.digest != model.digest:
        raise ValueError(
            f"{where}: trajectory '{traj.name}' has digest {traj.digest}, model '{model.name}' "
            f"{model.digest}; a film needs the model of its trajectory; simulate this model"
        )
    source = Source(model, traj)
    beside = (column, traj.t, source.column(column)) if column is not None else None
    return Stage(drawing.name, track(drawing, source, times), view, beside)


def _drawing(where: str, model: Model, scene: Scene | None) -> Drawing:
    chosen = scene if scene is not None else getattr(model, "scene", None)
    if chosen is None:
        raise ValueError(
            f"{where}: model '{model.name}' does not carry its scene; a picture needs it; give "
            "scene=..., from which it was compiled"
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
