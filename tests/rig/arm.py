"""The braked arm as bodies: from the three lumped inertias of Eq. 2 back to masses.

Free motion in the plane sees only three numbers, shoulder = I1 + m2 l1^2, elbow = I2 and
coupling = m2 rho2, but a physics engine wants bodies. Many sets of bodies share the three numbers;
any one of them will do, as long as it could exist: both links need positive inertia about their own
centre of mass, which holds for some m2 exactly when shoulder * elbow > (l1 * coupling)^2.

Frame: link 1 at rest lies along +x, angles grow from x to y, link 2 at rest points along theta2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .engine import Array, Pair, Setting, document

G = 9.81
HANGING: Pair = (G, 0.0)
"""Gravity (m/s^2) that makes the arm a double pendulum: link 1 hangs at q1 = 0."""


def tilt(angle: float, direction: float = 0.0) -> Pair:
    """In-plane gravity (m/s^2) of a table tilted by `angle` (rad).

    Downhill is at `direction` (rad) from link 1 at rest.
    """
    pull = G * math.sin(angle)
    return pull * math.cos(direction), pull * math.sin(direction)


@dataclass(frozen=True)
class Arm:
    """Two links on braked joints; q1 is link 1's angle, q2 the elbow's less theta2 (rad)."""

    l1: float
    """Length of link 1, m."""
    l2: float
    """Length of link 2, m (where a wrist bearing would sit; the motion does not depend on it)."""
    shoulder: float
    """I1 + m2 l1^2, kg m^2."""
    elbow: float
    """I2 about the elbow, kg m^2."""
    coupling: float
    """m2 rho2, kg m: link 2's first moment about the elbow."""
    theta2: float = 0.0
    """Elbow angle at rest, rad."""
    stiffness: Pair = (0.0, 0.0)
    """k1, k2, N m/rad."""
    damping: Pair = (0.0, 0.0)
    """c1, c2, N m s/rad."""
    link1_moment: float | None = None
    """m1 rho1 + m2 l1, kg m: felt under gravity only; None makes link 1 a uniform rod."""

    joints = 2

    def bodies(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Of link 1, link 2: mass (kg), distance of its centre (m), inertia about it (kg m^2)."""
        lightest = self.coupling**2 / self.elbow
        heaviest = self.shoulder / self.l1**2
        if not 0.0 <= lightest < heaviest:
            raise ValueError(
                "no rigid bodies have these inertias: shoulder * elbow <= (l1 * coupling)^2"
            )
        m2 = 0.5 * (lightest + heaviest)
        rho2 = self.coupling / m2
        inertia1 = self.shoulder - m2 * self.l1**2
        if self.link1_moment is None:
            moment1 = 1.5 * inertia1 / self.l1
        else:
            moment1 = self.link1_moment - m2 * self.l1
        # Any mass above moment1^2 / inertia1 leaves some inertia about the centre of mass;
        # a third more is the uniform rod's.
        m1 = max(4.0 / 3.0 * moment1**2 / inertia1, inertia1 / self.l1**2)
        rho1 = moment1 / m1
        return (
            (m1, rho1, inertia1 - m1 * rho1**2),
            (m2, rho2, self.elbow - m2 * rho2**2),
        )

    def mass_matrix(self, q2: float = 0.0) -> Array:
        """Eq. 2 at the elbow angle theta2 + q2, kg m^2."""
        reach = self.l1 * self.coupling * math.cos(self.theta2 + q2)
        whole = self.shoulder + self.elbow + 2.0 * reach
        return np.array([[whole, self.elbow + reach], [self.elbow + reach, self.elbow]])

    def modes(self) -> tuple[Array, Array]:
        """Frequencies (Hz, lowest first), damping ratios: small motion about rest, no gravity."""
        mass = self.mass_matrix()
        state = np.zeros((4, 4))
        state[:2, 2:] = np.eye(2)
        state[2:, :2] = -np.linalg.solve(mass, np.diag(self.stiffness))
        state[2:, 2:] = -np.linalg.solve(mass, np.diag(self.damping))
        roots = np.linalg.eigvals(state)
        roots = roots[np.argsort(np.abs(roots))][::2]
        return np.abs(roots) / (2.0 * math.pi), -roots.real / np.abs(roots)

    def fastest(self, gravity: Pair = (0.0, 0.0)) -> float:
        """Estimated bound (rad/s) on how fast the arm rings in any pose; it sets the time step."""
        (m1, rho1, _), (m2, _, _) = self.bodies()
        weight = math.hypot(*gravity)
        hang = self.coupling * weight
        lift = (m1 * rho1 + m2 * self.l1) * weight
        stiff = np.diag(self.stiffness) + np.array([[abs(lift) + hang, hang], [hang, hang]])
        # The coupling speeds the arm up most when link 2 is folded or stretched.
        poses = (-self.theta2, math.pi - self.theta2, math.pi / 2.0 - self.theta2)
        squares = [np.linalg.eigvals(np.linalg.solve(self.mass_matrix(q2), stiff)) for q2 in poses]
        return math.sqrt(max(float(np.max(s.real)) for s in squares))

    def mjcf(
        self,
        *,
        gravity: Pair = (0.0, 0.0),
        frictionloss: Pair = (0.0, 0.0),
        setting: Setting | None = None,
    ) -> str:
        """The arm as a MuJoCo model: in-plane gravity in m/s^2, Coulomb friction in N m."""
        (m1, rho1, i1), (m2, rho2, i2) = self.bodies()
        hinge = (
            '<joint name="{}" type="hinge" axis="0 0 1" '
            'stiffness="{!r}" damping="{!r}" frictionloss="{!r}"/>'
        )
        inertial = '<inertial pos="{1!r} 0 0" mass="{0!r}" diaginertia="{2!r} {2!r} {2!r}"/>'
        names = ("shoulder", "elbow")
        rows = zip(names, self.stiffness, self.damping, frictionloss, strict=True)
        first, second = (hinge.format(n, *(float(x) for x in row)) for n, *row in rows)
        link1, link2 = inertial.format(m1, rho1, i1), inertial.format(m2, rho2, i2)
        # A hinge's zero is the pose in the file: link 2's body turned by theta2 rests at q = 0.
        pose = f'pos="{float(self.l1)!r} 0 0" euler="0 0 {float(self.theta2)!r}"'
        world = f"<body>{first}{link1}<body {pose}>{second}{link2}</body></body>"
        return document(world, names, gravity, setting)


def paper_twin(theta2: float = 0.0) -> Arm:
    """The paper's Table 1 rig, bearings on: identified inertias, true stiffness and damping."""
    return Arm(
        l1=0.4,
        l2=0.4,
        shoulder=1.1662,
        elbow=0.5790,
        coupling=1.4384,
        theta2=theta2,
        stiffness=(16.67, 16.67),
        damping=(0.1, 0.1),
    )
