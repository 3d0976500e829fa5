"""The tables of an experiment: what free motion cannot tell.

Stiffness and damping show in the motion only as ratios to inertia, so the inertia of what moved is
given: an arm's, or any constant mass matrix. So are the air bearings that the arm rides on, since
step 3 takes their inertia off. A table checks itself when it is made, in Python as in a file:
inertia that no real thing has is refused.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar

import jax

from ..errors import InputError, entries, number, quote
from ..physics.mechanism import ConstantInertia, real_arm


@dataclass(frozen=True)
class ArmTable:
    """Two links in a plane, `[arm]`; inertia with the bearings on.

    `link_lengths`: l1, l2 in m. `shoulder`: I1 + m2 l1^2, I1 about the shoulder, and `elbow`: I2
    about the elbow, kg m^2. `coupling`: m2 rho2, kg m, rho2 from the elbow to link 2's centre of
    mass. The last three are None where they are what is looked for.
    """

    link_lengths: tuple[float, float]
    shoulder: float | None = None
    elbow: float | None = None
    coupling: float | None = None
    joints: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")
    units: ClassVar[tuple[str, ...]] = ("rad", "rad")
    _inertias: ClassVar = {"shoulder": "kg m^2", "elbow": "kg m^2", "coupling": "kg m"}

    def __post_init__(self):
        lengths = entries("link_lengths", self.link_lengths, "two lengths in m, [l1, l2]", 2)
        lengths = tuple(number("link_lengths", x, "m", above=0) for x in lengths)
        object.__setattr__(self, "link_lengths", lengths)
        for name, unit in self._inertias.items():
            if (value := getattr(self, name)) is not None:
                above = None if name == "coupling" else 0.0
                object.__setattr__(self, name, number(name, value, unit, above=above))
        check_bearings(self, ())

    @property
    def missing(self) -> tuple[str, ...]:
        """The inertias that are not given."""
        return tuple(name for name in self._inertias if getattr(self, name) is None)


@dataclass(frozen=True)
class InertiaTable:
    """Any constant mass matrix, `[inertia]`.

    `joints`: one name per coordinate. `matrix`: kg for a sliding joint, kg m^2 for a turning one.
    `units`: "m" or "rad" per joint, or None if not said.
    """

    joints: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]
    units: tuple[str, ...] | None = None

    def __post_init__(self):
        joints = tuple(entries("joints", self.joints, 'a list of names, as ["cart"]'))
        for name in joints:
            if not isinstance(name, str) or not name or not name.isprintable():
                raise InputError(f"joints has {quote(name)}: must be names, none of them empty")
            if name != name.strip() or ":" in name or "." in name:
                raise InputError(
                    f'joints has {quote(name)}: a name has no ":", no "." and no blanks around it'
                )
            if joints.count(name) > 1:
                raise InputError(f"joints has {quote(name)} twice: names must differ")
        n = len(joints)
        if not n:
            raise InputError("joints is empty: must have one name per coordinate")
        right = f"{n} by {n} numbers, one row per joint, as [[0.5]] for one"
        rows = [entries("matrix", row, right) for row in entries("matrix", self.matrix, right)]
        if len(rows) != n or any(len(row) != n for row in rows):
            raise InputError(f"matrix = {quote(rows)}: must be {right}")
        matrix = tuple(tuple(number("matrix", x, "kg or kg m^2") for x in row) for row in rows)
        try:
            with jax.enable_x64(True):
                ConstantInertia(matrix, joints)
        except ValueError as error:
            raise InputError(str(error)) from None
        units = self.units
        if units is not None:
            units = tuple(entries("units", units, 'a list, as ["m"]'))
            if len(units) != n or any(unit not in ("m", "rad") for unit in units):
                raise InputError(
                    f'units = {quote(list(units))}: must have "m" or "rad" for each of {n} joints'
                )
        object.__setattr__(self, "joints", joints)
        object.__setattr__(self, "matrix", matrix)
        object.__setattr__(self, "units", units)


@dataclass(frozen=True)
class Bearing:
    """One air bearing: rides on the `joint` "elbow" or "wrist" (the end of link 2).

    `mass` in kg; `inertia` about its own centre, kg m^2.
    """

    joint: str
    mass: float
    inertia: float

    def __post_init__(self):
        if self.joint not in ("elbow", "wrist"):
            raise InputError(f'joint = {quote(self.joint)}: must be "elbow" or "wrist"')
        object.__setattr__(self, "mass", number("mass", self.mass, "kg", above=0))
        object.__setattr__(self, "inertia", number("inertia", self.inertia, "kg m^2", above=0))


def check_bearings(inertia: Any, bearings: Iterable[Bearing]) -> None:
    """The arm must be a real one, and still be one when its `bearings` are taken off (Eq. 5)."""
    bearings = tuple(bearings)
    if not isinstance(inertia, ArmTable):
        if bearings:
            raise InputError("[[air_bearings]] ride on an [arm]; with [inertia] leave them out")
        return
    shoulder, elbow, coupling = inertia.shoulder, inertia.elbow, inertia.coupling
    if shoulder is None or elbow is None or coupling is None:
        return
    l1, l2 = inertia.link_lengths
    for bearing in bearings:
        reach = l2 if bearing.joint == "wrist" else 0.0
        shoulder -= bearing.mass * l1 * l1
        elbow -= bearing.inertia + bearing.mass * reach * reach
        coupling -= bearing.mass * reach
    if real_arm(l1, shoulder, elbow, coupling):
        return
    if bearings:
        raise InputError(
            f"[[air_bearings]]: without them the arm would have shoulder = {shoulder:g}, elbow = "
            f"{elbow:g}, coupling = {coupling:g}, which no real arm has; [arm] must be the inertia "
            "with the bearings on, and their masses in kg"
        )
    # With all of link 2 at its end, the least of I1 + m2 l1^2.
    long = shoulder < abs(coupling) / l2 * l1 * l1
    raise InputError(
        f"shoulder = {shoulder:g}, elbow = {elbow:g} and coupling = {coupling:g} with l1 = {l1:g} "
        "cannot belong to a real arm: shoulder*elbow must be above (l1*coupling)^2, or some motion "
        f"would have no inertia{'; are the lengths in m?' * long}"
    )
