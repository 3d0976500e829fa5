"""A model that was tried: its evidence under every random torque, and the motion that it has.

A model alone is iterated from the readings, and from rest; what else it begins with, from a motion
that a simpler one has.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import softmax

from ..effects import AbstractEffect
from ..effects.own_numbers import shared
from ..filtering.law import number_slices, numbers_of, state_slices
from ..filtering.trajectory import Scene, Trajectory
from ..fitting import FitError
from ..physics.effect import BASE
from ..physics.parameter import Parameter
from .columns import Columns, Screen, extended, spectral_lines, strengths
from .evidence import (
    COMPLETE,
    FAINT,
    FALL,
    HOPELESS,
    IN_PLAY,
    INDISTINGUISHABLE,
    INTENSITIES,
    READINGS_LEAD,
    SETTLED,
    information,
    log_prior_intensity,
    over_intensities,
    prior_of,
    right_signs,
    torque_scales,
)
from .iteration import evidences_at, settle, sticks
from .simulated import Simulated


@dataclasses.dataclass(frozen=True, eq=False)
class Tried:
    """A model, iterated to its evidence."""

    added: tuple[str, ...]  # labels beyond the base model, in the order in which they joined
    evidences: np.ndarray  # (I,) log evidence at each of `INTENSITIES` of the random torque
    best: Trajectory  # at the likeliest of them
    log_prior: float
    simulated: Simulated | None = dataclasses.field(default=None, kw_only=True)
    """Without a random torque, by exact simulation, where that was done."""

    @property
    def log_evidence(self) -> float:
        """The random torque summed over."""
        return over_intensities(self.evidences)

    @property
    def log_posterior(self) -> float:
        """Not normalised."""
        return self.log_evidence + self.log_prior

    @functools.cached_property
    def weights(self) -> np.ndarray:
        """(I,) posterior of the random torque's intensity, given the model."""
        return softmax(self.evidences + log_prior_intensity(INTENSITIES))

    def needs(self, scene: Scene) -> np.ndarray:
        """(I,) posterior of the random torque that the model needs: of louder ones, too, than it
        was iterated under."""
        known = np.isfinite(self.evidences)
        if known.all():
            return self.weights
        every = np.arange(len(INTENSITIES))
        each = evidences_at(scene, self.best, scene.linearised(self.best), every)
        each = np.where(known, self.evidences, each)
        return softmax(each + log_prior_intensity(INTENSITIES))

    @property
    def complete(self) -> float:
        """Probability, given the model, that it needs no random torque that matters."""
        return float(self.weights[self.enough].sum())

    @property
    def nearly_complete(self) -> bool:
        """Whether the filter cannot tell if the model needs a random torque."""
        return self.evidences[-1] > self.evidences.max() - INDISTINGUISHABLE

    @property
    def enough(self) -> np.ndarray:
        """(I,) the intensities with which the model needs no random torque that matters."""
        return COMPLETE if self.best.coloured is None else FAINT

    @property
    def informed(self) -> bool:
        """Whether the readings say anything of the strengths of each effect that was added
        (`information`): else the model has the odds of the prior, which are no finding."""
        t = self.posterior
        each = (places_of(t, e, strengths(e)) for e in t.effects if e.label in self.added)
        return all(information(t.covariance[np.ix_(own, own)]) > SETTLED for own in each)

    @property
    def intensity(self) -> float:
        """The likeliest random torque."""
        return INTENSITIES[int(np.argmax(self.weights))]

    @property
    def posterior(self) -> Trajectory:
        """With the posterior of its numbers: as simulated exactly where it needs no random torque
        and that was done; else as smoothed."""
        t, known = self.best, self.simulated
        if known is None or self.intensity > 0:
            return t
        u = np.append(known.u, t.u[len(known.u) :])
        return dataclasses.replace(t, u=u, covariance=known.covariance)

    def starts(self, scene: Scene) -> tuple[Trajectory, ...]:
        """Where fits by least squares begin: without a random torque; and as it is, if it has one,
        for a random torque taken away may lead astray."""
        silent = silenced(scene, self.best, self.intensity)
        return (silent, self.best) if self.intensity > 0 else (silent,)

    def simulated_as(self, found: Simulated) -> "Tried":
        """This model, with its exact simulation without a random torque. Linearised once along the
        motion without one it errs alike under all random torques; not so along another, from which
        the motion without any is far, and what sticks has a motion of its own under each."""
        evidences = self.evidences.copy()
        if self.nearly_complete and not sticks(self.best):
            evidences += found.log_evidence - evidences[-1]
        evidences[-1] = found.log_evidence
        return dataclasses.replace(self, evidences=evidences, simulated=found)

    def over_torques(self, scene: Scene) -> list[tuple[float, Trajectory]]:
        """The motion under each random torque that counts, with its posterior probability; where
        none can be smoothed (it runs away), the model's own."""
        system = scene.linearised(self.best)
        found = [
            (w, scene.smoothed(self.best, system, x))
            for w, x in zip(self.weights, INTENSITIES, strict=True)
            if w > IN_PLAY
        ]
        kept = [(w, t) for w, t in found if t is not None] or [(1.0, self.best)]
        return [(w / sum(w for w, _ in kept), t) for w, t in kept]


def signs_of(t: Trajectory) -> np.ndarray:
    """(I,) `right_signs` of a smoothed model, for each random torque that it still needs."""
    std = np.sqrt(np.maximum(np.diag(t.covariance), 1e-300))
    return right_signs(t.effects, t.prior, t.u, std, np.array(INTENSITIES))


