"""Scenarios: what the loader refuses, a lint of every shipped file, and a user's own files from end to end."""

import itertools
import json
import math
import re
import shlex
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from helpers import FEATURED, litres, said
from refusals import changed, refused, written
from scipy.optimize import linprog

import chemlab
import chemlab.scenarios
from chemlab.config.datafile import DataError, read_toml
from chemlab.config.inherit import scenario_names, synthesis_names
from chemlab.config.loading import dump_scenario, load_scenario, restore_scenario
from chemlab.config.scenario import Scenario
from chemlab.envs.role_env import RoleEnv
from chemlab.lab.engine import Laboratories
from chemlab.lab.starts import lab_starts

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


def resolved(scenario: Scenario) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Everything a scenario says but where it came from."""
    materials = {key: material.model_dump() for key, material in scenario.materials.items()}
    return scenario.model_dump(), materials, scenario.family.model_dump()


def top(line: str) -> tuple[str, str]:
    """A line more at the top of the file, as a replacement."""
    return 'summary = "One', f'{line}\nsummary = "One'


def ext(kind: str, line: str = "") -> tuple[str, str]:
    """Another kind of extraction bench, or a line more of it, as a replacement."""
    return 'kind = "extraction"', f'kind = "{kind}"\n{line}'


def drain(vessels: str) -> tuple[str, str]:
    """Other vessels to drain, as a replacement."""
    return 'vessel = "EV"\ntarget = "B1"', vessels


MANY_BENCHES = "\n".join(f"[benches.{c}]\nkind = 'distillation'\ncount = 16" for c in "abcdefghijklm")
COMPANION = 'companion = { material = "Na+", mol = 0.1, if_goal = "NaCl" }'
SALT_DRAW = """[world.draws.salt]
what = "amount"
of = ["slot_0"]
material = "Na+"
distribution = { kind = "uniform", low = 0.5, high = 1.0 }"""


def test_the_base_of_these_tests_is_sound(tmp_path: Path) -> None:
    assert Laboratories(written(tmp_path, BASE)).agents == ["manager_0", "rxn_0", "ext_0", "dit_0"]


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        # Top level.
        (*top('colour = "red"'), ["colour", "unknown key", "'red'"]),
        ('title = "A tiny', 'titel = "A tiny', ["titel: unknown key, given 'A tiny laboratory'; did you mean title?"]),
        ('goals = ["dodecane", "NaCl"]', 'goals = "dodecane"', ["goals: must be a list, as in ['dodecane']"]),
        ('name = "tiny"', 'name = "Tiny Lab"', ["name: must be lower-case letters", "'Tiny Lab'"]),
        ('title = "A tiny laboratory"\n', "", ["title", "required"]),
        ('goals = ["dodecane", "NaCl"]', "goals = []", ["goals: must have at least 1 item, given 0"]),
        ('goals = ["dodecane", "NaCl"]', 'goals = ["dodecane", "dodecane"]', ["goals", "twice"]),
        (*top("ambient_temperature_k = 1000.0"), ["ambient_temperature_k", "350", "1000.0"]),
        (*top("orders = 0"), ["orders", "greater than or equal to 1", "0"]),
        (*top("orders = 17"), ["orders", "less than or equal to 16"]),
        (*top("orders = 1.5"), ["orders", "1.5"]),
        (*top("orders = '2'"), ["orders: must be a number, not a text, given '2'"]),
        ("water = 10.0", "water = true", ["stock.water: must be a number, not true or false, given True"]),
        ("magnitudes = [10, 20]", "magnitudes = [true]", ["process.0.magnitudes.0: must be a number"]),
        ("water = 10.0", "water = 10.0\nwater = 1.0", ["line", "a key is given twice: remove one"]),
        ("water = 10.0", "water = 10.0\nNa+ = 1.0", ["line", 'as in "Na+" = 1.0']),
        ("water = 10.0", "water = 10,0", ["line", "a point in decimal numbers"]),
        ("hottest_k = 700.0", "heater = 700.0", ["benches.dit: heater: unknown key, given 700.0; known: process"]),
        (*top('rewards = "selfish"'), ["rewards", "'selfish'", "individual, cooperative, mixed"]),
        (*top("rewards = { bench = 1.0 }"), ["rewards", "bench"]),
        (*top("rewards = { bench_team = nan }"), ["rewards", "bench_team"]),
        # Materials nobody knows.
        ("water = 10.0", "wotter = 10.0", ["stock", "unknown material 'wotter'", "water"]),
        ("{ diethyl_ether = 4.0 }", "{ ether = 4.0 }", ["shelf.vessel.0.contents", "did you mean 'diethyl_ether'"]),
        ("{ diethyl_ether = 3.0 }", "{ ether = 3.0 }", ["benches.rxn.start.contents", "unknown material 'ether'"]),
        ('goals = ["dodecane", "NaCl"]', 'goals = ["dodecane", "gold"]', ["goals", "unknown material 'gold'"]),
        ("{ water = 0.001 }", "{ wine = 0.001 }", ["costs.stock_per_mol", "'wine'", "chemlab data material"]),
        ("Na = 2.0 }", "K = 2.0 }", ["benches.rxn.reagents: no material 'K' in", "stock.K = 1.0"]),
        ('material = "water"', 'material = "wine"', ["benches.ext.process.1.material: no material 'wine'"]),
        ('material = "water"', "material = { water = 1 }", ["benches.ext: process.1.material", "valid string"]),
        # Goals.
        ('lab_goals = ["dodecane"]', 'lab_goals = ["water"]', ["lab_goals", "'water'", "dodecane, NaCl"]),
        ('lab_goals = ["dodecane"]', 'lab_goals = ["dodecane", "NaCl"]', ["theoretical_maximum_mol.NaCl", "above 0"]),
        ("dodecane = 0.5", "dodecane = 0.0", ["theoretical_maximum_mol.dodecane", "or equal to 0.000001", "0.0"]),
        ("dodecane = 0.5", "dodecane = nan", ["theoretical_maximum_mol", "dodecane", "nan"]),
        # Amounts.
        ("capacity_l = 1.0\ncontents", "capacity_l = 0.01\ncontents", ["shelf.vessel.0", "do not fit", "0.01"]),
        ("capacity_l = 1.0\ncontents", "capacity_l = 0.0\ncontents", ["vessel.0.capacity_l", "equal to 0.000001"]),
        ("scales = {", "fill = {", ["instruments.fill", "fill"]),
        ("water = 10.0", "water = -1.0", ["stock.water", "greater than or equal to 0", "-1.0"]),
        ("water = 10.0", 'water = "lots"', ["stock.water", "number", "'lots'"]),
        ("{ diethyl_ether = 4.0 }", "{ diethyl_ether = -4.0 }", ["shelf.vessel.0.contents.diethyl_ether", "-4.0"]),
        ("Na = 2.0 }", "Na = 0.0 }", ["benches.rxn", "reagents", "Na", "0.0"]),
        ("{ water = 0.001 }", "{ water = -0.001 }", ["costs.stock_per_mol.water", "-0.001"]),
        # Shelf.
        ("[[shelf.vessel]]", "[shelf.vessel]", ["shelf.vessel: must be a list of tables, each under [[shelf.vessel]]"]),
        ("slots = 3", "slots = 0", ["shelf.slots", "greater than or equal to 1", "0"]),
        ("slots = 3", "slots = 2", ["shelf.slots", "bench 'ext' needs at least 3 slots, given 2"]),
        ("[benches.rxn]", "[[shelf.vessel]]\ncapacity_l = 1.0\n" * 3 + "[benches.rxn]", ["4 vessels", "on 3 slots"]),
        ("[instruments]", "[demand]\nfeedback = 'all'\n[instruments]", ["demand.feedback: Input should be 'none'"]),
        # Benches.
        (*ext("alchemy"), ["benches.ext.kind", "'alchemy'", "extraction"]),
        (*ext("chemlab.roles:Nothing"), ["benches.ext.kind", "'chemlab.roles:Nothing'"]),
        (*ext("extraction", "report = true"), ["benches.ext.report: must be a number, not true or false"]),
        (*ext("math:pi"), ["benches.ext.kind", "'math:pi'"]),
        (*ext(".bench:Bench"), ["benches.ext.kind", "'.bench:Bench'"]),
        (*ext("extraction", "step_limits = 5"), ["benches.ext: step_limits: unknown key", "did you mean step_limit?"]),
        (*ext("extraction", 'shape = "round"'), ["benches.ext", "shape", "unknown key", "'round'"]),
        (*ext("extraction", "count = 0"), ["benches.ext.count", "greater than or equal to 1"]),
        # Of a kind that chemlab has no data on.
        ('kind = "extraction"\nstep_limit = 5', 'kind = "my.own:Bench"', ["benches.ext.step_limit", "required"]),
        ("high = 350.0", "high = 250.0", ["benches.rxn", "temperature_k", "high = 250.0", "low = 275.0"]),
        ("hottest_k = 700.0", "hottest_k = 270.0", ["benches.dit", "270.0", "280.0"]),
        # Its agent would be manager_0, and there would be two of them.
        ("[instruments]", '[benches.manager]\nkind = "extraction"\n[instruments]', ["benches", "manager"]),
        # A bench's own numbers.
        ("tick = 0.01", "tick = 1e7", ["benches.rxn: tick"]),
        ("tick = 0.01", "tick = 0.01\nrtol = 0.0", ["benches.rxn: rtol"]),
        ("tick = 0.01", "tick = 0.01\nrtol = 1.0", ["benches.rxn: rtol"]),
        ("tick = 0.01", "tick = 0.01\natol = 1e-20", ["benches.rxn: atol"]),
        ("tick = 0.01", "tick = 0.01\nvessel_volume_l = 1e3", ["benches.rxn: vessel_volume_l"]),
        ("tick = 0.01", "tick = 0.01\npenalty = { NaCl = 1e9 }", ["benches.rxn: penalty"]),
        ("kpa = 500.0", "kpa = 1e9", ["benches.rxn: rated_pressure_kpa"]),
        ("low = 275.0, high = 350.0", "low = 275.0, high = 1e5", ["benches.rxn: temperature_k"]),
        ("low = 275.0, high = 350.0", "low = 1.0, high = 350.0", ["benches.rxn: temperature_k"]),
        (*ext("extraction", "settle_per_step = 1e3"), ["benches.ext: settle_per_step"]),
        ("[10, 20]", f"{[1.0] * 1001}", ["benches.ext: process"]),
        ("hottest_k = 700.0", "hottest_k = 1e4", ["benches.dit: hottest_k"]),
        ("coolest_k = 280.0", "coolest_k = 1.0", ["benches.dit: coolest_k: ", "or equal to 50, given 1.0"]),
        # Processes.
        (*drain('vessel = "EV"\ntarget = "B9"'), ["benches.ext.process.0", "'B9'", "EV, B1, B2"]),
        (*drain('vessel = "B7"\ntarget = "B1"'), ["benches.ext.process.0", "'B7'", "EV, B1, B2"]),
        (*drain('vessel = "EV"'), ["benches.ext.process.0", "target", "required by drain"]),
        (*drain('vessel = "EV"\ntarget = "EV"'), ["benches.ext.process.0", "must differ", "'EV'"]),
        ('material = "water"\n', "", ["benches.ext.process.1", "material", "required by add"]),
        ('material = "water"', 'material = "water"\ntarget = "B1"', ["process.1", "target", "not allowed for other"]),
        ("magnitudes = [10, 20]", "magnitudes = [10, 0]", ["benches.ext.process.0", "magnitudes", "above 0", "0.0"]),
        ("magnitudes = [10, 20]", "magnitudes = [101]", ["benches.ext.process.0", "magnitudes", "at most 100", "101"]),
        ("magnitudes = [10, 20]", "magnitudes = []", ["benches.ext", "process.0.magnitudes", "at least 1"]),
        ("magnitudes = [0.5]", "magnitudes = [1.5]", ["benches.dit.process.1", "magnitudes", "at most 1", "1.5"]),
        ("magnitudes = [-5, 5]", "magnitudes = [0]", ["benches.dit.process.0", "magnitudes", "0"]),
        ("magnitudes = [-5, 5]", "magnitudes = [nan]", ["benches.dit", "process.0", "magnitudes", "nan"]),
        ('kind = "heat"', 'kind = "stare"', ["benches.dit.process.0", "kind", "heat, pour", "'stare'"]),
        ('kind = "heat"', 'kind = "drain"', ["benches.dit.process.0", "kind", "heat, pour", "'drain'"]),
        # What nothing can be done with, and what would take too much.
        ("[[shelf.vessel]]\ncapacity_l = 1.0\ncontents = { diethyl_ether = 4.0 }\n", "", ["shelf", "at least one"]),
        (*top('physics = "magic"'), ["physics", "unknown backend", "paper", "'magic'"]),
        ('title = "A tiny laboratory"', f'title = "{"x" * 301}"', ["title", "at most 300"]),
        ('title = "A tiny laboratory"', r'title = "A \u001b[2J"', ["title", "without control characters"]),
        ('summary = "One', f'summary = "{"x" * 4001}', ["summary", "4000 characters"]),
        ('name = "tiny"', f'name = "{"x" * 101}"', ["name", "at most 100"]),
        ("dodecane = 0.5", "dodecane = 1e5", ["theoretical_maximum_mol.dodecane", "less than or equal to 10000"]),
        ("price = 0.01", "price = 1e7", ["instruments.scales.price", "less than or equal to 1000000"]),
        ("{ diethyl_ether = 3.0 }", "{ diethyl_ether = 3.0 }, goal_mol = 4.0", ["benches.rxn.start", "do not fit"]),
        ('goals = ["dodecane", "NaCl"]', f"goals = {[f'm{i}' for i in range(65)]}", ["goals", "at most 64 items"]),
        ("slots = 3", f"slots = 64\n{MANY_BENCHES}", ["benches x slots x goals", "at most 20000"]),
        ("water = 10.0", "water = 1" + "0" * 30, ["stock.water", "an integer", "9007199254740992"]),
        ("magnitudes = [10, 20]", "magnitudes = " + "[" * 20 + "]" * 20, ["magnitudes", "more than 12 levels"]),
        ("magnitudes = [10, 20]", "magnitudes = " + "[" * 5000, ["more than 12 levels"]),
        ("water = 10.0", "water" + ".a" * 20 + " = 1", ["dotted key of more than 12 parts"]),
        ("water = 10.0", "water = " + "9" * 5000, ["not valid TOML", "digits"]),
        ("water = 10.0", "water = 1.0 #" + "#" * 1_000_000, ["larger than 1000000 bytes"]),
        # Instruments, limits, safety.
        ('kind = "balance"', 'kind = "nose"', ["instruments.scales.kind", "'nose'", "balance"]),
        ("price = 0.01", "price = -0.01", ["instruments.scales.price", "greater than or equal to 0", "-0.01"]),
        ("price = 0.01", "cost = 0.01", ["instruments.scales.cost", "unknown key"]),
        ("ticks = 50", "ticks = 0", ["limits.ticks", "greater than or equal to 1", "0"]),
        ("{ spill_l = 1.0 }", "{ explosion = 1.0 }", ["safety", "weights.explosion", "unknown", "spill_l"]),
        ("{ spill_l = 1.0 }", "{ spill_l = -1.0 }", ["safety", "weights.spill_l", "-1.0", "or equal to 0"]),
        # Ions without those that balance them.
        ("water = 10.0", 'water = 10.0\n"Na+" = 0.1', ["stock", "'Na+' is an ion", "NaCl"]),
        ("{ diethyl_ether = 4.0 }", '{ water = 4.0, "Na+" = 0.5, "Cl-" = 0.25 }', ["vessel.0", "charge is +0.25 mol"]),
        ("{ diethyl_ether = 3.0 }", '{ water = 4.0, "Cl-" = 0.25 }', ["start.contents", "-0.25 mol", "balance it"]),
        ("Na = 2.0 }", 'Na = 2.0, "Cl-" = 1.0 }', ["benches.rxn.reagents", "'Cl-' is an ion", "NaCl"]),
        ('material = "water"', 'material = "Na+"', ["benches.ext.process.1.material", "'Na+' is an ion"]),
        ("{ diethyl_ether = 3.0 }", f"{{ diethyl_ether = 3.0 }}, {COMPANION}", ["start.companion", "'Na+' is an ion"]),
        ("[instruments]", f"{SALT_DRAW}\n[instruments]", ["world.draws.salt", "'Na+' is an ion"]),
        # Reactions.
        ('reactions = "wurtz"', 'reactions = "alchemy"', ["reactions", "'alchemy'", "wurtz"]),
    ],
)
def test_a_wrong_scenario_is_named_by_file_key_and_bound(tmp_path: Path, old: str, new: str, parts: list[str]) -> None:
    file = written(tmp_path, changed(BASE, old, new))
    refused(lambda: Laboratories(file), file, *parts)


def test_files_that_are_missing_or_of_another_kind_are_named(tmp_path: Path) -> None:
    """And no material of one's own takes a shipped name."""
    file, mine = tmp_path / "a.toml", 'reactions = "wurtz"\nmaterial_files = ["mine.toml"]'
    for new, parts in (
        ('reactions = "gone.toml"', ("no such file", tmp_path / "gone.toml")),
        (mine, ("no such file", tmp_path / "mine.toml")),
        (mine, ("already a bundled material", file, "material_files")),
    ):
        written(tmp_path, changed(BASE, 'reactions = "wurtz"', new))
        refused(lambda: load_scenario(file), *parts)
        if tmp_path / "mine.toml" in parts:
            shutil.copy(Path(chemlab.__file__).parent / "data" / "materials" / "gases.toml", tmp_path / "mine.toml")
    for text, kind in (
        ("[lock]\nx = 'y'\n[tar]\nmolar_mass_g_mol = 9.0", "materials"),
        ("name = 'tar'\n[[reaction]]", "reactions"),
        ("pairs = []", "pairs"),
    ):
        refused(lambda: load_scenario(written(tmp_path, text)), file, f"is a file of {kind}, not a scenario")  # noqa: B023


