"""A recording as the instants that a filter visits.

Every sample is one, and where the time from one to the next is longer than an integration step may
be, instants without a reading lie between. The count is filled up to one of a few lengths by
instants that follow at once and read nothing, so that one compiled program serves many recordings.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..fitting.layout import bucket
from ..recording import Recording

_STEP = 0.3  # integration step times fastest angular frequency


class Grid(NamedTuple):
    """M instants of one recording."""

    time: Float[Array, " M"]  # s from the first sample
    step: Float[Array, " M"]  # to the next instant; 0 at the end
    drive: Float[Array, "M n"]  # N m
    angle: Float[Array, "M n"]  # reading, 0 where there is none
    variance: Float[Array, "M n"]  # of a reading
    seen: Bool[Array, "M n"]  # where there is one
    swing: Float[Array, "M n"]  # local amplitude, rad


def lay_out(
    recording: Recording, wild: np.ndarray, swing: np.ndarray, frequency: float
) -> tuple[Grid, np.ndarray]:
    """The grid for motions up to an angular frequency (rad/s), and where the samples are in it."""
    clock = recording.time - recording.time[0]
    gaps = np.diff(clock)
    parts = np.maximum(1, np.ceil(gaps * frequency / _STEP - 1e-6)).astype(int)
    sample = np.concatenate([[0], np.cumsum(parts)])
    share = np.arange(sample[-1] + 1)
    time = np.interp(share, sample, clock)
    count = bucket(len(time))
    fill = count - len(time)
    time = np.concatenate([time, np.full(fill, time[-1])])
    n = recording.joints

    def spread(values: np.ndarray, rest: float) -> np.ndarray:
        out = np.full((count, n), rest, dtype=values.dtype)
        out[sample] = values
        return out

    def between(values: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(time, clock, column) for column in values.T], axis=1)

    seen = np.isfinite(recording.angle) & ~wild
    drive = np.zeros((count, n)) if recording.drive is None else between(recording.drive)
    grid = Grid(
        time=jnp.asarray(time),
        step=jnp.asarray(np.append(np.diff(time), 0.0)),
        drive=jnp.asarray(drive),
        angle=jnp.asarray(spread(np.where(seen, recording.angle, 0.0), 0.0)),
        variance=jnp.broadcast_to(jnp.asarray(recording.noise) ** 2, (count, n)),
        seen=jnp.asarray(spread(seen, False)),
        swing=jnp.asarray(between(swing)),
    )
    return grid, sample


def amplitude(time: np.ndarray, angle: np.ndarray, period: float) -> np.ndarray:
    """(N, n) local amplitude of each joint about where it rests: sqrt(2) times the standard
    deviation over one `period` (s) around each sample. NaN in `angle` is bridged."""
    half = 0.5 * min(period, time[-1] - time[0])
    # The window slides, but not beyond the recording.
    middle = np.clip(time, time[0] + half, time[-1] - half)
    found = []
    for column in angle.T:
        seen = np.isfinite(column)
        q = np.interp(time, time[seen], column[seen])
        q = q - q.mean()
        first, second = (_mean(time, q**power, middle - half, middle + half) for power in (1, 2))
        found.append(np.sqrt(2 * np.maximum(second - first**2, 0.0)))
    return np.stack(found, axis=1)


def _mean(time: np.ndarray, values: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    area = np.append(0.0, np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time)))
    return (np.interp(stop, time, area) - np.interp(start, time, area)) / (stop - start)
