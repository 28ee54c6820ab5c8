"""Everyday chemicals in a flask: found by any name, boiling where handbooks say, dissolving as measured."""

import csv
import importlib.util
import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import refused, script

from chemlab.config.catalogue import (
    FAMILY,
    FOLDER,
    CataloguePair,
    acids_and_bases,
    catalogue_pairs,
    keep_pairs,
    matches,
    spellings,
    user_folder,
)
from chemlab.config.datafile import DataError, read_toml
from chemlab.config.materials import load_materials, shipped_materials
from chemlab.config.pairs import shipped_pairs
from chemlab.sandbox import Flask

ROOT = Path(__file__).parent.parent
MOLECULES = {path.stem: load_materials([path])[path.stem] for path in sorted(FOLDER.glob("[!_]*.toml"))}
with (ROOT / "studies" / "physics" / "everyday.csv").open(encoding="utf-8", newline="") as _file:
    NAMES = [row["name"] for row in csv.DictReader(_file)]

BOILS_ELSEWHERE = {
    "N,N-diisopropylethylamine": "399.7 K by two compilations; 387 K is an old value",
    "acetanilide": "577 K by three compilations",
    "benzyl_chloride": "452 K by three compilations",
    "N-methylpyrrolidone": "475 K by the equation of its vapour pressure",
    "3-chlorohexane": "the bundled material's own source",
    "succinic_acid": "it loses water at 508 K; 591 K by Yaws and by DIPPR's vapour pressure",
}
"""Molecules that boil 1.5 K or more from the CRC Handbook, 95th ed."""


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing that this machine has kept takes part."""
    monkeypatch.setenv("CHEMLAB_CATALOGUE", str(tmp_path / "kept"))


def test_without_a_home_folder_chemicals_are_kept_in_the_working_directory(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("CHEMLAB_CATALOGUE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("os.path.expanduser", str)
    assert user_folder() == Path(".cache/chemlab/catalogue")


@pytest.mark.parametrize("name", [*NAMES, *map(str.upper, NAMES[:10])])
def test_everyday_names_are_known(name: str) -> None:
    flask = Flask({"Water ": 30.0, name: 0.1})
    assert flask.volume_l > 0.5
    assert flask.amounts["water"] > 30.05 or sum(mol > 0.0 for mol in flask.amounts.values()) >= 2


def test_every_name_leads_to_a_material() -> None:
    for spelling, keys in spellings().items():
        for key in keys:
            if not key.endswith(" acid") or key in MOLECULES:
                assert Flask.material(key).name, spelling
    flask = Flask({"DCM": 1.0, "MeOH": 2.0})
    assert flask.amounts["dichloromethane"] == flask.amounts["CH2Cl2"] == flask.amounts["75-09-2"] == 1.0
    assert (flask.amounts.get("DCM"), "MeOH" in flask.amounts, "benzene" in flask.amounts) == (1.0, True, False)
    with pytest.raises(KeyError, match="is not in the flask"):
        flask.amounts["benzene"]


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Flask({"acetonne": 1.0}), "did you mean 'acetone'"),
        (lambda: Flask({"unobtainium": 1.0}), r"Flask\.material\('unobtainium'\) looks up another molecule"),
        (lambda: Flask({"hydrogen": 0.1, "water": 10.0}), r"'hydrogen' \(H2\) is a gas, which an open flask cannot"),
        (lambda: Flask({"K2CO3": 0.1}), "'K2CO3' is a salt that is not in the catalogue; it has NaCl, NaOH"),
        (lambda: Flask({"sodium cloride": 0.1}), "did you mean 'sodium chloride'"),
        (lambda: Flask({"magnesium sulfate": 0.1}), "is a salt that is not in the catalogue"),
        (lambda: Flask({"C8H10": 1.0}), "may be .*'o-xylene'.*give one of these names"),
        (lambda: Flask({"xylene": 1.0}), "did you mean .*-xylene"),
        (lambda: Flask({"67-64-2": 1.0}), "its check digit is wrong"),
        (lambda: Flask({"HCl": 1.0}), "ions in water; add water"),
        (lambda: Flask({"water": 1.0, "K+": 0.1}), "charge of .*add the ions that balance it"),
        (lambda: Flask({"water": 1.0}).add("K+", 1.0), "is an ion; pour a neutral mixture"),
        (lambda: Flask({"toluene": 1.0}).add("HNO3", 1.0), "add water first"),
        (lambda: Flask({"acetone": 1.0}, physics="paper"), "has no polarity.*choose physics = 'real'"),
        (lambda: Flask({"water": 1.0}).plot(), "the history is empty"),
        (lambda: Flask.material("sulfuric acid"), "supported only as its ions in water"),
        (lambda: Flask.material("x" * 300), "unknown"),
        (lambda: Flask.material(None), "'None': unknown"),  # type: ignore[arg-type]
        (lambda: Flask.material("triphenylphosphine"), r"fusion_enthalpy_j_mol.*--values \(of chemlab data material"),
        (lambda: Flask.material("glycine"), r"must be above melting_point_k.*--values \(of chemlab data material"),
    ],
)
def test_mistakes_are_answered(made: Callable[[], object], message: str) -> None:
    refused(message, made)


def everyday(monkeypatch: pytest.MonkeyPatch) -> Any:
    """The study of a hundred names."""
    pytest.importorskip("thermo")
    monkeypatch.syspath_prepend(str(ROOT / "studies" / "physics"))
    return script("studies/physics/everyday.py")


@pytest.mark.slow
def test_flasks_boil_where_the_handbook_says(monkeypatch: pytest.MonkeyPatch) -> None:
    chemicals: Any = pytest.importorskip("chemicals")
    study: Any = everyday(monkeypatch)
    everything = {**MOLECULES, **{key: m for key, m in shipped_materials().items() if m.role in ("solvent", "solute")}}
    off = {}
    for key, material in everything.items():
        if material.cas and "CRC_ORG" in chemicals.Tb_methods(material.cas):
            off[key] = study.boiling_point(key) - float(chemicals.Tb(material.cas, method="CRC_ORG"))
    assert len(off) > 125
    assert {key for key, kelvin in off.items() if not abs(kelvin) < 1.5} == set(BOILS_ELSEWHERE)
    assert float(np.median(np.abs(list(off.values())))) < 0.2


def test_liquids_are_as_dense_as_the_other_compilation_says() -> None:
    """COSTALD and Rackett fits against DIPPR's and reference equations; two solutes have the density of the melt."""
    thermo: Any = pytest.importorskip("thermo")
    melts = {"cyclohexanol": "VDI_PPDS", "tert-butanol": "VDI_TABULAR"}
    off = {}
    for key, material in MOLECULES.items():
        poured = material.role == "solvent" or key in melts
        found = thermo.VolumeLiquid(CASRN=material.cas) if poured else None
        for method in (melts[key],) if key in melts else ("HTCOSTALDFIT", "RACKETTFIT", "VDI_PPDS"):
            if found and method in found.all_methods and f"[{method}]" not in material.source["density_kg_l"]:
                other = material.molar_mass_g_mol / 1e6 / float(found.calculate(298.15, method))
                off[key, method] = material.density_kg_l / other - 1.0
    assert len(off) > 50
    assert {key for key, _ in off} >= melts.keys()
    assert {key for key, share in off.items() if abs(share) > 0.03} == set()


