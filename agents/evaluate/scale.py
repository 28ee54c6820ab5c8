"""The scale of audits and benchmarks: 0 is random legal play, 1 a planner that knows each episode's world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from chemlab.kernels.arrays import FloatArray

from . import statistics


class Scale:
    """Statistics of scores on the audit's scale, of all episodes and without each group of them (the jackknife).

    Random play and the planner played the same episodes, so that their means are left out together with a score's.

    Args:
        random, oracle: [E] scores of each episode.
        groups: [E] what is drawn independently, such as the training run that played an episode; default: episodes.

    Attributes:
        span: the planner's mean score less random play's.
    """

    def __init__(self, random: FloatArray, oracle: FloatArray, groups: Sequence[int] | None = None) -> None:
        own = np.arange(len(random)) if groups is None else np.asarray(groups)
        kinds = np.unique(own)
        # [1 + G, E]: all episodes, then those outside each group; a single group leaves none.
        kept = [own != kind for kind in kinds] if len(kinds) > 1 else []
        self._kept = np.array([np.ones(len(own), dtype=np.bool_), *kept])
        self._zero = self._means(random)
        self._ends = self._means(oracle)
        self.span = float(self._ends[0] - self._zero[0])

    def _means(self, scores: FloatArray) -> FloatArray:
        return np.asarray((self._kept @ np.asarray(scores, dtype=np.float64)) / self._kept.sum(axis=1))

    def _scaled(self, values: FloatArray) -> FloatArray:
        span = self._ends - self._zero
        scaled: FloatArray = np.divide(values, span, out=np.full(len(values), np.nan), where=span > 0.0)
        return scaled

    def mean(self, scores: FloatArray) -> FloatArray:
        """[1 + G] normalized means: of all episodes, then without each group; NaN where nothing is above random."""
        return self._scaled(self._means(scores) - self._zero)

    def deviation(self, scores: FloatArray) -> FloatArray:
        """[1 + G] standard deviations on the scale; NaN where a group left out leaves a single episode."""
        kept = [scores[row] for row in self._kept]
        spreads = [part.std() if k == 0 or len(part) > 1 else np.nan for k, part in enumerate(kept)]
        return self._scaled(np.array(spreads))


def missing(reason: str) -> dict[str, Any]:
    """Return an entry without a value, with the reason, for a measure that does not apply."""
    return {"value": None, "low": None, "high": None, "reason": reason}


def interval(values: npt.ArrayLike) -> dict[str, Any]:
    """The first of [1 + G] values, with the interval that the others, each without a group of episodes, give it."""
    whole, *without = np.asarray(values, dtype=np.float64).tolist()
    return statistics.jackknife(whole, without).as_dict()
