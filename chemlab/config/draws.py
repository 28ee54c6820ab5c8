"""Worlds: what nature and the storeroom have drawn for an episode and keep to themselves.

A scenario declares under ``[world.draws]`` which numbers are drawn, from which distribution and shared by what; agents
know the declaration (the prior) and not the draw. This module has the declarations, the splits, and the kernel that
draws; :mod:`chemlab.lab.hidden` puts what is drawn into a laboratory.

A world is its *number*, 64 bits, from which all of its draws follow. The number's last two bits say its split, so no
number is in two of them. Every laboratory has a stream of numbers of its own that no other stream depends on: with or
without a world, all else that is drawn is the same.
"""

from __future__ import annotations

import hashlib
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator
from pydantic import Field as Bound

from ..kernels.arrays import Field, FloatArray, Handle, IntArray, StreamArray
from ..kernels.jit import inner, kernel, opened
from ..kernels.rng import normal, random_bits, uniform
from ..kernels.tables import Table

__all__ = [
    "BOTTLE",
    "DEVICE_QUANTITIES",
    "ORDER_QUANTITIES",
    "SPLITS",
    "VESSEL_QUANTITIES",
    "Choice",
    "Distribution",
    "Draw",
    "Lognormal",
    "Normal",
    "Permutation",
    "Split",
    "Uniform",
    "Variables",
    "WorldDraws",
    "WorldSpec",
    "changed_limits",
    "compile_draws",
    "draw_limits",
    "draw_worlds",
    "given_values",
    "named_values",
    "next_numbers",
    "positions",
    "quantiles",
    "world_draws",
]

_FROZEN = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_MOST_DRAWS = 64
_MOST_TARGETS = 64
_TRIES = 10_000
_LEAST_KEPT = 0.05
"""Of the prior must be left to training: worlds of test regions are drawn again until one is not in any."""

Number = Annotated[float, Bound(ge=-1e9, le=1e9)]
Name = Annotated[str, Bound(min_length=1, max_length=500)]
Option = float | Name

SPLITS = ("train", "validation", "test")
"""Splits by name; ``private:SALT`` is one more for everyone who knows the salt."""
_PRIVATE = "private"

VESSEL_QUANTITIES = ("identity", "amount", "titre")
"""What may be drawn of the contents of a vessel."""

BOTTLE = "stock"
"""Of the targets of an identity or a titre, the bottle of the material."""

DEVICE_QUANTITIES = ("gain", "life", "bias", "trend")
"""What may be drawn of benches that wear (gain, life) and of instruments that drift (bias, trend)."""

ORDER_QUANTITIES = ("arrives", "within", "price", "amount_at_least_mol", "purity_at_least")
"""What may be drawn of the terms of an order."""


# -- what a file says -------------------------------------------------------------------------------------------------


class Uniform(BaseModel):
    """Every number from ``low`` to ``high`` as likely."""

    model_config = _FROZEN

    kind: Literal["uniform"]
    low: Number
    high: Number

    @model_validator(mode="after")
    def _ordered(self) -> Uniform:
        if self.high < self.low:
            raise ValueError(f"high = {self.high:g} must not be below low = {self.low:g}")
        return self


class _Bounded(BaseModel):
    model_config = _FROZEN

    low: Number | None = None
    """What would be below is this."""
    high: Number | None = None
    """What would be above is this."""

    @model_validator(mode="after")
    def _ordered(self) -> _Bounded:
        if self.low is not None and self.high is not None and self.high < self.low:
            raise ValueError(f"high = {self.high:g} must not be below low = {self.low:g}")
        return self


class Normal(_Bounded):
    """Normal with ``mean`` and standard deviation ``sd``."""

    kind: Literal["normal"]
    mean: Number
    sd: float = Bound(ge=0.0, le=1e9)


class Lognormal(_Bounded):
    """``median`` times e to the power of a normal number with standard deviation ``sigma``."""

    kind: Literal["lognormal"]
    median: float = Bound(gt=0.0, le=1e9)
    sigma: float = Bound(ge=0.0, le=5.0)


