"""Effects whose numbers are symbols, and effects side by side, against closed forms.

Tolerances: integration at rtol 1e-10 leaves 1e-10 to 1e-9 of the motion over some ten events; 1e-8
has room for it, and stays far below what a wrong law would show. Expectations come from
tests/oracles; the numbers written out are published.
"""

from __future__ import annotations

import numpy as np
import pytest
from helpers.comparing import largest
from oracles import discontinuities as events
from scenes.effects import HOLDING, TIGHT, along, block, times_of, unit

import rbsd_sym as rs

by_holding = pytest.mark.parametrize("method", HOLDING)
# A motion along one axis is what counts here, not whether a spring without the others is stable.
pytestmark = pytest.mark.filterwarnings("ignore::rbsd_sym.ModelWarning")


# Numbers that are symbols, and effects side by side.


def test_numbers_of_effects_are_params_and_inputs() -> None:
    """The sliding distance v^2 / (2 mu g) for any mu, and with a normal force that ramps up."""
    mu, normal = rs.Param("mu", 0.5), rs.Input("normal", "N", 9.81)
    model = rs.compile_scene(block(rs.Friction(0, normal, mu), v=2.0))
    assert [label.name for label in model.dae.p_labels] == ["mu"]
    assert [label.name for label in model.dae.u_labels] == ["normal"]
    for value in (0.5, 0.1):
        end = 1.5 * 2 / (value * 9.81)
        found = rs.simulate(model, [0, end], TIGHT["rosenbrock"], params={"mu": value})
        assert along(found, 0)[0][-1] == pytest.approx(4 / (2 * value * 9.81), rel=1e-9)
    # v = 2 - mu 10 t^2 / 2 is zero at t^2 = 0.8, x = 2 t - 2.5 t^3 / 3.
    ramp = {"normal": lambda t: 10 * t}
    found = rs.simulate(model, [0, 1.2], TIGHT["idas"], inputs=ramp)
    stop = np.sqrt(0.8)
    assert times_of(found, "sticks")[0] == pytest.approx(stop, rel=1e-7)
    assert along(found, 0)[0][-1] == pytest.approx(2 * stop - 2.5 * stop**3 / 3, rel=1e-7)


def test_stiffness_and_limits_are_params() -> None:
    """Depth of a contact and the instant of a fracture follow the values of a run."""
    k, limit = rs.Param("k", 1e4), rs.Param("limit", 10.0)
    model = rs.compile_scene(block(rs.Contact(2, k), 2, x=0.1, pull=-9.81))
    for value in (1e4, 1e6):
        contact = events.drop_contact(1.0, value, 0.1, 9.81)
        t = [0, np.sqrt(0.2 / 9.81) + contact.duration / 2]
        found = rs.simulate(model, t, TIGHT["explicit"], params={"k": value})
        assert along(found, 2)[0][-1] == pytest.approx(-contact.depth, rel=1e-9)
    model = rs.compile_scene(block(rs.Fracture(limit), 0, 50.0, 2.0, v=1.5))
    for value in (10.0, 12.0):
        found = rs.simulate(model, [0, 1], TIGHT["explicit"], params={"limit": value})
        when = events.fracture_phases(2.0, 50.0, value, 0.0, 1.5)[1].start
        assert found.events[0][0] == pytest.approx(when, rel=1e-9)


FLOOR = [rs.Contact(2, 1e5, 50.0), rs.Friction(0, "contact_z", 0.4, name="along_x"),
         rs.Friction(1, "contact_z", 0.4, name="along_y")]  # fmt: skip


