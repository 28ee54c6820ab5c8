"""Melting, boiling and dissolving in one flask: at equilibrium, with the energy balance, however calls are divided."""

from pathlib import Path

import numpy as np
import pytest

from chemlab.config.materials import shipped_materials
from chemlab.physics import backends as laws
from chemlab.physics.backends.real.heats import enthalpy
from chemlab.physics.chemistry import AIR, AMOUNTS, TEMPERATURE
from chemlab.physics.constants import GAS_CONSTANT
from chemlab.physics.surroundings import Surroundings
from chemlab.physics.thermal import seal_vessel
from chemlab.sandbox import BoilingWarning, Flask

NAPHTHALENE = shipped_materials()["naphthalene"]


def state(flask: Flask, *others: Flask) -> list[float]:
    """Temperature, and the mol of everything in several flasks."""
    return [flask.temperature_k, *(mol for one in (flask, *others) for mol in one.amounts.values())]


def heated(contents: dict[str, float], joules: float, calls: int) -> list[float]:
    flask = Flask(contents, capacity_l=2.0)
    receiver = flask.another()
    for _ in range(calls):
        flask.heat(joules / calls, receiver)
    assert flask.vapor_pressure_kpa < 102.0, "open, so it boils before"
    assert sum(flask.waste.values()) == 0.0
    return state(flask, receiver)


@pytest.mark.parametrize(
    ("contents", "joules"),
    [
        ({"naphthalene": 1.0}, 15e3),
        ({"naphthalene": 1.0}, 60e3),
        ({"toluene": 3.0, "naphthalene": 1.0}, 120e3),
        ({"naphthalene": 0.5, "phenol": 0.5}, 30e3),
        ({"water": 10.0, "NaCl": 1.0}, 450e3),
        ({"water": 10.0, "KNO3": 3.0}, 300e3),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, dict) else f"{value / 1000:.0f}kJ",
)
def test_heating_does_not_depend_on_its_division(contents: dict[str, float], joules: float) -> None:
    once = heated(contents, joules, 1)
    for calls in (2, 10):
        np.testing.assert_allclose(heated(contents, joules, calls), once, rtol=2e-3, atol=2e-3)


def test_a_jacket_melts_crystals_at_their_melting_point() -> None:
    """Without a reaction there is a closed form: warming, melting at one temperature, warming."""
    heat, melting, transfer, jacket = NAPHTHALENE.heat_capacity_j_mol_k, NAPHTHALENE.melting_point_k, 5.0, 400.0
    warming = heat / transfer * np.log((jacket - 298.15) / (jacket - melting))
    molten = warming + NAPHTHALENE.real.fusion_enthalpy_j_mol / transfer / (jacket - melting)
    for seconds in (0.5 * warming, 0.5 * (warming + molten), 1.5 * molten):
        for calls in (1, 7):
            flask = Flask({"naphthalene": 1.0})
            for _ in range(calls):
                flask.react(seconds / calls, jacket, jacket_w_k=transfer)
            solid = sum(mol for layer in flask.layers if layer.name == "solids" for mol in layer.contents.values())
            share = min(max((molten - seconds) / (molten - warming), 0.0), 1.0)
            assert solid == pytest.approx(share, abs=2e-3)
            if 0.0 < share < 1.0:
                assert flask.temperature_k == pytest.approx(melting, abs=1e-6)


def test_a_thermostat_holds_its_temperature() -> None:
    """It supplies the heat of melting and of dissolving."""
    for contents, kelvin in (({"phenol": 1.0}, 340.0), ({"water": 20.0, "KNO3": 2.0}, 350.0)):
        flask = Flask(contents)
        flask.react(60.0, kelvin)
        assert flask.temperature_k == pytest.approx(kelvin, abs=1e-6)
        assert [layer.name for layer in flask.layers] in (["organic"], ["aqueous"])


