"""Reaction files: what the loader refuses, what its messages say, and that shipped families balance."""

from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from refusals import changed, refused

from chemlab.config.datafile import DataError
from chemlab.config.materials import shipped_materials
from chemlab.config.reactions import (
    ReactionFamily,
    check_without_real,
    dissolved_reactions,
    load_reactions,
    shipped_reactions_folder,
)

FAMILY = """
name = "mine"

[[reaction]]
reactants = { "1-chlorohexane" = 2, Na = 2 }
products = { dodecane = 1, NaCl = 2 }
orders = { "1-chlorohexane" = 1, Na = 0.5 }
pre_exponential = 10.0
activation_energy_j_mol = 6000.0
source = "made up"

[[salt]]
solid = "NaCl"
cation = "Na+"
anion = "Cl-"
source = "made up"

[[violent]]
reactants = { Na = 2, water = 2 }
products = { "Na+" = 2, "OH-" = 2, H2 = 1 }
source = "made up too"
"""


def load(folder: Path, text: str) -> ReactionFamily:
    """The family in ``text``, through a file and a relative path."""
    (folder / "mine.toml").write_text(text)
    return load_reactions("mine.toml", shipped_materials(), folder)


def test_a_family_arrives_as_written(tmp_path: Path) -> None:
    """Orders default to the law of mass action."""
    family = load(tmp_path, FAMILY)
    assert family.name == "mine"
    (step,) = family.reaction
    assert step.reactants == {"1-chlorohexane": 2.0, "Na": 2.0}
    assert step.orders == {"1-chlorohexane": 1.0, "Na": 0.5}
    assert (step.pre_exponential, step.activation_energy_j_mol) == (10.0, 6000.0)
    assert family.materials() == {"1-chlorohexane", "Na", "dodecane", "NaCl", "Na+", "Cl-", "water", "OH-", "H2"}
    plain = load(tmp_path, changed(FAMILY, 'orders = { "1-chlorohexane" = 1, Na = 0.5 }\n', ""))
    assert plain.reaction[0].orders == {"1-chlorohexane": 2.0, "Na": 2.0}


