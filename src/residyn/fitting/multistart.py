"""From several starts to the best minimum: growing horizons, and multiple shooting.

Ringing makes a cost with many minima: off by half a cycle at the end of the record, a descent ends
in another one. So each start is first fitted to the first few cycles alone, where no phase can
slip, then to a longer horizon, then to everything. Starts that end in the same place go on as one,
and those that have fallen far behind do not go on.

Where that ends above the noise and starts disagree, the first cycles were not enough, or they
were not typical (a brake that slips in the first swing and holds then; 5 % of noise). Then comes
*multiple shooting* (Bock and Plitt, 1984): recordings are cut into segments of a few cycles, each
with an initial state of its own, read off the measurement. All readings count at once, and in no
segment can a phase slip. To least squares, segments are recordings (`linalg`). From the numbers
found so, the segments are joined: their states go, and the horizon grows once more.
"""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..effects import AbstractEffect
from ..physics.modal import at_rest, eigenvalues, modes_of
from ..physics.model import Model
from ..physics.motion import split
from ..recordings.experiment import Experiment
from ..recordings.outliers import outlier_mask
from ..recordings.recording import Recording
from ..recordings.segments import segments_of
from .history import watching
from .initial_guess import first_guess, frequency_of, lines, memory_along_readings, resolving
from .lanes import SHARES, Fitting, Wanted
from .layout import bucket
from .least_squares import RESIDUAL_TOLERANCE, Compressed, Polished
from .linalg import BLIND, damped_step
from .problem import Problem, Ready, Unknowns, ready, reweighted
from .result import FitError, RecordingFit
from .smoothing import uniform

DEFAULT_STARTS = 6

_CALLS = 4  # of at most `least_squares.STEPS` steps, if they gain no more than ...
_GAINS = 1.0  # ... this: the square of a standard error, which grows with the residual
_MOST_CALLS = 16
_BEHIND = 25.0  # times the least cost: a start that is worse after a horizon does not go on
_SAME = 0.5  # starts that end within this many standard errors of another one have ended there
_CYCLES = 3  # of the fastest mode, in the first horizon and in a segment
_MOST = 0.7  # of a recording: what is predicted from it is less than half as much again
_MOST_OUTLIERS = 0.05  # a larger share of readings is not a few outliers, it is another motion
_ROUNDS = 3
_EXCESS = 2.0  # times the noise, where a law that sticks or rattles leaves more
_ABSURD = 1e9  # rad or m
_FAR = 5.0  # sigma: what is nearer to the model than this is no outlier beside it
_USUAL = 0.5  # of the residual's own size: what an outlier must exceed, too
_UNUSUAL = 2.0  # standard deviations of chi-square
_SEGMENTS = 4, 64  # room for segments comes in powers of this, up to this


class Descent(NamedTuple):
    """A `Polished` of a problem, with outliers set aside."""

    here: Ready
    problem: Problem
    outliers: list[np.ndarray]
    unknowns: Unknowns
    compressed: Compressed
    cost: float
    steps: int
    converged: bool
    agreeing: int = 1
    starts: int = 1

    @property
    def numbers(self) -> np.ndarray:
        """(P,) the model's numbers."""
        return np.asarray(self.problem.numbers(self.unknowns))

    @property
    def states(self) -> np.ndarray:
        """(R, s) initial states."""
        return np.asarray(self.problem.states(self.unknowns))

    @property
    def model(self) -> Model:
        """The model with these numbers."""
        return self.here.model.with_vector(self.numbers)

    @property
    def readings(self) -> int:
        """How many readings count."""
        return int(np.count_nonzero(self.problem.recorded.weights))

    @property
    def reduced_chi2(self) -> float:
        """Per degree of freedom."""
        unknown = self.numbers.size + self.states.size
        return self.cost / max(1, self.readings - unknown)

    @property
    def above_noise(self) -> bool:
        """Whether chi-square is more than noise often makes it."""
        readings = self.readings
        return self.cost > readings + _UNUSUAL * math.sqrt(2.0 * readings)

    def beside(self, recordings: Sequence[Recording]) -> list[RecordingFit]:
        """Each recording beside the model."""
        predicted = _predictions(self.compressed, recordings)
        parts = zip(recordings, predicted, self.outliers, self.states, strict=True)
        return [RecordingFit(*part) for part in parts]


