"""For whoever writes an effect: `param` declares a number, `Dimension` its unit and its size."""

from .physics.parameter import ANGLE as ANGLE
from .physics.parameter import CUBIC as CUBIC
from .physics.parameter import DAMPING as DAMPING
from .physics.parameter import DURATION as DURATION
from .physics.parameter import FORCE as FORCE
from .physics.parameter import FREQUENCY as FREQUENCY
from .physics.parameter import INERTIA as INERTIA
from .physics.parameter import QUADRATIC as QUADRATIC
from .physics.parameter import RATE as RATE
from .physics.parameter import RATIO as RATIO
from .physics.parameter import STIFFNESS as STIFFNESS
from .physics.parameter import TORQUE as TORQUE
from .physics.parameter import Dimension as Dimension
from .physics.parameter import Memory as Memory
from .physics.parameter import Scales as Scales
from .physics.parameter import param as param
