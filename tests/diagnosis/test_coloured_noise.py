"""Noise of the readings that is not white: an Ornstein-Uhlenbeck process beside their own.

It has the random torque's place: what a model leaves is either, and the readings tell which.
"""

import dataclasses

import jax
import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

import residyn
from residyn.diagnosis.evidence import prior_of
from residyn.diagnosis.missing_torque import scene_of
from residyn.recordings.tables import InertiaTable
from tests.exact import dry_motion

INERTIA, STIFFNESS, DAMPING = 0.31, 9.4, 0.03
STEP, RMS, TIME = 0.01, 2e-3, 0.045  # s; rad, and s of the noise


def recorded(
    friction: float = 0.0, seed: int = 0, duration: float = 20.0, white: bool = False
) -> residyn.Experiment:
    """A torsion pendulum, from one reversal to the next, read with AR(1) noise or white noise."""
    time = np.arange(0.0, duration, STEP)
    angle = dry_motion(
        lambda q, v: (INERTIA * np.eye(1), -STIFFNESS * q - DAMPING * v),
        np.array([friction]), np.array([0.25, 0.0]), time,
    )  # fmt: skip
    keeps = 0.0 if white else np.exp(-STEP / TIME)
    pushed = RMS * np.sqrt(1 - keeps**2) * np.random.default_rng(seed).standard_normal(len(time))
    pushed[0] /= np.sqrt(1 - keeps**2)  # it is stationary from the first
    noise = lfilter([1.0], [1.0, -keeps], pushed)
    recording = residyn.Recording.from_arrays(time, angle + noise[:, None])
    table = InertiaTable(("joint",), [[INERTIA]], ("rad",))
    return residyn.Experiment(table, (recording,))


def test_its_evidence_is_the_closed_form():
    """Of the linear system: a normal distribution of all readings together."""
    with jax.enable_x64(True):
        white, base = scene_of(recorded(duration=3.0), ())
        t = white.start(base, prior_of(white, base))
        t = dataclasses.replace(t, path=np.zeros_like(t.path))
        scene = white.with_noise(0.08)
        linear, intensity = scene.linearised(t), 0.03
        ours = float(scene.evidences(t, linear, [intensity]).log_evidence[0])
    system, K, noise = linear.system, scene.grid.real, scene.noise(t)
    X, P = noise.mean.shape[0], len(t.u)
    # States as a linear function of the first one and the regressors.
    mean, by = noise.mean, np.hstack([np.eye(X), np.zeros((X, P))])
    means, slopes = [], []
    for k in range(K):
        means.append((system.Hx[k] @ mean + system.hc[k])[0])
        slopes.append((system.Hx[k] @ by + np.hstack([np.zeros((1, X)), system.Hu[k]]))[0])
        mean = system.A[k] @ mean + system.c[k]
        by = system.A[k] @ by + np.hstack([np.zeros((X, X)), system.B[k]])
    prior = np.diag(np.append(noise.variance[:X], np.ones(P)))
    time, y = scene.grid.time[:K], scene.grid.angle[:K, 0]
    rms = intensity * np.std(y)
    covariance = np.array(slopes) @ prior @ np.array(slopes).T
    covariance += rms**2 * np.exp(-np.abs(time[:, None] - time) / 0.08)
    covariance += np.diag(scene.grid.variance[:K, 0])
    assert ours == pytest.approx(multivariate_normal.logpdf(y, means, covariance), abs=1e-4)


def test_a_clean_rig_in_coloured_noise_lacks_nothing():
    found = residyn.diagnose(recorded())
    assert found.verdict == "adequate"
    assert found.verdict_probability > 0.95
    assert not found.added
    noise = found.coloured_noise
    assert noise is not None
    assert noise.rms["joint"][0] == pytest.approx(RMS, rel=0.1)
    assert 0.02 < noise.correlation_time < 0.2
    assert "The noise of the readings is not white" in str(found)
    assert "does not explain this motion" not in str(found)
    assert found.to_dict()["coloured_noise"]["rms"]["joint"]["unit"] == "rad"


def test_friction_is_found_in_coloured_noise():
    found = residyn.diagnose(recorded(friction=0.06, seed=1))
    assert found.verdict == "missing"
    assert found.added == ("coulomb_friction:joint",)
    # Stribeck's law contains Coulomb's, and such noise hides what it has more.
    (coulomb, stribeck) = (found.candidate(f"{x}_friction:joint") for x in ("coulomb", "stribeck"))
    assert coulomb.probability > stribeck.probability
    assert coulomb.probability + stribeck.probability > 0.9
    noise = found.coloured_noise
    assert noise is not None
    assert 0.02 < noise.correlation_time < 0.1  # without friction it would be 0.16 s
    # Pictures of what the base model lacks are of a torque all the same.
    assert found.missing[0].torque.rms[0] > 0.01


def test_white_noise_is_not_called_coloured():
    found = residyn.diagnose(recorded(seed=5, white=True))
    assert found.verdict == "adequate"
    assert found.coloured_noise is None
