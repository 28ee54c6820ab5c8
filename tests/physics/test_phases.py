"""Phases: the closed-form salt equilibrium against SciPy's stiff solvers; what reacts at once, by stoichiometry."""

from typing import Any

import numpy as np
import pytest
from helpers import Glassware, four_solvents, mapping
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.physics.backends import settle_phases
from chemlab.physics.chemistry import AMOUNTS, build_chemistry
from chemlab.physics.events import METAL_IN_WATER
from chemlab.physics.shelf import CLOCK_SETTLED, Shelf

GLASS = Glassware(four_solvents(), 1)
IONIC = ("NaCl", "NaOH", "Na+", "Cl-", "OH-")
SOLVENTS = ("water", "diethyl_ether", "hexane", "ethyl_acetate")


def steady_state(contents: dict[str, float], method: str = "Radau") -> dict[str, float]:
    """Amounts where the rate equations of PHYSICS section 5 come to rest, by SciPy, k = 1e4, in 1 L."""
    k = 1e4
    order = {name: i for i, name in enumerate(IONIC)}
    solvents = [contents.get(name, 0.0) for name in SOLVENTS]

    def slope(_: float, amount: np.ndarray) -> np.ndarray:
        change = np.zeros(len(IONIC))
        for salt, (cation, anion) in {"NaCl": ("Na+", "Cl-"), "NaOH": ("Na+", "OH-")}.items():
            dissolving = sum(k * amount[order[salt]] * solvent for solvent in solvents)
            rate = dissolving - k * amount[order[cation]] * amount[order[anion]]
            change[[order[cation], order[anion]]] += rate
            change[order[salt]] -= rate
        return change

    begin = [contents.get(name, 0.0) for name in IONIC]
    # The slowest rates here are k x 1e-2 mol: a time of 1 is hundreds of the longest time constants.
    solution = solve_ivp(slope, (0.0, 1.0), begin, method=method, rtol=1e-9, atol=1e-12)
    assert solution.success
    return dict(zip(IONIC, solution.y[:, -1], strict=True))


def settled(contents: dict[str, float], capacity: float = 5.0) -> dict[str, float]:
    """Amounts of salts and ions in a vessel after its phase step."""
    GLASS.fill(0, contents, capacity)
    GLASS.phases(0)
    return {name: GLASS.amount(0, name) for name in IONIC}


small = st.floats(0.01, 3.0)


@given(
    st.dictionaries(st.sampled_from(SOLVENTS), small, min_size=1),
    st.dictionaries(st.sampled_from(IONIC), small, min_size=2),
)
@settings(max_examples=25)
def test_mixtures_come_to_the_rest_of_their_rate_equations(solvents: dict[str, float], ionic: dict[str, float]) -> None:
    """The same for random amounts of both salts and all ions, neutral or not, in up to four solvents."""
    contents = {**solvents, **ionic}
    GLASS.fill(0, contents, 20.0)
    before = GLASS.volume(0), GLASS.heat_capacity(0)
    assert settled(contents, 20.0) == pytest.approx(steady_state(contents), abs=1e-6)
    # Ions were given the volume and heat capacity of their salt.
    assert (GLASS.volume(0), GLASS.heat_capacity(0)) == pytest.approx(before, rel=1e-6)


def test_one_salt_by_hand() -> None:
    """1 mol NaCl in 2 mol of solvent: (1 - c) 2 = c^2, so c = sqrt(3) - 1."""
    found = settled({"NaCl": 1.0, "water": 1.5, "hexane": 0.5})
    free = np.sqrt(3.0) - 1.0
    assert found == pytest.approx({"NaCl": 1.0 - free, "NaOH": 0.0, "Na+": free, "Cl-": free, "OH-": 0.0}, abs=1e-14)


def test_without_solvent_everything_is_solid() -> None:
    """No solvent: all ion pairs are salt; only a surplus of one kind stays an ion."""
    found = settled({"Na+": 0.5, "Cl-": 0.3, "OH-": 0.2, "NaCl": 0.1, "dodecane": 1.0})
    assert found == pytest.approx({"NaCl": 0.4, "NaOH": 0.2, "Na+": 0.0, "Cl-": 0.0, "OH-": 0.0}, abs=1e-15)
    lone = settled({"Na+": 0.7, "Cl-": 0.3})
    assert lone == pytest.approx({"NaCl": 0.3, "NaOH": 0.0, "Na+": 0.4, "Cl-": 0.0, "OH-": 0.0}, abs=1e-15)


def test_new_ions_dissolve_where_they_tend_to_be() -> None:
    """What comes into solution is listed as dissolved at once: all of it, more per litre in water than in ether."""
    row = GLASS.fill(0, {"NaCl": 1.0, "water": 5.0, "diethyl_ether": 2.0})
    GLASS.phases(0)
    GLASS.partition(0)
    in_water, in_ether = (GLASS.in_solvent(0, "Na+", name) for name in ("water", "diethyl_ether"))
    assert in_water + in_ether == pytest.approx(GLASS.amount(0, "Na+"), rel=1e-12)
    assert in_water / GLASS.volume(0, "water") > in_ether / GLASS.volume(0, "diethyl_ether")
    assert row[AMOUNTS + GLASS.index("NaCl")] > 0.0


