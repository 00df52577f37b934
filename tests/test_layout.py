"""The kernels layout: the same numbers as flat code, exact derivatives, code that does not grow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
import reference_scenes
from test_minimal import chain

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file
from rbsd_sym.model.assembly import _Term, scatter_add

MODELS = Path(__file__).parents[1] / "models"


def massless() -> rs.Scene:
    """A body without inertia between two springs, the second damped."""
    a = rs.RigidBody("a", 0, 0, position=(1, 0, 0))
    b = rs.RigidBody("b", 2, (0.1, 0.2, 0.3), position=(2, 0, 0))
    joints = [
        rs.RigidBodySpringDamper("j", rs.Marker(rs.GROUND), rs.Marker("a", (-1, 0, 0)), [100] * 6),
        rs.RigidBodySpringDamper("k", rs.Marker("a"), rs.Marker("b", (-1, 0, 0)), [100] * 6,
                                 law=rs.Consistent()),
    ]  # fmt: skip
    return rs.Scene("massless", [a, b], joints, gravity=(0, 1, -2))


def star(n: int) -> rs.Scene:
    """A hub that carries n bodies on stiffness of their own, some of them Params."""
    hub = rs.RigidBody("hub", 5, (1, 1.2, 1.5), angular_velocity=(0, 0, 1))
    k = rs.Param("k", 300.0, "N/m")
    bodies = [
        rs.RigidBody(f"b{i}", 1 + i / 10, (0.1, 0.1, 0.2), position=(np.cos(i), np.sin(i), 0.3))
        for i in range(n)
    ]
    arms = [
        rs.RigidBodySpringDamper(
            f"c{i}", rs.Marker("hub", b.position), rs.Marker(b.name),
            [k if i % 3 == 0 else 100 + i, 100, 100, 10, 10, 10], [1] * 6, law=rs.Intrinsic(),
        )
        for i, b in enumerate(bodies)
    ]  # fmt: skip
    pull = rs.Load("pull", rs.Marker("hub", (0.1, 0, 0)), (rs.Input("F", "N"), 0, np.sin(rs.TIME)))
    return rs.Scene("star", [hub, *bodies], arms, [pull], gravity=(0, 0, -9.81))


SCENES: dict[str, Any] = {
    "chain4": lambda: (reference_scenes.build("chain4"), {}),
    "planar chain": lambda: (chain(5, rs.Consistent()), {}),
    "full chain": lambda: (chain(3, rs.Standard()), {"minimal": False}),
    "angles": lambda: (chain(3, rs.Consistent(), 0.1), {"formulation": rs.TaitBryan()}),
    "engine": lambda: (load_model_file(MODELS / "engine_mounts.py").scene(), {}),
    "user force": lambda: (load_model_file(MODELS / "user_force.py").scene(), {}),
    "massless": lambda: (massless(), {}),
    "star": lambda: (star(9), {}),
}


def both(name: str) -> tuple[rs.Model, rs.Model]:
    """The flat model and the one of kernels."""
    scene, options = SCENES[name]()
    flat, kernels = (rs.compile_scene(scene, **options, layout=v) for v in ("flat", "kernels"))
    assert (flat.kernels, kernels.kernels) == (False, True)
    return flat, kernels


def points(model: rs.Model, count: int = 3) -> list[list[Any]]:
    """Random arguments (t, x, z, u, p) near the start."""
    rng = np.random.default_rng(0)
    p = np.array([label.start for label in model.dae.p_labels])
    x, z = model.dae.start_values(p)
    return [
        [rng.standard_normal(), *(v + 0.1 * rng.standard_normal(v.size) for v in
                                  (x, z, np.zeros(model.n_u), p))]
        for _ in range(count)
    ]  # fmt: skip


def close(a: Any, b: Any, tolerance: float = 1e-12) -> None:
    a, b = (np.array(ca.densify(ca.DM(v))) for v in (a, b))
    assert a.shape == b.shape
    assert np.abs(a - b).max(initial=0.0) <= tolerance * (1 + np.abs(a).max(initial=0.0))


@pytest.mark.parametrize("name", SCENES)
def test_both_layouts_give_the_same_numbers(name: str) -> None:
    flat, kernels = both(name)
    jacobians = [f"d{f}_d{v}" for f in ("ode", "alg", "out") for v in "txzup"]
    for key in ("ode", "alg", "out", *jacobians):
        for point in points(flat):
            close(flat.function(key)(*point), kernels.function(key)(*point))


@pytest.mark.parametrize("f", ["ode", "alg", "out"])
@pytest.mark.parametrize("name", SCENES)
def test_directional_and_second_derivatives(name: str, f: str) -> None:
    flat, kernels = both(name)
    t, *parts = flat.symbols
    w, value = ca.vertcat(*parts), getattr(flat.dae, f)
    rng = np.random.default_rng(1)
    multiplier, direction = rng.standard_normal(value.numel()), rng.standard_normal(w.numel())
    jacobian = ca.Function("J", [t, *parts], [ca.jacobian(value, w)])
    second = ca.Function("H", [t, *parts], [ca.hessian(ca.dot(multiplier, value), w)[0]])
    for point in points(flat, 2):
        J, H = (np.array(ca.densify(g(*point))) for g in (jacobian, second))
        close(kernels.function(f"{f}_forward")(*point, direction), J @ direction[:, None])
        close(kernels.function(f"{f}_adjoint")(*point, multiplier), J.T @ multiplier[:, None])
        close(kernels.function(f"{f}_hessian")(*point, multiplier), H, 1e-11)


def test_jacobian_is_not_denser_than_what_it_holds() -> None:
    flat, kernels = both("chain4")
    ours, theirs = (m.function("dode_dx").nnz_out(0) for m in (kernels, flat))
    assert ours == theirs


@pytest.mark.parametrize("integrator", [rs.Idas(1e-9, 1e-11), rs.Rosenbrock(1e-9, 1e-11)],
                         ids=lambda v: type(v).__name__)
def test_simulation_is_the_same(integrator: Any) -> None:
    for name in ("massless", "star", "planar chain"):
        flat, kernels = both(name)
        inputs = {"F": lambda t: 3 * np.cos(t)} if flat.n_u else {}
        a, b = (rs.simulate(m, 0.2, integrator, inputs=inputs) for m in (flat, kernels))
        for label in flat.x_labels:
            close(a[label.name], b[label.name], 1e-7)


def test_inputs_of_all_kinds_reach_the_kernels() -> None:
    _, kernels = both("star")
    times = np.linspace(0, 0.2, 5)
    signals = [lambda t: 2.0 + 3 * t, lambda t: 2.0 + 3 * float(t), (times, 2.0 + 3 * times)]
    runs = [rs.simulate(kernels, times, rs.Idas(1e-9, 1e-11), inputs={"F": s}) for s in signals]
    for run in runs[1:]:
        close(runs[0]["hub.position"], run["hub.position"], 1e-8)


def test_scatter_adds_every_value_once() -> None:
    """Random places, some of them many times, some never; also places outside."""
    rng = np.random.default_rng(2)
    for size in (1, 5, 40):
        places = rng.integers(-1, size, (3, 17))
        values = rng.standard_normal((3, 17))
        expected = np.zeros(size)
        np.add.at(expected, places[places >= 0], values[places >= 0])
        stack = ca.MX.sym("v", 3, 17)
        function = ca.Function("s", [stack], [scatter_add([_Term(stack, places)], size)])
        close(function(values), expected[:, None])
    assert scatter_add([], 3).is_zero()


def test_layout_is_chosen_by_size_and_named_wrongly_refused() -> None:
    assert not rs.compile_scene(chain(3, rs.Consistent())).kernels
    assert rs.compile_scene(chain(40, rs.Consistent(), 0.1)).kernels
    with pytest.raises(ValueError, match=r"layout 'dense'.*auto, flat, kernels"):
        rs.compile_scene(chain(1, rs.Consistent()), layout="dense")


def test_code_hardly_grows_with_the_scene(tmp_path: Path) -> None:
    """Four times the bodies: the kernels stay, only index arrays and constants grow."""
    lines = []
    for n in (40, 160):
        model = rs.compile_scene(chain(n, rs.Consistent(), 0.1), layout="kernels")
        folder = rs.export_c(model, tmp_path / f"c{n}", ["ode"]).folder
        lines.append((folder / "chain.c").read_text().count("\n"))
    assert lines[1] < 1.3 * lines[0]
