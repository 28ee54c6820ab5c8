"""The scale of audits and benchmarks: 0 is random legal play, 1 a planner that knows each episode's world."""

from __future__ import annotations

from typing import Any

import numpy as np

from chemlab.arrays import FloatArray

from . import statistics

__all__ = ["Scale", "interval"]


class Scale:
    """Statistics of scores on the audit's scale, with intervals: every resample draws episodes anew, the same of
    everybody, and scales by its own random and clairvoyant ones.

    Args:
        random, clairvoyant: [E] scores of each episode.
    """

    def __init__(self, random: FloatArray, clairvoyant: FloatArray) -> None:
        draw = np.random.default_rng(0)
        n = len(random)
        self._samples = np.concatenate([np.arange(n)[None], draw.integers(n, size=(statistics.RESAMPLES, n))])
        self._zero = random[self._samples].mean(axis=1)
        self._span = np.maximum(clairvoyant[self._samples].mean(axis=1) - self._zero, 1e-9)

    def mean(self, scores: FloatArray) -> FloatArray:
        """[1 + R] normalised means: of the episodes themselves, then of every resample."""
        return np.asarray((scores[self._samples].mean(axis=1) - self._zero) / self._span)

    def deviation(self, scores: FloatArray) -> FloatArray:
        """[1 + R] standard deviations on the scale."""
        return np.asarray(scores[self._samples].std(axis=1) / self._span)


def interval(values: FloatArray) -> dict[str, Any]:
    """The first of [1 + R] values, and the ends of the interval that the others, of resamples, say."""
    tail = 50.0 * (1.0 - statistics.CONFIDENCE)
    low, high = np.percentile(values[1:], [tail, 100.0 - tail])
    return {"value": float(values[0]), "low": float(low), "high": float(high)}
