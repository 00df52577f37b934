"""Scenes of rigid bodies and 6-DOF spring-dampers as exact symbolic models.

A scene is written once. From it come CasADi functions with exact derivatives, simulations, C code,
equilibria and linear models, and optimal control:

    import rbsd_sym as rs

    arm = rs.RigidBody("arm", mass=2, inertia=(0.1, 0.2, 0.3), position=(0.5, 0, 0))
    joint = rs.RigidBodySpringDamper(
        "joint", rs.Marker(rs.GROUND), rs.Marker("arm", (-0.5, 0, 0)), stiffness=[1e4] * 6
    )
    model = rs.compile_scene(rs.Scene("swing", [arm], [joint], gravity=(0, 0, -9.81)))
    trajectory = rs.simulate(model, 2.0)
    trajectory["arm.position"]          # (n, 3), m

Units are SI. Studies of many runs are in `rs.study`, figures in `rs.plots`, optimal control in
`rs.ocp`. Of the source, read `pipeline.py` first; `README.md` in this folder is the map.
"""

from . import ocp, plots, study
from .analysis.equilibrium import Equilibrium, EquilibriumError, static_equilibrium
from .analysis.floquet import Floquet, NotPeriodic, floquet
from .analysis.linearize import Linear, linearize
from .analysis.sensitivity import Sensitivity, sensitivity
from .base.symbols import TIME, Input, Param, where
from .exports import (
    Artefact,
    CompilerMissing,
    Library,
    Simulator,
    compiled,
    export_c,
    export_simulator,
    load_c,
    load_simulator,
)
from .formulations import ModelWarning, Quaternion, TaitBryan
from .integrators import (
    RK4,
    Collocation,
    Dop853,
    ExplicitRK,
    GeneralizedAlpha,
    Idas,
    PostNewton,
    Rosenbrock,
)
from .laws import (
    Consistent,
    Contact,
    Cubic,
    Fracture,
    Friction,
    Impact,
    Intrinsic,
    LuGre,
    Maxwell,
    Plastic,
    Standard,
    Table,
    stops,
)
from .model.model import Model
from .model.signals import Inputs
from .model.trajectory import Outcome, Trajectory
from .model.values import Point, locate
from .pipeline import IntegrationError, compile_scene, simulate
from .scene.elements import GROUND, Load, Marker, RigidBody, RigidBodySpringDamper
from .scene.functions import Event
from .scene.scene import Scene
from .version import VERSION as __version__

__all__ = [
    "GROUND",
    "RK4",
    "TIME",
    "Artefact",
    "Collocation",
    "CompilerMissing",
    "Consistent",
    "Contact",
    "Cubic",
    "Dop853",
    "Equilibrium",
    "EquilibriumError",
    "Event",
    "ExplicitRK",
    "Floquet",
    "Fracture",
    "Friction",
    "GeneralizedAlpha",
    "Idas",
    "Impact",
    "Input",
    "Inputs",
    "IntegrationError",
    "Intrinsic",
    "Library",
    "Linear",
    "Load",
    "LuGre",
    "Marker",
    "Maxwell",
    "Model",
    "ModelWarning",
    "NotPeriodic",
    "Outcome",
    "Param",
    "Plastic",
    "Point",
    "PostNewton",
    "Quaternion",
    "RigidBody",
    "RigidBodySpringDamper",
    "Rosenbrock",
    "Scene",
    "Sensitivity",
    "Simulator",
    "Standard",
    "Table",
    "TaitBryan",
    "Trajectory",
    "__version__",
    "compile_scene",
    "compiled",
    "export_c",
    "export_simulator",
    "floquet",
    "linearize",
    "load_c",
    "load_simulator",
    "locate",
    "ocp",
    "plots",
    "sensitivity",
    "simulate",
    "static_equilibrium",
    "stops",
    "study",
    "where",
]
