"""Models of hidden parameters: declarations of draws and their distributions.

A scenario declares them under ``[world.draws]``; agents know the declaration (the prior), but not the draw.
:mod:`chemlab.lab.sampling` samples them, and :mod:`chemlab.lab.hidden` applies them to laboratories.

A world is identified by a 64-bit *number* that determines all of its draws. The number's last two bits are its split,
so the splits are disjoint. Every laboratory has a separate random stream for worlds: with or without hidden parameters,
all other random numbers are the same.
"""

from __future__ import annotations

import hashlib
import math
import re
import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field as Bound
from pydantic import model_validator

from .datamodel import DataModel

_MOST_DRAWS = 64
_MOST_TARGETS = 64
Number = Annotated[float, Bound(ge=-1e9, le=1e9)]
Name = Annotated[str, Bound(min_length=1, max_length=500)]
Option = float | Name

SPLITS = ("train", "validation", "test")
"""Splits by name; ``private:SALT`` is another one, which requires the salt: 32 hexadecimal digits at least."""

_PRIVATE = "private"

VESSEL_QUANTITIES = ("identity", "amount", "titre")
"""Quantities of a vessel's contents that may be drawn."""

BOTTLE = "stock"
"""Name of the bottle of the material among the targets of an identity or a titre."""

DEVICE_QUANTITIES = ("gain", "life", "bias", "trend")
"""Quantities that may be drawn for degrading benches (gain, life) and drifting instruments (bias, trend)."""

ORDER_QUANTITIES = ("arrives", "within", "price", "amount_at_least_mol", "purity_at_least")
"""Order terms that may be drawn."""


class Uniform(DataModel):
    """Uniform distribution from ``low`` to ``high``."""

    kind: Literal["uniform"]
    low: Number
    high: Number

    @model_validator(mode="after")
    def _ordered(self) -> Uniform:
        if self.high < self.low:
            raise ValueError(f"high = {self.high:g} must not be below low = {self.low:g}")
        return self


class _Bounded(DataModel):
    low: Number | None = None
    """Lower bound; smaller values are clipped."""
    high: Number | None = None
    """Upper bound; larger values are clipped."""

    @model_validator(mode="after")
    def _ordered(self) -> _Bounded:
        if self.low is not None and self.high is not None and self.high < self.low:
            raise ValueError(f"high = {self.high:g} must not be below low = {self.low:g}")
        return self


class Normal(_Bounded):
    """Normal distribution with ``mean`` and standard deviation ``sd``."""

    kind: Literal["normal"]
    mean: Number
    sd: float = Bound(ge=0.0, le=1e9)


class Lognormal(_Bounded):
    """Lognormal distribution: ``median`` times the exponential of a normal number with standard deviation ``sigma``."""

    kind: Literal["lognormal"]
    median: float = Bound(gt=0.0, le=1e9)
    sigma: float = Bound(ge=0.0, le=5.0)


class Choice(DataModel):
    """One of ``options`` (numbers or materials), independently for each target."""

    kind: Literal["choice"]
    options: tuple[Option, ...] = Bound(min_length=1, max_length=64)
    weights: tuple[Annotated[float, Bound(gt=0.0, le=1e6)], ...] = ()
    """Relative probabilities of the options; empty: equal."""

    @model_validator(mode="after")
    def _fits(self) -> Choice:
        if self.weights and len(self.weights) != len(self.options):
            raise ValueError(f"weights: must be one for each of {len(self.options)} options, given {len(self.weights)}")
        return self


class Permutation(DataModel):
    """Random permutation: each target has a different one of ``options``, all orders equally likely."""

    kind: Literal["permutation"]
    options: tuple[Option, ...] = Bound(min_length=1, max_length=64)


Distribution = Annotated[Uniform | Normal | Lognormal | Choice | Permutation, Bound(discriminator="kind")]


