"""What decides, held against closed forms: priors that normalise, marginal likelihoods of linear
and of nearly linear models, and the posterior as sums over models."""

import dataclasses
import itertools
import math
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.linalg import cho_factor, cho_solve, expm
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

import residyn
from residyn.diagnosis import free_curves
from residyn.diagnosis.columns import (
    Column,
    Columns,
    Screen,
    candidates,
    extended,
    of_one_kind,
    strengths,
)
from residyn.diagnosis.diagnose import Posterior
from residyn.diagnosis.evidence import (
    AMPLITUDES,
    FURTHER,
    INTENSITIES,
    NEGLIGIBLE,
    OUTSIDE,
    SETTLED,
    TORQUE_TIMES,
    WIDTH,
    Strength,
    at_least,
    at_work,
    common_size,
    conditional,
    gains_of,
    half_normal,
    information,
    laplace_about,
    log_prior_intensity,
    log_prior_model,
    non_normal_priors,
    occams_window,
    over_intensities,
    over_widths,
    prior_of,
    prior_sizes,
    right_signs,
    savage_dickey,
    subset,
)
from residyn.diagnosis.free_curves import CurveModel, Kind, Place
from residyn.diagnosis.iteration import over_torque_times, settle
from residyn.diagnosis.linearised_fit import Minimum
from residyn.diagnosis.simulated import Simulated
from residyn.diagnosis.tried import Tried, tried_alone
from residyn.effects import (
    AirDrag,
    AsymmetricStiffness,
    ConstantTorque,
    CoulombFriction,
    CouplingStiffness,
    CubicStiffness,
    Damper,
    DeadZone,
    Gravity,
    Hysteresis,
    SensorOffset,
    Spring,
    StribeckFriction,
)
from residyn.filtering.trajectory import Prior, Scene, Trajectory
from residyn.fitting.problem import Unknowns
from residyn.physics.effect import JointEffect
from residyn.physics.parameter import (
    FREQUENCY,
    RATIO,
    STIFFNESS,
    STIFFNESS_RATE,
    TORQUE,
    Dimension,
    Memory,
    Scales,
    param,
    parameters_of,
)

MASS, NOISE = 2.0, 1e-3
CART = residyn.ConstantInertia([[MASS]], joints=("cart",), units=("m",))
RATE = Dimension("N m/s", "N/s", lambda s: s.inertia * s.frequency**3 * s.amplitude)


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


class Ramp(JointEffect):
    """A torque that grows with time: a t."""

    name = "ramp"
    slope: float = param("slope", RATE)

    def joint_torque(self, motion):
        return self.slope * motion.t


def gaussian(y, mean, covariance):
    """Log density of a joint Gaussian."""
    factor = cho_factor(2 * math.pi * covariance, lower=True)
    square = 2 * math.pi * (y - mean) @ cho_solve(factor, y - mean)
    return -0.5 * square - np.log(np.diag(factor[0])).sum()


def scene_of_cart(time, reading):
    recording = residyn.Recording.from_arrays(time, reading[:, None], noise=NOISE)
    return Scene([recording], [CART], [np.zeros((len(time), 1), bool)])


# -- priors ---------------------------------------------------------------------------------------


def test_the_prior_of_the_random_torque_sums_to_one():
    assert np.exp(log_prior_intensity(INTENSITIES)).sum() == pytest.approx(1.0)
    assert over_intensities(np.full(len(INTENSITIES), -7.0)) == pytest.approx(-7.0)


def test_a_random_torque_under_which_nothing_was_found_adds_nothing():
    known = np.full(len(INTENSITIES), -3.0)
    lost = np.where(np.arange(len(known)) == 2, np.nan, known)
    share = np.exp(log_prior_intensity(INTENSITIES))[2]
    expected = -3.0 + math.log1p(-share)
    assert over_intensities(lost) == pytest.approx(expected)


@pytest.mark.parametrize("candidates", [1, 7, 40])
def test_the_prior_of_all_sets_of_effects_sums_to_one(candidates):
    """... but for what a geometric number of effects leaves beyond all candidates."""
    total = sum(
        math.comb(candidates, m) * math.exp(log_prior_model(m, candidates))
        for m in range(candidates + 1)
    )
    assert total == pytest.approx(1.0 - FURTHER ** (candidates + 1))


@given(st.floats(-6, 6), st.floats(0.02, 3))
@settings(max_examples=30)
def test_a_half_normal_prior_raises_the_evidence_as_its_integral_does(reading, noise):
    """One number u, read as `reading` with `noise`."""

    def joint(u):
        return norm.pdf(u) * norm.pdf(reading, u, noise)

    variance = 1 / (1 + 1 / noise**2)
    mean, std = variance * reading / noise**2, math.sqrt(variance)
    ends = mean - 12 * std, mean + 12 * std
    whole = quad(joint, *ends, epsabs=0)[0]
    if mean / std > -5:
        half = 2 * quad(joint, max(0.0, ends[0]), max(1e-9, ends[1]), epsabs=0)[0]
        assert half_normal(mean / std) == pytest.approx(math.log(half / whole), abs=1e-6)
    assert half_normal(mean / std) <= math.log(2.0)


