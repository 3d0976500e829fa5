"""Where a fitted model fails, and what it misses."""

from .comparison import Comparison as Comparison
from .curves import Curve as Curve
from .curves import curves as curves
from .diagnosing import diagnose as diagnose
from .missing import Missing as Missing
from .missing_torque import MissingTorque as MissingTorque
from .missing_torque import missing_torque as missing_torque
from .pipeline import compare as compare
from .pipeline import compare_fit as compare_fit
from .result import Diagnosis as Diagnosis