def test_names_are_compared_as_the_table_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of the hundred names; the page counts the comparisons."""
    study = everyday(monkeypatch)
    with (ROOT / "studies" / "physics" / "everyday.csv").open(encoding="utf-8", newline="") as file:
        stored = {name: list(map(float, numbers)) for name, _, *numbers in itertools.islice(csv.reader(file), 1, None)}
    monkeypatch.setattr(study, "names", lambda: ["acetic acid", "DIPEA"])
    for row in study.rows():
        assert list(row[2:]) == pytest.approx(stored[row.name], rel=1e-5, nan_ok=True)
    counts = np.isfinite(list(stored.values())).sum(axis=0)
    page = (ROOT / "docs" / "chemist" / "distillation.md").read_text(encoding="utf-8")
    assert f"{counts[0]} boiling points" in page
    assert f"{counts[2]} densities" in page


def test_mixtures_by_lot_boil_as_the_table_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three of the page's ten mixtures, misses included."""
    study = everyday(monkeypatch)
    page = (ROOT / "docs" / "chemist" / "distillation.md").read_text(encoding="utf-8")
    for one, other, most, mean in itertools.islice(study.trial(), 3):
        assert f"| {one} and {other} | {most:+.1f} | {mean:+.1f} |".replace("_", " ") in page


