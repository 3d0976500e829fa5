"""Recordings at equal steps, from which initial guesses begin."""

import numpy as np

from residyn.fitting.smoothing import smooth, uniform
from residyn.recordings.recording import Recording


def test_a_long_pause_of_the_logger_makes_no_endless_grid():
    t = np.arange(200) / 100
    angle = np.cos(3 * t)
    whole = uniform(Recording.from_arrays(t, angle, noise=1e-3), np.zeros((200, 1), bool))
    np.testing.assert_array_equal(whole.q[:, 0], angle)
    paused = Recording.from_arrays(t + 1e5 * (t >= 1), angle, noise=1e-3)
    grid = uniform(paused, np.zeros((200, 1), bool))
    assert len(grid.q) <= 10 * 200 + 1
    assert grid.dt * (len(grid.q) - 1) > 0.99 * paused.duration
    assert grid.good.sum() < 10  # nothing was read in the pause


def test_readings_that_are_lost_at_an_end_are_not_made_up():
    t = np.arange(200) / 100
    angle = np.stack([np.cos(3 * t), np.sin(3 * t)], axis=1)
    angle[:30, 0] = angle[-1, 1] = np.nan
    grid = uniform(Recording.from_arrays(t, angle, noise=1e-3), np.zeros((200, 2), bool))
    np.testing.assert_array_equal(np.flatnonzero(~grid.good), [*range(30), 199])
    assert np.abs(grid.q).max() <= 1


def test_weight_goes_to_what_moves():
    """Of two joints one rings on and one stops early, at an angle of its own."""
    t, noise, still = np.arange(1200) / 100, np.full(2, 1e-3), np.arange(1200) > 300
    angle = np.stack([0.1 * np.cos(5 * t), np.where(still, 0.02, 0.1 * np.cos(8 * t))], axis=1)
    angle += noise * np.random.default_rng(0).standard_normal(angle.shape)
    halves = np.array([6, 20, 60])
    after = np.arange(1200) > 300 + 4 * halves[-1]

    def shares(joints, dry):
        whole = Recording.from_arrays(t, angle[:, joints], noise=noise[joints])
        grid = uniform(whole, np.zeros((1200, len(joints)), bool))
        weight = smooth(grid, halves, noise[joints], 1, dry).weight
        return weight[:, after].sum(axis=1) / weight.sum(axis=1)

    usual = after.mean()
    assert (shares([0, 1], ()) > 0.9 * usual).all()  # one joint rings on
    assert (shares([0, 1], (1,)) < 0.1 * usual).all()  # the other one obeys no equation there
    assert (shares([1], ()) < 0.1 * usual).all()  # nothing moves