# -- what ships -----------------------------------------------------------------------------------------------------


def chords(scenario: Scenario) -> list[tuple[int, int, int, float]]:
    """Reactions (i, j, k) whose rates keep r_i^2 = c r_j r_k whatever the concentrations and the temperature, and c.

    By the inequality of Cauchy and Schwarz their extents, integrals of the rates over all vessels and all time, then
    keep x_i^2 <= c x_j x_k, whatever is fed where and when.
    """
    steps = scenario.family.reaction
    found = []
    for i, j, k in itertools.permutations(range(len(steps)), 3):
        names = {*steps[i].orders, *steps[j].orders, *steps[k].orders}
        orders = [[steps[r].orders.get(name, 0.0) for name in names] for r in (i, j, k)]
        energies = [steps[r].activation_energy_j_mol for r in (i, j, k)]
        if (
            j < k
            and 2 * energies[0] == energies[1] + energies[2]
            and np.allclose(2 * np.array(orders[0]), np.add(*orders[1:]))
        ):
            constants = [steps[r].pre_exponential for r in (i, j, k)]
            found.append((i, j, k, constants[0] ** 2 / (constants[1] * constants[2])))
    return found


def most_moles(scenario: Scenario, goal: str) -> float:
    """All of ``goal`` that stock, shelf and kinetics allow, mol: an optimum over extents of reaction.

    A linear program for the stock; where kinetics ties extents together (see :func:`chords`), the plane that touches
    the cone x_i^2 <= c x_j x_k nearest to the last optimum is added, until the optimum is inside. Each plane is an
    upper bound, so the last optimum is one, too. Salts count as formula units: dissolving one changes no amount of
    anything else.
    """
    identities = [draw for draw in scenario.world.draws.values() if draw.what == "identity"]
    if identities:
        return max(_most_of(scenario, goal, (contents,)) for contents in _held(scenario, identities[0]))
    return _most_of(scenario, goal, [vessel.contents for vessel in scenario.shelf.vessel])