@pytest.mark.slow
def test_azeotropes_are_where_they_were_measured() -> None:
    """The page's table, misses included."""
    study: Any = script("studies/physics/azeotropes.py")
    found = list(study.rows())
    missed = {(row.one, row.other) for row in found if not row.met}
    assert missed == {("formic_acid", "water"), ("ethyl_acetate", "hexane")}
    page = (ROOT / "docs" / "chemist" / "distillation.md").read_text(encoding="utf-8")
    for row in found:
        names = f"{row.one} and {row.other}".replace("_", " ")
        assert re.search(rf"\| {re.escape(names)} \|.*\| {'yes' if row.met else 'no'} \|", page), names


def test_what_mixes_with_water_is_one_liquid() -> None:
    """Those that are not say so; those that hardly mix have two layers."""
    mixes = ["pyridine", "tetrahydrofuran", "acetonitrile", "tert-butanol", "acetone", "1,4-dioxane", "2-propanol"]
    for name in mixes:
        for mol in (0.5, 1.0, 2.0, 4.0):
            flask = Flask({name: mol, "water": 4.0}, temperature_k=300.0)
            assert [layer.name for layer in flask.layers if layer.volume_l > 0.01] in (["aqueous"], ["organic"]), name
    for name in ("chlorobenzene", "1,2-dichlorobenzene", "dimethyl_carbonate"):
        for mol in (1.0, 4.0):
            assert [layer.name for layer in Flask({name: mol, "water": 4.0}).layers] == ["organic", "aqueous"], name
    for name in ("benzylamine", "butyric_acid", "gamma-butyrolactone"):
        flask = Flask({name: 1.0, "water": 4.0})
        assert len(flask.layers) == 2
        assert "two layers at room temperature although the liquids mix" in flask.report()
    for name, measured, most in (("cyclohexane", 5.5e-5, 300.0), ("hexane", 1.1e-5, 300.0), ("toluene", 5.3e-4, 2.0)):
        aqueous = Flask({name: 2.0, "water": 20.0}).layers[0]  # docs/chemist/extraction.md
        mass = aqueous.contents[name] * Flask.material(name).molar_mass_g_mol / (18.015 * aqueous.contents["water"])
        assert 1 / most < mass / measured < most, name


def test_every_two_molecules_are_a_pair() -> None:
    pairs = {frozenset(two) for two in itertools.combinations([*MOLECULES, "water", "ethanol", "toluene"], 2)}
    found = {**catalogue_pairs(pairs), **shipped_pairs()}
    assert pairs <= set(found)
    assert max(pair.error for pair in found.values()) < 2.0
    ideal = [two for two in pairs if found[two].source.startswith("estimate")]
    assert len(ideal) < 0.01 * len(pairs)
    assert not [two for two in ideal if "water" in two]


def test_salts_dissolve_as_listed() -> None:
    for salt in read_toml(ROOT / "studies" / "tools" / "catalogue.toml")["salts"].values():
        key = matches(salt["cas"])[0]
        mass = Flask.material(key).molar_mass_g_mol
        celsius, grams = salt["water_c"][-1], salt["water_g"][-1]
        flask = Flask({key: 30.0, "water": 55.509}, capacity_l=10.0)
        flask.react(10.0, temperature_k=celsius + 273.15)
        hectograms = flask.amounts["water"] * 0.01801528 * 10.0  # its heat of dissolving may boil some off
        assert flask.amounts[salt["ions"][0]] * mass / hectograms == pytest.approx(grams, rel=0.01), key


