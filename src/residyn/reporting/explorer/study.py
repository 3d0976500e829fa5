"""One experiment under study: its search, and least-squares fits of any set of effects.

A page, live or not, shows a `Study`. It begins with the base model's smoothed motion and the first
order of all candidates; the search adds tried models; and any set of effects that somebody chooses
is fitted by least squares, from the tried model where there is one, else from the first order.
Whoever works with a study does so in float64.
"""

import copy
import dataclasses
import functools
import time
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...diagnosis.columns import Columns, extended, nested
from ...diagnosis.diagnose import MOST_EFFECTS, Fits, diagnosed
from ...diagnosis.evidence import INTENSITIES
from ...diagnosis.forecast import HeldOut, held_out
from ...diagnosis.iteration import settle
from ...diagnosis.linearised_fit import on_host
from ...diagnosis.missing_torque import owning_base, scene_of, with_rests
from ...diagnosis.result import Diagnosis
from ...diagnosis.search import Search
from ...diagnosis.tried import Tried, screening_motion, tried_alone
from ...effects import AbstractEffect
from ...filtering.trajectory import Prior, Scene, Trajectory
from ...fitting import DEFAULT_STARTS
from ...fitting.conclusion import finishing
from ...fitting.lanes import alone
from ...fitting.multistart import Descent
from ...fitting.problem import ready
from ...fitting.result import Fit
from ...physics.effect import BASE
from ...recordings.experiment import Experiment
from .first_order import FirstOrder, first_order

_STEPS = 12  # of Gauss and Newton, at the most
_WHOLE = 2  # steps that are whole where a joint may stick, before they are averaged
_SETTLED = 0.2  # standard errors: a last step that moves no number by more
_NEAR = 0.01  # of the error: the same of a whole step where a joint may stick, which swings
_SWING = 10.0  # standard errors: by which it moves the numbers that say least, at the most


