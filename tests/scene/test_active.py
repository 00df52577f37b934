"""`active` as a flag, a Param or an Input: what is refused, what is off while off, exact switching.

The truth is integrated by many small Runge-Kutta steps, started again where the switch crosses 0.5.
"""

from __future__ import annotations

import warnings
from typing import Any

import casadi as ca
import numpy as np
import pytest

import rbsd_sym as rs

M, G, SOFT, STIFF, DAMPING, REST, SPEED = 1.3, 4.0, 6.0, 90.0, 0.7, 0.12, 0.35
ON = rs.Input("on", value=1.0)
TIGHT = {"rtol": 1e-10, "atol": 1e-12}


def scene(active: Any, **more: Any) -> rs.Scene:
    """A body that falls along -x on a soft spring, and on a stiff one that may be switched."""
    body = rs.RigidBody("b", M, (1, 1, 1), velocity=(SPEED, 0, 0))
    markers = rs.Marker(rs.GROUND), rs.Marker("b")
    given = {"stiffness": [STIFF] * 3 + [0] * 3, "damping": [DAMPING] * 3 + [0] * 3,
             "offset": [REST, 0, 0, 0, 0, 0]} | more  # fmt: skip
    connectors = [
        rs.RigidBodySpringDamper("soft", *markers, [SOFT] * 3 + [0] * 3),
        rs.RigidBodySpringDamper("c", *markers, active=active, **given),
    ]
    return rs.Scene("s", [body], connectors, gravity=(-G, 0, 0))


def truth(end: float, crossings: list[float], on: bool) -> np.ndarray:
    """Position and speed at the end, by 4th-order steps of at most 2e-4 s in each phase."""
    y, t = np.array([0.0, SPEED]), 0.0
    for stop in (*crossings, end):
        stiff, damping = (STIFF, DAMPING) if on else (0.0, 0.0)

        def rate(y: np.ndarray, stiff: float = stiff, damping: float = damping) -> np.ndarray:
            pull = SOFT * y[0] + stiff * (y[0] - REST) + damping * y[1]
            return np.array([y[1], -G - pull / M])

        n = int(np.ceil((stop - t) / 2e-4))
        h = (stop - t) / n
        for _ in range(n):
            a = rate(y)
            b = rate(y + h / 2 * a)
            c = rate(y + h / 2 * b)
            y = y + h / 6 * (a + 2 * b + 2 * c + rate(y + h * c))
        t, on = stop, not on
    return y


TIMES, VALUES = [0.0, 0.3, 0.9, 1.3, 1.4, 1.8], [0.0, 0.8, 0.8, 0.4, 0.45, 0.05]
SIGNALS: dict[str, tuple[Any, list[float], bool]] = {
    "smooth": (lambda t: 0.5 - 0.4 * np.cos(5 * t), [np.pi / 10 * k for k in (1, 3, 5)], False),
    "samples": ((TIMES, VALUES), [0.1875, 1.2], False),
    "steep samples": (([0, 0.5, 0.5 + 1e-9, 1.7], [1, 1, 0, 0]), [0.5 + 5e-10], True),
    "step": (lambda t: 0.0 if 0.45 <= t < 1.25 else 1.0, [0.45, 1.25], True),
}
METHODS = [rs.Idas(**TIGHT), rs.Dop853(**TIGHT), rs.Rosenbrock(**TIGHT), rs.ExplicitRK(**TIGHT)]


@pytest.mark.parametrize("name", SIGNALS)
@pytest.mark.parametrize("method", METHODS, ids=lambda m: type(m).__name__)
def test_an_input_switches_where_it_crosses(name: str, method: Any) -> None:
    signal, crossings, starts_on = SIGNALS[name]
    run = rs.simulate(MODEL, 1.7, method, inputs={"on": signal})
    end = np.array([run["b.p_x"][-1], run["b.v_x"][-1]])
    # CasADi's own search finds a jump of a Python function to 1e-9 s only.
    rough = name == "step" and isinstance(method, (rs.Rosenbrock, rs.ExplicitRK))
    assert np.abs(end - truth(1.7, crossings, starts_on)).max() < (1e-7 if rough else 1e-8)
    happened = [t for t, event in run.events if event == "c.switches" and t > 0]
    assert np.abs(np.array(happened) - crossings).max() < (1e-8 if rough else 1e-12)
    on = (np.searchsorted(crossings, run.t, side="right") % 2 == 0) == starts_on
    apart = np.abs(run.t[:, None] - np.array(crossings)).min(axis=1) > 1e-6
    assert np.array_equal(run["c.activeConnector"][apart], on[apart])
    assert not run["c.force_local"][apart & ~on].any()
    assert np.abs(run["c.force_local"][apart & on][:, 0]).min() > 0


