"""residyn: fit a braked arm from its recordings, see where the model fails, and mend it.

Names are imported when they are first used, so that the command answers `--help` at once.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .ahead import set_up as set_up
    from .bearings import AirBearing as AirBearing
    from .bearings import with_bearings as with_bearings
    from .bearings import without_bearings as without_bearings
    from .diagnosis import Comparison as Comparison
    from .diagnosis import Diagnosis as Diagnosis
    from .diagnosis import compare as compare
    from .diagnosis import diagnose as diagnose
    from .effects import CATALOGUE as CATALOGUE
    from .effects import AbstractEffect as AbstractEffect
    from .effects import AsymmetricDamping as AsymmetricDamping
    from .effects import AsymmetricStiffness as AsymmetricStiffness
    from .effects import BearingDrag as BearingDrag
    from .effects import BearingFriction as BearingFriction
    from .effects import BearingQuadraticDrag as BearingQuadraticDrag
    from .effects import BrakeSlip as BrakeSlip
    from .effects import ConstantTorque as ConstantTorque
    from .effects import CoulombFriction as CoulombFriction
    from .effects import CouplingDamping as CouplingDamping
    from .effects import CouplingStiffness as CouplingStiffness
    from .effects import CubicStiffness as CubicStiffness
    from .effects import Damper as Damper
    from .effects import DeadZone as DeadZone
    from .effects import Gravity as Gravity
    from .effects import Hysteresis as Hysteresis
    from .effects import InertiaError as InertiaError
    from .effects import JointEffect as JointEffect
    from .effects import PeriodicDisturbance as PeriodicDisturbance
    from .effects import PrintedInertiaTorque as PrintedInertiaTorque
    from .effects import QuadraticDrag as QuadraticDrag
    from .effects import SensorDelay as SensorDelay
    from .effects import SensorOffset as SensorOffset
    from .effects import SensorScale as SensorScale
    from .effects import Spring as Spring
    from .effects import StiffnessDrift as StiffnessDrift
    from .effects import StribeckFriction as StribeckFriction
    from .effects import WristFlexibility as WristFlexibility
    from .effects import adopt as adopt
    from .effects import load_effects as load_effects
    from .fitting import Bootstrap as Bootstrap
    from .fitting import Embedded as Embedded
    from .fitting import Fit as Fit
    from .fitting import FitError as FitError
    from .fitting import Race as Race
    from .fitting import Solution as Solution
    from .fitting import bootstrap as bootstrap
    from .fitting import embed as embed
    from .fitting import fit as fit
    from .fitting import fit_many as fit_many
    from .fitting import race as race
    from .integrators import Integrator as Integrator
    from .mechanism import AbstractMechanism as AbstractMechanism
    from .mechanism import ConstantInertia as ConstantInertia
    from .mechanism import PlanarArm as PlanarArm
    from .modal import Modes as Modes
    from .modal import modes as modes
    from .model import Model as Model
    from .motion import Motion as Motion
    from .nodes import Trajectory as Trajectory
    from .parameter import Memory as Memory
    from .parameter import param as param
    from .procedure import InertiaResult as InertiaResult
    from .procedure import Unloading as Unloading
    from .procedure import inertia as inertia
    from .procedure import unload as unload
    from .recording import Experiment as Experiment
    from .recording import InputError as InputError
    from .recording import Recording as Recording
    from .recording import load as load
    from .simulation import Drive as Drive
    from .simulation import simulate as simulate
    from .simulation import steps_for as steps_for

__version__ = "0.1.0"

_PUBLIC = {
    "ahead": ("set_up",),
    "bearings": ("AirBearing", "with_bearings", "without_bearings"),
    "diagnosis": ("Comparison", "Diagnosis", "compare", "diagnose"),
    "effects": (
        "CATALOGUE",
        "AbstractEffect",
        "AsymmetricDamping",
        "AsymmetricStiffness",
        "BearingDrag",
        "BearingFriction",
        "BearingQuadraticDrag",
        "BrakeSlip",
        "ConstantTorque",
        "CoulombFriction",
        "CouplingDamping",
        "CouplingStiffness",
        "CubicStiffness",
        "Damper",
        "DeadZone",
        "Gravity",
        "Hysteresis",
        "InertiaError",
        "JointEffect",
        "PeriodicDisturbance",
        "PrintedInertiaTorque",
        "QuadraticDrag",
        "SensorDelay",
        "SensorOffset",
        "SensorScale",
        "Spring",
        "StiffnessDrift",
        "StribeckFriction",
        "WristFlexibility",
        "adopt",
        "load_effects",
    ),
    "fitting": (
        "Bootstrap",
        "Embedded",
        "Fit",
        "FitError",
        "Race",
        "Solution",
        "bootstrap",
        "embed",
        "fit",
        "fit_many",
        "race",
    ),
    "integrators": ("Integrator",),
    "mechanism": ("AbstractMechanism", "ConstantInertia", "PlanarArm"),
    "model": ("Model",),
    "modal": ("Modes", "modes"),
    "motion": ("Motion",),
    "nodes": ("Trajectory",),
    "parameter": ("Memory", "param"),
    "procedure": ("InertiaResult", "Unloading", "inertia", "unload"),
    "recording": ("Experiment", "InputError", "Recording", "load"),
    "simulation": ("Drive", "simulate", "steps_for"),
}
_HOME = {name: module for module, names in _PUBLIC.items() for name in names}

__all__ = [*_HOME, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        # A module of the package, such as `residyn.recording`, or nothing.
        try:
            return importlib.import_module(f".{name}", __name__)
        except ModuleNotFoundError as error:
            if error.name != f"{__name__}.{name}":
                raise
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}") from None
    value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
