"""A law that was found in recordings, as a class in a file.

The text that the user gets is the class that was fitted: it is loaded from its own text, as any
file of effects is.
"""

import keyword
import re
import tempfile
from pathlib import Path
from typing import NamedTuple

from ..physics.effect import AbstractEffect
from .own import read_effects

_HEAD = '''"""Laws that residyn diagnose found. In use: --effects {file} --with NAME."""

import jax.numpy as jnp

from residyn import JointEffect, param
from residyn.parameter import ANGLE, DAMPING, DURATION, RATE, RATIO, STIFFNESS, TORQUE  # noqa: F401
'''


class FoundNumber(NamedTuple):
    """A number of a law."""

    field: str
    words: str
    dimension: str  # as `residyn.parameter` calls it
    value: float
    strength: bool  # whether the law is silent where it is 0; else it is a shape


class FoundLaw(NamedTuple):
    """A law of one joint's motion, to be written as a class."""

    joint: str
    variable: str
    factor: str  # both as of `diagnosis.free_curves.Kind`
    equation: str
    source: str  # where and when it was found
    numbers: tuple[FoundNumber, ...]
    torque: str  # the torque over its factor, an expression of x and the numbers

    @property
    def name(self) -> str:
        """What commands call it."""
        joint = re.sub(r"\W+", "_", self.joint).strip("_").lower()
        over = f"{self.factor}_over_" if self.factor else ""
        name = f"{joint}_{over}{self.variable}_law"
        return name if name.isidentifier() and not keyword.iskeyword(name) else f"law_{name}"

    @property
    def label(self) -> str:
        """As --with takes it."""
        return f"{self.name}:{self.joint}"

    def text(self, file: str = "found_effects.py") -> str:
        made = "".join(w.capitalize() for w in self.name.split("_"))
        x = {"angle": "motion.q", "rate": "motion.v", "time": "motion.t"}[self.variable]
        by = {"angle": "motion.q * ", "rate": "motion.v * ", "direction": "motion.direction * "}
        sums = f"({self.torque})" if self.factor and " + " in self.torque else self.torque
        joint, source = (re.sub(r'["\\\n]', " ", x) for x in (self.joint, self.source))  # in quotes
        lines = [
            f"class {made}(JointEffect):",
            f'    """{self.equation}; {source}."""',
            "",
            f'    name = "{self.name}"',
            f'    title = "Law of the {self.variable} at the {joint}"',
            f'    equation = "{self.equation}"',
            f'    source = "{source}"',
            *(["    dry = True"] if self.factor == "direction" else []),
            "    of_bearings = None  # residyn unload asks: True if it leaves with them, or False",
            "",
            *(_declared(n) for n in self.numbers),
            "",
            "    def joint_torque(self, motion):",
            f"        x = {x}",
            f"        return {by.get(self.factor, '')}{sums}",
        ]
        return "\n".join([_HEAD.format(file=file), "", *lines, ""])

    def kind(self) -> type[AbstractEffect]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "found_effects.py"
            path.write_text(self.text(), encoding="utf-8")
            (kind,) = read_effects(path)
        return kind


def _declared(n: FoundNumber) -> str:
    silent = "" if n.strength else ", silent=None"
    value = f"{n.value:.6g}"
    return (
        f'    {n.field}: float = param("{n.words}", {n.dimension}{silent}, default={float(value)})'
    )