def multistart(
    here: Ready,
    base: Callable[[], Ready] | None,
    starts: int,
    progress: Callable[[str], None],
    numbers: np.ndarray,
    memory: np.ndarray,
) -> Fitting[Descent]:
    """The best minimum from starts: numbers (S, P) and internal states (S, R, m).

    `base` gives the same recordings with springs and dampers alone, which lead on where effects do
    not; None where they are the model.

    **Raises:** `FitError` if nothing led anywhere.
    """
    begin = resolving(here, numbers)
    found: list[Descent] = []
    failed = None
    try:
        found.append((yield from descending(here, begin, numbers, here.outliers, progress, memory)))
    except FitError as error:
        failed = error
    if found and not _perhaps_local(found[0]):
        return found[0]
    progress("multiple shooting: segments with initial states of their own")
    with contextlib.suppress(FitError):
        shot = yield from _shooting(here, begin, numbers, memory, progress)
        found += [] if shot is None else [shot]
    if base is not None and starts > 1 and all(d.above_noise for d in found):
        progress("fitting springs and dampers alone, to begin again from there")
        found += yield from _from_the_base(here, base(), numbers, memory, progress)
    if not found:
        assert failed is not None
        raise failed
    best = min(found, key=lambda d: d.cost)
    ends = ((best.problem.scaled(d.numbers, d.states), d) for d in found)
    same = [d.agreeing for y, d in ends if _distance(best, best._replace(unknowns=y)) < _SAME]
    agreeing = min(sum(same), starts)  # what began from where they ended is no further start
    steps = sum(d.steps for d in found)
    return best._replace(starts=starts, agreeing=agreeing, steps=steps)


def _perhaps_local(descent: Descent) -> bool:
    """Whether this may be a local minimum: starts ended in different places, or an oscillation has
    a frequency of its own, of which each cycle of the recording makes a minimum, above the noise;
    or a law that sticks or rattles well above it."""
    model = descent.here.model
    nonsmooth = model.rough and descent.cost > _EXCESS * descent.readings
    many = descent.agreeing < descent.starts or any(e.oscillates for e in model.effects)
    return nonsmooth or (many and descent.above_noise)


# -- one problem, growing horizons ---------------------------------------------------------------


def descending(
    here: Ready,
    begin: Model,
    numbers: np.ndarray,
    outliers: list[np.ndarray],
    progress: Callable[[str], None] = lambda words: None,
    memory: np.ndarray | None = None,
    like: Problem | None = None,
    near: np.ndarray | None = None,
    growing: bool = False,
) -> Fitting[Descent]:
    """Descend from every row of `numbers` (S, P), and of `memory` (S, R, m); set outliers aside;
    descend again if there were.

    With `like`, the numbers stay as in `begin`, and that problem's compiled program serves. With
    `near` (S, R, s), initial states which are near enough that no phase can slip, all readings
    count from the first step on, unless the horizon is to be `growing`, too.

    **Raises:** `FitError` if no start led to a motion that could be.
    """
    frequency = here.frequency(begin)
    problem, states = here.problem(begin, outliers, like, frequency=frequency)
    if like is not None:
        problem = eqx.tree_at(lambda p: p.active, problem, np.zeros_like(problem.active))
    starts = len(numbers)
    first = np.broadcast_to(states, (starts, *states.shape)).copy() if near is None else near
    if memory is not None:
        first[..., first.shape[-1] - memory.shape[-1] :] = memory
    y = Unknowns(numbers / problem.scale.numbers, first / problem.scale.states)
    shares = horizons(here, frequency) if near is None or growing else [1.0]
    out = yield from polishing(problem, y, shares)
    if len(shares) > 1 and not _sane(out, here.recordings):
        out = yield from polishing(problem, y, [1.0])
    steps, agreeing = out.steps, out.agreeing
    mirrored = _upright(problem, out.unknowns)
    if mirrored is not None:
        out = yield from polishing(problem, _single(mirrored), [1.0])
    for round_ in range(_ROUNDS + 1):
        if not np.isfinite(out.cost):
            raise FitError("no start led to finite numbers: is this the arm that was recorded?")
        if not _sane(out, here.recordings):
            raise FitError("no start led to a motion that could be: is this the arm recorded?")
        predicted = _predictions(out.compressed, here.recordings)
        pairs = zip(here.recordings, predicted, strict=True)
        found = [_outliers_beside(r, r.angle - p) for r, p in pairs]
        found = [new | old for new, old in zip(found, outliers, strict=True)]
        settled = all((f == w).all() for f, w in zip(found, outliers, strict=True))
        if settled or round_ == _ROUNDS or any(f.mean() > _MOST_OUTLIERS for f in found):
            break
        progress("fitting again without outliers")
        outliers = found
        problem = reweighted(problem, outliers)
        out = yield from polishing(problem, _single(out.unknowns), [1.0])
        steps += out.steps
    return Descent(here, problem, outliers, *out._replace(steps=steps, agreeing=agreeing), starts)


