"""Models of hidden parameters: what is drawn for an episode, from which distribution, and shared by what.

A scenario declares them under ``[world.draws]``; agents know the declaration (the prior) and not the draw.
:mod:`chemlab.lab.sampling` draws from them, :mod:`chemlab.lab.hidden` puts what is drawn into a laboratory.

A world is its *number*, 64 bits, from which all of its draws follow. The number's last two bits say its split, so no
number is in two of them. Every laboratory has a stream of numbers of its own that no other stream depends on: with or
without a world, all else that is drawn is the same.
"""

from __future__ import annotations

import hashlib
import math
import sys
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator
from pydantic import Field as Bound

__all__ = [
    "BOTTLE",
    "CHOICE",
    "DEVICE_QUANTITIES",
    "LOGNORMAL",
    "NORMAL",
    "ORDER_QUANTITIES",
    "PERMUTATION",
    "SPLITS",
    "UNIFORM",
    "VESSEL_QUANTITIES",
    "Choice",
    "Distribution",
    "Draw",
    "Lognormal",
    "Normal",
    "Permutation",
    "Split",
    "Uniform",
    "WorldSpec",
    "changed_limits",
    "draw_limits",
    "numbers_of",
    "options_of",
]

_FROZEN = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
_MOST_DRAWS = 64
_MOST_TARGETS = 64
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


UNIFORM, NORMAL, LOGNORMAL, CHOICE, PERMUTATION = range(5)
"""Kinds of distribution by number, as kernels have them."""


def draw_limits(draw: Draw) -> tuple[float, float]:
    """Lowest and highest number that a draw can come to; of materials, nothing is said."""
    numbers = [option for option in options_of(draw) if not isinstance(option, str)]
    return (min(numbers), max(numbers)) if numbers else numbers_of(draw)[3:]


def changed_limits(draw: Draw, given: float) -> tuple[float, float]:
    """Lowest and highest that a draw can make of a number that the files give (0 at least, or else a value)."""
    low, high = draw_limits(draw)
    return {"factor": (low * given, high * given), "offset": (low + given, high + given)}.get(draw.change, (low, high))


def options_of(draw: Draw) -> tuple[Option, ...]:
    """Return the options of a choice or a permutation."""
    options: tuple[Option, ...] = getattr(draw.distribution, "options", ())
    return options


def numbers_of(draw: Draw) -> tuple[float, float, float, float, float]:
    """Kind, a, b, low and high of a draw's numbers."""
    drawn = draw.distribution
    if isinstance(drawn, Uniform):
        return UNIFORM, drawn.low, drawn.high, drawn.low, drawn.high
    if isinstance(drawn, (Normal, Lognormal)):
        least = -math.inf if isinstance(drawn, Normal) else sys.float_info.min
        low = least if drawn.low is None else drawn.low
        high = math.inf if drawn.high is None else drawn.high
        if isinstance(drawn, Normal):
            return NORMAL, drawn.mean, drawn.sd, low, high
        return LOGNORMAL, math.log(drawn.median), drawn.sigma, low, high
    return (CHOICE if isinstance(drawn, Choice) else PERMUTATION), 0.0, 0.0, -math.inf, math.inf
