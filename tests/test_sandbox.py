"""A flask by hand: the kernels' own numbers, balances, closed forms, and errors that change nothing."""

import copy
import doctest
import itertools
import math
import re
import warnings
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import Glassware, refused
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import chemlab.sandbox
from chemlab.config.datafile import DataError, read_toml
from chemlab.config.materials import shipped_materials
from chemlab.envs.role_env import RoleEnv
from chemlab.kernels.arrays import FloatArray
from chemlab.openchem.writing import material_text, pair_text
from chemlab.physics import backends as laws
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.sandbox import BoilingWarning, Flask, IonizationWarning, SaltWarning, SpillWarning

MATERIALS = shipped_materials()
TIERS = ("paper", "real")
NAPHTHALENE: Any = MATERIALS["naphthalene"]
FUSION, MELTING = NAPHTHALENE.real.fusion_enthalpy_j_mol, NAPHTHALENE.melting_point_k
MIXTURE = {"diethyl_ether": 2.0, "dodecane": 0.2, "water": 10.0, "NaCl": 0.5}


def first_order(reactant: str, products: str, rate: float, equilibrium: float | None = None) -> str:
    """A file of one reaction at any temperature; products are names."""
    made = ", ".join(f'"{product}" = 1' for product in products.split(", "))
    text = f'name = "family"\n[[reaction]]\nreactants = {{ "{reactant}" = 1 }}\nproducts = {{ {made} }}\n'
    text += f'pre_exponential = {rate}\nactivation_energy_j_mol = 0.0\nsource = "made up for a test"\n'
    return text + (f"equilibrium_constant = {equilibrium}\n" if equilibrium else "")


@pytest.fixture
def decay(tmp_path: Path) -> str:
    """A reaction file with one reaction, k = 0.01 / s."""
    path = tmp_path / "decay.toml"
    path.write_text(first_order("2-chlorohexane", "1-chlorohexane", 0.01), encoding="utf-8")
    return str(path)


def heat_capacity(flask: Flask) -> float:
    """J/K, from the data files."""
    return sum(mol * MATERIALS[name].heat_capacity_j_mol_k for name, mol in flask.amounts.items())


def atoms(flasks: Iterable[Flask]) -> dict[str, float]:
    """Atoms by element, and charge, in flasks and in what they have lost."""
    total: dict[str, float] = {"charge": 0.0}
    for flask in flasks:
        for found in (flask.amounts, flask.waste):
            for name, mol in found.items():
                total["charge"] += mol * MATERIALS[name].charge
                for element, count in MATERIALS[name].composition.items():
                    total[element] = total.get(element, 0.0) + count * mol
    return total


def seen(flask: Flask) -> tuple[object, ...]:
    """Everything that an operation could change."""
    return flask.amounts, flask.waste, flask.events, flask.temperature_k, flask.layers, flask.history


# -- the laboratory's kernels -----------------------------------------------------------------------------------------


def test_numbers_are_the_laboratorys() -> None:
    """The same operations by kernels, one by one, on a bench top: the same vessels."""
    glass = Glassware("wurtz_dodecane", 2)
    contents = {"diethyl_ether": 4.0, "dodecane": 0.45}
    glass.mixed(0, contents, capacity_l=2.0)
    glass.turn(0, 6.0)
    flask = Flask(contents, physics="paper", capacity_l=2.0)
    receiver = flask.another(capacity_l=1.2)
    glass.heat(0, 1, 40e3, hottest_k=800.0)
    flask.heat(40e3, receiver)
    glass.pour(0, 1, 0.25)
    flask.pour(receiver, 0.25)
    for position, one in enumerate((flask, receiver)):
        for name in contents:
            assert one.amounts[name] == pytest.approx(glass.amount(position, name), rel=1e-12)
        assert one.temperature_k == pytest.approx(glass.shelf.vessel(0, position).temperature_k, rel=1e-12)
    assert receiver.amounts["diethyl_ether"] > 0.5


@pytest.mark.parametrize("physics", TIERS)
def test_nothing_is_lost(physics: str) -> None:
    """Atoms and charge through a long sequence of operations, spills and violent reactions included."""
    rng = np.random.default_rng(4)
    flask = Flask(MIXTURE, physics=physics, capacity_l=1.0, reactions="wurtz")
    flasks = [flask, flask.another(capacity_l=0.2), flask.another(capacity_l=2.0)]
    expected = atoms(flasks)
    for number in range(60):
        one, other = (flasks[i] for i in rng.permutation(3)[:2])
        share = float(rng.random())
        if number == 20:
            flasks[2].add("Na", 0.1)
            expected["Na"] += 0.1
        steps: list[Callable[[], object]] = [
            partial(one.pour, other, share),
            partial(one.drain, other, share),
            partial(one.filter, other, share),
            partial(one.dry, 20.0 * share),
            partial(one.heat, 20e3, other),
            partial(one.cool, 10e3),
            one.mix,
            partial(one.wait, 60.0),
            partial(one.react, 0.01, 300.0),
        ]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SpillWarning)
            steps[rng.integers(len(steps))]()
        for found in flasks:
            assert math.isfinite(found.temperature_k)
            assert min(found.amounts.values()) >= 0.0
            assert found.volume_l <= found.capacity_l * (1.0 + 1e-6)
    found_atoms = atoms(flasks)
    for element, count in expected.items():
        assert found_atoms[element] == pytest.approx(count, rel=1e-9, abs=1e-9), element
    assert any(flask.events.get("spill_l") for flask in flasks)