class Draw(DataModel):
    """A declared draw: one or several numbers of one kind."""

    what: Name
    """Quantity that is drawn.

    Of the vessels ``of`` (and, for the first and the last, of bottles): ``identity`` (the true material in place of
    ``material``, litre for litre), ``amount`` (of ``material``) or ``titre`` (share of ``material`` that is genuine;
    the rest is ``inert``, litre for litre). Of degrading benches: ``gain`` or ``life``, and of drifting instruments:
    ``bias`` or ``trend``, at the start of an episode. Of the orders ``of``: ``arrives``, ``within``, ``price``,
    ``amount_at_least_mol`` or ``purity_at_least``. Otherwise a parameter of the chemistry, such as ``pre_exponential``
    or ``activation_energy`` of the reactions ``of``, ``polarity`` of the materials ``of``, or ``ambient_temperature``.
    """
    of: tuple[Name, ...] = Bound(default=(), max_length=_MOST_TARGETS)
    """Targets of the draw; empty for a single number without target.

    They are slots of the shelf (``slot_0``), benches for their own initial vessel (``rxn``), ``stock`` for the bottle
    of ``material``, benches of a laboratory (``rxn_0``; ``rxn`` for a single bench), instruments, orders (``order_0``),
    reactions as equations (``A + D -> F``), or materials.
    """
    material: Name | None = None
    """Declared material of the vessels and bottles."""
    inert: Name | None = None
    """Remainder of a titre."""
    distribution: Distribution
    """Distribution; ``kind`` is uniform, normal, lognormal, choice or permutation."""
    change: Literal["factor", "offset", "value"] = "factor"
    """Operation on the declared value: multiply, add, or replace."""
    shared: Literal["target", "episode"] = "target"
    """``target``: each target has its own number; ``episode``: all targets share one."""
    group: Name | None = None
    """Draws of a group are correlated."""
    correlation: float = Bound(default=1.0, ge=0.0, le=1.0)
    """Share of the group's common score in the variance of the normal score."""
    told: tuple[Name, ...] = Bound(default=(), max_length=16)
    """Benches, by key, whose agents observe the drawn values, or ``manager``; no other agent does."""
    test: tuple[tuple[Number, Number] | Name, ...] = Bound(default=(), max_length=16)
    """Regions [low, high] of the number (options by name) that training and validation never draw from.

    Worlds of the test split may be anywhere.
    """

    @model_validator(mode="after")
    def _sound(self) -> Draw:
        vessel = self.what in VESSEL_QUANTITIES
        if vessel and self.material is None:
            raise ValueError(f"material: required for {self.what}: the declared material in the vessels")
        if self.what == "titre" and self.inert is None:
            raise ValueError("inert: required for titre: the material that makes up the rest")
        if self.what != "titre" and self.inert is not None:
            raise ValueError(f"inert: only for what = 'titre', given what = {self.what!r}")
        if not vessel and self.material is not None:
            raise ValueError(f"material: only for {', '.join(VESSEL_QUANTITIES)}; put materials under of")
        if vessel and not self.of:
            raise ValueError("of: name at least one vessel, as slot_0")
        if self.what in DEVICE_QUANTITIES and not self.of:
            raise ValueError("of: name at least one bench or instrument")
        if self.what in ORDER_QUANTITIES and not self.of:
            raise ValueError("of: name at least one order, as order_0")
        if self.correlation != 1.0 and self.group is None:
            raise ValueError(
                "correlation: has no effect without a group; give draws that are correlated the same group"
            )
        if len(set(self.of)) != len(self.of):
            raise ValueError("of: a target is named twice")
        self._check_options()
        self._check_regions()
        return self

    def _check_options(self) -> None:
        options = getattr(self.distribution, "options", ())
        named = [isinstance(option, str) for option in options]
        if self.what == "identity" and not (named and all(named)):
            raise ValueError("distribution: must be a choice or a permutation of materials for an identity")
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
            elif region[1] < (limits := draw_limits(self))[0] or region[0] > limits[1]:
                raise ValueError(
                    f"test: [{region[0]:g}, {region[1]:g}]: nothing is drawn there; the distribution has numbers from "
                    f"{limits[0]:g} to {limits[1]:g}"
                )

    @property
    def variables(self) -> int:
        """Number of drawn numbers."""
        return 1 if self.shared == "episode" else max(len(self.of), 1)

    @property
    def materials(self) -> list[str]:
        """All materials that it names, except under ``of``."""
        options = [option for option in getattr(self.distribution, "options", ()) if isinstance(option, str)]
        return [name for name in (self.material, self.inert, *options) if name is not None]