VIOLENT = 'reactants = { Na = 2, water = 2 }\nproducts = { "Na+" = 2, "OH-" = 2, H2 = 1 }'
IONS = 'cation = "Na+"\nanion = "Cl-"'


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("dodecane = 1", "dodecan = 1", ["unknown material 'dodecan'", "dodecane"]),
        ('anion = "Cl-"', 'anion = "Br-"', ["unknown material 'Br-'"]),
        ("dodecane = 1", "dodecane = 2", ["reaction.0", "not balanced", "C 12 on the left, 24 on the right"]),
        ('"OH-" = 2, H2 = 1', '"OH-" = 2', ["violent.0", "not balanced", "H 4 on the left, 2 on the right"]),
        ('anion = "Cl-"', 'anion = "OH-"', ["salt.0", "not balanced", "Cl 1 on the left, 0 on the right"]),
        # Atoms balance, the charge does not.
        (VIOLENT, VIOLENT.replace("+", ""), ["violent.0", "not balanced", "charge 0 on the left, -2 on the right"]),
        ("orders = { ", "orders = { water = 1, ", ["reaction.0", "orders.water", "not a reactant"]),
        ("Na = 0.5", "Na = 0.0", ["reaction.0.orders.Na", "or equal to 0.01", "0.0"]),
        ("Na = 0.5", "Na = 3e8", ["reaction.0.orders.Na", "less than or equal to 20", "300000000.0"]),
        ('"1-chlorohexane" = 1, Na = 0.5', '"1-chlorohexane" = 11, Na = 10', ["orders: add up to 21; at most 20"]),
        ('"1-chlorohexane" = 1, ', "", ["reaction.0", "orders must name every reactant"]),
        ('"1-chlorohexane" = 2, Na = 2', '"1-chlorohexane" = -2, Na = 2', ["reaction.0.reactants", "equal to 0.001"]),
        ("dodecane = 1, NaCl = 2", "", ["reaction.0.products", "at least 1 item"]),
        ("dodecane = 1", "dodecane = 1e3", ["reaction.0.products.dodecane", "less than or equal to 100", "1000.0"]),
        # A number that is none would pass every comparison of the balance.
        ("dodecane = 1", "dodecane = nan", ["reaction.0"]),
        ("pre_exponential = 10.0", "pre_exponential = -10.0", ["reaction.0.pre_exponential", "than 0", "-10.0"]),
        ("pre_exponential = 10.0", "pre_exponential = 1e300", ["reaction.0.pre_exponential", "1e+30", "1e+300"]),
        ("pre_exponential = 10.0", "pre_exponential = 10.0\ncatalyst = 1", ["reaction.0.catalyst", "unknown key"]),
        ("= 6000.0", "= -6000.0", ["reaction.0.activation_energy_j_mol", "greater than or equal to 0", "-6000.0"]),
        ("= 6000.0", "= 6e9", ["reaction.0.activation_energy_j_mol", "less than or equal to 500000"]),
        ('source = "made up too"', 'source = ""', ["violent.0.source", "at least 1 character"]),
        ('source = "made up too"\n', "", ["violent.0.source", "required"]),
        ('name = "mine"', 'name = "mine"\nspeed = "fast"', ["speed", "unknown key", "'fast'"]),
        ('name = "mine"', f'name = "{"m" * 201}"', ["name", "at most 200"]),
        (IONS, 'cation = "Cl-"\nanion = "Na+"', ["salt.0", "a solid, a positive and a negative ion", "(charge -1)"]),
    ],
)
def test_a_wrong_family_is_named_with_file_and_key(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    refused(lambda: load(tmp_path, changed(FAMILY, old, new)), tmp_path / "mine.toml", *parts)


def test_two_salts_may_share_one_ion(tmp_path: Path) -> None:
    """A shared anion couples two cations, which the closed form of the backend ``paper`` does not cover."""
    hydroxide = '\n[[salt]]\nsolid = "NaOH"\ncation = "Na+"\nanion = "OH-"\nsource = "made up"\n'
    assert len(load(tmp_path, FAMILY + hydroxide).salt) == 2
    twice = '\n[[salt]]\nsolid = "NaCl"\ncation = "Na+"\nanion = "Cl-"\nsource = "made up"\n'
    with pytest.raises(DataError, match="have the same ions"):
        load(tmp_path, FAMILY + twice)
    salts = [salt for salt in load(tmp_path, FAMILY).salt if salt.anion == "Cl-"]
    potassium = salts[0].model_copy(update={"solid": "KCl", "cation": "K+"})
    both = load(tmp_path, FAMILY).model_copy(update={"salt": (*salts, potassium)})
    with pytest.raises(DataError, match="share an anion"):
        check_without_real(both, "mine")


def test_a_family_of_a_great_many_reactions(tmp_path: Path) -> None:
    start, stop = FAMILY.index("[[reaction]]"), FAMILY.index("[[salt]]")
    with pytest.raises(DataError, match=r"reaction: .*at most 200 items"):
        load(tmp_path, FAMILY[:start] + FAMILY[start:stop] * 201)


@pytest.mark.parametrize("name", sorted(path.stem for path in shipped_reactions_folder().glob("*.toml")))
def test_shipped_families_conserve_atoms_charge_and_mass(name: str) -> None:
    table = shipped_materials()
    family = load_reactions(name, table)
    steps = [(step.reactants, step.products) for step in (*family.reaction, *family.violent)]
    steps += [({salt.solid: 1.0}, {salt.cation: 1.0, salt.anion: 1.0}) for salt in family.salt]
    assert steps
    for reactants, products in steps:
        change: dict[str, float] = defaultdict(float)
        for sign, side in ((-1.0, reactants), (1.0, products)):
            for material, number in side.items():
                for element, count in table[material].composition.items():
                    change[element] += sign * number * count
                change["charge"] += sign * number * table[material].charge
                change["mass in g"] += sign * number * table[material].molar_mass_g_mol
        assert change == pytest.approx(dict.fromkeys(change, 0.0), abs=1e-3)


REAL = """
name = "mine"

[[reaction]]
reactants = { A = 1 }
products = { B = 2 }
catalysts = { "H+" = 0.5 }
inhibitors = { B = 3.0 }
equilibrium_constant = 2.5
enthalpy_j_mol = -1e4
pre_exponential = 10.0
activation_energy_j_mol = 6000.0
source = "made up"

[[acid]]
species = ["H2X", "HX-", "X--"]
pka = [2.0, 7.0]
enthalpy_j_mol = [-500.0, 1000.0]
source = "made up"
"""

WORLD = {
    "A": ({"E": 2}, 0, "solvent"),
    "B": ({"E": 1}, 0, "solvent"),
    "H2X": ({"X": 1, "H": 2}, 0, "solute"),
    "HX-": ({"X": 1, "H": 1}, -1, "ion"),
    "X--": ({"X": 1}, -2, "ion"),
    "H+": ({"H": 1}, 1, "ion"),
    "OH-": ({"O": 1, "H": 1}, -1, "ion"),
    "water": ({"H": 2, "O": 1}, 0, "solvent"),
}


def load_real(folder: Path, text: str, **roles: str) -> ReactionFamily:
    """The family in ``text``, over the materials above, some of other roles."""
    (folder / "mine.toml").write_text(text)
    like = shipped_materials()["water"]
    materials = {
        name: like.model_copy(update={"composition": atoms, "charge": charge, "role": roles.get(name, role)})
        for name, (atoms, charge, role) in WORLD.items()
    }
    return load_reactions("mine.toml", materials, folder)


def test_a_real_family_arrives_as_written_and_is_dumped_whole(tmp_path: Path) -> None:
    family = load_real(tmp_path, REAL)
    (step,), (acid,) = family.reaction, family.acid
    assert (step.catalysts, step.inhibitors) == ({"H+": 0.5}, {"B": 3.0})
    assert (step.equilibrium_constant, step.enthalpy_j_mol) == (2.5, -1e4)
    assert step.materials() == {"A", "B", "H+"}
    assert (acid.species, acid.pka, acid.enthalpy_j_mol) == (("H2X", "HX-", "X--"), (2.0, 7.0), (-500.0, 1000.0))
    assert family.materials() == set(WORLD)
    assert ReactionFamily.model_validate(family.model_dump(mode="json")) == family


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ('catalysts = { "H+" = 0.5 }', "catalysts = { A = 1 }", ["reaction.0: catalysts.A: is a reactant"]),
        ('catalysts = { "H+" = 0.5 }', "catalysts = { Z = 1 }", ["unknown material 'Z'"]),
        ('catalysts = { "H+" = 0.5 }', 'catalysts = { "H+" = 0 }', ["reaction.0.catalysts.H+", "or equal to 0.01"]),
        ('catalysts = { "H+" = 0.5 }', 'catalysts = { "H+" = 19 }', ["orders: add up to 21; at most 20"]),
        ("inhibitors = { B = 3.0 }", "inhibitors = { B = -3.0 }", ["reaction.0.inhibitors.B", "greater than 0"]),
        ("inhibitors = { B = 3.0 }", 'inhibitors = { "H+" = 1 }', ["inhibitors.H+: is a catalyst"]),
        ("inhibitors = { B = 3.0 }", "inhibitors = { Z = 1 }", ["unknown material 'Z'"]),
        ("= 2.5", "= 0", ["reaction.0.equilibrium_constant", "greater than 0"]),
        ("= 2.5", "= 1e-60", ["reaction.0: equilibrium_constant: at least 1e-50, given 1e-60"]),
        ("= 2.5", "= inf", ["reaction.0.equilibrium_constant"]),
        ("= 2.5", "= 2.5\norders = { A = 0.5 }", ["equilibrium_constant: requires mass action"]),
        ("enthalpy_j_mol = -1e4", "enthalpy_j_mol = -1e9", ["reaction.0.enthalpy_j_mol", "-10000000"]),
        ('"H2X", "HX-", "X--"', '"H2X", "X--", "HX-"', ["acid.0: H2X to X--: not balanced"]),
        ('"H2X", "HX-", "X--"', '"H2X"', ["acid.0.species", "at least 2 items"]),
        ('"H2X", "HX-", "X--"', '"H2X", "HX-", "HX-"', ["acid.0: species: one is listed twice"]),
        ('"H2X", "HX-", "X--"', '"H2X", "HX-"', ["acid.0: pka: 2 species have 1 steps, given 2"]),
        ("pka = [2.0, 7.0]", "pka = [2.0, 70.0]", ["acid.0.pka.1", "less than or equal to 40"]),
        ("[-500.0, 1000.0]", "[-500.0]", ["acid.0: enthalpy_j_mol: 3 species have 2 steps, given 1"]),
        ("enthalpy_j_mol = [-500.0, 1000.0]", "enthalpy = 1", ["acid.0.enthalpy"]),
    ],
)
def test_a_wrong_real_family_is_named_with_file_and_key(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    refused(lambda: load_real(tmp_path, changed(REAL, old, new)), tmp_path / "mine.toml", *parts)


def test_a_species_is_of_one_acid_and_dissolved(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"acid\.1: species: 'HX-' is part of acid\.0 already"):
        load_real(tmp_path, REAL + '\n[[acid]]\nspecies = ["HX-", "X--"]\npka = [7.0]\nsource = "made up"\n')
    water = REAL + '\n[[acid]]\nspecies = ["water", "OH-"]\npka = [14.0]\nsource = "made up"\n'
    with pytest.raises(DataError, match=r"acid\.1: species: 'water' is part of water already"):
        load_real(tmp_path, water)
    with pytest.raises(DataError, match=r"acid\.0: species: 'H2X' is a solid; it must be dissolved in water"):
        load_real(tmp_path, REAL, H2X="solid")


SOLUBLE = FAMILY.replace(
    'anion = "Cl-"', 'anion = "Cl-"\nsolubility = { solvents = { water = [[298.15, 6.1]] }, source = "made up" }'
)


def of_ions(folder: Path, reactants: str, products: str, more: str = "", salts: str = SOLUBLE) -> list[Any]:
    """(reactants, products, orders, catalysts) of what a reaction becomes where there is water."""
    step = f"""
[[reaction]]
reactants = {{ {reactants} }}
products = {{ {products} }}
{more}
pre_exponential = 10.0
activation_energy_j_mol = 6000.0
source = "made up"
"""
    first = salts.index("[[reaction]]")
    text = salts[:first] + step.lstrip() + salts[salts.index("[[salt]]") :]
    made = dissolved_reactions(load(folder, text)).reaction
    # What has been made of ions stays as it is, in a record that is read again.
    again = dissolved_reactions(ReactionFamily(name="again", reaction=made, salt=load(folder, text).salt))
    assert again.reaction == made
    return [(s.reactants, s.products, s.orders, s.catalysts) for s in made]


def test_a_salt_reacts_as_its_ions_where_it_dissolves(tmp_path: Path) -> None:
    """Ions on both sides take no part; what is used up of a salt has its order, or two have half of it each."""
    salt, solid = '[[salt]]\nsolid = "NaOH"\ncation = "Na+"\nanion = "OH-"\nsource = "made up"\n', "sodium_acetate"
    water = 'solubility = { solvents = { water = [[298.15, 6.1]] }, source = "made up" }\n'
    both = SOLUBLE + salt + water
    kept, ions = of_ions(tmp_path, "ethyl_acetate = 1, NaOH = 1", f"{solid} = 1, ethanol = 1", salts=both)
    whole = {"ethyl_acetate": 1.0, "NaOH": 1.0}
    assert kept[:3] == (whole, {solid: 1.0, "ethanol": 1.0}, whole)
    # The acetate is no salt here that dissolves.
    halves = {"ethyl_acetate": 1.0, "Na+": 0.5, "OH-": 0.5}
    assert ions == ({"ethyl_acetate": 1.0, "Na+": 1.0, "OH-": 1.0}, {solid: 1.0, "ethanol": 1.0}, halves, {})
    acetate = salt.replace("NaOH", solid).replace("OH-", "acetate") + water
    _, ions = of_ions(tmp_path, "ethyl_acetate = 1, NaOH = 1", f"{solid} = 1, ethanol = 1", salts=both + acetate)
    spectator = ({"ethyl_acetate": 1.0, "OH-": 1.0}, {"acetate": 1.0, "ethanol": 1.0})
    assert ions == (*spectator, {"ethyl_acetate": 1.0, "OH-": 1.0}, {})
    squared = "orders = { ethyl_acetate = 1, NaOH = 2 }"
    _, ions = of_ions(tmp_path, "ethyl_acetate = 1, NaOH = 1", f"{solid} = 1, ethanol = 1", squared, both + acetate)
    assert ions == (*spectator, {"ethyl_acetate": 1.0, "OH-": 2.0}, {})
    # A catalyst's base is what acts.
    catalysed = of_ions(tmp_path, "1-hexene = 1", "trans-2-hexene = 1", "catalysts = { NaOH = 1 }", salts=both)
    assert [step[3] for step in catalysed] == [{"NaOH": 1.0}, {"OH-": 1.0}]
    # What dissolves next to nothing, and what is only made, stays as it is.
    little = both.replace('[[298.15, 6.1]] }, source = "made up" }\n', '[[298.15, 1e-4]] }, source = "made up" }\n')
    assert len(of_ions(tmp_path, "ethyl_acetate = 1, NaOH = 1", f"{solid} = 1, ethanol = 1", salts=little)) == 1
    assert len(dissolved_reactions(load(tmp_path, SOLUBLE)).reaction) == 1