@pytest.mark.parametrize("physics", TIERS)
def test_heat_goes_somewhere(physics: str) -> None:
    """Heat in = change of (heat capacity x temperature) of both flasks, measured from the room's, + the condenser's."""
    flask = Flask({"diethyl_ether": 4.0, "dodecane": 0.45}, physics=physics, capacity_l=2.0)
    receiver = flask.another()
    room = flask.temperature_k
    heated = flask.heat(100e3, receiver)
    inside = sum(heat_capacity(one) * (one.temperature_k - room) for one in (flask, receiver))
    assert receiver.volume_l > 0.1
    # In the paper's tier the air above the contents is heated, too: up to 2 J/K.
    assert heated.taken_j == pytest.approx(inside + heated.condensed_j, rel=1e-9 if physics == "real" else 1e-3)
    warm = flask.temperature_k
    assert flask.cool(2000.0) == pytest.approx(2000.0)
    rel = 1e-9 if physics == "real" else 0.01
    assert warm - flask.temperature_k == pytest.approx(2000.0 / heat_capacity(flask), rel=rel)
    assert flask.cool(1e9, coolest_k=280.0) < 1e9
    assert flask.temperature_k == pytest.approx(280.0)


def test_salts_precipitate_while_a_flask_cools() -> None:
    once = Flask({"water": 20.0, "KNO3": 3.0}, temperature_k=350.0)
    parts = once.copy()
    assert once.cool(1e5) == pytest.approx(sum(parts.cool(1e4) for _ in range(10)), rel=1e-9)
    assert once.temperature_k == pytest.approx(parts.temperature_k, abs=1e-6)


def test_what_has_boiled_dry_does_not_boil() -> None:
    flask = Flask({"NaCl": 1.0, "water": 10.0})
    flask.heat(1e6)
    flask.react(100.0)
    assert (flask.temperature_k, flask.vapor_pressure_kpa) == (800.0, 0.0)


def test_a_column_keeps_more() -> None:
    def left(stages: int) -> float:
        pot = Flask({"diethyl_ether": 4.0, "dodecane": 0.45}, capacity_l=2.0)
        receiver = pot.another()
        while pot.amounts["diethyl_ether"] > 0.01 * pot.amounts["dodecane"]:
            pot.heat(500.0, receiver, stages=stages)
        return pot.amounts["dodecane"] / 0.45

    one, three = left(1), left(3)
    assert one == pytest.approx(0.966, abs=0.02)  # UNIFAC, boiled down to 99 %
    assert three > one + 0.01


def test_without_a_receiver_what_boils_is_lost() -> None:
    flask = Flask({"diethyl_ether": 4.0, "dodecane": 0.45}, capacity_l=2.0)
    kept = flask.copy()
    receiver = kept.another(capacity_l=3.0)
    assert flask.heat(80e3) == kept.heat(80e3, receiver)
    assert flask.waste["diethyl_ether"] == pytest.approx(receiver.amounts["diethyl_ether"], rel=1e-12)
    assert flask.amounts == kept.amounts


# -- layers -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("physics", TIERS)
def test_layers_are_all_there_is(physics: str) -> None:
    flask = Flask({**MIXTURE, "NaCl": 3.0}, physics=physics, capacity_l=2.0)
    assert flask.layers[0].name == "solids"
    assert len(flask.layers) == 3
    assert sum(layer.volume_l for layer in flask.layers) == pytest.approx(flask.volume_l, rel=1e-9)
    assert sum(layer.share for layer in flask.layers) == pytest.approx(1.0, rel=1e-9)
    for name, mol in flask.amounts.items():
        held = sum(layer.contents.get(name, 0.0) for layer in flask.layers)
        assert held == pytest.approx(mol, abs=1e-9), name


@pytest.mark.parametrize("physics", TIERS)
def test_the_lowest_layer_drains(physics: str) -> None:
    """All of it but for what stands between two marks of the funnel."""
    flask = Flask({"diethyl_ether": 2.0, "dodecane": 0.2, "water": 10.0}, physics=physics, capacity_l=2.0)
    lowest, upper = flask.layers
    below = flask.another()
    flask.drain(below, lowest.share)
    between = 0.25 * 2.0 / 4000 / lowest.volume_l
    assert below.amounts["water"] == pytest.approx(lowest.contents["water"], rel=4 * between)
    assert flask.amounts["diethyl_ether"] == pytest.approx(upper.contents["diethyl_ether"], rel=4 * between)
    assert below.volume_l == pytest.approx(lowest.volume_l, rel=1e-6)


@pytest.mark.parametrize("physics", TIERS)
def test_a_filter_keeps_solids(physics: str) -> None:
    flask = Flask({"water": 10.0, "NaCl": 3.0}, physics=physics)
    salt, brine = flask.layers
    filtrate = flask.another()
    flask.filter(filtrate, cake_liquid=0.5)
    wet = 0.5 * salt.volume_l / brine.volume_l
    assert filtrate.amounts["water"] == pytest.approx((1.0 - wet) * brine.contents["water"], rel=1e-9)
    if physics == "real":  # both stay saturated; the paper's solubility depends on how much liquid there is
        assert flask.amounts["NaCl"] == pytest.approx(salt.contents["NaCl"], rel=1e-6)
        assert filtrate.amounts["NaCl"] == pytest.approx(0.0, abs=1e-9)


def test_dry_crystals_are_left() -> None:
    """Of each litre of air p / RT of water flies, until all of it has; and nothing else."""
    flask = Flask({"water": 5.0, "benzoic_acid": 0.1}, reactions="sodium_salts")  # without ions of water
    held = flask.layers[0].contents["benzoic_acid"]
    flask.dry(1.0)
    expected = flask.vapor_pressure_kpa / (GAS_CONSTANT * flask.temperature_k)
    assert flask.waste["water"] == pytest.approx(expected, rel=1e-3)
    flask.dry(20_000.0)
    assert flask.amounts["water"] == pytest.approx(0.0, abs=1e-9)
    assert flask.waste["water"] == pytest.approx(5.0, rel=1e-9)
    assert flask.amounts["benzoic_acid"] >= held > 0.09


