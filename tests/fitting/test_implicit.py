"""`embed`: a fit inside other people's JAX programs. Recordings are made by MuJoCo (tests/rig)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn import AirBearing, PlanarArm, modes, without_bearings
from residyn.recordings.tables import ArmTable, InertiaTable
from tests import rig

ARM, SECONDS, NOISE = rig.paper_twin(0.3), 6.0, 1e-3
T = np.arange(round(SECONDS * 50)) / 50.0
BEARING = [AirBearing("wrist", 1.9635, 0.00245)]


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def experiment(shoulder=ARM.shoulder, elbow=ARM.elbow, coupling=ARM.coupling, angle=None, seed=0):
    truth, _ = rig.simulate(ARM, T, [0.2, -0.1])
    noise = NOISE * np.random.default_rng(seed).standard_normal(truth.shape)
    angle = truth + noise if angle is None else angle
    recording = residyn.Recording.from_arrays(T, angle, noise=NOISE, theta2=ARM.theta2)
    return residyn.Experiment(ArmTable((ARM.l1, ARM.l2), shoulder, elbow, coupling), (recording,))


@pytest.fixture(scope="module")
def fit():
    return residyn.fit(experiment(), starts=1)


@pytest.fixture(scope="module")
def embedded(fit):
    return residyn.embed(fit)


def numbers_of(fit):
    return np.array([n.value for n in fit.numbers])


def test_it_ends_where_the_fit_did(fit, embedded):
    found = embedded.solve()
    errors = np.array([n.std for n in fit.numbers])
    assert bool(found.converged)
    assert embedded.names == tuple(n.name for n in fit.numbers)
    # The fit takes the error of the integration off its numbers; this is the minimum of its steps.
    assert fit.integration_error < 0.1
    assert np.all(np.abs(found.numbers - numbers_of(fit)) < 0.05 * errors)
    inflation = max(1.0, fit.reduced_chi2)
    np.testing.assert_allclose(found.covariance * inflation, fit.covariance, rtol=1e-3, atol=1e-12)
    (predicted,) = embedded.readings(found.predicted)
    noise = fit.recordings[0].recording.noise.min()
    np.testing.assert_allclose(predicted, fit.recordings[0].predicted, atol=0.01 * noise)
    assert float(embedded.chi2(found.numbers, found.states)) == pytest.approx(float(found.chi2))
    # The minimum is one: a small step in any number makes it worse.
    for i, error in enumerate(errors):
        moved = found.numbers.at[i].add(0.1 * error)
        assert float(embedded.chi2(moved, found.states)) > float(found.chi2)


def test_it_takes_the_shortened_steps_of_a_fit():
    """A ringing cart, almost without noise."""
    t, noise = np.arange(500) / 50.0, 1e-8
    rate, turn = 1.0, 7.0
    angle = np.exp(-rate * t) * (np.cos(turn * t) + rate / turn * np.sin(turn * t))
    angle += noise * np.random.default_rng(0).standard_normal(len(t))
    recording = residyn.Recording.from_arrays(t, angle, noise=noise)
    table = InertiaTable(("cart",), ((2.0,),), ("m",))
    fit = residyn.fit(residyn.Experiment(table, (recording,)), starts=1)
    assert fit.shortened is not None
    off = numbers_of(fit) - np.asarray(residyn.embed(fit).solve().numbers)
    assert (np.abs(off) < 0.1 * np.array([n.std for n in fit.numbers])).all()


def test_other_readings_are_fitted_as_a_fit_of_their_own(embedded):
    other = experiment(seed=5).recordings[0].angle
    again = residyn.fit(experiment(angle=other), starts=1)
    found = embedded.with_angles(other).solve()
    errors = np.array([n.std for n in again.numbers])
    assert (np.abs(found.numbers - numbers_of(again)) < 0.02 * errors).all()


def test_a_lost_reading_does_not_count(embedded, fit):
    angle = np.array(fit.experiment.recordings[0].angle)
    spoilt = angle.copy()
    angle[40:60] = np.nan
    spoilt[40:60] = 7.0
    lost = embedded.with_angles(angle).solve()
    assert bool(lost.converged)
    assert float(lost.chi2) < float(embedded.solve().chi2)
    assert float(embedded.with_angles(spoilt).chi2(lost.numbers)) > 1e6
    with pytest.raises(ValueError, match="shape"):
        embedded.with_angles(angle[:-1])
    with pytest.raises(ValueError, match="2 arrays"):
        embedded.with_angles(angle, angle)


def test_bootstrap_fits_spread_as_the_covariance_says(embedded):
    rng = np.random.default_rng(1)
    found = embedded.solve()
    (clean,) = embedded.readings(found.predicted)
    angles = np.asarray(clean) + NOISE * rng.standard_normal((64, *clean.shape))
    out = jax.jit(jax.vmap(lambda q: embedded.with_angles(q).solve().numbers))(jnp.asarray(angles))
    one = embedded.with_angles(angles[3]).solve().numbers
    np.testing.assert_allclose(out[3], one, rtol=1e-6)
    spread = np.std(np.asarray(out), axis=0) / np.sqrt(np.diag(found.covariance))
    assert ((spread > 0.7) & (spread < 1.35)).all()  # 64 draws: 9 % of one standard deviation


def test_an_outer_loop_traces_once(embedded):
    traces = []

    @jax.jit
    def stiffness(angles, inertias):
        traces.append(1)
        arm = PlanarArm((ARM.l1, ARM.l2), *inertias, ARM.theta2)
        return embedded.with_angles(angles).with_mechanism(arm).solve().numbers[0]

    inertias = jnp.array([ARM.shoulder, ARM.elbow, ARM.coupling])
    base = experiment().recordings[0].angle
    values = [float(stiffness(base + 1e-4 * k, inertias * (1 + 0.01 * k))) for k in range(4)]
    assert len(traces) == 1
    assert len(set(values)) == 4


def orbital(embedded, inertias):
    """Natural frequencies, Hz, that a fit with these inertias predicts without the bearing."""
    arm = PlanarArm((ARM.l1, ARM.l2), *inertias, ARM.theta2)
    model = embedded.with_mechanism(arm).solve().model
    bare = without_bearings(arm, BEARING)
    return modes(eqx.tree_at(lambda m: m.mechanism, model, bare)).frequency_hz


@pytest.mark.slow
def test_derivatives_go_through_the_fit(embedded):
    inertias = jnp.array([ARM.shoulder, ARM.elbow, ARM.coupling])
    slopes = jax.jit(jax.jacfwd(lambda x: orbital(embedded, x)))(inertias)
    step = 2e-3

    def refitted(k, side):
        moved = np.array(inertias)
        moved[k] += side * step
        fit = residyn.fit(experiment(*moved), starts=1)
        arm = PlanarArm((ARM.l1, ARM.l2), *moved, ARM.theta2)
        bare = without_bearings(arm, BEARING)
        return modes(eqx.tree_at(lambda m: m.mechanism, fit.model, bare)).frequency_hz

    differences = np.stack([(refitted(k, 1) - refitted(k, -1)) / (2 * step) for k in range(3)], 1)
    np.testing.assert_allclose(slopes, differences, rtol=2e-3, atol=2e-3 * np.abs(slopes).max())
    # Inertias and stiffness scale together (Eq. 9): with the bearing on, nothing would change.
    assert np.abs(slopes).max() > 0.1


@pytest.mark.slow
def test_reverse_mode_is_the_same(embedded):
    angle = jnp.asarray(experiment().recordings[0].angle)

    def damping(q):
        return embedded.with_angles(q).solve().numbers[3]

    push = jnp.asarray(np.random.default_rng(2).standard_normal(angle.shape))
    _, forward = jax.jvp(damping, (angle,), (push,))
    backward = jnp.sum(jax.grad(damping)(angle) * push)
    assert float(backward) == pytest.approx(float(forward), rel=1e-6)
    h = 3e-4  # a third of the noise: a smaller step would be within what a descent leaves
    between = float(damping(angle + h * push) - damping(angle - h * push)) / (2 * h)
    assert float(forward) == pytest.approx(between, rel=2e-2)


def test_single_precision_is_refused(embedded, fit):
    start = embedded.solve().numbers
    with jax.enable_x64(False):
        for call in (
            lambda: residyn.embed(fit),
            embedded.solve,
            lambda: embedded.with_start(start),
            lambda: embedded.chi2(start),
            lambda: jax.jit(lambda e: e.solve().numbers)(embedded),
        ):
            with pytest.raises(ValueError, match="jax_enable_x64"):
                call()


def test_starts_and_bodies_of_another_shape_are_refused(embedded):
    numbers = embedded.solve().numbers
    arm = PlanarArm((ARM.l1, ARM.l2), [ARM.shoulder], ARM.elbow, ARM.coupling, ARM.theta2)
    for error, words, call in (
        (
            ValueError,
            r"numbers have shape \(3,\): must be",
            lambda: embedded.with_start(numbers[:3]),
        ),
        (ValueError, r"states have shape \(2,\)", lambda: embedded.with_start(numbers, [0.0, 0.0])),
        (ValueError, r"numbers have shape \(1,\)", lambda: embedded.chi2(numbers[:1])),
        (ValueError, "numbers of the PlanarArm have shapes", lambda: embedded.with_mechanism(arm)),
        (
            TypeError,
            "ConstantInertia: must be a PlanarArm",
            lambda: embedded.with_mechanism(residyn.ConstantInertia(np.eye(2))),
        ),
    ):
        with pytest.raises(error, match=words):
            call()


class ThreeLinks(residyn.AbstractMechanism):
    """Three equal links in a plane, point masses at their ends, angles from link to link.

    With absolute angles a, the kinetic energy is (1/2) m l^2 sum c_ij cos(a_i - a_j) a_i' a_j',
    c_ij = 3 - max(i, j); and a = S q with S lower triangular, all ones."""

    mass: float = 1.0
    length: float = 0.4
    joints: tuple[str, ...] = eqx.field(static=True, default=("base", "middle", "tip"))
    units: tuple[str, ...] | None = eqx.field(static=True, default=("rad",) * 3)

    def mass_matrix(self, q):
        a = (q[0], q[0] + q[1], q[0] + q[1] + q[2])
        size = self.mass * self.length**2
        each = [[(3 - max(i, j)) * jnp.cos(a[i] - a[j]) for j in range(3)] for i in range(3)]
        return tuple(
            tuple(
                size * sum(each[k][m] for k in range(i, 3) for m in range(j, 3)) for j in range(3)
            )
            for i in range(3)
        )


def test_three_links_of_the_users_own_swing_as_they_must():
    arm = ThreeLinks()
    model = residyn.Model(arm)
    for joint, k, c in zip(arm.joints, (30.0, 20.0, 10.0), (0.2, 0.1, 0.05), strict=True):
        model = model + residyn.Spring(joint, k) + residyn.Damper(joint, c)
    # An integrator and a mass matrix of its own: absolute angles, SciPy's eighth-order method.
    from scipy.integrate import solve_ivp

    shape = np.array([[3 - max(i, j) for j in range(3)] for i in range(3)]) * 0.16
    lower = np.tril(np.ones((3, 3)))
    back = np.linalg.inv(lower)

    def rates(t, y):
        a, w = y[:3], y[3:]
        q, v = back @ a, back @ w
        pull = back.T @ (np.array([30.0, 20.0, 10.0]) * q + np.array([0.2, 0.1, 0.05]) * v)
        apart = a[:, None] - a[None, :]
        swirl = (shape * np.sin(apart)) @ w**2
        return np.concatenate([w, np.linalg.solve(shape * np.cos(apart), -pull - swirl)])

    q0 = np.array([0.3, -0.2, 0.25])
    t = np.arange(301) / 50.0
    out = solve_ivp(
        rates, (0, t[-1]), [*(lower @ q0), 0, 0, 0], "DOP853", t, rtol=1e-10, atol=1e-12
    )
    truth = (back @ out.y[:3]).T
    q = np.asarray(residyn.simulate(model, t, q0).q)
    np.testing.assert_allclose(q, truth, atol=2e-5)


class RodOnCart(residyn.AbstractMechanism):
    """A cart, and a point mass on a rod that a joint spring holds upright."""

    joints: tuple[str, ...] = eqx.field(static=True, default=("cart", "rod"))
    units: tuple[str, ...] | None = eqx.field(static=True, default=("m", "rad"))

    def mass_matrix(self, q):
        off = 0.15 * jnp.cos(q[1])
        return (2.5, off), (off, 0.045)


def test_a_mechanism_of_the_users_own_is_fitted():
    from scipy.integrate import solve_ivp

    def rates(t, y):
        matrix = np.array([[2.5, 0.15 * np.cos(y[1])], [0.15 * np.cos(y[1]), 0.045]])
        pull = np.array([100.0 * y[0] + 0.5 * y[2], 2.0 * y[1] + 0.01 * y[3]])
        pull[0] -= 0.15 * np.sin(y[1]) * y[3] ** 2
        return np.concatenate([y[2:], np.linalg.solve(matrix, -pull)])

    t = np.arange(301) / 50.0
    out = solve_ivp(rates, (0, t[-1]), [0.1, 0.5, 0, 0], "DOP853", t, rtol=1e-10, atol=1e-12)
    noise = 1e-3 * np.random.default_rng(0).standard_normal((len(t), 2))
    recording = residyn.Recording.from_arrays(t, out.y[:2].T + noise, noise=1e-3)
    found = residyn.fit(residyn.Experiment(RodOnCart(), (recording,)), starts=1)
    values = {n.name: (n.value, n.std, n.unit) for n in found.numbers}
    for name, truth in (("spring:cart.stiffness", 100.0), ("spring:rod.stiffness", 2.0)):
        value, std, unit = values[name]
        assert abs(value - truth) < 4 * std < 0.01 * truth
        assert unit == ("N/m" if "cart" in name else "N m/rad")
    assert 0.8 < found.reduced_chi2 < 1.2


def test_the_vector_field_runs_in_an_integrator_of_the_users_own(fit):
    import diffrax

    q0 = jnp.array([0.2, -0.1])
    solution = diffrax.diffeqsolve(
        diffrax.ODETerm(lambda t, y, args: fit.model.vector_field(t, y, args)),
        diffrax.Tsit5(),
        0.0,
        3.0,
        0.01,
        (q0, jnp.zeros(2)),
        stepsize_controller=diffrax.PIDController(rtol=1e-9, atol=1e-11),
        saveat=diffrax.SaveAt(ts=jnp.linspace(0.0, 3.0, 50)),
    )
    own = residyn.simulate(fit.model, jnp.linspace(0.0, 3.0, 50), q0).q
    np.testing.assert_allclose(solution.ys[0], own, atol=2e-6)
