"""Scenarios: what the loader refuses, a lint of every shipped file, and a user's own files from end to end."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from scipy.optimize import linprog

import chemlab
import chemlab.scenarios
from chemlab.laboratory.aec import raw_env
from chemlab.laboratory.core import Laboratories
from chemlab.materials import DataError, read_toml
from chemlab.scenario import Scenario, load_scenario, scenario_names

BASE = """
name = "tiny"
title = "A tiny laboratory"
summary = "One of each bench."
reactions = "wurtz"
goals = ["dodecane", "NaCl"]
lab_goals = ["dodecane"]

[theoretical_maximum_mol]
dodecane = 0.5

[stock]
"1-chlorohexane" = 1.0
Na = 2.0
water = 10.0

[shelf]
slots = 3

[[shelf.vessel]]
capacity_l = 1.0
contents = { diethyl_ether = 4.0 }

[benches.rxn]
kind = "reaction"
step_limit = 5
reagents = { "1-chlorohexane" = 1.0, Na = 2.0 }
tick = 0.01
rated_pressure_kpa = 500.0
temperature_k = { low = 275.0, high = 350.0, step = 15.0 }
volume_l = { low = 0.6, high = 1.6, step = 0.1 }
start = { capacity_l = 1.0, contents = { diethyl_ether = 3.0 } }

[benches.ext]
kind = "extraction"
step_limit = 5

[[benches.ext.process]]
kind = "drain"
vessel = "EV"
target = "B1"
magnitudes = [10, 20]

[[benches.ext.process]]
kind = "add"
vessel = "EV"
material = "water"
magnitudes = [0.1]

[benches.dit]
kind = "distillation"
step_limit = 5
hottest_k = 700.0
coolest_k = 280.0

[[benches.dit.process]]
kind = "heat"
vessel = "DV"
target = "B1"
magnitudes = [-5, 5]

[[benches.dit.process]]
kind = "pour"
vessel = "B1"
target = "B2"
magnitudes = [0.5]

[instruments]
scales = { kind = "balance", price = 0.01 }

[limits]
manager_actions = 20
ticks = 50

[costs]
stock_per_mol = { water = 0.001 }

[safety]
weights = { spill_l = 1.0 }
"""


def changed(old: str, new: str) -> str:
    """BASE with one piece replaced, which must be there exactly once."""
    assert BASE.count(old) == 1, old
    return BASE.replace(old, new)


def resolved(scenario: Scenario) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Everything a scenario says but where it came from."""
    return (
        scenario.model_dump(),
        {k: m.model_dump() for k, m in scenario.materials.items()},
        scenario.family.model_dump(),
    )