def _held(scenario: Scenario, identity: Any) -> list[dict[str, float]]:
    """What one vessel may hold, of which the file knows the label: one such vessel is all that an order gets."""
    volume = {name: m.molar_mass_g_mol / m.density_kg_l for name, m in scenario.materials.items()}
    label = identity.material
    others = {k: v for k, v in scenario.shelf.vessel[0].contents.items() if k != label}
    litres = scenario.shelf.vessel[0].contents[label] * volume[label]
    return [{**others, option: litres / volume[option]} for option in dict.fromkeys(identity.distribution.options)]


def _most_of(scenario: Scenario, goal: str, shelf: Sequence[Mapping[str, float]]) -> float:
    have = dict.fromkeys(scenario.materials, 0.0)
    for contents in (scenario.stock, *shelf):
        for name, mol in contents.items():
            have[name] += mol
    steps = scenario.family.reaction
    if not steps:
        return have[goal]
    change = np.array([[r.products.get(n, 0.0) - r.reactants.get(n, 0.0) for r in steps] for n in have])
    row = list(have).index(goal)
    planes, bounds = list(-change), list(have.values())
    for _ in range(200):
        tolerance = {"primal_feasibility_tolerance": 1e-10}
        found = linprog(-change[row], A_ub=np.array(planes), b_ub=np.array(bounds), options=tolerance)
        assert found.status == 0
        extents, inside = found.x, True
        for i, j, k, c in chords(scenario):
            if extents[i] > math.sqrt(c * extents[j] * extents[k]) + 1e-9:
                slope = math.sqrt((extents[k] + 1e-9) / (extents[j] + 1e-9))
                plane = np.zeros(len(steps))
                plane[i], plane[j], plane[k] = 1.0, -0.5 * math.sqrt(c) * slope, -0.5 * math.sqrt(c) / slope
                planes.append(plane)
                bounds.append(0.0)
                inside = False
        if inside:
            return have[goal] - float(found.fun)
    raise AssertionError("the planes do not close in on an optimum")


