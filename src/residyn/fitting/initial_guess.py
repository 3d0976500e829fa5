"""A start without simulation: Eq. 1 in weak form.

Position, rate and acceleration that all passed the *same* filter (`smoothing`) obey the same
linear equation of motion. Stiffness and damping follow from linear least squares on
`q'' - acceleration(q, q'; numbers) = 0`, for each of a few values of whatever shapes an effect
without being proportional to it.

Which width is best depends on modes and noise that are not known yet: narrow ones let noise in,
which biases the stiffness, and wide ones leave nothing of a fast mode. So every width of a
geometric ladder gives one candidate, the least uncertain ones go on, and the simulations of the
multi-start judge between them.

An arm that comes to rest away from zero (a brake has slipped, a table is tilted) would make its
springs look soft, or negative: beside those candidates, others come from equations with a constant
torque at every joint, which is then forgotten.
"""

import itertools
import math
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import InputError
from ..physics.effect import BASE
from ..physics.modal import paces
from ..physics.model import Model, changed
from ..physics.motion import Motion, split, stack
from ..physics.parameter import stacked
from ..runtime.export_cache import kept
from .layout import AnyArray, bucket
from .problem import Ready
from .smoothing import smooth, uniform

_NARROWEST = 4  # samples in half a kernel
_STRIDE, _LONG = 2, 1000  # where there are so many samples, every other one will do
_ENOUGH = 64  # recordings, evenly picked: a start needs no more, and the fit weighs all of them
_LADDER = 12  # kernels tried, each 1.5 times wider than the last
_LEAST_KEPT = 0.05
_INSTANTS = 8, 2048  # room for instants comes in powers of this, from this up
_CHUNK = 256  # instants whose equations are summed at a time
_FAR = 10.0  # times its typical size: no number is looked for much further away
_ROUNDING = 1e-14
_ELSEWHERE = 0.1  # of a joint's swing: where it rings about, if not about zero
_PERTURBED = 0.3  # standard deviation of the logarithm of a number's factor
_MOST = 48  # trials; beyond, shapes vary one at a time
_LINES = 3  # frequencies tried for each periodic disturbance
_SUBSTEPS = 2
_LOOKED = 24  # candidates, the best ones, that are looked at
_ALIKE = 0.2  # share by which shapes of one kind differ at most
_PACE = 0.7  # and the logarithms of its modes' frequencies
_ABSURD = 1e12  # rad/s
_SLOWER = 0.75  # share of the starts that are no faster than the one that sets the step


