"""Readings that a low-pass filter has smoothed: found in their spectrum, and thinned."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt, sosfiltfilt

import residyn
from residyn.recordings.bandwidth import independent
from residyn.recordings.recording import Recording
from residyn.recordings.tables import InertiaTable

RATE, SIGMA = 200.0, 5e-3
TIME = np.arange(0.0, 20.0, 1.0 / RATE)


def ringing(frequency: float = 0.8, damping: float = 0.01, time: np.ndarray = TIME) -> np.ndarray:
    """A release of 0.5 rad."""
    pace = 2 * np.pi * frequency
    swing = np.cos(pace * np.sqrt(1 - damping**2) * time)
    return 0.5 * np.exp(-damping * pace * time) * swing


def white(seed: int) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal(len(TIME))


@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("filtered", [sosfilt, sosfiltfilt])
@pytest.mark.parametrize("cut_off", [8.0, 20.0])
def test_a_filters_cut_off_is_found(order, filtered, cut_off):
    sections = butter(order, cut_off / (0.5 * RATE), output="sos")
    found = [
        independent(TIME, filtered(sections, ringing() + white(seed))[:, None])
        for seed in range(8)
    ]  # fmt: skip
    known = [(one, band) for one, band in found if one > 1]
    assert len(known) >= 5  # the others stay as they are
    assert all(0.75 * cut_off < band < 2.0 * cut_off for _, band in known)
    assert all(abs(one - 0.5 * RATE / band) <= 0.5 for one, band in known)


@pytest.mark.parametrize("damping", [1e-3, 0.05, 0.6, 0.9])
@pytest.mark.parametrize("noise", [0.0, 1e-4, 1.0])
def test_other_readings_are_taken_as_they_are(damping, noise):
    for frequency in (0.3, 2.0, 9.0):
        angle = ringing(frequency, damping) + noise * white(1)
        coarse = np.round(angle, 3)
        for column in (angle, coarse, np.sign(angle) * np.abs(angle) ** 1.5):
            assert independent(TIME, column[:, None]) == (1, np.inf)


def test_several_joints_are_thinned_alike_and_uneven_or_many_lost_samples_not_at_all():
    sections = butter(4, 0.1, output="sos")
    one = sosfiltfilt(sections, ringing() + white(1))
    other = sosfiltfilt(sections, ringing(1.7) + white(2))
    angle = np.stack([one, other], axis=1)
    assert independent(TIME, angle)[0] in (9, 10, 11)
    mixed = np.stack([one, ringing(1.7) + white(2)], axis=1)
    assert independent(TIME, mixed)[0] == 1
    rng = np.random.default_rng(1)
    assert independent(np.round(1.03 * TIME, 3), angle)[0] == independent(TIME, angle)[0]
    uneven = np.sort(TIME + 0.1 * rng.uniform(-1, 1, len(TIME)))
    assert independent(uneven, angle)[0] == 1
    few, many = (np.where(rng.uniform(size=angle.shape) < x, np.nan, angle) for x in (0.01, 0.1))
    assert independent(TIME, few)[0] in (9, 10, 11)
    assert independent(TIME, many)[0] == 1


def test_a_filtered_recording_says_what_was_taken_and_its_noise_is_what_scatters():
    sections = butter(2, 0.1, output="sos")
    noise = sosfiltfilt(sections, white(3))
    given = {"name": "a.csv"}
    found = Recording.from_arrays(TIME, ringing() + noise, **given)
    (words,) = [w for w in found.warnings if "low-pass" in w]
    every = round(len(TIME) / len(found.time))
    assert words.startswith("a.csv: its readings were low-pass filtered, at about ")
    assert f"one of {every} is taken" in words
    np.testing.assert_array_equal(found.time, TIME[::every])
    assert found.noise[0] == pytest.approx(noise.std(), rel=0.2)
    driven = Recording.from_arrays(TIME, ringing() + noise, drive=np.sin(TIME), **given)
    assert len(driven.time) == len(TIME)


def test_errors_of_a_fit_to_filtered_readings_are_what_they_scatter_by():
    sections, n = butter(4, 0.1, output="sos"), 24
    truth = (2 * np.pi * 0.8) ** 2, 2 * 0.01 * 2 * np.pi * 0.8
    off = []
    for seed in range(n):
        angle = sosfiltfilt(sections, ringing() + white(100 + seed))
        recording = Recording.from_arrays(TIME, angle, noise=SIGMA * np.sqrt(0.1))
        joint = InertiaTable(("joint",), ((1.0,),), ("rad",))
        found = residyn.fit(residyn.Experiment(joint, (recording,)))
        off.append([(x.value - y) / x.std for x, y in zip(found.numbers, truth, strict=True)])
    # Mean squares of n normal numbers; of readings taken as independent these would be near ten.
    squares = np.mean(np.square(off), axis=0)
    assert np.all((squares > 0.45) & (squares < 1.9))