class Choice(BaseModel):
    """One of ``options`` (numbers or materials), each target's for itself."""

    model_config = _FROZEN

    kind: Literal["choice"]
    options: tuple[Option, ...] = Bound(min_length=1, max_length=64)
    weights: tuple[Annotated[float, Bound(gt=0.0, le=1e6)], ...] = ()
    """How likely each is, relative to the others; empty: all alike."""

    @model_validator(mode="after")
    def _fits(self) -> Choice:
        if self.weights and len(self.weights) != len(self.options):
            raise ValueError(f"weights: one for each of {len(self.options)} options, given {len(self.weights)}")
        return self


class Permutation(BaseModel):
    """Each target has another one of ``options``, every order as likely."""

    model_config = _FROZEN

    kind: Literal["permutation"]
    options: tuple[Option, ...] = Bound(min_length=1, max_length=64)


Distribution = Annotated[Uniform | Normal | Lognormal | Choice | Permutation, Bound(discriminator="kind")]


class Draw(BaseModel):
    """A declared draw: one or several numbers of one kind."""

    model_config = _FROZEN

    what: Name
    """``identity`` (which material a vessel really holds where the file says ``material``, litre for litre), ``amount``
    (how much of ``material`` it holds) or ``titre`` (which share of ``material`` is that; the rest is ``inert``, litre
    for litre) of the vessels ``of``, the first and the last of bottles, too; ``gain`` or ``life`` of benches that wear,
    ``bias`` or ``trend`` of instruments that drift, as an episode begins; ``arrives``, ``within``, ``price``,
    ``amount_at_least_mol`` or ``purity_at_least`` of the orders ``of``; or a parameter of the chemistry, as
    ``pre_exponential`` and ``activation_energy`` of the reactions ``of``, ``polarity`` of the materials ``of``,
    ``ambient_temperature``."""
    of: tuple[Name, ...] = Bound(default=(), max_length=_MOST_TARGETS)
    """Whose: slots of the shelf (``slot_0``), benches whose own starting vessel is meant (``rxn``) and ``stock``, the
    bottle of ``material``; benches of a laboratory (``rxn_0``; ``rxn``: on its own), instruments, orders (``order_0``),
    reactions as equations (``A + D -> F``), materials; nothing for a number that is not anybody's."""
    material: Name | None = None
    """Of vessels and bottles: the material that the file says is in them."""
    inert: Name | None = None
    """Of a titre: what the rest is."""
    distribution: Distribution
    """What it is drawn from: ``kind`` is uniform, normal, lognormal, choice or permutation."""
    change: Literal["factor", "offset", "value"] = "factor"
    """Whether the number multiplies what the files say, is added to it, or stands in its place."""
    shared: Literal["target", "episode"] = "target"
    """Whether each of ``of`` has a number of its own, or all of them one in an episode."""
    group: Name | None = None
    """Draws of a group rise and fall together."""
    correlation: float = Bound(default=1.0, ge=0.0, le=1.0)
    """Of normal scores: the square of what a number has in common with its group."""
    told: tuple[Name, ...] = Bound(default=(), max_length=16)
    """Benches, by key, whose agents see what has been drawn; nobody else does."""
    test: tuple[tuple[Number, Number] | Name, ...] = Bound(default=(), max_length=16)
    """Regions [low, high] of the number (options by name) that training and validation never draw from; a world of the
    test split may be anywhere."""

    @model_validator(mode="after")
    def _sound(self) -> Draw:
        vessel = self.what in VESSEL_QUANTITIES
        if vessel and self.material is None:
            raise ValueError(f"material: must be given for {self.what}: what the file says is in the vessels")
        if (self.what == "titre") != (self.inert is not None):
            raise ValueError("inert: must be given for a titre (what the rest is), and for nothing else")
        if not vessel and self.material is not None:
            raise ValueError(f"material: only for {', '.join(VESSEL_QUANTITIES)}; put materials under of")
        if vessel and not self.of:
            raise ValueError("of: name at least one vessel, as slot_0")
        if self.what in DEVICE_QUANTITIES and not self.of:
            raise ValueError("of: name at least one bench or instrument")
        if self.what in ORDER_QUANTITIES and not self.of:
            raise ValueError("of: name at least one order, as order_0")
        if len(set(self.of)) != len(self.of):
            raise ValueError("of: somebody is named twice")
        self._check_options()
        self._check_regions()
        return self

    def _check_options(self) -> None:
        options = getattr(self.distribution, "options", ())
        named = [isinstance(option, str) for option in options]
        if self.what == "identity" and not (named and all(named)):
            raise ValueError("distribution: an identity is a choice or a permutation of materials")
        if self.what != "identity" and any(named):
            raise ValueError(f"distribution.options: must be numbers for {self.what}; materials are for identity")
        if isinstance(self.distribution, Permutation):
            if self.shared == "episode":
                raise ValueError("shared: a permutation gives each target its own; leave shared out")
            if len(options) < len(self.of):
                raise ValueError(f"distribution.options: {len(options)} are too few for {len(self.of)} targets")
        if isinstance(self.distribution, (Permutation, Choice)) and self.group is not None:
            raise ValueError("group: only for uniform, normal and lognormal numbers")

    def _check_regions(self) -> None:
        if isinstance(self.distribution, Permutation) and self.test:
            raise ValueError("test: a permutation has no regions; declare them for another draw")
        for region in self.test:
            if isinstance(region, str) != (self.what == "identity"):
                raise ValueError("test: must be pairs [low, high] of numbers, for an identity names of options")
            if isinstance(region, str):
                if region not in getattr(self.distribution, "options", ()):
                    raise ValueError(f"test: {region!r} is not one of the options")
            elif region[1] < region[0]:
                raise ValueError(f"test: [{region[0]:g}, {region[1]:g}]: must be [low, high]")

    @property
    def variables(self) -> int:
        """How many numbers are drawn."""
        return 1 if self.shared == "episode" else max(len(self.of), 1)

    @property
    def materials(self) -> list[str]:
        """Every material it names but those under ``of``."""
        options = [option for option in getattr(self.distribution, "options", ()) if isinstance(option, str)]
        return [name for name in (self.material, self.inert, *options) if name is not None]