class WorldSpec(DataModel):
    """Hidden parameters of a scenario."""

    draws: dict[Annotated[str, Bound(pattern=r"^[a-z][a-z0-9_]*$", max_length=100)], Draw] = Bound(
        default={}, max_length=_MOST_DRAWS
    )
    """Declared draws by name, in the order of drawing and application."""
    revealed: bool = False
    """True: all agents observe all drawn values."""

    def told_to(self, key: str) -> list[str]:
        """Return the draws whose values are revealed to a bench, by key, or to the ``manager``."""
        return [name for name, draw in self.draws.items() if self.revealed or key in draw.told]

    def numbers(self, names: Sequence[str]) -> int:
        """Return how many numbers some draws have."""
        return sum(self.draws[name].variables for name in names)


@dataclass(frozen=True)
class Split:
    """A set of worlds, disjoint from the other splits.

    Attributes:
        name: name of the split.
        number: 0 to 3, the last two bits of its worlds' numbers.
        test: whether it may have worlds of test regions.
        key: seed of its random streams, in addition to an episode's seed.
    """

    name: str
    number: int
    test: bool
    key: tuple[int, ...]

    @property
    def public(self) -> str:
        """Its name without a salt, which is secret."""
        return self.name.partition(":")[0]

    @classmethod
    def of(cls, name: str) -> Split:
        """Return a split by name.

        Raises:
            ValueError: the name is unknown.
        """
        if name in SPLITS:
            return cls(name, SPLITS.index(name), name == "test", (0x776F726C, SPLITS.index(name)))
        private, _, salt = str(name).partition(":")
        if private != _PRIVATE or re.fullmatch("[0-9a-fA-F]{32,200}", salt, re.ASCII) is None:
            raise ValueError(
                f"split: must be {', '.join(SPLITS)} or {_PRIVATE}:SALT, with 128 random bits or more as hexadecimal "
                f"digits, for instance the new {_PRIVATE}:{secrets.token_hex(16)}; given {name!r:.100}"
            )
        words = np.frombuffer(hashlib.blake2b(salt.encode(), digest_size=32).digest(), "<u4")
        return cls(name, len(SPLITS), True, (0x776F726C, len(SPLITS), *(int(word) for word in words)))

    def sequence(self, seed: np.random.SeedSequence) -> np.random.SeedSequence:
        """Return the seed sequence of the worlds of an episode seed, independent of the episode's other streams."""
        return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, *self.key))

    def world(self, seed: int) -> int:
        """Return the number of the split's world with a seed."""
        bits = int(self.sequence(np.random.SeedSequence(seed)).generate_state(1, np.uint64)[0])
        return bits & ~3 | self.number


UNIFORM, NORMAL, LOGNORMAL, CHOICE, PERMUTATION = range(5)
"""Kinds of distribution by number, as kernels have them."""


def draw_limits(draw: Draw) -> tuple[float, float]:
    """Return the lowest and highest possible number of a draw; meaningless for materials."""
    numbers = [option for option in options_of(draw) if not isinstance(option, str)]
    return (min(numbers), max(numbers)) if numbers else numbers_of(draw)[3:]


def changed_limits(draw: Draw, given: float) -> tuple[float, float]:
    """Return the lowest and highest possible result of a draw for a declared number (at least 0), or its own limits."""
    low, high = draw_limits(draw)
    return {"factor": (low * given, high * given), "offset": (low + given, high + given)}.get(draw.change, (low, high))


def options_of(draw: Draw) -> tuple[Option, ...]:
    """Return the options of a choice or a permutation."""
    options: tuple[Option, ...] = getattr(draw.distribution, "options", ())
    return options


def numbers_of(draw: Draw) -> tuple[float, float, float, float, float]:
    """Return kind, a, b, low and high of a draw's numbers."""
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
