"""A driven test of step 1: one joint is led to and fro, the other is braked (Eq. 10, 11).

What the least-squares equations need of a recording beyond its readings: which joint was driven,
how large the noise of its torque is, and which way the joint slid when. Where it is too slow to
say, near a reversal, dry friction may be anything within its bounds, so nothing is asked there.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.ndimage import binary_dilation
from scipy.signal import oaconvolve

from ..errors import InputError, inside
from ..fitting import FitError
from ..fitting.smoothing import Uniform, uniform
from ..recordings.noise import estimate_noise
from ..recordings.recording import Recording

_BRAKED = 0.2  # the most that a braked joint may move, as a share of the driven one's range
_NOISY = 8.0  # sigmas of a reading which its noise alone may span
_FINEST = 1e-4  # no torque sensor is better than this share of the torque that it reads
_SLOW = 0.05  # share of the highest rate below which the direction of sliding counts as not known
_SURE = 4.0  # standard errors of the rate which that must be
_SHORTEST = 60  # samples of a test, at least
_OFFSET = 0.1
"""rad from its pose beyond which a braked joint makes one doubt what its angle is measured from."""


@dataclass(frozen=True, eq=False)
class DrivenTest:
    """A recording made ready for step 1, on a uniform grid of G instants."""

    recording: Recording
    joint: int  # 0: the shoulder is driven; 1: the elbow
    grid: Uniform
    torque_noise: float  # sigma of one reading of the drive, N m
    rate: np.ndarray  # (G,) of the driven joint, smoothed, rad/s
    clear: np.ndarray  # (G,) whether it is known which way the joint slides
    warnings: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The recording's."""
        return self.recording.name

    @property
    def angle(self) -> np.ndarray:
        """(G,) of the driven joint, rad."""
        return self.grid.q[:, self.joint]

    @property
    def braked(self) -> np.ndarray:
        """(G,) angle of the other joint, rad."""
        return self.grid.q[:, 1 - self.joint]

    @property
    def theta2(self) -> float:
        """The elbow's angle in the test (its mean, where it is braked), rad."""
        turned = float(np.mean(self.braked)) if self.joint == 0 else 0.0
        return self.recording.theta2 + turned

    @property
    def reversals(self) -> int:
        """How often the joint turned round."""
        return int(np.count_nonzero(np.diff(np.sign(self.rate[self.clear]))))


def driven_test(recording: Recording) -> DrivenTest:
    """Make a recording with `role = "inertia"` ready.

    **Raises:** `InputError` if it is no driven test of one joint with the other braked; `FitError`
    if the joint moves too little to be seen beside the noise.
    """
    with inside(recording.name):
        if recording.drive is None:
            raise InputError("has no drive: step 1 needs the torque that moved it, as u1, u2 (N m)")
        joint = _driven_joint(recording, recording.drive)
        drive = recording.drive[:, joint]
        # Torque and angles share their wild instants: a row needs all of them.
        grid = uniform(recording, recording.outliers)
        if len(grid.q) < _SHORTEST:
            raise FitError(
                f"{recording.name}: has {len(grid.q)} samples, at least {_SHORTEST} are needed"
            )
        finest = _FINEST * math.sqrt(float(np.mean(drive**2)))
        torque_noise = max(float(estimate_noise(recording.time, drive[:, None])[0]), finest)
        knot, threshold = _pace(grid, joint, recording)
    rate = smoothed(grid.q[:, joint], knot, grid.dt)[1]
    # A fast reversal falls between two samples; smoothing blurs how long it lasts.
    unclear = np.abs(rate) <= threshold
    unclear[1:] |= rate[1:] * rate[:-1] < 0
    clear = ~np.asarray(binary_dilation(unclear, iterations=knot), bool)
    clear[: 3 * knot] = clear[len(clear) - 3 * knot :] = False
    warnings = _warnings(recording, joint)
    return DrivenTest(recording, joint, grid, torque_noise, rate, clear & grid.good, warnings)


def kernel(knot: int, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A B-spline of fifth degree, knots `knot` samples apart, and two derivatives, (6 knot + 1,).

    Of all kernels, since its sums over samples are exact where those over other smooth bumps are
    nearly so (step 1 is slow: an angle of 1 rad may accelerate by 0.01 rad/s^2, and an inexact
    second derivative would add some of the angle to it), and since shifted ones add up to smooth
    functions as wide as the recording, so that no width has to be chosen with care.
    """
    spline = BSpline.basis_element(np.arange(-3.0, 4.0))
    at, width = np.arange(-3 * knot, 3 * knot + 1) / knot, knot * dt
    value, first, second = (spline.derivative(n)(at) if n else spline(at) for n in range(3))
    return value / knot, first / knot / width, second / knot / width**2


def smoothed(column: np.ndarray, knot: int, dt: float) -> tuple[np.ndarray, ...]:
    """Angle, rate and acceleration (G,) through one kernel; the ends are held."""
    padded = np.pad(column, 3 * knot, mode="edge")
    value, rate, acceleration = (oaconvolve(padded, k, "valid") for k in kernel(knot, dt))
    return value, rate, acceleration


def _driven_joint(recording: Recording, drive: np.ndarray) -> int:
    """The joint that a torque acts on and that moves.

    A brake may show a holding torque; the joint's own equation has no place for it.
    """
    acted = np.ptp(drive, axis=0) > 0
    low, high = np.nanquantile(recording.angle, [0.001, 0.999], axis=0)
    moved = np.maximum(high - low - _NOISY * recording.noise, 0.0)
    if not acted.any():
        raise InputError("the drive never changes: nothing was driven")
    if not moved.any():
        raise FitError(f"{recording.name}: no joint moves more than its noise, too little to see")
    joint = int(np.argmax(moved))
    if moved[1 - joint] > _BRAKED * moved[joint]:
        raise InputError(
            f"both joints move (by {moved[0]:.2g} and {moved[1]:.2g} rad): in a test of step 1 one "
            "is driven and the other braked"
        )
    if not acted[joint]:
        raise InputError(
            f"u{2 - joint} drives but q{joint + 1} is what moves: are the columns in order?"
        )
    return joint


def _pace(grid: Uniform, joint: int, recording: Recording) -> tuple[int, float]:
    """Knots (samples) of the narrowest kernel that shows the direction of sliding through the
    noise, and the rate (rad/s) beyond which it does."""
    noise, widest = float(recording.noise[joint]), max(1, len(grid.q) // 30)
    knot, rate, unsure = 1, 0.0, math.inf
    while True:
        first = kernel(knot, grid.dt)[1]
        rate = float(np.quantile(np.abs(oaconvolve(grid.q[:, joint], first, "valid")), 0.98))
        unsure = _SURE * noise * float(np.linalg.norm(first))
        if unsure < _SLOW * rate or knot == widest:
            break
        knot = min(math.ceil(1.5 * knot), widest)
    if unsure > 0.5 * rate:
        raise FitError(
            f"{recording.name}: q{joint + 1} moves too little beside its noise ({noise:.2g} rad) "
            "to say which way it slides"
        )
    return knot, max(_SLOW * rate, unsure)


def _warnings(recording: Recording, joint: int) -> tuple[str, ...]:
    rest = float(np.nanmedian(recording.angle[:, 1 - joint]))
    if joint == 1 or abs(rest) < _OFFSET:
        return ()
    return (
        f"{recording.name}: the braked elbow stands at q2 = {rest:.3g} rad; as q2 counts from "
        f"theta2 = {recording.theta2:.4g}, its angle is taken as {recording.theta2 + rest:.4g}",
    )
