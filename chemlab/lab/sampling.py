"""Sampling of hidden parameters: arrays and kernels that draw worlds as :mod:`chemlab.config.draws` declares them."""

from __future__ import annotations

import itertools
import math
import sys
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..config.draws import (
    CHOICE,
    LOGNORMAL,
    NORMAL,
    PERMUTATION,
    UNIFORM,
    Draw,
    WorldSpec,
    numbers_of,
    options_of,
)
from ..kernels.arrays import Field, FloatArray, Handle, IntArray, StreamArray
from ..kernels.jit import inner, kernel, opened
from ..kernels.rng import normal, random_bits, uniform
from ..kernels.tables import Table

_TRIES = 10_000
_LEAST_KEPT = 0.05
"""Minimum probability of the prior outside test regions; training worlds inside them are redrawn."""
_SAMPLE = 2000
"""Number of worlds by which that of correlated draws is estimated."""


class Variables(NamedTuple):
    """Declared draws as arrays: K numbers, Q options in total, Z regions in total, in order."""

    kind: Annotated[IntArray, Field("K")]
    a: Annotated[FloatArray, Field("K")]
    """[K] low, mean, or logarithm of the median"""
    b: Annotated[FloatArray, Field("K")]
    """[K] high, or standard deviation"""
    low: Annotated[FloatArray, Field("K")]
    high: Annotated[FloatArray, Field("K")]
    group: Annotated[IntArray, Field("K")]
    """[K] index of the group, -1 for none"""
    common: Annotated[FloatArray, Field("K")]
    """[K] weight of the group's score in the number's own; the rest has the weight sqrt(1 - weight^2)"""
    block: Annotated[IntArray, Field("K")]
    """[K] for a permutation, index of its first number"""
    first_option: Annotated[IntArray, Field("K+1")]
    options: Annotated[FloatArray, Field("Q")]
    """[Q] numbers, or indices of materials"""
    reached: Annotated[FloatArray, Field("Q")]
    """[Q] cumulative probability"""
    first_region: Annotated[IntArray, Field("K+1")]
    regions: Annotated[FloatArray, Field("Z 2")]


class WorldDraws(NamedTuple):
    """Draws of N laboratories: K numbers, C groups."""

    stream: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] stream of the numbers of a laboratory's next worlds"""
    number: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] the world's number"""
    values: Annotated[FloatArray, Field("N K", first=None)]
    """[N, K] drawn values"""
    work: Annotated[StreamArray, Field("N 1", first=None, kept=False)]
    """[N, 1] scratch, like ``scores`` [N, C]"""
    scores: Annotated[FloatArray, Field("N C", first=None, kept=False)]


def world_draws(laboratories: int, variables: Table[Variables]) -> Table[WorldDraws]:
    """Allocate the draws of some laboratories."""
    groups = int(variables.arrays.group.max(initial=-1)) + 1
    sizes = {"N": laboratories, "K": len(variables.arrays.kind), "C": groups, "1": 1}
    return Table.empty(WorldDraws, **sizes)