def test_the_laboratory_itself_comes_to_the_maximum_of_a_mixed_product() -> None:
    slow = {"base": "wurtz_any", "name": "slow", "benches": {"rxn": {"tick": 1000.0, "step_limit": 3}}}
    env = RoleEnv(load_scenario(slow), bench="rxn")
    env.reset(seed=0, options={"goal": "5-methylundecane"})
    made = sum(float(env.step(np.array([0.5, 0.5, 1.0, 1.0, 0.0, 1.0], dtype=np.float32))[1]) for _ in range(3))
    assert made == pytest.approx(env.batch.scenario.theoretical_maximum_mol["5-methylundecane"], rel=1e-3)


def features(scenario: Scenario) -> set[str]:
    """What makes a difference to agents and to tests of what holds in any scenario."""
    benches, instruments = scenario.benches.values(), scenario.instruments.values()
    there = {
        "several of a bench": any(bench.count > 1 for bench in benches),
        "wear": any(bench.wear is not None for bench in benches),
        "reports": any(bench.report is not None for bench in benches),
        "drift": any(spec.drift is not None for spec in instruments),
        "several orders": scenario.orders > 1,
        "orders that come": bool(scenario.demand.order),
        "grades": bool(scenario.grades),
        "specifications": bool(scenario.specifications),
        "several goals": len(scenario.lab_goals) > 1,
    }
    return {
        *(name for name, has_it in there.items() if has_it),
        *(f"{bench.kind}, {scenario.physics}" for bench in benches),
        *(spec.kind for spec in instruments),
        *(f"{draw.what} drawn" for draw in scenario.world.draws.values()),
    }


