"""Statistics of returns, against closed forms and scipy."""

import itertools
import warnings

import numpy as np
import pytest
from helpers import refused
from scipy import stats

from chemlab.agents.evaluate.statistics import (
    Estimate,
    interquartile_mean,
    jackknife,
    mean,
    paired_improvement,
    performance_profile,
    probability_of_improvement,
)

RNG = np.random.default_rng(7)


@pytest.fixture(autouse=True)
def _no_warnings() -> object:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize("n", [2, 3, 5, 10, 200])
def test_mean_interval_is_students(n: int) -> None:
    """SciPy's one-sample t test has it; of two strata, half of Welch's of a sum, however many episodes each has."""
    a, b = RNG.normal(3.0, 2.0, n), RNG.normal(50.0, 0.5, n + 3)
    found, one = mean([a]), stats.ttest_1samp(a, 0.0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((one.low, one.high), rel=1e-12)
    found, two = mean([a, b]), stats.ttest_ind(a, -b, equal_var=False).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((two.low / 2.0, two.high / 2.0), rel=1e-12)
    assert found.value == pytest.approx((a.mean() + b.mean()) / 2.0, rel=1e-12)


def test_samples_of_one_run_are_one_sample() -> None:
    """Goals of one run rise and fall together: their mean varies as each does, not less, and is all that is drawn."""
    runs = RNG.normal(0.5, 0.1, 6)
    goals = [runs, runs + 1.0, runs - 1.0]
    one = stats.ttest_1samp(runs, 0.0).confidence_interval(0.95)
    found = mean(goals, together=True)
    assert (found.value, found.low, found.high) == pytest.approx((runs.mean(), one.low, one.high), rel=1e-12)
    apart = mean(goals)
    assert apart.high - apart.low < 0.7 * (found.high - found.low)
    beside = [np.full(6, 0.5), np.full(6, 1.5), np.full(6, -0.5)]
    single = paired_improvement(goals[:1], beside[:1])
    assert paired_improvement(goals, beside, together=True) == single
    narrow = paired_improvement(goals, beside)
    assert narrow.high - narrow.low < 0.8 * (single.high - single.low)


def test_a_stratum_of_one_sample_has_no_interval() -> None:
    """It is not certain, however many samples the others have."""
    for one in (mean, interquartile_mean):
        assert one([[0.5], [0.1, 0.2, 0.3]]).low is None
        assert one([[4.0], [2.0]]) == Estimate(3.0, None, None)
    assert str(mean([[4.0], [2.0]])) == "3.000"
    assert paired_improvement([[1.0], [0.0, 1.0]], [[0.5], [0.5, 0.5]]).high is None
    assert probability_of_improvement([[1.0, 2.0]], [[1.5]]) == Estimate(0.5, None, None)
    # What differs between goals alone has no sampling error; equal samples have an interval of no width.
    assert mean([np.zeros(20), np.full(20, 9.0)]) == Estimate(4.5, 4.5, 4.5)
    assert mean([[4.0, 4.0, 4.0]]) == interquartile_mean([[4.0, 4.0, 4.0]]) == Estimate(4.0, 4.0, 4.0)


def test_interquartile_mean_drops_a_quarter_at_each_end() -> None:
    """Of 1..8 the middle four remain; an outlier changes nothing; samples of all strata are pooled."""
    assert interquartile_mean([[1, 2, 3, 4], [5, 6, 7, 8e6]]).value == pytest.approx((3 + 4 + 5 + 6) / 4)
    assert interquartile_mean([[1.0, 2.0, 10.0]]).value == pytest.approx(13.0 / 3.0)  # a quarter of 3, rounded down


@pytest.mark.parametrize("n", [4, 5, 10, 19, 40])
def test_interval_of_an_interquartile_mean_is_tukey_and_mclaughlins(n: int) -> None:
    """As SciPy's mstats has it: winsorized deviations, and as many degrees of freedom as values are left, less one."""
    sample = RNG.normal(3.0, 2.0, n)
    found = interquartile_mean([sample])
    expected = stats.mstats.trimmed_mean_ci(sample, limits=[n // 4 / n + 1e-12] * 2, alpha=0.05)
    assert (found.low, found.high) == pytest.approx(tuple(expected), rel=1e-8)


def test_paired_improvement_counts_ties_as_halves() -> None:
    """Two gains, a loss and a tie (rounding included) are (2 + 1/2) / 4."""
    found = paired_improvement([[1.0, 2.0], [0.0, 5.0 + 1e-13]], [[0.0, 1.0], [1.0, 5.0]])
    assert found.value == pytest.approx(2.5 / 4)
    assert 0.0 <= found.low <= found.value <= found.high <= 1.0


@pytest.mark.parametrize(("wins", "n"), [(0, 3), (3, 3), (1, 5), (7, 10), (60, 100)])
def test_interval_of_a_share_is_wilsons(wins: int, n: int) -> None:
    """SciPy's; strata of one share are one sample of all of them. Where all win, the interval has a width."""
    won = (np.arange(n) < wins).astype(float)
    half = np.full(n, 0.5)
    for k in (1, 4):
        expected = stats.binomtest(k * wins, k * n).proportion_ci(0.95, method="wilson")
        found = paired_improvement([won] * k, [half] * k)
        assert (found.low, found.high) == pytest.approx((expected.low, expected.high), abs=1e-9)
        (profile,) = performance_profile([won] * k, [0.5])
        assert profile == found


def test_probability_of_improvement_is_mann_whitneys() -> None:
    """Mean over goals of U / (n m), with ties."""
    x, y = RNG.integers(0, 6, (3, 9)).astype(float), RNG.integers(0, 5, (3, 7)).astype(float)
    expected = np.mean([stats.mannwhitneyu(a, b).statistic / (9 * 7) for a, b in zip(x, y, strict=True)])
    assert probability_of_improvement(list(x), list(y)).value == pytest.approx(expected)


def test_few_and_lopsided_samples_have_finite_intervals() -> None:
    for sample, of in itertools.product(([0.0, 1.0], [0.0, 0.0, 1.0], [1.0] * 9 + [2.0]), (mean, interquartile_mean)):
        found = of([sample])
        assert np.isfinite([found.low, found.high]).all()
        assert found.low <= found.value <= found.high


@pytest.mark.parametrize(("n", "k"), [(3, 1), (3, 8), (10, 8), (20, 1)])
def test_intervals_contain_the_true_value_as_often_as_they_say(n: int, k: int) -> None:
    """Normal samples whose true values are known; the binomial distribution of SciPy judges the count (p > 1e-4).

    More than 95 % is no fault of score intervals of few samples; interval_coverage.py in studies/speed measures all.
    """
    rng, tries = np.random.default_rng(11), 400
    above = float(stats.norm.cdf(1.0 / np.sqrt(2.0)))
    inside = dict.fromkeys(("mean", "iqm", "unpaired", "paired"), 0)
    for _ in range(tries):
        x, y = rng.normal(1.0, 1.0, (k, n)), rng.normal(0.0, 1.0, (k, n))
        for name, found, true in (
            ("mean", mean(list(x)), 1.0),
            ("iqm", interquartile_mean(list(x)), 1.0),
            ("unpaired", probability_of_improvement(list(x), list(y)), above),
            ("paired", paired_improvement(list(x), list(y)), above),
        ):
            inside[name] += found.low <= true <= found.high
    for name, count in inside.items():
        assert stats.binomtest(count, tries, 0.95, alternative="less").pvalue > 1e-4, (name, count / tries)
    assert stats.binomtest(inside["mean"], tries, 0.95).pvalue > 1e-4


def test_jackknife_of_a_mean_is_students() -> None:
    """The variance of a mean's leave-one-out values is that of the mean itself."""
    sample = RNG.normal(size=7)
    found = jackknife(sample.mean(), (sample.sum() - sample) / 6)
    expected = stats.ttest_1samp(sample, 0.0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((expected.low, expected.high), rel=1e-12)
    assert jackknife(1.0, []).low is jackknife(1.0, [1.0]).low is jackknife(1.0, [1.0, np.nan]).low is None


def test_mistakes_are_refused() -> None:
    for wrong in ([], [[]], [[1.0], []], [[np.nan]]):
        refused("statistics", mean, wrong)
    refused("paired samples", paired_improvement, [[1.0]], [[1.0, 2.0]])
    refused("strata", probability_of_improvement, [[1.0]], [[1.0], [2.0]])
    refused(r"equally many in each stratum, given \[1, 2\]", mean, [[1.0], [1.0, 2.0]], together=True)
