"""Which of the tests that a rig allows tells most, from the predictions of the models in play.

Every model predicts every test, with slopes in its numbers and in the state at release. What the
recordings leave open of the numbers is their posterior covariance; what a test is then worth is
`experiment_design.worth`. More than one test is planned greedily: each is the best beside those
before it.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..filtering.trajectory import Scene
from ..fitting.layout import bucket
from ..fitting.problem import mechanism_of, posed
from ..physics.modal import at_rest, equilibrium, fastest, modes_of
from ..physics.model import Model
from ..recordings.experiment import Experiment
from ..recordings.limits import Limits
from ..recordings.reads import READS
from ..recordings.recording import Recording
from ..recordings.tables import ArmTable, InertiaTable
from ..runtime.export_cache import kept
from ..runtime.json import finite
from ..runtime.presentation import Result
from ..simulation.equation import Drive
from ..simulation.interpolation import read
from ..simulation.simulate import SMOOTH_STEP, march
from .evidence import CONTENDERS, IN_PLAY, INDISTINGUISHABLE, RELEASE_ERROR, WORTHWHILE
from .experiment_design import Predicted, Quantity, Worth, entropy, reduced, together, worth
from .tried import Tried

_SAMPLES = 512
"""Instants of a prediction: the separation of two models is then right to 1 % over 40 cycles, to
2 % over 300."""
_ELBOWS = 5
"""Elbow angles that are tried: inertia goes with the cosine of the angle, and five see it small,
middling and large, on either side."""
_FURTHEST = 0.75 * math.pi
"""Of them, unless limits are given: folded further, links of any width touch."""
_SHARES = (0.125, 0.25, 0.5, 1.0)
"""Of the longest duration; of the largest release, from 0.25 on. Halves: the cost goes with their
number, and no test is longer than twice what is needed."""
_DIRECTIONS = 40
"""Of a release: all that four joints have, up to sign. Their number is three times as large with
each joint, and so is the time that a plan takes."""
_LOADS = 3
"""Loads that are tried: what a load changes grows with it, and a middle one shows it bend."""
_TWICE = 2.0
"""Angles and loads that are tried, in those recorded, unless limits are given: the
further from the recordings, the less their models say of the rig."""
_DRIVES = (0.3, 1.0)
"""Of the largest torque of a motor, half a decade apart, as `INTENSITIES` are: what grows with the
swing shows under the largest, friction under less."""
_BAND = (0.5, 1.5)
"""Of a sweep, in the lowest and the highest frequency of the modes: it passes the whole of each
resonance, also under a load as heavy as what moves, which lowers it to 0.7."""
_NEARLY = 0.95
"""Of the fall of the entropy in the longest recording, from which a shorter one is enough: of two
models the rest is at most 0.03 nats, about what the draws leave open."""


@dataclass(frozen=True)
class Sweep:
    """A motor's torque, a sine of rising frequency, on an arm that begins at rest."""

    joint: str
    torque: float
    """Amplitude, N m or N."""
    low: float
    """Hz, at the beginning."""
    high: float
    """Hz, at the end."""

    def at(self, time: np.ndarray, duration: float) -> np.ndarray:
        """(M,) torque at instants of a recording that lasts so long."""
        rise = (self.high - self.low) / duration
        return self.torque * np.sin(2 * np.pi * (self.low * time + 0.5 * rise * time**2))

    def beginning(self, share: float) -> "Sweep":
        """What a share of the duration sees of it: the frequency rises in proportion to time."""
        return dataclasses.replace(self, high=self.low + share * (self.high - self.low))


@dataclass(frozen=True)
class Outcome:
    """What is to be seen if one of the models is right."""

    added: tuple[str, ...]
    reading: float
    """Of the joint and instant that the test names, in the test's `unit`."""
    std: float
    """What the recordings leave open of it, and the noise of a reading."""
    probability: float
    """Which this model is then expected to have."""