def horizons(here: Ready, frequency: float) -> list[float]:
    """The growing shares (0 to 1) of the recordings that a start is fitted to, each the root of the
    one before; `frequency` is the fastest one, rad/s.

    Two of them and then everything, where phases are all that can slip. How often a joint swings
    before it sticks is a whole number, which is off by one where friction is known from a few
    swings only: there, roots are taken up to most of a recording.
    """
    shares = [min(1.0, _CYCLES * 2 * math.pi / frequency / here.duration)]
    while len(shares) < 2 or (here.model.rough and shares[-1] < _MOST):
        shares.append(math.sqrt(shares[-1]))
    return sorted({*shares[: SHARES - 1], 1.0})


def polishing(problem: Problem, starts: Unknowns, shares: Sequence[float]) -> Fitting[Polished]:
    """Descend from every start (leading axis S) over growing shares (0 to 1) of the recordings."""
    going, shares = _begun(starts), list(shares)
    if len(going) > 1:
        # Those that had not settled go on where they are before more of the recording counts.
        going = distinct((yield from _further(problem, going, shares[:1], most=1)))
        going = distinct((yield from _further(problem, going, shares[:1])))
        shares = shares[1:] or shares
    while shares:
        # One alone need not wait for others after each share.
        few = len(shares) if len(going) == 1 else 1
        again = [end._replace(converged=False) for end in going]
        going = distinct((yield from _further(problem, again, shares[:few])))
        shares = shares[few:]
    return going[0]


def _further(
    problem: Problem, ends: Sequence[Polished], shares: Sequence[float], most: int = _MOST_CALLS
) -> Fitting[list[Polished]]:
    """Where those that have not settled end over growing shares of the recordings, of which each
    has so many calls at the `most`, and no more than a few that hardly gain."""
    readings = max(1, np.count_nonzero(problem.recorded.weights))
    ends, left = list(ends), [() if end.converged else tuple(shares) for end in ends]
    units, made, idle = [1.0] * len(ends), [0] * len(ends), [0] * len(ends)
    while going := [i for i, own in enumerate(left) if own]:
        watch = watching()  # which looks at each share's end
        few = [1 if watch is not None or units[i] > 1.0 else len(left[i]) for i in going]
        pairs = zip(going, few, strict=True)
        outs = yield [
            Wanted.of(problem, ends[i].unknowns, left[i][:few], units[i]) for i, few in pairs
        ]
        for i, out in zip(going, outs, strict=True):
            y, squeezed, cost, steps, good, done = jax.device_get(out)
            total, agreeing = ends[i].steps + int(steps), ends[i].agreeing
            gain, here = (ends[i].cost - float(cost)) / units[i] ** 2, done == 1
            ends[i] = Polished(y, squeezed, float(cost), total, bool(good), agreeing)
            made[i] = made[i] + 1 if here else 1
            idle[i] = idle[i] + (not gain > _GAINS) if here else 1
            left[i] = left[i][int(done) - 1 :]
            if np.isfinite(ends[i].cost):
                units[i] = max(1.0, math.sqrt(ends[i].cost / readings))
            if watch is not None:
                watch.descended(problem, y, int(steps))
            over = idle[i] == _CALLS or made[i] == most
            if idle[i] == _CALLS and not good:
                ends[i] = ends[i]._replace(converged=_settled(ends[i], units[i]))
            if good or over or (watch is not None and watch.over()):
                left[i], units[i], made[i], idle[i] = left[i][1:], 1.0, 0, 0
    return ends