# -- time -------------------------------------------------------------------------------------------------------------


def test_a_flask_cools_in_the_room() -> None:
    """Newton: 0.5 W/K for each litre."""
    flask = Flask({"dodecane": 2.0}, temperature_k=350.0)
    rate = 0.5 * flask.volume_l / heat_capacity(flask)
    flask.wait(3600.0)
    assert flask.temperature_k == pytest.approx(298.15 + (350.0 - 298.15) * math.exp(-3600.0 * rate), rel=1e-6)


@pytest.mark.parametrize("physics", TIERS)
def test_a_reaction_of_first_order(physics: str, decay: str) -> None:
    flask = Flask({"2-chlorohexane": 1.0, "dodecane": 1.0}, physics=physics, reactions=decay)
    flask.react(100.0, 320.0)
    assert flask.amounts["2-chlorohexane"] == pytest.approx(math.exp(-1.0), rel=1e-5)
    assert flask.amounts["1-chlorohexane"] == pytest.approx(1.0 - math.exp(-1.0), rel=1e-5)
    assert flask.temperature_k == 320.0


def test_an_edited_file_is_read_again(decay: str) -> None:
    path = Path(decay)
    text, old = path.read_text(), Flask({"2-chlorohexane": 1.0}, reactions=decay)
    factor = 3.0
    path.write_text(re.sub(r"pre_exponential = (\S+)", lambda m: f"pre_exponential = {factor * float(m[1])}", text))
    new = Flask({"2-chlorohexane": 1.0}, reactions=decay)
    left = []
    for flask in (old, new):
        flask.react(100.0, 330.0)
        left.append(flask.amounts["2-chlorohexane"])
    # A first-order reaction three times as fast: the logarithm of what is left is three times as large.
    assert math.log(left[1]) == pytest.approx(factor * math.log(left[0]), rel=1e-4)
    # Matter of two chemistries is not mixed, and the old flask learns nothing from the new file.
    before = seen(old)
    refused("edited after this flask was made", old.pour, new, 0.5)
    with pytest.raises(DataError, match="edited after this flask was made; make a new flask"):
        old.add("toluene", 0.1)
    assert seen(old) == before
    path.write_text(text)
    old.add("toluene", 0.1)
    assert old.amounts["toluene"] == pytest.approx(0.1)


def test_material_and_pair_files_are_read_again_after_an_edit(tmp_path: Path) -> None:
    shipped = read_toml(Path(__file__).parent.parent / "chemlab" / "data" / "materials" / "solvents.toml")["hexane"]
    materials, pairs = tmp_path / "m.toml", tmp_path / "p.toml"
    masses, pressures = [], []
    for density, b in ((0.65, 0.0), (0.5, 300.0)):
        materials.write_text(material_text({"ours": {**shipped, "density_kg_l": density}}, "a test", ()))
        row = {"of": ["ours", "toluene"], "a": [0.0, 0.0], "b": [b, b], "alpha": 0.3, "low_k": 270.0, "high_k": 400.0}
        pairs.write_text(pair_text([{**row, "error": 0.0, "source": "a test"}], "a test", ()))
        flask = Flask({"ours": 1.0, "toluene": 1.0}, material_files=[str(materials)], pair_files=[str(pairs)])
        alone = flask.another({"ours": 1.0})
        masses.append(alone.mass_kg / alone.volume_l)
        pressures.append(flask.vapor_pressure_kpa)
    assert masses == pytest.approx([0.65, 0.5], rel=1e-6)
    # NRTL with tau = 1 for both at 300 K (about, at 298.15) and x = 1/2: ln gamma = tau (G^2 + G) / (1 + G)^2 with
    # G = exp(-0.3 tau), the same for both, so that the pressure rises by gamma against the ideal mixture of before.
    tau = 300.0 / flask.temperature_k
    g = math.exp(-0.3 * tau)
    gamma = math.exp(tau * (g**2 + g) / (1.0 + g) ** 2)
    assert pressures[1] / pressures[0] == pytest.approx(gamma, rel=1e-3)


def test_without_a_condenser_it_boils_dry() -> None:
    """A runaway: under a condenser that takes everything nothing is lost and it stays at its boiling point."""
    flask = Flask({"diethyl_ether": 4.0, "1-chlorohexane": 1.0, "Na": 1.0}, capacity_l=2.0, reactions="wurtz_real")
    open_, closed = flask.copy(), flask.copy()
    open_.react(1800.0, condenser_w=0.0)
    closed.react(1800.0)
    assert open_.events["relief_valve_mol"] > 1.0
    assert not closed.events
    assert closed.amounts["diethyl_ether"] == pytest.approx(4.0, rel=1e-9)
    assert 305.0 < closed.temperature_k < 330.0


# -- however long a call lasts ----------------------------------------------------------------------------------------

IDEAL = """
[lock]
made = "by hand"

[[pairs]]
of = ["naphthalene", "{other}"]
a = [0.0, 0.0]
b = [0.0, 0.0]
alpha = 0.3
low_k = 250.0
high_k = 400.0
error = 0.0
source = "ideal, for a test"
"""


