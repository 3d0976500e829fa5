"""Recordings as a compiled program takes them: arrays of few sizes, laid out in integration steps.

Which step an instant lies in, and where within it, does not depend on the numbers that are sought,
so it is looked up before the fit begins; and a drive torque is one straight line a step, which the
integrator follows exactly.
"""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ..physics.mechanism import AbstractMechanism
from ..physics.parameter import stacked
from ..recordings.recording import Recording
from ..simulation.equation import Piecewise

AnyArray = Array | np.ndarray  # NumPy's, until a compiled program takes it


class Recorded(eqx.Module):
    """R recordings as arrays of N instants each, of NumPy or JAX: their readings, and behind the
    last one of a shorter recording instants at which nothing was read.

    Time counts from each recording's first sample.
    """

    duration: Float[AnyArray, " R"]
    row: Int[AnyArray, "R N"]  # integration step in which each instant lies
    place: Float[AnyArray, "R N"]  # where within it, 0 to 1
    angles: Float[AnyArray, "R N n"]
    weights: Float[AnyArray, "R N n"]  # 1/sigma of each reading; 0 where there is none
    count: Int[AnyArray, " R"]  # of the N, how many instants are its own
    mechanism: AbstractMechanism
    drive: Piecewise | None
    orders: tuple[int, ...] = eqx.field(static=True, default=())
    """(n,) which derivative was read of each joint; () is angles."""


def bucket(count: int, base: int = 2, least: int = 16) -> int:
    """The next of `least`, `base` times that, and so on: few sizes, so few compilations."""
    size = least
    while size < count:
        size *= base
    return size


def read_of(recorded: Recorded) -> list[AnyArray]:
    """What of a recording is one row per instant."""
    return [recorded.row, recorded.place, recorded.angles, recorded.weights]


def lay_out(
    recordings: Sequence[Recording],
    mechanisms: Sequence[AbstractMechanism],
    outliers: Sequence[np.ndarray],
    steps: int,
    room: int,
    instants: int,
) -> Recorded:
    """Readings as they lie in `steps` equal steps a recording; `outliers` (N, n) get no weight.

    `instants` is the N to lay out for.
    """
    shape = len(recordings), instants, recordings[0].angle.shape[1]
    row, place = np.zeros(shape[:2], int), np.zeros(shape[:2])
    angles, weights = np.zeros(shape), np.zeros(shape)
    for i, (r, bad) in enumerate(zip(recordings, outliers, strict=True)):
        count = len(r.time)
        part = (r.time - r.time[0]) / (r.time[-1] - r.time[0]) * steps
        row[i, :count] = np.clip(np.floor(part).astype(int), 0, steps - 1)
        place[i, :count] = part - row[i, :count]
        seen = np.isfinite(r.angle) & ~bad
        angles[i, :count] = np.where(seen, r.angle, 0.0)
        weights[i, :count] = np.where(seen, 1.0 / r.noise, 0.0)
    return Recorded(
        duration=np.array([r.duration for r in recordings]),
        row=row,
        place=place,
        angles=angles,
        weights=weights,
        count=np.array([len(r.time) for r in recordings]),
        mechanism=stacked(mechanisms),
        drive=drives(recordings, steps, room),
        orders=recordings[0].orders if any(recordings[0].orders) else (),
    )


def drives(recordings: Sequence[Recording], steps: int, room: int) -> Piecewise | None:
    """Drive torques as one straight line a step, with the readings' own impulse and moment.

    The integrator follows a straight line exactly, but a kink inside a step would cost it its
    order, and a torque merely smoothed shifts the position with every jump. Impulse and moment kept
    step by step keep rate and position at the end of every step.
    """
    if all(r.drive is None for r in recordings):
        return None
    from scipy.interpolate import make_interp_spline

    found = []
    for r in recordings:
        ends = np.linspace(r.time[0], r.time[-1], steps + 1)
        h = ends[1] - ends[0]
        torque = np.zeros_like(r.angle) if r.drive is None else r.drive
        line = make_interp_spline(r.time, torque, k=1)
        once, twice = (line.antiderivative(order)(ends) for order in (1, 2))
        mean = np.diff(once, axis=0) / h
        # Second integral over the step, beyond that of its mean: a slope s gives -s h^3 / 12.
        slope = -12 * (np.diff(twice, axis=0) - h * once[:-1] - mean * h**2 / 2) / h**3
        left, right = mean - slope * h / 2, mean + slope * h / 2
        sides = (np.pad(side, ((0, room - steps), (0, 0))) for side in (left, right))
        found.append(Piecewise(0.0, h, *sides))
    return stacked(found)
