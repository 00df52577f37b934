"""Scenes of rigid bodies and 6-DOF spring-dampers as exact symbolic models.

The file to read first is `pipeline.py`.
"""

from . import ocp, plots, study
from .analysis.equilibrium import EquilibriumError, static_equilibrium
from .analysis.linearize import linearize
from .analysis.sensitivity import sensitivity
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
from .model.trajectory import Outcome, Trajectory
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
    "EquilibriumError",
    "Event",
    "ExplicitRK",
    "Fracture",
    "Friction",
    "GeneralizedAlpha",
    "Idas",
    "Impact",
    "Input",
    "IntegrationError",
    "Intrinsic",
    "Library",
    "Load",
    "LuGre",
    "Marker",
    "Maxwell",
    "Model",
    "ModelWarning",
    "Outcome",
    "Param",
    "Plastic",
    "PostNewton",
    "Quaternion",
    "RigidBody",
    "RigidBodySpringDamper",
    "Rosenbrock",
    "Scene",
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
    "linearize",
    "load_c",
    "load_simulator",
    "ocp",
    "plots",
    "sensitivity",
    "simulate",
    "static_equilibrium",
    "stops",
    "study",
    "where",
]
