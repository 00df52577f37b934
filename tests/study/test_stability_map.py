"""Multipliers of periodic motion, stability maps, their chart, the page of Kapitza, the command."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from oracles import mathieu
from paths import MODELS
from scenes.small import GROUND, column

import rbsd_sym as rs
from models import atlas
from models.atlas import kapitza
from rbsd_sym.__main__ import main
from rbsd_sym.analysis.floquet import NODES, NotPeriodic, floquet, monodromy


def hinged_column(length: float = 0.5) -> rs.Scene:
    """An upright bar on a weak hinge, whose stiffness and damping are Params."""
    d = rs.Param("damping", 0.1, "N m s/rad")
    return column(rs.Param("stiffness", 1.0, "N m/rad"), [10, 10, 10, d, d, 0.1], length)


def make(point: dict) -> rs.Model:
    """The column of another length, which is not a Param."""
    return rs.compile_scene(hinged_column(point["length"]))


def exponent_of(k: float, d: float, length: float = 0.5) -> float:
    """Largest root of (J + m l^2) s^2 + d s + k - m g l on a rigid hinge."""
    inertia, stiffness = 0.08 + length**2, k - 9.81 * length
    return float(np.roots([inertia, d, stiffness]).real.max())


@pytest.mark.parametrize("steps", [16, 32, 64])
def test_monodromy_of_a_mathieu_equation(steps: int) -> None:
    """Against Gauss' method; the error falls with the sixth power of the step."""
    A, period = mathieu.pendulum(0.2, 10.0, 2 / 3, 0.06), 0.1
    exact = mathieu.monodromy(A, period, 1600)
    t = (np.arange(steps)[:, None] + NODES).reshape(-1) * period / steps
    M, told = monodromy(np.array([A(time) for time in t]), period)
    scale = np.array([[1, 10], [0.1, 1]])  # rad and rad/s
    error = np.abs((M - exact) * scale).max()
    assert error < 0.5 * (8 / steps) ** 6
    assert error < np.abs(told * scale).max() or error < 1e-9


def test_constant_equations_are_exact_however_stiff() -> None:
    """A rotation at 1e6 rad/s over a second in one interval: what is left is rounding."""
    w = 1e6
    A = np.array([[0.0, 1.0], [-w * w, 0.0]])
    M, told = monodromy(np.array([A, A, A]), 1.0)
    angle = w * np.finfo(float).eps * 64
    assert abs(M[0, 0] - math.cos(w)) < angle
    assert not told.any()
    values = np.abs(np.linalg.eigvals(M * np.array([[1, w], [1 / w, 1]])))
    np.testing.assert_allclose(values, 1, atol=angle)


def test_a_vibrated_pendulum_has_the_exponents_of_mathieus_equation() -> None:
    """Left out of the minimal model; the give of the hinge is 1 / 900 of the amplitude."""
    model = rs.compile_scene(kapitza.scene())
    assert {label.name for label in model.x_labels} == {"body.p_z", "body.v_z"}
    for frequency, amplitude in ((20.0, 0.02), (10.0, 0.1), (20.0, 0.35)):
        found = floquet(model, 1 / frequency,
                        params={"frequency": frequency, "amplitude": amplitude})  # fmt: skip
        rest = kapitza.DAMPING / kapitza.INERTIA
        lifted = amplitude * (1 + 1 / 900)
        A = mathieu.pendulum(lifted, frequency, kapitza.REDUCED, rest)
        expected = mathieu.exponent(A, 1 / frequency)
        assert found.abscissa == pytest.approx(expected, rel=2e-3)
        assert found.stable is (expected < 0)
        assert np.log(np.abs(found.kept.values)).max() < 0, "its own motion decays"


def test_the_full_model_has_the_multipliers_of_both_sets() -> None:
    params = {"frequency": 20.0, "amplitude": 0.02}
    small, full = (
        floquet(rs.compile_scene(kapitza.scene(), minimal=minimal), 0.05, params=params,
                accuracy=1e-3)
        for minimal in (True, False)
    )
    assert len(full.left_out.values) == 0
    assert len(full.kept.values) == 12
    assert len(small.kept.values) + len(small.left_out.values) == 12
    assert full.abscissa == pytest.approx(small.abscissa, rel=1e-5)


