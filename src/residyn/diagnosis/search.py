"""Which models are worth their evidence: forward selection, exchange and backward elimination.

From the model as it is, all candidates are screened to first order (`columns`); the contenders, and
what no first order can see, are iterated to their own nonlinear evidence beside "nothing more", from
loud random torques to silent ones. The best joins, the motion is smoothed with it, and the next
round begins, until no model beats the one that there is. The models tried, with their evidences, are
all that the rest of the diagnosis needs: it can stop at any time with the best so far.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence

import numpy as np
from scipy.special import logsumexp

from ..effects import AbstractEffect
from ..filtering.trajectory import Scene, Trajectory, number_slices, state_slices
from .columns import Columns, Screen, candidates, extended, spectral_lines
from .evidence import (
    CORRELATION,
    INDISTINGUISHABLE,
    INTENSITIES,
    NEGLIGIBLE,
    log_evidence,
    log_prior_intensity,
    log_prior_model,
    over_intensities,
    prior_of,
)

CONTENDERS = 6
"""Candidates of each screen that are iterated, and as many pairs whose members are."""
_ITERATIONS = 8  # at one intensity, at the most
_LED = 0.01  # random torque from which contenders are iterated, at least: the readings lead
_SETTLED = 0.1  # nats
_HOPELESS = 30.0  # nats behind the best on the way


@dataclasses.dataclass(frozen=True, eq=False)
class Tried:
    """A model, iterated to its evidence."""

    added: tuple[str, ...]
    """Labels beyond the base model, in the order in which they joined."""
    intensities: tuple[float, ...]
    evidences: np.ndarray
    """(I,) log evidence at each random torque."""
    trajectories: tuple[Trajectory | None, ...]
    log_prior: float

    @property
    def log_evidence(self) -> float:
        """The random torque summed over."""
        return over_intensities(self.evidences, self.intensities)

    @property
    def log_posterior(self) -> float:
        """Not normalised."""
        return self.log_evidence + self.log_prior

    @property
    def weights(self) -> np.ndarray:
        """(I,) posterior of the random torque's intensity, given the model."""
        each = np.nan_to_num(self.evidences, nan=-np.inf) + log_prior_intensity(self.intensities)
        return np.exp(each - logsumexp(each))

    @property
    def complete(self) -> float:
        """Probability, given the model, that it needs no random torque that matters."""
        return float(self.weights[np.array(self.intensities) <= NEGLIGIBLE].sum())

    @property
    def best(self) -> Trajectory:
        """The trajectory at the likeliest random torque."""
        found = self.trajectories[int(np.argmax(self.weights))]
        assert found is not None
        return found

    @property
    def intensity(self) -> float:
        """The likeliest random torque."""
        return self.intensities[int(np.argmax(self.weights))]

    @property
    def silent(self) -> Trajectory:
        """The trajectory at the smallest random torque that it was iterated to."""
        return next(t for t in reversed(self.trajectories) if t is not None)

    def loud(self) -> tuple[Trajectory, float]:
        """A trajectory that the readings still lead, to look for more along: at the likeliest random
        torque, or a louder one."""
        k = int(np.argmax(self.weights))
        while k > 0 and (self.intensities[k] < _LED or self.trajectories[k] is None):
            k -= 1
        found = self.trajectories[k]
        assert found is not None
        return found, self.intensities[k]