def silenced(scene: Scene, t: Trajectory, intensity: float) -> Trajectory:
    """A model without a random torque: where a fit by least squares begins. If it runs away on the
    way there, the last motion that did not."""
    first = INTENSITIES.index(intensity)
    for x in (*INTENSITIES[first + 1 :: FALL], 0.0, 0.0):
        moved = scene.smoothed(t, scene.linearised(t), x)
        if moved is None:
            break
        t = moved
    return t


def tried_alone(
    scene: Scene,
    effects: Sequence[AbstractEffect],
    known: float = -math.inf,
    go_on: Callable[[], None] = lambda: None,
) -> Tried:
    """A model by itself, linearised along the readings at first, and at rest: noise makes of
    readings rates that no model follows. And, where it has effects that are silent there, from the
    springs and dampers alone, which these join one by one as the screen has them: without a
    strength neither shapes nor internal states matter, and no slope leads away. Where it falls
    hopelessly behind a log evidence that is `known`, it is left as far as it has come. `go_on` is
    called before each iteration.

    **Raises:** `FitError` if no motion goes with it.
    """
    plain = [e for e in effects if _begins_at_once(e)]
    silent = [e for e in effects if not _begins_at_once(e)]
    begun = tried_alone(scene, plain, go_on=go_on) if silent else None
    start = scene.start(effects, prior_of(scene, effects))
    starts = [start, dataclasses.replace(start, path=np.zeros_like(start.path))]
    starts = [t for each in starts if (t := _smoothed(scene, each))]
    if begun is not None:
        for effect in silent:
            t, intensity = screening_motion(scene, begun)
            linear = scene.linearised(t)
            lines = spectral_lines(scene, t, linear)
            columns = Columns(scene, t, [shared(effect)], lines, linear=linear)
            (row,) = Screen(columns, screened_at(intensity)).ranked
            begin = scene.consistent(extended(scene, t, row))
            (found,) = settle(scene, [begin], intensity, go_on)
            if found is None:
                break
            begun = Tried((), *found, log_prior=0.0)
        else:
            starts.append(scene.consistent(begun_as(start, begun.best)))
    each = [found for found in settle(scene, starts, INTENSITIES[0], go_on, known) if found]
    if not each:
        raise FitError("no motion of the model goes with the readings")
    best = max((Tried((), *found, log_prior=0.0) for found in each), key=lambda t: t.log_evidence)
    times = torque_scales(scene, best.best)
    if best.log_evidence < known - HOPELESS or times.max() == 1.0:
        return best
    scene.scale_torques(times)
    return tried_alone(scene, effects, known, go_on)


def _begins_at_once(effect: AbstractEffect) -> bool:
    """Whether an effect that is silent has a slope all the same, wherever a motion begins."""
    return effect.name in BASE or effect.senses or not strengths(effect)


def _smoothed(scene: Scene, start: Trajectory) -> Trajectory | None:
    """A start after one step. Of a path that no model was smoothed to, evidence says nothing: about
    rest, that of a linear arm, which may be above all that the true one has."""
    return scene.smoothed(start, scene.linearised(start), INTENSITIES[0])


def begun_as(start: Trajectory, known: Trajectory) -> Trajectory:
    """A model at its start, with the motion, numbers and internal states that another one with the
    same effects has; numbers of a run's own as those that all share."""
    n = known.path.shape[1] - known.first.shape[1]
    t = dataclasses.replace(known, effects=start.effects, prior=start.prior, u=np.array(start.u))
    t = dataclasses.replace(t, path=np.array(start.path), first=np.array(start.first))
    t.path[:, :n] = known.path[:, :n]
    places = zip(t.effects, number_slices(t.effects), state_slices(t.effects), strict=True)
    for effect, own, states in places:
        i = known.labels.index(effect.label)
        fields = [x.field for x in numbers_of(known.effects[i])]
        at = dict(zip(fields, known.u[number_slices(known.effects)[i]], strict=True))
        t.u[own] = [at.get(x.field, at.get(x.field.rpartition("_")[0])) for x in numbers_of(effect)]
        old = state_slices(known.effects)[i]
        t.path[:, n:][:, states] = known.path[:, n:][:, old]
        t.first[:, states] = known.first[:, old]
    return t


def screening_motion(scene: Scene, model: Tried) -> tuple[Trajectory, float]:
    """The motion that candidates are screened along, and its random torque: the likeliest, or one
    that still lets the readings lead."""
    noise = model.best.coloured is not None  # of the readings: the louder, the less they lead
    intensity = model.intensity if noise else max(model.intensity, READINGS_LEAD)
    if intensity == model.intensity:
        return model.best, intensity
    system = scene.linearised(model.best)
    return scene.smoothed(model.best, system, intensity) or model.best, intensity


def screened_at(intensity: float) -> list[float]:
    """Random torques over which a screen sums: the likeliest, one a decade below it, and none."""
    return sorted({intensity, 0.1 * intensity, 0.0}, reverse=True)


def may_be_complete(model: Tried) -> bool:
    """Whether a model may need no random torque, which an exact simulation tells: a filter's word
    is not enough where something sticks."""
    return model.nearly_complete or sticks(model.best)


def places_of(t: Trajectory, effect: AbstractEffect, numbers: Sequence[Parameter]) -> list[int]:
    """Where some numbers of an effect stand among all of a model."""
    first = number_slices(t.effects)[t.labels.index(effect.label)].start
    return [first + i for i, n in enumerate(numbers_of(effect)) if n in numbers]
