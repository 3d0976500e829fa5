"""What a test is worth before it is made: the expected fall of the entropy over models.

Models m with posterior p_m. Under m, the readings of a test, in units of the noise, are to first
order

    y = mean_m + A_m a + B_m b + e,        a, b, e ~ N(0, 1):

A_m holds what the recordings so far leave open of the model's numbers (slopes times the root of
their posterior covariance), B_m what is not known of the test itself (the state at release), e the
noise. So y given m is normal with covariance V_m = 1 + U_m U_m', U = [A B]. The information that
the test is expected to give is the fall of Shannon's entropy H (Lindley, Annals of Mathematical
Statistics 27, 1956; for models: Box and Hill, Technometrics 9, 1967),

    I = H(p) - sum over m of p_m E[ H(p(.|y)) | m ],        p(m'|y) ~ p_m' N(y; mean_m', V_m').

With two models of equal V it is an integral over one number: the log Bayes factor given m is normal
with mean d^2/2 and variance d^2, where d^2 = (mean_1 - mean_2)' V^-1 (mean_1 - mean_2) is the
squared separation after the rival has bent its numbers as far as it may. For more models it is a
mean over draws. They need few dimensions: all that tells the models apart lies in the span of the
columns U of all models and of the differences of their means, and noise beside it is common to all.

Tests that follow each other share a, and have a b each.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag
from scipy.special import entr, softmax

from .evidence import gram_factor

DRAWS = 400
"""Of the readings, for each model: the expected entropy of two models is then known to 0.02."""


class Predicted(NamedTuple):
    """What a model says of a test's N readings, in units of the noise."""

    mean: np.ndarray  # (N,)
    numbers: np.ndarray  # (N, P) by what is not known of its numbers, each scaled to a unit normal
    release: np.ndarray  # (N, S) by what is not known of the test, likewise


class Worth(NamedTuple):
    """What some tests together are expected to tell."""

    entropy: float  # nats, expected after them
    right: float
    """Expected probability of the likeliest model after them, which is the chance that it is the
    right one."""
    each: np.ndarray  # (M,) expected probability of each model, if it is the right one
    separation: float
    """Expected log Bayes factor of the right model against the others (Box and Hill's measure)."""
    variance: float  # expected, of a quantity; NaN if none was given


class Quantity(NamedTuple):
    """Something that is wanted of each model, linear in its numbers."""

    mean: np.ndarray  # (M,)
    slopes: Sequence[np.ndarray]  # (P,) of each model, in the units of `Predicted.numbers`
    rest: np.ndarray  # (M,) variance that no test reduces


def entropy(probability: np.ndarray) -> np.ndarray:
    """Shannon's, nats, over the last axis."""
    return entr(probability).sum(axis=-1)


def reduced(test: Sequence[Predicted]) -> list[Predicted]:
    """A test in as few dimensions as all its models need: the same for `worth`."""
    origin = test[0].mean
    columns = [np.column_stack([x.mean - origin, x.numbers, x.release]) for x in test]
    sizes = np.cumsum([c.shape[1] for c in columns])[:-1]
    together = np.concatenate(columns, axis=1)
    if len(together) > together.shape[1]:  # only lengths and angles between columns matter
        values, vectors = np.linalg.eigh(together.T @ together)
        together = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    found = []
    for own, like in zip(np.split(together, sizes, axis=1), test, strict=True):
        many = 1 + like.numbers.shape[1]
        found.append(Predicted(own[:, 0], own[:, 1:many], own[:, many:]))
    return found


def together(tests: Sequence[Sequence[Predicted]]) -> list[Predicted]:
    """Several tests as one: numbers are the same in all, releases are not."""
    return [
        Predicted(
            np.concatenate([x.mean for x in each]),
            np.concatenate([x.numbers for x in each]),
            np.asarray(block_diag(*(x.release for x in each))),
        )
        for each in zip(*tests, strict=True)
    ]


def worth(
    test: Sequence[Predicted],
    probability: ArrayLike,
    quantity: Quantity | None = None,
    draws: int = DRAWS,
) -> Worth:
    """What a test is expected to tell of models with these probabilities (M,).

    Exact for models that are linear in their numbers, but for the finite number of draws; these are
    the same for all tests.
    """
    test, p = reduced(test), np.asarray(probability, float)
    p = p / p.sum()
    rng, D = np.random.default_rng(0), len(test[0].mean)
    columns = [np.column_stack([x.numbers, x.release]) for x in test]
    inner = [np.eye(u.shape[1]) + u.T @ u for u in columns]
    factors = [gram_factor(x) for x in inner]
    halves = np.array([np.log(np.diag(f)).sum() for f in factors])
    noise = rng.standard_normal((draws // 2, D))
    noise = np.concatenate([noise, -noise])
    prior = np.log(np.maximum(p, 1e-300))[:, None]
    expected, each = np.zeros(3), np.zeros(len(p))
    variance = math.nan if quantity is None else 0.0
    for m, truth in enumerate(test):
        own = rng.standard_normal((draws // 2, columns[m].shape[1]))
        y = truth.mean + np.concatenate([own, -own]) @ columns[m].T + noise
        logs, values = np.zeros((2, len(p), draws))
        spreads = np.zeros((len(p), 1))
        for k, (model, u, factor) in enumerate(zip(test, columns, factors, strict=True)):
            left = y - model.mean
            t = np.linalg.solve(factor, u.T @ left.T)
            logs[k] = 0.5 * ((t**2).sum(0) - (left**2).sum(1)) - halves[k]
            if quantity is not None:
                g = np.zeros(u.shape[1])
                g[: len(quantity.slopes[k])] = quantity.slopes[k]
                by = np.linalg.solve(factor, g)
                values[k] = quantity.mean[k] + by @ t
                spreads[k] = by @ by + quantity.rest[k]
        weighted = logs + prior
        after = softmax(weighted, axis=0)
        told = 0.0
        if len(p) > 1 and p[m] < 1:
            others = np.logaddexp.reduce(np.delete(weighted, m, axis=0), axis=0)
            told = np.mean(logs[m] - others) + np.log(1 - p[m])
        each[m] = after[m].mean()
        expected += p[m] * np.array([entropy(after.T).mean(), after.max(axis=0).mean(), told])
        mean = (after * values).sum(0)
        variance += p[m] * float(np.mean((after * (values**2 + spreads)).sum(0) - mean**2))
    entropy_after, right, separation = map(float, expected)
    return Worth(entropy_after, right, each, separation, variance)