def anneal(
    scene: Scene,
    starts: Sequence[Trajectory],
    intensities: Sequence[float],
    deadline: float = math.inf,
) -> list[tuple[np.ndarray, tuple[Trajectory | None, ...]]]:
    """Iterate models from loud random torques to silent ones, each from where the louder one ended.

    The first is never given up; others are when they fall hopelessly behind.
    """
    live: list[Trajectory | None] = list(starts)
    evidences = np.full((len(live), len(intensities)), -np.inf)
    found: list[list[Trajectory | None]] = [[None] * len(intensities) for _ in live]
    for k, intensity in enumerate(intensities):
        before = np.full(len(live), -np.inf)
        moving = [i for i, t in enumerate(live) if t is not None]
        for _ in range(_ITERATIONS):
            if time.perf_counter() > deadline:
                raise _OutOfTime
            for i, t in zip(
                moving,
                scene.iterate([live[i] for i in moving], intensity, CORRELATION),
                strict=True,
            ):
                live[i] = t
            now = np.array([-np.inf if t is None else log_evidence(t) for t in live])
            moving = [
                i for i in moving if live[i] is not None and abs(now[i] - before[i]) > _SETTLED
            ]
            before = now
            if not moving:
                break
        for i, t in enumerate(live):
            if t is not None:
                evidences[i, k], found[i][k] = before[i], t
        if k:
            best = evidences.max()
            live = [
                t if i == 0 or evidences[i].max() > best - _HOPELESS else None
                for i, t in enumerate(live)
            ]
    return [(e, tuple(f)) for e, f in zip(evidences, found, strict=True)]


class _OutOfTime(Exception):
    pass


def tried_alone(scene: Scene, effects: Sequence[AbstractEffect]) -> Tried:
    """A model by itself, iterated over all random torques."""
    start = scene.start(effects, prior_of(scene, effects))
    ((evidences, trajectories),) = anneal(scene, [start], INTENSITIES)
    return Tried((), INTENSITIES, evidences, trajectories, 0.0)


