"""Activity coefficients of liquid mixtures: binary NRTL parameters as data.

A pair file has a ``[lock]`` table (its origin) and ``pairs``, a row for each pair of materials. Renon and Prausnitz,
AIChE J. 14 (1968) 135: with tau_ij = a_ij + b_ij / T + c_ij ln(T / 300 K) and G_ij = exp(-alpha_ij tau_ij),

    ln gamma_i = sum_j x_j tau_ji G_ji / sum_k x_k G_ki
               + sum_j x_j G_ij / sum_k x_k G_kj (tau_ij - sum_k x_k tau_kj G_kj / sum_k x_k G_kj).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field, model_validator

from ..kernels.arrays import FloatArray
from .datafile import DataError, read_toml
from .datamodel import DataModel, validated
from .materials import Text

REFERENCE_K = 300.0
"""Temperature at which ln(T / 300 K) is 0."""
_SHOWN = 3
STRONGEST = 100.0
"""Largest absolute value of tau, in a file at the ends of its range, and in the extrapolation by kernels."""

Both = tuple[Annotated[float, Field(ge=-1e5, le=1e5)], Annotated[float, Field(ge=-1e5, le=1e5)]]
"""Values of tau_12 and tau_21."""


class Pair(DataModel):
    """NRTL parameters of two materials, 1 and 2 in the order of ``of``."""

    of: tuple[Text, Text]
    a: Both
    b: Both
    """K"""
    c: Both = (0.0, 0.0)
    alpha: float = Field(ge=0.01, le=1.0)
    low_k: float = Field(ge=100.0, le=2000.0)
    high_k: float = Field(ge=100.0, le=2000.0)
    """Upper end of the temperature range of the parameters."""
    error: float = Field(ge=0.0, le=10.0)
    """Largest error of ln gamma relative to the source, in miscible mixtures and at infinite dilution."""
    source: str = Field(min_length=1)

    @model_validator(mode="after")
    def _sound(self) -> Pair:
        if self.of[0] == self.of[1]:
            raise ValueError(f"of: must be two different materials, given {list(self.of)}")
        if self.low_k >= self.high_k:
            raise ValueError(f"high_k = {self.high_k} must be above low_k = {self.low_k}")
        for temperature in (self.low_k, self.high_k):
            if max(abs(tau) for tau in self.tau(temperature)) > STRONGEST:
                raise ValueError(f"tau is beyond {STRONGEST:g} at {temperature} K")
        return self

    def tau(self, temperature_k: float) -> tuple[float, float]:
        """Return tau_12 and tau_21 at a temperature in K."""
        rest = math.log(temperature_k / REFERENCE_K)
        first, second = (a + b / temperature_k + c * rest for a, b, c in zip(self.a, self.b, self.c, strict=True))
        return first, second


Pairs = Mapping[frozenset[str], Pair]
"""Pairs by the ids of their two materials."""


class PairFile(DataModel):
    """A file of pairs."""

    lock: dict[Text, str] = Field(max_length=50)
    """Origin of the file: command and versions."""
    pairs: tuple[Pair, ...] = Field(max_length=10_000)


class PairTable(NamedTuple):
    """NRTL parameters of M materials: tau_ij = a_ij + b_ij / T + c_ij ln(T / 300 K), all [M, M], 0 for i = j."""

    a: FloatArray
    b: FloatArray
    c: FloatArray
    alpha: FloatArray

    def tau(self, temperature_k: float) -> FloatArray:
        """Return [M, M] tau at a temperature in K."""
        return self.a + self.b / temperature_k + self.c * math.log(temperature_k / REFERENCE_K)


def load_pairs(paths: Iterable[Path]) -> dict[frozenset[str], Pair]:
    """Read pair files into ``{{material, other}: Pair}``.

    A later file replaces pairs of an earlier one, so that measured parameters can replace the bundled ones.

    Raises:
        DataError: a file is missing or malformed, a value is out of bounds, or a file has a pair twice.
    """
    pairs: dict[frozenset[str], Pair] = {}
    for path in paths:
        file = validated(PairFile, read_toml(path), str(path))
        found = {frozenset(pair.of): pair for pair in file.pairs}
        if len(found) < len(file.pairs):
            ((names, _),) = Counter(frozenset(pair.of) for pair in file.pairs).most_common(1)
            first, second = sorted(names)
            raise DataError(f"{path}: pairs: {first!r} with {second!r} is listed twice; remove one of them")
        pairs |= found
    return pairs


@functools.lru_cache(maxsize=1)
def shipped_pairs() -> dict[frozenset[str], Pair]:
    """Return the bundled pairs."""
    return load_pairs(sorted((Path(__file__).parent.parent / "data" / "pairs").glob("*.toml")))


def pair_table(names: Sequence[str], pairs: Pairs) -> PairTable:
    """Return the parameters of every pair among some materials.

    Args:
        names: the M materials, in the order of the arrays' rows and columns.
        pairs: from :func:`load_pairs`.

    Raises:
        DataError: a pair is missing; the message names it and the command that makes it.
    """
    missing = [two for two in itertools.combinations(names, 2) if frozenset(two) not in pairs]
    if missing:
        shown = ", ".join(f"{one!r} with {other!r}" for one, other in missing[:_SHOWN])
        more = f" and {len(missing) - _SHOWN} more" if len(missing) > _SHOWN else ""
        concerned = " ".join(repr(name) for name in names if any(name in two for two in missing))
        raise DataError(
            f"pairs: no activity coefficients of {shown}{more}; make them with "
            f"pip install '.[chem]' and chemlab data pairs {concerned} -o my_pairs.toml "
            "(--materials FILE for materials of your own), and name that file in pair_files"
        )
    size = len(names)
    table = PairTable(*(np.zeros((size, size)) for _ in range(4)))
    for i, j in itertools.permutations(range(size), 2):
        pair = pairs[frozenset((names[i], names[j]))]
        side = 0 if pair.of[0] == names[i] else 1
        table.a[i, j], table.b[i, j], table.c[i, j] = pair.a[side], pair.b[side], pair.c[side]
        table.alpha[i, j] = pair.alpha
    return table


def log_activity_coefficients(mole_fractions: FloatArray, tau: FloatArray, alpha: FloatArray) -> FloatArray:
    """Return ln of the NRTL activity coefficients.

    Args:
        mole_fractions: [..., M] mole fractions of mixtures.
        tau: [..., M, M].
        alpha: [..., M, M] or a number.

    Returns:
        [..., M].
    """
    g = np.exp(-alpha * tau)
    below = np.einsum("...k,...kj->...j", mole_fractions, g)
    mean = np.einsum("...k,...kj->...j", mole_fractions, tau * g) / below
    share = mole_fractions / below
    result: FloatArray = (
        mean + np.einsum("...j,...ij->...i", share, g * tau) - np.einsum("...j,...ij->...i", share * mean, g)
    )
    return result
