"""From an experiment to the name of what is missing.

The search leaves models with their evidences; all that is said here is a sum over them. Least
squares then gives the numbers of the models on the way, their standard errors, and the falling
error on readings that were fitted and on readings that were not.
"""

import contextlib
import dataclasses
import functools
import math
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import log_softmax

from ..effects import AbstractEffect
from ..filtering.law import each_number, state_slices
from ..filtering.trajectory import Scene, Trajectory
from ..fitting import DEFAULT_STARTS, FitError, fit
from ..fitting.conclusion import finishing, with_held_out
from ..fitting.lanes import alone
from ..fitting.multistart import Descent, descending, without_drift
from ..fitting.problem import ready
from ..fitting.result import Fit
from ..physics.effect import BASE
from ..physics.motion import Motion
from ..recordings.experiment import Experiment, must_be_experiment
from ..runtime.memory import give_back
from .candidate_tests import best_tests, in_play
from .channels import reassigned
from .evidence import (
    EXPLAINS_NOTHING,
    HOPELESS,
    INDISTINGUISHABLE,
    INTENSITIES,
    NOISE,
    at_least,
    at_work,
    log_sum,
)
from .forecast import ModelState, held_out
from .free_curves import compile_screen
from .law import CurveModel, curve_models, laws_of
from .linearised_fit import Hopeless, on_host
from .missing_torque import CURVES, missing_of, owning_base, restoring_torque, scene_of, with_rests
from .residuals import coloured
from .result import (
    Budget,
    Candidate,
    ChannelError,
    ColouredNoise,
    Diagnosis,
    Family,
    RandomTorque,
    Value,
    Verdict,
)
from .search import Search
from .simulated import Simulated, simulated
from .tried import Tried, signs_of

MOST_EFFECTS = 3
"""How many effects are added unless it is told otherwise."""