def isomers(folder: Path, rate: float) -> dict[str, Any]:
    """Arguments of a flask in which a liquid turns into naphthalene and back, K = 1, and all mixtures are ideal."""
    table = NAPHTHALENE.model_dump(mode="json", exclude_none=True)
    del table["cas"], table["smiles"], table["real"]["fusion_enthalpy_j_mol"]
    table |= {"name": "an isomer", "melting_point_k": 250.0}
    table["real"] |= {"formation_state": "l"}
    table["real"]["formation_enthalpy_j_mol"] += FUSION
    table["real"]["source"] = {k: v for k, v in table["real"]["source"].items() if not k.startswith("fusion")}
    pairs = [IDEAL.format(other=other) for other in ("isomer", "toluene")]
    pairs.append(IDEAL.replace("naphthalene", "isomer").format(other="toluene"))
    files = [folder / f"pair_{number}.toml" for number in range(3)]
    texts = [material_text({"isomer": table}, "by hand", ()), first_order("isomer", "naphthalene", rate, 1.0), *pairs]
    for file, text in zip((folder / "isomer.toml", folder / "family.toml", *files), texts, strict=True):
        file.write_text(text, encoding="utf-8")
    materials = [str(folder / "isomer.toml")]
    return {"reactions": str(folder / "family.toml"), "material_files": materials, "pair_files": list(map(str, files))}


@pytest.mark.parametrize("rate", [2e-4, 2e-2])
def test_a_product_that_crystallizes_draws_its_equilibrium(tmp_path: Path, rate: float) -> None:
    """What crystallizes meanwhile goes on being made: SciPy's integration, in one call as in many."""
    kelvin, solvent, seconds = 283.15, 1.0, 3600.0
    soluble = math.exp(-FUSION / GAS_CONSTANT * (1.0 / kelvin - 1.0 / MELTING))
    begun = 1.0

    def slopes(time: float, y: FloatArray) -> list[float]:
        isomer, held = y
        made = rate * (isomer - held)
        saturated = soluble / (1.0 - soluble) * (isomer + solvent)
        return [-made, made + 2e-3 * min(begun - isomer - held, saturated - held)]

    start = [0.45, 0.25]  # 0.3 mol of crystals
    isomer, held = solve_ivp(slopes, (0.0, seconds), start, rtol=1e-8, atol=1e-10, method="LSODA").y[:, -1]
    settings = isomers(tmp_path, rate)
    for calls in (1, 7, 60):
        flask = Flask({"isomer": start[0], "naphthalene": 0.55, "toluene": solvent}, temperature_k=kelvin, **settings)
        flask._shelf.dissolved[0, 0, flask._shelf.layout.dissolved.index("naphthalene")] = [0.0, start[1]]
        for _ in range(calls):
            flask.react(seconds / calls, kelvin)
        crystals = flask.layers[0].contents["naphthalene"]
        assert flask.amounts["isomer"] == pytest.approx(isomer, rel=0.01), calls
        assert crystals == pytest.approx(begun - isomer - held, rel=0.01), calls
        assert flask.amounts["isomer"] + flask.amounts["naphthalene"] == pytest.approx(begun, rel=1e-12)


def test_crystals_dissolve_while_they_react() -> None:
    """Aspirin, an hour at 60 degrees C, of crystals of salicylic acid, in one call and in 60, thermostat or jacket."""
    made: dict[tuple[int, float | None], float] = {}
    for calls, jacket in itertools.product((1, 60), (None, 6.0)):
        flask = Flask({"acetic_acid": 1.0, "acetic_anhydride": 0.75, "salicylic_acid": 0.3}, reactions="aspirin")
        before = atoms([flask])
        for _ in range(calls):
            flask.react(900.0 / calls, 333.15, jacket)
        made[calls, jacket] = flask.amounts["acetylsalicylic_acid"]
        assert {k: round(v, 9) for k, v in atoms([flask]).items()} == {k: round(v, 9) for k, v in before.items()}
    for jacket in (None, 6.0):
        assert 0.2 < made[60, jacket] < 0.3
        assert made[1, jacket] == pytest.approx(made[60, jacket], rel=0.01)


def test_crystals_melt_by_the_heat_that_they_take() -> None:
    """At the melting point until all have: heat = capacity x warming + heat of fusion x what has melted."""
    mol = 0.5
    molten = Flask({"naphthalene": mol}, temperature_k=MELTING + 1.0)
    assert [layer.name for layer in molten.layers] == ["organic"]
    assert molten.temperature_k == MELTING + 1.0
    flask = Flask({"naphthalene": mol}, temperature_k=340.0)
    warming = heat_capacity(flask) * (MELTING - 340.0)
    flask.heat(warming + 0.25 * FUSION * mol)
    assert flask.temperature_k == pytest.approx(MELTING, abs=1e-6)
    assert flask.layers[-1].contents["naphthalene"] == pytest.approx(0.25 * mol, rel=1e-6)
    flask.heat(0.75 * FUSION * mol + 10.0 * heat_capacity(flask))
    assert [layer.name for layer in flask.layers] == ["organic"]
    assert flask.temperature_k == pytest.approx(MELTING + 10.0, abs=1e-6)


def test_dissolved_crystals_are_no_layer() -> None:
    flask = Flask({"water": 100.0, "benzoic_acid": 1e-4}, capacity_l=3.0)
    flask.wait(36_000.0)
    assert [layer.name for layer in flask.layers] == ["aqueous"]


def test_a_cooling_solution_crystallizes_alike_in_one_tick_and_in_many() -> None:
    left = []
    for ticks in (1, 60):
        flask = Flask({"water": 50.0, "benzoic_acid": 0.3}, capacity_l=2.0, temperature_k=360.0)
        arguments = flask._chem, flask._shelf.waste[0], flask._events, flask._work
        for _ in range(ticks):
            laws.elapse(flask._row, 30.0 / ticks, *arguments)  # half an hour
        flask.settle()
        left.append(flask.layers[0].contents["benzoic_acid"])
    assert left[0] == pytest.approx(left[1], rel=0.01)
    assert 0.1 < left[1] < 0.2


