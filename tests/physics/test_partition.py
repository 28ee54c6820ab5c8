"""Partition: the settled limit in closed form, the three-case update by hand, conservation through any sequence."""

import math

import numpy as np
import pytest
from helpers import Glassware, four_solvents, molar_volume

from chemlab.physics.chemistry import CLOCK, CLOCK_WAS
from chemlab.physics.shelf import CLOCK_SETTLED, T_MIX

FOUR = Glassware(four_solvents(), 2)
SOLVENTS = ("water", "diethyl_ether", "hexane", "ethyl_acetate")


def star(glass: Glassware, contents: dict[str, float], solute: str, clock: float) -> dict[str, float]:
    """S*_L(t) / [S] of PHYSICS section 3 for each solvent in ``contents``, written out again."""
    materials = glass.scenario.materials
    litres = {name: contents[name] * molar_volume(glass.scenario, name) for name in contents if name in SOLVENTS}
    gaps = {name: abs(materials[solute].polarity - materials[name].polarity) for name in litres}
    whole, gap_sum = sum(litres.values()), sum(gaps.values())
    weighted = sum(litres[name] * gaps[name] for name in litres)
    a = math.exp(30.0 * (T_MIX - clock))
    shares = {}
    for name, volume in litres.items():
        w = (1.0 - gaps[name] / gap_sum) / (1.0 - weighted / (whole * gap_sum))
        shares[name] = volume / whole * (a + (1.0 - a) * w)
    return shares


def where(glass: Glassware, position: int, solute: str, solvents: tuple[str, ...]) -> list[float]:
    return [glass.in_solvent(position, solute, name) for name in solvents]


@pytest.mark.parametrize("solute", ["Na+", "dodecane"])
def test_four_solvents_at_rest_follow_the_formula(solute: str) -> None:
    """Settled and mixed, four solvents hold what S*_L says."""
    contents = {"water": 6.0, "diethyl_ether": 3.0, "hexane": 1.0, "ethyl_acetate": 2.0}
    FOUR.mixed(0, {**contents, "NaCl": 0.5, "dodecane": 0.2}, 2.0)
    total, mixed = FOUR.amount(0, solute), star(FOUR, contents, solute, T_MIX)
    assert where(FOUR, 0, solute, SOLVENTS) == pytest.approx([total * mixed[name] for name in SOLVENTS], rel=1e-12)
    litres = [FOUR.volume(0, name) for name in SOLVENTS]
    assert [mixed[name] for name in SOLVENTS] == pytest.approx(np.array(litres) / sum(litres), rel=1e-12)
    FOUR.turn(0, 100.0)
    rest = star(FOUR, contents, solute, CLOCK_SETTLED)
    assert where(FOUR, 0, solute, SOLVENTS) == pytest.approx([total * rest[name] for name in SOLVENTS], rel=1e-12)


def test_solvents_as_polar_as_the_solute_share_it_by_volume() -> None:
    """All differences in polarity are 0 then, and no solvent is preferred."""
    glass = Glassware(four_solvents(), 1)
    glass.known.polarity[:] = 0.5
    glass.mixed(0, {"water": 6.0, "hexane": 1.0, "dodecane": 0.2})
    glass.turn(0, 100.0)
    in_water, in_hexane = where(glass, 0, "dodecane", ("water", "hexane"))
    assert in_water / in_hexane == pytest.approx(glass.volume(0, "water") / glass.volume(0, "hexane"), rel=1e-12)


@pytest.mark.parametrize("clock", [T_MIX, 0.0, CLOCK_SETTLED])
def test_one_solvent_holds_everything(clock: float) -> None:
    """With one solvent every solute is in it, at any clock and wherever it was before."""
    FOUR.fill(0, {"hexane": 2.0, "dodecane": 0.3, "Na+": 0.1, "Cl-": 0.1}, clock=clock)
    FOUR.dissolved(0)[:] = 0.02
    FOUR.partition(0)
    for solute in FOUR.layout.dissolved:
        total = FOUR.amount(0, solute)
        assert where(FOUR, 0, solute, SOLVENTS) == [0.0, 0.0, pytest.approx(total, rel=1e-15), 0.0]


def test_no_solvent_dissolves_nothing() -> None:
    """Without any solvent no solute is listed as dissolved, though it is there."""
    FOUR.fill(0, {"dodecane": 0.3, "1-chlorohexane": 0.2})
    FOUR.dissolved(0)[:] = 0.02
    FOUR.partition(0)
    assert (FOUR.dissolved(0) == 0.0).all()
    assert FOUR.amount(0, "dodecane") == 0.3


