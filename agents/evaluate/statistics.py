"""Means, interquartile means and probabilities of improvement of returns, with 95 % confidence intervals.

Samples come in strata: one array for each goal or scenario. Strata are fixed, the samples (episodes or training runs)
are drawn. No interval needs more than a few samples:

| statistic | interval |
|---|---|
| mean over strata | Student's t; Welch-Satterthwaite degrees of freedom over several strata |
| interquartile mean | Tukey and McLaughlin's t of winsorized samples, as above over several strata |
| share of samples or pairs | Wilson's score interval |
| probability of improvement | Newcombe's score interval of Mann-Whitney's U (2006, method 5) |

Score intervals of several strata have the variance of strata with one probability, which is the greatest that the
same mean can have. With ``together`` sample i of every stratum comes from the same episode or run: its values are
averaged first, and shares count as those of one stratum, which is exact where all strata agree and wide elsewhere.

A stratum of one sample has no known variance: the estimate has no interval. The coverage of all of them is measured by
``python studies/speed/interval_coverage.py``.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import optimize, stats

from chemlab.kernels.arrays import FloatArray

CONFIDENCE = 0.95
TIE = 1e-9
"""Returns that differ by less are a tie: rounding is no improvement."""

Strata = Sequence[npt.ArrayLike]


@dataclass(frozen=True)
class Estimate:
    """A statistic and the ends of its confidence interval, in the statistic's unit; the ends are None where a stratum
    has a single sample, of which no interval can be derived."""

    value: float
    low: float | None
    high: float | None

    def as_dict(self) -> dict[str, Any]:
        """The fields as a dictionary."""
        return dict(vars(self))

    def __str__(self) -> str:
        return interval_text(self.as_dict())


def number_text(value: float, digits: int = 3, sign: str = "") -> str:
    """A number of a table; what rounds to 0 has no minus. ``sign``: ``+`` to say it of positive ones, too."""
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"


def interval_text(estimate: Mapping[str, Any], digits: int = 3, sign: str = "") -> str:
    """``value [low, high]`` of an :class:`Estimate` as a dictionary, see :func:`number_text`."""
    if estimate["low"] is None:
        return number_text(estimate["value"], digits, sign)
    value, low, high = (number_text(estimate[key], digits, sign) for key in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def _checked(strata: Strata) -> list[FloatArray]:
    arrays = [np.asarray(stratum, dtype=np.float64).ravel() for stratum in strata]
    if not arrays or any(array.size == 0 for array in arrays):
        raise ValueError("statistics: needs at least one sample in every stratum")
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError("statistics: samples must be finite numbers")
    return arrays


def _check_together(strata: Sequence[FloatArray], together: bool) -> None:
    sizes = sorted({stratum.size for stratum in strata})
    if together and len(sizes) > 1:
        raise ValueError(f"statistics: samples that belong together are equally many in each stratum, given {sizes}")


# -- Student's t ------------------------------------------------------------------------------------------------------


def _student(value: float, variance: float, freedom: float) -> Estimate:
    half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, freedom)) * math.sqrt(variance) if variance > 0.0 else 0.0
    return Estimate(value, value - half, value + half)


def _welch(value: float, strata: Sequence[FloatArray], weights: Sequence[float], freedoms: Sequence[float]) -> Estimate:
    """Interval of the sum of weights times means of strata.

    Args:
        value: the estimate, which may differ from that sum.
        strata: samples.
        weights: of each stratum's mean.
        freedoms: degrees of freedom of each stratum's variance.
    """
    if any(stratum.size < 2 for stratum in strata):
        return Estimate(value, None, None)
    variances = [
        weight**2 * float(stratum.var(ddof=1)) / stratum.size for weight, stratum in zip(weights, strata, strict=True)
    ]
    whole = sum(variances)
    # Of the shares of the variance: the variances themselves may be too small to be squared.
    shares = [variance / whole if whole > 0.0 else 0.0 for variance in variances]
    parts = sum(share**2 / freedom for share, freedom in zip(shares, freedoms, strict=True))
    return _student(value, whole, 1.0 / parts if parts > 0.0 else 1.0)


def mean(strata: Strata, together: bool = False) -> Estimate:
    """Mean over strata of their means, with Student's t interval.

    Args:
        strata: samples of each goal, in the unit of a return.
        together: sample i of every stratum is from the same episode or run.

    Raises:
        ValueError: a stratum is empty, a sample is not finite, or strata of samples that belong together differ in
            their sizes.
    """
    samples = _checked(strata)
    _check_together(samples, together)
    value = float(np.mean([stratum.mean() for stratum in samples]))
    if together:
        samples = [np.mean(samples, axis=0)]
    weights = [1.0 / len(samples)] * len(samples)
    return _welch(value, samples, weights, [stratum.size - 1.0 for stratum in samples])


def interquartile_mean(strata: Strata, together: bool = False) -> Estimate:
    """Mean of the middle half of all samples (a quarter, rounded down, is cut off at each end), with the t interval of
    the samples winsorized at these quarters.

    The definition is that of Agarwal et al. 2021, "Deep RL at the Edge of the Statistical Precipice". The interval of
    one stratum is that of Tukey and McLaughlin (1963). Arguments and errors as for :func:`mean`.
    """
    samples = _checked(strata)
    _check_together(samples, together)
    pooled = np.sort(np.concatenate(samples))
    cut = pooled.size // 4
    value = float(pooled[cut : pooled.size - cut].mean())
    share = (pooled.size - 2 * cut) / pooled.size
    weights = [stratum.size / pooled.size / share for stratum in samples]
    winsorized = [np.clip(stratum, pooled[cut], pooled[-1 - cut]) for stratum in samples]
    if together:
        winsorized, weights = [np.mean(winsorized, axis=0)], [1.0 / share]
    freedoms = [max(share * stratum.size - 1.0, 0.5) for stratum in winsorized]
    return _welch(value, winsorized, weights, freedoms)


def jackknife(value: float, without: npt.ArrayLike) -> Estimate:
    """A smooth statistic of n samples and its t interval with the jackknife's variance (Tukey 1958).

    Args:
        value: the statistic of all samples.
        without: [n] the statistic without each sample (or group of samples); of a single one, or where a number is not
            finite, there is no interval.
    """
    left = np.asarray(without, dtype=np.float64)
    n = left.size
    if n < 2 or not np.isfinite(left).all():
        return Estimate(value, None, None)
    return _student(value, (n - 1) * float(left.var()), n - 1.0)


# -- score intervals --------------------------------------------------------------------------------------------------


def _score_interval(share: float, variance: Callable[[float], float]) -> Estimate:
    """The interval of a share: the probabilities from which it is at most z standard deviations away.

    Args:
        share: the estimate, from 0 to 1.
        variance: of the estimate where the probability is the argument; 0 at 0 and 1.
    """
    z2 = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)) ** 2

    def excess(p: float) -> float:
        return (share - p) ** 2 - z2 * variance(p)

    # A share of 0 or 1 is a root itself, and not the one that is sought.
    low = 0.0 if share <= 0.0 else float(optimize.brentq(excess, 0.0, min(share, 1.0 - 1e-9)))
    high = 1.0 if share >= 1.0 else float(optimize.brentq(excess, max(share, 1e-9), 1.0))
    return Estimate(share, low, high)


def _binomial(p: float, n: int) -> float:
    """Variance of a share of n samples."""
    return p * (1.0 - p) / n


def _mann_whitney(p: float, m: int, n: int) -> float:
    """Variance of U / (m n): Hanley and McNeil (1982), with the mean of both numbers of samples as Newcombe has it."""
    more = (m + n) / 2.0 - 1.0
    return p * (1.0 - p) * (1.0 + more * ((1.0 - p) / (2.0 - p) + p / (1.0 + p))) / (m * n)


def _of_shares(shares: Sequence[float], variances: Sequence[Callable[[float], float]], together: bool) -> Estimate:
    """Mean over strata of shares; the strata are taken to have one probability, where the variance is greatest."""
    k = len(shares)

    def variance(p: float) -> float:
        return sum(one(p) for one in variances) / (k if together else k * k)

    return _score_interval(float(np.mean(shares)), variance)


def _won(difference: FloatArray) -> FloatArray:
    """1 for a gain, 0 for a loss, 1/2 for a tie."""
    return np.asarray(np.where(np.abs(difference) <= TIE, 0.5, difference > 0.0), dtype=np.float64)


def _share_estimate(strata: Sequence[FloatArray], together: bool) -> Estimate:
    shares = [float(stratum.mean()) for stratum in strata]
    if any(stratum.size < 2 for stratum in strata):
        return Estimate(float(np.mean(shares)), None, None)
    variances = [functools.partial(_binomial, n=stratum.size) for stratum in strata]
    return _of_shares(shares, variances, together)


def paired_improvement(strata: Strata, baseline: Strata, together: bool = False) -> Estimate:
    """Share of pairs in which the sample is above the baseline's, ties counted as 1/2, with Wilson's interval.

    Args:
        strata: samples of each goal.
        baseline: the baseline's, sample for sample from the same seed.
        together: as for :func:`mean`.

    Raises:
        ValueError: as :func:`mean`, or the shapes differ.
    """
    ours, theirs = _checked(strata), _checked(baseline)
    _check_together(ours, together)
    if [x.size for x in ours] != [y.size for y in theirs]:
        raise ValueError(
            f"paired samples: the strata have {[x.size for x in ours]}, the baseline {[y.size for y in theirs]}"
        )
    return _share_estimate([_won(x - y) for x, y in zip(ours, theirs, strict=True)], together)


def probability_of_improvement(strata: Strata, baseline: Strata, together: bool = False) -> Estimate:
    """P(sample > baseline) + P(tie) / 2 for independent draws (Mann-Whitney's U over the number of pairs), mean over
    strata, with Newcombe's interval.

    Arguments and errors as for :func:`paired_improvement`, but numbers of samples may differ.
    """
    ours, theirs = _checked(strata), _checked(baseline)
    if len(ours) != len(theirs):
        raise ValueError(f"probability of improvement: {len(ours)} strata, the baseline has {len(theirs)}")
    for side in (ours, theirs):
        _check_together(side, together)
    shares = [float(_won(x[:, None] - y[None, :]).mean()) for x, y in zip(ours, theirs, strict=True)]
    if any(sample.size < 2 for sample in (*ours, *theirs)):
        return Estimate(float(np.mean(shares)), None, None)
    variances = [functools.partial(_mann_whitney, m=x.size, n=y.size) for x, y in zip(ours, theirs, strict=True)]
    return _of_shares(shares, variances, together)


def performance_profile(strata: Strata, thresholds: npt.ArrayLike) -> list[Estimate]:
    """For each threshold, the share of samples above it, mean over strata, with Wilson's interval.

    The definition is that of Agarwal et al. 2021 (run-score distributions); the intervals are of each threshold by
    itself.

    Args:
        strata: samples of each task.
        thresholds: [T], in the samples' unit.

    Raises:
        ValueError: as :func:`mean`.
    """
    samples, levels = _checked(strata), np.asarray(thresholds, dtype=np.float64).ravel()
    return [
        _share_estimate([np.asarray(stratum > level, dtype=np.float64) for stratum in samples], False)
        for level in levels
    ]