@dataclass(frozen=True)
class Test(Result, about="plan"):
    """A recording to make."""

    __test__ = False  # for pytest, which this is not

    release: dict[str, float]
    """How far (rad or m) from its rest, as its sensor reads it, each joint is let go."""
    units: tuple[str, ...]
    """Of the joints' angles; "" where not known."""
    theta2: float | None
    """Elbow angle at rest, rad; None where there is no arm."""
    air_bearings: bool | None
    """Whether the bearings are on; None where there are none."""
    extra_mass: float | None
    """Load on the first coordinate, kg m^2 (kg if it slides); None where that is not a choice."""
    load: float | None
    """On whatever rubs, N; None where the recordings state none."""
    drive: Sweep | None
    """What the motor does; None: nothing, the arm is released."""
    duration: float
    """s."""
    entropy: float
    """Of the models in play, nats, expected after this test and those before it."""
    probability_right: float
    """Expected probability of the likeliest model then."""
    between: tuple[tuple[str, ...], tuple[str, ...]]
    """What the two likeliest models add, each without what both have."""
    difference: float
    """Their predictions differ by this many standard errors of all readings together, after the
    rival has adjusted its numbers as far as it may."""
    now: float
    """The same for the recordings that there are."""
    joint: str
    """Where the two are told apart most clearly by one reading,"""
    reads: str
    """what is read there: "angle", "rate" or "acceleration","""
    unit: str
    """in which unit ("" where not known),"""
    time: float
    """and when, s after the beginning."""
    outcomes: tuple[Outcome, ...]
    """One for each model in play."""
    helps: bool
    """Whether it is expected to tell enough to be worth making."""
    band: float | None = None
    """Expected half width of the 95 % band of what the plan is for, if it is for a quantity."""

    @property
    def words(self) -> str:
        """The test and what it tells, in two or three sentences."""
        return self._presented("sentence")

    def to_dict(self) -> dict[str, Any]:
        """The JSON of one test, and of `next_experiment`."""
        told = dataclasses.asdict(self)
        named = {
            "between": ["+".join(labels) or "nothing" for labels in self.between],
            "difference_over_noise": told.pop("difference"),
            "difference_over_noise_now": told.pop("now"),
            "reading": {key: told.pop(key) for key in ("joint", "reads", "unit", "time")},
            "words": self.words,
        }
        return finite(told | named)


class Setting(NamedTuple):
    """A test that could be made."""

    recording: Recording
    release: np.ndarray
    drive: Sweep | None


class Rival(NamedTuple):
    """A model in play."""

    tried: Tried
    model: Model
    root: np.ndarray  # (P, P) R with R R' the posterior covariance of its numbers

    @classmethod
    def of(cls, scene: Scene, tried: Tried) -> "Rival":
        """A tried model."""
        t = tried.posterior
        slopes = t.prior.slopes(t.u)
        own = t.covariance[: len(slopes), : len(slopes)] * np.outer(slopes, slopes)
        size = np.sqrt(np.maximum(np.diag(own), 1e-300))
        values, vectors = np.linalg.eigh(own / np.outer(size, size))
        root = size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
        return cls(tried, scene.model(t), root)


def settings_of(experiment: Experiment, scene: Scene, model: Model) -> list[Setting]:
    """Every test that is compared: releases from rest, and sweeps of the motors, within limits."""
    limits = experiment.limits or Limits()
    like = max(experiment.fit_recordings, key=lambda r: r.duration)
    n = len(experiment.joints)
    swing = np.array([s.amplitude for s in scene.scales])
    angle = np.array(limits.each("angle", n) or _TWICE * swing)
    duration = limits.duration or like.duration
    each = itertools.product(_SHARES[1:], _directions(angle))
    releases = [size * direction for size, direction in each]
    motions: list[tuple[np.ndarray, Sweep | None]] = [(r, None) for r in releases]
    torques = limits.each("drive", n) or (0.0,) * n
    frequencies = modes_of(model, at_rest(model)[1]).frequency_hz
    rings = frequencies[np.isfinite(frequencies) & (frequencies > 0)]
    for joint, torque in zip(experiment.joints, torques, strict=True):
        for share in _DRIVES if torque and len(rings) else ():
            band = _BAND[0] * float(min(rings)), _BAND[1] * float(max(rings))
            motions.append((np.zeros(n), Sweep(joint, share * torque, *band)))
    # Of a run to come, for which there are only the numbers that all runs share.
    run = dataclasses.replace(like, name="planned", own=(), segment_of=None)
    longest = dataclasses.replace(run, time=np.array([0.0, duration]), drive=None)
    return [
        Setting(dataclasses.replace(longest, **change), release, drive)
        for change in _changes(experiment, like, limits)
        for release, drive in motions
    ]


def _directions(angle: np.ndarray) -> list[np.ndarray]:
    """Largest releases (n,): the joints that may be released to either side or not at all, but for
    the sign of the whole; those of fewest joints first, `_DIRECTIONS` at the most."""
    free = np.flatnonzero(angle)
    each = (
        (joints, (1.0, *signs))
        for count in range(1, len(free) + 1)
        for joints in itertools.combinations(free, count)
        for signs in itertools.product((1.0, -1.0), repeat=count - 1)
    )
    found = []
    for joints, signs in itertools.islice(each, _DIRECTIONS):
        direction = np.zeros(len(angle))
        direction[list(joints)] = signs * angle[list(joints)]
        found.append(direction)
    return found