MODEL = rs.compile_scene(scene(ON))


def test_generalized_alpha_keeps_its_order() -> None:
    """Steps are cut at the crossing: errors fall as the square of the step."""
    signal, crossings, starts_on = SIGNALS["smooth"]
    errors = []
    for step in (4e-3, 2e-3, 1e-3):
        run = rs.simulate(MODEL, [0, 0.85, 1.7], rs.GeneralizedAlpha(step), inputs={"on": signal})
        errors.append(abs(run["b.p_x"][-1] - truth(1.7, crossings, starts_on)[0]))
    assert errors[2] < 1e-5
    assert 3 < errors[0] / errors[1] < 5
    assert 3 < errors[1] / errors[2] < 5


@pytest.mark.parametrize("layout", ["flat", "kernels"])
@pytest.mark.parametrize("minimal", [True, False])
def test_every_layout_switches(layout: str, minimal: bool) -> None:
    model = rs.compile_scene(scene(ON), layout=layout, minimal=minimal)
    run = rs.simulate(model, 1.7, rs.Dop853(**TIGHT), inputs={"on": SIGNALS["samples"][0]})
    end = [run["b.position"][-1, 0], run["b.velocity"][-1, 0]]
    assert np.abs(end - truth(1.7, [0.1875, 1.2], False)).max() < 1e-8
    chosen = rs.compile_scene(scene(rs.Param("p", 1.0)), layout=layout, minimal=minimal)
    run = rs.simulate(chosen, 1.7, rs.Idas(**TIGHT), params={"p": 0.4})
    end = [run["b.position"][-1, 0], run["b.velocity"][-1, 0]]
    assert np.abs(end - truth(1.7, [], False)).max() < 1e-8
    x, _ = chosen.dae.start_values([1.0])
    slopes = np.array(ca.DM(chosen.function("dode_dp")(0, x, [], [], [0.4])))
    assert not slopes.any()


def test_expressions_of_params_switch_and_conditions_in_time_are_refused() -> None:
    low, high = rs.Param("low", 0.3), rs.Param("high", 0.4)
    model = rs.compile_scene(scene(low + high))
    assert not model.events
    for values, on in (({}, True), ({"low": 0.1}, False)):
        run = rs.simulate(model, 1.7, rs.Idas(**TIGHT), params=values)
        end = [run["b.p_x"][-1], run["b.v_x"][-1]]
        assert np.abs(end - truth(1.7, [], on)).max() < 1e-8
    for jumping in (rs.TIME > 0.4, ON > 0.5, low * ON, rs.where(rs.TIME < 1, 0, 1)):
        with pytest.raises(TypeError, match=r"'c', active: .*for a condition give an Input"):
            scene(jumping)


COMPARED = ("b.position", "b.velocity", "b.quaternion", "c.force_local", "c.torque_local",
            "c.force1", "c.potential_energy", "c.dissipated_power", "c.injected_power",
            "c.displacement_local", "c.tangent_stiffness", "energy")  # fmt: skip
EFFECTS = [
    (), rs.Maxwell(0, 30, 4), rs.Contact(0, 900, 3), rs.Impact(0, 0.5, gap=0.2),
    rs.Plastic(0, 60, 0.9), rs.Fracture(force=1e4), rs.Friction(0, 1.2, 0.3),
    rs.Friction(0, 1.2, 0.3, smoothing=0.01), rs.LuGre(0, 1.0, 0.3, 0.5, 0.1, 500, 2),
]  # fmt: skip


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: type(e).__name__)
@pytest.mark.parametrize("law", [rs.Standard(), rs.Consistent()], ids=lambda e: type(e).__name__)
def test_a_param_is_the_flag_of_its_value(effect: Any, law: Any) -> None:
    """Above 0.5 every column is that of active=True, else that of active=False."""
    effects = effect or ()
    model = rs.compile_scene(scene(rs.Param("p", 0.2), law=law, effects=effects))
    for value, flag in ((0.51, True), (0.5, False), (7, True), (-1, False)):
        plain = rs.compile_scene(scene(flag, law=law, effects=effects))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rs.ModelWarning)  # pushed, the stiff spring buckles
            runs = [rs.simulate(model, 0.6, rs.Idas(**TIGHT), params={"p": value}),
                    rs.simulate(plain, 0.6, rs.Idas(**TIGHT))]  # fmt: skip
        for name in COMPARED:
            first, second = (run[name][-1] for run in runs)
            assert np.abs(first - second).max() < 1e-7 * max(1, np.abs(second).max()), name
        for run in runs:
            assert (run["c.active"] == float(flag)).all()
            assert run.parameters.get("p", value) == value


