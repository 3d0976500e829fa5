"""Which models are worth their evidence: forward selection and backward elimination.

From the model as it is, all candidates are screened to first order (`columns`); the contenders, and
what no first order can see, are iterated to their own nonlinear evidence beside "nothing more",
from loud random torques to silent ones. The best joins, the motion is smoothed with it, and the
next round begins, until no model beats the one that there is. The models tried, with their
evidences, are all that the rest of the diagnosis needs: it can stop at any time with the best so
far.
"""

import contextlib
import functools
import itertools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from ..effects import AbstractEffect
from ..filtering.kalman import System
from ..filtering.law import number_slices, numbers_of
from ..filtering.linearised import Linear
from ..filtering.trajectory import Scene, Trajectory
from ..runtime.memory import give_back
from ..runtime.parallel import side_by_side
from .columns import (
    Column,
    Columns,
    Screen,
    candidates,
    extended,
    nested,
    of_one_kind,
    spectral_lines,
    strengths,
    without,
)
from .evidence import (
    CONTENDERS,
    EXPLAINS_NOTHING,
    HOPELESS,
    IN_PLAY,
    INDISTINGUISHABLE,
    INTENSITIES,
    STRENGTHS,
    WIDTH,
    correlation_times,
    log_prior_model,
    occams_window,
    over_intensities,
    prior_of,
    savage_dickey,
    signed,
)
from .iteration import NEAR, evidences_at, levels_about, likeliest_level, settle
from .simulated import Simulated
from .tried import Tried, may_be_complete, places_of, screened_at, screening_motion, tried_alone

_prepared: set[Any] = set()


def prepare(scene: Scene, base: Sequence[AbstractEffect], wanted: Sequence[AbstractEffect]) -> bool:
    """Compile what a search runs, side by side, by running it once with zeros; once a process.

    **Returns:** whether anything was compiled.
    """
    t = scene.start(base, prior_of(scene, base))
    K, X, n, P = scene.K, t.path.shape[1], scene.n, len(t.u)
    laws, _ = scene.tabulated(t)
    key = laws.names, scene.joints, len(t.first), K, X, P, type(scene.mechanisms[0])
    if key in _prepared:
        return False
    _prepared.add(key)
    shapes = (X, X), (X, P), (X, n), (X,), (n, X), (n, P), (n,), (n, n), (n,)
    system = System(*(np.zeros((K, *shape)) for shape in shapes))
    wide = (n, 3 * K), (n, 3 * K), (X, X, 3 * K), (X, n, 3 * K)
    unused = [np.zeros(0)] * 3
    linear = Linear(system, np.zeros((K, n)), *map(np.zeros, wide), *unused)

    def filters() -> None:
        scene.evidences(t, linear, np.zeros(NEAR))
        scene.smoothed(t, linear, 0.0)
        Columns(scene, t, wanted, [1.0], linear=linear).gram([0.0])

    # The largest program beside all others.
    side_by_side([functools.partial(scene.linearised, t), filters])
    give_back()
    return True