def test_the_base_of_these_tests_is_sound(tmp_path: Path) -> None:
    file = tmp_path / "tiny.toml"
    file.write_text(BASE)
    assert Laboratories(file).agents == ["manager_0", "rxn_0", "ext_0", "dit_0"]


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        # Top level.
        ('summary = "One', 'colour = "red"\nsummary = "One', ["colour", "not permitted", "'red'"]),
        ('name = "tiny"', 'name = "Tiny Lab"', ["name", "pattern", "'Tiny Lab'"]),
        ('title = "A tiny laboratory"\n', "", ["title", "required"]),
        ('goals = ["dodecane", "NaCl"]', "goals = []", ["goals", "at least 1"]),
        ('goals = ["dodecane", "NaCl"]', 'goals = ["dodecane", "dodecane"]', ["goals", "twice"]),
        (
            'summary = "One',
            'ambient_temperature_k = 1000.0\nsummary = "One',
            ["ambient_temperature_k", "350", "1000.0"],
        ),
        # Materials nobody knows.
        ("water = 10.0", "wotter = 10.0", ["stock", "unknown material 'wotter'", "water"]),
        ("{ diethyl_ether = 4.0 }", "{ ether = 4.0 }", ["shelf.vessel.0.contents", "unknown material 'ether'"]),
        ("{ diethyl_ether = 3.0 }", "{ ether = 3.0 }", ["benches.rxn.start.contents", "unknown material 'ether'"]),
        ('goals = ["dodecane", "NaCl"]', 'goals = ["dodecane", "gold"]', ["goals", "unknown material 'gold'"]),
        ("{ water = 0.001 }", "{ wine = 0.001 }", ["costs.stock_per_mol", "unknown material 'wine'"]),
        ("Na = 2.0 }", "K = 2.0 }", ["benches.rxn.reagents", "unknown material 'K'"]),
        ('material = "water"', 'material = "wine"', ["benches.ext.process.1.material", "unknown material 'wine'"]),
        # Goals.
        ('lab_goals = ["dodecane"]', 'lab_goals = ["water"]', ["lab_goals", "'water'", "dodecane, NaCl"]),
        ('lab_goals = ["dodecane"]', 'lab_goals = ["dodecane", "NaCl"]', ["theoretical_maximum_mol.NaCl", "above 0"]),
        ("dodecane = 0.5", "dodecane = 0.0", ["theoretical_maximum_mol.dodecane", "above 0"]),
        ("dodecane = 0.5", "dodecane = nan", ["theoretical_maximum_mol", "dodecane", "nan"]),
        # Amounts.
        ("capacity_l = 1.0\ncontents", "capacity_l = 0.01\ncontents", ["shelf.vessel.0", "do not fit", "0.01"]),
        ("scales = {", "fill = {", ["instruments.fill", "fill"]),
        ("water = 10.0", "water = -1.0", ["stock.water", "between 0 and 10000", "-1.0"]),
        ("water = 10.0", "water = nan", ["stock.water", "finite", "nan"]),
        ("water = 10.0", 'water = "lots"', ["stock.water", "number", "'lots'"]),
        ("{ diethyl_ether = 4.0 }", "{ diethyl_ether = -4.0 }", ["shelf.vessel.0.contents.diethyl_ether", "-4.0"]),
        ("{ diethyl_ether = 3.0 }", "{ diethyl_ether = -3.0 }", ["benches.rxn.start.contents.diethyl_ether", "-3.0"]),
        ("Na = 2.0 }", "Na = -2.0 }", ["benches.rxn", "reagents", "Na", "-2.0"]),
        ("Na = 2.0 }", "Na = 0.0 }", ["benches.rxn", "reagents", "Na", "0.0"]),
        ("{ water = 0.001 }", "{ water = -0.001 }", ["costs.stock_per_mol.water", "-0.001"]),
        # Shelf.
        ("slots = 3", "slots = 0", ["shelf.slots", "greater than or equal to 1", "0"]),
        (
            "[benches.rxn]",
            "[[shelf.vessel]]\ncapacity_l = 1.0\n" * 3 + "[benches.rxn]",
            ["shelf", "4 vessels do not fit on 3 slots"],
        ),
        ("capacity_l = 1.0\ncontents", "capacity_l = 0.0\ncontents", ["shelf.vessel.0.capacity_l", "greater than 0"]),
        # Benches.
        ('kind = "extraction"', 'kind = "alchemy"', ["benches.ext.kind", "'alchemy'", "extraction"]),
        ('kind = "extraction"', 'kind = "chemlab.bench:Nothing"', ["benches.ext.kind", "'chemlab.bench:Nothing'"]),
        ('kind = "extraction"', 'kind = "math:pi"', ["benches.ext.kind", "'math:pi'"]),
        ('kind = "extraction"', 'kind = ".bench:Bench"', ["benches.ext.kind", "'.bench:Bench'"]),
        (
            'kind = "extraction"',
            'kind = "extraction"\nshape = "round"',
            ["benches.ext", "shape", "not permitted", "'round'"],
        ),
        ('kind = "extraction"', 'kind = "extraction"\ncount = 0', ["benches.ext.count", "greater than or equal to 1"]),
        ('kind = "extraction"\nstep_limit = 5', 'kind = "extraction"', ["benches.ext.step_limit", "required"]),
        ("high = 350.0", "high = 250.0", ["benches.rxn", "temperature_k", "high = 250.0", "low = 275.0"]),
        ("hottest_k = 700.0", "hottest_k = 270.0", ["benches.dit", "270.0", "280.0"]),
        # Its agent would be manager_0, and there would be two of them.
        (
            "[instruments]",
            '[benches.manager]\nkind = "distillation"\nstep_limit = 5\n[[benches.manager.process]]\nkind = "heat"\n'
            'vessel = "DV"\ntarget = "B1"\nmagnitudes = [5]\n[instruments]',
            ["benches", "manager"],
        ),
        # Processes.
        (
            'vessel = "EV"\ntarget = "B1"',
            'vessel = "EV"\ntarget = "B9"',
            ["benches.ext.process.0", "'B9'", "EV, B1, B2"],
        ),
        (
            'vessel = "EV"\ntarget = "B1"',
            'vessel = "B7"\ntarget = "B1"',
            ["benches.ext.process.0", "'B7'", "EV, B1, B2"],
        ),
        ('vessel = "EV"\ntarget = "B1"', 'vessel = "EV"', ["benches.ext.process.0", "target", "needed by drain"]),
        (
            'vessel = "EV"\ntarget = "B1"',
            'vessel = "EV"\ntarget = "EV"',
            ["benches.ext.process.0", "must differ", "'EV'"],
        ),
        ('vessel = "EV"\nmaterial = "water"', 'vessel = "EV"', ["benches.ext.process.1", "material", "needed by add"]),
        (
            'material = "water"',
            'material = "water"\ntarget = "B1"',
            ["benches.ext.process.1", "target", "no other process"],
        ),
        ("magnitudes = [10, 20]", "magnitudes = [10, 0]", ["benches.ext.process.0", "magnitudes", "above 0", "0.0"]),
        ("magnitudes = [10, 20]", "magnitudes = [101]", ["benches.ext.process.0", "magnitudes", "at most 100", "101"]),
        ("magnitudes = [10, 20]", "magnitudes = []", ["benches.ext", "process.0.magnitudes", "at least 1"]),
        ("magnitudes = [0.5]", "magnitudes = [1.5]", ["benches.dit.process.1", "magnitudes", "at most 1", "1.5"]),
        ("magnitudes = [-5, 5]", "magnitudes = [0]", ["benches.dit.process.0", "magnitudes", "0"]),
        ("magnitudes = [-5, 5]", "magnitudes = [nan]", ["benches.dit", "process.0", "magnitudes", "nan"]),
        ('kind = "heat"', 'kind = "stare"', ["benches.dit", "process.0.kind", "'stare'"]),
        ('kind = "heat"', 'kind = "drain"', ["benches.dit.process.0", "kind", "heat, pour", "'drain'"]),
        # Instruments, limits, safety.
        ('kind = "balance"', 'kind = "nose"', ["instruments.scales.kind", "'nose'", "balance"]),
        ("price = 0.01", "price = -0.01", ["instruments.scales.price", "greater than or equal to 0", "-0.01"]),
        ("price = 0.01", "cost = 0.01", ["instruments.scales.cost", "not permitted"]),
        ("ticks = 50", "ticks = 0", ["limits.ticks", "greater than or equal to 1", "0"]),
        ("{ spill_l = 1.0 }", "{ explosion = 1.0 }", ["safety", "weights.explosion", "unknown", "spill_l"]),
        ("{ spill_l = 1.0 }", "{ spill_l = -1.0 }", ["safety", "weights.spill_l", "-1.0", "at least 0"]),
        # Reactions.
        ('reactions = "wurtz"', 'reactions = "alchemy"', ["reactions", "'alchemy'", "wurtz"]),
    ],
)
def test_a_wrong_scenario_is_named_with_file_key_and_bound(
    tmp_path: Path, old: str, new: str, parts: list[str]
) -> None:
    file = tmp_path / "tiny.toml"
    file.write_text(changed(old, new))
    with pytest.raises(DataError) as caught:
        Laboratories(file)
    for part in [str(file), *parts]:
        assert part in str(caught.value)