def test_nothing_is_left_out_because_it_is_off_by_default() -> None:
    """A body at rest that only a switched connector moves keeps its states for every default."""
    def model(active: Any) -> rs.Model:
        body = rs.RigidBody("b", M, (1, 1, 1))
        joint = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), [9] * 6,
                                         offset=[0.1, 0, 0, 0, 0, 0.2], active=active)  # fmt: skip
        return rs.compile_scene(rs.Scene("s", [body], [joint]))

    flagged, idle = model(True), model(False)
    assert idle.n_x == 0
    for default in (0.0, 0.2, 1.0):
        switched, driven = model(rs.Param("p", default)), model(rs.Input("u", value=default))
        names = [label.name for label in flagged.x_labels]
        assert [label.name for label in switched.x_labels] == names
        assert [label.name for label in driven.x_labels] == [*names, "c.active"]
        moved = rs.simulate(switched, 0.5, rs.Idas(**TIGHT), params={"p": 1})["b.position"][-1, 0]
        assert moved == pytest.approx(0.1 * (1 - np.cos(np.sqrt(9 / M) * 0.5)), abs=1e-8)


def ball(effects: Any, **more: Any) -> rs.Model:
    """A ball above the floor, its connector to the floor switched by the Input."""
    body = rs.RigidBody("b", 1.0, (1, 1, 1), position=(0, 0, 0.1))
    floor = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), effects=effects,
                                     active=ON, **more)  # fmt: skip
    return rs.compile_scene(rs.Scene("s", [body], [floor], gravity=(0, 0, -10)))


@pytest.mark.parametrize("method", [*METHODS, rs.GeneralizedAlpha(1e-3)],
                         ids=lambda m: type(m).__name__)  # fmt: skip
def test_events_wait_while_off(method: Any) -> None:
    """The ball falls through a floor that is off; switched on above it, it is thrown at once."""
    model = ball(rs.Impact(2, 0.5))
    through = rs.simulate(model, 0.3, method, inputs={"on": lambda t: 1 - t / 0.2})
    assert through["b.position"][-1, 2] == pytest.approx(0.1 - 5 * 0.09, abs=1e-9)
    assert [name for _, name in through.events] == ["c.switches"]
    thrown = rs.simulate(model, 0.3, method, inputs={"on": lambda t: t / 0.4})
    height = 0.1 - 5 * 0.04 + 0.5 * 2.0 * 0.1 - 5 * 0.01  # speed 2 m/s at 0.2 s
    assert thrown["b.position"][-1, 2] == pytest.approx(height, abs=1e-8)
    assert [name for t, name in thrown.events if t > 0] == ["c.switches", "c.impact_z_hits"]


def test_what_is_off_does_not_break() -> None:
    """The spring is overloaded while off, and breaks as it is switched on."""
    model = ball(rs.Fracture(force=4), stiffness=[100] * 6)
    run = rs.simulate(model, 0.3, rs.Idas(**TIGHT), inputs={"on": lambda t: t / 0.4})
    broken = [t for t, name in run.events if name == "c.fracture_breaks"]
    assert broken == pytest.approx([0.2], abs=1e-12)
    assert run["b.position"][-1, 2] == pytest.approx(0.1 - 5 * 0.09, abs=1e-9)


def test_states_of_effects_rest_while_off() -> None:
    model = ball(rs.Maxwell(2, 50.0, 3.0))
    times = np.linspace(0, 0.3, 31)
    run = rs.simulate(model, times, rs.Idas(**TIGHT), inputs={"on": lambda t: 1 - t / 0.2})
    force = run["c.maxwell_z_force"]
    assert abs(force[-1]) > 1
    assert np.abs(force[run.t > 0.1001] - force[-1]).max() < 1e-12
    assert np.array_equal(run["c.maxwell_z"][run.t > 0.1001], np.zeros((run.t > 0.1001).sum()))
    assert run["b.v_z"][-1] == pytest.approx(run["b.v_z"][10] - 10 * 0.2, abs=1e-8)