def test_vessel_as_filled_holds_the_settled_distribution() -> None:
    """A vessel put on the shelf with two solvents and a solute in it is at rest: the solute is where S* has it."""
    contents = {"water": 6.0, "diethyl_ether": 3.0}
    FOUR.fill(0, {**contents, "dodecane": 0.2})
    FOUR.phases(0)
    FOUR.partition(0)
    rest = star(FOUR, contents, "dodecane", CLOCK_SETTLED)
    expected = [0.2 * rest["water"], 0.2 * rest["diethyl_ether"]]
    assert where(FOUR, 0, "dodecane", SOLVENTS[:2]) == pytest.approx(expected, rel=1e-9)


PAIR = {"water": 6.0, "hexane": 3.0}


def start(clock: float, in_water: float, in_hexane: float) -> None:
    """A vessel whose dodecane is known to be so much in water and so much in hexane at ``clock``."""
    FOUR.fill(0, {**PAIR, "dodecane": in_water + in_hexane}, clock=clock)[CLOCK_WAS] = clock
    k = FOUR.layout.dissolved.index("dodecane")
    FOUR.dissolved(0)[k] = 0.0
    FOUR.dissolved(0)[k, FOUR.layout.solvents.index("water")] = in_water
    FOUR.dissolved(0)[k, FOUR.layout.solvents.index("hexane")] = in_hexane


def in_water() -> float:
    return FOUR.in_solvent(0, "dodecane", "water")


def test_settling_keeps_the_deviation() -> None:
    """t > t': S(t) = S*(t) + S(t') - S*(t'); t = t': S stays, whatever S* is."""
    start(T_MIX + 0.3, 0.18, 0.02)
    FOUR.partition(0)
    assert in_water() == pytest.approx(0.18, rel=1e-14)
    before, after = T_MIX + 0.01, T_MIX + 0.05
    start(before, 0.05, 0.15)
    FOUR.turn(0, 0.04)
    stars = [star(FOUR, PAIR, "dodecane", t)["water"] for t in (before, after)]
    assert stars[0] > stars[1]
    assert 0.05 + 0.2 * (stars[1] - stars[0]) > 0.0  # so nothing is clipped
    assert in_water() == pytest.approx(0.05 + 0.2 * (stars[1] - stars[0]), rel=1e-12)
    assert FOUR.in_solvent(0, "dodecane", "hexane") == pytest.approx(0.2 - in_water(), rel=1e-12)
    assert FOUR.rows[0, CLOCK_WAS] == FOUR.rows[0, CLOCK] == pytest.approx(after, abs=1e-15)


def test_mixing_shrinks_the_deviation() -> None:
    """t < t': S(t) = S*(t) + (t - t_mix) / (t' - t_mix) (S(t') - S*(t'))."""
    before, after = T_MIX + 0.08, T_MIX + 0.02
    start(before, 0.15, 0.05)
    FOUR.turn(0, -0.06)
    stars = [star(FOUR, PAIR, "dodecane", t)["water"] for t in (before, after)]
    expected = 0.2 * stars[1] + (0.02 / 0.08) * (0.15 - 0.2 * stars[0])
    assert 0.0 < expected < 0.2
    assert in_water() == pytest.approx(expected, rel=1e-12)
    assert FOUR.in_solvent(0, "dodecane", "hexane") == pytest.approx(0.2 - expected, rel=1e-12)


def test_what_would_be_negative_is_clipped_and_the_rest_scaled() -> None:
    """Where the update asks for less than nothing in water, all of it is in hexane."""
    before = T_MIX + 0.01
    start(before, 0.0, 0.2)
    FOUR.turn(0, 0.5)
    assert star(FOUR, PAIR, "dodecane", T_MIX + 0.51)["water"] < star(FOUR, PAIR, "dodecane", before)["water"]
    assert where(FOUR, 0, "dodecane", ("water", "hexane")) == [0.0, pytest.approx(0.2, rel=1e-15)]


@pytest.mark.parametrize("trace", [5e-324, 1e-311, 1e-200])
def test_adding_to_a_trace_of_a_solute_stays_finite(trace: float) -> None:
    """A mole added to next to nothing of the same solute: all of it is somewhere, nothing is infinite."""
    FOUR.mixed(0, {"water": 6.0, "hexane": 3.0, "dodecane": trace})
    FOUR.add(0, "dodecane", 1.0)
    FOUR.partition(0)
    assert np.isfinite(FOUR.rows).all()
    assert sum(where(FOUR, 0, "dodecane", SOLVENTS)) == pytest.approx(1.0, rel=1e-12)