def test_acids_ionize() -> None:
    """Ostwald's law with Davies' coefficients."""
    acids = {acid["species"][0]: acid["pka"][0] for acid in read_toml(FAMILY)["acid"]}
    assert set(acids) - acids_and_bases() == {"ethanol"}  # weaker than water
    base = Flask({"water": 55.5, "sodium ethoxide": 0.1}, capacity_l=2.0)
    assert float(base.measure("ph_meter")) == pytest.approx(13.0, abs=0.2)
    assert base.amounts["ethanol"] == pytest.approx(0.1, rel=0.01)
    flask = Flask({"water": 55.509, "acetic acid": 0.1}, capacity_l=2.0, temperature_k=298.15)
    ions = math.sqrt(10.0 ** -acids["acetic_acid"] * 0.1)
    root = math.sqrt(ions)
    davies = 0.509 * (root / (1.0 + root) - 0.3 * ions)
    dissociation = 10.0 ** (-acids["acetic_acid"] + 2.0 * davies)
    exact = (-dissociation + math.sqrt(dissociation**2 + 0.4 * dissociation)) / 2.0
    assert float(flask.measure("ph_meter")) == pytest.approx(-math.log10(exact) + davies, abs=0.005)


def test_a_strong_acid_is_neutralized_at_once() -> None:
    flask = Flask({"water": 55.5, "HCl": 0.1}, capacity_l=2.0)
    flask.add("NaOH", 0.1)
    assert float(flask.measure("ph_meter")) == pytest.approx(7.0, abs=0.1)
    assert flask.amounts["H+"] < 1e-6
    flask.add("H2SO4", 0.01)
    assert flask.amounts["H+"] == pytest.approx(0.02, rel=0.25)
    assert flask.amounts["HSO4-"] + flask.amounts["SO4--"] == pytest.approx(0.01, rel=1e-9)


@pytest.mark.parametrize("mol", [0.3, 4.0, 8.0])
def test_the_heat_of_a_neutralization_boils_an_open_flask(mol: float) -> None:
    """4 mol warm the salt water past its boiling point; 8 mol in little water leave hot salt, at 1,140 K."""
    flask = Flask({"water": 20.0 if mol < 8.0 else 1.0, "KOH": mol})
    flask.another({"water": 10.0 if mol < 8.0 else 1.0, "HNO3": mol}).pour(flask, 1.0)
    flask.mix()
    assert flask.vapor_pressure_kpa <= 1.001 * flask.pressure_kpa or flask.amounts["water"] < 1e-4
    assert bool(flask.events) is (mol > 1.0)


@pytest.mark.parametrize("water", [0.3, 2.0, 10.0])
def test_a_solid_base_and_an_acid_do_not_both_remain(water: float) -> None:
    flask = Flask({"NaOH": 1.0, "acetic_acid": 1.0, "water": water})
    assert flask.vapor_pressure_kpa <= 1.02 * flask.pressure_kpa
    assert min(flask.amounts["acetic_acid"], flask.amounts["OH-"] + flask.amounts["NaOH"]) < 0.01
    assert flask.events


def test_flasks_of_bundled_materials_read_nothing_of_it() -> None:
    """Their chemistry is the one of before there was a catalogue."""
    scenario = Flask({"ethanol": 1.0, "water": 1.0, "NaCl": 0.1})._chemistry.scenario
    assert scenario.family.name == "sodium_salts"
    assert scenario.material_files == ()
    assert set(scenario.pairs) <= set(shipped_pairs())


def test_a_reaction_file_may_name_all_of_it(tmp_path: Path) -> None:
    """Also what only speeds a reaction up, slows it down or ionizes, and that the flask does not contain."""
    step = 'reactants = {{ {} = 1 }}\nproducts = {{ {} = 1 }}\nsource = "made up"\n'
    rate = "pre_exponential = 0.001\nactivation_energy_j_mol = 0.0\n"
    isomers, file = step.format('"1-propanol"', '"2-propanol"'), tmp_path / "own.toml"
    for more in ("catalysts = { pyridine = 1 }\n", "inhibitors = { pyridine = 1 }\n", None):
        entry = f"[[violent]]\n{isomers}" if more is None else f"[[reaction]]\n{isomers}{rate}{more}"
        file.write_text(f'name = "own"\n{entry}', encoding="utf-8")
        flask = Flask({"ethanol": 1.0}, reactions=file)
        flask.add("pyridine", 0.1)
        flask.add("1-propanol", 1.0)
        flask.react(100.0)
        assert flask.amounts["1-propanol"] < 1.0
    file.write_text('name = "own"\nreaction = 3\n', encoding="utf-8")
    with pytest.raises(DataError, match=r"own\.toml: reaction: must be a list"):
        Flask({"water": 1.0}, reactions=file)