def _changes(experiment: Experiment, like: Recording, limits: Limits) -> list[dict]:
    """What may be set on the rig beside the release: every combination."""
    fitted = experiment.fit_recordings
    choices: dict[str, list] = {}
    if isinstance(experiment.inertia, ArmTable):
        low, high = limits.theta2 or (-_FURTHEST, _FURTHEST)
        choices["theta2"] = _with(like.theta2, np.linspace(low, high, _ELBOWS))
        either = (True, False) if experiment.bearings else (like.air_bearings,)
        choices["air_bearings"] = list(limits.air_bearings or either)
    elif isinstance(experiment.inertia, InertiaTable):
        own = float(np.asarray(experiment.inertia.matrix)[0][0])
        largest = max([_TWICE * r.extra_mass for r in fitted] + [own])
        low, high = limits.extra_mass or (0.0, largest)
        choices["extra_mass"] = _with(like.extra_mass, np.linspace(low, high, _LOADS))
    loaded = max(r.load for r in fitted)
    if limits.load or loaded > 0:
        low, high = limits.load or (0.0, _TWICE * loaded)
        choices["load"] = _with(like.load, np.linspace(low, high, _LOADS))
    return [dict(zip(choices, x, strict=True)) for x in itertools.product(*choices.values())]


def _with(now: float, values: np.ndarray) -> list[float]:
    """These values, and what is set now if it lies between them."""
    each = values.tolist()
    return list(dict.fromkeys([*each, now] if min(each) <= now <= max(each) else each))


class Predictions:
    """Every model's readings in every test."""

    def __init__(self, experiment: Experiment, scene: Scene, rivals: Sequence[Rival]):
        self.experiment, self.scene, self.rivals = experiment, scene, rivals
        self.settings = settings_of(experiment, scene, rivals[0].model)
        first = experiment.fit_recordings[0]
        self.noise = first.noise
        per_second = len(first.time) / first.duration
        self.duration = self.settings[0].recording.duration
        self.time = np.linspace(0.0, self.duration, _SAMPLES)
        # Each sample stands for all readings that lie nearer to it than to others.
        self.weight = np.sqrt(per_second * self.duration / _SAMPLES) / self.noise
        mechanisms = [mechanism_of(experiment, s.recording) for s in self.settings]
        posed_at = {
            (s.recording.theta2, s.recording.air_bearings, s.recording.extra_mass): m
            for s, m in zip(self.settings, mechanisms, strict=True)
        }
        fast = max(float(fastest(posed(r.model, m))) for r in rivals for m in posed_at.values())
        swept = max((2 * math.pi * s.drive.high for s in self.settings if s.drive), default=0.0)
        steps = bucket(max(16, math.ceil(self.duration * max(fast, swept) / SMOOTH_STEP)))
        stacked = jax.tree.map(lambda *x: np.stack(x), *mechanisms)
        releases = np.stack([s.release for s in self.settings])
        drives = self._drives(steps)
        given = stacked, releases, drives, self.time, steps, scene.orders
        told = [jax.device_get(_predict(r.model, *given)) for r in rivals]
        self.readings, self.slopes = zip(*told, strict=True)
        """(S, T, n) of each model, of what the sensors read; and (S, T, n, P + 2n + M) in its
        numbers, and in the angles, rates and internal states at release."""

    def _drives(self, steps: int) -> Drive | None:
        if not any(s.drive for s in self.settings):
            return None
        time = np.linspace(0.0, self.duration, steps + 1)
        values = np.zeros((len(self.settings), len(time), self.scene.n))
        for i, s in enumerate(self.settings):
            if s.drive is not None:
                joint = self.scene.joints.index(s.drive.joint)
                values[i, :, joint] = s.drive.at(time, self.duration)
        begin, step = np.zeros(len(values)), np.full(len(values), time[1])
        return Drive(*map(jnp.asarray, (begin, step, values)))

    def of(self, index: int, share: float = 1.0) -> list[Predicted]:
        """What all models say of one test, or its beginning; nothing if one of them runs away."""
        keep = slice(0, math.ceil(share * _SAMPLES))
        found = []
        for rival, readings, slopes in zip(self.rivals, self.readings, self.slopes, strict=True):
            mean, by = readings[index, keep], slopes[index, keep]
            if not (np.isfinite(mean).all() and np.isfinite(by).all()):
                return []
            w = self.weight[None, :]
            P = len(rival.root)
            numbers = (by[..., :P] * w[..., None]).reshape(-1, P) @ rival.root
            release = by[..., P:] * w[..., None] * self._unknown(rival, index)
            found.append(
                Predicted((mean * w).reshape(-1), numbers, release.reshape(-1, release.shape[-1]))
            )
        return reduced(found)

    def _unknown(self, rival: Rival, index: int) -> np.ndarray:
        """(2n + M,) how well the state at release is known; internal states as well as where any
        recording begins (`Scene.noise`)."""
        scales = self.scene.scales
        swing = np.array([s.amplitude for s in scales])
        release = np.abs(self.settings[index].release)
        angle = RELEASE_ERROR * swing * (float(np.max(release / swing)) or 1.0)
        rate = angle * np.array([s.frequency for s in scales])
        memory = [
            float(each.dimension.size(scales[self.scene.joint_of(effect)]))
            for effect in rival.model.effects
            for each in effect.memory
        ]
        return np.concatenate([angle, rate, memory])

    def clearest(self, index: int, share: float) -> tuple[int, int, list[tuple[float, float]]]:
        """The sample and joint at which one reading tells the two likeliest models apart best, and
        every model's reading there with its standard error."""
        keep = slice(0, math.ceil(share * _SAMPLES))
        means, stds = [], []
        for rival, readings, slopes in zip(self.rivals, self.readings, self.slopes, strict=True):
            by, P = slopes[index, keep], len(rival.root)
            numbers, release = by[..., :P] @ rival.root, by[..., P:] * self._unknown(rival, index)
            means.append(readings[index, keep])
            stds.append(np.sqrt((numbers**2).sum(-1) + (release**2).sum(-1) + self.noise**2))
        a, b = 0, min(1, len(means) - 1)
        apart = np.abs(means[a] - means[b]) / np.hypot(stds[a], stds[b])
        k, j = np.unravel_index(int(np.argmax(apart)), apart.shape)
        each = [(float(m[k, j]), float(s[k, j])) for m, s in zip(means, stds, strict=True)]
        return int(k), int(j), each


