"""Means, interquartile means and probabilities of improvement of returns, with 95 % confidence intervals.

Samples are grouped in strata: one array for each goal or scenario. Strata are fixed; samples (episodes or training
runs) are random. The intervals are valid for small samples:

| statistic | interval |
|---|---|
| mean over strata | Student's t; Welch-Satterthwaite degrees of freedom over several strata |
| interquartile mean | Tukey and McLaughlin's t of winsorized samples, as above over several strata |
| share of samples or pairs | Wilson's score interval |
| probability of improvement | Newcombe's score interval of Mann-Whitney's U (2006, method 5) |

Score intervals of several strata use the variance of strata with equal probabilities, the largest for a given mean.
With ``together``, sample i of every stratum comes from the same episode or run: its values are averaged first, and
shares count as those of one stratum. This is exact if all strata agree, and conservative otherwise.

If a stratum has one sample, its variance is unknown and the estimate has no interval. ``python
studies/speed/interval_coverage.py`` measures the coverage of all intervals.
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
"""Returns that differ by at most this are tied, because rounding is not an improvement."""

Strata = Sequence[npt.ArrayLike]


@dataclass(frozen=True)
class Estimate:
    """A statistic and the ends of its confidence interval, in the statistic's unit.

    The ends are None if a stratum has a single sample.
    """

    value: float
    low: float | None
    high: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return the fields as a dictionary."""
        return dict(vars(self))

    def __str__(self) -> str:
        return interval_text(self.as_dict())


def number_text(value: float, digits: int = 3, sign: str = "") -> str:
    """Format a number for a table. A rounded 0 has no minus; ``sign="+"`` marks positive numbers."""
    return f"{round(value, digits) + 0.0:{sign}.{digits}f}"


def interval_text(estimate: Mapping[str, Any], digits: int = 3, sign: str = "") -> str:
    """Format an estimate (:meth:`Estimate.as_dict`) as ``value [low, high]``; see :func:`number_text`."""
    if estimate["low"] is None:
        return number_text(estimate["value"], digits, sign)
    value, low, high = (number_text(estimate[key], digits, sign) for key in ("value", "low", "high"))
    return f"{value} [{low}, {high}]"


def _checked(strata: Strata, together: bool = False) -> list[FloatArray]:
    """Return strata as arrays, checked as :func:`mean` says."""
    arrays = [np.asarray(stratum, dtype=np.float64).ravel() for stratum in strata]
    if not arrays or any(array.size == 0 for array in arrays):
        raise ValueError("statistics: needs at least one sample in every stratum")
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError("statistics: samples must be finite numbers")
    sizes = sorted({array.size for array in arrays})
    if together and len(sizes) > 1:
        raise ValueError(
            f"statistics: samples that belong together must be equally many in each stratum, given {sizes}"
        )
    return arrays


def _student(value: float, variance: float, freedom: float) -> Estimate:
    half = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, freedom)) * math.sqrt(variance) if variance > 0.0 else 0.0
    return Estimate(value, value - half, value + half)


def _welch(value: float, strata: Sequence[FloatArray], weights: Sequence[float], freedoms: Sequence[float]) -> Estimate:
    """Return an estimate, which need not be the sum, with the interval of a weighted sum of stratum means.

    ``freedoms`` are the degrees of freedom of each stratum's variance.
    """
    if any(stratum.size < 2 for stratum in strata):
        return Estimate(value, None, None)
    pairs = zip(weights, strata, strict=True)
    variances = [weight**2 * float(stratum.var(ddof=1)) / stratum.size for weight, stratum in pairs]
    total = sum(variances)
    # Shares of the variance, because the square of a tiny variance underflows.
    shares = [variance / total if total > 0.0 else 0.0 for variance in variances]
    parts = sum(share**2 / freedom for share, freedom in zip(shares, freedoms, strict=True))
    return _student(value, total, 1.0 / parts if parts > 0.0 else 1.0)


def mean(strata: Strata, together: bool = False) -> Estimate:
    """Return the mean over strata of their means, with Student's t interval.

    Args:
        strata: samples of each goal, in the unit of a return.
        together: True if sample i of every stratum is from the same episode or run.

    Raises:
        ValueError: a stratum is empty, a sample is not finite, or sizes differ although samples belong ``together``.
    """
    samples = _checked(strata, together)
    value = float(np.mean([stratum.mean() for stratum in samples]))
    if together:
        samples = [np.mean(samples, axis=0)]
    weights = [1.0 / len(samples)] * len(samples)
    return _welch(value, samples, weights, [stratum.size - 1.0 for stratum in samples])


def interquartile_mean(strata: Strata, together: bool = False) -> Estimate:
    """Return the mean of the middle half of all samples, with the t interval of winsorized samples.

    A quarter of the samples, rounded down, is cut off at each end, and samples are winsorized there. The definition is
    that of Agarwal et al. 2021, "Deep RL at the Edge of the Statistical Precipice". The interval of one stratum is that
    of Tukey and McLaughlin (1963). Arguments and errors are those of :func:`mean`.
    """
    samples = _checked(strata, together)
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
    """Return a smooth statistic of n samples and its t interval with the jackknife's variance (Tukey 1958).

    Args:
        value: the statistic of all samples.
        without: [n] the statistic without each sample (or group of samples). No interval if n < 2 or one is not finite.
    """
    left = np.asarray(without, dtype=np.float64)
    n = left.size
    if n < 2 or not np.isfinite(left).all():
        return Estimate(value, None, None)
    return _student(value, (n - 1) * float(left.var()), n - 1.0)


