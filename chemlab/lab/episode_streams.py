"""Series of episodes: the random streams at the start of each, and the handling of interrupted steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar

import gymnasium
import numpy as np
import numpy.typing as npt

from ..kernels.arrays import BoolArray, IntArray, StreamArray

P = ParamSpec("P")
T = TypeVar("T")

INTERRUPTED = "step: an earlier step or reset was interrupted or failed, so this episode cannot go on: call reset()"
"""Error message of a step after an interrupted one."""

_APART = np.uint64(0x9FB21C651E98DF25)
"""Distance of the counters of successive episodes of a series: odd, so that all of them differ."""


class Guarded:
    """Mixin of environments that detects interrupted steps, after which a reset is required.

    A step calls :meth:`_guarded` first, a reset :meth:`_entered`; both set ``_unfinished`` to False at their end.
    """

    _unfinished = False
    """True while a step or reset is running, and after it was interrupted."""

    def _guarded(self, step: Callable[[Any], T], action: Any) -> T:
        """Call the environment's own step.

        Raises:
            gymnasium.error.ResetNeeded: an earlier step or reset was interrupted or failed.
        """
        if self._unfinished:
            raise gymnasium.error.ResetNeeded(INTERRUPTED)
        return self._entered(step, action)

    def _entered(self, call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        """Call the environment; if it raises an error, it determines whether the episode can continue."""
        before, self._unfinished = self._unfinished, True
        try:
            return call(*args, **kwargs)
        except Exception:
            self._unfinished = before
            raise


def _mixed(counters: StreamArray) -> StreamArray:
    """Mix 64-bit counters as SplitMix64 does, so that neighbouring counters have unrelated streams."""
    mixed = (counters ^ (counters >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(mixed ^ (mixed >> np.uint64(31)))


class EpisodeStreams:
    """Random streams of N members that depend only on a member's seed and the index of the episode.

    The first episode after a seed starts with the seeded streams. Each later one starts with its own streams,
    independent of the actions played before, so that policies are compared on the same episodes.

    Args:
        members: number of members N.
        count: number of streams of a member K.

    Attributes:
        first: [N, K] streams of the first episode.
        begun: [N] number of episodes started since the seed.
        again: [N] whether the next episode repeats the last one's streams.
    """

    def __init__(self, members: int, count: int) -> None:
        self.first: StreamArray = np.zeros((members, count), dtype=np.uint64)
        self.begun: IntArray = np.zeros(members, dtype=np.int64)
        self.again: BoolArray = np.zeros(members, dtype=np.bool_)

    def seed(self, member: int, streams: Sequence[StreamArray]) -> None:
        """Start a new series with the freshly seeded ``streams`` [N, 1] each."""
        self.first[member] = [stream[member, 0] for stream in streams]
        self.begun[member], self.again[member] = 0, False

    def begin(self, members: IntArray, streams: Sequence[StreamArray]) -> None:
        """Set the ``streams`` [N, 1] each to the initial ones of the next episodes of ``members`` [B]."""
        anew = ~self.again[members]
        later = members[anew & (self.begun[members] > 0)]
        if len(later):
            mixed = _mixed(self.first[later] + self.begun[later, None].astype(np.uint64) * _APART)
            for k, stream in enumerate(streams):
                stream[later, 0] = mixed[:, k]
        self.begun[members] += anew
        self.again[members] = False

    def sequence(self, member: int) -> np.random.SeedSequence:
        """Return a seed sequence for other random objects of the member's current episode, such as policies."""
        return np.random.SeedSequence([int(self.first[member, 0]), int(self.begun[member])])

    def arrays(self) -> list[npt.NDArray[Any]]:
        """Return every array that changes, for snapshots."""
        return [self.first, self.begun, self.again]
