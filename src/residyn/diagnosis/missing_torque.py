"""The missing torque: what each joint feels that the model does not know of.

    Z(q) q'' + f^w + sum of effect torques + tau = drive torque

Nothing is assumed of tau but that it changes little from one sample to the next; how little, the
recording's likelihood says, joint by joint. A Kalman filter carries angles, rates and tau along the
readings, so the model's phase never drifts and a wrong frequency shows as what it is, a torque in
proportion to the angle. A smoother then looks back. What comes out is a curve with a band. Against
time, angle, rate and amplitude it draws the signature of what is missing: a step against the rate
is dry friction, a bent line against the angle a spring that is not linear, a loop hysteresis.

A torque that the noise hides does not show: the band says where that begins. It assumes that what
cannot be seen (the harmonics of a torque, above all) is about as large as a kink or a step in the
torque would make it; where the torque is smooth, the band is therefore too wide rather than right.
"""

import math
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np

from ..kept import kept
from ..modal import concrete_state_matrix
from ..model import Model
from ..motion import Motion, split, stack
from ..parameter import all_floating
from ..recording import Recording
from ._filter import Start
from ._grid import amplitude, lay_out
from ._smooth import Data, Smoothed, along, estimate, followed, likeliest
from ._step import size

_LEVELS = 10.0 ** np.arange(-8, 0)
_UNSURE = 2.0  # rms amplitudes (rates) that the first angle (rate) may be off


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """What one recording's joints feel beside the model: N samples of n joints."""

    time: np.ndarray
    """(N,) s, on the recording's own clock."""
    angle: np.ndarray
    """(N, n) smoothed angle, rad or m."""
    rate: np.ndarray
    """(N, n) smoothed rate, rad/s or m/s."""
    torque: np.ndarray
    """(N, n) N m or N, positive where it resists, like an effect's."""
    std: np.ndarray
    """(N, n) its standard error: the 95 % band is 1.96 of it to either side."""
    amplitude: np.ndarray
    """(N, n) local amplitude of the angle about where it rests, rad or m."""
    intensity: np.ndarray
    """(n,) root mean square of what the torque was allowed to be, N m or N; 0: nothing."""
    log_likelihood: float
    """Of the readings, with the missing torque."""
    log_likelihood_without: float
    """Of the readings, with the model alone."""
    rms: np.ndarray
    """(n,) rms of the torque, N m or N."""
    share_of_spring: np.ndarray
    """(n,) `rms` over the rms of the joint's spring torque, or of Z q'' if it has no spring."""

    def between(self, first: int, last: int) -> "MissingTorque":
        """The same from one sample up to another; what is said of the whole stays as it was."""
        own = ("time", "angle", "rate", "torque", "std", "amplitude")
        return replace(self, **{name: getattr(self, name)[first:last] for name in own})


def missing_torque(
    model: Model,
    recording: Recording,
    *,
    wild: np.ndarray | None = None,
    state: np.ndarray | None = None,
) -> MissingTorque:
    """The torque that a model lacks to move as the recording says, with its band.

    Runs in float64 whatever JAX's setting.

    **Arguments:**

    - `model`: on this recording's mechanism, whatever effects it has.
    - `recording`: readings and their noise; samples may be lost or uneven, and the motion driven.
    - `wild`: (N, n) readings to leave out, as from `residyn.recording.wild_samples`. Single
      readings that are far off are given little weight anyway.
    - `state`: (q0, v0, and internal states if the model has any) at the first sample, as fitted:
      where to begin, not what to believe, but for internal states, which are taken as they are.

    **Returns:** a `MissingTorque`.
    """
    with jax.enable_x64(True):
        model = all_floating(model)
        bad = np.zeros(recording.angle.shape, bool) if wild is None else np.asarray(wild, bool)
        data, sample = _data(model, recording, bad, state)
        levels = _follow_all(model, data, jnp.asarray(_LEVELS))
        level = _LEVELS[int(np.argmax(np.nan_to_num(np.asarray(levels), nan=-np.inf)))]
        found = _estimate(model, data._replace(level=jnp.asarray(level)))
        found, allowed, without, spring = jax.device_get(found)
    n = recording.joints
    angle, rate = found.state[sample, :n], found.state[sample, n : 2 * n]
    torque = found.torque[sample]
    rms, whole = (np.sqrt(np.mean(x**2, axis=0)) for x in (torque, spring[sample]))
    return MissingTorque(
        time=recording.time,
        angle=angle,
        rate=rate,
        torque=torque,
        std=found.std[sample],
        amplitude=np.asarray(data.grid.swing)[sample],
        intensity=allowed,
        log_likelihood=float(found.likelihood),
        log_likelihood_without=float(without),
        rms=rms,
        share_of_spring=rms / np.where(whole > 0, whole, np.nan),
    )