def compile_draws(spec: WorldSpec, materials: Sequence[str]) -> Table[Variables]:
    """Convert declared draws to arrays.

    Raises:
        ValueError: test regions leave too little for training; the message names them.
    """
    rows: list[tuple[float, ...]] = []
    options: list[list[float]] = []
    reached: list[FloatArray] = []
    regions: list[list[tuple[float, float]]] = []
    groups: list[str] = []
    kept = 1.0
    for name, draw in spec.draws.items():
        own = [float(o) if not isinstance(o, str) else float(materials.index(o)) for o in options_of(draw)]
        weights = np.array(getattr(draw.distribution, "weights", ()) or [1.0] * len(own))
        reserved = [
            (float(materials.index(r)),) * 2 if isinstance(r, str) else (float(r[0]), float(r[1])) for r in draw.test
        ]
        if draw.group is not None and draw.group not in groups:
            groups.append(draw.group)
        row = (*numbers_of(draw), -1 if draw.group is None else groups.index(draw.group), math.sqrt(draw.correlation))
        block = len(rows)
        rows += [(*row, block)] * draw.variables
        options += [own] * draw.variables
        reached += [np.cumsum(weights) / weights.sum() if own else np.zeros(0)] * draw.variables
        regions += [reserved] * draw.variables
        kept *= (1.0 - _reserved(draw, rows[-1], own, weights, reserved)) ** draw.variables
        if kept < _LEAST_KEPT:
            raise ValueError(
                f"world.draws.{name}.test: leaves {kept:.2g} of all worlds to training; at least {_LEAST_KEPT:g}"
            )
    columns = np.array(rows, dtype=np.float64).reshape(len(rows), 8).T
    table = Table(
        Variables(
            kind=columns[0].astype(np.int64),
            a=columns[1].copy(),
            b=columns[2].copy(),
            low=columns[3].copy(),
            high=columns[4].copy(),
            group=columns[5].astype(np.int64),
            common=columns[6].copy(),
            block=columns[7].astype(np.int64),
            first_option=np.cumsum([0, *map(len, options)]),
            options=np.concatenate([np.zeros(0), *map(np.array, options)]),
            reached=np.concatenate([np.zeros(0), *reached]),
            first_region=np.cumsum([0, *map(len, regions)]),
            regions=np.array([pair for own in regions for pair in own]).reshape(-1, 2),
        )
    )
    correlated = [name for name, draw in spec.draws.items() if draw.group is not None and draw.test]
    if len(correlated) > 1 and (share := _outside(table)) < _LEAST_KEPT:
        raise ValueError(
            f"world.draws: the test regions of {', '.join(correlated)}, which are correlated, leave about {share:.2g} "
            f"of all worlds to training; at least {_LEAST_KEPT:g}"
        )
    return table


def _outside(variables: Table[Variables]) -> float:
    """Return the share of worlds outside every test region, from a sample."""
    sample = world_draws(_SAMPLE, variables)
    sample.arrays.work[:, 0] = np.arange(_SAMPLE)
    draw_worlds(np.arange(_SAMPLE), variables.handle, sample.handle, True)
    outside = np.ones(_SAMPLE, dtype=np.bool_)
    for k, (first, last) in enumerate(itertools.pairwise(variables.arrays.first_region.tolist())):
        for low, high in variables.arrays.regions[first:last]:
            outside &= ~((low <= sample.arrays.values[:, k]) & (sample.arrays.values[:, k] <= high))
    return float(outside.mean())


def _reserved(
    draw: Draw, row: tuple[float, ...], options: list[float], weights: FloatArray, regions: list[tuple[float, float]]
) -> float:
    """Return an upper bound of the probability that a number lies in one of its test regions (regions may overlap)."""
    kind, a, b, low, high = row[:5]
    total = 0.0
    for first, last in regions:
        if kind == CHOICE:
            inside = np.array([first <= option <= last for option in options])
            total += float(weights[inside].sum() / weights.sum())
        elif kind == UNIFORM:
            total += max(min(last, b) - max(first, a), 0.0) / (b - a) if b > a else float(first <= a <= last)
        else:
            total += _mass(kind, a, b, (-math.inf if first <= low else first, math.inf if last >= high else last))
    return min(total, 1.0)


def _mass(kind: float, a: float, b: float, region: tuple[float, float]) -> float:
    """Return the probability of a region under a normal (or lognormal) distribution."""
    below = []
    for end in region:
        if kind == LOGNORMAL:
            end = -math.inf if end <= 0.0 else math.log(end)
        score = (end - a) / b if b > 0.0 else math.copysign(math.inf, end - a)
        below.append(0.5 * math.erfc(-score / math.sqrt(2.0)))
    return max(below[1] - below[0], 0.0)