def test_heat_of_dissolving_is_that_of_what_has_dissolved() -> None:
    """Potassium nitrate cools its water: in one portion or in many, and mixing changes nothing more."""
    found = []
    for portions in (1, 2, 20):
        flask = Flask({"water": 20.0})
        for _ in range(portions):
            flask.add("KNO3", 2.0 / portions)
        found.append(state(flask))
        for _ in range(3):
            flask.mix()
        np.testing.assert_allclose(state(flask), found[-1], rtol=1e-6, atol=1e-7)
    assert found[0][0] < 285.0
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize(
    ("contents", "last"),
    [
        ({"water": 10.0, "ethanol": 1.5, "NaCl": 0.25}, "NaCl"),
        ({"ethanol": 6.0, "water": 4.0, "NaOH": 0.1}, "NaOH"),
        ({"ethanol": 5.0, "water": 5.0, "NaCl": 0.1}, "NaCl"),
        ({"water": 8.0, "diethyl_ether": 2.0, "ethanol": 1.0, "NaCl": 0.5}, "ethanol"),
        ({"water": 3.0, "methanol": 0.4, "KNO3": 1.0}, "methanol"),
    ],
    ids=lambda value: "+".join(value) if isinstance(value, dict) else value,
)
def test_shaken_once_is_at_equilibrium_in_whatever_order(contents: dict[str, float], last: str) -> None:
    flask = Flask(contents)
    flask.mix()
    volumes, once = [layer.volume_l for layer in flask.layers], state(flask)
    flask.mix()
    np.testing.assert_allclose([layer.volume_l for layer in flask.layers], volumes, rtol=1e-3, atol=1e-5)
    np.testing.assert_allclose(state(flask), once, rtol=1e-5, atol=1e-5)
    other = Flask({name: mol for name, mol in contents.items() if name != last})
    other.add(last, contents[last])
    other.mix()
    assert other.temperature_k == pytest.approx(flask.temperature_k, abs=1e-2)
    np.testing.assert_allclose([layer.volume_l for layer in other.layers], volumes, rtol=1e-3, atol=1e-5)


def test_a_solid_that_distils_into_a_warm_flask_keeps_the_energy_balance() -> None:
    for warm in (False, True):
        pot = Flask({"phenol": 1.0}, temperature_k=400.0)
        receiver = pot.another({"water": 5.0})
        if warm:
            receiver.react(60.0, 350.0)
        before = [enthalpy(flask._row, flask._chem) for flask in (pot, receiver)]
        taken, condensed = pot.heat(60e3, receiver)
        after = [enthalpy(flask._row, flask._chem) for flask in (pot, receiver)]
        assert sum(after) - sum(before) + condensed == pytest.approx(taken, rel=1e-9)


def test_salts_of_carboxylic_acids_are_bases() -> None:
    """Benzoate takes the proton of hydrochloric acid; acetate is a weak base, with or without acetic acid named."""
    flask = Flask({"water": 55.5, "sodium benzoate": 0.5}, capacity_l=3.0)
    flask.add("HCl", 0.5)
    flask.wait(7200.0)
    assert flask.amounts["benzoic_acid"] == pytest.approx(0.5, abs=0.01)
    assert float(flask.measure("ph_meter").values[0]) == pytest.approx(2.9, abs=0.1)
    for named in ({}, {"acetic_acid": 0.0}):
        acetate = Flask({"water": 55.5, "sodium acetate": 0.1, **named}, capacity_l=3.0)
        assert float(acetate.measure("ph_meter").values[0]) == pytest.approx(8.8, abs=0.1)


def test_what_is_added_above_its_melting_point_is_molten() -> None:
    flask, other = Flask(), Flask({"naphthalene": 0.5}, temperature_k=400.0)
    flask.add("naphthalene", 0.5, temperature_k=400.0)
    np.testing.assert_allclose(state(flask), state(other))
    assert [layer.name for layer in flask.layers] == ["organic"]


@pytest.mark.parametrize("capacity_l", [1.0, 100.0])
def test_a_share_of_little_in_a_large_flask_drains(capacity_l: float) -> None:
    for share in (0.5, 1.0):
        flask = Flask({"water": 0.1}, capacity_l=capacity_l)
        receiver = flask.another()
        flask.drain(receiver, share)
        assert receiver.amounts["water"] == pytest.approx(0.1 * share, rel=1e-9)


def test_a_reaction_file_may_name_materials_of_the_catalogue(tmp_path: Path) -> None:
    file = tmp_path / "ester.toml"
    file.write_text(
        'name = "ester"\n[[reaction]]\nreactants = { acetic_acid = 1, methanol = 1 }\nsource = "a guess"\n'
        "products = { methyl_acetate = 1, water = 1 }\npre_exponential = 1e7\nactivation_energy_j_mol = 60000.0\n"
    )
    flask = Flask({"MeOH": 5.0, "AcOH": 5.0}, reactions=file)
    flask.react(3600.0, 330.0)
    assert flask.amounts["methyl_acetate"] > 1.0
    assert flask.amounts["methyl_acetate"] == pytest.approx(flask.amounts["water"])


