"""Random chemistries: balanced, sensible, solvable, the same everywhere; and how hard they are."""

import hashlib
import json
import math
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import command, refused, script
from hypothesis import given, settings
from hypothesis import strategies as st

from chemlab.agents.episodes import play_laboratory
from chemlab.agents.policies import make_policies
from chemlab.config.datafile import DataError
from chemlab.config.loading import load_scenario
from chemlab.config.materials import shipped_materials
from chemlab.config.pairs import load_pairs, log_activity_coefficients, pair_table
from chemlab.config.scenario import Scenario
from chemlab.lab.engine import Laboratories
from chemlab.openchem.designs import feeds, steps_to
from chemlab.openchem.difficulty import constant_conditions, difficulty
from chemlab.openchem.generate import LEVELS, chemistry, generated
from chemlab.openchem.invented import boiling_point, pair_rows
from chemlab.openchem.reaction_networks import Draws, Size, chosen_size, draw_network
from chemlab.record import scenario_hash
from chemlab.roles import reaction_bench as reaction

R = 8.314462618


@st.composite
def sizes(draw: st.DrawFn) -> Size:
    steps = draw(st.integers(1, 8))
    others = draw(st.integers(0, 12))
    return Size(steps, 2 * steps + 1 + others, draw(st.integers(max(steps, others), steps + 2 * others)))


def weigh(side: Mapping[str, int], atoms: Mapping[str, Mapping[str, int]]) -> Counter[str]:
    total: Counter[str] = Counter()
    for name, number in side.items():
        for element, count in atoms[name].items():
            total[element] += number * count
    return total


@given(st.integers(0, 2**40), sizes())
def test_a_network_has_its_size_balances_and_leads_from_the_feeds_to_the_goal(seed: int, size: Size) -> None:
    network = draw_network(Draws(seed), size)
    assert (len(network.route), len(network.atoms), len(network.steps)) == (size.steps, size.materials, size.reactions)
    for step in network.steps:
        assert weigh(step.reactants, network.atoms) == weigh(step.products, network.atoms)
    # The route alone, each of its reactions once, turns one of each feed into one of the goal.
    left = Counter(network.feeds)
    for step in network.steps[: size.steps]:
        assert all(left[name] >= n for name, n in step.reactants.items())
        left.subtract(step.reactants)
        left.update(step.products)
    assert +left == Counter([network.route[-1], *network.coproducts])
    # More there cannot be: every feed brings an atom that the goal has, and nothing else brings it.
    goal = network.atoms[network.route[-1]]
    assert all(goal[f"Q{i + 1}"] == 1 for i in range(len(network.feeds)))
    assert {name for step in network.steps for name in (*step.reactants, *step.products)} == set(network.atoms)


