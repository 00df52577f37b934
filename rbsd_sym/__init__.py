"""Scenes of rigid bodies and 6-DOF spring-dampers as exact symbolic models.

The file to read first is `pipeline.py`.
"""

from . import plots, study
from .elements import GROUND, Load, Marker, RigidBody, RigidBodySpringDamper
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
from .integrators import Dop853, ExplicitRK, Idas, Rosenbrock
from .laws import Consistent, Intrinsic, Standard
from .model import Model
from .pipeline import IntegrationError, compile_scene, simulate
from .scene import Scene
from .symbols import TIME, Input, Param, where
from .trajectory import Outcome, Trajectory
from .version import VERSION as __version__

__all__ = [
    "GROUND",
    "TIME",
    "Artefact",
    "CompilerMissing",
    "Consistent",
    "Dop853",
    "ExplicitRK",
    "Idas",
    "Input",
    "IntegrationError",
    "Intrinsic",
    "Library",
    "Load",
    "Marker",
    "Model",
    "ModelWarning",
    "Outcome",
    "Param",
    "Quaternion",
    "RigidBody",
    "RigidBodySpringDamper",
    "Rosenbrock",
    "Scene",
    "Simulator",
    "Standard",
    "TaitBryan",
    "Trajectory",
    "__version__",
    "compile_scene",
    "compiled",
    "export_c",
    "export_simulator",
    "load_c",
    "load_simulator",
    "plots",
    "simulate",
    "study",
    "where",
]