@pytest.mark.parametrize(
    "contents",
    [{"toluene": 5.0, "water": 5.0, "benzoic_acid": 1.5}, {"diethyl_ether": 3.0, "water": 10.0, "salicylic_acid": 1.5}],
)
def test_an_acid_dissolves_in_oil_and_water_alike_in_one_call_and_in_many(contents: dict[str, float]) -> None:
    left = []
    for calls in (1, 100):
        flask = Flask(contents, capacity_l=4.0)
        for _ in range(calls):
            flask.react(3600.0 / calls, temperature_k=298.15)
        flask.settle()
        left.append(flask.layers[0].contents[list(contents)[-1]])
    assert left[0] == pytest.approx(left[1], rel=0.02)
    assert 0.3 < left[1] < 1.3


CLOSED = Surroundings(300.0, 0.0, -1.0, 1e-3, 1e-9)
"""An insulated and sealed vessel."""


@pytest.mark.parametrize(
    ("contents", "hot", "kelvin"),
    [
        ({"salicylic_acid": 1.71, "water": 1.42}, 440.0, 290.0),
        ({"benzoic_acid": 1.2, "water": 1.0, "NaOH": 0.8, "NaCl": 0.4, "naphthalene": 0.7}, 440.0, 330.0),
    ],
)
def test_crystals_in_a_closed_vessel_keep_its_energy(contents: dict[str, float], hot: float, kelvin: float) -> None:
    flask = Flask(contents, capacity_l=5.0)
    row, arguments = flask._row, (flask._chem, flask._shelf.waste[0], flask._events, flask._work)
    row[AIR] = 0.01
    for at in (hot, kelvin):
        row[TEMPERATURE] = at
        laws.settle_phases(row, *arguments)
        if at == hot:
            laws.react(row, 1000.0, CLOSED._replace(jacket=hot, transfer=-1.0), *arguments)
    before = enthalpy(row, flask._chem)
    laws.react(row, 1000.0, CLOSED, *arguments)
    assert enthalpy(row, flask._chem) == pytest.approx(before, abs=1e-3)
    assert kelvin < row[TEMPERATURE] < 400.0


def test_salts_that_do_not_converge_keep_the_energy() -> None:
    """Strongly exothermic salts with common ions: the solution for all of them and the temperature is hard to find."""
    rng = np.random.default_rng(1)
    salts = ["NaCl", "NaOH", "KNO3", "KCl", "NaNO3", "KBr", "NaI", "KOH", "sodium_acetate", "NaBr", "KI"]
    for _ in range(80):
        contents = {"water": 10 ** rng.uniform(-1.0, 1.0)}
        contents |= {str(salt): 10 ** rng.uniform(-1.0, 0.6) for salt in rng.choice(salts, 3, replace=False)}
        flask = Flask(contents, capacity_l=5.0)
        row, row[TEMPERATURE] = flask._row, rng.uniform(280.0, 350.0)
        row[AIR] = 0.01
        before = enthalpy(row, flask._chem)
        laws.settle_phases(row, flask._chem, flask._shelf.waste[0], flask._events, flask._work)
        assert enthalpy(row, flask._chem) == pytest.approx(before, abs=1e-3), contents


def test_a_sealed_vessel_stays_sealed_after_its_valve_has_opened() -> None:
    flask = Flask({"water": 20.0, "NaCl": 1.0}, capacity_l=1.0)
    row, chem, waste, events, work = flask._row, flask._chem, flask._shelf.waste[0], flask._events, flask._work
    seal_vessel(row, chem)
    row[TEMPERATURE] = 435.0
    laws.vent(row, 500.0, chem, waste, events)
    row[TEMPERATURE], water = 415.0, flask.amounts["water"]
    row[AMOUNTS + flask._shelf.layout.index("NaCl")] += 0.5
    laws.settle_phases(row, chem, waste, events, work)
    assert flask.amounts["water"] == water


def test_the_relief_valve_lets_out_gas_down_to_its_rating() -> None:
    flask = Flask({"water": 10.0}, capacity_l=1.0)
    row, row[AIR], row[TEMPERATURE] = flask._row, 0.2, 380.0
    laws.vent(row, 500.0, flask._chem, flask._shelf.waste[0], flask._events)
    gas = row[AIR] * GAS_CONSTANT * row[TEMPERATURE] / (1.0 - flask.volume_l)
    assert gas + flask.vapor_pressure_kpa == pytest.approx(500.0)
    assert row[AIR] < 0.2


@pytest.mark.parametrize("contents", [{"water": 10, "NaCl": 2}, {"water": 1, "sodium_acetate": 0.5, "benzoic_acid": 1}])
def test_a_closed_flask_loses_nothing_whatever_is_dissolved(contents: dict[str, float]) -> None:
    flask = Flask(contents)
    with pytest.warns(BoilingWarning):
        flask.react(60.0, temperature_k=430.0)
    assert sum(flask.waste.values()) == 0.0