class Refit(NamedTuple):
    """Least squares by the smoother."""

    path: Trajectory
    predicted: np.ndarray  # (K, n) readings, rad or m
    torque: np.ndarray  # (K, n) what all effects resist with, N m
    fitted: np.ndarray  # (n,) rms error over the noise


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
        self.experiment, self.say = experiment, say
        experiment, effects = with_rests(experiment, effects)
        whole = owning_base(experiment, effects)
        scene, base = scene_of(whole, effects)
        self._keep(Search(scene, base, say=say), Fits(whole, scene, DEFAULT_STARTS))
        say("fitting springs and dampers")
        self.predict(())

    @classmethod
    def of(cls, found: Diagnosis) -> "Study":
        """The study that a diagnosis was, which must have kept its search."""
        assert found.search is not None
        self = cls.__new__(cls)
        self.experiment, self.say = found.fits.whole, lambda words: None
        self._keep(found.search, found.fits)
        self._learn(found)
        return self

    def _keep(self, search: Search, fits: Fits) -> None:
        self.search, self.least_squares = search, fits
        self.fits: dict[frozenset[str], Fit] = {}
        self.found: Diagnosis | None = None
        self._held: dict[frozenset[str], HeldOut | None] = {}
        self.refits: dict[frozenset[str], Refit | None] = {}
        self.predictions: dict[frozenset[str], np.ndarray | None] = {}
        self.screen = search.screen(search.base)
        self.loud, self.intensity = screening_motion(search.scene, search.base)
        self.effects = [e for e in self.loud.effects if e.name not in BASE]
        """Of the base model. Of the bearings' effects recordings without any know no name."""
        self.shapes = {s.effect.label: s.shape for s in self.screen.ranked}

    @property
    def labels(self) -> tuple[str, ...]:
        return tuple(s.effect.label for s in self.screen.ranked)

    def neighbours(self, added: Sequence[str], more: Sequence[str]) -> list[frozenset[str]]:
        """Models with one effect less, and with one more of some, which takes the place of laws
        that it contains or that contain it."""
        own = {e.label: e for e in self.search.candidates}
        found = [[x for x in added if x != less] for less in added]
        found += [
            [*(x for x in added if not nested(own[x], own[new])), new]
            for new in more
            if new not in added
        ]
        return list(map(frozenset, found))

    def columns_along(self, scene: Scene, path: Trajectory) -> Columns:
        """Every candidate at its likeliest shape, along a motion."""
        effects = [s.effect for s in self.screen.ranked]
        return Columns(scene, path, effects, [], self.shapes)

    @functools.cached_property
    def columns(self) -> Columns:
        """The same along the base model's motion."""
        return self.columns_along(self.search.scene, self.loud)

    def first_order(self) -> FirstOrder | None:
        """What each candidate does to the readings, fitted and held out."""
        there, path, _ = self.beside
        return first_order(self.columns, self.columns_along(there, path) if path else None)

    @functools.cached_property
    def beside(self) -> tuple[Scene, Trajectory | None, np.ndarray]:
        """Where predictions are tested: the check recordings, or the fitted ones without their last
        thirds; the base model's smoothed motion there, of the check recordings; and (K,) which
        instants are held out."""
        held, scene = self.experiment.check_recordings, self.search.scene
        if not held:
            g, other = scene.grid, copy.copy(scene)
            ends = np.array([r.duration for r in scene.recordings])[g.run]
            late = g.time > 2 / 3 * ends
            other.grid = g._replace(seen=g.seen & ~late[:, None])
            other.readings = scene.readings._replace(seen=jnp.asarray(other.grid.seen))
            return other, None, late
        self.say("smoothing the recordings that are held out")
        here = ready(self.experiment, held, self.effects)
        other = Scene(here.recordings, here.mechanisms, here.outliers)
        other.scales, other.torque = scene.scales, scene.torque
        other.catalogued, other.fixed = scene.catalogued, scene.fixed  # also bearings' effects
        best = tried_alone(other, tuple(self.loud.effects)).best
        led = other.smoothed(best, other.linearised(best), self.intensity)
        return other, led or best, np.ones(other.K, bool)

    # -- by the smoother, without compiling anything ------------------------------------------

    def refit(self, added: Sequence[str], go_on: Callable[[], None] = lambda: None) -> Refit | None:
        """The base model and some candidates by least squares: Gauss and Newton on the whole
        motion, from the likeliest model that is known and part of it, with the programs that the
        screen has used. None if that does not settle. `go_on` is called before each step.

        **Raises:** `ValueError` for what is no candidate; what `go_on` raises.
        """
        key = frozenset(added)
        for label in key - set(self.labels):
            raise ValueError(f"{label} is no candidate")
        if key not in self.refits:
            self.refits[key] = refitted(self.search.scene, self._near(added).best, go_on)
        return self.refits[key]

    def predicted(
        self, added: Sequence[str], go_on: Callable[[], None] = lambda: None
    ) -> np.ndarray | None:
        """(n,) errors over the noise of a `refit` on what was held out; None where that does not
        settle. Of check recordings only the first states are fitted; last thirds are predicted from
        the rest.

        **Raises:** as `refit`.
        """
        key, found = frozenset(added), self.refit(added, go_on)
        if found is None:
            return None
        if key not in self.predictions:
            self.predictions[key] = self._predicted(found.path, go_on)
        return self.predictions[key]

    def motion(self, added: Sequence[str]) -> Trajectory:
        """The motion of a model, as well as it is known."""
        known = self.search.tried.get(frozenset(added))  # where it sticks as it should
        return (known or self._near(added)).best

    @functools.cached_property
    def base_torque(self) -> np.ndarray:
        """(K, n) what the base model resists with, N m."""
        return sum_of(self.search.scene.torques(self.search.base.best))

    def _predicted(self, path: Trajectory, go_on: Callable[[], None]) -> np.ndarray | None:
        other, begin, counts = self.beside
        if begin is not None:
            numbers, room = path.numbers, path.first.shape[1]
            known = Prior(numbers, np.full(len(numbers), 1e-9), np.zeros(len(numbers), bool))
            n = 2 * other.n
            path = dataclasses.replace(
                path, prior=known, u=np.zeros_like(path.u), spread=begin.spread,
                first=np.zeros((len(begin.first), room)),
                path=np.concatenate([begin.path[:, :n], np.zeros((other.K, room))], axis=1),
            )  # fmt: skip
            if any(e.memory for e in path.effects):  # of which nothing is known there
                (led,) = settle(other, [path], INTENSITIES[0], go_on)
                path = path if led is None else led[1]
        found = refitted(other, path, go_on)
        if found is None:
            return None
        measured = other if begin is not None else self.search.scene
        return times_noise(measured, found.predicted, counts)

    # -- least squares ------------------------------------------------------------------------

    def fit(
        self,
        added: Sequence[str],
        held: Mapping[str, float] | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> Fit:
        """The base model and some candidates, fitted by least squares; numbers in `held`, by name,
        stay as they are. `progress` is called with a few words now and then.

        **Raises:** `FitError`; `ValueError` for what is no candidate or no number of this model;
        what `progress` raises.
        """
        key = frozenset(added)
        if key not in self.fits:
            known = self.search.tried.get(key)
            if known is None:
                self.refit(added)
                known = self._near(added)
            self.fits.setdefault(key, self.least_squares.fitted(known, progress))
        found = self.fits[key]
        return self._holding(found, held) if held else found

    def held_out(self, added: Sequence[str], found: Fit) -> np.ndarray | None:
        """(n,) errors over the noise on readings that were not fitted; None if not known."""
        if found.check_ratio is not None:
            return found.check_ratio
        key = frozenset(added)
        beside = self._held.get(key) if found is self.fits.get(key) else None
        return None if beside is None else beside.held_out.ratio

    def predict(self, added: Sequence[str], held: Mapping[str, float] | None = None) -> Fit:
        """`fit` with what it predicts of the readings that were held out.

        **Raises:** as `fit`.
        """
        found, key = self.fit(added, held), frozenset(added)
        if self.experiment.check_recordings:
            if found.check_rmse is None:
                found = self.least_squares.with_held_out(found)
                if not held:
                    self.fits[key] = found
        elif not held and key not in self._held:
            self._held[key] = held_out(found)
        return found

    def _near(self, added: Sequence[str]) -> Tried:
        """A model from what is known of it: the search's, or by least squares, or the likeliest
        without a random torque of those that are part of it, with the other effects as the first
        order has them together."""
        key, none = frozenset(added), np.array(INTENSITIES) == 0
        known = list(self.search.tried.values())
        for part, refit in list(self.refits.items()):
            if refit is not None:
                here = np.where(none, refit.path.log_evidence, -np.inf)
                known.append(Tried(tuple(part), here, refit.path, 0.0))
        known = [t for t in known if key.issuperset(t.added)]
        near = max(known, key=lambda t: (len(t.added) == len(key), t.evidences[-1]))
        rows = {s.effect.label: s for s in self.screen.ranked}
        chosen = [rows[x] for x in added]
        _, means = self.screen.gain(chosen)
        ends, trajectory = np.cumsum([len(s.which) for s in chosen]), near.best
        for s, own in zip(chosen, np.split(means, ends)[:-1], strict=True):
            if s.effect.label not in near.added:
                s = s._replace(regressors=own)
                trajectory = extended(self.search.scene, trajectory, s)
        return dataclasses.replace(near, added=tuple(added), best=trajectory)

    def _holding(self, found: Fit, held: Mapping[str, float]) -> Fit:
        """A fit again, from where it is, with some numbers kept at given values."""
        began = time.perf_counter()
        names = [n.name for n in found.numbers]
        for name, value in held.items():
            if name not in names or not np.isfinite(value):
                raise ValueError(f"{name} = {value}: is no number of this model")
        begin = found.model.with_values({k: jnp.asarray(float(v)) for k, v in held.items()})
        active = np.array([float(name not in held) for name in names])
        problem = dataclasses.replace(found.problem, model=begin, active=active)
        start, states = np.asarray(begin.vector()), found.problem.states(found.unknowns)
        at = problem.scaled(start, states)
        end = on_host(problem, at, np.ones(1), 1.0)
        outliers = [r.wild for r in found.recordings if r.recording.role != "check"]
        descent = Descent(found.ready, problem, outliers, *end[:-1])
        given = found.experiment, start, descent, began
        return alone(finishing(*given, correct=False), on_host)

    # -- the search ---------------------------------------------------------------------------

    def diagnose(self) -> Diagnosis:
        """Search for what is missing, from what is there; call it once, in a thread of its own."""
        began = time.perf_counter()
        found = diagnosed(self.search, self.least_squares, self.effects, MOST_EFFECTS, began)
        self._learn(found)
        return found

    def _learn(self, found: Diagnosis) -> None:
        for step in found.ladder:
            key = frozenset(step.fit.model.labels) - frozenset(found.base.model.labels)
            self.fits.setdefault(key, step.fit)
            self._held.setdefault(key, step.held_out)
        self.found = found

    def stop(self) -> None:
        self.search.deadline = 0.0


def refitted(scene: Scene, path: Trajectory, go_on: Callable[[], None]) -> Refit | None:
    """A model without a random torque, from a motion near the readings: Gauss and Newton until the
    numbers stand still. None where that does not settle. `go_on` is called before each step.

    Readings and torques are those of the last linearisation, moved by the last step. Where a joint
    may stick whole steps swing about the end, and averages of them converge to it.
    """
    sticks = any(e.dry or e.follows for e in path.effects)
    for k in range(_STEPS):
        go_on()
        share = 2.0 / (2.0 + k) if sticks and k >= _WHOLE else 1.0
        linear = scene.linearised(path)
        moved = scene.smoothed(path, linear, 0.0, share)
        if moved is None:
            return None
        system, change = linear.system, moved.path - path.path
        seen = np.asarray(linear.seen)
        beyond = np.asarray(system.Hu) @ (moved.u - path.u)
        beyond += np.einsum("kjx,kx->kj", np.asarray(system.Hx), change)
        here, there = times_noise(scene, seen), times_noise(scene, seen + beyond / share)
        count = len(moved.prior.mean)
        std = np.sqrt(np.diag(moved.covariance)[:count]) * max(1.0, np.max(here))
        step = np.max(np.abs(moved.u - path.u)[:count] / std) / share
        swings = share < 1 and np.allclose(there, here, rtol=_NEAR)
        if step < (_SWING if swings else _SETTLED):
            predicted = seen + beyond
            torque = sum_of(scene.torques(moved, linear))
            return Refit(moved, predicted, torque, times_noise(scene, predicted))
        path = moved
    return None


def sum_of(torques: Mapping[str, np.ndarray]) -> np.ndarray:
    """(K, n) the torque of all effects together."""
    return np.sum([*torques.values()], axis=0)


def times_noise(scene: Scene, predicted: np.ndarray, counts: np.ndarray | None = None):
    """(n,) rms error over the noise of predictions (K, n) of the readings, at all instants or at
    some."""
    g = scene.grid
    use = g.seen if counts is None else g.seen & counts[:, None]
    left = (g.angle - predicted) * use
    noise = np.stack([r.noise for r in scene.recordings])
    each = use * noise[g.run] ** 2 / g.variance  # readings in an average
    energy = left**2 * each + (each - use) * noise[g.run] ** 2
    typical = np.sqrt(np.mean(noise**2, axis=0))
    return np.sqrt(energy.sum(0) / np.maximum(each.sum(0), 1)) / typical
