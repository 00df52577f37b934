"""The figure of a moving scene: one set of artists, which are moved from picture to picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from ..base.names import titled
from .motion_camera import Camera, back_to_front, camera, hidden, level
from .motion_track import Track
from .shapes import FACES, NORMALS, arrow_head, corners, nice_step, spring
from .style import COLOURS, STYLES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..model.trajectory import Column

AXES = ("#D55E00", "#009E73", "#0072B2")  # x, y, z
ARROW = "#000000"  # with a white rim, visible in front of any colour
_HEIGHT = 4.4  # of the figure, inches
_WIDTH = 6.4  # of the scene's part, inches
_BESIDE = 3.9  # width of the panel with a column, inches
_TALL = 0.86  # height of the scene's panel over that of the figure
_MARGIN = 0.05  # around the scene, over its size on the screen
_DARK = 0.55  # brightness of a face in the shade
_BEHIND = 0.35  # opacity of a spring behind a box
_LIGHT = (-0.55, 0.78, 0.3)  # to the right of the picture, up, and towards the eye


class Polyline(NamedTuple):
    """A line through points (k, 3) in space, m, and how it is drawn."""

    points: np.ndarray
    colour: tuple[float, ...]
    width: float
    opacity: float = 1.0

    def cut(self, dim: np.ndarray) -> list[Polyline]:
        """Return the parts that are hidden, in a lower opacity, and those that are visible.

        Arguments:
            dim: (k - 1,) whether each segment is hidden.
        """
        at = [0, *(np.flatnonzero(dim[1:] != dim[:-1]) + 1), len(dim)]
        return [
            self._replace(points=self.points[i : j + 1], opacity=_BEHIND if dim[i] else 1.0)
            for i, j in pairwise(at)
            if j > i
        ]


class Stage:
    """A figure of a scene, and the artists that move in it.

    Arguments:
        name: of the scene, the title.
        track: what is drawn, at all times.
        view: elevation and azimuth, degrees.
        beside: name, times (n,) and values of a column to draw beside the scene.
    """

    def __init__(
        self,
        name: str,
        track: Track,
        view: tuple[float, float],
        beside: tuple[str, np.ndarray, Column] | None = None,
    ) -> None:
        # Matplotlib is imported where it is used: it is slow to import, and simulations do not
        # need it.
        from matplotlib.figure import Figure

        self.name, self.track, self.level = name, track, level(track.up)
        wide = _WIDTH + (_BESIDE if beside else 0.0)
        self.figure: Figure = Figure(figsize=(wide, _HEIGHT), dpi=100)
        self.share = _WIDTH / wide
        points = track.points.reshape(-1, 3)
        ground, step = _ground(points @ self.level, track.extent)
        # The camera and the limits are fixed by all that is drawn at any time, ground included, so
        # that nothing leaves the picture and the background need not be drawn again.
        sides = np.array([[x, y, ground[0, 2]] for x in ground[:, 0] for y in ground[:, 1]])
        every = np.vstack([points, sides @ self.level.T])
        self.camera: Camera = camera(every, track.up, *view)
        right, _, ahead = self.camera[1:]
        light = _LIGHT[0] * right + _LIGHT[1] * track.up - _LIGHT[2] * ahead
        self.light = light / np.linalg.norm(light)
        self.floor = float(ground[0, 2])
        self.panel = self._panel(every)
        self._draw_ground(ground, step)
        self._add_artists(name)
        self._draw_triad()
        self.energy = self._draw_energy()
        self.cursor = self._draw_column(*beside) if beside else None

    def _panel(self, every: np.ndarray) -> Axes:
        right = 0.84 if self.track.kinetic is not None else 1.0
        panel = self.figure.add_axes((0.0, 0.06, right * self.share, _TALL))
        panel.set_axis_off()
        flat = self.camera.screen(every)
        low, high = flat.min(axis=0), flat.max(axis=0)
        # One scale for both directions, or the picture would be distorted: that of the direction
        # that needs more room. `half` is half the panel's width and height on the screen.
        sides = np.array([right * _WIDTH, _TALL * _HEIGHT])  # inches
        half = float(((high - low) / sides).max()) * sides * (1 + _MARGIN) / 2
        middle = (low + high) / 2
        panel.set_xlim(middle[0] - half[0], middle[0] + half[0])
        panel.set_ylim(middle[1] - half[1], middle[1] + half[1])
        return panel

    def _draw_ground(self, ground: np.ndarray, step: float) -> None:
        from matplotlib.collections import LineCollection
        from matplotlib.patches import Polygon

        (x0, y0, z), (x1, y1, _) = ground
        lines = [[(x, y0, z), (x, y1, z)] for x in np.arange(x0, x1 + step / 2, step)]
        lines += [[(x0, y, z), (x1, y, z)] for y in np.arange(y0, y1 + step / 2, step)]
        flat = self.camera.screen(np.array(lines) @ self.level.T)
        sheet = np.array([(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)]) @ self.level.T
        self.panel.add_patch(Polygon(self.camera.screen(sheet), fc="#F6F6F4", ec="none", zorder=0))
        self.panel.add_collection(
            LineCollection(list(flat), colors="#DADAD6", linewidths=0.7, zorder=0.5), autolim=False
        )
        notes = [f"grid {step:g} m"]
        notes += [f"longest arrow {size:.3g} {unit}" for unit, size in self.track.largest.items()]
        self.figure.text(
            0.985 * self.share, 0.025, " · ".join(notes), ha="right", fontsize=8, color="#555555"
        )

    def _add_artists(self, name: str) -> None:
        from matplotlib.collections import LineCollection, PolyCollection
        from matplotlib.patheffects import withStroke

        add = self.panel.add_collection
        self.shadows = add(PolyCollection([], fc="#E4E4E0", ec="#E4E4E0", lw=0.5, zorder=1), False)
        self.boxes = add(PolyCollection([], lw=0.8, joinstyle="round", zorder=2), False)
        self.lines = add(LineCollection([], zorder=3, capstyle="round"), False)
        rim = [withStroke(linewidth=3.6, foreground="white")]
        self.shafts = add(
            LineCollection([], zorder=4, lw=2.0, colors=ARROW, path_effects=rim), False
        )
        self.heads = add(PolyCollection([], zorder=4, fc=ARROW, ec="white", lw=0.8), False)
        (self.feet,) = self.panel.plot(
            [], [], "^", ms=6, mfc="#BBBBBB", mec="#555555", mew=0.8, zorder=2.5
        )
        self.figure.text(0.02 * self.share, 0.945, name, fontsize=11, weight="bold")
        self.clock = self.figure.text(
            (0.83 if self.track.kinetic is not None else 0.97) * self.share,
            0.945,
            "",
            fontsize=11,
            ha="right",
            family="monospace",
        )

    def _draw_triad(self) -> None:
        """Draw the world axes in the lower left corner."""
        width = 0.1 * self.share
        inset = self.figure.add_axes((0.01 * self.share, 0.02, width, 0.145))
        inset.set_axis_off()
        inset.set_xlim(-1.45, 1.45)
        inset.set_ylim(-1.45, 1.45)
        inset.set_aspect("equal")
        ends = np.column_stack([self.camera.right, self.camera.above])
        for name, colour, end in zip("xyz", AXES, ends, strict=True):
            inset.plot([0, end[0]], [0, end[1]], color=colour, lw=1.8, solid_capstyle="round")
            inset.text(*(1.3 * end), name, color=colour, ha="center", va="center", fontsize=8)

    def _draw_energy(self) -> tuple[Any, Any] | None:
        if self.track.kinetic is None or self.track.potential is None:
            return None
        panel = self.figure.add_axes((0.925 * self.share, 0.15, 0.04 * self.share, 0.68))
        # The axis holds the largest energy of the whole motion, so heights can be compared.
        most = float((self.track.kinetic + self.track.potential).max())
        panel.set_ylim(0, most or 1.0)
        panel.set_xlim(0, 1)
        panel.set_xticks([])
        panel.tick_params(labelsize=7, length=2)
        panel.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
        panel.yaxis.get_offset_text().set_visible(False)
        scale = _power(most)
        panel.yaxis.set_major_formatter(lambda value, _: f"{value / 10.0**scale:g}")
        panel.set_ylabel(f"energy [{_times_ten(scale)}J]", fontsize=8, labelpad=1)
        (low,) = panel.bar([0.5], [0], 1, color=COLOURS[0], label="kinetic")
        (high,) = panel.bar(
            [0.5], [0], 1, color=COLOURS[6], hatch="///", ec="#FFFFFF", lw=0, label="potential"
        )
        panel.legend(
            loc="lower right",
            bbox_to_anchor=(1.35, 1.0),
            fontsize=7,
            frameon=False,
            handlelength=1,
            borderpad=0.1,
            reverse=True,
        )
        return low, high

    def _draw_column(self, name: str, t: np.ndarray, column: Column) -> Any:
        left = self.share + 0.62 / (_WIDTH + _BESIDE)
        panel = self.figure.add_axes((left, 0.13, 0.985 - left, 0.74))
        values = column.values.reshape(len(t), -1)
        many = values.shape[1]
        for i in range(many):
            label = column.components[i] if len(column.components) == many else str(i)
            style = STYLES[(i // len(COLOURS) + i) % len(STYLES)]
            panel.plot(t, values[:, i], style, color=COLOURS[i % len(COLOURS)], lw=1.3, label=label)
        quantity = titled(name)
        panel.set_title(name, loc="left", fontsize=9)
        panel.set_xlabel("time [s]", fontsize=8)
        unit = f" [{column.unit}]" if column.unit else ""
        panel.set_ylabel(f"{quantity}{unit}", fontsize=8, labelpad=1)
        panel.tick_params(labelsize=7)
        panel.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)
        panel.yaxis.get_offset_text().set_fontsize(7)
        panel.grid(alpha=0.3)
        panel.margins(x=0)
        if np.ptp(values) < 1e-12 * max(1.0, float(np.abs(values).max())):
            panel.set_ylim(float(values.mean()) - 1, float(values.mean()) + 1)
        if 1 < many <= 9:
            panel.legend(
                fontsize=7,
                ncols=3,
                loc="lower right",
                bbox_to_anchor=(1.0, 1.0),
                frameon=False,
                handlelength=2.2,
            )
        return panel.axvline(t[0], color="#666666", lw=1.2)

    @property
    def moving(self) -> list[Any]:
        """The artists that move, in the order in which they are painted."""
        found = [self.shadows, self.boxes, self.feet, self.lines, self.shafts, self.heads]
        return [*found, *(self.energy or ()), *([self.cursor] if self.cursor else []), self.clock]

    def show(self, k: int, clock: str) -> None:
        """Move everything to the k-th time of the track.

        Arguments:
            clock: text that shows the time.
        """
        track, eye = self.track, self.camera.eye
        place = track.boxes.p[k], track.boxes.R[k], track.edges
        self._show_boxes(corners(*place), place)
        pieces = self._pieces(k)
        points = self.camera.screen(np.vstack([np.zeros((0, 3)), *(p.points for p in pieces)]))
        parts = np.split(points, np.cumsum([len(piece.points) for piece in pieces]))[:-1]
        middles = np.array([piece.points[len(piece.points) // 2] for piece in pieces])
        order = np.argsort(-self.camera.distance(middles.reshape(-1, 3)))
        self.lines.set_segments([parts[i] for i in order])
        self.lines.set_color([(*pieces[i].colour, pieces[i].opacity) for i in order] or "none")
        self.lines.set_linewidth([pieces[i].width for i in order] or [0.0])
        feet = track.ends.p[k][track.fixed]
        feet = self.camera.screen(feet[~hidden(eye, feet, *place)])
        self.feet.set_data(feet[:, 0], feet[:, 1])
        self._show_arrows(k)
        if self.energy and track.kinetic is not None and track.potential is not None:
            low, high = self.energy
            low.set_height(track.kinetic[k])
            high.set_y(track.kinetic[k])
            high.set_height(track.potential[k])
        if self.cursor is not None:
            self.cursor.set_xdata([track.t[k], track.t[k]])
        self.clock.set_text(clock)

    def _show_boxes(self, points: np.ndarray, place: tuple[np.ndarray, ...]) -> None:
        centres, axes, edges = place
        faces, fills, rims = [], [], []
        flat = self.camera.screen(points)
        for i in back_to_front(self.camera.eye, centres, axes, edges):
            normals = NORMALS @ axes[i].T
            middles = centres[i] + normals * np.repeat(edges[i], 2)[:, None] / 2
            shade = normals @ self.light
            # Only faces whose outer side is towards the eye are painted. A convex body needs no
            # order among these.
            for j in np.flatnonzero(np.einsum("ij,ij->i", normals, self.camera.eye - middles) > 0):
                bright = _DARK + (1 - _DARK) * (1 + shade[j]) / 2
                faces.append(flat[i][FACES[j]])
                fills.append(0.12 + 0.88 * self.track.fills[i] * bright)
                rims.append(self.track.fills[i] * 0.45)
        self.boxes.set_verts(faces)
        self.boxes.set_facecolor(np.array(fills).reshape(-1, 3))
        self.boxes.set_edgecolor(np.array(rims).reshape(-1, 3))
        # Shadows are those of light from straight above: the faces, moved down to the ground.
        local = points @ self.level
        local[..., 2] = self.floor
        self.shadows.set_verts(
            list(self.camera.screen((local @ self.level.T)[:, FACES].reshape(-1, 4, 3)))
        )

    def _pieces(self, k: int) -> list[Polyline]:
        """Return springs and joint axes, cut where they pass behind a box."""
        track, whole = self.track, []
        for i, diameter in enumerate(track.diameters):
            ends, turns = track.ends.p[k, 2 * i : 2 * i + 2], track.ends.R[k, 2 * i : 2 * i + 2]
            path, colour = spring(ends[0], ends[1], turns[0][:, 2], diameter), track.colours[i]
            dashes = [path[j : j + 3] for j in range(0, len(path) - 1, 4)]
            every = [path] if track.active[k, i] else dashes
            whole += [Polyline(dash, tuple(colour), 1.1) for dash in every]
            for place, turn in zip(ends, turns, strict=True):
                whole += [
                    Polyline(np.array([place, place + 0.9 * diameter * axis]), _rgb(name), 1.5)
                    for axis, name in zip(turn.T, AXES, strict=True)
                ]
        if not whole:
            return []
        # A segment counts as hidden if its middle is; one call tests the segments of all lines.
        middles = [(piece.points[1:] + piece.points[:-1]) / 2 for piece in whole]
        place = track.boxes.p[k], track.boxes.R[k], track.edges
        dim = hidden(self.camera.eye, np.vstack(middles), *place)
        parts = np.split(dim, np.cumsum([len(m) for m in middles])[:-1])
        return [cut for piece, flags in zip(whole, parts, strict=True) for cut in piece.cut(flags)]

    def _show_arrows(self, k: int) -> None:
        shafts, heads = [], []
        size = 0.035 * float(np.ptp(self.panel.get_xlim()))
        for unit, tails, ends in self.track.shafts:
            tail, tip = self.camera.screen(np.array([tails[k], ends[k]]))
            if not np.any(ends[k] != tails[k]):
                continue
            head = arrow_head(tail, tip, size)
            back = head[1:].mean(axis=0)
            shafts.append([tail, back])
            heads += [head] if unit == "N" else [head - 0.7 * (tip - back), head]
        self.shafts.set_segments(shafts)
        self.heads.set_verts(heads)


class Film:
    """The pictures of a stage as pixels; what does not move is drawn once.

    Arguments:
        clocks: text that shows the time, for each picture.
        dpi: pixels per inch.
    """

    def __init__(self, stage: Stage, clocks: Sequence[str], dpi: float) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        self.stage, self.clocks = stage, clocks
        stage.figure.set_dpi(dpi)
        self.canvas = FigureCanvasAgg(stage.figure)
        # Animated artists are left out of an ordinary drawing. What remains is kept as background,
        # restored before each picture, and only the moving artists are drawn on it.
        for artist in stage.moving:
            artist.set_animated(True)
        self.canvas.draw()
        self.region = self.canvas.copy_from_bbox(stage.figure.bbox)
        self.still = self._pixels()

    def _pixels(self) -> np.ndarray:
        return np.asarray(self.canvas.buffer_rgba())[:, :, :3].copy()

    def picture(self, k: int) -> np.ndarray:
        """Return the pixels (height, width, 3) of the k-th picture."""
        self.canvas.restore_region(self.region)
        self.stage.show(k, self.clocks[k])
        for artist in self.stage.moving:
            self.stage.figure.draw_artist(artist)
        return self._pixels()

    def pictures(self) -> Iterator[np.ndarray]:
        """Return all pictures, drawn one by one as they are asked for."""
        return (self.picture(k) for k in range(len(self.clocks)))


@cache
def _rgb(colour: str) -> tuple[float, ...]:
    from matplotlib.colors import to_rgb

    return to_rgb(colour)


def _ground(local: np.ndarray, extent: float) -> tuple[np.ndarray, float]:
    """Return opposite corners (2, 3) of the ground in level axes, and the step of its grid, m.

    The ground is below everything, and its edges are lines of the grid.
    """
    low, high = local.min(axis=0), local.max(axis=0)
    step = nice_step(float(max((high - low)[:2].max(), 0.5 * extent)))
    first, last = np.floor(low[:2] / step - 0.2) * step, np.ceil(high[:2] / step + 0.2) * step
    floor = low[2] - 0.02 * extent
    return np.array([[*first, floor], [*last, floor]]), step


def _power(value: float) -> int:
    """Return the power of ten to take out of an axis' numbers, a multiple of 3 for a prefix."""
    power = int(np.floor(np.log10(value))) if value > 0 else 0
    return 0 if -2 <= power <= 3 else power // 3 * 3


def _times_ten(power: int) -> str:
    prefixes = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
    return prefixes.get(power, f"1e{power} ")
