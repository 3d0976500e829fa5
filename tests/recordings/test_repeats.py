"""Readings of an encoder whose steps are larger than the noise."""

import numpy as np
import pytest

import residyn
from residyn.recordings.tables import InertiaTable

STEP, PACE, STOP = 1.5e-3, 7.0, 0.004
"""rad, rad/s, and the deflection at which friction holds the disc."""


def disc(size, phase, shake, rng):
    """A disc on a spring that dry friction alone stops, in closed form, read by an encoder."""
    time = np.arange(0, 12, 0.01)
    swing = np.floor(PACE * time / np.pi).astype(int)
    swings = np.arange(swing.max() + 2)
    peak = np.maximum(size - 2 * STOP * swings, 0.0)
    last = int(np.argmax(peak <= STOP))  # from where it stays at rest
    off = (-1.0) ** swing * STOP
    angle = off + (-1.0) ** swing * (peak[swing] - STOP) * np.cos(PACE * time - np.pi * swing)
    angle = np.where(swing < last, angle, (-1.0) ** last * peak[last])
    angle += rng.normal(0, shake * STEP, len(time))
    return time, (np.floor(angle / STEP + phase) + 0.5 - phase) * STEP


def recording(shake, seed):
    rng = np.random.default_rng(seed)
    time, read = disc(rng.uniform(0.1, 0.14), rng.uniform(), shake, rng)
    return residyn.Recording.from_arrays(time, read)


@pytest.mark.parametrize("shake", [0.0, 0.2])
def test_a_joint_that_rests_within_a_step_says_one_thing(shake):
    run = recording(shake, 1)
    assert run.counts[run.time > 9.0].mean() < 0.1
    assert run.counts[run.time < 0.3].mean() > 0.9  # fast, over many steps


def test_all_readings_count_where_noise_shakes_them_over_the_steps():
    assert recording(0.6, 1).counts.all()


def test_numbers_from_a_coarse_encoder_are_within_their_errors():
    table, off = InertiaTable(("disc",), ((0.01,),), ("rad",)), []
    for seed in range(6):
        fit = residyn.fit(
            residyn.Experiment(table, (recording(0.0, seed),)),
            effects=["coulomb_friction"],
            starts=1,
        )
        truth = 0.01 * PACE**2, 0.0, 0.01 * PACE**2 * STOP
        off.append([(n.value - x) / n.std for n, x in zip(fit.numbers, truth, strict=True)])
        assert fit.reduced_chi2 > 0.85
    assert (np.sqrt(np.mean(np.square(off), axis=0)) < 2.0).all()
