"""What a test is worth, against closed forms."""

import numpy as np
import pytest
from numpy.polynomial.hermite_e import hermegauss

from residyn.diagnosis.experiment_design import (
    Predicted,
    Quantity,
    entropy,
    reduced,
    together,
    worth,
)

MANY = 20_000


def fixed(*values):
    """A model that leaves nothing open."""
    mean = np.array(values, float)
    return Predicted(mean, np.zeros((len(mean), 0)), np.zeros((len(mean), 0)))


def two_models(d, p):
    """Expected entropy and chance of being right of two models d noises apart, by quadrature."""
    x, w = hermegauss(200)
    w = w / w.sum()
    total = chance = 0.0
    for own, other in ((p, 1 - p), (1 - p, p)):
        factor = d**2 / 2 + d * x  # log Bayes factor for the right one
        right = own / (own + other * np.exp(-factor))
        total += own * w @ entropy(np.stack([right, 1 - right], 1))
        chance += own * w @ np.maximum(right, 1 - right)
    return total, chance


@pytest.mark.parametrize("d", [0.3, 1.0, 3.0])
@pytest.mark.parametrize("p", [0.5, 0.9])
def test_two_models_that_leave_nothing_open(d, p):
    direction = np.array([0.6, 0.8])
    found = worth([fixed(0, 0), fixed(*(d * direction))], [p, 1 - p], draws=MANY)
    total, chance = two_models(d, p)
    assert found.entropy == pytest.approx(total, abs=0.005)
    assert found.right == pytest.approx(chance, abs=0.005)
    assert found.separation == pytest.approx(d**2 / 2, abs=0.05)  # Box and Hill's measure


def test_what_a_number_may_bend_tells_nothing():
    """Both have one number, not known at all, along the first reading: only the second counts."""
    along = np.array([[1e4], [0.0]])
    models = [Predicted(np.array(x), along, np.zeros((2, 0))) for x in ([0.0, 0.0], [50.0, 1.5])]
    found = worth(models, [0.5, 0.5], draws=MANY)
    assert found.entropy == pytest.approx(two_models(1.5, 0.5)[0], abs=0.01)


def test_half_known_number():
    """Along a number known to s the separation is (d^2 / (1 + s^2))^(1/2)."""
    along = np.array([[2.0]])
    models = [Predicted(np.array([x]), along, np.zeros((1, 0))) for x in (0.0, 3.0)]
    expected = two_models(3.0 / np.sqrt(5.0), 0.5)[0]
    assert worth(models, [0.5, 0.5], draws=MANY).entropy == pytest.approx(expected, abs=0.005)


def test_models_that_say_the_same_stay():
    p = np.array([0.2, 0.3, 0.5])
    found = worth([fixed(1, 2)] * 3, p)
    assert found.entropy == pytest.approx(entropy(p), abs=1e-12)
    assert found.right == pytest.approx(0.5)


def test_models_far_apart_are_told():
    found = worth([fixed(0), fixed(50), fixed(100)], [0.2, 0.3, 0.5])
    assert found.entropy < 1e-6
    np.testing.assert_allclose(found.each, 1.0)


def test_a_model_that_leaves_more_open_is_told_by_its_spread():
    """Equal means, variances 1 and 1 + s^2: expected entropy by quadrature over the reading."""
    s = 4.0
    models = [fixed(0.0), Predicted(np.zeros(1), np.array([[s]]), np.zeros((1, 0)))]
    y = np.linspace(-60, 60, 200_001)
    each = [np.exp(-(y**2) / 2 / v) / np.sqrt(2 * np.pi * v) for v in (1, 1 + s**2)]
    after = np.stack(each, 1) / np.sum(each, axis=0)[:, None]
    expected = np.trapezoid(0.5 * np.sum(each, axis=0) * entropy(after), y)
    found = worth(models, [0.5, 0.5], draws=MANY)
    assert found.entropy == pytest.approx(expected, abs=0.01)


def a_test(rng, readings=40):
    """Three models with two numbers each, and a release of one unknown."""
    return [
        Predicted(*(rng.normal(size=(readings, *shape)) / 4 for shape in ((), (2,), (1,))))
        for _ in range(3)
    ]


def test_fewer_dimensions_change_nothing():
    test = a_test(np.random.default_rng(1))
    small = reduced(test)
    assert len(small[0].mean) == 12
    for a, b in ((0, 1), (1, 2)):
        full, less = (
            np.column_stack([t[a].mean - t[b].mean, t[a].numbers, t[b].release])
            for t in (test, small)
        )
        np.testing.assert_allclose(less.T @ less, full.T @ full, atol=1e-12)


def test_tests_made_one_after_the_other():
    """Two tests of one number are one test of both readings; a second release is another one."""
    one, two = (
        [Predicted(np.array([m]), np.array([[a]]), np.array([[1.0]])) for m, a in each]
        for each in (((0, 1), (2, 1)), ((0, 2), (1, 2)))
    )
    both = together([one, two])
    assert both[1].mean.tolist() == [2, 1]
    assert both[0].numbers.tolist() == [[1], [2]]
    assert both[0].release.tolist() == [[1, 0], [0, 1]]
    p = [0.5, 0.5]
    assert worth(both, p).entropy < min(worth(one, p).entropy, worth(two, p).entropy)


def test_variance_of_a_quantity():
    """One model: Kalman's formula. Two far apart: which one it is becomes known."""
    numbers = np.array([[2.0, 0.0], [1.0, 1.0]])
    model = Predicted(np.zeros(2), numbers, np.zeros((2, 0)))
    wanted = Quantity(np.array([3.0]), [np.array([1.0, -1.0])], np.array([0.25]))
    inverse = np.linalg.inv(np.eye(2) + numbers.T @ numbers)
    expected = wanted.slopes[0] @ inverse @ wanted.slopes[0] + 0.25
    assert worth([model], [1.0], wanted).variance == pytest.approx(expected)

    none = [np.zeros(0)] * 2
    wanted = Quantity(np.array([0.0, 2.0]), none, np.array([0.1, 0.3]))
    p = np.array([0.5, 0.5])
    assert worth([fixed(0), fixed(50)], p, wanted).variance == pytest.approx(0.2)
    assert worth([fixed(0), fixed(0)], p, wanted).variance == pytest.approx(1.2)
