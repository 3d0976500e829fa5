"""The paper's procedure around the fit: inertias first (step 1), orbit last (step 3)."""

from .inertia import inertia as inertia
from .result import InertiaResult as InertiaResult
from .unload import check_unload as check_unload
from .unload import unload as unload
from .unloaded import Unloading as Unloading
