"""A family with catalysts, equilibria and acids, from its file to what the kernels of the tier ``real`` make of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import composition
from real_tier import enthalpy_of, filled, react, real_table

from chemlab.config.datafile import DataError
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.config.materials import shipped_materials
from chemlab.config.scenario import PHYSICS_TIERS, Scenario
from chemlab.kernels.jit import kernel
from chemlab.kernels.tables import Table
from chemlab.physics.backends.real.acids import acid_work_size, ph, settle_acids
from chemlab.physics.backends.real.fields import acid_fields, independent_reactions, kinetic_fields
from chemlab.physics.chemistry import AMOUNTS, TEMPERATURE, build_chemistry

MATERIALS = {
    # name: (composition, charge, role, formation enthalpy, source of that: NBS tables of 1982)
    "acetic acid": ({"C": 2, "H": 4, "O": 2}, 0, "solvent", -484.5e3),
    "ethanoate": ({"C": 2, "H": 3, "O": 2}, -1, "ion", -486.0e3),
    "spirit": ({"C": 2, "H": 6, "O": 1}, 0, "solvent", -277.7e3),
    "ester": ({"C": 4, "H": 8, "O": 2}, 0, "solvent", -479.3e3),
    "H+": ({"H": 1}, 1, "ion", 0.0),
    "hydrogen sulfate ion": ({"S": 1, "O": 4, "H": 1}, -1, "ion", -887.3e3),
    "sulfate ion": ({"S": 1, "O": 4}, -2, "ion", -909.3e3),
}
FORMATION = {"water": -285.83e3, "OH-": -230.015e3, "Na+": -240.1e3, "air": 0.0, "NaOH": -425.6e3}

FAMILY = """
name = "esters"

[[reaction]]
reactants = { "acetic acid" = 1, spirit = 1 }
products = { ester = 1, water = 1 }
catalysts = { "H+" = 1 }
inhibitors = { ester = 0.1, "Na+" = 0.01, hexane = 0.5 }
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

[[acid]]
species = ["acetic acid", "ethanoate"]
pka = [4.756]
enthalpy_j_mol = [-410.0]
source = "Goldberg, Kishore, Lennen, J. Phys. Chem. Ref. Data 31 (2002) 231"

