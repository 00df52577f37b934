"""Pictures of motion: the numbers behind them, the files, and what is said of bad arguments."""

from __future__ import annotations

import dataclasses
import io
import json
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

import rbsd_sym as rs
from models import pair
from rbsd_sym.base import files
from rbsd_sym.plots import animation as motion
from rbsd_sym.plots import motion_files
from rbsd_sym.plots.motion_camera import back_to_front, camera, hidden
from rbsd_sym.plots.motion_track import Source, Track, track
from rbsd_sym.plots.shapes import (
    INACTIVE,
    box_of_inertia,
    corners,
    drawing_of,
    quaternion_matrix,
    spring,
)


class Run(NamedTuple):
    scene: rs.Scene
    model: rs.Model
    trajectory: rs.Trajectory


def run_of(scene: rs.Scene, t_end: float = 1.0, **arguments) -> Run:
    model = rs.compile_scene(scene)
    return Run(scene, model, rs.simulate(model, t_end, **arguments))


@pytest.fixture(scope="module")
def two() -> Run:
    return run_of(pair.scene())


def turn(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[j, j], R[i, j], R[j, i] = c, c, -s, s
    return R


def driven_scene(**more) -> rs.Scene:
    """Markers driven by time, a Param and an Input; a body without a size, one that is hidden."""
    length, pull = rs.Param("arm_length", 0.4, "m"), rs.Input("pull", "N")
    R = turn(2, 0.5)
    arm = rs.RigidBody("arm", 3, R @ np.diag([0.02, 0.08, 0.09]) @ R.T, com=(0.1, 0, 0))
    ghost = rs.RigidBody("ghost", 1, (0.01, 0.01, 0.01), position=(1, 0, 0.5), show=False)
    k, c = (400, 400, 400, 5, 5, 5), (2, 2, 2, 0.1, 0.1, 0.1)
    high = rs.Marker(rs.GROUND, (0, 0.3 * np.sin(4 * rs.TIME), 1.2))
    drive = rs.RigidBodySpringDamper("drive", high, rs.Marker("arm", (0, 0, 0.05)), k, c)
    link = rs.RigidBodySpringDamper(
        "link", rs.Marker("arm", (length, 0, 0), turn(0, 0.3)), rs.Marker("ghost"), k, c,
        rotation_marker0=turn(1, 0.2), draw_size=0.06,
    )  # fmt: skip
    asleep = rs.RigidBodySpringDamper(
        "asleep", rs.Marker(rs.GROUND, (1, 0.5, 0)), rs.Marker("ghost"), k, active=False
    )
    unseen = rs.RigidBodySpringDamper(
        "unseen", rs.Marker(rs.GROUND), rs.Marker("arm"), k, c, show=False
    )
    load = rs.Load("tug", rs.Marker("arm", (0.3, 0, 0)), (0, pull, 0), (0, 0, 0.5), frame="body")
    return rs.Scene(
        "driven", [arm, ghost], [drive, link, asleep, unseen], [load], (0, -9.81, 0), **more
    )


@pytest.fixture(scope="module")
def driven() -> Run:
    signals = {"pull": lambda t: 10 * np.cos(3 * t)}
    return run_of(driven_scene(), 1.5, inputs=signals, params={"arm_length": 0.5})


def track_of(run: Run, t: np.ndarray | None = None) -> Track:
    times = run.trajectory.t if t is None else t
    return track(drawing_of(run.scene), Source(run.model, run.trajectory), times)


def in_bare(model: rs.Model) -> rs.Model:
    """The model without its scene."""
    known = [field.name for field in dataclasses.fields(model)]
    return dataclasses.replace(model, scene=None) if "scene" in known else model


# Numbers


@pytest.mark.parametrize("edges", [(0.3, 0.5, 0.9), (1.0, 0.1, 0.2), (0.4, 0.4, 0.4)])
@pytest.mark.parametrize("R", [np.eye(3), turn(0, 0.7) @ turn(2, -1.1)], ids=["along", "turned"])
def test_box_of_inertia_inverts_the_formula_of_the_cuboid(edges, R) -> None:
    mass, (a, b, c) = 7.0, edges
    inertia = mass / 12 * np.diag([b * b + c * c, a * a + c * c, a * a + b * b])
    found, axes = box_of_inertia(mass, R @ inertia @ R.T)
    assert sorted(found) == pytest.approx(sorted(edges))
    again = mass / 12 * np.diag((found**2).sum() - found**2)
    assert axes @ again @ axes.T == pytest.approx(R @ inertia @ R.T)
    assert np.linalg.det(axes) == pytest.approx(1)


def test_a_rod_stays_visible_and_a_point_is_a_small_cube() -> None:
    rod, _ = box_of_inertia(2.0, np.diag([0.0, 1.5, 1.5]))
    assert rod == pytest.approx([3.0, 0.09, 0.09])
    for mass, inertia in ((0.0, 0.0), (1.0, 0.0)):
        assert (box_of_inertia(mass, np.eye(3) * inertia)[0] == 0).all()
    point = rs.RigidBody("point", 1, 0, velocity=(2, 0, 0))
    thread = rs.RigidBodySpringDamper("thread", rs.Marker(rs.GROUND), rs.Marker("point"), [9] * 6)
    drawn = track_of(run_of(rs.Scene("point_scene", [point], [thread])))
    assert drawn.edges == pytest.approx(np.full((1, 3), 0.04 * drawn.extent))


def test_boxes_are_centred_at_the_centre_of_mass(driven: Run) -> None:
    drawn, trajectory = track_of(driven), driven.trajectory
    R = trajectory["arm.rotation_matrix"]
    centre = trajectory["arm.position"] + R @ [0.1, 0, 0]
    assert drawn.boxes.p[:, 0] == pytest.approx(centre, abs=1e-12)
    principal = np.einsum("nji,njk->nik", R, drawn.boxes.R[:, 0])  # box to body
    edges = drawn.edges[0]
    again = 3 / 12 * np.diag((edges**2).sum() - edges**2)
    expected = turn(2, 0.5) @ np.diag([0.02, 0.08, 0.09]) @ turn(2, 0.5).T
    for axes in principal[::40]:
        assert axes @ again @ axes.T == pytest.approx(expected, abs=1e-12)


def test_springs_end_at_the_markers(driven: Run) -> None:
    drawn, trajectory = track_of(driven), driven.trajectory
    t = trajectory.t
    R, p = trajectory["arm.rotation_matrix"], trajectory["arm.position"]
    high = np.stack([0 * t, 0.3 * np.sin(4 * t), 0 * t + 1.2], axis=1)
    expected = [high, p + R @ [0, 0, 0.05], p + R @ [0.5, 0, 0], trajectory["ghost.position"]]
    for i, place in enumerate(expected):
        assert drawn.ends.p[:, i] == pytest.approx(place, abs=1e-9)
    assert drawn.ends.R[:, 2] == pytest.approx(R @ turn(0, 0.3) @ turn(1, 0.2), abs=1e-9)
    path = spring(drawn.ends.p[9, 0], drawn.ends.p[9, 1], np.array([0.0, 0, 1]), 0.1)
    assert (path[0] == drawn.ends.p[9, 0]).all()
    assert (path[-1] == drawn.ends.p[9, 1]).all()
    assert list(drawn.fixed) == [True, False, False, False, True, False]


def test_arrows_follow_inputs_in_body_axes(driven: Run) -> None:
    drawn, trajectory = track_of(driven), driven.trajectory
    (_, newton, tails, force), (_, metre, _, torque) = drawn.arrows
    R, zero = trajectory["arm.rotation_matrix"], 0 * trajectory.t
    pull = np.stack([zero, 10 * np.cos(3 * trajectory.t), zero], axis=1)
    assert (newton, metre) == ("N", "N m")
    assert force == pytest.approx(np.einsum("nij,nj->ni", R, pull), abs=1e-9)
    assert torque == pytest.approx(R @ [0, 0, 0.5], abs=1e-12)
    assert tails == pytest.approx(trajectory["arm.position"] + R @ [0.3, 0, 0], abs=1e-12)
    assert drawn.largest == pytest.approx({"N": 10.0, "N m": 0.5})


def test_energy_is_split_and_up_is_against_gravity(driven: Run, two: Run) -> None:
    drawn = track_of(driven)
    assert drawn.up == pytest.approx([0, 1, 0])
    assert drawn.potential is not None
    assert drawn.potential.min() == pytest.approx(0, abs=1e-9)
    free = track_of(two)
    assert free.up == pytest.approx([0, 0, 1])
    assert free.kinetic + free.potential == pytest.approx(two.trajectory["energy"])


def test_poses_between_saved_points_are_rotations(two: Run) -> None:
    t = np.linspace(0, 1, 77)
    R = track_of(two, t).boxes.R
    assert R @ R.transpose(0, 1, 3, 2) == pytest.approx(np.broadcast_to(np.eye(3), R.shape))
    q = np.array([0.5, -0.5, 0.5, 0.5])
    assert quaternion_matrix(q) == pytest.approx(np.array([[0, -1, 0], [0, 0, 1], [-1, 0, 0]]))


def test_a_spring_without_length_is_a_ring() -> None:
    place, axis = np.array([1.0, 2, 3]), turn(0, 0.4)[:, 2]
    path = spring(place, place, axis, 0.2)
    assert path[[0, 1, -2, -1]] == pytest.approx(np.tile(place, (4, 1)))
    assert np.linalg.norm(path[2:-2] - place, axis=1) == pytest.approx(0.1)
    assert (path - place) @ axis == pytest.approx(np.zeros(len(path)), abs=1e-12)


def test_show_false_hides_and_asleep_is_grey(driven: Run) -> None:
    drawn = track_of(driven)
    assert drawn.boxes.p.shape[1] == 1
    assert drawn.ends.p.shape[1] == 6  # drive, link, asleep
    assert (drawn.active == [True, True, False]).all()
    grey = [int(INACTIVE[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    assert drawn.colours[2] == pytest.approx(grey)
    assert drawn.diameters[1] == 0.06


# Perspective


def test_the_nearer_box_is_painted_last_and_hides_what_is_behind() -> None:
    centres = np.array([[0.0, 0, 0], [3.0, 0, 0], [0.3, 0, 1.0]])
    axes, edges = np.tile(np.eye(3), (3, 1, 1)), np.array([[4.0, 1, 1], [1, 1, 1], [0.2, 1, 1]])
    assert back_to_front(np.array([9.0, 0, 5]), centres, axes, edges) == [0, 2, 1]
    assert back_to_front(np.array([-9.0, 0, -5]), centres, axes, edges)[-1] == 0
    points = np.array([[0.0, 0, 0], [-9, 0, 0], [9, 0, 0], [0, 5, 0]])
    seen = hidden(np.array([20.0, 0, 0]), points, centres, axes, edges)
    assert list(seen) == [True, True, False, False]


def test_the_camera_sees_everything_upright() -> None:
    points = corners(np.zeros(3), np.eye(3), np.array([1.0, 2, 3]))
    eye = camera(points, np.array([0.0, 1, 0]), 20, -60)
    assert ((points - eye.eye) @ eye.ahead > 0).all()
    low, high = eye.screen(np.array([[0.0, -1, 0], [0.0, 1, 0]]))
    assert high[1] > low[1]
    assert high[0] == pytest.approx(low[0])


# Files


def test_gif_has_a_frame_for_each_time_and_is_small(two: Run, tmp_path: Path) -> None:
    path = rs.plots.animate(two.model, two.trajectory, tmp_path / "pair.gif", two.scene, fps=12)
    with Image.open(path) as image:
        assert image.n_frames == 13
        assert image.size == (640, 440)
        length = 0
        for k in range(image.n_frames):
            image.seek(k)
            length += image.info["duration"]
        assert length == pytest.approx(1000 * 13 / 12, abs=10)
        assert image.convert("RGB").getpixel((300, 60)) == (255, 255, 255)
    assert path.stat().st_size < 1.5e6 * 13 / 101
    assert [p.name for p in tmp_path.iterdir()] == ["pair.gif"]


def test_page_is_self_contained_and_escapes_names(two: Run, tmp_path: Path) -> None:
    path = rs.plots.animate(
        two.model, two.trajectory, tmp_path / "pair.html", two.scene, fps=3, dpi=40, duration=2,
        column="joint.force_local",
    )  # fmt: skip
    text = path.read_text()
    assert "http" not in text
    assert not re.search(r"""(src|href)\s*=\s*["']?[^"'\s]*//|url\(|@import""", text)
    data = json.loads(re.search(r"^const data = (.*);$", text, re.M)[1])
    assert len(data["frames"]) == len(data["clocks"]) == 7
    assert data["clocks"][3] == "t = 0.50 s (2x slower)"
    out = io.BytesIO()
    palette = motion_files.Palette(np.zeros((4, 4, 3), np.uint8), [])
    nasty = '<script>alert("&")</script> DATA'
    motion_files.write_page(out, [], palette, 1.0, ["</script>"], nasty)
    page = out.getvalue().decode()
    assert page.count("<script>") == page.count("</script>") == 1
    assert "&lt;script&gt;alert(&quot;&amp;&quot;)&lt;/script&gt; DATA" in page


def test_frames_of_page_and_film_are_the_pictures(two: Run) -> None:
    stage = motion._stage(
        "animate", two.model, two.trajectory, two.scene, np.array([0.0, 0.5]), (20, -60), None
    )
    film = motion.Film(stage, ["first", "second"], 50)
    pixels = film.picture(1)
    palette = motion_files.Palette(film.still, [film.picture(0), pixels])
    shown = np.array(palette.picture(palette.indices(pixels)).convert("RGB")).astype(int)
    assert np.abs(shown - pixels).mean() < 1.0
    index, base = palette.indices(pixels), palette.still
    layer = np.array(palette.picture(index, base))
    assert (np.where(layer == 96, base, layer) == index).all()


def test_snapshot_shows_the_time_and_the_column(driven: Run) -> None:
    figure = rs.plots.snapshot(
        driven.model, driven.trajectory, 0.53, driven.scene, column="link.force_local"
    )
    texts = [text.get_text() for text in figure.texts]
    assert "t = 0.53 s" in texts
    assert any("grid 0.2 m" in text and "10 N" in text for text in texts)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert "force local [N]" in labels
    assert "energy [J]" in labels
    out = io.BytesIO()
    figure.savefig(out, format="png")
    assert len(out.getvalue()) > 10_000


def test_a_loaded_trajectory_needs_only_the_model(driven: Run, tmp_path: Path) -> None:
    path = driven.trajectory.save(tmp_path / "driven.npz")
    loaded = rs.Trajectory.load(path)
    again = track(drawing_of(driven.scene), Source(driven.model, loaded), driven.trajectory.t)
    assert again.ends.p == pytest.approx(track_of(driven).ends.p, abs=1e-12)


def test_a_model_that_carries_its_scene_needs_no_other(two: Run) -> None:
    model = in_bare(rs.compile_scene(two.scene))
    object.__setattr__(model, "scene", two.scene)
    figure = rs.plots.snapshot(model, two.trajectory, 0.0)
    assert any(text.get_text() == "pair" for text in figure.texts)


@pytest.mark.parametrize("place", ["write_gif", "replace"])
def test_nothing_is_left_when_writing_fails(two: Run, tmp_path: Path, monkeypatch, place) -> None:
    def fail(*arguments, **more):
        raise OSError("disk full")

    path = tmp_path / "pair.gif"
    path.write_bytes(b"before")
    target = motion if place == "write_gif" else files.os
    monkeypatch.setattr(target, place, fail)
    with pytest.raises(ValueError, match="disk full"):
        rs.plots.animate(two.model, two.trajectory, path, two.scene, fps=2, dpi=30)
    assert [p.name for p in tmp_path.iterdir()] == ["pair.gif"]
    assert path.read_bytes() == b"before"


# Bad arguments


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "film.mp4"}, "animate: path 'film.mp4'; films are .gif or .html"),
        ({"path": "film"}, "animate: path 'film'; films are"),
        ({"path": "none/film.gif"}, "cannot write to none .*make the folder"),
        ({"fps": 0}, "fps 0; it is pictures per second, 0.1 to 50"),
        ({"fps": 30, "duration": 3000}, "90001 pictures .*shorter duration"),
        ({"duration": -1.0}, "duration -1.0; it is"),
        ({"dpi": float("nan")}, "dpi nan; it is"),
        ({"elevation": 91}, "elevation 91; it is degrees"),
        ({"azimuth": "left"}, "azimuth 'left'; it is degrees"),
        ({"column": "joint.fork"}, "no output 'joint.fork'; there are: joint.displacement_local"),
        ({"column": "nothing"}, "no output 'nothing'; there are: "),
    ],
)
def test_bad_arguments_are_told(two: Run, arguments, message, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=message):
        rs.plots.animate(
            two.model, two.trajectory, scene=two.scene, **{"path": "film.gif", **arguments}
        )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("t", [-0.1, 1.01, float("nan"), "end"])