def test_block_slides_to_rest_on_a_floor() -> None:
    """Contact and friction along x and y in one connector: v^2 / (2 mu g) along each axis.

    Friction is that of each axis, not of a disc. The block lies m g / k deep from the start, so
    that the push is m g to integration's error.
    """
    g, (v_x, v_y) = 9.81, (1.5, -0.8)
    body = rs.RigidBody("b", 3.0, [1.0] * 3, position=(0, 0, -3 * g / 1e5), velocity=(v_x, v_y, 0))
    joint = rs.RigidBodySpringDamper("j", rs.Marker(rs.GROUND), rs.Marker("b"), 0, effects=FLOOR)
    model = rs.compile_scene(rs.Scene("floor", [body], [joint], gravity=(0, 0, -g)))
    assert model.n_z == 2
    found = rs.simulate(model, np.linspace(0, 0.6, 7), TIGHT["rosenbrock"])
    assert found["j.along_x"][1] == pytest.approx(0.4 * 3 * g, rel=1e-7)
    assert found["j.along_y"][1] == pytest.approx(-0.4 * 3 * g, rel=1e-7)
    assert found["j.contact_z"] == pytest.approx(-3 * g * np.ones(7), rel=1e-7)
    assert found["b.p_x"][-1] == pytest.approx(v_x**2 / (0.8 * g), rel=1e-8)
    assert found["b.p_y"][-1] == pytest.approx(-(v_y**2) / (0.8 * g), rel=1e-8)
    assert times_of(found, "along_y_sticks")[0] == pytest.approx(0.8 / (0.4 * g), rel=1e-8)
    assert abs(found["j.along_x_mode"][-1]) < 1e-9
    assert abs(found["j.along_y_mode"][-1]) < 1e-9


@by_holding
def test_friction_feels_the_push_of_bounces(method: str) -> None:
    """A bounce pushes by 2 m u + m g T, and takes mu times that of the speed along the floor."""
    g, c = 9.81, events.drop_contact(1.0, 1e4, 0.1, 9.81)
    body = rs.RigidBody("b", 1.0, [1.0] * 3, position=(0, 0, 0.1), velocity=(3.0, 0, 0))
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND), rs.Marker("b"), 0,
        effects=[rs.Contact(2, 1e4), rs.Friction(0, "contact_z", 0.2)],
    )  # fmt: skip
    model = rs.compile_scene(rs.Scene("bounces", [body], [joint], gravity=(0, 0, -g)))
    found = rs.simulate(model, [0, 0.1, 0.3, 0.6, 0.9], TIGHT[method])
    taken = 0.2 * (2 * c.rebound + g * c.duration)
    assert largest(found["b.v_x"] - 3.0 + taken * np.array([0, 0, 1, 2, 3])) < 1e-7


@pytest.mark.parametrize("method", ["rosenbrock", "explicit"])
def test_three_axes_do_not_feel_each_other(method: str) -> None:
    """Plastic, Maxwell and Contact beside each other move as each of them alone."""
    effects = [rs.Plastic(0, 3.0, 0.5, 1.0), rs.Maxwell(1, 4.0, 2.0), rs.Contact(2, 50.0, 1.0)]
    t = np.linspace(0, 4, 21)
    start, v = (0.0, 0.1, 0.2), (1.0, 0.5, -0.3)
    body = rs.RigidBody("b", 1.0, [1.0] * 3, position=start, velocity=v)
    joint = rs.RigidBodySpringDamper(
        "j", rs.Marker(rs.GROUND), rs.Marker("b"), [1, 1, 1, 0, 0, 0], effects=effects
    )
    together = rs.simulate(
        rs.compile_scene(rs.Scene("three", [body], [joint])), t, TIGHT[method]
    )["b.position"]
    for axis, effect in enumerate(effects):
        alone = rs.compile_scene(block(effect, axis, 1.0, 1.0, start[axis], v[axis]))
        found = along(rs.simulate(alone, t, TIGHT[method]), axis)[0]
        assert largest(found - together[:, axis]) < 1e-7


def test_effects_of_connectors_of_one_kind_keep_their_own_numbers() -> None:
    """Two blocks on frictions of one structure and other numbers, in one scene."""
    bodies, joints = [], []
    for i, (mu, v) in enumerate(((0.2, 1.0), (0.5, -2.0))):
        bodies.append(rs.RigidBody(f"b{i}", 1.0, [1.0] * 3, velocity=v * unit(0)[:3]))
        joints.append(rs.RigidBodySpringDamper(
            f"j{i}", rs.Marker(rs.GROUND), rs.Marker(f"b{i}"), 0, effects=rs.Friction(0, 10.0, mu)
        ))  # fmt: skip
    found = rs.simulate(
        rs.compile_scene(rs.Scene("two", bodies, joints)), [0, 1.0], TIGHT["rosenbrock"]
    )
    assert found["b0.p_x"][-1] == pytest.approx(1 / 4, rel=1e-8)
    assert found["b1.p_x"][-1] == pytest.approx(-4 / 10, rel=1e-8)
