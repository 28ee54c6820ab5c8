"""Statistics of returns, against closed forms and scipy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy import stats

from chemlab.agents.evaluation.statistics import (
    Estimate,
    interquartile_mean,
    mean,
    paired_improvement,
    probability_of_improvement,
)

RNG = np.random.default_rng(7)


@pytest.fixture(autouse=True)
def _no_warnings() -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


def test_mean_weighs_strata_equally() -> None:
    """Goals count the same, however many episodes each has."""
    assert mean([[0.0, 2.0], [5.0] * 10]).value == pytest.approx(3.0)


def test_mean_interval_is_students_for_normal_samples() -> None:
    """The bootstrap of a mean converges on mean +- z s / sqrt(n)."""
    sample = RNG.normal(3.0, 2.0, 400)
    found = mean([sample], resamples=8000)
    half = stats.norm.ppf(0.975) * sample.std(ddof=1) / np.sqrt(sample.size)
    assert found.low == pytest.approx(sample.mean() - half, abs=0.1 * half)
    assert found.high == pytest.approx(sample.mean() + half, abs=0.1 * half)


def test_resampling_stays_within_strata() -> None:
    """What differs between goals alone has no sampling error; within them, variances add up as (s1^2 + s2^2) / 4."""
    assert mean([np.zeros(20), np.full(20, 9.0)]) == Estimate(4.5, 4.5, 4.5)
    a, b = RNG.normal(0.0, 1.0, 300), RNG.normal(50.0, 2.0, 300)
    found = mean([a, b], resamples=8000)
    half = stats.norm.ppf(0.975) * np.sqrt((a.var(ddof=1) + b.var(ddof=1)) / 300) / 2.0
    assert (found.high - found.low) / 2.0 == pytest.approx(half, rel=0.1)


def test_confidence_sets_the_width() -> None:
    sample = RNG.normal(size=300)
    narrow, wide = mean([sample], confidence=0.5), mean([sample], confidence=0.99)
    ratio = stats.norm.ppf(0.995) / stats.norm.ppf(0.75)
    assert (wide.high - wide.low) / (narrow.high - narrow.low) == pytest.approx(ratio, rel=0.15)


def test_interquartile_mean_drops_a_quarter_at_each_end() -> None:
    """Of 1..8 the middle four remain; an outlier changes nothing; samples of all strata are pooled."""
    assert interquartile_mean([[1, 2, 3, 4], [5, 6, 7, 8e6]]).value == pytest.approx((3 + 4 + 5 + 6) / 4)
    assert interquartile_mean([[1.0, 2.0, 10.0]]).value == pytest.approx(13.0 / 3.0)  # a quarter of 3, rounded down


def test_paired_improvement_counts_ties_as_halves() -> None:
    """Two gains, a loss and a tie (rounding included) are (2 + 1/2) / 4."""
    found = paired_improvement([[1.0, 2.0], [0.0, 5.0 + 1e-13]], [[0.0, 1.0], [1.0, 5.0]])
    assert found.value == pytest.approx(2.5 / 4)
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0
    assert paired_improvement([[1.0, 2.0]], [[1.0, 2.0]]) == Estimate(0.5, 0.5, 0.5)


def test_probability_of_improvement_is_mann_whitneys() -> None:
    """Mean over goals of U / (n m), with ties."""
    x, y = RNG.integers(0, 6, (3, 9)).astype(float), RNG.integers(0, 5, (3, 7)).astype(float)
    expected = np.mean([stats.mannwhitneyu(a, b).statistic / (9 * 7) for a, b in zip(x, y, strict=True)])
    assert probability_of_improvement(list(x), list(y)).value == pytest.approx(expected)


def test_probability_of_improvement_of_normal_samples() -> None:
    """P(X > Y) of unit normals one apart is Phi(1 / sqrt 2); a baseline of one number is allowed."""
    found = probability_of_improvement([RNG.normal(1.0, 1.0, 300)], [RNG.normal(0.0, 1.0, 300)], resamples=500)
    assert found.low < stats.norm.cdf(1.0 / np.sqrt(2.0)) < found.high
    single = probability_of_improvement([[1.0, 2.0, 3.0, 4.0]], [[2.5]])
    assert single.value == 0.5
    assert single.low < 0.5 < single.high


def test_constant_samples_have_an_interval_of_no_width_and_single_ones_none() -> None:
    sample = [4.0, 4.0, 4.0]
    assert mean([sample]) == interquartile_mean([sample]) == Estimate(4.0, 4.0, 4.0)
    assert mean([[4.0], [2.0]]) == Estimate(3.0, None, None)
    assert str(mean([[4.0], [2.0]])) == "3.000"


@pytest.mark.parametrize("sample", [[0.0, 1.0], [0.0, 0.0, 1.0], [1.0] * 9 + [2.0]])
def test_few_and_lopsided_samples_have_finite_intervals(sample: list[float]) -> None:
    for found in (mean([sample]), interquartile_mean([sample])):
        assert min(sample) <= found.low <= found.high <= max(sample)


def test_same_seed_same_interval() -> None:
    sample = RNG.normal(size=50)
    assert mean([sample], seed=3) == mean([sample], seed=3)
    assert mean([sample], seed=3) != mean([sample], seed=4)


def test_mistakes_are_refused() -> None:
    for wrong in ([], [[]], [[1.0], []], [[np.nan]]):
        with pytest.raises(ValueError, match="statistics"):
            mean(wrong)
    with pytest.raises(ValueError, match="paired samples"):
        paired_improvement([[1.0]], [[1.0, 2.0]])
    with pytest.raises(ValueError, match="strata"):
        probability_of_improvement([[1.0]], [[1.0], [2.0]])