def _data(
    model: Model, recording: Recording, wild: np.ndarray, state: np.ndarray | None
) -> tuple[Data, np.ndarray]:
    """The recording laid out for the smoother, and where its samples are."""
    n, time = recording.joints, recording.time
    angle = np.where(wild, np.nan, recording.angle)
    fast, slow = _frequencies(model, time)
    swing = amplitude(time, angle, 2 * math.pi / slow)
    grid, sample = lay_out(recording, wild, swing, fast)
    rms = np.maximum(np.nanstd(angle, axis=0), 3 * recording.noise)
    begin = np.zeros(size(model))
    if state is not None:
        begin[:] = state
    else:
        begin[:n] = [np.median(q[np.isfinite(q)][:5]) for q in angle.T]
        memory = model.memory_begin(Motion.at(0.0, begin[:n], begin[n : 2 * n], begin[2 * n :]))
        begin[2 * n :] = [float(z) for z in memory]
    unsure = np.zeros(len(begin))
    unsure[:n], unsure[n : 2 * n] = _UNSURE * rms, _UNSURE * rms * fast
    start = Start(jnp.asarray(begin), jnp.diag(jnp.asarray(unsure**2)))
    inertia = model.bodies.mass_matrix((0.0,) * n)
    unit = np.array([float(inertia[j][j]) for j in range(n)]) * fast**2 * rms
    return Data(grid, start, jnp.asarray(unit), jnp.asarray(1.0)), sample


def _frequencies(model: Model, time: np.ndarray) -> tuple[float, float]:
    """Angular frequencies of the fastest and of the slowest motion to expect, rad/s."""
    least = 2 * math.pi / (time[-1] - time[0])
    most = math.pi / float(np.median(np.diff(time)))
    matrix = np.asarray(concrete_state_matrix(model))
    values = np.linalg.eigvals(matrix) if np.isfinite(matrix).all() else np.array([most])
    imaginary = np.imag(values)
    rings = imaginary[imaginary > 0]
    slow = float(rings.min()) if len(rings) else 4 * least
    return float(np.clip(np.abs(values).max(), least, most)), float(np.clip(slow, least, most))


@kept(like=0)
def _follow_all(model: Model, data: Data, levels):
    """Log likelihood of following the readings with each of these levels."""
    return jax.vmap(
        lambda level: jnp.sum(followed(model, data._replace(level=level))[0].likelihood)
    )(levels)


@kept(like=(Smoothed(0, 0, 0, 0), 0, 0, 0))  # pyright: ignore[reportArgumentType]
def _estimate(model: Model, data: Data):
    """Smoothed at the likeliest intensities, those as torques, the likelihood without, and what to
    compare the torque with."""
    here = along(model, data)
    intensity, without = likeliest(here)
    found = estimate(here, intensity)
    walk = here.prior.walk(intensity)
    # Each regressor's mean square is 1: the mean over the recording of all coefficients' variance.
    allowed = jnp.sqrt(jnp.sum(walk.begin + 0.5 * jnp.sum(walk.growth, axis=0), axis=1))
    return found, allowed, without, _spring(model, data, found)


def _spring(model: Model, data: Data, found: Smoothed):
    """(M, n) torque of each joint's spring, or Z q'' where it has none, N m."""
    n = len(model.mechanism.joints)
    springs = {e.place: e for e in model.effects if e.name == "spring"}

    def at(time, x, torque, drive):
        motion = Motion.at(time, x[:n], x[n : 2 * n], x[2 * n :])
        push = split(drive - torque)
        acceleration = stack(model.acceleration(motion, push))
        matrix = jnp.asarray(model.bodies.mass_matrix(motion.q), float)
        own = matrix @ acceleration
        for j, joint in enumerate(model.mechanism.joints):
            if joint in springs:
                held = springs[joint].torque(motion, model.mechanism)[j]
                own = own.at[j].set(held)
        return own

    return jax.vmap(at)(data.grid.time, found.state, found.torque, data.grid.drive)