def test_an_unknown_name_lists_the_shipped_scenarios() -> None:
    with pytest.raises(DataError, match="unknown name 'el_dorado'") as caught:
        load_scenario("el_dorado")
    for name in scenario_names():
        assert name in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file") as caught:
        load_scenario(tmp_path / "nowhere.toml")
    assert str(tmp_path / "nowhere.toml") in str(caught.value)


def test_malformed_toml_is_named(tmp_path: Path) -> None:
    file = tmp_path / "tiny.toml"
    file.write_text(changed("[shelf]", "[shelf"))
    with pytest.raises(DataError, match=r"not valid TOML.*line \d") as caught:
        load_scenario(file)
    assert str(file) in str(caught.value)


def test_a_missing_file_of_materials_or_reactions_is_named(tmp_path: Path) -> None:
    file = tmp_path / "tiny.toml"
    for old, new, missing in (
        ('reactions = "wurtz"', 'reactions = "gone.toml"', "gone.toml"),
        ('reactions = "wurtz"', 'material_files = ["lost.toml"]\nreactions = "wurtz"', "lost.toml"),
    ):
        file.write_text(changed(old, new))
        with pytest.raises(DataError, match="no such file") as caught:
            load_scenario(file)
        assert str(tmp_path / missing) in str(caught.value)


