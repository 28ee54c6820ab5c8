"""Series of episodes: the random streams that each begins with, and what a step says after one that was interrupted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar

import gymnasium
import numpy as np
import numpy.typing as npt

from ..kernels.arrays import BoolArray, IntArray, StreamArray

__all__ = ["INTERRUPTED", "EpisodeStreams", "Guarded"]

P = ParamSpec("P")
T = TypeVar("T")

INTERRUPTED = "step: an earlier step or reset was interrupted or failed, so this episode cannot go on: call reset()"
"""Message of the error that a step raises after one that has not come to its end."""

_APART = np.uint64(0x9FB21C651E98DF25)
"""Distance of the counters of two episodes of a series: odd, so that no two of them agree."""


class Guarded:
    """Mixin for what keeps account of an environment's steps: an interrupted step is not gone on with.

    A step calls :meth:`_guarded` first, a reset :meth:`_entered`; both set ``_unfinished`` to False at their end.
    """

    _unfinished = False
    """Whether a step or reset is under way, or was interrupted."""

    def _guarded(self, step: Callable[[Any], T], action: Any) -> T:
        """Take the environment's own step.

        Raises:
            gymnasium.error.ResetNeeded: an earlier step or reset was interrupted or failed.
        """
        if self._unfinished:
            raise gymnasium.error.ResetNeeded(INTERRUPTED)
        return self._entered(step, action)

    def _entered(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call the environment. Where that raises an error, the environment says whether it can go on."""
        before, self._unfinished = self._unfinished, True
        try:
            return call(*args, **kwargs)
        except Exception:
            self._unfinished = before
            raise


def _mixed(counters: StreamArray) -> StreamArray:
    """Mix 64-bit counters as SplitMix64 does, so that neighbours have unrelated streams."""
    mixed = (counters ^ (counters >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(mixed ^ (mixed >> np.uint64(31)))


class EpisodeStreams:
    """Random streams of N members that depend on a member's seed and on the number of the episode alone.

    The first episode after a seed begins with the streams as they were seeded. Each later one begins with streams of
    its own, whatever was played before, so that policies are compared on the same episodes.

    Args:
        members: N.
        count: K, number of streams of a member.

    Attributes:
        first: [N, K] the streams of the first episode.
        begun: [N] episodes begun since the seed.
        again: [N] whether the next episode stands in for the last one: it goes on with that one's streams.
    """

    def __init__(self, members: int, count: int) -> None:
        self.first: StreamArray = np.zeros((members, count), dtype=np.uint64)
        self.begun: IntArray = np.zeros(members, dtype=np.int64)
        self.again: BoolArray = np.zeros(members, dtype=np.bool_)

    def seed(self, member: int, streams: Sequence[StreamArray]) -> None:
        """Begin a new series with the ``streams`` [N, 1] each, as they have just been seeded."""
        self.first[member] = [stream[member, 0] for stream in streams]
        self.begun[member], self.again[member] = 0, False

    def begin(self, members: IntArray, streams: Sequence[StreamArray]) -> None:
        """Set the ``streams`` [N, 1] each to what the next episodes of ``members`` [B] begin with."""
        anew = ~self.again[members]
        later = members[anew & (self.begun[members] > 0)]
        if len(later):
            apart = self.begun[later].astype(np.uint64) * _APART
            for k, stream in enumerate(streams):
                stream[later, 0] = _mixed(self.first[later, k] + apart)
        self.begun[members] += anew
        self.again[members] = False

    def sequence(self, member: int) -> np.random.SeedSequence:
        """Seeds for whatever else is random in the member's present episode, as policies are."""
        return np.random.SeedSequence([int(self.first[member, 0]), int(self.begun[member])])

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Every array that changes, for snapshots."""
        return [self.first, self.begun, self.again]
