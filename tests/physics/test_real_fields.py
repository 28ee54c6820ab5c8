"""A family with catalysts, equilibria and acids, from its file to what the kernels of the tier ``real`` are given."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from chemlab.config.datafile import DataError
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.physics.backends.real.fields import independent_reactions
from chemlab.physics.chemistry import build_chemistry

FAMILY = """
name = "esters"

[[reaction]]
reactants = { acetic_acid = 1, ethanol = 1 }
products = { ethyl_acetate = 1, water = 1 }
catalysts = { "H+" = 1 }
inhibitors = { ethyl_acetate = 0.1, "Na+" = 0.01, hexane = 0.5 }
equilibrium_constant = 4.0
enthalpy_j_mol = -3000.0
pre_exponential = 1e7
activation_energy_j_mol = 60000.0
source = "made up"

[[reaction]]
reactants = { hexane = 1 }
products = { hexane = 1 }
catalysts = { "H+" = 1 }
pre_exponential = 1.0
activation_energy_j_mol = 0.0
source = "made up"

[[salt]]
solid = "NaOH"
cation = "Na+"
anion = "OH-"
source = "made up"
solubility = { solvents = { water = [[298.15, 25.0]] }, source = "made up" }

[[acid]]
species = ["acetic_acid", "acetate"]
pka = [4.756]
enthalpy_j_mol = [-410.0]
source = "Goldberg, Kishore, Lennen, J. Phys. Chem. Ref. Data 31 (2002) 231"

[[acid]]
species = ["benzoic_acid", "benzoate"]
pka = [4.204]
source = "Goldberg, Kishore, Lennen, J. Phys. Chem. Ref. Data 31 (2002) 231"
"""


@pytest.fixture
def esters(tmp_path: Path) -> dict[str, Any]:
    """A scenario of the tier with the family above, as a mapping."""
    (tmp_path / "family.toml").write_text(FAMILY)
    return {
        "name": "esters",
        "title": "Esters",
        "summary": "For tests.",
        "physics": "real",
        "reactions": str(tmp_path / "family.toml"),
        "goals": ["ethyl_acetate"],
        "lab_goals": ["ethyl_acetate"],
        "theoretical_maximum_mol": {"ethyl_acetate": 1.0},
        "stock": {"acetic_acid": 5.0, "ethanol": 5.0, "water": 20.0, "NaOH": 1.0},
        "shelf": {"slots": 4, "vessel": [{"capacity_l": 1.0, "contents": {"benzoic_acid": 1.0}}]},
        "benches": {"rxn": {"kind": "reaction", "step_limit": 10, "options": {"reagents": {"ethanol": 1.0}}}},
        "limits": {"manager_actions": 10, "ticks": 10},
    }


def test_a_family_is_closed_under_its_reactions(esters: dict[str, Any]) -> None:
    """Acids bring their bases, H+ and OH-; what is not there inhibits nothing; the family is the same in a record."""
    scenario = load_scenario(esters)
    made = {"ethyl_acetate", "acetate", "benzoic_acid", "benzoate", "H+", "OH-", "Na+", "air"}
    assert set(scenario.materials) == {*esters["stock"], *made}
    (step,) = scenario.family.reaction
    assert step.inhibitors == {"ethyl_acetate": 0.1, "Na+": 0.01}
    assert restore_scenario(dump_scenario(scenario), "a copy").family == scenario.family
    # From the other side, too: where there is water there is the catalyst.
    empty = {**esters, "shelf": {"slots": 4, "vessel": [{"capacity_l": 1.0}]}}
    wet = load_scenario({**empty, "stock": {"ethyl_acetate": 1.0, "water": 5.0}})
    assert {"ethanol", "H+", "OH-"} <= set(wet.materials)
    assert "ethanol" not in load_scenario({**empty, "stock": {"ethyl_acetate": 1.0}}).materials
    # Acids are none without water.
    dry = load_scenario({**empty, "stock": {"acetic_acid": 1.0, "ethyl_acetate": 1.0}})
    assert dry.family.acid == ()
    assert "H+" not in dry.materials


def test_the_paper_tier_refuses_what_it_does_not_know(esters: dict[str, Any]) -> None:
    esters |= {"physics": "paper", "shelf": {"slots": 4, "vessel": [{"capacity_l": 1.0}]}}
    with pytest.raises(DataError, match=r"'esters': reaction acetic_acid .* water: catalysts needs physics = 'real'"):
        load_scenario(esters)
    family = Path(esters["reactions"])
    family.write_text(FAMILY[: FAMILY.index("[[reaction]]")] + FAMILY[FAMILY.index("[[salt]]") :])
    with pytest.raises(DataError, match=r"'esters': acid needs physics = 'real'"):
        load_scenario(esters)
    dry = {key: mol for key, mol in esters["stock"].items() if key != "water"}
    assert load_scenario({**esters, "stock": dry}).family.acid == ()


def test_a_heat_that_contradicts_the_materials_is_refused(esters: dict[str, Any]) -> None:
    Path(esters["reactions"]).write_text(FAMILY.replace("-3000.0", "30000.0"))
    with pytest.raises(DataError, match=r"acetic_acid .*: enthalpy_j_mol = 30000: .* give -\d+, and may differ"):
        build_chemistry(load_scenario(esters))


def test_independent_reactions_make_up_the_others() -> None:
    stoichiometry = np.array([[-1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, -2.0, 2.0], [-1.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    found = independent_reactions(stoichiometry)
    assert found["independent"].tolist() == [0, 2]
    made = np.zeros_like(stoichiometry)
    for row, parts, numbers in zip(made, found["parts"], found["part_numbers"], strict=True):
        for part, number in zip(parts, numbers, strict=True):
            if part >= 0:
                row += number * stoichiometry[found["independent"][part]]
    np.testing.assert_allclose(made, stoichiometry, atol=1e-14)
