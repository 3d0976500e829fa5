"""Draws from a fit's values and covariance, and what ArviZ is given of them."""

import dataclasses
import sys
import types

import numpy as np
import pytest

from residyn.fitting import MissingExtra
from residyn.fitting.result import gaussian
from tests import by_hand


@pytest.fixture(scope="module")
def fit():
    return by_hand.a_fit((by_hand.FOUND,))


def drawn_from(fit, draws):
    return gaussian(fit.numbers, fit.covariance, draws, 0)


def test_draws_have_the_fits_values_errors_and_correlations(fit):
    drawn = drawn_from(fit, 20000)
    assert list(drawn) == [n.name for n in fit.numbers]
    each = np.stack(list(drawn.values()))
    std = np.array([n.std for n in fit.numbers])
    values = np.array([n.value for n in fit.numbers])
    np.testing.assert_allclose(each.mean(axis=1), values, atol=4 * std.max() / 20000**0.5)
    np.testing.assert_allclose(each.std(axis=1), std, rtol=0.03)
    np.testing.assert_allclose(np.corrcoef(each), fit.correlation, atol=0.03)
    again = drawn_from(fit, 20000)
    assert all(np.array_equal(drawn[name], again[name]) for name in drawn)


def test_what_is_not_determined_is_not_drawn(fit):
    first = dataclasses.replace(fit.numbers[0], std=float("inf"), determined=False)
    spread = fit.spread._replace(blind=np.eye(len(fit.numbers))[:1], variance=np.ones(1))
    odd = dataclasses.replace(fit, numbers=(first, *fit.numbers[1:]), spread=spread)
    assert np.isnan(odd.covariance[0]).all()
    drawn = drawn_from(odd, 10)
    assert list(drawn) == [n.name for n in fit.numbers[1:]]
    assert all(np.isfinite(x).all() for x in drawn.values())
    nothing = tuple(dataclasses.replace(n, determined=False) for n in fit.numbers)
    with pytest.raises(ValueError, match="nothing to draw from"):
        drawn_from(dataclasses.replace(fit, numbers=nothing), 10)
    with pytest.raises(ValueError, match="draws = 0"):
        drawn_from(fit, 0)


@pytest.mark.parametrize("version", ["0.23.4", "1.3.0"])
def test_either_arviz_is_given_what_it_reads(fit, monkeypatch, version):
    """From 1.0 on, `from_dict` takes all groups in one mapping."""

    def from_dict(groups=None, posterior=None):
        assert (groups is None) == (version < "1")
        return posterior if groups is None else groups["posterior"]

    fake = types.SimpleNamespace(__version__=version, from_dict=from_dict)
    monkeypatch.setitem(sys.modules, "arviz", fake)
    assert {x.shape for x in fit.to_arviz(draws=7).values()} == {(1, 7)}


def test_without_arviz_one_line_says_what_to_install(fit, monkeypatch):
    monkeypatch.setitem(sys.modules, "arviz", None)
    with pytest.raises(MissingExtra, match=r"residyn\[bayes\]"):
        fit.to_arviz()


def test_arviz_summarises_it(fit):
    arviz = pytest.importorskip("arviz", reason="needs the extra bayes")
    table = arviz.summary(fit.to_arviz(4000), kind="stats", round_to="none")
    for n in fit.numbers:
        assert abs(float(table.loc[n.name, "mean"]) - n.value) < 5 * n.std / 4000**0.5
