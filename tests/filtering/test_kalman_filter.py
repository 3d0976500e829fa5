"""The Kalman filter under a random torque: its likelihood, its smoother, and the linear steps of a
model, each held against a closed form or another way to the same number."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.linalg import eigh

from residyn import ConstantInertia, PlanarArm, Recording, Spring
from residyn.diagnosis.columns import Columns, Screen, extended, spectral_lines
from residyn.diagnosis.evidence import WIDTH
from residyn.effects import CoulombFriction, CubicStiffness, Damper, Gravity, Hysteresis
from residyn.filtering.grid import Spectrum, lay_out
from residyn.filtering.kalman import Noise, Readings, System, evidences, gram, smooth
from residyn.filtering.law import numbers_of
from residyn.filtering.trajectory import Prior, Scene
from residyn.physics.effect import JointEffect
from residyn.physics.modal import modes
from residyn.physics.parameter import RATIO, STIFFNESS, param
from residyn.simulation.simulate import simulate

pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def a_system(K=12, X=3, n=2, P=3, seed=0):
    """A random stable system, its readings (one lost), and its noise."""
    rng = np.random.default_rng(seed)
    A = np.eye(X) * 0.9 + 0.05 * rng.standard_normal((K, X, X))
    system = System(
        A,
        rng.standard_normal((K, X, P)),
        rng.standard_normal((K, X, n)),
        rng.standard_normal((K, X)),
        rng.standard_normal((K, n, X)),
        rng.standard_normal((K, n, P)),
        rng.standard_normal((K, n)),
        rng.standard_normal((K, n, n)),
        rng.uniform(0.0, 0.5, (K, n)),
    )
    seen = np.ones((K, n), bool)
    seen[4, 1] = False
    readings = Readings(rng.standard_normal((K, n)), seen, rng.uniform(0.5, 2.0, (K, n)))
    decay = np.full((K, n), 0.8)
    growth = np.concatenate([np.zeros((K, X)), np.full((K, n), 0.3)], axis=1)
    noise = Noise(rng.standard_normal(X), rng.uniform(0.5, 1.0, X + n), decay, growth)
    return system, readings, noise


def joint_gaussian(system, readings, noise):
    """Mean and covariance of all readings at once, regressors included, written out densely; and
    the covariance of the states with them."""
    K, X = system.c.shape
    n, P = system.T.shape[-1], system.B.shape[-1]
    D = X + n
    # Unknowns: first state, regressors, torque increments; each normal.
    size = D + P + K * n
    means = np.zeros(size)
    means[:X] = noise.mean
    variances = np.concatenate([noise.variance, np.ones(P), noise.growth[:, X:].reshape(-1)])
    state, const = np.zeros((D, size)), np.zeros(D)
    state[:, :D] = np.eye(D)
    rows, constants, states, state_constants = [], [], [], []
    for k in range(K):
        states.append(state)
        state_constants.append(const)
        read = system.Hx[k] @ state[:X] + system.Ht[k] @ state[X:]
        read[:, D : D + P] += system.Hu[k]
        rows.append(read)
        constants.append(system.Hx[k] @ const[:X] + system.Ht[k] @ const[X:] + system.hc[k])
        F = np.block([[system.A[k], system.T[k]], [np.zeros((n, X)), np.diag(noise.decay[k])]])
        state, const = F @ state, F @ const
        state[:X, D : D + P] += system.B[k]
        const[:X] += system.c[k]
        for j in range(n):
            state[X + j, D + P + k * n + j] += 1.0
    keep = np.asarray(readings.seen).reshape(-1)
    H = np.concatenate(rows)[keep]
    mean = (np.concatenate(constants) + np.concatenate(rows) @ means)[keep]
    noise_of = np.asarray(readings.variance + system.unsure).reshape(-1)[keep]
    covariance = H * variances @ H.T + np.diag(noise_of)
    y = np.asarray(readings.y).reshape(-1)[keep]
    return y, mean, covariance, H, means, variances, states, state_constants


def test_marginal_likelihood_and_smoother_equal_the_dense_gaussian():
    system, readings, noise = a_system()
    y, mean, covariance, H, means, variances, states, constants = joint_gaussian(
        system, readings, noise
    )
    off = y - mean
    sign, logdet = np.linalg.slogdet(2 * np.pi * covariance)
    exact = -0.5 * (off @ np.linalg.solve(covariance, off) + logdet)
    found = smooth(system, readings, noise, 1.0)
    assert sign > 0
    assert float(found.log_evidence) == pytest.approx(exact, abs=1e-8)
    gain = (variances[:, None] * H.T) @ np.linalg.inv(covariance)
    after = means + gain @ off
    D, P = noise.variance.shape[0], system.B.shape[-1]
    np.testing.assert_allclose(found.regressors, after[D : D + P], atol=1e-9)
    for k in (0, 5, 11):
        np.testing.assert_allclose(found.mean[k], states[k] @ after + constants[k], atol=1e-8)


def test_evidences_under_several_random_torques_are_those_of_each_alone():
    system, readings, noise = a_system()
    found = evidences(system, readings, noise, np.array([2.0, 0.5, 0.0]))
    for i, intensity in enumerate((2.0, 0.5, 0.0)):
        alone = smooth(system, readings, noise, intensity)
        assert float(found.log_evidence[i]) == pytest.approx(float(alone.log_evidence), abs=1e-9)
        np.testing.assert_allclose(found.regressors[i], alone.regressors, atol=1e-9)
        np.testing.assert_allclose(found.covariance[i], alone.covariance, atol=1e-9)


def test_smoothed_variances_are_those_given_the_regressors():
    system, readings, noise = a_system()
    none = system._replace(B=0 * system.B, Hu=0 * system.Hu)
    _, _, covariance, H, _, variances, states, _ = joint_gaussian(none, readings, noise)
    gain = (variances[:, None] * H.T) @ np.linalg.inv(covariance)
    left = np.diag(variances) - gain @ (H * variances)
    found = smooth(none, readings, noise, 1.0)
    for k in (0, 6, 11):
        exact = np.diag(states[k] @ left @ states[k].T)
        np.testing.assert_allclose(found.variance[k], exact, atol=1e-9)


def test_the_evidence_has_the_derivative_of_its_finite_differences():
    system, readings, noise = a_system()

    def evidence(scale):
        return smooth(system._replace(A=scale * jnp.asarray(system.A)), readings, noise, 1.0)[0]

    slope = float(jax.grad(evidence)(1.0))
    eps = 1e-5
    difference = (evidence(1.0 + eps) - evidence(1.0 - eps)) / (2 * eps)
    assert slope == pytest.approx(float(difference), rel=1e-7)


def test_one_gram_matrix_holds_the_evidence_of_every_subset():
    from residyn.diagnosis.evidence import conditional, subset

    system, readings, noise = a_system(P=4)
    total, square = map(np.asarray, gram(system, (), readings, noise, 1.0))
    base, rest = conditional(square, 1)
    for chosen in ((), (0,), (2,), (0, 1), (0, 1, 2)):
        of = [0, *(i + 1 for i in chosen)]
        alone = system._replace(B=system.B[..., of], Hu=system.Hu[..., of])
        exact = float(smooth(alone, readings, noise, 1.0).log_evidence)
        gain = subset(rest, chosen)[0] if chosen else 0.0
        assert float(total) + base + gain == pytest.approx(exact, abs=1e-8)


# -- a model along its motion ---------------------------------------------------------------------

ARM = PlanarArm([0.4, 0.4], 1.1, 0.58, 1.4, 0.3, [1.0, 1.0])


def a_recording(model, q0=(0.2, -0.1), seconds=5.0, rate=100.0, noise=1e-4, seed=0, **given):
    time = np.arange(round(seconds * rate) + 1) / rate
    path = simulate(model, time, list(q0), steps=4 * len(time))
    rng = np.random.default_rng(seed)
    q = np.asarray(path.q) + noise * rng.standard_normal(path.q.shape)
    return Recording.from_arrays(time, q, noise=noise, theta2=0.3, **given), path


def base_of(scene):
    effects = [e(j) for e in (Spring, Damper) for j in scene.joints]
    sizes = [s.inertia * s.frequency**2 for s in scene.scales]
    dampers = [0.3 * s.inertia * s.frequency for s in scene.scales]
    n = scene.n
    prior = Prior(
        np.array([*sizes, *[0.0] * n]), np.array([*sizes, *dampers]), np.zeros(2 * n, bool)
    )
    return effects, prior


def settled(scene, t, intensities=(1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 0.0)):
    for intensity in intensities:
        for _ in range(3):
            t = scene.smoothed(t, scene.linearised(t), intensity)
    return t


def test_without_a_random_torque_it_is_the_fit_by_least_squares():
    truth = ARM + Spring("shoulder", 17.0) + Spring("elbow", 12.0)
    truth = truth + Damper("shoulder", 0.1) + Damper("elbow", 0.05)
    recording, path = a_recording(truth)
    scene = Scene([recording], [ARM], [np.zeros(recording.angle.shape, bool)])
    effects, prior = base_of(scene)
    t = settled(scene, scene.start(effects, prior))
    np.testing.assert_allclose(t.numbers, [17.0, 12.0, 0.1, 0.05], rtol=2e-3)
    own = t.path[: scene.grid.real, :2]
    assert np.sqrt(np.mean((own - np.asarray(path.q)) ** 2)) < 2e-5


def test_a_step_of_the_linear_system_is_a_step_of_the_simulation():
    """Along a simulated motion, A x + B u + c is where the simulation goes, numbers moved too."""
    model = ARM + Spring("shoulder", 17.0) + Spring("elbow", 12.0) + Gravity(2.0, 0.5, 0.3, 0.1)
    model = model + CubicStiffness("elbow", 30.0) + Damper("elbow", 0.05)
    recording, path = a_recording(model, q0=(0.4, -0.3))
    scene = Scene([recording], [ARM], [np.zeros(recording.angle.shape, bool)])
    count = len(model.vector())
    values = np.asarray(model.vector())
    prior = Prior(values, np.maximum(np.abs(values), 0.1), np.zeros(count, bool))
    t = scene.start(model.effects, prior)
    motion = np.concatenate([np.asarray(path.q), np.asarray(path.v)], axis=1)
    real = scene.grid.real
    t.path[:real, :4], t.path[real:, :4] = motion[:real], motion[real - 1]
    system = jax.tree.map(np.asarray, scene.linearised(t).system)
    k = np.arange(real - 1)
    moved = np.einsum("kij,kj->ki", system.A[k], t.path[k]) + system.c[k]
    np.testing.assert_allclose(moved[:, :4], motion[1:real], atol=1e-5)
    # ... and B is how the end of a step moves with each number.
    step, eps = 1 / 100, 1e-4
    for i in range(count):
        ends = []
        for side in (1, -1):
            numbers = values.copy()
            numbers[i] += side * eps
            start = motion[50]
            end = simulate(
                model.with_vector(jnp.asarray(numbers)),
                np.array([0.0, step]),
                start[:2],
                v0=start[2:],
                steps=4,
            )
            ends.append(np.concatenate([end.q[-1], end.v[-1]]))
        slope = (ends[0] - ends[1]) / (2 * eps) * prior.width[i]
        np.testing.assert_allclose(system.B[50, :4, i], slope, atol=2e-6)


def test_expected_friction_is_the_level_far_from_rest_and_holds_at_rest():
    from residyn.filtering.linearised import expected_direction

    def direction(*args):
        return float(expected_direction(*map(jnp.asarray, args))[0])

    assert direction(1.0, 0.3, 1.0, 1e-6, 1e-3) == pytest.approx(1.0, abs=1e-6)
    # At rest, just the torque that is needed; no more than friction can give.
    assert direction(0.0, 0.3, 1.0, 1e-9, 1e-3) == pytest.approx(0.3, abs=1e-6)
    assert 0 < direction(0.0, 3.0, 1.0, 1e-9, 1e-3) < 1
    assert direction(0.0, 0.0, 1.0, 1.0, 1e-3) == pytest.approx(0.0, abs=1e-3)


def test_slopes_of_the_expected_direction_are_its_finite_differences():
    from residyn.filtering.linearised import expected_direction

    at = np.array([2e-4, 0.3, 1.0])
    _, slopes = expected_direction(*map(jnp.asarray, at), 3e-4, 1e-3)
    for i, eps in enumerate((1e-8, 1e-5, 1e-5)):
        step = eps * np.eye(3)[i]
        ends = [float(expected_direction(*map(jnp.asarray, x), 3e-4, 1e-3)[0])
                for x in (at + step, at - step)]  # fmt: skip
        assert float(slopes[i]) == pytest.approx((ends[0] - ends[1]) / (2 * eps), rel=1e-5)


@pytest.mark.parametrize("effect", [CoulombFriction("elbow", 0.2), Hysteresis("elbow", 0.5, 0.1)])
def test_strengths_of_laws_with_jumps_or_memory_are_found(effect):
    truth = ARM + Spring("shoulder", 17.0) + Spring("elbow", 12.0)
    truth = truth + Damper("shoulder", 0.05) + Damper("elbow", 0.05) + effect
    recording, _ = a_recording(truth, q0=(0.2, -0.3))
    scene = Scene([recording], [ARM], [np.zeros(recording.angle.shape, bool)])

    effects, prior = base_of(scene)
    t = settled(scene, scene.start(effects, prior), (1.0, 0.3, 0.1, 0.03))
    lines = spectral_lines(scene, t, scene.linearised(t))
    columns = Columns(scene, t, [type(effect)("elbow")], lines)
    (found,) = Screen(columns, [0.03]).ranked
    t = extended(scene, t, found)
    for intensity in (0.03, 0.01, 1e-3, 0.0):
        for _ in range(8):
            t = scene.smoothed(t, scene.linearised(t), intensity, share=0.5)
    assert t.numbers[4] == pytest.approx(float(effect.level), rel=0.02)


class Geared(JointEffect):
    """A spring behind a gear of known ratio."""

    name = "geared"
    stiffness: float = param("stiffness", STIFFNESS)
    ratio: float = param("ratio of the gear", RATIO, silent=None, default=1.0, fitted=False)

    def joint_torque(self, motion):
        return self.ratio * self.stiffness * motion.q


def test_effects_of_one_name_have_their_own_fixed_values():
    recording, _ = a_recording(ARM + Spring("shoulder", 17.0) + Spring("elbow", 12.0), seconds=1.0)
    scene = Scene([recording], [ARM], [np.zeros(recording.angle.shape, bool)])
    effects = [Geared("elbow", ratio=10.0), Geared("shoulder", ratio=0.1)]
    t = scene.start(effects, Prior(np.array([2.0, 3.0]), np.ones(2), np.zeros(2, bool)))
    torque = scene.torques(t)
    for joint, size in ((1, 20.0), (0, 0.3)):
        found = torque[f"geared:{scene.joints[joint]}"]
        np.testing.assert_allclose(found[:, joint], size * t.path[:, joint])
        assert not found[:, 1 - joint].any()
    base = scene.start(*base_of(scene))
    columns = Columns(scene, base, effects, [], {e.label: {} for e in effects})
    found = columns.torque[..., 0], columns.torque[..., 1]
    for x, effect, joint, ratio in zip(found, effects, (1, 0), (10.0, 0.1), strict=True):
        width = WIDTH * scene.size(effect, numbers_of(effect)[0])
        np.testing.assert_allclose(x[:, joint], ratio * width * scene.q[:, joint], atol=1e-12)


# -- recordings on the grid -----------------------------------------------------------------------


def test_fast_readings_are_averaged_and_lose_nothing():
    """Averages of 1 kHz readings find stiffness and damping as all readings do: the curvature
    within an average is accounted for."""
    cart = ConstantInertia([[2.0]], joints=("cart",), units=("m",))
    truth = cart + Spring("cart", 200.0) + Damper("cart", 0.4)
    time = np.arange(10000) / 1000
    path = simulate(truth, time, [0.05], steps=10000)
    rng = np.random.default_rng(1)
    q = np.asarray(path.q) + 1e-5 * rng.standard_normal(path.q.shape)
    recording = Recording.from_arrays(time, q, noise=1e-5)
    scene = Scene([recording], [cart], [np.zeros(q.shape, bool)])
    assert scene.grid.real < 4096
    effects, prior = base_of(scene)
    t = settled(scene, scene.start(effects, prior))
    assert t.numbers[0] == pytest.approx(200.0, rel=1e-4)
    assert t.numbers[1] == pytest.approx(0.4, rel=2e-3)


@pytest.mark.parametrize("lost", ["in turn", "readings", "rows", "few rows"])
def test_averages_are_of_all_readings_that_there_are(lost):
    """... with the noise of so many, and the model says the mean of its angles at their times."""
    truth = ARM + Spring("shoulder", 17.0) + Spring("elbow", 12.0)
    recording, path = a_recording(truth, seconds=12.0, rate=1000.0)
    rng, angle = np.random.default_rng(4), np.array(recording.angle)
    rows = np.arange(len(angle))
    if lost == "in turn":
        angle[rows[:, None] % 2 == [0, 1]] = np.nan
    elif lost == "readings":
        angle[rng.random(angle.shape) < 0.2] = np.nan
    elif lost == "rows":
        rows = np.delete(rows, rng.choice(rows, 2400, replace=False))
    else:
        rows = np.delete(rows, [500, 7000, 7001])
    angle, time, q = angle[rows], recording.time[rows], np.asarray(path.q)[rows]
    there = np.isfinite(angle)
    recording = Recording.from_arrays(time, angle, noise=1e-4)
    scene = Scene([recording], [ARM], [np.zeros(angle.shape, bool)])
    grid, own = scene.grid, scene.grid.of(0)
    seen = grid.seen[own]
    assert grid.real < 5000
    readings = np.where(seen, recording.noise**2 / grid.variance[own], 0.0)
    np.testing.assert_allclose(readings.sum(axis=0), there.sum(axis=0))
    means = grid.of_readings(0, angle, there)
    np.testing.assert_array_equal(means[seen], grid.angle[own][seen])
    values = np.asarray(truth.vector())
    t = scene.start(truth.effects, Prior(values, values, np.zeros(len(values), bool)))
    motion = CubicSpline(path.t, np.concatenate([path.q, path.v], axis=1))(grid.time)
    t = dataclasses.replace(t, path=np.concatenate([motion, t.path[:, 4:]], axis=1))
    said = np.asarray(scene.linearised(t).seen)[own]
    np.testing.assert_allclose(said[seen], grid.of_readings(0, q, there)[seen], atol=1e-6)


def test_lost_and_uneven_readings_keep_their_times():
    rng = np.random.default_rng(2)
    time = np.sort(rng.uniform(0, 10, 400))
    angle = np.stack([np.sin(3 * time), np.cos(2 * time)], axis=1)
    angle[100:120] = np.nan
    recording = Recording.from_arrays(time, angle, noise=1e-3)
    grid = lay_out([recording, recording], [np.zeros(angle.shape, bool)] * 2)
    at = np.flatnonzero(grid.seen[:, 0] & (grid.run == 0))
    np.testing.assert_allclose(grid.angle[at, 0], np.sin(3 * (grid.time[at] + time[0])), atol=1e-12)
    assert grid.seen[:, 0].sum() == 2 * (400 - 20)
    assert grid.last.sum() == 1
    assert 1024 < grid.real < len(grid.time) == 1536


def test_the_fastest_frequency_is_that_of_the_motion_not_of_the_noise():
    time = np.arange(2000) / 100
    rng = np.random.default_rng(3)
    angle = 0.2 * np.sin(2 * np.pi * 0.5 * time) + 0.02 * np.sin(2 * np.pi * 4 * time)
    angle = (angle + 1e-3 * rng.standard_normal(len(time)))[:, None]
    recording = Recording.from_arrays(time, angle, noise=1e-3)
    fast = Spectrum.of(recording, np.zeros(angle.shape, bool)).fastest
    # Averaged over 15 lines of 0.05 Hz to either side.
    assert 1.0 < fast / (2 * np.pi * 4) < 1.25


@pytest.mark.parametrize("mirrored", [False, True])
def test_noise_alone_hardly_ever_stands_out_even_at_the_lowest_lines(mirrored):
    """One line in 10^6: of 4000 joints and some ten averages each, next to none."""
    noise = np.random.default_rng(0).standard_normal((256, 4000))
    seen = Recording.from_arrays(np.arange(256) / 100, noise, noise=1.0)
    signal = Spectrum.of(seen, np.zeros(noise.shape, bool), mirrored).signal
    assert signal.any(axis=1).sum() <= 1


def test_lost_readings_make_no_motion_faster():
    time, rng = np.arange(1200) / 30, np.random.default_rng(5)
    angle = 0.2 * np.sin(2 * np.pi * 0.8 * time) + 0.1 * np.sin(2 * np.pi * 2.4 * time)
    angle = (angle + 2e-4 * rng.standard_normal(len(time)))[:, None]
    kept = np.sort(rng.choice(len(time), 960, replace=False))
    whole, part = (
        Recording.from_arrays(t, x, noise=2e-4)
        for t, x in ((time, angle), (time[kept], angle[kept]))
    )
    fast, slow = (Spectrum.of(r, np.zeros(r.angle.shape, bool)).fastest for r in (part, whole))
    assert fast < 2.5 * slow  # a line through a lost reading has corners of the Nyquist frequency


def test_noise_of_fewer_readings_is_no_motion():
    """Joints that are read in turn, fast: bridged, the noise of half of the readings has twice the
    power of all of them at the frequencies of the motion."""
    time, rng = np.arange(12000) / 1000, np.random.default_rng(5)
    angle = 0.2 * np.exp(-0.2 * time) * np.sin(2 * np.pi * 0.8 * time)
    angle = (angle + 2e-4 * rng.standard_normal(len(time)))[:, None]
    half = np.where(np.arange(len(time))[:, None] % 2 == 0, angle, np.nan)
    runs = [Recording.from_arrays(time, x, noise=2e-4) for x in (half, angle)]
    fast, slow = (Spectrum.of(r, np.zeros(r.angle.shape, bool)).fastest for r in runs)
    assert fast < 1.1 * slow


def test_typical_stiffness_is_that_of_a_motion_that_is_soon_over():
    time, rng = np.arange(1200) / 30, np.random.default_rng(6)
    decayed = 0.3 * np.exp(-0.15 * 5 * time) * np.cos(5 * time)
    angle = (0.02 + decayed + 1e-4 * rng.standard_normal(len(time)))[:, None]
    recording = Recording.from_arrays(time, angle, noise=1e-4)
    found = Spectrum.of(recording, np.zeros(angle.shape, bool)).stiffness(np.array([[2.0]]))
    np.testing.assert_allclose(found, [50.0], rtol=0.3)


def test_a_fast_mode_that_is_over_at_once_has_its_size_and_its_steps():
    truth = ARM + Spring("shoulder", 30.0) + Spring("elbow", 8.0) + Damper("elbow", 0.4)
    recording, _ = a_recording(truth, seconds=40.0)
    wild = np.zeros(recording.angle.shape, bool)
    scene = Scene([recording], [ARM], [wild])
    sizes = [s.inertia * s.frequency**2 for s in scene.scales]
    np.testing.assert_allclose(sizes, [30.0, 8.0], rtol=0.3)
    fastest = 2 * np.pi * np.max(modes(truth).frequency_hz)
    assert 0.9 * fastest < scene.grid.fast < 6 * fastest


def test_typical_stiffness_is_that_of_the_springs():
    truth = ARM + Spring("shoulder", 30.0) + Spring("elbow", 8.0)
    recording, _ = a_recording(truth, seconds=20.0)
    rows = ARM.mass_matrix((0.0, 0.0))
    inertia = np.array([[float(x) for x in row] for row in rows])
    found = Spectrum.of(recording, np.zeros(recording.angle.shape, bool)).stiffness(inertia)
    np.testing.assert_allclose(found, [30.0, 8.0], rtol=0.15)


@pytest.mark.parametrize("off", np.linspace(0.95, 1.05, 5))
def test_typical_stiffness_is_not_lost_in_a_small_difference_of_large_torques(off):
    """Only the fast mode rings, and the arm's coupling is off by some per cent."""
    springs = np.array([30.0, 60.0])
    truth = ARM + Spring("shoulder", springs[0]) + Spring("elbow", springs[1])
    rows = ARM.mass_matrix((0.0, 0.0))
    inertia = np.array([[float(x) for x in row] for row in rows])
    shape = eigh(np.diag(springs), inertia)[1][:, -1]
    recording, _ = a_recording(truth, q0=0.1 * shape / np.abs(shape).max(), seconds=20.0)
    wrong = inertia * np.array([[1.0, off], [off, 1.0]])
    found = Spectrum.of(recording, np.zeros(recording.angle.shape, bool)).stiffness(wrong)
    assert np.all((found > springs / 4) & (found < 4 * springs))