@kept(like=(0, 0))
def _predict(
    model: Model, mechanisms, releases, drives, times, steps: int, orders: tuple[int, ...]
):
    """Readings of each test, and their slopes in numbers and state at release."""
    numbers, n, M = model.vector(), releases.shape[1], len(model.memory)
    P = len(numbers)

    def one(test):
        mechanism, release, drive = test

        def at(z):
            moved = posed(model.with_vector(z[:P]), mechanism)
            q, v, memory = z[P : P + n], z[P + n : P + 2 * n], z[P + 2 * n :]
            q0 = equilibrium(moved) + release + q
            nodes = march(moved, times[0], times[-1], q0, v, steps=steps, z0=memory, drive=drive)
            found = read(moved, nodes, times, orders).readings
            return found, found

        z = jnp.concatenate([numbers, jnp.zeros(2 * n + M)])
        slopes, found = jax.jacfwd(at, has_aux=True)(z)
        return found, slopes

    return jax.lax.map(one, (mechanisms, releases, drives))


def best_tests(
    experiment: Experiment,
    scene: Scene,
    models: Sequence[Tried],
    probability: np.ndarray,
    tests: int = 1,
    quantity: Quantity | None = None,
) -> tuple[tuple[Test, ...], int]:
    """The tests that are expected to tell these models apart best, each beside those before it; or
    to narrow a quantity most, whose slopes are in the models' numbers. And how many were compared.
    """
    p = np.asarray(probability, float) / np.sum(probability)
    rivals = [Rival.of(scene, m) for m in models]
    all_of_them = Predictions(experiment, scene, rivals)
    wanted = quantity and quantity._replace(
        slopes=[r.root.T @ s for r, s in zip(rivals, quantity.slopes, strict=True)]
    )
    known = {i: x for i in range(len(all_of_them.settings)) if (x := all_of_them.of(i))}
    # A load of which the experiment says nothing may not be at hand.
    limits = experiment.limits or Limits()
    loaded = limits.extra_mass or any(r.extra_mass for r in experiment.fit_recordings)
    made: list[list[Predicted]] = []
    found: list[Test] = []
    before = float(entropy(p))

    def after(test: list[Predicted]) -> Worth:
        return worth(together([*made, test]), p, wanted)

    def rank(i: int, told: Worth) -> tuple[float, ...]:
        if wanted is not None:
            return (told.variance,)
        # To two digits: the draws know no more. What is told for certain is told best by what
        # tells the most apart.
        unstated = not loaded and all_of_them.settings[i].recording.extra_mass > 0
        return round(told.entropy, 2), unstated, -told.separation

    while len(found) < min(tests, len(known)):
        told = {i: after(x) for i, x in known.items()}
        best = min(told, key=lambda i: rank(i, told[i]))
        chosen = 1.0, known[best], told[best]
        if wanted is None:
            enough = before - _NEARLY * (before - told[best].entropy)
            shorter = ((s, x := all_of_them.of(best, s), after(x)) for s in _SHARES[:-1])
            chosen = next((x for x in shorter if x[2].entropy <= enough), chosen)
        share, test, left = chosen
        helps = wanted is not None or before - left.entropy > WORTHWHILE * float(entropy(p))
        made.append(test)
        found.append(_test(all_of_them, best, share, separation(test), left, helps))
        before = left.entropy
        if not helps:
            break
    return tuple(found), len(known)