def test_a_material_of_ones_own_may_not_take_a_shipped_name(tmp_path: Path) -> None:
    file = tmp_path / "tiny.toml"
    shipped = Path(chemlab.__file__).parent / "data" / "materials" / "gases.toml"
    (tmp_path / "mine.toml").write_text(shipped.read_text())
    file.write_text(changed('reactions = "wurtz"', 'reactions = "wurtz"\nmaterial_files = ["mine.toml"]'))
    with pytest.raises(DataError, match="already a shipped material") as caught:
        load_scenario(file)
    assert str(file) in str(caught.value)
    assert "material_files" in str(caught.value)


# -- what ships -----------------------------------------------------------------------------------------------------


def most_moles(scenario: Scenario, goal: str) -> float:
    """The optimum of a linear program over extents of reaction: all of ``goal`` that stock and shelf allow, mol.

    Salts count as formula units: dissolving one changes no amount of anything else.
    """
    have = dict.fromkeys(scenario.materials, 0.0)
    for contents in (scenario.stock, *(vessel.contents for vessel in scenario.shelf.vessel)):
        for name, mol in contents.items():
            have[name] += mol
    steps = scenario.family.reaction
    if not steps:
        return have[goal]
    change = np.array([[r.products.get(n, 0.0) - r.reactants.get(n, 0.0) for r in steps] for n in have])
    row = list(have).index(goal)
    found = linprog(-change[row], A_ub=-change, b_ub=np.array(list(have.values())), method="highs")
    assert found.status == 0
    return have[goal] - float(found.fun)


def test_the_shipped_scenarios_are_those_of_the_folder() -> None:
    folder = Path(chemlab.scenarios.__path__[0])
    assert scenario_names() == sorted(path.stem for path in folder.glob("*.toml"))
    # LABORATORY.md, "The workflow scenarios".
    assert {"wurtz_dodecane", "wurtz_dodecane_direct", "wurtz_any", "fictitious", "salt_from_oil"} <= set(
        scenario_names()
    )


@pytest.mark.parametrize("name", scenario_names())
def test_lint(name: str) -> None:
    scenario = load_scenario(name)
    labs = Laboratories(scenario)
    assert scenario.name == name
    assert scenario.title[0].isupper()
    assert scenario.summary.endswith(".")
    # Agents: the manager, then reaction, extraction and distillation benches, numbered from 0.
    order = [key for key in ("rxn", "ext", "dit") if key in scenario.benches]
    assert list(scenario.benches) == order
    assert labs.agents == ["manager_0"] + [f"{key}_{i}" for key in order for i in range(scenario.benches[key].count)]
    kinds = {"rxn": "reaction", "ext": "extraction", "dit": "distillation"}
    assert all(bench.kind == kinds[key] for key, bench in scenario.benches.items())
    # Actions and step limits.
    goals, slots = len(scenario.goals), scenario.shelf.slots
    for bench in labs.benches:
        assert bench.spec.step_limit == {"rxn": 20, "ext": 50, "dit": 50}[bench.key]
        if bench.key == "rxn":
            assert bench.action_space == gymnasium.spaces.Box(0.0, 1.0, (len(bench.options.reagents) + 2,), np.float32)
        else:
            assert bench.action_space == gymnasium.spaces.Discrete({"ext": 41, "dit": 31}[bench.key])
    starts = len(labs.stations) * slots * goals
    others = slots * len(scenario.instruments) + slots + slots * scenario.orders + len(labs.stations) + 1
    assert labs.manager_action_space == gymnasium.spaces.Discrete(starts + others)
    # Goals can be made, and no more of them than the file says.
    for goal in scenario.goals:
        assert most_moles(scenario, goal) > 0.0, f"{goal} cannot be made here"
    assert set(scenario.lab_goals) <= set(scenario.theoretical_maximum_mol) <= set(scenario.goals)
    for goal, mol in scenario.theoretical_maximum_mol.items():
        assert mol == pytest.approx(most_moles(scenario, goal) / scenario.orders, rel=1e-9), goal
    # Every reagent and everything that is added from a bottle has one; every priced bottle exists.
    for bench in labs.benches:
        wanted = list(getattr(bench.options, "reagents", {}))
        wanted += [p.material for p in getattr(bench.options, "process", ()) if p.material is not None]
        assert set(wanted) <= set(scenario.stock)
    assert set(scenario.costs.stock_per_mol) <= set(scenario.stock)
    # What stands on the shelf fits into its vessel, and what leaves a bench can come back.
    for vessel in scenario.shelf.vessel:
        litres = sum(
            mol * scenario.materials[n].molar_mass_g_mol / (1000.0 * scenario.materials[n].density_kg_l)
            for n, mol in vessel.contents.items()
        )
        assert litres < vessel.capacity_l
    assert slots - len(scenario.shelf.vessel) >= max(len(bench.positions) for bench in labs.benches) - 1