SAPONIFICATION = """
name = "saponification"

[[reaction]]
reactants = {{ ethyl_acetate = 1, {base} = 1 }}
products = {{ {salt} = 1, ethanol = 1 }}
pre_exponential = {rate}
activation_energy_j_mol = 0.0
source = "made up for a test"
{more}
[[salt]]
solid = "NaOH"
cation = "Na+"
anion = "OH-"
source = "made up for a test"
solubility = {{ solvents = {{ water = [[298.15, 25.0]] }}, source = "CRC Handbook" }}

[[salt]]
solid = "sodium_acetate"
cation = "Na+"
anion = "acetate"
source = "made up for a test"
solubility = {{ solvents = {{ water = [[298.15, 6.0]] }}, source = "Seidell" }}
"""


@pytest.mark.parametrize(("base", "salt"), [("NaOH", "sodium_acetate"), ('"OH-"', "acetate")])
def test_a_soluble_salt_reacts_as_its_ions(tmp_path: Path, base: str, salt: str) -> None:
    """Second order with equal concentrations: x = c k c t / (1 + k c t)."""
    path, rate, mol, seconds = tmp_path / "family.toml", 0.11, 0.05, 1800.0
    path.write_text(SAPONIFICATION.format(base=base, salt=salt, rate=rate, more=""), encoding="utf-8")
    for calls in (1, 20):
        contents = {"water": 54.8, "ethyl_acetate": mol, "NaOH": mol}
        flask = Flask(contents, reactions=str(path), temperature_k=298.15)
        litres = flask.volume_l
        for _ in range(calls):
            flask.react(seconds / calls, 298.15)
        ahead = rate * mol / litres * seconds
        assert flask.amounts["ethanol"] == pytest.approx(mol * ahead / (1.0 + ahead), rel=2e-3)
        assert sum(n * MATERIALS[name].charge for name, n in flask.amounts.items()) == pytest.approx(0.0, abs=1e-12)


def test_a_salt_without_water_reacts_as_a_solid(tmp_path: Path) -> None:
    """Of first order in what there is of it by litre of liquid, where nothing dissolves it."""
    path = tmp_path / "family.toml"
    path.write_text(SAPONIFICATION.format(base="NaOH", salt="sodium_acetate", rate=1e-3, more=""), encoding="utf-8")
    flask = Flask({"ethyl_acetate": 5.0, "NaOH": 0.01, "toluene": 1.0}, reactions=str(path))
    litres = flask.layers[-1].volume_l
    flask.react(60.0, 298.15)
    assert flask.amounts["sodium_acetate"] == pytest.approx(0.01 * -math.expm1(-1e-3 * 5.0 / litres * 60.0), rel=5e-3)
    assert flask.amounts["OH-"] == 0.0


BUFFER = """
[[acid]]
species = ["salicylic_acid", "salicylate"]
pka = [9.0]
enthalpy_j_mol = [0.0]
source = "made up for a test: as if it were a weak one"
"""


def test_a_buffer_gives_what_a_reaction_takes(tmp_path: Path) -> None:
    """A base that is at its equilibrium all the time: SciPy's integration with the balance of charge at every point."""
    path, rate, mol, weak, seconds = tmp_path / "family.toml", 1.0, 0.01, 0.05, 18_000.0
    path.write_text(SAPONIFICATION.format(base='"OH-"', salt="acetate", rate=rate, more=BUFFER), encoding="utf-8")
    contents = {"water": 54.0, "ethyl_acetate": mol, "salicylate": weak, "Na+": weak}
    litres = Flask(contents, reactions=str(path)).volume_l
    kilograms = 54.0 * 18.01528e-3
    strength = weak / kilograms
    root = math.sqrt(strength)
    gamma = 10.0 ** (-0.509 * (root / (1.0 + root) - 0.3 * strength))
    water, acid = 10.0**-13.995 / gamma**2, 10.0**-9.0 / gamma**2

    def hydroxide(used: float) -> float:
        """mol, where the acid has given as many protons as are not left to hydroxide."""

        def excess(log: float) -> float:
            proton = math.exp(log)
            base = weak / kilograms * acid / (acid + proton)
            return weak / kilograms + proton - water / proton - base - used / kilograms

        proton = math.exp(brentq(excess, -40.0, 0.0, xtol=1e-14))
        return water / proton * kilograms

    def slope(time: float, used: FloatArray) -> list[float]:
        return [rate * hydroxide(used[0]) * (mol - used[0]) / litres]

    expected = solve_ivp(slope, (0.0, seconds), [0.0], rtol=1e-9, atol=1e-12).y[0, -1]
    assert 0.3 * mol < expected < 0.95 * mol
    assert expected > 5.0 * hydroxide(0.0)  # many times what there was of it
    for calls in (1, 30):
        flask = Flask(contents, reactions=str(path), temperature_k=298.15)
        for _ in range(calls):
            flask.react(seconds / calls, 298.15)
        assert flask.amounts["ethanol"] == pytest.approx(expected, rel=0.01), calls


def test_gas_does_not_come_back_to_an_open_flask(tmp_path: Path) -> None:
    """What leaves is no reactant: first order to its end under a condenser, an equilibrium where it is kept in."""
    path = tmp_path / "family.toml"
    path.write_text(first_order("hexane", "1-hexene, H2", 1e-3, 0.1), encoding="utf-8")
    for calls in (1, 10):
        flask = Flask({"hexane": 0.1, "dodecane": 2.0}, reactions=str(path))
        for _ in range(calls):
            flask.react(1000.0 / calls, 298.15, jacket_w_k=1e6)
        assert flask.amounts["hexane"] == pytest.approx(0.1 * math.exp(-1.0), rel=2e-3)
    closed = Flask({"hexane": 0.1, "dodecane": 2.0}, reactions=str(path))
    litres = closed.volume_l
    closed.react(1e5, 298.15)
    made = closed.amounts["1-hexene"]
    assert made**2 / (0.1 - made) / litres == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize("mol", [1e-3, 0.01, 0.1, 1.0])