[[acid]]
species = ["hydrogen sulfate ion", "sulfate ion"]
pka = [1.987]
source = "Goldberg, Kishore, Lennen, J. Phys. Chem. Ref. Data 31 (2002) 231"
"""


@pytest.fixture
def esters(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """A scenario of the tier with the family above, as a mapping."""
    monkeypatch.setitem(PHYSICS_TIERS, "real", "chemlab.physics.backends.real")
    weights = {"C": 12.011, "H": 1.008, "O": 15.999, "S": 32.06}
    lines = []
    for name, (atoms, charge, role, _) in MATERIALS.items():
        if name in shipped_materials():
            continue
        lines += [f'["{name}"]', f'name = "{name}"', f'formula = "{name}"', f"charge = {charge}", f'role = "{role}"']
        lines.append("composition = { " + ", ".join(f"{element} = {x}" for element, x in atoms.items()) + " }")
        lines.append(f"molar_mass_g_mol = {sum(weights[element] * x for element, x in atoms.items())}")
        numbers = {"density_kg_l": 1.0, "heat_capacity_j_mol_k": 100.0, "boiling_point_k": 400.0}
        numbers |= {"vaporization_enthalpy_j_mol": 4e4, "polarity": 0.5}
        lines += [f"{key} = {value}" for key, value in numbers.items()]
        lines += ['color = "#808080"', "shade = 0.5", f'["{name}".source]']
        lines += [f'{key} = "made up"' for key in ("molar_mass_g_mol", *numbers)]
    (tmp_path / "mine.toml").write_text("\n".join(lines))
    (tmp_path / "family.toml").write_text(FAMILY)
    return {
        "name": "esters",
        "title": "Esters",
        "summary": "For tests.",
        "physics": "real",
        "reactions": str(tmp_path / "family.toml"),
        "material_files": [str(tmp_path / "mine.toml")],
        "goals": ["ester"],
        "lab_goals": ["ester"],
        "theoretical_maximum_mol": {"ester": 1.0},
        "stock": {"acetic acid": 5.0, "spirit": 5.0, "water": 20.0, "NaOH": 1.0},
        "shelf": {"slots": 4, "vessel": [{"capacity_l": 1.0, "contents": {"hydrogen sulfate ion": 1.0, "Na+": 1.0}}]},
        "benches": {"rxn": {"kind": "reaction", "step_limit": 10, "options": {"reagents": {"spirit": 1.0}}}},
        "limits": {"manager_actions": 10, "ticks": 10},
    }


def chemistry(scenario: Scenario) -> Table[Any]:
    """What the kernels of kinetics and acids need to know of a scenario."""
    names = list(scenario.materials)
    known = FORMATION | {name: values[3] for name, values in MATERIALS.items()}
    formation = np.array([known[name] for name in names])
    base = build_chemistry(scenario.model_copy(update={"physics": "paper"})).world()._asdict()
    own = {**kinetic_fields(scenario, names, formation), **acid_fields(scenario, names, formation)}
    everything = np.array([i for i, m in enumerate(scenario.materials.values()) if m.role in ("solvent", "ion")])
    at = np.full(len(names), -1)
    at[everything] = np.arange(len(everything))
    base |= {"dissolved": everything, "dissolved_at": at, "solvents": np.arange(1), "formation": formation}
    return real_table(len(names), **{**base, **own})


@kernel
def read(row: Any, chem: Any) -> float:
    return ph(row, chem)


def test_a_family_is_closed_under_its_reactions(esters: dict[str, Any]) -> None:
    """Acids bring their bases, H+ and OH-; what is not there inhibits nothing; the family is the same in a record."""
    scenario = load_scenario(esters)
    assert set(scenario.materials) == {*MATERIALS, *FORMATION}
    (step,) = scenario.family.reaction
    assert step.inhibitors == {"ester": 0.1, "Na+": 0.01}
    assert restore_scenario(dump_scenario(scenario), "a copy").family == scenario.family
    # From the other side, too: where there is water there is the catalyst.
    empty = {**esters, "shelf": {"slots": 4, "vessel": [{"capacity_l": 1.0}]}}
    wet = load_scenario({**empty, "stock": {"ester": 1.0, "water": 5.0}})
    assert {"spirit", "H+", "OH-"} <= set(wet.materials)
    assert "spirit" not in load_scenario({**empty, "stock": {"ester": 1.0}}).materials
    # Acids are none without water.
    dry = load_scenario({**empty, "stock": {"acetic acid": 1.0, "ester": 1.0}})
    assert dry.family.acid == ()
    assert "H+" not in dry.materials


def test_the_paper_tier_refuses_what_it_does_not_know(esters: dict[str, Any]) -> None:
    with pytest.raises(DataError, match=r"'esters': reaction acetic acid .* water: catalysts needs physics = 'real'"):
        load_scenario({**esters, "physics": "paper"})
    family = Path(esters["reactions"])
    family.write_text(FAMILY[: FAMILY.index("[[reaction]]")] + FAMILY[FAMILY.index("[[salt]]") :])
    with pytest.raises(DataError, match=r"'esters': acid needs physics = 'real'"):
        load_scenario({**esters, "physics": "paper"})
    dry = {key: mol for key, mol in esters["stock"].items() if key != "water"}
    assert load_scenario({**esters, "physics": "paper", "stock": dry}).family.acid == ()


def test_a_heat_that_contradicts_the_materials_is_refused(esters: dict[str, Any]) -> None:
    family = Path(esters["reactions"])
    family.write_text(FAMILY.replace("-3000.0", "30000.0"))
    with pytest.raises(
        DataError, match=r"acetic acid .*: enthalpy_j_mol = 30000: .* give -2930, and may differ by 5000"
    ):
        chemistry(load_scenario(esters))


def test_an_esterification_runs_with_its_acids_and_keeps_atoms_charge_and_energy(esters: dict[str, Any]) -> None:
    """Insulated, from two sides to K = 4 and the pH of what is there."""
    scenario = load_scenario(esters)
    table, names = chemistry(scenario), list(scenario.materials)
    atoms = composition(scenario)[1]
    quotients = []
    for start in ({"acetic acid": 4.0, "spirit": 4.0, "water": 2.0}, {"ester": 4.0, "water": 6.0, "acetic acid": 0.01}):
        mol = np.zeros(len(names))
        for name, x in {**start, "hydrogen sulfate ion": 0.5, "H+": 0.5}.items():
            mol[names.index(name)] = x
        dissolved = {int(i): [mol[i]] for i in table.arrays.dissolved}
        row = filled(table, mol, 330.0, dissolved)
        before = enthalpy_of(row, table.handle)
        acid_work = np.zeros(acid_work_size(table.arrays))
        for _ in range(200):
            settle_acids(row, table.handle, acid_work)
            assert react(row, table, 500.0, 298.15, 0.0, (1e-5, 1e-8)) >= 0
        after = row[AMOUNTS : AMOUNTS + len(names)]
        np.testing.assert_allclose(after @ atoms, mol @ atoms, rtol=1e-12, atol=1e-12)
        assert enthalpy_of(row, table.handle) == pytest.approx(before, rel=1e-9)
        by_name = dict(zip(names, after, strict=True))
        quotient = by_name["ester"] * by_name["water"] / (by_name["acetic acid"] * by_name["spirit"])
        warmer = 1.0 / row[TEMPERATURE] - 1.0 / 298.15
        quotients.append(quotient / (4.0 * math.exp(3000.0 / 8.31446261815324 * warmer)))
        assert -1.0 < read(row, table.handle) < 1.5
    assert quotients == pytest.approx([1.0, 1.0], rel=1e-3)


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