@inner
def _number(k: int, score: float, share: float, variables: Variables) -> float:
    """Return a number of the k-th distribution from its normal score, or for a choice from its uniform share."""
    kind, value = variables.kind[k], 0.0
    if kind == UNIFORM:
        below = 0.5 * math.erfc(-score / math.sqrt(2.0))
        value = variables.a[k] + (variables.b[k] - variables.a[k]) * below
    elif kind == NORMAL:
        value = variables.a[k] + variables.b[k] * score
    elif kind == LOGNORMAL:
        value = math.exp(variables.a[k] + variables.b[k] * score)
    else:
        q = variables.first_option[k]
        while q < variables.first_option[k + 1] - 1 and share >= variables.reached[q]:
            q += 1
        value = variables.options[q]
    return float(min(max(value, variables.low[k]), variables.high[k]))


@inner
def _permuted(k: int, share: float, values: FloatArray, variables: Variables) -> float:
    """Return the next number of a permutation: one of the options that the earlier ones do not have."""
    first, last = variables.first_option[k], variables.first_option[k + 1]
    block = variables.block[k]
    left = int(share * (last - first - (k - block)))
    value = 0.0
    for q in range(first, last):
        # Options may be equal: count how often each has been taken, and how often it occurred before.
        taken, before = 0, 0
        for other in range(block, k):
            taken += values[other] == variables.options[q]
        for other in range(first, q):
            before += variables.options[other] == variables.options[q]
        if before >= taken:
            if left == 0:
                value = variables.options[q]
            left -= 1
    return value


@kernel
def draw_worlds(members: IntArray, declared: Handle, drawn: Handle, anywhere: bool) -> None:
    """Draw all numbers of the worlds of ``members`` from the worlds' numbers.

    Args:
        members: [B] environment indices.
        declared: the declared draws (:class:`Variables`).
        drawn: receives the draws (:class:`WorldDraws`); ``work`` holds the worlds' numbers.
        anywhere: whether worlds may lie in test regions; otherwise they are redrawn until they do not.
    """
    variables, state = opened(Variables, declared), opened(WorldDraws, drawn)
    for i in range(members.shape[0]):
        n = members[i]
        state.number[n, 0] = state.work[n, 0]
        values, scores, stream = state.values[n], state.scores[n], state.work[n]
        again, tries = True, 0
        while again and tries < _TRIES:
            again = False
            tries += 1
            for g in range(scores.shape[0]):
                scores[g] = normal(stream)
            for k in range(values.shape[0]):
                if variables.kind[k] == PERMUTATION:
                    values[k] = _permuted(k, uniform(stream), values, variables)
                elif variables.kind[k] == CHOICE:
                    values[k] = _number(k, 0.0, uniform(stream), variables)
                else:
                    score, g, common = normal(stream), variables.group[k], variables.common[k]
                    if g >= 0:
                        score = common * scores[g] + math.sqrt(1.0 - common * common) * score
                    values[k] = _number(k, score, 0.0, variables)
                for z in range(variables.first_region[k], variables.first_region[k + 1]):
                    inside = variables.regions[z, 0] <= values[k] <= variables.regions[z, 1]
                    again = again or (inside and not anywhere)


@kernel
def next_numbers(members: IntArray, drawn: Handle, split: int) -> None:
    """Write the next world's number of each laboratory's stream to ``work``."""
    state = opened(WorldDraws, drawn)
    for i in range(members.shape[0]):
        n = members[i]
        state.work[n, 0] = (random_bits(state.stream[n]) & ~np.uint64(3)) | np.uint64(split)


def quantiles(draw: Draw, shares: FloatArray) -> FloatArray:
    """Return quantiles of a draw's prior.

    Raises:
        ValueError: the draw is of materials, or a permutation.
    """
    kind, a, b, low, high = numbers_of(draw)
    if kind == PERMUTATION or draw.what == "identity":
        raise ValueError(f"{draw.what}: has options, so it has no quantiles")
    if kind == CHOICE:
        options = np.array(options_of(draw), dtype=np.float64)
        weights = np.array(getattr(draw.distribution, "weights", ()) or [1.0] * len(options))
        order = np.argsort(options, kind="stable")
        reached = np.cumsum(weights[order]) / weights.sum()
        return np.asarray(options[order][np.minimum(np.searchsorted(reached, shares, "right"), len(options) - 1)])
    if kind == UNIFORM:
        return np.asarray(a + (b - a) * shares)
    scores = np.array([NormalDist().inv_cdf(share) for share in shares.tolist()])
    numbers = a + b * scores
    return np.clip(np.exp(numbers) if kind == LOGNORMAL else numbers, low, high)


