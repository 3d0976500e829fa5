"""Pictures of results; `reporting.figures` holds them."""

from .reporting.figures import candidates as candidates
from .reporting.figures import composite_inertia as composite_inertia
from .reporting.figures import convergence as convergence
from .reporting.figures import errors as errors
from .reporting.figures import horizon as horizon
from .reporting.figures import ladder as ladder
from .reporting.figures import law as law
from .reporting.figures import missing_torque as missing_torque
from .reporting.figures import overlay as overlay
from .reporting.figures import ring_down as ring_down
from .reporting.figures import signature as signature
from .reporting.figures import spectrum as spectrum
from .reporting.figures import where as where
