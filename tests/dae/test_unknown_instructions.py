"""Tables and Functions that CasADi calls instead of inlining survive every pass and layout.

A body of 20 kg moves along z on a spring and a damper that only such a call describes. The oracle
is numpy: the damper in closed form, the motion by a Runge-Kutta method.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.comparing import by_name, close, points
from helpers.refusals import refused
from scenes.calls import (
    CALLBACK,
    CASES,
    CURVE,
    FORCES,
    MASS,
    SPEEDS,
    SQUARE,
    START,
    STIFFNESS,
    T_END,
    Damper,
    pair,
    piecewise,
    shock,
)

import rbsd_sym as rs
from rbsd_sym.model.model import derive

TIGHT = rs.ExplicitRK(1e-10, 1e-12)
BOTH = [(layout, minimal) for layout in ("flat", "kernels") for minimal in (True, False)]
every_model = pytest.mark.parametrize(("layout", "minimal"), BOTH)


@cache
def model_of(name: str, layout: str = "flat", minimal: bool = True) -> rs.Model:
    return rs.compile_scene(shock(CASES[name][0]), layout=layout, minimal=minimal)


@cache
def exact(name: str, steps: int = 6000) -> tuple[float, float]:
    """Travel and speed at the end, by the classical Runge-Kutta method."""
    damper, h, y = CASES[name][1], T_END / steps, np.array([START, 0.0])

    def rate(y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -(STIFFNESS * y[0] + damper(y[0], y[1])) / MASS])

    for _ in range(steps):
        a = rate(y)
        b = rate(y + h / 2 * a)
        c = rate(y + h / 2 * b)
        y = y + h / 6 * (a + 2 * b + 2 * c + rate(y + h * c))
    return float(y[0]), float(y[1])


@every_model
@pytest.mark.parametrize("name", CASES)
def test_motion(name: str, layout: str, minimal: bool) -> None:
    """The rates at random points, and the motion."""
    model = model_of(name, layout, minimal)
    place = {label.name: i for i, label in enumerate(model.x_labels)}
    z, v = place["body.p_z"], place["body.v_z"]
    x = np.array([label.start for label in model.x_labels])
    assert (model.n_x == 2) is minimal
    for x[z], x[v] in np.random.default_rng(1).uniform(-1, 1, (20, 2)):
        force = STIFFNESS * x[z] + CASES[name][1](x[z], x[v])
        rates = np.array(model.function("ode")(0, x, [], [], [])).reshape(-1)
        assert rates[v] == pytest.approx(-force / MASS, rel=1e-12)
        assert rates[z] == x[v]
    run = rs.simulate(model, T_END, TIGHT)
    found = run["body.p_z"][-1], run["body.v_z"][-1]
    np.testing.assert_allclose(found, exact(name), rtol=0, atol=1e-6)
    force = run["strut.force_local"][:, 2]
    at = [STIFFNESS * u + CASES[name][1](u, v) for u, v in zip(run["body.p_z"], run["body.v_z"],
                                                                strict=True)]  # fmt: skip
    np.testing.assert_allclose(force, at, rtol=1e-9, atol=1e-7)


METHODS = [rs.Idas(), rs.Rosenbrock(), rs.ExplicitRK(), rs.Dop853(), rs.GeneralizedAlpha(2e-4),
           rs.Collocation(2e-3, 3)]  # fmt: skip


@pytest.mark.parametrize("name", ["table", "spline of two", "MX never inlined"])
@pytest.mark.parametrize("method", METHODS, ids=by_name)
def test_methods(method: Any, name: str) -> None:
    run = rs.simulate(model_of(name, "kernels"), T_END, method)
    np.testing.assert_allclose(run["body.p_z"][-1], exact(name)[0], rtol=0, atol=2e-6)


# Two bodies in space: derivatives, and layouts beside each other.


def _differences(f: Any, x: np.ndarray) -> np.ndarray:
    """Central differences of f(x), a column each."""
    steps = 1e-6 * np.eye(len(x))
    ends = [[np.array(f(x + sign * step)).reshape(-1) for sign in (1, -1)] for step in steps]
    return np.array([(after - before) / 2e-6 for after, before in ends]).T


DIFFERENTIABLE = ["table", "table of two", "spline", "spline of two", "MX never inlined",
                  "Callback", "map"]  # fmt: skip


@pytest.mark.parametrize("layout", ["flat", "kernels"])
@pytest.mark.parametrize("name", DIFFERENTIABLE)
def test_derivatives(name: str, layout: str) -> None:
    """First ones against differences of the function, second ones against those of the gradient."""
    model = pair(CASES[name][0], layout=layout, minimal=False)
    ode, gradient = model.function("ode"), model.function("ode_adjoint")
    t, x, *rest = points(model, 1)[0]
    v, weights = np.random.default_rng(2).standard_normal((2, model.n_x))
    slope = _differences(lambda x: ode(t, x, *rest), x)
    jacobian = np.array(ca.DM(model.function("dode_dx")(t, x, *rest)))
    assert np.abs(jacobian - slope).max() < 1e-6 * np.abs(slope).max()
    close(model.function("ode_forward")(t, x, *rest, v), jacobian @ v, 1e-10)
    close(gradient(t, x, *rest, weights), jacobian.T @ weights, 1e-10)
    if name == "table of two":
        words = "model 'pair', ode_hessian: ", "mixed second derivatives of plane", "bspline"
        return refused(ValueError, lambda: model.function("ode_hessian"), *words)
    second = _differences(lambda x: gradient(t, x, *rest, weights), x)
    hessian = np.array(ca.DM(model.function("ode_hessian")(t, x, *rest, weights)))
    # CasADi takes a Callback's second derivatives from differences of differences.
    room = 1e-2 if name == "Callback" else 1e-6
    assert np.abs(hessian - second).max() < room * np.abs(second).max()


@pytest.mark.parametrize("name", CASES)
def test_layouts_agree(name: str) -> None:
    one, other = (pair(CASES[name][0], 4, layout=layout) for layout in ("flat", "kernels"))
    room = 1e-8 if name == "Callback" else 1e-12  # its derivatives are differences
    outputs = ["j0.force_local", "j2.torque_local", "energy", "j1.dissipated_power"]
    for point in points(one):
        for function in ("ode", "dode_dx", *outputs):
            close(one.function(function)(*point), other.function(function)(*point), room)


def test_tables_of_one_name_stay_apart() -> None:
    """Instances of a kernel, digests and proofs tell callees by their content."""
    def scene(*factors: float) -> rs.Scene:
        def force(mbs: Any, t: Any, item: Any, u: Any, *rest: Any) -> list[Any]:
            values = [factors[item] * f for f in FORCES]
            table = ca.interpolant("curve", "linear", [SPEEDS], values)
            return [10 * u[0], 10 * u[1], table(u[2]), 0, 0, 0]

        bodies = [rs.RigidBody(n, 1, (1, 1, 1), position=(0, 0, 0.1)) for n in ("b0", "b1")]
        ground = rs.Marker(rs.GROUND)
        return rs.Scene("twins", bodies, [
            rs.RigidBodySpringDamper(f"to_{b.name}", ground, rs.Marker(b.name), 0, force=force)
            for b in bodies
        ])  # fmt: skip

    for layout, minimal in BOTH:
        model = rs.compile_scene(scene(1, 3), layout=layout, minimal=minimal)
        x = np.array([label.start for label in model.x_labels])
        rates = np.array(model.function("ode")(0, x, [], [], [])).reshape(-1)
        names = [label.name for label in model.x_labels]
        pulled = [rates[names.index(f"b{i}.v_z")] for i in range(2)]
        np.testing.assert_allclose(pulled, [-piecewise(0.1), -3 * piecewise(0.1)], rtol=1e-13)
    digests = {rs.compile_scene(scene(*f)).digest for f in ((1, 3), (1, 3), (1, 3 + 1e-9), (3, 1))}
    assert len(digests) == 3


def test_formulas_that_differ_in_the_ninth_digit_stay_apart() -> None:
    """`str` of an expression prints six: one kernel was made for both, one digest, one library."""
    k = rs.Param("k", 1e4, "N/m")

    def scene(*factors: float) -> rs.Scene:
        bodies = [rs.RigidBody(f"b{i}", 1, (1, 1, 1), position=(0.3, 0, 0.1)) for i in range(2)]
        return rs.Scene("twins", bodies, [
            rs.RigidBodySpringDamper(f"j{i}", rs.Marker(rs.GROUND, (0.3, 0, 0)),
                                     rs.Marker(f"b{i}"), [k * f] * 3 + [1] * 3)
            for i, f in enumerate(factors)
        ])  # fmt: skip

    model = rs.compile_scene(scene(1.00000001, 1.00000004), layout="kernels", minimal=False)
    x = np.array([label.start for label in model.x_labels])
    rates = np.array(model.function("ode")(0, x, [], [], [1e4])).reshape(-1)
    names = [label.name for label in model.x_labels]
    pulled = [rates[names.index(f"b{i}.v_z")] for i in range(2)]
    np.testing.assert_allclose(pulled, [-1000.00001, -1000.00004], rtol=0, atol=1e-9)
    assert model.digest != rs.compile_scene(scene(1.00000001, 1.00000003), minimal=False).digest


@every_model
def test_params_and_inputs_go_through_calls(layout: str, minimal: bool) -> None:
    """A table returns a plain SX; the leaves in it are found by their symbols."""
    k, pull = rs.Param("k", 0.5), rs.Input("pull", "m/s")
    idle = rs.Param("idle", 1.0)
    scene = shock(lambda u, v: SQUARE(CURVE(k * v + pull) / 100) * (1 + 0 * idle.expr) * k)
    model = rs.compile_scene(scene, layout=layout, minimal=minimal)
    assert [label.name for label in (*model.dae.p_labels, *model.dae.u_labels)] == ["k", "pull"]
    x = np.array([label.start for label in model.x_labels])
    row = [label.name for label in model.x_labels].index("body.v_z")
    x[row] = 0.3
    found = float(model.function("ode")(0, x, [], [0.1], [0.8])[row])
    called = piecewise(0.8 * 0.3 + 0.1) / 100
    assert found == pytest.approx(-(STIFFNESS * START + 2500 * called**2 * 0.8) / MASS, rel=1e-12)
    slope = np.array(ca.DM(model.function("dode_dp")(0, x, [], [0.1], [0.8])))[row, 0]
    step = [float(model.function("ode")(0, x, [], [0.1], [0.8 + h])[row]) for h in (1e-6, -1e-6)]
    assert slope == pytest.approx((step[0] - step[1]) / 2e-6, rel=1e-6)


@pytest.mark.parametrize("number", [np.inf, -np.inf, np.nan])
def test_constants_that_are_not_finite(number: float) -> None:
    """A stiffness of any number, given below the checks of scenes, is kept in every layout."""
    body = rs.RigidBody("b", 2, (1, 1, 1), position=(0.1, 0.2, 0.3))
    joint = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), [10] * 6)
    dae = rs.Quaternion().write(rs.Scene("s", [body], [joint]))
    parts = list(dae.parts)
    at = [part.name for part in parts].index("c")
    constants = ca.SX(parts[at].constants)
    constants[int(np.flatnonzero(parts[at].numbers == 10)[0])] = number
    parts[at] = replace(parts[at], constants=constants)
    for kernels in (False, True):
        model = derive(replace(dae, parts=tuple(parts)), None, kernels)
        x = np.array([label.start for label in model.x_labels])
        rates = np.array(model.function("ode")(0, x, [], [], [])).reshape(-1)
        np.testing.assert_array_equal(rates[7:10], [-number, -1, -1.5])


# What is left out.


def test_a_table_that_is_zero_at_zero_lets_directions_go() -> None:
    """What a table gives for a number is a number: the proof goes through the call."""
    model = pair_to_ground(lambda u, v: CURVE(v))
    assert {label.name for label in model.x_labels} == {"b.p_z", "b.v_z"}


@pytest.mark.parametrize("damper", [lambda u, v: CURVE(v + 0.01), lambda u, v: CALLBACK(v)],
                         ids=["not zero at zero", "not known"])  # fmt: skip
def test_a_call_that_is_not_provably_zero_keeps_its_directions(damper: Damper) -> None:
    assert pair_to_ground(damper).n_x == 13


def pair_to_ground(damper: Damper) -> rs.Model:
    """A body that is moved along z alone, on a connector that calls the damper along every axis."""
    def force(mbs: Any, t: Any, item: Any, u: Any, r: Any, v: Any, w: Any, *rest: Any) -> list[Any]:
        forces = [900 * u[i] + damper(u[i], v[i]) for i in range(3)]
        return forces + [9 * r[i] + damper(r[i], w[i]) for i in range(3)]

    body = rs.RigidBody("b", 2, (1, 1.2, 1.4), position=(0, 0, 0.1))
    ends = rs.Marker(rs.GROUND), rs.Marker("b")
    joint = rs.RigidBodySpringDamper("j", *ends, 0, force=force)
    return rs.compile_scene(rs.Scene("b", [body], [joint]))


@pytest.mark.parametrize("layout", ["flat", "kernels"])
def test_motion_about_an_axis(layout: str) -> None:
    """A flywheel on a table of its angle becomes one angle, and obeys I a'' = -table(a)."""
    def force(mbs: Any, t: Any, item: Any, u: Any, r: Any, *rest: Any) -> list[Any]:
        return [*(100 * u), 8e3 * r[0], 8e3 * r[1], CURVE(r[2])]

    wheel = rs.RigidBody("wheel", 2, (20, 20, 30), angular_velocity=(0, 0, 0.3))
    ends = rs.Marker(rs.GROUND), rs.Marker("wheel")
    scene = rs.Scene("wheel", [wheel], [rs.RigidBodySpringDamper("j", *ends, 0, force=force)])
    model = rs.compile_scene(scene, layout=layout)
    assert [label.name for label in model.x_labels] == ["wheel.angle_z", "wheel.w_z"]
    run = rs.simulate(model, 0.15, TIGHT)  # the angle stays in the table's interval from 0 to 0.06
    rate = np.sqrt(FORCES[4] / SPEEDS[4] / 30)
    np.testing.assert_allclose(run["wheel.angle_z"], 0.3 / rate * np.sin(rate * run.t), atol=1e-9)


def test_a_state_that_only_a_call_reads_is_kept() -> None:
    """The requested force depends on b's travel through a table alone."""
    def force(mbs: Any, t: Any, item: Any, u: Any, *rest: Any) -> list[Any]:
        return [0, 0, CURVE(u[2]), 0, 0, 0]

    bodies = [rs.RigidBody(n, 2, (1, 1, 1), position=(0, 0, 0.1), velocity=(0, 0, 0.2)) for n in
              "ab"]  # fmt: skip
    joint = rs.RigidBodySpringDamper("j", rs.Marker(rs.GROUND), rs.Marker("b"), 0, force=force)
    scene = rs.Scene("two", bodies, [joint], outputs=["j.force_local"])
    model = rs.compile_scene(scene)
    assert [label.name for label in model.x_labels] == ["b.p_z", "b.v_z"]