class WorldSpec(BaseModel):
    """What is drawn for an episode and not told."""

    model_config = _FROZEN

    draws: dict[Annotated[str, Bound(pattern=r"^[a-z][a-z0-9_]*$", max_length=100)], Draw] = Bound(
        default={}, max_length=_MOST_DRAWS
    )
    """Declared draws by name, in the order in which they are drawn and applied."""


# -- splits -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Split:
    """A set of worlds that no other split has any of.

    Attributes:
        name: as it was given.
        number: 0 to 3, the last two bits of its worlds' numbers.
        test: whether it may have worlds of test regions.
        key: what its streams of numbers are seeded with besides an episode's seed.
    """

    name: str
    number: int
    test: bool
    key: tuple[int, ...]

    @classmethod
    def of(cls, name: str) -> Split:
        """A split by its name.

        Raises:
            ValueError: there is none of this name.
        """
        if name in SPLITS:
            return cls(name, SPLITS.index(name), name == "test", (0x776F726C, SPLITS.index(name)))
        private, colon, salt = str(name).partition(":")
        if private != _PRIVATE or not (colon and salt):
            raise ValueError(f"split: must be {', '.join(SPLITS)} or {_PRIVATE}:SALT, given {name!r:.100}")
        words = np.frombuffer(hashlib.blake2b(salt.encode(), digest_size=32).digest(), "<u4")
        return cls(name, len(SPLITS), True, (0x776F726C, len(SPLITS), *(int(word) for word in words)))

    def sequence(self, seed: np.random.SeedSequence) -> np.random.SeedSequence:
        """The seeds of worlds that belong to an episode's seeds; disturbs no other stream of them."""
        return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, *self.key))

    def world(self, seed: int) -> int:
        """Number of the split's world that a seed names."""
        bits = int(self.sequence(np.random.SeedSequence(seed)).generate_state(1, np.uint64)[0])
        return bits & ~3 | self.number