def _mann_whitney(p: float, m: int, n: int) -> float:
    """Return the variance of U / (m n) (Hanley and McNeil 1982), with the mean of m and n as in Newcombe (2006)."""
    more = (m + n) / 2.0 - 1.0
    return p * (1.0 - p) * (1.0 + more * ((1.0 - p) / (2.0 - p) + p / (1.0 + p))) / (m * n)


def _mean_share(shares: Sequence[float], variances: Sequence[Callable[[float], float]], together: bool) -> Estimate:
    """Return the mean over strata of shares in [0, 1] with its score interval.

    The interval has all probabilities from which the mean is at most z standard deviations away. ``variances`` are
    those of the shares as functions of the probability, which is taken as equal in all strata.
    """
    k, share = len(shares), float(np.mean(shares))
    z2 = float(stats.norm.ppf(0.5 + 0.5 * CONFIDENCE)) ** 2

    def excess(p: float) -> float:
        variance = sum(of_stratum(p) for of_stratum in variances) / (k if together else k * k)
        return (share - p) ** 2 - z2 * variance

    # A share of 0 or 1 is a root itself, but not the end of the interval.
    low = 0.0 if share <= 0.0 else float(optimize.brentq(excess, 0.0, min(share, 1.0 - 1e-9)))
    high = 1.0 if share >= 1.0 else float(optimize.brentq(excess, max(share, 1e-9), 1.0))
    return Estimate(share, low, high)


def _wins(difference: FloatArray) -> FloatArray:
    """Return 1 for a gain, 0 for a loss, 1/2 for a tie."""
    return np.asarray(np.where(np.abs(difference) <= TIE, 0.5, difference > 0.0), dtype=np.float64)


def _share_estimate(strata: Sequence[FloatArray], together: bool) -> Estimate:
    shares = [float(stratum.mean()) for stratum in strata]
    if any(stratum.size < 2 for stratum in strata):
        return Estimate(float(np.mean(shares)), None, None)
    variances = [lambda p, n=stratum.size: p * (1.0 - p) / n for stratum in strata]  # of a share of n samples
    return _mean_share(shares, variances, together)


def paired_improvement(strata: Strata, baseline: Strata, together: bool = False) -> Estimate:
    """Return the share of pairs in which the sample is above the baseline's, with Wilson's interval; ties count 1/2.

    Args:
        strata: samples of each goal.
        baseline: samples of the baseline with the same seeds, in the same order.
        together: as for :func:`mean`.

    Raises:
        ValueError: as for :func:`mean`, or the shapes differ.
    """
    ours, theirs = _checked(strata, together), _checked(baseline)
    if [x.size for x in ours] != [y.size for y in theirs]:
        raise ValueError(
            f"paired samples: the strata have {[x.size for x in ours]}, the baseline {[y.size for y in theirs]}"
        )
    return _share_estimate([_wins(x - y) for x, y in zip(ours, theirs, strict=True)], together)


def probability_of_improvement(strata: Strata, baseline: Strata, together: bool = False) -> Estimate:
    """Return P(sample > baseline) + P(tie) / 2 for independent draws, mean over strata, with Newcombe's interval.

    This is Mann-Whitney's U divided by the number of pairs. Arguments and errors are those of
    :func:`paired_improvement`, but sizes may differ from the baseline's.
    """
    ours, theirs = _checked(strata, together), _checked(baseline, together)
    if len(ours) != len(theirs):
        raise ValueError(f"probability of improvement: {len(ours)} strata, the baseline has {len(theirs)}")
    shares = [float(_wins(x[:, None] - y[None, :]).mean()) for x, y in zip(ours, theirs, strict=True)]
    if any(sample.size < 2 for sample in (*ours, *theirs)):
        return Estimate(float(np.mean(shares)), None, None)
    variances = [functools.partial(_mann_whitney, m=x.size, n=y.size) for x, y in zip(ours, theirs, strict=True)]
    return _mean_share(shares, variances, together)


def performance_profile(strata: Strata, thresholds: npt.ArrayLike) -> list[Estimate]:
    """Return the share of samples above each threshold, mean over strata, with Wilson's interval.

    The definition is that of Agarwal et al. 2021 (run-score distributions); the intervals are pointwise.

    Args:
        strata: samples of each task.
        thresholds: [T] in the samples' unit.

    Raises:
        ValueError: as for :func:`mean`.
    """
    samples, levels = _checked(strata), np.asarray(thresholds, dtype=np.float64).ravel()
    return [
        _share_estimate([np.asarray(stratum > level, dtype=np.float64) for stratum in samples], False)
        for level in levels
    ]
