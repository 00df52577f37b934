"""Wrong events, data and effects: the error's type, its place, and what, rule and remedy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from helpers.refusals import INF, NAN, body, compiled, joint, refused, table

import rbsd_sym as rs

WHERE = "connector 'joint'"
Contact, Friction, Impact, Plastic = rs.Contact, rs.Friction, rs.Impact, rs.Plastic
Fracture, LuGre, Table = rs.Fracture, rs.LuGre, rs.Table


def event(*given: Any, **changes: Any) -> rs.Model:
    """A model with one event of the displacement, at 1 m."""
    data = changes.pop("states", [])
    return events(lambda *a: [rs.Event(a[4][0] - 1, *given, **changes)], data=data)


def events(function: Any, **changes: Any) -> rs.Model:
    return compiled(connectors=[joint(events=function, **changes)])


def zero(value: Any) -> rs.Model:
    return events(lambda *a: [rs.Event(value(a) if callable(value) else value)])


def two(*names: str, direction: int = -1) -> rs.Model:
    """Two events of these names, the second of any direction."""
    return events(lambda *a: [rs.Event(a[4][0], name=names[0]),
                              rs.Event(a[4][1], direction, name=names[1])])  # fmt: skip


def with_effects(*effects: Any, **changes: Any) -> rs.RigidBodySpringDamper:
    return joint(effects=effects, **changes)


def model_of(*effects: Any, **changes: Any) -> rs.Model:
    """A compiled model, since some rules are those of the whole scene."""
    bodies = [changes.pop("body", body())]
    return compiled(bodies=bodies, connectors=[with_effects(*effects, **changes)])


def stepping(step: Callable[..., Any], **changes: Any) -> rs.Model:
    return compiled(connectors=[joint(post_newton_step=step, **({"data": [0.0]} | changes))])


def massless() -> rs.RigidBody:
    return rs.RigidBody("arm", 0, 0)


SIX = "6 numbers: impulse x y z, turning impulse x y z"
EVENT = f"{WHERE}, events, 'event_0'"


@table([
    (ValueError, lambda: event(impulse=[1, 2, 3]), f"{EVENT}, impulse: ", "3 numbers", SIX),
    (ValueError, lambda: event(impulse=3.0), f"{EVENT}, impulse: ", "1 numbers", SIX),
    (ValueError, lambda: event(impulse=[NAN] * 6), f"{EVENT}, impulse: ", "entry 0 is nan",
     "finite"),
    (TypeError, lambda: event(impulse=["a"] * 6), f"{EVENT}, impulse: ", "'a'", "return numbers"),
    (ValueError, lambda: event(data=[1.0]), f"{EVENT}, data: ", "1 numbers", "returns 0 numbers",
     "one for each entry of the connector's data"),
    (ValueError, lambda: event(data=[1.0, 2.0], states=[0.0]), f"{EVENT}, data: ", "2 numbers",
     "returns 1 numbers"),
    (ValueError, lambda: event(data=1.0, states=[0.0, 0.0]), f"{EVENT}, data: ", "1 numbers",
     "returns 2 numbers"),
    (ValueError, lambda: event(data=[INF], states=[0.0]), f"{EVENT}, data: ", "inf", "finite"),
    (TypeError, lambda: event(data=["x"], states=[0.0]), f"{EVENT}, data: ", "'x'",
     "return numbers"),
    (TypeError, lambda: zero("a"), f"{EVENT}, zero: ", "'a'", "return numbers"),
    (TypeError, lambda: zero(None), f"{EVENT}, zero: ", "None", "return numbers"),
    (ValueError, lambda: zero(lambda a: a[4]), f"{EVENT}, zero: ", "3 numbers",
     "returns 1 number"),
    (ValueError, lambda: zero(NAN), f"{EVENT}, zero: ", "nan", "finite"),
    (TypeError, lambda: events(lambda *a: None), f"{WHERE}, events: ", "None",
     "list of rbsd_sym.Event"),
    (TypeError, lambda: events(lambda *a: [a[4][0]]), f"{WHERE}, events: ", "strain_0",
     "list of rbsd_sym.Event"),
    (TypeError, lambda: events(lambda *a: 3.0), f"{WHERE}, events: ", "3.0",
     "list of rbsd_sym.Event"),
    (TypeError, lambda: events(lambda *a: [rs.Event(a[4][0])] if a[4][0] > 0 else []),
     f"{WHERE}, events: ", "no truth value", "rbsd_sym.where"),
    (TypeError, lambda: events(lambda a: []), f"{WHERE}, events: ", "13 were given",
     "called as (mbs, t, item, data, "),
    (ValueError, lambda: zero(ca.SX.sym("alien")), f"{WHERE}, events: ", "alien",
     "Params, Inputs"),
    (ValueError, lambda: two("a", "a"), f"{WHERE}, events: ", "['a', 'a']", "different names"),
    (ValueError, lambda: two("a_falls", "a", direction=0), f"{WHERE}, events: ", "a_falls",
     "different names"),
    (ValueError, lambda: two("event_1", ""), f"{WHERE}, events: ", "event_1", "different names"),
    (TypeError, lambda: joint(events=3), f"{WHERE}: ", "events 3", "function"),
    (ValueError, lambda: rs.Event(1, 2), "Event: ", "direction 2", "-1 falls, +1 rises"),
    (ValueError, lambda: rs.Event(1, "down"), "Event: ", "direction 'down'", "-1 falls"),
    (ValueError, lambda: rs.Event(1, name="a b"), "Event: ", "'a b'", "identifier", "choose"),
])  # fmt: skip
def test_events(row: tuple[Any, ...]) -> None:
    refused(*row)


def test_at_once_needs_a_direction() -> None:
    with pytest.raises(ValueError, match=r"^Event: at_once needs a direction, which tells the far"):
        rs.Event(1, 0, at_once=True)


@table([
    (TypeError, lambda: joint(data=["a"]), f"{WHERE}, data: ", "'a' is str", "float"),
    (ValueError, lambda: joint(data=[0, NAN]), f"{WHERE}, data: ", "nan", "finite"),
    (ValueError, lambda: joint(data=1.0), f"{WHERE}, data: ", "1.0", "list of start values"),
    (ValueError, lambda: joint(data="ab"), f"{WHERE}, data: ", "'ab'", "(2,)"),
    (ValueError, lambda: joint(data=[rs.Param("k", 1.0)]), f"{WHERE}, data: ", "[k]",
     "plain numbers"),
    (ValueError, lambda: joint(data=[[1, 2]]), f"{WHERE}, data: ", "[[1, 2]]", "(1,)"),
    (ValueError, lambda: stepping(lambda *a: [0, 0]), f"{WHERE}, post_newton_step: ", "2 numbers",
     "2 + 1 numbers: error, recommended step, and each entry of data"),
    (ValueError, lambda: stepping(lambda *a: [0] * 4), f"{WHERE}, post_newton_step: ",
     "4 numbers", "2 + 1 numbers"),
    (ValueError, lambda: stepping(lambda *a: None), f"{WHERE}, post_newton_step: ", "None",
     "2 + 1 numbers"),
    (TypeError, lambda: stepping(lambda *a: [0, 0, "a"]), f"{WHERE}, post_newton_step: ",
     "entry 2 is 'a'", "return numbers"),
    (TypeError, lambda: stepping(lambda a, b, c, d, e, f, g, h, i, j, k, l: [0] * 3),
     f"{WHERE}, post_newton_step: ", "13 were given", "called as (mbs, t, item, data, "),
    (TypeError, lambda: compiled(connectors=[joint(force=lambda a, b: [0] * 6)]),
     f"{WHERE}, force: ", "12 were given", "called as (mbs, t, item, displacement, "),
    (TypeError, lambda: compiled(connectors=[joint(
        force=lambda a, b, c, d, e, f, g, h, i, j, k, l, m, n: [0] * 6, data=[0.0])]),
     f"{WHERE}, force: ", "2 required positional arguments", "called as (mbs, t, item, "),
    (ValueError, lambda: rs.simulate(stepping(lambda *a: [0, -1, a[4][0]]), 1, rs.Rosenbrock()),
     "model 'bench': ", "post_newton_step", "use GeneralizedAlpha(step) or Idas()"),
    (ValueError, lambda: rs.simulate(stepping(lambda *a: [0, -1, a[4][0]]), 1, rs.ExplicitRK()),
     "model 'bench': ", "post_newton_step", "use GeneralizedAlpha(step) or Idas()"),
])  # fmt: skip
def test_data_and_steps(row: tuple[Any, ...]) -> None:
    refused(*row)


AXIS = ("give 0, 1, 2 for translation along the joint's x, y, z", "3, 4, 5 for rotation")
ORDER = ("acts on the whole wrench", "after the other effects", "connector of its own")
LACKS = ("body 'arm'", "lacks mass or inertia", "give it some", "smoothing")
MORE = "at least as much to start sliding"


@table([
    (ValueError, lambda: with_effects(Friction(0, 9, -0.1)), f"{WHERE}, Friction, kinetic: ",
     "-0.1", "not negative", "check sign"),
    (ValueError, lambda: with_effects(Friction(0, 9, 0.1, -0.2)), f"{WHERE}, Friction, static: ",
     "-0.2", "not negative", "check sign"),
    (ValueError, lambda: with_effects(Friction(0, -9, 0.1)), f"{WHERE}, Friction, normal: ",
     "-9 N", "not negative", "check sign"),
    (ValueError, lambda: with_effects(Friction(0, rs.Input("n", "N", -5.0), 0.3)),
     f"{WHERE}, Friction, normal: ", "-5 N", "not negative"),
    (ValueError, lambda: with_effects(Friction(0, 9, 0.1, velocity=INF)),
     f"{WHERE}, Friction, velocity: ", "inf m/s", "finite"),
    (ValueError, lambda: with_effects(Friction(0, 9, 0.3, 0.2)), f"{WHERE}, Friction: ",
     "static coefficient 0.2 < kinetic 0.3", MORE),
    (ValueError, lambda: with_effects(LuGre(0, 9, 0.3, 0.2, 0.1, 1e3)), f"{WHERE}, LuGre: ",
     "static coefficient 0.2 < kinetic 0.3", MORE),
    (ValueError, lambda: with_effects(LuGre(0, 9, 0.3, 0.4, 0.0, 1e3)),
     f"{WHERE}, LuGre, stribeck: ", "0 m/s", "positive"),
    (ValueError, lambda: with_effects(Contact(2, -5.0)), f"{WHERE}, Contact, stiffness: ",
     "-5 N/m", "positive", "check sign and unit"),
    (ValueError, lambda: with_effects(Contact(2, 5.0, -1.0)), f"{WHERE}, Contact, damping: ",
     "-1 N s/m", "not negative"),
    (ValueError, lambda: with_effects(Contact(2, 5.0, gap=NAN)), f"{WHERE}, Contact, gap: ",
     "nan m", "finite"),
    (TypeError, lambda: with_effects(Contact(2, "5")), f"{WHERE}, Contact, stiffness: ",
     "'5' is str", "give a float, a Param"),
    (ValueError, lambda: with_effects(Contact(2, 5.0, side=0)), f"{WHERE}, Contact: ", "side 0",
     "+1 (a floor) or -1 (a ceiling)"),
    (ValueError, lambda: with_effects(Impact(2, 0.5, side="floor")), f"{WHERE}, Impact: ",
     "side 'floor'", "+1 (a floor) or -1 (a ceiling)"),
    (ValueError, lambda: with_effects(Impact(2, 1.1)), f"{WHERE}, Impact, restitution: ", "1.1",
     "at most 1", "loses no energy"),
    (ValueError, lambda: with_effects(Impact(2, -0.1)), f"{WHERE}, Impact, restitution: ", "-0.1",
     "not negative"),
    (ValueError, lambda: with_effects(Plastic(0, 1.0, 0.0)), f"{WHERE}, Plastic, yield_force: ",
     "0 N", "positive"),
    (ValueError, lambda: with_effects(Plastic(0, 0.0, 1.0)), f"{WHERE}, Plastic, stiffness: ",
     "0 N/m", "positive"),
    (ValueError, lambda: with_effects(Plastic(0, 1.0, 1.0, -1.0)), f"{WHERE}, Plastic, kinematic: ",
     "-1 N/m", "not negative"),
    (ValueError, lambda: with_effects(rs.Maxwell(0, 1.0, 0.0)), f"{WHERE}, Maxwell, damping: ",
     "0 N s/m", "positive"),
    (ValueError, lambda: with_effects(rs.Cubic(0, INF)), f"{WHERE}, Cubic, cubic: ", "inf N/m3",
     "finite"),
    (TypeError, lambda: with_effects(rs.Cubic(0, 1j)), f"{WHERE}, Cubic, cubic: ", "complex",
     "give a float"),
    (ValueError, lambda: with_effects(Impact(6, 0.5)), f"{WHERE}, Impact: ", "axis 6", *AXIS),
    (ValueError, lambda: with_effects(Contact("x", 5.0)), f"{WHERE}, Contact: ", "axis 'x'", *AXIS),
    (ValueError, lambda: with_effects(Contact(-1, 5.0)), f"{WHERE}, Contact: ", "axis -1", *AXIS),
    (TypeError, lambda: with_effects(3.0), f"{WHERE}, effects: ", "3.0", "Contact(2, 1e5)"),
    (TypeError, lambda: with_effects(Contact), f"{WHERE}, effects: ", "<class", "Contact(2, 1e5)"),
    (TypeError, lambda: with_effects(rs.Event(1)), f"{WHERE}, effects: ", "Event(zero=1",
     "Contact(2, 1e5)"),
    (ValueError, lambda: with_effects(Contact(2, 5.0), Contact(2, 6.0)), f"{WHERE}: ",
     "two effects are called 'contact_z'", "give one a name"),
    (ValueError, lambda: with_effects(Contact(2, 5.0, name="a"), Impact(1, 0.5, name="a")),
     f"{WHERE}: ", "two effects are called 'a'", "give one a name"),
    (ValueError, lambda: with_effects(Contact(2, 5.0, name="a b")), f"{WHERE}, Contact: ", "'a b'",
     "identifier", "choose another"),
    (ValueError, lambda: with_effects(Friction(0, "nothing", 0.3)), f"{WHERE}, friction_x: ",
     "no effect 'nothing'", "before it are: none"),
    (ValueError, lambda: with_effects(Friction(0, "contact_z", 0.3), Contact(2, 5.0)),
     f"{WHERE}, friction_x: ", "no effect 'contact_z' before it", "before it are: none"),
    (ValueError, lambda: with_effects(Fracture()), f"{WHERE}, Fracture: ", "no limit",
     "a force, a torque or an energy"),
    (ValueError, lambda: with_effects(Fracture(force=0.0)), f"{WHERE}, Fracture, force: ", "0 N",
     "positive"),
    (ValueError, lambda: with_effects(Fracture(torque=-1.0)), f"{WHERE}, Fracture, torque: ",
     "-1 N m", "positive"),
    (ValueError, lambda: with_effects(Fracture(force=1.0), Contact(2, 5.0)), f"{WHERE}: ",
     "fracture", *ORDER),
    (ValueError, lambda: with_effects(Friction(0, 9.0, 0.3), Fracture(force=1.0)), f"{WHERE}: ",
     "fracture", *ORDER),
    (ValueError, lambda: with_effects(Table(0, [0, 1, 1], [0, 1, 2])), f"{WHERE}, Table: ",
     "(0.0, 1.0, 1.0)", "do not increase", "sort"),
    (ValueError, lambda: with_effects(Table(0, [0, 1], [0, 1, 2])), f"{WHERE}, Table: ",
     "2 strains and 3 forces", "as many forces", "at least two"),
    (ValueError, lambda: with_effects(Table(0, [0], [0])), f"{WHERE}, Table: ", "1 strains",
     "at least two"),
    (ValueError, lambda: with_effects(Table(0, [0, 1], [0, INF])), f"{WHERE}, Table: ", "finite"),
    (ValueError, lambda: rs.stops(0, 2.0, 1.0, 5.0), "stops: ", "lower 2.0", "upper 1.0",
     "exchange"),
    (ValueError, lambda: with_effects(*rs.stops(0, -1.0, 1.0, -5.0)),
     f"{WHERE}, Contact, stiffness: ", "-5 N/m", "positive"),
    (ValueError, lambda: model_of(Friction(0, 1.0, 0.3), body=massless()), f"{WHERE}: ",
     "friction_x stops or throws", *LACKS),
    (ValueError, lambda: model_of(Impact(0, 0.3), body=massless()), f"{WHERE}: ",
     "impact_x stops or throws", *LACKS),
    (ValueError, lambda: rs.simulate(model_of(Friction(0, 1.0, 0.3)), 1.0, rs.ExplicitRK()),
     "model 'bench': ", "1 algebraic unknowns", "ODEs only", "use Idas() or Rosenbrock()"),
    (ValueError, lambda: rs.simulate(model_of(Friction(0, 1.0, 0.3)), 1.0, rs.Dop853()),
     "model 'bench': ", "1 algebraic unknowns", "use Idas() or Rosenbrock()"),
])  # fmt: skip
def test_effects(row: tuple[Any, ...]) -> None:
    refused(*row)


def test_a_simulator_of_dop853_has_no_events(tmp_path: Path) -> None:
    words = ("model 'bench': ", "events", "Dop853", "give Rosenbrock() or ExplicitRK()")
    model = model_of(Impact(0, 0.3))
    refused(ValueError, lambda: rs.export_simulator(model, tmp_path / "out", rs.Dop853()), *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("effect", [
    Friction(0, 9.0, 0.0), Contact(2, 5.0, gap=-1.0), Impact(5, 1.0), Impact(0, 0.0, side=-1),
    rs.Cubic(0, -5.0), Plastic(3, 1.0, 1.0, isotropic=2.0), Friction(0, 0.0, 0.3, 0.3),
    Table(0, np.array([0, 1, 3]), (0, -1, 2)), Fracture(energy=1.0),
], ids=lambda effect: effect.text)  # fmt: skip
def test_what_is_at_the_edge_is_taken(effect: Any) -> None:
    assert with_effects(effect).effects == (effect,)


# Slips of kinds: wrong types, numbers that are Params, what two parts together forbid.

NUMBER = "give a float, a Param, an Input, TIME or an expression of them"
WIDTH = [
    (kind(*given, smoothing=value), type(value) is float)
    for kind, given in ((Friction, (0, 9.0, 0.3)), (Contact, (2, 5.0)), (Plastic, (0, 1.0, 1.0)),
                        (Fracture, (1.0,)))
    for value in (-1e-3, NAN, "a")
]  # fmt: skip


@table([
    (ValueError, lambda: zero(1.0), f"{EVENT}, zero: ", "1.0 is constant", "never crosses",
     "; ", "an Input"),
    (ValueError, lambda: zero(rs.Param("k", 1.0)), f"{EVENT}, zero: ", "k is constant in time"),
    (ValueError, lambda: model_of(Impact(0, 0.5, gap=9), data=[0.0], events=lambda *a: [
        rs.Event(a[4][0], name="impact_x_hits")]), f"{WHERE}, events: ", "impact_x_hits",
     "different names"),
    (ValueError, lambda: model_of(body=massless(), damping=[1] * 6, events=lambda *a: [
        rs.Event(a[1] - 1, 1, impulse=[1.0] * 6)]), f"{WHERE}: ", "event_0 throws", *LACKS[:3]),
    (ValueError, lambda: rs.Event(1, np.array([1, 2])), "Event: ", "direction array", "-1 falls"),
    (ValueError, lambda: rs.Event(1, 0, at_once=True), "Event: ", "at_once", "; ", "two events"),
    (TypeError, lambda: rs.Event(1, at_once="no"), "Event: ", "at_once 'no'", "True or False"),
    (TypeError, lambda: joint(data=None), f"{WHERE}, data: ", "None", "list of start values"),
    (TypeError, lambda: joint(data=[True]), f"{WHERE}, data: ", "True is bool", "plain numbers"),
    (TypeError, lambda: joint(effects=3.0), f"{WHERE}, effects: ", "3.0", "Contact(2, 1e5)"),
    (TypeError, lambda: joint(effects=None), f"{WHERE}, effects: ", "None", "Contact(2, 1e5)"),
    (ValueError, lambda: with_effects(Contact(1.0, 5.0)), f"{WHERE}, Contact: ", "axis 1.0", *AXIS),
    (ValueError, lambda: with_effects(Contact(True, 5.0)), f"{WHERE}, Contact: ", "axis True",
     *AXIS),
    *((ValueError if number else TypeError, lambda e=effect: with_effects(e),
       f"{WHERE}, {type(effect).__name__}, smoothing: ", str(effect.smoothing))
      for effect, number in WIDTH),
    (TypeError, lambda: with_effects(Friction(0, None, 0.3)), f"{WHERE}, Friction, normal: ",
     "None", NUMBER),
    (TypeError, lambda: with_effects(Friction(0, 9.0, None)), f"{WHERE}, Friction, kinetic: ",
     "None", NUMBER),
    (TypeError, lambda: with_effects(Contact(0, None)), f"{WHERE}, Contact, stiffness: ", "None",
     NUMBER),
    (ValueError, lambda: with_effects(Friction(0, 9, 0.3, rs.Param("s", 0.2))),
     f"{WHERE}, Friction: ", "static coefficient 0.2 < kinetic 0.3", MORE),
    (ValueError, lambda: with_effects(Impact(0, rs.Param("e", 1.1))),
     f"{WHERE}, Impact, restitution: ", "1.1", "at most 1"),
    (ValueError, lambda: with_effects(Friction(0, 9, -0.1)), f"{WHERE}, Friction, kinetic: ",
     "-0.1; it is not negative"),
    (ValueError, lambda: with_effects(Contact(4, -5.0)), f"{WHERE}, Contact, stiffness: ",
     "-5 N m/rad", "positive"),
    (ValueError, lambda: with_effects(Contact(2, NAN)), f"{WHERE}, Contact, stiffness: ",
     "nan N/m", "finite"),
    (ValueError, lambda: Table(0, ["a", 1], [0, 1]), "Table, strain: ", "'a' is str"),
    (TypeError, lambda: Table(0, 1.0, 2.0), "Table, strain: ", "1.0", "give a list"),
    (TypeError, lambda: Table(0, [0, rs.Param("a", 1.0)], [0, 1]), "Table, strain: ", "plain"),
    (ValueError, lambda: with_effects(Table(0, [0, NAN], [0, 1])), f"{WHERE}, Table: ", "nan"),
    (TypeError, lambda: rs.stops(0, "a", 1.0, 5.0), "stops: ", "lower 'a'", "; "),
    (ValueError, lambda: rs.stops(0, 1.0, 1.0, 5.0), "stops: ", "lower 1", "; ", "apart"),
    (ValueError, lambda: model_of(Friction(0, 1.0, 0.3), Friction(0, 2.0, 0.3, name="g")),
     f"{WHERE}: ", "friction_x", "g", "both hold"),
    (ValueError, lambda: model_of(Fracture(energy=1.0), force=lambda *a: [a[3][0]] + [0] * 5),
     f"{WHERE}: ", "fracture", "energy", "user force"),
    (TypeError, lambda: compiled(connectors=[joint(
        force=lambda a, b, c, d, e, f, g, h, i, j, k, l, m: [0] * 6)]), f"{WHERE}, force: ",
     "13 arguments", "data"),
    (ValueError, lambda: rs.simulate(stepping(lambda *a: [0, -1, a[4][0]]), 1, rs.ExplicitRK()),
     "model 'bench': ", "ExplicitRK"),
])  # fmt: skip
def test_slips(row: tuple[Any, ...]) -> None:
    refused(*row)