def test_a_top_sleeps_when_it_spins_fast_enough() -> None:
    """An upright top on a ball joint: it sleeps from (C w)^2 = 4 A m g l on [Landau, sec. 35]."""
    A, C, weight = 0.08 + 0.25, 0.02, 9.81 * 0.5
    bar = rs.RigidBody("bar", 1.0, (0.08, 0.08, C), position=(0, 0, 0.5))
    ball = rs.RigidBodySpringDamper(
        "ball", GROUND, rs.Marker("bar", (0, 0, -0.5)), [1e6] * 3 + [0] * 3
    )
    scene = rs.Scene("top", [bar], [ball], gravity=(0, 0, -9.81))
    model, critical = rs.compile_scene(scene, minimal=False), 2 * math.sqrt(A * weight) / C
    start = {"bar.p_z": 0.5 - 9.81e-6}
    for factor in (0.97, 1.03):
        w = factor * critical
        found = floquet(model, 2 * math.pi / w, start={**start, "bar.w_z": w})
        # Nutation and precession, in axes at rest: A s^2 - i C w s - m g l = 0.
        roots = np.roots([A, -1j * C * w, -weight])
        assert found.abscissa == pytest.approx(max(roots.real.max(), 0), rel=5e-3, abs=1e-3)
        assert found.stable is (factor > 1)


def test_newtons_method_finds_the_periodic_motion() -> None:
    """A damped oscillator, driven off resonance: amplitude and phase of the textbook."""
    k, d, w, F = 500.0, 5.0, 15.0, 3.0
    body = rs.RigidBody("b", 1, (1, 1, 1))
    spring = rs.RigidBodySpringDamper("s", GROUND, rs.Marker("b"), [k] * 6, [d] * 6)
    load = rs.Load("l", rs.Marker("b"), (0, rs.Input("pull", "N"), 0))
    model = rs.compile_scene(rs.Scene("driven", [body], [spring], [load]))
    found = floquet(
        model, 2 * math.pi / w, start={"b.p_y": 0.3}, inputs={"pull": lambda t: F * np.sin(w * t)}
    )
    response = F / (k - w * w + 1j * w * d)
    assert found.start["b.p_y"] == pytest.approx(response.imag, abs=1e-9)
    assert found.start["b.v_y"] == pytest.approx(w * response.real, abs=1e-8)
    assert found.abscissa == pytest.approx(-d / 2, rel=1e-6)
    with pytest.raises(NotPeriodic, match=r"a period of 1 s later .* other rates"):
        floquet(model, 1.0, start={"b.p_y": 0.3}, inputs={"pull": lambda t: F * t})


def test_a_motion_that_does_not_come_back_is_told() -> None:
    """A body that falls; and one pushed along, which only drifts."""
    body = rs.RigidBody("b", 1.0, (1, 1, 1))
    model = rs.compile_scene(rs.Scene("falling", [body], [], gravity=(0, 0, -9.81)))
    with pytest.raises(NotPeriodic, match=r"no motion of period 0\.5 s.*off by -4\.9.* m/s"):
        floquet(model, 0.5)


def test_bad_calls_of_floquet() -> None:
    model = rs.compile_scene(hinged_column())
    with pytest.raises(ValueError, match=r"period -1 s; give a positive"):
        floquet(model, -1)
    ball = rs.RigidBody("b", 1.0, (1, 1, 1), position=(0, 0, 1))
    floor = rs.RigidBodySpringDamper(
        "floor", GROUND, rs.Marker("b"), 0, effects=[rs.Impact(2, restitution=1.0)]
    )
    bounces = rs.compile_scene(rs.Scene("ball", [ball], [floor], gravity=(0, 0, -9.81)))
    with pytest.raises(ValueError, match="has events"):
        floquet(bounces, 1.0)


def test_a_map_of_the_column_has_its_buckling_boundary() -> None:
    model = rs.compile_scene(hinged_column())
    stiffness, damping = [1.0, 4.0, 5.0, 9.0], [0.1, 1.0]
    table = rs.study.stability_map(model, {"stiffness": stiffness}, {"damping": damping})
    assert table.units[:4] == ("N m/rad", "N m s/rad", "1/s", "1/s")
    assert len(table.rows) == 8
    for i, k in enumerate(table.column("stiffness")):
        d = table.column("damping")[i]
        expected = exponent_of(k, d)
        assert table.column("abscissa")[i] == pytest.approx(expected, rel=1e-3)
        assert table.column("stable")[i] == (k > 9.81 * 0.5)
        assert table.column("kept")[i] < 0, "the model itself sees nothing of it"
        assert table.column("left_out")[i] == table.column("abscissa")[i]
        assert table.column("error")[i] is None


