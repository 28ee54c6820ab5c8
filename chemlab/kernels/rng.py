"""Random streams: SplitMix64 with one counter per laboratory, so that members of a batch are independent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from .arrays import FloatArray, StreamArray
from .jit import helper, inner, kernel

_STEP = np.uint64(0x9E3779B97F4A7C15)
_UNIT = 1.0 / 9007199254740992.0


@helper
def _bits(counter: np.uint64) -> np.uint64:
    """Return the 64 bits of a SplitMix64 stream at a count."""
    z = counter
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    bits: np.uint64 = z ^ (z >> np.uint64(31))
    return bits


@helper
def random_bits(state: StreamArray) -> np.uint64:
    """Return the next 64 bits of a SplitMix64 stream whose counter is ``state[0]`` (advanced in place)."""
    state[0] += _STEP
    return _bits(state[0])


@helper
def uniform(state: StreamArray) -> float:
    """Return the next number in [0, 1) of the stream."""
    return (random_bits(state) >> np.uint64(11)) * _UNIT


@inner
def uniforms(state: StreamArray, out: FloatArray) -> None:
    """Fill ``out`` with the next numbers in [0, 1) of the stream, computed independently of each other."""
    counter = state[0]
    for i in range(out.shape[0]):
        out[i] = (_bits(counter + np.uint64(i + 1) * _STEP) >> np.uint64(11)) * _UNIT
    state[0] = counter + np.uint64(out.shape[0]) * _STEP


@kernel
def normal(stream: StreamArray) -> float:
    """Return the next standard normal number (Box-Muller) of the stream, from two uniform ones."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream)))
    return radius * math.cos(2.0 * math.pi * uniform(stream))


def checked_seed(seed: Any, name: str = "seed") -> int | None:
    """Return a seed as a Python integer, or None.

    Args:
        seed: the user's seed.
        name: name of the argument, for the error message.

    Raises:
        ValueError: it is neither a non-negative integer nor None.
    """
    if seed is None:
        return None
    if isinstance(seed, (int, np.integer)) and not isinstance(seed, bool) and seed >= 0:
        return int(seed)
    raise ValueError(f"{name}: must be an integer of at least 0, or None, given {seed!r:.200}")


def as_sequence(seed: int | np.random.SeedSequence | None) -> np.random.SeedSequence:
    """Return a seed as a seed sequence."""
    return seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)


def seed_streams(seed: np.random.SeedSequence, streams: Sequence[StreamArray], member: int) -> None:
    """Set the random stream of one member in each of ``streams`` from one seed sequence."""
    for stream, state in zip(streams, seed.generate_state(len(streams), np.uint64), strict=True):
        stream[member, 0] = state
