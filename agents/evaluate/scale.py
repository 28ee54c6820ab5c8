"""The scale of audits and benchmarks: 0 is random legal play, 1 the oracle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.kernels.arrays import FloatArray

from . import statistics


class Scale:
    """Normalized statistics of scores: of all E episodes, and without each of G groups of episodes (jackknife).

    Random play and the oracle played the same episodes, so a group is left out of their means as well.

    Args:
        random, oracle: [E] scores of each episode.
        groups: [E] index of the independent sample of each episode, such as the training run that played it; default:
            each episode is one.

    Attributes:
        span: mean score of the oracle minus that of random play; 0 if it is a rounding error.
    """

    def __init__(self, random: FloatArray, oracle: FloatArray, groups: Sequence[int] | None = None) -> None:
        group_of = np.arange(len(random)) if groups is None else np.asarray(groups)
        names = np.unique(group_of)
        # [1 + G, E]: all episodes, then those outside each group; without a single group, no episode would remain.
        kept = [group_of != name for name in names] if len(names) > 1 else []
        self._kept = np.array([np.ones(len(group_of), dtype=np.bool_), *kept])
        self._zero = self._means(random)
        span = self._means(oracle) - self._zero
        self._span = np.where(span > statistics.TIE, span, 0.0)
        self.span = float(self._span[0])

    def _means(self, scores: FloatArray) -> FloatArray:
        return np.asarray((self._kept @ np.asarray(scores, dtype=np.float64)) / self._kept.sum(axis=1))

    def _scaled(self, values: FloatArray) -> FloatArray:
        nothing = np.full(len(values), np.nan)
        return np.asarray(np.divide(values, self._span, out=nothing, where=self._span > 0.0))

    def mean(self, scores: FloatArray) -> FloatArray:
        """Return [1 + G] normalized means: of all episodes, then without each group; NaN if the scale has no span."""
        return self._scaled(self._means(scores) - self._zero)

    def deviation(self, scores: FloatArray) -> FloatArray:
        """Return [1 + G] normalized standard deviations; NaN where only one episode remains without a group."""
        kept = [scores[row] for row in self._kept]
        deviations = [part.std() if k == 0 or len(part) > 1 else np.nan for k, part in enumerate(kept)]
        return self._scaled(np.array(deviations))


def missing(reason: str) -> dict[str, Any]:
    """Return an estimate without a value, and the reason why there is none."""
    return {"value": None, "low": None, "high": None, "reason": reason}


def interval(values: npt.ArrayLike) -> dict[str, Any]:
    """Return the estimate of [1 + G] values: the first, with the jackknife interval from the others."""
    value, *without = np.asarray(values, dtype=np.float64).tolist()
    return statistics.jackknife(value, without).as_dict()
