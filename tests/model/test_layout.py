"""The kernels layout: the same numbers as flat code, exact derivatives, code that does not grow."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.comparing import close, points
from paths import MODELS
from scenes import reference
from scenes.small import chain, massless, star

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file
from rbsd_sym.model.assembly import _Term, scatter_add

SCENES: dict[str, Any] = {
    "chain4": lambda: (reference.build("chain4"), {}),
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