def _settled(end: Polished, unit: float) -> bool:
    """Whether the Gauss-Newton step from here would move the fit by next to nothing, in times the
    `unit`, sigma: so far is the minimum, to first order, in standard errors of any number (the
    relative offset of Bates and Watts, Technometrics 23, 1981). A number that the data hardly
    determine need not stand still for that, as a descent demands, on the scale of its start."""
    factor, along = np.asarray(end.compressed.factor), np.asarray(end.compressed.along)
    if not (np.isfinite(factor).all() and np.isfinite(along).all()):
        return False
    square, slope = factor.transpose(0, 2, 1) @ factor, np.einsum("rij,ri->rj", factor, along)
    step = damped_step(square, slope, len(end.unknowns.numbers), BLIND).local()
    return bool(np.linalg.norm(np.einsum("rij,rj->ri", factor, step)) < RESIDUAL_TOLERANCE * unit)


def _begun(starts: Unknowns) -> list[Polished]:
    """Starts that have not moved yet."""
    nothing: Compressed = None  # pyrefly: ignore[bad-assignment]
    each = map(Unknowns, *jax.device_get(starts))
    return [Polished(y, nothing, math.inf, 0, False) for y in each]


def distinct(ends: Sequence[Polished]) -> list[Polished]:
    """The different places where starts ended, the best one first, without those far behind."""
    found: list[Polished] = []
    for end in sorted(ends, key=lambda e: e.cost if math.isfinite(e.cost) else math.inf):
        for i, other in enumerate(found):
            if _distance(other, end) < _SAME:
                found[i] = other._replace(agreeing=other.agreeing + end.agreeing)
                break
        else:
            if not found or end.cost <= _BEHIND * found[0].cost:
                found.append(end)
    return found


def _distance(one: Polished | Descent, other: Polished | Descent) -> float:
    """Between two ends, in standard errors of the first."""
    gap = jax.tree.map(np.subtract, other.unknowns, one.unknowns)
    return float(np.linalg.norm(np.einsum("rij,rj->ri", one.compressed.factor, gap.local())))


def _sane(out: Polished, recordings: Sequence[Recording]) -> bool:
    """Whether a start ended in a motion that could be."""
    if not np.isfinite(out.cost):
        return False
    return all(np.all(np.abs(x) < _ABSURD) for x in _predictions(out.compressed, recordings))


def _upright(problem: Problem, at: Unknowns) -> Unknowns | None:
    """The same point with all numbers of the sign that people write; None if they have it."""
    if not problem.model.mirrors:
        return None
    states, n = np.array(problem.states(at)), len(problem.model.mechanism.joints)
    model = problem.model.with_vector(problem.numbers(at))
    found = model
    for state in states:
        found, memory = model.upright(split(state[2 * n :]))
        state[2 * n :] = [float(z) for z in memory]
    if np.array_equal(found.vector(), model.vector()):
        return None
    return problem.scaled(found.vector(), jnp.asarray(states))


def _outliers_beside(recording: Recording, residual: np.ndarray) -> np.ndarray:
    """Readings whose residual is far off its neighbours, and off what is usual."""
    # Where the model misses something, the residual has corners of its own.
    middle = np.ma.median(np.ma.masked_invalid(np.abs(residual)), axis=0).filled(0.0)
    noise = np.maximum(recording.noise, _USUAL * 1.4826 * middle)
    if not np.any(np.abs(residual) > _FAR * noise):
        return np.zeros(residual.shape, bool)
    return outlier_mask(recording.time, residual, noise)


def _single(y: Unknowns) -> Unknowns:
    """As starts, of which there is but one."""
    return jax.tree.map(lambda x: np.asarray(x)[None], y)


def _predictions(squeezed: Compressed, recordings: Sequence[Recording]) -> list[np.ndarray]:
    pairs = zip(recordings, np.asarray(squeezed.predicted), strict=True)
    return [x[: len(r.time)] for r, x in pairs]


# -- multiple shooting ---------------------------------------------------------------------------


