"""Where a fitted model fails, and what it misses."""

from .compare import Comparison as Comparison
from .compare import compare as compare
from .compare import compare_fit as compare_fit
from .detectable import Atlas as Atlas
from .detectable import detectable as detectable
from .diagnose import diagnose as diagnose
from .law import Law as Law
from .missing_torque import Curve as Curve
from .missing_torque import Missing as Missing
from .missing_torque import MissingTorque as MissingTorque
from .missing_torque import missing_torque as missing_torque
from .plan import Plan as Plan
from .plan import plan as plan
from .result import Diagnosis as Diagnosis