class Search:
    """The models tried so far on some recordings."""

    def __init__(
        self,
        scene: Scene,
        base: Sequence[AbstractEffect],
        *,
        deadline: float = math.inf,
        say: Callable[[str], None] = lambda words: None,
    ):
        self.scene, self.say, self.deadline = scene, say, deadline
        self.fixed = tuple(e.label for e in base)
        self.candidates = candidates(scene, self.fixed)
        self.tried: dict[frozenset[str], Tried] = {}
        self.stopped: str | None = None
        """Why the search ended early, if it did: "interrupted" or "budget"."""
        self.screens: dict[frozenset[str], Screen] = {}
        """First-order evidence of all candidates beside the models that were extended."""
        say("smoothing the motion with the model")
        alone = tried_alone(scene, base)
        self._keep((), INTENSITIES, alone.evidences, alone.trajectories)

    @property
    def base(self) -> Tried:
        return self.tried[frozenset()]

    @property
    def best(self) -> Tried:
        """The model with the highest posterior."""
        return max(self.tried.values(), key=lambda t: t.log_posterior)

    def _keep(self, added, intensities, evidences, trajectories) -> None:
        if not np.isfinite(evidences).any():
            return
        prior = log_prior_model(len(added), len(self.candidates))
        found = Tried(tuple(added), tuple(intensities), evidences, tuple(trajectories), prior)
        known = self.tried.get(frozenset(added))
        if known is None or found.log_posterior > known.log_posterior:
            self.tried[frozenset(added)] = found

    def run(self, most: int) -> None:
        """Add effects, `most` at most, until no model beats the one that there is. Ctrl-C and the
        deadline end it with what there is."""
        try:
            extended: set[frozenset[str]] = set()
            while True:
                best = frozenset(self.best.added)
                if best in extended or len(best) >= most:
                    # Each effect in turn might have another in its place.
                    rest = [best - {x} for x in self.best.added[:-1]]
                    todo = [s for s in rest if s in self.tried and s not in extended]
                    if not todo:
                        break
                    best = todo[0]
                self.extend(self.tried[best])
                extended.add(best)
                self.reduce(self.best)
        except KeyboardInterrupt:
            self.stopped = "interrupted"
        except _OutOfTime:
            self.stopped = "budget"

    def screen(self, parent: Tried) -> Screen:
        """The first-order evidence of all candidates beside a model."""
        key = frozenset(parent.added)
        if key not in self.screens:
            trajectory, intensity = parent.loud()
            self.say(f"screening {len(self.candidates)} candidates")
            lines = spectral_lines(self.scene, trajectory)
            effects = [e for e in self.candidates if self._may_join(e, trajectory)]
            columns = Columns(self.scene, trajectory, effects, lines)
            # The likeliest random torque, one a decade below it, and none.
            used = sorted({intensity, 0.1 * intensity, 0.0}, reverse=True)
            self.screens[key] = columns.screen(used)
        return self.screens[key]

    def extend(self, parent: Tried) -> None:
        """Try a model with one more effect, each contender in turn."""
        trajectory, intensity = parent.loud()
        screen = self.screen(parent)
        ranked = screen.ranked
        found = {s.effect.label: s for s in ranked}
        likeliest = screen.pairs(3 * CONTENDERS)[:CONTENDERS]
        chosen = {s.effect.label: s for s in ranked[:CONTENDERS]}
        for _, a, b in likeliest:
            for s in (a, b):
                chosen.setdefault(s.effect.label, found[s.effect.label])
        for s in ranked:  # linear nowhere: the first order cannot see it
            if s.effect.dry:
                chosen.setdefault(s.effect.label, s)
        if parent.complete > 0.5:
            # What is left is small, and the first order right: most cannot be worth their prior.
            n = len(self.candidates)
            price = log_prior_model(len(parent.added), n) - log_prior_model(len(parent.added) + 1, n)
            worth = price - 2 * INDISTINGUISHABLE
            chosen = {k: s for k, s in chosen.items() if s.gain > worth}
        if not chosen:
            return
        self.say(f"weighing {len(chosen)} candidates")
        starts, added = [trajectory], [parent.added]
        for label, s in chosen.items():
            starts.append(extended(self.scene, trajectory, prior_of, s))
            added.append((*parent.added, label))
        used = tuple(x for x in INTENSITIES if x <= intensity)
        results = anneal(self.scene, starts, used, self.deadline)
        for labels, (evidences, trajectories) in zip(added, results, strict=True):
            self._keep(labels, used, evidences, trajectories)

    def _may_join(self, effect: AbstractEffect, trajectory: Trajectory) -> bool:
        """Whether an effect is not there, nor a law that it contains or that contains it."""
        kinds = {e.label: e for e in trajectory.effects}
        if effect.label in kinds:
            return False
        for present in trajectory.effects:
            same = present.place == effect.place
            if same and (present.extends == effect.name or effect.extends == present.name):
                return False
        return True

    def reduce(self, model: Tried) -> None:
        """Try a model without each of its effects but the last."""
        self.say("weighing simpler models")
        for label in model.added[:-1]:
            rest = tuple(x for x in model.added if x != label)
            if frozenset(rest) in self.tried:
                continue
            trajectory, intensity = model.loud()
            used = tuple(x for x in INTENSITIES if x <= intensity)
            ((evidences, trajectories),) = anneal(
                self.scene, [without(self.scene, trajectory, label)], used, self.deadline
            )
            self._keep(rest, used, evidences, trajectories)


def without(scene: Scene, trajectory: Trajectory, label: str) -> Trajectory:
    """A model without one of its effects, from where it is."""
    effects = trajectory.effects
    gone = [e.label for e in effects].index(label)
    numbers, states = number_slices(effects), state_slices(effects)
    kept = [i for i in range(len(effects)) if i != gone]
    rest = tuple(effects[i] for i in kept)
    u = np.zeros(scene.regressors(rest))
    own = np.concatenate([trajectory.u[numbers[i]] for i in kept])
    u[: len(own)] = own
    n, room = scene.n, scene.room(rest)
    old = np.concatenate([np.arange(states[i].start, states[i].stop) for i in kept]).astype(int)
    path = np.zeros((scene.K, 2 * n + room))
    path[:, : 2 * n] = trajectory.path[:, : 2 * n]
    path[:, 2 * n : 2 * n + len(old)] = trajectory.path[:, 2 * n + old]
    first = np.zeros(room)
    first[: len(old)] = trajectory.first[old]
    return dataclasses.replace(
        trajectory, effects=rest, prior=prior_of(scene, rest), u=u, path=path, first=first
    )