def test_a_map_over_a_setting_makes_models() -> None:
    made = []

    def counted(point: dict) -> rs.Model:
        made.append(point["length"])
        return make(point)

    table = rs.study.stability_map(
        counted, {"length": [0.3, 0.5]}, {"stiffness": [2.0, 4.0]}, units={"length": "m"}
    )
    assert made == [0.3, 0.5], "once for each length, stiffness is a Param"
    assert table.units[:2] == ("m", "N m/rad")
    for length, k, rate in zip(*(table.column(c) for c in ("length", "stiffness", "abscissa")),
                               strict=True):  # fmt: skip
        assert rate == pytest.approx(exponent_of(k, 0.1, length), rel=2e-3)


def test_points_that_fail_are_rows_with_a_reason() -> None:
    def sometimes(point: dict) -> rs.Model:
        if point["length"] > 1:
            raise ValueError("too long")
        body = rs.RigidBody("b", 1.0, (1, 1, 1))
        return rs.compile_scene(rs.Scene("free", [body], [], gravity=(0, 0, -9.81)))

    table = rs.study.stability_map(sometimes, {"length": [0.5, 2.0]}, {"y": [1.0, 2.0]})
    reasons = table.column("error").tolist()
    assert reasons[1] == "ValueError: too long"
    assert "EquilibriumError" in reasons[0]
    assert "add stiffness there" in reasons[0]
    assert np.isnan(np.array(table.column("abscissa"), float)).all()
    assert set(table.column("stable").tolist()) == {None}
    figure = rs.plots.stability_map(table)
    assert [t.get_text() for t in figure.legends[0].get_texts()] == ["failed"]


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        (({"k": [1]}, {"damping": [1]}), r"'k' is not a Param or Input.*stiffness.*make\(point\)"),
        (({"damping": [1]}, {"damping": [1]}), "both axes are 'damping'"),
        (({}, {"damping": [1]}), "x_axis {}; give one name with finite values"),
        (({"stiffness": []}, {"damping": [1]}), "give one name with finite values"),
        (({"stiffness": [1]}, {"damping": ["a"]}), "y_axis.*give one name"),
    ],
)
def test_bad_axes_are_refused(axes: tuple, message: str) -> None:
    model = rs.compile_scene(hinged_column())
    with pytest.raises(ValueError, match=message):
        rs.study.stability_map(model, *axes)


def test_what_makes_no_models_is_refused() -> None:
    with pytest.raises(TypeError, match="give a model, or make"):
        rs.study.stability_map("column", {"a": [1]}, {"b": [1]})  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="gave a Scene; return a model"):
        rs.study.stability_map(lambda point: hinged_column(), {"a": [1]}, {"b": [1]})  # type: ignore[arg-type]


def test_the_chart_shows_the_boundary_and_units() -> None:
    stiffness, damping = np.linspace(1, 9, 17), [0.1, 1.0]
    model = rs.compile_scene(hinged_column())
    table = rs.study.stability_map(
        model, {"stiffness": list(stiffness)}, {"damping": list(damping)}
    )
    figure = rs.plots.stability_map(table, "column")
    panel = figure.axes[0]
    assert panel.get_xlabel() == "stiffness [N m/rad]"
    assert figure.axes[1].get_ylabel() == "largest growth rate [1/s]"
    lines = [line for c in panel.collections for path in c.get_paths() if hasattr(c, "levels")
             for line in path.to_polygons(closed_only=False)]  # fmt: skip
    boundary = np.concatenate(lines)
    assert np.abs(boundary[:, 0] - 9.81 * 0.5).max() < 0.5, "a cell wide"
    with pytest.raises(ValueError, match="one value on an axis"):
        rs.plots.stability_map(
            rs.study.stability_map(make, {"length": [0.5]}, {"stiffness": [1.0, 2.0]})
        )
    with pytest.raises(ValueError, match=r"give the table of study\.stability_map"):
        rs.plots.stability_map(rs.study.Table(("a", "b"), ("", ""), ()))


def test_hills_determinants_agree_with_gauss_method() -> None:
    """The theory that the page draws against the oracle, for both boundaries."""
    for frequency in (6.0, 20.0):
        low, high = kapitza.theory(frequency)
        damping = kapitza.DAMPING / kapitza.INERTIA

        def grows(amplitude: float, f: float = frequency, d: float = damping) -> bool:
            A = mathieu.pendulum(amplitude, f, kapitza.REDUCED, d)
            return mathieu.exponent(A, 1 / f, 80) > 0

        assert mathieu.boundary(grows, 0.9 * low, 1.1 * low) == pytest.approx(low, rel=1e-5)
        assert mathieu.boundary(grows, 0.9 * high, 1.1 * high) == pytest.approx(high, rel=1e-5)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict, Path]:
    """The page in its short form."""
    folder = tmp_path_factory.mktemp("atlas")
    found = next(p for p in atlas.pages() if p.number == 13)
    return dict(atlas.make(found, folder, full=False)), folder