@given(st.integers(0, 2**32 - 1), st.floats(0.003, 2.0))
@settings(max_examples=30)
def test_a_prior_of_another_width_gives_the_posterior_of_a_fit_with_that_prior(seed, width):
    rng = np.random.default_rng(seed)
    W, y = 3.0 * rng.standard_normal((8, 3)), 3.0 * rng.standard_normal(8)

    def fitted(widths):
        covariance = np.linalg.inv(W.T @ W + np.diag(1.0 / np.array(widths) ** 2))
        mean = covariance @ W.T @ y
        prior = np.eye(8) + W @ np.diag(np.square(widths)) @ W.T
        sided = half_normal(mean[1] / math.sqrt(covariance[1, 1]))
        return gaussian(y, np.zeros(8), prior) + sided, mean, covariance

    before, mean, covariance = fitted([1.0, 1.0, 1.0])
    after, expected, spread = fitted([1.0, width, 1.0])
    found = over_widths(mean, covariance, 1, np.array([width]))
    assert found[0] == pytest.approx(after - before, abs=1e-6)
    np.testing.assert_allclose(found[1], expected, atol=1e-6)
    np.testing.assert_allclose(found[2], spread, atol=1e-6)


def test_about_a_point_that_is_no_maximum_the_density_is_that_of_the_point():
    rng = np.random.default_rng(0)
    mean, root, at, log = rng.normal(size=3), rng.normal(size=(3, 3)), rng.normal(size=3), 7.0
    covariance = root @ root.T
    known = log + multivariate_normal.logpdf(at, mean, covariance)
    known += 0.5 * np.linalg.slogdet(2 * np.pi * covariance)[1]
    assert laplace_about(log, mean, covariance, at) == pytest.approx(known, rel=1e-9)
    assert laplace_about(log, mean, covariance, mean) == log


def test_a_joint_has_one_law_of_each_kind():
    friction = [CoulombFriction("elbow"), residyn.effects.DahlFriction("elbow")]
    assert of_one_kind(*friction)
    assert not of_one_kind(friction[0], residyn.effects.DahlFriction("shoulder"))
    assert not of_one_kind(friction[0], CubicStiffness("elbow"))


def test_a_prior_of_any_width_is_the_mixture_over_widths():
    mean, covariance, widths = np.array([0.3]), np.array([[0.04]]), np.array([1.0, 0.1])
    each = [over_widths(mean, covariance, 0, widths[[k]]) for k in (0, 1)]
    p = np.exp([e[0] for e in each]) / 2
    means, variances = (np.array([e[k].item() for e in each]) for k in (1, 2))
    gain, m, v = over_widths(mean, covariance, 0, widths)
    assert gain == pytest.approx(math.log(p.sum()))
    assert m.item() == pytest.approx(p @ means / p.sum())
    assert v.item() == pytest.approx(p @ (variances + means**2) / p.sum() - m.item() ** 2)


# -- marginal likelihoods -------------------------------------------------------------------------


