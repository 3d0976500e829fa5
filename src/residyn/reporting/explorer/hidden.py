"""Hide one: the same arm, simulated, with an effect in it that the page does not tell.

Springs and dampers are as they were fitted, or less damped, for a fitted damper has swallowed
whatever else takes energy; the effect is drawn from the catalogue, with a strength that shows.
"""

import dataclasses

import numpy as np

from ...diagnosis.evidence import signed
from ...effects import AbstractEffect
from ...filtering.law import numbers_of, with_numbers
from ...fitting.problem import mechanism_of, posed
from ...fitting.result import Fit
from ...physics.model import Model
from ...recordings.experiment import Experiment
from ...recordings.recording import Recording
from ...simulation.simulate import simulate
from .study import Study

_SHARE = (0.03, 0.15)  # of an effect's typical size
_DAMPED = 0.3  # of the fitted damping, where an effect that takes energy is hidden
_SEEN = 8.0  # times the noise, rms, that the effect must move the readings
_TRIES = 60


def hide_one(study: Study, random: np.random.Generator) -> tuple[Experiment, AbstractEffect]:
    """A simulated experiment, and what is hidden in it.

    **Raises:** `ValueError` if no effect of the catalogue would show here.
    """
    fit = study.fit(())
    candidates = [
        e for e in study.search.candidates
        if not e.senses and not e.oscillates and not e.memory and e.place in study.experiment.joints
    ]  # fmt: skip
    dampers = {n.name: _DAMPED * n.value for n in fit.numbers if n.name.startswith("damper:")}
    model = fit.model.with_values(dampers)
    without = _simulated(fit, model)
    for _ in range(_TRIES if candidates else 0):
        effect = _drawn(study, candidates[random.integers(len(candidates))], random)
        with_it = _simulated(fit, model + effect)
        moved = np.concatenate([
            ((a - b) / r.recording.noise).ravel()
            for a, b, r in zip(with_it, without, fit.recordings, strict=True)
        ])  # fmt: skip
        size = [np.nanmax(np.abs(r.recording.angle)) for r in fit.recordings]
        sane = all(np.isfinite(a).all() and np.abs(a).max() < 3 * s
                   for a, s in zip(with_it, size, strict=True))  # fmt: skip
        if sane and np.sqrt(np.mean(moved**2)) > _SEEN:
            made = [
                _recording(beside.recording, angle, random)
                for beside, angle in zip(fit.recordings, with_it, strict=True)
            ]
            return dataclasses.replace(study.experiment, recordings=tuple(made), path=""), effect
    raise ValueError("no effect of the catalogue would show in these recordings")


def _drawn(study: Study, effect: AbstractEffect, random: np.random.Generator) -> AbstractEffect:
    scene, values = study.search.scene, []
    for number in numbers_of(effect):
        size = scene.size(effect, number)
        if number.silent is None:
            values.append(size * (random.choice(number.grid) if number.grid else 1.0))
        else:
            sign = 1.0 if signed(number) else random.choice([-1.0, 1.0])
            values.append(number.silent + sign * size * np.exp(random.uniform(*np.log(_SHARE))))
    return with_numbers(effect, np.array(values))


def _simulated(fit: Fit, model: Model) -> list[np.ndarray]:
    """(N, n) readings of every recording, without noise."""
    found, n = [], len(fit.joints)
    for beside in fit.recordings:
        r, state = beside.recording, beside.state
        here = posed(model, mechanism_of(fit.experiment, r))
        time, begin = r.time - r.time[0], (state[:n], state[n : 2 * n])
        found.append(np.asarray(simulate(here, time, *begin, orders=r.orders).readings))
    return found


def _recording(like: Recording, angle: np.ndarray, random: np.random.Generator) -> Recording:
    return Recording.from_arrays(
        like.time - like.time[0],
        angle + like.noise * random.standard_normal(angle.shape),
        noise=like.noise,
        theta2=like.theta2,
        role=like.role,
        name=f"simulated {like.role} recording",
        air_bearings=like.air_bearings,
        extra_mass=like.extra_mass,
        load=like.load,
        reads=like.reads or "angle",
    )