def _shooting(
    here: Ready,
    begin: Model,
    numbers: np.ndarray,
    memory: np.ndarray,
    progress: Callable[[str], None],
) -> Fitting[Descent | None]:
    """Where starts lead by multiple shooting; None if the recordings are no longer than a segment.

    Internal states of a segment begin with what they come to along the measured motion.
    """
    # A start may have lost the fast mode, but the readings show it.
    frequency = max(here.frequency(begin), float(here.pace.max()))
    cycle = 2 * math.pi / frequency
    most = max(1, _SEGMENTS[1] // len(here.recordings))
    cut: list[Recording] = []
    bad: list[np.ndarray] = []
    which: list[int] = []
    for i, (r, own) in enumerate(zip(here.recordings, here.outliers, strict=True)):
        parts = segments_of(r, r.duration / min(most, max(1, round(r.duration / cycle / _CYCLES))))
        cut += parts
        bad += np.split(own, np.cumsum([len(p.time) for p in parts])[:-1])
        which += [i] * len(parts)
    if len(cut) == len(here.recordings):
        return None
    # Few sizes, few programs: what fills up has no weight.
    filling = bucket(len(cut), _SEGMENTS[0], _SEGMENTS[0]) - len(cut)
    cut += [cut[-1]] * filling
    bad += [np.ones_like(bad[-1])] * filling
    which += [which[-1]] * filling
    segments = here._replace(
        recordings=tuple(cut), mechanisms=tuple(here.mechanisms[i] for i in which)
    )
    problem, states = segments.problem(begin, bad, frequency=frequency)
    each = np.tile(states, (len(numbers), 1, 1))
    if here.model.memory:
        at = [(r, part.time[0]) for r, part in zip(which, cut, strict=True)]
        found = memory_along_readings(here, numbers, memory, at)
        each[..., -found.shape[-1] :] = found
    y = Unknowns(numbers / problem.scale.numbers, each / problem.scale.states)
    ends = distinct((yield from _further(problem, _begun(y), [1.0], most=1)))[:2]
    end = distinct((yield from _further(problem, ends, [1.0])))[0]
    if not np.isfinite(end.cost):
        return None
    numbers = np.asarray(problem.numbers(end.unknowns))
    first = np.searchsorted(which, range(len(here.recordings)))
    joined = np.asarray(problem.states(end.unknowns))[None, first]
    begun = here, here.model.with_vector(numbers), numbers[None], here.outliers, progress
    found = yield from _one_by_one(
        descending(*begun, near=joined, growing=growing) for growing in (False, True)
    )
    return min(found, key=lambda d: d.cost, default=None)


def _one_by_one(descents: Iterable[Fitting[Descent]]) -> Fitting[list[Descent]]:
    """Where they end, those left out that lead nowhere; the first that ends at the noise is the
    last."""
    found = []
    for each in descents:
        with contextlib.suppress(FitError):
            found.append((yield from each))
            if not found[-1].above_noise:
                break
    return found


# -- the nested model first ----------------------------------------------------------------------

_STRENGTHS = 0.01, 0.3, 1.0  # of an effect's typical one
_LINES = 2  # of the residual's spectrum
_TURNS = 0.0, 0.5 * math.pi  # of an oscillation's phase
_WEAK = 0.05  # of an oscillation's typical strength


def _from_the_base(
    here: Ready,
    base: Ready,
    guess: np.ndarray,
    memory: np.ndarray,
    progress: Callable[[str], None],
) -> Fitting[list[Descent]]:
    """Fits of a model from where springs and dampers alone end, which is found more surely: with
    effects hardly there, weak, as is typical, and as guessed in closed form.

    The frequency of an oscillation has as many minima as its recording has cycles. What springs and
    dampers leave is linear in it, so that its spectrum is the likelihood of all of them.
    """
    numbers, states = first_guess(base, len(guess))
    begin = resolving(base, numbers)
    try:
        end = yield from descending(base, begin, numbers, base.outliers, progress, states)
    except FitError:
        return []
    rows = [(_typically(here, share), None, None) for share in _STRENGTHS]
    rows += [(row, None, near) for row, near in _ringing(here, end)]
    rows += [(row, own[None], None) for row, own in zip(guess, memory, strict=True)]

    def from_here(row, memory, near) -> Fitting[Descent]:
        numbers = np.concatenate([end.numbers, row[len(end.numbers) :]])
        begin = here.model.with_vector(numbers)
        return descending(here, begin, numbers[None], here.outliers, progress, memory, near=near)

    # Each by itself: of several, those that are behind after the first cycles would be left.
    return (yield from _one_by_one(from_here(*each) for each in rows))


def _ringing(here: Ready, base: Descent) -> list[tuple[np.ndarray, np.ndarray]]:
    """Numbers (P,) and initial states (1, R, s) with which a weak oscillation begins, at a
    frequency of the residual of springs and dampers; nothing without an oscillation."""
    model, rows = here.model, []
    memory = [m.effect for m in model.memory]
    for i, effect in enumerate(model.effects):
        if effect.oscillates is None:
            continue
        fits = base.beside(here.recordings)
        left = [dataclasses.replace(f.recording, angle=f.residual) for f in fits]
        grids = [uniform(r, w) for r, w in zip(left, base.outliers, strict=True)]
        shortest = min(len(g.q) for g in grids)
        each = np.stack([g.q[:shortest] for g in grids])  # (R, G, n)
        spacing = np.array([g.dt for g in grids])
        for frequency, phases in lines(np.moveaxis(each, -1, 0), spacing)[:_LINES]:
            for turn in _TURNS:  # how late an angle answers a torque depends on the modes
                numbers = _typically(here, _WEAK)
                numbers[frequency_of(model, i)] = frequency
                states = np.zeros((len(grids), len(memory)))
                states[:, memory.index(i)] = phases + turn
                rows.append((numbers, np.concatenate([base.states, states], axis=1)[None]))
    return rows


def _typically(here: Ready, share: float) -> np.ndarray:
    """(P,) typical numbers, of strengths a share."""
    inactive = [n.meaning.silent for n in here.model.fitted]
    pairs = zip(inactive, here.typical(), strict=True)
    return np.array([x if s is None else s + share * (x - s) for s, x in pairs])


# -- segments that are never joined --------------------------------------------------------------

_RINGS = 1.0  # cycles of a mode in the recording: fewer, and it holds nothing in place
_SAMPLES = 40  # of a segment, at least
_FEWEST = 8  # segments: a recording that would not make so many is left as it is


def segment_length(model: Model, recording: Recording) -> float | None:
    """How long the segments are to be that a recording is cut into, s; None if it is to stay whole.
    `model` is about right: its modes decide.

    A joint with a spring comes back: the error of a simulated swing stays of the size of the swing.
    A driven joint without one integrates every newton that the model misses, twice, over the whole
    recording. Its rate is forgotten within a time constant (inertia over damping), so that is how
    long a segment is: what is missing then shows as a torque, at the instant at which it acts.
    """
    driven = recording.drive is not None and bool(np.any(recording.drive))
    if not driven or recording.segment_of is not None:
        return None
    matrix = at_rest(model)[1]
    values = eigenvalues(matrix)
    frequency, damping = (np.asarray(x) for x in modes_of(model, matrix))
    rings = (frequency * recording.duration > _RINGS) & (np.abs(damping) < 1 - 1e-9)
    if rings.all():
        return None
    fades = -np.real(values)[np.abs(np.imag(values)) < 1e-9 * np.abs(values)]
    if not fades.size or fades.max() <= 0:
        return None
    # Slower modes of other joints must be seen to ring in a segment, too.
    longest = max([1.0 / float(fades.max()), *(1.0 / frequency[rings])])
    least = _SAMPLES * float(np.median(np.diff(recording.time)))
    seconds = max(longest, least)
    return seconds if recording.duration > _FEWEST * seconds else None


def without_drift(experiment: Experiment, model: Model) -> Experiment:
    """The experiment with driven recordings of what nothing pulls back cut into segments; itself if
    there are none. A warning of each says so."""
    found: list[Recording] = []
    for recording in experiment.recordings:
        seconds = None if recording.role == "inertia" else segment_length(model, recording)
        if seconds is None:
            found.append(recording)
            continue
        doubt = (
            "driven, and nothing pulls it back: a simulation of the whole drifts away. It is "
            f"fitted in segments of {seconds:.2g} s, each with an initial state of its own"
        )
        found += segments_of(recording.saying([doubt]), seconds)
    if len(found) == len(experiment.recordings):
        return experiment
    return dataclasses.replace(experiment, recordings=tuple(found))


class Beginning(NamedTuple):
    """What every search begins with: the experiment, what nothing pulls back cut into segments, its
    recordings ready, and starts in closed form: numbers (S, P), internal states (S, R, m)."""

    experiment: Experiment
    here: Ready
    numbers: np.ndarray
    memory: np.ndarray


def beginning(
    experiment: Experiment, effects: Sequence[str | AbstractEffect], starts: int
) -> Beginning:
    """The beginning of a search, whatever it searches by. Call it in float64.

    **Raises:** `ValueError` as `ready`.
    """
    here = ready(experiment, experiment.fit_recordings, effects)
    numbers, memory = first_guess(here, starts)
    cut = without_drift(experiment, here.model.with_vector(numbers[0]))
    if cut is not experiment:
        here = ready(cut, cut.fit_recordings, effects)
        memory = here.memory(starts)
    return Beginning(cut, here, numbers, memory)
