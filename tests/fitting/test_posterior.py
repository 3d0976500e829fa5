"""An embedded fit as the likelihood of a NumPyro model, sampled beside its covariance."""

import jax
import numpy as np
import pytest

import residyn
from residyn.recordings.tables import ArmTable
from tests import rig

numpyro = pytest.importorskip("numpyro", reason="needs the extra bayes")

from numpyro import distributions as dist  # noqa: E402
from numpyro.diagnostics import effective_sample_size  # noqa: E402
from numpyro.infer import MCMC, NUTS, init_to_value  # noqa: E402

# Drag, not Coulomb friction: c v|v| has a slope everywhere, so that a leapfrog step keeps its
# energy. A joint that sticks or not puts kinks into chi-square.
ARM, NOISE, DRAG = rig.paper_twin(0.3), 1e-3, 0.08  # rad; N m s^2/rad^2
T = np.arange(200) / 50.0  # s
DRAWS = 600


pytestmark = pytest.mark.usefixtures("float64", "compiled_in_less_time")


def dragging(t, q, v):
    return np.array([0.0, -DRAG * v[1] * abs(v[1])])


@pytest.fixture(scope="module")
def embedded():
    truth, _ = rig.simulate(ARM, T, [0.2, -0.3], torque=dragging)
    noise = NOISE * np.random.default_rng(4).standard_normal(truth.shape)
    recording = residyn.Recording.from_arrays(T, truth + noise, noise=NOISE, theta2=ARM.theta2)
    table = ArmTable((ARM.l1, ARM.l2), ARM.shoulder, ARM.elbow, ARM.coupling)
    experiment = residyn.Experiment(table, (recording,))
    return residyn.embed(residyn.fit(experiment, effects=["quadratic_drag:elbow"], starts=1))


@pytest.fixture(scope="module")
def solution(embedded):
    return embedded.solve()


def test_numbers_and_states_vary_together_as_the_numbers_alone_do(embedded, solution):
    whole = np.asarray(embedded.covariance(solution.numbers, solution.states))
    p = len(embedded.names)
    assert whole.shape == (p + 4, p + 4)
    np.testing.assert_allclose(whole[:p, :p], solution.covariance, rtol=1e-6)
    # Chi-square rises by one where any unknown is off by its error and the others follow.
    for row, variance in zip(whole, np.diag(whole), strict=True):
        off = row / np.sqrt(variance)
        for side in (1, -1):
            numbers = solution.numbers + side * off[:p]
            states = solution.states + side * off[p:].reshape(1, 4)
            rise = embedded.chi2(numbers, states) - solution.chi2
            assert float(rise) == pytest.approx(1.0, rel=0.05)


def test_the_posterior_is_as_wide_as_the_covariance_says(embedded, solution):
    centre = {"numbers": solution.numbers, "states": solution.states}

    def posterior():
        # Flat in the numbers, and in the initial state, which nobody measured either.
        flat = {
            name: numpyro.sample(name, dist.ImproperUniform(dist.constraints.real, (), x.shape))
            for name, x in centre.items()
        }
        numpyro.factor("readings", -0.5 * embedded.chi2(**flat))

    kernel = NUTS(
        posterior,
        init_strategy=init_to_value(values=centre),
        inverse_mass_matrix={tuple(centre): embedded.covariance(**centre)},
        dense_mass=[tuple(centre)],
        adapt_mass_matrix=False,  # nothing is left to adapt but the step
    )
    sampler = MCMC(kernel, num_warmup=100, num_samples=DRAWS, progress_bar=False)
    sampler.run(jax.random.key(0))
    assert not sampler.get_extra_fields()["diverging"].any()
    std = np.sqrt(np.diag(solution.covariance))
    off = (np.asarray(sampler.get_samples()["numbers"]) - np.asarray(solution.numbers)) / std
    # Four standard errors, for as many independent draws as these amount to: of the mean, and,
    # through the squares, of the spread. Then what the posterior may differ from a Gaussian.
    many, squares = (effective_sample_size(x[None]) for x in (off, off**2))
    assert many.min() > 0.25 * DRAWS
    assert (np.abs(off.mean(axis=0)) < 4 / np.sqrt(many) + 0.05).all()
    assert (np.abs(off.std(axis=0) - 1) < 4 / np.sqrt(2 * squares) + 0.02).all()
    # Correlations too: the damper and the drag share what the decay says.
    expected = solution.covariance / std / std[:, None]
    assert np.abs(expected - np.eye(len(std))).max() > 0.5
    np.testing.assert_allclose(np.corrcoef(off.T), expected, atol=4 / np.sqrt(squares.min()))