def test_a_few_scenarios_have_every_feature() -> None:
    """Tests of what holds in any scenario run by default in these."""
    every = set[str]().union(*(features(load_scenario(name)) for name in scenario_names()))
    few = set[str]().union(*(features(load_scenario(name)) for name in FEATURED))
    assert every == few


LINES = {"failing": ["east", "west"], "relay": ["rxn", "fin"]}
"""Scenarios with reaction benches of other names."""


@pytest.mark.parametrize("name", scenario_names())
def test_lint(name: str) -> None:
    scenario = load_scenario(name)
    labs = Laboratories(scenario)
    assert scenario.name == name
    assert scenario.title[0].isupper()
    assert scenario.summary.endswith(".")
    # Agents: the manager, then reaction, extraction and distillation benches, numbered from 0.
    order = LINES.get(name) or [key for key in ("rxn", "ext", "dit", "cry") if key in scenario.benches]
    assert list(scenario.benches) == order
    assert labs.agents == ["manager_0"] + [f"{key}_{i}" for key in order for i in range(scenario.benches[key].count)]
    kinds = {"rxn": "reaction", "ext": "extraction", "dit": "distillation", "cry": "crystallization"}
    assert all(bench.kind == kinds.get(key, "reaction") for key, bench in scenario.benches.items())
    # Actions and step limits.
    goals, slots = len(scenario.goals), scenario.shelf.slots
    for bench in labs.benches:
        reacting = 20 if scenario.physics == "paper" else 60
        limits = {"reaction": reacting, "extraction": 50, "distillation": 50, "crystallization": bench.spec.step_limit}
        assert bench.spec.step_limit == limits[bench.spec.kind] or scenario.world.draws
        if bench.spec.kind == "reaction":
            assert bench.action_space == gymnasium.spaces.Box(0.0, 1.0, (len(bench.options.reagents) + 2,), np.float32)
        else:
            actions = {"ext": 41, "dit": 31, "cry": bench.action_count}[bench.key]
            assert bench.action_space == gymnasium.spaces.Discrete(actions)
    starts = len(labs.experiments) * slots * goals * max(len(scenario.grades), 1)
    others = slots * len(scenario.instruments) + slots + slots * scenario.orders + len(labs.experiments) + 1
    others += sum(spec.drift is not None for spec in scenario.instruments.values())
    others += sum(spec.count for spec in scenario.benches.values() if spec.wear is not None)
    assert labs.manager.action_space == gymnasium.spaces.Discrete(starts + others)
    # Goals can be made, and no more of them than the file says.
    for goal in scenario.goals:
        assert most_moles(scenario, goal) > 0.0, f"{goal} cannot be made here"
    assert set(scenario.lab_goals) <= set(scenario.theoretical_maximum_mol) <= set(scenario.goals)
    for goal, mol in scenario.theoretical_maximum_mol.items():
        # Where orders say how much they pay for, or vessels hold unknown shares, the file says what counts as all.
        if not scenario.demand.order and name not in ("crude", "selectivity", "runaway"):
            assert mol == pytest.approx(most_moles(scenario, goal) / scenario.orders, rel=1e-8), goal
    # Every reagent and everything that is added from a bottle has one; every priced bottle exists.
    for bench in labs.benches:
        wanted = list(getattr(bench.options, "reagents", {}))
        wanted += [p.material for p in getattr(bench.options, "process", ()) if p.material is not None]
        assert set(wanted) <= set(scenario.stock)
    assert set(scenario.costs.stock_per_mol) <= set(scenario.stock)
    # What stands on the shelf fits into its vessel, and what leaves a bench can come back.
    for vessel in scenario.shelf.vessel:
        assert litres(scenario, vessel.contents) < vessel.capacity_l
    assert slots - len(scenario.shelf.vessel) >= max(len(bench.positions) for bench in labs.benches) - 1


