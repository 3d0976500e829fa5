"""A test rig that is nobody's model: the braked arm built and run in MuJoCo.

Tests and benchmarks need recordings whose truth is known and whose physics was worked out by
someone else. The rig gives them: it states the arm as masses and hinges and lets MuJoCo derive the
motion. It never imports the package under test, so the two can only agree if both are right.
"""

from .arm import HANGING, Arm, paper_twin, tilt
from .cart import Cart
from .cases import Case, clean_cases, friction_cases, random_arm, random_release
from .engine import Memory, simulate

__all__ = [
    "HANGING",
    "Arm",
    "Cart",
    "Case",
    "Memory",
    "clean_cases",
    "friction_cases",
    "paper_twin",
    "random_arm",
    "random_release",
    "simulate",
    "tilt",
]
