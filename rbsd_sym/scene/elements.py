"""The checked elements of a scene: bodies, markers, connectors, loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base import checks
from ..base.names import check_identifier
from ..base.symbols import Input, Leaf, Param, Scalar, is_number, leaves_of
from ..laws import AXES, Effect, Law, Own, Standard, value_at_default

GROUND = "ground"
"""The world as a body: `Marker(GROUND, position)`."""

Numbers = Any
_ZERO3 = (0.0, 0.0, 0.0)
_EYE3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _set(instance: object, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(instance, name, value)


@dataclass(frozen=True, eq=False)
class RigidBody:
    """A rigid body and its start.

    Arguments:
        name: identifier, unique in the scene.
        mass: kg. Mass and inertia may be Params, but do not vary in time.
        inertia: about the centre of mass, body axes, kg m2: 3x3, 3 principal values, or
            6 values (Ixx, Iyy, Izz, Iyz, Ixz, Ixy).
        com: centre of mass in body axes, from the body frame's origin, m.
        position, velocity: of the body frame's origin, world axes, m and m/s.
        rotation: body to world, 3x3 or unit quaternion (w, x, y, z).
        angular_velocity: body axes, rad/s.
        show, size, color: drawing only; size is the box (x, y, z) in m.

    Raises:
        ValueError, TypeError: a number of wrong shape, not finite, or impossible for a body.
    """

    name: str
    mass: Numbers
    inertia: Numbers
    com: Numbers = _ZERO3
    position: Numbers = _ZERO3
    rotation: Numbers = _EYE3
    velocity: Numbers = _ZERO3
    angular_velocity: Numbers = _ZERO3
    show: bool = True
    size: Sequence[float] | None = None
    color: Any = None

    def __repr__(self) -> str:
        return f"<RigidBody '{self.name}'>"

    def __post_init__(self) -> None:
        check_identifier(self.name, "body")
        where = f"body '{self.name}'"
        if self.name == GROUND:
            raise ValueError(f"{where}: the name is taken by the world; choose another")
        mass = checks.numbers(self.mass, (), f"{where}, mass", "kg")
        massless = is_number(self.inertia) and not isinstance(self.inertia, Scalar)
        inertia = checks.inertia(
            np.zeros((3, 3)) if massless and self.inertia == 0 else self.inertia, where
        )
        _check_mass(where, mass, inertia)
        _set(
            self,
            show=_flag(self.show, f"{where}, show"),
            mass=mass[()],
            inertia=inertia,
            com=checks.numbers(self.com, (3,), f"{where}, com", "m"),
            position=checks.numbers(self.position, (3,), f"{where}, position", "m"),
            rotation=checks.rotation(self.rotation, f"{where}, rotation"),
            velocity=checks.numbers(self.velocity, (3,), f"{where}, velocity", "m/s"),
            angular_velocity=checks.numbers(
                self.angular_velocity, (3,), f"{where}, angular_velocity", "rad/s"
            ),
        )
        for name in (
            "mass",
            "inertia",
            "com",
            "position",
            "rotation",
            "velocity",
            "angular_velocity",
        ):
            varying = _varying(getattr(self, name))
            if varying:
                raise ValueError(
                    f"{where}, {name}: depends on '{varying[0].name}', which varies in time; mass "
                    "properties and start values are constant; use a Param"
                )


def _check_mass(where: str, mass: np.ndarray, inertia: np.ndarray) -> None:
    value = float(checks.at_default(mass))
    if value < 0:
        raise ValueError(f"{where}: mass {value} kg; it is positive (or 0 without inertia)")
    if value == 0 and np.any(checks.at_default(inertia) != 0):
        raise ValueError(f"{where}: mass 0 kg with inertia; give a mass, or inertia=0")


@dataclass(frozen=True, eq=False)
class Marker:
    """A frame carried by a body, or fixed to the ground.

    Arguments:
        body: a body, its name, or GROUND.
        position: from the body frame's origin, body axes, m.
        rotation: marker to body, 3x3 or unit quaternion.

    A marker may be driven by TIME: its velocity is then the exact derivative. One driven by an
    Input moves without velocity, since the rate of an Input is not known.
    """

    body: str
    position: Numbers = _ZERO3
    rotation: Numbers = _EYE3

    if TYPE_CHECKING:  # a body is accepted, its name is kept

        def __init__(
            self, body: str | RigidBody, position: Numbers = ..., rotation: Numbers = ...
        ) -> None: ...

    def __post_init__(self) -> None:
        if isinstance(self.body, RigidBody):
            _set(self, body=self.body.name)
        if not isinstance(self.body, str):
            raise TypeError(
                f"marker: body {self.body!r}; give a body, its name, or rbsd_sym.GROUND"
            )
        where = f"marker on '{self.body}'"
        _set(
            self,
            position=checks.numbers(self.position, (3,), f"{where}, position", "m"),
            rotation=checks.rotation(self.rotation, f"{where}, rotation"),
        )


@dataclass(frozen=True, eq=False)
class RigidBodySpringDamper:
    """A 6-DOF spring-damper between two markers (bushing).

    Arguments:
        name: identifier, unique in the scene.
        marker0, marker1: the two markers.
        stiffness, damping: 6x6 (or 6 numbers, the diagonal), translation first; N/m, N m/rad and
            N s/m, N m s/rad. Zero by default.
        offset: 6 numbers, the strain at which the spring exerts no force, m and rad; with
            an Input it is a servo.
        velocity_offset: 6 numbers, the rate without damping force, m/s and rad/s.
        rotation_marker0, rotation_marker1: joint frame to marker; A_i = R_body R_marker R_joint.
        law: `Standard()`, `Intrinsic()` or `Consistent()`.
        force: user function (mbs, t, item, displacement, rotation, velocity, angular_velocity,
            stiffness, damping, rotJ0, rotJ1, offset) -> 6 numbers, called once with symbols. `mbs`
            reads the scene (`scene.mbs.Mbs`), item is the connector's index; stiffness, damping,
            rotJ0, rotJ1 (rotation_marker0 and 1, 3x3) and offset are copies. The joint frames to
            world A_0 and A_1 are mbs.frame_to_world(item, 0) and (item, 1). It replaces the linear
            force. If it takes 13 arguments, data comes after item.
        data: start values of data states, `<name>.data_0` ...: constant but for events and
            post_newton_step.
        post_newton_step: user function with the arguments of force and data after item -> [error,
            recommended step, data...]; see `integrators.post_newton` for what is made of it.
        events: user function with the same arguments -> list of `Event`.
        effects: laws along one axis, or on the whole, added to the wrench: `Contact`, `Friction`,
            `Plastic`, `Fracture`, ... Their states are `<name>.<effect>_<state>`, their forces the
            outputs `<name>.<effect>`, such as `floor.contact_z`.
        active: False gives no force and costs nothing. A Param, an expression of Params, or an
            Input switches the connector, which is on above 0.5. While off it gives no force and
            stores no energy, none of its events happen, and its states keep their values; strain
            and rate are measured. An Input switches it by the event `<name>.switches`,
            which keeps the data state `<name>.active`, 1 or 0.
        show, draw_size, color: drawing only; draw_size is the spring's diameter, m. None, and the
            documented -1 and (-1, -1, -1, -1), mean the default.

    Outputs are also available under their documented names: `<name>.ForceLocal` is
    `<name>.force_local`.
    """

    name: str
    marker0: Marker
    marker1: Marker
    stiffness: Numbers = 0
    damping: Numbers = 0
    offset: Numbers = 0
    velocity_offset: Numbers = 0
    rotation_marker0: Numbers = _EYE3
    rotation_marker1: Numbers = _EYE3
    law: Law = field(default_factory=Standard)
    force: Callable[..., Any] | None = None
    post_newton_step: Callable[..., Any] | None = None
    data: Sequence[float] = ()
    active: Any = True
    show: bool = True
    draw_size: float | None = None
    color: Any = None
    effects: Sequence[Effect] = ()
    events: Callable[..., Any] | None = None

    def __repr__(self) -> str:
        return f"<RigidBodySpringDamper '{self.name}'>"

    def __post_init__(self) -> None:
        check_identifier(self.name, "connector")
        where = f"connector '{self.name}'"
        for name in ("marker0", "marker1"):
            if not isinstance(getattr(self, name), Marker):
                raise TypeError(f"{where}: {name} is {getattr(self, name)!r}; give a Marker")
        if isinstance(self.law, type) or not hasattr(self.law, "relative"):
            raise TypeError(f"{where}: law {self.law!r}; give a law object, such as Consistent()")
        for name in ("force", "post_newton_step", "events"):
            function = getattr(self, name)
            if function is not None and not callable(function):
                raise TypeError(f"{where}: {name} {function!r}; give a function")
        stiffness = checks.matrix6(self.stiffness, f"{where}, stiffness")
        if self.law.needs_symmetric_stiffness:
            _check_symmetric(stiffness, f"{where}, stiffness")
        active = _active(self.active, where)
        effects = _effects(self.effects, where)
        _check_switch(active, effects, where)
        for effect in effects:
            if self.force is not None and effect.needs_potential:
                raise ValueError(
                    f"{where}: {effect.label} breaks at an energy, but of a user force no energy "
                    "is known; give a force or torque limit"
                )
        _set(
            self,
            data=_data(self.data, where),
            active=active,
            show=_flag(self.show, f"{where}, show"),
            draw_size=None if _is_default(self.draw_size, ()) else self.draw_size,
            color=None if _is_default(self.color, (4,)) else self.color,
            effects=effects,
            stiffness=stiffness,
            damping=checks.matrix6(self.damping, f"{where}, damping"),
            offset=checks.vector6(self.offset, f"{where}, offset"),
            velocity_offset=checks.vector6(self.velocity_offset, f"{where}, velocity_offset"),
            rotation_marker0=checks.rotation(self.rotation_marker0, f"{where}, rotation_marker0"),
            rotation_marker1=checks.rotation(self.rotation_marker1, f"{where}, rotation_marker1"),
        )

    @property
    def idle(self) -> bool:
        """Whether it never acts."""
        return self.active is False

    @property
    def switched(self) -> bool:
        """Whether a number decides if it acts."""
        return isinstance(self.active, Scalar)

    @property
    def switches(self) -> bool:
        """Whether that number may change during a run."""
        return self.switched and bool(_varying(self.active))

    @property
    def acts(self) -> bool:
        """Whether it may act and touches a body."""
        return not self.idle and not self.marker0.body == self.marker1.body == GROUND

    @property
    def own(self) -> tuple[Own, ...]:
        """Its data and internal states, named within the connector."""
        data = [Own(f"data_{i}", start=float(v), data=True) for i, v in enumerate(self.data)]
        of_effects = [o._replace(name=f"{e.label}_{o.name}") for e in self.effects for o in e.own]
        switch = [Own("active", start=float(value_at_default(self.active) > 0.5), data=True)]
        return (*data, *of_effects, *(switch if self.switches else ())) if self.acts else ()

    @property
    def unknowns(self) -> tuple[Own, ...]:
        """Its unknown forces, named within the connector."""
        named = [o._replace(name=f"{e.label}_{o.name}") for e in self.effects for o in e.unknowns]
        return tuple(named) if self.acts else ()


def _flag(value: Any, where: str) -> bool:
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{where}: {value!r} is {type(value).__name__}; give True or False")
    return bool(value)


def _is_default(value: Any, shape: tuple[int, ...]) -> bool:
    """Whether it is the documented -1, or a colour that begins with -1."""
    try:
        numbers = np.array(value, float)
    except (TypeError, ValueError):
        return False
    return numbers.shape == shape and bool(numbers.reshape(-1)[0] == -1)


def _active(value: Any, where: str) -> bool | Scalar:
    # A condition in Inputs or TIME jumps, and has no crossing that a search for events could find.
    if isinstance(value, Scalar) and (isinstance(value, Input) or not _varying(value)):
        return value
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(
            f"{where}, active: {value!r} is {type(value).__name__}; give True or False, or a "
            "Param, an expression of Params, or an Input, which is on above 0.5; for a condition "
            "give an Input, and its value over time with the run"
        )
    return bool(value)


def _varying(value: Any) -> list[Leaf]:
    return sorted(
        (leaf for leaf in leaves_of(value) if not isinstance(leaf, Param)), key=lambda v: v.name
    )


def _check_switch(active: bool | Scalar, effects: Sequence[Effect], where: str) -> None:
    """What holds remembers which way it slid, and would not know after a time without force."""
    varying = _varying(active)
    holding = [effect.label for effect in effects if effect.unknowns]
    if varying and holding:
        raise ValueError(
            f"{where}, active: depends on '{varying[0].name}', which varies in time, but "
            f"{holding[0]} holds exactly; give it smoothing, or switch by a Param"
        )


def _data(data: Any, where: str) -> np.ndarray:
    if is_number(data):
        raise ValueError(f"{where}, data: {data!r}; give a list of start values, such as [0.0]")
    if data is None:
        raise TypeError(f"{where}, data: None; give a list of start values, such as [0.0]")
    count = len(data)
    for value in data:
        if isinstance(value, bool):
            raise TypeError(f"{where}, data: {value} is bool; start values are plain numbers")
    values = checks.numbers(data, (count,), f"{where}, data") if count else np.zeros(0)
    if checks.is_symbolic(values):
        raise ValueError(f"{where}, data: {list(values)}; start values of data are plain numbers")
    return values


def _effects(effects: Any, where: str) -> tuple[Effect, ...]:
    """The effects, checked, with names that differ and those on the whole at the end."""
    if not isinstance(effects, (Effect, Sequence)):
        raise TypeError(f"{where}, effects: {effects!r}; give effects such as Contact(2, 1e5)")
    found = (effects,) if isinstance(effects, Effect) else tuple(effects)
    names: list[str] = []
    for effect in found:
        if not isinstance(effect, Effect):
            raise TypeError(f"{where}, effects: {effect!r}; give effects such as Contact(2, 1e5)")
        effect.check(where)
        if effect.label in names:
            raise ValueError(f"{where}: two effects are called '{effect.label}'; give one a name")
        normal = getattr(effect, "normal", None)
        if isinstance(normal, str) and normal not in names:
            raise ValueError(
                f"{where}, {effect.label}: no effect '{normal}' before it; before it are: "
                f"{', '.join(names) or 'none'}"
            )
        names.append(effect.label)
    _check_holds(found, where)
    wholes = [effect for effect in found if effect.whole]
    if wholes and (found[-len(wholes) :] != tuple(wholes) or any(e.unknowns for e in found)):
        raise ValueError(
            f"{where}: {wholes[0].label} acts on the whole wrench; it comes after the other effects"
            ", and friction that holds exactly belongs to a connector of its own"
        )
    return found


def _check_holds(effects: Sequence[Effect], where: str) -> None:
    holding: dict[int, str] = {}
    for effect in effects:
        axis = getattr(effect, "axis", -1)
        if effect.unknowns and axis in holding:
            raise ValueError(
                f"{where}: {holding[axis]} and {effect.label} both hold the motion along "
                f"'{AXES[axis]}', and nothing tells how they share the load; use smoothing"
            )
        if effect.unknowns:
            holding[axis] = effect.label


def _check_symmetric(matrix: np.ndarray, where: str) -> None:
    largest = max((abs(v) for v in matrix.flat if not isinstance(v, Scalar)), default=0.0)
    for i in range(6):
        for j in range(i):
            a, b = matrix[i, j], matrix[j, i]
            if isinstance(a, Scalar) or isinstance(b, Scalar):
                same = repr(a) == repr(b)
            else:
                same = abs(a - b) <= 1e-12 * largest
            if not same:
                raise ValueError(
                    f"{where}: entry ({i}, {j}) is {a}, ({j}, {i}) is {b}; this law derives its "
                    "force from an energy and needs a symmetric matrix; use (K + K')/2, or another "
                    "law"
                )


@dataclass(frozen=True, eq=False)
class Load:
    """A force (N) and a torque (N m) at a marker, in world axes or in the axes of its body."""

    name: str
    marker: Marker
    force: Numbers = _ZERO3
    torque: Numbers = _ZERO3
    frame: str = "world"

    def __repr__(self) -> str:
        return f"<Load '{self.name}'>"

    def __post_init__(self) -> None:
        check_identifier(self.name, "load")
        where = f"load '{self.name}'"
        if not isinstance(self.marker, Marker):
            raise TypeError(f"{where}: marker is {self.marker!r}; give a Marker")
        if self.frame not in ("world", "body"):
            raise ValueError(f"{where}: frame {self.frame!r}; it is 'world' or 'body'")
        _set(
            self,
            force=checks.numbers(self.force, (3,), f"{where}, force", "N"),
            torque=checks.numbers(self.torque, (3,), f"{where}, torque", "N m"),
        )