def first_guess(here: Ready, starts: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the starts begin, the best one first: numbers (S, P), internal states (S, R, m).

    **Raises:** `InputError` for an effect whose torque is not finite along the readings.
    """
    found = closed_form(here, here.typical())
    some = various(here, found.numbers)[:starts] if starts > 1 else [0][: len(found.numbers)]
    if not some:
        _check_finite(here)
        found, some = Trials(here.typical()[None], here.memory(1)), [0]
    candidates = _turned(here.model, found.numbers[some])
    more = starts - len(candidates)
    numbers = np.vstack([candidates, perturbed(candidates[0], more)])
    return numbers, found.memory[[*some, *some[:1] * more]]


def _check_finite(here: Ready) -> None:
    """**Raises:** `InputError` as `first_guess`."""

    def torque(model: Model, q, v):
        motion = Motion.at(0.0, q, v)
        return stack(model.torque(motion._replace(memory=model.memory_begin(motion))))

    for model, recording in zip(here.posed(), here.recordings, strict=True):
        grid = uniform(recording, recording.outliers)
        rates = np.gradient(grid.q, grid.dt, axis=0)
        for effect in model.with_vector(here.typical()).effects:
            alone = changed(model, effects=(effect,))
            if not np.isfinite(jax.vmap(partial(torque, alone))(grid.q, rates)).all():
                where = f"along the readings of {recording.name}"
                raise InputError(f"{effect.label}: its torque is not finite {where}")


def various(here: Ready, candidates: np.ndarray) -> list[int]:
    """Indices of candidates (C, P), best first, those last that hardly differ from a better one: of
    kernels that have all lost the fast mode, one is tried before any that has not."""
    if not len(candidates):
        return []
    shapes = [n.meaning.silent is None for n in here.model.fitted]
    seen = np.log(_paces(here, candidates[:_LOOKED]))
    kinds, alike = [], []
    for i, pace in enumerate(seen):
        own = candidates[i][shapes]
        near = any(
            np.all(np.abs(pace - seen[k]) <= _PACE)
            and np.all(np.abs(own - candidates[k][shapes]) <= _ALIKE * np.abs(own))
            for k in kinds
        )
        (alike if near else kinds).append(i)
    return [*kinds, *alike, *range(len(seen), len(candidates))]


def _paces(here: Ready, numbers: np.ndarray) -> np.ndarray:
    """(S, s) how fast a model's modes are with numbers (S, P), slowest first, rad/s, none slower
    than a cycle in the longest recording."""
    least = 2 * math.pi / here.duration
    return np.clip(paces(here.model, numbers), least, _ABSURD)


def resolving(here: Ready, numbers: np.ndarray) -> Model:
    """The start of numbers (S, P) by whose fastest mode all of them are integrated: no slower than
    that of three in four.

    A start from a wide kernel may have lost the fast mode. It costs nothing but itself, unless the
    others are integrated with its step, and begin from where it would.
    """
    if len(numbers) > 1:
        fast = _paces(here, numbers[:_LOOKED])[:, -1]
        order = np.argsort(np.where(fast < _ABSURD, fast, 0.0), kind="stable")
        numbers = numbers[order[math.ceil(_SLOWER * (len(order) - 1)) :]]
    return here.model.with_vector(numbers[0])


def _turned(model: Model, numbers: np.ndarray) -> np.ndarray:
    """Starts (S, P) of which no effect's number has a sign that physics does not allow: an inertia
    below zero, however small, runs away. Springs and dampers stay: gravity may hold a joint."""
    positive = [
        n.meaning.sign == "positive" and model.effects[n.effect].name not in BASE
        for n in model.fitted
    ]
    return np.where(positive, np.abs(numbers), numbers)


class Trials(NamedTuple):
    """(B, P) numbers, and (B, R, m) internal states at each recording's first sample."""

    numbers: np.ndarray
    memory: np.ndarray


def closed_form(here: Ready, sizes: np.ndarray) -> Trials:
    """Candidate numbers for a model from its recordings.

    `sizes` (P,) are the numbers' typical ones, in which their grids are given.

    **Returns:** the candidates, the least uncertain first, hopeless ones left out; empty if the
    model has no numbers.
    """
    model, recordings = here.model, here.recordings
    if len(recordings) > _ENOUGH and not model.memory:
        some = np.linspace(0, len(recordings) - 1, _ENOUGH).round().astype(int)
        few = here._replace(
            recordings=tuple(recordings[i] for i in some),
            mechanisms=tuple(here.mechanisms[i] for i in some),
        )
        found = closed_form(few, sizes)
        return found._replace(memory=here.memory(len(found.numbers)))
    grids = [uniform(r, r.outliers) for r in recordings]
    shortest = min(len(g.q) for g in grids)
    # What passed a kernel varies from sample to sample as slowly as the kernel does; a memory is
    # run along the motion, and wants all of it.
    stride = _STRIDE if shortest >= _LONG and not model.memory else 1
    longest = max(len(g.q[::stride]) for g in grids)
    longest = bucket(longest) if model.memory else bucket(longest, *_INSTANTS)
    halves = np.array([round(_NARROWEST * 1.5**i) for i in range(_LADDER)])
    # Which kernels are narrow enough for each recording, (R, K): others are of no weight in it.
    own = np.stack([halves <= max(_NARROWEST, len(g.q) // 8) for g in grids])
    fits = np.asarray(own.any(axis=0))
    used = np.where(own, halves, _NARROWEST)  # always as many: one compiled program
    # By friction of its own: what rubs at a point holds all joints or none.
    joints = model.mechanism.joints
    dry = [joints.index(e.place) for e in model.effects if e.dry and e.place in joints]
    each = [
        smooth(g, widths, r.as_angles.noise, stride, dry)
        for g, r, widths in zip(grids, recordings, used, strict=True)
    ]
    each = [s._replace(weight=s.weight * of[:, None]) for s, of in zip(each, own, strict=True)]
    data = tuple(_side_by_side(parts, longest) for parts in zip(*each, strict=True))
    posed = stacked(here.posed())
    spacing = np.array([g.dt * stride for g in grids])

    chunks = np.asarray(-(-max(q.shape[1] for q, *_ in each) // min(_CHUNK, longest)))

    def solved(trials: Trials):
        equations = jax.device_get(_equations(posed, trials, spacing, data, chunks))
        return _solved(equations, np.asarray(trials.numbers), sizes, used.max(axis=0) // stride)

    trials = plain(model, sizes, len(grids))
    if any(effect.oscillates for effect in model.effects):
        first = jax.tree.map(lambda x: x[0], trials)
        found = solved(trials)[0][:, 0, 0]
        missing = jax.device_get(_missing(posed, first, found, spacing, data))
        trials = tuned(model, trials, missing, spacing, fits)
    numbers, spread = solved(trials)
    # Without and with a constant torque, (K, 2, B): taken as further trials, unless there are
    # several already, which tell more.
    elsewhere = len(trials.numbers) == 1 and any(_rests_elsewhere(g.q) for g in grids)
    kinds = slice(None, None, -1) if elsewhere else slice(1)
    numbers, spread = numbers[:, kinds], spread[:, kinds]
    memory = np.tile(trials.memory, (numbers.shape[1], 1, 1))
    numbers = numbers.reshape(_LADDER, -1, numbers.shape[-1])
    spread = spread.reshape(_LADDER, -1)
    # A kernel wider than the slowest swing leaves only rest and drift, which any tiny stiffness
    # fits beautifully.
    kept = np.stack([s.kept(h // stride) for s, h in zip(each, used, strict=True)])
    kept = np.max(np.where(own, kept, 0.0), axis=0)
    fits &= kept > min(_LEAST_KEPT, 0.5 * kept.max())
    # Overlapping kernels share their noise: a kernel of half-width h leaves about 1/h as many
    # independent equations.
    spread = spread + np.where(fits, 0.5 * np.log(halves), np.inf)[:, None]
    spread = np.where(np.isfinite(numbers).all(axis=-1), spread, np.inf)
    memory = np.broadcast_to(memory, (_LADDER, *memory.shape))
    # Every trial's best kernel comes before any trial's second: what tells shapes apart is the
    # simulation.
    rank = np.argsort(np.argsort(spread, axis=0, kind="stable"), axis=0, kind="stable")
    order = np.lexsort((spread.ravel(), rank.ravel()))
    order = order[np.isfinite(spread.ravel()[order])]
    return Trials(*(x.reshape(spread.size, *x.shape[2:])[order] for x in (numbers, memory)))


def _side_by_side(parts: Sequence[np.ndarray], longest: int) -> np.ndarray:
    """(H, G, ...) of each recording as (H, R, longest, ...), filled up with zeros."""
    filled = np.zeros((parts[0].shape[0], len(parts), longest, *parts[0].shape[2:]))
    for i, part in enumerate(parts):
        filled[:, i, : part.shape[1]] = part
    return filled


def _rests_elsewhere(q: np.ndarray) -> bool:
    """Whether a joint, its angles (G, n), rings about an angle that is not near zero."""
    middle = np.median(q[len(q) // 2 :], axis=0)
    return bool(np.any(np.abs(middle) > _ELSEWHERE * np.abs(q).max(axis=0)))


def _errors(of, models, vector, data, z, t):
    """`of`, the acceleration error or its derivative, at every instant of every recording."""
    row = jax.vmap(partial(of, vector), in_axes=(None,) + (0,) * 7)
    return eqx.filter_vmap(row)(models, t, *data, z)


def _error(vector, model, t, q, v, a, drive, weight, z):
    """Acceleration, and a torque at each joint that no effect gives, less what was measured."""
    joints = len(model.mechanism.joints)
    model = model.with_vector(vector[:-joints])
    drive = split(drive + vector[-joints:])
    wanted = stack(model.acceleration(Motion.at(t, q, v, z), drive))
    return jnp.sqrt(weight) * (a - wanted)


def _memories(models, vector, z0, spacing, data):
    """Each recording's internal states (R, G, m) along its motion, with these numbers (P,)."""
    return eqx.filter_vmap(lambda m, *x: memory_along(m.with_vector(vector), *x))(
        models, spacing, data[0], data[1], z0
    )


class _Equations(NamedTuple):
    """Linear equations for changes of U unknowns, the model's numbers (P,) and a constant torque at
    every joint: J'J, J'e and e'e, for every kernel and trial."""

    square: AnyArray  # (K, B, U, U)
    slope: AnyArray  # (K, B, U)
    total: AnyArray  # (K, B)
    readings: AnyArray  # (K,) how many there are, by their weight


@kept(like=_Equations(0, 0, 0, 0))  # pyrefly: ignore[bad-argument-type]
def _equations(models, trials: Trials, spacing, data, chunks) -> _Equations:
    """The acceleration error and its slopes, summed over the first `chunks` chunks of instants."""
    joints = len(models.mechanism.joints)
    shape = [n.meaning.silent is None for n in models.fitted]
    shape = jnp.asarray([*shape, *[False] * joints])
    t = spacing[:, None] * jnp.arange(data[0].shape[2])
    chunk = min(_CHUNK, t.shape[1])

    def one(vector, z0, data):  # one trial and kernel; `data` over recordings
        z = _memories(models, vector, z0, spacing, data)
        vector = jnp.concatenate([vector, jnp.zeros(joints)])

        def add(index, sums):
            """How many chunks there are need not be compiled in."""
            part = jax.tree.map(
                lambda x: jax.lax.dynamic_slice_in_dim(x, index * chunk, chunk, 1), (data, z, t)
            )
            of = jax.jacfwd(lambda *x: (_error(*x),) * 2, has_aux=True)
            j, e = _errors(of, models, vector, *part)
            j = jnp.where(shape, 0.0, j)
            more = jnp.einsum("rgnp,rgnk->pk", j, j), jnp.einsum("rgnp,rgn->p", j, e), jnp.sum(e**2)
            return jax.tree.map(jnp.add, sums, more)

        empty = jnp.zeros((len(shape),) * 2), jnp.zeros(len(shape)), jnp.zeros(())
        return jax.lax.fori_loop(0, chunks, add, empty)

    each = jax.vmap(one, in_axes=(0, 0, None))
    square, slope, total = jax.vmap(each, in_axes=(None, None, 0))(*trials, data)
    return _Equations(square, slope, total, jnp.sum(data[-1], axis=(1, 2)) * joints)


def _solved(
    equations: _Equations, vectors: np.ndarray, sizes: np.ndarray, halves: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (K, 2, B, P), without and with the constant torques, and their spread (K, 2, B), from
    trials (B, P); `sizes` (P,) are typical, `halves` (K,) the kernels' half-widths in instants.
    """
    squares, slopes, total, readings = (np.asarray(x) for x in equations)
    own, found, spreads = vectors.shape[1], [], []
    for count in (own, slopes.shape[-1]):
        square, slope = squares[..., :count, :count], slopes[..., :count]
        diagonal = np.einsum("kbii->kbi", square)
        seen = diagonal > 0
        size = np.sqrt(np.where(seen, diagonal, 1.0))
        scaled = square / size[..., None] / size[..., None, :]
        # Blind directions stay put; of others the typical relative standard deviation is wanted, in
        # its logarithm, and for ranking only.
        scaled = scaled + np.where(seen, 1e-12, 1.0)[..., None] * np.eye(count)
        change = _change(scaled, slope / size)
        gained = np.einsum("kbi,kbi->kb", slope / size, change)
        left = np.maximum(total + gained, _ROUNDING * total)
        left = np.maximum(left, 1e-300) / np.maximum(readings, 1e-300)[:, None]
        volume = np.linalg.slogdet(scaled)[1] + 2.0 * np.sum(np.log(size), axis=-1)
        spread = 0.5 * (np.log(left) - volume / np.maximum(1, seen.sum(axis=-1)))
        # What these readings hardly determine stays near where it began: far away, no simulation
        # would come back. Equations share their noise with as many others as a kernel is wide.
        known = np.append(_FAR * sizes, np.full(count - own, np.inf))
        ridge = (halves[:, None] * left)[..., None] / (known * size) ** 2
        change = _change(scaled + ridge[..., None] * np.eye(count), slope / size) / size
        found.append(vectors + change[..., :own])
        spreads.append(np.where(readings[:, None] > 0, spread, np.inf))
    return np.stack(found, axis=1), np.stack(spreads, axis=1)


def _change(square: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Least squares' step; none where something is not finite."""
    good = np.asarray(np.isfinite(square).all(axis=(-2, -1)) & np.isfinite(slope).all(axis=-1))
    square = np.where(good[..., None, None], square, np.eye(square.shape[-1]))
    step = -np.linalg.solve(square, slope[..., None])[..., 0]
    return np.where(good[..., None], step, np.nan)


@kept(like=0)
def _missing(models, trial: Trials, numbers, spacing, data):
    """The torque (K, R, G, n) that is missing beside numbers (K, P) found from one trial."""
    joints = len(models.mechanism.joints)
    t = spacing[:, None] * jnp.arange(data[0].shape[2])

    def torque(model, q, e):
        return jnp.stack([stack(row) for row in model.bodies.mass_matrix(split(q))]) @ e

    def one(found, data):
        z = _memories(models, trial.numbers, trial.memory, spacing, data)
        vector = jnp.concatenate([found, jnp.zeros(joints)])
        left = _errors(_error, models, vector, data, z, t)
        # Of each recording's own model, which may hold what is no array: not for `jax.vmap`.
        return eqx.filter_vmap(jax.vmap(torque, in_axes=(None, 0, 0)))(models, data[0], -left)

    return jax.vmap(one)(numbers, data)


def perturbed(best: np.ndarray, count: int) -> np.ndarray:
    """`count` points around one: each number times a log-normal factor, always the same ones, so
    that the same recording gives the same fit."""
    factors = np.random.default_rng(0).standard_normal((count, len(best)))
    return best * np.exp(_PERTURBED * factors)


def plain(model: Model, sizes: np.ndarray, recordings: int) -> Trials:
    """Every combination of the shapes' grid values, or, if these are many, one shape at a time."""
    values = np.asarray(model.vector())
    choices = [
        tuple(g * size for g in n.meaning.grid) or (value,)
        for n, value, size in zip(model.fitted, values, sizes, strict=True)
    ]
    if np.prod([len(c) for c in choices]) <= _MOST:
        found = list(itertools.product(*choices))
    else:
        middle = [c[len(c) // 2] for c in choices]
        found = [middle]
        for i, c in enumerate(choices):
            found += [(*middle[:i], x, *middle[i + 1 :]) for x in c if x != middle[i]]
    numbers = np.asarray(found, float).reshape(-1, len(values))
    return Trials(numbers, np.zeros((len(numbers), recordings, len(model.memory))))


def tuned(
    model: Model, trials: Trials, missing: np.ndarray, spacing: np.ndarray, fits: np.ndarray
) -> Trials:
    """The trials with frequencies and phases of periodic disturbances read off the torque
    (K, R, G, n) that is missing without them, for those kernels K that fit."""
    memory = [m.effect for m in model.memory]
    for i, effect in enumerate(model.effects):
        if not effect.oscillates:
            continue
        joint = model.mechanism.joints.index(effect.place)
        found = lines(missing[fits][..., joint], spacing)
        number = frequency_of(model, i)
        first = trials.numbers[:1] if len(trials.numbers) * len(found) > _MOST else trials.numbers
        same = np.unique(np.delete(first, number, axis=1), axis=0)
        numbers, states = [], []
        for frequency, phases in found:
            for row in same:
                numbers.append(np.insert(row, number, frequency))
                states.append(trials.memory[0].copy())
                states[-1][:, memory.index(i)] = phases
        trials = Trials(np.asarray(numbers), np.asarray(states))
    return trials


def frequency_of(model: Model, index: int) -> int:
    """Which of a model's fitted numbers is the frequency of its effect `index`."""
    field = model.effects[index].oscillates
    pairs = enumerate(model.fitted)
    return next(k for k, n in pairs if n.effect == index and n.meaning.field == field)


def lines(torque: np.ndarray, spacing: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Strongest frequencies (Hz) of that of (K, R, G) torques which shows one best, and each
    recording's phase there."""
    _, recordings, length = torque.shape
    dt = float(spacing.max())
    frequencies = np.arange(0.5, 0.2 * length, 0.25) / (length * dt)
    frequencies = frequencies[frequencies < 0.25 / dt]
    # One window for all: without it a strong slow line would drown the others in its skirts.
    window = np.hanning(length)
    waves = []
    for r in range(recordings):
        turns = np.exp(-2j * np.pi * np.outer(np.arange(length) * spacing[r], frequencies))
        waves.append(window * torque[:, r] @ turns)
    waves = np.stack(waves, axis=1)  # (K, R, F)
    power = np.sum(np.abs(waves) ** 2, axis=1)
    contrast = power.max(axis=1) / np.maximum(np.median(power, axis=1), 1e-300)
    best = np.argmax(np.nan_to_num(contrast))
    power, waves, found = power[best], waves[best], []
    for _ in range(_LINES):
        top = int(np.argmax(power))
        # A sin(x + phase) has the transform (A/2i) exp(i phase).
        found.append((frequencies[top], np.angle(1j * waves[:, top])))
        power = np.where(np.abs(frequencies - frequencies[top]) < 2 / (length * dt), 0.0, power)
    return found


def memory_along(
    model: Model, dt, q: Float[Array, "G n"], v: Float[Array, "G n"], z0: Float[Array, " m"]
) -> Float[Array, "G m"]:
    """Internal states of a model that is led along a motion sampled every `dt` s."""
    if not model.memory:
        return jnp.zeros((q.shape[0], 0))
    first = Motion.at(0.0, q[0], v[0])
    begin = stack(model.memory_begin(first)) + z0

    def step(z, ends):
        t, q0, q1, v0, v1 = ends
        for k in range(_SUBSTEPS):
            part = (k + 0.5) / _SUBSTEPS
            middle = q0 + part * (q1 - q0), v0 + part * (v1 - v0)
            h = dt / _SUBSTEPS
            half = z + 0.5 * h * stack(model.memory_rate(Motion.at(t, *middle, z)))
            z = z + h * stack(model.memory_rate(Motion.at(t, *middle, half)))
        z = stack(model.memory_follow(Motion.at(t + dt, q1, v1, z)))
        return z, z

    t = dt * jnp.arange(q.shape[0] - 1)
    path = jax.lax.scan(step, begin, (t, q[:-1], q[1:], v[:-1], v[1:]))[1]
    return jnp.concatenate([begin[None], path])


def memory_along_readings(
    here: Ready,
    numbers: np.ndarray,
    memory: np.ndarray,
    at: Sequence[tuple[int, float]],
) -> np.ndarray:
    """(S, T, m) what internal states come to along the measured motion with numbers (S, P), from
    `memory` (S, R, m), beyond what their effects would begin with there; `at` are T recordings and
    times, s."""
    from scipy.signal import savgol_filter

    paths, grids = [], []
    for r, (model, recording) in enumerate(zip(here.posed(), here.recordings, strict=True)):
        grid = uniform(recording, recording.outliers)
        size = bucket(len(grid.q), *_INSTANTS)
        q, v = (
            np.asarray(savgol_filter(grid.q, 9, 3, deriv=k, delta=grid.dt, axis=0, mode="interp"))
            for k in (0, 1)
        )
        q, v = (np.pad(x, ((0, size - len(x)), (0, 0)), "edge") for x in (q, v))
        paths.append(np.asarray(_beyond(model, numbers, grid.dt, q, v, memory[:, r])))
        grids.append((recording.time[0], grid.dt, len(grid.q)))
    found = []
    for r, time in at:
        start, dt, length = grids[r]
        found.append(paths[r][:, min(round((time - start) / dt), length - 1)])
    return np.stack(found, axis=1)


@kept(like=0)
def _beyond(model: Model, numbers, dt, q, v, z0):
    def one(vector, z0):
        own = model.with_vector(vector)
        begin = jax.vmap(lambda q, v: stack(own.memory_begin(Motion.at(0.0, q, v))))(q, v)
        return memory_along(own, dt, q, v, z0) - begin

    return jax.vmap(one)(numbers, z0)