def positions(variables: Variables, values: FloatArray, columns: IntArray | None = None) -> FloatArray:
    """Return [B, C] positions of ``values`` [B, K] in their distributions, from 0 to 1.

    A position is the prior probability below the value, or the scaled index of the option. ``columns`` [C] selects
    numbers (default: all).
    """
    chosen = range(values.shape[1]) if columns is None else columns.tolist()
    out = np.zeros((len(values), len(chosen)))
    for at, k in enumerate(chosen):
        own, kind, a, b = values[:, k], int(variables.kind[k]), variables.a[k], variables.b[k]
        if kind in (CHOICE, PERMUTATION):
            options = variables.options[variables.first_option[k] : variables.first_option[k + 1]]
            out[:, at] = (own[:, None] == options).argmax(axis=1) / max(len(options) - 1, 1)
        elif b == (a if kind == UNIFORM else 0.0):
            out[:, at] = 0.5
        elif kind == UNIFORM:
            out[:, at] = (own - a) / (b - a)
        else:
            score = ((np.log(np.maximum(own, sys.float_info.min)) if kind == LOGNORMAL else own) - a) / b
            out[:, at] = [0.5 * math.erfc(-one / math.sqrt(2.0)) for one in score]
    return np.clip(out, 0.0, 1.0)


def named_values(spec: WorldSpec, values: FloatArray, materials: Sequence[str]) -> dict[str, Any]:
    """Return one world's numbers [K] by draw, and by target if each has its own; materials by name."""
    found: dict[str, Any] = {}
    k = 0
    for name, draw in spec.draws.items():
        own: list[Any] = [float(value) for value in values[k : k + draw.variables]]
        if draw.what == "identity":
            own = [materials[int(value)] for value in own]
        found[name] = own[0] if draw.shared == "episode" or not draw.of else dict(zip(draw.of, own, strict=True))
        k += draw.variables
    return found


def given_values(spec: WorldSpec, given: Mapping[str, Any], materials: Sequence[str]) -> FloatArray:
    """Return [K] numbers from the form of :func:`named_values`; NaN for missing ones.

    Raises:
        ValueError: a draw or target is unknown, or a value is invalid.
    """
    out = np.full(sum(draw.variables for draw in spec.draws.values()), np.nan)
    unknown = [name for name in given if name not in spec.draws]
    if unknown:
        raise ValueError(f"world: {unknown[0]!r:.100} is not drawn; choose from {', '.join(spec.draws) or 'nothing'}")
    k = 0
    for name, draw in spec.draws.items():
        value = given.get(name, {})
        targets = [name] if draw.shared == "episode" or not draw.of else list(draw.of)
        by_target = {name: value} if targets == [name] and name in given else value
        if not isinstance(by_target, Mapping) or not set(by_target) <= set(targets):
            raise ValueError(f"world: {name}: must be a table of {', '.join(targets)}, given {value!r:.100}")
        for target, one in by_target.items():
            out[k + targets.index(target)] = _given(draw, f"world: {name}", one, materials)
        k += draw.variables
    return out


def _given(draw: Draw, where: str, value: Any, materials: Sequence[str]) -> float:
    options = options_of(draw)
    if options and value not in options:
        raise ValueError(f"{where}: must be one of {', '.join(map(str, options))}, given {value!r:.100}")
    if draw.what == "identity":
        return float(materials.index(value))
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{where}: must be a finite number, given {value!r:.100}")
    _, _, _, low, high = numbers_of(draw)
    if not low <= value <= high:
        raise ValueError(f"{where}: must be from {low:g} to {high:g}, given {value:g}")
    return float(value)