@given(st.sampled_from(sorted(LEVELS)), st.none() | st.integers(3, 40), st.none() | st.integers(1, 75))
def test_a_size_is_what_was_asked_for_or_there_is_none(name: str, materials: int | None, reactions: int | None) -> None:
    def exists(size: Size) -> bool:
        least, most = max(size.steps, size.others), size.steps + 2 * size.others
        return size.others >= 0 and least <= size.reactions <= most

    try:
        size = chosen_size(LEVELS[name].size, materials, reactions, None)
    except DataError:
        assert materials is not None
        assert reactions is not None
        assert not any(exists(Size(steps, materials, reactions)) for steps in range(1, 9))
        return
    assert exists(size)
    assert materials in (None, size.materials)
    assert reactions in (None, size.reactions)
    if materials is reactions is None:
        assert size == LEVELS[name].size


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"materials": 2}, "materials = 2: must be from 3 to 40"),
        ({"reactions": 0}, "reactions = 0: must be from 1 to 75"),
        ({"steps": 9}, "steps = 9: must be from 1 to 8"),
        ({"materials": 5, "reactions": 9}, "materials = 5, reactions = 9: there is no such network"),
        ({"materials": 5, "steps": 3}, "omit one of the numbers"),
        ({"goals": 3}, "goals = 3: must be from 1 to 2"),
        ({"difficulty": "dire"}, "difficulty = 'dire': must be one of easy, medium, hard"),
        ({"physics": "none"}, "physics = 'none': must be one of paper, real"),
        ({"seed": -1}, "seed = -1: must be an integer from 0"),
        ({"seed": 1.5}, "seed = 1.5: must be an integer"),
    ],
)
def test_what_there_is_not_is_said_with_what_to_do(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        generated(**{"seed": 0, **arguments})


def test_boiling_points_are_those_of_alkanes() -> None:
    # Kinney's number of an alkane: 0.8 for each carbon, 1 for each hydrogen.
    for name, carbons in (("hexane", 6), ("dodecane", 12)):
        expected = pytest.approx(shipped_materials()[name].boiling_point_k, abs=3.0)
        assert boiling_point(0.8 * carbons + 2 * carbons + 2) == expected


@pytest.mark.parametrize("physics", ["paper", "real"])
@pytest.mark.parametrize("name", LEVELS)
@pytest.mark.parametrize("seed", range(2))
def test_properties_are_sensible_and_consistent(seed: int, name: str, physics: str) -> None:
    made = generated(seed, difficulty=name, physics=physics)
    scenario = made.scenario()
    invented = {key: m for key, m in scenario.materials.items() if key in made.materials}
    assert set(invented) == set(made.materials)
    liquids = [m for m in scenario.materials.values() if m.role in ("solvent", "solute")]
    for goal in scenario.lab_goals:
        boils = scenario.materials[goal].boiling_point_k
        apart = [abs(m.boiling_point_k - boils) for k, m in scenario.materials.items() if k != goal and m in liquids]
        assert min(apart) >= LEVELS[name].gap_k[0] - 0.1
    for key, material in invented.items():
        assert 300.0 < material.boiling_point_k < (640.0 if key in scenario.goals else 800.0)  # of dimers: tars
        assert 0.7 < material.density_kg_l < 1.2
        assert 1.6 < material.heat_capacity_j_mol_k / material.molar_mass_g_mol < 2.3
        assert 75.0 < material.vaporization_enthalpy_j_mol / material.boiling_point_k < 95.0  # Trouton: about 85
        assert made.materials[key]["real"]["critical_temperature_k"] > material.boiling_point_k
    mass = {name: material.molar_mass_g_mol for name, material in scenario.materials.items()}
    heat = {name: table["real"]["formation_enthalpy_j_mol"] for name, table in made.materials.items()}
    for step in scenario.family.reaction:
        for of, low, high in ((mass, -0.05, 0.05), (heat, -250e3, 0.0)):
            change = sum(of[k] * n for k, n in step.products.items())
            change -= sum(of[k] * n for k, n in step.reactants.items())
            assert low < change < high


def test_a_vapour_pressure_has_the_boiling_point_and_the_heat_of_vaporization() -> None:
    scenario = chemistry(3, physics="real")
    for name in scenario.family.materials():
        material = scenario.materials[name]
        assert material.real is not None
        assert material.real.vapor_pressure is not None
        boils = material.boiling_point_k
        pressure = material.real.vapor_pressure.pascal(np.array([boils - 0.01, boils, boils + 0.01]))
        assert pressure[1] == pytest.approx(101_325.0, rel=1e-4)
        slope = math.log(pressure[2] / pressure[0]) / (1.0 / (boils - 0.01) - 1.0 / (boils + 0.01))
        assert R * slope == pytest.approx(material.vaporization_enthalpy_j_mol, rel=1e-3)  # Clausius-Clapeyron


def test_pairs_are_regular_solutions(tmp_path: Path) -> None:
    made = generated(5, physics="real", difficulty="hard")
    made.write(tmp_path)
    pairs = load_pairs([tmp_path / "chemistry_5_pairs.toml"])
    scenario = made.scenario()
    names = [name for name, m in scenario.materials.items() if m.role == "solvent"]
    assert len(pairs) == math.comb(len(names), 2)
    first, second = scenario.materials["A1"], scenario.materials["P1"]

    def cohesion(name: str) -> tuple[float, float]:
        m = scenario.materials[name]
        assert m.real is not None
        critical = m.real.critical_temperature_k
        assert critical is not None
        volume = m.molar_mass_g_mol / m.density_kg_l * 1e-6
        watson = ((critical - 298.15) / (critical - m.boiling_point_k)) ** 0.38
        return volume, (m.vaporization_enthalpy_j_mol * watson - R * 298.15) / volume

    (v1, c1), (v2, c2) = cohesion("A1"), cohesion("P1")
    table = pair_table(["A1", "P1"], pairs)
    expected = math.sqrt(v1 * v2) * (math.sqrt(c1) - math.sqrt(c2)) ** 2 / (R * 360.0)
    for x in ([1.0, 0.0], [0.0, 1.0]):
        logs = log_activity_coefficients(np.array(x), table.tau(360.0), table.alpha)
        assert logs[int(x[0])] == pytest.approx(expected, abs=1e-4)
    (row,) = pair_rows({"A1": first, "P1": second})
    assert frozenset(row["of"]) in pairs


@pytest.mark.parametrize("physics", ["paper", "real"])
@pytest.mark.parametrize("goals", [1, 3])
def test_what_there_can_be_of_a_goal_follows_from_the_route(physics: str, goals: int) -> None:
    scenario = chemistry(11, difficulty="hard", physics=physics, goals=goals)
    assert len(scenario.lab_goals) == goals
    for i, goal in enumerate(scenario.lab_goals):
        fed = feeds(goal, scenario.family, scenario.theoretical_maximum_mol[goal])
        assert len(steps_to(goal, scenario.family)) <= 3 - (goals - 1 - i)
        assert fed.items() <= {k: pytest.approx(n) for k, n in scenario.stock.items()}.items()


@pytest.mark.parametrize("physics", ["paper", "real"])
def test_files_are_the_scenario_and_are_written_once(physics: str, tmp_path: Path) -> None:
    made = generated(2, physics=physics, name="mine")
    path = made.write(tmp_path / "new")
    assert path == tmp_path / "new" / "mine.toml"
    loaded = load_scenario(path)
    assert loaded.materials == made.scenario().materials
    assert loaded.family == made.scenario().family
    assert scenario_hash(loaded) == scenario_hash(made.scenario())
    refused(r"mine\.toml: already exists", made.write, tmp_path / "new")
    made.write(tmp_path / "new", force=True)


FIRST = {
    "paper": "8b50ef797dccd4c23f9b9dd3fe600b162ee5f7ebd23cbc5c10ab47b6f7d4bc5f",
    "real": "f1d08a180d17b21c53b5ae005abedfbd694d489db522acaa059565ce7b795c37",
}
"""Of the files of seed 1, without the version of chemlab. A change makes every seed another chemistry: it belongs into
the changelog."""


@pytest.mark.parametrize("physics", FIRST)
def test_a_seed_is_the_same_files_everywhere(physics: str) -> None:
    texts = generated(1, difficulty="hard", physics=physics).files()
    lines = [line for text in texts.values() for line in text.splitlines() if not line.startswith("chemlab =")]
    assert hashlib.sha256("\n".join(lines).encode()).hexdigest() == FIRST[physics]


def test_seeds_are_different_chemistries_with_the_same_spaces() -> None:
    made = [chemistry(seed, difficulty="hard") for seed in range(20)]
    assert len({json.dumps(s.family.model_dump(mode="json")["reaction"]) for s in made}) == 20
    labs = [Laboratories(scenario) for scenario in made[:6]]
    spaces = [[(one.observation_space(i), one.action_space(i)) for i in range(len(one.agents))] for one in labs]
    assert spaces == [spaces[0]] * 6


def test_it_needs_no_extra() -> None:
    code = (
        "import sys\nfor name in ('rdkit', 'thermo', 'chemicals', 'ugropy', 'torch'): sys.modules[name] = None\n"
        "from chemlab.openchem.generate import chemistry\n"
        "for physics in ('paper', 'real'): chemistry(0, physics=physics)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ, "NUMBA_DISABLE_JIT": "1"})


def play(scenario: Scenario) -> float:
    """The scripted agents' score of an episode, in which every atom stays somewhere."""
    played, before, after = script("studies/physics/chemistries.py").scripted(scenario)
    np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-12)
    return float(played.returns[0])


def test_scripted_agents_play_and_atoms_stay() -> None:
    scores = [play(chemistry(seed, difficulty=list(LEVELS)[seed % 2])) for seed in range(14)]
    scores += [play(chemistry(seed, difficulty="easy", physics="real")) for seed in range(6)]
    assert np.isfinite(scores).all()
    assert np.mean(np.array(scores) > 0.5) > 0.6  # of 1,000: studies/physics/chemistries.csv


def test_kernels_are_compiled_for_no_chemistry_of_its_own() -> None:
    play(chemistry(0, difficulty="easy"))
    known = len(getattr(reaction._step, "overloads", ()))
    for seed, steps in enumerate((1, 2, 5)):
        play(chemistry(seed, steps=steps, materials=2 * steps + 4))
    assert len(getattr(reaction._step, "overloads", ())) == known


@settings(max_examples=10)
@given(st.integers(0, 2**40), sizes(), st.sampled_from(sorted(LEVELS)))
def test_any_size_loads_and_plays(seed: int, size: Size, name: str) -> None:
    play(chemistry(seed, size.materials, size.reactions, name, "paper", size.steps, 1))


def test_the_harder_it_is_the_less_constant_conditions_reach() -> None:
    medians = []
    for name in LEVELS:
        found = [constant_conditions(s, s.goals[-1]) for s in (chemistry(seed, difficulty=name) for seed in range(8))]
        medians.append(float(np.median([conditions.reached for conditions in found if conditions is not None])))
    assert medians == sorted(medians, reverse=True)
    assert medians[0] > 0.9
    assert medians[-1] < 0.8


def test_a_route_without_side_reactions_is_selective() -> None:
    scenario = chemistry(4, materials=5, reactions=2, difficulty="easy")
    conditions = constant_conditions(scenario, scenario.goals[-1])
    assert conditions is not None
    # What has not become the goal is still on the way to it: an intermediate, which uses up its feeds.
    assert conditions.selectivity == pytest.approx(1.0, abs=0.1)
    single = chemistry(4, materials=3, reactions=1, difficulty="easy")
    conditions = constant_conditions(single, single.goals[-1])
    assert conditions is not None
    assert conditions.selectivity == pytest.approx(1.0, abs=1e-6)
    assert conditions.reached > 0.97


def test_difficulty_of_a_shipped_scenario_says_what_is_known_of_it() -> None:
    rows = {row.goal: row for row in difficulty("fictitious", episodes=1, plans=0)}
    assert {goal: row.steps for goal, row in rows.items()} == {"E": 1, "F": 1, "G": 1, "H": 1, "I": 4}
    # I is made of F, G and H; put together at once, their reagents become E, five times as fast.
    assert rows["I"].conditions is not None
    assert rows["I"].conditions.reached < 0.5 < 0.95 < rows["F"].conditions.reached  # type: ignore[union-attr]
    assert (rows["F"].boils_apart_k, rows["F"].boils_next) == (15.0, "C")
    assert rows["F"].plan is None
    labs = Laboratories("fictitious", 7)
    drawn = play_laboratory(labs, make_policies("scripted,manager=random", labs, 0), "F", 0)
    again = {row.goal: row for row in difficulty("fictitious", episodes=1, plans=0, explored=7)}["F"]
    assert again.chance == pytest.approx((drawn.returns > 0.1).mean())
    assert again.decisions == pytest.approx(labs.state.actions.mean())
    assert -0.2 < again.nothing <= 0.0
    (salt,) = difficulty("salt_from_oil", episodes=1, plans=0)
    assert (salt.steps, salt.conditions, salt.boils_apart_k) == (0, None, None)


def test_commands_write_and_judge_a_chemistry(tmp_path: Path) -> None:
    assert "must be lower-case letters, digits and _" in command("data", "generate", "My Chem", code=2)
    words = ("data", "generate", "mine", "--seed", 3, "--materials", 6, "--reactions", 4, "-o", tmp_path)
    command(*words)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine.toml", "mine_materials.toml", "mine_reactions.toml"]
    scenario = load_scenario(tmp_path / "mine.toml")
    assert (len(scenario.family.reaction), len(scenario.family.materials())) == (4, 6)
    assert "--force" in command(*words, code=2)
    judge = ("audit", "difficulty", tmp_path / "mine.toml", "--episodes", 2, "--plans")
    (row,) = json.loads(command(*judge, 8, "--json"))
    assert row["goal"] == scenario.goals[-1]
    assert 0.0 < row["conditions"]["reached"] <= row["conditions"]["selectivity"] <= 1.0
    assert row["plan"] is not None
    assert "selectivity" in command(*judge, 0)