def test_the_page_tells_where_eigenvalues_at_rest_fail(page: tuple[dict, Path]) -> None:
    tables, folder = page
    # The stated accuracy of the boundary: 0.1 %.
    for row in tables["boundary"].rows:
        assert row[1] == pytest.approx(row[2], rel=1e-3)
        assert row[3] == pytest.approx(row[4], rel=1e-3)
    map_ = tables["map"]
    for f, a, stable in zip(*(map_.column(c) for c in ("frequency", "amplitude", "stable")),
                            strict=True):  # fmt: skip
        low, high = kapitza.theory(float(f))
        if min(abs(a / low - 1), abs(a / high - 1)) > 2e-3:
            assert stable == (low < a < high)
    runs = tables["runs"]
    fall = math.sqrt(9.81 / kapitza.REDUCED)
    assert np.abs(runs.column("at_rest") - fall).max() < 0.03 * fall, "the same at every point"
    assert (runs.column("own_motion") < -100).all(), "the smallest model sees no growth"
    assert runs.column("left_out")[1] == pytest.approx(-0.03, rel=1e-2)
    for i in (0, 2):
        assert runs.column("simulated")[i] == pytest.approx(runs.column("left_out")[i], rel=0.05)
    assert runs.column("largest_tilt")[1] < 0.2
    assert runs.column("largest_tilt")[[0, 2]].min() > 30
    assert (folder / "13_kapitza.png").stat().st_size > 10_000


def model_file(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "model.py"
    path.write_text(text)
    return path


def test_the_command_prints_rest_and_eigenvalues(capsys: pytest.CaptureFixture) -> None:
    assert main(["stability", str(MODELS / "engine_mounts.py")]) == 0
    said = capsys.readouterr().out
    assert "equilibrium found in" in said
    assert "engine.p_z = " in said
    assert "damping ratio" in said
    assert "stable, largest real part" in said


def test_the_command_draws_the_map_of_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    text = (MODELS / "kapitza.py").read_text()
    text += 'STABILITY |= {"x": {"frequency": [10, 20]}, "y": {"amplitude": [0.02, 0.1]}}\n'
    path = model_file(tmp_path, text)
    assert main(["stability", str(path), "--folder", str(tmp_path)]) == 0
    assert "2 of 4 points are stable, 0 failed" in capsys.readouterr().out
    for suffix in (".png", ".md", ".csv"):
        assert (tmp_path / "charts" / f"kapitza_stability{suffix}").stat().st_size > 100
    assert "| frequency [Hz] |" in (tmp_path / "charts" / "kapitza_stability.md").read_text()


def test_mistakes_in_the_command_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    assert main(["stability"]) == 1
    assert "give one, or --all" in capsys.readouterr().err
    assert main(["stability", "--page", "99"]) == 1
    assert "no such page; there are:" in capsys.readouterr().err
    text = (MODELS / "mini.py").read_text() + '\nSTABILITY = {"x": {"a": [1, 2]}}\n'
    assert main(["stability", str(model_file(tmp_path, text))]) == 1
    assert "STABILITY has no 'y'" in capsys.readouterr().err


def test_a_page_that_fails_does_not_lose_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "models" / "atlas"
    folder.mkdir(parents=True)
    for name in ("__init__.py", "pages.py"):
        shutil.copy(MODELS / "atlas" / name, folder)
    page = """'''{title}.'''
import rbsd_sym as rs
from matplotlib.figure import Figure
NUMBER = {number}
def study(full):
    {line}
    return {{"one": rs.study.Table(("a",), ("m",), ((1.0,),))}}
def draw(tables):
    return Figure()
"""
    bad, good = 'raise RuntimeError("no luck")', "pass"
    (folder / "bad.py").write_text(page.format(title="Bad", number=1, line=bad))
    (folder / "good.py").write_text(page.format(title="Good", number=2, line=good))
    monkeypatch.chdir(tmp_path)
    assert main(["stability", "--all", "--short", "--folder", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert "wrote 1 of 2 pages" in said.out
    assert "1 (RuntimeError: no luck)" in said.err
    assert (tmp_path / "charts" / "atlas" / "02_good.png").exists()


def test_the_atlas_is_named_where_it_is_not(
    tmp_path: Path, capsys: pytest.CaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["stability", "--all"]) == 1
    assert "part of the repository, not of the installed package" in capsys.readouterr().err
