"""The scenes of the speed charts, ours and as the peers (`oracles.scenes`, Exudyn) read them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from oracles import scenes
from oracles.rotations import Array, cross, from_quaternion
from paths import MODELS

import rbsd_sym as rs
from rbsd_sym.__main__ import load_model_file
from rbsd_sym.base.checks import at_default
from scenes import massless, published, reference

Wrenches = Callable[[float, Array], tuple[Array, Array]]


class Case(NamedTuple):
    """One scene of the charts.

    Fields:
        peer: the scene as `oracles.scenes` has it (`com` of each body beyond its format), or None.
        beside: force and moment about the centre of mass on each body (n, 3), world axes, of what
            the oracle's format does not hold, at (t, state).
        exudyn: whether Exudyn can run it; `point_springs` in `peer` are for it.
        note: what is to be known of the scene.
    """

    scene: rs.Scene
    t_end: float
    peer: dict[str, Any] | None = None
    beside: Wrenches | None = None
    exudyn: bool = True
    note: str = ""


def peer_of(scene: rs.Scene, law: str = "standard") -> dict[str, Any]:
    """A scene of bodies and plain connectors in the oracle's format, Params at their defaults."""
    plain: Any = lambda value: np.array(at_default(value), float)  # noqa: E731
    bodies, place = [], {rs.GROUND: scenes.GROUND}
    for i, body in enumerate(scene.bodies):
        place[body.name] = i
        R, com, w_B = plain(body.rotation), plain(body.com), plain(body.angular_velocity)
        bodies.append({
            "mass": float(plain(body.mass)), "inertia": plain(body.inertia), "com": com,
            "position": plain(body.position) + R @ com, "rotation": R, "angular_velocity": w_B,
            "velocity": plain(body.velocity) + R @ np.cross(w_B, com),
        })  # fmt: skip
    connectors = []
    for c in scene.connectors:
        if c.force is not None:
            continue
        own: dict[str, Any] = {key: plain(getattr(c, key))
                               for key in ("stiffness", "damping", "offset")}  # fmt: skip
        for end, marker, turn in ((0, c.marker0, c.rotation_marker0),
                                  (1, c.marker1, c.rotation_marker1)):  # fmt: skip
            i = place[marker.body]
            com = np.zeros(3) if i == scenes.GROUND else bodies[i]["com"]
            own |= {f"body{end}": i, f"position{end}": plain(marker.position) - com,
                    f"rotation_marker{end}": plain(marker.rotation) @ plain(turn)}  # fmt: skip
        connectors.append(own)
    return {"gravity": plain(scene.gravity), "law": law, "bodies": bodies,
            "connectors": connectors}  # fmt: skip


def _reference(name: str) -> Case:
    scene = reference.build(name)
    return Case(scene, reference.data(name)["t_end"], peer_of(scene))


def _mini() -> Case:
    scene = published.mini()
    return Case(scene, 1.0, peer_of(scene))


def stiff(factor: float) -> Case:
    """The body of `single`, its stiffness times a factor but for one slow axis, damping 1e-4 s."""
    data = reference.SCENES["single"]
    start = {key: data["bodies"][0][key]
             for key in ("position", "velocity", "angular_velocity")}  # fmt: skip
    body = rs.RigidBody("b0", 2.0, (0.1, 0.2, 0.3), **start)
    joint = np.eye(3)[:, [1, 2, 0]]  # its z is x of the body
    K = np.array([5000.0, 7000.0, 4000.0, 500.0, 325.0, 0.0]) * factor + [0, 0, 0, 0, 0, 250.0]
    markers = rs.Marker(rs.GROUND, rotation=joint), rs.Marker("b0", (0.1, -0.2, 0.05), joint)
    spring = rs.RigidBodySpringDamper("c0", *markers, K, 1e-4 * K)
    name = f"stiff1e{round(math.log10(factor))}"
    scene = rs.Scene(name, [body], [spring], gravity=data["gravity"])
    note = (
        f"The body of `single`; stiffness times {factor:g} but for the rotation about x, damping "
        "1e-4 s times stiffness. The joint frames are turned so that the slow axis is their z, the "
        "only one about which `Standard` is a valid hinge. The start is that of `single`: its "
        "velocity against the stiff axes is a fast transient, which every method has to resolve."
    )
    return Case(scene, 1.0, peer_of(scene), note=note)


