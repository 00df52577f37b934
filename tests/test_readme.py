"""Every block of the README and of the guide runs, and so does every file in models/."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from paths import CHARTS, MODELS, ROOT, TESTS

import rbsd_sym as rs
from rbsd_sym import __main__ as command_line
from rbsd_sym.analysis.linearize import Linear

README, GUIDE = ROOT / "README.md", MODELS / "README.md"
FILES = sorted(MODELS.glob("*.py"))
PAGES = [README, GUIDE, *sorted((ROOT / "rbsd_sym").rglob("README.md")), TESTS / "README.md",
         *sorted(CHARTS.rglob("*.md"))]  # fmt: skip


def blocks(file: Path, language: str) -> list[str]:
    """Code blocks of a page in a language."""
    return re.findall(rf"```{language}\n(.*?)```", file.read_text(encoding="utf-8"), re.S)


def test_pages_keep_their_sizes() -> None:
    assert README.stat().st_size <= 10_000
    assert (ROOT / "rbsd_sym" / "README.md").stat().st_size <= 5_000
    for room in ("ocp", "integrators", "exports", "minimal"):
        page = ROOT / "rbsd_sym" / room / "README.md"
        assert page.read_text(encoding="utf-8").count("\n") <= 60, page


def test_links_of_the_pages_lead_somewhere() -> None:
    for page in [*PAGES, ROOT / "generated" / "gallery" / "README.md"]:
        for link in re.findall(r"(?<!\")\]\(([^)#]+)", page.read_text(encoding="utf-8")):
            assert (page.parent / link).exists(), f"{page}: {link}"


def test_python_and_c_blocks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {}
    scene, compiled, _ = blocks(README, "python")
    (script,) = (b for b in blocks(GUIDE, "python") if "__main__" in b)
    exec(compile(scene, "README.md", "exec"), namespace)
    trajectory = namespace["trajectory"]
    assert isinstance(trajectory, rs.Trajectory)
    assert trajectory.outcome is rs.Outcome.reached_end
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    exec(compile(compiled, "README.md", "exec"), namespace)
    (tmp_path / "script.py").write_text(script)
    environment = {**os.environ, "PYTHONPATH": str(Path(rs.__file__).parents[1])}
    table = subprocess.run([sys.executable, "script.py"], capture_output=True, text=True,
                           check=True, env=environment).stdout  # fmt: skip
    assert table.count("\n") == 4, table
    assert "Error" not in table
    include, body = blocks(README, "c")[0].split("\n", 1)
    program = (
        f"#include <stdio.h>\n{include}\nint main(void) {{\n{body}\n"
        '  printf("%.17g", rates[SWING_X_ARM_V_Y]);\n  return 0;\n}\n'
    )
    folder = tmp_path / "generated" / "swing"
    (folder / "main.c").write_text(program)
    build = ["cc", "-std=c99", "main.c", "swing.c", "-lm", "-o", "main"]
    subprocess.run(build, cwd=folder, check=True)
    printed = subprocess.run(["./main"], cwd=folder, capture_output=True, text=True, check=True)
    model = namespace["model"]
    assert isinstance(model, rs.Model)
    x = [label.start for label in model.x_labels]
    expected = model.function("ode")(0, x, [], [5.0], [2e4])
    row = [label.name for label in model.x_labels].index("arm.v_y")
    # At the start the arm hangs straight, so only the push of 5 N on 2 kg moves it sideways.
    assert float(printed.stdout) == pytest.approx(float(expected[row]), rel=1e-15)
    assert float(printed.stdout) == pytest.approx(2.5, rel=1e-12)


def test_block_with_events(capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, object] = {}
    exec(compile(blocks(GUIDE, "python")[0], "guide", "exec"), namespace)
    *events, last = capsys.readouterr().out.splitlines()
    assert events[0].endswith("s floor.friction_x_moves")
    assert events[1].endswith("s floor.contact_z_closes")
    mode, place = (float(word) for word in last.split())
    assert mode == 0  # it has come to rest, near v^2 / (2 mu g)
    assert place == pytest.approx(4 / (2 * 0.3 * 9.81), rel=0.06)


def test_block_about_stability(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    scene, *_ = blocks(README, "python")
    *_, linear = blocks(GUIDE, "python")
    namespace: dict[str, object] = {}
    exec(compile(scene.split("jacobian =")[0] + linear, "README.md", "exec"), namespace)
    found, gradient = namespace["linear"], namespace["gradient"]
    assert isinstance(found, Linear)
    assert found.stable
    # The damper along x: 20 N s/m on 2 kg.
    assert np.abs(found.eigenvalues.real + 5).min() < 1e-4
    model, step = namespace["model"], 1.0
    assert isinstance(model, rs.Model)
    runs = [rs.simulate(model, 1.0, rs.Idas(1e-12, 1e-14), params={"k": 2e4 + s})
            for s in (-step, step)]  # fmt: skip
    difference = (runs[1]["arm.position"][-1] - runs[0]["arm.position"][-1]) / (2 * step)
    np.testing.assert_allclose(gradient["arm.position"][:, 0], difference, atol=1e-11)
    assert (tmp_path / "map.png").stat().st_size > 1e4


def test_block_about_optimal_control(capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, object] = {}
    (block,) = (b for b in blocks(README, "python") if "ocp" in b)
    exec(compile(block, "README.md", "exec"), namespace)
    found = namespace["solution"]
    assert isinstance(found, rs.ocp.Solution)
    assert found.outcome is rs.ocp.Outcome.optimal
    assert found.flown is not None
    assert found.flown.difference < 1e-5
    assert np.abs(found.trajectory["cart.position"][-1]).max() < 1e-8
    assert 0.2 < found.params["k"] < 40
    assert "flown by IDAS" in capsys.readouterr().out


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_models_run_and_export(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = ["--folder", str(tmp_path)]
    assert command_line.main(["info", str(path)]) == 0
    assert "states kept" in capsys.readouterr().out
    assert command_line.main(["run", str(path), *folder]) == 0
    assert "reached the end" in capsys.readouterr().out
    assert command_line.main(["export", str(path), *folder]) == 0
    saved = rs.Trajectory.load(next(tmp_path.glob("*/*.npz")))
    assert saved.outcome is rs.Outcome.reached_end
    for suffix in ("png", "h", "c"):
        assert list(tmp_path.glob(f"*/*.{suffix}")), suffix


@pytest.mark.parametrize(
    ("law", "ratio", "within"),
    [(rs.Standard(), 1.46, 5e-3), (rs.Intrinsic(), 0.990, 5e-4), (rs.Consistent(), 1.0, 1e-6)],
    ids=lambda value: type(value).__name__,
)
def test_pair_makes_the_energy_its_law_makes(law: object, ratio: float, within: float) -> None:
    """E/E0 after 1 s, from converged runs, rounded as printed."""
    scene = command_line.load_model_file(MODELS / "pair.py").scene(law)
    energy = rs.simulate(rs.compile_scene(scene), 1.0)["energy"]
    assert energy[-1] / energy[0] == pytest.approx(ratio, abs=within)


def test_models_cover_what_the_guide_says() -> None:
    assert {path.stem for path in FILES} == {
        "arm", "chain", "crane", "engine_mounts", "flexible_slew", "governor", "kapitza", "mini",
        "mount_design", "pair", "post_newton_contact", "receding_horizon", "reorientation",
        "stick_slip", "user_force",
    }  # fmt: skip
    text = GUIDE.read_text(encoding="utf-8")
    assert not [path.stem for path in FILES if f"`{path.stem}`" not in text]


def test_scripts_and_tests_that_pages_name_are_there() -> None:
    named = {
        (page.relative_to(ROOT), path) for page in PAGES
        for path in re.findall(r"\btests/[\w/]*\.py", page.read_text(encoding="utf-8"))
    }  # fmt: skip
    assert len({path for _, path in named}) > 25
    assert not [(page, path) for page, path in named if not (ROOT / path).is_file()]


def test_command_line_errors_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command_line.main(["info", str(tmp_path / "none.py")]) == 1
    assert "no such file" in capsys.readouterr().err
    empty = tmp_path / "empty.py"
    empty.write_text("x = 1\n")
    assert command_line.main(["run", str(empty)]) == 1
    assert "scene()" in capsys.readouterr().err
    mini = str(MODELS / "mini.py")
    assert command_line.main(["run", mini, "--t-end", "-1"]) == 1
    assert "positive" in capsys.readouterr().err
    assert command_line.main(["run", mini, "--set", "k"]) == 1
    assert "NAME=VALUE" in capsys.readouterr().err
    assert command_line.main(["run", mini, "--columns", "body.speed"]) == 1
    assert "body.speed" in capsys.readouterr().err


def test_a_failed_run_keeps_what_it_reached(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "blow_up.py"
    source.write_text(
        "import rbsd_sym as rs\n"
        "def force(mbs, t, i, u, th, v, w, k, d, R0, R1, offset):\n"
        "    return [-u[0] ** 3 - 1000 * v[0] ** 2, 0, 0, 0, 0, 0]\n"
        "def scene():\n"
        "    b = rs.RigidBody('b', 1, (1, 1, 1), velocity=(1, 0, 0))\n"
        "    m = rs.Marker(rs.GROUND), rs.Marker('b')\n"
        "    c = rs.RigidBodySpringDamper('c', *m, 0, force=force)\n"
        "    return rs.Scene('blow_up', [b], [c])\n"
    )
    assert command_line.main(["run", str(source), "--folder", str(tmp_path)]) == 1
    assert "last saved state" in capsys.readouterr().err
    kept = rs.Trajectory.load(tmp_path / "blow_up" / "blow_up.npz")
    assert not kept.outcome.ok
    assert 0 < kept.stats["t_failed"] < 1.1e-3  # v' = 1000 v^2 from 1 m/s has its pole at 1 ms


def test_help_teaches() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "rbsd_sym", "--help"], cwd=ROOT, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert "scene()" in result.stdout
    assert "examples" in result.stdout