def _test(
    all_of_them: Predictions, index: int, share: float, apart: float, told: Worth, helps: bool
) -> Test:
    """One of them, or its beginning, and what it tells beside those before it."""
    s, experiment = all_of_them.settings[index], all_of_them.experiment
    models = [r.tried for r in all_of_them.rivals]
    arm = isinstance(experiment.inertia, ArmTable)
    table = isinstance(experiment.inertia, InertiaTable)
    loaded = any(x.recording.load for x in all_of_them.settings)
    k, j, readings = all_of_them.clearest(index, share)
    first, second = models[0], models[min(1, len(models) - 1)]
    one, other = (
        tuple(x for x in m.added if x not in n.added) for m, n in ((first, second), (second, first))
    )
    return Test(
        release=dict(zip(experiment.joints, map(float, s.release), strict=True)),
        units=experiment.units or ("",) * len(experiment.joints),
        theta2=float(s.recording.theta2) if arm else None,
        air_bearings=s.recording.air_bearings if arm and experiment.bearings else None,
        extra_mass=float(s.recording.extra_mass) if table else None,
        load=float(s.recording.load) if loaded else None,
        drive=s.drive and s.drive.beginning(share),
        duration=share * all_of_them.duration,
        entropy=told.entropy,
        probability_right=told.right,
        between=(one, other),
        difference=apart,
        now=math.sqrt(2 * abs(first.log_evidence - second.log_evidence)),
        joint=experiment.joints[j],
        reads=READS[s.recording.orders[j]],
        unit=experiment.reading_units[j],
        time=float(all_of_them.time[k]),
        outcomes=tuple(
            Outcome(m.added, reading, std, float(e))
            for m, (reading, std), e in zip(models, readings, told.each, strict=True)
        ),
        helps=helps,
        band=None if math.isnan(told.variance) else 1.96 * math.sqrt(max(told.variance, 0.0)),
    )


def separation(test: Sequence[Predicted]) -> float:
    """d of the two likeliest models: their difference in standard errors, after the second has bent
    its numbers as far as it may."""
    if len(test) < 2:
        return 0.0
    a, b = test[0], test[1]
    u, d = np.column_stack([b.numbers, b.release]), a.mean - b.mean
    bend = np.linalg.solve(np.eye(u.shape[1]) + u.T @ u, u.T @ d)
    return math.sqrt(max(0.0, float(d @ d - (u.T @ d) @ bend)))


def settled(logs: np.ndarray) -> bool:
    """Whether odds tell the likeliest of some models from all else together, by log
    probabilities."""
    p = math.exp(np.max(logs, initial=-math.inf))
    return p >= 1 or (p > 0 and math.log(p / (1 - p)) > INDISTINGUISHABLE)


def in_play(models: Sequence[Tried], logs: np.ndarray) -> tuple[list[Tried], np.ndarray, float]:
    """The models that the recordings leave possible, the likeliest first, their probabilities
    among each other, and that of all the rest. `logs` (len(models),) are log probabilities, whose
    sum is less than 1 where something else has the rest."""
    kept = [i for i in np.argsort(-logs)[:CONTENDERS] if logs[i] >= math.log(IN_PLAY)]
    p = np.exp(logs[kept])
    return [models[i] for i in kept], p / p.sum(), max(0.0, float(1.0 - p.sum()))
