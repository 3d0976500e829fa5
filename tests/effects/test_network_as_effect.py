"""An effect may hold a network: it simulates, trains beside physics, and is fitted around.

Recordings are made by MuJoCo (tests/rig), with a stiffening elbow that the physical model lacks."""

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import residyn
from residyn import Damper, PlanarArm, Spring, param, simulate, steps_for
from residyn.physics.parameter import RATIO
from residyn.recordings.tables import ArmTable
from tests import rig

ARM, NOISE, CUBIC = rig.paper_twin(0.3), 1e-3, 150.0  # rad; N m/rad^3
T = np.arange(50) / 50.0  # s
STARTS = np.array([[0.2, -0.2], [-0.2, 0.2], [0.1, 0.25], [0.25, 0.05]])  # rad
BODIES = PlanarArm((ARM.l1, ARM.l2), ARM.shoulder, ARM.elbow, ARM.coupling, ARM.theta2)


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


class NetworkTorque(residyn.JointEffect):
    """A torque that a network draws from the angle, N m."""

    name = "network_torque"
    network: eqx.nn.MLP
    share: float = param("share of what the network says", RATIO, default=1.0)

    def joint_torque(self, motion):
        return self.share * self.network(motion.q / 0.1)


def network(seed=0, activation=jnp.tanh):
    key = jax.random.PRNGKey(seed)
    return eqx.nn.MLP("scalar", "scalar", 16, 1, activation, key=key)


def springs_and_dampers():
    model = residyn.Model(BODIES)
    for joint, k, c in zip(BODIES.joints, ARM.stiffness, ARM.damping, strict=True):
        model = model + Spring(joint, k) + Damper(joint, c)
    return model


def at_elbow(effect, q):
    """Its torque at these angles, N m."""
    motions = jax.vmap(lambda q: residyn.Motion.at(0.0, [0.0, q], [0.0, 0.0]))(q)
    return np.asarray(jax.vmap(lambda m: effect.torque(m, BODIES)[1])(motions))


# -- simulation ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("friction", "adjoint"), [(0.0, diffrax.RecursiveCheckpointAdjoint()), (0.05, None)]
)
def test_a_network_moves_the_arm_as_its_torque_written_out_does(friction, adjoint):
    net, base = network(), springs_and_dampers()
    if friction:
        base = base + residyn.CoulombFriction("elbow", friction)

    class WrittenOut(residyn.JointEffect):
        name = "written_out"

        def joint_torque(self, motion):
            inner, outer = net.layers
            hidden = jnp.tanh(inner.weight[:, 0] * motion.q / 0.1 + inner.bias)
            return outer.weight[0] @ hidden + outer.bias[0]

    effects = NetworkTorque("elbow", net), WrittenOut("elbow")
    one, other = (simulate(base + e, T, STARTS[0], adjoint=adjoint).q for e in effects)
    np.testing.assert_allclose(one, other, atol=1e-12)
    silent = simulate(base + NetworkTorque("elbow", net, 0.0), T, STARTS[0], adjoint=adjoint).q
    assert np.abs(one - silent).max() > 1e-2


def test_other_weights_are_not_traced_again():
    traces = []

    def activation(x):
        traces.append(1)
        return jnp.tanh(x)

    base = springs_and_dampers()
    motions, counts = [], []
    for seed in range(3):
        effect = NetworkTorque("elbow", network(seed, activation))
        motions.append(simulate(base + effect, T, STARTS[0], steps=40).q[-1])
        counts.append(len(traces))
    assert counts[0] > 0
    assert counts == counts[:1] * 3
    assert len({float(q[1]) for q in motions}) == 3


# -- training --------------------------------------------------------------------------------


def stiffening(t, q, v):
    return np.array([0.0, -CUBIC * q[1] ** 3])


def test_a_network_learns_the_torque_that_the_model_lacks():
    optax = pytest.importorskip("optax", reason="comes with the extra ga")
    base, random = springs_and_dampers(), np.random.default_rng(0)
    truth = np.stack([rig.simulate(ARM, T, q0, torque=stiffening)[0] for q0 in STARTS])
    readings = truth + NOISE * random.standard_normal(truth.shape)
    steps = steps_for(base + residyn.CubicStiffness("elbow", CUBIC), T[-1])
    count, traces = 1500, []

    def chi2(effect):
        """Mean of squared residuals in units of the noise."""
        traces.append(1)
        q = jax.vmap(lambda q0: simulate(base + effect, T, q0, steps=steps).q)(STARTS)
        return jnp.mean(((q - readings) / NOISE) ** 2)

    optimiser = optax.adam(optax.cosine_decay_schedule(0.1, count), b2=0.99)

    @eqx.filter_jit
    def advance(effect, state):
        loss, slope = eqx.filter_value_and_grad(chi2)(effect)
        change, state = optimiser.update(slope, state)
        return eqx.apply_updates(effect, change), state, loss

    effect = NetworkTorque("elbow", network())
    state, losses = optimiser.init(eqx.filter(effect, eqx.is_array)), []
    for _ in range(count):
        effect, state, loss = advance(effect, state)
        losses.append(float(loss))
    assert len(traces) == 1
    # Down to the noise: 1, to within three standard deviations of a mean over so many readings.
    assert losses[-1] < 1 + 3 * np.sqrt(2 / readings.size)
    assert losses[-1] < losses[0] / 500
    # A torque of a reading's noise times the stiffness moves the elbow, slowly, by that noise: so
    # well does each reading know it.
    q = truth[..., 1].ravel()
    apart = at_elbow(effect, q) - CUBIC * q**3
    known = NOISE * ARM.stiffness[1]  # 0.017 N m; the torque to be learnt is 0.59 N m rms
    assert np.sqrt(np.mean(apart**2)) < 3 * known
    # And no single angle that the readings dwell on is far off.
    dwelt = np.abs(q) < np.quantile(np.abs(q), 0.95)
    assert np.abs(apart[dwelt]).max() < 10 * known


# -- fits ------------------------------------------------------------------------------------


def test_springs_and_dampers_are_fitted_beside_a_network():
    t = np.arange(250) / 50.0
    effect = NetworkTorque("elbow", network())
    model = springs_and_dampers() + effect
    recordings = []
    for i, q0 in enumerate(STARTS[:2]):
        q = np.asarray(simulate(model, t, q0).q)
        q = q + NOISE * np.random.default_rng(i).standard_normal(q.shape)
        recordings.append(residyn.Recording.from_arrays(t, q, noise=NOISE, theta2=ARM.theta2))
    table = ArmTable((ARM.l1, ARM.l2), ARM.shoulder, ARM.elbow, ARM.coupling)
    experiment = residyn.Experiment(table, tuple(recordings))
    fit = residyn.fit(experiment, effects=[effect], starts=1)
    truth = dict(zip(model.values(), map(float, model.values().values()), strict=True))
    assert 0.8 < fit.reduced_chi2 < 1.2
    for n in fit.numbers:
        assert abs(n.value - truth[n.name]) < 4 * n.std
    embedded = residyn.embed(fit)
    numbers = np.array([n.value for n in fit.numbers])
    std = np.array([n.std for n in fit.numbers])
    for again in (embedded, embedded.with_mechanism(BODIES)):
        np.testing.assert_allclose((again.solve().numbers - numbers) / std, 0.0, atol=1e-2)
    drawn = residyn.bootstrap(fit, 4, batch=4)
    assert drawn.converged.all()
    assert (np.abs(drawn.numbers - numbers) < 5 * std).all()
