"""One experiment under study: its search, and least-squares fits of any set of effects.

A page, live or not, shows a `Study`. It begins with the base model's smoothed motion and the first
order of all candidates; the search adds tried models; and any set of effects that somebody chooses
is fitted by least squares, from the tried model where there is one, else from the first order.
"""

import dataclasses
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...diagnosis.columns import Columns, Screened, extended
from ...diagnosis.diagnose import MOST_EFFECTS, Fits, concluded
from ...diagnosis.evidence import INTENSITIES, prior_of
from ...diagnosis.forecast import HeldOut, held_out
from ...diagnosis.linearised_fit import LinearisedFit
from ...diagnosis.missing_torque import scene_of
from ...diagnosis.result import Diagnosis
from ...diagnosis.search import Search, Tried, settle, silenced, tried_alone
from ...effects import AbstractEffect
from ...filtering.trajectory import Prior, Scene, Trajectory
from ...fitting import DEFAULT_STARTS, fit
from ...fitting.fit import finish
from ...fitting.lanes import alone
from ...fitting.multistart import Descent, outliers_among, polishing
from ...fitting.problem import Unknowns, ready
from ...fitting.result import Fit, FitError
from ...recordings.experiment import Experiment
from .first_order import FirstOrder, first_order

_STEPS = 8  # of Gauss and Newton, of a quick fit
_SETTLED = 0.01  # of the error, in its last step
_WORSE = 1.02  # of chi-square: with an effect more, a minimum above this is another one's


class Quick(NamedTuple):
    """A fit by the smoother."""

    path: Trajectory
    fitted: np.ndarray
    """(n,) rms error over the noise."""
    held_out: np.ndarray | None


