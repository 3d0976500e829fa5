"""residyn: fit a braked arm from its recordings, see where the model fails, and mend it."""

from .bearings import AirBearing as AirBearing
from .bearings import with_bearings as with_bearings
from .bearings import without_bearings as without_bearings
from .effects import CATALOGUE as CATALOGUE
from .effects import AbstractEffect as AbstractEffect
from .effects import CoulombFriction as CoulombFriction
from .effects import Damper as Damper
from .effects import Gravity as Gravity
from .effects import InertiaError as InertiaError
from .effects import JointEffect as JointEffect
from .effects import PrintedInertiaTorque as PrintedInertiaTorque
from .effects import Spring as Spring
from .fit import Fit as Fit
from .fit import FitError as FitError
from .fit import fit as fit
from .mechanism import AbstractMechanism as AbstractMechanism
from .mechanism import ConstantInertia as ConstantInertia
from .mechanism import PlanarArm as PlanarArm
from .model import Model as Model
from .modes import Modes as Modes
from .modes import modes as modes
from .motion import Motion as Motion
from .parameter import param as param
from .recording import Experiment as Experiment
from .recording import InputError as InputError
from .recording import Recording as Recording
from .recording import load as load
from .simulate import Drive as Drive
from .simulate import Trajectory as Trajectory
from .simulate import simulate as simulate
from .simulate import steps_for as steps_for

__version__ = "0.1.0"