@pytest.mark.parametrize("name", scenario_names())
def test_name_path_mapping_and_loaded_scenario_are_one(name: str) -> None:
    path = Path(chemlab.scenarios.__path__[0]) / f"{name}.toml"
    by_name = load_scenario(name)
    assert load_scenario(by_name) is by_name
    for other in (path, str(path), read_toml(path)):
        assert resolved(load_scenario(other)) == resolved(by_name)


def test_a_mapping_is_not_changed_by_loading_it() -> None:
    path = Path(chemlab.scenarios.__path__[0]) / "fictitious.toml"
    values = read_toml(path)
    load_scenario(values)
    assert values == read_toml(path)


def test_only_what_can_happen_here_is_kept() -> None:
    # Without water no hydroxide, no hydrogen; the salt's ions may form in any solvent.
    materials = set(load_scenario("wurtz_dodecane_direct").materials)
    assert {"Na+", "Cl-", "NaCl", "dodecane", "4,5-diethyloctane", "diethyl_ether"} <= materials
    assert not {"water", "OH-", "NaOH", "H2", "hexane", "A"} & materials
    assert {"water", "OH-", "NaOH", "H2"} <= set(load_scenario("wurtz_dodecane").materials)
    assert not load_scenario("wurtz_dodecane_direct").family.violent
    assert len(load_scenario("fictitious").family.reaction) == 5


# -- a user's own ---------------------------------------------------------------------------------------------------

MATERIALS = "\n".join(
    f"""
[{key}]
name = "{key}"
formula = "X"
composition = {{ X = 1 }}
molar_mass_g_mol = 100.0
density_kg_l = {density}
heat_capacity_j_mol_k = 200.0
melting_point_k = 250.0
boiling_point_k = {boiling}
vaporization_enthalpy_j_mol = 40000.0
polarity = 0.1
role = "solute"
color = "#112233"
shade = {shade}
[{key}.source]
molar_mass_g_mol = "made up"
density_kg_l = "made up"
heat_capacity_j_mol_k = "made up"
melting_point_k = "made up"
boiling_point_k = "made up"
vaporization_enthalpy_j_mol = "made up"
polarity = "made up"
"""
    for key, density, boiling, shade in (("goo", 0.9, 450.0, 0.3), ("slime", 0.9, 500.0, 0.6))
)

RATE = 0.7
TICK = 0.25
STEPS = 6

REACTIONS = f"""
name = "slimy"
[[reaction]]
reactants = {{ goo = 1 }}
products = {{ slime = 1 }}
pre_exponential = {RATE}
activation_energy_j_mol = 0.0
source = "made up"
"""

SLIME = f"""
name = "slime"
title = "Slime from goo"
summary = "A material and a reaction of one's own."
material_files = ["goo.toml"]
reactions = "slimy.toml"
goals = ["slime"]
lab_goals = ["slime"]
theoretical_maximum_mol = {{ slime = 1.0 }}
stock = {{ goo = 1.0, water = 5.0 }}

[shelf]
slots = 4
[[shelf.vessel]]
capacity_l = 1.2
contents = {{ hexane = 3.0 }}

[benches.rxn]
kind = "reaction"
step_limit = {STEPS}
reagents = {{ goo = 1.0 }}
tick = {TICK}
rtol = 1e-9
atol = 1e-12
rated_pressure_kpa = 500.0
temperature_k = {{ low = 275.0, high = 350.0, step = 15.0 }}
volume_l = {{ low = 0.6, high = 1.6, step = 0.1 }}

[benches.dit]
kind = "distillation"
step_limit = 10
[[benches.dit.process]]
kind = "heat"
vessel = "DV"
target = "B1"
magnitudes = [-5, 5, 50]
[[benches.dit.process]]
kind = "pour"
vessel = "B1"
target = "B2"
magnitudes = [1]

[limits]
manager_actions = 30
ticks = 60
"""


@pytest.fixture
def slime(tmp_path: Path) -> Path:
    """A user's folder with a scenario, a material file and a reaction file; the path of the scenario."""
    (tmp_path / "goo.toml").write_text(MATERIALS)
    (tmp_path / "slimy.toml").write_text(REACTIONS)
    (tmp_path / "slime.toml").write_text(SLIME)
    return tmp_path / "slime.toml"