def test_typical_stiffness_is_the_springs_though_an_encoder_jumps():
    truth = ARM + Spring("shoulder", 30.0) + Spring("elbow", 8.0)
    recording, _ = a_recording(truth, seconds=20.0)
    angle = np.array(recording.angle)
    angle[len(angle) // 3 :, 1] += 0.5 * np.std(angle[:, 1])
    jumped = Recording.from_arrays(recording.time, angle, noise=recording.noise)
    rows = ARM.mass_matrix((0.0, 0.0))
    inertia = np.array([[float(x) for x in row] for row in rows])
    found = Spectrum.of(jumped, np.zeros(angle.shape, bool)).stiffness(inertia)
    np.testing.assert_allclose(found, [30.0, 8.0], rtol=0.5)


def test_typical_torque_of_a_driven_slide_without_a_spring_is_the_motors():
    # Short pulses to and fro: the slope of force against position leaves out a half of the force.
    time = np.arange(2000) / 100
    wave = np.sin(2 * np.pi * time / 4)
    force = 5.0 * np.sign(wave) * (np.abs(wave) > 0.98)
    rate = np.cumsum(force - force.mean()) / 100
    place = np.cumsum(rate - rate.mean()) / 100
    seen = Recording.from_arrays(time, place[:, None], noise=1e-4, drive=force[:, None])
    slide = ConstantInertia([[1.0]], joints=("slide",), units=("m",))
    scene = Scene([seen], [slide], [np.zeros((2000, 1), bool)])
    assert scene.torque[0] / np.sqrt(2) == pytest.approx(np.std(force), rel=0.1)


def test_sizes_are_those_of_the_motion_however_long_it_rests_after():
    time, rng = np.arange(1200) / 30, np.random.default_rng(6)
    decayed = 0.3 * np.exp(-0.15 * 5 * time) * np.cos(5 * time)
    angle = (decayed + 1e-4 * rng.standard_normal(len(time)))[:, None]
    table, amplitude = ConstantInertia([[2.0]], ["joint"]), []
    for count in (200, 1200):  # it has decayed to 0.2 mrad after 200
        seen = Recording.from_arrays(time[:count], angle[:count], noise=1e-4)
        scene = Scene([seen], [table], [np.zeros((count, 1), bool)])
        amplitude.append(scene.scales[0].amplitude)
    np.testing.assert_allclose(*amplitude, rtol=0.05)


def test_the_order_of_recordings_changes_no_evidence():
    """A cart on a spring of 300 N/m, alone and, for longer, under a load of 8 kg."""
    runs, carts = [], []
    for mass, seconds, noise in ((2.0, 3.0, 1e-4), (10.0, 6.0, 3e-4)):
        time = np.arange(0.0, seconds, 0.0125)
        q = 0.03 * np.cos(np.sqrt(300.0 / mass) * time)
        q = q + noise * np.random.default_rng(0).standard_normal(len(time))
        runs.append(Recording.from_arrays(time, q[:, None], noise=noise))
        carts.append(ConstantInertia([[mass]], joints=("cart",), units=("m",)))
    found = []
    for order in (slice(None), slice(None, None, -1)):
        wild = [np.zeros(r.angle.shape, bool) for r in runs[order]]
        scene = Scene(runs[order], carts[order], wild)
        (spring,) = (s.inertia * s.frequency**2 for s in scene.scales)
        assert spring == pytest.approx(300.0, rel=0.2)
        t = scene.start(*base_of(scene))
        found.append(scene.evidences(t, scene.linearised(t), [0.3, 0.03]).log_evidence)
    np.testing.assert_allclose(*found, rtol=1e-9)


@pytest.mark.parametrize("turns", [0.1, 10.0])
def test_a_random_torque_of_any_correlation_time_does_as_much_to_the_ringing(turns):
    """Its power spectral density at the joint's frequency is that of one of a radian."""
    truth = ARM + Spring("shoulder", 17.0) + Spring("elbow", 12.0)
    recording, _ = a_recording(truth, rate=2000.0)
    scene = Scene([recording], [ARM], [np.zeros(recording.angle.shape, bool)])
    t, densities = scene.start(*base_of(scene)), []
    for time in (1.0, turns):
        noise = scene.noise(dataclasses.replace(t, torque_time=time))
        decay, growth = noise.decay[0], noise.growth[0, 2 * scene.n + t.first.shape[1] :]
        step = scene.grid.time[1] - scene.grid.time[0]
        turn = np.exp(-1j * step * np.array([s.frequency for s in scene.scales]))
        densities.append(growth / np.abs(1.0 - decay * turn) ** 2)
    np.testing.assert_allclose(*densities, rtol=0.02)


def test_no_evidence_is_above_the_density_of_readings_without_a_residual():
    recording, _ = a_recording(ARM + Spring("shoulder", 30.0) + Spring("elbow", 8.0))
    scene = Scene([recording], [ARM], [np.zeros(recording.angle.shape, bool)])
    highest = scene.length * -np.log(1e-4 * np.sqrt(2 * np.pi))
    found = scene.possible(highest + np.array([-1.0, 1.0, np.inf, np.nan, -np.inf]))
    assert found[0] == highest - 1.0
    assert np.all(found[1:] == -np.inf)