@pytest.mark.parametrize("ions", [{"H+": 1.0, "Cl-": 1.0}, {"Na+": 1.0, "OH-": 1.0}])
def test_the_ph_of_strong_acids_and_bases(ions: dict[str, float], mol: float) -> None:
    """Davies' activity coefficient, which chemlab keeps from 0.5 mol/kg on, and pKw = 13.995."""
    kilogram = 1000.0 / MATERIALS["water"].molar_mass_g_mol
    flask = Flask({"water": kilogram, **dict.fromkeys(ions, mol)}, capacity_l=2.0, temperature_k=298.15)
    root = math.sqrt(min(mol, 0.5))
    ph = -math.log10(mol) + 0.509 * (root / (1.0 + root) - 0.3 * root**2)
    assert float(flask.measure("ph_meter")) == pytest.approx(ph if "H+" in ions else 13.995 - ph, abs=0.002)


def test_the_ph_of_water_and_of_salt_water() -> None:
    for contents in ({"water": 10.0}, {"water": 10.0, "Na+": 0.1, "Cl-": 0.1}, {"water": 10.0, "hexane": 0.5}):
        assert float(Flask(contents, temperature_k=298.15).measure("ph_meter")) == pytest.approx(7.0, abs=0.005)
    assert str(Flask({"water": 0.1, "HCl": 1.0}).measure("ph_meter")).endswith("nothing aqueous, or below -2")


@pytest.mark.filterwarnings("error::chemlab.sandbox.IonizationWarning")
@pytest.mark.parametrize(
    ("name", "mol", "kind", "words"),
    [
        ("water", 1.0, "karl_fischer", "100.000% water by mass"),
        ("water", 1.0, "balance", "0.018 kg"),
        ("water", 200.0, "balance", "2.000 kg or more, the end of its range"),
        ("benzoic_acid", 0.1, "ph_meter", "no pH: nothing aqueous, or below -2"),
    ],
)
def test_a_reading_in_words_also_at_the_end_of_its_range(name: str, mol: float, kind: str, words: str) -> None:
    assert str(Flask({name: mol}, capacity_l=5.0).measure(kind)) == words


# -- what a flask knows -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "ionizes"), [("formic acid", False), ("triethylamine", False), ("AcOH", True), ("vanillin", False)]
)
def test_a_ph_without_an_acid_that_does_not_ionize_is_doubted(name: str, ionizes: bool) -> None:
    flask = Flask({"water": 5.0, name: 0.01})
    with nullcontext() if ionizes else pytest.warns(IonizationWarning, match=name.replace(" ", "_")):
        assert (float(flask.measure("ph_meter")) < 6.9) is ionizes


@pytest.mark.parametrize("physics", TIERS)
def test_learning_changes_nothing(physics: str) -> None:
    """A flask that gets to know a material holds what it held, layer by layer."""
    flask = Flask(MIXTURE, physics=physics, capacity_l=2.0)
    flask.add("hexane", 0.0)
    again = Flask(MIXTURE, physics=physics, capacity_l=2.0)
    assert "hexane" in flask.amounts
    assert "hexane" not in again.amounts
    for mine, theirs in zip(flask.layers, again.layers, strict=True):
        assert mine.name == theirs.name
        assert dict(mine.contents) == pytest.approx(dict(theirs.contents), rel=1e-12)
    other = Flask({"ethyl_acetate": 1.0}, physics=physics)
    other.pour(flask, 1.0)
    assert flask.amounts["ethyl_acetate"] == 1.0
    assert set(other.amounts) == set(flask.amounts)


def test_a_copy_is_a_flask_of_its_own() -> None:
    flask = Flask(MIXTURE, capacity_l=2.0)
    before = seen(flask)
    for copied in (flask.copy(), copy.copy(flask)):
        assert seen(copied) == before
        copied.heat(200e3)
        assert seen(flask) == before
        assert copied.waste


def test_what_does_not_fit_runs_over() -> None:
    flask = Flask({"water": 5.0}, capacity_l=0.1)
    with pytest.warns(SpillWarning, match=r"spilled: the capacity is 0\.1 L"):
        flask.add("water", 2.0)
    assert flask.volume_l == pytest.approx(0.1)
    assert flask.amounts["water"] + flask.waste["water"] == pytest.approx(7.0)
    molar = MATERIALS["water"].molar_mass_g_mol / 1000.0 / MATERIALS["water"].density_kg_l
    assert flask.events["spill_l"] == pytest.approx(7.0 * molar - 0.1)
    with pytest.warns(SpillWarning) as caught:
        flask.add("H2SO4", 1.0)  # added as its ions
    assert [one.filename for one in caught] == [__file__]


@pytest.mark.parametrize("physics", TIERS)
def test_a_receiver_that_runs_over_loses_it_itself(physics: str) -> None:
    pot = Flask({"diethyl_ether": 4.0}, physics=physics)
    receiver = pot.another({"diethyl_ether": 0.1}, capacity_l=0.05)
    with pytest.warns(SpillWarning, match=r"spilled: the capacity is 0\.05 L") as caught:
        pot.heat(60e3, receiver)
    assert len(caught) == 1
    assert pot.waste == pot.events == {}
    held = sum(flask.amounts["diethyl_ether"] for flask in (pot, receiver))
    assert held + receiver.waste["diethyl_ether"] == pytest.approx(4.1, rel=1e-12)
    assert receiver.events["spill_l"] > 0.1
    if physics == "real":
        assert pot.history[-1].distillate["diethyl_ether"] == pytest.approx(4.0 - pot.amounts["diethyl_ether"])