def test_salts_that_exchange_their_ions_do_nothing_else_in_water(tmp_path: Path) -> None:
    file = tmp_path / "exchange.toml"
    step = "reactants = { NaCl = 1, KBr = 1 }\nproducts = { NaBr = 1, KCl = 1 }\npre_exponential = 1.0\n"
    more = f'[[reaction]]\n{step}activation_energy_j_mol = 0.0\nsource = "made up"\n'
    file.write_text(FAMILY.read_text(encoding="utf-8") + more, encoding="utf-8")
    flasks = [Flask({"water": 10.0, "NaCl": 0.1, "KBr": 0.1}, reactions=family) for family in (file, FAMILY)]
    for flask in flasks:
        flask.react(100.0)
    assert flasks[0].amounts == pytest.approx(flasks[1].amounts, rel=1e-9)


def test_an_acid_uses_up_a_solid_salt(tmp_path: Path) -> None:
    """While the last of the solid dissolves, the integration does not crawl; in one call and in many."""
    file = tmp_path / "gas.toml"
    step = "reactants = { sodium_bicarbonate = 1, acetic_acid = 1 }\n"
    step += "products = { sodium_acetate = 1, water = 1, CO2 = 1 }\npre_exponential = 0.3\n"
    more = f'[[reaction]]\n{step}activation_energy_j_mol = 0.0\nsource = "made up"\n'
    salts_only = FAMILY.read_text(encoding="utf-8").partition("[[acid]]")[0]
    file.write_text(salts_only + more, encoding="utf-8")
    one = Flask({"water": 1.35, "sodium_bicarbonate": 0.08, "acetic_acid": 0.09}, reactions=file)
    many = one.copy()
    one.react(40.0, 298.15)
    for _ in range(20):
        many.react(2.0, 298.15)
    assert one.amounts["HCO3-"] > 1e-4
    assert one.amounts == pytest.approx(many.amounts, rel=0.01, abs=1e-5)
    one.react(6000.0, 298.15)
    assert one.amounts["acetate"] + one.amounts["sodium_acetate"] == pytest.approx(0.08, rel=1e-6)


def test_a_flask_remembers(tmp_path: Path) -> None:
    pot = Flask({"acetone": 3.0, "MeOH": 3.0, "water": 3.0}, capacity_l=1.0)
    head = pot.another()
    for _ in range(20):
        pot.heat(10e3, head, stages=4, reflux=3.0)
    pot.react(60.0, 330.0)
    last = pot.history[-2]
    assert pot.history[-1].seconds == 60.0
    assert last.joules == pytest.approx(sum(b.joules - a.joules for a, b in itertools.pairwise(pot.history[:-1])))
    heads = [m.head_temperature_k for m in pot.history if m.head_temperature_k is not None]
    assert 328.0 < heads[0] < 331.0  # the azeotrope of acetone and methanol boils at 328.7 K
    assert all(m.head_temperature_k <= m.temperature_k + 0.1 for m in pot.history if m.head_temperature_k)
    distilled = sum(m.distillate.get("acetone", 0.0) for m in pot.history)
    assert distilled == pytest.approx(head.amounts["acetone"], rel=1e-6)
    copy = pot.copy()
    copy.settle()
    assert len(copy.history) == len(pot.history) + 1
    assert "estimates and doubts" in pot.report()
    assert "acetone with methanol: UNIFAC" in pot.report()
    pytest.importorskip("matplotlib")
    pot.plot(tmp_path / "pot.png")
    assert (tmp_path / "pot.png").read_bytes().startswith(b"\x89PNG")
    refused(r"unknown suffix .*choose from png", pot.plot, tmp_path / "pot.gif")
    pot.add("KNO3", 5.0)
    pot.add("KCl", 5.0)
    colors = {line.get_label(): line.get_color() for line in pot.plot().axes[1].lines}
    assert len(set(colors.values())) == len(colors) > 4


