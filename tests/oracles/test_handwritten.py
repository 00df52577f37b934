"""The hand-written C against the numpy oracle and the reference scenes; its speed, printed."""

from __future__ import annotations

import copy
import ctypes
import math
import shutil
import statistics
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from paths import stored

from oracles import handwritten, scenes

SCENES = stored("scenes")["scenes"]
EPS = np.finfo(float).eps
MASSES = ("mass", "inertia")
BLOCKS = (slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13))
pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(scope="module", params=[(), ("-DHW_LIBM",)], ids=["own_atan2", "libm"])
def any_library(request: Any, tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return handwritten.build(tmp_path_factory.mktemp("handwritten"), request.param)


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return handwritten.build(tmp_path_factory.mktemp("handwritten"))


def excursions(library: ctypes.CDLL, scene: scenes.Scene) -> list[np.ndarray]:
    """Largest distances from the start over the motion, at 100 points."""
    trajectory = [scenes.start_state(scene)]
    for _ in range(100):
        trajectory.append(handwritten.rk8(library, scene, scene["t_end"] / 100, 20, trajectory[-1]))
    return handwritten.excursions(trajectory)


def tangle(rng: np.random.Generator) -> scenes.Scene:
    """Three bodies with every kind of connector: to and from the ground, diagonal and full."""
    diagonals = rng.uniform(1.0, 1e3, size=(6, 2, 6))
    full = rng.normal(size=(6, 2, 6, 6))
    return {
        "gravity": rng.normal(size=3),
        "law": "standard",
        "bodies": [
            {"mass": rng.uniform(0.1, 10), "inertia": rng.uniform(0.1, 10, size=3),
             "position": np.zeros(3), "velocity": np.zeros(3), "angular_velocity": np.zeros(3)}
            for _ in range(3)
        ],
        "connectors": [
            {"body0": body0, "body1": body1, "position0": rng.normal(size=3),
             "position1": rng.normal(size=3), "offset": rng.normal(size=6),
             "stiffness": np.diag(K) + i % 2 * full_K, "damping": np.diag(D) + i % 2 * full_D}
            for i, ((body0, body1), (K, D), (full_K, full_D)) in enumerate(zip(
                [(-1, 0), (1, -1), (0, 1), (2, 1), (0, 2), (-1, -1)], diagonals, full, strict=True
            ))
        ],
    }  # fmt: skip


def check_rates(library: ctypes.CDLL, scene: scenes.Scene, state: np.ndarray) -> None:
    """Each block of the rates to 1e-12 of its largest, or to the rounding of positions.

    Positions enter as differences, so stiff springs between bodies far from the origin see that.
    """
    ours, theirs = handwritten.rates(library, scene, state), scenes.rates(scene, state)
    stiffest = max(np.abs(connector["stiffness"]).max() for connector in scene["connectors"])
    force = EPS * np.abs(state[:, :3]).max() * stiffest
    mass, inertia = (min(np.min(body[key]) for body in scene["bodies"]) for key in MASSES)
    for block, rounding in zip(BLOCKS, (0.0, 0.0, force / mass, force / inertia), strict=True):
        size = np.abs(theirs[:, block]).max()
        error = np.abs(ours[:, block] - theirs[:, block]).max()
        assert error <= 1e-12 * size + rounding, block


@pytest.mark.parametrize("name", ["single", "coupled", "chain4", "chain16", "pair"])
def test_rates_agree_with_numpy(any_library: ctypes.CDLL, name: str) -> None:
    """At rest, nearby, far away, and with quaternions of any length."""
    rng = np.random.default_rng(1)
    scene = SCENES[name]
    start = scenes.start_state(scene)
    check_rates(any_library, scene, start)
    for spread in (1e-6, 1e-2, 1.0, 10.0):
        for _ in range(4):
            check_rates(any_library, scene, start + spread * rng.normal(size=start.shape))


def test_rates_of_every_kind_of_connector(any_library: ctypes.CDLL) -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        scene = tangle(rng)
        check_rates(any_library, scene, rng.normal(size=(3, 13)))


def test_length_of_the_quaternion_changes_nothing_else(library: ctypes.CDLL) -> None:
    scene = SCENES["chain4"]
    state = np.random.default_rng(3).normal(size=(4, 13))
    scaled = state.copy()
    scaled[:, 3:7] *= -2.0  # exact, so that even the rounding is the same
    a, b = (handwritten.rates(library, scene, x) for x in (state, scaled))
    a[:, 3:7] *= -2.0
    assert np.array_equal(a, b)


def test_angle_is_that_of_atan2(library: ctypes.CDLL) -> None:
    rng = np.random.default_rng(4)
    points = rng.normal(size=(20_000, 2)) * 10.0 ** rng.uniform(-8, 0, size=(20_000, 2))
    # The ends of its three ranges, and the axes.
    special = [(0.66, 1.0), (math.tan(3 * math.pi / 8), 1.0), (1.0, 1.0), (0.0, 1.0), (1.0, 0.0)]
    corners = [(i * y, j * x) for y, x in special for i in (1, -1) for j in (1, -1)]
    for y, x in [*points, *corners]:
        angle, exact = library.hw_angle_of(y, x), math.atan2(y + 0.0, x + 0.0)
        assert abs(angle - exact) <= 2 * math.ulp(exact), (y, x)
    assert library.hw_angle_of(0.0, 0.0) == 0.0


@pytest.mark.parametrize(("name", "steps"), [
    ("mini", 100), ("single", 160), ("coupled", 160), ("chain4", 320), ("chain16", 640),
])  # fmt: skip
def test_rk8_reaches_the_reference_state(library: ctypes.CDLL, name: str, steps: int) -> None:
    scene = SCENES[name]
    end = handwritten.rk8(library, scene, scene["t_end"], steps)
    size = excursions(library, scene)
    assert handwritten.error(end, scenes.final_state(scene), size) < 1e-10


def test_rk8_has_order_8(library: ctypes.CDLL) -> None:
    scene, t_end = SCENES["single"], 0.25
    exact = handwritten.rk8(library, scene, t_end, 1000)
    size = handwritten.excursions([scenes.start_state(scene), exact])
    steps = np.array([12, 16, 24, 32, 48])
    errors = [
        handwritten.error(handwritten.rk8(library, scene, t_end, int(n)), exact, size)
        for n in steps
    ]
    slopes = -np.diff(np.log(errors)) / np.diff(np.log(steps))
    assert np.all((slopes > 7.5) & (slopes < 8.6)), slopes
    # Far above rounding, or the slope would say nothing.
    assert min(errors) > 1e-13


def test_rk8_says_that_it_failed(library: ctypes.CDLL) -> None:
    scene = SCENES["chain16"]
    with pytest.raises(FloatingPointError, match="10 steps"):
        handwritten.rk8(library, scene, scene["t_end"], 10)


@pytest.mark.parametrize("links", [1, 4, 16])
def test_chain_is_that_of_the_file(links: int) -> None:
    stored = {key: value for key, value in SCENES[f"chain{links}"].items() if key != "final"}
    assert handwritten.chain(links) == stored


@pytest.mark.parametrize("change", [
    lambda scene: scene.update(law="consistent"),
    lambda scene: scene["bodies"][0].update(inertia=np.eye(3)),
    lambda scene: scene["connectors"][0].update(rotation0=np.eye(3)),
    lambda scene: scene["connectors"][0].update(velocity_offset=np.zeros(6)),
])  # fmt: skip
def test_what_it_cannot_do_is_refused(
    library: ctypes.CDLL, change: Callable[[scenes.Scene], None]
) -> None:
    scene = copy.deepcopy(SCENES["single"])
    state = scenes.start_state(scene)
    change(scene)
    with pytest.raises(ValueError, match="takes no such"):
        handwritten.rates(library, scene, state)
    with pytest.raises(ValueError, match="shape"):
        handwritten.rates(library, SCENES["single"], state[0])


@pytest.mark.benchmark
def test_speed(library: ctypes.CDLL) -> None:
    """Rates at half time, and the cheapest integration that ends within 1e-6 of the reference."""
    print()
    for name, scene in {**SCENES, "chain256": handwritten.chain(256)}.items():
        if name not in ("single", "coupled", "chain4", "chain16", "chain256"):
            continue
        t_end = scene["t_end"]
        state = handwritten.rk8(library, scene, 0.5 * t_end, 400)
        calls = 500_000 // len(state)
        runs = [handwritten.seconds_per_call(library, scene, state, calls) for _ in range(7)]
        took = 1e9 * statistics.median(runs)
        print(f"{name}: rates {took:.0f} ns a call, {took / len(state):.0f} a body and connector")
        assert took > 0
        if "final" not in scene:
            continue
        size, final = excursions(library, scene), scenes.final_state(scene)
        for steps in range(10, 1000):
            try:
                end = handwritten.rk8(library, scene, t_end, steps)
            except FloatingPointError:
                continue
            if handwritten.error(end, final, size) < 1e-6:
                break
        runs = [handwritten.seconds_of_rk8(library, scene, t_end, steps) for _ in range(7)]
        print(f"{name}: error below 1e-6 by {steps} steps, {1e3 * statistics.median(runs):.3f} ms")
