"""Starts in closed form, against motions that are known exactly."""

import jax
import numpy as np

import residyn
from residyn.fitting.initial_guess import closed_form
from residyn.fitting.problem import ready
from residyn.recordings.tables import InertiaTable


def sticking(t, mass, stiffness, damping, friction, release):
    """(N,) m: a released cart on a spring with Coulomb friction, one half swing after the other."""
    decay, x = 0.5 * damping / mass, np.empty_like(t)
    turn = np.sqrt(stiffness / mass - decay**2)
    began, at = 0.0, release
    while abs(stiffness * at) > friction:
        middle, since = np.sign(at) * friction / stiffness, t - began
        swing = np.cos(turn * since) + decay / turn * np.sin(turn * since)
        now = since >= 0
        x[now] = (middle + (at - middle) * np.exp(-decay * since) * swing)[now]
        began += np.pi / turn
        at = middle - (at - middle) * np.exp(-decay * np.pi / turn)
    x[t >= began] = at
    return x


def test_a_joint_that_stands_still_does_not_hide_its_friction():
    """A cart that sticks at 1.6 s of 12 s."""
    t, noise = np.arange(1200) / 100.0, 2e-4
    angle = sticking(t, 3.4, 210.0, 1.1, 1.2, 0.05)
    angle += noise * np.random.default_rng(1).standard_normal(len(t))
    recording = residyn.Recording.from_arrays(t, angle, noise=noise)
    table = InertiaTable(("slide",), ((3.4,),), ("m",))
    experiment = residyn.Experiment(table, (recording,))
    with jax.enable_x64(True):
        here = ready(experiment, experiment.fit_recordings, ["coulomb_friction:slide"])
        stiffness, damping, friction = closed_form(here, here.typical()).numbers[0]
    assert abs(stiffness - 210.0) < 10.0
    assert damping < 4.0
    assert 0.6 < friction < 1.8
