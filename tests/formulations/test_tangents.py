"""Tangent stiffness and damping of connectors against complex step of the oracle laws."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from oracles import laws as oracle
from oracles import rotations, scenes
from oracles.laws import Pose
from oracles.scenes import marker_pose
from scenes import reference

import rbsd_sym as rs

SCENES = ["coupled", "chain4", "pair", "pair_intrinsic", "chain4_consistent", "pair_consistent"]
ORACLES = {"standard": oracle.standard, "intrinsic": oracle.intrinsic,
           "consistent": oracle.consistent}  # fmt: skip
Array = np.ndarray


@functools.cache
def model(name: str) -> rs.Model:
    return rs.compile_scene(reference.build(name), minimal=False)


def moved(pose: Pose, small: Array, faster: Array) -> Pose:
    """A marker shifted, turned about world axes and sped up, to first order."""
    R = pose.R + rotations.skew(small[3:]) @ pose.R
    return Pose(pose.p + small[:3], R, pose.v + faster[:3], pose.w + faster[3:])


def tangents(name: str, poses: list[Pose], connector: dict) -> list[Array]:
    """Minus the derivatives of the wrenches by positions and by velocities, by complex step."""
    law = ORACLES[reference.SCENES[name]["law"]]
    numbers = [np.array(connector[key]) for key in ("stiffness", "damping", "offset")]

    def wrenches(small: Array, faster: Array) -> Array:
        ends = [moved(pose, small[k : k + 6], faster[k : k + 6])
                for pose, k in zip(poses, (0, 6), strict=True)]  # fmt: skip
        r = law(*ends, *numbers)
        return np.concatenate([r.force0, r.torque0, r.force1, r.torque1])

    still, h = np.zeros(12), 1e-30
    steps = 1j * h * np.eye(12)
    return [-np.array([wrenches(step, still).imag / h for step in steps]).T,
            -np.array([wrenches(still, step).imag / h for step in steps]).T]  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_tangents_are_the_derivatives_of_the_wrenches(name: str) -> None:
    scene = reference.SCENES[name]
    rng = np.random.default_rng(7)
    for _ in range(3):
        state = scenes.start_state(scene) + 0.3 * rng.normal(size=(len(scene["bodies"]), 13))
        for i, connector in enumerate(scene["connectors"]):
            poses = [marker_pose(state, connector, end) for end in (0, 1)]
            expected = tangents(name, poses, connector)
            for key, exact in zip(("stiffness", "damping"), expected, strict=True):
                function = model(name).function(f"c{i}.tangent_{key}")
                found = np.array(function(0, state.reshape(-1), [], [], [])).reshape(12, 12)
                scale = 1e-300 + np.abs(exact).max()
                assert np.abs(found - exact).max() < 1e-12 * scale


@pytest.mark.parametrize("name", ["pair", "pair_intrinsic", "pair_consistent"])
def test_moving_both_markers_together_only_turns_the_wrenches(name: str) -> None:
    """At rest every law is frame-indifferent: -K (translation) = 0, -K (turn e) = e x wrench."""
    connector = reference.SCENES[name]["connectors"][0]
    x = scenes.start_state(reference.SCENES[name])
    x[1, :7] += 0.2 * np.random.default_rng(8).normal(size=7)
    x[:, 7:] = 0.0
    poses, x = [marker_pose(x, connector, end) for end in (0, 1)], x.reshape(-1)
    K = np.array(model(name).function("c0.tangent_stiffness")(0, x, [], [], [])).reshape(12, 12)
    wrench = [np.array(model(name).function(f"c0.{key}")(0, x, [], [], [])).reshape(3)
              for key in ("force0", "torque0", "force1", "torque1")]  # fmt: skip
    for e in np.eye(3):
        shift = np.concatenate([e, np.zeros(3), e, np.zeros(3)])
        assert np.abs(K @ shift).max() < 1e-12 * np.abs(K).max()
        turn = np.concatenate([part for pose in poses for part in (np.cross(e, pose.p), e)])
        expected = np.concatenate([np.cross(e, part) for part in wrench])
        assert np.abs(-K @ turn - expected).max() < 1e-12 * np.abs(K).max()


def test_tangents_along_a_trajectory_and_only_on_request() -> None:
    small = rs.compile_scene(reference.build("single"))
    assert not [label for label in small.dae.out_labels if "tangent" in label.name]
    trajectory = rs.simulate(small, 0.1)
    assert trajectory["c0.tangent_stiffness"].shape == (201, 12, 12)
    np.testing.assert_allclose(
        np.diag(trajectory["c0.tangent_damping"][0])[:6], (40, 50, 70, 2.5, 5, 3.25)
    )