def test_a_body_without_inertia_on_a_table() -> None:
    """0 = table(v) + k (z - h): within one interval of the table z falls as exp(-k t / c)."""
    def force(mbs: Any, t: Any, item: Any, u: Any, r: Any, v: Any, *rest: Any) -> list[Any]:
        return [*(100 * u[:2]), 600 * u[2] + CURVE(v[2]), *(10 * r)]

    pan = rs.RigidBody("pan", 0, 0, position=(0, 0, 0.5))
    joint = rs.RigidBodySpringDamper("j", rs.Marker(rs.GROUND), rs.Marker("pan"), 0, force=force)
    for layout, minimal in BOTH:
        model = rs.compile_scene(rs.Scene("pan", [pan], [joint]), layout=layout, minimal=minimal)
        run = rs.simulate(model, 0.2, rs.Idas(1e-10, 1e-12))
        # In the interval from -0.4 to -0.06 the table is a + c v.
        c = (FORCES[2] - FORCES[1]) / (SPEEDS[2] - SPEEDS[1])
        a = FORCES[2] - c * SPEEDS[2]
        fall = (0.5 + a / 600) * np.exp(-600 / c * run.t) - a / 600
        np.testing.assert_allclose(run["pan.p_z"], fall, rtol=0, atol=1e-8)


