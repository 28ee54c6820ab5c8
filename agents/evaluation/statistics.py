"""Statistics of returns: means, interquartile means and probabilities of improvement, with bootstrap intervals.

Samples come in strata: one array for each goal. Goals are fixed, episodes (or training runs) are drawn, so that every
resample draws anew within each goal and never across goals (the stratified bootstrap).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from chemlab.arrays import FloatArray

__all__ = [
    "CONFIDENCE",
    "RESAMPLES",
    "TIE",
    "Estimate",
    "interquartile_mean",
    "interval_text",
    "mean",
    "number_text",
    "paired_improvement",
    "performance_profile",
    "probability_of_improvement",
]

CONFIDENCE = 0.95
RESAMPLES = 2000
TIE = 1e-9
"""Returns that differ by less are a tie: rounding is no improvement."""

_BATCH = 200
"""Resamples held in memory at a time."""

Strata = Sequence[npt.ArrayLike]


@dataclass(frozen=True)
class Estimate:
    """A statistic and its confidence interval, in the statistic's unit; single samples say nothing of others and have
    none (None)."""

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


def _bootstrap(
    strata: list[FloatArray], statistic: Callable[..., Any], method: str, confidence: float, resamples: int, seed: int
) -> Estimate:
    """The statistic of ``strata`` and its interval; ``statistic(*strata, axis=-1)`` works on the last axis."""
    value = float(statistic(*strata, axis=-1))
    if all(stratum.size < 2 for stratum in strata):
        return Estimate(value, None, None)
    drawn = [stratum for stratum in strata if np.ptp(stratum) > 0.0]
    if not drawn:
        return Estimate(value, value, value)  # nothing varies: every resample is the sample itself
    # scipy refuses strata of one sample; a constant one is the same in every resample, so it need not be drawn.
    varies = [bool(np.ptp(stratum) > 0.0) for stratum in strata]

    def of_drawn(*samples: FloatArray, axis: int = -1) -> Any:
        remaining = iter(samples)
        shape = samples[0].shape[:-1]
        full = [
            next(remaining) if moving else np.broadcast_to(stratum, (*shape, stratum.size))
            for moving, stratum in zip(varies, strata, strict=True)
        ]
        return statistic(*full, axis=axis)

    # The jackknife of BCa needs at least three values to say anything of skewness.
    if min(stratum.size for stratum in drawn) < 3:
        method = "percentile"
    for attempt in dict.fromkeys((method, "percentile")):
        with np.errstate(all="ignore"):
            distribution = _resampled(drawn, of_drawn, attempt, confidence, resamples, seed)
        low, high = (float(bound) for bound in distribution)
        if np.isfinite(low) and np.isfinite(high):
            return Estimate(value, low, high)
    return Estimate(value, value, value)


def _resampled(
    drawn: list[FloatArray], statistic: Callable[..., Any], method: Any, confidence: float, resamples: int, seed: int
) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)  # handled by the caller: the interval is NaN
        return stats.bootstrap(
            tuple(drawn),
            statistic,
            vectorized=True,
            paired=False,
            n_resamples=resamples,
            batch=_BATCH,
            confidence_level=confidence,
            method=method,
            random_state=np.random.default_rng(seed),
        ).confidence_interval


def _mean_of_means(*strata: FloatArray, axis: int = -1) -> Any:
    return sum(np.mean(stratum, axis=axis) for stratum in strata) / len(strata)


def _pooled_iqm(*strata: FloatArray, axis: int = -1) -> Any:
    return stats.trim_mean(np.concatenate(strata, axis=axis), 0.25, axis=axis)


def mean(strata: Strata, confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = 0) -> Estimate:
    """Mean over strata of their means, with the bias-corrected and accelerated bootstrap interval.

    Args:
        strata: samples of each goal, in the unit of a return.
        confidence: of the interval.
        resamples: number of bootstrap resamples.
        seed: of the resampling.

    Raises:
        ValueError: a stratum is empty or a sample is not finite.
    """
    return _bootstrap(_checked(strata), _mean_of_means, "BCa", confidence, resamples, seed)


def interquartile_mean(
    strata: Strata, confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = 0
) -> Estimate:
    """Mean of the middle half of all samples (a quarter, rounded down, is cut off at each end), percentile interval.

    The definition and interval are those of Agarwal et al. 2021, "Deep RL at the Edge of the Statistical Precipice".
    Arguments and errors as for :func:`mean`.
    """
    return _bootstrap(_checked(strata), _pooled_iqm, "percentile", confidence, resamples, seed)


def _won(difference: FloatArray) -> FloatArray:
    """1 for a gain, 0 for a loss, 1/2 for a tie."""
    return np.asarray(np.where(np.abs(difference) <= TIE, 0.5, difference > 0.0), dtype=np.float64)


def paired_improvement(
    strata: Strata, baseline: Strata, confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = 0
) -> Estimate:
    """Share of pairs in which the sample is above the baseline's, ties counted as 1/2; pairs are resampled.

    Args:
        strata: samples of each goal.
        baseline: the baseline's, sample for sample from the same seed.
        confidence, resamples, seed: as for :func:`mean`.

    Raises:
        ValueError: as :func:`mean`, or the shapes differ.
    """
    ours, theirs = _checked(strata), _checked(baseline)
    if [x.size for x in ours] != [y.size for y in theirs]:
        raise ValueError(
            f"paired samples: the strata have {[x.size for x in ours]}, the baseline {[y.size for y in theirs]}"
        )
    pairs = [_won(x - y) for x, y in zip(ours, theirs, strict=True)]
    return _bootstrap(pairs, _mean_of_means, "percentile", confidence, resamples, seed)


def probability_of_improvement(
    strata: Strata, baseline: Strata, confidence: float = CONFIDENCE, resamples: int = RESAMPLES, seed: int = 0
) -> Estimate:
    """P(sample > baseline) + P(tie) / 2 for independent draws (Mann-Whitney's U over the number of pairs), mean over
    strata; both sides are resampled.

    Arguments and errors as for :func:`paired_improvement`, but numbers of samples may differ.
    """
    ours, theirs = _checked(strata), _checked(baseline)
    if len(ours) != len(theirs):
        raise ValueError(f"probability of improvement: {len(ours)} strata, the baseline has {len(theirs)}")

    def statistic(*samples: FloatArray, axis: int = -1) -> Any:
        half = len(samples) // 2
        wins = [
            _won(x[..., :, None] - y[..., None, :]).mean(axis=(-2, -1))
            for x, y in zip(samples[:half], samples[half:], strict=True)
        ]
        return sum(wins) / half

    return _bootstrap([*ours, *theirs], statistic, "percentile", confidence, resamples, seed)


def performance_profile(
    strata: Strata,
    thresholds: npt.ArrayLike,
    confidence: float = CONFIDENCE,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> list[Estimate]:
    """For each threshold, the share of samples above it, mean over strata, with percentile intervals.

    The definition is that of Agarwal et al. 2021 (run-score distributions); the intervals are of each threshold by
    itself, from resamples within strata.

    Args:
        strata: samples of each task.
        thresholds: [T], in the samples' unit.
        confidence, resamples, seed: as for :func:`mean`.

    Raises:
        ValueError: as :func:`mean`.
    """
    samples, levels = _checked(strata), np.asarray(thresholds, dtype=np.float64).ravel()
    above = [stratum[:, None] > levels for stratum in samples]
    shares = np.mean([each.mean(axis=0) for each in above], axis=0)
    if all(len(each) < 2 for each in above):
        return [Estimate(float(share), None, None) for share in shares]
    draw = np.random.default_rng(seed)
    drawn = np.zeros((resamples, len(levels)))
    for each in above:
        drawn += each[draw.integers(len(each), size=(resamples, len(each)))].mean(axis=1) / len(above)
    tail = 50.0 * (1.0 - confidence)
    low, high = np.percentile(drawn, [tail, 100.0 - tail], axis=0)
    return [Estimate(*(float(x) for x in row)) for row in zip(shares, low, high, strict=True)]