@pytest.mark.skipif(importlib.util.find_spec("rdkit") is None, reason="needs the extra chem")
def test_other_compounds_are_looked_up_once(tmp_path: Path) -> None:
    pytest.importorskip("ugropy")
    assert Flask.material("anisole").boiling_point_k == pytest.approx(426.8, abs=1.0)
    assert (tmp_path / "kept" / "anisole.toml").is_file()
    flask = Flask({"anisole": 1.0, "water": 5.0, "acetone": 1.0})
    assert flask.amounts["100-66-3"] == 1.0
    assert [layer.name for layer in flask.layers] == ["aqueous", "organic"]
    (tmp_path / "kept" / "anisole.toml").rename(tmp_path / "kept" / "moved")
    with pytest.raises(DataError, match=r"names\.csv: lists 'anisole', but its file is missing; Flask.material"):
        Flask({"anisole": 1.0})
    (tmp_path / "kept" / "moved").rename(tmp_path / "kept" / "anisole.toml")
    rows = (tmp_path / "kept" / "pairs.csv").read_text(encoding="utf-8").splitlines()
    assert {tuple(row.split(",")[:2]) for row in rows} == {("acetone", "anisole"), ("anisole", "water")}
    Flask({"anisole": 2.0, "water": 5.0})
    assert (tmp_path / "kept" / "pairs.csv").read_text(encoding="utf-8").splitlines() == rows
    refused("a mixture of hydrocarbons", Flask.material, "petroleum ether")


@pytest.mark.skipif(importlib.util.find_spec("rdkit") is None, reason="needs the extra chem")
def test_what_is_added_is_one_compound_and_changes_no_other(tmp_path: Path) -> None:
    def of(text: str) -> str | None:
        return Flask.material(text).smiles

    unlisted = "CCCCC(C)OC(CC)CCCC", "CCCCC(C)OC(CCC)CCC"
    assert [of(text) for text in unlisted] == [of(text) for text in unlisted] == list(unlisted)  # isomers
    assert sum(mol == 1.0 for mol in Flask(dict.fromkeys(unlisted, 1.0)).amounts.values()) == 2
    assert of("benzo[a]pyrene") == of("50-32-8")
    assert of("2,2'-bipyridine") == of("2,2'-Bipyridine") == "c1ccc(-c2ccccn2)nc1"
    assert of("C1CCCCC1C") == "CC1CCCCC1"
    assert of("c1ccccc1C") == of("toluene")
    assert of("C1CCSC1") != of("thiophene")
    assert of("methane") == "C"  # not the fictitious material C
    of("propanal")
    assert of("C3H6O") == of("acetone")
    assert of("hydrogen") == of("H2")
    with pytest.raises(DataError, match=r"'hydrogen'.* is a gas"):
        Flask({"hydrogen": 0.1, "water": 10.0})
    # One compound by any of its names, whichever came first.
    files = len(list((tmp_path / "kept").glob("*.toml")))
    for text in ("phenyl methyl ether", "anisole", "COc1ccccc1", "100-66-3"):
        assert of(text) == "COc1ccccc1"
    assert len(list((tmp_path / "kept").glob("*.toml"))) == files + 1
    assert Flask({"Anisole": 1.0, "Phenyl methyl ether": 1.0}).amounts["100-66-3"] == 2.0


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("names.csv", "anisole\n", "the line 'anisole' has 1 cells, not 2"),
        ("pairs.csv", "acetone,butanone,UNIFAC\n", "the line .* has 3 cells, not 11"),
        ("pairs.csv", "acetone,own,UNIFAC,x,0,0,0,0,0,0,0\n", "the line .* has a cell that is not a number"),
        ("names.csv", "\xff", "is not a table of 2 columns"),
    ],
)
def test_a_line_of_ones_own_that_is_malformed_is_named(name: str, text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / name).write_bytes(text.encode("latin-1"))
    with pytest.raises(DataError, match=f"{re.escape(name)}: {message}"):
        catalogue_pairs([frozenset(("acetone", "own"))]) if name == "pairs.csv" else matches("x")


def test_a_row_of_pairs_begins_its_own_line(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "pairs.csv").write_text("a,b,UNIFAC,0.3,0,0,0,0,0,0,0")
    keep_pairs([CataloguePair("a", "c", "UNIFAC", 0.3, 0.0, (0.0,) * 6)])
    assert len(catalogue_pairs([frozenset("ab"), frozenset("ac")])) == 2