def test_bad_times_are_told(two: Run, t) -> None:
    with pytest.raises(ValueError, match=r"snapshot: t .* goes from 0 to 1 s; choose a time"):
        rs.plots.snapshot(two.model, two.trajectory, t, two.scene)


def test_a_missing_or_other_scene_is_told(two: Run, driven: Run) -> None:
    with pytest.raises(ValueError, match=r"'pair' does not carry its scene; .*give scene="):
        rs.plots.snapshot(in_bare(two.model), two.trajectory, 0.5)
    with pytest.raises(ValueError, match="body 'arm' of scene 'driven' is not in model 'pair'"):
        rs.plots.snapshot(two.model, two.trajectory, 0.5, driven.scene)
    with pytest.raises(TypeError, match=r"scene is a str; give the rbsd_sym.Scene"):
        rs.plots.snapshot(two.model, two.trajectory, 0.5, "pair")
    with pytest.raises(ValueError, match="needs the model of its trajectory"):
        rs.plots.snapshot(two.model, driven.trajectory, 0.5, two.scene)


@pytest.mark.parametrize(
    ("body", "connector", "message"),
    [
        ({"size": (1, 0, 1)}, {}, r"body 'a', size: \(1, 0, 1\); it is three positive lengths"),
        ({"size": 2}, {}, "body 'a', size: 2; it is three positive lengths"),
        ({"color": "blau"}, {}, "body 'a', color: 'blau'; it is a colour of matplotlib"),
        ({}, {"draw_size": -2}, "connector 'c', draw_size: -2; it is a positive length in m"),
        ({}, {"draw_size": "big"}, "connector 'c', draw_size: 'big'; it is a positive"),
        ({}, {"color": (2, 0, 0)}, "connector 'c', color: .*colour of matplotlib"),
        ({"show": False}, {"show": False}, "show=False everywhere; .*set show=True"),
    ],
)
def test_drawing_attributes_are_checked(body, connector, message) -> None:
    a = rs.RigidBody("a", 1, (1, 1, 1), **body)
    c = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("a"), [1] * 6, **connector)
    with pytest.raises(ValueError, match=message):
        drawing_of(rs.Scene("s", [a], [c]))
