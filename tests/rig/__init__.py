"""A test rig that is nobody's model: the braked arm built and run in MuJoCo.

Tests and benchmarks need recordings whose truth is known and whose physics was worked out by
someone else. The rig gives them: it states the arm as masses and hinges and lets MuJoCo derive the
motion. It never imports the package under test, so the two can only agree if both are right.
"""

from .arm import HANGING, Arm, paper_twin, tilt
from .cart import Cart
from .cases import Case, clean_cases, friction_cases, random_arm, random_release
from .engine import Memory, Trace, simulate, trace
from .hidden import Hidden, HiddenCase, hidden_cases, random_hidden, record
from .laws import NAMES, OUTSIDE
from .unnamed import UNNAMED, Unnamed

__all__ = [
    "HANGING",
    "NAMES",
    "OUTSIDE",
    "UNNAMED",
    "Arm",
    "Cart",
    "Case",
    "Hidden",
    "HiddenCase",
    "Memory",
    "Trace",
    "Unnamed",
    "clean_cases",
    "friction_cases",
    "hidden_cases",
    "paper_twin",
    "random_arm",
    "random_hidden",
    "random_release",
    "record",
    "simulate",
    "tilt",
    "trace",
]