@pytest.mark.parametrize("calls", [1, 10])
@pytest.mark.parametrize(
    ("contents", "kelvin", "name", "lost", "near"),
    [
        ({"acetone": 5.0, "water": 5.0}, 360.0, "water", 1.24, 0.03),
        ({"toluene": 5.0, "water": 1.0}, 370.0, "toluene", 0.8, 0.1),
        ({"acetic_acid": 3.0, "water": 3.0}, 385.0, "acetic_acid", 2.45, 0.001),
    ],
    ids=["one liquid", "two layers", "weak acid"],
)
def test_a_mantle_boils_contents_up_to_its_own_temperature(
    contents: dict[str, float], kelvin: float, name: str, lost: float, near: float, calls: int
) -> None:
    """What is left boils at the mantle's temperature, however long the steps, and is at equilibrium."""
    flask = Flask(contents)
    for _ in range(calls):
        flask.heat(3e5 / calls, hottest_k=kelvin)
    assert flask.vapor_pressure_kpa == pytest.approx(101.3, abs=1.0)
    assert flask.waste[name] == pytest.approx(lost, rel=near)


@pytest.mark.parametrize(
    ("contents", "closed_k", "jacket_k", "watts", "transfer", "near"),
    [
        ({"hexane": 1.0, "benzoic_acid": 0.2}, 298.15, 440.0, 1e9, 0.2, 0.0),
        ({"1-butanol": 5.0}, 330.0, 330.0, 0.0, 50.0, 0.06),
        ({"water": 10.0}, 390.0, 350.0, 20.0, 50.0, 0.005),
    ],
    ids=["crystals", "volatile product", "opened"],
)
def test_an_open_flask_boils_in_one_call_as_in_many(
    contents: dict[str, float],
    closed_k: float,
    jacket_k: float,
    watts: float,
    transfer: float,
    near: float,
    tmp_path: Path,
) -> None:
    (file := tmp_path / "ether.toml").write_text(
        'name = "ether"\n[[reaction]]\nreactants = { 1-butanol = 1 }\nproducts = { diethyl_ether = 1 }\n'
        'pre_exponential = 0.001\nactivation_energy_j_mol = 0.0\nsource = "made up for a test"\n'
    )
    lost = []
    for calls in (1, 50):
        flask = Flask(contents, capacity_l=2.0, temperature_k=closed_k, reactions=file)
        for _ in range(calls):
            flask.react(1000.0 / calls, jacket_k, jacket_w_k=transfer, condenser_w=watts)
        assert flask.vapor_pressure_kpa < 103.0
        lost.append(sum(flask.waste.values()))
    assert lost[0] == pytest.approx(lost[1], rel=near)


def test_ions_that_boil_dry_form_acids_that_boil() -> None:
    flask = Flask({"acetic_acid": 0.28, "water": 2.7, "ethanol": 0.88}, capacity_l=2.0)
    flask.heat(3e5)
    assert flask.vapor_pressure_kpa < 103.0
    assert flask.amounts["acetic_acid"] < 1e-4


def test_drying_does_not_depend_on_its_division() -> None:
    """A trace of ethanol leaves first, and long before the molten naphthalene."""
    lost = []
    for calls in (1, 60):
        flask = Flask({"ethanol": 0.047, "naphthalene": 2.18}, temperature_k=357.0)
        for _ in range(calls):
            flask.dry(1000.0 / calls)
        lost.append(flask.waste["naphthalene"])
    assert lost[0] == pytest.approx(lost[1], rel=0.01)


@pytest.mark.parametrize("calls", [1, 10])
def test_layers_that_stand_do_not_exchange_what_they_dissolve(calls: int) -> None:
    flask = Flask({"acetanilide": 0.3, "water": 28.0, "toluene": 1.0})
    flask.react(3600.0, temperature_k=350.0)
    water = flask.layers[1].contents["toluene"]
    for _ in range(calls):
        flask.wait(3600.0 / calls)
    assert flask.temperature_k < 335.0
    assert flask.layers[1].contents["toluene"] == pytest.approx(water)


def test_boiling_and_melting_alone_are_changes() -> None:
    for contents, kelvin in (({"diethyl_ether": 1.0, "dodecane": 3.0}, 400.0), ({"naphthalene": 1.0}, 353.5)):
        flask = Flask(contents, capacity_l=2.0)
        flask._row[TEMPERATURE] = kelvin
        before = flask._row.copy()
        assert laws.elapse(flask._row, 1.0, flask._chem, flask._shelf.waste[0], flask._events, flask._work)
        assert (flask._row[AMOUNTS:] != before[AMOUNTS:]).any()