# Events, post_newton_step.


@every_model
def test_events(layout: str, minimal: bool) -> None:
    """A table decides when a free fall is reversed, and another with what speed it goes on."""
    marks = ca.interpolant("marks", "linear", [[-3.0, 0.0, 1.0]], [-1.0, 0.5, 2.5])
    speeds = ca.interpolant("speeds", "linear", [[-9.0, 0.0, 9.0]], [-4.5, 0.0, 9.0])

    def events(
        mbs: Any, t: Any, item: Any, data: Any, u: Any, r: Any, v: Any, *rest: Any
    ) -> list[Any]:
        push = MASS * (v[2] - speeds(v[2]))  # the speed falls to half of what it is
        return [rs.Event(marks(u[2]), impulse=[0, 0, push, 0, 0, 0], data=[data[0] + SQUARE(u[2])])]

    body = rs.RigidBody("body", MASS, (1, 1.2, 1.4))
    ends = rs.Marker(rs.GROUND), rs.Marker("body")
    joint = rs.RigidBodySpringDamper("j", *ends, 0, events=events, data=[0.25])
    scene = rs.Scene("fall", [body], [joint], gravity=(0, 0, -10))
    model = rs.compile_scene(scene, layout=layout, minimal=minimal)
    run = rs.simulate(model, [0, 0.3, 0.6], rs.Rosenbrock(1e-10, 1e-12))
    # marks is zero at -1 m, reached after sqrt(0.2) s at sqrt(20) m/s.
    hit, speed = np.sqrt(0.2), -np.sqrt(20.0) / 2
    ((t, name),) = run.events
    assert (name, t) == ("j.event_0", pytest.approx(hit, abs=1e-8))
    rest = 0.6 - hit
    assert run["body.p_z"][-1] == pytest.approx(-1 + speed * rest - 5 * rest**2, abs=1e-7)
    assert run["j.data_0"][-1] == pytest.approx(0.25 - 2500, abs=1e-3)


@every_model
def test_post_newton_step(layout: str, minimal: bool) -> None:
    """[error, recommended step, data], all from calls."""
    def step(mbs: Any, t: Any, item: Any, data: Any, u: Any, r: Any, v: Any, *rest: Any
             ) -> list[Any]:  # fmt: skip
        return [SQUARE(v[2]), CURVE(u[2]), CURVE(v[2] + data[0])]

    body = rs.RigidBody("body", MASS, (1, 1.2, 1.4), position=(0, 0, 0.3), velocity=(0, 0, 0.2))
    ends = rs.Marker(rs.GROUND), rs.Marker("body")
    joint = rs.RigidBodySpringDamper("j", *ends, [9] * 6, post_newton_step=step, data=[0.1])
    model = rs.compile_scene(rs.Scene("s", [body], [joint]), layout=layout, minimal=minimal)
    x = np.array([label.start for label in model.x_labels])
    found = np.array(model.function("post_newton")(0, x, [], [], [])).reshape(-1)
    assert found[0] == pytest.approx(2500 * 0.2**2)
    assert found[1] == pytest.approx(piecewise(0.3))
    row = [label.name for label in model.x_labels].index("j.data_0")
    assert found[2 + row] == pytest.approx(piecewise(0.3))