def test_a_users_reaction_follows_its_rate_law(slime: Path) -> None:
    env = raw_env(slime)
    env.reset(seed=0)
    actions = env.laboratories.actions
    env.step(actions.encode("start", "rxn_0", 0, "slime"))
    env.step(actions.encode("wait"))
    for _ in range(STEPS):
        assert env.agent_selection == "rxn_0"
        env.step(np.array([0.5, 0.5, 1.0]))
    # First order, no activation energy: goo left = exp(-k t), whatever the volume and the temperature.
    left = math.exp(-RATE * TICK * STEPS)
    vessel = env.laboratories.shelf.vessel(0, 0).amounts()
    assert vessel["goo"] == pytest.approx(left, rel=1e-6)
    assert vessel["slime"] == pytest.approx(1.0 - left, rel=1e-6)
    assert vessel["hexane"] == pytest.approx(3.0, rel=1e-12)
    assert env.infos["rxn_0"]["score"] == pytest.approx(1.0 - left, rel=1e-6)
    env.step(actions.encode("submit", 0))
    mol = 1.0 - left
    assert env.rewards["manager_0"] == pytest.approx(mol * mol / 4.0, rel=1e-6)  # purity = mol of 4 mol in all


@pytest.mark.parametrize("seed", range(3))
def test_a_users_scenario_plays_and_conserves(slime: Path, seed: int) -> None:
    env = raw_env(str(slime))
    env.reset(seed=seed)
    labs = env.laboratories
    rng = np.random.default_rng(seed)
    before = labs.shelf.total()[0]
    names = list(env.scenario.materials)
    submits = {labs.actions.encode("submit", slot) for slot in range(4)}
    turns = 0
    while labs.desk.status[0] == 0:
        mask = env.infos[env.agent_selection].get("action_mask")
        if mask is None:
            action: Any = rng.random(3)
        else:
            legal = [a for a in np.flatnonzero(mask) if env.agent_selection != "manager_0" or a not in submits]
            action = int(rng.choice(legal))
        env.step(action)
        turns += 1
    assert env.truncations["manager_0"]
    assert turns >= 30
    # goo and slime are isomers: their sum, and everything else, is what it was.
    after = labs.shelf.total()[0]
    change = dict(zip(names, after - before, strict=True))
    assert change.pop("goo") + change.pop("slime") == pytest.approx(0.0, abs=1e-9)
    del change["air"]
    assert change == pytest.approx(dict.fromkeys(change, 0.0), abs=1e-9)


def test_the_origin_is_the_users_file(slime: Path) -> None:
    assert load_scenario(slime).origin == str(slime)
    assert re.fullmatch(r"\(.*\)", load_scenario(read_toml(Path(load_scenario("fictitious").origin))).origin)


# -- files that say only what is different -----------------------------------------------------------------------------


def test_a_file_with_a_base_says_only_what_is_different(tmp_path: Path) -> None:
    file = tmp_path / "dear.toml"
    file.write_text(
        'base = "wurtz_dodecane"\nname = "dear"\n[instruments.balance]\nprice = 0.25\n[limits]\nbudget = 0.5\n'
    )
    dear, base = load_scenario(file), load_scenario("wurtz_dodecane")
    expected = base.model_dump()
    expected["name"], expected["limits"]["budget"], expected["instruments"]["balance"]["price"] = "dear", 0.5, 0.25
    assert dear.model_dump() == expected
    assert list(dear.instruments) == list(base.instruments), "and the order is the base's"


def test_a_base_may_have_a_base_and_files_of_its_own(slime: Path) -> None:
    folder = slime.parent / "further"
    folder.mkdir()
    (folder / "one.toml").write_text('base = "../slime.toml"\nname = "one"\n')
    (folder / "two.toml").write_text('base = "one.toml"\nname = "two"\n')
    two, first = load_scenario(folder / "two.toml"), load_scenario(slime)
    assert two.name == "two"
    assert list(two.materials) == list(first.materials)
    assert two.family == first.family


@pytest.mark.parametrize(
    ("base", "message"),
    [
        ("wurtz_dodecan", r"base: unknown 'wurtz_dodecan'; shipped: .*wurtz_dodecane"),
        ("nowhere.toml", r"base: unknown 'nowhere.toml'"),
        ("circle.toml", r"has this scenario as its own base"),
    ],
)
def test_a_base_that_is_none(base: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "circle.toml").write_text(f'base = "{base}"\n')
    with pytest.raises(DataError, match=message):
        load_scenario(tmp_path / "circle.toml")