# -- drawing ----------------------------------------------------------------------------------------------------------

_UNIFORM, _NORMAL, _LOGNORMAL, _CHOICE, _PERMUTATION = range(5)


class Variables(NamedTuple):
    """Declared draws as arrays: K numbers, Q options of all of them, Z regions of all of them, in order."""

    kind: Annotated[IntArray, Field("K")]
    a: Annotated[FloatArray, Field("K")]
    """[K] low, mean, or the logarithm of the median"""
    b: Annotated[FloatArray, Field("K")]
    """[K] high, or standard deviation"""
    low: Annotated[FloatArray, Field("K")]
    high: Annotated[FloatArray, Field("K")]
    group: Annotated[IntArray, Field("K")]
    """[K] -1 for none"""
    common: Annotated[FloatArray, Field("K")]
    """[K] share of the group's score in its own; the rest is the square root of 1 less its square"""
    block: Annotated[IntArray, Field("K")]
    """[K] of a permutation, the first of its numbers"""
    first_option: Annotated[IntArray, Field("K+1")]
    options: Annotated[FloatArray, Field("Q")]
    """[Q] numbers, or indices of materials"""
    reached: Annotated[FloatArray, Field("Q")]
    """[Q] cumulative probability"""
    first_region: Annotated[IntArray, Field("K+1")]
    regions: Annotated[FloatArray, Field("Z 2")]


class WorldDraws(NamedTuple):
    """What has been drawn for N laboratories: K numbers, C groups."""

    stream: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] where the numbers of a laboratory's next worlds come from"""
    number: Annotated[StreamArray, Field("N 1", first=None)]
    """[N, 1] the world's number"""
    values: Annotated[FloatArray, Field("N K", first=None)]
    """[N, K] what was drawn"""
    work: Annotated[StreamArray, Field("N 1", first=None, kept=False)]
    """scratch, as ``scores`` [N, C]"""
    scores: Annotated[FloatArray, Field("N C", first=None, kept=False)]


def world_draws(laboratories: int, variables: Table[Variables]) -> Table[WorldDraws]:
    """Room for the draws of some laboratories."""
    groups = int(variables.arrays.group.max(initial=-1)) + 1
    sizes = {"N": laboratories, "K": len(variables.arrays.kind), "C": groups, "1": 1}
    return Table.empty(WorldDraws, **sizes)