@pytest.mark.parametrize("name", scenario_names())
def test_name_path_mapping_and_loaded_scenario_are_one(name: str) -> None:
    path = Path(chemlab.scenarios.__path__[0]) / f"{name}.toml"
    by_name = load_scenario(name)
    assert load_scenario(by_name) is by_name
    values = read_toml(path)
    for other in (path, str(path), values):
        assert resolved(load_scenario(other)) == resolved(by_name)
    assert values == read_toml(path), "loading changes no mapping"


def test_only_what_can_happen_here_is_kept() -> None:
    # Without water no hydroxide, no hydrogen; the salt's ions may form in any solvent.
    materials = set(load_scenario("wurtz_dodecane_direct").materials)
    assert {"Na+", "Cl-", "NaCl", "dodecane", "4,5-diethyloctane", "diethyl_ether"} <= materials
    assert not {"water", "OH-", "NaOH", "H2", "hexane", "A"} & materials
    assert {"water", "OH-", "NaOH", "H2"} <= set(load_scenario("wurtz_dodecane").materials)
    assert not load_scenario("wurtz_dodecane_direct").family.violent
    assert len(load_scenario("fictitious").family.reaction) == 5


# -- files that say only what is different -----------------------------------------------------------------------------


def test_a_file_with_a_base_says_only_what_is_different(tmp_path: Path) -> None:
    file = tmp_path / "dear.toml"
    text = "[instruments.balance]\nprice = 0.25\n[limits]\nbudget = 0.5\n"
    file.write_text(f'base = "wurtz_dodecane"\nname = "dear"\n{text}')
    dear, base = load_scenario(file), load_scenario("wurtz_dodecane")
    expected = base.model_dump()
    expected["name"], expected["limits"]["budget"], expected["instruments"]["balance"]["price"] = "dear", 0.5, 0.25
    assert dear.model_dump() == expected
    assert list(dear.instruments) == list(base.instruments), "and the order is the base's"


def test_files_and_parts_of_a_base_are_found_beside_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = min(load_scenario("crude").pairs, key=sorted)
    rest = 'a = [0, 0], b = [7, 7], alpha = 0.3, low_k = 270, high_k = 400, error = 0, source = "made up"'
    row = f"{{ of = {sorted(names)}, {rest} }}"
    (tmp_path / "p.toml").write_text(f'pairs = [{row}]\n[lock]\nmade = "up"\n')
    key = min(load_scenario("crude").benches)
    model = f'[benches.{key}]\nmodel = "parts.py:Slow"\n[levels.2]\npair_files = ["p.toml"]'
    (tmp_path / "first.toml").write_text(f'base = "crude"\nname = "first"\npair_files = ["p.toml"]\n{model}')
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "second.toml").write_text('base = "../first.toml"\nname = "second"\n')
    monkeypatch.chdir(tmp_path)
    refused(lambda: load_scenario("first"), "unknown name 'first'; did you mean first.toml?")
    for path in (tmp_path / "below" / "second.toml", "below/second.toml", "below/second.toml@2"):
        second = load_scenario(path)
        assert second.pairs[names].b == (7.0, 7.0)
        assert second.benches[key].model == "../parts.py:Slow"
        assert second.pair_files == ("../p.toml",)  # not where the folder is, which would be in the scenario's hash