class Study:
    """An experiment, the base model, and all that has been tried on it."""

    def __init__(
        self,
        experiment: Experiment,
        effects: Sequence[str | AbstractEffect] = (),
        say: Callable[[str], None] = lambda words: None,
    ):
        """Smooth the motion with the base model and screen all candidates.

        **Raises:** `ValueError` for an effect that does not exist or does not go with the
        experiment, or without a recording to fit; `FitError` if the base model has no fit.
        """
        if not experiment.fit_recordings:
            raise ValueError('no recording has role = "fit": there is nothing to fit to')
        self.experiment, self.effects, self.say = experiment, tuple(effects), say
        with jax.enable_x64(True):
            scene, base, wild = scene_of(experiment, effects)
            self._keep(Search(scene, base, say=say), Fits(experiment, scene, wild, DEFAULT_STARTS))
            say("fitting springs and dampers")
            self.fit(())

    @classmethod
    def of(cls, found: Diagnosis) -> "Study":
        """The study that a diagnosis was.

        **Raises:** `ValueError` if it did not keep its search.
        """
        if found.search is None:
            raise ValueError("this diagnosis did not keep its search")
        self = cls.__new__(cls)
        self.experiment, self.say = found.fits.whole, lambda words: None
        self.effects = tuple(
            e for e in found.base.model.effects if e.name not in ("spring", "damper")
        )
        with jax.enable_x64(True):
            self._keep(found.search, found.fits)
        self.found = found
        for step in found.ladder:
            added = [x for x in step.fit.model.labels if x not in found.base.model.labels]
            self.fits[frozenset(added)] = step.fit
            self._held[frozenset(added)] = step.held_out
        return self

    def _keep(self, search: Search, fits: Fits) -> None:
        self.search, self.least_squares = search, fits
        self.fits: dict[frozenset[str], Fit] = {}
        self.found: Diagnosis | None = None
        self._held: dict[frozenset[str], HeldOut | None] = {}
        self._lock = threading.RLock()
        self._quick: dict[frozenset[str], Quick | None] = {}
        self._beside: Scene | None = None
        self.screen = search.screen(search.base)
        self.loud, self.intensity = search.screening_motion(search.base)
        self.shapes = {s.effect.label: s.shape for s in self.screen.ranked}

    @property
    def labels(self) -> tuple[str, ...]:
        """Candidates, by name."""
        return tuple(s.effect.label for s in self.screen.ranked)

    def columns(self, scene: Scene | None = None, trajectory=None) -> Columns:
        """Every candidate at its likeliest shape, along the base model's motion."""
        effects = [s.effect for s in self.screen.ranked]
        return Columns(
            scene or self.search.scene, trajectory or self.loud, effects, [], self.shapes
        )

    def first_order(self) -> FirstOrder | None:
        """What each candidate does to the readings, fitted and held out."""
        fitted, held = self.experiment.fit_recordings, self.experiment.check_recordings
        beside, scene = None, self.search.scene
        with jax.enable_x64(True):
            if held:
                self.say("smoothing the recordings that are held out")
                here = ready(self.experiment, held, self.effects)
                wild = outliers_among(here, [r.angle for r in here.recordings])
                other = Scene(here.recordings, here.mechanisms, wild)
                other.scales, other.torque = scene.scales, scene.torque  # the same priors
                self._beside = other
                base = tuple(self.loud.effects)
                best = tried_alone(other, base).best
                led = other.smoothed(best, other.linearised(best), self.intensity)
                beside = self.columns(other, led or best)
            noise = np.stack([r.noise for r in (*fitted, *held)])
            return first_order(self.columns(), beside, noise)

    # -- without compiling anything -----------------------------------------------------------

    def quick(self, added: Sequence[str]) -> "Quick | None":
        """The base model and some candidates, fitted by the smoother without a random torque: least
        squares by Gauss and Newton, with the programs that the screen has used. None if that does
        not settle.

        **Raises:** `ValueError` for what is no candidate.
        """
        key = frozenset(added)
        self._check(key)
        if key not in self._quick:
            known = self.search.tried.get(key)
            with jax.enable_x64(True):
                self._quick[key] = self._quickly(known) if known else self._from_afar(tuple(added))
        return self._quick[key]

    def _from_afar(self, added: tuple[str, ...]) -> "Quick | None":
        """A model that was not tried: straight from the first order if it is smooth, else from the
        readings' lead to its own, as the search would."""
        guess = self._guessed(added)
        found = None if _sticks(guess.best) else self._quickly(guess)
        if found is not None:
            return found
        (settled,) = settle(self.search.scene, [guess.best], self.intensity)
        return None if settled is None else self._quickly(Tried(added, *settled, log_prior=0.0))

    def _quickly(self, model: Tried) -> "Quick | None":
        scene, before = self.search.scene, None
        path = silenced(scene, model.best, model.intensity)
        for _ in range(_STEPS):
            moved = scene.smoothed(path, scene.linearised(path), 0.0)
            if moved is None:
                return None
            errors, path = times_noise(scene, moved), moved
            if before is not None and np.allclose(errors, before, rtol=_SETTLED):
                return Quick(path, errors, self._held_out_by(path))
            before = errors
        return None

    def _held_out_by(self, path: Trajectory) -> np.ndarray | None:
        """(n,) errors on the check recordings, of which only the first states are fitted."""
        other = self._beside
        if other is None:
            return None
        numbers = path.numbers
        known = Prior(numbers, np.full(len(numbers), 1e-9), np.zeros(len(numbers), bool))
        led, loud = other.start(path.effects, known), INTENSITIES[0]
        if _sticks(path):  # that takes more steps
            (found,) = settle(other, [led], loud)
            led = led if found is None else found[1]
        led = silenced(other, led, loud)
        end = other.smoothed(led, other.linearised(led), 0.0)
        return None if end is None else times_noise(other, end)

    def _check(self, key: frozenset[str]) -> None:
        for label in key - set(self.labels):
            raise ValueError(f"{label} is no candidate")

    # -- least squares ------------------------------------------------------------------------

    def fit(self, added: Sequence[str], held: Mapping[str, float] | None = None) -> Fit:
        """The base model and some candidates, fitted by least squares; numbers in `held`, by name,
        stay as they are.

        **Raises:** `FitError`; `ValueError` for what is no candidate or no number of this model.
        """
        key = frozenset(added)
        self._check(key)
        with self._lock, jax.enable_x64(True):
            if key not in self.fits:
                self.fits[key] = self._fitted(tuple(added))
            found = self.fits[key]
            return self._holding(found, held) if held else found

    def held_out(self, added: Sequence[str], found: Fit) -> np.ndarray | None:
        """(n,) errors over the noise on readings that were not fitted; None if not known."""
        if found.check_rmse is not None:
            return found.check_rmse / found.noise
        key = frozenset(added)
        if found is not self.fits.get(key):
            return None
        with self._lock, jax.enable_x64(True):
            if key not in self._held:
                self._held[key] = held_out(LinearisedFit.of(found))
            beside = self._held[key]
        return None if beside is None else beside.held_out.ratio

    def _fitted(self, added: tuple[str, ...]) -> Fit:
        known = self.search.tried.get(frozenset(added))
        found = self.least_squares.of(known or self._guessed(added))
        if added:
            base = self.fits.get(frozenset())
            if base is not None and found.reduced_chi2 > _WORSE * base.reduced_chi2:
                own = {e.label: e for e in self.search.candidates}
                effects = [*self.effects, *(own[x] for x in added)]
                again = fit(self.least_squares.experiment, effects=effects)
                found = min(found, again, key=lambda f: f.reduced_chi2)
        return found

    def _guessed(self, added: tuple[str, ...]) -> Tried:
        """A model from the first order of its effects together."""
        rows = {s.effect.label: s for s in self.screen.ranked}
        chosen: list[Screened] = [rows[x] for x in added]
        _, means = self.screen.gain(chosen)
        trajectory, first = self.loud, 0
        for s in chosen:
            own = means[first : first + len(s.which)]
            first += len(s.which)
            s = s._replace(regressors=own)
            trajectory = extended(self.search.scene, trajectory, prior_of, s)
        here = np.where(np.array(INTENSITIES) == self.intensity, 0.0, -np.inf)
        return Tried(added, here, trajectory, 0.0)

    def _holding(self, found: Fit, held: Mapping[str, float]) -> Fit:
        """A fit again, from where it is, with some numbers kept at given values."""
        began = time.perf_counter()
        names = [n.name for n in found.numbers]
        for name, value in held.items():
            if name not in names or not np.isfinite(value):
                raise ValueError(f"{name} = {value}: is no number of this model")
        begin = found.model.with_values({k: jnp.asarray(float(v)) for k, v in held.items()})
        problem = dataclasses.replace(
            found.problem,
            model=begin,
            active=np.array([float(name not in held) for name in names]),
        )
        start, states = np.asarray(begin.vector()), found.problem.states(found.unknowns)
        y = problem.scaled(start, states)
        starts = Unknowns(np.asarray(y.numbers)[None], np.asarray(y.states)[None])
        out = alone(polishing(problem, starts, [1.0]))
        if not np.isfinite(out.cost):
            raise FitError("with these numbers the motion runs away")
        outliers = [r.wild for r in found.recordings if r.recording.role != "check"]
        ends = out.unknowns, out.compressed, out.cost, out.steps, out.converged
        descent = Descent(found.ready, problem, outliers, *ends, starts=1, agreeing=1)
        return finish(found.experiment, start, descent, began)

    # -- the search ---------------------------------------------------------------------------

    def diagnose(self, say: Callable[[str], None], most: int = MOST_EFFECTS) -> Diagnosis:
        """Search for what is missing, from what is there; call it once, in a thread of its own."""
        began = time.perf_counter()
        with jax.enable_x64(True):
            self.search.say = say
            self.search.run(most)
            found = concluded(self.search, self.least_squares, began, say)
            with self._lock:
                self.found = found
                for step in found.ladder:
                    added = [x for x in step.fit.model.labels if x not in found.base.model.labels]
                    self.fits.setdefault(frozenset(added), step.fit)
                    self._held.setdefault(frozenset(added), step.held_out)
        return found

    def stop(self) -> None:
        """End a search that runs."""
        self.search.deadline = 0.0


def _sticks(path: Trajectory) -> bool:
    """Whether a joint or a brake may stick."""
    return any(e.dry or e.follows for e in path.effects)


def times_noise(scene: Scene, path: Trajectory) -> np.ndarray:
    """(n,) rms error over the noise of a motion without a random torque."""
    g = scene.grid
    seen = np.asarray(scene.linearised(path).seen)
    left = (g.angle - seen) * g.seen
    noise = np.stack([r.noise for r in scene.recordings])
    each = g.seen * noise[g.run] ** 2 / g.variance  # readings in an average
    energy = left**2 * each + (each - g.seen) * noise[g.run] ** 2
    typical = np.sqrt(np.mean(noise**2, axis=0))
    return np.sqrt(energy.sum(0) / np.maximum(each.sum(0), 1)) / typical
