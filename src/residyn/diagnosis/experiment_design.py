"""What to record next, when two names explain a recording as well.

Each is let predict releases that were never made: other angles, another elbow, without bearings,
with a load. Where the predictions part by more than the noise, after the rival has bent its numbers
as far as the present recordings let it, there is the experiment to make.
"""

import dataclasses
import itertools
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..fitting.layout import bucket
from ..fitting.problem import Ready, mechanism_of, posed
from ..fitting.result import Fit
from ..physics.model import Model
from ..recordings.experiment import Experiment
from ..recordings.recording import Recording
from ..recordings.tables import ArmTable, InertiaTable
from ..reporting.numbers import amount, plain
from ..simulation.interpolation import read
from ..simulation.simulate import march
from .result import NextExperiment

_SAMPLES = 256
_STEP = 0.3  # of an integration step, times the fastest angular frequency
_ELBOWS = (0.0, 0.25, 0.5, 0.75)  # of pi, tried on either side
_SIZES = (0.5, 1.0, 2.0)  # times the present release
_LOADS = (0.5, 1.0, 2.0)  # times the first coordinate's own inertia


class Scene(NamedTuple):
    """An experiment that could be made."""

    recording: Recording
    release: np.ndarray


def advise(
    experiment: Experiment, accepted: Fit, rival: Fit, names: tuple[str, str]
) -> NextExperiment:
    """The release that tells two fitted models apart best."""
    first = accepted.recordings[0]
    scenes = _scenes(experiment, first.recording, first.state[: len(experiment.joints)])
    mechanisms = [mechanism_of(experiment, s.recording) for s in scenes]
    ready = Ready(accepted.model, (first.recording,), tuple(mechanisms))
    fast = max(ready.frequency(f.model) for f in (accepted, rival))
    duration = first.recording.duration
    steps = bucket(max(16, math.ceil(duration * fast / _STEP)))
    readings = int(first.used.sum())
    weight = np.sqrt(readings / (_SAMPLES * len(experiment.joints))) / first.recording.noise
    stacked = jax.tree.map(lambda *x: jnp.stack(x), *mechanisms)
    releases = jnp.asarray(np.stack([s.release for s in scenes]))
    times = jnp.linspace(0.0, duration, _SAMPLES)
    one = _predict(accepted.model, stacked, releases, times, steps)
    other, slopes = _sloped(rival.model, stacked, releases, times, steps)
    known = np.linalg.pinv(np.where(np.isfinite(rival.covariance), rival.covariance, 0.0))
    apart = []
    for a, b, slope in zip(*jax.device_get((one, other, slopes)), strict=True):
        d = ((a - b) * weight).reshape(-1)
        j = (slope * weight[:, None]).reshape(len(d), -1)
        if not (np.isfinite(d).all() and np.isfinite(j).all()):
            apart.append(0.0)
            continue
        bend = np.linalg.lstsq(j.T @ j + known, j.T @ d, rcond=1e-12)[0]
        apart.append(math.sqrt(max(0.0, float(d @ d - (j.T @ d) @ bend))))
    best = int(np.argmax(apart))
    now = math.sqrt(abs(_chi2(rival) - _chi2(accepted)))
    return _told(experiment, scenes[best], names, apart[best], now)


def _chi2(fitted: Fit) -> float:
    """Squared residuals of the fitted recordings in units of the noise."""
    return sum(
        float(np.sum((np.where(r.used, r.residual, 0.0) / r.recording.noise) ** 2))
        for r in fitted.recordings
        if r.recording.role != "check"
    )


def _scenes(experiment: Experiment, like: Recording, state: np.ndarray) -> list[Scene]:
    """Releases from rest around the one that was made."""
    size = np.maximum(np.abs(state), 0.3 * np.max(np.abs(state)))
    table = experiment.inertia
    patterns = [np.ones(1)] if len(size) == 1 else [
        np.array(p) for p in ((1.0, 1.0), (1.0, -1.0), (1.0, 0.0), (0.0, 1.0))
    ]  # fmt: skip
    patterns = patterns if len(size) <= 2 else [np.ones(len(size))]
    releases = [s * p * size for s, p in itertools.product(_SIZES, patterns)]
    changes: list[dict] = [{}]
    if isinstance(table, ArmTable):
        sign = math.copysign(1.0, like.theta2 or 1.0)
        changes += [{"theta2": sign * e * math.pi} for e in _ELBOWS]
        if experiment.bearings:
            changes.append({"air_bearings": not like.air_bearings})
    elif isinstance(table, InertiaTable):
        own = float(np.asarray(table.matrix)[0][0])
        changes += [{"extra_mass": like.extra_mass + x * own} for x in _LOADS]
    return [
        Scene(dataclasses.replace(like, **change), release)
        for change, release in itertools.product(changes, releases)
    ]


@eqx.filter_jit
def _predict(model: Model, mechanisms, releases, times, steps: int):
    def one(mechanism, release):
        return _readings(posed(model, mechanism), release, times, steps)

    return jax.lax.map(lambda x: one(*x), (mechanisms, releases))


@eqx.filter_jit
def _sloped(model: Model, mechanisms, releases, times, steps: int):
    def one(mechanism, release):
        def at(vector):
            found = _readings(posed(model.with_vector(vector), mechanism), release, times, steps)
            return found, found

        slopes, found = jax.jacfwd(at, has_aux=True)(model.vector())
        return found, slopes

    return jax.lax.map(lambda x: one(*x), (mechanisms, releases))


def _readings(model: Model, release, times, steps: int):
    nodes = march(model, times[0], times[-1], release, 0.0 * release, steps=steps)
    return read(model, nodes, times).readings


def _told(
    experiment: Experiment, scene: Scene, names: tuple[str, str], apart: float, now: float
) -> NextExperiment:
    units = experiment.units or ("rad",) * len(experiment.joints)
    release = dict(zip(experiment.joints, map(float, scene.release), strict=True))
    angles = " and ".join(
        f"the {joint} at {amount(x, unit, 3)}"
        for (joint, x), unit in zip(release.items(), units, strict=True)
    )
    r, arm = scene.recording, isinstance(experiment.inertia, ArmTable)
    setting = f"with the elbow at {plain(r.theta2 or 0.0, 3)} rad, " if arm else ""
    if arm and experiment.bearings:
        setting += "on the air bearings, " if r.air_bearings else "without the air bearings, "
    if not arm and r.extra_mass:
        setting += f"with {plain(r.extra_mass, 3)} kg of load, "
    if apart >= 5.0:
        words = (
            f"To tell {names[0]} from {names[1]}, release {setting}{angles}: their predictions "
            f"then differ by {plain(apart, 2)} standard errors of all readings together, where "
            f"now it is {plain(now, 2)}."
        )
    else:
        words = (
            f"No release that was tried (other angles, elbow angles, bearings or loads) would tell "
            f"{names[0]} from {names[1]}: at best they differ by {plain(apart, 2)} standard errors "
            "of all readings together."
        )
    return NextExperiment(
        between=names,
        release=release,
        theta2=None if not arm else float(r.theta2 or 0.0),
        air_bearings=bool(r.air_bearings) if arm and experiment.bearings else None,
        extra_mass=None if arm else float(r.extra_mass),
        difference=apart,
        now=now,
        words=words,
    )