def compile_draws(spec: WorldSpec, materials: Sequence[str]) -> Table[Variables]:
    """The declared draws as arrays.

    Raises:
        ValueError: test regions leave next to nothing to training; the message names them.
    """
    rows: list[tuple[float, ...]] = []
    options: list[list[float]] = []
    reached: list[FloatArray] = []
    regions: list[list[tuple[float, float]]] = []
    groups: list[str] = []
    kept = 1.0
    for name, draw in spec.draws.items():
        own = [float(o) if not isinstance(o, str) else float(materials.index(o)) for o in _options(draw)]
        weights = np.array(getattr(draw.distribution, "weights", ()) or [1.0] * len(own))
        reserved = [
            (float(materials.index(r)),) * 2 if isinstance(r, str) else (float(r[0]), float(r[1])) for r in draw.test
        ]
        if draw.group is not None and draw.group not in groups:
            groups.append(draw.group)
        row = (*_numbers(draw), -1 if draw.group is None else groups.index(draw.group), math.sqrt(draw.correlation))
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
    return Table(
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


def draw_limits(draw: Draw) -> tuple[float, float]:
    """Lowest and highest number that a draw can come to; of materials, nothing is said."""
    numbers = [option for option in _options(draw) if not isinstance(option, str)]
    return (min(numbers), max(numbers)) if numbers else _numbers(draw)[3:]


def changed_limits(draw: Draw, given: float) -> tuple[float, float]:
    """Lowest and highest that a draw can make of a number that the files give (0 at least, or else a value)."""
    low, high = draw_limits(draw)
    return {"factor": (low * given, high * given), "offset": (low + given, high + given)}.get(draw.change, (low, high))


def _options(draw: Draw) -> tuple[Option, ...]:
    options: tuple[Option, ...] = getattr(draw.distribution, "options", ())
    return options


def _numbers(draw: Draw) -> tuple[float, float, float, float, float]:
    """Kind, a, b, low and high of a draw's numbers."""
    drawn = draw.distribution
    if isinstance(drawn, Uniform):
        return _UNIFORM, drawn.low, drawn.high, drawn.low, drawn.high
    if isinstance(drawn, (Normal, Lognormal)):
        least = -math.inf if isinstance(drawn, Normal) else sys.float_info.min
        low = least if drawn.low is None else drawn.low
        high = math.inf if drawn.high is None else drawn.high
        if isinstance(drawn, Normal):
            return _NORMAL, drawn.mean, drawn.sd, low, high
        return _LOGNORMAL, math.log(drawn.median), drawn.sigma, low, high
    return (_CHOICE if isinstance(drawn, Choice) else _PERMUTATION), 0.0, 0.0, -math.inf, math.inf


def _reserved(
    draw: Draw, row: tuple[float, ...], options: list[float], weights: FloatArray, regions: list[tuple[float, float]]
) -> float:
    """Largest probability that a number lies in one of its test regions (regions may overlap)."""
    kind, a, b, low, high = row[:5]
    total = 0.0
    for first, last in regions:
        if kind == _CHOICE:
            inside = np.array([first <= option <= last for option in options])
            total += float(weights[inside].sum() / weights.sum())
        elif kind == _UNIFORM:
            total += max(min(last, b) - max(first, a), 0.0) / (b - a) if b > a else float(first <= a <= last)
        else:
            total += _mass(kind, a, b, (-math.inf if first <= low else first, math.inf if last >= high else last))
    return min(total, 1.0)


def _mass(kind: float, a: float, b: float, region: tuple[float, float]) -> float:
    """Probability of a region of a normal (or lognormal) number."""
    below = []
    for end in region:
        if kind == _LOGNORMAL:
            end = -math.inf if end <= 0.0 else math.log(end)
        score = (end - a) / b if b > 0.0 else math.copysign(math.inf, end - a)
        below.append(0.5 * math.erfc(-score / math.sqrt(2.0)))
    return max(below[1] - below[0], 0.0)


@inner
def _number(k: int, score: float, share: float, variables: Variables) -> float:
    """A number of the k-th distribution: by its normal score; of a choice, by its share of all."""
    kind, value = variables.kind[k], 0.0
    if kind == _UNIFORM:
        below = 0.5 * math.erfc(-score / math.sqrt(2.0))
        value = variables.a[k] + (variables.b[k] - variables.a[k]) * below
    elif kind == _NORMAL:
        value = variables.a[k] + variables.b[k] * score
    elif kind == _LOGNORMAL:
        value = math.exp(variables.a[k] + variables.b[k] * score)
    else:
        q = variables.first_option[k]
        while q < variables.first_option[k + 1] - 1 and share >= variables.reached[q]:
            q += 1
        value = variables.options[q]
    return float(min(max(value, variables.low[k]), variables.high[k]))


@inner
def _permuted(k: int, share: float, values: FloatArray, variables: Variables) -> float:
    """The next number of a permutation: one of the options that those before it have not."""
    first, last = variables.first_option[k], variables.first_option[k + 1]
    block = variables.block[k]
    left = int(share * (last - first - (k - block)))
    value = 0.0
    for q in range(first, last):
        # Options may be equal: count how often each has been taken, and how often it stood before.
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
    """Draw all numbers of the worlds of ``members`` from their worlds' numbers.

    Args:
        members: [B] laboratories.
        declared: what to draw (:class:`Variables`).
        drawn: where it goes (:class:`WorldDraws`); ``work`` holds the worlds' numbers.
        anywhere: whether worlds may lie in test regions; else they are drawn again until they do not.
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
                if variables.kind[k] == _PERMUTATION:
                    values[k] = _permuted(k, uniform(stream), values, variables)
                elif variables.kind[k] == _CHOICE:
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
    """Put the next world's number of each laboratory's stream into ``work``."""
    state = opened(WorldDraws, drawn)
    for i in range(members.shape[0]):
        n = members[i]
        state.work[n, 0] = (random_bits(state.stream[n]) & ~np.uint64(3)) | np.uint64(split)


def quantiles(draw: Draw, shares: FloatArray) -> FloatArray:
    """Numbers of a draw below which these shares of the prior lie: what whoever knows the prior may reckon with.

    Raises:
        ValueError: it is a draw of materials, or of a permutation.
    """
    kind, a, b, low, high = _numbers(draw)
    if kind == _PERMUTATION or draw.what == "identity":
        raise ValueError(f"{draw.what}: has options, and no quantiles")
    if kind == _CHOICE:
        options = np.array(_options(draw), dtype=np.float64)
        weights = np.array(getattr(draw.distribution, "weights", ()) or [1.0] * len(options))
        order = np.argsort(options, kind="stable")
        reached = np.cumsum(weights[order]) / weights.sum()
        return np.asarray(options[order][np.minimum(np.searchsorted(reached, shares, "right"), len(options) - 1)])
    if kind == _UNIFORM:
        return np.asarray(a + (b - a) * shares)
    scores = np.array([NormalDist().inv_cdf(share) for share in shares.tolist()])
    numbers = a + b * scores
    return np.clip(np.exp(numbers) if kind == _LOGNORMAL else numbers, low, high)


def positions(variables: Variables, values: FloatArray, columns: IntArray | None = None) -> FloatArray:
    """[B, C] where the ``columns`` [C] (default: all) of ``values`` [B, K] stand in their distributions, from 0 to 1:
    which share of the prior is below each, or which option it is."""
    chosen = range(values.shape[1]) if columns is None else columns.tolist()
    out = np.zeros((len(values), len(chosen)))
    for at, k in enumerate(chosen):
        own, kind, a, b = values[:, k], int(variables.kind[k]), variables.a[k], variables.b[k]
        if kind in (_CHOICE, _PERMUTATION):
            options = variables.options[variables.first_option[k] : variables.first_option[k + 1]]
            out[:, at] = (own[:, None] == options).argmax(axis=1) / max(len(options) - 1, 1)
        elif b == (a if kind == _UNIFORM else 0.0):
            out[:, at] = 0.5
        elif kind == _UNIFORM:
            out[:, at] = (own - a) / (b - a)
        else:
            score = ((np.log(np.maximum(own, sys.float_info.min)) if kind == _LOGNORMAL else own) - a) / b
            out[:, at] = [0.5 * math.erfc(-one / math.sqrt(2.0)) for one in score]
    return np.clip(out, 0.0, 1.0)


def named_values(spec: WorldSpec, values: FloatArray, materials: Sequence[str]) -> dict[str, Any]:
    """One world's numbers [K] by draw, and by target where each has its own; materials by name."""
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
    """[K] numbers in the form of :func:`named_values`; NaN for what is not given.

    Raises:
        ValueError: unknown draw or target, or a value that is none.
    """
    out = np.full(sum(draw.variables for draw in spec.draws.values()), np.nan)
    unknown = [name for name in given if name not in spec.draws]
    if unknown:
        raise ValueError(f"world: {unknown[0]!r:.100} is not drawn; known: {', '.join(spec.draws) or 'nothing'}")
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
    options = _options(draw)
    if options and value not in options:
        raise ValueError(f"{where}: must be one of {', '.join(map(str, options))}, given {value!r:.100}")
    if draw.what == "identity":
        return float(materials.index(value))
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ValueError(f"{where}: must be a finite number, given {value!r:.100}")
    _, _, _, low, high = _numbers(draw)
    if not low <= value <= high:
        raise ValueError(f"{where}: must be from {low:g} to {high:g}, given {value:g}")
    return float(value)
