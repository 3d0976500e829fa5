"""The paper's procedure around the fit: inertia from driven tests (step 1)."""

from .inertia import inertia as inertia
from .result import InertiaResult as InertiaResult