def test_nothing_happens_to_an_empty_vessel_or_to_oil() -> None:
    """No salt, no ions, no metal: the phase step changes no bit."""
    metal = {"Na": 1.0, "diethyl_ether": 4.0, "1-chlorohexane": 1.0}
    for contents in ({}, {"dodecane": 1.0}, {"water": 2.0, "hexane": 1.0}, metal):
        row = GLASS.fill(0, contents, clock=CLOCK_SETTLED)
        before = row.copy()
        GLASS.phases(0)
        assert (row == before).all()
    assert (GLASS.events == 0.0).all()


@pytest.mark.parametrize(
    ("metal", "water", "reacted"), [(0.4, 5.0, 0.4), (1.0 / 3.0, 7.0, 1.0 / 3.0), (2.0, 0.5, 0.5), (1.0, 1.0, 1.0)]
)
def test_metal_in_water_reacts_until_one_is_gone(metal: float, water: float, reacted: float) -> None:
    """2 Na + 2 H2O -> 2 Na+ + 2 OH- + H2: by stoichiometry, the gas in the waste, the metal an event."""
    glass = Glassware("wurtz_dodecane", 1)
    glass.fill(0, {"Na": metal, "water": water, "diethyl_ether": 1.0, "NaCl": 0.2})
    before = glass.atoms()
    glass.phases(0)
    assert min(glass.amount(0, "Na"), glass.amount(0, "water")) == 0.0, "no trace stays that would react again"
    assert glass.amount(0, "Na") == pytest.approx(metal - reacted, abs=1e-14)
    assert glass.amount(0, "water") == pytest.approx(water - reacted, abs=1e-14)
    assert glass.waste[glass.index("H2")] == pytest.approx(reacted / 2.0, rel=1e-14)
    assert glass.amount(0, "H2") == 0.0
    assert glass.amount(0, "OH-") + glass.amount(0, "NaOH") == pytest.approx(reacted, rel=1e-12)
    sodium = sum(glass.amount(0, name) for name in ("Na+", "NaCl", "NaOH"))
    assert sodium == pytest.approx(reacted + 0.2, rel=1e-12)
    assert glass.events[METAL_IN_WATER] == pytest.approx(reacted, rel=1e-14)
    np.testing.assert_allclose(glass.atoms(), before, rtol=1e-12, atol=1e-12)
    assert glass.waste.sum() == glass.waste[glass.index("H2")]


NEUTRAL = """
name = "neutral"
[[violent]]
reactants = { acetic_anhydride = 1, water = 1 }
products = { acetic_acid = 2 }
source = "A test."
%s
"""


def anhydride(family: str, events: dict[str, str], tmp_path: Any) -> np.ndarray[Any, Any]:
    """Safety events of a vessel in which 0.3 mol of an anhydride meet 10 mol of water and react with it at once."""
    (tmp_path / "neutral.toml").write_text(family, encoding="utf-8")
    values = mapping("salt_from_oil")
    values |= {"name": "neutral", "reactions": str(tmp_path / "neutral.toml")}
    values["stock"] |= {"acetic_anhydride": 1.0}
    values["safety"]["events"] = events
    scenario = load_scenario(values)
    shelf = Shelf(build_chemistry(scenario), 1, 1)
    shelf.fill(0, 0, 1.0, {"water": 10.0, "acetic_anhydride": 0.3})
    seen = np.zeros(len(scenario.safety_events))
    settle_phases(shelf.rows[0], shelf.chem(), shelf.waste[0], seen, np.zeros((2, 8)))
    assert shelf.vessel(0, 0).amounts(1e-9) == pytest.approx({"water": 9.7, "acetic_acid": 0.6}, rel=1e-12)
    return seen


def test_a_violent_reaction_counts_as_the_event_it_names(tmp_path: Any) -> None:
    """As none if it names none: without a metal it is no metal in water."""
    assert not anhydride(NEUTRAL % "", {}, tmp_path).any()
    seen = anhydride(NEUTRAL % 'event = "hydrolysed_mol"', {"hydrolysed_mol": "mol of anhydride"}, tmp_path)
    assert seen.tolist() == pytest.approx([0.0] * 5 + [0.3], rel=1e-12)
    with pytest.raises(DataError, match=r"violent\.event: unknown safety event 'bang'; choose from none, .*decl"):
        anhydride(NEUTRAL % 'event = "bang"', {}, tmp_path)


def test_gas_that_is_in_a_vessel_leaves_it_for_the_waste() -> None:
    """Whatever reaction made it: mol by mol, and nothing else goes."""
    glass = Glassware(vessels=1)
    glass.fill(0, {"diethyl_ether": 2.0})[AMOUNTS + glass.index("H2")] = 0.25
    atoms = glass.atoms()
    glass.phases(0)
    assert glass.amount(0, "H2") == 0.0
    assert glass.waste[glass.index("H2")] == 0.25
    assert glass.waste.sum() == 0.25
    np.testing.assert_allclose(glass.atoms(), atoms, rtol=1e-12)
