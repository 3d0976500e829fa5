"""All that decides: priors, the marginal likelihood, and what follows from it.

A *model* is a set of effects and the intensity of a random torque that stands for whatever the
effects do not say. Its *evidence* is the marginal likelihood of the readings: everything unknown
(the numbers, the first states, the random torque) integrated over its prior. Evidence times prior,
normalised over the models that were tried, is the posterior; verdict, probabilities of names and
families, and look-alikes are sums of it (MacKay, Information Theory, Inference and Learning
Algorithms, 2003, ch. 28). Nothing else in this folder decides.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import erf, log_ndtr, softmax

from ..effects import AbstractEffect
from ..filtering.law import each_number, number_slices, numbers_of
from ..filtering.trajectory import Prior, Scene, Trajectory
from ..physics.effect import BASE
from ..physics.parameter import Parameter

# -- the numbers that decide ------------------------------------------------------------------

WIDTH = 0.3
"""Prior standard deviation of a strength, in the typical size of its dimension (of a torque: the
spring's at full swing). Effects worth naming act with 0.5 to 30 % of the spring's torque; a factor
of two in this width moves an evidence by at most 0.7 nats a number."""
SCALE_ERROR = 0.05
"""Prior standard deviation of a sensor's scale: gears, encoders and cameras are calibrated to per
cents."""
DELAY = 0.1
"""Prior standard deviation of a sensor's delay, in radians of the slowest joint's ringing: filters
and buses are late by samples, not by cycles."""
SHAPE = 1.0
"""Prior standard deviation of the logarithm of a shape (a gap, a rate, a frequency): an e-fold
about the middle of its grid."""
RESCALED = 2.0
"""By how much a joint's spring or damper in the base model may exceed what is taken for the typical
torque there, before that is taken for it: a factor of two in all widths is worth less than a nat a
number."""
STRENGTHS = (0.03, 0.3, 3.0)
"""Strengths, in standard deviations of the prior, about which a law that sticks is linearised: up
to where a half-normal prior ends, a decade apart. The iteration goes on from the likeliest, so that
the grid need only be near: it decides which models are iterated, not what they come to."""
INTENSITIES = (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 0.0)
"""Random torques (rms, in the spring's torque at full swing) over which the evidence is summed:
half a decade apart, which no posterior of it is narrower than with a hundred independent
instants."""
TORQUE_TIMES = (1.0, 0.1)
"""Correlation times of a random torque over which the evidence is summed, equally likely, in
radians of a joint's ringing: what is missing may ring with the joint, or turn within a swing as
friction does. What is slower is an offset or a drift, which are effects."""
NO_RANDOM_TORQUE = 0.5
"""Prior probability that the model needs none; the other half is shared by the rest of the grid."""
FURTHER = 0.5
"""Prior probability of one more effect, given that there are m: the number of effects is geometric,
one on average; which ones they are is uniform over kinds and places."""
NEGLIGIBLE = 1e-4
"""Random torque up to which a model is called complete: a ten-thousandth of the spring's torque
changes no stiffness by more than 0.01 % and no damping ratio by more than 5e-5, a hundredth of a
lightly damped joint's."""
COMPLETE = np.array(INTENSITIES) <= NEGLIGIBLE
"""(I,) which random torques these are."""
FAINT = np.array(INTENSITIES) <= INTENSITIES[3]
"""(I,) of coloured noise, in the readings' own rms, the intensities beside which a model is
complete: up to 3 %, above which it is as large as what effects do, and no noise to be left."""
OUTSIDE = 1 / 5
"""Prior probability that what a joint lacks is of no effect in the catalogue: Laplace's rule of
succession after three measured rigs (carts, EMPS, a double pendulum), whose authors' explanations
are all in it. All free curves share it."""
INDISTINGUISHABLE = math.log(20.0)
"""Nats up to which two models cannot be told apart: posterior odds of 20 to 1 are strong evidence
(Kass and Raftery, J. American Statistical Association 90, 1995)."""
NOISE = 1e-3
"""Probability, if it is noise, below which `compare` says that a residual is not white: one right
model in a thousand is doubted."""
CONTENDERS = 6
"""Candidates of each screen whose nonlinear evidence is worked out, as many pairs, and as many
frequencies of each joint that a disturbance may have: of 780 pairs at first order the true one was
among the first two on seven arms of eight, single effects of 1 % first on all."""
AMPLITUDES = INTENSITIES[:6]
"""Sizes of a free curve's torque, in the spring's at full swing, of which the prior is that of a
strength: half a decade apart, down to where an effect is hardly worth naming."""
DECADES = np.array(AMPLITUDES[1:]) / WIDTH
"""Prior widths, in those of a strength, of damping that is there in any case and of which nobody
knows how large it is: half a decade apart, from `WIDTH` down to where it changes nothing."""
CURVE_LENGTHS = (0.08, 0.2, 0.5, 1.5)
"""Correlation lengths of a free curve, in the visited range of its variable: from what its splines
can just follow to a bend over the whole range."""
EXPLAINS_NOTHING = INTENSITIES[0]
"""Random torque from which a model is none of the motion at all: what it lacks is then as large as
the spring's own torque."""
READINGS_LEAD = INTENSITIES[4]
"""Random torque, at least, along whose motion candidates are screened, the middle of the grid: the
motion is the readings', not that of a model that may be wrong."""
HOPELESS = 10 * INDISTINGUISHABLE
"""Nats behind the best from which a model is not iterated any further."""
IN_PLAY = 0.01
"""Probability from which a model counts: to first order, whether it is iterated where little is
left to explain; whether it is simulated exactly; and whether the next test is planned for it. What
all the rarer ones may add to an entropy is less than what the draws leave of it open. A plan is for
`CONTENDERS` models at the most: each is integrated through every test."""
SETTLED = 0.1
"""Nats to which an evidence is iterated: odds of 1.1, less than any prior is known to."""
FALL = 2
"""Steps of `INTENSITIES`, a decade, that the random torque may fall by in one iteration: the motion
is linearised about the one before."""
RELEASE_ERROR = 0.1
"""Standard deviation of the state at release of a test that is planned, as a share of the angles:
hands and stops are right to a tenth. It is far above the noise, so that only its order matters."""
WORTHWHILE = 0.1
"""Share of the entropy from which an expected fall is worth a test; less is within what the
first-order predictions of it are wrong by."""
# ---------------------------------------------------------------------------------------------


def prior_of(scene: Scene, effects: Sequence[AbstractEffect]) -> Prior:
    """The prior of a model's numbers.

    A spring is known within its own typical size, a strength to be within `WIDTH` of nothing, a
    shape within an e-fold of the middle of its grid, or of its value if it has none.
    """
    rows = []
    for effect, number in each_number(effects):
        size = scene.size(effect, number)
        if effect.name == "spring":
            rows.append((size, size, False))
        elif number.silent is None:
            known = [g * size for g in number.grid] or [float(getattr(effect, number.field))]
            rows.append((math.exp(np.mean(np.log(known))), SHAPE, True))
        else:
            rows.append((number.silent, width_of(scene, effect, number), False))
    mean, width, log = zip(*rows, strict=True)
    return Prior(np.array(mean, float), np.array(width, float), np.array(log, bool))


def width_of(scene: Scene, effect: AbstractEffect, number: Parameter) -> float:
    """Prior standard deviation of a strength, in its own unit. A damper, which is there in any
    case, is known as a spring is, and so is what acts in the place of a spring: gravity may be all
    that pulls back, and a loose joint has none inside its gap."""
    if effect.name in BASE or number.as_spring:
        return scene.size(effect, number)
    if effect.senses and number.dimension.rotary in ("1", "1/rad"):  # of the scale at full swing
        return SCALE_ERROR * scene.size(effect, number)
    if effect.senses and number.dimension.rotary == "s":
        return DELAY / min(s.frequency for s in scene.scales)
    return WIDTH * scene.size(effect, number)


def torque_scales(scene: Scene, t: Trajectory) -> np.ndarray:
    """(n,) how many times as large as what accelerates each joint a torque is there: as what its
    spring or its damper does in a base model. In a motion that hardly rings these hold each other,
    and what accelerates is a small difference of them. 1 where it is at most `RESCALED`."""
    size, found = np.array([s.inertia * s.frequency**2 for s in scene.scales]), np.zeros(scene.n)
    for (effect, _), x in zip(each_number(t.effects), t.numbers, strict=True):
        if effect.name in BASE:
            j = scene.joint_of(effect)
            rate = scene.scales[j].frequency if effect.name == "damper" else 1.0
            found[j] = max(found[j], rate * float(x))
    return np.where(found > RESCALED * size, found / size, 1.0)


def signed(number: Parameter) -> bool:
    """Whether a number has a half-normal prior: physics gives its sign. No spring, damper or
    friction has less than nothing."""
    return number.sign == "positive" and number.silent is not None


def _signed(effects: Sequence[AbstractEffect], prior: Prior, u: np.ndarray, std: np.ndarray):
    """Each number whose sign is known: which it is, by how much (...,) it is on the right side of
    where it is silent, and its standard deviation, both in prior widths, and how many of these make
    the typical size of its dimension."""
    for i, (effect, number) in enumerate(each_number(effects)):
        if signed(number):
            silent = (number.silent - prior.mean[i]) / prior.width[i]
            wide = effect.name in BASE or number.as_spring
            yield i, u[..., i] - silent, std[..., i], 1.0 if wide else 1.0 / WIDTH


def non_normal_priors(
    effects: Sequence[AbstractEffect], prior: Prior, u: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """(...,) what the priors of a model add to its log evidence under unit normal ones, of which
    `u` (..., P) and `covariance` (..., P, P) are the posterior: of the strengths of an effect that
    is `of_one_size`, that size (`common_size`); of each other number whose sign is known the log
    of the probability, after the readings over before them, that it is on the right side of where
    it is silent."""
    std = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    nothing = np.zeros(u.shape[-1]), np.ones(u.shape[-1])
    total, sized = np.zeros(u.shape[:-1]), set()
    for effect, first in zip(effects, number_slices(effects), strict=True):
        each = enumerate(numbers_of(effect), first.start)
        own = {i: Strength(n, prior.width[i]) for i, n in each if n.silent is not None}
        if effect.of_one_size and len(own) > 1:
            inner = covariance[..., np.array([*own])[:, None], [*own]]
            total = total + common_size(u[..., [*own]], inner, [*own.values()])
            sized.update(own)
    pairs = zip(_signed(effects, prior, u, std), _signed(effects, prior, *nothing), strict=True)
    for (i, off, s, _), (_, first, one, _) in pairs:
        if i not in sized:
            total = total + log_ndtr(off / s) - log_ndtr(first / one)
    return total


class Strength(NamedTuple):
    """A strength of an effect, and its prior standard deviation were it the only one."""

    number: Parameter
    width: float  # in its own unit

    @property
    def size(self) -> float:
        """Typical size, in its own unit."""
        return self.width if self.number.as_spring else self.width / WIDTH


def common_sizes(strengths: Sequence[Strength]) -> tuple[np.ndarray, np.ndarray]:
    """(S, k) how many times as wide the priors of k strengths are with each of their common sizes,
    and (S,) the prior of that.

    The size is one of `AMPLITUDES`, in typical ones, of which that in one unit at one joint is the
    smallest; where a strength may do all that a spring does, with even odds one of the half decades
    from there to that.
    """
    sizes: dict[Any, float] = {}
    units = [(s.number.joint, s.number.dimension.rotary) for s in strengths]
    for unit, strength in zip(units, strengths, strict=True):
        sizes[unit] = min(strength.size, sizes.get(unit, math.inf))
    base = np.array([sizes[unit] for unit in units])
    amplitudes, weights = np.array(AMPLITUDES), prior_sizes(AMPLITUDES)
    springs = [s.size / b for s, b in zip(strengths, base, strict=True) if s.number.as_spring]
    if springs:
        more = 10.0 ** (0.5 * np.arange(1 + math.ceil(2 * math.log10(max(springs)))))
        amplitudes = np.append(amplitudes, more)
        weights = 0.5 * np.append(weights, np.full(len(more), 1 / len(more)))
    return amplitudes[:, None] * base / [s.width for s in strengths], weights


def common_size(
    mean: np.ndarray, covariance: np.ndarray, strengths: Sequence[Strength]
) -> np.ndarray:
    """(...,) by how much the log evidence of the k strengths of an effect changes if these have a
    common size, each sign as it is known, and not unit normal priors.

    A hierarchical prior (Gelman et al., Bayesian Data Analysis, 2013, ch. 5): a table that is
    hardly tilted pulls weakly at every joint, along and across. If a size makes the prior of the
    i-th R_ii times as wide (`common_sizes`), the posterior N(m, V) goes over to N(m', V') with
    V'^-1 = V^-1 - 1 + R^-2 and V'^-1 m' = V^-1 m, and the evidence changes by
    sqrt(|V'| / |V|) / |R| exp(m' V'^-1 m' / 2 - m V^-1 m / 2).
    """
    ratio, weights = common_sizes(strengths)
    with np.errstate(invalid="ignore"):  # of a motion that runs away
        precision = np.linalg.inv(covariance)
        h = (precision @ mean[..., None])[..., 0]
        wider = np.eye(len(strengths)) * (ratio**-2.0 - 1.0)[..., None]
        new = np.linalg.inv(precision[..., None, :, :] + wider)
        means = (new @ h[..., None, :, None])[..., 0]
        raised = np.sum(means * h[..., None, :], -1) - np.sum(mean * h, -1)[..., None]
        volume = np.linalg.slogdet(new)[1] - np.linalg.slogdet(covariance)[1][..., None]
        ratios = half_normal(means / np.sqrt(np.diagonal(new, axis1=-2, axis2=-1)))
        signs = np.where([signed(s.number) for s in strengths], ratios, 0.0).sum(-1)
        logs = 0.5 * (volume + raised) - np.log(ratio).sum(-1) + signs
        return np.logaddexp.reduce(logs + np.log(weights), axis=-1)


def right_signs(
    effects: Sequence[AbstractEffect], prior: Prior, u: np.ndarray, std: np.ndarray, left: Any = 0.0
) -> np.ndarray:
    """How much less probable the readings are if all numbers of a model have the signs that physics
    gives them than if each had either: the product of 2 Phi (`half_normal`), of each 1 at most. A
    sign that the readings leave open, as of a damping of zero, says nothing. `u`, `std` as in
    `half_normals`.

    `left` (I,) is the torque that is left beside the model, in typical torques. It may be along
    any number: what came out on the wrong side may be there by as much.
    """
    total = np.zeros(u.shape[:-1])
    for _, off, s, size in _signed(effects, prior, u, std):
        ratio = off / np.where(off < 0, np.hypot(s, left * size), s)
        total = total + np.minimum(half_normal(ratio), 0.0)
    return np.exp(total)


def half_normal(ratio):
    """By how much a half-normal prior raises a log evidence over a normal one, where the posterior
    mean is `ratio` standard deviations on the right side: log 2 Phi."""
    return math.log(2.0) + log_ndtr(ratio)


def savage_dickey(mean: np.ndarray, covariance: np.ndarray, signs: Sequence[bool]) -> float:
    """By how much k strengths raise the log evidence of a model that has them: the log of their
    prior density over their posterior density where they are silent (Dickey, Annals of Mathematical
    Statistics 42, 1971). `mean` (k,) and `covariance` (k, k) of the posterior, in prior widths from
    there; `signs`: which of them have a half-normal prior."""
    ratio = half_normal(mean / np.sqrt(np.diag(covariance)))
    normal = np.linalg.slogdet(covariance)[1] + mean @ np.linalg.solve(covariance, mean)
    return float(0.5 * normal + ratio[np.asarray(signs)].sum())


def information(covariance: np.ndarray) -> float:
    """What readings say of k strengths, nats: by how much the posterior, of `covariance` (k, k) in
    prior widths, is narrower than the prior (Lindley, Annals of Mathematical Statistics 27, 1956).
    Where that is little, their evidence says less still, on average, of whether there are any."""
    with np.errstate(invalid="ignore"):  # of a motion that runs away
        return -0.5 * float(np.linalg.slogdet(covariance)[1])


def laplace_about(
    log_evidence: np.ndarray, mean: np.ndarray, covariance: np.ndarray, at: np.ndarray
) -> np.ndarray:
    """(...,) Laplace's approximation about numbers `at` (P,) that are not the likeliest: the
    density there times the volume sqrt |2 pi V|. A `log_evidence` (...,) is that about the
    posterior's `mean` (..., P), where a law that bends is another one than at `at`, and more by
    d' V^-1 d / 2."""
    off = mean - at
    with np.errstate(all="ignore"):  # of a motion that runs away
        square = np.einsum("...i,...ij,...j->...", off, np.linalg.inv(covariance), off)
        return log_evidence - 0.5 * square


def over_widths(
    mean: np.ndarray, covariance: np.ndarray, i: int, widths: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """By how much the log evidence rises, and what mean (P,) and covariance (P, P) become, if the
    half-normal prior of the i-th number has any of `widths`, equally likely, and not 1.

    Its posterior N(m, v) goes over to N(m', v') with 1/v' = 1/v - 1 + 1/w^2 and m'/v' = m/v, and
    the evidence changes by sqrt(v'/v) / w exp(m'^2 / 2 v' - m^2 / 2 v). The other numbers follow
    by their regression on it. Mean and variance are those of the mixture over w.
    """
    m, v = mean[i], covariance[i, i]
    new = 1.0 / (max(1.0 / v - 1.0, 0.0) + widths**-2.0)
    means = m / v * new
    logs = 0.5 * (np.log(new / v) + means**2 / new - m**2 / v) - np.log(widths * len(widths))
    logs += half_normal(means / np.sqrt(new)) - half_normal(m / math.sqrt(v))
    p, slope = softmax(logs), covariance[:, i] / v
    middle = p @ means
    wider = p @ (new + means**2) - middle**2 - v
    return log_sum(logs), mean + slope * (middle - m), covariance + wider * np.outer(slope, slope)


def log_prior_intensity(intensities: Sequence[float] | np.ndarray) -> np.ndarray:
    """(I,) log prior of each intensity, of which 0 is one."""
    others = (1 - NO_RANDOM_TORQUE) / (len(INTENSITIES) - 1)
    return np.log(np.where(np.equal(intensities, 0), NO_RANDOM_TORQUE, others))


def correlation_times(shortest: float, longest: float) -> np.ndarray:
    """(T,) correlation times that coloured noise may have, equally likely, s: a factor of two
    apart, which a posterior of it tells from a hundred readings, from the readings' own distance to
    a radian of the slowest ringing. What changes more slowly is drift or motion."""
    return shortest * 2.0 ** np.arange(1 + max(0, math.floor(math.log2(longest / shortest))))


def prior_sizes(sizes: Sequence[float]) -> np.ndarray:
    """(S,) prior probability that an effect's size, half-normal of `WIDTH`, is in each cell of a
    grid, the largest first."""
    each = np.array(sizes)
    edges = np.concatenate([[np.inf], np.sqrt(each[:-1] * each[1:]), [0.0]])
    return -np.diff(erf(edges / WIDTH / math.sqrt(2)))


def at_least(weights: np.ndarray, size: float) -> np.ndarray:
    """(I,) the posterior of a random torque's intensity, of which it is known that it is no less
    than a size."""
    k = int(np.argmin(np.abs(np.log(np.maximum(INTENSITIES, 1e-9) / max(size, 1e-9)))))
    return np.append(weights[:k], [weights[k:].sum(), *np.zeros(len(weights) - k - 1)])


def at_work(before: np.ndarray, signs: Any = 1.0, noise: bool = False) -> np.ndarray:
    """(..., I) probability that an effect of a model is at work, for each random torque that the
    model still needs; `before` (..., I) is the posterior of the one that it needs without it.

    The alternative is a torque of no effect in the catalogue, of which the effect only takes up a
    part: then any share of what was missing before is as likely to be left. Beside an effect that
    is at work it is another torque, of any size (`log_prior_intensity`) up to what was missing. So
    a name is sure where it leaves next to nothing of that, and doubtful where it leaves much of it,
    whatever the number of readings. What stands in for another torque may have either sign: `signs`
    (I,) is what those of springs, dampers and all effects say against them (`right_signs`).

    With `noise`, intensities are those of coloured noise, which is left in any case: it hides all
    that is fainter, so that of either alternative counts that as much or less is left.
    """
    shares = _SHARES_OR_LESS if noise else _SHARES
    return before @ (signs * shares / (signs * shares + 1.0 - shares))


def _at_work_of(or_less: bool) -> np.ndarray:
    """(I, I) the same for each random torque before, if all signs are as they should be."""
    sizes, prior = np.array(INTENSITIES), np.exp(log_prior_intensity(INTENSITIES))
    loud = int(np.count_nonzero(~COMPLETE))  # one cell for each, and one for as good as none
    prior = np.append(prior[:loud], prior[loud:].sum())
    edges = np.concatenate([[np.inf], np.sqrt(sizes[:loud] * sizes[1 : loud + 1]), [0.0]])
    share = np.full((loud + 1, loud + 1), 1.0 - OUTSIDE)
    for k, size in enumerate(sizes[:loud]):
        outside = OUTSIDE * -np.diff(np.minimum(edges, size))[k:] / size
        work = (1.0 - OUTSIDE) * prior[k:] / prior[k:].sum()
        if or_less:
            outside, work = (np.cumsum(x[::-1])[::-1] for x in (outside, work))
        share[k, k:] = work / (work + outside)
        share[k, :k] = share[k, k]
    # More that was missing makes no name less sure, nor more that is left a surer one.
    share = np.minimum.accumulate(share)
    share = np.minimum.accumulate(share[:, ::-1], axis=1)[:, ::-1]
    cell = np.minimum(np.arange(len(sizes)), loud)
    return share[np.ix_(cell, cell)]


_SHARES, _SHARES_OR_LESS = _at_work_of(False), _at_work_of(True)


def log_sum(logs) -> float:
    """Log of the sum of what some logarithms are of."""
    return float(np.logaddexp.reduce(logs))


def over_intensities(evidences: np.ndarray) -> float:
    """Log evidence of a model from those (I,) under each random torque."""
    return log_sum(np.nan_to_num(evidences, nan=-np.inf) + log_prior_intensity(INTENSITIES))


def log_prior_model(added: int, candidates: int) -> float:
    """Log prior of one set of `added` effects out of `candidates`."""
    sets = math.comb(candidates, added)
    return math.log(1 - FURTHER) + added * math.log(FURTHER) - math.log(sets)


def occams_window(models: Iterable[Any]) -> list[Any]:
    """The models that cannot be told from the likeliest (`INDISTINGUISHABLE`), the likeliest first,
    but none of which a part is likelier (Madigan and Raftery, J. American Statistical Association
    89, 1994). Each has labels `added` and a `log_posterior`."""
    found: list[Any] = []
    for model in sorted(models, key=lambda m: -m.log_posterior):
        near = not found or model.log_posterior > found[0].log_posterior - INDISTINGUISHABLE
        if near and not any(set(part.added) < set(model.added) for part in found):
            found.append(model)
    return found


_ROUNDING = 1e-13
"""Numerical tolerance: what rounding may take from the diagonal of a Gram matrix of unit
diagonal."""


def gram_factor(square: np.ndarray) -> np.ndarray:
    """Cholesky factor (..., C, C) of Gram matrices plus 1. Columns that rounding cannot tell apart
    keep it real: the smallest of two nearly equal ones is lost beside it otherwise."""
    size = np.sqrt(np.diagonal(square, axis1=-2, axis2=-1))
    unit = square / size[..., :, None] / size[..., None, :]
    unit = unit + _ROUNDING * np.eye(unit.shape[-1])
    return np.linalg.cholesky(unit) * size[..., :, None]


def conditional(gram: np.ndarray, base: int) -> tuple[np.ndarray, np.ndarray]:
    """Gram matrices (..., 1 + base + C, 1 + base + C) of whitened innovations, with the first
    `base` regressors integrated out: (...,) their log evidence, and the Gram matrices (..., 1 + C,
    1 + C) of what is left.

    With unit normal priors the evidence of any further subset is then `subset` of those.
    """
    keep, own = np.r_[0, 1 + base : gram.shape[-1]], gram[..., 1 : 1 + base, :]
    factor = gram_factor(own[..., 1 : 1 + base] + np.eye(base))
    with np.errstate(over="ignore", invalid="ignore"):  # of a motion that runs away
        across = np.linalg.solve(factor, own[..., keep])
        rest = gram[..., keep[:, None], keep] - across.mT @ across
    logs = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
    return -0.5 * rest[..., 0, 0] - logs, rest


def means_of_base(gram: np.ndarray, base: int) -> np.ndarray:
    """(..., base, 1 + C) what the first `base` regressors of Gram matrices (..., 1 + base + C, 1 +
    base + C) are without further columns, and how they change with each: their posterior mean
    beside columns at s is this times (1, s)."""
    keep, own = np.r_[0, 1 + base : gram.shape[-1]], gram[..., 1 : 1 + base, :]
    return -np.linalg.solve(own[..., 1 : 1 + base] + np.eye(base), own[..., keep])


def subset(gram: np.ndarray, columns) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """By how much some columns raise the log evidence, their posterior mean and covariance.

    `gram` (..., 1 + C, 1 + C) of readings and columns; `columns` (..., k) from 0: several sets of
    as many columns at once.
    """
    i = np.asarray(columns, int) + 1
    inner = gram[..., i[..., :, None], i[..., None, :]] + np.eye(i.shape[-1])
    factor = gram_factor(inner)
    x = np.linalg.solve(factor, -gram[..., i, 0][..., None])
    logs = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
    mean = np.linalg.solve(factor.mT, x)[..., 0]
    return 0.5 * np.sum(x[..., 0] ** 2, -1) - logs, mean, np.linalg.inv(inner)


def priors_of_columns(
    mean: np.ndarray,
    covariance: np.ndarray,
    strengths: Sequence[Sequence[Sequence[Strength | None]]],
) -> np.ndarray:
    """(..., S) what the priors of S sets of k columns add to their log evidence under unit normal
    ones, of which `mean` (..., S, k) and `covariance` (..., S, k, k) are the posterior. `strengths`
    are those that the columns of each set are of, those together that are of one size; None has a
    unit normal prior.
    """
    std = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
    sided = [
        [len(group) == 1 and s is not None and signed(s.number) for group in own for s in group]
        for own in strengths
    ]
    total = np.where(sided, half_normal(mean / std), 0.0).sum(-1)
    for i, own in enumerate(strengths):
        first = 0
        for group in own:
            at = slice(first, first := first + len(group))
            known = [s for s in group if s is not None]
            if len(known) > 1:
                inner = covariance[..., i, at, at]
                total[..., i] += common_size(mean[..., i, at], inner, known)
    return total


def gains_of(
    grams: np.ndarray, logs: np.ndarray, sets: Sequence[Sequence[int]],
    strengths: Sequence[Sequence[Sequence[Strength | None]]] | None = None,
) -> list[tuple[float, np.ndarray]]:  # fmt: skip
    """Log evidence of each of some sets of columns, random torques summed over, and their posterior
    mean under the likeliest.

    `grams` (I, 1 + C, 1 + C) and `logs` (I,) log evidences under each random torque; `strengths` as
    in `priors_of_columns`, without which all priors are unit normal. Sets of as many columns at
    once.
    """
    found: dict[int, tuple[float, np.ndarray]] = {}
    for size in {len(s) for s in sets}:
        own = [i for i, s in enumerate(sets) if len(s) == size]
        gain, mean, covariance = subset(grams, [sets[i] for i in own])
        if strengths is not None:
            gain = gain + priors_of_columns(mean, covariance, [strengths[i] for i in own])
        each = gain + logs[:, None]
        each = np.where(np.isfinite(each), each, -np.inf)  # of a motion that runs away
        top = np.argmax(each, axis=0)
        found |= {i: (log_sum(each[:, k]), mean[top[k], k]) for k, i in enumerate(own)}
    return [found[i] for i in range(len(sets))]
