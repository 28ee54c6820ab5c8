"""Uniformly random legal actions."""

from __future__ import annotations

import numpy as np

from chemlab.envs.players import Actions, Remembering
from chemlab.kernels.arrays import FloatArray, IntArray, MaskArray, ObservationArray, StreamArray
from chemlab.kernels.jit import kernel
from chemlab.kernels.rng import as_sequence, uniform


@kernel
def _draw_legal(mask: MaskArray, members: IntArray, stream: StreamArray, out: IntArray) -> None:
    for b in range(mask.shape[0]):
        legal = 0
        for a in range(mask.shape[1]):
            legal += mask[b, a] != 0
        wanted = int(uniform(stream[members[b]]) * legal)
        chosen = -1
        while wanted >= 0 and chosen < mask.shape[1] - 1:
            chosen += 1
            wanted -= mask[b, chosen] != 0
        out[b] = chosen


@kernel
def _draw_numbers(members: IntArray, stream: StreamArray, out: FloatArray) -> None:
    for b in range(out.shape[0]):
        for x in range(out.shape[1]):
            out[b, x] = uniform(stream[members[b]])


class RandomPolicy(Remembering):
    """Uniformly random legal actions, with a separate stream per member.

    Args:
        size: size of a continuous action; ignored with a mask.
        seed: seed of the members' streams, until :meth:`seed` gives one of them its own.
    """

    _MEMORY = ("_stream",)

    def __init__(self, size: int, seed: int | np.random.SeedSequence | None = None) -> None:
        self._size = size
        self._seeds = as_sequence(seed)
        self._stream: StreamArray = np.zeros((0, 1), dtype=np.uint64)

    def _provide(self, members: int) -> None:
        """Create streams for these members."""
        while len(self._stream) < members:
            more = self._seeds.spawn(max(members - len(self._stream), len(self._stream)))
            states = [sequence.generate_state(1, np.uint64) for sequence in more]
            self._stream = np.concatenate([self._stream, states])

    def seed(self, member: int, seed: int | np.random.SeedSequence) -> None:
        """Restart the stream of one member, as that of member 0 of a policy that was made with this seed."""
        self._provide(member + 1)
        own = as_sequence(seed)
        first = np.random.SeedSequence(own.entropy, spawn_key=(*own.spawn_key, 0))
        self._stream[member] = first.generate_state(1, np.uint64)

    def act(self, observation: ObservationArray, mask: MaskArray | None, step: IntArray, members: IntArray) -> Actions:
        """See :class:`chemlab.envs.players.Policy`."""
        self._provide(int(members.max()) + 1)
        if mask is None:
            numbers = np.empty((len(observation), self._size))
            _draw_numbers(members, self._stream, numbers)
            return numbers
        chosen = np.empty(len(mask), dtype=np.int64)
        _draw_legal(mask, members, self._stream, chosen)
        return chosen