def test_a_thermostat_that_would_boil_an_open_flask() -> None:
    flask = Flask({"water": 10.0, "ethanol": 2.0})
    with pytest.warns(BoilingWarning, match=r"at 600 K the contents would boil .*jacket_w_k leaves it open") as caught:
        flask.react(10.0, temperature_k=600.0)
    assert caught[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        flask.react(10.0, temperature_k=300.0)


def test_a_salt_that_a_reaction_file_forgets(decay: str) -> None:
    with pytest.warns(SaltWarning, match=r"NaOH has no \[\[salt\]\] entry in decay\.toml, so it does not") as caught:
        flask = Flask({"water": 10.0, "NaOH": 0.1}, reactions=decay)
    with pytest.warns(SaltWarning, match="NaCl has no") as more:
        flask.add("NaCl", 0.1)
    salt = flask.another({"KCl": 0.1})
    with pytest.warns(SaltWarning) as poured:
        salt.pour(flask, 1.0)
    assert {one.filename for one in (*caught, *more, *poured)} == {__file__}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        flask.copy().heat(10.0)  # once of each salt


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Flask({"diethylether": 1.0}), "did you mean 'diethyl_ether'"),
        (lambda: Flask({"H2": 1.0}), "is a gas"),
        (lambda: Flask({"water": -1.0}), "contents: water: must be a finite number of at least 0"),
        (lambda: Flask({"water": math.nan}), "contents: water: must be a finite number"),
        (lambda: Flask({"water": "much"}), "contents: water: must be a number"),  # type: ignore[dict-item]
        (lambda: Flask({"water": 100.0}), "do not fit in capacity_l = 1"),
        (lambda: Flask("water"), r'contents must be a mapping such as {"water": 1.0}, given .water.'),  # type: ignore[arg-type]
        (lambda: Flask({"water": 1.0}).another(["water"]), "contents must be a mapping"),  # type: ignore[arg-type]
        (lambda: Flask({"water": 1.0, "Na+": 1.0}), r"charge of \+1 mol"),
        (lambda: Flask({"water": 1.0}, capacity_l=0.0), "capacity_l: must be"),
        (lambda: Flask({"water": 1.0}, physics="magic"), "flask: physics: unknown backend"),
        (lambda: Flask({"water": 1.0}, reactions="magic"), "flask: reactions: unknown family"),
        (lambda: Flask({"water": 1.0}, temperature_k=math.inf), "temperature_k: must be"),
        (lambda: Flask(room_k=25.0), "room_k: must be a finite number of at least 200"),
        (lambda: Flask(room_kpa=101325.0), "room_kpa: must be .* at most 1000"),
    ],
)
def test_what_is_no_flask(made: Callable[[], Flask], message: str) -> None:
    refused(message, made)