class OutOfTime(Exception):
    """The search's time is over."""


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
        self.fixed = scene.fixed = tuple(e.label for e in base)
        self.candidates = candidates(scene, self.fixed)
        self.tried: dict[frozenset[str], Tried] = {}
        self.lines: list[float] = []
        """Frequencies, Hz, in the random torque of the base model."""
        self.passed: dict[frozenset[str], Tried] = {}
        """Models that were not iterated, for to first order they have next to no part: as their
        parents, with the evidence that the first order gives."""
        self.exact: Callable[[Tried], Simulated | None] | None = None
        """A model without a random torque, by exact simulation, if that can be had."""
        self._white: tuple | None = None
        """What was known under white noise, where all models have another noise now."""
        self.curves: list[Any] = []
        """`law.CurveModel`s: models with a law that has no name."""
        self.reassignments: Sequence[Any] = ()
        """`channels.Reassigned`s: the base model with the columns of the readings read otherwise,
        where it does not explain them as they stand."""
        self.stopped: str | None = None
        """Why the search ended early, if it did: "interrupted" or "budget"."""
        self._reduced: set[tuple[Tried, tuple[str, ...]]] = set()
        self._simulated: set[Trajectory] = set()
        self.screens: dict[frozenset[str], Screen] = {}
        """First-order evidence of all candidates beside the models that were extended."""
        say("smoothing the motion with the model")
        self.compiled = prepare(scene, base, self.candidates)
        """Whether programs were compiled for it: none of its kind went before, in this process."""
        alone = tried_alone(scene, base)
        self._keep((), alone.evidences, alone.best)

    def in_time(self) -> None:
        """**Raises:** `OutOfTime` after the deadline."""
        if time.perf_counter() > self.deadline:
            raise OutOfTime

    @property
    def base(self) -> Tried:
        return self.tried[frozenset()]

    @property
    def best(self) -> Tried:
        """The model with the highest posterior."""
        return max(self.tried.values(), key=lambda t: t.log_posterior)

    @property
    def singles(self) -> list[Tried]:
        """The models with one effect, the likeliest first."""
        found = (t for t in self.tried.values() if len(t.added) == 1)
        return sorted(found, key=lambda t: -t.log_posterior)

    def _keep(self, added: Sequence[str], evidences: np.ndarray, best: Trajectory) -> None:
        prior = log_prior_model(len(added), len(self.candidates))
        found = Tried(tuple(added), evidences, best, prior)
        known = self.tried.get(frozenset(added))
        if known is None or found.log_posterior > known.log_posterior:
            self.tried[frozenset(added)] = found

    @property
    def reassigned(self) -> Any:
        """The likeliest other reading of the columns, if it leaves less than an effect might
        explain and is likelier than all models of the columns as they stand; else None."""
        each = [r for r in self.reassignments if r.tried.intensity < WIDTH]
        likeliest = max(each, key=lambda r: r.tried.log_posterior, default=None)
        if likeliest is None or likeliest.tried.log_posterior < self.best.log_posterior:
            return None
        return likeliest

    def run(self, most: int, reassign: Callable[[], Sequence[Any]] = tuple) -> None:
        """Add effects, `most` at most, until no model beats the one that there is, or as long as
        the likeliest explains anything of the motion. Ctrl-C and the deadline end it with what
        there is. `reassign` makes `channels.Reassigned`s."""
        with self.ending():
            if self.base.complete < 0.5:
                self.say("reading the columns otherwise")
                self.reassignments = reassign()
                give_back()
            other = self.reassigned
            if other and (other.tried.complete > 0.5 or self.base.intensity >= WIDTH):
                return  # nothing is left to be explained, or as much as effects are
            self._grow(most)
            if self.best.complete < 0.5:
                self._in_coloured_noise(most)
            self._take_each_away()
            if self.best.intensity >= EXPLAINS_NOTHING:  # then no name says anything
                self.tried, self.passed = {frozenset(): self.base}, {}
        if self.stopped:  # what was tried last has the filter's evidence alone, others an exact one
            self.deadline = math.inf
            with self.ending():
                self._simulate()

    def _in_coloured_noise(self, most: int) -> None:
        """Go on with noise that is not white in the place of a random torque, if the readings are
        surely likelier so, or if no model explains them; as long as that leaves a complete model
        that is surely likelier. If not, all is as before."""
        least = self.best.log_posterior + INDISTINGUISHABLE
        explains = self.best.intensity < EXPLAINS_NOTHING
        self._colour_noise(least if explains else -math.inf)
        if self.scene.coloured is not None:
            self._grow(most)
            self._colour_noise(self.best.log_posterior)  # its time again, with what was found
            self.screen(self.base)  # of what was not iterated, its evidence under that noise
            if self.best.complete < 0.5 or self.best.log_posterior < least:
                self.whiten_noise()

    def _grow(self, most: int) -> None:
        """Add effects, `most` at most."""
        extended: set[frozenset[str]] = set()
        self.screen(self.base)
        self._simulate()
        while not extended or self.best.intensity < EXPLAINS_NOTHING:
            # In other noise, too, from the base model on.
            best = frozenset(self.best.added) if extended else frozenset()
            if best in extended or len(best) >= most:
                # Each effect in turn might have another in its place.
                todo = [
                    (model, x)
                    for model in occams_window(self.tried.values())
                    for x in model.added if frozenset(model.added) - {x} not in extended
                ]  # fmt: skip
                if not todo:
                    return
                rests = [frozenset(model.added) - {x} for model, x in todo]
                self._simplify([
                    (*own, None) for own, rest in zip(todo, rests, strict=True)
                    if rest not in self.tried
                ])  # fmt: skip
                found = [rest for rest in rests if rest in self.tried]
                extended.update(set(rests).difference(found))  # no motion has these
                if not found:
                    continue
                best = found[0]
            self.extend(self.tried[best], most)
            extended.add(best)
            self.reduce()
            self._simulate()

    def _colour_noise(self, least: float) -> None:
        """Give all models noise that is not white in the place of a random torque, if a log
        posterior is then at `least` so high: an Ornstein-Uhlenbeck process, as that torque is, of
        the likeliest correlation time."""
        scene, every = self.scene, np.arange(len(INTENSITIES))
        longest = 1.0 / min(s.frequency for s in scene.scales)
        times = correlation_times(float(np.median(np.diff(scene.recordings[0].time))), longest)
        each = []
        for model in dict.fromkeys([self.base, self.best]):
            # Linearised, a model is the same with noise of any time.
            linear = scene.with_noise(longest).linearised(model.best)
            for own in times.tolist():
                self.in_time()
                known = evidences_at(scene.with_noise(own), model.best, linear, every)
                log = over_intensities(known) + model.log_prior - math.log(len(times))
                each.append((log, own, INTENSITIES[likeliest_level(known)]))
        _, time_, loudest = max(each)
        if time_ == scene.coloured:
            return
        self.say("weighing noise that is not white")
        models, scene = list(self.tried.values()), scene.with_noise(time_)
        if self.scene.coloured is not None:  # what was hopeless is not iterated again
            lowest = self.best.log_posterior - HOPELESS
            models = [m for m in models if m is self.base or m.log_posterior > lowest]
        models.sort(key=lambda model: model not in (self.base, self.best))
        some, others = models[:2], models[2:]

        def settled(each: Sequence[Tried]) -> list[tuple[Tried, tuple[np.ndarray, Trajectory]]]:
            found = settle(scene, [m.best for m in each], loudest, self.in_time)
            return [(m, f) for m, f in zip(each, found, strict=True) if f is not None]

        known = settled(some)
        log = max((over_intensities(f[0]) + m.log_prior for m, f in known), default=-math.inf)
        if log < least or not any(model is self.base for model, _ in known):
            return
        known += settled(others) if others else []
        self._white = self._white or (
            self.scene, self.tried, self.passed, self.screens, self.reassignments
        )  # fmt: skip
        self.scene, self.tried, self.passed, self.screens = scene, {}, {}, {}
        self.reassignments = ()
        self._reduced.clear()
        for model, own in known:
            self._keep(model.added, *own)

    @property
    def base_under_torque(self) -> Tried:
        """The base model under a random torque, whatever the noise."""
        return self._white[1][frozenset()] if self._white else self.base

    def whiten_noise(self) -> None:
        """Take back what `_colour_noise` did."""
        if self._white:
            self.scene, self.tried, self.passed, self.screens, self.reassignments = self._white
            self._white = None

    @contextlib.contextmanager
    def ending(self) -> Iterator[None]:
        """What Ctrl-C and the deadline end: `stopped` then says which of them."""
        try:
            yield
        except KeyboardInterrupt:
            self.stopped = "interrupted"
        except OutOfTime:
            self.stopped = "budget"

    def _simulate(self) -> None:
        """The evidence of each model in play that may need no random torque, by exact simulation,
        until no other is in play."""
        while self.exact is not None and self.scene.coloured is None:
            lowest = self.best.log_posterior + math.log(IN_PLAY)
            todo = [
                t
                for t in sorted(self.tried.values(), key=lambda t: len(t.added))
                if t.log_posterior > lowest and t.best not in self._simulated
                if may_be_complete(t)
            ]
            if not todo:
                return
            self.say("simulating what is in play")
            self._without_torque(todo)

    def _without_torque(self, models: Sequence[Tried]) -> None:
        """Simulate models exactly, each once."""
        self.in_time()
        self._simulated.update(t.best for t in models)
        work = [functools.partial(self.exact, t) for t in models]  # pyrefly: ignore
        for model, found in zip(models, side_by_side(work), strict=True):
            if found is not None:
                self.tried[frozenset(model.added)] = model.simulated_as(found)
        give_back()

    def beside(self, parent: Tried, label: str) -> Tried | None:
        """A model with one more effect, whatever the prior of that; None where it ran away, or has
        that law already. For after a search: its deadline is no more."""
        self.deadline = math.inf
        key = frozenset([*parent.added, label])
        if key not in self.tried:
            trajectory, intensity = screening_motion(self.scene, parent)
            row = next((s for s in self.screen(parent).ranked if s.effect.label == label), None)
            start = row and self._start(parent, trajectory, row)
            (found,) = settle(self.scene, [start], intensity) if start else (None,)
            if found is None:
                return None
            self._keep((*parent.added, label), *found)
        model = self.tried[key]
        known = self.exact is None or model.best in self._simulated
        if not known and self.scene.coloured is None and may_be_complete(model):
            self._without_torque([model])
        return self.tried[key]

    def screen(self, parent: Tried) -> Screen:
        """The first-order evidence of all candidates beside a model."""
        key = frozenset(parent.added)
        if key not in self.screens:
            self.in_time()
            trajectory, intensity = screening_motion(self.scene, parent)
            self.say(f"screening {len(self.candidates)} candidates")
            # A model with little random torque shows no line in it, however wrong it is: the base
            # model's, which is the loudest, stay.
            linear = self.scene.linearised(trajectory)
            lines = spectral_lines(self.scene, trajectory, linear, self.lines)
            self.lines = self.lines or lines
            effects = [e for e in self.candidates if self._may_join(e, trajectory)]
            columns = Columns(self.scene, trajectory, effects, lines, linear=linear)
            screen = self.screens[key] = Screen(columns, screened_at(intensity))
            little = parent.complete > 0.5 and self.scene.coloured is None
            if not little:  # else the first order is right
                screen.revise(self._sticking(screen, trajectory, linear, intensity))
        return self.screens[key]

    def _sticking(
        self, screen: Screen, trajectory: Trajectory, linear: Linear, intensity: float
    ) -> list[Column]:
        """The candidates in which something sticks, at each of their shapes: dry friction at each
        of `STRENGTHS`, what follows the angle, whose torque is in proportion to its strength, at
        the one that the screen has for that shape.

        When it sticks depends on the numbers, so that one linearisation about no strength says
        little: each point of the grid has its own. About far too small a strength a shape would
        have to move too far.
        """
        scene, levels = self.scene, levels_about(INTENSITIES.index(intensity))
        none = over_intensities(evidences_at(scene, trajectory, linear, levels))

        def at(row: Column) -> Column:
            self.in_time()
            t = scene.consistent(extended(scene, trajectory, row))
            here = evidences_at(scene, t, scene.linearised(t), levels)
            return row._replace(gain=over_intensities(here) - none)

        points = []
        for row in screen.rows:
            # Further strengths are next to silent: of Stribeck's law, Coulomb's is left.
            each = np.eye(len(row.which))[0]
            if row.effect.dry:
                points += [row._replace(regressors=x * each) for x in STRENGTHS]
            elif row.effect.follows:
                points.append(row._replace(regressors=screen.gain([row])[1]))
        return side_by_side([functools.partial(at, point) for point in points])

    def extend(self, parent: Tried, most: int) -> None:
        """Try a model with one more effect, each contender in turn; and, unless one explains the
        readings, with the likeliest pairs: where each alone leaves about as much as before, both
        may leave nothing. Of `most` effects in all."""
        trajectory, intensity = screening_motion(self.scene, parent)
        screen = self.screen(parent)
        prior, worth = self._price(parent, 1)
        chosen, little = screen.ranked[:CONTENDERS], parent.complete > 0.5
        if little:
            # What is left is small, and the first order right: by it most have no part.
            chosen = [s for s in chosen if s.gain > worth]
            for s in (s for s in screen.ranked if s.gain <= worth):
                added = (*parent.added, s.effect.label)
                passed = Tried(added, parent.evidences + s.gain, parent.best, prior)
                self.passed[frozenset(added)] = passed
        # A law that contains another's begins where that one has ended.
        for later in (False, True):
            # Where something sticks, an iteration may end at corners that lie on its way.
            starts = [
                ((s.effect.label,), self._start(parent, trajectory, x))
                for s in chosen if bool(s.effect.extends) is later
                for x in (s, *(s.alike if s.effect.follows else ()))
            ]  # fmt: skip
            self._join(parent, intensity, starts)
        self._simulate()  # the filter may take a model for complete that is not
        if little or self.best.complete <= 0.5:
            pairs = self._pairs(parent, screen, most)
            if little:
                pairs = [own for own in pairs if own[0] > self._price(parent, 2)[1]]
            starts = [self._start_of_two(trajectory, screen, a, b) for _, a, b in pairs]
            self._join(parent, intensity, starts)

    def _pairs(
        self, parent: Tried, screen: Screen, most: int
    ) -> list[tuple[float, Column, Column]]:
        """The likeliest pairs of effects, to first order, that a model may have more: none of which
        one of the two alone is likelier, for the other would follow it; and none with what
        follows the angle, of which one linearisation about no strength says little."""
        if len(parent.added) + 2 > most:
            return []
        more = self._price(parent, 2)[1] - self._price(parent, 1)[1]
        alone = {s.effect.label: screen.gain([s])[0] for s in screen.ranked}
        each = (
            (gain, a, b) for gain, a, b in screen.pairs
            if gain > max(alone[s.effect.label] for s in (a, b)) + more
            and not (a.effect.follows or b.effect.follows)
        )  # fmt: skip
        return list(itertools.islice(each, CONTENDERS))

    def _start_of_two(
        self, t: Trajectory, screen: Screen, *pair: Column
    ) -> tuple[tuple[str, ...], Trajectory]:
        """Where the iteration of a model with two more effects begins, as the screen has them."""
        _, u = screen.gain(pair)
        for s, own in zip(pair, np.split(u, [len(pair[0].which)]), strict=True):
            t = extended(self.scene, t, s._replace(regressors=own))
        return tuple(s.effect.label for s in pair), self.scene.consistent(t)

    def _price(self, parent: Tried, more: int) -> tuple[float, float]:
        """Log prior of a model with some more effects, and what they must raise the log evidence
        by, nats, for it to be in play beside its parent."""
        n, m = len(self.candidates), len(parent.added)
        prior = log_prior_model(m + more, n)
        return prior, log_prior_model(m, n) - prior + math.log(IN_PLAY)

    def _join(
        self,
        parent: Tried,
        intensity: float,
        starts: Sequence[tuple[tuple[str, ...], Trajectory]],
    ) -> None:
        """Iterate a model with some more effects, from where it begins with each of them."""
        if not starts:
            return
        each, begun = zip(*starts, strict=True)
        self.say(f"weighing {len(set(each))} candidates")
        results = settle(self.scene, begun, intensity, self.in_time)
        for labels, found in zip(each, results, strict=True):
            if found is not None:
                self._keep((*parent.added, *labels), *found)

    def _start(self, parent: Tried, trajectory: Trajectory, found: Column) -> Trajectory:
        """Where the iteration of a model with one more effect begins: as the screen has it, or, if
        the model with the law that it contains has ended already, from there."""
        less = self._contained(found.effect)
        ended = less and self.tried.get(frozenset([*parent.added, less.label]))
        if less is None or ended is None:
            return self.scene.consistent(extended(self.scene, trajectory, found))
        return self._instead(ended.best, less, found)  # pyrefly: ignore[missing-attribute]

    def _contained(self, law: AbstractEffect) -> AbstractEffect | None:
        """The candidate that a law is with its further numbers silent."""
        within = (e for e in self.candidates if e.place == law.place and e.name == law.extends)
        return next(within, None)

    def _instead(self, t: Trajectory, old: AbstractEffect, found: Column) -> Trajectory:
        """A model with another law in the place of one of its effects; what both have keeps its
        value."""
        own = number_slices(t.effects)[t.labels.index(old.label)]
        at = {n.field: u for n, u in zip(numbers_of(old), t.u[own], strict=True)}
        values = zip(numbers_of(old), t.numbers[own], strict=True)
        shape = found.shape | {n.field: x for n, x in values if n.silent is None}
        screened = zip(strengths(found.effect), found.regressors, strict=True)
        begun = np.array([at.get(n.field, u) for n, u in screened])
        found = found._replace(shape=shape, regressors=begun)
        rest = without(self.scene, t, old.label)
        return self.scene.consistent(extended(self.scene, rest, found))

    def _may_join(self, effect: AbstractEffect, trajectory: Trajectory) -> bool:
        """Whether an effect is not there, nor a law that it contains or that contains it, nor one
        of its kind that joined the base model."""
        return effect.label not in trajectory.labels and not any(
            nested(effect, present)
            or (present.label not in self.fixed and of_one_kind(effect, present))
            for present in trajectory.effects
        )

    def reduce(self) -> None:
        """Try simpler models from the richer one's motion: those that it says, to first order, to
        be in play, and likelier than the way there has shown."""
        lowest, todo = self.best.log_posterior - INDISTINGUISHABLE, []
        for model in self.tried.values():
            for label in model.added:
                effect = model.best.effects[model.best.labels.index(label)]
                within = self._contained(effect)
                for less in (None, within) if within else (None,):
                    rest = _replaced(model.added, label, less)
                    price = log_prior_model(len(rest), len(self.candidates)) - model.log_prior
                    hoped = model.log_posterior + price - bayes_factor(model.best, effect, less)
                    known = self.tried.get(frozenset(rest))
                    above = known.log_posterior + INDISTINGUISHABLE if known else lowest
                    if rest and hoped > max(lowest, above) and (model, rest) not in self._reduced:
                        todo.append((model, label, less))
        self._simplify(todo)

    def _take_each_away(self) -> None:
        """Try the models in play without each of their effects: whether one is at work shows beside
        the model without it."""

        def left() -> list[tuple[Tried, str, None]]:
            lowest = self.best.log_posterior + math.log(IN_PLAY)
            return [
                (model, x, None)
                for model in self.tried.values() if model.log_posterior > lowest
                for x in model.added
                if frozenset(model.added) - {x} not in self.tried
                and (model, _replaced(model.added, x, None)) not in self._reduced
            ]  # fmt: skip

        while todo := left():
            self._simplify(todo)
            self._simulate()

    def _simplify(self, todo: Sequence[tuple[Tried, str, AbstractEffect | None]]) -> None:
        """Try models without an effect, or with a law that it contains in its place."""
        if not todo:
            return
        self._reduced.update((m, _replaced(m.added, label, less)) for m, label, less in todo)
        self.say("weighing simpler models")
        starts, loudest = [], 0.0
        for model, label, less in todo:
            t, intensity = screening_motion(self.scene, model)
            loudest = max(loudest, intensity)
            if less is None:
                starts.append(without(self.scene, t, label))
                continue
            old, none = t.effects[t.labels.index(label)], np.zeros(len(strengths(less)))
            states = np.zeros((self.scene.K, len(less.memory)))
            starts.append(self._instead(t, old, Column(less, {}, (), states, regressors=none)))
        each = settle(self.scene, starts, loudest, self.in_time)
        for (model, label, less), found in zip(todo, each, strict=True):
            if found is not None:
                self._keep(_replaced(model.added, label, less), *found)


def _replaced(added: Sequence[str], label: str, less: AbstractEffect | None) -> tuple[str, ...]:
    """Labels without one of them, or with another one in its place, which comes last."""
    return (*(x for x in added if x != label), *([less.label] if less else ()))


def bayes_factor(t: Trajectory, effect: AbstractEffect, less: AbstractEffect | None) -> float:
    """Log evidence of a model over that without one of its effects, or with a law that it contains
    in its place, to first order (`savage_dickey`)."""
    kept = [n.field for n in strengths(less)] if less else []
    gone = [n for n in strengths(effect) if n.field not in kept]
    which = places_of(t, effect, gone)
    covariance = t.covariance[np.ix_(which, which)]
    return savage_dickey(t.u[which], covariance, [signed(n) for n in gone])