def _engine_mounts() -> Case:
    """The unbalance as a function of time in the scene, so that exported simulators have it."""
    scene = load_model_file(MODELS / "engine_mounts.py").scene()
    shake = 400.0 * np.sin(2 * math.pi * 12.0 * rs.TIME)
    load = replace(scene.loads[0], force=(0, 0.3 * shake, shake))
    arm = np.array([0.1, 0.0, 0.1]) - np.array(scene.bodies[0].com, float)

    def unbalance(t: float, state: Array) -> tuple[Array, Array]:
        pull = 400.0 * math.sin(2 * math.pi * 12.0 * t)
        f = np.array([[0.0, 0.3 * pull, pull]])
        return f, cross(from_quaternion(state[0, 3:7]) @ arm, f[0])[None, :]

    note = "Law `Consistent`, which Exudyn does not have."
    return Case(replace(scene, loads=[load]), 1.0, peer_of(scene, "consistent"), unbalance,
                exudyn=False, note=note)  # fmt: skip


def _bricard() -> Case:
    scene = published.bricard()
    return Case(scene, 0.5, peer_of(scene), note="Hinges of 1e6 N/m and 1e4 N m/rad, undamped.")


def _governor() -> Case:
    """Its two point spring-dampers are user forces here, and objects of their own in Exudyn."""
    scene = published.governor()
    peer = peer_of(scene)
    springs = [
        {"body0": 1, "position0": [0.05 * side, 0.0, 0.0], "body1": 2 + i,
         "position1": -peer["bodies"][2 + i]["com"], "stiffness": 4000.0, "damping": 200.0,
         "length": 0.5}
        for i, side in enumerate((1, -1))
    ]  # fmt: skip

    def pulls(t: float, state: Array) -> tuple[Array, Array]:
        force, moment = np.zeros((2, len(state), 3))
        for s in springs:
            ends = [scenes.marker_pose(state, s, end) for end in (0, 1)]
            d, rate = ends[1].p - ends[0].p, ends[1].v - ends[0].v
            length = np.linalg.norm(d)
            pull = (4000.0 * (length - 0.5) + 200.0 * (d @ rate) / length) * d / length
            for i, at, f in ((s["body0"], ends[0].p, pull), (s["body1"], ends[1].p, -pull)):
                force[i] += f
                moment[i] += cross(at - state[i, :3], f)
        return force, moment

    note = "Two undamped modes of 2.8e4 rad/s beside the slow motion."
    return Case(scene, 1.0, peer | {"point_springs": springs}, pulls, note=note)


def _stick_slip() -> Case:
    scene = load_model_file(MODELS / "stick_slip.py").scene()
    note = "A block on a belt: five events. Peers would need a switch of their own; none is run."
    return Case(scene, 10.0, note=note)


def _massless() -> Case:
    scene = replace(massless.linked(0.0, massless.UNDAMPED), name="massless")
    note = "A massless link between two springs: algebraic unknowns. The peers want a mass."
    return Case(scene, 0.5, note=note)


CASES: dict[str, Callable[[], Case]] = {
    "mini": _mini,
    **{name: partial(_reference, name) for name in ("single", "coupled", "chain16", "chain256")},
    "stiff1e3": partial(stiff, 1e3), "stiff1e6": partial(stiff, 1e6),
    "engine_mounts": _engine_mounts, "governor": _governor, "bricard": _bricard,
    "stick_slip": _stick_slip, "massless": _massless,
}  # fmt: skip


def rates(case: Case, t: float, state: Array) -> Array:
    """Rates of the oracle's state (n, 13), with what its format does not hold."""
    out = scenes.rates(case.peer, state)  # type: ignore[arg-type]
    if case.beside is not None and case.peer is not None:
        force, moment = case.beside(t, state)
        for i, body in enumerate(case.peer["bodies"]):
            R = from_quaternion(state[i, 3:7])
            out[i, 7:10] += force[i] / body["mass"]
            out[i, 10:13] += np.linalg.solve(body["inertia"], R.T @ moment[i])
    return out