def test_user_events_and_data_rest_while_off() -> None:
    """A latch that a motion sets is not set while off; post-Newton steps change nothing."""
    def latch(mbs, t, item, data, u, *rest) -> list[rs.Event]:
        return [rs.Event(u[2], direction=-1, data=[1.0])]

    def step(mbs, t, item, data, u, *rest) -> list[Any]:
        return [0.0, -1, t]

    model = ball((), data=[0.0], events=latch)
    off = rs.simulate(model, 0.3, inputs={"on": lambda t: 1 - t / 0.2})
    assert off["c.data_0"][-1] == 0
    assert rs.simulate(model, 0.3, inputs={"on": 1.0})["c.data_0"][-1] == 1
    noted = ball((), data=[0.0], post_newton_step=step)
    run = rs.simulate(noted, np.linspace(0, 0.3, 31), rs.GeneralizedAlpha(0.01),
                      inputs={"on": lambda t: 1 - t / 0.2})  # fmt: skip
    assert run["c.data_0"][-1] == pytest.approx(0.1, abs=0.011)


def test_what_is_not_finite_while_off_leaves_no_trace() -> None:
    """A force that divides by the distance, which is zero: value and slope count for nothing."""
    def singular(mbs, t, item, u, *rest) -> list[Any]:
        length = np.sqrt(u @ u)
        return [*(3 * (length - 1) * u / length), 0, 0, 0]

    body = rs.RigidBody("b", 1.0, (1, 1, 1))
    joint = rs.RigidBodySpringDamper("c", rs.Marker(rs.GROUND), rs.Marker("b"), force=singular,
                                     active=rs.Param("p", 0.0))  # fmt: skip
    model = rs.compile_scene(rs.Scene("s", [body], [joint]), minimal=False)
    x = np.array([0, 0, 0, 1, *[0.0] * 9])
    for name in ("ode", "dode_dx", "dode_dp", "c.force_local"):
        assert np.isfinite(np.array(model.function(name)(0, x, [], [], [0]))).all(), name
    assert np.isnan(np.array(model.function("ode")(0, x, [], [], [1]))).any()


def test_statics_and_linear_models_take_the_input_as_it_is() -> None:
    for value, stiffness in ((1, SOFT + STIFF), (0.51, SOFT + STIFF), (0.5, SOFT), (0, SOFT)):
        rest = rs.static_equilibrium(MODEL, inputs={"on": value}, start={"b.p_x": -0.4})
        pull = STIFF * REST if stiffness > SOFT else 0.0
        assert rest.x["b.p_x"] == pytest.approx((pull - M * G) / stiffness, rel=1e-9)
        modes = rs.linearize(MODEL, inputs={"on": value}).eigenvalues
        assert np.abs(modes).max() ** 2 == pytest.approx(stiffness / M, rel=1e-9)


def test_exported_c_switches(tmp_path: Any) -> None:
    try:
        artefact = rs.export_simulator(MODEL, tmp_path / "s", rs.Rosenbrock(**TIGHT))
        simulator = rs.load_simulator(artefact, MODEL)
    except rs.CompilerMissing as error:
        pytest.skip(str(error))
    run = simulator(1.7, inputs={"on": SIGNALS["samples"][0]})
    end = [run["b.p_x"][-1], run["b.v_x"][-1]]
    assert np.abs(end - truth(1.7, [0.1875, 1.2], False)).max() < 1e-8


@pytest.mark.parametrize("value", ["yes", "True", 0.0, 1, 0, None, [True], np.array([1.0]), object])
def test_other_flags_are_refused(value: Any) -> None:
    with pytest.raises(TypeError, match=r"connector 'c', active: .*; give True or False, or a "):
        scene(value)
    if not isinstance(value, np.ndarray):
        with pytest.raises(TypeError, match=r"connector 'c', show: .*; give True or False"):
            scene(True, show=value)
        with pytest.raises(TypeError, match=r"body 'b', show: .*; give True or False"):
            rs.RigidBody("b", 1, (1, 1, 1), show=value)


def test_flags_of_numpy_are_flags() -> None:
    off = rs.compile_scene(scene(np.bool_(False)))
    assert len(off.dae.parts) == len(rs.compile_scene(scene(False)).dae.parts)
    assert scene(np.bool_(True)).text == scene(True).text


def test_exact_friction_is_not_switched_in_a_run() -> None:
    with pytest.raises(ValueError, match=r"connector 'c', active: depends on 'on'.*friction_x"):
        scene(ON, effects=rs.Friction(0, 1.0, 0.3))


def test_flags_of_old_scenes_make_the_same_model() -> None:
    """active=False is in no part and in no constant; active=True has no switch."""
    for flag, parts in ((True, 3), (False, 2)):
        model = rs.compile_scene(scene(flag), minimal=False)
        assert len(model.dae.parts) == parts
        assert (model.events, model.n_p, model.n_u, model.n_x) == ((), 0, 0, 13)