@pytest.mark.parametrize(
    ("work", "message"),
    [
        (lambda flask, other: flask.add("wather", 1.0), "did you mean 'water'"),
        (lambda flask, other: flask.add("water", -1.0), "add: water: must be"),
        (lambda flask, other: flask.add("Na+", 1.0), "is an ion"),
        (lambda flask, other: flask.pour(flask, 0.5), "is the flask itself"),
        (lambda flask, other: flask.pour(other, 1.5), "share: must be .* at most 1"),
        (lambda flask, other: flask.drain(other, math.nan), "share: must be"),
        (lambda flask, other: flask.filter(other, -1.0), "cake_liquid: must be"),
        (lambda flask, other: flask.heat(-5.0), "joules: must be"),
        (lambda flask, other: flask.heat(math.inf, other), "joules: must be a finite"),
        (lambda flask, other: flask.heat(1e300, other), r"joules: must be .* at most 1e\+09"),
        (lambda flask, other: flask.heat(1.0, other, stages=99), "stages: must be"),
        (lambda flask, other: flask.heat(1.0, stages=1.9), "stages: must be a whole number, given 1.9"),
        (lambda flask, other: flask.another({"K2CO3": 1.0, "water": 1.0}), "'K2CO3' is a salt that is not in the cata"),
        (lambda flask, other: flask.heat(1.0, hottest_k=120.0), "hottest_k: must be .* at least 150"),
        (lambda flask, other: flask.cool(math.nan), "joules: must be"),
        (lambda flask, other: flask.react(-1.0), "seconds: must be"),
        (lambda flask, other: flask.react(1.0, jacket_w_k=1.0), "requires temperature_k"),
        (lambda flask, other: flask.wait(math.inf), "seconds: must be a finite"),
        (lambda flask, other: flask.pour(Flask({"water": 1.0}, physics="paper"), 0.5), "has physics = 'paper'"),
        (lambda flask, other: flask.measure("horoscope"), "unknown kind 'horoscope'"),
        (lambda flask, other: flask.measure(None), "measure: kind: .* given None"),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_done_changes_nothing(work: Callable[[Flask, Flask], object], message: str) -> None:
    flask = Flask(MIXTURE, capacity_l=2.0)
    other = flask.another()
    before = seen(flask), seen(other)
    refused(message, work, flask, other)
    assert (seen(flask), seen(other)) == before


@pytest.mark.parametrize(("law", "work"), [("react", Flask.react), ("elapse", Flask.wait)])
def test_what_is_too_stiff_changes_nothing(
    law: str, work: Callable[[Flask, float], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    flask = Flask(MIXTURE, capacity_l=2.0)
    before = seen(flask)
    monkeypatch.setattr(laws, law, lambda *_: -1)
    with pytest.raises(ArithmeticError, match="too stiff"):
        work(flask, 60.0)
    assert seen(flask) == before


def test_a_receiver_is_a_flask() -> None:
    with pytest.raises(TypeError, match="receiver: must be a Flask, given 'cup'"):
        Flask({"water": 1.0}).pour("cup", 0.5)  # type: ignore[arg-type]


def test_paper_has_no_columns_and_no_materials_without_polarity() -> None:
    refused("a column needs physics='real'", Flask({"water": 1.0}, physics="paper").heat, 1.0, stages=2)
    unknown = next(name for name, m in MATERIALS.items() if m.polarity is None and m.role not in ("gas", "ion"))
    with pytest.raises(DataError, match=f"flask: materials: '{re.escape(unknown)}' has no polarity"):
        Flask({unknown: 1.0}, physics="paper")


# -- how it looks -----------------------------------------------------------------------------------------------------


def test_it_has_a_picture() -> None:
    pytest.importorskip("PIL")
    flask = Flask(MIXTURE, capacity_l=0.5)
    picture = flask.picture(240, 200)
    assert (picture.shape, picture.dtype) == ((200, 240, 3), np.uint8)
    layers = flask.scene().shelf[0].vessel
    column = [tuple(pixel) for pixel in picture[:, 105].tolist()]
    where = []
    for layer in layers.layers:
        color = tuple(bytes.fromhex(layer.color[1:]))
        assert color in column, layer
        where.append(column.index(color))
    assert where[0] > where[1]  # water below
    assert "data:image/png;base64," in flask._repr_html_()
    refused("at least 120", flask.picture, 50, 50)
    refused("at most 8192 each, given 100000 x 100000", flask.picture, 100_000, 100_000)


# -- examples ---------------------------------------------------------------------------------------------------------


def test_docstrings() -> None:
    found = doctest.testmod(chemlab.sandbox)
    assert found.attempted >= 4
    assert found.failed == 0


@pytest.mark.parametrize("name", ["snar", "fischer"])
def test_what_a_bench_adds_reacts_in_the_same_step_as_in_a_flask(name: str) -> None:
    env = RoleEnv(name, bench="rxn")
    env.reset(seed=0)
    shelf, options, reagents = env.batch.shelf, env.bench.options, env.bench.spec.reagents
    contents = dict(zip(shelf.layout.materials, shelf.amounts[0, 0].tolist(), strict=True))
    for reagent, mol in reagents.items():
        contents[reagent] += mol
    env.step(np.array([0.5, 0.5, *np.ones(len(reagents))]))
    flask = Flask({m: mol for m, mol in contents.items() if mol}, reactions=env.scenario.reactions)
    flask.react(options.tick, 298.15, jacket_w_k=options.jacket_w_k, condenser_w=options.condenser_w)
    made = dict(zip(shelf.layout.materials, shelf.amounts[0, 0].tolist(), strict=True))
    assert made == pytest.approx({m: flask.amounts.get(m, 0.0) for m in made}, rel=1e-3, abs=1e-6)
    assert sum(made[goal] for goal in env.scenario.goals) > 0.01


@pytest.mark.parametrize(("mol", "seconds", "jacket"), [(8.0, 3600.0, 0.0), (10.0, 7200.0, 50.0)])
def test_a_product_lowers_the_boiling_point_alike_in_one_call(
    tmp_path: Path, mol: float, seconds: float, jacket: float
) -> None:
    """Ether that forms from warm ethanol boils off, in an insulated flask and in a jacket."""
    path = tmp_path / "ether.toml"
    text = first_order("ethanol", "diethyl_ether, water", 3e9).replace('"ethanol" = 1', '"ethanol" = 2')
    path.write_text(text.replace("j_mol = 0.0", "j_mol = 100000.0"), encoding="utf-8")
    lost = []
    for calls in (1, 300):
        flask = Flask({"ethanol": mol}, reactions=str(path), temperature_k=345.0)
        for _ in range(calls):
            flask.react(seconds / calls, 345.0, jacket_w_k=jacket, condenser_w=0.0)
        lost.append(flask.waste)
    assert lost[0]["diethyl_ether"] == pytest.approx(lost[1]["diethyl_ether"], rel=0.05)
    assert lost[0]["ethanol"] == pytest.approx(lost[1]["ethanol"], rel=0.07)


def test_contents_boiled_dry_have_the_temperature_of_the_room_in_every_call(tmp_path: Path) -> None:
    path = tmp_path / "ether.toml"
    path.write_text(first_order("ethanol", "diethyl_ether, water", 1e-5).replace('"ethanol" = 1', '"ethanol" = 2'))
    dry = Flask({"ethanol": 10.0}, reactions=str(path))
    for _ in range(5):
        dry.react(1440.0, 365.0, jacket_w_k=50.0, condenser_w=0.0)
    assert dry.temperature_k == 298.15


def test_what_a_runaway_boils_off_does_not_depend_on_how_long_one_looks_away() -> None:
    """Ten minutes at once lose as much ether as six thousand tenths of a second."""
    lost = []
    for calls in (1, 6000):
        flask = Flask({"diethyl_ether": 4.0, "1-chlorohexane": 0.5, "Na": 0.5}, capacity_l=2.0, reactions="wurtz_real")
        for _ in range(calls):
            flask.react(600.0 / calls, 283.15, jacket_w_k=6.0, condenser_w=80.0)
        lost.append(4.0 - flask.amounts["diethyl_ether"])
    assert lost[1] > 0.5
    assert lost[0] == pytest.approx(lost[1], rel=0.05)