def derived(folder: Path, text: str, base: str = "wurtz_dodecane") -> Scenario:
    """A file with that base and that text, loaded."""
    (folder / "derived.toml").write_text(f'base = "{base}"\nname = "derived"\n{text}')
    return load_scenario(folder / "derived.toml")


def test_a_file_can_take_keys_of_its_base_out_and_give_them_anew(tmp_path: Path) -> None:
    base = load_scenario("wurtz_dodecane").model_dump()
    changed = derived(tmp_path, 'remove = ["benches.ext", "instruments", "costs.stock_per_mol.\'1-chlorohexane\'"]')
    del base["benches"]["ext"], base["costs"]["stock_per_mol"]["1-chlorohexane"]
    assert changed.model_dump() == {**base, "name": "derived", "instruments": {}}
    assert Laboratories(changed).agents == ["manager_0", "rxn_0", "dit_0"]
    solvent = "[benches.rxn.start.contents]\nhexane = 2.0\n"
    anew = derived(tmp_path, f'remove = ["benches.rxn.start.contents"]\n{solvent}')
    assert anew.benches["rxn"].start.contents == {"hexane": 2.0}


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('remove = ["benches.cook"]', ["remove", "'benches.cook'", "'wurtz_dodecane'", "rxn, ext, dit"]),
        ('remove = ["name.first"]', ["remove", "'name.first'", "not a table"]),
        ('remove = ["instruments", "instruments.balance"]', ["remove", "'instruments.balance' is not in the base"]),
        ('remove = "instruments"', ["remove", "list of keys", "'instruments'"]),
        ('remove = ["a = 1\\nb"]', ["remove", "must be keys"]),
        ('remove = ["reactions"]', ["reactions", "required"]),
        ("[benches.ext]", ["benches.ext", "empty table", 'remove = ["benches.ext"]']),
        ("[costs]\nstock_per_mol = {}", ["costs.stock_per_mol", 'remove = ["costs.stock_per_mol"]']),
    ],
)
def test_what_cannot_be_taken_out_is_named(tmp_path: Path, text: str, parts: list[str]) -> None:
    refused(lambda: derived(tmp_path, text), tmp_path / "derived.toml", *parts)


def test_the_advice_about_an_empty_table_works(tmp_path: Path) -> None:
    with pytest.raises(DataError) as caught:
        derived(tmp_path, "[instruments]")
    advice = re.search(r"remove = \[.*\]", str(caught.value))
    assert advice is not None
    assert not derived(tmp_path, advice.group()).instruments


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('base = "wurtz_dodecan"', r"base: unknown 'wurtz_dodecan'; choose from .*wurtz_dodecane.*optimize_coupling"),
        ('base = "nowhere.toml"', r"base: unknown 'nowhere.toml'"),
        ('bases = "wurtz_dodecane"', r"bases: unknown key; did you mean base\?"),
        ('base = "a.toml"', r"inherits from this scenario"),
        ('base = "unlabelled@1"', r"base: 'unlabelled@1' must not have a level"),
        ('remove = ["instruments"]' + BASE, "remove: requires a base, and this scenario has none"),
    ],
)
def test_a_base_that_is_none(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match=message):
        load_scenario(written(tmp_path, text))


def test_bases_have_an_end(tmp_path: Path) -> None:
    for i in range(20):
        (tmp_path / f"{i}.toml").write_text(f'base = "{i + 1}.toml"\n')
    (tmp_path / "20.toml").write_text('base = "fictitious"\n')
    with pytest.raises(DataError, match="more than 16 nested bases"):
        load_scenario(tmp_path / "0.toml")
    assert load_scenario(tmp_path / "10.toml").name == "fictitious"


# -- what a kind of bench has anyway -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["reaction", "extraction", "distillation", "crystallization"])
def test_what_a_bench_leaves_out_is_what_its_kind_has(kind: str, tmp_path: Path) -> None:
    data = read_toml(Path(chemlab.__file__).parent / "data" / "benches" / f"{kind}.toml")
    needed = {"reagents": {"Na": 1.0}, "tick": 0.01} if kind == "reaction" else {}
    least = load_scenario({**read_toml(tiny(tmp_path)), "benches": {"x": {"kind": kind, **needed}}})
    bench = least.benches["x"]
    assert bench.step_limit == data["step_limit"]
    assert bench.model_extra == {**needed, **{key: data[key] for key in data if key != "step_limit"}}
    # A key that is given counts as a whole, and the shipped data stay as they were.
    key, value = {
        "reaction": ("temperature_k", {"low": 280.0, "high": 290.0, "step": 1.0}),
        "extraction": ("process", [{"kind": "mix", "vessel": "EV", "magnitudes": [1]}]),
        "distillation": ("hottest_k", 650.0),
        "crystallization": ("cake_liquid", 0.5),
    }[kind]
    other = load_scenario({**read_toml(tiny(tmp_path)), "benches": {"x": {"kind": kind, **needed, key: value}}})
    assert other.benches["x"].model_extra == {**(bench.model_extra or {}), key: value}
    assert load_scenario({**read_toml(tiny(tmp_path)), "benches": {"x": {"kind": kind, **needed}}}) == least


