"""Columns of a trajectory evaluated together."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from paths import MODELS

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file


@pytest.mark.parametrize("minimal", [True, False])
def test_together_they_are_what_they_are_one_by_one(minimal: bool) -> None:
    """Outputs, states that were left out, parameters of outputs alone, and columns known before."""
    scene = load_model_file(MODELS / "mini.py").scene()
    model = rs.compile_scene(scene, minimal=minimal)
    one, many = (rs.simulate(model, [0, 0.05, 0.1], rs.Idas(1e-8, 1e-10)) for _ in range(2))
    names = [*model.dae.outputs, *model.left_out[:3], model.x_labels[0].name]
    assert bool(model.left_out) == minimal
    many.evaluate(names)
    many.evaluate(names)  # which is nothing new
    for name in names:
        assert name in many.columns
        apart, together = one.column(name), many.column(name)
        assert (apart.unit, apart.components) == (together.unit, together.components)
        np.testing.assert_allclose(together.values, apart.values, rtol=1e-13, atol=1e-300)


def test_unknown_columns_are_refused_and_nothing_is_kept(tmp_path: Path) -> None:
    model = rs.compile_scene(load_model_file(MODELS / "mini.py").scene())
    found = rs.simulate(model, 0.1)
    before = set(found.columns)
    names = [*list(model.dae.outputs)[:2], "no such thing"]
    with pytest.raises(ValueError, match="no such thing"):
        found.evaluate(names)
    assert set(found.columns) == before
    loaded = rs.Trajectory.load(found.save(tmp_path / "run"))
    with pytest.raises(ValueError, match=f"no column '{names[0]}'; it holds"):
        loaded.evaluate(names)