def diagnose(
    experiment: Experiment,
    *,
    effects: Sequence[str | AbstractEffect] = (),
    max_effects: int = MOST_EFFECTS,
    starts: int = DEFAULT_STARTS,
    budget: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Which physical effect is missing from springs and dampers, how probable that is, what else it
    might be, and how far the error falls with it.

    Effects join the model one by one, as long as the evidence for the model rises. Runs in float64
    whatever JAX's setting. Ctrl-C ends the search with the best so far.

    **Arguments:**

    - `experiment`: from `residyn.load`, or made of arrays.
    - `effects`: what is in the model from the start, beside springs and dampers: `name`,
      `name:joint`, or an effect.
    - `max_effects`: how many may be added, at least 0.
    - `starts`: how many starts a fit tries where the smoothed motion leads it nowhere, at least 1.
    - `budget`: seconds after which the search ends with the best so far; None: when it is done.
    - `progress`: called with a few words as each phase begins.

    **Returns:** a `Diagnosis`: print it, or `to_dict()`.

    **Raises:** `FitError` if no start led to finite numbers; `TypeError` for what is no experiment;
    `ValueError` for an effect that does not exist or does not go with this experiment, a negative
    `max_effects`, or a `budget` that is not positive.
    """
    must_be_experiment(experiment)
    if max_effects < 0:
        raise ValueError(f"max_effects = {max_effects}: it cannot be negative")
    if starts < 1:
        raise ValueError(f"starts = {starts}: at least one start is needed")
    if budget is not None and not budget > 0:
        raise ValueError(f"budget = {budget}: it must be positive (seconds)")
    began, say = time.perf_counter(), progress or (lambda words: None)
    with jax.enable_x64(True):
        deadline = math.inf if budget is None else time.perf_counter() + budget
        # What is found is of all runs; whether one has it for itself, `compare` asks afterwards.
        experiment, effects = with_rests(experiment, effects)
        experiment = owning_base(experiment, effects)
        scene, base = scene_of(experiment, effects)
        fits = Fits(experiment, scene, starts)
        search = Search(scene, base, deadline=deadline, say=say)
        return diagnosed(search, fits, effects, max_effects, began)


def diagnosed(
    search: Search,
    fits: "Fits",
    effects: Sequence[str | AbstractEffect],
    max_effects: int,
    began: float,
) -> Diagnosis:
    """What `diagnose` finds from a base model with some effects; `began` on `time.perf_counter`."""
    if search.compiled:  # compiled beside the search, at the end of which it is needed
        fits.in_background(functools.partial(compile_screen, search.scene, search.base.best))
    fits.begin(search.base)
    search.exact = fits.simulated
    given = fits.whole, effects, search.scene, search.base, len(search.candidates), search.in_time
    search.run(max_effects, functools.partial(reassigned, *given))
    lost = search.best.intensity >= EXPLAINS_NOTHING or search.reassigned
    if not (lost or search.stopped):
        with search.ending():
            search.say("looking for a law without a name")
            search.curves = curve_models(search)
    search.say("fitting the models on the way")
    try:
        return _concluded(search, fits, began)
    finally:
        search.whiten_noise()  # pictures are of torques


class Fits:
    """Least-squares fits of tried models, each from its smoothed motion.

    Without a random torque the iterated smoother *is* the fit by least squares, but for its linear
    steps: what is left to do is an exact simulation and a few steps from there.
    """

    def __init__(self, experiment: Experiment, scene: Scene, starts: int):
        self.scene, self.starts, self.whole = scene, starts, experiment
        self.experiment, self.cut = experiment, False
        self.lock, self._pool = threading.Lock(), ThreadPoolExecutor(2)
        self._begun: dict[Trajectory, Future[Fit]] = {}
        self.known: list[Fit] = []
        """Of the fitted recordings: a model that contains the effects of another fits no worse."""

    def begin(self, tried: Tried, enough: float = math.inf) -> "Future[Fit]":
        """Fit one model, in another thread; `enough` as in `fitted`."""
        with self.lock:  # none waits for one that is begun after it
            if tried.best not in self._begun:
                parts = [
                    f for t, f in self._begun.items() if set(t.labels) < set(tried.best.labels)
                ]
                self._begun[tried.best] = self._pool.submit(self._of, tried, enough, parts)
            return self._begun[tried.best]

    def in_background(self, call: Callable[[], None]) -> None:
        """Have something done in another thread, in float64."""

        def in_float64() -> None:
            with jax.enable_x64(True):  # JAX's settings are each thread's own
                call()

        self._pool.submit(in_float64)

    def of(self, tried: Tried) -> Fit:
        """The fit of one model.

        **Raises:** `FitError` if nothing finite comes of it.
        """
        return self.begin(tried).result()

    def simulated(self, tried: Tried) -> Simulated | None:
        """One model without a random torque, by exact simulation; None if it cannot be had. One
        whose evidence is then hopelessly less than the filter's has just that much less."""
        try:
            fit = self.begin(tried, self._enough(tried)).result()
            return simulated(self.scene, tried.best, fit)
        except Hopeless:
            with self.lock:
                del self._begun[tried.best]  # a fit that is shown is a whole one
            P, t = len(tried.best.prior.mean), tried.best
            least = min(tried.evidences[-1], tried.log_evidence - HOPELESS)
            return Simulated(float(least), t.u[:P], t.covariance[:P, :P])
        except FitError:
            return None

    def _enough(self, tried: Tried) -> float:
        """The squared whitened residuals from which a model's evidence without a random torque is
        hopelessly less than with one, for all that its priors may add."""
        pairs = zip(self.scene.recordings, self.scene.wild, strict=True)
        readings = sum(int((np.isfinite(r.angle) & ~wild).sum()) for r, wild in pairs)
        raised = len(tried.best.prior.mean) * math.log(2.0)
        # Readings scatter about their averages, by twice the noise's square at the most.
        scatter = 2 * (readings - self.scene.length)
        return scatter + 2 * (self.scene.highest + raised + HOPELESS - tried.log_evidence)

    def _of(self, tried: Tried, enough: float, parts: "Sequence[Future[Fit]]") -> Fit:
        wait(parts)
        with jax.enable_x64(True):  # JAX's settings are each thread's own
            return self.with_held_out(self.fitted(tried, enough=enough))

    def with_held_out(self, found: Fit) -> Fit:
        """One of these fits, with the recordings beside it that were held out, unless its numbers
        make their motion run away."""
        try:
            return alone(with_held_out(found, self.experiment), on_host)
        except FitError:
            return dataclasses.replace(found, experiment=self.experiment)

    def fitted(
        self,
        tried: Tried,
        progress: Callable[[str], None] | None = None,
        enough: float = math.inf,
    ) -> Fit:
        """The fit of one model to the fitted recordings alone, in this thread; where many starts
        are tried, `progress` is as in `fit`. Call it in float64.

        **Raises:** `FitError`; `Hopeless` where all starts end above `enough`; what `progress`
        raises.
        """
        began = time.perf_counter()
        motions = tried.starts(self.scene)
        t = motions[0]
        own = [e for e in t.valued() if e.name not in BASE]
        with self.lock:
            if not self.cut:  # what drives a joint that nothing pulls back is fitted in segments
                here = ready(self.whole, self.whole.fit_recordings, own)
                at = here.model.with_vector(jnp.asarray(t.numbers))
                self.experiment, self.cut = without_drift(self.whole, at), True
        known = self.experiment.fit_recordings
        fitted = dataclasses.replace(self.experiment, recordings=known)
        here = ready(fitted, known, own)

        ends: list[Descent] = []
        hopeless: list[Hopeless] = []

        def descend(starts, growing: bool = False) -> None:
            """From each start, until one ends at the noise."""
            for numbers, states in starts:
                begin = here.model.with_vector(jnp.asarray(numbers))
                begun = here, begin, numbers[None], self._wild(here.recordings)
                descent = descending(*begun, near=np.array([states]), growing=growing)
                try:
                    ends.append(alone(descent, functools.partial(on_host, enough=enough)))
                except Hopeless as error:
                    hopeless.append(error)
                except FitError:
                    continue
                if ends and not lowest().above_noise:
                    return
            # What sticks does so in order: the first ones first.
            if here.model.rough and not growing:
                descend(starts, growing=True)

        def lowest() -> Descent:
            return min(ends, key=lambda end: end.cost)

        with self.lock:
            within = [f for f in self.known if set(f.model.labels) < set(t.labels)]
        best = min(within, key=_cost, default=None)
        found = None
        if tried.intensity >= EXPLAINS_NOTHING:  # then the smoothed motion leads nowhere
            with contextlib.suppress(FitError):
                found = fit(fitted, effects=own, starts=self.starts, progress=progress)
        if found is None:
            descend([(m.numbers, [self._state(m, r) for r in here.recordings]) for m in motions])
            # From the minimum of a model that it contains no fit ends above that one.
            if best and (not ends or lowest().cost > _cost(best)):
                descend([self._from(best, t)])
            if ends:
                with contextlib.suppress(FitError):
                    found = alone(finishing(fitted, t.numbers, lowest(), began), on_host)
            elif hopeless:
                raise hopeless[0]
        if found is None:
            # No start of a wrong model is better than another one.
            starts = 1 if tried.complete < 0.5 else self.starts
            found = fit(fitted, effects=own, starts=starts, progress=progress)
        with self.lock:
            self.known.append(found)
        return found

    def _from(self, best: Fit, t: Trajectory) -> tuple[np.ndarray, list[np.ndarray]]:
        """Numbers and initial states (s,) of a model at the minimum of one that it contains: what
        else it has does nothing."""
        values = {n.name: float(n.value) for n in best.numbers}
        numbers = [
            values.get(f"{e.label}.{n.name}", x if n.silent is None else n.silent)
            for (e, n), x in zip(each_number(t.effects), t.numbers, strict=True)
        ]
        n, inner = 2 * self.scene.n, state_slices(best.model.effects)
        known = dict(zip(best.model.labels, inner, strict=True))
        states = []
        for r in (r for r in best.recordings if r.recording.role != "check"):
            own = [r.state[n:][known[e.label]] if e.label in known else np.zeros(len(e.memory))
                   for e in t.effects]  # fmt: skip
            states.append(np.concatenate([r.state[:n], *own]))
        return np.array(numbers), states

    def _index(self, recording) -> tuple[int, int]:
        """Which recording of the scene one (or a segment) is of, and where it begins there."""
        whole = recording.segment_of or recording
        # Whatever else is said of it, its readings stay the same array.
        run = next(i for i, r in enumerate(self.scene.recordings) if r.angle is whole.angle)
        g = self.scene.grid
        own = g.of(run)
        since = recording.time[0] - self.scene.recordings[run].time[0]
        return run, int(own[np.argmin(np.abs(g.time[own] - since))])

    def _wild(self, recordings) -> list[np.ndarray]:
        found = []
        for r in recordings:
            run, _ = self._index(r)
            first = int(np.searchsorted(self.scene.recordings[run].time, r.time[0]))
            found.append(self.scene.wild[run][first : first + len(r.time)])
        return found

    def _state(self, t: Trajectory, recording) -> np.ndarray:
        """Initial state (q0, v0, and internal states beyond what the effects begin with)."""
        run, k = self._index(recording)
        n, scene = self.scene.n, self.scene
        own = slice(2 * n, 2 * n + sum(len(e.memory) for e in t.effects))
        state = np.array(t.path[k])
        # The first instant of averaged readings comes after the first reading.
        early = scene.grid.time[k] - (recording.time[0] - scene.recordings[run].time[0])
        state[:n] -= early * state[n : 2 * n]
        motion = Motion.at(0.0, tuple(state[:n]), tuple(state[n : 2 * n]))
        begin = [float(z) for e in t.valued() for z in e.begin(motion, scene.mechanisms[run])]
        return np.concatenate([state[: 2 * n], state[own] - np.array(begin, float)])


def _cost(fit: Fit) -> float:
    """Sum of the squared residuals of a fit, in sigma."""
    return float(sum(np.sum((r.weight * r.left) ** 2) for r in fit.fitted))


def _concluded(search: Search, fits: Fits, began: float) -> Diagnosis:
    """What a search has found, in numbers."""
    posterior = Posterior(search)
    scene, best, other = search.scene, posterior.best, search.reassigned
    models = _ladder_of(search, fits, best)
    lookalikes, advice = posterior.lookalikes(), None
    rivals, p = posterior.rivals()
    if len(rivals) > 1:
        search.say("looking for the experiment that would tell the models apart")
        advice = next(iter(best_tests(fits.whole, scene, rivals, p)[0]), None)
    if search.curves:
        search.say("looking for its formula")
    curves = posterior.of_curves.tolist(), posterior.of_laws
    laws = laws_of(search, *curves, search.best.log_evidence, fits)
    shown = [(search.tried.get(frozenset([x]), best), x) for x in best.added]
    others = [
        (search.tried[frozenset([x])], x)
        for group in lookalikes
        for x in group[1:]
        if frozenset([x]) in search.tried
    ]
    pairs = best.over_torques(scene)
    still = missing_of(scene, best, pairs=pairs)
    missing = still
    if best.added:
        missing = missing_of(fits.scene, search.base_under_torque, [*shown, *others[:CURVES]])
    verdict, probability = posterior.verdict()
    noise = _coloured_noise(scene, best, models[-1].fit)
    # All evidences are those of white noise: where none is that, no model of them is adequate.
    left = coloured(models[-1].fit) if verdict != "unexplained" and noise is None else None
    if left is not None:
        verdict, probability = "unexplained", 1.0 - NOISE
    return Diagnosis(
        verdict=verdict,
        verdict_probability=probability,
        ladder=models,
        candidates=posterior.candidates(),
        families=posterior.families(),
        lookalikes=lookalikes,
        next_experiment=advice,
        missing=missing,
        still_missing=still,
        laws=laws,
        coloured=left,
        coloured_noise=noise,
        random_torque=_random_torque(scene, best, pairs),
        parameters=values_of(scene, best.posterior),
        channels=other
        and ChannelError(other.channels.words, posterior.of_reassigned, other.tried.complete > 0.5),
        intensity=0.0 if scene.coloured else float(np.dot(best.weights, INTENSITIES)),
        explains_nothing=best.intensity >= EXPLAINS_NOTHING,
        budget=Budget(len(search.tried), len(search.candidates), search.stopped),
        seconds=time.perf_counter() - began,
        search=search,
        fits=fits,
    )


def _ladder_of(search: Search, fits: Fits, best: Tried) -> tuple[ModelState, ...]:
    """Models that were tried on the way from the base model to the best one: of those with the
    fewest more of its effects the likeliest in turn, however the search came there."""
    models = [search.base]
    while len(models[-1].added) < len(best.added):
        own = set(models[-1].added)
        ways = [m for x, m in search.tried.items() if own < x <= set(best.added)]
        models.append(min(ways, key=lambda m: (len(m.added), -m.log_posterior)))
    for model in models:
        fits.begin(model)
    found, known = [], ()
    for model in models:
        result = fits.of(model)
        joined, known = tuple(x for x in model.added if x not in known), model.added
        held = held_out(result)
        relative = model.log_evidence - search.best.log_evidence
        found.append(ModelState(joined, result, held, relative))
    give_back()
    return tuple(found)


def values_of(scene: Scene, t: Trajectory) -> dict[str, Value]:
    """The numbers of a smoothed model, by name, with their posterior standard deviations; less
    those that do nothing at all, as the second link's where there is one."""
    slopes = t.prior.slopes(t.u)
    spread = np.sqrt(np.maximum(np.diag(t.covariance)[: len(slopes)], 0.0)) * np.abs(slopes)
    return {
        f"{e.label}.{n.name}": Value(float(x), float(s), scene.unit(e, n))
        for (e, n), x, s in zip(each_number(t.effects), t.numbers, spread, strict=True)
        if x != n.silent  # exactly where its prior has it
    }


class Posterior:
    """Sums over the models that were tried."""

    def __init__(self, search: Search):
        self.search = search
        self._needs = functools.cache(lambda model: model.needs(search.scene))
        self._torques = functools.cache(lambda t: search.scene.torques(t))
        self.curves = search.curves
        self.models = [m for m in search.tried.values() if m.informed]
        """Those that were tried, but for effects of which the readings say nothing."""
        passed = [m for added, m in search.passed.items() if added not in search.tried]
        self.named = [*self.models, *passed]
        """With those that are known to first order only."""
        other = search.reassigned
        logs = [m.log_posterior for m in [*self.named, *self.curves]]
        logs += [other.tried.log_posterior] if other else []
        each = log_softmax(np.array(logs))
        self.log_tried = each[: len(self.models)]
        """Log probability of each model that was tried: of a rare one the probability may be 0."""
        self.log_with_negligible = self.log_tried.copy()
        """The same, with what is that model beside a negligible law without a name."""
        places = {frozenset(m.added): i for i, m in enumerate(self.models)}
        for curve, log in zip(self.curves, each[len(self.named) :], strict=False):
            i = places.get(frozenset(curve.added))
            if i is not None and not curve.matters:
                self.log_with_negligible[i] = np.logaddexp(self.log_with_negligible[i], log)
        ends = np.cumsum([len(self.named), len(self.curves)])
        self.each, self.of_curves, of_other = np.split(np.exp(each), ends)
        """Probability of each model with names only, of each with a free curve, and of the base
        model with the columns read otherwise."""
        self.weighed = [
            *zip(self.named, self.each, strict=True), *zip(self.curves, self.of_curves, strict=True)
        ]  # fmt: skip
        self.of_reassigned = float(of_other.sum())
        pairs = zip(self.curves, self.of_curves, strict=True)
        self.of_unnamed = float(sum(p for curve, p in pairs if curve.matters))
        """Probability that there is a law without a name."""
        verdict = self.verdict()[0]
        chosen = {"adequate": False, "missing": True}.get(verdict)
        first = next(
            own for own in self._explanations()
            if chosen is None or bool(self.models[own[0]].added) is chosen
        )  # fmt: skip
        self.best: Tried = self.models[first[0]]
        """The likeliest model of the likeliest explanation that the verdict speaks of, without its
        free curve."""
        if chosen is None and self.curves:
            top = max([*self.models, *self.curves], key=lambda m: m.log_posterior)
            self.best = search.tried[frozenset(top.added)]

    def of(self, labels: Iterable[str], kind: tuple[str, str | None] | None = None) -> float:
        """Probability that one of these effects, or a law of this kind and place that has no name,
        is at work: that of all models which have one, less what may be of a torque of no catalogue
        that they only take up a part of."""
        wanted = set(labels)
        total = 0.0
        for model, p in self.weighed:
            each: list[str | None] = [x for x in model.added if x in wanted]
            if kind is not None and self._kind_of(model) == kind:
                each.append(None)
            of_each = (np.dot(model.weights, self._at_work(model, x)) for x in each)
            total += p * max(of_each, default=0.0)
        return float(total)

    def _kind_of(self, model: Tried | CurveModel) -> tuple[str, str] | None:
        """Kind of law and place of a model's free curve."""
        if not isinstance(model, CurveModel) or not model.matters or not model.place.kind.family:
            return None
        return model.place.kind.family, self.search.scene.joints[model.place.joint]

    def _at_work(self, model: Tried | CurveModel, label: str | None) -> np.ndarray:
        """(I,) `at_work` of one effect in a model, or of its free curve. Beside a curve which may
        hold a spring or a damper of either sign, the signs are those without it; a friction holds
        neither."""
        signs = model
        if isinstance(model, CurveModel) and model.place.kind.factor != "direction":
            signs = self.search.tried.get(frozenset(model.added), model)
        before, noise = self._needed_without(model, label), model.best.coloured is not None
        return at_work(before, signs_of(signs.best), noise)

    def _needed_without(self, model: Tried | CurveModel, label: str | None) -> np.ndarray:
        """(I,) posterior of the random torque that a model needs without one of its effects, or
        without its free curve: the least that any model needs which was tried and has no effect
        beyond those. With more effects a model needs no more. It is no less than what the effect
        does: a random torque need not show a line that is far above the modes."""
        rest, sizes = frozenset(model.added) - {label}, np.array(INTENSITIES)
        each = (self._needs(m) for added, m in self.search.tried.items() if added <= rest)
        return at_least(
            min(each, key=lambda weights: weights @ sizes), self._beyond_base(model, label)
        )

    def _beyond_base(self, model: Tried | CurveModel, label: str | None) -> float:
        """What an effect does in a model that neither springs nor dampers could: rms, in typical
        torques, of the part of its torque that is no linear function of the state, at the joint
        where that is largest; 0 of what is no torque."""
        scene, t = self.search.scene, model.best
        if label not in t.labels or scene.coloured is not None:
            return 0.0
        own, state = self._torques(t)[label][scene.real], t.path[scene.real, : 2 * scene.n]
        own = own - state @ np.linalg.lstsq(state, own)[0]
        return float(np.max(np.sqrt(np.mean(own**2, axis=0)) / scene.torque))

    def _explains(self, model: Tried | CurveModel) -> float:
        """Probability, given a model, that it needs no random torque that matters and that its
        names, if it has any, are at work."""
        work = np.min([self._at_work(model, x) for x in model.added] or 1.0, axis=0)
        return float((work * model.weights)[model.enough].sum())

    @property
    def of_laws(self) -> list[float]:
        """Probability that there is each law without a name: that of its model, less what may be of
        another torque that it only takes up a part of."""
        pairs = zip(self.curves, self.of_curves, strict=True)
        return [float(p * np.dot(c.weights, self._at_work(c, None))) for c, p in pairs]

    def verdict(self) -> tuple[Verdict, float]:
        """The likeliest of the three, and its probability."""
        sums = {"adequate": 0.0, "missing": 0.0, "unexplained": 0.0}
        for model, p in self.weighed:
            # A law without a name is no explanation by the catalogue, unless it is negligible.
            unnamed = isinstance(model, CurveModel) and model.matters
            complete = 0.0 if unnamed else self._explains(model)
            sums["missing" if model.added else "adequate"] += p * complete
            sums["unexplained"] += p * (1.0 - complete)
        sums["unexplained"] += self.of_reassigned  # by anything of the readings as they stand
        likeliest: Verdict = max(sums, key=lambda v: sums[v])  # pyrefly: ignore[bad-assignment]
        return likeliest, float(sums[likeliest])

    def _alone(self, label: str) -> float:
        """Log evidence of the base model with one effect, to first order if it was not tried."""
        tried = self.search.tried.get(frozenset([label]))
        if tried is not None:
            return tried.log_evidence
        screen = self.search.screens.get(frozenset())
        gains = (s.gain for s in (screen.ranked if screen else ()) if s.effect.label == label)
        return self.search.base.log_evidence + next(gains, -math.inf)

    def candidates(self) -> tuple[Candidate, ...]:
        """Every effect and place."""
        found = []
        for label in (e.label for e in self.search.candidates):
            alone = self.search.tried.get(frozenset([label]))
            values = values_of(self.search.scene, alone.posterior) if alone else {}
            candidate = Candidate(
                effect=label,
                probability=self.of([label]),
                log_evidence=self._alone(label) - self.search.best.log_evidence,
                iterated=alone is not None,
                parameters={k: v for k, v in values.items() if k.startswith(f"{label}.")},
            )
            if candidate.log_evidence > -math.inf:
                found.append(candidate)
        # By the probability as it is printed: of equal ones the evidence tells.
        return tuple(sorted(found, key=lambda c: (-round(c.probability, 2), -c.log_evidence)))

    def families(self) -> tuple[Family, ...]:
        """Kinds of law and their places."""
        groups: dict[tuple[str, str | None], list[AbstractEffect]] = {}
        for effect in self.search.candidates:
            groups.setdefault((effect.kind(), effect.place), []).append(effect)
        found = []
        for (name, place), effects in groups.items():
            labels, kind = [e.label for e in effects], (name, place)
            members = sorted(((x, self.of([x])) for x in labels), key=lambda m: -m[1])
            known = self.of(labels, kind), tuple(members), self.of((), kind)
            found.append(Family(name, place, *known))

        def order(f: Family):
            # `OUTSIDE`, known from three rigs, leaves a name's probability open by about a tenth.
            # As probable to that: what has a name is first, then what explains most by itself.
            label, probability = f.members[0]
            unnamed = probability < 0.5 * f.probability
            return -round(f.probability, 1), unnamed, -self._alone(label)

        return tuple(sorted(found, key=order))

    def _explanations(self) -> list[list[int]]:
        """The models that were tried, those of the same kinds of law and places together, the
        likeliest first: several laws of one kind share its probability."""
        groups: dict[frozenset, list[int]] = {}
        for i in np.argsort(-self.log_tried, kind="stable").tolist():
            groups.setdefault(self._kinds_of(self.models[i]), []).append(i)
        return sorted(groups.values(), key=lambda own: -log_sum(self.log_tried[own]))

    def _kinds_of(self, model: Tried) -> frozenset[tuple[str, str | None]]:
        """Kinds and places of the laws that were added."""
        kinds = {e.label: (e.kind(), e.place) for e in self.search.candidates}
        return frozenset(kinds[x] for x in model.added)

    def in_play(self) -> tuple[list[Tried], np.ndarray, float]:
        """The models with names only that count, the likeliest first, their probabilities among
        each other, and that of all the rest (`in_play`). None where the columns are to be put right
        first."""
        if self.of_reassigned:
            return [], np.zeros(0), 1.0
        return in_play(self.models, self.log_with_negligible)

    def rivals(self) -> tuple[list[Tried], np.ndarray]:
        """Of the models in play, the likeliest explanation (kinds of law and their places) and the
        next one, if the two cannot be told apart: the likeliest model of each, and their
        probabilities."""
        groups: dict[frozenset, list[tuple[Tried, float]]] = {}
        models, p, _ = self.in_play()
        for model, x in zip(models, p.tolist(), strict=True):
            groups.setdefault(self._kinds_of(model), []).append((model, x))
        each = [(own[0][0], sum(x for _, x in own)) for own in groups.values()]
        each = sorted(each, key=lambda e: -e[1])[:2]
        close = [e for e in each if e[1] >= each[0][1] * math.exp(-INDISTINGUISHABLE)]
        p = np.array([x for _, x in close])
        return [m for m, _ in close], p / p.sum()

    def lookalikes(self) -> tuple[tuple[str, ...], ...]:
        """For each added effect, those that could stand in its place with odds of at least 1 to 20,
        the likeliest first; of the models in play."""
        found, (models, _, _) = [], self.in_play()
        for label in self.best.added if self.best in models else ():
            rest = frozenset(self.best.added) - {label}
            others = []
            for model in models:
                new = frozenset(model.added) - rest
                if rest <= frozenset(model.added) and len(new) == 1 and label not in new:
                    behind = self.best.log_posterior - model.log_posterior
                    if behind < INDISTINGUISHABLE:
                        others.append((behind, next(iter(new))))
            if others:
                found.append((label, *(x for _, x in sorted(others))))
        return tuple(found)


def _coloured_noise(scene: Scene, model: Tried, fit: Fit) -> ColouredNoise | None:
    """What the fit of a model leaves, where the model needs noise that is not white."""
    if scene.coloured is None or model.intensity == 0:
        return None
    each = zip(scene.joints, fit.experiment.reading_units, fit.rmse, strict=True)
    return ColouredNoise(scene.coloured, {joint: (float(rms), unit) for joint, unit, rms in each})


def _random_torque(
    scene: Scene, model: Tried, pairs: Sequence[tuple[float, Trajectory]]
) -> tuple[RandomTorque, ...]:
    """Per joint, what the model still lacks: its rms over the recordings, summed over intensities
    (`pairs`, from `over_torques`). None stands for all up to the least that is not none: where the
    band ends there, that is its end."""

    def size(t: Trajectory) -> np.ndarray:
        return np.sqrt(np.mean((t.torque**2 + t.torque_variance)[scene.real], axis=0))

    sizes, weights = np.array([size(t) for _, t in pairs]), np.array([w for w, _ in pairs])
    low, high = np.quantile(sizes, (0.025, 0.975), axis=0, weights=weights, method="inverted_cdf")
    if not high.all():
        t = model.best
        least = scene.smoothed(t, scene.linearised(t), INTENSITIES[-2])
        high = high if least is None else np.where(high == 0, size(least), high)
    spring = np.sqrt(np.mean(restoring_torque(scene, model.best)[scene.real] ** 2, axis=0))
    rms = np.sqrt(weights @ sizes**2)
    share = np.divide(rms, spring, out=np.full(scene.n, math.nan), where=spring > 0)
    rows = zip(rms.tolist(), low.tolist(), high.tolist(), share.tolist(), strict=True)
    names = zip(scene.joints, scene.torque_units, strict=True)
    return tuple(RandomTorque(*own, *row) for own, row in zip(names, rows, strict=True))