def tiny(folder: Path) -> Path:
    """The base of these tests with a bottle of ether, as a file."""
    (folder / "tiny.toml").write_text(changed(BASE, "water = 10.0", "water = 10.0\ndiethyl_ether = 1.0"))
    return folder / "tiny.toml"


# -- records -----------------------------------------------------------------------------------------------------------

SHIPPED = {
    "aspirin": "b41599b60e0bf667",
    "benzoic": "0fd9fb935467a270",
    "campaign": "a2c8cc4532df8e9d",
    "crude": "71596ebce01ceecc",
    "failing": "9ea4c1f6fab72fa9",
    "fictitious": "b6e5f8dd73567f54",
    "fischer": "7a30e0cf732e6625",
    "recrystallization": "d407192965600b62",
    "refine": "fb9238a50b6221dd",
    "relay": "c97947048fc2dbe1",
    "runaway": "03446a2127f55efe",
    "rush": "f4ab2766bae75f3c",
    "salt_from_oil": "43921995890affd4",
    "selectivity": "17a7d44d984e4a8d",
    "snar": "3c70f9ce213da2e0",
    "unlabelled": "4db73a9febb40023",
    "wurtz_any": "f423b6d9860f5d2f",
    "wurtz_dodecane": "80551b66bf4da036",
    "wurtz_dodecane_direct": "cd0c35f6b4502c1f",
    "wurtz_real": "d9cabef7808bbf30",
    "wurtz_safe": "47d2eaba16444148",
    "wurtz_scarce": "991871ed4204b25c",
    "wurtz_two_lines": "d0ec357071303304",
}
"""Hashes of all that the shipped scenarios say, in the order in which they say it. The files may change; what they come
to may not without a line in the changelog: records of episodes name their scenario by it."""


def test_what_the_shipped_scenarios_say_has_not_changed() -> None:
    assert {name: said(name) for name in scenario_names() + synthesis_names()} == SHIPPED


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("reactions.reaction.0.products.dodecane", 50.0, r"reaction.0: not balanced: C 12 on the left, 600 "),
        ("reactions.reaction.0.orders.Na", 1e6, r"reaction.0.orders.Na: Input should be less than or equal to 20"),
        ("reactions.reaction.0.products.gold", 1.0, r"reactions: unknown material 'gold'"),
        ("reactions.salt.0.anion", "OH-", r"salt.0: not balanced"),
        ("scenario.shelf.vessel.0.capacity_l", 0.1, r"shelf.vessel.0: contents of 0.4\d+ L do not fit"),
        ("scenario.benches.ext.start.capacity_l", 0.1, r"benches.ext.start: contents of .* do not fit"),
        ("scenario.stock.H2", 1.0, r"stock: 'H2' is a gas"),
        ("scenario.stock.gold", 1.0, r"stock: unknown material 'gold'"),
        ("scenario.theoretical_maximum_mol", {}, r"theoretical_maximum_mol.dodecane: must be given"),
        ("scenario.shelf.vessel", [], r"shelf: vessel: must have at least one"),
        ("scenario.physics", "magic", r"physics: unknown backend"),
        ("scenario.title", "x" * 5000, r"scenario: title: a text must be 4000 characters at most"),
        ("materials.water.density_kg_l", -1.0, r"materials.water: density_kg_l"),
        ("materials", {}, r"unknown material"),
    ],
)
def test_a_record_s_scenario_is_checked_as_a_file_is(key: str, value: Any, message: str) -> None:
    data = json.loads(json.dumps(dump_scenario(load_scenario("wurtz_dodecane"))))
    *parts, last = key.split(".")
    at = data
    for part in parts:
        at = at[int(part)] if isinstance(at, list) else at[part]
    at[last] = value
    with pytest.raises(DataError, match=message) as caught:
        restore_scenario(data, "run.jsonl")
    assert str(caught.value).startswith("run.jsonl: ")


# -- in a notebook and in a hint ---------------------------------------------------------------------------------------


def test_a_hint_can_be_typed(tmp_path: Path) -> None:
    assert load_scenario("wurtz_safe").argument == "wurtz_safe"
    folder = tmp_path / "my labs"
    folder.mkdir()
    (folder / "a.toml").write_text('base = "wurtz_safe"\nname = "cheap"\n')
    cheap = load_scenario(folder / "a.toml")
    (typed,) = shlex.split(cheap.argument)
    assert load_scenario(typed) == cheap
    # Only the file of a shipped name goes by it.
    (folder / "a.toml").write_text('base = "wurtz_safe"\n')
    assert load_scenario(folder / "a.toml").argument == f"'{folder / 'a.toml'}'"
    assert load_scenario({"base": "wurtz_safe", "name": "cheap"}).argument == "FILE.toml"
    with pytest.raises(DataError, match=re.escape(f"run: chemlab export starts {cheap.argument}")):
        lab_starts(cheap, "rxn")