@given(st.integers(0, 2**32 - 1), st.integers(0, 3), st.integers(1, 4))
def test_one_gram_matrix_holds_the_dense_gaussian_of_every_subset(seed, base, more):
    """Whitened innovations e = w + W u with e and u standard normal: w ~ N(0, 1 + W W')."""
    rng = np.random.default_rng(seed)
    w, W = rng.standard_normal(9), rng.standard_normal((9, base + more))
    white = np.column_stack([w, W])
    chosen = sorted(rng.choice(more, rng.integers(1, more + 1), replace=False))

    def dense(columns):
        covariance = np.eye(9) + W[:, columns] @ W[:, columns].T
        return gaussian(w, np.zeros(9), covariance) + 4.5 * math.log(2 * math.pi)

    known, rest = conditional(white.T @ white, base)
    gain, mean, covariance = subset(rest, chosen)
    among = [*range(base), *(base + i for i in chosen)]
    assert known == pytest.approx(dense(range(base)), abs=1e-9)
    assert known + gain == pytest.approx(dense(among), abs=1e-9)
    spread = np.linalg.inv(np.eye(len(among)) + W[:, among].T @ W[:, among])
    np.testing.assert_allclose(mean, (spread @ W[:, among].T @ -w)[base:], atol=1e-9)
    np.testing.assert_allclose(covariance, spread[base:, base:], atol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_what_one_tilt_scales_has_one_size_in_its_unit(seed):
    """A mixture of dense Gaussians. Gravity's moments may be as large as the springs, and are as
    its lateral pulls, in N m."""
    rng = np.random.default_rng(seed)
    w, W = rng.standard_normal(9), rng.standard_normal((9, 5)) * 10 ** rng.uniform(-1, 2)  # per N m
    widths = np.array([1.0, 8.0, 20.0, 0.3, 0.6])  # typical: 8, 20, 1 and 2 N m

    def dense(widths):
        return gaussian(w, np.zeros(9), np.eye(9) + W @ np.diag(np.square(widths)) @ W.T)

    each = [dense([1.0, s, 2 * s, s, 2 * s]) for s in (10, math.sqrt(10), 1, *AMPLITUDES)]
    weights = 0.5 * np.append(np.full(3, 1 / 3), prior_sizes(AMPLITUDES))
    expected = logsumexp(each, b=weights) - dense(widths)
    white = np.column_stack([w, widths * W])
    gram = white.T @ white
    whole, u, covariance = subset(gram, range(5))

    # Beside a number of another effect: of a model, and as columns of a screen.
    prior = Prior(np.zeros(5), widths, np.zeros(5, bool))
    effects = [AsymmetricStiffness("cart", 0.0), Gravity()]
    assert non_normal_priors(effects, prior, u, covariance) == pytest.approx(expected, abs=1e-6)
    pulls = [Strength(*own) for own in zip(strengths(Gravity()), widths[1:], strict=True)]
    ((gain, _),) = gains_of(gram[None], np.zeros(1), [range(5)], [[[None], pulls]])
    assert gain == pytest.approx(whole + expected, abs=1e-6)


def test_what_has_one_size_has_the_signs_that_physics_gives_it():
    """Of two levels of friction, each read once: products of integrals over the right side."""
    reading, noise = np.array([0.05, 0.02]), np.array([0.01, 0.02])
    covariance = np.diag(1 / (1 + 1 / noise**2))
    levels = [Strength(n, 1.0) for n in strengths(StribeckFriction("cart", 0.0, 0.0, 1.0))]
    found = common_size(covariance @ (reading / noise**2), covariance, levels)

    def right(size):
        return [quad(lambda u, r=r, s=s: 2 * norm.pdf(r, u, s) * norm.pdf(u, 0, size), 0, 1,
                     points=[0.05])[0]
                for r, s in zip(reading, noise, strict=True)]  # fmt: skip

    each = [np.prod(right(a / WIDTH)) for a in AMPLITUDES]
    whole = [norm.pdf(r, 0, math.hypot(1, s)) for r, s in zip(reading, noise, strict=True)]
    expected = math.log(np.dot(prior_sizes(AMPLITUDES), each) / np.prod(whole))
    assert found == pytest.approx(expected, abs=1e-6)


def test_the_density_of_none_tells_what_a_model_without_some_columns_has():
    rng = np.random.default_rng(3)
    columns = rng.standard_normal((30, 6)) @ np.diag([3.0, 1.0, 2.0, 0.5, 1.0, 1.0])
    gram = columns.T @ columns
    whole, mean, covariance = subset(gram, range(5))
    for gone in ([0], [1, 3], [0, 2, 4]):
        less, *_ = subset(gram, [i for i in range(5) if i not in gone])
        own = covariance[np.ix_(gone, gone)]
        found = savage_dickey(mean[gone], own, [False] * len(gone))
        assert found == pytest.approx(whole - less, abs=1e-9)


def test_the_density_of_none_under_a_half_normal_prior_is_the_integral_of_the_right_side():
    # One reading of a strength that is positive: its evidence is a ratio of two integrals.
    reading, noise = 0.4, 0.3
    both = lambda u: norm.pdf(reading, u, noise) * norm.pdf(u)  # noqa: E731
    whole = 2 * quad(both, 0, 10)[0] / norm.pdf(reading, 0, noise)
    precision = 1 + 1 / noise**2
    mean, covariance = np.array([reading / noise**2 / precision]), np.array([[1 / precision]])
    assert savage_dickey(mean, covariance, [True]) == pytest.approx(math.log(whole), abs=1e-6)


def test_evidence_and_gain_of_a_column_are_those_of_a_line_fit_by_hand():
    """A free mass under a constant force and one that grows with time moves along a cubic in
    time: its readings are a joint Gaussian that can be written down."""
    time = np.arange(120) / 40
    force, slope = 0.3, -0.08
    rng = np.random.default_rng(0)
    path = 0.1 + 0.05 * time - force * time**2 / (2 * MASS) - slope * time**3 / (6 * MASS)
    reading = path + NOISE * rng.standard_normal(len(time))
    scene = scene_of_cart(time, reading)
    constant, ramp = ConstantTorque("cart"), Ramp("cart")
    t = scene.start([constant], prior_of(scene, [constant]))
    first = scene.noise(t)
    width = WIDTH * np.array([scene.size(e, parameters_of(e)[0]) for e in (constant, ramp)])
    columns = np.stack([time**0, time, -(time**2) / (2 * MASS), -(time**3) / (6 * MASS)], axis=1)
    variances = np.array([first.variance[0], first.variance[1], *width**2])

    def dense(count):
        H = columns[:, :count]
        covariance = H * variances[:count] @ H.T + NOISE**2 * np.eye(len(time))
        return gaussian(reading, np.full(len(time), first.mean[0]), covariance)

    found = scene.evidences(t, scene.linearised(t), [0.0])
    assert float(found.log_evidence[0]) == pytest.approx(dense(3), abs=1e-6)
    (screened,) = Screen(Columns(scene, t, [ramp], [[1.0]]), [0.0]).ranked
    assert screened.gain == pytest.approx(dense(4) - dense(3), abs=1e-6)
    assert screened.regressors[0] * width[1] == pytest.approx(slope, rel=0.05)


@pytest.fixture(scope="module")
def ringing():
    """A cart on a spring, simulated by its closed form."""
    stiffness, damping = 50.0, 0.8
    time = np.arange(120) / 20
    rng = np.random.default_rng(1)
    path = free(stiffness, damping, time) @ [0.05, 0.0]
    return time, path + NOISE * rng.standard_normal(len(time))


def free(stiffness, damping, time):
    """(N, 2) how angles go with the first angle and the first rate: m q'' + c q' + k q = 0."""
    rate = damping / (2 * MASS)
    pace = np.sqrt(stiffness / MASS - rate**2)
    sine, cosine = np.sin(pace * time) / pace, np.cos(pace * time)
    return np.exp(-rate * time)[:, None] * np.stack([cosine + rate * sine, sine], axis=1)


def test_evidence_of_spring_and_damper_is_the_integral_over_their_numbers(ringing):
    """Laplace's approximation about the smoothed motion, against a grid over both numbers with
    the first state integrated in closed form."""
    time, reading = ringing
    scene = scene_of_cart(time, reading)
    effects = [Spring("cart"), Damper("cart")]
    model = tried_alone(scene, effects)
    t = model.best
    for _ in range(4):
        t = scene.smoothed(t, scene.linearised(t), 0.0)
    found = float(scene.evidences(t, scene.linearised(t), [0.0]).log_evidence[0])
    std = np.sqrt(np.diag(t.covariance)[:2]) * t.prior.slopes(t.u)
    offsets = np.linspace(-5, 5, 21)  # the rule of trapezia is exact for a Gaussian
    first = scene.noise(t)

    def log_joint(stiffness, damping):
        H = free(stiffness, damping, time)
        covariance = H * first.variance[:2] @ H.T + NOISE**2 * np.eye(len(time))
        prior = norm.logpdf([stiffness, damping], t.prior.mean, t.prior.width).sum()
        return gaussian(reading, H @ first.mean[:2], covariance) + prior

    grid = [
        [log_joint(t.numbers[0] + a * std[0], t.numbers[1] + b * std[1]) for b in offsets]
        for a in offsets
    ]
    cell = np.log(std * (offsets[1] - offsets[0])).sum()
    assert found == pytest.approx(logsumexp(grid) + cell, abs=0.01)
    assert model.complete > 0.8


@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("turns", [0.1, 1.0])
def test_the_correlation_time_of_what_is_missing_is_found(turns):
    """Of an oscillator under a random torque, in exact steps (Van Loan, IEEE Transactions on
    Automatic Control 23, 1978)."""
    pace, step, count = 7.0, 0.01, 2000  # rad/s, s
    A = np.array([[0.0, 1.0, 0.0], [-(pace**2), -0.02 * pace, 1.0], [0.0, 0.0, -pace / turns]])
    rms = 0.02 * pace**2 * 0.2  # of the spring's torque over the inertia, at 0.2 rad
    Q = np.diag([0.0, 0.0, 2.0 * rms**2 * pace / turns])
    both = expm(step * np.block([[-A, Q], [np.zeros((3, 3)), A.T]]))
    F, pushed = both[3:, 3:].T, np.linalg.cholesky(both[3:, 3:].T @ both[:3, 3:])
    rng, x, path = np.random.default_rng(3), np.array([0.2, 0.0, 0.0]), []
    for _ in range(count):
        path.append(x[0])
        x = F @ x + pushed @ rng.standard_normal(3)
    angle = np.array(path)[:, None] + 1e-5 * rng.standard_normal((count, 1))
    recording = residyn.Recording.from_arrays(step * np.arange(count), angle, noise=1e-5)
    table = residyn.ConstantInertia([[1.0]], ("joint",), ("rad",))
    scene = Scene([recording], [table], [np.zeros(angle.shape, bool)])
    found = tried_alone(scene, [residyn.Spring("joint"), residyn.effects.Damper("joint")])
    assert found.best.torque_time == turns
    # The evidence is the mean over the times, each along the same motion.
    t, linear, each = found.best, scene.linearised(found.best), []
    for x in TORQUE_TIMES:
        own = scene.evidences(dataclasses.replace(t, torque_time=x), linear, [0.03])
        more = non_normal_priors(t.effects, t.prior, own.regressors, own.covariance)
        each.append((own.log_evidence + more)[0])
    level, known = INTENSITIES.index(0.03), np.full(len(INTENSITIES), -np.inf)
    known[level] = each[TORQUE_TIMES.index(turns)]
    summed, _ = over_torque_times(scene, t, linear, known, np.array([level]))
    assert summed[level] == pytest.approx(logsumexp(each) - math.log(len(TORQUE_TIMES)), abs=1e-6)


def test_an_effect_that_is_not_there_pays_for_its_prior(ringing):
    """Occam's factor: where the readings hold a number to be nothing, within s, a normal prior of
    width w costs log w / s."""
    time, reading = ringing
    scene = scene_of_cart(time, reading)
    base = [Spring("cart"), Damper("cart")]
    richer = [*base, CubicStiffness("cart")]
    one, two = (
        settle(scene, [scene.start(e, prior_of(scene, e))], INTENSITIES[0])[0]
        for e in (base, richer)
    )
    cubic = scene.evidences(two[1], scene.linearised(two[1]), [0.0])
    u, std = cubic.regressors[0, 2], math.sqrt(cubic.covariance[0, 2, 2])
    price = 0.5 * u**2 / std**2 + math.log(std)
    assert two[0][-1] - one[0][-1] == pytest.approx(price, abs=0.1)
    assert price < 0


@given(st.floats(-4, 4), st.floats(0.05, 3))
def test_no_spring_has_less_than_nothing(reading, noise):
    """Its prior is normal about its typical size, cut off where the stiffness would be negative:
    the share of the posterior that is not, over that of the normal distribution."""
    size = 3.0
    prior = Prior(np.array([size]), np.array([size]), np.array([False]))
    std = 1 / math.sqrt(1 + (size / noise) ** 2)  # of u, the stiffness read as size (1 + u)
    mean = std**2 * size * (reading - size) / noise**2
    found = np.array([mean]), np.array([std])
    positive = norm.sf(0.0, loc=size * (1 + mean), scale=size * std)
    expected = math.log(max(positive, 1e-300)) - math.log(norm.sf(0.0, loc=size, scale=size))
    added = non_normal_priors([Spring("cart", 1.0)], prior, found[0], np.array([[std**2]]))
    assert added == pytest.approx(expected, rel=1e-6) or positive < 1e-290
    right = right_signs([Spring("cart", 1.0)], prior, *found)
    assert right == pytest.approx(min(2 * positive, 1.0), rel=1e-6, abs=1e-290)


@given(st.floats(-2, 2), st.floats(0.05, 1), st.floats(0, 1))
def test_what_is_left_may_be_why_a_number_has_the_wrong_sign(mean, std, left):
    """A torque left beside the model, along a spring, is a normal error of its stiffness."""
    size = 3.0
    prior = Prior(np.array([size]), np.array([size]), np.array([False]))
    found = np.array([mean / size - 1.0]), np.array([std / size])
    wide = math.hypot(std, size * left) if mean < 0 else std
    right = right_signs([Spring("cart", 1.0)], prior, *found, left)
    assert right == pytest.approx(min(2 * norm.cdf(mean / wide), 1.0), rel=1e-6, abs=1e-290)


@pytest.mark.parametrize(("loads", "told"), [((4.0, 4.0), False), ((4.0, 9.0), True)])
def test_friction_in_proportion_to_a_load_needs_two_loads(loads, told):
    """Under one load it is Coulomb friction."""
    time = np.arange(80) / 40
    reading = 0.1 * np.exp(-0.2 * time) * np.cos(6 * time)
    runs = [residyn.Recording.from_arrays(time, reading[:, None], noise=NOISE, load=x)
            for x in loads]  # fmt: skip
    carts = [residyn.ConstantInertia([[MASS]], ("cart",), ("m",), load=x) for x in loads]
    found = candidates(Scene(runs, carts, [np.zeros((len(time), 1), bool)] * 2), ())
    assert ("load_friction" in {e.name for e in found}) is told
    assert "coulomb_friction" in {e.name for e in found}


def test_a_memory_begins_in_each_recording_as_its_own_motion_does():
    """A cart with hysteresis, let go on either side: the sign of its angles in one recording is a
    matter of words."""
    time = np.arange(0.0, 2.0, 0.02)
    model = CART + Spring("cart", 200.0) + Damper("cart", 0.5) + Hysteresis("cart", 1.0, 0.02, 1.0)
    q = np.stack([residyn.simulate(model, time, [x], steps=1000).q for x in (0.1, 0.08)])
    q = q + 1e-4 * np.random.default_rng(0).standard_normal(q.shape)
    found = []
    for sign in (1.0, -1.0):
        runs = [residyn.Recording.from_arrays(time, x, noise=1e-4) for x in (q[0], sign * q[1])]
        scene = Scene(runs, [CART, CART], [np.zeros((len(time), 1), bool)] * 2)
        base = tried_alone(scene, [Spring("cart"), Damper("cart")]).best
        screen = Screen(Columns(scene, base, [Hysteresis("cart")], []), INTENSITIES)
        (other,) = settle(scene, [extended(scene, base, screen.ranked[0])], INTENSITIES[0])
        assert other is not None
        found.append((screen.ranked[0].gain, other[0].max()))
    assert found[0] == pytest.approx(found[1], abs=0.1)


def test_what_links_feel_is_measured_by_their_own_joint_and_length():
    """The pull of link 1 is known beforehand as a spring at the shoulder is; forces at points of
    links go with the unit of length."""
    time = np.arange(200) / 40
    swing = np.stack([0.2 * np.cos(3 * time), 0.5 * np.cos(9 * time)], axis=1)
    run = residyn.Recording.from_arrays(time, swing, noise=NOISE)
    wild = np.zeros(swing.shape, bool)
    one, other = (
        Scene(
            [run],
            [residyn.PlanarArm([0.2 * m, 0.3 * m], 0.03 * m**2, 0.01 * m**2, 0.02 * m)],
            [wild],
        )
        for m in (1.0, 100.0)
    )
    moment1, moment2, *_ = parameters_of(Gravity())
    for joint, moment in (("shoulder", moment1), ("elbow", moment2)):
        (stiffness,) = parameters_of(Spring(joint))
        assert one.size(Gravity(), moment) == pytest.approx(one.size(Spring(joint), stiffness))
    (drag,) = parameters_of(AirDrag())  # kg/m^2
    assert other.size(AirDrag(), drag) == pytest.approx(1e-4 * one.size(AirDrag(), drag))


def test_a_number_between_joints_has_the_unit_that_a_fit_gives_it():
    time = np.arange(200) / 40
    run = residyn.Recording.from_arrays(time, np.cos(np.outer(time, [3.0, 9.0])), noise=NOISE)
    pair = residyn.ConstantInertia(np.diag([2.0, 0.5]), ("cart", "pole"), ("m", "rad"))
    scene = Scene([run], [pair], [np.zeros((len(time), 2), bool)])
    for effect in (CouplingStiffness(), Spring("cart")):
        model = residyn.Model(pair) + effect
        (number,) = parameters_of(effect)
        assert str(model).endswith(f" 0 {scene.unit(effect, number)}")
    assert scene.unit(CouplingStiffness(), parameters_of(CouplingStiffness())[0]) == "N/rad"


def test_a_drift_is_measured_by_the_recording_and_not_by_a_swing():
    """A prior of one width changes the spring by the same share within the recording, however often
    the arm swings meanwhile."""
    for duration, frequency in ((5.0, 3.0), (50.0, 3.0), (50.0, 30.0)):
        scales = Scales(frequency=frequency, duration=duration)
        assert STIFFNESS_RATE.size(scales) * duration == pytest.approx(STIFFNESS.size(scales))


def test_what_takes_a_spring_s_place_is_known_beforehand_as_a_spring_is():
    """A pendulum has no other spring, and a loose joint none inside its gap: these are no effects
    of 0.5 to 30 % of one."""
    time = np.arange(200) / 40
    run = residyn.Recording.from_arrays(time, 0.2 * np.cos(3 * time), noise=NOISE)
    link = residyn.ConstantInertia([[MASS]], joints=("axis",), units=("rad",))
    scene = Scene([run], [link], [np.zeros((len(time), 1), bool)])
    pull, across = (prior_of(scene, [Gravity()]).width[i] for i in (0, 2))
    spring, twist, lost = (
        prior_of(scene, [e("axis")]).width[0] for e in (Spring, ConstantTorque, DeadZone)
    )
    assert (pull, across, lost) == pytest.approx((spring, twist, spring))


class Humming(JointEffect):
    """A disturbance of one frequency that grows with the angle."""

    name = "humming"
    oscillates = "frequency"
    memory = (Memory("phase", RATIO),)
    steady: float = param("torque", TORQUE)
    growing: float = param("torque over the angle", STIFFNESS)
    frequency: float = param("frequency", FREQUENCY, silent=None, default=1.0, grid=(1.0,))

    def joint_torque(self, motion):
        return (self.steady + self.growing * motion.q) * jnp.sin(motion.memory[0])

    def joint_rate(self, motion):
        return (2 * math.pi * self.frequency,)


def test_all_strengths_of_a_disturbance_have_its_phase():
    time = np.arange(80) / 40
    scene = scene_of_cart(time, 0.1 * np.cos(6 * time))
    t = scene.start([Spring("cart")], prior_of(scene, [Spring("cart")]))
    steady, growing, phase = 0.2, -0.3, 2.5
    begun = 2 * math.pi * 1.5 * scene.grid.time[:, None]
    both = np.outer([math.cos(phase), math.sin(phase)], [steady, growing]).ravel()
    found = Column(Humming("cart"), {"frequency": 1.5}, (0, 1, 2, 3), begun, regressors=both)
    t = extended(scene, t, found)
    assert t.u[1:3] == pytest.approx([steady, growing])
    assert t.numbers[3] == pytest.approx(1.5)
    np.testing.assert_allclose(t.path[:, 2], begun[:, 0] + phase)


@pytest.mark.parametrize("sizes", [AMPLITUDES, INTENSITIES[:-1], (0.3,)])
def test_the_prior_of_an_effects_size_is_that_of_a_strength(sizes):
    """The half-normal's probability of each cell of the grid, by quadrature."""
    edges = [10.0, *(math.sqrt(a * b) for a, b in itertools.pairwise(sizes)), 0.0]
    each = [quad(lambda x: 2 * norm.pdf(x, scale=WIDTH), b, a)[0]
            for a, b in itertools.pairwise(edges)]  # fmt: skip
    assert np.allclose(prior_sizes(sizes), each, atol=1e-6)
    assert prior_sizes(sizes).sum() == pytest.approx(1.0)


def test_what_was_missing_is_no_less_than_what_an_effect_does():
    weights = np.linspace(1.0, 2.0, len(INTENSITIES))
    assert np.array_equal(at_least(weights, 0.0), weights)
    known = at_least(weights, 0.028)
    assert np.array_equal(known[:3], weights[:3])
    assert known[3] == pytest.approx(weights[3:].sum())
    assert not known[4:].any()


def test_a_name_is_sure_where_it_leaves_little_of_what_was_missing():
    """Of a torque of no catalogue any share may be left; beside effects at work any size is."""
    each = {x: at_work(one) for x, one in zip(INTENSITIES, np.eye(len(INTENSITIES)), strict=True)}
    assert np.all(at_work(np.eye(len(INTENSITIES))[2], 0.1) < each[0.1])  # least with wrong signs
    for share in each.values():
        assert np.all(np.diff(share) >= 0)  # intensities fall along it
    for more, less in itertools.pairwise(INTENSITIES):
        assert np.all(each[more] >= each[less])
    found = dict(zip(INTENSITIES, each[0.1], strict=True))
    assert found[0.0] == found[NEGLIGIBLE] > 0.99
    assert found[0.1] < 0.5
    assert each[0.0][-1] == pytest.approx(1 - OUTSIDE)  # where nothing can be told
    low, high = math.sqrt(0.003 * 0.01), math.sqrt(0.01 * 0.03)
    # Of the grid's random torques two are louder than what was missing before.
    outside, work = OUTSIDE * (high - low) / 0.1, (1 - OUTSIDE) * 0.5 / 8 / (1 - 2 * 0.5 / 8)
    assert found[0.01] == pytest.approx(work / (work + outside), rel=1e-6)
    mixed = at_work((np.eye(len(INTENSITIES))[2] + np.eye(len(INTENSITIES))[3]) / 2)
    assert np.allclose(mixed, (each[0.1] + each[0.03]) / 2)


@pytest.mark.parametrize(("least", "shift"), [(-1.0, -30.0), (-300.0, 0.0), (-np.inf, 0.0)])
def test_what_an_exact_simulation_changes_is_true_of_motions_that_are_near(least, shift):
    """Of a motion under a random torque that is needed, one without any says nothing."""
    each = np.append(-np.arange(len(INTENSITIES) - 1.0), 0.0)
    each[-1] = least
    model = Tried((), each, NOWHERE, 0.0)
    end = (least if np.isfinite(least) else -300.0) - 30.0
    found = model.simulated_as(Simulated(end, np.zeros(0), np.zeros((0, 0))))
    assert found.evidences[-1] == end
    assert np.allclose(found.evidences[:-1], each[:-1] + shift)


def test_unknowns_that_rounding_cannot_tell_apart_leave_a_fit_compressed():
    """All readings answer to all of twelve unknowns alike but for rounding, and to another one not
    at all."""
    square = np.zeros((1, 13, 13))
    square[0, :12, :12] = 1e22 * (1.0 - 3e-14 * (np.eye(12) - 1 / 12))
    some = np.zeros((1, 5, 1))
    slope = np.append(np.full(12, 1e11), 0.0)[None]
    end = Unknowns(np.zeros(11), np.zeros((1, 2)))
    found = Minimum(end, some, some, 0.0, 1, True, square, slope)
    factor = np.asarray(found.compressed()[1])
    assert factor.transpose(0, 2, 1) @ factor == pytest.approx(
        square + np.diag([0.0] * 12 + [1.0]), rel=1e-12
    )


# -- the posterior over models --------------------------------------------------------------------

OFFSETS = ConstantTorque("cart"), SensorOffset("cart")
NAMES = [*OFFSETS, CoulombFriction("cart"), CubicStiffness("cart")]
LABELS = [e.label for e in NAMES]
SETS = [(), *((x,) for x in LABELS), (LABELS[0], LABELS[2]), (LABELS[3], LABELS[2])]
LOUD = np.array(INTENSITIES) > NEGLIGIBLE
evidences = st.lists(
    st.lists(st.floats(-40, 40), min_size=len(INTENSITIES), max_size=len(INTENSITIES)),
    min_size=len(SETS),
    max_size=len(SETS),
)


# A motion without numbers, none of which has a wrong sign.
NOWHERE = Trajectory(
    (), Prior(np.zeros(0), np.zeros(0), np.zeros(0, bool)), np.zeros(0), *np.zeros((3, 1, 1)),
    -math.inf, *np.zeros((3, 0, 0)),
)  # fmt: skip


# A motion with a damper below zero by five standard errors.
WRONG = dataclasses.replace(
    NOWHERE,
    effects=(Damper("cart"),),
    prior=Prior(np.zeros(1), np.ones(1), np.zeros(1, bool)),
    u=np.array([-0.5]),
    covariance=np.array([[0.01]]),
)


def posterior(each, named=NOWHERE, curves=()):
    tried = {
        frozenset(s): Tried(
            s, np.array(e), named if s else NOWHERE, log_prior_model(len(s), len(NAMES))
        )
        for s, e in zip(SETS, each, strict=True)
    }
    best = max(tried.values(), key=lambda m: m.log_posterior)
    base = tried[frozenset()]
    known = {"tried": tried, "passed": {}, "base": base, "best": best, "candidates": NAMES}
    scene = SimpleNamespace(joints=("cart",))
    told = {"screens": {}, "curves": list(curves), "reassigned": None, "scene": scene}
    return Posterior(SimpleNamespace(**known, **told))


def test_occams_window_has_rivals_of_the_best_model_and_no_richer_ones():
    logs = {"ab": 0.0, "ac": -2.5, "cd": -2.9, "abd": -1.0, "cde": -2.0, "a": -9.0, "ef": -3.1}
    each = [SimpleNamespace(added=tuple(x), log_posterior=p) for x, p in logs.items()]
    found = ["".join(m.added) for m in occams_window(each)]
    assert found == ["ab", "cde", "ac", "cd"]  # odds of 20 are 3 nats


def test_information_of_a_strength_that_was_read_once():
    """Half the log of 1 + signal to noise. Where that is little, a log Bayes factor is less on
    average (here the divergence of the readings' two normal densities)."""
    for signal in (0.01, 0.2, 4.0):
        told = information(np.array([[1 / (1 + signal)]]))
        assert told == pytest.approx(0.5 * math.log(1 + signal))
        if told < SETTLED:
            assert 0.5 * (signal - math.log(1 + signal)) < told


def in_a_complete_model(found, label):
    pairs = zip(found.models, found.each, strict=True)
    return sum(p * m.complete for m, p in pairs if label in m.added)


@given(evidences, st.lists(st.floats(0, 30), min_size=len(SETS), max_size=len(SETS)))
def test_evidence_against_the_catalogue_never_makes_a_name_likelier(each, raised):
    """Whichever models the readings then give a random torque to, and how much of it."""
    before = posterior(each)

    def with_more(which):
        rows = zip(each, raised, which, strict=True)
        return posterior([np.array(e) + r * LOUD * x for e, r, x in rows])

    after = with_more(np.ones(len(SETS)))
    for label in LABELS:
        assert in_a_complete_model(after, label) <= in_a_complete_model(before, label) + 1e-12
    # What simpler models need is evidence for the names that they lack.
    richest = with_more([not any(set(one) < set(other) for other in SETS) for one in SETS])
    verdict, probability = before.verdict()
    new, its = richest.verdict()
    if verdict == "unexplained":
        assert new == "unexplained"
        assert its >= probability - 1e-12
    elif new == verdict:
        assert its <= probability + 1e-12


@given(evidences)
def test_the_three_verdicts_share_all_probability(each):
    found = posterior(each)
    assert sum(found.each) == pytest.approx(1.0)
    base = found.models[0].weights
    of = {frozenset(m.added): min(m.weights, base, key=lambda w: w @ np.array(INTENSITIES))
          for m in found.models}  # fmt: skip
    missing = sum(
        p * np.dot(m.weights, ~LOUD * np.min([at_work(of[frozenset(m.added) - {x}])
                                               for x in m.added], axis=0))
        for m, p in zip(found.models, found.each, strict=True)
        if m.added
    )  # fmt: skip
    adequate = found.each[0] * found.models[0].complete
    shares = {"adequate": adequate, "missing": missing, "unexplained": 1 - adequate - missing}
    verdict, probability = found.verdict()
    assert probability == pytest.approx(shares[verdict], abs=1e-9)
    assert probability == pytest.approx(max(shares.values()), abs=1e-9)


def test_the_kind_of_law_is_told_before_the_law():
    """Two laws of one kind share what the readings give it."""
    each = np.full((len(SETS), len(INTENSITIES)), -40.0)
    constant, offset, friction = (SETS.index((x,)) for x in LABELS[:3])
    each[[constant, offset, friction], -1] = 0.0, 0.2, 0.5
    found = posterior(each)
    assert found.each[friction] == max(found.each)
    assert found.best.added == (OFFSETS[1].label,)
    models, p = found.rivals()
    assert [m.added for m in models] == [(OFFSETS[1].label,), (LABELS[2],)]
    assert p[0] > 0.5 > p[1]


def test_only_models_in_play_have_rivals_and_lookalikes():
    """Beside a law without a name that is far ahead none has."""
    each = np.full((len(SETS), len(INTENSITIES)), -40.0)
    constant, offset, friction = (SETS.index((x,)) for x in LABELS[:3])
    each[[constant, offset, friction], -1] = 0.0, 0.2, 0.5
    base = Tried((), each[0] + 40.0, NOWHERE, log_prior_model(0, len(NAMES)))
    faint = dataclasses.replace(a_curve(base, Kind("rate")), share=0.0)
    assert len(posterior(each).lookalikes()[0]) == 3
    law = a_curve(dataclasses.replace(base, evidences=base.evidences + 100.0), Kind("rate"))
    beside = posterior(each, curves=[law])
    assert beside.in_play()[2] == beside.of_unnamed == pytest.approx(1.0)
    assert beside.rivals()[0] == beside.in_play()[0] == []
    assert beside.lookalikes() == ()
    # A law that does nothing is none: with it the model is the one without it.
    models, p, rest = posterior(each, curves=[faint]).in_play()
    assert rest < 0.01
    assert models[int(np.argmax(p))].added == ()


@pytest.mark.parametrize("most", [LABELS[0], LABELS[2]])
def test_of_kinds_in_the_same_models_the_first_is_what_explains_most_alone(most):
    each = np.full((len(SETS), len(INTENSITIES)), -40.0)
    each[:, 0] = -30.0  # but for the pair all is missing
    each[SETS.index((LABELS[0], LABELS[2])), -1] = 0.0
    each[SETS.index((most,)), 0] = -20.0
    first, second = posterior(each).families()[:2]
    assert first.probability == pytest.approx(second.probability, abs=1e-3)
    assert most in dict(first.members)


@given(evidences, st.sampled_from([NOWHERE, WRONG]))
def test_effects_are_missing_no_surer_than_any_is_named(each, motion):
    """Also where no name is at work, for all stand beside a damper below zero."""
    found = posterior(each, motion)
    verdict, probability = found.verdict()
    if verdict == "missing":
        assert probability <= found.of(LABELS) + 1e-12


def test_a_curve_that_holds_the_damper_makes_no_name_less_sure():
    """A curve of the rate may be a damper of any size, and the damper beside it be negative."""
    each = np.zeros((len(SETS), len(INTENSITIES)))
    each[SETS.index((LABELS[0],))] = 30.0
    best = Tried((LABELS[0],), each[1] + 40.0, WRONG, log_prior_model(1, len(NAMES)))
    curve = a_curve(best, Kind("rate"))
    alone, beside = posterior(each), posterior(each, curves=[curve])
    assert sum(beside.of_curves) > 0.99
    assert beside.of([LABELS[0]]) == pytest.approx(alone.of([LABELS[0]]), abs=0.01)


def a_curve(beside: Tried, kind: Kind) -> CurveModel:
    none = np.zeros(0)
    return CurveModel(
        beside.added, beside.evidences, beside.best, beside.log_prior,
        Place(kind, 0, -1.0, 1.0), free_curves.Posterior(none, none, none, none), none, share=0.1,
    )  # fmt: skip


def test_a_friction_without_a_name_is_dry_friction():
    """Three in four for a friction that changes with time, and next to nothing for Coulomb's."""
    each = np.zeros((len(SETS), len(INTENSITIES)))
    each[1:] = -30.0
    base = Tried((), each[0] + math.log(3.0), NOWHERE, log_prior_model(0, len(NAMES)))
    for variable in ("time", "angle"):
        found = posterior(each, curves=[a_curve(base, Kind(variable, "direction"))])
        kind = next(f for f in found.families() if f.name == "dry friction")
        loud = float(base.weights @ at_work(found.models[0].weights))
        assert kind.probability == pytest.approx(0.75 * loud, abs=1e-6)
        assert kind.unnamed == pytest.approx(kind.probability, abs=1e-6)
        assert all(f.probability < 1e-6 for f in found.families() if f != kind)
    other = posterior(each, curves=[a_curve(base, Kind("rate"))])
    assert all(f.probability < 1e-6 for f in other.families())
    best = Tried((LABELS[2],), each[0] + 60.0, NOWHERE, log_prior_model(1, len(NAMES)))
    beside = posterior(each, curves=[a_curve(best, Kind("angle"))]).families()
    assert [f.name for f in beside[:2]] == ["dry friction", "spring shape"]
    assert beside[0].probability == pytest.approx(beside[1].probability, abs=1e-6)


@given(evidences)
def test_a_family_is_as_likely_as_its_members_together(each):
    """No more than their sum, for a model may have two of them, and no less than any."""
    found = posterior(each)
    for family in found.families():
        parts = [p for _, p in family.members]
        assert max(parts) - 1e-12 <= family.probability <= min(1.0, sum(parts)) + 1e-9


@given(evidences, st.integers(1, len(SETS) - 1), st.floats(0, 20))
def test_evidence_for_a_model_raises_its_names(each, which, more):
    before = posterior(each)
    after = posterior([np.array(e) + more * (i == which) for i, e in enumerate(each)])
    for label in SETS[which]:
        inside = lambda found, label=label: sum(  # noqa: E731
            p for m, p in zip(found.models, found.each, strict=True) if label in m.added
        )
        assert inside(after) >= inside(before) - 1e-12
